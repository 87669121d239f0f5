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

    /// Waits for `submission`, which contains the copy, and passes the mapped bytes to `read`.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn read<T>(
        &self,
        gpu: &Gpu,
        submission: &wgpu::SubmissionIndex,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        gpu.guard(|| self.buffer.map_async(wgpu::MapMode::Read, .., |_| {}))?;
        gpu.wait(submission)?;
        let result = {
            let view = self.buffer.get_mapped_range(..).map_err(|e| Error::DeviceLost(e.to_string()))?;
            read(&view)
        };
        self.buffer.unmap();
        Ok(result)
    }
}
