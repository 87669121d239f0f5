//! The visibility pass on the CPU, for software adapters: G-buffer rows and the shading bin of each sample.
//!
//! CPU counterpart of `visibility.wgsl`. The samples are divided into bands of rows, each rasterised by one thread into a buffer
//! that stays in its cache.
//! Must not know: textures, what is lit from them.

use std::cell::RefCell;
use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8, mask32x8, u32x8};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::gpu::staging::{PAGE_BYTES, Page, PageWriter};
use crate::render::device::shading_bins::{ShadingBin, ShadingBins};
use crate::render::lighting::gbuffer::MAX_NORMAL_CODE;
use crate::render::lighting::slopes_host::{GBufferRow, ReliefSlopes};
use crate::render::raster::fill::FragmentSink;
use crate::render::raster::lanes::{
    BLOCK_HEIGHT, BLOCK_WIDTH, LANES, load_block, load_block_u32, store_block, store_block_u32,
};
use crate::render::raster::setup::{Interpolant, TriangleSetup};
use crate::render::raster::setup8::{TriangleSetup8, TriangleVertices8};
use crate::render::select::tiles::PixelRect;
use crate::render::visibility::geometry::{ScreenMesh, ScreenTriangle, VisibleTriangles};

/// Rows of a band.
pub(super) const BAND_ROWS: usize = 32;
/// The bit of [`GBufferBand::bins_and_slots`] where the slot of the instance begins.
const SLOT_SHIFT: u32 = ShadingBin::BITS;

thread_local! {
    /// One per thread, so that its memory is reused.
    static BAND: RefCell<GBufferBand> = RefCell::default();
}

/// The shading bin of each sample, as the stencil holds it.
#[derive(Debug, Default)]
pub struct ShadingBinMask {
    /// One more than the bin, row by row; 0 where no surface was drawn. The bins of all relief bands are merged
    /// (`ShadingBins::merge_bands`).
    pub values: Vec<u8>,
}

/// Rows that are rasterised at once.
#[derive(Clone, Debug)]
pub struct RowsPart {
    /// Columns of the image's samples.
    pub image_width: usize,
    /// The samples of the image that are kept: those of a tile.
    pub samples: PixelRect,
    /// Rows that are divided into bands; those beside the tile are left out.
    pub rows: Range<u32>,
    /// Those of its rows in the tile that are uploaded.
    pub uploaded: Range<u32>,
}

/// A band of rows that one thread rasterises.
struct BandJob<'a> {
    rows: Range<usize>,
    /// Those of its rows that are kept, and their mask.
    kept: Range<usize>,
    mask: &'a mut [u8],
    /// Those of its rows that are uploaded, and the memory that they are written to.
    uploaded: Range<usize>,
    pages: Vec<Page<'a>>,
}

/// What the bands of a part have in common.
#[derive(Clone, Copy)]
struct BandTarget<'a> {
    triangles: &'a VisibleTriangles,
    /// Columns of the image's samples.
    image_width: usize,
    /// First and end of the columns that are kept.
    columns: [usize; 2],
    /// Bytes of a row of the visibility buffer and of the slopes.
    row_bytes: [usize; 2],
}

/// The rows that are in both.
fn intersection(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    let start = a.start.max(b.start);
    start..a.end.min(b.end).max(start)
}

impl ShadingBinMask {
    /// Resizes it for this many columns and rows of samples, none of which is drawn yet.
    pub fn restart(&mut self, [width, height]: [u32; 2]) {
        self.values.resize(width as usize * height as usize, 0);
    }

