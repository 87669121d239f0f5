//! Meshes on a device that draws them itself: vertices, indices, and the draws of a picture.
//!
//! Vertices stay while a scene does, and those of rocks come to them when they are first drawn; indices stay while the ground's grid
//! does; draws are made anew for each frame.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Weak};

use bytemuck::{Pod, Zeroable};
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;
use wgpu::{BufferUsages, IndexFormat};

use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::gpu::staging::{PAGE_BYTES, Page};
use crate::render::raster::lanes::{VERTEX_BATCH, to_soa};
use crate::render::select::draw_list::{MeshDraw, MeshRef};
use crate::render::select::ground_blocks::ground_blocks;
use crate::render::select::selection::Selection;
use crate::reuse::Reused;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::noise::floor;
use crate::scene::sky::DOME_LEVEL;
use crate::scene::terrain::{Layout, Terrain};

/// Columns of cells whose triangles are listed row by row, before those beside them: few enough for a device to find the vertices of a
/// row among the last 16 that it has transformed when it comes to the next.
const STRIP_CELLS: u32 = 6;
/// Vertices in a page, and pages that a thread packs at a time.
const PER_PAGE: usize = PAGE_BYTES / size_of::<PackedVertex>();
const PAGES_AT_A_TIME: usize = 16;

/// One indexed draw, as a device reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Draw {
    /// Indices.
    pub index_count: u32,
    /// Instances, one after the other.
    pub instance_count: u32,
    /// Place of the first index.
    pub first_index: u32,
    /// What is added to each index.
    pub base_vertex: i32,
    /// Slot of the first instance.
    pub first_instance: u32,
}

impl Draw {
    /// Triangles of all its instances.
    #[must_use]
    pub fn triangles(&self) -> u64 {
        u64::from(self.index_count / 3) * u64::from(self.instance_count)
    }
}

/// A vertex as a device has it. Positions are those of the scene to the bit: where they lie decides what a sample shows.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
struct PackedVertex {
    /// Metres.
    position: [f32; 3],
    /// The normal on an octahedron, in shares of [`HALF`].
    normal: [i16; 2],
}

/// What 1 is packed as.
const HALF: f32 = 32_767.0;

/// Bytes from a vertex to the next.
const VERTEX_BYTES: u64 = size_of::<PackedVertex>() as u64;
/// Position and normal.
const VERTEX_ATTRIBUTES: [wgpu::VertexAttribute; 2] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Snorm16x2];

/// Layout of the vertex buffer for a shader that reads the first `attributes` of position and normal.
pub(crate) fn vertex_layout(attributes: usize) -> wgpu::VertexBufferLayout<'static> {
    wgpu::VertexBufferLayout {
        array_stride: VERTEX_BYTES,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &VERTEX_ATTRIBUTES[..attributes],
    }
}

/// The meshes of a scene, and what to draw of them.
#[derive(Debug)]
pub struct Meshes {
    /// Vertices of the unit sphere, the ground, rocks, and how many.
    vertices: GrowingBuffer,
    vertex_count: usize,
    /// Triangles of the icosphere's levels, then of the ground's blocks.
    indices: GrowingBuffer,
    index_format: IndexFormat,
    /// The draws of the frame, as in its draw list.
    draws: Vec<Draw>,
    /// The same, for indirect drawing.
    indirect: Option<GrowingBuffer>,
    /// Index ranges of the icosphere's levels, and of the ground's blocks with the first vertex of each.
    levels: Vec<Range<u32>>,
    blocks: Vec<(Range<u32>, i32)>,
    /// Columns and rows of the ground that these are for, and whether they are rings.
    cells: [u32; 3],
    /// Keeps the ground's address from being given to another, but not the ground. So with the rocks.
    terrain: Weak<Terrain>,
    ground: i32,
    /// Of each rock of the scene, its mesh and the first vertex of it; no mesh where it was not given yet.
    rocks: Vec<(Weak<Reused<Vertex>>, i32)>,
}

impl Default for Meshes {
    fn default() -> Self {
        Self {
            vertices: GrowingBuffer::new("scene/vertices", BufferUsages::VERTEX),
            vertex_count: 0,
            indices: GrowingBuffer::new("scene/indices", BufferUsages::INDEX),
            index_format: IndexFormat::Uint16,
            draws: Vec::new(),
            indirect: None,
            levels: Vec::new(),
            blocks: Vec::new(),
            cells: [0; 3],
            terrain: Weak::new(),
            ground: 0,
            rocks: Vec::new(),
        }
    }
}

