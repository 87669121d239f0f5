//! Rocks as what hides the ground behind them, shadows the ground beside them and reflects the sun: sums over the rocks of a cell.
//!
//! Rocks are no part of the heights of a cell. A ray passes them with the probability of Poisson's law.
//! Must not know: the ground.

use std::f32::consts::PI;
use std::ops::{AddAssign, Range, Sub};

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec2;

use crate::render::select::lane_math::{LANES, exp, load, splat};
use crate::render::select::lit_rocks::REACH;
use crate::render::select::nested_grids::{CELLS, LEVELS, NestedGrids};

/// Frontal area of a rock over its width times its height: that of half an ellipse.
const FRONTAL_AREA: f32 = 0.25 * PI;
/// Height above which half of the width of all rocks lies, over the geometric mean of their heights weighted by width: in nine fields of
/// rocks 0.5 to 0.7.
const HALF_HEIGHT: f32 = 0.65;
/// Largest part of what lies behind a cell that a single rock hides.
const MAX_HIDDEN: f32 = 0.95;

/// Most stretches along a ray.
pub const MAX_STRETCHES: usize = 16;

/// Sums over the rocks of a cell, per square metre.
#[derive(Clone, Copy, Debug, Default)]
pub struct RockCover {
    /// Widths, 1/m.
    width: f32,
    /// Optical depth at the ground, 1/m.
    pub depth: f32,
    /// Widths times the logarithms of the heights in metres, 1/m.
    log_heights: f32,
    /// Frontal areas.
    pub front: f32,
    /// Frontal areas times colours over that of soil, of rocks that are no sources of their own (`lit_rocks.rs`).
    unlisted: f32,
    /// The same of rocks that are.
    listed: f32,
    /// The same times the distances that they light, metres.
    listed_reach_m: f32,
}

impl AddAssign for RockCover {
    fn add_assign(&mut self, other: Self) {
        self.width += other.width;
        self.depth += other.depth;
        self.log_heights += other.log_heights;
        self.front += other.front;
        self.unlisted += other.unlisted;
        self.listed += other.listed;
        self.listed_reach_m += other.listed_reach_m;
    }
}

impl Sub for RockCover {
    type Output = Self;

    /// Without rocks that are part of these.
    fn sub(self, other: Self) -> Self {
        Self {
            width: (self.width - other.width).max(0.0),
            depth: (self.depth - other.depth).max(0.0),
            log_heights: self.log_heights - other.log_heights,
            front: (self.front - other.front).max(0.0),
            unlisted: (self.unlisted - other.unlisted).max(0.0),
            listed: (self.listed - other.listed).max(0.0),
            listed_reach_m: (self.listed_reach_m - other.listed_reach_m).max(0.0),
        }
    }
}

/// [`RockCover`] of eight cells.
#[derive(Clone, Copy, Debug)]
pub struct CoverOfLanes<S: Simd> {
    /// See [`RockCover`].
    width: f32x8<S>,
    /// See [`RockCover`].
    pub depth: f32x8<S>,
    log_heights: f32x8<S>,
    /// See [`RockCover`].
    pub front: f32x8<S>,
    unlisted: f32x8<S>,
    listed: f32x8<S>,
    listed_reach_m: f32x8<S>,
}

// Its functions are inlined into `dispatch!`, so that they are compiled for each SIMD level.
impl<S: Simd> CoverOfLanes<S> {
    /// Of these cells.
    #[inline(always)]
    #[must_use]
    pub fn new(simd: S, covers: [&RockCover; LANES]) -> Self {
        let mut fields = [[0.0; LANES]; 7];
        for (lane, cover) in covers.into_iter().enumerate() {
            fields[0][lane] = cover.width;
            fields[1][lane] = cover.depth;
            fields[2][lane] = cover.log_heights;
            fields[3][lane] = cover.front;
            fields[4][lane] = cover.unlisted;
            fields[5][lane] = cover.listed;
            fields[6][lane] = cover.listed_reach_m;
        }
        Self {
            width: load(simd, &fields[0]),
            depth: load(simd, &fields[1]),
            log_heights: load(simd, &fields[2]),
            front: load(simd, &fields[3]),
            unlisted: load(simd, &fields[4]),
            listed: load(simd, &fields[5]),
            listed_reach_m: load(simd, &fields[6]),
        }
    }

    /// Height above which half of the optical depth is left, metres.
    #[inline(always)]
    #[must_use]
    pub fn half_height_m(&self, simd: S) -> f32x8<S> {
        let has_rocks = self.width.simd_gt(1e-6);
        let mean_log = (self.log_heights / self.width.max(1e-6)).min(3.0);
        has_rocks.select(exp(simd, mean_log) * HALF_HEIGHT, splat(simd, 0.0))
    }

