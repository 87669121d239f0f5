//! The scene pass: ground, rocks, sky. Every draw writes every plane: colour and class cannot disagree.

use super::gpu_scene::GpuScene;
use super::shaders::{Program, SKY, SURFACE};
use super::targets::{Plane, Targets, depth_state};
use super::{BindLayouts, vertex_layout};
use crate::frame::Annotations;
use crate::gpu::Gpu;

/// Pipelines of the pass.
#[derive(Debug)]
pub(super) struct ScenePass {
    modules: [wgpu::ShaderModule; 2],
    layouts: [wgpu::PipelineLayout; 2],
    /// Lit ground, surfaces and sky, for each set of annotations that was asked for so far.
    pipelines: Vec<(Annotations, [wgpu::RenderPipeline; 3])>,
}

impl ScenePass {
    /// Compiles the programs.
    #[must_use]
    pub(super) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = |program: &Program, groups: &[Option<&wgpu::BindGroupLayout>]| {
            gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(program.name),
                bind_group_layouts: groups,
                immediate_size: 0,
            })
        };
        let common = [Some(&layouts.frame), Some(&layouts.scene)];
        Self {
            modules: [SURFACE.compile(gpu), SKY.compile(gpu)],
            layouts: [
                layout(&SURFACE, &[common[0], common[1], Some(&layouts.shadow)]),
                layout(&SKY, &common),
            ],
            pipelines: Vec::new(),
        }
    }

    /// Makes the pipelines that draw these annotations, unless they are there.
    pub(super) fn prepare(&mut self, gpu: &Gpu, annotations: Annotations) {
        if self.pipelines.iter().any(|(made, _)| *made == annotations) {
            return;
        }
        let positions_and_normals = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let positions = wgpu::vertex_attr_array![0 => Float32x3];
        // The dome is seen from inside, the stars from outside.
        let pipelines = [
            self.pipeline(
                gpu,
                0,
                &[("OPEN", 1.0)],
                annotations,
                &positions_and_normals,
                Some(wgpu::Face::Back),
            ),
            self.pipeline(
                gpu,
                0,
                &[("OPEN", 0.0)],
                annotations,
                &positions_and_normals,
                Some(wgpu::Face::Back),
            ),
            self.pipeline(gpu, 1, &[], annotations, &positions, None),
        ];
        self.pipelines.push((annotations, pipelines));
    }

    fn pipeline(
        &self,
        gpu: &Gpu,
        program: usize,
        constants: &[(&str, f64)],
        annotations: Annotations,
        attributes: &[wgpu::VertexAttribute],
        cull_mode: Option<wgpu::Face>,
    ) -> wgpu::RenderPipeline {
        let module = &self.modules[program];
        let targets = Plane::ALL.map(|plane| {
            plane.is_drawn(annotations).then(|| wgpu::ColorTargetState {
                format: plane.format(),
                blend: None,
                write_mask: wgpu::ColorWrites::ALL,
            })
        });
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some([SURFACE.name, SKY.name][program]),
            layout: Some(&self.layouts[program]),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vs_main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[Some(vertex_layout(attributes))],
            },
            primitive: wgpu::PrimitiveState { cull_mode, ..Default::default() },
            depth_stencil: Some(depth_state()),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some("fs_main"),
                compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
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
                plane.is_drawn(targets.annotations).then(|| wgpu::RenderPassColorAttachment {
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
        let made = self.pipelines.iter().find(|(made, _)| *made == targets.annotations);
        let [lit, surface, sky] = &made.expect("pipelines are prepared before they are used").1;
        pass.set_pipeline(lit);
        super::draw_all(&mut pass, scene, scene.thing_indices(), &scene.draws.lit);
        pass.set_pipeline(surface);
        super::draw_all(&mut pass, scene, scene.thing_indices(), &scene.draws.surfaces);
        pass.set_pipeline(sky);
        super::draw_all(&mut pass, scene, &scene.indices, &scene.draws.sky);
    }
}