    /// Rasterises the rows of a part that lie in its tile. Those that are uploaded are written to `pages`: the G-buffer row as
    /// `visibility.wgsl` writes it, then the slopes of the ground if there are any, `row_bytes` of each.
    pub fn draw(
        &mut self,
        triangles: &VisibleTriangles,
        part: &RowsPart,
        (pages, row_bytes): (&mut dyn Iterator<Item = Page<'_>>, [usize; 2]),
    ) {
        let range = |first: u32, count: u32| first as usize..(first + count) as usize;
        let (rows, uploaded) = (&part.rows, &part.uploaded);
        let [rows, uploaded] = [rows, uploaded].map(|rows| rows.start as usize..rows.end as usize);
        let PixelRect { origin: [left, top], size: [width, height] } = part.samples;
        let (columns, tile_rows) = (range(left, width), range(top, height));
        let width = columns.len();
        let drawn = intersection(&rows, &tile_rows);
        let mut mask = &mut self.values[(drawn.start - tile_rows.start) * width..][..drawn.len() * width];
        let bands = rows.clone().step_by(BAND_ROWS).map(|first| first..rows.end.min(first + BAND_ROWS));
        let jobs: Vec<_> = bands
            .filter_map(|rows| {
                let kept = intersection(&rows, &tile_rows);
                let uploaded = intersection(&kept, &uploaded);
                let of_band = mask.split_off_mut(..kept.len() * width)?;
                let pages = pages.take(uploaded.len() * (row_bytes[0] + row_bytes[1]) / PAGE_BYTES).collect();
                (!kept.is_empty()).then_some(BandJob { rows, kept, mask: of_band, uploaded, pages })
            })
            .collect();
        let target = BandTarget {
            triangles,
            image_width: part.image_width,
            columns: [columns.start, columns.end],
            row_bytes,
        };
        // One job at a time per thread: their costs differ widely.
        jobs.into_par_iter()
            .with_max_len(1)
            .for_each(|job| BAND.with_borrow_mut(|band| band.run(job, target)));
    }
}

/// The G-buffer of a band of rows, in structures of arrays, with the extra columns and rows of [`BLOCK_WIDTH`].
#[derive(Debug, Default)]
struct GBufferBand {
    /// Samples from one row to the next.
    stride: usize,
    /// Inverse depth along the optical axis, 1/m; 0 where nothing is drawn yet.
    inverse_w: Vec<f32>,
    /// The octahedral coordinates of the vertex normal, 24 bits each.
    normal_x: Vec<u32>,
    normal_y: Vec<u32>,
    /// The packed normal of the triangle itself.
    face_normal: Vec<u32>,
    /// One more than the shading bin in the low bits, and the slot of the instance above; 0 where nothing is drawn yet.
    bins_and_slots: Vec<u32>,
    /// A row as it is uploaded, and the slopes of its ground.
    packed_row: Vec<[u32; 4]>,
    slopes_row: Vec<[f16; 4]>,
    /// Of each sample of a row, 1 if it is known to see all of the sun past other ground.
    sun_row: Vec<u8>,
    /// The same of all samples that are kept.
    in_full_sun: Vec<u8>,
}

/// A row of a [`GBufferBand`].
struct Row<'a> {
    inverse_w: &'a [f32],
    normal_x: &'a [u32],
    normal_y: &'a [u32],
    face_normal: &'a [u32],
    bins_and_slots: &'a [u32],
}

impl GBufferBand {
    /// Rasterises a band and writes its mask and its uploaded rows.
    fn run(&mut self, job: BandJob<'_>, target: BandTarget<'_>) {
        let BandJob { rows, kept, mask, uploaded, pages } = job;
        let BandTarget { triangles, image_width, columns: [left, right], row_bytes } = target;
        let bins = triangles.bins();
        self.clear(image_width, rows.len());
        let raster_rows = rows.start as i32..rows.end as i32;
        dispatch!(Level::new(), simd => {
            self.rasterise(simd, triangles.meshes(), bins, image_width, &raster_rows);
        });
        for (number, mask) in kept.clone().zip(mask.chunks_exact_mut(right - left)) {
            let row = self.row(number - rows.start, left..right);
            dispatch!(Level::new(), _simd => row.write_mask(bins, mask));
        }
        let mut packed_row = std::mem::take(&mut self.packed_row);
        let mut slopes_row = std::mem::take(&mut self.slopes_row);
        let mut sun_row = std::mem::take(&mut self.sun_row);
        let mut in_full_sun = std::mem::take(&mut self.in_full_sun);
        packed_row.resize(right - left, [0; 4]);
        slopes_row.resize(image_width, [f16::ZERO; 4]);
        sun_row.resize(image_width, 0);
        in_full_sun.clear();
        in_full_sun.resize((right - left) * kept.len(), 0);
        let mut writer = PageWriter::new(pages);
        for number in uploaded {
            let row = self.row(number - rows.start, left..right);
            dispatch!(Level::new(), _simd => row.pack(bins, &mut packed_row));
            writer.write_row(bytemuck::cast_slice(&packed_row), row_bytes[0]);
            if let Some(slopes) = triangles.slopes() {
                let row = self.row(number - rows.start, 0..image_width);
                slopes.set_row(number, &row.for_slopes(), (&mut slopes_row, &mut sun_row));
                let first = (right - left) * (number - kept.start);
                in_full_sun[first..first + right - left].copy_from_slice(&sun_row[left..right]);
                let bits = slopes_row[left..right].as_flattened().reinterpret_cast();
                writer.write_row(bytemuck::cast_slice(bits), row_bytes[1]);
            }
        }
        if triangles.slopes().is_some_and(ReliefSlopes::finds_full_sun) {
            dispatch!(Level::new(), _simd => bin_by_full_sun(mask, &mut in_full_sun, right - left));
        }
        (self.packed_row, self.slopes_row) = (packed_row, slopes_row);
        (self.sun_row, self.in_full_sun) = (sun_row, in_full_sun);
    }

