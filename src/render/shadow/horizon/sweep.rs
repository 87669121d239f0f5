//! The sweep: horizon heights along rows that run towards the sun.
//!
//! Each row of samples is swept from its sunward end. From sample to sample the height of the shadow boundary falls by the slope of
//! the sun's rays, and where the ground stands higher it rises to the ground: a running maximum along a scanline, as in Timonen and
//! Westerholm 2010 ("Scalable height field self-shadowing", Computer Graphics Forum 29), who sweep for all elevations; for one
//! elevation the maximum is a single number. Eight rows are swept in the lanes of a vector.
//! Must not know: who asks for which part.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8, mask32x8};
use glam::Vec2;
use rayon::prelude::*;

use super::grid_frame::GridFrame;
use super::heightfield::{ChordErrors, Heightfield, LANES};
use super::image_layout::ImageRows;
use super::occluders::{Limbs, OccluderStrips, Occluders, PARTS, StripBatch};
use crate::render::select::footprint::Footprint;
use crate::scene::rings_mesh::CornersOfLanes;
use crate::scene::sky::Sun;
use crate::scene::terrain::{Layout, Terrain};

/// Lowest elevation of a limb of the sun, degrees.
const MIN_LIMB_DEG: f64 = 0.01;
/// Highest elevation of a limb of the sun, degrees.
const MAX_LIMB_DEG: f64 = 89.9;
/// Horizon of a row that begins where no ground further towards the sun can occlude it, metres: lower than everything.
const NO_HORIZON_M: f32 = -1.0e9;

/// Columns whose heights are stored at once, row by row: a few cache lines of each.
const BLOCK_COLUMNS: usize = 32;

/// A lattice of samples over the whole ground: columns run towards the sun, rows across.
pub(super) struct SweepLattice<'a> {
    terrain: &'a Terrain,
    /// The heights of a square ground.
    heightfield: Option<&'a Heightfield>,
    /// Horizontal unit vectors towards the sun and across.
    towards: Vec2,
    across: Vec2,
    /// The first sample of the first row, world, metres.
    origin: Vec2,
    step_m: f32,
    /// Samples along a side.
    samples: usize,
    /// How far the ray from each limb falls in a step, metres.
    pub(super) fall_m: Limbs,
}

/// The samples of a lattice that are computed.
pub(super) struct SweepRegion {
    columns: Range<usize>,
    rows: Range<usize>,
    /// Of each row, the columns.
    spans: Vec<Range<usize>>,
    /// Columns of the image: without those that only the next finer grid samples.
    image_columns: usize,
}

impl SweepRegion {
    /// Largest number of samples by which a span ends further towards the sun than asked for.
    pub(super) const ROUNDED: f32 = 3.0;

    /// Columns and rows of the image.
    pub(super) fn image_size(&self) -> [usize; 2] {
        [self.image_columns, self.rows.len()]
    }
}

/// One level of the horizon map while it is made: a part of a lattice.
pub(super) struct HorizonGrid {
    pub(super) frame: GridFrame,
    /// Columns of the image.
    pub(super) image_columns: usize,
    /// Where a finer grid begins.
    occluders: OccluderStrips,
    /// Samples of a square ground around which other ground may occlude any of the sun, world, metres.
    pub(super) shadowed: Vec<Vec2>,
}

/// Rows that are swept at once.
struct RowBatch<'a> {
    first_row: usize,
    /// The column that the stored heights begin with.
    first_column: usize,
    /// The column that they end before.
    end_column: usize,
    /// Of each row, the columns that are computed.
    spans: &'a [Range<usize>],
}

impl<'a> SweepLattice<'a> {
    pub(super) fn new(
        terrain: &'a Terrain,
        heightfield: Option<&'a Heightfield>,
        sun: &Sun,
        towards: Vec2,
        step_m: f32,
    ) -> Self {
        let across = Vec2::new(-towards.y, towards.x);
        let samples = (side_m(terrain, towards) / step_m).ceil() as usize + 2;
        let origin = terrain.centre - 0.5 * (samples - 1) as f32 * step_m * (towards + across);
        let half_disc = 0.5 * sun.angular_diameter_deg;
        let fall_m = [-half_disc, half_disc].map(|offset| {
            let limb = (sun.elevation_deg + offset).clamp(MIN_LIMB_DEG, MAX_LIMB_DEG).to_radians();
            libm::tan(limb) as f32 * step_m
        });
        Self { terrain, heightfield, towards, across, origin, step_m, samples, fall_m }
    }

