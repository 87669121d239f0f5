//! Visibility: the nearest surface at each sample, written to the G-buffer by one of three backends with the same stages:
//! `find`, then for each tile of the image `fill` and `record`.
//! Must not know: how surfaces are shaded.

pub(in crate::render) mod compute;
mod device;
#[cfg(test)]
mod exact_check;
pub mod geometry;
pub mod host;
pub(crate) mod mesh_places;
pub(crate) mod meshes;
pub(crate) mod packed_vertices;
pub(crate) mod triangle_groups;

use std::ops::Range;
use std::time::Instant;

use wgpu::{TextureFormat, TextureUsages};

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::staging::{PAGE_BYTES, Page, StagingBuffer, StagingBuffers, TextureRegion};
use crate::render::backend::{LightingMode, RasterBackend, RasterOptions};
use crate::render::device::bind_groups::{BindLayouts, RasterGroups};
use crate::render::device::depth::STENCIL_FORMAT;
use crate::render::device::timing::{Pass, Timer, milliseconds};
use crate::render::lighting::gbuffer::{GBuffer, GBufferLayout, SLOPES_FORMAT, VISIBILITY_FORMAT};
use crate::render::lighting::relief_bands::ReliefBands;
use crate::render::select::draw_list::DrawBatch;
use crate::render::select::full_sun::FullSun;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::Selection;
use crate::render::select::tiles::PixelRect;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use compute::ComputeVisibility;
use device::VisibilityPass;
use geometry::VisibleTriangles;
use host::{RowsPart, ShadingBinMask};
use meshes::Meshes;

/// Most bytes that are uploaded at once.
const STAGING_BYTES: u32 = 32 << 20;
/// The staging buffer's size is a multiple of this, bytes: frames differ a little in what they need.
const STAGING_STEP_BYTES: usize = 4 << 20;

/// The parts of a frame plan that the stage reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VisibilityInputs<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) settings: &'a RenderSettings,
    pub(crate) selection: &'a Selection,
    pub(crate) caster_grid: &'a [u32],
    pub(crate) bands: &'a ReliefBands,
    /// The draws of the plan, of these meshes.
    pub(crate) draws: (&'a Meshes, &'a [DrawBatch]),
    /// Triangles are binned by what can shade them ([`crate::render::backend::RasterOptions`]).
    pub(crate) bin_by_shadow_sources: bool,
    /// Where other ground shades none, for samples to be binned by that too.
    pub(crate) full_sun: Option<&'a FullSun>,
}

/// Backend of the visibility stage.
#[derive(Debug)]
pub(crate) enum VisibilityBackend {
    /// A render pass on the device.
    Device(VisibilityPass),
    /// A compute pass on the device.
    Compute(Box<ComputeVisibility>),
    /// The CPU rasteriser, whose samples are uploaded.
    Host(Box<VisibilityRaster>),
}

impl VisibilityBackend {
    /// A backend that has rasterised nothing yet.
    pub(crate) fn new(options: &RasterOptions) -> Self {
        match options.visibility {
            RasterBackend::Device => Self::Device(VisibilityPass::new(options.lighting)),
            RasterBackend::Compute => Self::Compute(Box::new(ComputeVisibility::new(options.lighting))),
            RasterBackend::Host => Self::Host(Box::default()),
        }
    }

    /// The G-buffer that it fills for a scene.
    pub(crate) const fn gbuffer_layout(&self, scene: &Scene) -> GBufferLayout {
        match self {
            Self::Device(pass) => GBufferLayout {
                write_usage: TextureUsages::RENDER_ATTACHMENT,
                depth_stencil_format: Some(pass.depth_stencil_format()),
                is_computed: matches!(pass.lighting, LightingMode::Compute),
                has_slopes: false,
                has_host_stencil: false,
            },
            Self::Compute(pass) => GBufferLayout {
                write_usage: TextureUsages::STORAGE_BINDING,
                depth_stencil_format: None,
                is_computed: matches!(pass.lighting, LightingMode::Compute),
                has_slopes: false,
                has_host_stencil: false,
            },
            Self::Host(_) => GBufferLayout {
                write_usage: TextureUsages::COPY_DST,
                depth_stencil_format: Some(STENCIL_FORMAT),
                is_computed: false,
                has_slopes: scene.relief.is_some(),
                has_host_stencil: true,
            },
        }
    }

