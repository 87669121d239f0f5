//! The device backend of shadows: depth of all casters, fronts in one layer of an atlas and backs in the other, then the midpoint
//! map of the two (Woo 1992).
//!
//! The map stays or goes as a whole: a device rounds a tile by its place in the map, so that a tile in another place is not the same to the
//! bit.

use std::ops::Range;

use wgpu::TextureUsages;

use super::device_map::{DeviceMap, MapSource};
use crate::gpu::Gpu;
use crate::render::device::bind_groups::{BindLayouts, RasterGroups, bind_group};
use crate::render::device::depth::{SHADOW_LAYERS_FORMAT, depth_state};
use crate::render::device::shader_programs::{SHADOW, SHADOW_MIDPOINT, TextOptions};
use crate::render::visibility::meshes::{Meshes, vertex_layout};

/// Columns and rows of texels that a workgroup of `shadow_midpoint.wgsl` makes of the map; the shader has the same constant.
const WORKGROUP_PX: u32 = 8;

/// The passes, and the map that they draw.
#[derive(Debug, Default)]
pub(crate) struct ShadowPass {
    pipelines: Option<Pipelines>,
    pub(super) map: DeviceMap,
    layers: Option<Layers>,
}

#[derive(Debug)]
struct Pipelines {
    layers: [wgpu::RenderPipeline; 2],
    midpoint: wgpu::ComputePipeline,
}

/// The layers that the map is made of.
#[derive(Debug)]
struct Layers {
    /// Depth of the fronts, above that of the backs.
    view: wgpu::TextureView,
    /// Bind group of the compute pass that makes the map of them.
    midpoint_group: wgpu::BindGroup,
}

impl ShadowPass {
    /// Compiles the pipelines, unless they are there, and readies the map.
    pub(super) fn prepare(&mut self, gpu: &Gpu, layouts: &BindLayouts, source: MapSource) {
        if self.map.prepare(gpu, source) {
            self.layers = Some(Layers::new(gpu, layouts, &self.map));
        }
        self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
    }

    /// Records the passes. `timestamps` are those of the start of the first and of the end of the last.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        casters: &Range<usize>,
        groups: &RasterGroups,
        timestamps: Option<(wgpu::RenderPassTimestampWrites<'_>, wgpu::ComputePassTimestampWrites<'_>)>,
    ) {
        let layers = self.layers.as_ref().expect("a map is prepared before it is drawn");
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        let (start, end) = timestamps.unzip();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &layers.view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: start,
            ..Default::default()
        });
        pass.set_bind_group(0, &groups.frame, &[]);
        pass.set_bind_group(1, &groups.scene, &[0, 0]);
        for pipeline in &pipelines.layers {
            pass.set_pipeline(pipeline);
            meshes.record(&mut pass, casters);
        }
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow/map"),
            timestamp_writes: end,
        });
        pass.set_pipeline(&pipelines.midpoint);
        pass.set_bind_group(2, &layers.midpoint_group, &[]);
        let [columns, rows] = self.map.size_px().map(|side| side.div_ceil(WORKGROUP_PX));
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let program = SHADOW.parse(TextOptions::default());
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
                    module: &program.specialise(gpu, &["vs_main"], &[("ATLAS_LAYER", layer)]),
                    entry_point: Some("vs_main"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(vertex_layout(1))],
                },
                primitive: wgpu::PrimitiveState { cull_mode: Some(cull), ..Default::default() },
                depth_stencil: Some(depth_state(SHADOW_LAYERS_FORMAT)),
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
        let midpoint = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("shadow/map"),
            layout: Some(&layout),
            module: &SHADOW_MIDPOINT.parse(TextOptions::default()).specialise(gpu, &["cs_main"], &[]),
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: gpu.pipeline_cache(),
        });
        Self { layers, midpoint }
    }
}

impl Layers {
    fn new(gpu: &Gpu, layouts: &BindLayouts, map: &DeviceMap) -> Self {
        let [columns, rows] = map.size_px();
        let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
        let (_, view) = gpu.texture("shadow/layers", [columns, 2 * rows], SHADOW_LAYERS_FORMAT, usage);
        let textures = [&view, map.view()].map(wgpu::BindingResource::TextureView);
        let midpoint_group = bind_group(gpu, "shadow/map", &layouts.layers, &textures);
        Self { view, midpoint_group }
    }
}