    /// The samples around a part of the ground, and `beyond` samples further towards the sun.
    pub(super) fn region(&self, footprint: &Footprint, beyond: f32) -> SweepRegion {
        let footprint = footprint.mapped(|corner| {
            let offset = (corner - self.origin) / self.step_m;
            Vec2::new(offset.dot(self.towards), offset.dot(self.across))
        });
        let corners = &footprint.corners;
        let first = |at: f32| (at.floor() - 1.0).clamp(0.0, (self.samples - 2) as f32) as usize;
        let end = |at: f32| (at.ceil() + 2.0).clamp(2.0, self.samples as f32) as usize;
        let samples = |low: f32, high: f32| first(low)..end(high).max(first(low) + 2);
        let lowest = corners.iter().copied().reduce(Vec2::min).unwrap_or_default();
        let highest = corners.iter().copied().reduce(Vec2::max).unwrap_or_default();
        let columns = samples(lowest.x, highest.x + beyond);
        let rows = samples(lowest.y, highest.y);
        let spans = rows
            .clone()
            .map(|row| {
                // With the rows that bilinear interpolation between two rows, or in a finer grid between two of its rows, may need.
                let span = footprint.span(row as f32 - 3.0, row as f32 + 3.0);
                span.map_or(0..0, |[low, high]| {
                    let span = samples(low, high + beyond);
                    span.start.max(columns.start)..span.end.min(columns.end)
                })
            })
            .collect();
        let image_columns = samples(lowest.x, highest.x).len();
        SweepRegion { columns, rows, spans, image_columns }
    }

    /// Where the samples of a region lie.
    fn frame(&self, region: &SweepRegion) -> GridFrame {
        let SweepRegion { columns, rows, .. } = region;
        let first = Vec2::new(columns.start as f32, rows.start as f32);
        // Finer samples than those of a square are counted from nearby, for the precision of their coordinates.
        let (origin, first) = if self.heightfield.is_some() {
            (self.origin, first)
        } else {
            (self.origin + self.step_m * (first.x * self.towards + first.y * self.across), Vec2::ZERO)
        };
        let size = [columns.len(), rows.len()];
        GridFrame { origin, first, step_m: self.step_m, size, towards: self.towards }
    }