    /// Finds what may be visible in the image, for [`Self::fill`]. Returns the bytes that were uploaded.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] if its meshes are too large for a compute pass.
    pub(crate) fn find(
        &mut self,
        gpu: &Gpu,
        layouts: &BindLayouts,
        inputs: VisibilityInputs<'_>,
    ) -> Result<u64> {
        match self {
            Self::Device(pass) => pass.prepare(gpu, layouts),
            Self::Compute(pass) => return pass.prepare(gpu, layouts, inputs.draws),
            Self::Host(raster) => raster.find(inputs),
        }
        Ok(0)
    }

    /// Prepares everything for [`Self::record`] of a rectangle of the image's samples, the G-buffer's, and sets the G-buffer's
    /// batches. `batches` are those of the plan. Returns the bytes that were uploaded.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(crate) fn fill(
        &mut self,
        gpu: &Gpu,
        batches: &[DrawBatch],
        samples: PixelRect,
        (gbuffer, staging): (&mut GBuffer, &mut StagingBuffers),
    ) -> Result<u64> {
        gbuffer.batches = batches.to_vec();
        gbuffer.dome_stencil = None;
        let bytes = match self {
            Self::Device(_) => 0,
            Self::Compute(pass) => {
                pass.reserve(gpu, gbuffer.sample_size);
                0
            }
            Self::Host(raster) => raster.fill(gpu, samples, gbuffer, staging)?,
        };
        gbuffer.batches.retain(|batch| batch.bounds != ScreenBounds::EMPTY);
        for batch in &mut gbuffer.batches {
            batch.bounds = batch.bounds.relative_to(samples.origin);
        }
        Ok(bytes)
    }

    /// Records the pass that draws the G-buffer's batches, which are draws of `meshes`: none where it was uploaded.
    pub(crate) fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &Meshes,
        groups: &RasterGroups,
        (gbuffer, timer): (&GBuffer, Option<&Timer>),
    ) {
        match self {
            Self::Device(pass) => {
                let timestamps = timer.map(|timer| timer.render_pass(Pass::Visibility));
                pass.record(encoder, meshes, groups, gbuffer, timestamps);
            }
            Self::Compute(pass) => {
                let timestamps = timer.map(|timer| timer.compute_pass(Pass::Visibility));
                pass.record(gpu, encoder, meshes, groups, (gbuffer, timestamps));
            }
            Self::Host(_) => {}
        }
    }

    /// The pass whose time the device measures.
    pub(crate) const fn device_pass(&self) -> Option<Pass> {
        match self {
            Self::Device(_) | Self::Compute(_) => Some(Pass::Visibility),
            Self::Host(_) => None,
        }
    }

    /// The time that the host took for the frame, milliseconds.
    pub(crate) const fn host_ms(&self) -> Option<f64> {
        match self {
            Self::Device(_) | Self::Compute(_) => None,
            Self::Host(raster) => Some(raster.elapsed_ms),
        }
    }

    /// Triangles that are rasterised for the frame.
    pub(crate) fn triangles(&self, meshes: &Meshes, batches: &[DrawBatch]) -> u64 {
        match self {
            Self::Device(_) | Self::Compute(_) => {
                batches.iter().map(|batch| meshes.triangles(&batch.draws)).sum()
            }
            Self::Host(raster) => raster.triangles(),
        }
    }
}

/// The host backend. Its memory is used again for the next frame.
#[derive(Debug, Default)]
pub(crate) struct VisibilityRaster {
    triangles: VisibleTriangles,
    /// Columns and rows of samples of the image.
    sample_size: [u32; 2],
    elapsed_ms: f64,
}

impl VisibilityRaster {
    fn find(&mut self, inputs: VisibilityInputs<'_>) {
        let start = Instant::now();
        let VisibilityInputs { scene, settings, selection, caster_grid, bands, .. } = inputs;
        self.triangles.find(scene, selection, settings, caster_grid, bands, inputs.bin_by_shadow_sources);
        if let Some(full_sun) = inputs.full_sun {
            self.triangles.bin_by_full_sun(full_sun, scene.camera.eye);
        }
        self.sample_size = settings.sample_size();
        self.elapsed_ms = milliseconds(start.elapsed());
    }

