//! The planes that the lighting pass draws: format, cleared value, and the textures at sample resolution.
//!
//! To add an annotation: a variant of [`Plane`], its arms here, a field in `shaders/common/planes.wgsl` and its
//! value in `lighting_surface.wgsl` and `lighting_sky.wgsl`, its rule in `resolve.wgsl`.

use std::ops::Range;

use glam::Vec3;
use wgpu::{TextureFormat, TextureUsages};

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::{Annotation, Annotations};
use crate::gpu::Gpu;
use crate::render::device::packing::Packing;
use crate::render::select::draw_list::DrawBatch;
use crate::render::settings::RenderSettings;

/// What a sample of the lighting pass carries. The location in `LightingOutput` is the place in [`Plane::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    /// Linear radiance.
    Radiance,
    /// Class id.
    Class,
    /// World normal.
    Normal,
    /// Instance id.
    Instance,
    /// Fraction of the sun that is hidden.
    SunOcclusion,
}

impl Plane {
    /// Every plane, by location.
    pub const ALL: [Self; 5] =
        [Self::Radiance, Self::Class, Self::Normal, Self::Instance, Self::SunOcclusion];

    /// Format of its texture. Together they must stay within 32 bytes a sample, which every device offers.
    #[must_use]
    pub const fn format(self) -> TextureFormat {
        match self {
            Self::Radiance | Self::Normal => TextureFormat::Rgba16Float,
            Self::Class => TextureFormat::R8Uint,
            Self::Instance => TextureFormat::R16Uint,
            Self::SunOcclusion => TextureFormat::R8Unorm,
        }
    }

    /// Its value before anything is drawn: that of the background, if there is one.
    #[must_use]
    pub fn cleared(self, background: Option<&Background>) -> wgpu::Color {
        let [r, g, b] = background.map_or([0.0; 3], |background| background.radiance.as_dvec3().to_array());
        let class = background.map_or(ClassId::UNLABELLED, |background| background.class);
        match self {
            Self::Radiance if background.is_some() => wgpu::Color { r, g, b, a: 1.0 },
            Self::Radiance | Self::Normal | Self::Instance | Self::SunOcclusion => wgpu::Color::TRANSPARENT,
            Self::Class => wgpu::Color { r: class.0.into(), g: 0.0, b: 0.0, a: 0.0 },
        }
    }

    /// Whether it is drawn when these annotations are asked for. What is averaged over the samples of an instance
    /// needs the instances.
    #[must_use]
    pub fn is_drawn(self, asked: Annotations) -> bool {
        let any =
            |annotations: &[Annotation]| annotations.iter().any(|&annotation| asked.contains(annotation));
        match self {
            Self::Radiance | Self::Class => true,
            Self::Normal => any(&[Annotation::Normals]),
            Self::Instance => {
                any(&[Annotation::Instances, Annotation::Depth, Annotation::Normals, Annotation::Shadow])
            }
            Self::SunOcclusion => any(&[Annotation::Shadow]),
        }
    }
}

/// A surface of one radiance and one class.
#[derive(Clone, Copy, Debug)]
pub struct Background {
    /// Its radiance.
    pub radiance: Vec3,
    /// Its class.
    pub class: ClassId,
    /// Its value in the stencil.
    pub stencil: u8,
}

/// Format of the visibility texture (`visibility.wgsl` has its layout).
pub const VISIBILITY_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Format of the slopes: rise per metre along x and y.
pub const SLOPES_FORMAT: TextureFormat = TextureFormat::Rg32Float;

/// How the textures are filled, which their usages and formats depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GBufferLayout {
    /// Usage through which visibility and stencil are written.
    pub write_usage: TextureUsages,
    /// Format of the stencil, with depth beside it where a pass needs it.
    pub stencil_format: TextureFormat,
    /// There are slopes of the relief below the mesh.
    pub has_slopes: bool,
    /// The stencil is known to the host too.
    pub has_host_stencil: bool,
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
    /// Annotations that are rendered.
    pub annotations: Annotations,
    /// How it is filled.
    pub layout: GBufferLayout,
    /// One view for each plane, as in [`Plane::ALL`]; of a single sample where the plane is not rendered.
    pub planes: [wgpu::TextureView; Plane::ALL.len()],
    /// The visible surface at each sample: instance, normals, inverse depth.
    pub visibility: (wgpu::Texture, wgpu::TextureView),
    /// Slopes of the relief below the mesh, where the host computes them. Without them the lighting pass does.
    pub slopes: Option<(wgpu::Texture, wgpu::TextureView)>,
    /// One more than the shading bin of each sample, 0 where there is no surface; maybe with depth.
    pub stencil: (wgpu::Texture, wgpu::TextureView),
    /// The same in host memory, row by row, if it is known there.
    pub host_stencil: Option<Vec<u8>>,
    /// Rows of `visibility` that may hold anything but zeros, if it is written by upload.
    pub written_rows: Range<u32>,
    /// The shading bins that samples are in.
    pub batches: Vec<DrawBatch>,
    /// What is visible in all samples that no batch covers, if it is known that nothing else is.
    pub background: Option<Background>,
    /// Bound where there are no slopes.
    no_slopes: wgpu::TextureView,
}

