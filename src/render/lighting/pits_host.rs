//! Pits below the size of the mesh's cells in a batch of samples, summed on the host: the slopes, heights and shades of craters and clods
//! where the eye sees them, and where they shadow the ground.
//!
//! CPU counterpart of `add_pits` in `shaders/common/pits.wgsl`, equal to it but for rounding. The pits themselves are
//! `src/scene/craters.rs`. All is inlined, to be compiled for each width of vectors.
//! Must not know: what else is summed.

use glam::Vec2;

use super::detail_sums::{DetailSums, MIN_CLEARANCE};
use super::ground_batch::{BATCH, GroundBatch, Vectors};
use super::waves_host::slope_from_lattice;
use crate::render::device::shader_structs::LatticeUniforms;
use crate::scene::craters::{
    BOWL, CLOD_HEIGHT, EJECTA_EXPONENT, FRESH_DEPTHS, JITTER_CELLS, PROFILE_DEPTH, RIM, WORN_DEPTHS,
    second_hash,
};
use crate::scene::noise::lattice_hash;

/// Taylor coefficients of 2^x around 0: ln(2)^k / k!.
const EXP2_TAYLOR: [f32; 8] = [
    1.0,
    std::f32::consts::LN_2,
    0.240_226_5,
    0.055_504_11,
    0.009_618_129,
    0.001_333_356,
    0.000_154_035_3,
    0.000_015_252_73,
];
/// Derivative of the crater's profile inside the crest, diameters per radius: a polynomial in the distance r from the centre in radii.
/// The profile is `RIM + (1 - r) p(r)` with the coefficients b of p in [`crate::scene::craters::BOWL`], a fit to the profile of Yang
/// et al. 2021, so that coefficient `k` is `(k + 1) (b[k + 1] - b[k])`. Stands in `pits.wgsl` too.
const BOWL_SLOPE: [f32; 5] = [0.051_383_2, -0.150_474_8, 2.937_590_4, -5.661_628, 2.871_354];
/// Distance from the centre where the ejecta have faded out, and one over the width of the fade, radii. The neighbouring cells of the
/// lattice begin there.
const EJECTA_FADE: [f32; 2] = [1.5, 2.5];
/// Distance from the centre from which on nothing is left of a pit, with a margin for rounding, radii.
pub(crate) const PIT_REACH: f32 = 1.51;
/// Binary logarithm of the depth of the oldest crater over that of the youngest worn one: log2(0.02 / 0.12).
const WORN_DEPTH_LOG2: f32 = -2.584_962_5;
/// Depth of the youngest fresh crater less that of the oldest, diameters.
const FRESH_DEPTH_SPAN: f32 = 0.04;
/// What fresh craters add to the logarithm of the albedo at the crest: their soil is less mature. Stands in `pits.wgsl` too.
pub(crate) const FRESH_SHADE: f32 = 0.2;
/// How much of that their middle has, where soil has crept down.
pub(crate) const FRESH_FLOOR: f32 = 0.6;
/// How much further than the mean that soil reaches in some directions, and less far in others, for each of four waves around the centre.
pub(crate) const FRESH_WAVES: f32 = 0.15;
/// Maximum depth of a worn crater, diameters: a little less than that of a fresh one, as in `craters.rs`.
const MAX_WORN_DEPTH: f32 = 0.1099;

