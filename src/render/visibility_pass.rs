//! The visibility pass: which thing each sample shows, and by which draw of the scene pass it is lit.

use super::gpu_scene::{GpuScene, Lit};
use super::shaders::VISIBILITY;
use super::targets::{DEPTH_FORMAT, Targets, VISIBLE_FORMAT, depth_state};
use super::{BindLayouts, vertex_layout};
use crate::gpu::Gpu;

/// Pipelines of the pass.
#[derive(Debug)]
pub(super) struct VisibilityPass {
    /// Of things, which are seen from outside, and of the sky, whose dome is seen from inside; of it nothing is written but depth
    /// and stencil.
    things: wgpu::RenderPipeline,
    sky: wgpu::RenderPipeline,
}

impl VisibilityPass {
    /// Compiles the pass.
    #[must_use]
    pub(super) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let module = VISIBILITY.compile(gpu);
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(VISIBILITY.name),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene)],
            immediate_size: 0,
        });
        let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let pipeline = |entry_point, cull_mode, write_mask| {
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(VISIBILITY.name),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vs_main"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(vertex_layout(&attributes))],
                },
                primitive: wgpu::PrimitiveState { cull_mode, ..Default::default() },
                depth_stencil: Some(depth_state(DEPTH_FORMAT)),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(wgpu::ColorTargetState { write_mask, ..VISIBLE_FORMAT.into() })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        Self {
            things: pipeline("fs_main", Some(wgpu::Face::Back), wgpu::ColorWrites::ALL),
            sky: pipeline("fs_sky", None, wgpu::ColorWrites::empty()),
        }
    }

    /// Records the pass.
    pub(super) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        groups: [&wgpu::BindGroup; 2],
        targets: &Targets,
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("visibility"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &targets.visible,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &targets.depth_stencil,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0),
                    store: wgpu::StoreOp::Store,
                }),
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        let [frame, instances] = groups;
        pass.set_bind_group(0, frame, &[]);
        for (value, seen) in (1..).zip(&scene.draws.seen) {
            let (pipeline, indices) = if seen.lit == Lit::Sky {
                (&self.sky, scene.whole_indices())
            } else {
                (&self.things, scene.thing_indices())
            };
            pass.set_pipeline(pipeline);
            pass.set_stencil_reference(value);
            super::draw_all(&mut pass, instances, scene, indices, &seen.draws);
        }
    }
}