    fn clear(&mut self, width: usize, rows: usize) {
        self.stride = width + BLOCK_WIDTH;
        let samples = self.stride * (rows + BLOCK_HEIGHT);
        self.inverse_w.clear();
        self.inverse_w.resize(samples, 0.0);
        self.bins_and_slots.clear();
        self.bins_and_slots.resize(samples, 0);
        // These are read only where a surface was drawn: whatever they hold may stay.
        for plane in [&mut self.normal_x, &mut self.normal_y, &mut self.face_normal] {
            plane.resize(samples, 0);
        }
    }

    // `inline(always)` all the way down to the fill loop, so that `dispatch!` compiles it for each vector width.
    #[inline(always)]
    fn rasterise<S: Simd>(
        &mut self,
        simd: S,
        meshes: &[ScreenMesh],
        bins: ShadingBins,
        width: usize,
        rows: &Range<i32>,
    ) {
        let misses_band =
            |[first, last]: [u16; 2]| i32::from(last) < rows.start || i32::from(first) >= rows.end;
        for mesh in meshes {
            if misses_band(mesh.rows) {
                continue;
            }
            let mut eight = [0; LANES];
            let mut count = 0;
            for (index, triangle) in mesh.triangles.iter().enumerate() {
                if misses_band(triangle.rows) {
                    continue;
                }
                eight[count] = index;
                count += 1;
                if count == LANES {
                    self.rasterise_eight(simd, mesh, &eight, bins, width, rows);
                    count = 0;
                }
            }
            self.rasterise_eight(simd, mesh, &eight[..count], bins, width, rows);
        }
    }

    /// Rasterises up to eight triangles of a mesh, given by their indices.
    #[inline(always)]
    fn rasterise_eight<S: Simd>(
        &mut self,
        simd: S,
        mesh: &ScreenMesh,
        indices: &[usize],
        bins: ShadingBins,
        width: usize,
        rows: &Range<i32>,
    ) {
        let mut vertices8 = TriangleVertices8::EMPTY;
        for (lane, &index) in indices.iter().enumerate() {
            let vertices = mesh.vertices_of(&mesh.triangles[index]);
            for (corner, vertex) in vertices.iter().enumerate() {
                vertices8.set(lane, corner, vertex.position, vertex.position_px, vertex.attributes());
            }
        }
        let setup8 = TriangleSetup8::new(simd, &vertices8, width, rows);
        let (first_row, stride) = (rows.start, self.stride);
        for (lane, &index) in indices.iter().enumerate() {
            let triangle = &mesh.triangles[index];
            if setup8.is_small(lane) && triangle.clipped().is_none() {
                let range = range_of(mesh.vertices_of(triangle).map(|vertex| vertex.inverse_w));
                let mut writer = self.writer(mesh, triangle, bins, (setup8.interpolants(lane), range));
                setup8.fill(simd, lane, first_row, stride, &mut writer);
                continue;
            }
            let vertices = mesh.vertices_of(triangle);
            let positions = vertices.map(|vertex| vertex.position);
            let Some(setup) = TriangleSetup::new(positions, width, rows) else { continue };
            let interpolants = mesh.interpolants(triangle, vertices, &setup);
            // What was clipped has corners of its own.
            let is_whole = triangle.clipped().is_none();
            let range =
                if is_whole { range_of(vertices.map(|vertex| vertex.inverse_w)) } else { [0.0, f32::MAX] };
            setup.fill(
                simd,
                first_row,
                stride,
                &mut self.writer(mesh, triangle, bins, (interpolants, range)),
            );
        }
    }

