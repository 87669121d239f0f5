//! The G-buffer: the textures at sample resolution that visibility and lighting write. The formats of the planes that
//! lighting writes are in the table [`SAMPLE_PLANES`].

use std::ops::Range;

use wgpu::{TextureFormat, TextureUsages};

use crate::frame::Annotations;
use crate::gpu::Gpu;
use crate::render::device::planes::{SAMPLE_PLANES, SamplePlaneRow, storage};
use crate::render::select::draw_list::DrawBatch;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::settings::RenderSettings;

/// Format of the visibility texture (`visibility.wgsl` has its layout).
pub(crate) const VISIBILITY_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Maximum code of a coordinate of a normal there: 24 bits. `common/octahedral.wgsl` has the same.
pub(in crate::render) const MAX_NORMAL_CODE: u32 = 0x00ff_ffff;
/// Format of the ground's detail below its mesh: slope, rise per metre along x and y; factor on the albedo; fraction of the sun's
/// disc that grains leave visible.
pub(crate) const SLOPES_FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// Bytes that a compute pass that rasterises keeps of each sample beside the G-buffer, in place of depth.
pub(in crate::render) const NEAREST_BYTES: u64 = 8;

/// How the textures are filled, which their usages and formats depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GBufferLayout {
    /// Usage through which visibility and stencil are written.
    pub write_usage: TextureUsages,
    /// Format of depth, stencil or both: depth where a render pass rasterises visibility, a stencil where it selects the samples of a
    /// shading bin. None where a compute pass rasterises.
    pub depth_stencil_format: Option<TextureFormat>,
    /// A compute pass writes the planes, which are storage textures then.
    pub is_computed: bool,
    /// There are slopes of the relief below the mesh.
    pub has_slopes: bool,
    /// The stencil is known to the host too.
    pub has_host_stencil: bool,
}

impl GBufferLayout {
    /// Bytes of a sample in all textures of a G-buffer with these annotations.
    #[must_use]
    pub fn bytes_per_sample(&self, annotations: Annotations) -> u64 {
        let planes =
            SAMPLE_PLANES.iter().filter(|row| row.plane.is_needed(annotations)).map(|row| self.format(row));
        let slopes = self.has_slopes.then_some(SLOPES_FORMAT);
        let copied = planes.chain([VISIBILITY_FORMAT]).chain(slopes);
        let copied: u64 = copied.map(|format| u64::from(format.block_copy_size(None).unwrap_or(0))).sum();
        let depth_stencil = match self.depth_stencil_format {
            None => 0,
            Some(TextureFormat::Stencil8) => 1,
            Some(TextureFormat::Depth32Float) => 4,
            Some(_) => 8,
        };
        copied + depth_stencil + self.nearest_bytes()
    }

    /// Bytes that a compute pass that rasterises keeps of each sample beside the textures; 0 where none does.
    pub(crate) const fn nearest_bytes(&self) -> u64 {
        if self.depth_stencil_format.is_none() { NEAREST_BYTES } else { 0 }
    }

    /// Format of a plane.
    pub(crate) const fn format(&self, row: &SamplePlaneRow) -> TextureFormat {
        if self.is_computed { storage::format(row) } else { row.format }
    }

    /// The format with the stencil that selects samples, if there is one.
    #[must_use]
    pub fn stencil_format(&self) -> Option<TextureFormat> {
        self.depth_stencil_format.filter(TextureFormat::has_stencil_aspect)
    }
}

/// The textures of one image size, and what is known about their content.
#[derive(Debug)]
pub struct GBuffer {
    /// Pixels of the image.
    pub size: [u32; 2],
    /// Samples along a side of a pixel.
    pub samples_per_side: u32,
    /// Columns and rows of samples.
    pub sample_size: [u32; 2],
    /// Columns and rows of the textures, whose first ones the samples are.
    capacity: [u32; 2],
    /// Annotations that are rendered.
    pub annotations: Annotations,
    /// How it is filled.
    pub layout: GBufferLayout,
    /// One view for each plane, as in [`SAMPLE_PLANES`]; of a single sample where the plane is not rendered.
    pub planes: [wgpu::TextureView; SAMPLE_PLANES.len()],
    /// The visible surface at each sample: instance, normals, inverse depth.
    pub visibility: (wgpu::Texture, wgpu::TextureView),
    /// Slopes of the relief below the mesh, where the host computes them. Without them the lighting pass does.
    pub slopes: Option<(wgpu::Texture, wgpu::TextureView)>,
    /// The stencil holds one more than the shading bin of each sample, 0 where there is no surface. Of a single sample where there is
    /// neither depth nor stencil.
    pub depth_stencil: (wgpu::Texture, wgpu::TextureView),
    /// The same in host memory, row by row, if it is known there.
    pub host_stencil: Option<Vec<u8>>,
    /// Rows of `visibility` that may hold anything but zeros, if it is written by upload.
    pub written_rows: Range<u32>,
    /// The shading bins that samples are in.
    pub batches: Vec<DrawBatch>,
    /// Value in the host's stencil of the samples of the sky's dome, which all have the same values in every plane.
    pub dome_stencil: Option<u8>,
    /// A lens distorts the image: the samples are those of the image before.
    pub is_distorted: bool,
    /// The 8-bit image is resolved: no sensor replaces it.
    pub has_rgb: bool,
    /// Bound where there are no slopes.
    no_slopes: wgpu::TextureView,
}

