//! The resolve pass: samples to pixels, packed for the readback. `resolve.wgsl` states the rules, the table in
//! `crate::render::device::planes` those of each plane.

use wgpu::BufferUsages;

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::{Annotations, Frame};
use crate::gpu::Gpu;
use crate::gpu::readback::ReadbackBuffer;
use crate::render::device::bind_groups::{BindLayouts, bind_group};
use crate::render::device::packing::{Packing, WORKGROUP_SIZE};
use crate::render::device::planes::{packed_planes, request_override};
use crate::render::device::shader_programs::{ParsedProgram, RESOLVE, TextOptions};
use crate::render::lighting::gbuffer::GBuffer;
use crate::render::resolve::tile_list::{SkyStencil, TileList};
use crate::render::resolve::tone::{TONE_KNEE, TONE_WHITE};
use crate::render::resolve::unpack::unpack;

/// Workgroups per row of the dispatch; `resolve.wgsl` has the same constant.
const DISPATCH_WIDTH: u32 = 1024;

/// The pass with its compiled pipelines.
#[derive(Debug)]
pub struct ResolvePass {
    program: ParsedProgram,
    layout: wgpu::PipelineLayout,
    /// One for each variant that was used.
    pipelines: Vec<(Variant, wgpu::ComputePipeline)>,
}

/// Constants that a pipeline is specialised for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    samples_per_side: u32,
    annotations: Annotations,
    has_rgb: bool,
    has_lens_distortion: bool,
    uses_tile_list: bool,
}

impl Variant {
    /// For an image from the samples of a G-buffer.
    #[must_use]
    pub fn new(gbuffer: &GBuffer) -> Self {
        let has_lens_distortion = gbuffer.is_distorted;
        Self {
            samples_per_side: gbuffer.samples_per_side,
            annotations: gbuffer.annotations,
            has_rgb: gbuffer.has_rgb,
            has_lens_distortion,
            uses_tile_list: gbuffer.layout.has_host_stencil && !has_lens_distortion,
        }
    }

    /// Values of the overrides in `resolve.wgsl`, by name.
    fn constants(self) -> Vec<(String, f64)> {
        let flag = |is_set: bool| f64::from(u8::from(is_set));
        let of_pass = [
            ("TONE_KNEE", TONE_KNEE),
            ("TONE_WHITE", TONE_WHITE),
            ("SAMPLES_PER_SIDE", f64::from(self.samples_per_side)),
            ("HAS_ANNOTATIONS", flag(self.annotations != Annotations::default())),
            ("HAS_RGB", flag(self.has_rgb)),
            ("HAS_LENS_DISTORTION", flag(self.has_lens_distortion)),
            ("USES_TILE_LIST", flag(self.uses_tile_list)),
        ];
        let of_planes =
            packed_planes().map(|(plane, _)| (request_override(plane), flag(plane.is_in(self.annotations))));
        of_pass.into_iter().map(|(name, value)| (name.to_owned(), value)).chain(of_planes).collect()
    }
}

impl ResolvePass {
    /// Parses the program.
    #[must_use]
    pub fn new(gpu: &Gpu, layouts: &BindLayouts) -> Self {
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("resolve/layout"),
            bind_group_layouts: &[Some(&layouts.frame), None, Some(&layouts.resolve)],
            immediate_size: 0,
        });
        Self { program: RESOLVE.parse(TextOptions::default()), layout, pipelines: Vec::new() }
    }

    /// Compiles the pipeline of a variant, unless there is one.
    pub fn prepare(&mut self, gpu: &Gpu, variant: Variant) {
        if self.pipelines.iter().any(|(compiled, _)| *compiled == variant) {
            return;
        }
        let constants = variant.constants();
        let constants: Vec<_> = constants.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("resolve"),
            layout: Some(&self.layout),
            module: &self.program.specialise(gpu, &["cs_main"], &constants),
            entry_point: Some("cs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: gpu.pipeline_cache(),
        });
        self.pipelines.push((variant, pipeline));
    }

    /// Bind group 2 of the pass.
    pub fn bind_group(
        gpu: &Gpu,
        layouts: &BindLayouts,
        (gbuffer, packed): (&GBuffer, &PackedFrame),
        nearest: wgpu::BindingResource<'_>,
    ) -> wgpu::BindGroup {
        let view = wgpu::BindingResource::TextureView;
        let lists = [packed.buffer.as_entire_binding(), nearest, packed.tile_list.as_entire_binding()];
        let planes = gbuffer.planes.iter().map(view);
        let resources: Vec<_> =
            [view(&gbuffer.visibility.1)].into_iter().chain(lists).chain(planes).collect();
        bind_group(gpu, "resolve", &layouts.resolve, &resources)
    }

    /// Records the pass.
    ///
    /// # Panics
    /// If the variant of this G-buffer and frame was not prepared.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        resolve_group: &wgpu::BindGroup,
        gbuffer: &GBuffer,
        packed: &PackedFrame,
        timestamps: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("resolve"),
            timestamp_writes: timestamps,
        });
        let variant = Variant::new(gbuffer);
        let pipeline = self.pipelines.iter().find(|(compiled, _)| *compiled == variant);
        pass.set_pipeline(&pipeline.expect("a pipeline is prepared before it is used").1);
        pass.set_bind_group(0, frame_group, &[]);
        pass.set_bind_group(2, resolve_group, &[]);
        let [columns, rows] = dispatch_size(packed.tiles.resolved.len());
        pass.dispatch_workgroups(columns, rows, 1);
    }
}