    /// Strips for the occluders at the samples between which a finer grid begins, `beyond` samples further towards the sun than its spans.
    pub(super) fn strips(
        &self,
        region: &SweepRegion,
        finer: Option<(&SweepLattice<'_>, &SweepRegion, usize)>,
    ) -> OccluderStrips {
        let frame = self.frame(region);
        let starts = finer.into_iter().flat_map(|(lattice, region, beyond)| {
            let rows = region.rows.clone().zip(&region.spans).filter(|(_, span)| !span.is_empty());
            rows.map(move |(row, span)| lattice.position(span.end + beyond, row))
        });
        OccluderStrips::new(frame.size[1], starts.map(|start| frame.cell(start).0))
    }

    /// The coarsest grid: its rows begin where no ground further towards the sun is high enough to occlude it.
    pub(super) fn sweep_coarsest(
        &self,
        region: &SweepRegion,
        output: (ImageRows<'_>, OccluderStrips),
    ) -> HorizonGrid {
        let [lowest_m, highest_m] = self.terrain.z_range_m;
        let fall_m = self.fall_m[0].max(1e-6);
        let reach = ((highest_m - lowest_m) / fall_m).ceil().min(self.samples as f32) as usize + 2;
        let nothing = Occluders([[NO_HORIZON_M; 2]; PARTS.len()]);
        let start = |_, end: usize| ((end + reach).min(self.samples), nothing);
        let chord_errors = self.heightfield.map(|heightfield| &heightfield.chord_errors);
        self.sweep(region, output, start, chord_errors)
    }

    /// A finer grid: its rows begin `beyond` samples further towards the sun than their spans, with the heights of a coarser grid.
    pub(super) fn sweep_finer(
        &self,
        region: &SweepRegion,
        output: (ImageRows<'_>, OccluderStrips),
        coarser: &HorizonGrid,
        beyond: usize,
    ) -> HorizonGrid {
        let start = |row, end| {
            let end = end + beyond;
            let position = self.position(end, row);
            let ground_m = self.ground_m(position);
            (end, coarser.sample(position).raised_to_ground(ground_m))
        };
        self.sweep(region, output, start, None)
    }

    /// Sweeps every row of a region into its rows of the image, several at once and batches in parallel: heights behind the ground that
    /// hides most of the sun from the ground at the sample, `f32::MIN` where nothing is computed. `start` maps a row and the end of its
    /// span to the column that the sweep begins behind, and the horizon heights there.
    fn sweep(
        &self,
        region: &SweepRegion,
        (image, mut occluders): (ImageRows<'_>, OccluderStrips),
        start: impl Fn(usize, usize) -> (usize, Occluders) + Sync,
        chord_errors: Option<&ChordErrors>,
    ) -> HorizonGrid {
        let SweepRegion { columns, rows, spans, image_columns } = region;
        let ImageRows { texels, width, column } = image;
        let strips = occluders.batches().into_par_iter();
        let batches =
            texels.par_chunks_mut(LANES * width).zip(strips).zip(spans.par_chunks(LANES)).enumerate();
        let shadowed = batches.map(|(index, ((texels, strips), spans))| {
            let texels = texels.chunks_exact_mut(width).map(|row| &mut row[column..][..*image_columns]);
            let mut texels: Vec<&mut [Limbs]> = texels.collect();
            // The memory of an earlier map. The sweep sets all of the span.
            for (row, span) in texels.iter_mut().zip(spans) {
                let [start, end] =
                    [span.start, span.end].map(|column| column.max(columns.start) - columns.start);
                row[..start.min(*image_columns)].fill([f32::MIN; 2]);
                row[end.min(*image_columns)..].fill([f32::MIN; 2]);
            }
            let first_row = rows.start + index * LANES;
            let end_column = columns.start + image_columns;
            let batch = RowBatch { first_row, first_column: columns.start, end_column, spans };
            dispatch!(
                Level::new(),
                simd => self.sweep_batch(simd, &batch, (&mut texels, strips), &start, chord_errors)
            )
        });
        let shadowed = shadowed.collect::<Vec<_>>().into_iter().flatten().collect();
        HorizonGrid { frame: self.frame(region), image_columns: *image_columns, occluders, shadowed }
    }

    /// Sweeps a batch of rows: stores the heights of their spans, and returns the positions of the samples around which ground may
    /// be shadowed.
    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn sweep_batch<S: Simd>(
        &self,
        simd: S,
        batch: &RowBatch<'_>,
        (texels, mut strips): (&mut [&mut [Limbs]], StripBatch<'_>),
        start: &impl Fn(usize, usize) -> (usize, Occluders),
        chord_errors: Option<&ChordErrors>,
    ) -> Vec<Vec2> {
        let (mut front, columns) = SweepFront::new(simd, self, batch, start);
        let mut shadowed = Vec::new();
        let stored = batch.stored();
        let mut block = [[[0.0; 2]; LANES]; BLOCK_COLUMNS];
        let mut known = CornersOfLanes::default();
        let sampled = batch.first_column + strips.columns.start..batch.first_column + strips.columns.end;
        for column in columns.rev() {
            let has_started = front.fall(column, self.fall_m);
            // Beyond both ends of its span the ground below a row changes nothing.
            let swept = has_started & front.first_column.simd_le(column as f32);
            let (ground, cell) = self.ground_across(simd, (front.row_origins, swept), column, &mut known);
            if stored.contains(&column) {
                let first = column - column % BLOCK_COLUMNS;
                store_limbs(front.limbs(ground), &mut block[column - first]);
                if column == first || column == stored.start {
                    batch.store(first, &block, texels);
                }
            }
            if sampled.contains(&column) {
                let mut of_parts = [[[0.0; 2]; LANES]; PARTS.len()];
                for (limbs, of_part) in front.occluders.into_iter().zip(&mut of_parts) {
                    store_limbs(limbs, of_part);
                }
                for lane in (0..LANES).filter(|lane| batch.computes(*lane, column)) {
                    let occluders = Occluders(of_parts.map(|of_part| of_part[lane]));
                    strips.store(column - batch.first_column, lane, occluders);
                }
            }
            if let Some(chord_errors) = chord_errors
                && stored.contains(&column)
            {
                let mut lanes = chord_errors.shadowed_lanes(simd, ground, cell, front.occluders[0][0]);
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize;
                    lanes &= lanes - 1;
                    if batch.computes(lane, column) {
                        shadowed.push(self.position(column, batch.first_row + lane));
                    }
                }
            }
            front.raise_to_ground(has_started, ground);
        }
        shadowed
    }

    /// Heights of the ground in a column of rows, which begin at `row_origins`, and of a square ground the cells there. Of rings only
    /// in some rows; elsewhere `f32::MIN`. `known` has the cells of the column before.
    #[inline(always)]
    fn ground_across<S: Simd>(
        &self,
        simd: S,
        (row_origins, rows): ([f32x8<S>; 2], mask32x8<S>),
        column: usize,
        known: &mut CornersOfLanes,
    ) -> (f32x8<S>, i32x8<S>) {
        let along = column as f32 * self.step_m * self.towards;
        let (x, y) = (row_origins[0] + along.x, row_origins[1] + along.y);
        if let Some(heightfield) = self.heightfield {
            return heightfield.sample(simd, &self.terrain.heights_m, [x, y]);
        }
        let Layout::Rings(rings) = &self.terrain.layout else {
            return (f32x8::splat(simd, f32::MIN), i32x8::splat(simd, 0));
        };
        // As `ground_m`.
        let (centre, radius_m) = (self.terrain.centre, self.terrain.half_extent_m);
        let (from_x, from_y) = (x - centre.x, y - centre.y);
        let on_ground = rows & (from_x * from_x + from_y * from_y).simd_le(radius_m * radius_m);
        let heights_m = self.terrain.ring_heights(simd, rings, [x, y], on_ground, known);
        (on_ground.select(heights_m, f32x8::splat(simd, f32::MIN)), i32x8::splat(simd, 0))
    }

    /// Position of a sample, world, metres.
    fn position(&self, column: usize, row: usize) -> Vec2 {
        self.origin + row as f32 * self.step_m * self.across + column as f32 * self.step_m * self.towards
    }

    /// Height of the ground at a position, `f32::MIN` where there is none, metres.
    fn ground_m(&self, position: Vec2) -> f32 {
        if self.terrain.contains(position) { self.terrain.surface_height_at(position) } else { f32::MIN }
    }
}

/// Side of the square that is aligned with the sun and holds the ground, metres.
pub(super) fn side_m(terrain: &Terrain, towards: Vec2) -> f32 {
    2.0 * terrain.half_extent_m * (towards.x.abs() + towards.y.abs())
}

impl RowBatch<'_> {
    /// Whether the height at a column of a row of the batch is computed.
    #[inline(always)]
    fn computes(&self, row: usize, column: usize) -> bool {
        self.spans.get(row).is_some_and(|span| span.contains(&column))
    }

    /// The columns that some row stores.
    fn stored(&self) -> Range<usize> {
        let spans = self.spans.iter().filter(|span| !span.is_empty());
        let ends = spans.map(|span| [span.start, span.end]);
        let [first, end] = ends.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]).unwrap_or_default();
        first..end.min(self.end_column)
    }

    /// Stores the heights of a block of columns from `first` on, of each row those in its span.
    #[inline(always)]
    fn store(&self, first: usize, block: &[[Limbs; LANES]; BLOCK_COLUMNS], texels: &mut [&mut [Limbs]]) {
        for (lane, (span, row)) in self.spans.iter().zip(texels).enumerate() {
            let columns = span.start.max(first)..span.end.min(first + BLOCK_COLUMNS).min(self.end_column);
            if columns.is_empty() {
                continue;
            }
            let stored = &mut row[columns.start - self.first_column..columns.end - self.first_column];
            for (stored, limbs) in stored.iter_mut().zip(&block[columns.start - first..]) {
                *stored = limbs[lane];
            }
        }
    }
}

/// The state of the sweep of a batch of rows, one lane a row.
struct SweepFront<S: Simd> {
    /// The first sample of each row: x and y, world, metres.
    row_origins: [f32x8<S>; 2],
    /// The column that the sweep of each row begins behind.
    start_column: f32x8<S>,
    /// The first column of the span of each row.
    first_column: f32x8<S>,
    /// [`Occluders`] at the current column.
    occluders: [[f32x8<S>; 2]; PARTS.len()],
}

impl<S: Simd> SweepFront<S> {
    /// The front at the start of each row, and the columns that are swept.
    #[inline(always)]
    fn new(
        simd: S,
        lattice: &SweepLattice<'_>,
        batch: &RowBatch<'_>,
        start: &impl Fn(usize, usize) -> (usize, Occluders),
    ) -> (Self, Range<usize>) {
        let (mut origins, mut start_column) = ([[0.0; LANES]; 2], [0.0; LANES]);
        let mut first_column = [0.0; LANES];
        let mut limbs = [[[0.0; LANES]; 2]; PARTS.len()];
        let (mut first, mut end) = (usize::MAX, 0);
        for (row, span) in batch.spans.iter().enumerate() {
            let origin = lattice.origin + (batch.first_row + row) as f32 * lattice.step_m * lattice.across;
            (origins[0][row], origins[1][row]) = (origin.x, origin.y);
            if span.is_empty() {
                continue;
            }
            let (column, at_start) = start(batch.first_row + row, span.end);
            start_column[row] = column as f32;
            for (limbs, at_start) in limbs.iter_mut().zip(at_start.0) {
                (limbs[0][row], limbs[1][row]) = (at_start[0], at_start[1]);
            }
            first_column[row] = span.start as f32;
            (first, end) = (first.min(span.start), end.max(column));
        }
        let front = Self {
            row_origins: [f32x8::from_slice(simd, &origins[0]), f32x8::from_slice(simd, &origins[1])],
            start_column: f32x8::from_slice(simd, &start_column),
            first_column: f32x8::from_slice(simd, &first_column),
            occluders: limbs
                .map(|[lower, upper]| [f32x8::from_slice(simd, &lower), f32x8::from_slice(simd, &upper)]),
        };
        (front, first..end)
    }

