//! Meshes on the device, for the stages that it rasterises: vertices, indices, and the draws of a frame.
//!
//! Vertices stay for as long as their scene; those of rocks are appended as they are needed. Indices stay for as long as the
//! ground's grid. Draws are set for each frame.
//! Must not know: a stage.

use std::collections::HashMap;
use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use wgpu::{BufferUsages, IndexFormat};

use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::gpu::staging::Page;
use crate::render::select::draw_list::{MeshDraw, MeshRef};
use crate::render::select::ground_blocks::ground_blocks;
use crate::render::select::selection::Selection;
use crate::render::visibility::mesh_places::MeshPlaces;
use crate::render::visibility::packed_vertices::PackedVertex;
use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::terrain::{Layout, Terrain};

/// Columns of cells in a strip, whose triangles are indexed row by row: few enough for the vertices of a row to be among the last 16
/// in the vertex cache when the next row is drawn.
const STRIP_CELLS: u32 = 6;
/// Least number of pages that a thread packs.
const MIN_PAGES_PER_THREAD: usize = 16;

/// One indexed draw, in WebGPU's layout for indirect draws.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(crate) struct Draw {
    /// Number of indices.
    pub index_count: u32,
    /// Number of instances.
    pub instance_count: u32,
    /// Offset of the first index in the index buffer.
    pub first_index: u32,
    /// Added to each index.
    pub base_vertex: i32,
    /// Slot of the first instance.
    pub first_instance: u32,
}

impl Draw {
    /// Triangles of all its instances.
    #[must_use]
    pub(crate) fn triangles(&self) -> u64 {
        u64::from(self.index_count / 3) * u64::from(self.instance_count)
    }
}

/// Stride of the vertex buffer.
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

/// The meshes of a scene, and the draws of a frame.
#[derive(Debug)]
pub(crate) struct Meshes {
    /// Vertices of the unit sphere, the ground, then rocks.
    vertices: GrowingBuffer,
    /// Triangles of the icosphere's levels, then of the ground's blocks.
    indices: GrowingBuffer,
    index_format: IndexFormat,
    /// In the order of the frame's draw list.
    draws: Vec<Draw>,
    /// The same, for indirect drawing.
    indirect: Option<GrowingBuffer>,
    /// Index range of each level of the icosphere.
    levels: Vec<Range<u32>>,
    /// Index range of each block of the ground, and its first vertex, counted from that of the ground.
    blocks: Vec<(Range<u32>, i32)>,
    /// The grid that the indices are for: columns, rows, and 1 if it is made of rings.
    grid: [u32; 3],
    /// Where the vertices lie.
    places: MeshPlaces,
}

impl Default for Meshes {
    fn default() -> Self {
        Self {
            vertices: GrowingBuffer::new("scene/vertices", BufferUsages::VERTEX.union(BufferUsages::STORAGE)),
            indices: GrowingBuffer::new("scene/indices", BufferUsages::INDEX.union(BufferUsages::STORAGE)),
            index_format: IndexFormat::Uint16,
            draws: Vec::new(),
            indirect: None,
            levels: Vec::new(),
            blocks: Vec::new(),
            grid: [0; 3],
            places: MeshPlaces::default(),
        }
    }
}

impl Meshes {
    /// Uploads the meshes of a selection that the device does not have yet. Returns the bytes that were uploaded.
    pub(crate) fn upload(&mut self, gpu: &Gpu, scene: &Scene, selection: &Selection) -> u64 {
        let of_indices = self.upload_indices(gpu, &scene.terrain);
        if let Some(bytes) = self.upload_missing(gpu, scene, selection) {
            return of_indices + bytes as u64;
        }
        // The buffer is full: a larger one gets everything.
        self.places = MeshPlaces::default();
        of_indices + self.upload_missing(gpu, scene, selection).unwrap_or_default() as u64
    }

