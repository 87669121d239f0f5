//! Visibility: the nearest surface at each sample, written to the G-buffer by one of two backends with the same stages:
//! `prepare`, `record`.
//! Must not know: how surfaces are shaded.

mod device;
pub mod geometry;
pub mod host;
pub(crate) mod meshes;

use std::time::Instant;

use wgpu::{TextureFormat, TextureUsages};

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::staging::{PAGE_BYTES, Page, StagingBuffer, TextureRegion};
use crate::render::backend::{LightingMode, RasterBackend, RasterOptions};
use crate::render::device::bind_groups::BindLayouts;
use crate::render::device::depth::{DEPTH_FORMAT, DEPTH_STENCIL_FORMAT, STENCIL_FORMAT};
use crate::render::device::timing::{Pass, Timer, milliseconds};
use crate::render::lighting::gbuffer::{GBuffer, GBufferLayout, SLOPES_FORMAT, VISIBILITY_FORMAT};
use crate::render::lighting::relief_bands::ReliefBands;
use crate::render::select::draw_list::DrawBatch;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::Selection;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use device::VisibilityPass;
use geometry::VisibleTriangles;
use host::ShadingBinMask;
use meshes::Meshes;

/// Most bytes that are uploaded at once.
const STAGING_BYTES: u32 = 32 << 20;

/// The parts of a frame plan that the stage reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VisibilityInputs<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) settings: &'a RenderSettings,
    pub(crate) selection: &'a Selection,
    pub(crate) caster_grid: &'a [u32],
    pub(crate) bands: &'a ReliefBands,
    /// A batch for each shading bin, by bin.
    pub(crate) batches: &'a [DrawBatch],
    /// Triangles are binned by what can shade them ([`crate::render::backend::RasterOptions`]).
    pub(crate) bin_by_shadow_sources: bool,
}

/// Backend of the visibility stage.
#[derive(Debug)]
pub(crate) enum VisibilityBackend {
    /// A render pass on the device.
    Device(VisibilityPass),
    /// The CPU rasteriser, whose samples are uploaded.
    Host(Box<VisibilityRaster>),
}

impl VisibilityBackend {
    /// A backend that has rasterised nothing yet.
    pub(crate) fn new(options: &RasterOptions) -> Self {
        match options.visibility {
            RasterBackend::Device => Self::Device(VisibilityPass::new(match options.lighting {
                LightingMode::Bins => DEPTH_STENCIL_FORMAT,
                LightingMode::OneDraw => DEPTH_FORMAT,
            })),
            RasterBackend::Host => Self::Host(Box::default()),
        }
    }

    /// The G-buffer that it fills for a scene.
    pub(crate) const fn gbuffer_layout(&self, scene: &Scene) -> GBufferLayout {
        match self {
            Self::Device(pass) => GBufferLayout {
                write_usage: TextureUsages::RENDER_ATTACHMENT,
                depth_stencil_format: pass.depth_stencil_format,
                has_slopes: false,
                has_host_stencil: false,
            },
            Self::Host(_) => GBufferLayout {
                write_usage: TextureUsages::COPY_DST,
                depth_stencil_format: STENCIL_FORMAT,
                has_slopes: scene.relief.is_some(),
                has_host_stencil: true,
            },
        }
    }

    /// Prepares everything for [`Self::record`], and sets the G-buffer's batches. Returns the bytes that were
    /// uploaded.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        inputs: VisibilityInputs<'_>,
        gbuffer: &mut GBuffer,
        staging: &mut Option<StagingBuffer>,
    ) -> Result<u64> {
        let bytes = match self {
            Self::Device(pass) => {
                pass.prepare(gpu, layouts);
                gbuffer.batches = inputs.batches.to_vec();
                gbuffer.dome_stencil = None;
                0
            }
            Self::Host(raster) => raster.prepare(gpu, inputs, gbuffer, staging)?,
        };
        gbuffer.batches.retain(|batch| batch.bounds != ScreenBounds::EMPTY);
        Ok(bytes)
    }

    /// Records the pass that draws the G-buffer's batches, which are draws of `meshes`: none where it was uploaded.
    pub(crate) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        groups: [&wgpu::BindGroup; 2],
        gbuffer: &GBuffer,
        timer: Option<&Timer>,
    ) {
        if let Self::Device(pass) = self {
            let timestamps = timer.map(|timer| timer.render_pass(Pass::Visibility));
            pass.record(encoder, meshes, groups, gbuffer, timestamps);
        }
    }

    /// The pass whose time the device measures.
    pub(crate) const fn device_pass(&self) -> Option<Pass> {
        match self {
            Self::Device(_) => Some(Pass::Visibility),
            Self::Host(_) => None,
        }
    }

    /// The time that the host took for the frame, milliseconds.
    pub(crate) const fn host_ms(&self) -> Option<f64> {
        match self {
            Self::Device(_) => None,
            Self::Host(raster) => Some(raster.elapsed_ms),
        }
    }

    /// Triangles that are rasterised for the frame.
    pub(crate) fn triangles(&self, meshes: &Meshes, batches: &[DrawBatch]) -> u64 {
        match self {
            Self::Device(_) => batches.iter().map(|batch| meshes.triangles(&batch.draws)).sum(),
            Self::Host(raster) => raster.triangles(),
        }
    }
}

