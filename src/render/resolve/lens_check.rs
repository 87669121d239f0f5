//! Test of the inverse of the lens as shaders compute it.

use bytemuck::Zeroable;

use crate::gpu::adapter::adapter_of_tests;
use crate::gpu::{Gpu, shader_check};
use crate::lens::{InverseSteps, Lens};
use crate::render::device::shader_structs::FrameUniforms;

/// Points along a side of the image.
const SIDE: usize = 64;
const ENTRY: &str = "
@group(0) @binding(1) var<storage, read_write> points: array<vec2<f32>>;
@compute @workgroup_size(64)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) { points[id.x] = undistortion(points[id.x]); }";

/// Displacements of points as the shader computes them.
fn displacements(gpu: &Gpu, lens: Lens, steps: InverseSteps, points: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let uniforms = FrameUniforms {
        lens_k: [lens.k1, lens.k2, lens.k3].map(|k| k as f32),
        lens_p: glam::Vec2::new(lens.p1 as f32, lens.p2 as f32),
        lens_steps: steps.packed(),
        ..FrameUniforms::zeroed()
    };
    let text = [
        include_str!("../../../shaders/common/frame.wgsl"),
        include_str!("../../../shaders/common/exact.wgsl"),
        include_str!("../../../shaders/common/lens.wgsl"),
        ENTRY,
    ];
    shader_check::run(gpu, &text.concat(), bytemuck::bytes_of(&uniforms), points)
}

/// Half the field of view of each lens is what an image of 512 x 512 pixels with 2 x 2 samples each covers. The last four turn beyond the
/// corners of such an image, where Newton's method alone finds other points.
#[test]
fn shaders_undistort_to_a_ten_thousandth_of_a_sample() {
    let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
    for (lens, half) in [
        (Lens { k1: -0.08, ..Lens::default() }, 0.77),
        (Lens { k1: 0.2, k2: -0.03, ..Lens::default() }, 0.5),
        (Lens { k1: -0.25, k2: 0.06, k3: -0.005, p1: 0.002, p2: -0.001 }, 0.55),
        (Lens { k1: 0.232, k2: 0.267, k3: -0.214, ..Lens::default() }, 0.88),
        (Lens { k1: 0.394, k2: 0.127, k3: -0.355, ..Lens::default() }, 0.767),
        (Lens { k1: -0.022, k2: 0.25, k3: -0.102, p1: 0.015, p2: -0.003 }, 1.0355),
        (Lens { k1: 0.432, k2: 0.272, k3: -0.253, ..Lens::default() }, 0.84),
    ] {
        let steps = lens.inverse_steps([half; 2]).unwrap_or_else(|| panic!("{lens:?} is no lens"));
        let focal_samples = 512.0 / half;
        let at = |index: usize| ((index as f64 + 0.5) / SIDE as f64 * 2.0 - 1.0) * half;
        let points: Vec<[f32; 2]> =
            (0..SIDE * SIDE).map(|point| [at(point % SIDE) as f32, at(point / SIDE) as f32]).collect();
        for (point, found) in points.iter().zip(displacements(&gpu, lens, steps, &points)) {
            let point = point.map(f64::from);
            let expected = lens.undistort(point);
            for axis in [0, 1] {
                let error = (point[axis] + f64::from(found[axis]) - expected[axis]) * focal_samples;
                assert!(error.abs() < 1e-4, "{lens:?}, {steps:?}, {point:?}: {error} samples");
            }
        }
    }
}
