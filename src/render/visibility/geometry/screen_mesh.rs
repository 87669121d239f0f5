//! A mesh on the samples: projected vertices, and the triangles that survive culling and clipping.
//!
//! Must not know: what the mesh is of.

use fearless_simd::{Level, dispatch};
use glam::Vec3;

use super::face_normal::packed_face_normal;
use super::projection::{ClipVertex, Projection, ScreenVertex};
use crate::render::device::shading_bins::{ShadingBin, ShadowSources};
use crate::render::raster::bounds::{PixelBounds, pixel_bounds};
use crate::render::raster::cull::{CULL_BATCH, CullMode, Survivors, Winding};
use crate::render::raster::lanes::VERTEX_BATCH;
use crate::render::raster::setup::{Interpolant, TriangleSetup};
use crate::render::select::ground_blocks::BLOCK_CELLS;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::scene::mesh::Vertex;

/// Number of [`ShadowSources`].
pub(super) const SHADOW_SOURCES: usize = ShadowSources::ALL.len();

// A row of cells of a ground block is culled at once, two triangles per cell.
const _: () = assert!(CULL_BATCH >= 2 * BLOCK_CELLS as usize);

/// A triangle that may cover samples: a front face, by the order of its vertices.
#[derive(Clone, Copy, Debug)]
pub struct ScreenTriangle {
    /// Indices in [`ScreenMesh::vertices`].
    pub vertices: [u32; 3],
    /// Normal of the triangle itself, packed as `visibility.wgsl` does. 0 where no rock can shade it: only the lookup of rock
    /// shadows reads it.
    pub face_normal: u32,
    /// First and last row of samples that it may cover.
    pub rows: [u16; 2],
    /// What can shade it, by the index in [`ShadowSources::ALL`], in the lowest bits. Above them, of a piece of a clipped triangle, one
    /// more than its index in [`ScreenMesh::clipped_interpolants`], else 0: the piece may be too thin to compute interpolants from its
    /// own corners.
    sources_and_clipped: u32,
}

/// Bits of the index of the [`ShadowSources`].
const SOURCES_BITS: u32 = SHADOW_SOURCES.ilog2();

impl ScreenTriangle {
    /// What can shade it, by the index in `ShadowSources::ALL`.
    #[must_use]
    #[inline(always)]
    pub const fn shadow_sources(&self) -> usize {
        self.sources_and_clipped as usize % SHADOW_SOURCES
    }

    /// Of a piece of a clipped triangle, the index in [`ScreenMesh::clipped_interpolants`].
    #[must_use]
    #[inline(always)]
    pub const fn clipped(&self) -> Option<usize> {
        (self.sources_and_clipped as usize >> SOURCES_BITS).checked_sub(1)
    }
}

/// A mesh on the samples.
#[derive(Debug, Default)]
pub struct ScreenMesh {
    /// Vertices of the surface that it was made for, before clipping.
    vertex_capacity: usize,
    /// Slot of its instance.
    pub slot: u32,
    /// Shading bins of its triangles, by their `ShadowSources`.
    pub bins: [ShadingBin; SHADOW_SOURCES],
    /// Bounds of the triangles of each bin.
    pub bounds: [ScreenBounds; SHADOW_SOURCES],
    /// Its projected vertices, then those that clipping added.
    pub vertices: Vec<ScreenVertex>,
    /// Whether no vertex needs clipping.
    needs_no_clipping: bool,
    /// Its triangles.
    pub triangles: Vec<ScreenTriangle>,
    /// Interpolants of the attributes of clipped triangles, from the first sample of the image on.
    pub clipped_interpolants: Vec<[Interpolant; 4]>,
    /// First and last row of samples that it may cover.
    pub rows: [u16; 2],
}

impl ScreenMesh {
    /// A mesh for a surface with this many vertices.
    pub(super) fn with_capacity(vertex_capacity: usize) -> Self {
        // Of a closed surface half of the triangles, as many as there are vertices, face the eye.
        let triangles = Vec::with_capacity(vertex_capacity);
        Self { vertex_capacity, vertices: Vec::with_capacity(vertex_capacity), triangles, ..Self::default() }
    }