    /// The sink of a triangle.
    #[inline(always)]
    fn writer(
        &mut self,
        mesh: &ScreenMesh,
        triangle: &ScreenTriangle,
        bins: ShadingBins,
        (interpolants, range): ([Interpolant; 4], [f32; 2]),
    ) -> GBufferWriter<'_> {
        let bin = mesh.bins[triangle.shadow_sources()];
        let bin_and_slot = (u32::from(bin) + 1) | (mesh.slot << SLOT_SHIFT);
        let [inverse_w, x, y, z] = interpolants;
        // The sky has no normal.
        let normal = (bin < bins.stars()).then_some([x, y, z]);
        GBufferWriter {
            band: self,
            inverse_w,
            range,
            normal,
            face_normal: triangle.face_normal,
            bin_and_slot,
        }
    }

    /// These columns of a row.
    fn row(&self, row: usize, columns: Range<usize>) -> Row<'_> {
        let range = row * self.stride + columns.start..row * self.stride + columns.end;
        Row {
            inverse_w: &self.inverse_w[range.clone()],
            normal_x: &self.normal_x[range.clone()],
            normal_y: &self.normal_y[range.clone()],
            face_normal: &self.face_normal[range.clone()],
            bins_and_slots: &self.bins_and_slots[range],
        }
    }
}

/// Moves samples in full sun to the bins of ground that no other ground can shade: blocks of two rows and four columns, which a CPU driver
/// shades at once, whose ground is all in full sun. A block in two bins is shaded twice. `mask` has rows of this many columns, as
/// `in_full_sun`.
// `inline(always)` as `GBufferBand::rasterise`.
#[inline(always)]
pub(super) fn bin_by_full_sun(mask: &mut [u8], in_full_sun: &mut [u8], width: usize) {
    for (mask, flags) in mask.chunks_mut(2 * width).zip(in_full_sun.chunks_mut(2 * width)) {
        // From here on those of ground that other ground may shade.
        for (flag, value) in flags.iter_mut().zip(&*mask) {
            *flag = ShadingBins::is_shaded_by_ground(value.wrapping_sub(1)) & (1 - *flag);
        }
        let (upper, lower) = mask.split_at_mut(width);
        let (of_upper, of_lower) = flags.split_at(width);
        let of_lower = if of_lower.is_empty() { of_upper } else { of_lower };
        leave_out_ground(upper, of_upper, of_lower);
        leave_out_ground(lower, of_lower, of_upper);
    }
}

/// Of four samples each of a row, all or none: those that none of these flags is set for.
#[inline(always)]
fn leave_out_ground(values: &mut [u8], flags: &[u8], other_flags: &[u8]) {
    let blocks = values.as_chunks_mut::<4>().0.iter_mut();
    for ((values, flags), others) in blocks.zip(flags.as_chunks().0).zip(other_flags.as_chunks().0) {
        let is_in_full_sun = u32::from_ne_bytes(*flags) | u32::from_ne_bytes(*others) == 0;
        for value in values {
            // The bin of the same ground without this source of shadow is the one before.
            *value -= u8::from(is_in_full_sun) & ShadingBins::is_shaded_by_ground(value.wrapping_sub(1));
        }
    }
}

impl Row<'_> {
    const fn for_slopes(&self) -> GBufferRow<'_> {
        let Self { inverse_w, normal_x, normal_y, bins_and_slots, .. } = *self;
        GBufferRow { inverse_depth: inverse_w, normal_x, normal_y, visibility: bins_and_slots }
    }

    /// Writes a row of [`ShadingBinMask::values`].
    // `inline(always)` as `GBufferBand::rasterise`.
    #[inline(always)]
    fn write_mask(&self, bins: ShadingBins, values: &mut [u8]) {
        for (value, bin_and_slot) in values.iter_mut().zip(self.bins_and_slots) {
            // 0 (no surface) wraps to a bin that does not exist, which stays as it is and wraps back to 0.
            *value = bins.merge_bands((*bin_and_slot as u8).wrapping_sub(1)).wrapping_add(1);
        }
    }

    /// Packs the row as `visibility.wgsl` does.
    // `inline(always)` as `GBufferBand::rasterise`.
    #[inline(always)]
    fn pack(&self, bins: ShadingBins, samples: &mut [[u32; 4]]) {
        let count = samples.len();
        let (inverse_w, bins_and_slots) = (&self.inverse_w[..count], &self.bins_and_slots[..count]);
        let (normal_x, normal_y, face_normal) =
            (&self.normal_x[..count], &self.normal_y[..count], &self.face_normal[..count]);
        for i in 0..count {
            let (bin, slot) =
                (bins_and_slots[i] & u32::from(ShadingBin::MAX), bins_and_slots[i] >> SLOT_SHIFT);
            // The lighting of the sky reads nothing, and the sky has no normals to pack.
            let is_surface = bin.wrapping_sub(1) < u32::from(bins.stars());
            let packed = [
                normal_x[i] | ((slot & 0xff) << 24),
                normal_y[i] | ((slot >> 8) << 24),
                face_normal[i],
                inverse_w[i].to_bits(),
            ];
            samples[i] = packed.map(|word| if is_surface { word } else { 0 });
        }
    }
}

