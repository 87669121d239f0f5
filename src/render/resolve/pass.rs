//! The resolve pass: samples to pixels, packed for reading back. `resolve.wgsl` states each plane's rule.

use wgpu::BufferUsages;

use crate::class::ClassId;
use crate::error::Result;
use crate::frame::{Annotation, Annotations, Frame};
use crate::gpu::Gpu;
use crate::gpu::readback::ReadbackBuffer;
use crate::render::device::bind_groups::BindLayouts;
use crate::render::device::packing::{Packing, WORKGROUP_SIZE};
use crate::render::device::shader_programs::RESOLVE;
use crate::render::lighting::gbuffer::GBuffer;
use crate::render::resolve::tile_list::{SkyStencil, TileList};

/// Display-linear value up to which the tone curve is the identity.
pub const TONE_KNEE: f64 = 0.85;
/// Display-linear value that endless light comes to: 249 of 255 after sRGB encoding.
pub const TONE_WHITE: f64 = 0.947_307;
/// Workgroups in a row of the dispatch; stands in `resolve.wgsl` too.
const ROW_WIDTH: u32 = 1024;

/// Factor on radiance at an exposure in stops.
#[must_use]
pub fn exposure(ev: f32) -> f32 {
    libm::exp2f(ev)
}

/// The tone curve on the largest channel of exposed radiance. Twin of `tone` in `common/tone.wgsl`.
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

/// Pipelines of the pass.
#[derive(Debug)]
pub struct ResolvePass {
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    /// For each variant that was needed so far.
    pipelines: Vec<(Variant, wgpu::ComputePipeline)>,
}

/// What a pipeline of the pass is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    samples_per_side: u32,
    annotated: bool,
    distorted: bool,
    listed: bool,
}

impl Variant {
    /// For samples of these targets and a picture of this size: smaller where a lens distorts it.
    #[must_use]
    pub fn new(gbuffer: &GBuffer, picture_size: [u32; 2]) -> Self {
        let distorted = gbuffer.size != picture_size;
        Self {
            samples_per_side: gbuffer.samples_per_side,
            annotated: gbuffer.annotations != Annotations::default(),
            distorted,
            listed: gbuffer.layout.has_host_stencil && !distorted,
        }
    }
}

/// The packed result of one picture size.
#[derive(Debug)]
pub struct PackedFrame {
    /// Pixels of the picture.
    pub size: [u32; 2],
    packing: Packing,
    /// Written by the pass.
    pub buffer: wgpu::Buffer,
    readback: ReadbackBuffer,
    tiles: TileList,
    /// Indices of the tiles that are resolved.
    pub list: wgpu::Buffer,
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
        Self { module: RESOLVE.compile(gpu), layout, pipelines: Vec::new() }
    }

    /// Makes the pipeline, unless it is there.
    pub fn prepare(&mut self, gpu: &Gpu, wanted: Variant) {
        if self.pipelines.iter().any(|(made, _)| *made == wanted) {
            return;
        }
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("resolve"),
            layout: Some(&self.layout),
            module: &self.module,
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[
                    ("TONE_KNEE", TONE_KNEE),
                    ("TONE_WHITE", TONE_WHITE),
                    ("SAMPLES_PER_SIDE", f64::from(wanted.samples_per_side)),
                    ("HAS_ANNOTATIONS", f64::from(u8::from(wanted.annotated))),
                    ("HAS_LENS_DISTORTION", f64::from(u8::from(wanted.distorted))),
                    ("USES_TILE_LIST", f64::from(u8::from(wanted.listed))),
                ],
                ..Default::default()
            },
            cache: gpu.pipeline_cache(),
        });
        self.pipelines.push((wanted, pipeline));
    }

    /// Records the pass.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        own: &wgpu::BindGroup,
        gbuffer: &GBuffer,
        packed: &PackedFrame,
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("resolve"),
            timestamp_writes: timestamps,
        });
        let wanted = Variant::new(gbuffer, packed.size);
        let made = self.pipelines.iter().find(|(made, _)| *made == wanted);
        pass.set_pipeline(&made.expect("a pipeline is prepared before it is used").1);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, own, &[]);
        let [columns, rows] = dispatched(packed.tiles.resolved.len());
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

/// Columns and rows of a dispatch of so many workgroups and maybe some more.
fn dispatched(workgroups: usize) -> [u32; 2] {
    let count = workgroups as u32;
    [count.min(ROW_WIDTH), count.div_ceil(ROW_WIDTH)]
}

/// How long a list of so many is with those that are dispatched for none of them.
fn list_len(workgroups: usize) -> u64 {
    dispatched(workgroups).map(u64::from).iter().product()
}

