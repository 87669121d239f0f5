//! The G-buffer: the textures at sample resolution that visibility and lighting write. The formats of the planes that
//! lighting writes are in the table [`SAMPLE_PLANES`].

use std::ops::Range;

use wgpu::{TextureFormat, TextureUsages};

use crate::error::{Error, Result};
use crate::frame::Annotations;
use crate::gpu::Gpu;
use crate::render::device::packing::Packing;
use crate::render::device::planes::SAMPLE_PLANES;
use crate::render::select::draw_list::DrawBatch;
use crate::render::settings::RenderSettings;

/// Format of the visibility texture (`visibility.wgsl` has its layout).
pub(crate) const VISIBILITY_FORMAT: TextureFormat = TextureFormat::Rgba32Uint;
/// Format of the slopes: rise per metre along x and y.
pub(crate) const SLOPES_FORMAT: TextureFormat = TextureFormat::Rg32Float;

/// How the textures are filled, which their usages and formats depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GBufferLayout {
    /// Usage through which visibility and stencil are written.
    pub write_usage: TextureUsages,
    /// Format of depth, stencil or both: depth where the device rasterises visibility, a stencil where it selects the samples of a
    /// shading bin.
    pub depth_stencil_format: TextureFormat,
    /// There are slopes of the relief below the mesh.
    pub has_slopes: bool,
    /// The stencil is known to the host too.
    pub has_host_stencil: bool,
}

impl GBufferLayout {
    /// The format with the stencil that selects samples, if there is one.
    #[must_use]
    pub fn stencil_format(&self) -> Option<TextureFormat> {
        Some(self.depth_stencil_format).filter(TextureFormat::has_stencil_aspect)
    }
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
    /// One view for each plane, as in [`SAMPLE_PLANES`]; of a single sample where the plane is not rendered.
    pub planes: [wgpu::TextureView; SAMPLE_PLANES.len()],
    /// The visible surface at each sample: instance, normals, inverse depth.
    pub visibility: (wgpu::Texture, wgpu::TextureView),
    /// Slopes of the relief below the mesh, where the host computes them. Without them the lighting pass does.
    pub slopes: Option<(wgpu::Texture, wgpu::TextureView)>,
    /// The stencil holds one more than the shading bin of each sample, 0 where there is no surface.
    pub depth_stencil: (wgpu::Texture, wgpu::TextureView),
    /// The same in host memory, row by row, if it is known there.
    pub host_stencil: Option<Vec<u8>>,
    /// Rows of `visibility` that may hold anything but zeros, if it is written by upload.
    pub written_rows: Range<u32>,
    /// The shading bins that samples are in.
    pub batches: Vec<DrawBatch>,
    /// Value in the host's stencil of the samples of the sky's dome, which all have the same values in every plane.
    pub dome_stencil: Option<u8>,
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
            planes: SAMPLE_PLANES.map(|row| {
                let size = if row.plane.is_needed(annotations) { sample_size } else { [1, 1] };
                gpu.texture(&format!("gbuffer/{}", row.name), size, row.format, drawn).1
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
            depth_stencil: gpu.texture(
                "gbuffer/depth_stencil",
                sample_size,
                layout.depth_stencil_format,
                layout.write_usage | TextureUsages::RENDER_ATTACHMENT,
            ),
            host_stencil: layout.has_host_stencil.then(Vec::new),
            written_rows: 0..0,
            batches: Vec::new(),
            dome_stencil: None,
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
