//! The craters of the surface stage: from decimetres (and, as pits, centimetres) to tens of metres, in equilibrium.
//!
//! Their numbers follow Trask's law N(>D) = 0.0794 D^-2 per square metre (Trask 1966, as in the CraterStats function
//! file), their cross-sections the profile of Yang et al. 2021 (GRL 48, 2021GL095537), scaled to a depth that decreases with
//! age. Craters of one octave of diameters lie on two lattices, at most one per cell: position and size are a hash of the
//! cell, so that the craters around a point are found without a list of millions.
//! Craters above [`UNCLASSED_M`] may be replaced by a list: three classes with fixed counts.
//! Must not know: who asks. GPU counterpart of the slopes: `shaders/common/pits.wgsl`.

use fearless_simd::{Level, dispatch};
use glam::Vec2;

use super::lattice::Lattice;
use super::noise::lattice_hash;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Craters larger than 1 m in diameter per square metre, in equilibrium (Trask 1966).
pub const TRASK_DENSITY: f64 = 0.0794;
/// Crater classes: the knob of the count, the purpose of the random streams, the range of radii, metres.
const CLASSES: [(Knob, &str, [f64; 2]); 3] = [
    (Knob::CratersBigCount, "craters.big", [14.0, 40.0]),
    (Knob::CratersMediumCount, "craters.medium", [3.0, 12.0]),
    (Knob::CratersSmallCount, "craters.small", [0.6, 3.0]),
];
/// Half the side of the square around the origin in which their centres lie, metres: as on the nominal stage.
const CLASSES_HALF_M: f64 = 383.0;
/// With classes, craters up to this diameter are still in equilibrium, metres.
pub const UNCLASSED_M: f64 = 1.25;
/// Largest diameter, metres.
pub const LARGEST_M: f64 = 80.0;
/// Octaves of diameters, halving from 80 m to 2 cm.
pub const OCTAVES: u32 = 12;
/// Lattices per octave.
pub const LATTICES: u32 = 2;
/// Largest diameter of an octave, cells of its lattice.
pub const DIAMETER_CELLS: f64 = 0.44;
/// Largest distance of a centre from the middle of its cell along an axis, cells.
pub const JITTER_CELLS: f32 = 0.17;
/// Radius within which a crater changes the height, in crater radii.
pub const REACH_RADII: f32 = 2.5;
/// Rim-to-floor depth of the profile, diameters.
pub const PROFILE_DEPTH: f32 = 0.114;
/// Depths of degraded craters, diameters, from the youngest to the oldest: log-uniform. With 3 % fresh craters the mean is
/// 0.058 (Wu et al. 2021: 0.061 at the Chang'e-4 site).
pub const WORN_DEPTHS: [f32; 2] = [0.12, 0.02];
/// Depths of fresh craters, diameters (Stopar et al. 2017: 0.11 to 0.17 for the small ones).
pub const FRESH_DEPTHS: [f32; 2] = [0.11, 0.15];
/// Clods stand on the lattices of craters up to this diameter, metres.
pub const CLOD_LARGEST_M: f64 = 0.08;
/// Height of a clod, diameters.
pub const CLOD_HEIGHT: f32 = 0.22;
/// Cells of a row in which fresh craters are looked for at once.
const CELL_BATCH: usize = 16;
/// Multiplier of [`second_hash`].
pub(crate) const SECOND_HASH: u32 = 0x2c1b_3c6d;

/// Inside the rim crest the profile is `RIM + (1 - r) p(r)`, r in radii, heights in diameters: these are the coefficients of
/// p, a fit to Yang's curve for a diameter of 1 m, accurate to 0.0003.
pub const BOWL: [f32; 5] = [-0.114_206_6, -0.062_823_4, -0.138_060_8, 0.841_136_2, -0.574_270_8];
/// Height of the rim crest above the surrounding ground, diameters.
pub const RIM: f32 = 0.025_13;
/// Exponent of the ejecta thickness as a function of the distance from the centre.
pub const EJECTA_EXPONENT: f32 = -3.1906;

/// A crater or a clod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pit {
    /// Centre, metres from the centre of the ground.
    pub offset: Vec2,
    /// Rim-to-rim diameter, metres.
    pub diameter_m: f32,
    /// Rim-to-floor depth, diameters; for a clod, its negative height.
    pub depth: f32,
    /// Unique key in the scene.
    pub key: u64,
}

impl Pit {
    /// Whether it is a fresh crater.
    #[must_use]
    pub fn is_fresh(&self) -> bool {
        self.depth >= FRESH_DEPTHS[0]
    }

