//! Uploads to textures through a mapped staging buffer: texels are written where the device copies them from.

use crate::error::Result;
use crate::gpu::Gpu;

/// Rows of texels start at multiples of this, bytes.
pub const ROW_ALIGNMENT: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;

/// Size of a [`Page`], bytes.
pub const PAGE_BYTES: usize = 4096;
const _: () = assert!(PAGE_BYTES.is_multiple_of(ROW_ALIGNMENT));

/// Most bytes of a part that is uploaded while the device is idle.
const IDLE_PART_BYTES: usize = 4 << 20;
/// The size of a buffer for such parts is a multiple of this, bytes: frames differ a little in what they need.
const STEP_BYTES: usize = 4 << 20;

/// A part of a staging buffer that any one thread may write.
pub type Page<'a> = wgpu::WriteOnly<'a, [u8; PAGE_BYTES]>;

/// Writes rows of texels to a list of pages, from the first page on.
#[derive(Debug)]
pub struct PageWriter<'a> {
    pages: std::vec::IntoIter<Page<'a>>,
    /// The unwritten rest of the current page.
    rest: wgpu::WriteOnly<'a, [u8]>,
}

impl<'a> PageWriter<'a> {
    /// A writer to these pages.
    #[must_use]
    pub fn new(pages: Vec<Page<'a>>) -> Self {
        Self { pages: pages.into_iter(), rest: wgpu::WriteOnly::default() }
    }

    /// Writes a row and skips the padding behind it: the next row starts `row_bytes` after this one.
    pub fn write_row(&mut self, row: &[u8], row_bytes: usize) {
        let mut written = 0;
        while written < row_bytes {
            if self.rest.is_empty() {
                let Some(page) = self.pages.next() else { return };
                self.rest = page.into();
            }
            let end = row_bytes.min(written + self.rest.len());
            let mut target = self.rest.split_off(..end - written).unwrap_or_default();
            let bytes = &row[written.min(row.len())..end.min(row.len())];
            target.slice(..bytes.len()).copy_from_slice(bytes);
            written = end;
        }
    }
}

/// A buffer that the host writes texels into and the device copies from.
#[derive(Debug)]
pub struct StagingBuffer {
    buffer: wgpu::Buffer,
    /// The last copy from it, until it is mapped again.
    last_copy: Option<wgpu::SubmissionIndex>,
}

/// Staging buffers for uploads of two kinds, the first of which comes first in each frame.
///
/// Where the device works on a frame while the next is prepared, a copy waits for that frame: each kind has a buffer of its own, large
/// enough for most frames. Where the device is idle then, both share one buffer and are uploaded in small parts.
#[derive(Debug, Default)]
pub struct StagingBuffers {
    /// The device is idle while a frame is prepared.
    pub device_is_idle: bool,
    first: Option<StagingBuffer>,
    second: Option<StagingBuffer>,
}

impl StagingBuffers {
    /// The buffer for uploads of the first kind, and the most bytes of a part, at most `max_bytes`.
    pub const fn first(&mut self, max_bytes: usize) -> (&mut Option<StagingBuffer>, usize) {
        let part_bytes = self.part_bytes(max_bytes);
        (&mut self.first, part_bytes)
    }

    /// The same for uploads of the second kind.
    pub const fn second(&mut self, max_bytes: usize) -> (&mut Option<StagingBuffer>, usize) {
        let part_bytes = self.part_bytes(max_bytes);
        (if self.device_is_idle { &mut self.first } else { &mut self.second }, part_bytes)
    }

    /// Writes the first `size` columns and rows of a texture; `texels` are in row-major order. While the device is idle, in parts.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) or [`Error::Device`](crate::Error::Device).
    pub fn write_texels<T: bytemuck::NoUninit>(
        &mut self,
        gpu: &Gpu,
        texture: &wgpu::Texture,
        size: [u32; 2],
        texels: &[T],
    ) -> Result<()> {
        if !self.device_is_idle {
            return gpu.guard(|| gpu.write_texels(texture, size, texels));
        }
        let [width, height] = size;
        let row_bytes = (width as usize * size_of::<T>()).next_multiple_of(ROW_ALIGNMENT);
        let (staging, max_bytes) = self.first(IDLE_PART_BYTES);
        let rows_at_once = (max_bytes / row_bytes).max(1) as u32;
        for first in (0..height).step_by(rows_at_once as usize) {
            let rows = first..height.min(first + rows_at_once);
            let room = (rows.len() * row_bytes).next_multiple_of(STEP_BYTES);
            let staging = StagingBuffer::with_capacity(staging, gpu, "staging/texels", room)?;
            let texels = &texels[first as usize * width as usize..][..rows.len() * width as usize];
            staging.write(gpu, |pages| {
                let mut writer =
                    PageWriter::new(pages.take((rows.len() * row_bytes).div_ceil(PAGE_BYTES)).collect());
                for row in texels.chunks_exact(width as usize) {
                    writer.write_row(bytemuck::cast_slice(row), row_bytes);
                }
            })?;
            let size = [width, rows.len() as u32];
            let region = TextureRegion { offset_bytes: 0, row_bytes, origin: [0, first], size };
            staging.copy_to(gpu, texture, &[region])?;
        }
        Ok(())
    }

