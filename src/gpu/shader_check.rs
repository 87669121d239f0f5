//! For tests of functions of shaders: a compute pass over a few numbers.

use bytemuck::{AnyBitPattern, NoUninit};
use wgpu::BufferUsages;
use wgpu::util::{BufferInitDescriptor, DeviceExt};

use crate::gpu::Gpu;
use crate::gpu::readback::ReadbackBuffer;

/// What `cs_main` of a program makes of values, with a workgroup of 64 threads for each 64 of them. Binding 0 of group 0 is the uniforms,
/// binding 1 the values.
pub(crate) fn run<T: NoUninit + AnyBitPattern>(
    gpu: &Gpu,
    text: &str,
    uniforms: &[u8],
    values: &[T],
) -> Vec<T> {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(text.into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("cs_main"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let buffer = |contents, usage| {
        gpu.device.create_buffer_init(&BufferInitDescriptor { label: None, contents, usage })
    };
    let uniforms = buffer(uniforms, BufferUsages::UNIFORM);
    let storage = buffer(bytemuck::cast_slice(values), BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let entries = [&uniforms, &storage].map(wgpu::Buffer::as_entire_binding);
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[0, 1].map(|binding: usize| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: entries[binding].clone(),
        }),
    });
    let readback = ReadbackBuffer::new(gpu, "values", storage.size());
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(values.len().div_ceil(64) as u32, 1, 1);
    }
    readback.copy(&mut encoder, &storage, storage.size());
    let submission = gpu.queue.submit([encoder.finish()]);
    readback.map();
    gpu.wait(&submission).expect("the device works");
    readback.read(bytemuck::pod_collect_to_vec).expect("values")
}
