//! Layout of the packed frame: what the resolve pass writes and the readback unpacks.
//! Must not know: a pass.

use std::ops::Range;

use crate::frame::Annotations;
use crate::frame::plane::Plane;
use crate::render::device::planes::{MAX_PACKED_PLANES, packed_planes};

/// Invocations in a workgroup of the resolve pass, each of four pixels; `resolve.wgsl` has the same constants.
pub(crate) const WORKGROUP_SIZE: u32 = 64;

/// Where each plane of a frame lies in the packed result.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packing {
    pixels: u64,
    annotations: Annotations,
}

/// Offset of a plane that is not requested; `common/frame.wgsl` has the same constant.
pub(crate) const NOT_REQUESTED: u32 = u32::MAX;

impl Packing {
    /// Packing of an image of this size with these annotations.
    #[must_use]
    pub(crate) fn new([width, height]: [u32; 2], annotations: Annotations) -> Self {
        Self { pixels: u64::from(width) * u64::from(height), annotations }
    }

    /// Runs of four pixels, each packed into three words of colour and one of classes.
    #[must_use]
    pub(crate) fn quads(self) -> u64 {
        self.pixels.div_ceil(4)
    }

    /// Annotations that are packed.
    #[must_use]
    pub(crate) const fn annotations(self) -> Annotations {
        self.annotations
    }

    /// The planes that are packed behind the quads, with the range of their words.
    pub(crate) fn planes(self) -> impl Iterator<Item = (Plane, Range<u64>)> {
        let mut end = 4 * self.quads();
        packed_planes().filter(move |(plane, _)| plane.is_in(self.annotations)).map(move |(plane, words)| {
            let start = end;
            end += words.len() as u64 * self.pixels;
            (plane, start..end)
        })
    }

    /// First word of each of [`packed_planes`], or [`NOT_REQUESTED`]: `plane_offsets` of the frame's uniforms.
    #[must_use]
    pub(crate) fn offsets(self) -> [[u32; 4]; MAX_PACKED_PLANES / 4] {
        let mut offsets = [[NOT_REQUESTED; 4]; MAX_PACKED_PLANES / 4];
        for (offset, (plane, _)) in offsets.as_flattened_mut().iter_mut().zip(packed_planes()) {
            if let Some((_, words)) = self.planes().find(|(packed, _)| *packed == plane) {
                *offset = words.start as u32;
            }
        }
        offsets
    }

    /// Size of the packed frame, bytes.
    #[must_use]
    pub(crate) fn bytes(self) -> u64 {
        4 * self.planes().last().map_or(4 * self.quads(), |(_, words)| words.end)
    }
}

#[cfg(test)]
mod tests {
    use half::f16;
    use wgpu::BufferUsages;

    use crate::gpu::Gpu;
    use crate::gpu::readback::ReadbackBuffer;
    use crate::render::device::bind_groups::bind_group;

    /// `half_bits` of `common/half.wgsl` for the bits of these numbers, on a device.
    fn half_bits(gpu: &Gpu, values: &[u32]) -> Vec<u32> {
        const ENTRY: &str = "
            @group(0) @binding(0) var<storage, read> values: array<u32>;
            @group(0) @binding(1) var<storage, read_write> halves: array<u32>;
            @compute @workgroup_size(64)
            fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
                let index = id.y * 65536u + id.x;
                halves[index] = half_bits(bitcast<f32>(values[index]));
            }";
        let text = [include_str!("../../../shaders/common/half.wgsl"), ENTRY].concat();
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("half"),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("half"),
            layout: None,
            module: &module,
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let bytes = size_of_val(values) as u64;
        let input = gpu.buffer("values", bytes, BufferUsages::STORAGE | BufferUsages::COPY_DST);
        gpu.queue.write_buffer(&input, 0, bytemuck::cast_slice(values));
        let output = gpu.buffer("halves", bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let readback = ReadbackBuffer::new(gpu, "readback", bytes);
        let buffers = [input.as_entire_binding(), output.as_entire_binding()];
        let group = bind_group(gpu, "half", &pipeline.get_bind_group_layout(0), &buffers);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(1024, (values.len() / 65536) as u32, 1);
        }
        readback.copy(&mut encoder, &output, bytes);
        let submission = gpu.queue.submit([encoder.finish()]);
        readback.map();
        gpu.wait(&submission).expect("the device");
        readback.read(|bytes| bytemuck::cast_slice(bytes).to_vec()).expect("halves")
    }

    /// Every half, every number half way between two, and their neighbours: zeros, subnormals, infinities and NaNs among them.
    #[test]
    fn halves_are_rounded_to_nearest_even() {
        let halves = (0..=u16::MAX).map(|bits| f16::from_bits(bits).to_f32().to_bits());
        // Half a step: the first bit that is rounded off, of the smallest half 2^-24 too.
        let midpoints = (0..=u16::MAX).map(|bits| {
            let [low, high] = [bits, bits.wrapping_add(1)].map(|bits| f16::from_bits(bits).to_f64());
            ((0.5 * (low + high)) as f32).to_bits()
        });
        let midpoints: Vec<u32> = midpoints.collect();
        let beside = |step: u32| midpoints.iter().map(move |bits| bits.wrapping_add(step));
        let spread = (0..=u16::MAX).map(|k| u32::from(k).wrapping_mul(0x1_0001).rotate_left(7));
        let mut values: Vec<u32> = halves.chain(midpoints.iter().copied()).collect();
        values.extend(beside(1).chain(beside(u32::MAX)).chain(spread));
        let gpu = Gpu::open(Some(&crate::gpu::adapter::adapter_of_tests())).expect("a device");
        let packed = half_bits(&gpu, &values);
        gpu.check().expect("no error");
        assert_eq!(packed.len(), 5 * 65536);
        for (bits, packed) in values.into_iter().zip(packed) {
            let expected = f16::from_f32(f32::from_bits(bits));
            let both_nan = expected.is_nan() && packed >> 16 == 0 && f16::from_bits(packed as u16).is_nan();
            assert!(
                both_nan || packed == u32::from(expected.to_bits()),
                "{bits:08x}: {packed:04x} instead of {:04x}",
                expected.to_bits()
            );
        }
    }
}
