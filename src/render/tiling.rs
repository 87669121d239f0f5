//! Frames that are drawn in tiles: how large a tile may be, and the frame that tiles are put together to.
//!
//! A frame is planned and its shadows are drawn once; visibility, lighting, resolve and readback run tile by tile. Every tile gets the
//! values that the whole frame would have there: positions, rays and noise count from the first sample of the image.
//! Must not know: what is drawn.

use crate::error::{Error, Result};
use crate::frame::plane::every_annotation;
use crate::frame::{Annotations, Frame};
use crate::gpu::Gpu;
use crate::render::backend::RasterBackend;
use crate::render::device::packing::Packing;
use crate::render::lighting::gbuffer::GBufferLayout;
use crate::render::resolve::assemble;
use crate::render::select::tiles::{DividedImage, ImageTile, divide};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;

/// How large a tile may be. A frame that is larger is drawn in tiles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileLimits {
    /// Device memory that the G-buffer, the packed planes and their readback may take, bytes.
    pub(crate) bytes: u64,
    /// Columns and rows of samples.
    pub(crate) side_samples: u32,
}

impl TileLimits {
    /// Those of a device: its textures', and memory for a frame of 8192 x 8192 pixels with 16 samples within a gigabyte.
    pub(crate) fn of(gpu: &Gpu) -> Self {
        Self { bytes: 640 << 20, side_samples: gpu.device.limits().max_texture_dimension_2d }
    }

    /// These, for tiles as small as costs no time: twice a frame of the surface stage of 512 x 512 pixels with 4 samples. Of such a frame
    /// two tiles take 5 % more time than the whole.
    #[must_use]
    pub(crate) fn small(self) -> Self {
        Self { bytes: self.bytes.min(128 << 20), ..self }
    }
}

/// Maximum columns and rows of samples of a frame: the guard band of the rasterisers, and rows that 16 bits number.
const MAX_SIDE_SAMPLES: u32 = 32_768;

/// The tiles of an image with these settings: one if it is drawn whole. `scene` and `rendered` are those of the image before distortion.
///
/// Where the host rasterises, every bit is that of the whole frame. A device rounds the corners of triangles relative to the tile: there a
/// frame has the tiles that it needs with every output, so that its labels do not depend on which others are asked for.
///
/// # Errors
/// [`Error::SizeBeyondDevice`].
pub(crate) fn tiles(
    gpu: &Gpu,
    image: &RenderSettings,
    (scene, rendered): (&Scene, &RenderSettings),
    (layout, rasteriser): (GBufferLayout, RasterBackend),
    max: TileLimits,
) -> Result<Vec<ImageTile>> {
    let limits = gpu.device.limits();
    let samples_per_side = image.samples_per_side;
    let beyond = |needed: String, limit: String| Error::SizeBeyondDevice {
        width: image.size[0],
        height: image.size[1],
        samples: samples_per_side * samples_per_side,
        needed,
        limit,
        adapter: gpu.info.name.clone(),
    };
    let side = rendered.sample_size().into_iter().max().unwrap_or(0);
    if side > MAX_SIDE_SAMPLES {
        return Err(beyond(format!("{side} samples along a side"), MAX_SIDE_SAMPLES.to_string()));
    }
    let annotations = match rasteriser {
        RasterBackend::Host | RasterBackend::Compute => image.annotations,
        RasterBackend::Device => every_annotation(),
    };
    let bytes_per_sample = layout.bytes_per_sample(annotations);
    let max_buffer_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    let fits = |tile: ImageTile| {
        let [width, height] = tile.rendered.samples(samples_per_side).size;
        let packed_bytes = tile.packed_bytes(annotations);
        // Packed planes are there twice: where the device writes them and where the host reads them.
        let bytes = u64::from(width) * u64::from(height) * bytes_per_sample + 2 * packed_bytes;
        let bound_bytes = packed_bytes.max(u64::from(width) * u64::from(height) * layout.nearest_bytes());
        width.max(height) <= max.side_samples && bound_bytes <= max_buffer_bytes && bytes <= max.bytes
    };
    let divided = DividedImage { size: image.size, rendered_size: rendered.size, camera: &scene.camera };
    divide(&divided, fits).ok_or_else(|| {
        let mebibytes = |bytes: u64| format!("{} MiB", bytes.div_ceil(1 << 20));
        beyond("more memory for a single pixel".to_owned(), mebibytes(max.bytes))
    })
}

impl ImageTile {
    /// Bytes of its planes as they are read back.
    pub(crate) fn packed_bytes(&self, annotations: Annotations) -> u64 {
        Packing::new(self.image.size, annotations).bytes()
    }

    /// An error of this tile, with the position in the image.
    pub(crate) fn in_image(self, error: Error) -> Error {
        let [left, top] = self.image.origin;
        match error {
            Error::Unlabelled { pixels, column, row, frame } => {
                Error::Unlabelled { pixels, column: left + column, row: top + row, frame }
            }
            other => other,
        }
    }
}

/// A frame of which tiles are added.
#[derive(Debug)]
pub(crate) struct TiledFrame {
    frame: Frame,
}

impl TiledFrame {
    /// A frame of this size without any tile.
    pub(crate) fn new([width, height]: [u32; 2]) -> Self {
        Self { frame: Frame { width, height, ..Frame::default() } }
    }

    /// Adds a tile that was read back.
    pub(crate) fn add(&mut self, tile: ImageTile, planes: &Frame) {
        assemble::place(&mut self.frame, planes, tile.image.origin);
    }

    /// The frame, of which all tiles were added.
    pub(crate) fn finish(self) -> Frame {
        self.frame
    }
}