/// Adds the pits of a lattice: at most one crater or clod a cell, which does not reach beyond its cell.
#[inline(always)]
pub(super) fn add_pits(
    pits: &LatticeUniforms,
    fresh_share: f32,
    ground: &GroundBatch,
    sums: &mut DetailSums,
) {
    let lattice = pits.lattice();
    // Radius of the largest pit, cells.
    let largest = 0.5 * pits.max_diameter_m / pits.cell_m;
    let zeros = [0.0; BATCH];
    let mut offsets = Vectors { x: zeros, y: zeros };
    let (mut firsts, mut seconds) = ([0; BATCH], [0; BATCH]);
    // Most samples are further from the pit of their cell than it reaches, or would with a little room for rounding.
    let max_reach = 1.001 * PIT_REACH * largest;
    let mut near = 0_u32;
    for i in 0..BATCH {
        let (cell, position) = lattice.cell(lattice.local(sums.point(ground, i)));
        let first = lattice_hash(cell[0], cell[1], 0, pits.seed);
        let second = second_hash(first);
        let [x, y] = pit_centre(second);
        let (along, across) = (position[0] - x, position[1] - y);
        let exists = has_pit(pits, first);
        let square = along * along + across * across;
        let is_near = exists & (square * shrink_square(second) < max_reach * max_reach);
        near |= if is_near { 1 } else { 0 };
        (offsets.x[i], offsets.y[i]) = (along, across);
        (firsts[i], seconds[i]) = (first, second);
    }
    if near == 0 {
        return;
    }
    let ages = CraterAges::new(pits.share, fresh_share);
    let (mut shares, mut diameters_m, mut ages_of) = (zeros, zeros, zeros);
    let mut reached = 0_u32;
    for i in 0..BATCH {
        let (diameter_m, age) = size_and_age([firsts[i], seconds[i]], pits);
        let (along, across) = (offsets.x[i], offsets.y[i]);
        let exists = has_pit(pits, firsts[i]);
        let share = sums.share(ground, i, diameter_m);
        let reach = 0.5 * PIT_REACH * diameter_m / pits.cell_m;
        let is_reached = exists & (along * along + across * across < reach * reach);
        shares[i] = if is_reached { share } else { 0.0 };
        // The bits of 0 alone are 0.
        reached |= shares[i].to_bits();
        (diameters_m[i], ages_of[i]) = (diameter_m, age);
    }
    if reached == 0 {
        return;
    }
    let (mut clearances_m, mut ways_m) = (zeros, zeros);
    for i in 0..BATCH {
        let pit = CellPit::new(diameters_m[i], (firsts[i], ages_of[i]), shares[i], &ages);
        let offset = Vec2::new(offsets.x[i], offsets.y[i]);
        (clearances_m[i], ways_m[i]) = add_pit(pits, ground, (i, &pit), offset, sums);
    }
    sums.add_occluders(&clearances_m, &ways_m);
}

/// Adds a pit of a lattice where the ray to the eye of sample `i` meets it. `offset`: the sample's position before, cells from the pit's
/// centre. Returns by how much the ray to the sun from there clears the pit, and the horizontal way to where it does, metres.
#[inline(always)]
fn add_pit(
    pits: &LatticeUniforms,
    ground: &GroundBatch,
    (i, pit): (usize, &CellPit),
    offset: Vec2,
    sums: &mut DetailSums,
) -> (f32, f32) {
    let per_radius = 2.0 * pits.cell_m / pit.diameter_m;
    let turned = |x: f32, y: f32| {
        Vec2::new(
            (pits.rotation_per_m.x * x + pits.rotation_per_m.y * y) * per_radius,
            (pits.rotation_per_m.x * y - pits.rotation_per_m.y * x) * per_radius,
        )
    };
    let offset = per_radius * offset;
    // In radii of the pit from here on: the ray's way for each metre that it rises.
    let way = turned(ground.ways[0].x[i], ground.ways[0].y[i]);
    let (rise, way_m) = (sums.rise(ground, i), 0.5 * pit.diameter_m);
    let at = |rise_m: f32| {
        let point = offset + rise_m * way;
        let square = point.x * point.x + point.y * point.y;
        let square = if square > 1e-12 { square } else { 1e-12 };
        let r = square.sqrt();
        let [steepness, height] = pit.profile(r);
        // Slope per radius away from the centre, and height, metres.
        (point, r, pit.share * steepness / r, pit.share * pit.diameter_m * height)
    };
    // A clod hides the ground behind it: the ray is followed from where it passes closest to the centre, if it is inside there.
    let way_square = way.x * way.x + way.y * way.y;
    let closest_m =
        -(offset.x * way.x + offset.y * way.y) / if way_square > 1e-12 { way_square } else { 1e-12 };
    let top_m = CLOD_HEIGHT * pit.diameter_m;
    let closest_m = if closest_m > 0.0 { closest_m } else { 0.0 };
    let closest_m = if closest_m < top_m { closest_m } else { top_m };
    let closest = offset + closest_m * way;
    let height_m = pit.share * pit.diameter_m * clod_height(closest.x * closest.x + closest.y * closest.y);
    let is_inside = pit.is_clod & (pit.share > 0.0) & (height_m > closest_m * rise);
    let start_m = if is_inside { closest_m } else { 0.0 };
    // Two steps of Newton's method.
    let (point, _, per_r, height_m) = at(start_m);
    let climb = per_r * (point.x * way.x + point.y * way.y) * way_m;
    let left = rise - climb;
    let left = if left > MIN_CLEARANCE { left } else { MIN_CLEARANCE };
    let first_m = start_m + (height_m - start_m * rise) / left;
    let (point, r, per_r, height_m) = at(first_m);
    let slope = pits.cell_m * slope_from_lattice(pits, [per_r * point.x, per_r * point.y]);
    let (sun_way, larger) = (
        Vec2::new(ground.ways[1].x[i], ground.ways[1].y[i]),
        sums.x[i] * ground.ways[1].x[i] + sums.y[i] * ground.ways[1].y[i],
    );
    let fade = ((EJECTA_FADE[0] - r) * EJECTA_FADE[1]).clamp(0.0, 1.0);
    let fresh = if pit.is_fresh { fade * FRESH_SHADE * pit.freshness(point / r, r) * pit.share } else { 0.0 };
    let of_pit = (i, pit.diameter_m);
    sums.move_up(ground, of_pit, first_m);
    sums.add(ground, of_pit, slope, height_m - first_m * rise, fresh);
    // Its shadow: of a crater's crest into the crater, of a clod where the ray to the sun passes closest to its centre.
    let per_sun_way = ground.per_way[1][i];
    let sun = turned(sun_way.x * per_sun_way, sun_way.y * per_sun_way) * (0.5 * pit.diameter_m);
    let away = point.x * sun.x + point.y * sun.y;
    let past = away * away - r * r;
    let crossing = past + 1.0;
    let to_crest = (if crossing > 0.0 { crossing } else { 0.0 }).sqrt() - away;
    let to_closest = if away < 0.0 { -away } else { 0.0 };
    let way_r = if pit.is_clod { to_closest } else { to_crest };
    let closest_square = -past;
    let clod = clod_height(if closest_square > 0.0 { closest_square } else { 0.0 });
    let top = if pit.is_clod { clod } else { RIM / PROFILE_DEPTH * pit.depth };
    let way_m = way_r * 0.5 * pit.diameter_m;
    let rise_m = way_m * per_sun_way;
    let clearance_m = rise_m * (1.0 - larger) / fade - (pit.share * pit.diameter_m * top - height_m);
    let is_tested =
        (pit.share > 0.0) & (fade > 0.0) & (pit.is_clod | (r < 1.0)) & (way_m > ground.across_m[i]);
    (if is_tested { clearance_m } else { f32::INFINITY }, way_m)
}