    /// Mean height of the rocks by their widths, metres.
    #[inline(always)]
    #[must_use]
    pub fn mean_height_m(&self) -> f32x8<S> {
        self.front / (self.width * FRONTAL_AREA).max(1e-9)
    }

    /// Frontal areas times colours of the rocks that light what lies at a distance: those that are sources of their own only beyond
    /// the distances that they light as such.
    #[inline(always)]
    #[must_use]
    pub fn lighting(&self, distance_m: f32x8<S>) -> f32x8<S> {
        let per_reach = distance_m * self.listed / self.listed_reach_m.max(1e-9);
        let square = per_reach * per_reach;
        self.unlisted + self.listed * (square * square).min(1.0)
    }
}

/// A rock as its cover is found from.
#[derive(Clone, Copy, Debug)]
pub struct CoveringRock {
    /// Its place, metres, world.
    pub place: Vec2,
    /// Half its width, metres.
    pub radius_m: f32,
    /// Height of its top above the ground, metres.
    pub height_m: f32,
    /// Its colour over that of soil.
    pub colour: f32,
    /// Whether it is a source of its own.
    pub is_listed: bool,
}

/// The cells of a grid that a rock is spread over, and its part in each.
#[derive(Clone, Debug)]
pub struct Spread {
    /// Columns of the grid.
    pub columns: Range<usize>,
    /// Rows of the grid.
    pub rows: Range<usize>,
    /// The same for all its cells.
    pub cover: RockCover,
}

/// The cells of each grid that a rock is spread over; `None` for grids that it is not in.
pub type Spreads = [Option<Spread>; LEVELS];

impl CoveringRock {
    /// Spreads it over the cells below it.
    #[must_use]
    pub fn spreads(&self, grids: NestedGrids) -> Spreads {
        std::array::from_fn(|level| self.spread(grids, level))
    }

    fn spread(&self, grids: NestedGrids, level: usize) -> Option<Spread> {
        let (cell_m, half_m) = (grids.cell_m(level), grids.half_side_m(level));
        let from_border = self.place - grids.centre + half_m;
        if from_border.min_element() < 0.0 || from_border.max_element() >= 2.0 * half_m {
            return None;
        }
        let beyond_m = (self.radius_m - 0.5 * cell_m).max(0.0);
        let range = |along_m: f32| {
            let index = |metres: f32| ((metres / cell_m).max(0.0) as usize).min(CELLS - 1);
            index(along_m - beyond_m)..index(along_m + beyond_m) + 1
        };
        let (columns, rows) = (range(from_border.x), range(from_border.y));
        let width_m = 2.0 * self.radius_m;
        let width = width_m / ((columns.len() * rows.len()) as f32 * cell_m * cell_m);
        let across_m = columns.len().max(rows.len()) as f32 * cell_m;
        let lighting = FRONTAL_AREA * width * self.height_m * self.colour;
        let reach_m = REACH * (0.5 * FRONTAL_AREA * width_m * self.height_m).sqrt();
        let listed = if self.is_listed { lighting } else { 0.0 };
        let cover = RockCover {
            width,
            depth: -libm::logf(1.0 - (width_m / across_m).min(MAX_HIDDEN)) / across_m,
            log_heights: width * libm::logf(self.height_m.max(1e-3)),
            front: FRONTAL_AREA * width * self.height_m,
            unlisted: lighting - listed,
            listed,
            listed_reach_m: listed * reach_m,
        };
        Some(Spread { columns, rows, cover })
    }
}

/// The rocks on the stretches that eight rays pass, from the nearest on; of the last, where they end, the nearer half.
#[derive(Clone, Debug)]
pub struct PassedRocks<S: Simd> {
    count: usize,
    /// Whether there is a rock on any of them.
    has_rocks: bool,
    stretches: [Passed<S>; MAX_STRETCHES],
}

/// A stretch of ground, as eight places see it.
#[derive(Clone, Copy, Debug)]
pub struct Passed<S: Simd> {
    /// Distance of its far end, metres.
    pub distance_m: f32x8<S>,
    /// Height of that above the place, metres.
    pub above_m: f32x8<S>,
    /// Optical depth of its rocks at the ground.
    pub depth: f32x8<S>,
    /// Height above which half of it is left, metres.
    pub half_height_m: f32x8<S>,
}

impl<S: Simd> PassedRocks<S> {
    /// None yet.
    #[inline(always)]
    pub fn none(simd: S) -> Self {
        let zero = splat(simd, 0.0);
        let nothing = Passed { distance_m: zero, above_m: zero, depth: zero, half_height_m: zero };
        Self { count: 0, has_rocks: false, stretches: [nothing; MAX_STRETCHES] }
    }