/// Columns and rows of a dispatch of at least `workgroups` workgroups.
fn dispatch_size(workgroups: usize) -> [u32; 2] {
    let count = workgroups as u32;
    [count.min(DISPATCH_WIDTH), count.div_ceil(DISPATCH_WIDTH)]
}

/// Length of the tile list for a number of workgroups: an entry for each one that is dispatched.
fn tile_list_len(workgroups: usize) -> u64 {
    dispatch_size(workgroups).map(u64::from).iter().product()
}

/// The packed planes of a frame: the buffer that the pass writes, and its way back to the host.
#[derive(Debug)]
pub struct PackedFrame {
    /// Columns and rows of the image.
    pub size: [u32; 2],
    packing: Packing,
    /// Written by the pass.
    pub buffer: wgpu::Buffer,
    readback: ReadbackBuffer,
    /// The tiles that the pass resolves.
    tiles: TileList,
    /// Indices of the workgroups in `tiles`.
    pub tile_list: wgpu::Buffer,
}

impl PackedFrame {
    /// Buffers for an image of this size with these annotations.
    #[must_use]
    pub fn new(gpu: &Gpu, size: [u32; 2], annotations: Annotations) -> Self {
        let packing = Packing::new(size, annotations);
        let all_tiles = TileList::new(size, None).resolved.len();
        Self {
            size,
            packing,
            buffer: gpu.buffer(
                "resolve/packed",
                packing.bytes(),
                BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            ),
            readback: ReadbackBuffer::new(gpu, "resolve/readback", packing.bytes()),
            tiles: TileList::default(),
            tile_list: gpu.buffer(
                "resolve/list",
                4 * tile_list_len(all_tiles),
                BufferUsages::STORAGE | BufferUsages::COPY_DST,
            ),
        }
    }

    /// Lists the tiles to resolve: all of them, unless the host knows the stencil of an undistorted image. Lighting then draws the
    /// sky's dome only where it is resolved. Returns the bytes that were uploaded.
    pub fn choose(&mut self, gpu: &Gpu, gbuffer: &mut GBuffer) -> u64 {
        let uses_tile_list = Variant::new(gbuffer).uses_tile_list;
        let sky = gbuffer.host_stencil.as_deref().zip(gbuffer.dome_stencil);
        let sky = sky.map(|(stencil, dome)| SkyStencil {
            stencil,
            dome,
            samples_per_side: gbuffer.samples_per_side as usize,
        });
        self.tiles = TileList::new(self.size, sky.filter(|_| uses_tile_list));
        if !uses_tile_list {
            return 0;
        }
        gbuffer.limit_dome(self.tiles.resolved_rows(self.size[0]));
        // The last row of the dispatch is filled up with a workgroup beyond the image, which does nothing.
        let mut list = self.tiles.resolved.clone();
        list.resize(tile_list_len(list.len()) as usize, u32::MAX / WORKGROUP_SIZE);
        gpu.queue.write_buffer(&self.tile_list, 0, bytemuck::cast_slice(&list));
        4 * list.len() as u64
    }

    /// Whether the buffers fit an image of this size with these annotations.
    #[must_use]
    pub fn serves(&self, size: [u32; 2], annotations: Annotations) -> bool {
        (self.size, self.packing.annotations()) == (size, annotations)
    }

    /// Records the copy to a buffer that the host can map.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        self.readback.copy(encoder, &self.buffer, self.packing.bytes());
    }

    /// Asks for the planes to be mapped once the device has finished what was submitted.
    pub fn map(&self) {
        self.readback.map();
    }

    /// Unpacks the frame, after [`Self::map`] and the wait for it.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], or [`Error::Unlabelled`] if a sample was written by no draw.
    pub fn read(&self) -> Result<Frame> {
        let frame = self.readback.read(|bytes| unpack(bytes, self.size, self.packing, &self.tiles))?;
        match frame.class.iter().position(|id| *id == ClassId::UNLABELLED.0) {
            None => Ok(frame),
            Some(first) => Err(Error::Unlabelled {
                pixels: frame.count(ClassId::UNLABELLED),
                column: first as u32 % frame.width,
                row: first as u32 / frame.width,
                frame: "a frame".to_owned(),
            }),
        }
    }
}
