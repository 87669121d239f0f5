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
use crate::gpu::staging::{PAGE_BYTES, Page, StagingBuffer, TextureRegion};
use crate::render::device::packing::Packing;
use crate::render::settings::RenderSettings;
use crate::render::visibility::geometry::Facets;
use crate::render::visibility::host::Stencil;

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

    /// What it holds before anything is drawn: nothing, or what shows `background` wherever nothing else is drawn.
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

/// What is seen, unlit, wherever nothing else is.
#[derive(Clone, Copy, Debug)]
pub struct Background {
    /// Its radiance.
    pub radiance: Vec3,
    /// Its class.
    pub class: ClassId,
}

/// Format of what the visibility pass draws (`visibility.wgsl`).
pub const VISIBILITY_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Format of the slopes of ground below its mesh, rise per metre along x and y, where they are given.
pub const SLOPES_FORMAT: TextureFormat = TextureFormat::Rg32Float;
/// Format of the depth of the shadow atlas, and of that of the samples, whose stencil says by which draw of the lighting pass
/// a sample is lit. Reversed in both: cleared to 0, the far end.
pub const ATLAS_FORMAT: TextureFormat = TextureFormat::Depth32Float;
/// See [`ATLAS_FORMAT`].
pub const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32FloatStencil8;
/// Format of the stencil of samples whose visibility is given, and not drawn by the device: it needs no depth.
pub const GIVEN_FORMAT: TextureFormat = TextureFormat::Stencil8;

/// Depth state of the passes that draw things: reversed, the nearer wins, of two as near the first. The stencil, where there
/// is one, takes the pass's reference.
#[must_use]
pub fn depth_state(format: TextureFormat) -> wgpu::DepthStencilState {
    let taken = wgpu::StencilFaceState { pass_op: wgpu::StencilOperation::Replace, ..Default::default() };
    wgpu::DepthStencilState {
        format,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Greater),
        stencil: if format.has_stencil_aspect() {
            wgpu::StencilState { front: taken, back: taken, read_mask: !0, write_mask: !0 }
        } else {
            wgpu::StencilState::default()
        },
        bias: wgpu::DepthBiasState::default(),
    }
}

/// The textures of one picture size.
#[derive(Debug)]
pub struct GBuffer {
    /// Pixels of the picture.
    pub size: [u32; 2],
    /// Samples along a side of a pixel.
    pub samples_per_side: u32,
    /// Columns and rows of samples.
    pub sample_size: [u32; 2],
    /// What is asked for.
    pub annotations: Annotations,
    /// One view a plane, as in [`Plane::ALL`]; of a single sample where the plane is not drawn.
    pub planes: [wgpu::TextureView; Plane::ALL.len()],
    /// What the samples show.
    pub visibility: (wgpu::Texture, wgpu::TextureView),
    /// Slopes of the ground below its mesh; of a single sample where the device sums them up itself.
    pub slopes: (wgpu::Texture, wgpu::TextureView),
    /// Whether it is given them.
    pub has_slopes: bool,
    /// Depth and stencil of the samples; if [`Self::is_given`], their stencil alone.
    pub depth_stencil: (wgpu::Texture, wgpu::TextureView),
    /// Whether the device is given what the samples show.
    pub is_given: bool,
    /// If so: rows of samples that were given last; 0 is in all others.
    given_rows: Range<u32>,
}

/// Most bytes that the device is given at once.
const STAGING_BYTES: u32 = 32 << 20;

