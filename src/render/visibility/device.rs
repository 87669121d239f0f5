//! The device backend of visibility: one render pass writes the visible surface of each sample, and one more than its shading bin
//! to the stencil if there is one.

use wgpu::TextureFormat;

use crate::gpu::Gpu;
use crate::render::backend::LightingMode;
use crate::render::device::bind_groups::{BindLayouts, RasterGroups};
use crate::render::device::depth::{DEPTH_FORMAT, DEPTH_STENCIL_FORMAT, depth_state};
use crate::render::device::shader_programs::{TextOptions, VISIBILITY};
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::gbuffer::{GBuffer, VISIBILITY_FORMAT};
use crate::render::visibility::meshes::{Meshes, vertex_layout};

/// Of depth and stencil alike. Nothing reads the depth afterwards, but where one aspect is stored and the other discarded, wgpu
/// inserts a pass that clears the discarded one.
const STORE: wgpu::StoreOp = wgpu::StoreOp::Store;

/// The pass.
#[derive(Debug)]
pub(crate) struct VisibilityPass {
    /// How the samples are lit, which the stencil depends on.
    pub(crate) lighting: LightingMode,
    pipelines: Option<Pipelines>,
}

#[derive(Debug)]
struct Pipelines {
    /// Of ground and rocks, with back-face culling.
    surfaces: wgpu::RenderPipeline,
    /// Of the sky, whose dome is seen from inside. Its samples are known by the stencil; without one, by their slot.
    sky: wgpu::RenderPipeline,
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts, depth_stencil_format: TextureFormat) -> Self {
        let program = VISIBILITY.parse(TextOptions::default());
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(VISIBILITY.name),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene)],
            immediate_size: 0,
        });
        let pipeline = |entry_point, cull_mode, write_mask| {
            let module = program.specialise(gpu, &["vs_main", entry_point], &[]);
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(VISIBILITY.name),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vs_main"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(vertex_layout(2))],
                },
                primitive: wgpu::PrimitiveState { cull_mode, ..Default::default() },
                depth_stencil: Some(depth_state(depth_stencil_format)),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(wgpu::ColorTargetState { write_mask, ..VISIBILITY_FORMAT.into() })],
                }),
                multiview_mask: None,
                cache: gpu.pipeline_cache(),
            })
        };
        let has_stencil = depth_stencil_format.has_stencil_aspect();
        let sky_writes = if has_stencil { wgpu::ColorWrites::empty() } else { wgpu::ColorWrites::ALL };
        Self {
            surfaces: pipeline("fs_main", Some(wgpu::Face::Back), wgpu::ColorWrites::ALL),
            sky: pipeline("fs_sky", None, sky_writes),
        }
    }
}

impl VisibilityPass {
    /// A pass for samples that are lit like this, which has compiled nothing yet.
    pub(crate) const fn new(lighting: LightingMode) -> Self {
        Self { lighting, pipelines: None }
    }

    /// Format of depth, with a stencil beside it where lighting is divided into shading bins.
    pub(crate) const fn depth_stencil_format(&self) -> TextureFormat {
        if self.lighting.is_by_instance() { DEPTH_FORMAT } else { DEPTH_STENCIL_FORMAT }
    }

    /// Compiles the pass, unless it is there.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, layouts: &BindLayouts) {
        let format = self.depth_stencil_format();
        self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts, format));
    }

    /// Records the pass.
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        groups: &RasterGroups,
        gbuffer: &GBuffer,
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let has_stencil = self.depth_stencil_format().has_stencil_aspect();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("visibility"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &gbuffer.visibility.1,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &gbuffer.depth_stencil.1,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: STORE }),
                stencil_ops: has_stencil
                    .then_some(wgpu::Operations { load: wgpu::LoadOp::Clear(0), store: STORE }),
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        gbuffer.set_viewport(&mut pass);
        pass.set_bind_group(0, &groups.frame, &[]);
        pass.set_bind_group(1, &groups.scene, &[0, 0]);
        for batch in &gbuffer.batches {
            let is_sky = batch.variant == LightingVariant::Sky;
            pass.set_pipeline(if is_sky { &pipelines.sky } else { &pipelines.surfaces });
            pass.set_stencil_reference(u32::from(batch.bin) + 1);
            meshes.record(&mut pass, &batch.draws);
        }
    }
}