    /// Radius within which it changes the height, metres.
    #[must_use]
    pub fn reach_m(&self) -> f32 {
        reach_m(self.diameter_m)
    }

    /// Height that it adds at a point (metres from the centre of the ground), metres.
    #[must_use]
    #[inline(always)]
    pub fn height_at(&self, offset: Vec2) -> f32 {
        let radius_m = 0.5 * self.diameter_m;
        let square = offset.distance_squared(self.offset) / (radius_m * radius_m);
        if square >= REACH_RADII * REACH_RADII {
            return 0.0;
        }
        if self.depth < 0.0 {
            let rise = (1.0 - square).max(0.0);
            return -self.depth * self.diameter_m * rise * rise;
        }
        self.diameter_m * (self.depth / PROFILE_DEPTH) * profile(square.sqrt())
    }
}

/// Radius within which a crater of this diameter changes the height, metres.
fn reach_m(diameter_m: f32) -> f32 {
    0.5 * REACH_RADII * diameter_m
}

/// Profile of a fresh crater: height in diameters at a distance in radii below [`REACH_RADII`], where it fades to 0.
#[must_use]
#[inline(always)]
pub fn profile(r: f32) -> f32 {
    if r < 1.0 {
        let p = BOWL.iter().rev().fold(0.0, |sum, coefficient| sum * r + coefficient);
        return RIM + (1.0 - r) * p;
    }
    // r^-3.1906 as r^-3 times a [1/1] Pade approximant of the rest, accurate to 1 %.
    let (x, a) = (r - 1.0, -3.0 - EJECTA_EXPONENT);
    let bend = (1.0 + 0.5 * (1.0 - a) * x) / (1.0 + 0.5 * (1.0 + a) * x);
    let fade = ((REACH_RADII - r) / 0.4).min(1.0);
    RIM * bend / (r * r * r) * fade
}

/// A part of the ground: of a circle, what lies in a ring around the centre of the ground, or in a sector of one.
#[derive(Clone, Copy, Debug)]
pub struct Region {
    /// Middle of the circle, metres from the centre of the ground.
    pub middle: Vec2,
    /// Its radius, metres.
    pub radius_m: f32,
    /// Nearest and farthest distance from the centre of the ground, metres.
    pub distances_m: [f32; 2],
    /// Outward unit normals of the rays that bound a sector of less than half a turn; zero for a whole ring.
    pub sides: [Vec2; 2],
}

impl Region {
    /// A whole circle.
    #[must_use]
    pub const fn circle(middle: Vec2, radius_m: f32) -> Self {
        Self { middle, radius_m, distances_m: [0.0, f32::INFINITY], sides: [Vec2::ZERO; 2] }
    }

    /// Whether any of it may be within `reach_m` of a point (metres from the centre of the ground).
    #[inline(always)]
    fn is_near(&self, point: Vec2, reach_m: f32) -> bool {
        let within_m = self.radius_m + reach_m;
        if point.distance_squared(self.middle) >= within_m * within_m {
            return false;
        }
        // With a little room for rounding, as in a ring.
        is_near_ring(point.length(), reach_m, self.distances_m)
            && self.sides.iter().all(|side| side.dot(point) <= 1.01 * reach_m)
    }
}

/// Whether a point this far from the centre of a ring may be within `reach_m` of it, with a little room for rounding; all in metres.
#[inline(always)]
pub(super) fn is_near_ring(distance_m: f32, reach_m: f32, [nearest_m, farthest_m]: [f32; 2]) -> bool {
    let reach_m = 1.01 * reach_m;
    distance_m + reach_m >= nearest_m && distance_m - reach_m <= farthest_m
}

/// One lattice of craters.
#[derive(Clone, Copy, Debug)]
pub struct PitLattice {
    /// The cells.
    pub lattice: Lattice,
    /// Largest diameter, metres; the smallest is half of it.
    pub largest_m: f32,
    /// Probability that a cell has a crater.
    pub chance: f32,
    /// Fraction of clods.
    pub clods: f32,
}

/// All craters of a scene.
#[derive(Clone, Debug)]
pub struct CraterField {
    /// In order of decreasing size.
    pub lattices: Vec<PitLattice>,
    /// Craters of the classes, big ones first; empty if all are in equilibrium.
    pub listed: Vec<Pit>,
    /// Fraction of fresh craters.
    pub fresh_share: f32,
}

