//! The lighting pass: light on what the samples show. One draw for all samples that are lit alike writes every plane: colour
//! and class cannot disagree.

use rayon::prelude::*;

use crate::frame::Annotations;
use crate::gpu::Gpu;
use crate::render::device::bind_groups::BindLayouts;
use crate::render::device::shader_structs::{Instance, LIGHTING_SKY, LIGHTING_SURFACE, ReliefUniforms};
use crate::render::device::shading_bins::LightingVariant;
use crate::render::gpu_scene::{GpuScene, slot_stride};
use crate::render::lighting::gbuffer::{DEPTH_FORMAT, GBuffer, GIVEN_FORMAT, Plane};
use crate::scene::Scene;
use crate::scene::photometry::Law;
use crate::scene::terrain::Layout;

/// Pipelines of the pass.
#[derive(Debug)]
pub(in crate::render) struct LightingPass {
    surface: wgpu::ShaderModule,
    sky: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    /// For each way of lighting of each variant that was needed so far.
    pipelines: Vec<((Variant, LightingVariant), wgpu::RenderPipeline)>,
}

/// What pipelines are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::render) struct Variant {
    /// What is drawn.
    pub(in crate::render) annotations: Annotations,
    /// How it reflects.
    pub(in crate::render) law: Law,
    /// Whether the ground is made of rings.
    pub(in crate::render) rings: bool,
    /// Whether ground and rocks have detail below their meshes.
    pub(in crate::render) detail: bool,
    /// Whether the device was given what the samples show, and slopes of the ground below its mesh: their stencil has no depth
    /// beside it then.
    pub(in crate::render) is_given: bool,
}

impl Variant {
    /// For a scene on these gbuffer.
    pub(in crate::render) fn new(scene: &Scene, gbuffer: &GBuffer) -> Self {
        Self {
            annotations: gbuffer.annotations,
            law: scene.photometry.law,
            rings: matches!(scene.terrain.layout, Layout::Rings(_)),
            detail: scene.relief.is_some(),
            is_given: gbuffer.is_given,
        }
    }
}

/// The values of `DETAIL_MODE` in `lighting_surface.wgsl`.
const DETAIL_NONE: f64 = 0.0;
const DETAIL_RELIEF: f64 = 1.0;
const DETAIL_ROCK_TEXTURE: f64 = 2.0;
const DETAIL_UPLOADED_SLOPES: f64 = 3.0;

impl LightingPass {
    /// Compiles the programs.
    #[must_use]
    pub(in crate::render) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("scene"),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene), Some(&layouts.light)],
            immediate_size: 0,
        });
        Self {
            surface: LIGHTING_SURFACE.compile(gpu),
            sky: LIGHTING_SKY.compile(gpu),
            layout,
            pipelines: Vec::new(),
        }
    }

    /// Whether any pipeline was made for this.
    #[must_use]
    pub(in crate::render) fn has(&self, variant: Variant) -> bool {
        self.pipelines.iter().any(|((made, _), _)| *made == variant)
    }

    /// Makes the pipelines that light so, unless they are there.
    pub(in crate::render) fn prepare(
        &mut self,
        gpu: &Gpu,
        variant: Variant,
        wanted: impl IntoIterator<Item = LightingVariant>,
    ) {
        let mut missing: Vec<(Variant, LightingVariant)> = Vec::new();
        for wanted in wanted.into_iter().map(|lit| (variant, lit)) {
            if !missing.contains(&wanted) && !self.pipelines.iter().any(|(made, _)| *made == wanted) {
                missing.push(wanted);
            }
        }
        let made = missing.par_iter().map(|&(variant, lit)| self.pipeline(gpu, variant, lit));
        let made: Vec<_> = made.collect();
        self.pipelines.extend(missing.into_iter().zip(made));
    }

    fn pipeline(&self, gpu: &Gpu, variant: Variant, lit: LightingVariant) -> wgpu::RenderPipeline {
        let surface = |shades, detail, of_many: bool| {
            vec![
                ("SHADOW_SOURCES", f64::from(shades as u32)),
                ("RINGS", f64::from(u8::from(variant.rings))),
                ("PHOTOMETRY_LAW", f64::from(variant.law as u32)),
                ("DETAIL_MODE", if variant.detail { detail } else { DETAIL_NONE }),
                ("PER_SAMPLE_INSTANCE", f64::from(u8::from(of_many))),
            ]
        };
        let (label, module, constants) = match lit {
            LightingVariant::Ground { shades } => {
                let detail = if variant.is_given { DETAIL_UPLOADED_SLOPES } else { DETAIL_RELIEF };
                (LIGHTING_SURFACE.name, &self.surface, surface(shades, detail, false))
            }
            LightingVariant::Rocks { shades } => {
                (LIGHTING_SURFACE.name, &self.surface, surface(shades, DETAIL_ROCK_TEXTURE, true))
            }
            LightingVariant::Sky => (LIGHTING_SKY.name, &self.sky, Vec::new()),
        };
        let targets = Plane::ALL.map(|plane| {
            plane.is_drawn(variant.annotations).then(|| wgpu::ColorTargetState {
                format: plane.format(),
                blend: None,
                write_mask: wgpu::ColorWrites::ALL,
            })
        });
        let equal = wgpu::StencilFaceState { compare: wgpu::CompareFunction::Equal, ..Default::default() };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(label),
            layout: Some(&self.layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vs_main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: if variant.is_given { GIVEN_FORMAT } else { DEPTH_FORMAT },
                depth_write_enabled: Some(false),
                depth_compare: Some(wgpu::CompareFunction::Always),
                stencil: wgpu::StencilState { front: equal, back: equal, read_mask: !0, write_mask: 0 },
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some("fs_main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &constants,
                    ..Default::default()
                },
                targets: &targets,
            }),
            multiview_mask: None,
            cache: gpu.pipeline_cache(),
        })
    }

    /// Records the pass.
    pub(in crate::render) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        groups: [&wgpu::BindGroup; 3],
        variant: Variant,
        gbuffer: &GBuffer,
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let attachments: Vec<_> = Plane::ALL
            .iter()
            .zip(&gbuffer.planes)
            .map(|(plane, view)| {
                plane.is_drawn(gbuffer.annotations).then(|| wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(plane.cleared(scene.background.as_ref())),
                        store: wgpu::StoreOp::Store,
                    },
                })
            })
            .collect();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene"),
            color_attachments: &attachments,
            // It is only read.
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &gbuffer.depth_stencil.1,
                depth_ops: None,
                stencil_ops: None,
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        let [frame, instances, light] = groups;
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, light, &[]);
        for seen in &scene.draws.batches {
            let made = self.pipelines.iter().find(|(made, _)| *made == (variant, seen.lit));
            pass.set_pipeline(&made.expect("pipelines are prepared before they are used").1);
            pass.set_stencil_reference(u32::from(seen.group) + 1);
            let slots =
                [seen.instance * slot_stride::<Instance>(), seen.relief * slot_stride::<ReliefUniforms>()];
            pass.set_bind_group(1, instances, &slots);
            let [x, y, width, height] = seen.bounds.scissor_rect(gbuffer.sample_size);
            pass.set_scissor_rect(x, y, width, height);
            pass.draw(0..3, 0..1);
        }
    }
}
