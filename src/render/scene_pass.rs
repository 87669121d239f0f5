//! The scene pass: ground, rocks, sky. Every draw writes every plane: colour and class cannot disagree.

use super::gpu_scene::{Draw, DrawList, GpuScene};
use super::relief::SIZES;
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
    /// For each variant that was needed so far.
    pipelines: Vec<(Variant, Pipelines)>,
}

/// What draws a frame.
#[derive(Debug)]
struct Pipelines {
    /// Ground by what can shade it, for each size of the relief below the mesh that was needed so far.
    ground: [Option<[wgpu::RenderPipeline; 3]>; SIZES.len()],
    /// Rocks that are turned from the sun, and the rest.
    rocks: [wgpu::RenderPipeline; 2],
    sky: wgpu::RenderPipeline,
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

    /// Makes the pipelines that draw a scene, unless they are there.
    pub(super) fn prepare(&mut self, gpu: &Gpu, variant: Variant, draws: &DrawList) {
        let known = self.pipelines.iter().position(|(made, _)| *made == variant);
        let place = known.unwrap_or_else(|| {
            let surface = |shades| self.surface(gpu, variant, shades, TEXTURE_DETAIL, 0);
            let pipelines = Pipelines {
                ground: [const { None }; SIZES.len()],
                rocks: [surface(Shades::Nothing), surface(Shades::Casters)],
                // The dome is seen from inside, the stars from outside.
                sky: self.pipeline(
                    gpu,
                    1,
                    &[],
                    variant.annotations,
                    &wgpu::vertex_attr_array![0 => Float32x3],
                    None,
                ),
            };
            self.pipelines.push((variant, pipelines));
            self.pipelines.len() - 1
        });
        for size in 0..SIZES.len() {
            let is_drawn = draws.ground.iter().any(|lists| !lists[size].is_empty());
            if is_drawn && self.pipelines[place].1.ground[size].is_none() {
                let surface = |shades| self.surface(gpu, variant, shades, RELIEF_DETAIL, size);
                let made = [Shades::Nothing, Shades::Ground, Shades::Casters].map(surface);
                self.pipelines[place].1.ground[size] = Some(made);
            }
        }
    }

    fn surface(
        &self,
        gpu: &Gpu,
        variant: Variant,
        shades: Shades,
        detail: f64,
        size: usize,
    ) -> wgpu::RenderPipeline {
        let detail = if variant.detail { detail } else { NO_DETAIL };
        let [waves, pits] = SIZES[size].map(|number| number as f64);
        let constants = [
            ("SHADES", f64::from(shades as u32)),
            ("LAW", f64::from(variant.law as u32)),
            ("DETAIL", detail),
            ("WAVES", waves),
            ("PITS", pits),
        ];
        let positions_and_normals = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let culled = Some(wgpu::Face::Back);
        self.pipeline(gpu, 0, &constants, variant.annotations, &positions_and_normals, culled)
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
        let mut draw = |pipeline: &wgpu::RenderPipeline, indices, list: &[Draw]| {
            pass.set_pipeline(pipeline);
            super::draw_all(&mut pass, instances, scene, indices, list);
        };
        // Rocks before the ground that they cover, all before the sky.
        for (pipeline, list) in pipelines.rocks.iter().zip(&draws.rocks).rev() {
            draw(pipeline, scene.thing_indices(), list);
        }
        for (shades, lists) in draws.ground.iter().enumerate().rev() {
            // Those with much relief are near.
            for (pipelines, list) in pipelines.ground.iter().zip(lists).rev() {
                if let Some(pipelines) = pipelines {
                    draw(&pipelines[shades], scene.thing_indices(), list);
                }
            }
        }
        draw(&pipelines.sky, &scene.indices, &draws.sky);
    }
}