impl CraterField {
    /// The craters of these parameters, for points around `centre` (metres, world).
    #[must_use]
    pub fn new(streams: &Streams, params: &Params, centre: Vec2) -> Self {
        let number = |knob| params.number(knob);
        let (density, clods) = (number(Knob::CratersDensity), number(Knob::ReliefClods));
        let fresh_share = number(Knob::CratersFreshShare) as f32;
        let counted = params.text(Knob::CratersLaw) == "classes";
        let lattices = (0..OCTAVES * LATTICES)
            .map(|k| {
                let largest_m = LARGEST_M / f64::from(1_u32 << (k / LATTICES));
                let cell_m = largest_m / DIAMETER_CELLS;
                // Craters from half the largest diameter to the largest: (4 - 1) N(> largest).
                let per_cell = 3.0 * TRASK_DENSITY / (largest_m * largest_m) * cell_m * cell_m;
                let chance = if counted && largest_m > UNCLASSED_M { 0.0 } else { density * per_cell };
                PitLattice {
                    lattice: Lattice::new(cell_m, centre, &mut streams.stream("craters.lattice", k.into())),
                    largest_m: largest_m as f32,
                    chance: (chance / f64::from(LATTICES)) as f32,
                    clods: if largest_m <= CLOD_LARGEST_M { clods as f32 } else { 0.0 },
                }
            })
            .collect();
        let listed = if counted { classed(streams, params, fresh_share, centre) } else { Vec::new() };
        Self { lattices, listed, fresh_share }
    }

    /// Calls `visit` with every crater and clod larger than `min_m` that can change the height within a region, always in the same
    /// order.
    pub fn around(&self, region: &Region, min_m: f32, visit: impl FnMut(Pit)) {
        self.visit_around(region, min_m, false, visit);
    }

    /// The same for fresh craters alone, which are few.
    pub fn fresh_around(&self, region: &Region, min_m: f32, mut visit: impl FnMut(Pit)) {
        self.visit_around(region, min_m, true, |pit| {
            if pit.is_fresh() {
                visit(pit);
            }
        });
    }

    /// See [`Self::around`]; with `only_fresh` no crater of a lattice that is not fresh.
    #[inline(always)]
    fn visit_around(&self, region: &Region, min_m: f32, only_fresh: bool, mut visit: impl FnMut(Pit)) {
        let is_near = |position: Vec2, diameter_m: f32| {
            diameter_m > min_m && region.is_near(position, reach_m(diameter_m))
        };
        self.listed.iter().copied().filter(|pit| is_near(pit.offset, pit.diameter_m)).for_each(&mut visit);
        let wanted = self.lattices.iter().take_while(|lattice| lattice.largest_m > min_m);
        for lattice in wanted.filter(|lattice| lattice.chance > 0.0) {
            let reach = (region.radius_m + reach_m(lattice.largest_m)) / lattice.lattice.cell_m;
            let margin = reach + JITTER_CELLS;
            let local = lattice.lattice.local(region.middle);
            let (low, high) = ((local.y - margin - 0.5).ceil(), (local.y + margin - 0.5).floor());
            // The middles of cells lie within a circle, with a little room for rounding.
            let radius = 1.001 * (reach + std::f32::consts::SQRT_2 * JITTER_CELLS) + 0.001;
            for y in low as i32..=high as i32 {
                let across = y as f32 + 0.5 - local.y;
                let half = (radius * radius - across * across).max(0.0).sqrt().min(margin);
                let (low, high) = ((local.x - half - 0.5).ceil(), (local.x + half - 0.5).floor());
                let (low, high) = (low as i32, high as i32);
                let mut visit_cell = |x: i32| {
                    let pit = lattice.pit([x, y], self.fresh_share, is_near);
                    pit.into_iter().for_each(&mut visit);
                };
                if !only_fresh {
                    (low..=high).for_each(visit_cell);
                    continue;
                }
                for first in (low..=high).step_by(CELL_BATCH) {
                    let are_fresh = dispatch!(Level::new(), _simd => {
                        lattice.are_fresh([first, y], self.fresh_share)
                    });
                    let cells = (first..=high).zip(are_fresh);
                    cells.filter(|(_, is_fresh)| *is_fresh).for_each(|(x, _)| visit_cell(x));
                }
            }
        }
    }
}