/// The centre of the pit of a cell with this second hash, cells from the corner of the cell. As `PitLattice::pit` in
/// `src/scene/craters.rs`.
#[inline(always)]
fn pit_centre(second: u32) -> [f32; 2] {
    let jitter = |bits: u32| ((bits & 0x3ff) as i32 as f32 * (1.0 / 512.0) - 1.0) * JITTER_CELLS + 0.5;
    [jitter(second), jitter(second >> 10)]
}

/// Whether a cell with this first hash has a pit.
#[inline(always)]
fn has_pit(pits: &LatticeUniforms, first: u32) -> bool {
    // Uniform in [0, 1).
    let draw = (first & 0xffff) as i32 as f32 * (1.0 / 65_536.0);
    draw < pits.amount
}

/// What the hashes of a cell say of its pit. As `PitLattice::pit` in `src/scene/craters.rs`.
#[derive(Debug)]
struct CellPit {
    /// Metres.
    diameter_m: f32,
    /// Of a crater, diameters.
    depth: f32,
    /// Whether it is a clod, or a fresh crater.
    is_clod: bool,
    is_fresh: bool,
    /// How much of it the mesh leaves out and samples can show, 0 to 1.
    share: f32,
    /// The hash of its cell.
    first: u32,
}

/// Diameter, metres, and age of the pit of a cell with these hashes: uniform in [0, 1), clods first, then craters from the youngest to the
/// oldest.
#[inline(always)]
fn size_and_age([first, second]: [u32; 2], pits: &LatticeUniforms) -> (f32, f32) {
    let diameter_m = pits.max_diameter_m / shrink_square(second).sqrt();
    (diameter_m, (first >> 16) as i32 as f32 * (1.0 / 65_536.0))
}

/// Square of the ratio of a lattice's largest diameter to that of the pit of a cell with this second hash: the inverse of the cumulative
/// distribution of diameters, which goes with D^-2, within an octave.
#[inline(always)]
fn shrink_square(second: u32) -> f32 {
    4.0 * (1.0 - 0.75 / 4096.0 * (second >> 20) as i32 as f32)
}

