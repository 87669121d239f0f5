//! The buffers and textures that hold a frame plan on the device. Upload only: nothing is decided here.
//! Must not know: how a plan is made.

use std::sync::{Arc, Weak};

use wgpu::{BufferUsages, TextureFormat};

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::gpu::growing_texture::GrowingTexture;
use crate::gpu::staging::StagingBuffers;
use crate::render::device::bind_groups::{
    BindLayouts, RasterGroups, bind_group, instances_group, slot_stride,
};
use crate::render::device::shader_structs::{FrameUniforms, Instance, ReliefUniforms};
use crate::render::frame_plan::FramePlan;
use crate::render::lighting::gbuffer::GBuffer;
use crate::render::select::lit_rocks::LitRocks;
use crate::render::shadow::horizon::HorizonMap;
use crate::render::staged_frame::{CopyTargets, StagedFrame};
use crate::render::visibility::meshes::Meshes;
use crate::scene::Scene;

/// Buffers of a scene, kept from frame to frame and grown where a frame needs more.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    /// Meshes, where the device rasterises anything.
    pub(crate) meshes: Meshes,
    /// `FrameUniforms`.
    frame: GrowingBuffer,
    /// `ReliefUniforms`, one to a slot.
    relief: GrowingBuffer,
    /// `Instance`s, one to a slot.
    instances: GrowingBuffer,
    /// `CasterTile`s.
    caster_tiles: GrowingBuffer,
    /// Cells of the caster grids, then those that sunlit rocks light.
    caster_grid: GrowingBuffer,
    /// Sunlit faces of rocks.
    lit_faces: GrowingTexture,
    /// The horizon map, two heights a texel.
    horizon: GrowingTexture,
    /// The map that the texture holds. A weak reference keeps its address from being used again, but not the map.
    horizon_source: Weak<HorizonMap>,
}

impl Default for SceneBuffers {
    fn default() -> Self {
        Self {
            meshes: Meshes::default(),
            frame: GrowingBuffer::new("frame/uniforms", BufferUsages::UNIFORM),
            relief: GrowingBuffer::new("scene/relief", BufferUsages::UNIFORM.union(BufferUsages::STORAGE)),
            instances: GrowingBuffer::new(
                "scene/instances",
                BufferUsages::UNIFORM.union(BufferUsages::STORAGE),
            ),
            caster_tiles: GrowingBuffer::new("shadow/tiles", BufferUsages::STORAGE),
            caster_grid: GrowingBuffer::new("shadow/caster_grid", BufferUsages::STORAGE),
            lit_faces: GrowingTexture::new("scene/lit_faces", TextureFormat::Rgba32Float),
            horizon: GrowingTexture::new("shadow/horizon", TextureFormat::Rg32Float),
            horizon_source: Weak::new(),
        }
    }
}

