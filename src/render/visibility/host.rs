//! What each sample shows, found by this program: for devices that are a CPU themselves.
//!
//! Twin of `visibility.wgsl`. The picture is drawn in bands of rows, each by one thread and small enough to stay near to it.
//! Must not know: what becomes of it.

use std::cell::RefCell;
use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8, mask32x8, u32x4, u32x8};
use rayon::prelude::*;

use crate::gpu::staging::{PAGE_BYTES, Page, PageWriter};
use crate::render::device::shading_bins::{ShadingBin, ShadingBins};
use crate::render::lighting::slopes_host::Seen;
use crate::render::raster::{Corners, HEIGHT, LANES, Outline, Outlines, Paint, Plane, WIDTH, load, store};
use crate::render::visibility::geometry::{Facet, Facets, Mesh};

/// Rows of a band.
const BAND_ROWS: usize = 32;
/// Where the group of a sample ends in its [`Sheet::things`], and the slot of its instance begins.
const SLOT_AT: u32 = ShadingBin::BITS;

thread_local! {
    /// Kept for its memory.
    static SHEET: RefCell<Sheet> = RefCell::default();
}

/// One more than the group by which each sample is lit (all bands of ground are as one), a row after the other; 0 where nothing
/// is.
#[derive(Debug, Default)]
pub struct Stencil {
    /// Them.
    pub values: Vec<u8>,
    /// Whether there is a sample that shows nothing.
    pub has_holes: bool,
}

impl Stencil {
    /// Of a picture of this many columns and rows of samples, of which none is drawn yet.
    pub fn restart(&mut self, [width, height]: [u32; 2]) {
        self.values.resize(width as usize * height as usize, 0);
        self.has_holes = false;
    }

    /// Draws rows of a picture. Of `given`, some of these rows, it writes what `visibility.wgsl` does and behind each the slopes of
    /// the ground in it, if there are any: so many bytes of each.
    pub fn draw(
        &mut self,
        facets: &Facets,
        width: usize,
        rows: &Range<u32>,
        given: &Range<u32>,
        (pages, row_bytes): (&mut dyn Iterator<Item = Page<'_>>, [usize; 2]),
    ) {
        let groups = facets.groups();
        let [rows, given] = [rows, given].map(|rows| rows.start as usize..rows.end as usize);
        let stencil = &mut self.values[rows.start * width..rows.end * width];
        let bands = rows.step_by(BAND_ROWS).zip(stencil.chunks_mut(BAND_ROWS * width));
        let bands: Vec<_> = bands
            .map(|(first, stencil)| {
                let rows = first..first + stencil.len() / width;
                let given = rows.start.max(given.start)..rows.end.min(given.end);
                let pages: Vec<Page<'_>> =
                    pages.take(given.len() * (row_bytes[0] + row_bytes[1]) / PAGE_BYTES).collect();
                (rows, stencil, given, pages)
            })
            .collect();
        let draw = |(rows, stencil, given, pages): (Range<usize>, &mut [u8], Range<usize>, Vec<Page<'_>>)| {
            SHEET.with_borrow_mut(|sheet| {
                sheet.restart(width, rows.len());
                let of_picture = rows.start as i32..rows.end as i32;
                dispatch!(Level::new(), simd => sheet.draw(simd, facets.meshes(), groups, width, &of_picture));
                for (row, stencil) in stencil.chunks_exact_mut(width).enumerate() {
                    dispatch!(Level::new(), _simd => sheet.row(row, width).stencil(groups, stencil));
                }
                let (mut line, mut slopes) =
                    (std::mem::take(&mut sheet.line), std::mem::take(&mut sheet.slopes));
                line.resize(width, [0; 4]);
                slopes.resize(width, [0.0; 2]);
                let mut written = PageWriter::new(pages);
                for number in given {
                    let row = sheet.row(number - rows.start, width);
                    dispatch!(Level::new(), _simd => row.samples(groups, &mut line));
                    written.write_row(bytemuck::cast_slice(&line), row_bytes[0]);
                    if let Some(of_ground) = facets.slopes() {
                        of_ground.set_row(number, &row.seen(), &mut slopes);
                        written.write_row(bytemuck::cast_slice(&slopes), row_bytes[1]);
                    }
                }
                (sheet.line, sheet.slopes) = (line, slopes);
            });
            stencil.contains(&0)
        };
        self.has_holes |= bands.into_par_iter().with_max_len(1).map(draw).reduce(|| false, |a, b| a || b);
    }
}

/// What the samples of a band show.
#[derive(Debug, Default)]
struct Sheet {
    /// Samples from one row to the next.
    stride: usize,
    /// One over the metres along the axis; 0 where there is nothing yet.
    inverse_w: Vec<f32>,
    /// The two numbers of the normal, in 24 bits each.
    normal_x: Vec<u32>,
    normal_y: Vec<u32>,
    /// The facet's own normal, packed.
    facing: Vec<u32>,
    /// One more than the group, and the slot of the instance above; 0 where there is nothing.
    things: Vec<u32>,
    /// A row as it is given, and the slopes of the ground in it.
    line: Vec<[u32; 4]>,
    slopes: Vec<[f32; 2]>,
}

/// A row of a sheet.
struct Row<'a> {
    inverse_w: &'a [f32],
    normal_x: &'a [u32],
    normal_y: &'a [u32],
    facing: &'a [u32],
    things: &'a [u32],
}

