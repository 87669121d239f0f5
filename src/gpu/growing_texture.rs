//! Textures that hold tables for shaders, rewritten for each frame.

use wgpu::{TextureFormat, TextureUsages};

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::staging::StagingBuffers;

/// A device texture that is replaced by a larger one when more is written than it holds.
#[derive(Debug)]
pub struct GrowingTexture {
    label: &'static str,
    format: TextureFormat,
    texture: Option<(wgpu::Texture, wgpu::TextureView)>,
}

impl GrowingTexture {
    /// A texture without texels; the device allocates nothing before the first write.
    #[must_use]
    pub const fn new(label: &'static str, format: TextureFormat) -> Self {
        Self { label, format, texture: None }
    }

    /// The current texture; a write may replace it.
    ///
    /// # Panics
    /// Before the first write.
    #[must_use]
    pub fn texture(&self) -> &wgpu::Texture {
        &self.current().0
    }

    /// Its view.
    ///
    /// # Panics
    /// Before the first write.
    #[must_use]
    pub fn view(&self) -> &wgpu::TextureView {
        &self.current().1
    }

    fn current(&self) -> &(wgpu::Texture, wgpu::TextureView) {
        self.texture.as_ref().expect("a texture is written before it is bound")
    }

    /// Whether it has this many columns and rows.
    #[must_use]
    pub fn holds(&self, [width, height]: [u32; 2]) -> bool {
        let fits = |texture: &wgpu::Texture| texture.width() >= width && texture.height() >= height;
        self.texture.as_ref().is_some_and(|(texture, _)| fits(texture))
    }

    /// Makes it hold at least this many columns and rows.
    pub fn reserve(&mut self, gpu: &Gpu, size: [u32; 2]) {
        if !self.holds(size) {
            // The old one first: both need not fit.
            self.texture = None;
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
            self.texture = Some(gpu.texture(self.label, size, self.format, usage));
        }
    }

    /// Writes the first `size` columns and rows; `texels` are in row-major order. Returns the number of bytes written.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub fn write<T: bytemuck::NoUninit>(
        &mut self,
        gpu: &Gpu,
        staging: &mut StagingBuffers,
        size: [u32; 2],
        texels: &[T],
    ) -> Result<u64> {
        self.reserve(gpu, size);
        if let Some((texture, _)) = &self.texture {
            staging.write_texels(gpu, texture, size, texels)?;
        }
        Ok(size_of_val(texels) as u64)
    }
}
