//! Test of the inverse of the lens as shaders compute it.

use bytemuck::Zeroable;
use wgpu::BufferUsages;
use wgpu::util::{BufferInitDescriptor, DeviceExt};

use crate::gpu::Gpu;
use crate::gpu::readback::ReadbackBuffer;
use crate::lens::Lens;
use crate::render::device::shader_structs::FrameUniforms;

/// Points along a side of the image.
const SIDE: usize = 64;
const ENTRY: &str = "
@group(0) @binding(1) var<storage, read_write> points: array<vec2<f32>>;
@compute @workgroup_size(64)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) { points[id.x] = undistortion(points[id.x]); }";

/// Displacements of points as the shader computes them.
fn displacements(gpu: &Gpu, lens: Lens, half: f64, points: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let uniforms = FrameUniforms {
        lens_k: [lens.k1, lens.k2, lens.k3].map(|k| k as f32),
        lens_p: glam::Vec2::new(lens.p1 as f32, lens.p2 as f32),
        lens_steps: lens.newton_steps([half; 2]),
        ..FrameUniforms::zeroed()
    };
    let text = [
        include_str!("../../../shaders/common/frame.wgsl"),
        include_str!("../../../shaders/common/lens.wgsl"),
        ENTRY,
    ];
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(text.concat().into()),
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
    let uniform = buffer(bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM);
    let storage = buffer(bytemuck::cast_slice(points), BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let entries = [&uniform, &storage].map(wgpu::Buffer::as_entire_binding);
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[0, 1].map(|binding: usize| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: entries[binding].clone(),
        }),
    });
    let readback = ReadbackBuffer::new(gpu, "points", storage.size());
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups((points.len() / 64) as u32, 1, 1);
    }
    readback.copy(&mut encoder, &storage, storage.size());
    let submission = gpu.queue.submit([encoder.finish()]);
    readback.map();
    gpu.wait(&submission).expect("the device works");
    readback.read(bytemuck::pod_collect_to_vec).expect("points")
}

/// Half the field of view of each lens is what an image of 512 x 512 pixels with 2 x 2 samples each covers.
#[test]
fn shaders_undistort_to_a_ten_thousandth_of_a_sample() {
    let gpu = Gpu::open(Some("cpu")).expect("an adapter");
    for (lens, half) in [
        (Lens { k1: -0.08, ..Lens::default() }, 0.77),
        (Lens { k1: 0.2, k2: -0.03, ..Lens::default() }, 0.5),
        (Lens { k1: -0.25, k2: 0.06, k3: -0.005, p1: 0.002, p2: -0.001 }, 0.55),
    ] {
        let focal_samples = 512.0 / half;
        let at = |index: usize| ((index as f64 + 0.5) / SIDE as f64 * 2.0 - 1.0) * half;
        let points: Vec<[f32; 2]> =
            (0..SIDE * SIDE).map(|point| [at(point % SIDE) as f32, at(point / SIDE) as f32]).collect();
        for (point, found) in points.iter().zip(displacements(&gpu, lens, half, &points)) {
            let point = point.map(f64::from);
            let expected = lens.undistort(point);
            for axis in [0, 1] {
                let error = (point[axis] + f64::from(found[axis]) - expected[axis]) * focal_samples;
                assert!(error.abs() < 1e-4, "{lens:?}, {point:?}: {error} samples");
            }
        }
    }
}
