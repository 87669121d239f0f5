//! The lighting pass: deferred shading of the G-buffer. One draw for each shading bin, or one for all, writes every plane, so that
//! colour and class cannot disagree. Where a device cannot write all planes at once, some are written by further passes; colour
//! and class never.
//! Must not know: who filled the G-buffer.

use rayon::prelude::*;

use crate::gpu::Gpu;
use crate::render::backend::LightingMode;
use crate::render::device::bind_groups::{BindLayouts, slot_stride};
use crate::render::device::light_table::Transport;
use crate::render::device::planes::{PlaneSet, lighting_passes};
use crate::render::device::shader_programs::{
    LIGHTING_ONE_DRAW, LIGHTING_SKY, LIGHTING_SURFACE, ParsedProgram, Program, TextOptions,
};
use crate::render::device::shader_structs::{Instance, ReliefUniforms};
use crate::render::device::shading_bins::LightingVariant;
use crate::render::device::timing::{Pass, Timer};
use crate::render::lighting::compute::ComputeLighting;
use crate::render::lighting::frame_key::{FrameKey, constants};
use crate::render::lighting::gbuffer::GBuffer;

/// Pipelines of the pass.
#[derive(Debug)]
pub(crate) struct LightingPass {
    /// How light numbers reach the fragment stage.
    pub(crate) transport: Transport,
    limits: wgpu::Limits,
    layout: wgpu::PipelineLayout,
    /// All programs that were needed so far.
    programs: Vec<(ProgramKey, ParsedProgram)>,
    /// All pipelines that were needed so far.
    pipelines: Vec<(PipelineKey, wgpu::RenderPipeline)>,
    /// Those of the compute pass.
    compute: ComputeLighting,
}

/// A program for a pass that writes these planes, by the program's name.
type ProgramKey = (&'static str, PlaneSet);

/// A pipeline: what a frame's have in common, what it shades, and the planes that it writes.
type PipelineKey = (FrameKey, LightingVariant, PlaneSet);

/// The program of a variant.
const fn program(variant: LightingVariant) -> &'static Program {
    match variant {
        LightingVariant::Ground { .. } | LightingVariant::Rocks { .. } => &LIGHTING_SURFACE,
        LightingVariant::Sky => &LIGHTING_SKY,
        LightingVariant::Any => &LIGHTING_ONE_DRAW,
    }
}