    fn fill(
        &mut self,
        gpu: &Gpu,
        samples: PixelRect,
        gbuffer: &mut GBuffer,
        staging: &mut StagingBuffers,
    ) -> Result<u64> {
        let start = Instant::now();
        let bins = self.triangles.bins();
        for mesh in self.triangles.meshes() {
            for (bin, bounds) in self.triangles.bins_and_bounds(mesh) {
                let batch = &mut gbuffer.batches[usize::from(bins.merge_bands(bin))];
                batch.bounds = batch.bounds.union(bounds);
            }
        }
        let bytes = self.rasterise(gpu, samples, gbuffer, staging)?;
        gbuffer.dome_stencil = Some(bins.dome() + 1);
        self.elapsed_ms += milliseconds(start.elapsed());
        Ok(bytes)
    }

    /// Rasterises in parts that fit into the staging buffer and uploads each. Returns the bytes that were uploaded.
    fn rasterise(
        &mut self,
        gpu: &Gpu,
        samples: PixelRect,
        gbuffer: &mut GBuffer,
        staging: &mut StagingBuffers,
    ) -> Result<u64> {
        let [width, _] = samples.size;
        // Rows are shared out to threads, and so begin with pages.
        let bytes_of = |format: TextureFormat, width: u32| {
            (format.block_copy_size(None).unwrap_or(0) as usize * width as usize).next_multiple_of(PAGE_BYTES)
        };
        let each_bytes = |width: u32| {
            let slopes_bytes = gbuffer.slopes.as_ref().map_or(0, |_| bytes_of(SLOPES_FORMAT, width));
            [bytes_of(VISIBILITY_FORMAT, width), slopes_bytes]
        };
        // The image is divided into the same bands of rows whether it is drawn whole or in tiles: numbers are rounded relative to the
        // first row of a band.
        let [image_width, image_height] = self.sample_size;
        let rows_at_once =
            (STAGING_BYTES / each_bytes(image_width).iter().sum::<usize>() as u32).clamp(1, image_height);
        let each_bytes = each_bytes(width);
        let row_bytes = each_bytes[0] + each_bytes[1];
        let (staging, max_bytes) = staging.second(STAGING_BYTES as usize);
        let rows_of_upload = rows_of_upload(rows_at_once, max_bytes / row_bytes);
        let largest_part = rows_of_upload.min(samples.size[1]) as usize * row_bytes;
        let largest_part = largest_part.next_multiple_of(STAGING_STEP_BYTES);
        let staging = StagingBuffer::with_capacity(staging, gpu, "gbuffer/staging", largest_part)?;
        let [first_row, end_row] = [samples.origin[1], samples.origin[1] + samples.size[1]];
        // Rows that only the frame before covered are cleared.
        let within =
            |rows: Range<u32>| rows.start.clamp(first_row, end_row)..rows.end.clamp(first_row, end_row);
        let covered = within(self.triangles.surface_rows());
        let before =
            std::mem::replace(&mut gbuffer.written_rows, covered.start - first_row..covered.end - first_row);
        let before = first_row + before.start..first_row + before.end;
        let written = [covered, before].into_iter().filter(|rows| !rows.is_empty());
        let written = written.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0);
        let mut stencil = ShadingBinMask { values: gbuffer.host_stencil.take().unwrap_or_default() };
        stencil.restart(gbuffer.sample_size);
        for rows in parts(0..image_height, rows_at_once).flat_map(|rows| parts(rows, rows_of_upload)) {
            if rows.end <= first_row || rows.start >= end_row {
                continue;
            }
            let uploaded = written.start.max(rows.start)..written.end.min(rows.end);
            let part =
                RowsPart { image_width: image_width as usize, samples, rows, uploaded: uploaded.clone() };
            let mut draw = |pages: &mut dyn Iterator<Item = Page<'_>>| {
                stencil.draw(&self.triangles, &part, (pages, each_bytes));
            };
            if uploaded.is_empty() {
                draw(&mut std::iter::empty());
                continue;
            }
            staging.write(gpu, draw)?;
            let (origin, size) = ([0, uploaded.start - first_row], [width, uploaded.len() as u32]);
            let region = TextureRegion { offset_bytes: 0, row_bytes, origin, size };
            staging.copy_to(gpu, &gbuffer.visibility.0, &[region])?;
            if let Some((slopes, _)) = &gbuffer.slopes {
                staging.copy_to(gpu, slopes, &[TextureRegion { offset_bytes: each_bytes[0], ..region }])?;
            }
        }
        let padded = gbuffer.padded(&stencil.values);
        let values = padded.as_ref().unwrap_or(&stencil.values);
        gpu.guard(|| gpu.write_texels(&gbuffer.depth_stencil.0, gbuffer.capacity(), values))?;
        let bytes = row_bytes as u64 * written.len() as u64 + stencil.values.len() as u64;
        gbuffer.host_stencil = Some(stencil.values);
        Ok(bytes)
    }

    fn triangles(&self) -> u64 {
        self.triangles.meshes().iter().map(|mesh| mesh.triangles.len() as u64).sum()
    }
}