/// Depth-tests a triangle (nearer wins) and writes it to the G-buffer.
struct GBufferWriter<'a> {
    band: &'a mut GBufferBand,
    inverse_w: Interpolant,
    /// Smallest and largest 1/w of the corners. A sample that is inside only after corners were rounded is extrapolated to, far off if the
    /// triangle is a sliver.
    range: [f32; 2],
    /// Vertex normal over depth; its length does not matter.
    normal: Option<[Interpolant; 3]>,
    face_normal: u32,
    bin_and_slot: u32,
}

impl<S: Simd> FragmentSink<S> for GBufferWriter<'_> {
    #[inline(always)]
    fn write(&mut self, simd: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let [farthest, nearest] = self.range.map(|inverse_w| f32x8::splat(simd, inverse_w));
        let inverse_w = self.inverse_w.at(x, y).max(farthest).min(nearest);
        let previous = load_block(simd, &self.band.inverse_w, offsets);
        let nearer = covered & inverse_w.simd_gt(previous);
        if !nearer.any_true() {
            return;
        }
        store_block(&mut self.band.inverse_w, offsets, nearer.select(inverse_w, previous));
        let bin_and_slot = u32x8::splat(simd, self.bin_and_slot);
        store_masked(simd, &mut self.band.bins_and_slots, offsets, nearer, bin_and_slot);
        let Some([normal_x, normal_y, normal_z]) = &self.normal else { return };
        let (x, y, z) = (normal_x.at(x, y), normal_y.at(x, y), normal_z.at(x, y));
        // CPU counterpart of `octahedral_encode` in `common/octahedral.wgsl`. It takes a vector of any length: no division by 1/w.
        let length = (x.abs() + y.abs() + z.abs()).max(f32x8::splat(simd, 1e-30));
        let (x, y) = (x / length, y / length);
        let one = f32x8::splat(simd, 1.0);
        let (folded_x, folded_y) = ((one - y.abs()).copysign(x), (one - x.abs()).copysign(y));
        let is_below = z.simd_lt(0.0);
        let (x, y) = (is_below.select(folded_x, x), is_below.select(folded_y, y));
        store_masked(simd, &mut self.band.normal_x, offsets, nearer, to_snorm24(x));
        store_masked(simd, &mut self.band.normal_y, offsets, nearer, to_snorm24(y));
        let face_normal = u32x8::splat(simd, self.face_normal);
        store_masked(simd, &mut self.band.face_normal, offsets, nearer, face_normal);
    }
}

/// The smallest and the largest of three values.
#[inline(always)]
fn range_of([a, b, c]: [f32; 3]) -> [f32; 2] {
    [a.min(b).min(c), a.max(b).max(c)]
}

/// From [-1, 1] to 24 bits, as `visibility.wgsl` packs it.
#[inline(always)]
fn to_snorm24<S: Simd>(x: f32x8<S>) -> u32x8<S> {
    const MAX_CODE: f32 = MAX_NORMAL_CODE as f32;
    // Of 1 the half that is added would round the largest code up to one that has a bit more, which is the slot's.
    let code = ((x * 0.5 + 0.5) * MAX_CODE + 0.5).min(MAX_CODE);
    code.to_int::<i32x8<S>>().bitcast()
}

/// Replaces the chosen words of a block.
#[inline(always)]
fn store_masked<S: Simd>(
    simd: S,
    buffer: &mut [u32],
    offsets: [usize; 2],
    mask: mask32x8<S>,
    words: u32x8<S>,
) {
    let previous = load_block_u32(simd, buffer, offsets);
    store_block_u32(buffer, offsets, mask.select(words, previous));
}