    /// Makes room for the meshes of a scene, which have these places and this size, and which a copy recorded later brings. Returns the
    /// bytes of the indices that were uploaded.
    pub(crate) fn expect_copy(&mut self, gpu: &Gpu, scene: &Scene, places: MeshPlaces, bytes: u64) -> u64 {
        self.vertices.reserve(gpu, bytes);
        self.places = places;
        self.upload_indices(gpu, &scene.terrain)
    }

    /// Whether the device has the ground of a scene.
    pub(crate) fn has_ground(&self, scene: &Scene) -> bool {
        self.places.has_ground(scene)
    }

    /// Uploads what is missing; `None` if it has no room behind what is there.
    fn upload_missing(&mut self, gpu: &Gpu, scene: &Scene, selection: &Selection) -> Option<usize> {
        let begin = if self.places.has_ground(scene) { self.places.len() } else { 0 };
        let missing = self.places.add(scene, selection);
        let bytes = missing.bytes();
        if bytes == 0 {
            return Some(0);
        }
        if begin == 0 {
            self.vertices.reserve(gpu, bytes as u64);
        }
        let write = |view: wgpu::WriteOnly<'_, [u8]>| {
            let pages: Vec<Page<'_>> = view.into_chunks().0.into_iter().collect();
            let pages = pages.into_par_iter().enumerate().with_min_len(MIN_PAGES_PER_THREAD);
            pages.for_each(|(index, page)| missing.write_page(index, page));
        };
        let at = begin * size_of::<PackedVertex>();
        self.vertices.try_write_at(gpu, at, bytes, write).then_some(bytes)
    }

    /// Sets the draws of the frame, whose meshes must be uploaded. With `multi_draw` they are uploaded too, for indirect drawing.
    /// Returns the bytes that were uploaded.
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
            MeshRef::Rock { rock, level } => (&self.levels[level], self.places.rock(rock)),
            MeshRef::Block(block) => {
                let (indices, first_vertex) = &self.blocks[block];
                (indices, self.places.ground() + first_vertex)
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

    /// Number of triangles in a range of the draws.
    pub(crate) fn triangles(&self, draws: &Range<usize>) -> u64 {
        self.draws(draws).iter().map(Draw::triangles).sum()
    }

    /// A range of the draws.
    pub(crate) fn draws(&self, draws: &Range<usize>) -> &[Draw] {
        &self.draws[draws.clone()]
    }

    /// The buffers of vertices and of indices.
    pub(crate) const fn buffers(&self) -> [&GrowingBuffer; 2] {
        [&self.vertices, &self.indices]
    }

    /// Whether an index has 16 bits, else 32.
    pub(crate) fn has_narrow_indices(&self) -> bool {
        self.index_format == IndexFormat::Uint16
    }

    /// Records a range of the draws.
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
        for draw in self.draws(draws) {
            let slots = draw.first_instance..draw.first_instance + draw.instance_count;
            let indices = draw.first_index..draw.first_index + draw.index_count;
            pass.draw_indexed(indices, draw.base_vertex, slots);
        }
    }

    /// Uploads the indices, which depend on the ground's grid alone. Blocks of equal size share theirs, which count from the first
    /// vertex of the block.
    fn upload_indices(&mut self, gpu: &Gpu, terrain: &Terrain) -> u64 {
        let is_rings = matches!(terrain.layout, Layout::Rings(_));
        let grid = [terrain.columns, terrain.rows, u32::from(is_rings)];
        if self.grid == grid {
            return 0;
        }
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut append = |mesh: &mut dyn Iterator<Item = [u32; 3]>| {
            let start = 3 * triangles.len() as u32;
            triangles.extend(mesh);
            start..3 * triangles.len() as u32
        };
        self.levels = (0..=Icosphere::MAX_LEVEL).map(|level| append(&mut sphere_triangles(level))).collect();
        let mut shared: HashMap<[u32; 3], Range<u32>> = HashMap::new();
        let blocks = ground_blocks(terrain).map(|[columns, rows]| {
            let first = rows.start * (terrain.columns + 1) + columns.start;
            let fans = is_rings && rows.start == 0;
            let shape = [columns.len() as u32, rows.len() as u32, u32::from(fans)];
            let indices = shared.entry(shape).or_insert_with(|| {
                let of_block = block_triangles(terrain, &columns, &rows);
                append(&mut of_block.map(|triangle| triangle.map(|vertex| vertex - first)))
            });
            (indices.clone(), first as i32)
        });
        self.blocks = blocks.collect();
        self.grid = grid;
        let indices = triangles.as_flattened();
        let narrow: Option<Vec<u16>> = indices.iter().map(|&index| u16::try_from(index).ok()).collect();
        self.index_format = if narrow.is_some() { IndexFormat::Uint16 } else { IndexFormat::Uint32 };
        match narrow {
            Some(mut narrow) => {
                // Sizes of copies are multiples of four bytes.
                narrow.resize(narrow.len().next_multiple_of(2), 0);
                self.indices.write(gpu, &narrow)
            }
            None => self.indices.write(gpu, indices),
        }
    }
}

