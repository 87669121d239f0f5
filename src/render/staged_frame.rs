//! What the device copies for a frame from memory that a worker has written: meshes, horizon map, caster grid and instances,
//! nearly all of an upload.
//! Must not know: how a plan is made.

use std::ops::Range;

use crate::gpu::staging::{PAGE_BYTES, PageWriter, ROW_ALIGNMENT, TextureRegion, copy_to_texture};
use crate::gpu::upload::{MappedBuffer, UploadPool};
use crate::render::device::bind_groups::slot_stride;
use crate::render::device::shader_structs::Instance;
use crate::render::frame_plan::FramePlan;
use crate::render::shadow::horizon::HorizonMap;
use crate::render::visibility::mesh_places::MeshPlaces;
use crate::render::visibility::packed_vertices::MeshList;
use crate::scene::Scene;

/// What of a frame is written to where the device copies it from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Staging {
    /// All that the device needs: it has nothing of the scene.
    Whole,
    /// The same without meshes: the device has those of earlier frames of the scene, or will upload them.
    WithoutMeshes,
}

impl Staging {
    /// For a scene whose frames the device has drawn, once its camera has moved: of the rover that has come along the device has no meshes.
    pub(crate) fn for_moved_camera(scene: &Scene) -> Self {
        if scene.has_rover() { Self::Whole } else { Self::WithoutMeshes }
    }
}

/// A buffer with all vertices of a frame and, behind them, its horizon map, its instances, and its caster grid with the cells that rocks
/// light.
#[derive(Debug)]
pub(crate) struct StagedFrame {
    buffer: MappedBuffer,
    /// Where the vertices lie, until they are taken; `None` if it has none.
    places: Option<MeshPlaces>,
    vertex_bytes: usize,
    /// Whether the device lacks the vertices.
    vertices_are_missing: bool,
    horizon: TextureRegion,
    instances: Range<usize>,
    grid: Range<usize>,
    /// Whether the device lacks the horizon map.
    horizon_is_missing: bool,
}

impl StagedFrame {
    /// Writes what the device needs of a plan whose tiles are placed; `None` if the device has failed.
    pub(crate) fn new(pool: &UploadPool, scene: &Scene, plan: &FramePlan, staging: Staging) -> Option<Self> {
        let mut places = (staging == Staging::Whole).then(MeshPlaces::default);
        let of_places = places.as_mut().map(|places| places.add(scene, &plan.selection));
        let meshes: MeshList<'_> = of_places.unwrap_or_default();
        let map = &*plan.horizon;
        let horizon = TextureRegion {
            offset_bytes: meshes.bytes(),
            row_bytes: (map.width as usize * HorizonMap::TEXEL_BYTES).next_multiple_of(ROW_ALIGNMENT),
            origin: [0; 2],
            size: [map.width, map.height()],
        };
        let lists: [&[u8]; 2] = [&plan.caster_grid[..], &plan.lit_rocks.lists].map(bytemuck::cast_slice);
        let slot_bytes = slot_stride::<Instance>() as usize;
        let horizon_end = horizon.offset_bytes + horizon.row_bytes * horizon.size[1] as usize;
        let instances = following(horizon_end, slot_bytes * plan.instances.len());
        let grid = following(instances.end, lists[0].len() + lists[1].len());
        let mut buffer = pool.take(grid.end)?;
        buffer.write(|pages| {
            let of_meshes = pages.take(meshes.bytes() / PAGE_BYTES);
            of_meshes.enumerate().for_each(|(index, page)| meshes.write_page(index, page));
            let mut rows = PageWriter::new(pages.collect());
            for row in map.heights_m.chunks_exact(map.width as usize) {
                rows.write_row(bytemuck::cast_slice(row), horizon.row_bytes);
            }
            for instance in &plan.instances {
                rows.write_row(bytemuck::bytes_of(instance), slot_bytes);
            }
            for list in lists {
                rows.write_row(list, list.len());
            }
        })?;
        Some(Self {
            buffer,
            vertex_bytes: meshes.bytes(),
            places,
            vertices_are_missing: false,
            horizon,
            instances,
            grid,
            horizon_is_missing: false,
        })
    }

    /// Size of its instances, and of its caster grid with what follows that, bytes.
    pub(crate) fn instance_and_grid_bytes(&self) -> [u64; 2] {
        [&self.instances, &self.grid].map(|range| range.len() as u64)
    }

    /// Asks for a copy of its vertices; returns where they lie, and their bytes. `None` if it has none.
    pub(crate) fn copy_vertices(&mut self) -> Option<(MeshPlaces, u64)> {
        let places = self.places.take()?;
        self.vertices_are_missing = true;
        Some((places, self.vertex_bytes as u64))
    }

    /// Asks for a copy of its horizon map.
    pub(crate) const fn copy_horizon(&mut self) {
        self.horizon_is_missing = true;
    }

    /// Gives it to the device; no copy can be asked for after that.
    pub(crate) fn unmap(&mut self) {
        self.buffer.unmap();
    }

    /// Records the copies that were asked for, and those of instances and grid.
    pub(crate) fn record(&self, encoder: &mut wgpu::CommandEncoder, to: &CopyTargets<'_>) {
        let buffer = self.buffer.buffer();
        let mut copy = |from: &Range<usize>, to| {
            encoder.copy_buffer_to_buffer(buffer, from.start as u64, to, 0, from.len() as u64);
        };
        copy(&self.instances, to.instances);
        copy(&self.grid, to.grid);
        if self.vertices_are_missing {
            copy(&(0..self.vertex_bytes), to.vertices);
        }
        if self.horizon_is_missing {
            copy_to_texture(encoder, buffer, to.horizon, &self.horizon);
        }
    }
}

/// Where a staged frame is copied to.
#[derive(Debug)]
pub(crate) struct CopyTargets<'a> {
    pub(crate) vertices: &'a wgpu::Buffer,
    pub(crate) horizon: &'a wgpu::Texture,
    pub(crate) instances: &'a wgpu::Buffer,
    pub(crate) grid: &'a wgpu::Buffer,
}

/// A range of this many bytes from `start` on.
const fn following(start: usize, bytes: usize) -> Range<usize> {
    start..start + bytes
}
