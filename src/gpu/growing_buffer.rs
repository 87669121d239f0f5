//! Buffers that are rewritten for each frame.

use wgpu::BufferUsages;

use crate::gpu::Gpu;

/// A device buffer that is replaced by a larger one when more is written than it holds.
#[derive(Debug)]
pub struct GrowingBuffer {
    label: &'static str,
    usage: BufferUsages,
    buffer: Option<wgpu::Buffer>,
    /// See [`Self::used`].
    used: u64,
}

impl GrowingBuffer {
    /// An empty buffer; the device allocates nothing before the first write.
    #[must_use]
    pub const fn new(label: &'static str, usage: BufferUsages) -> Self {
        Self { label, usage, buffer: None, used: 0 }
    }

    /// The current buffer; a write may replace it.
    ///
    /// # Panics
    /// Before the first write.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        self.buffer.as_ref().expect("a buffer is written before it is bound")
    }

    /// A binding of the first `bytes`.
    ///
    /// # Panics
    /// Before the first write.
    #[must_use]
    pub fn bind_first(&self, bytes: usize) -> wgpu::BindingResource<'_> {
        let size = wgpu::BufferSize::new(bytes as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: self.buffer(), offset: 0, size })
    }

    /// Bytes that are in use: those of the last reservation or write, and of what was written behind them.
    #[must_use]
    pub const fn used(&self) -> u64 {
        self.used
    }

    /// A binding of the bytes in use.
    ///
    /// # Panics
    /// Before the first write.
    #[must_use]
    pub fn bind_used(&self) -> wgpu::BindingResource<'_> {
        self.bind_first(self.used as usize)
    }

    /// Replaces the content with `data`; returns the number of bytes written.
    pub fn write<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, data: &[T]) -> u64 {
        let data: &[u8] = bytemuck::cast_slice(data);
        self.write_with(gpu, data.len(), |mut view| view.copy_from_slice(data))
    }

    /// Replaces the content with `first` and, behind it, `second`; returns the number of bytes written.
    pub fn write_both<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, first: &[T], second: &[T]) -> u64 {
        let (first, second): (&[u8], &[u8]) = (bytemuck::cast_slice(first), bytemuck::cast_slice(second));
        self.write_with(gpu, first.len() + second.len(), |mut view| {
            view.slice(..first.len()).copy_from_slice(first);
            view.slice(first.len()..).copy_from_slice(second);
        })
    }

    /// Makes room for this many bytes, whatever they are; returns their number.
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> u64 {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
            let capacity = bytes.next_power_of_two().min(gpu.device.limits().max_buffer_size).max(bytes);
            self.buffer = Some(gpu.buffer(self.label, capacity, self.usage | BufferUsages::COPY_DST));
        }
        self.used = bytes;
        bytes
    }

    /// Replaces the content with the `bytes` bytes (a multiple of four) that `write` writes; returns their number.
    pub fn write_with(
        &mut self,
        gpu: &Gpu,
        bytes: usize,
        write: impl FnOnce(wgpu::WriteOnly<'_, [u8]>),
    ) -> u64 {
        self.reserve(gpu, bytes as u64);
        self.try_write_at(gpu, 0, bytes, write);
        bytes as u64
    }

    /// Writes `bytes` bytes at `offset` (both multiples of four) and keeps the content before them. Returns false, with
    /// nothing written, if they do not fit.
    pub fn try_write_at(
        &mut self,
        gpu: &Gpu,
        offset: usize,
        bytes: usize,
        write: impl FnOnce(wgpu::WriteOnly<'_, [u8]>),
    ) -> bool {
        let Some(buffer) = self.buffer.as_ref().filter(|buffer| buffer.size() >= (offset + bytes) as u64)
        else {
            return false;
        };
        let size = wgpu::BufferSize::new(bytes as u64);
        // There is no view when the device has failed; `Gpu::check` reports that.
        let view = size.and_then(|size| gpu.queue.write_buffer_with(buffer, offset as u64, size));
        if let Some(mut view) = view {
            write(view.slice(..));
        }
        self.used = self.used.max((offset + bytes) as u64);
        true
    }
}