/// The craters of the classes, each from a random stream of its own; offsets are from `centre`.
fn classed(streams: &Streams, params: &Params, fresh_share: f32, centre: Vec2) -> Vec<Pit> {
    let of_class = |(class, (knob, purpose, radii_m)): (u64, (Knob, &'static str, [f64; 2]))| {
        (0..u64::from(params.count(knob))).map(move |k| {
            let mut draw = streams.stream(purpose, k);
            let mut across = || draw.uniform(-CLASSES_HALF_M, CLASSES_HALF_M) as f32;
            let position = Vec2::new(across(), across());
            let diameter_m = 2.0 * draw.uniform(radii_m[0], radii_m[1]) as f32;
            let depth = worn_depth(draw.unit() as f32, fresh_share);
            Pit { offset: position - centre, diameter_m, depth, key: (class + 1) << 32 | k }
        })
    };
    (0..).zip(CLASSES).flat_map(of_class).collect()
}

impl PitLattice {
    /// The first hash of a cell; cells count from the lattice's base.
    #[inline(always)]
    const fn first_hash(&self, [x, y]: [i32; 2]) -> u32 {
        let [base_x, base_y] = self.lattice.base;
        lattice_hash(base_x.wrapping_add(x), base_y.wrapping_add(y), 0, self.lattice.seed)
    }

    /// Whether a cell with this first hash has a crater or clod.
    // Here and below signed numbers are converted: that vectorises.
    #[inline(always)]
    fn has_pit(&self, first: u32) -> bool {
        ((first & 0xffff) as i32 as f32 * (1.0 / 65_536.0)) < self.chance
    }

    /// Age of the crater or clod of a cell with this first hash: clods first, then craters from the youngest to the oldest.
    #[inline(always)]
    fn pit_age(first: u32) -> f32 {
        (first >> 16) as i32 as f32 * (1.0 / 65_536.0)
    }

    /// Age of a crater, 0 to 1, by that of its cell.
    #[inline(always)]
    fn crater_age(&self, pit_age: f32) -> f32 {
        (pit_age - self.clods) / (1.0 - self.clods)
    }

    /// Whether this cell and those to the right of it have fresh craters.
    // Must be inlined into the dispatched code to be compiled for its SIMD width.
    #[inline(always)]
    fn are_fresh(&self, [x, y]: [i32; 2], fresh_share: f32) -> [bool; CELL_BATCH] {
        let mut are_fresh = [false; CELL_BATCH];
        for (k, is_fresh) in are_fresh.iter_mut().enumerate() {
            let first = self.first_hash([x + k as i32, y]);
            let pit_age = Self::pit_age(first);
            *is_fresh =
                self.has_pit(first) & (pit_age >= self.clods) & (self.crater_age(pit_age) < fresh_share);
        }
        are_fresh
    }

    /// The crater or clod of a cell, if it has one whose position and diameter are wanted; cells count from the lattice's base.
    #[inline(always)]
    fn pit(&self, [x, y]: [i32; 2], fresh_share: f32, is_wanted: impl Fn(Vec2, f32) -> bool) -> Option<Pit> {
        let lattice = &self.lattice;
        let first = self.first_hash([x, y]);
        let fraction = |bits: u32, count: u32| bits as f32 / (1_u32 << count) as f32;
        if !self.has_pit(first) {
            return None;
        }
        let pit_age = Self::pit_age(first);
        let age = self.crater_age(pit_age);
        let second = second_hash(first);
        let jitter = |bits: u32| (2.0 * fraction(bits & 0x3ff, 10) - 1.0) * JITTER_CELLS + 0.5;
        let local = Vec2::new(x as f32 + jitter(second), y as f32 + jitter(second >> 10));
        // Inverse transform sampling of D^-2 within the octave.
        let diameter_m = 0.5 * self.largest_m / (1.0 - 0.75 * fraction(second >> 20, 12)).sqrt();
        let offset = lattice.offset(local);
        if !is_wanted(offset, diameter_m) {
            return None;
        }
        // Last, because of its power function.
        let depth = if pit_age < self.clods { -CLOD_HEIGHT } else { worn_depth(age, fresh_share) };
        Some(Pit { offset, diameter_m, depth, key: u64::from(first) << 32 | u64::from(second) })
    }
}

/// The second hash of a cell, from the first (one round of Wellons' hash).
#[must_use]
#[inline(always)]
pub const fn second_hash(first: u32) -> u32 {
    let second = (first ^ (first >> 15)).wrapping_mul(SECOND_HASH);
    second ^ (second >> 12)
}

/// Rim-to-floor depth, diameters, of a crater of an age in [0, 1).
fn worn_depth(age: f32, fresh_share: f32) -> f32 {
    if age < fresh_share {
        return FRESH_DEPTHS[0] + (FRESH_DEPTHS[1] - FRESH_DEPTHS[0]) * (1.0 - age / fresh_share);
    }
    let wear = (age - fresh_share) / (1.0 - fresh_share);
    // A degraded crater is always shallower than a fresh one.
    (WORN_DEPTHS[0] * libm::powf(WORN_DEPTHS[1] / WORN_DEPTHS[0], wear)).min(FRESH_DEPTHS[0] - 1e-4)
}
