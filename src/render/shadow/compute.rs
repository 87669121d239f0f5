//! The compute backend of shadows: the largest depth of the casters' fronts and backs in each texel, then the midpoint map of the two
//! (Woo 1992), in one compute pass, the same on every device.

use std::ops::Range;

use wgpu::BufferUsages;

use super::device_map::{DeviceMap, MapSource};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::render::device::bind_groups::{
    BindLayouts, RasterGroups, SHADOW_MAP_FORMAT, bind_group, storage_buffer, storage_texture,
};
use crate::render::device::shader_programs::SHADOW_COMPUTE;
use crate::render::select::casters::DEPTH_RANGE_PX;
use crate::render::visibility::meshes::Meshes;
use crate::render::visibility::triangle_groups::{
    TriangleGroups, TrianglePass, compile_passes, group_layout,
};

/// Columns and rows of texels that a workgroup writes; `shadow_compute.wgsl` has the same constant.
pub(in crate::render) const WORKGROUP_SIDE: u32 = 8;

/// Rows of the largest tile.
const MAX_TILE_PX: u32 = DEPTH_RANGE_PX as u32;

/// The pass, and the map that it makes.
#[derive(Debug)]
pub(crate) struct ComputeShadow {
    pipelines: Option<Pipelines>,
    groups: TriangleGroups,
    /// Depths of fronts and of backs.
    layers: [GrowingBuffer; 2],
    pub(super) map: DeviceMap,
    /// What the pass binds in group 2, once it has made a map.
    own: Option<wgpu::BindGroup>,
}

#[derive(Debug)]
struct Pipelines {
    layout: wgpu::BindGroupLayout,
    layers: TrianglePass,
    map: wgpu::ComputePipeline,
}

impl Default for ComputeShadow {
    fn default() -> Self {
        let layer = |label| GrowingBuffer::new(label, BufferUsages::STORAGE);
        Self {
            pipelines: None,
            groups: TriangleGroups::new("shadow/groups"),
            layers: [layer("shadow/fronts"), layer("shadow/backs")],
            map: DeviceMap::default(),
            own: None,
        }
    }
}

impl ComputeShadow {
    /// Compiles the pass, unless it is there, and readies the map; unless a frame before has made it, uploads the triangles of these
    /// draws. Returns the bytes that were uploaded.
    ///
    /// # Errors
    /// Those of [`TriangleGroups::write`].
    pub(super) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        source: MapSource,
        (meshes, casters): (&Meshes, &Range<usize>),
    ) -> Result<u64> {
        self.map.prepare(gpu, source);
        let pipelines = self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
        if self.map.is_kept() {
            return Ok(0);
        }
        let bytes = self.groups.write(gpu, meshes, std::iter::once((casters, false)))?;
        for layer in &mut self.layers {
            layer.reserve(gpu, layer_bytes(self.map.size_px()));
        }
        let [fronts, backs] = self.layers.each_ref().map(|layer| layer.buffer().as_entire_binding());
        let out = wgpu::BindingResource::TextureView(self.map.view());
        let own: Vec<_> = self.groups.bindings(meshes).into_iter().chain([fronts, backs, out]).collect();
        self.own = Some(bind_group(gpu, SHADOW_COMPUTE.name, &pipelines.layout, &own));
        Ok(bytes)
    }

    /// Records the pass.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        groups: &RasterGroups,
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let size_px = self.map.size_px();
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        for layer in &self.layers {
            encoder.clear_buffer(layer.buffer(), 0, Some(layer_bytes(size_px)));
        }
        self.groups.clear_queues(encoder);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow"),
            timestamp_writes: timestamps,
        });
        pass.set_bind_group(0, &groups.frame, &[]);
        pass.set_bind_group(1, &groups.instances, &[]);
        pass.set_bind_group(2, self.own.as_ref(), &[]);
        self.groups.dispatch(&mut pass, &pipelines.layers, MAX_TILE_PX);
        pass.set_pipeline(&pipelines.map);
        let [columns, rows] = size_px.map(|side| side.div_ceil(WORKGROUP_SIDE));
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let own = [storage_buffer(false), storage_buffer(false), storage_texture(SHADOW_MAP_FORMAT)];
        let layout = group_layout(gpu, SHADOW_COMPUTE.name, &own);
        let ([layers], map) = compile_passes(gpu, &SHADOW_COMPUTE, (layouts, &layout), "cs_map");
        Self { layout, layers, map }
    }
}

/// Bytes of a layer of this many columns and rows.
fn layer_bytes(size_px: [u32; 2]) -> u64 {
    size_px.map(u64::from).iter().product::<u64>() * size_of::<u32>() as u64
}
