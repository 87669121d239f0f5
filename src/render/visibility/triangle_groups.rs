//! Triangles for compute passes that rasterise: the draws of a frame, divided into groups of which a workgroup takes one
//! (`common/triangle_groups.wgsl`).
//! Must not know: a stage.

use std::ops::Range;

use rayon::prelude::*;
use wgpu::{BindingType, BufferUsages, ShaderStages};

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::render::device::bind_groups::{BindLayouts, bind_group_layout, storage_buffer};
use crate::render::device::shader_programs::{Program, TextOptions};
use crate::render::visibility::meshes::Meshes;

/// Triangles of a group. The shader has the same constants.
pub(in crate::render) const GROUP_TRIANGLES: u32 = 64;
/// Groups of a row of workgroups: more than a device takes along one axis may be needed.
pub(in crate::render) const GROUPS_PER_ROW: u32 = 128;
/// Workgroups along the queues of triangles that no thread alone rasterises, and the most huge ones.
pub(in crate::render) const QUEUE_WORKGROUPS: u32 = 512;
/// See [`QUEUE_WORKGROUPS`].
pub(in crate::render) const MAX_HUGE: u32 = 4096;
/// Rows of samples for which a huge triangle has one more workgroup, and the most that it has. Mesa's CPU driver ends a loop after 65,535
/// steps: a workgroup tests some thousand blocks of samples at most.
const ROWS_PER_SLICE: u32 = 128;
const MAX_SLICES: u32 = 64;
/// Bits above the number of triangles in the last word of a group.
pub(in crate::render) const IS_SKY: u32 = 0x80;
/// See [`IS_SKY`].
pub(in crate::render) const IS_NARROW: u32 = 0x100;

/// The first index of the triangles, what is added to each index, the slot of their instance; their number, [`IS_SKY`] and [`IS_NARROW`].
type Group = [u32; 4];

/// The groups of some draws on the device.
#[derive(Debug)]
pub(in crate::render) struct TriangleGroups {
    /// [`Group`]s, whole rows of them.
    buffer: GrowingBuffer,
    rows: u32,
    /// Queues of triangles that no thread alone rasterises: two lengths, the large ones, the huge ones.
    queues: GrowingBuffer,
}

impl TriangleGroups {
    /// None yet.
    pub(in crate::render) const fn new(label: &'static str) -> Self {
        Self {
            buffer: GrowingBuffer::new(label, BufferUsages::STORAGE),
            rows: 0,
            queues: GrowingBuffer::new(label, BufferUsages::STORAGE),
        }
    }

    /// Replaces them with those of ranges of the draws, in their order; each range is of the sky or not. Returns the bytes that were
    /// uploaded.
    ///
    /// # Errors
    /// [`Error::Scene`] if the device cannot bind as much as they are.
    pub(in crate::render) fn write<'a>(
        &mut self,
        gpu: &Gpu,
        meshes: &Meshes,
        draws: impl Iterator<Item = (&'a Range<usize>, bool)>,
    ) -> Result<u64> {
        // About as many as for the frame before.
        let mut groups = Vec::with_capacity((self.rows * GROUPS_PER_ROW) as usize);
        for (draws, is_sky) in draws {
            add_groups(&mut groups, meshes, draws, if is_sky { IS_SKY } else { 0 });
        }
        groups.resize(groups.len().next_multiple_of(GROUPS_PER_ROW as usize).max(1), [0; 4]);
        self.rows = groups.len() as u32 / GROUPS_PER_ROW;
        let triangles = groups.len() as u64 * u64::from(GROUP_TRIANGLES);
        self.queues.reserve(gpu, (2 + triangles + u64::from(MAX_HUGE)) * size_of::<u32>() as u64);
        let bytes = self.buffer.write(gpu, &groups);
        let (used, limit) = (self.buffers(meshes), gpu.device.limits().max_storage_buffer_binding_size);
        match used.map(GrowingBuffer::used).into_iter().max() {
            Some(most) if most > limit => Err(too_large(most, limit, &gpu.info.name)),
            _ => Ok(bytes),
        }
    }