impl CellPit {
    #[inline(always)]
    fn new(diameter_m: f32, (first, age): (u32, f32), share: f32, ages: &CraterAges) -> Self {
        let is_clod = age < ages.clods;
        let is_fresh = !is_clod & (age - ages.clods < ages.fresh_share * (1.0 - ages.clods));
        Self { diameter_m, depth: ages.depth(age), is_clod, is_fresh, share, first }
    }

    /// How fresh the soil of a fresh crater is in a direction from its centre, at a distance of `r` radii: about 1 at the crest, less
    /// on the floor, and outside as thick ejecta are, which fall with the third power of the distance (McGetchin et al. 1973). It is
    /// no disc: soil reaches further in some directions than in others.
    #[inline(always)]
    fn freshness(&self, way: Vec2, r: f32) -> f32 {
        let (c, s) = (way.x, way.y);
        // Cosines and sines of two and three times the angle.
        let waves = [2.0 * c * c - 1.0, 2.0 * c * s, c * (4.0 * c * c - 3.0), s * (3.0 - 4.0 * s * s)];
        let mut sum = 0.0;
        for (k, wave) in waves.into_iter().enumerate() {
            let bits = self.first >> (16 + 2 * k) & 15;
            sum += (bits as i32 as f32 * (2.0 / 15.0) - 1.0) * wave;
        }
        let reach = r * (1.0 + FRESH_WAVES * sum);
        let inside = FRESH_FLOOR + (1.0 - FRESH_FLOOR) * reach * reach;
        let outside = 1.0 / (reach * reach * reach);
        if reach < 1.0 { inside } else { outside }
    }

    /// Rise per metre away from the centre, and height in diameters, at a distance of `r` radii.
    #[inline(always)]
    fn profile(&self, r: f32) -> [f32; 2] {
        let per_r = 1.0 / r;
        let crater = [crater_steepness(r, per_r, self.depth), crater_height(r, per_r, self.depth)];
        let clod = [clod_steepness(r), clod_height(r * r)];
        [if self.is_clod { clod[0] } else { crater[0] }, if self.is_clod { clod[1] } else { crater[1] }]
    }
}

/// The depth of craters over their age. As `worn_depth` in `src/scene/craters.rs`.
struct CraterAges {
    clods: f32,
    fresh_share: f32,
    /// One over the share of craters among the pits, of worn ones and of fresh ones among the craters.
    per_crater: f32,
    per_worn: f32,
    per_fresh: f32,
}

impl CraterAges {
    #[inline(always)]
    fn new(clods: f32, fresh_share: f32) -> Self {
        let (per_crater, per_worn) = (1.0 / (1.0 - clods), 1.0 / (1.0 - fresh_share));
        let per_fresh = if fresh_share > 1e-6 { 1.0 / fresh_share } else { 1e6 };
        Self { clods, fresh_share, per_crater, per_worn, per_fresh }
    }

    /// Depth from crest to floor, diameters: linear in the age while fresh, then evenly in the logarithm.
    #[inline(always)]
    fn depth(&self, pit_age: f32) -> f32 {
        let age = (pit_age - self.clods) * self.per_crater;
        let wear = (age - self.fresh_share) * self.per_worn;
        let worn = WORN_DEPTHS[0] * exp2_small(WORN_DEPTH_LOG2 * wear);
        let worn = if worn < MAX_WORN_DEPTH { worn } else { MAX_WORN_DEPTH };
        let fresh = FRESH_DEPTHS[1] - FRESH_DEPTH_SPAN * self.per_fresh * age;
        if age < self.fresh_share { fresh } else { worn }
    }
}

/// Rise per metre away from the centre of a crater of a depth in diameters, at a distance r in radii: inside the crest the derivative of
/// the polynomial, outside that of the ejecta's power law, with an exponent of -4 in place of -4.19, faded out.
#[inline(always)]
fn crater_steepness(r: f32, per_r: f32, depth: f32) -> f32 {
    let [b0, b1, b2, b3, b4] = BOWL_SLOPE;
    let bowl = b0 + r * (b1 + r * (b2 + r * (b3 + r * b4)));
    let per_r_squared = per_r * per_r;
    let [end, per_width] = EJECTA_FADE;
    let fade = ((end - r) * per_width).clamp(0.0, 1.0);
    let ejecta = EJECTA_EXPONENT * RIM * (per_r_squared * per_r_squared) * fade;
    2.0 / PROFILE_DEPTH * depth * if r < 1.0 { bowl } else { ejecta }
}