    /// Forgets the buffers, of which an error may have left one unusable.
    pub fn clear(&mut self) {
        (self.first, self.second) = (None, None);
    }

    const fn part_bytes(&self, max_bytes: usize) -> usize {
        if self.device_is_idle && max_bytes > IDLE_PART_BYTES { IDLE_PART_BYTES } else { max_bytes }
    }
}

/// A rectangle of a texture and where its texels lie in the staging buffer.
#[derive(Clone, Copy, Debug)]
pub struct TextureRegion {
    /// Offset of the first texel, bytes.
    pub offset_bytes: usize,
    /// Distance from one row to the next, bytes: a multiple of [`ROW_ALIGNMENT`].
    pub row_bytes: usize,
    /// Column and row of its first texel in the texture.
    pub origin: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

impl StagingBuffer {
    /// The buffer in `slot` if it holds `bytes`, else a new one, which replaces it.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) or [`Error::Device`](crate::Error::Device), also when the device is out of memory.
    pub fn with_capacity<'a>(
        slot: &'a mut Option<Self>,
        gpu: &Gpu,
        label: &str,
        bytes: usize,
    ) -> Result<&'a mut Self> {
        let is_large_enough = |staging: &Self| staging.buffer.size() >= bytes as u64;
        match slot.take().filter(is_large_enough) {
            Some(staging) => Ok(slot.insert(staging)),
            None => {
                let descriptor = wgpu::BufferDescriptor {
                    label: Some(label),
                    size: bytes.next_multiple_of(PAGE_BYTES) as u64,
                    usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: true,
                };
                let buffer = gpu.guard(|| gpu.device.create_buffer(&descriptor))?;
                gpu.check()?;
                Ok(slot.insert(Self { buffer, last_copy: None }))
            }
        }
    }

    /// Waits until the device has finished the last copy, then lets `write` fill the pages, from the first on.
    ///
    /// Each write must be followed by a [`Self::copy_to`], or the next write cannot map the buffer.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) or [`Error::Device`](crate::Error::Device).
    pub fn write<T>(
        &mut self,
        gpu: &Gpu,
        write: impl FnOnce(&mut dyn Iterator<Item = Page<'_>>) -> T,
    ) -> Result<T> {
        if let Some(last_copy) = self.last_copy.take() {
            gpu.guard(|| self.buffer.map_async(wgpu::MapMode::Write, .., |_| {}))?;
            gpu.wait(&last_copy)?;
        }
        let result = {
            let view = self.buffer.get_mapped_range_mut(..);
            let mut view = view.map_err(|error| gpu.failure(&error))?;
            write(&mut view.slice(..).into_chunks().0.into_iter())
        };
        self.buffer.unmap();
        Ok(result)
    }

    /// Submits the copy of regions to a texture.
    ///
    /// # Errors
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) or [`Error::Device`](crate::Error::Device).
    pub fn copy_to(&mut self, gpu: &Gpu, texture: &wgpu::Texture, regions: &[TextureRegion]) -> Result<()> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for region in regions {
            copy_to_texture(&mut encoder, &self.buffer, texture, region);
        }
        self.last_copy = Some(gpu.guard(|| gpu.queue.submit([encoder.finish()]))?);
        Ok(())
    }
}

/// Records the copy of a region of a buffer to a texture.
pub fn copy_to_texture(
    encoder: &mut wgpu::CommandEncoder,
    buffer: &wgpu::Buffer,
    texture: &wgpu::Texture,
    region: &TextureRegion,
) {
    let layout = wgpu::TexelCopyBufferLayout {
        offset: region.offset_bytes as u64,
        bytes_per_row: Some(region.row_bytes as u32),
        rows_per_image: None,
    };
    let ([x, y], [width, height]) = (region.origin, region.size);
    let origin = wgpu::Origin3d { x, y, z: 0 };
    let to = wgpu::TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
    let from = wgpu::TexelCopyBufferInfo { buffer, layout };
    encoder.copy_buffer_to_texture(from, to, wgpu::Extent3d { width, height, depth_or_array_layers: 1 });
}
