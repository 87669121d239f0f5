//! Vertices as the device has them: a position, and a normal of two numbers.
//! Must not know: a device.

use std::sync::OnceLock;

use bytemuck::{Pod, Zeroable};
use fearless_simd::{Level, dispatch};

use crate::gpu::staging::{PAGE_BYTES, Page};
use crate::pool::made_once;
use crate::render::raster::lanes::{VERTEX_BATCH, to_soa};
use crate::render::select::selection::SelectedRock;
use crate::rounding::floor;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::sky::DOME_LEVEL;

/// Vertices in a page of the upload.
const PER_PAGE: usize = PAGE_BYTES / size_of::<PackedVertex>();

/// A vertex in the vertex buffer. Its position is that of the scene to the bit, for labels depend on it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct PackedVertex {
    /// Relative to its instance, metres.
    position: [f32; 3],
    /// Octahedral encoding of the normal, signed normalised: [`SNORM_MAX`] is 1.
    normal: [i16; 2],
}

/// The value of a 16-bit signed normalised number that stands for 1.
const SNORM_MAX: f32 = 32_767.0;

/// Meshes that lie one behind the other in an upload, which has whole pages.
#[derive(Debug, Default)]
pub(crate) struct MeshList<'a> {
    /// Each with its first vertex.
    meshes: Vec<(usize, &'a [Vertex])>,
    len: usize,
}

impl<'a> MeshList<'a> {
    /// Appends a mesh; returns its first vertex.
    pub(super) fn push(&mut self, mesh: &'a [Vertex]) -> usize {
        let first = self.len;
        self.meshes.push((first, mesh));
        self.len += mesh.len();
        first
    }

    /// Number of vertices.
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// Size of the upload.
    pub(crate) const fn bytes(&self) -> usize {
        (self.len * size_of::<PackedVertex>()).next_multiple_of(PAGE_BYTES)
    }

    /// Writes a page of the upload.
    pub(crate) fn write_page(&self, index: usize, page: Page<'_>) {
        let mut page: wgpu::WriteOnly<'_, [u8]> = page.into();
        page.copy_from_slice(bytemuck::cast_slice(&self.packed_page(index)));
    }

    fn packed_page(&self, index: usize) -> [PackedVertex; PER_PAGE] {
        let first = index * PER_PAGE;
        let mut page = [PackedVertex::default(); PER_PAGE];
        let mut rest = &mut page[..];
        let started = self.meshes.partition_point(|(start, _)| *start <= first);
        for (start, mesh) in &self.meshes[started.saturating_sub(1)..] {
            let vertices = mesh.get(first.saturating_sub(*start)..).unwrap_or_default();
            let (packed, after) = rest.split_at_mut(vertices.len().min(rest.len()));
            dispatch!(Level::new(), _simd => pack(vertices, packed));
            rest = after;
            if rest.is_empty() {
                break;
            }
        }
        page
    }
}

/// The sphere of radius 1 m that stars, the sun and the dome are drawn with.
pub(super) fn unit_sphere() -> &'static [Vertex] {
    static VERTICES: OnceLock<Vec<Vertex>> = OnceLock::new();
    let make = || {
        let directions = &Icosphere::shared().directions[..Icosphere::vertex_count(DOME_LEVEL)];
        directions.iter().map(|&d| Vertex { position: d, normal: d }).collect()
    };
    made_once::<Vec<Vertex>>(&VERTICES, make)
}

/// The vertices of a rock down to the finest level at which a frame needs it.
pub(super) fn vertices_of<'a>(scene: &'a Scene, selected: &SelectedRock) -> &'a [Vertex] {
    let rock = &scene.rocks[selected.rock];
    let finest = selected.visible_level.max(selected.caster.map(|(_, level)| level)).unwrap_or(0);
    &rock.vertices[..Icosphere::vertex_count(finest.min(rock.level))]
}

// Inlined into `dispatch!`, so that it is compiled for each SIMD level.
#[inline(always)]
fn pack(vertices: &[Vertex], packed: &mut [PackedVertex]) {
    for (vertices, packed) in vertices.chunks(VERTEX_BATCH).zip(packed.chunks_mut(VERTEX_BATCH)) {
        let [x, y, z] = to_soa(vertices.iter().map(|vertex| vertex.normal));
        // CPU counterpart of `octahedral_encode` in `common/octahedral.wgsl`.
        let mut octahedral = [[0_i32; VERTEX_BATCH]; 2];
        for i in 0..VERTEX_BATCH {
            let sum = x[i].abs() + y[i].abs() + z[i].abs();
            let scale = SNORM_MAX / if sum > 1e-30 { sum } else { 1e-30 };
            let (u, v) = (scale * x[i], scale * y[i]);
            let is_below = z[i] < 0.0;
            let folded_u = (SNORM_MAX - v.abs()).copysign(u);
            let folded_v = (SNORM_MAX - u.abs()).copysign(v);
            octahedral[0][i] = floor(0.5 + if is_below { folded_u } else { u });
            octahedral[1][i] = floor(0.5 + if is_below { folded_v } else { v });
        }
        for (i, (vertex, packed)) in vertices.iter().zip(packed).enumerate() {
            let normal = [octahedral[0][i] as i16, octahedral[1][i] as i16];
            *packed = PackedVertex { position: vertex.position.into(), normal };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    #[test]
    fn packing_keeps_positions_and_changes_normals_by_less_than_a_ten_thousandth() {
        let normals = &Icosphere::shared().directions;
        let vertices: Vec<Vertex> =
            normals.iter().map(|&normal| Vertex { position: 3.7 * normal, normal }).collect();
        let (one, others) = vertices.split_at(1);
        // A mesh without vertices, and some that end within a page.
        let mut meshes = MeshList::default();
        for mesh in [one, &[], &others[..700], &others[700..]] {
            meshes.push(mesh);
        }
        assert_eq!(meshes.bytes(), vertices.len().div_ceil(PER_PAGE) * PAGE_BYTES);
        for (index, expected) in vertices.chunks(PER_PAGE).enumerate() {
            let page = meshes.packed_page(index);
            for (packed, vertex) in page.iter().zip(expected) {
                assert_eq!(Vec3::from(packed.position), vertex.position);
                let p = Vec2::from(packed.normal.map(|snorm| f32::from(snorm) / SNORM_MAX));
                let z = 1.0 - p.x.abs() - p.y.abs();
                let back = (-z).max(0.0);
                let normal = Vec3::new(p.x - back.copysign(p.x), p.y - back.copysign(p.y), z).normalize();
                assert!(normal.distance(vertex.normal) < 1e-4, "{normal} for {}", vertex.normal);
            }
        }
    }
}
