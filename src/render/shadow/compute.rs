//! The compute backend of shadows: the largest depth of the casters' fronts and backs in each texel, then the midpoint map of the two
//! (Woo 1992), in one compute pass, the same on every device.

use std::ops::Range;

use wgpu::{BufferUsages, TextureUsages};

use super::map_source::{KeptMap, MapSource};
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::render::device::bind_groups::{BindLayouts, RasterGroups, SHADOW_MAP_FORMAT, bind_group};
use crate::render::device::shader_programs::SHADOW_COMPUTE;
use crate::render::select::casters::DEPTH_RANGE_PX;
use crate::render::visibility::meshes::Meshes;
use crate::render::visibility::triangle_groups::{
    TriangleGroups, bind_group_layout, compute_pipelines, storage_buffer, storage_texture,
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
    map: Option<Map>,
    kept: KeptMap,
}

#[derive(Debug)]
struct Pipelines {
    layout: wgpu::BindGroupLayout,
    /// Of small triangles, and of those that these leave.
    layers: [wgpu::ComputePipeline; 2],
    map: wgpu::ComputePipeline,
}

/// The map, and what the pass that makes it binds.
#[derive(Debug)]
struct Map {
    /// Columns and rows.
    size_px: [u32; 2],
    view: wgpu::TextureView,
    group: Option<wgpu::BindGroup>,
}

impl Default for ComputeShadow {
    fn default() -> Self {
        let layer = |label| GrowingBuffer::new(label, BufferUsages::STORAGE);
        Self {
            pipelines: None,
            groups: TriangleGroups::new("shadow/groups"),
            layers: [layer("shadow/fronts"), layer("shadow/backs")],
            map: None,
            kept: KeptMap::default(),
        }
    }
}

impl ComputeShadow {
    /// Compiles the pass, unless it is there, and makes a map of the columns and rows of its source; unless a frame before has made
    /// it, uploads the triangles of these draws. Returns the bytes that were uploaded.
    pub(super) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        source: MapSource,
        (meshes, casters): (&Meshes, &Range<usize>),
    ) -> u64 {
        let size_px = source.size_px;
        if self.map.as_ref().is_none_or(|map| map.size_px != size_px) {
            let usage = TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING;
            let (_, view) = gpu.texture("shadow/map", size_px, SHADOW_MAP_FORMAT, usage);
            self.map = Some(Map { size_px, view, group: None });
            self.kept.invalidate();
        }
        let pipelines = self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
        if self.kept.holds(source) {
            return 0;
        }
        let bytes = self.groups.write(gpu, meshes, std::iter::once((casters, false)));
        for layer in &mut self.layers {
            layer.reserve(gpu, layer_bytes(size_px));
        }
        let map = self.map.as_mut().expect("it was just made");
        let [fronts, backs] = self.layers.each_ref().map(|layer| layer.buffer().as_entire_binding());
        let out = wgpu::BindingResource::TextureView(&map.view);
        let own: Vec<_> = self.groups.bindings(meshes).into_iter().chain([fronts, backs, out]).collect();
        map.group = Some(bind_group(gpu, SHADOW_COMPUTE.name, &pipelines.layout, &own));
        bytes
    }

    /// Whether the map is that of a frame before, so that there is nothing to record.
    pub(super) const fn is_kept(&self) -> bool {
        self.kept.is_kept
    }

    /// The next frame makes the map, whatever it holds.
    pub(super) fn invalidate(&mut self) {
        self.kept.invalidate();
    }

    /// The map.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(crate) fn map(&self) -> &wgpu::TextureView {
        &self.map.as_ref().expect("a map is prepared before it is used").view
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
        let map = self.map.as_ref().expect("a map is prepared before it is made");
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        for layer in &self.layers {
            encoder.clear_buffer(layer.buffer(), 0, Some(layer_bytes(map.size_px)));
        }
        self.groups.clear(encoder);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow"),
            timestamp_writes: timestamps,
        });
        pass.set_bind_group(0, &groups.frame, &[]);
        pass.set_bind_group(1, &groups.instances, &[]);
        pass.set_bind_group(2, map.group.as_ref(), &[]);
        let [small, left] = &pipelines.layers;
        self.groups.dispatch(&mut pass, small);
        self.groups.dispatch_left(&mut pass, left, MAX_TILE_PX);
        pass.set_pipeline(&pipelines.map);
        let [columns, rows] = map.size_px.map(|side| side.div_ceil(WORKGROUP_SIDE));
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let own = [storage_buffer(false), storage_buffer(false), storage_texture(SHADOW_MAP_FORMAT)];
        let layout = bind_group_layout(gpu, SHADOW_COMPUTE.name, &own);
        let entry_points = ["cs_layers", "cs_layers_left", "cs_map"];
        let [layers, layers_left, map] =
            compute_pipelines(gpu, &SHADOW_COMPUTE, (layouts, &layout), entry_points);
        Self { layout, layers: [layers, layers_left], map }
    }
}

/// Bytes of a layer of this many columns and rows.
fn layer_bytes(size_px: [u32; 2]) -> u64 {
    size_px.map(u64::from).iter().product::<u64>() * size_of::<u32>() as u64
}