impl Meshes {
    /// Has the device hold the meshes of a picture of a scene, and says how many bytes it was given for that.
    pub(crate) fn upload(&mut self, gpu: &Gpu, scene: &Scene, selection: &Selection) -> u64 {
        self.upload_indices(gpu, &scene.terrain) + self.upload_vertices(gpu, scene, selection)
    }

    /// Sets what is to be drawn, and returns how many bytes were uploaded for that. With `multi_draw`, the device reads the draws
    /// from a buffer.
    pub(crate) fn set_draws(&mut self, gpu: &Gpu, draws: &[MeshDraw], multi_draw: bool) -> u64 {
        self.draws = draws.iter().map(|draw| self.indexed_draw(draw)).collect();
        if !multi_draw {
            self.indirect = None;
            return 0;
        }
        let indirect =
            self.indirect.get_or_insert_with(|| GrowingBuffer::new("scene/draws", BufferUsages::INDIRECT));
        indirect.write(gpu, &self.draws)
    }

    fn indexed_draw(&self, draw: &MeshDraw) -> Draw {
        let (indices, base_vertex) = match draw.mesh {
            MeshRef::Rock { rock, level } => (&self.levels[level], self.rocks[rock].1),
            MeshRef::Block(block) => {
                let (indices, first_vertex) = &self.blocks[block];
                (indices, self.ground + first_vertex)
            }
            MeshRef::UnitSphere(level) => (&self.levels[level], 0),
        };
        Draw {
            index_count: indices.len() as u32,
            instance_count: draw.slots.len() as u32,
            first_index: indices.start,
            base_vertex,
            first_instance: draw.slots.start,
        }
    }

    /// Triangles of some of the draws.
    pub(crate) fn triangles(&self, draws: &Range<usize>) -> u64 {
        self.draws[draws.clone()].iter().map(Draw::triangles).sum()
    }

    /// Records some of them.
    pub(crate) fn record(&self, pass: &mut wgpu::RenderPass<'_>, draws: &Range<usize>) {
        if draws.is_empty() {
            return;
        }
        pass.set_vertex_buffer(0, self.vertices.buffer().slice(..));
        pass.set_index_buffer(self.indices.buffer().slice(..), self.index_format);
        if let Some(indirect) = &self.indirect {
            let first = (draws.start * size_of::<Draw>()) as u64;
            pass.multi_draw_indexed_indirect(indirect.buffer(), first, draws.len() as u32);
            return;
        }
        for draw in &self.draws[draws.clone()] {
            let slots = draw.first_instance..draw.first_instance + draw.instance_count;
            let indices = draw.first_index..draw.first_index + draw.index_count;
            pass.draw_indexed(indices, draw.base_vertex, slots);
        }
    }

    /// The index buffer depends on the ground's grid alone. Blocks of as many columns and rows share their triangles, which count
    /// vertices from the first of the block.
    fn upload_indices(&mut self, gpu: &Gpu, terrain: &Terrain) -> u64 {
        let is_rings = matches!(terrain.layout, Layout::Rings(_));
        let cells = [terrain.columns, terrain.rows, u32::from(is_rings)];
        if self.cells == cells {
            return 0;
        }
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut range = |more: &mut dyn Iterator<Item = [u32; 3]>| {
            let start = 3 * triangles.len() as u32;
            triangles.extend(more);
            start..3 * triangles.len() as u32
        };
        self.levels = (0..=Icosphere::MAX_LEVEL).map(|level| range(&mut sphere_triangles(level))).collect();
        let mut known: HashMap<[u32; 3], Range<u32>> = HashMap::new();
        let blocks = ground_blocks(terrain).map(|[columns, rows]| {
            let first = rows.start * (terrain.columns + 1) + columns.start;
            let fans = is_rings && rows.start == 0;
            let shape = [columns.len() as u32, rows.len() as u32, u32::from(fans)];
            let indices = known.entry(shape).or_insert_with(|| {
                let of_block = block_triangles(terrain, &columns, &rows);
                range(&mut of_block.map(|triangle| triangle.map(|vertex| vertex - first)))
            });
            (indices.clone(), first as i32)
        });
        self.blocks = blocks.collect();
        self.cells = cells;
        let indices = triangles.as_flattened();
        let narrow: Option<Vec<u16>> = indices.iter().map(|&index| u16::try_from(index).ok()).collect();
        self.index_format = if narrow.is_some() { IndexFormat::Uint16 } else { IndexFormat::Uint32 };
        match narrow {
            Some(mut narrow) => {
                // Copies go by four bytes.
                narrow.resize(narrow.len().next_multiple_of(2), 0);
                self.indices.write(gpu, &narrow)
            }
            None => self.indices.write(gpu, indices),
        }
    }