    /// Groups, indices, vertices, queues.
    const fn buffers<'a>(&'a self, meshes: &'a Meshes) -> [&'a GrowingBuffer; 4] {
        let [vertices, indices] = meshes.buffers();
        [&self.buffer, indices, vertices, &self.queues]
    }

    /// What the shader binds first in group 2: groups, indices, vertices, queues.
    pub(in crate::render) fn bindings<'a>(&'a self, meshes: &'a Meshes) -> [wgpu::BindingResource<'a>; 4] {
        self.buffers(meshes).map(GrowingBuffer::bind_used)
    }

    /// Empties the queues.
    pub(in crate::render) fn clear_queues(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(self.queues.buffer(), 0, Some(2 * size_of::<u32>() as u64));
    }

    /// Loses all rows of groups but these first ones.
    #[cfg(test)]
    pub(in crate::render) fn lose(&mut self, rows: u32) {
        assert!(rows < self.rows, "{rows} of {} rows", self.rows);
        self.rows = rows;
    }

    /// Dispatches a workgroup for each group, then workgroups for the triangles that these queued, which cover at most this many rows of
    /// samples.
    pub(in crate::render) fn dispatch(
        &self,
        pass: &mut wgpu::ComputePass<'_>,
        [small, queued]: &TrianglePass,
        rows: u32,
    ) {
        pass.set_pipeline(small);
        pass.dispatch_workgroups(GROUPS_PER_ROW, self.rows, 1);
        pass.set_pipeline(queued);
        let slices = rows.div_ceil(ROWS_PER_SLICE).clamp(1, MAX_SLICES);
        pass.dispatch_workgroups(QUEUE_WORKGROUPS, 1 + slices, 1);
    }
}

/// The error of a scene of which a buffer of this many bytes would have to be bound.
fn too_large(bytes: u64, limit: u64, adapter: &str) -> Error {
    Error::Scene(format!(
        "the meshes of the scene are too large for --raster compute on {adapter}: a buffer has {} MiB, the limit is {}; use --raster device, a \
         larger terrain.cell_mrad or a larger camera.fov_deg",
        bytes.div_ceil(1 << 20),
        limit >> 20
    ))
}

/// Layout of group 2 of a compute pass that rasterises: what [`TriangleGroups::bindings`] binds, then what is its own.
pub(in crate::render) fn group_layout(gpu: &Gpu, label: &str, own: &[BindingType]) -> wgpu::BindGroupLayout {
    let (read, write) = (storage_buffer(true), storage_buffer(false));
    let bindings = [read, read, read, write].into_iter().chain(own.iter().copied());
    bind_group_layout(gpu, label, ShaderStages::COMPUTE, (0..).zip(bindings))
}

/// Pipelines of a pass over the triangles: of small ones, and of those that these queue.
pub(in crate::render) type TrianglePass = [wgpu::ComputePipeline; 2];

/// Compiles a program with the bind groups of the frame and of the scene, and one of its own: its passes over the triangles, and the entry
/// point of what follows them.
pub(in crate::render) fn compile_passes<const PASSES: usize>(
    gpu: &Gpu,
    program: &Program,
    (layouts, own): (&BindLayouts, &wgpu::BindGroupLayout),
    last: &str,
) -> ([TrianglePass; PASSES], wgpu::ComputePipeline) {
    let label = program.name;
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &[Some(&layouts.frame), Some(&layouts.instances), Some(own)],
        immediate_size: 0,
    });
    let program = program.parse(TextOptions::default());
    let compile = |(entry_point, pass_number, are_alone): (&str, usize, bool)| {
        let constants = [("PASS_NUMBER", pass_number as f64), ("ARE_ALONE", f64::from(u8::from(are_alone)))];
        gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout: Some(&layout),
            module: &program.specialise(gpu, &[entry_point], &constants),
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: gpu.pipeline_cache(),
        })
    };
    let passes = (0..PASSES).flat_map(|pass| [("cs_small", pass, true), ("cs_queued", pass, false)]);
    let entry_points: Vec<_> = passes.chain([(last, 0, true)]).collect();
    let pipelines: Vec<_> = entry_points.into_par_iter().map(compile).collect();
    let mut pipelines = pipelines.into_iter();
    let mut next = || pipelines.next().expect("a pipeline for each entry point");
    (std::array::from_fn(|_| [next(), next()]), next())
}

fn add_groups(groups: &mut Vec<Group>, meshes: &Meshes, draws: &Range<usize>, sky: u32) {
    let narrow = if meshes.has_narrow_indices() { IS_NARROW } else { 0 };
    for draw in meshes.draws(draws) {
        let end = draw.first_index + draw.index_count;
        for slot in draw.first_instance..draw.first_instance + draw.instance_count {
            let firsts = (draw.first_index..end).step_by(3 * GROUP_TRIANGLES as usize);
            groups.extend(firsts.map(|first| {
                let count = ((end - first) / 3).min(GROUP_TRIANGLES);
                [first, draw.base_vertex.cast_unsigned(), slot, count | sky | narrow]
            }));
        }
    }
}