/// Height of a crater of a depth above its surroundings, all in diameters, at a distance r in radii: with an exponent of -3 in place of
/// -3.19 outside the crest, faded out.
#[inline(always)]
fn crater_height(r: f32, per_r: f32, depth: f32) -> f32 {
    let [b0, b1, b2, b3, b4] = BOWL;
    let bowl = RIM + (1.0 - r) * (b0 + r * (b1 + r * (b2 + r * (b3 + r * b4))));
    let [end, per_width] = EJECTA_FADE;
    let fade = ((end - r) * per_width).clamp(0.0, 1.0);
    let ejecta = RIM * (per_r * per_r * per_r) * fade;
    1.0 / PROFILE_DEPTH * depth * if r < 1.0 { bowl } else { ejecta }
}

/// Height of a clod, diameters, at a distance whose square this is, radii.
#[inline(always)]
fn clod_height(square: f32) -> f32 {
    let rise = if square < 1.0 { 1.0 - square } else { 0.0 };
    CLOD_HEIGHT * (rise * rise)
}

/// Rise per metre away from the centre of a clod.
#[inline(always)]
fn clod_steepness(r: f32) -> f32 {
    let square = r * r;
    -8.0 * CLOD_HEIGHT * r * if square < 1.0 { 1.0 - square } else { 0.0 }
}

/// 2 to a power from -2.7 to 0, within a millionth: the Taylor series at a quarter of it, to the fourth power.
#[inline(always)]
fn exp2_small(power: f32) -> f32 {
    let x = 0.25 * power;
    let mut sum = EXP2_TAYLOR[7];
    for coefficient in EXP2_TAYLOR[..7].iter().rev() {
        sum = sum * x + coefficient;
    }
    let square = sum * sum;
    square * square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_small_is_a_power_of_two_within_a_millionth() {
        for i in 0..=270 {
            let power = -0.01 * i as f32;
            assert!((exp2_small(power) / libm::exp2f(power) - 1.0).abs() < 1e-6, "2^{power}");
        }
    }

    #[test]
    fn constants_follow_from_the_crater_profile_and_its_depths() {
        for (k, slope) in BOWL_SLOPE.iter().enumerate() {
            let expected = (k + 1) as f32 * (BOWL.get(k + 1).unwrap_or(&0.0) - BOWL[k]);
            assert!((slope - expected).abs() < 1e-6, "coefficient {k}: {slope}, not {expected}");
        }
        assert!((WORN_DEPTH_LOG2 - libm::log2f(WORN_DEPTHS[1] / WORN_DEPTHS[0])).abs() < 1e-6);
        assert!((MAX_WORN_DEPTH - (FRESH_DEPTHS[0] - 1e-4)).abs() < 1e-7);
        assert!((FRESH_DEPTH_SPAN - (FRESH_DEPTHS[1] - FRESH_DEPTHS[0])).abs() < 1e-7);
    }

    #[test]
    fn fresh_soil_is_brightest_at_the_crest_and_reaches_further_in_some_directions() {
        let ages = CraterAges::new(0.0, 0.03);
        let mut uneven = 0;
        for first in (0..200_u32).map(|k| k.wrapping_mul(0x9e37_79b1)) {
            let pit = CellPit::new(0.1, (first, 0.01), 1.0, &ages);
            assert_eq!(pit.freshness(Vec2::X, 0.0), FRESH_FLOOR);
            let around = |r: f32| {
                let ways = (0..64_u8).map(|k| Vec2::from_angle(std::f32::consts::TAU * f32::from(k) / 64.0));
                ways.map(|way| pit.freshness(way, r)).collect::<Vec<f32>>()
            };
            let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
            let [crest, outside] = [1.0, 1.3].map(around);
            assert!(crest.iter().chain(&outside).all(|value| (0.0..=1.0).contains(value)), "{pit:?}");
            assert!(mean(&crest) > 0.75 && mean(&outside) < 0.75 * mean(&crest), "{crest:?} {outside:?}");
            let (low, high) = outside.iter().fold((1.0_f32, 0.0_f32), |(a, b), v| (a.min(*v), b.max(*v)));
            uneven += u32::from(high > 1.3 * low);
        }
        assert!(uneven > 180, "{uneven} of 200 pits");
    }
}
