//! Bytes from the device back to memory.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// A buffer that the device copies results into and the host maps.
#[derive(Debug)]
pub struct ReadbackBuffer {
    buffer: wgpu::Buffer,
}

impl ReadbackBuffer {
    /// A buffer with capacity for `bytes`.
    #[must_use]
    pub fn new(gpu: &Gpu, label: &str, bytes: u64) -> Self {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Self { buffer: gpu.buffer(label, bytes, usage) }
    }

    /// Records the copy of the first `bytes` of `source`.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder, source: &wgpu::Buffer, bytes: u64) {
        encoder.copy_buffer_to_buffer(source, 0, &self.buffer, 0, bytes);
    }

    /// Asks for the buffer to be mapped once the device has finished what was submitted: [`Gpu::wait`] for it maps the buffer.
    pub fn map(&self) {
        self.buffer.map_async(wgpu::MapMode::Read, .., |_| {});
    }

    /// Passes the bytes to `read`, after [`Self::map`] and [`Gpu::wait`], and unmaps the buffer.
    ///
    /// # Errors
    /// [`Error::DeviceLost`].
    pub fn read<T>(&self, read: impl FnOnce(&[u8]) -> T) -> Result<T> {
        let result = {
            let failed = |_| Error::DeviceLost("its memory cannot be read".to_owned());
            let view = self.buffer.get_mapped_range(..).map_err(failed)?;
            read(&view)
        };
        self.buffer.unmap();
        Ok(result)
    }
}