impl GBuffer {
    /// Textures for an image with these settings.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`].
    pub fn new(gpu: &Gpu, settings: &RenderSettings, layout: GBufferLayout) -> Result<Self> {
        let &RenderSettings { size, samples_per_side, annotations, .. } = settings;
        check_limits(gpu, settings)?;
        let sample_size = settings.sample_size();
        let drawn = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
        let uploaded = TextureUsages::COPY_DST | TextureUsages::TEXTURE_BINDING;
        Ok(Self {
            size,
            samples_per_side,
            sample_size,
            annotations,
            layout,
            planes: Plane::ALL.map(|plane| {
                let size = if plane.is_drawn(annotations) { sample_size } else { [1, 1] };
                gpu.texture(&format!("gbuffer/{plane:?}"), size, plane.format(), drawn).1
            }),
            visibility: gpu.texture(
                "gbuffer/visibility",
                sample_size,
                VISIBILITY_FORMAT,
                layout.write_usage | TextureUsages::TEXTURE_BINDING,
            ),
            slopes: layout
                .has_slopes
                .then(|| gpu.texture("gbuffer/slopes", sample_size, SLOPES_FORMAT, uploaded)),
            stencil: gpu.texture(
                "gbuffer/stencil",
                sample_size,
                layout.stencil_format,
                layout.write_usage | TextureUsages::RENDER_ATTACHMENT,
            ),
            host_stencil: layout.has_host_stencil.then(Vec::new),
            written_rows: 0..0,
            batches: Vec::new(),
            background: None,
            no_slopes: gpu.texture("gbuffer/no_slopes", [1, 1], SLOPES_FORMAT, uploaded).1,
        })
    }

    /// Whether it serves these settings.
    #[must_use]
    pub fn serves(&self, settings: &RenderSettings, layout: GBufferLayout) -> bool {
        (self.size, self.samples_per_side, self.annotations, self.layout)
            == (settings.size, settings.samples_per_side, settings.annotations, layout)
    }

    /// The slopes as the lighting pass binds them: a single sample where there are none.
    #[must_use]
    pub fn slopes_view(&self) -> &wgpu::TextureView {
        self.slopes.as_ref().map_or(&self.no_slopes, |(_, view)| view)
    }
}

fn check_limits(gpu: &Gpu, settings: &RenderSettings) -> Result<()> {
    let &RenderSettings { size, samples_per_side, annotations, .. } = settings;
    let limits = gpu.device.limits();
    let [width, height] = size;
    let too_large = |needed: String, limit: String| Error::SizeBeyondDevice {
        width,
        height,
        samples: samples_per_side * samples_per_side,
        needed,
        limit,
        adapter: gpu.info.name.clone(),
    };
    let side_px = u64::from(width.max(height)) * u64::from(samples_per_side);
    if side_px > u64::from(limits.max_texture_dimension_2d) {
        let limit = format!("{} px", limits.max_texture_dimension_2d);
        return Err(too_large(format!("a target with a side of {side_px} px"), limit));
    }
    let packed_bytes = Packing::new(size, annotations).bytes();
    if packed_bytes > limits.max_storage_buffer_binding_size {
        let mebibytes = |bytes: u64| format!("{} MiB", bytes.div_ceil(1 << 20));
        let limit = mebibytes(limits.max_storage_buffer_binding_size);
        return Err(too_large(format!("{} in one buffer", mebibytes(packed_bytes)), limit));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_fit_into_the_guaranteed_bytes_per_sample() {
        let bytes: u32 = Plane::ALL
            .iter()
            .map(|plane| plane.format().target_pixel_byte_cost().expect("a colour format"))
            .sum();
        assert!(bytes <= 32, "{bytes} bytes");
    }
}