/// The host backend. Its memory is used again for the next frame.
#[derive(Debug, Default)]
pub(crate) struct VisibilityRaster {
    triangles: VisibleTriangles,
    elapsed_ms: f64,
}

impl VisibilityRaster {
    fn prepare(
        &mut self,
        gpu: &Gpu,
        inputs: VisibilityInputs<'_>,
        gbuffer: &mut GBuffer,
        staging: &mut Option<StagingBuffer>,
    ) -> Result<u64> {
        let start = Instant::now();
        let VisibilityInputs { scene, settings, selection, caster_grid, bands, .. } = inputs;
        self.triangles.find(scene, selection, settings, caster_grid, bands, inputs.bin_by_shadow_sources);
        let bins = self.triangles.bins();
        gbuffer.batches = inputs.batches.to_vec();
        for mesh in self.triangles.meshes() {
            for (bin, bounds) in mesh.bins.iter().zip(mesh.bounds) {
                let batch = &mut gbuffer.batches[usize::from(bins.merge_bands(*bin))];
                batch.bounds = batch.bounds.union(bounds);
            }
        }
        let bytes = self.rasterise(gpu, gbuffer, staging)?;
        gbuffer.dome_stencil = Some(bins.dome() + 1);
        self.elapsed_ms = milliseconds(start.elapsed());
        Ok(bytes)
    }

    /// Rasterises in parts that fit into the staging buffer and uploads each. Returns the bytes that were uploaded.
    fn rasterise(
        &self,
        gpu: &Gpu,
        gbuffer: &mut GBuffer,
        staging: &mut Option<StagingBuffer>,
    ) -> Result<u64> {
        let [width, height] = gbuffer.sample_size;
        // Rows are shared out to threads, and so begin with pages.
        let bytes_of = |format: TextureFormat| {
            (format.block_copy_size(None).unwrap_or(0) as usize * width as usize).next_multiple_of(PAGE_BYTES)
        };
        let slopes_bytes = gbuffer.slopes.as_ref().map_or(0, |_| bytes_of(SLOPES_FORMAT));
        let each_bytes = [bytes_of(VISIBILITY_FORMAT), slopes_bytes];
        let row_bytes = each_bytes[0] + each_bytes[1];
        let rows_at_once = (STAGING_BYTES / row_bytes as u32).clamp(1, height);
        let staging =
            StagingBuffer::with_capacity(staging, gpu, "gbuffer/staging", row_bytes * rows_at_once as usize)?;
        // Rows that only the frame before covered are cleared.
        let covered = self.triangles.surface_rows();
        let before = std::mem::replace(&mut gbuffer.written_rows, covered.clone());
        let written = [covered, before].into_iter().filter(|rows| !rows.is_empty());
        let written = written.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0);
        let mut stencil = ShadingBinMask { values: gbuffer.host_stencil.take().unwrap_or_default() };
        stencil.restart(gbuffer.sample_size);
        for first in (0..height).step_by(rows_at_once as usize) {
            let rows = first..height.min(first + rows_at_once);
            let uploaded = written.start.max(rows.start)..written.end.min(rows.end);
            let mut draw = |pages: &mut dyn Iterator<Item = Page<'_>>| {
                stencil.draw(&self.triangles, width as usize, &rows, &uploaded, (pages, each_bytes));
            };
            if uploaded.is_empty() {
                draw(&mut std::iter::empty());
                continue;
            }
            staging.write(gpu, draw)?;
            let size = [width, uploaded.len() as u32];
            let part = TextureRegion { offset_bytes: 0, row_bytes, origin: [0, uploaded.start], size };
            staging.copy_to(gpu, &gbuffer.visibility.0, &[part])?;
            if let Some((slopes, _)) = &gbuffer.slopes {
                staging.copy_to(gpu, slopes, &[TextureRegion { offset_bytes: each_bytes[0], ..part }])?;
            }
        }
        gpu.guard(|| gpu.write_texels(&gbuffer.depth_stencil.0, gbuffer.sample_size, &stencil.values))?;
        let bytes = row_bytes as u64 * written.len() as u64 + stencil.values.len() as u64;
        gbuffer.host_stencil = Some(stencil.values);
        Ok(bytes)
    }

    fn triangles(&self) -> u64 {
        self.triangles.meshes().iter().map(|mesh| mesh.triangles.len() as u64).sum()
    }
}