    /// Vertices of the surface that it was made for.
    pub(super) const fn vertex_capacity(&self) -> usize {
        self.vertex_capacity
    }

    /// The vertices of one of its triangles.
    #[must_use]
    #[inline(always)]
    pub fn vertices_of(&self, triangle: &ScreenTriangle) -> [ScreenVertex; 3] {
        triangle.vertices.map(|vertex| self.vertices[vertex as usize])
    }

    /// The interpolants of [`ScreenVertex::attributes`] over one of its triangles, which has these vertices.
    #[must_use]
    #[inline(always)]
    pub fn interpolants(
        &self,
        triangle: &ScreenTriangle,
        vertices: [ScreenVertex; 3],
        setup: &TriangleSetup,
    ) -> [Interpolant; 4] {
        triangle.clipped().map_or_else(
            || setup.interpolants(vertices.map(|v| v.position_px), vertices.map(|v| v.attributes())),
            |clipped| self.clipped_interpolants[clipped].map(|i| setup.rebase(i)),
        )
    }

    pub(super) fn restart(&mut self, slot: u32, bins: [ShadingBin; SHADOW_SOURCES]) {
        (self.slot, self.bins) = (slot, bins);
        self.bounds = [ScreenBounds::EMPTY; SHADOW_SOURCES];
        self.rows = [u16::MAX, 0];
        self.needs_no_clipping = true;
        self.vertices.clear();
        self.triangles.clear();
        self.clipped_interpolants.clear();
    }

