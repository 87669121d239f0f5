//! The scene pass: ground, rocks, sky. Every draw writes every plane: colour and class cannot disagree.

use super::gpu_scene::GpuScene;
use super::shaders::{Program, SKY, SURFACE};
use super::targets::{Plane, Targets, depth_state};
use super::{BindLayouts, vertex_layout};
use crate::gpu::Gpu;

/// Pipelines of the pass.
#[derive(Debug)]
pub(super) struct ScenePass {
    surface: wgpu::RenderPipeline,
    sky: wgpu::RenderPipeline,
}

impl ScenePass {
    /// Compiles the pass.
    #[must_use]
    pub(super) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let positions_and_normals = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let positions = wgpu::vertex_attr_array![0 => Float32x3];
        Self {
            surface: pipeline(
                gpu,
                &SURFACE,
                layouts,
                Some(&layouts.shadow),
                &positions_and_normals,
                Some(wgpu::Face::Back),
            ),
            // The dome is seen from inside, the stars from outside.
            sky: pipeline(gpu, &SKY, layouts, None, &positions, None),
        }
    }

    /// Records the pass.
    pub(super) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        groups: [&wgpu::BindGroup; 3],
        targets: &Targets,
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let attachments: Vec<_> = Plane::ALL
            .iter()
            .zip(&targets.planes)
            .map(|(plane, view)| {
                Some(wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(plane.cleared()),
                        store: wgpu::StoreOp::Store,
                    },
                })
            })
            .collect();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene"),
            color_attachments: &attachments,
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &targets.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        for (index, group) in (0..).zip(groups) {
            pass.set_bind_group(index, group, &[]);
        }
        pass.set_pipeline(&self.surface);
        super::draw_all(&mut pass, scene, &scene.draws.surfaces);
        pass.set_pipeline(&self.sky);
        super::draw_all(&mut pass, scene, &scene.draws.sky);
    }
}

fn pipeline(
    gpu: &Gpu,
    program: &Program,
    layouts: &BindLayouts,
    own: Option<&wgpu::BindGroupLayout>,
    attributes: &[wgpu::VertexAttribute],
    cull_mode: Option<wgpu::Face>,
) -> wgpu::RenderPipeline {
    let module = program.compile(gpu);
    let mut groups = vec![Some(&layouts.frame), Some(&layouts.scene)];
    groups.extend(own.map(Some));
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(program.name),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    let targets = Plane::ALL.map(|plane| {
        Some(wgpu::ColorTargetState {
            format: plane.format(),
            blend: None,
            write_mask: wgpu::ColorWrites::ALL,
        })
    });
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(program.name),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(vertex_layout(attributes))],
        },
        primitive: wgpu::PrimitiveState { cull_mode, ..Default::default() },
        depth_stencil: Some(depth_state()),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}
