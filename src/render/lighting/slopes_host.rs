//! The ground's detail below the size of its mesh's cells, summed on the host: for software adapters, which load each number of a
//! uniform again for every sample.
//!
//! CPU counterpart of `ground_detail` in `shaders/common/relief.wgsl`, equal to it but for rounding; functions have the same names. The
//! height function itself is `src/scene/relief.rs`, the craters `src/scene/craters.rs`. Everything is written for batches of samples
//! without branches, so that the compiler vectorises it.
//! Must not know: where slopes go.

use fearless_simd::{Level, dispatch};
use glam::{Vec2, Vec3};
use half::f16;
use half::slice::HalfFloatSliceExt;

use crate::render::device::shader_structs::{LatticeUniforms, ReliefUniforms, ReliefView};
use crate::render::device::shading_bins::{LightingVariant, ShadingBin, ShadingBins};
use crate::render::lighting::crater_rays_host::add_crater_rays;
use crate::render::lighting::detail_sums::DetailSums;
use crate::render::lighting::grains_host::{GrainGround, GroundDetail, add_grains};
use crate::render::lighting::ground_batch::{BATCH, GroundBatch, MIN_TESTED_SAMPLES, SampleBatch, Vectors};
use crate::render::lighting::relief_bands::{ReliefBands, sample_share};
use crate::render::lighting::waves_host::{MIN_LOW_WAY, noise_slope, set_strength};
use crate::scene::craters::{
    BOWL, CLOD_HEIGHT, EJECTA_EXPONENT, FRESH_DEPTHS, JITTER_CELLS, PROFILE_DEPTH, RIM, WORN_DEPTHS,
    second_hash,
};
use crate::scene::grains::GrainMaterial;
use crate::scene::noise::lattice_hash;
use crate::scene::relief::{MIN_CELLS, mesh_share};
use crate::scene::sky::Sun;

/// In place of the index of a band: none.
const NO_BAND: u8 = u8::MAX;
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
/// et al. 2021, so that coefficient k is (k + 1) (b[k + 1] - b[k]). Stands in `relief.wgsl` too.
const BOWL_SLOPE: [f32; 5] = [0.051_383_2, -0.150_474_8, 2.937_590_4, -5.661_628, 2.871_354];
/// Distance from the centre where the ejecta have faded out, and one over the width of the fade, radii. The neighbouring cells of the
/// lattice begin there.
const EJECTA_FADE: [f32; 2] = [1.5, 2.5];
/// Distance from the centre from which on nothing is left of a pit, with a margin for rounding, radii.
const PIT_REACH: f32 = 1.51;
/// Binary logarithm of the depth of the oldest crater over that of the youngest worn one: log2(0.02 / 0.12).
const WORN_DEPTH_LOG2: f32 = -2.584_962_5;
/// Depth of the youngest fresh crater less that of the oldest, diameters.
const FRESH_DEPTH_SPAN: f32 = 0.04;
/// What fresh craters add to the logarithm of the albedo: their soil is less mature. Stands in `relief.wgsl` too.
const FRESH_SHADE: f32 = 0.2;
/// The detail where there is no relief below the mesh: no slope, the material's albedo, no grain between the ground and the sun.
const NO_DETAIL: [f16; 4] = [f16::ZERO, f16::ZERO, f16::ONE, f16::ONE];
/// Half the width of the edges of these shadows, distances between samples.
pub(crate) const SHADOW_BLUR: f32 = 0.5;
/// Maximum depth of a worn crater, diameters: a little less than that of a fresh one, as in `craters.rs`.
const MAX_WORN_DEPTH: f32 = 0.1099;

/// Sums the slopes of a frame's ground.
#[derive(Clone, Debug)]
pub struct ReliefSlopes {
    bands: Vec<ReliefUniforms>,
    /// The band of each shading bin whose ground has relief below its mesh.
    band_of_bin: [u8; 1 << ShadingBin::BITS],
    /// Positions relative to the eye at a depth of a metre: the corner of sample (0, 0), and the steps to the next column and row.
    rays: [Vec3; 3],
    /// Unit vector towards the sun, and the tangent of half the angle that its disc spans.
    sun: (Vec3, f32),
}

/// What a row of the G-buffer holds, one value a sample.
#[derive(Clone, Copy, Debug)]
pub struct GBufferRow<'a> {
    /// Inverse depth, 1/m.
    pub inverse_depth: &'a [f32],
    /// First octahedral coordinate of the normal, in the lowest 24 bits.
    pub normal_x: &'a [u32],
    /// Second octahedral coordinate of the normal, in the lowest 24 bits.
    pub normal_y: &'a [u32],
    /// One more than the shading bin in the lowest bits; 0 where nothing is visible.
    pub visibility: &'a [u32],
}

