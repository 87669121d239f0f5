//! The resolve pass: samples to pixels, packed for reading back. `resolve.wgsl` states each plane's rule.

use wgpu::BufferUsages;

use super::BindLayouts;
use super::shaders::RESOLVE;
use super::targets::Targets;
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;

/// Display-linear value up to which the tone curve is the identity.
pub const TONE_KNEE: f64 = 0.85;
/// Display-linear value that endless light comes to: 249 of 255 after sRGB encoding.
pub const TONE_WHITE: f64 = 0.947_307;
/// Workgroups in a row of the dispatch, and invocations in a workgroup; both stand in `resolve.wgsl` too.
const ROW_WIDTH: u32 = 1024;
const GROUP_WIDTH: u32 = 64;

/// Factor on radiance at an exposure in stops.
#[must_use]
pub fn exposure(ev: f32) -> f32 {
    libm::exp2f(ev)
}

/// The tone curve on exposed radiance. Twin of `tone` in `common/tone.wgsl`.
#[must_use]
pub fn tone(x: f64) -> f64 {
    let room = TONE_WHITE - TONE_KNEE;
    if x <= TONE_KNEE { x } else { TONE_KNEE + room * (1.0 - libm::exp(-(x - TONE_KNEE) / room)) }
}

/// 8-bit sRGB value of a radiance at 0 EV.
#[must_use]
pub fn encoded(radiance: f64) -> f64 {
    let x = tone(radiance);
    255.0 * if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055 }
}

/// Pipeline of the pass.
#[derive(Debug)]
pub struct ResolvePass {
    pipeline: wgpu::ComputePipeline,
}

/// The packed result of one picture size.
#[derive(Debug)]
pub struct PackedFrame {
    size: [u32; 2],
    /// Written by the pass.
    pub buffer: wgpu::Buffer,
    readback: Readback,
}

impl ResolvePass {
    /// Compiles the pass.
    #[must_use]
    pub fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("resolve/layout"),
            bind_group_layouts: &[Some(&layouts.frame), None, Some(&layouts.resolve)],
            immediate_size: 0,
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("resolve"),
            layout: Some(&layout),
            module: &RESOLVE.compile(gpu),
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[("TONE_KNEE", TONE_KNEE), ("TONE_WHITE", TONE_WHITE)],
                ..Default::default()
            },
            cache: None,
        });
        Self { pipeline }
    }

    /// Records the pass.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        own: &wgpu::BindGroup,
        targets: &Targets,
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("resolve"),
            timestamp_writes: timestamps,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, own, &[]);
        let workgroups = (groups_of_four(targets.size) as u32).div_ceil(GROUP_WIDTH);
        pass.dispatch_workgroups(workgroups.min(ROW_WIDTH), workgroups.div_ceil(ROW_WIDTH), 1);
    }
}

fn groups_of_four([width, height]: [u32; 2]) -> u64 {
    (u64::from(width) * u64::from(height)).div_ceil(4)
}

impl PackedFrame {
    /// Room for a picture of this size.
    #[must_use]
    pub fn new(gpu: &Gpu, size: [u32; 2]) -> Self {
        let bytes = 16 * groups_of_four(size);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        Self {
            size,
            buffer: gpu.buffer("resolve/packed", bytes, usage),
            readback: Readback::new(gpu, "resolve/readback", bytes),
        }
    }

    /// Records the copy to where the program can read it.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        self.readback.copy(encoder, &self.buffer, 16 * groups_of_four(self.size));
    }

    /// Waits for the frame.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub fn read(&self, gpu: &Gpu) -> crate::Result<Frame> {
        let [width, height] = self.size;
        let pixels = width as usize * height as usize;
        let classes_at = 12 * groups_of_four(self.size) as usize;
        self.readback.read(gpu, |bytes| Frame {
            width,
            height,
            rgb: bytes[..3 * pixels].to_vec(),
            class: bytes[classes_at..classes_at + pixels].to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tone_curve_is_smooth_rises_and_ends_at_249() {
        assert!((tone(TONE_KNEE) - TONE_KNEE).abs() < 1e-12);
        let step = 1e-6;
        let slope = (tone(TONE_KNEE + step) - tone(TONE_KNEE)) / step;
        assert!((slope - 1.0).abs() < 1e-4, "{slope}");
        let mut last = -1.0;
        for i in 0..1000 {
            let value = encoded(f64::from(i) * 0.01);
            assert!(value >= last);
            last = value;
        }
        assert!((encoded(1e9) - 249.0).abs() < 0.01, "{}", encoded(1e9));
    }

    #[test]
    fn exposure_doubles_with_each_stop() {
        assert_eq!((exposure(0.0), exposure(1.0), exposure(-2.0)), (1.0, 2.0, 0.25));
    }
}
