//! Buffers that any thread fills before the thread of the device copies from them, kept from frame to frame.
//! Must not know: what they hold.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use crate::gpu::staging::{PAGE_BYTES, Page};

/// Sizes of new buffers are multiples of this, bytes: frames differ a little in what they need.
const STEP_BYTES: u64 = 2 << 20;

/// Mapped buffers that no frame uses: no more than frames were planned or in flight at a time.
#[derive(Debug)]
pub struct UploadPool {
    device: wgpu::Device,
    unused: Arc<Mutex<Vec<wgpu::Buffer>>>,
}

impl UploadPool {
    /// A pool without buffers.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        Self { device: device.clone(), unused: Arc::default() }
    }

    /// A mapped buffer of at least `bytes`, for any thread to fill; `None` if the device has no memory for it, no buffers of that size, or
    /// has failed.
    #[must_use]
    pub fn take(&self, bytes: usize) -> Option<MappedBuffer> {
        let bytes = bytes.next_multiple_of(PAGE_BYTES) as u64;
        let unused = {
            let mut unused = self.unused.lock().unwrap_or_else(PoisonError::into_inner);
            let fits = |&index: &usize| unused[index].size() >= bytes;
            let smallest = (0..unused.len()).filter(fits).min_by_key(|&index| unused[index].size());
            // One that is too small makes way for the new one.
            let index = smallest.or_else(|| unused.len().checked_sub(1));
            index.map(|index| unused.swap_remove(index)).filter(|buffer| buffer.size() >= bytes)
        };
        let create = || {
            let descriptor = wgpu::BufferDescriptor {
                label: Some("upload"),
                size: bytes.next_multiple_of(STEP_BYTES),
                usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: true,
            };
            catch_unwind(AssertUnwindSafe(|| self.created(&descriptor))).ok().flatten()
        };
        let buffer = unused.or_else(create)?;
        Some(MappedBuffer { buffer, is_mapped: true, unused: Arc::clone(&self.unused) })
    }

    /// A new buffer; `None` if the device cannot create it. That is no error of the frame which another thread draws meanwhile: scopes of
    /// errors belong to a thread.
    fn created(&self, descriptor: &wgpu::BufferDescriptor<'_>) -> Option<wgpu::Buffer> {
        let scopes = [wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation]
            .map(|filter| self.device.push_error_scope(filter));
        let buffer = self.device.create_buffer(descriptor);
        // Each scope is popped, the last one first.
        let errors = scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop()));
        (errors.count() == 0).then_some(buffer)
    }
}

/// A buffer of an [`UploadPool`], which returns there when it is dropped, as soon as the device has done what was submitted with it.
#[derive(Debug)]
pub struct MappedBuffer {
    buffer: wgpu::Buffer,
    is_mapped: bool,
    unused: Arc<Mutex<Vec<wgpu::Buffer>>>,
}

impl MappedBuffer {
    /// Lets `write` fill its pages, from the first on; `None` if the device has failed.
    pub fn write<T>(&mut self, write: impl FnOnce(&mut dyn Iterator<Item = Page<'_>>) -> T) -> Option<T> {
        let mut view = self.buffer.get_mapped_range_mut(..).ok()?;
        Some(write(&mut view.slice(..).into_chunks().0.into_iter()))
    }

    /// Gives it to the device, to be copied from. It cannot be written after that.
    pub fn unmap(&mut self) {
        if std::mem::take(&mut self.is_mapped) {
            self.buffer.unmap();
        }
    }

    /// The buffer, after [`Self::unmap`].
    #[must_use]
    pub const fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

impl Drop for MappedBuffer {
    fn drop(&mut self) {
        let (buffer, unused) = (self.buffer.clone(), Arc::clone(&self.unused));
        let keep = move || unused.lock().unwrap_or_else(PoisonError::into_inner).push(buffer);
        if self.is_mapped {
            keep();
            return;
        }
        // A lost device may panic here; then the buffer is not kept.
        let _ = catch_unwind(AssertUnwindSafe(|| {
            self.buffer.map_async(wgpu::MapMode::Write, .., |mapped| {
                if mapped.is_ok() {
                    keep();
                }
            });
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Gpu;
    use crate::gpu::adapter::adapter_of_tests;
    use crate::gpu::readback::ReadbackBuffer;

    /// Sizes of the unused buffers, in steps, the smallest first.
    fn unused_sizes(pool: &UploadPool) -> Vec<u64> {
        let unused = pool.unused.lock().expect("unpoisoned");
        let mut sizes: Vec<u64> = unused.iter().map(|buffer| buffer.size() / STEP_BYTES).collect();
        sizes.sort_unstable();
        sizes
    }

    #[test]
    fn buffers_return_when_the_device_has_copied_from_them() {
        let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
        let pool = UploadPool::new(&gpu.device);
        let step = STEP_BYTES as usize;
        drop([pool.take(1).expect("a buffer"), pool.take(3 * step).expect("a buffer")]);
        assert_eq!(unused_sizes(&pool), [1, 3]);

        let page: [u8; PAGE_BYTES] = std::array::from_fn(|i| (i * i % 251) as u8);
        let mut smallest = pool.take(PAGE_BYTES).expect("a buffer");
        assert_eq!(unused_sizes(&pool), [3]);
        let written = smallest.write(|pages| {
            pages.next().map(|first| wgpu::WriteOnly::<'_, [u8]>::from(first).copy_from_slice(&page))
        });
        assert_eq!(written, Some(Some(())));
        smallest.unmap();
        let copy = ReadbackBuffer::new(&gpu, "copy", PAGE_BYTES as u64);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        copy.copy(&mut encoder, smallest.buffer(), PAGE_BYTES as u64);
        let submission = gpu.queue.submit([encoder.finish()]);
        copy.map();
        drop(smallest);
        gpu.wait(&submission).expect("copied");
        assert!(copy.read(|bytes| bytes == page).expect("mapped"));
        assert_eq!(unused_sizes(&pool), [1, 3]);

        // None is large enough: one makes way.
        drop(pool.take(4 * step));
        let sizes = unused_sizes(&pool);
        assert!(sizes.len() == 2 && sizes[1] == 4, "{sizes:?}");
    }

    /// Another thread may draw a frame meanwhile, whose error this would be.
    #[test]
    fn a_buffer_that_cannot_be_made_is_not_kept_and_no_error_of_a_frame() {
        let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
        let pool = UploadPool::new(&gpu.device);
        let too_large = gpu.device.limits().max_buffer_size as usize + 1;
        assert!(pool.take(too_large).is_none());
        assert_eq!(unused_sizes(&pool), [0; 0]);
        gpu.check().expect("no error");
    }
}
