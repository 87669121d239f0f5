//! Buffers that are written anew for each frame.

use wgpu::BufferUsages;

use crate::gpu::Gpu;

/// A buffer that grows when more is written than it holds.
#[derive(Debug)]
pub struct Store {
    label: &'static str,
    usage: BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Store {
    /// One that holds nothing yet.
    #[must_use]
    pub const fn new(label: &'static str, usage: BufferUsages) -> Self {
        Self { label, usage, buffer: None }
    }

    /// The buffer.
    ///
    /// # Panics
    /// Before it was first written.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        self.buffer.as_ref().expect("a scene is uploaded before it is drawn")
    }

    /// Its first `bytes`, as a binding.
    ///
    /// # Panics
    /// Before it was first written.
    #[must_use]
    pub fn first(&self, bytes: usize) -> wgpu::BindingResource<'_> {
        let size = wgpu::BufferSize::new(bytes as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: self.buffer(), offset: 0, size })
    }

    /// Writes from the start on, and says how many bytes; what the buffer held may be lost.
    pub fn write<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, data: &[T]) -> u64 {
        let data: &[u8] = bytemuck::cast_slice(data);
        self.write_with(gpu, data.len(), |mut view| view.copy_from_slice(data))
    }

    /// The same, of so many bytes (a multiple of four) that `write` writes.
    pub fn write_with(
        &mut self,
        gpu: &Gpu,
        bytes: usize,
        write: impl FnOnce(wgpu::WriteOnly<'_, [u8]>),
    ) -> u64 {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes as u64) {
            let room = (bytes as u64).next_power_of_two();
            self.buffer = Some(gpu.buffer(self.label, room, self.usage | BufferUsages::COPY_DST));
        }
        self.write_behind(gpu, 0, bytes, write);
        bytes as u64
    }

    /// Writes so many bytes behind the first `offset`, which stay (both multiples of four), and says whether there is room for them.
    pub fn write_behind(
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
        // There is no view where something is wrong with the device, which it says itself.
        let view = size.and_then(|size| gpu.queue.write_buffer_with(buffer, offset as u64, size));
        if let Some(mut view) = view {
            write(view.slice(..));
        }
        true
    }
}
