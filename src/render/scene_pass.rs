//! The scene pass: ground, rocks, sky. Every draw writes every plane: colour and class cannot disagree.

use super::gpu_scene::GpuScene;
use super::shaders::{Program, SKY, SURFACE};
use super::shadow::Shades;
use super::targets::{Plane, Targets, depth_state};
use super::{BindLayouts, vertex_layout};
use crate::frame::Annotations;
use crate::gpu::Gpu;
use crate::scene::photometry::Law;

/// Pipelines of the pass.
#[derive(Debug)]
pub(super) struct ScenePass {
    modules: [wgpu::ShaderModule; 2],
    layouts: [wgpu::PipelineLayout; 2],
    /// Ground by what can shade it, rocks and sky, for each variant that was needed so far.
    pipelines: Vec<(Variant, [wgpu::RenderPipeline; 6])>,
}

/// What pipelines are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Variant {
    /// What is drawn.
    pub(super) annotations: Annotations,
    /// How it reflects.
    pub(super) law: Law,
    /// Whether ground and rocks have detail below their meshes.
    pub(super) detail: bool,
}

/// The values of `DETAIL` in `surface.wgsl`.
const NO_DETAIL: f64 = 0.0;
const RELIEF_DETAIL: f64 = 1.0;
const TEXTURE_DETAIL: f64 = 2.0;

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

    /// Makes the pipelines of a variant, unless they are there.
    pub(super) fn prepare(&mut self, gpu: &Gpu, variant: Variant) {
        if self.pipelines.iter().any(|(made, _)| *made == variant) {
            return;
        }
        let positions_and_normals = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let positions = wgpu::vertex_attr_array![0 => Float32x3];
        let law = f64::from(variant.law as u32);
        let surface = |shades: Shades, detail: f64| {
            let detail = if variant.detail { detail } else { NO_DETAIL };
            let constants = [("SHADES", f64::from(shades as u32)), ("LAW", law), ("DETAIL", detail)];
            self.pipeline(
                gpu,
                0,
                &constants,
                variant.annotations,
                &positions_and_normals,
                Some(wgpu::Face::Back),
            )
        };
        let pipelines = [
            surface(Shades::Nothing, RELIEF_DETAIL),
            surface(Shades::Ground, RELIEF_DETAIL),
            surface(Shades::Casters, RELIEF_DETAIL),
            surface(Shades::Nothing, TEXTURE_DETAIL),
            surface(Shades::Casters, TEXTURE_DETAIL),
            // The dome is seen from inside, the stars from outside.
            self.pipeline(gpu, 1, &[], variant.annotations, &positions, None),
        ];
        self.pipelines.push((variant, pipelines));
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
        let [frame, instances, shadow] = groups;
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, shadow, &[]);
        let made = self.pipelines.iter().find(|(made, _)| *made == scene.variant(targets.annotations));
        let pipelines = &made.expect("pipelines are prepared before they are used").1;
        let draws = &scene.draws;
        let things = scene.thing_indices();
        let [open, by_ground, by_rocks] = &draws.ground;
        let [dark, lit] = &draws.rocks;
        let lists = [
            (open, things),
            (by_ground, things),
            (by_rocks, things),
            (dark, things),
            (lit, things),
            (&draws.sky, &scene.indices),
        ];
        // Rocks before the ground that they cover, all before the sky.
        for place in [4, 3, 2, 1, 0, 5] {
            let (list, indices) = lists[place];
            pass.set_pipeline(&pipelines[place]);
            super::draw_all(&mut pass, instances, scene, indices, list);
        }
    }
}
