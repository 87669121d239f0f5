//! Bytes from memory to textures of the device, without a copy on the way.

use std::ops::Range;

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// Bytes that are handed out as one; each row begins with some of its own.
pub const PAGE: usize = 4096;
const _: () = assert!(PAGE.is_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize));

/// A part of the room, which may be written on any thread.
pub type Page<'a> = wgpu::WriteOnly<'a, [u8; PAGE]>;

/// A buffer that the program writes rows of texels into and the device copies from.
#[derive(Debug)]
pub struct Staging {
    buffer: wgpu::Buffer,
    /// Pages of a row.
    pub row_pages: usize,
    /// The copy that was made from it last, until it is written again.
    copied: Option<wgpu::SubmissionIndex>,
}

impl Staging {
    /// Room for so many rows of so many bytes.
    #[must_use]
    pub fn new(gpu: &Gpu, label: &str, row_bytes: u32, rows: u32) -> Self {
        let row_pages = (row_bytes as usize).div_ceil(PAGE);
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: (row_pages * PAGE) as u64 * u64::from(rows),
            usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: true,
        });
        Self { buffer, row_pages, copied: None }
    }

    /// Whether it is made for so many rows of so many bytes.
    #[must_use]
    pub fn serves(&self, row_bytes: u32, rows: u32) -> bool {
        let row_pages = (row_bytes as usize).div_ceil(PAGE);
        row_pages == self.row_pages && self.buffer.size() == (row_pages * PAGE) as u64 * u64::from(rows)
    }

    /// Waits until the device has copied what was written last, which it must be set to, and lets `write` write anew: to the pages
    /// of the first row, then to those of the next.
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

    /// Sets the device to copy its first rows to these rows of a texture.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn copy(&mut self, gpu: &Gpu, texture: &wgpu::Texture, rows: Range<u32>) -> Result<()> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some((self.row_pages * PAGE) as u32),
            rows_per_image: None,
        };
        let to = wgpu::TexelCopyTextureInfo {
            origin: wgpu::Origin3d { x: 0, y: rows.start, z: 0 },
            ..texture.as_image_copy()
        };
        let size =
            wgpu::Extent3d { width: texture.width(), height: rows.len() as u32, depth_or_array_layers: 1 };
        encoder.copy_buffer_to_texture(wgpu::TexelCopyBufferInfo { buffer: &self.buffer, layout }, to, size);
        self.copied = Some(gpu.guard(|| gpu.queue.submit([encoder.finish()]))?);
        Ok(())
    }
}