    /// Goes on to the next stretch.
    ///
    /// # Panics
    /// Beyond [`MAX_STRETCHES`].
    #[inline(always)]
    pub fn push(&mut self, next: &Passed<S>) {
        let half_height_m = next.half_height_m.max(1e-6);
        self.stretches[self.count] = Passed { half_height_m, ..*next };
        self.has_rocks |= next.depth.simd_gt(0.0).any_true();
        self.count += 1;
    }

    /// Optical depth of the rocks that rays of these slopes pass. By power laws of their sizes, what stands higher than some height falls
    /// with its first power.
    #[inline(always)]
    #[must_use]
    pub fn depth(&self, simd: S, slope: f32x8<S>) -> f32x8<S> {
        let mut sum = splat(simd, 0.0);
        if !self.has_rocks {
            return sum;
        }
        let mut last = sum;
        for passed in &self.stretches[..self.count] {
            let ray_m = (slope * passed.distance_m - passed.above_m).max(0.0);
            last = passed.depth * passed.half_height_m / (passed.half_height_m + ray_m);
            sum += last;
        }
        sum - last * 0.5
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::render::select::lane_math::store;

    /// Optical depth of the rocks on two stretches, along a ray of this slope.
    fn depth(above_m: f32, of_stretch: f32, slope: f32) -> f32 {
        let depths = dispatch!(Level::new(), simd => {
            let mut rocks = PassedRocks::none(simd);
            for distance_m in [1.0, 3.0] {
                rocks.push(&Passed {
                    distance_m: splat(simd, distance_m),
                    above_m: splat(simd, above_m),
                    depth: splat(simd, of_stretch),
                    half_height_m: splat(simd, 0.2),
                });
            }
            store(rocks.depth(simd, splat(simd, slope)))
        });
        depths[0]
    }

    #[test]
    fn rocks_hide_what_lies_behind_them() {
        assert_eq!(depth(0.0, 0.0, 0.1), 0.0);
        assert!((depth(0.0, 0.5, 0.0) - 0.75).abs() < 1e-6, "one stretch and half of the last");
        let [low, high] = [0.02, 0.3].map(|slope| depth(0.0, 0.5, slope));
        assert!(high < 0.6 * low && low < 1.0, "{low} {high}");
        assert!(depth(-2.0, 0.5, 0.02) < 0.2 * low);
    }

    /// Rays across the cells of a rock miss it as often as Poisson's law says.
    #[test]
    fn a_rock_hides_its_part_of_the_cells_that_it_covers() {
        let grids = NestedGrids { centre: Vec2::ZERO, half_m: 12.0 };
        for radius_m in [0.02, 0.1, 0.2, 0.7] {
            let rock = CoveringRock {
                place: Vec2::new(0.3, -0.2),
                radius_m,
                height_m: 0.3,
                colour: 1.0,
                is_listed: false,
            };
            let [first, ..] = rock.spreads(grids);
            let spread = first.expect("a place in the first grid");
            let across_m = spread.rows.len() as f32 * grids.cell_m(0);
            let expected = 1.0 - (2.0 * radius_m / across_m).min(0.95);
            let found = libm::expf(-spread.cover.depth * across_m);
            assert!((found - expected).abs() < 1e-3, "radius {radius_m} m: {found}, not {expected}");
        }
    }

    #[test]
    fn a_cover_without_a_rock_is_that_of_the_others() {
        let grids = NestedGrids { centre: Vec2::ZERO, half_m: 12.0 };
        let rock = |radius_m: f32, is_listed| {
            let rock =
                CoveringRock { place: Vec2::ONE, radius_m, height_m: radius_m, colour: 1.4, is_listed };
            let [first, ..] = rock.spreads(grids);
            first.expect("a place in the first grid").cover
        };
        let (small, large) = (rock(0.05, false), rock(0.2, true));
        let mut both = small;
        both += large;
        let left = both - large;
        // Half and mean heights; and how they light at one metre and at thirty.
        let numbers = |cover: &RockCover| {
            dispatch!(Level::new(), simd => {
                let cover = CoverOfLanes::new(simd, [cover; LANES]);
                let lighting = [1.0, 30.0].map(|distance_m| cover.lighting(splat(simd, distance_m)));
                [cover.half_height_m(simd), cover.mean_height_m(), lighting[0], lighting[1]].map(|number| store(number)[0])
            })
        };
        let [of_small, of_both, of_left] = [&small, &both, &left].map(numbers);
        assert!((of_left[0] / of_small[0] - 1.0).abs() < 1e-3);
        assert!((of_left[1] / 0.05 - 1.0).abs() < 1e-3);
        assert!((of_left[2] / of_small[2] - 1.0).abs() < 1e-3);
        // A source of its own lights as one of many only beyond its own reach.
        assert!(of_both[2] < 1.5 * of_small[2]);
        assert!(of_both[3] > 10.0 * of_small[3]);
    }
}
