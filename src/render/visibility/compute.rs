//! The compute backend of visibility: three dispatches of one compute pass write the visible surface of each sample, the same on every
//! device.
//!
//! Triangles go to the device as draws do, divided into groups of which a workgroup takes one.
//! Must not know: how surfaces are shaded.

use wgpu::{BindingType, BufferUsages, ShaderStages};

use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::render::backend::LightingMode;
use crate::render::device::bind_groups::{BindLayouts, bind_group};
use crate::render::device::shader_programs::VISIBILITY_COMPUTE;
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::gbuffer::{GBuffer, NEAREST_BYTES, VISIBILITY_FORMAT};
use crate::render::select::draw_list::DrawBatch;
use crate::render::visibility::meshes::Meshes;

/// Triangles of a group; `visibility_compute.wgsl` has the same constants.
pub(in crate::render) const GROUP_TRIANGLES: u32 = 64;
/// Groups of a row of workgroups: more than a device takes along one axis may be needed.
pub(in crate::render) const GROUPS_PER_ROW: u32 = 128;
/// Columns and rows of samples that a workgroup writes.
pub(in crate::render) const WORKGROUP_SIDE: u32 = 8;
/// Bits above the number of triangles in the last word of a group.
pub(in crate::render) const IS_SKY: u32 = 0x80;
pub(in crate::render) const IS_NARROW: u32 = 0x100;

/// Triangles that are drawn with the same instance: the first of their indices, what is added to each index, the slot of the instance;
/// their number, [`IS_SKY`] and [`IS_NARROW`].
type TriangleGroup = [u32; 4];

/// The passes.
#[derive(Debug)]
pub(crate) struct ComputeVisibility {
    /// How the samples are lit.
    pub(crate) lighting: LightingMode,
    pipelines: Option<Pipelines>,
    /// [`TriangleGroup`]s, whole rows of them.
    groups: GrowingBuffer,
    rows: u32,
    /// What the dispatches know of each sample of a tile: one after the other, they serve all frames.
    nearest: GrowingBuffer,
}

#[derive(Debug)]
struct Pipelines {
    layout: wgpu::BindGroupLayout,
    depth: wgpu::ComputePipeline,
    triangle: wgpu::ComputePipeline,
    write: wgpu::ComputePipeline,
}

impl Pipelines {
    fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let buffer = |read_only| BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only },
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let out = BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: VISIBILITY_FORMAT,
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        let bindings = [buffer(true), buffer(true), buffer(true), buffer(false), out];
        let entries: Vec<_> = (0..)
            .zip(bindings)
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: ShaderStages::COMPUTE,
                ty,
                count: None,
            })
            .collect();
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(VISIBILITY_COMPUTE.name),
            entries: &entries,
        });
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(VISIBILITY_COMPUTE.name),
            bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.scene), Some(&layout)],
            immediate_size: 0,
        });
        let module = VISIBILITY_COMPUTE.compile(gpu);
        let pipeline = |entry_point| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: gpu.pipeline_cache(),
            })
        };
        let [depth, triangle, write] = ["cs_depth", "cs_triangle", "cs_write"].map(pipeline);
        Self { layout, depth, triangle, write }
    }
}

impl ComputeVisibility {
    /// Passes for samples that are lit like this, which have compiled nothing yet.
    pub(crate) const fn new(lighting: LightingMode) -> Self {
        Self {
            lighting,
            pipelines: None,
            groups: GrowingBuffer::new("visibility/groups", BufferUsages::STORAGE),
            rows: 0,
            nearest: GrowingBuffer::new("visibility/nearest", BufferUsages::STORAGE),
        }
    }

    /// Compiles the passes, unless they are there, and uploads the groups of the draws of a frame.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        (meshes, batches): (&Meshes, &[DrawBatch]),
    ) -> u64 {
        self.pipelines.get_or_insert_with(|| Pipelines::new(gpu, layouts));
        let mut groups = groups(meshes, batches);
        groups.resize(groups.len().next_multiple_of(GROUPS_PER_ROW as usize), [0; 4]);
        self.rows = groups.len() as u32 / GROUPS_PER_ROW;
        self.groups.write(gpu, &groups)
    }

    /// Makes room for the samples of a tile.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, [columns, rows]: [u32; 2]) {
        self.nearest.reserve(gpu, u64::from(columns) * u64::from(rows) * NEAREST_BYTES);
    }

    /// Records the pass.
    pub(crate) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        [frame, instances]: [&wgpu::BindGroup; 2],
        (gbuffer, timestamps): (&GBuffer, Option<wgpu::ComputePassTimestampWrites<'_>>),
    ) {
        let pipelines = self.pipelines.as_ref().expect("a pass is prepared before it is recorded");
        let [columns, rows] = gbuffer.sample_size;
        encoder.clear_buffer(
            self.nearest.buffer(),
            0,
            Some(u64::from(columns) * u64::from(rows) * NEAREST_BYTES),
        );
        let [vertices, indices] = meshes.buffers();
        let own = [
            self.groups.buffer().as_entire_binding(),
            indices.as_entire_binding(),
            vertices.as_entire_binding(),
            self.nearest.buffer().as_entire_binding(),
            wgpu::BindingResource::TextureView(&gbuffer.visibility.1),
        ];
        let own = bind_group(gpu, VISIBILITY_COMPUTE.name, &pipelines.layout, &own);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("visibility"),
            timestamp_writes: timestamps,
        });
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, instances, &[0, 0]);
        pass.set_bind_group(2, &own, &[]);
        for pipeline in [&pipelines.depth, &pipelines.triangle] {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(GROUPS_PER_ROW, self.rows, 1);
        }
        pass.set_pipeline(&pipelines.write);
        pass.dispatch_workgroups(columns.div_ceil(WORKGROUP_SIDE), rows.div_ceil(WORKGROUP_SIDE), 1);
    }
}

/// The triangles of these batches, in the order of their draws: of two at the same depth the first is visible.
fn groups(meshes: &Meshes, batches: &[DrawBatch]) -> Vec<TriangleGroup> {
    let mut groups = Vec::new();
    let narrow = if meshes.has_narrow_indices() { IS_NARROW } else { 0 };
    for batch in batches {
        let sky = if batch.variant == LightingVariant::Sky { IS_SKY } else { 0 };
        for draw in meshes.draws(&batch.draws) {
            for slot in draw.first_instance..draw.first_instance + draw.instance_count {
                let end = draw.first_index + draw.index_count;
                let firsts = (draw.first_index..end).step_by(3 * GROUP_TRIANGLES as usize);
                groups.extend(firsts.map(|first| {
                    let count = ((end - first) / 3).min(GROUP_TRIANGLES);
                    [first, draw.base_vertex.cast_unsigned(), slot, count | sky | narrow]
                }));
            }
        }
    }
    groups
}