    /// The vertices of sphere, ground and the rocks of a picture, unless the device has them.
    fn upload_vertices(&mut self, gpu: &Gpu, scene: &Scene, selection: &Selection) -> u64 {
        let sphere: Vec<Vertex>;
        let mut more: Vec<(usize, &[Vertex])> = Vec::new();
        let begin = if self.terrain.as_ptr() == Arc::as_ptr(&scene.terrain) { self.vertex_count } else { 0 };
        let mut end = begin;
        let mut add = |vertices| {
            let first = end;
            more.push((first - begin, vertices));
            end += vertices.len();
            first as i32
        };
        if begin == 0 {
            let directions = &Icosphere::shared().directions[..Icosphere::vertex_count(DOME_LEVEL)];
            sphere = directions.iter().map(|&d| Vertex { position: d, normal: d }).collect();
            add(&sphere);
            self.ground = add(&scene.terrain.vertices);
            self.terrain = Arc::downgrade(&scene.terrain);
            self.rocks.clear();
        }
        self.rocks.resize(scene.rocks.len(), (Weak::new(), 0));
        for selected in &selection.rocks {
            let (known, mesh) = (&mut self.rocks[selected.rock], &scene.rocks[selected.rock].vertices);
            if known.0.as_ptr() != Arc::as_ptr(mesh) {
                *known = (Arc::downgrade(mesh), add(mesh));
            }
        }
        if more.is_empty() {
            return 0;
        }
        self.vertex_count = end;
        let bytes = ((end - begin) * size_of::<PackedVertex>()).next_multiple_of(PAGE_BYTES);
        let write = |room: wgpu::WriteOnly<'_, [u8]>| {
            let pages: Vec<Page<'_>> = room.into_chunks().0.into_iter().collect();
            pages.into_par_iter().enumerate().with_min_len(PAGES_AT_A_TIME).for_each(|(place, page)| {
                let mut page: wgpu::WriteOnly<'_, [u8]> = page.into();
                page.copy_from_slice(bytemuck::cast_slice(&packed_page(&more, place * PER_PAGE)));
            });
        };
        if begin == 0 {
            self.vertices.write_with(gpu, bytes, write);
        } else if !self.vertices.try_write_at(gpu, begin * size_of::<PackedVertex>(), bytes, write) {
            self.terrain = Weak::new();
            return self.upload_vertices(gpu, scene, selection);
        }
        bytes as u64
    }
}

/// The triangles of a level of the icosphere, so that one follows another beside it: of the four that one was split into, again and
/// again, the middle one is third.
fn sphere_triangles(level: usize) -> impl Iterator<Item = [u32; 3]> {
    let triangles = &Icosphere::shared().triangles[level];
    let within_a_face = (1 << (2 * level)) - 1;
    // Two bits a split, in which 2 and 3 change places.
    (0..triangles.len()).map(move |place| triangles[place ^ ((place >> 1) & 0x5555 & within_a_face)])
}

/// The triangles of a block of the ground, in strips.
fn block_triangles(
    terrain: &Terrain,
    columns: &Range<u32>,
    rows: &Range<u32>,
) -> impl Iterator<Item = [u32; 3]> {
    columns.clone().step_by(STRIP_CELLS as usize).flat_map(|first| {
        terrain.block_triangles(first..(first + STRIP_CELLS).min(columns.end), rows.clone())
    })
}

/// A page of the vertices of some meshes that stand one behind the other, each from a vertex of all of them on; from vertex `first`
/// on.
fn packed_page(meshes: &[(usize, &[Vertex])], first: usize) -> [PackedVertex; PER_PAGE] {
    let mut page = [PackedVertex::default(); PER_PAGE];
    let mut rest = &mut page[..];
    let begun = meshes.partition_point(|(start, _)| *start <= first);
    for (start, mesh) in &meshes[begun.saturating_sub(1)..] {
        let here = mesh.get(first.saturating_sub(*start)..).unwrap_or_default();
        let (packed, after) = rest.split_at_mut(here.len().min(rest.len()));
        dispatch!(Level::new(), _simd => pack(here, packed));
        rest = after;
        if rest.is_empty() {
            break;
        }
    }
    page
}