impl ReliefSlopes {
    /// For the ground of these bands, seen along these rays.
    #[must_use]
    pub fn new(bands: &ReliefBands, bins: ShadingBins, rays: [Vec3; 3], sun: &Sun) -> Self {
        let mut band_of_bin = [NO_BAND; 1 << ShadingBin::BITS];
        for (band_of_bin, (variant, band)) in band_of_bin.iter_mut().zip(bins.all()) {
            let ReliefView { waves, pit_lattices, grain_lattices, ray_contrast, .. } = bands.bands[band].view;
            let has_detail = waves + pit_lattices + grain_lattices > 0 || ray_contrast > 0.0;
            if matches!(variant, LightingVariant::Ground { .. }) && has_detail {
                *band_of_bin = band as u8;
            }
        }
        Self { bands: bands.bands.clone(), band_of_bin, rays, sun: (sun.direction, sun.tan_half_angle()) }
    }

    /// Writes the detail at a row of samples: slope, rise per metre along x and y; factor on the albedo; fraction of the sun's disc that
    /// grains leave visible.
    pub fn set_row(&self, row: usize, gbuffer: &GBufferRow<'_>, slopes: &mut [[f16; 4]]) {
        slopes.fill(NO_DETAIL);
        let mut batch = SampleBatch::default();
        let (mut batch_band, mut count) = (NO_BAND, 0);
        for (column, visibility) in gbuffer.visibility.iter().enumerate() {
            let bin = (visibility & u32::from(ShadingBin::MAX)).wrapping_sub(1);
            let band = self.band_of_bin.get(bin as usize).copied().unwrap_or(NO_BAND);
            if band == NO_BAND {
                continue;
            }
            if count == BATCH || band != batch_band {
                self.set_batch(row, batch_band, &mut batch, count, slopes);
                (batch_band, count) = (band, 0);
            }
            batch.columns[count] = column as u32;
            batch.inverse_depth[count] = gbuffer.inverse_depth[column];
            batch.normal_x[count] = gbuffer.normal_x[column];
            batch.normal_y[count] = gbuffer.normal_y[column];
            count += 1;
        }
        self.set_batch(row, batch_band, &mut batch, count, slopes);
    }

    /// Writes the detail at the first `count` samples of a batch.
    fn set_batch(
        &self,
        row: usize,
        band: u8,
        batch: &mut SampleBatch,
        count: usize,
        slopes: &mut [[f16; 4]],
    ) {
        if count == 0 {
            return;
        }
        batch.pad(count);
        let relief = &self.bands[usize::from(band)];
        let mut detail = [[0.0_f32; 4]; BATCH];
        dispatch!(Level::new(), _simd => {
            ground_detail(relief, (self.rays, self.sun), row, (batch, count), &mut detail);
        });
        let mut halves = [NO_DETAIL; BATCH];
        halves.as_flattened_mut().convert_from_f32_slice(detail.as_flattened());
        for (column, halves) in batch.columns[..count].iter().zip(&halves) {
            slopes[*column as usize] = *halves;
        }
    }
}

// From here on all is inlined, to be compiled for each width of vectors.

/// What the mesh leaves out and samples can show, at the first `count` samples of a batch.
#[inline(always)]
fn ground_detail(
    relief: &ReliefUniforms,
    (rays, sun): ([Vec3; 3], (Vec3, f32)),
    row: usize,
    (batch, count): (&SampleBatch, usize),
    result: &mut [[f32; 4]; BATCH],
) {
    let view = &relief.view;
    let ground = GroundBatch::new(view, rays, sun.0, row, batch);
    let zeros = [0.0; BATCH];
    let mut sums = DetailSums::new();
    let nearest_across_m = add_relief(relief, &ground, &mut sums);
    let (mut x, mut y, mut sun_on_ground) = (zeros, zeros, zeros);
    for i in 0..BATCH {
        let point = sums.point(&ground, i);
        (x[i], y[i]) = (point.x, point.y);
        let blur_m = SHADOW_BLUR * ground.across_m[i] * ground.per_way[1][i];
        let sun = (0.5 + 0.5 * sums.sun_clearance_m[i] / blur_m).clamp(0.0, 1.0);
        sun_on_ground[i] = sun + (1.0 - sun) * ground.hidden_shadows[i];
    }
    let mut detail = GroundDetail {
        slope: Vectors { x: sums.x, y: sums.y },
        // The exponential function to second order.
        albedo: sums.shade.map(|shade| 1.0 + shade * (1.0 + 0.5 * shade)),
        sun: sun_on_ground,
        nearest_m: [0.0; BATCH],
        cover: [0.0; BATCH],
        cover_sun: [0.0; BATCH],
    };
    let material = GrainMaterial { ratio: view.grain_ratio, spread: view.grain_spread };
    let grain_ground = GrainGround {
        count,
        point: Vectors { x, y },
        across_m: ground.across_m,
        ways: ground.ways,
        sun_tan_half_angle: sun.1,
        material,
    };
    for grains in &relief.grains[..view.grain_lattices as usize] {
        if sample_share(1.001 * grains.max_diameter_m, nearest_across_m) > 0.0 {
            add_grains(grains, &grain_ground, &mut detail);
        }
    }
    if view.ray_contrast > 0.0 {
        add_crater_rays(relief, Vectors { x, y }, &ground.sample_m, &mut detail.albedo);
    }
    for (i, result) in result.iter_mut().enumerate() {
        // What hides the ground hides its shadows.
        let sun = detail.sun[i] * (1.0 - detail.cover[i]) + detail.cover_sun[i];
        *result = [detail.slope.x[i], detail.slope.y[i], detail.albedo[i], sun];
    }
}