impl GBuffer {
    /// Textures for a picture of this size. `is_given` tells whether the device is given what the samples show, `has_slopes`
    /// whether it is given slopes of ground too.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`].
    pub fn new(gpu: &Gpu, settings: &RenderSettings, is_given: bool, has_slopes: bool) -> Result<Self> {
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
        let sample_size = settings.sample_size();
        let drawn = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
        let texture = |label: &str, size, format, usage| gpu.texture(label, size, format, usage);
        let (visibility, stencil) = if is_given {
            let given = TextureUsages::COPY_DST;
            (
                texture(
                    "gbuffer/visibility",
                    sample_size,
                    VISIBILITY_FORMAT,
                    given | TextureUsages::TEXTURE_BINDING,
                ),
                texture(
                    "gbuffer/stencil",
                    sample_size,
                    GIVEN_FORMAT,
                    given | TextureUsages::RENDER_ATTACHMENT,
                ),
            )
        } else {
            (
                texture("gbuffer/visibility", sample_size, VISIBILITY_FORMAT, drawn),
                texture("gbuffer/depth", sample_size, DEPTH_FORMAT, TextureUsages::RENDER_ATTACHMENT),
            )
        };
        Ok(Self {
            size,
            samples_per_side,
            sample_size,
            annotations,
            planes: Plane::ALL.map(|plane| {
                let size = if plane.is_drawn(annotations) { sample_size } else { [1, 1] };
                texture(&format!("gbuffer/{plane:?}"), size, plane.format(), drawn).1
            }),
            visibility,
            slopes: texture(
                "gbuffer/slopes",
                if has_slopes { sample_size } else { [1, 1] },
                SLOPES_FORMAT,
                TextureUsages::COPY_DST | TextureUsages::TEXTURE_BINDING,
            ),
            has_slopes,
            depth_stencil: stencil,
            is_given,
            given_rows: 0..0,
        })
    }

    /// Draws what the samples show and gives it to the device; how many bytes. `staging` is kept from frame to frame.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub(in crate::render) fn give(
        &mut self,
        gpu: &Gpu,
        staging: &mut Option<StagingBuffer>,
        facets: &Facets,
        stencil: &mut Stencil,
    ) -> Result<u64> {
        let [width, height] = self.sample_size;
        // Rows are given out to threads, and so begin with pages.
        let bytes_of = |format: TextureFormat| {
            (format.block_copy_size(None).unwrap_or(0) as usize * width as usize).next_multiple_of(PAGE_BYTES)
        };
        let each_bytes =
            [bytes_of(VISIBILITY_FORMAT), if self.has_slopes { bytes_of(SLOPES_FORMAT) } else { 0 }];
        let row_bytes = each_bytes[0] + each_bytes[1];
        let rows_at_once = (STAGING_BYTES / row_bytes as u32).clamp(1, height);
        let bytes = row_bytes * rows_at_once as usize;
        let staging = StagingBuffer::with_capacity(staging, gpu, "gbuffer/staging", bytes)?;
        // Where something was shown last there may be nothing but the sky now.
        let things = facets.rows_of_things();
        let before = std::mem::replace(&mut self.given_rows, things.clone());
        let all = [things, before].into_iter().filter(|rows| !rows.is_empty());
        let all = all.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0);
        stencil.restart(self.sample_size);
        for first in (0..height).step_by(rows_at_once as usize) {
            let rows = first..height.min(first + rows_at_once);
            let given = all.start.max(rows.start)..all.end.min(rows.end);
            let mut draw = |pages: &mut dyn Iterator<Item = Page<'_>>| {
                stencil.draw(facets, width as usize, &rows, &given, (pages, each_bytes));
            };
            if given.is_empty() {
                draw(&mut std::iter::empty());
            } else {
                staging.write(gpu, draw)?;
                let size = [width, given.len() as u32];
                let part = TextureRegion { offset_bytes: 0, row_bytes, origin: [0, given.start], size };
                staging.copy_to(gpu, &self.visibility.0, &[part])?;
                if self.has_slopes {
                    staging.copy_to(
                        gpu,
                        &self.slopes.0,
                        &[TextureRegion { offset_bytes: each_bytes[0], ..part }],
                    )?;
                }
            }
        }
        gpu.guard(|| gpu.write_texels(&self.depth_stencil.0, self.sample_size, &stencil.values))?;
        Ok(row_bytes as u64 * all.len() as u64 + stencil.values.len() as u64)
    }

    /// Whether they serve these settings.
    #[must_use]
    pub fn serve(&self, settings: &RenderSettings, is_given: bool, has_slopes: bool) -> bool {
        (self.size, self.samples_per_side, self.annotations)
            == (settings.size, settings.samples_per_side, settings.annotations)
            && (self.is_given, self.has_slopes) == (is_given, has_slopes)
    }
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