impl PackedFrame {
    /// Room for a picture of this size with these annotations.
    #[must_use]
    pub fn new(gpu: &Gpu, size: [u32; 2], annotations: Annotations) -> Self {
        let packing = Packing::new(size, annotations);
        let all = TileList::new(size, None).resolved.len();
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        Self {
            size,
            packing,
            buffer: gpu.buffer("resolve/packed", packing.bytes(), usage),
            readback: ReadbackBuffer::new(gpu, "resolve/readback", packing.bytes()),
            tiles: TileList::default(),
            list: gpu.buffer(
                "resolve/list",
                4 * list_len(all),
                BufferUsages::STORAGE | BufferUsages::COPY_DST,
            ),
        }
    }

    /// Lists the tiles to resolve: all of them, unless the host knows the stencil of an undistorted image. Returns the bytes that
    /// were uploaded.
    pub fn choose(&mut self, gpu: &Gpu, gbuffer: &GBuffer) -> u64 {
        let is_listed = Variant::new(gbuffer, self.size).listed;
        let sky = gbuffer.host_stencil.as_deref().zip(gbuffer.background.as_ref());
        let sky = sky.map(|(stencil, background)| SkyStencil {
            stencil,
            dome: background.stencil,
            samples_per_side: gbuffer.samples_per_side as usize,
        });
        self.tiles = TileList::new(self.size, sky.filter(|_| is_listed));
        if !is_listed {
            return 0;
        }
        // Beyond the last of the list there are none of the picture.
        let mut list = self.tiles.resolved.clone();
        list.resize(list_len(list.len()) as usize, u32::MAX / WORKGROUP_SIZE);
        gpu.queue.write_buffer(&self.list, 0, bytemuck::cast_slice(&list));
        4 * list.len() as u64
    }

    /// Whether it serves a picture of this size with these annotations.
    #[must_use]
    pub fn serves(&self, size: [u32; 2], annotations: Annotations) -> bool {
        (self.size, self.packing.annotations()) == (size, annotations)
    }

    /// Records the copy to where the program can read it.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        self.readback.copy(encoder, &self.buffer, self.packing.bytes());
    }

    /// Waits for the frame.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::error::Error::DeviceLost) or [`Error::Device`](crate::error::Error::Device).
    pub fn read(&self, gpu: &Gpu, submission: &wgpu::SubmissionIndex) -> Result<Frame> {
        let [width, height] = self.size;
        let pixels = width as usize * height as usize;
        let classes_at = 12 * self.packing.quads() as usize;
        self.readback.read(gpu, submission, |bytes| {
            let words = |annotation: Annotation| {
                let range = self.packing.words(annotation).unwrap_or(0..0);
                bytes[4 * range.start as usize..4 * range.end as usize]
                    .chunks_exact(4)
                    .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
            };
            let class = bytes[classes_at..classes_at + pixels].to_vec();
            let depth = |(word, class): (u32, &u8)| {
                if *class == ClassId::SKY.0 { f32::INFINITY } else { f32::from_bits(word) }
            };
            let half = |bits: u32| half::f16::from_bits(bits as u16);
            let mut frame = Frame {
                width,
                height,
                focal_px: 0.0,
                rgb: bytes[..3 * pixels].to_vec(),
                depth_m: words(Annotation::Depth).zip(&class).map(depth).collect(),
                normals: words(Annotation::Normals).map(f32::from_bits).collect(),
                instances: words(Annotation::Instances).map(|word| word as u16).collect(),
                sun_occlusion: words(Annotation::Shadow).map(|word| word as u8).collect(),
                radiance: words(Annotation::Hdr)
                    .enumerate()
                    // Red and green share a word, blue has one with an empty half.
                    .flat_map(|(i, word)| [Some(half(word)), (i % 2 == 0).then(|| half(word >> 16))])
                    .flatten()
                    .collect(),
                sample_counts: words(Annotation::Coverage)
                    .map(|word| [word as u8, (word >> 8) as u8, (word >> 16) as u8])
                    .collect(),
                class,
                ..Frame::default()
            };
            let tiles = &self.tiles;
            tiles.spread(&mut frame.rgb, 3);
            tiles.spread(&mut frame.class, 1);
            tiles.spread(&mut frame.depth_m, 1);
            tiles.spread(&mut frame.normals, 3);
            tiles.spread(&mut frame.instances, 1);
            tiles.spread(&mut frame.sun_occlusion, 1);
            tiles.spread(&mut frame.radiance, 3);
            tiles.spread(&mut frame.sample_counts, 1);
            frame
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