/// Adds the pits and the noise, each from coarse to fine. Returns the smallest distance of samples across the view, metres.
#[inline(always)]
fn add_relief(relief: &ReliefUniforms, ground: &GroundBatch, sums: &mut DetailSums) -> f32 {
    let view = &relief.view;
    // Floats that are not negative sort as their bits do.
    let (mut smallest_cell, mut nearest, mut nearest_across) = (u32::MAX, u32::MAX, u32::MAX);
    let mut largest_cell = 0;
    for (cell_m, sample_m) in ground.cell_m.iter().zip(&ground.sample_m) {
        smallest_cell = smallest_cell.min(cell_m.to_bits());
        largest_cell = largest_cell.max(cell_m.to_bits());
        nearest = nearest.min(sample_m.to_bits());
    }
    for across_m in &ground.across_m {
        nearest_across = nearest_across.min(across_m.to_bits());
    }
    let [smallest_cell_m, largest_cell_m, nearest_m] =
        [smallest_cell, largest_cell, nearest].map(f32::from_bits);
    let mut smallest_per_way = u32::MAX;
    for per_way in &ground.per_way[1] {
        smallest_per_way = smallest_per_way.min(per_way.to_bits());
    }
    let is_sun_low = f32::from_bits(smallest_per_way) < 1.0 / MIN_LOW_WAY;
    for pits in &relief.pits[..view.pit_lattices as usize] {
        // The smallest pits of a lattice are half as large as its largest; a little room for how sizes are rounded.
        let is_resolved = sample_share(1.001 * pits.max_diameter_m, nearest_m) > 0.0;
        let is_below_mesh = mesh_share(0.499 * pits.max_diameter_m, largest_cell_m) < 1.0;
        let is_sampled = pits.factor * pits.max_diameter_m >= 2.0 * MIN_CELLS * smallest_cell_m;
        if is_resolved && is_below_mesh && is_sampled {
            pits_slope(pits, view.fresh_share, ground, sums);
        }
    }
    for wave in &relief.noise[..view.waves as usize] {
        if mesh_share(wave.cell_m, largest_cell_m) == 1.0 {
            set_strength(wave, ground, sums);
        } else if sample_share(wave.cell_m, nearest_m) > 0.0 {
            let is_tested = wave.cell_m > MIN_TESTED_SAMPLES * nearest_m;
            noise_slope(wave, ground, [is_tested, is_sun_low], sums);
        }
    }
    f32::from_bits(nearest_across)
}