impl LightingPass {
    /// A pass that has compiled nothing yet.
    #[must_use]
    pub(crate) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("lighting/layout"),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene), Some(&layouts.light)],
            immediate_size: 0,
        });
        let (transport, limits) = (Transport::of(gpu), gpu.device.limits());
        let compute = ComputeLighting::default();
        Self { transport, limits, layout, programs: Vec::new(), pipelines: Vec::new(), compute }
    }

    /// Whether there is any pipeline with this key.
    #[must_use]
    pub(crate) fn has(&self, key: FrameKey, mode: LightingMode) -> bool {
        match mode {
            LightingMode::Compute => self.compute.has(key),
            LightingMode::Bins | LightingMode::OneDraw => {
                self.pipelines.iter().any(|((found, ..), _)| *found == key)
            }
        }
    }

    /// Compiles the pipelines that do not depend on what a frame shows, where they are missing. Those of shading bins only if there are
    /// none at all: they can light every frame.
    pub(crate) fn prepare_general(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        key: FrameKey,
        mode: LightingMode,
    ) {
        match mode {
            LightingMode::Bins if self.has(key, mode) => {}
            LightingMode::Bins => self.prepare(gpu, key, LightingVariant::GENERAL),
            LightingMode::OneDraw => self.prepare(gpu, key, [LightingVariant::Any]),
            LightingMode::Compute => self.compute.prepare(gpu, layouts, key),
        }
    }

    /// The planes that each pass of a frame writes.
    fn passes(&self, key: FrameKey) -> Vec<PlaneSet> {
        lighting_passes(key.annotations, &self.limits)
    }

    /// Compiles the pipelines of these variants that are missing.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        key: FrameKey,
        variants: impl IntoIterator<Item = LightingVariant>,
    ) {
        let passes = self.passes(key);
        let mut missing: Vec<PipelineKey> = Vec::new();
        for variant in variants {
            for needed in passes.iter().map(|planes| (key, variant, *planes)) {
                if !missing.contains(&needed) && !self.pipelines.iter().any(|(found, _)| *found == needed) {
                    missing.push(needed);
                }
            }
        }
        for (_, variant, planes) in &missing {
            let program = program(*variant);
            if self.program(program, *planes).is_none() {
                let options = TextOptions { transport: self.transport, planes: *planes };
                self.programs.push(((program.name, *planes), program.parse(options)));
            }
        }
        let compiled = missing.par_iter().map(|&key| self.compile(gpu, key));
        let compiled: Vec<_> = compiled.collect();
        self.pipelines.extend(missing.into_iter().zip(compiled));
    }

    fn program(&self, program: &Program, planes: PlaneSet) -> Option<&ParsedProgram> {
        let found = self.programs.iter().find(|(found, _)| *found == (program.name, planes));
        found.map(|(_, program)| program)
    }

    fn compile(&self, gpu: &Gpu, (key, variant, planes): PipelineKey) -> wgpu::RenderPipeline {
        let parsed = self.program(program(variant), planes).expect("programs are parsed before pipelines");
        let module = &parsed.specialise(gpu, &["vs_main", "fs_main"], &constants(key, variant));
        let targets: Vec<_> = planes
            .rows()
            .map(|row| {
                row.plane.is_needed(key.annotations).then_some(wgpu::ColorTargetState {
                    format: row.format,
                    blend: None,
                    write_mask: wgpu::ColorWrites::ALL,
                })
            })
            .collect();
        let equal = wgpu::StencilFaceState { compare: wgpu::CompareFunction::Equal, ..Default::default() };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(program(variant).name),
            layout: Some(&self.layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vs_main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: key.stencil_format.map(|format| wgpu::DepthStencilState {
                format,
                depth_write_enabled: Some(false),
                depth_compare: Some(wgpu::CompareFunction::Always),
                stencil: wgpu::StencilState { front: equal, back: equal, read_mask: !0, write_mask: 0 },
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some("fs_main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
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
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        groups: [&wgpu::BindGroup; 3],
        (key, gbuffer): (FrameKey, &GBuffer),
        timer: Option<&Timer>,
    ) {
        if key.is_computed {
            let timestamps = timer.map(|timer| timer.compute_pass(Pass::Lighting));
            self.compute.record(gpu, encoder, groups, (key, gbuffer), timestamps);
            return;
        }
        let timestamps = timer.map(|timer| timer.render_pass(Pass::Lighting));
        let passes = self.passes(key);
        let last = passes.len() - 1;
        for (number, planes) in passes.into_iter().enumerate() {
            // Each of several passes has the timestamp that it begins or ends with, if any.
            let timestamps = timestamps.clone().map(|all| wgpu::RenderPassTimestampWrites {
                beginning_of_pass_write_index: all.beginning_of_pass_write_index.filter(|_| number == 0),
                end_of_pass_write_index: all.end_of_pass_write_index.filter(|_| number == last),
                ..all
            });
            let is_timed = number == 0 || number == last;
            let mut pass = begin_pass(encoder, key, planes, gbuffer, timestamps.filter(|_| is_timed));
            let [frame, instances, light] = groups;
            gbuffer.set_viewport(&mut pass);
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(2, light, &[]);
            let pipeline = |variant| {
                let found = self.pipelines.iter().find(|(found, _)| *found == (key, variant, planes));
                &found.expect("pipelines are prepared before they are used").1
            };
            if key.stencil_format.is_none() {
                pass.set_pipeline(pipeline(LightingVariant::Any));
                pass.set_bind_group(1, instances, &[0, 0]);
                pass.draw(0..3, 0..1);
                continue;
            }
            for batch in &gbuffer.batches {
                pass.set_pipeline(pipeline(batch.variant));
                pass.set_stencil_reference(u32::from(batch.bin) + 1);
                let slots = [
                    batch.instance * slot_stride::<Instance>(),
                    batch.relief * slot_stride::<ReliefUniforms>(),
                ];
                pass.set_bind_group(1, instances, &slots);
                let [x, y, width, height] = batch.bounds.scissor_rect(gbuffer.sample_size);
                pass.set_scissor_rect(x, y, width, height);
                pass.draw(0..3, 0..1);
            }
        }
    }
}

/// Begins a pass that writes these planes.
fn begin_pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    key: FrameKey,
    planes: PlaneSet,
    gbuffer: &GBuffer,
    timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
) -> wgpu::RenderPass<'a> {
    let attachments: Vec<_> = planes
        .rows()
        .map(|row| {
            row.plane.is_needed(key.annotations).then(|| wgpu::RenderPassColorAttachment {
                view: &gbuffer.planes[row.plane as usize],
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(row.plane.clear_value()),
                    store: wgpu::StoreOp::Store,
                },
            })
        })
        .collect();
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("lighting"),
        color_attachments: &attachments,
        // Read only: the stencil selects the samples of a batch.
        depth_stencil_attachment: key.stencil_format.map(|_| wgpu::RenderPassDepthStencilAttachment {
            view: &gbuffer.depth_stencil.1,
            depth_ops: None,
            stencil_ops: None,
        }),
        timestamp_writes: timestamps,
        ..Default::default()
    })
}