impl Sheet {
    fn restart(&mut self, width: usize, rows: usize) {
        self.stride = width + WIDTH;
        let texels = self.stride * (rows + HEIGHT);
        self.inverse_w.clear();
        self.inverse_w.resize(texels, 0.0);
        self.things.clear();
        self.things.resize(texels, 0);
        // Only what lies where a thing was drawn is read of these.
        for plane in [&mut self.normal_x, &mut self.normal_y, &mut self.facing] {
            plane.resize(texels, 0);
        }
    }

    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn draw<S: Simd>(
        &mut self,
        simd: S,
        meshes: &[Mesh],
        groups: ShadingBins,
        width: usize,
        rows: &Range<i32>,
    ) {
        let is_beside =
            |[first, last]: [u16; 2]| i32::from(last) < rows.start || i32::from(first) >= rows.end;
        for mesh in meshes {
            if is_beside(mesh.rows) {
                continue;
            }
            let mut eight = [0; LANES];
            let mut count = 0;
            for (number, facet) in mesh.facets.iter().enumerate() {
                if is_beside(facet.rows) {
                    continue;
                }
                eight[count] = number;
                count += 1;
                if count == LANES {
                    self.draw_eight(simd, mesh, &eight, groups, width, rows);
                    count = 0;
                }
            }
            self.draw_eight(simd, mesh, &eight[..count], groups, width, rows);
        }
    }

    /// Draws up to eight facets, by their numbers.
    #[inline(always)]
    fn draw_eight<S: Simd>(
        &mut self,
        simd: S,
        mesh: &Mesh,
        numbers: &[usize],
        groups: ShadingBins,
        width: usize,
        rows: &Range<i32>,
    ) {
        let mut of_eight = Corners::none();
        for (lane, &number) in numbers.iter().enumerate() {
            let corners = mesh.corners_of(&mesh.facets[number]);
            for (i, corner) in corners.iter().enumerate() {
                of_eight.set(lane, i, corner.place, corner.at, corner.values());
            }
        }
        let outlines = Outlines::new(simd, &of_eight, width, rows);
        let (first, stride) = (rows.start, self.stride);
        for (lane, &number) in numbers.iter().enumerate() {
            let facet = &mesh.facets[number];
            if outlines.is_small(lane) && facet.clipped.is_none() {
                let mut brush = self.brush(mesh, facet, groups, outlines.planes(lane));
                outlines.fill(simd, lane, first, stride, &mut brush);
                continue;
            }
            let corners = mesh.corners_of(facet);
            let places = corners.map(|corner| corner.place);
            let Some(outline) = Outline::new(places, width, rows) else { continue };
            let planes = mesh.planes(facet, corners, &outline);
            outline.fill(simd, first, stride, &mut self.brush(mesh, facet, groups, planes));
        }
    }

    /// What a facet is painted with.
    #[inline(always)]
    fn brush(&mut self, mesh: &Mesh, facet: &Facet, groups: ShadingBins, planes: [Plane; 4]) -> Brush<'_> {
        let group = mesh.groups[facet.shades as usize];
        let thing = (u32::from(group) + 1) | (mesh.slot << SLOT_AT);
        let [inverse_w, x, y, z] = planes;
        // The sky has no normal.
        let normal = (group < groups.stars()).then_some([x, y, z]);
        Brush { sheet: self, inverse_w, normal, facing: facet.facing, thing }
    }

    fn row(&self, row: usize, width: usize) -> Row<'_> {
        let range = row * self.stride..row * self.stride + width;
        Row {
            inverse_w: &self.inverse_w[range.clone()],
            normal_x: &self.normal_x[range.clone()],
            normal_y: &self.normal_y[range.clone()],
            facing: &self.facing[range.clone()],
            things: &self.things[range],
        }
    }
}

