//! Lighting in a compute pass, of all samples at once: each by what its instance says. A dispatch writes the planes to storage textures, or as
//! many as the device can store to, and others the rest; radiance and class are always written together.
//! Must not know: who filled the G-buffer.

use wgpu::ShaderStages;

use crate::gpu::Gpu;
use crate::render::device::bind_groups::{BindLayouts, bind_group, bind_group_layout, storage_texture};
use crate::render::device::light_table::Transport;
use crate::render::device::planes::{PlaneSet, storage};
use crate::render::device::shader_programs::{LIGHTING_COMPUTE, TextOptions};
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::frame_key::{FrameKey, constants};
use crate::render::lighting::gbuffer::GBuffer;

/// Columns and rows of samples that a workgroup lights; `lighting_compute.wgsl` has the same constant.
pub(in crate::render) const WORKGROUP_SIDE: u32 = 8;

/// What a dispatch is compiled for: what the pipelines of a frame have in common, and the planes that it writes.
type DispatchKey = (FrameKey, PlaneSet);

/// Pipelines of the dispatches, all that were needed so far.
#[derive(Debug, Default)]
pub(crate) struct ComputeLighting {
    dispatches: Vec<(DispatchKey, Dispatch)>,
}

#[derive(Debug)]
struct Dispatch {
    pipeline: wgpu::ComputePipeline,
    /// Layout of group 3: the textures that it writes.
    written: wgpu::BindGroupLayout,
}

/// What the dispatches of a frame are compiled for.
fn keys(gpu: &Gpu, key: FrameKey) -> impl Iterator<Item = DispatchKey> {
    let sets = storage::dispatches(key.annotations, &gpu.device.limits());
    sets.into_iter().map(move |planes| (key, planes))
}

impl ComputeLighting {
    /// Whether there are pipelines for a frame.
    pub(crate) fn has(&self, key: FrameKey) -> bool {
        self.dispatches.iter().any(|((found, _), _)| *found == key)
    }

    /// Compiles the pipelines of a frame that are missing.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, layouts: &BindLayouts, key: FrameKey) {
        for key in keys(gpu, key) {
            if self.dispatches.iter().all(|(found, _)| *found != key) {
                self.dispatches.push((key, Dispatch::new(gpu, layouts, key)));
            }
        }
    }

    /// Records the pass.
    ///
    /// # Panics
    /// If [`Self::prepare`] has not compiled the pipelines of the frame.
    pub(crate) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        [frame, instances, light]: [&wgpu::BindGroup; 3],
        (key, gbuffer): (FrameKey, &GBuffer),
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("lighting"),
            timestamp_writes: timestamps,
        });
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, instances, &[0, 0]);
        pass.set_bind_group(2, light, &[]);
        let [columns, rows] = gbuffer.sample_size.map(|side| side.div_ceil(WORKGROUP_SIDE));
        for key in keys(gpu, key) {
            let found = self.dispatches.iter().find(|(found, _)| *found == key);
            let (_, dispatch) = found.expect("pipelines are prepared before they are used");
            let (_, planes) = key;
            let views = planes.rows().map(|row| &gbuffer.planes[row.plane as usize]);
            let written: Vec<_> = views.map(wgpu::BindingResource::TextureView).collect();
            pass.set_pipeline(&dispatch.pipeline);
            pass.set_bind_group(3, &bind_group(gpu, "lighting", &dispatch.written, &written), &[]);
            pass.dispatch_workgroups(columns, rows, 1);
        }
    }
}

impl Dispatch {
    fn new(gpu: &Gpu, layouts: &BindLayouts, (key, planes): DispatchKey) -> Self {
        let written = (0..).zip(planes.rows().map(|row| storage_texture(storage::format(row))));
        let written = bind_group_layout(gpu, "lighting/written", ShaderStages::COMPUTE, written);
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("lighting/compute/layout"),
            bind_group_layouts: &[
                Some(&layouts.frame),
                Some(&layouts.scene),
                Some(&layouts.light),
                Some(&written),
            ],
            immediate_size: 0,
        });
        let options = TextOptions { transport: Transport::Uniforms, planes };
        let constants = constants(key, LightingVariant::Any);
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(LIGHTING_COMPUTE.name),
            layout: Some(&layout),
            module: &LIGHTING_COMPUTE.parse(options).specialise(gpu, &["cs_main"], &constants),
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: gpu.pipeline_cache(),
        });
        Self { pipeline, written }
    }
}