    /// Bytes of its lists.
    pub(super) fn needed_bytes(&self) -> usize {
        size_of_val(&self.vertices[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.clipped_interpolants[..])
    }

    /// Bytes that are allocated for its lists.
    pub(super) fn kept_bytes(&self) -> usize {
        fn bytes<T>(list: &Vec<T>) -> usize {
            list.capacity() * size_of::<T>()
        }
        bytes(&self.vertices) + bytes(&self.triangles) + bytes(&self.clipped_interpolants)
    }

    /// Frees what is allocated beyond the needed.
    pub(super) fn free_excess(&mut self) {
        self.vertices.shrink_to_fit();
        self.triangles.shrink_to_fit();
        self.clipped_interpolants.shrink_to_fit();
    }

    /// Adds the vertices of a surface at `origin`, metres from the eye.
    pub(super) fn add_vertices(&mut self, projection: &Projection, origin: Vec3, vertices: &[Vertex]) {
        self.vertices.reserve(vertices.len());
        for vertices in vertices.chunks(VERTEX_BATCH) {
            let first = self.vertices.len();
            dispatch!(Level::new(), _simd => projection.project_batch(origin, vertices, &mut self.vertices));
            self.needs_no_clipping &= self.vertices[first..].iter().all(|vertex| vertex.inverse_w > 0.0);
        }
    }

    /// Culls triangles of a closed or one-sided surface; all survive if some may need clipping.
    pub(super) fn cull(&self, projection: &Projection, triangles: &[[u32; 3]]) -> Survivors {
        if !self.needs_no_clipping {
            return Survivors::all(triangles.len());
        }
        let position_of = |vertex: u32| self.vertices[vertex as usize].position;
        dispatch!(Level::new(), simd => {
            Survivors::cull(simd, triangles, position_of, CullMode::Back, projection.width, &projection.rows)
        })
    }

    /// Adds the visible part of a triangle. `shadow_sources` tells what can shade it, or none if it is buried; `vertex` gives the
    /// offset of a corner from the eye, and its normal. Both are asked only of triangles that may cover samples.
    #[inline]
    pub(super) fn add(
        &mut self,
        projection: &Projection,
        triangle: [u32; 3],
        cull_mode: CullMode,
        shadow_sources: impl FnOnce() -> Option<ShadowSources>,
        vertex: impl Fn(u32) -> (Vec3, Vec3),
    ) {
        if !triangle.iter().all(|&corner| self.is_projected(corner)) {
            self.add_clipped(projection, triangle, cull_mode, shadow_sources, vertex);
            return;
        }
        let Some((vertices, bounds)) = self.front_facing(projection, triangle, cull_mode) else { return };
        if let Some(shadow_sources) = shadow_sources() {
            let face_normal = || packed_face_normal(vertices.map(|corner| vertex(corner).0));
            self.push(vertices, bounds, shadow_sources, face_normal, 0);
        }
    }

    /// Whether a vertex needs no clipping.
    #[inline]
    fn is_projected(&self, vertex: u32) -> bool {
        self.vertices[vertex as usize].inverse_w > 0.0
    }

    /// [`Self::add`] for a triangle with a vertex that needs clipping.
    fn add_clipped(
        &mut self,
        projection: &Projection,
        triangle: [u32; 3],
        cull_mode: CullMode,
        shadow_sources: impl FnOnce() -> Option<ShadowSources>,
        vertex: impl Fn(u32) -> (Vec3, Vec3),
    ) {
        let clip_vertices = triangle.map(|corner| {
            let (offset, normal) = vertex(corner);
            let (xy, w) = projection.clip_coordinates(offset);
            ClipVertex { xy, w, normal, index: self.is_projected(corner).then_some(corner) }
        });
        if projection.is_outside_frustum(&clip_vertices) {
            return;
        }
        let polygon: Vec<u32> = projection
            .clip_triangle(clip_vertices)
            .into_iter()
            .map(|v| v.index.unwrap_or_else(|| self.push_vertex(projection.project(v.xy, v.w, v.normal))))
            .collect();
        let fan = (2..polygon.len()).map(|i| [polygon[0], polygon[i - 1], polygon[i]]);
        let pieces: Vec<_> =
            fan.filter_map(|piece| self.front_facing(projection, piece, cull_mode)).collect();
        if pieces.is_empty() {
            return;
        }
        if let (Some(interpolants), Some(shadow_sources)) =
            (projection.homogeneous_interpolants(clip_vertices), shadow_sources())
        {
            self.clipped_interpolants.push(interpolants);
            let clipped = self.clipped_interpolants.len() as u32;
            let face_normal = || packed_face_normal(triangle.map(|corner| vertex(corner).0));
            for (vertices, bounds) in pieces {
                self.push(vertices, bounds, shadow_sources, face_normal, clipped);
            }
        }
    }

    fn push_vertex(&mut self, vertex: ScreenVertex) -> u32 {
        self.vertices.push(vertex);
        self.vertices.len() as u32 - 1
    }

    /// The vertices of a triangle in the order of a front face, and its bounds; none if it is culled.
    #[inline]
    fn front_facing(
        &self,
        projection: &Projection,
        [a, b, c]: [u32; 3],
        cull_mode: CullMode,
    ) -> Option<([u32; 3], PixelBounds)> {
        let positions = [a, b, c].map(|vertex| self.vertices[vertex as usize].position);
        let bounds = pixel_bounds(positions, projection.width, &projection.rows)?;
        match (Winding::of(positions)?, cull_mode) {
            (Winding::Front, _) => Some(([a, b, c], bounds)),
            (Winding::Back, CullMode::None) => Some(([a, c, b], bounds)),
            (Winding::Back, CullMode::Back) => None,
        }
    }

    #[inline]
    fn push(
        &mut self,
        vertices: [u32; 3],
        PixelBounds { columns, rows }: PixelBounds,
        shadow_sources: ShadowSources,
        face_normal: impl FnOnce() -> u32,
        clipped: u32,
    ) {
        let bounds = &mut self.bounds[shadow_sources as usize];
        *bounds = bounds.union(ScreenBounds::of_samples(columns, rows));
        let face_normal = if shadow_sources.has_rocks() { face_normal() } else { 0 };
        let rows = [rows.0 as u16, rows.1 as u16];
        self.rows = [self.rows[0].min(rows[0]), self.rows[1].max(rows[1])];
        let sources_and_clipped = shadow_sources as u32 | clipped << SOURCES_BITS;
        self.triangles.push(ScreenTriangle { vertices, face_normal, rows, sources_and_clipped });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::raster::coverage::CoverageCounter;
    use crate::render::raster::lanes::BLOCK_WIDTH;
    use crate::render::settings::RenderSettings;
    use crate::scene::camera::Camera;

    const SIZE: [usize; 2] = [96, 64];

    fn projection(pitch_deg: f64) -> Projection {
        let camera = Camera::new(Vec3::ZERO, [pitch_deg, 0.0, 0.0], 80.0, 2000.0, 0.0);
        let settings = RenderSettings::new(SIZE.map(|side| side as u32), 1).expect("settings");
        Projection::new(&camera, &settings)
    }

    /// A mesh of these triangles.
    fn mesh(projection: &Projection, positions: &[Vec3], triangles: &[[u32; 3]]) -> ScreenMesh {
        let mut mesh = ScreenMesh::default();
        let vertices: Vec<Vertex> =
            positions.iter().map(|&position| Vertex { position, normal: Vec3::Z }).collect();
        mesh.add_vertices(projection, Vec3::ZERO, &vertices);
        for &triangle in triangles {
            let vertex = |v: u32| (positions[v as usize], Vec3::Z);
            mesh.add(projection, triangle, CullMode::None, || Some(ShadowSources::None), vertex);
        }
        mesh
    }

    /// Ground a metre below the eye that reaches behind it and far beside the image: it covers every sample below the horizon
    /// once, at the depth where the ray meets it.
    #[test]
    fn surfaces_that_reach_behind_the_eye_are_clipped_without_a_seam() {
        let far_m = 1.0e5;
        let corner = |x: f32, y: f32| Vec3::new(x * far_m, y * far_m, -1.0);
        let positions =
            [corner(-1.0, -1.3), corner(1.1, -1.0), corner(1.0, 1.2), corner(-0.9, 1.0), Vec3::NEG_Z];
        let triangles = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
        let stride = SIZE[0] + BLOCK_WIDTH;
        for pitch_deg in [-70.0, -20.0, 0.0] {
            let projection = projection(pitch_deg);
            let mesh = mesh(&projection, &positions, &triangles);
            assert!(!mesh.clipped_interpolants.is_empty());
            let mut counter = CoverageCounter::new(SIZE);
            for triangle in &mesh.triangles {
                let vertices = mesh.vertices_of(triangle);
                let setup = TriangleSetup::new(vertices.map(|v| v.position), SIZE[0], &projection.rows)
                    .expect("it has bounds");
                [counter.attribute, ..] = mesh.interpolants(triangle, vertices, &setup);
                let counter = &mut counter;
                dispatch!(Level::new(), simd => setup.fill(simd, 0, stride, counter));
            }
            let offset_from_clip = projection.clip_from_offset.as_dmat4().inverse();
            let mut covered = 0;
            for row in 0..SIZE[1] {
                for column in 0..SIZE[0] {
                    let at = glam::DVec2::new(column as f64 + 0.5, row as f64 + 0.5)
                        / projection.half_size.as_dvec2();
                    let near = offset_from_clip * glam::DVec4::new(at.x - 1.0, 1.0 - at.y, 1.0, 1.0);
                    let ray = near.truncate() / near.w;
                    // Inverse depth of the point on the ray that lies a metre below the eye.
                    let expected = -ray.z / f64::from(projection.near_m);
                    let sample = row * stride + column;
                    if expected > 1e-3 {
                        assert_eq!(counter.counts[sample], 1, "pitch {pitch_deg}, sample {column}, {row}");
                        let found = f64::from(counter.values[sample]);
                        assert!((found / expected - 1.0).abs() < 1e-5, "{found} for {expected}");
                        covered += 1;
                    } else if expected < 0.0 {
                        assert_eq!(counter.counts[sample], 0, "pitch {pitch_deg}, sample {column}, {row}");
                    }
                }
            }
            assert!(covered > 2000, "{covered}");
        }
    }
}
