//! The shadow-map pass: depth of all casters, fronts in one layer of an atlas and backs in the other, and of the two the map.
//! A device that is a CPU is given the map as [`crate::render::shadow::host`] draws it.

use wgpu::TextureUsages;

use crate::gpu::Gpu;
use crate::render::device::bind_groups::{BindLayouts, SHADOW_MAP_FORMAT};
use crate::render::device::shader_structs::{SHADOW, SHADOW_MIDPOINT};
use crate::render::gpu_scene::GpuScene;
use crate::render::lighting::gbuffer::{ATLAS_FORMAT, depth_state};
use crate::render::visibility::meshes::vertex_layout;

/// Columns and rows of texels that a group of invocations makes of the map; they stand in `shadow_midpoint.wgsl` too.
const GROUP_PX: u32 = 8;

/// What the pass draws, and with what.
#[derive(Debug, Default)]
pub(in crate::render) struct ShadowPass {
    /// Once a map was to be drawn.
    pipelines: Option<Pipelines>,
    map: Option<Map>,
}

#[derive(Debug)]
struct Pipelines {
    layers: [wgpu::RenderPipeline; 2],
    middle: wgpu::ComputePipeline,
}

/// The map, and the layers that it is made of.
#[derive(Debug)]
struct Map {
    /// Columns and rows of the map and of each layer.
    size_px: [u32; 2],
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    /// Unless the map is given: fronts above backs, and how the map is made of them.
    drawn: Option<(wgpu::TextureView, wgpu::BindGroup)>,
}

impl ShadowPass {
    /// Makes the map with exactly so many columns and rows, unless it is there. Not a larger one: if the device is to draw it,
    /// places in it would be rounded otherwise, and the frame would depend on those before it.
    pub(in crate::render) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        size_px: [u32; 2],
        is_given: bool,
    ) {
        let serves = |map: &Map| map.size_px == size_px && map.drawn.is_none() == is_given;
        if !self.map.as_ref().is_some_and(serves) {
            self.map = Some(Map::new(gpu, layouts, size_px, is_given));
        }
        if !is_given {
            self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
        }
    }

    /// The map, which parts may be copied to if it is given.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(in crate::render) fn texture(&self) -> &wgpu::Texture {
        &self.map.as_ref().expect("a map is prepared before it is used").texture
    }

    /// The map.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(in crate::render) fn map(&self) -> &wgpu::TextureView {
        &self.map.as_ref().expect("a map is prepared before it is used").view
    }

    /// Records the pass, unless the map was given. `timestamps` are those of its start and of its end.
    pub(in crate::render) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        groups: [&wgpu::BindGroup; 2],
        timestamps: Option<(wgpu::RenderPassTimestampWrites<'_>, wgpu::ComputePassTimestampWrites<'_>)>,
    ) {
        let Some(Map { size_px, drawn: Some((layers, making)), .. }) = &self.map else { return };
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        let (start, end) = timestamps.unzip();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: layers,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: start,
            ..Default::default()
        });
        let [frame, instances] = groups;
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, instances, &[0, 0]);
        for pipeline in &pipelines.layers {
            pass.set_pipeline(pipeline);
            scene.meshes.record(&mut pass, &scene.draws.casters);
        }
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow/map"),
            timestamp_writes: end,
        });
        pass.set_pipeline(&pipelines.middle);
        pass.set_bind_group(2, making, &[]);
        let [columns, rows] = size_px.map(|side| side.div_ceil(GROUP_PX));
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
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
                        constants: &[("ATLAS_LAYER", layer)],
                        ..Default::default()
                    },
                    buffers: &[Some(vertex_layout(1))],
                },
                primitive: wgpu::PrimitiveState { cull_mode: Some(cull), ..Default::default() },
                depth_stencil: Some(depth_state(ATLAS_FORMAT)),
                multisample: wgpu::MultisampleState::default(),
                fragment: None,
                multiview_mask: None,
                cache: gpu.pipeline_cache(),
            })
        };
        let layers =
            [layer("shadow/fronts", 0.0, wgpu::Face::Back), layer("shadow/backs", 1.0, wgpu::Face::Front)];
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("shadow/map/layout"),
            bind_group_layouts: &[None, None, Some(&layouts.layers)],
            immediate_size: 0,
        });
        let middle = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("shadow/map"),
            layout: Some(&layout),
            module: &SHADOW_MIDPOINT.compile(gpu),
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: gpu.pipeline_cache(),
        });
        Self { layers, middle }
    }
}

impl Map {
    fn new(gpu: &Gpu, layouts: &BindLayouts, size_px: [u32; 2], is_given: bool) -> Self {
        let filled = if is_given { TextureUsages::COPY_DST } else { TextureUsages::STORAGE_BINDING };
        let (texture, view) =
            gpu.texture("shadow/map", size_px, SHADOW_MAP_FORMAT, filled | TextureUsages::TEXTURE_BINDING);
        let drawn = (!is_given).then(|| {
            let size = [size_px[0], 2 * size_px[1]];
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
            let (_, layers) = gpu.texture("shadow/layers", size, ATLAS_FORMAT, usage);
            let making = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("shadow/map"),
                layout: &layouts.layers,
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: wgpu::BindingResource::TextureView(&layers),
                    },
                    wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&view) },
                ],
            });
            (layers, making)
        });
        Self { size_px, texture, view, drawn }
    }
}