// Inlined wholly, to be compiled for each width of vectors.
#[inline(always)]
fn pack(vertices: &[Vertex], packed: &mut [PackedVertex]) {
    for (vertices, packed) in vertices.chunks(VERTEX_BATCH).zip(packed.chunks_mut(VERTEX_BATCH)) {
        let [x, y, z] = to_soa(vertices.iter().map(|vertex| vertex.normal));
        // Twin: `octahedral_encode` in `common/octahedral.wgsl`.
        let (mut across, mut up) = ([0_i32; VERTEX_BATCH], [0_i32; VERTEX_BATCH]);
        for i in 0..VERTEX_BATCH {
            let sum = x[i].abs() + y[i].abs() + z[i].abs();
            let scale = HALF / if sum > 1e-30 { sum } else { 1e-30 };
            let (right, ahead) = (scale * x[i], scale * y[i]);
            let is_below = z[i] < 0.0;
            let folded_right = (HALF - ahead.abs()).copysign(right);
            let folded_ahead = (HALF - right.abs()).copysign(ahead);
            across[i] = floor(0.5 + if is_below { folded_right } else { right });
            up[i] = floor(0.5 + if is_below { folded_ahead } else { ahead });
        }
        for (i, (vertex, packed)) in vertices.iter().zip(packed).enumerate() {
            *packed =
                PackedVertex { position: vertex.position.into(), normal: [across[i] as i16, up[i] as i16] };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::sampler::Config;
    use glam::{Vec2, Vec3};

    fn ground(stage: &str) -> Terrain {
        let mut config = Config::new();
        config.apply_set(&format!("stage.name={stage}")).expect("a stage");
        let scene = Scene::build(3, &config.draw(3).expect("drawn")).expect("built");
        Arc::unwrap_or_clone(scene.terrain)
    }

    #[test]
    fn strips_of_blocks_are_all_of_the_ground() {
        for stage in ["nominal", "surface"] {
            let terrain = ground(stage);
            let mut of_blocks: Vec<[u32; 3]> = ground_blocks(&terrain)
                .flat_map(|[columns, rows]| block_triangles(&terrain, &columns, &rows).collect::<Vec<_>>())
                .collect();
            let mut all: Vec<[u32; 3]> = terrain.triangles().collect();
            of_blocks.sort_unstable();
            all.sort_unstable();
            assert!(of_blocks == all, "{stage}");
        }
    }

    /// Vertices that are transformed for each triangle, by a device that keeps the last `kept` of them.
    fn transformed_per_triangle(triangles: &[[u32; 3]], kept: usize) -> f64 {
        let (mut cache, mut transformed) = (std::collections::VecDeque::new(), 0);
        for vertex in triangles.as_flattened() {
            if !cache.contains(vertex) {
                transformed += 1;
                cache.push_back(*vertex);
                if cache.len() > kept {
                    cache.pop_front();
                }
            }
        }
        f64::from(transformed) / triangles.len() as f64
    }

    #[test]
    fn few_vertices_are_transformed_twice() {
        let terrain = ground("nominal");
        let block: Vec<_> = block_triangles(&terrain, &(0..30), &(0..30)).collect();
        let sphere: Vec<_> = sphere_triangles(4).collect();
        // An endless grid has half as many vertices as triangles, and so has a sphere.
        for (triangles, kept, most) in
            [(&block, 16, 0.61), (&block, 32, 0.61), (&sphere, 16, 0.79), (&sphere, 32, 0.67)]
        {
            let transformed = transformed_per_triangle(triangles, kept);
            assert!((0.5..most).contains(&transformed), "{transformed} with {kept} kept");
        }
    }

    #[test]
    fn spheres_have_the_triangles_of_their_level() {
        for (level, expected) in Icosphere::shared().triangles.iter().enumerate() {
            let (mut here, mut expected): (Vec<_>, Vec<_>) =
                (sphere_triangles(level).collect(), expected.clone());
            here.sort_unstable();
            expected.sort_unstable();
            assert!(here == expected, "level {level}");
        }
    }

    #[test]
    fn packed_vertices_lie_where_they_did_and_their_normals_turn_by_less_than_a_ten_thousandth() {
        let normals = &Icosphere::shared().directions;
        let vertices: Vec<Vertex> =
            normals.iter().map(|&normal| Vertex { position: 3.7 * normal, normal }).collect();
        let (one, others) = vertices.split_at(1);
        // A mesh without vertices, and some that end within a page.
        let meshes = [(0, one), (1, &[]), (1, &others[..700]), (701, &others[700..])];
        for (first, expected) in vertices.chunks(PER_PAGE).enumerate() {
            let page = packed_page(&meshes, first * PER_PAGE);
            for (packed, vertex) in page.iter().zip(expected) {
                assert_eq!(Vec3::from(packed.position), vertex.position);
                let p = Vec2::from(packed.normal.map(|half| f32::from(half) / HALF));
                let z = 1.0 - p.x.abs() - p.y.abs();
                let back = (-z).max(0.0);
                let normal = Vec3::new(p.x - back.copysign(p.x), p.y - back.copysign(p.y), z).normalize();
                assert!(normal.distance(vertex.normal) < 1e-4, "{normal} for {}", vertex.normal);
            }
        }
    }
}