/// Adds the slope of the pits of a lattice: at most one crater or clod a cell, which does not reach beyond its cell.
#[inline(always)]
fn pits_slope(pits: &LatticeUniforms, fresh_share: f32, ground: &GroundBatch, sums: &mut DetailSums) {
    let lattice = pits.lattice();
    let ages = CraterAges::new(pits.share, fresh_share);
    // Radius of the largest pit, cells.
    let largest = 0.5 * pits.max_diameter_m / pits.cell_m;
    let per_largest = 1.0 / largest;
    let zeros = [0.0; BATCH];
    let (mut offsets, mut shares) = (Vectors { x: zeros, y: zeros }, zeros);
    let (mut shrinks, mut radii, mut ages_of) = (zeros, zeros, zeros);
    let (mut firsts, mut seconds) = ([0; BATCH], [0; BATCH]);
    // Most samples are further from the pit of their cell than the largest one would reach.
    let max_reach = PIT_REACH * largest;
    let mut near = 0_u32;
    for i in 0..BATCH {
        let (cell, position) = lattice.cell(lattice.local(sums.point(ground, i)));
        let first = lattice_hash(cell[0], cell[1], 0, pits.seed);
        let second = second_hash(first);
        let [x, y] = pit_centre(second);
        let (along, across) = (position[0] - x, position[1] - y);
        let exists = pit_exists(pits, ground, i, first);
        let is_near = exists & (along * along + across * across < max_reach * max_reach);
        near |= if is_near { 1 } else { 0 };
        (offsets.x[i], offsets.y[i]) = (along, across);
        (firsts[i], seconds[i]) = (first, second);
    }
    if near == 0 {
        return;
    }
    let mut reached = 0_u32;
    for i in 0..BATCH {
        let pit = CellPit::new([firsts[i], seconds[i]], largest);
        let (along, across) = (offsets.x[i], offsets.y[i]);
        let exists = pit_exists(pits, ground, i, firsts[i]);
        let share = sums.share(ground, i, 2.0 * pits.cell_m * pit.radius);
        let reach = PIT_REACH * pit.radius;
        let is_reached = exists & (along * along + across * across < reach * reach) & (share > 0.0);
        reached |= if is_reached { 1 } else { 0 };
        shares[i] = if exists { share } else { 0.0 };
        (shrinks[i], radii[i], ages_of[i]) = (pit.shrink, pit.radius, pit.age);
    }
    if reached == 0 {
        return;
    }
    for i in 0..BATCH {
        let (share, shrink, radius, age) = (shares[i], shrinks[i], radii[i], ages_of[i]);
        let (along, across) = (offsets.x[i], offsets.y[i]);
        let square = along * along + across * across;
        let square = if square > 1e-12 { square } else { 1e-12 };
        let cells = square.sqrt();
        let per_cells = cells / square;
        // Distance from the centre in radii, and one over it.
        let (r, per_r) = (cells * shrink * per_largest, per_cells * radius);
        let depth = ages.depth(age);
        let is_clod = age < pits.share;
        let steepness = if is_clod { clod_steepness(r) } else { crater_steepness(r, per_r, depth) };
        let height = if is_clod { clod_height(r) } else { crater_height(r, per_r, depth) };
        let diameter_m = 2.0 * pits.cell_m * radius;
        let fresh = ((EJECTA_FADE[0] - r) * EJECTA_FADE[1]).clamp(0.0, 1.0) * FRESH_SHADE * share;
        let is_fresh = (age >= pits.share) & (age - pits.share < fresh_share * (1.0 - pits.share));
        let slope = pits.cell_m * share * steepness * per_cells;
        let (along, across) = (slope * along, slope * across);
        let slope = Vec2::new(
            pits.rotation_per_m.x * along - pits.rotation_per_m.y * across,
            pits.rotation_per_m.y * along + pits.rotation_per_m.x * across,
        );
        sums.add(ground, i, slope, share * diameter_m * height, if is_fresh { fresh } else { 0.0 });
    }
}

/// The centre of the pit of a cell with this second hash, cells from the corner of the cell. As `PitLattice::pit` in
/// `src/scene/craters.rs`.
#[inline(always)]
fn pit_centre(second: u32) -> [f32; 2] {
    let jitter = |bits: u32| ((bits & 0x3ff) as i32 as f32 * (1.0 / 512.0) - 1.0) * JITTER_CELLS + 0.5;
    [jitter(second), jitter(second >> 10)]
}

/// Whether the cell of sample `i`, which has this first hash, has a pit, and the lattice is sampled there.
#[inline(always)]
fn pit_exists(pits: &LatticeUniforms, ground: &GroundBatch, i: usize, first: u32) -> bool {
    let is_sampled = pits.factor * pits.max_diameter_m >= 2.0 * MIN_CELLS * ground.cell_m[i];
    // Uniform in [0, 1).
    let draw = (first & 0xffff) as i32 as f32 * (1.0 / 65_536.0);
    is_sampled & (draw < pits.amount)
}

/// What the hashes of a cell say of its pit. As `PitLattice::pit` in `src/scene/craters.rs`.
struct CellPit {
    /// How many times smaller than the largest pit of the lattice: 1 to 2.
    shrink: f32,
    /// Radius, cells.
    radius: f32,
    /// Uniform in [0, 1): clods first, then craters from the youngest to the oldest.
    age: f32,
}

impl CellPit {
    #[inline(always)]
    fn new([first, second]: [u32; 2], largest: f32) -> Self {
        // The inverse of the cumulative distribution of diameters, which goes with D^-2, within an octave.
        let shrink = 2.0 * (1.0 - 0.75 / 4096.0 * (second >> 20) as i32 as f32).sqrt();
        let age = (first >> 16) as i32 as f32 * (1.0 / 65_536.0);
        Self { shrink, radius: largest / shrink, age }
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

/// Height of a clod, diameters.
#[inline(always)]
fn clod_height(r: f32) -> f32 {
    let square = r * r;
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
}