impl GBuffer {
    /// Textures of this many columns and rows for an image, or for a tile of one, with these settings. They must be within the
    /// device's limits.
    #[must_use]
    fn new(gpu: &Gpu, settings: &RenderSettings, layout: GBufferLayout, capacity: [u32; 2]) -> Self {
        let &RenderSettings { size, samples_per_side, annotations, .. } = settings;
        let written = if layout.is_computed {
            TextureUsages::STORAGE_BINDING
        } else {
            TextureUsages::RENDER_ATTACHMENT
        };
        let planes = written | TextureUsages::TEXTURE_BINDING;
        let uploaded = TextureUsages::COPY_DST | TextureUsages::TEXTURE_BINDING;
        // Depth cannot be stored to.
        let depth_usage = layout.write_usage - TextureUsages::STORAGE_BINDING;
        Self {
            size,
            samples_per_side,
            sample_size: settings.sample_size(),
            capacity,
            annotations,
            layout,
            planes: SAMPLE_PLANES.map(|row| {
                let size = if row.plane.is_needed(annotations) { capacity } else { [1, 1] };
                gpu.texture(&format!("gbuffer/{}", row.name), size, layout.format(&row), planes).1
            }),
            visibility: gpu.texture(
                "gbuffer/visibility",
                capacity,
                VISIBILITY_FORMAT,
                layout.write_usage | TextureUsages::TEXTURE_BINDING,
            ),
            slopes: layout
                .has_slopes
                .then(|| gpu.texture("gbuffer/slopes", capacity, SLOPES_FORMAT, uploaded)),
            depth_stencil: gpu.texture(
                "gbuffer/depth_stencil",
                layout.depth_stencil_format.map_or([1, 1], |_| capacity),
                layout.depth_stencil_format.unwrap_or(TextureFormat::Depth32Float),
                depth_usage | TextureUsages::RENDER_ATTACHMENT,
            ),
            host_stencil: layout.has_host_stencil.then(Vec::new),
            written_rows: 0..0,
            batches: Vec::new(),
            dome_stencil: None,
            is_distorted: false,
            has_rgb: true,
            no_slopes: gpu.texture("gbuffer/no_slopes", [1, 1], SLOPES_FORMAT, uploaded).1,
        }
    }

    /// Bytes of its textures.
    fn bytes(&self) -> u64 {
        self.capacity.map(u64::from).iter().product::<u64>() * self.layout.bytes_per_sample(self.annotations)
    }

    /// Whether it has the samples of these settings, in textures that are not much too large.
    fn serves(&self, settings: &RenderSettings, layout: GBufferLayout) -> bool {
        let area = |[width, height]: [u32; 2]| u64::from(width) * u64::from(height);
        let needed = settings.sample_size();
        (self.samples_per_side, self.annotations, self.layout)
            == (settings.samples_per_side, settings.annotations, layout)
            && self.capacity.iter().zip(needed).all(|(has, needed)| *has >= needed)
            && (self.capacity == needed || area(self.capacity) <= 2 * area(needed))
    }

    /// Gives it the samples of an image of another size, which it has room for.
    fn resize(&mut self, settings: &RenderSettings) {
        self.size = settings.size;
        let before = std::mem::replace(&mut self.sample_size, settings.sample_size());
        if before != self.sample_size {
            // Of rows that were longer.
            self.written_rows = 0..self.sample_size[1];
        }
    }

