//! Bytes from memory to textures of the device, without a copy on the way.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// Rows of texels begin at multiples of this, bytes.
pub const ROW_ALIGNMENT: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;

/// Bytes that are handed out as one.
pub const PAGE: usize = 4096;
const _: () = assert!(PAGE.is_multiple_of(ROW_ALIGNMENT));

/// A part of the room, which may be written on any thread.
pub type Page<'a> = wgpu::WriteOnly<'a, [u8; PAGE]>;

/// Writes to pages, one after the other.
#[derive(Debug)]
pub struct Writer<'a> {
    pages: std::vec::IntoIter<Page<'a>>,
    /// What is left of the page that was begun.
    rest: wgpu::WriteOnly<'a, [u8]>,
}

impl<'a> Writer<'a> {
    /// To these pages.
    #[must_use]
    pub fn new(pages: Vec<Page<'a>>) -> Self {
        Self { pages: pages.into_iter(), rest: wgpu::WriteOnly::default() }
    }

    /// Writes a row, and leaves what is between it and the next, which begins so many bytes after it.
    pub fn row(&mut self, row: &[u8], row_bytes: usize) {
        let mut written = 0;
        while written < row_bytes {
            if self.rest.is_empty() {
                let Some(page) = self.pages.next() else { return };
                self.rest = page.into();
            }
            let end = row_bytes.min(written + self.rest.len());
            let mut there = self.rest.split_off(..end - written).unwrap_or_default();
            let bytes = &row[written.min(row.len())..end.min(row.len())];
            there.slice(..bytes.len()).copy_from_slice(bytes);
            written = end;
        }
    }
}

/// A buffer that the program writes texels into and the device copies from.
#[derive(Debug)]
pub struct Staging {
    buffer: wgpu::Buffer,
    /// The copy that was made from it last, until it is written again.
    copied: Option<wgpu::SubmissionIndex>,
}

/// A part of a texture, and where its texels stand.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Of the first texel.
    pub offset_bytes: usize,
    /// From a row to the next: a multiple of [`ROW_ALIGNMENT`].
    pub row_bytes: usize,
    /// Column and row of the texture where it begins.
    pub corner: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

impl Staging {
    /// Keeps one that has room for so many bytes, or makes it so.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`], as where the device has not so much memory.
    pub fn with_room<'a>(
        kept: &'a mut Option<Self>,
        gpu: &Gpu,
        label: &str,
        bytes: usize,
    ) -> Result<&'a mut Self> {
        let serves = |staging: &Self| staging.buffer.size() >= bytes as u64;
        match kept.take().filter(serves) {
            Some(staging) => Ok(kept.insert(staging)),
            None => {
                let descriptor = wgpu::BufferDescriptor {
                    label: Some(label),
                    size: bytes.next_multiple_of(PAGE) as u64,
                    usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: true,
                };
                let buffer = gpu.guard(|| gpu.device.create_buffer(&descriptor))?;
                gpu.check()?;
                Ok(kept.insert(Self { buffer, copied: None }))
            }
        }
    }

    /// Waits until the device has copied what was written last, which it must be set to, and lets `write` write anew, from the
    /// first page on.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn write<T>(
        &mut self,
        gpu: &Gpu,
        write: impl FnOnce(&mut dyn Iterator<Item = Page<'_>>) -> T,
    ) -> Result<T> {
        if let Some(copied) = self.copied.take() {
            gpu.guard(|| self.buffer.map_async(wgpu::MapMode::Write, .., |_| {}))?;
            gpu.wait(&copied)?;
        }
        let result = {
            let mut view =
                self.buffer.get_mapped_range_mut(..).map_err(|e| Error::DeviceLost(e.to_string()))?;
            write(&mut view.slice(..).into_chunks().0.into_iter())
        };
        self.buffer.unmap();
        Ok(result)
    }

    /// Sets the device to copy parts of a texture.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn copy(&mut self, gpu: &Gpu, texture: &wgpu::Texture, parts: &[Part]) -> Result<()> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for part in parts {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: part.offset_bytes as u64,
                bytes_per_row: Some(part.row_bytes as u32),
                rows_per_image: None,
            };
            let ([x, y], [width, height]) = (part.corner, part.size);
            let to = wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d { x, y, z: 0 },
                ..texture.as_image_copy()
            };
            let from = wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout };
            let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
            encoder.copy_buffer_to_texture(from, to, size);
        }
        self.copied = Some(gpu.guard(|| gpu.queue.submit([encoder.finish()]))?);
        Ok(())
    }
}
