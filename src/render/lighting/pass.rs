//! The lighting pass: deferred shading of the G-buffer. One draw for each shading bin writes every plane, so that colour and class
//! cannot disagree.
//! Must not know: who filled the G-buffer.

use rayon::prelude::*;
use wgpu::TextureFormat;

use crate::frame::Annotations;
use crate::gpu::Gpu;
use crate::render::device::bind_groups::{BindLayouts, slot_stride};
use crate::render::device::planes::SAMPLE_PLANES;
use crate::render::device::shader_programs::{LIGHTING_SKY, LIGHTING_SURFACE};
use crate::render::device::shader_structs::{Instance, ReliefUniforms};
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::gbuffer::GBuffer;
use crate::scene::Scene;
use crate::scene::photometry::Law;
use crate::scene::terrain::Layout;

/// Pipelines of the pass.
#[derive(Debug)]
pub(crate) struct LightingPass {
    surface: wgpu::ShaderModule,
    sky: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    /// All that were needed so far.
    pipelines: Vec<((PipelineKey, LightingVariant), wgpu::RenderPipeline)>,
}

/// What all pipelines of a frame have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PipelineKey {
    /// Annotations that are rendered.
    annotations: Annotations,
    /// Law of reflection.
    law: Law,
    /// The ground's mesh is made of rings.
    has_rings: bool,
    /// Ground and rocks have detail below their meshes.
    has_detail: bool,
    /// The G-buffer has the slopes of that detail.
    has_slopes: bool,
    /// Format of the stencil that selects samples.
    stencil_format: TextureFormat,
}

impl PipelineKey {
    /// For a scene in this G-buffer.
    pub(crate) fn new(scene: &Scene, gbuffer: &GBuffer) -> Self {
        Self {
            annotations: gbuffer.annotations,
            law: scene.photometry.law,
            has_rings: matches!(scene.terrain.layout, Layout::Rings(_)),
            has_detail: scene.relief.is_some(),
            has_slopes: gbuffer.layout.has_slopes,
            stencil_format: gbuffer.layout.stencil_format,
        }
    }
}

/// Values of `DETAIL_MODE` in `lighting_surface.wgsl`.
const DETAIL_NONE: f64 = 0.0;
const DETAIL_RELIEF: f64 = 1.0;
const DETAIL_ROCK_TEXTURE: f64 = 2.0;
const DETAIL_UPLOADED_SLOPES: f64 = 3.0;

impl LightingPass {
    /// Compiles the shader modules.
    #[must_use]
    pub(crate) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("lighting/layout"),
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

    /// Whether there is any pipeline with this key.
    #[must_use]
    pub(crate) fn has(&self, key: PipelineKey) -> bool {
        self.pipelines.iter().any(|((found, _), _)| *found == key)
    }

    /// Compiles the pipelines of these variants that are missing.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        key: PipelineKey,
        variants: impl IntoIterator<Item = LightingVariant>,
    ) {
        let mut missing: Vec<(PipelineKey, LightingVariant)> = Vec::new();
        for needed in variants.into_iter().map(|variant| (key, variant)) {
            if !missing.contains(&needed) && !self.pipelines.iter().any(|(found, _)| *found == needed) {
                missing.push(needed);
            }
        }
        let compiled = missing.par_iter().map(|&(key, variant)| self.compile(gpu, key, variant));
        let compiled: Vec<_> = compiled.collect();
        self.pipelines.extend(missing.into_iter().zip(compiled));
    }

    fn compile(&self, gpu: &Gpu, key: PipelineKey, variant: LightingVariant) -> wgpu::RenderPipeline {
        let surface = |sources, detail, per_sample_instance: bool| {
            vec![
                ("SHADOW_SOURCES", f64::from(sources as u32)),
                ("RINGS", f64::from(u8::from(key.has_rings))),
                ("PHOTOMETRY_LAW", f64::from(key.law as u32)),
                ("DETAIL_MODE", if key.has_detail { detail } else { DETAIL_NONE }),
                ("PER_SAMPLE_INSTANCE", f64::from(u8::from(per_sample_instance))),
            ]
        };
        let (label, module, constants) = match variant {
            LightingVariant::Ground { sources } => {
                let detail = if key.has_slopes { DETAIL_UPLOADED_SLOPES } else { DETAIL_RELIEF };
                (LIGHTING_SURFACE.name, &self.surface, surface(sources, detail, false))
            }
            LightingVariant::Rocks { sources } => {
                (LIGHTING_SURFACE.name, &self.surface, surface(sources, DETAIL_ROCK_TEXTURE, true))
            }
            LightingVariant::Sky => (LIGHTING_SKY.name, &self.sky, Vec::new()),
        };
        let targets = SAMPLE_PLANES.map(|row| {
            row.plane.is_needed(key.annotations).then_some(wgpu::ColorTargetState {
                format: row.format,
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
                format: key.stencil_format,
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
    ///
    /// # Panics
    /// If [`Self::prepare`] has not compiled the pipelines of the G-buffer's batches.
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        groups: [&wgpu::BindGroup; 3],
        key: PipelineKey,
        gbuffer: &GBuffer,
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let background =
            gbuffer.background.as_ref().map(|background| (background.radiance, background.class));
        let attachments: Vec<_> = SAMPLE_PLANES
            .iter()
            .zip(&gbuffer.planes)
            .map(|(row, view)| {
                row.plane.is_needed(gbuffer.annotations).then(|| wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(row.plane.clear_value(background)),
                        store: wgpu::StoreOp::Store,
                    },
                })
            })
            .collect();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("lighting"),
            color_attachments: &attachments,
            // Read only: the stencil selects the samples of a batch.
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &gbuffer.stencil.1,
                depth_ops: None,
                stencil_ops: None,
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        let [frame, instances, light] = groups;
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, light, &[]);
        for batch in &gbuffer.batches {
            let pipeline = self.pipelines.iter().find(|(found, _)| *found == (key, batch.variant));
            pass.set_pipeline(&pipeline.expect("pipelines are prepared before they are used").1);
            pass.set_stencil_reference(u32::from(batch.bin) + 1);
            let slots =
                [batch.instance * slot_stride::<Instance>(), batch.relief * slot_stride::<ReliefUniforms>()];
            pass.set_bind_group(1, instances, &slots);
            let [x, y, width, height] = batch.bounds.scissor_rect(gbuffer.sample_size);
            pass.set_scissor_rect(x, y, width, height);
            pass.draw(0..3, 0..1);
        }
    }
}
