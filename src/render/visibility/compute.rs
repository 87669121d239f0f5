//! The compute backend of visibility: dispatches of one compute pass write the visible surface of each sample, the same on every
//! device.
//! Must not know: how surfaces are shaded.

use wgpu::BufferUsages;

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::render::backend::LightingMode;
use crate::render::device::bind_groups::{
    BindLayouts, RasterGroups, bind_group, storage_buffer, storage_texture,
};
use crate::render::device::shader_programs::VISIBILITY_COMPUTE;
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::gbuffer::{GBuffer, NEAREST_BYTES, VISIBILITY_FORMAT};
use crate::render::select::draw_list::DrawBatch;
use crate::render::visibility::meshes::Meshes;
use crate::render::visibility::triangle_groups::{
    TriangleGroups, TrianglePass, compile_passes, group_layout,
};

/// Columns and rows of samples that a workgroup writes; `visibility_compute.wgsl` has the same constant.
pub(in crate::render) const WORKGROUP_SIDE: u32 = 8;

/// The pass.
#[derive(Debug)]
pub(crate) struct ComputeVisibility {
    /// How the samples are lit.
    pub(crate) lighting: LightingMode,
    pipelines: Option<Pipelines>,
    pub(in crate::render) groups: TriangleGroups,
    /// What the dispatches know of each sample of a tile. One after the other, all frames share it.
    nearest: GrowingBuffer,
}

#[derive(Debug)]
struct Pipelines {
    layout: wgpu::BindGroupLayout,
    /// Which find the largest inverse depth, then the first triangle that has it.
    passes: [TrianglePass; 2],
    write: wgpu::ComputePipeline,
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let own = [storage_buffer(false), storage_texture(VISIBILITY_FORMAT)];
        let layout = group_layout(gpu, VISIBILITY_COMPUTE.name, &own);
        let (passes, write) = compile_passes(gpu, &VISIBILITY_COMPUTE, (layouts, &layout), "cs_write");
        Self { layout, passes, write }
    }
}

impl ComputeVisibility {
    /// A pass for samples that are lit like this, which has compiled nothing yet.
    pub(crate) const fn new(lighting: LightingMode) -> Self {
        Self {
            lighting,
            pipelines: None,
            groups: TriangleGroups::new("visibility/groups"),
            nearest: GrowingBuffer::new("visibility/nearest", BufferUsages::STORAGE),
        }
    }

    /// Compiles the pass, unless it is there, and uploads the triangles of a frame: of two at the same depth the first is visible.
    /// Returns the bytes that were uploaded.
    ///
    /// # Errors
    /// Those of [`TriangleGroups::write`].
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        (meshes, batches): (&Meshes, &[DrawBatch]),
    ) -> Result<u64> {
        self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
        let draws = batches.iter().map(|batch| (&batch.draws, batch.variant == LightingVariant::Sky));
        self.groups.write(gpu, meshes, draws)
    }

    /// Makes room for the samples of a tile.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, sample_size: [u32; 2]) {
        self.nearest.reserve(gpu, nearest_bytes(sample_size));
    }

    /// Records the pass.
    ///
    /// # Panics
    /// Before [`Self::prepare`] and [`Self::reserve`].
    pub(crate) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        groups: &RasterGroups,
        (gbuffer, timestamps): (&GBuffer, Option<wgpu::ComputePassTimestampWrites<'_>>),
    ) {
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        let out = wgpu::BindingResource::TextureView(&gbuffer.visibility.1);
        let bytes = nearest_bytes(gbuffer.sample_size);
        let own = [self.nearest.bind_first(bytes as usize), out];
        let own: Vec<_> = self.groups.bindings(meshes).into_iter().chain(own).collect();
        self.groups.clear_queues(encoder);
        encoder.clear_buffer(self.nearest.buffer(), 0, Some(bytes));
        let own = bind_group(gpu, VISIBILITY_COMPUTE.name, &pipelines.layout, &own);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("visibility"),
            timestamp_writes: timestamps,
        });
        pass.set_bind_group(0, &groups.frame, &[]);
        pass.set_bind_group(1, &groups.instances, &[]);
        pass.set_bind_group(2, &own, &[]);
        let [_, rows] = gbuffer.sample_size;
        for triangle_pass in &pipelines.passes {
            self.groups.dispatch(&mut pass, triangle_pass, rows);
        }
        pass.set_pipeline(&pipelines.write);
        let [columns, rows] = gbuffer.sample_size.map(|side| side.div_ceil(WORKGROUP_SIDE));
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

/// Bytes that the dispatches keep of this many columns and rows of samples.
fn nearest_bytes(sample_size: [u32; 2]) -> u64 {
    sample_size.map(u64::from).iter().product::<u64>() * NEAREST_BYTES
}
