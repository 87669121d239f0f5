//! The shadow-map pass: depth only, fronts of all casters in one layer of the atlas, backs in the other.

use wgpu::TextureUsages;

use super::gpu_scene::GpuScene;
use super::shaders::SHADOW;
use super::targets::{ATLAS_FORMAT, depth_state};
use super::{BindLayouts, vertex_layout};
use crate::gpu::Gpu;

/// Pipelines and atlas of the pass.
#[derive(Debug)]
pub(super) struct ShadowPass {
    layers: [wgpu::RenderPipeline; 2],
    /// The atlas, with its columns and the rows of a layer, of which it has two, fronts above backs.
    atlas: Option<([u32; 2], wgpu::TextureView)>,
}

impl ShadowPass {
    /// Compiles the pass.
    #[must_use]
    pub(super) fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let module = SHADOW.compile(gpu);
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("shadow/layout"),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene)],
            immediate_size: 0,
        });
        let layer = |label, layer: f64, cull| {
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(label),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vs_main"),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &[("LAYER", layer)],
                        ..Default::default()
                    },
                    buffers: &[Some(vertex_layout(&wgpu::vertex_attr_array![0 => Float32x3]))],
                },
                primitive: wgpu::PrimitiveState { cull_mode: Some(cull), ..Default::default() },
                depth_stencil: Some(depth_state(ATLAS_FORMAT)),
                multisample: wgpu::MultisampleState::default(),
                fragment: None,
                multiview_mask: None,
                cache: None,
            })
        };
        let layers =
            [layer("shadow/fronts", 0.0, wgpu::Face::Back), layer("shadow/backs", 1.0, wgpu::Face::Front)];
        Self { layers, atlas: None }
    }

    /// Makes the atlas with layers of exactly so many columns and rows, unless it is there. Not a larger one: places in the atlas
    /// would be rounded otherwise, and the frame would depend on those before it.
    pub(super) fn prepare(&mut self, gpu: &Gpu, layer_px: [u32; 2]) {
        if self.atlas.as_ref().is_none_or(|(made, _)| *made != layer_px) {
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
            let size = [layer_px[0], 2 * layer_px[1]];
            self.atlas = Some((layer_px, gpu.texture("shadow/atlas", size, ATLAS_FORMAT, usage).1));
        }
    }

    /// The atlas.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(super) fn atlas(&self) -> &wgpu::TextureView {
        &self.atlas.as_ref().expect("an atlas is prepared before it is used").1
    }

    /// Records the pass.
    pub(super) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        groups: [&wgpu::BindGroup; 2],
        timestamps: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: self.atlas(),
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: timestamps,
            ..Default::default()
        });
        let [frame, instances] = groups;
        pass.set_bind_group(0, frame, &[]);
        for (pipeline, draws) in self.layers.iter().zip(&scene.draws.casters) {
            pass.set_pipeline(pipeline);
            super::draw_all(&mut pass, instances, scene, scene.thing_indices(), draws);
        }
    }
}