impl SceneBuffers {
    /// Writes a plan to the device and returns how many bytes that took. What is staged of it is copied once [`Self::record_copies`] is
    /// recorded.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(crate) fn upload(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        (plan, mut staged): (&FramePlan, Option<&mut StagedFrame>),
        (multi_draw, staging): (bool, &mut StagingBuffers),
    ) -> Result<u64> {
        let mut bytes = self.upload_uniforms(gpu, &plan.uniforms);
        bytes += write_slots(&mut self.relief, gpu, &plan.bands.bands);
        bytes += self.caster_tiles.write(gpu, &plan.caster_tiles);
        bytes += if let Some(staged) = &staged {
            let [of_instances, of_grid] = staged.instance_and_grid_bytes();
            self.instances.reserve(gpu, of_instances) + self.caster_grid.reserve(gpu, of_grid)
        } else {
            write_slots(&mut self.instances, gpu, &plan.instances)
                + self.caster_grid.write_both(gpu, &plan.caster_grid, &plan.lit_rocks.lists)
        };
        bytes += self.upload_lit_faces(gpu, &plan.lit_rocks, staging)?;
        if !plan.draws.draws.is_empty() {
            let is_new = !self.meshes.has_ground(scene);
            bytes += match staged.as_deref_mut().filter(|_| is_new).and_then(StagedFrame::copy_vertices) {
                Some((places, size)) => size + self.meshes.expect_copy(gpu, scene, places, size),
                None => self.meshes.upload(gpu, scene, &plan.selection),
            };
            bytes += self.meshes.set_draws(gpu, &plan.draws.draws, multi_draw);
        }
        bytes += self.upload_horizon(gpu, &plan.horizon, (staged.as_deref_mut(), staging))?;
        if let Some(staged) = staged {
            staged.unmap();
        }
        Ok(bytes)
    }

    /// Records the copies of what is staged of a frame.
    pub(crate) fn record_copies(&self, encoder: &mut wgpu::CommandEncoder, staged: Option<&StagedFrame>) {
        if let Some(staged) = staged {
            let [vertices, _] = self.meshes.buffers();
            let (instances, grid) = (self.instances.buffer(), self.caster_grid.buffer());
            let to =
                CopyTargets { vertices: vertices.buffer(), horizon: self.horizon.texture(), instances, grid };
            staged.record(encoder, &to);
        }
    }

    /// Writes the uniforms of the frame, or of a tile, and returns how many bytes that took.
    pub(crate) fn upload_uniforms(&mut self, gpu: &Gpu, uniforms: &FrameUniforms) -> u64 {
        self.frame.write(gpu, &[*uniforms])
    }

    fn upload_horizon(
        &mut self,
        gpu: &Gpu,
        map: &Arc<HorizonMap>,
        (staged, staging): (Option<&mut StagedFrame>, &mut StagingBuffers),
    ) -> Result<u64> {
        let size = [map.width, map.height()];
        if self.horizon.holds(size) && self.horizon_source.as_ptr() == Arc::as_ptr(map) {
            return Ok(0);
        }
        self.horizon_source = Arc::downgrade(map);
        if let Some(staged) = staged {
            self.horizon.reserve(gpu, size);
            staged.copy_horizon();
            return Ok(size_of_val(&map.heights_m[..]) as u64);
        }
        self.horizon.write(gpu, staging, size, &map.heights_m)
    }

    /// Where there are none, as under laws other than Hapke's, the shaders have a texture of one texel, which they do not read.
    fn upload_lit_faces(
        &mut self,
        gpu: &Gpu,
        lit_rocks: &LitRocks,
        staging: &mut StagingBuffers,
    ) -> Result<u64> {
        let size @ [_, rows] = lit_rocks.texture_size();
        if rows == 0 {
            self.lit_faces.reserve(gpu, [1, 1]);
            return Ok(0);
        }
        self.lit_faces.write(gpu, staging, size, lit_rocks.texels())
    }

    /// Bind groups 0 and 1.
    pub(crate) fn raster_groups(&self, gpu: &Gpu, layouts: &BindLayouts) -> RasterGroups {
        let instances = self.instances.buffer();
        let scene = [
            self.instances.bind_first(size_of::<Instance>()),
            self.caster_tiles.buffer().as_entire_binding(),
            self.relief.bind_first(size_of::<ReliefUniforms>()),
            instances.as_entire_binding(),
            self.relief.buffer().as_entire_binding(),
        ];
        RasterGroups {
            frame: bind_group(gpu, "frame", &layouts.frame, &[self.frame.buffer().as_entire_binding()]),
            scene: bind_group(gpu, "scene", &layouts.scene, &scene),
            instances: instances_group(gpu, layouts, instances),
        }
    }

    /// Bind group 2 of the lighting pass.
    pub(crate) fn light_group(
        &self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        gbuffer: &GBuffer,
        shadow_map: &wgpu::TextureView,
        nearest: wgpu::BindingResource<'_>,
    ) -> wgpu::BindGroup {
        let view = wgpu::BindingResource::TextureView;
        let resources = [
            view(&gbuffer.visibility.1),
            view(shadow_map),
            view(self.horizon.view()),
            self.caster_grid.buffer().as_entire_binding(),
            nearest,
            view(gbuffer.slopes_view()),
            view(self.lit_faces.view()),
        ];
        bind_group(gpu, "light", &layouts.light, &resources)
    }
}

/// Writes uniforms, each to its slot; returns how many bytes that took.
fn write_slots<T: bytemuck::NoUninit>(buffer: &mut GrowingBuffer, gpu: &Gpu, uniforms: &[T]) -> u64 {
    let stride = slot_stride::<T>() as usize;
    buffer.write_with(gpu, stride * uniforms.len(), |mut slots| {
        for uniforms in uniforms {
            let slot = slots.split_off(..stride);
            slot.expect("one for each").slice(..size_of::<T>()).copy_from_slice(bytemuck::bytes_of(uniforms));
        }
    })
}