    /// Moves to a column, one step further from the sun, in the rows that have started; returns which have.
    #[inline(always)]
    fn fall(&mut self, column: usize, fall_m: Limbs) -> mask32x8<S> {
        let has_started = self.start_column.simd_gt(column as f32);
        for limbs in &mut self.occluders {
            for (height, fall_m) in limbs.iter_mut().zip(fall_m) {
                *height = has_started.select(*height - fall_m, *height);
            }
        }
        has_started
    }

    /// As [`Occluders::raised_to_ground`], in the rows that have started.
    #[inline(always)]
    fn raise_to_ground(&mut self, has_started: mask32x8<S>, ground: f32x8<S>) {
        for (limbs, part) in self.occluders.iter_mut().zip(PARTS) {
            let hidden = limbs[0] + (limbs[1] - limbs[0]) * part;
            let stands_out = has_started & ground.simd_gt(hidden);
            *limbs = [stands_out.select(ground, limbs[0]), stands_out.select(ground, limbs[1])];
        }
    }

    /// The horizon heights behind the ground that hides most of the sun from ground of this height: the height of the lower limb over
    /// that of the ground relative to the width of the penumbra.
    #[inline(always)]
    fn limbs(&self, ground: f32x8<S>) -> [f32x8<S>; 2] {
        let [mut darkest, others @ ..] = self.occluders;
        for limbs in others {
            let hides_more = ((limbs[0] - ground) * (darkest[0] - darkest[1]))
                .simd_gt((darkest[0] - ground) * (limbs[0] - limbs[1]));
            darkest = [hides_more.select(limbs[0], darkest[0]), hides_more.select(limbs[1], darkest[1])];
        }
        darkest
    }
}

/// Stores both heights of each row.
#[inline(always)]
fn store_limbs<S: Simd>([lower, upper]: [f32x8<S>; 2], limbs: &mut [Limbs; LANES]) {
    let (first, second) = lower.interleave(upper);
    let limbs: &mut [f32] = bytemuck::cast_slice_mut(limbs);
    first.store_slice(&mut limbs[..LANES]);
    second.store_slice(&mut limbs[LANES..]);
}

impl HorizonGrid {
    /// Horizon heights at a position where a finer grid begins, bilinearly interpolated.
    fn sample(&self, position: Vec2) -> Occluders {
        let ([column, row], t) = self.frame.cell(position);
        let corner = |dx: usize, dy: usize| self.occluders.at(column + dx, row + dy).0;
        let [south_west, south_east, north_west, north_east] =
            [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        Occluders(std::array::from_fn(|part| {
            std::array::from_fn(|limb| {
                let south = mix(south_west[part][limb], south_east[part][limb], t.x);
                let north = mix(north_west[part][limb], north_east[part][limb], t.x);
                mix(south, north, t.y)
            })
        }))
    }
}