    /// The rows of a plane with a value for each sample, padded to those of the textures: copies to a stencil are of all of it.
    pub(crate) fn padded<T: Copy + Default>(&self, samples: &[T]) -> Option<Vec<T>> {
        let [columns, rows] = self.capacity.map(|side| side as usize);
        if self.capacity == self.sample_size {
            return None;
        }
        let mut padded = vec![T::default(); columns * rows];
        let width = self.sample_size[0] as usize;
        for (padded, samples) in padded.chunks_exact_mut(columns).zip(samples.chunks_exact(width)) {
            padded[..width].copy_from_slice(samples);
        }
        Some(padded)
    }

    /// Columns and rows of the textures.
    pub(crate) const fn capacity(&self) -> [u32; 2] {
        self.capacity
    }

    /// Limits a pass to its samples.
    pub(crate) fn set_viewport(&self, pass: &mut wgpu::RenderPass<'_>) {
        let [width, height] = self.sample_size.map(|side| side as f32);
        pass.set_viewport(0.0, 0.0, width, height, 0.0, 1.0);
    }

    /// Limits the draw of the dome to these rows of pixels, where the host knows the samples that show it.
    pub fn limit_dome(&mut self, rows: Range<u32>) {
        let (Some(dome), Some(stencil)) = (self.dome_stencil, &self.host_stencil) else { return };
        let [width, height] = self.sample_size;
        let samples =
            (rows.start * self.samples_per_side).min(height)..(rows.end * self.samples_per_side).min(height);
        let mut with_dome = samples.filter(|row| {
            let first = *row as usize * width as usize;
            stencil[first..first + width as usize].contains(&dome)
        });
        let first = with_dome.next();
        let last = with_dome.next_back().or(first);
        let bounds = first.zip(last).map_or(ScreenBounds::EMPTY, |(first, last)| {
            ScreenBounds::of_samples((0, width as i32 - 1), (first as i32, last as i32))
        });
        self.batches.retain_mut(|batch| {
            let is_dome = batch.bin + 1 == dome;
            if is_dome {
                batch.bounds = bounds;
            }
            !is_dome || bounds != ScreenBounds::EMPTY
        });
    }

    /// The slopes as the lighting pass binds them: a single sample where there are none.
    #[must_use]
    pub fn slopes_view(&self) -> &wgpu::TextureView {
        self.slopes.as_ref().map_or(&self.no_slopes, |(_, view)| view)
    }
}

/// The sides of textures for images that a lens distorts are multiples of a power of two, which is this part of them or less: where each
/// frame has a lens of its own, each has a size of its own, and yet they share textures.
const CAPACITY_STEPS: u32 = 8;

/// G-buffers that are kept.
const MAX_KEPT: usize = 2;

/// The G-buffers of the last frames: where two sizes alternate, none is made again for each frame.
#[derive(Debug, Default)]
pub(crate) struct GBufferPool {
    /// Those that are not in use, the oldest first.
    kept: Vec<GBuffer>,
}

impl GBufferPool {
    /// A G-buffer that serves these settings: a kept one, or a new one in place of the oldest if there are enough or all would
    /// take more than `max_bytes`.
    pub(crate) fn take(
        &mut self,
        gpu: &Gpu,
        (settings, is_distorted): (&RenderSettings, bool),
        layout: GBufferLayout,
        max_bytes: u64,
    ) -> GBuffer {
        if let Some(index) = self.kept.iter().position(|kept| kept.serves(settings, layout)) {
            let mut gbuffer = self.kept.remove(index);
            gbuffer.resize(settings);
            return gbuffer;
        }
        let side_limit = gpu.device.limits().max_texture_dimension_2d;
        let capacity = settings.sample_size().map(|side| {
            let step = if is_distorted { (side / (2 * CAPACITY_STEPS) + 1).next_power_of_two() } else { 1 };
            side.next_multiple_of(step).min(side_limit.max(side))
        });
        let samples: u64 = capacity.map(u64::from).iter().product();
        let needed = samples * layout.bytes_per_sample(settings.annotations);
        let has_room = |kept: &[GBuffer]| {
            kept.len() < MAX_KEPT && needed + kept.iter().map(GBuffer::bytes).sum::<u64>() <= max_bytes
        };
        while !self.kept.is_empty() && !has_room(&self.kept) {
            self.kept.remove(0);
        }
        GBuffer::new(gpu, settings, layout, capacity)
    }

    /// Keeps one for later frames. Those that the device still reads may be taken: it works in order.
    pub(crate) fn keep(&mut self, gbuffer: GBuffer) {
        self.kept.push(gbuffer);
    }

    /// The visibility textures of those that are kept.
    #[cfg(test)]
    pub(crate) fn textures(&self) -> Vec<wgpu::Texture> {
        self.kept.iter().map(|kept| kept.visibility.0.clone()).collect()
    }
}