/// The triangles of a level of the icosphere in an order in which neighbours follow each other, for the vertex cache: of the four
/// into which each subdivision splits a triangle, the middle one comes third.
fn sphere_triangles(level: usize) -> impl Iterator<Item = [u32; 3]> {
    let triangles = &Icosphere::shared().triangles[level];
    let within_a_face = (1 << (2 * level)) - 1;
    // Each subdivision has two bits of the index, in which 2 and 3 are exchanged.
    (0..triangles.len()).map(move |index| triangles[index ^ ((index >> 1) & 0x5555 & within_a_face)])
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::params::config::Config;

    fn ground(stage: &str) -> Terrain {
        let mut config = Config::new();
        config.apply_set(&format!("stage.name={stage}")).expect("a stage");
        let scene = Scene::build(3, &config.draw(3).expect("drawn")).expect("built");
        Arc::unwrap_or_clone(scene.terrain)
    }

    #[test]
    fn strips_of_all_blocks_are_the_triangles_of_the_ground() {
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

    /// Average cache miss ratio: vertices transformed per triangle, with a first-in, first-out vertex cache (Hoppe 1999).
    fn cache_miss_ratio(triangles: &[[u32; 3]], cache_size: usize) -> f64 {
        let (mut cache, mut transformed) = (std::collections::VecDeque::new(), 0);
        for vertex in triangles.as_flattened() {
            if !cache.contains(vertex) {
                transformed += 1;
                cache.push_back(*vertex);
                if cache.len() > cache_size {
                    cache.pop_front();
                }
            }
        }
        f64::from(transformed) / triangles.len() as f64
    }

    #[test]
    fn triangles_are_ordered_for_the_vertex_cache() {
        let terrain = ground("nominal");
        let block: Vec<_> = block_triangles(&terrain, &(0..30), &(0..30)).collect();
        let sphere: Vec<_> = sphere_triangles(4).collect();
        // The lower bound is 0.5: large grids and spheres have half as many vertices as triangles.
        for (triangles, cache_size, max) in
            [(&block, 16, 0.61), (&block, 32, 0.61), (&sphere, 16, 0.79), (&sphere, 32, 0.67)]
        {
            let ratio = cache_miss_ratio(triangles, cache_size);
            assert!((0.5..max).contains(&ratio), "{ratio} with a cache of {cache_size}");
        }
    }

    #[test]
    fn reordered_spheres_have_the_triangles_of_their_level() {
        for (level, expected) in Icosphere::shared().triangles.iter().enumerate() {
            let (mut reordered, mut expected): (Vec<_>, Vec<_>) =
                (sphere_triangles(level).collect(), expected.clone());
            reordered.sort_unstable();
            expected.sort_unstable();
            assert!(reordered == expected, "level {level}");
        }
    }
}