/// Parts of at most `count` rows.
fn parts(rows: Range<u32>, count: u32) -> impl Iterator<Item = Range<u32>> {
    let end = rows.end;
    rows.step_by(count as usize).map(move |first| first..end.min(first + count))
}

/// Rows that are uploaded at once, of `rows_at_once` that may be and where the staging buffer has room for `max_rows`: all, or whole bands.
fn rows_of_upload(rows_at_once: u32, max_rows: usize) -> u32 {
    if rows_at_once as usize <= max_rows {
        return rows_at_once;
    }
    let bands = (max_rows / host::BAND_ROWS).max(1);
    (bands * host::BAND_ROWS).min(rows_at_once as usize) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::device::shading_bins::{ShadingBins, ShadowSources};

    #[test]
    fn uploads_begin_where_bands_of_the_image_do() {
        let (rows_at_once, height) = (910, 2000);
        let bands = |rows| parts(rows, host::BAND_ROWS as u32);
        let of_image: Vec<Range<u32>> = parts(0..height, rows_at_once).flat_map(bands).collect();
        for max_rows in [1, 31, 32, 100, 909, 910, 5000] {
            let rows = rows_of_upload(rows_at_once, max_rows);
            assert!(rows as usize <= max_rows.max(host::BAND_ROWS), "{rows} rows for {max_rows}");
            let uploads = parts(0..height, rows_at_once).flat_map(|part| parts(part, rows));
            assert_eq!(uploads.flat_map(bands).collect::<Vec<_>>(), of_image, "{max_rows} rows at once");
        }
    }

    #[test]
    fn blocks_whose_ground_is_all_in_full_sun_leave_it_out() {
        let value = |sources| ShadingBins::ground(0, sources) + 1;
        let (both, ground) = (value(ShadowSources::GroundAndRocks), value(ShadowSources::Ground));
        let (rocks, none) = (value(ShadowSources::Rocks), value(ShadowSources::None));
        let of_rock = ShadingBins::rocks(ShadowSources::GroundAndRocks) + 1;
        // Two blocks side by side, two samples beside them, and a row below.
        let mut mask = [
            [ground, both, ground, of_rock, ground, ground, ground, ground, ground, ground],
            [0, ground, ground, ground, ground, ground, both, ground, ground, ground],
            [ground, ground, ground, ground, both, both, both, none, ground, ground],
        ];
        let mut in_full_sun = [[1; 10]; 3];
        (in_full_sun[0][3], in_full_sun[1][0]) = (0, 0);
        in_full_sun[1][6] = 0;
        host::bin_by_full_sun(mask.as_flattened_mut(), in_full_sun.as_flattened_mut(), 10);
        assert_eq!(
            mask,
            [
                [none, rocks, none, of_rock, ground, ground, ground, ground, ground, ground],
                [0, none, none, none, ground, ground, both, ground, ground, ground],
                [none, none, none, none, rocks, rocks, rocks, none, ground, ground],
            ]
        );
    }
}