impl Row<'_> {
    const fn seen(&self) -> Seen<'_> {
        let Self { inverse_w, normal_x, normal_y, things, .. } = *self;
        Seen { inverse_w, normal_x, normal_y, things }
    }

    // As above.
    #[inline(always)]
    fn stencil(&self, groups: ShadingBins, values: &mut [u8]) {
        for (value, thing) in values.iter_mut().zip(self.things) {
            // 0 is no group, nor does one less come to one.
            *value = groups.merge_bands((*thing as u8).wrapping_sub(1)).wrapping_add(1);
        }
    }

    // As above.
    #[inline(always)]
    fn samples(&self, groups: ShadingBins, samples: &mut [[u32; 4]]) {
        let count = samples.len();
        let (inverse_w, things) = (&self.inverse_w[..count], &self.things[..count]);
        let (normal_x, normal_y, facing) =
            (&self.normal_x[..count], &self.normal_y[..count], &self.facing[..count]);
        for i in 0..count {
            let (value, slot) = (things[i] & u32::from(ShadingBin::MAX), things[i] >> SLOT_AT);
            // Nothing of the sky is read.
            let is_thing = value.wrapping_sub(1) < u32::from(groups.stars());
            let packed = [
                normal_x[i] | ((slot & 0xff) << 24),
                normal_y[i] | ((slot >> 8) << 24),
                facing[i],
                inverse_w[i].to_bits(),
            ];
            samples[i] = packed.map(|word| if is_thing { word } else { 0 });
        }
    }
}

/// Paints what is nearer than what is there.
struct Brush<'a> {
    sheet: &'a mut Sheet,
    inverse_w: Plane,
    normal: Option<[Plane; 3]>,
    facing: u32,
    thing: u32,
}

impl<S: Simd> Paint<S> for Brush<'_> {
    #[inline(always)]
    fn paint(&mut self, simd: S, texels: [usize; 2], inside: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let inverse_w = self.inverse_w.at(x, y);
        let there = load(simd, &self.sheet.inverse_w, texels);
        let nearer = inside & inverse_w.simd_gt(there);
        if !nearer.any_true() {
            return;
        }
        store(&mut self.sheet.inverse_w, texels, nearer.select(inverse_w, there));
        paint_words(simd, &mut self.sheet.things, texels, nearer, u32x8::splat(simd, self.thing));
        let Some([of_x, of_y, of_z]) = &self.normal else { return };
        let (x, y, z) = (of_x.at(x, y), of_y.at(x, y), of_z.at(x, y));
        // Twin: `octahedral_encode` in `common/octahedral.wgsl`. Of any length, so that nothing is to be divided by 1/w.
        let length = (x.abs() + y.abs() + z.abs()).max(f32x8::splat(simd, 1e-30));
        let (x, y) = (x / length, y / length);
        let one = f32x8::splat(simd, 1.0);
        let (over_x, over_y) = ((one - y.abs()).copysign(x), (one - x.abs()).copysign(y));
        let is_below = z.simd_lt(0.0);
        let (x, y) = (is_below.select(over_x, x), is_below.select(over_y, y));
        let plane = &mut self.sheet.normal_x;
        paint_words(simd, plane, texels, nearer, in_24_bits(x));
        let plane = &mut self.sheet.normal_y;
        paint_words(simd, plane, texels, nearer, in_24_bits(y));
        paint_words(simd, &mut self.sheet.facing, texels, nearer, u32x8::splat(simd, self.facing));
    }
}

/// From [-1, 1], as `visibility.wgsl` packs it.
#[inline(always)]
fn in_24_bits<S: Simd>(x: f32x8<S>) -> u32x8<S> {
    ((x * 0.5 + 0.5) * 16_777_215.0 + 0.5).to_int::<i32x8<S>>().bitcast()
}

/// Replaces those of eight words that are chosen.
#[inline(always)]
fn paint_words<S: Simd>(
    simd: S,
    plane: &mut [u32],
    [upper, lower]: [usize; 2],
    chosen: mask32x8<S>,
    words: u32x8<S>,
) {
    let there = u32x4::from_slice(simd, &plane[upper..upper + WIDTH])
        .combine(u32x4::from_slice(simd, &plane[lower..lower + WIDTH]));
    let (above, below) = chosen.select(words, there).split();
    above.store_slice(&mut plane[upper..upper + WIDTH]);
    below.store_slice(&mut plane[lower..lower + WIDTH]);
}
