//! Shadow maps: of rocks by midpoint shadow maps, of the ground by its horizon. The map of the rocks is rasterised by one of three
//! backends with the same stages: `place_tiles`, `prepare`, `record`.
//! Must not know: what is visible.

pub(in crate::render) mod compute;
mod device;
mod device_map;
pub mod horizon;
pub mod host;
pub mod tiles;

use std::ops::Range;
use std::time::Instant;

use wgpu::TextureUsages;

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::staging::{StagingBuffer, StagingBuffers};
use crate::render::backend::RasterBackend;
use crate::render::device::bind_groups::{BindLayouts, RasterGroups, SHADOW_MAP_FORMAT};
use crate::render::device::timing::{Pass, Timer, milliseconds};
use crate::render::select::selection::Selection;
use crate::render::visibility::meshes::Meshes;
use crate::scene::Scene;
use compute::ComputeShadow;
use device::ShadowPass;
use device_map::DeviceMap;
pub(crate) use device_map::MapSource;
use tiles::{NewTile, ShadowMap};

/// The room for new tiles in the staging buffer is a multiple of this, bytes: frames differ a little in what they need.
const STAGING_STEP_BYTES: usize = 4 << 20;
/// Most bytes of tiles that are uploaded at once.
const STAGING_BYTES: usize = 16 << 20;

/// Backend of the shadow map of the rocks.
#[derive(Debug)]
pub(crate) enum ShadowBackend {
    /// Render passes on the device.
    Device(ShadowPass),
    /// A compute pass on the device.
    Compute(Box<ComputeShadow>),
    /// The CPU rasteriser, whose tiles are uploaded.
    Host(ShadowRaster),
}

impl ShadowBackend {
    /// A backend that has rasterised nothing yet.
    pub(crate) fn new(backend: RasterBackend) -> Self {
        match backend {
            RasterBackend::Device => Self::Device(ShadowPass::default()),
            RasterBackend::Compute => Self::Compute(Box::default()),
            RasterBackend::Host => Self::Host(ShadowRaster::default()),
        }
    }

    /// Gives the tiles of a selection's casters their origins in the map, and returns its columns and rows. `None` where the device makes the
    /// map: those of a plan are placed already.
    pub(crate) fn place_tiles(
        &mut self,
        scene: &Scene,
        selection: &mut Selection,
        max_texture_px: u32,
    ) -> Option<[u32; 2]> {
        match self {
            Self::Device(_) | Self::Compute(_) => None,
            Self::Host(raster) => Some(raster.place_tiles(scene, selection, max_texture_px)),
        }
    }

    /// Prepares everything for [`Self::record`], with a map of exactly this many columns and rows, which the device makes of `source`. The
    /// casters are draws of the meshes. Returns the bytes that were uploaded.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        (scene, source, size_px): (&Scene, Option<MapSource>, [u32; 2]),
        (casters, staging): ((&Meshes, &Range<usize>), &mut StagingBuffers),
    ) -> Result<u64> {
        let of_device = |source: Option<MapSource>| source.expect("a plan for the device has a source");
        match self {
            Self::Device(pass) => {
                pass.prepare(gpu, layouts, of_device(source));
                Ok(0)
            }
            Self::Compute(pass) => pass.prepare(gpu, layouts, of_device(source), casters),
            Self::Host(raster) => raster.prepare(gpu, scene, size_px, staging),
        }
    }

    /// The map.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(crate) fn map(&self) -> &wgpu::TextureView {
        match self {
            Self::Device(pass) => pass.map.view(),
            Self::Compute(pass) => pass.map.view(),
            Self::Host(raster) => &raster.texture().1,
        }
    }

    /// The map that the device makes.
    fn device_map(&self) -> Option<&DeviceMap> {
        match self {
            Self::Device(pass) => Some(&pass.map),
            Self::Compute(pass) => Some(&pass.map),
            Self::Host(_) => None,
        }
    }

    /// Records the passes that make the map of `casters`, which are draws of `meshes`: none where it was uploaded, or where the device
    /// has it from an earlier frame.
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        casters: &Range<usize>,
        groups: &RasterGroups,
        timer: Option<&Timer>,
    ) {
        if self.device_pass().is_none() {
            return;
        }
        match self {
            Self::Device(pass) => {
                let timestamps = timer.map(|timer| timer.render_and_compute_pass(Pass::Shadow));
                pass.record(encoder, meshes, casters, groups, timestamps);
            }
            Self::Compute(pass) => {
                pass.record(encoder, groups, timer.map(|timer| timer.compute_pass(Pass::Shadow)));
            }
            Self::Host(_) => {}
        }
    }

    /// The pass whose time the device measures.
    pub(crate) fn device_pass(&self) -> Option<Pass> {
        self.device_map().filter(|map| !map.is_kept()).map(|_| Pass::Shadow)
    }

    /// The time that the host took for the frame, milliseconds.
    pub(crate) const fn host_ms(&self) -> Option<f64> {
        match self {
            Self::Device(_) | Self::Compute(_) => None,
            Self::Host(raster) => Some(raster.elapsed_ms),
        }
    }
}

/// The host backend: tiles that the map has stay while the sun and their casters do.
#[derive(Debug, Default)]
pub(crate) struct ShadowRaster {
    tiles: ShadowMap,
    /// Tiles that the map does not have yet.
    new_tiles: Vec<NewTile>,
    map: Option<(wgpu::Texture, wgpu::TextureView)>,
    elapsed_ms: f64,
}

impl ShadowRaster {
    fn place_tiles(&mut self, scene: &Scene, selection: &mut Selection, max_texture_px: u32) -> [u32; 2] {
        let start = Instant::now();
        self.new_tiles = self.tiles.allocate(scene, selection, max_texture_px);
        self.elapsed_ms = milliseconds(start.elapsed());
        self.tiles.size_px()
    }

    fn prepare(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        size_px: [u32; 2],
        staging: &mut StagingBuffers,
    ) -> Result<u64> {
        let has_size = |texture: &wgpu::Texture| [texture.width(), texture.height()] == size_px;
        if !self.map.as_ref().is_some_and(|(texture, _)| has_size(texture)) {
            let usage = TextureUsages::COPY_DST | TextureUsages::TEXTURE_BINDING;
            // The old one first: both need not fit.
            self.map = None;
            self.map = Some(gpu.texture("shadow/map", size_px, SHADOW_MAP_FORMAT, usage));
        }
        let start = Instant::now();
        let mut uploaded = 0;
        let (staging, max_bytes) = staging.first(STAGING_BYTES);
        for bands in tiles::upload_parts(&tiles::bands(&self.new_tiles), max_bytes) {
            let (regions, bytes) = tiles::upload_regions(bands);
            let room = bytes.next_multiple_of(STAGING_STEP_BYTES);
            let staging = StagingBuffer::with_capacity(staging, gpu, "shadow/staging", room)?;
            staging.write(gpu, |pages| host::rasterise(scene, bands, pages))?;
            let (texture, _) = self.map.as_ref().expect("it was just made");
            staging.copy_to(gpu, texture, &regions)?;
            uploaded += bytes as u64;
        }
        self.elapsed_ms += milliseconds(start.elapsed());
        Ok(uploaded)
    }

    fn texture(&self) -> &(wgpu::Texture, wgpu::TextureView) {
        self.map.as_ref().expect("a map is prepared before it is used")
    }
}
