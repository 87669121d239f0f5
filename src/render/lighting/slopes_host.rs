//! Slopes of the ground below the size of its mesh's cells, summed up by this program: for devices that are a CPU themselves,
//! which fetch each number of a uniform for every sample.
//!
//! Twin of `relief_slope` in `shaders/common/relief.wgsl`, but for the last bits of a slope.
//! Must not know: where slopes go.

use fearless_simd::{Level, dispatch};
use glam::{Vec2, Vec3};

use crate::render::device::shader_structs::{LatticeUniforms, ReliefUniforms, ReliefView};
use crate::render::device::shading_bins::{LightingVariant, ShadingBin, ShadingBins};
use crate::render::lighting::relief_bands::{Bands, sample_share};
use crate::scene::craters::{CLOD_HEIGHT, EJECTA_EXPONENT, JITTER_CELLS, PROFILE_DEPTH, RIM, second_hash};
use crate::scene::noise::{gradient_noise_slope_2d, lattice_hash};
use crate::scene::relief::{CELLS_LEAST, mesh_share};

/// Samples that are summed up for together.
const AT_A_TIME: usize = 64;
/// In place of a band: none.
const NO_BAND: u8 = u8::MAX;
/// Coefficients of 2 to the power of something small: ln(2)^k / k!.
const EXP2: [f32; 8] = [
    1.0,
    std::f32::consts::LN_2,
    0.240_226_5,
    0.055_504_11,
    0.009_618_129,
    0.001_333_356,
    0.000_154_035_3,
    0.000_015_252_73,
];

/// What slopes are summed up from.
#[derive(Clone, Debug)]
pub struct Slopes {
    bands: Vec<ReliefUniforms>,
    /// The band of each group that shows something of it.
    band_of: [u8; 1 << ShadingBin::BITS],
    /// A metre along the axis, metres from the eye: the corner of sample (0, 0), and how that moves with a column and a row.
    rays: [Vec3; 3],
}

/// A row of samples: one over the metres along the axis, the two numbers of the normal as `visibility.wgsl` packs them, and one
/// more than the group.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// One over the metres along the axis.
    pub inverse_w: &'a [f32],
    /// The normal's first number, 24 bits.
    pub normal_x: &'a [u32],
    /// Its second.
    pub normal_y: &'a [u32],
    /// One more than the group in the lowest bits.
    pub things: &'a [u32],
}

/// Some samples of a row that show the same band.
#[derive(Clone, Copy)]
struct Some64 {
    columns: [u32; AT_A_TIME],
    inverse_w: [f32; AT_A_TIME],
    normal_x: [u32; AT_A_TIME],
    normal_y: [u32; AT_A_TIME],
}

/// Where these lie on the ground, metres from its centre, and how large cells and how far apart samples are there: what
/// [`mesh_share`] and [`sample_share`] divide a size by, and one over it.
struct Places {
    x: [f32; AT_A_TIME],
    y: [f32; AT_A_TIME],
    cell_m: [f32; AT_A_TIME],
    sample_m: [f32; AT_A_TIME],
    per_mesh: [f32; AT_A_TIME],
    per_sample: [f32; AT_A_TIME],
}

/// Rise per metre along x and y.
struct Sums {
    x: [f32; AT_A_TIME],
    y: [f32; AT_A_TIME],
}

impl Slopes {
    /// Of the ground of these bands, seen along these rays.
    #[must_use]
    pub fn new(bands: &Bands, groups: ShadingBins, rays: [Vec3; 3]) -> Self {
        let mut band_of = [NO_BAND; 1 << ShadingBin::BITS];
        for (band_of, (lit, band)) in band_of.iter_mut().zip(groups.all()) {
            let ReliefView { waves, pit_lattices, .. } = bands.bands[band].view;
            if matches!(lit, LightingVariant::Ground { .. }) && waves + pit_lattices > 0 {
                *band_of = band as u8;
            }
        }
        Self { bands: bands.bands.clone(), band_of, rays }
    }

    /// Sets those of a row of samples: rise per metre along x and y, 0 where there are none.
    pub fn set_row(&self, row: usize, seen: &Seen<'_>, slopes: &mut [[f32; 2]]) {
        slopes.fill([0.0; 2]);
        let mut some = Some64::default();
        let (mut band, mut count) = (NO_BAND, 0);
        for (column, thing) in seen.things.iter().enumerate() {
            let group = (thing & u32::from(ShadingBin::MAX)).wrapping_sub(1);
            let here = self.band_of.get(group as usize).copied().unwrap_or(NO_BAND);
            if here == NO_BAND {
                continue;
            }
            if count == AT_A_TIME || here != band {
                self.set_some(row, band, &mut some, count, slopes);
                (band, count) = (here, 0);
            }
            some.columns[count] = column as u32;
            some.inverse_w[count] = seen.inverse_w[column];
            some.normal_x[count] = seen.normal_x[column];
            some.normal_y[count] = seen.normal_y[column];
            count += 1;
        }
        self.set_some(row, band, &mut some, count, slopes);
    }

    fn set_some(&self, row: usize, band: u8, some: &mut Some64, count: usize, slopes: &mut [[f32; 2]]) {
        if count == 0 {
            return;
        }
        // The rest is what the first is.
        for i in count..AT_A_TIME {
            some.copy_first(i);
        }
        let mut sums = Sums { x: [0.0; AT_A_TIME], y: [0.0; AT_A_TIME] };
        let relief = &self.bands[usize::from(band)];
        dispatch!(Level::new(), _simd => sum_up(relief, self.rays, row, some, &mut sums));
        for (column, slope) in some.columns[..count].iter().zip(sums.x.iter().zip(&sums.y)) {
            slopes[*column as usize] = [*slope.0, *slope.1];
        }
    }
}

impl Some64 {
    const fn copy_first(&mut self, to: usize) {
        self.columns[to] = self.columns[0];
        self.inverse_w[to] = self.inverse_w[0];
        self.normal_x[to] = self.normal_x[0];
        self.normal_y[to] = self.normal_y[0];
    }
}

impl Default for Some64 {
    fn default() -> Self {
        let (none, nothing) = ([0; AT_A_TIME], [0.0; AT_A_TIME]);
        Self { columns: none, inverse_w: nothing, normal_x: none, normal_y: none }
    }
}

// From here on all is inlined, to be compiled for each width of vectors.

#[inline(always)]
fn sum_up(relief: &ReliefUniforms, rays: [Vec3; 3], row: usize, some: &Some64, sums: &mut Sums) {
    let view = &relief.view;
    let places = Places::of(view, rays, row, some);
    // Numbers that are not negative are in the order of their bits.
    let (mut smallest_cell, mut nearest) = (u32::MAX, u32::MAX);
    let mut largest_cell = 0;
    for (cell_m, sample_m) in places.cell_m.iter().zip(&places.sample_m) {
        smallest_cell = smallest_cell.min(cell_m.to_bits());
        largest_cell = largest_cell.max(cell_m.to_bits());
        nearest = nearest.min(sample_m.to_bits());
    }
    let [smallest_cell_m, largest_cell_m, nearest_m] =
        [smallest_cell, largest_cell, nearest].map(f32::from_bits);
    for wave in &relief.noise[..view.waves as usize] {
        if sample_share(wave.cell_m, nearest_m) > 0.0 && mesh_share(wave.cell_m, largest_cell_m) < 1.0 {
            add_wave(wave, &places, sums);
        }
    }
    for pits in &relief.pits[..view.pit_lattices as usize] {
        // The smallest pits of a lattice are half as large as its largest.
        let is_shown = sample_share(1.001 * pits.largest_m, nearest_m) > 0.0;
        let is_below_mesh = mesh_share(0.499 * pits.largest_m, largest_cell_m) < 1.0;
        let is_asked = pits.asked * pits.largest_m >= 2.0 * CELLS_LEAST * smallest_cell_m;
        if is_shown && is_below_mesh && is_asked {
            add_pits(pits, view.fresh_share, &places, sums);
        }
    }
}

impl Places {
    #[inline(always)]
    fn of(view: &ReliefView, [corner, right, down]: [Vec3; 3], row: usize, some: &Some64) -> Self {
        let none = [0.0; AT_A_TIME];
        let mut places =
            Self { x: none, y: none, cell_m: none, sample_m: none, per_mesh: none, per_sample: none };
        let left = corner + (row as f32 + 0.5) * down;
        for i in 0..AT_A_TIME {
            let (column, w) = (some.columns[i] as i32 as f32 + 0.5, 1.0 / some.inverse_w[i]);
            let x = (left.x + column * right.x) * w;
            let y = (left.y + column * right.y) * w;
            let z = (left.z + column * right.z) * w;
            // Twin: `octahedral_decode` in `common/octahedral.wgsl`.
            let p = (some.normal_x[i] & 0x00ff_ffff) as i32 as f32 * (2.0 / 16_777_215.0) - 1.0;
            let q = (some.normal_y[i] & 0x00ff_ffff) as i32 as f32 * (2.0 / 16_777_215.0) - 1.0;
            let n_z = 1.0 - p.abs() - q.abs();
            let back = if n_z < 0.0 { -n_z } else { 0.0 };
            let n_x = if p >= 0.0 { p - back } else { p + back };
            let n_y = if q >= 0.0 { q - back } else { q + back };
            let (square, n_square) = (x * x + y * y + z * z, n_x * n_x + n_y * n_y + n_z * n_z);
            let facing = -(n_x * x + n_y * y + n_z * z) / (square * n_square).sqrt();
            // Samples lie further apart in depth than across: the mean of the two, in the logarithm.
            let sample_m = view.sample_angle * (square / facing.clamp(0.04, 1.0)).sqrt();
            let (x, y) = (view.eye_from_centre.x + x, view.eye_from_centre.y + y);
            let height = view.eye_height_m;
            places.x[i] = x;
            places.y[i] = y;
            let cell_m = view.cell * (x * x + y * y + height * height).sqrt();
            places.cell_m[i] = cell_m;
            places.sample_m[i] = sample_m;
            places.per_mesh[i] = 1.0 / (CELLS_LEAST * cell_m);
            places.per_sample[i] = 0.5 / sample_m;
        }
        places
    }

    /// How much of something of this size the mesh leaves out and samples show at a place.
    #[inline(always)]
    fn share(&self, i: usize, size_m: f32) -> f32 {
        let left_out = 1.0 - (size_m * self.per_mesh[i] - 1.0).clamp(0.0, 1.0);
        left_out * (size_m * self.per_sample[i] - 1.0).clamp(0.0, 1.0)
    }
}

#[inline(always)]
fn add_wave(wave: &LatticeUniforms, places: &Places, sums: &mut Sums) {
    let lattice = wave.lattice();
    for i in 0..AT_A_TIME {
        let ([column, row], t) = lattice.cell(lattice.local(Vec2::new(places.x[i], places.y[i])));
        let [along, across] = gradient_noise_slope_2d([column, row], t, wave.seed);
        let share = wave.amount * places.share(i, wave.cell_m);
        sums.x[i] += share * (wave.turn.x * along - wave.turn.y * across);
        sums.y[i] += share * (wave.turn.y * along + wave.turn.x * across);
    }
}

#[inline(always)]
fn add_pits(pits: &LatticeUniforms, fresh_share: f32, places: &Places, sums: &mut Sums) {
    let lattice = pits.lattice();
    let (per_old, per_worn) = (1.0 / (1.0 - pits.clods), 1.0 / (1.0 - fresh_share));
    let per_fresh = if fresh_share > 1e-6 { 1.0 / fresh_share } else { 1e6 };
    // Radius of the largest, cells.
    let largest = 0.5 * pits.largest_m / pits.cell_m;
    let per_largest = 1.0 / largest;
    for i in 0..AT_A_TIME {
        let ([column, row], [u, v]) = lattice.cell(lattice.local(Vec2::new(places.x[i], places.y[i])));
        let first = lattice_hash(column, row, 0, pits.seed);
        let second = second_hash(first);
        let jitter = |bits: u32| ((bits & 0x3ff) as i32 as f32 * (1.0 / 512.0) - 1.0) * JITTER_CELLS + 0.5;
        let (along, across) = (u - jitter(second), v - jitter(second >> 10));
        // How many times smaller than the largest, and the radius in cells.
        let smaller = 2.0 * (1.0 - 0.75 / 4096.0 * (second >> 20) as i32 as f32).sqrt();
        let radius = largest / smaller;
        let square = along * along + across * across;
        let square = if square > 1e-12 { square } else { 1e-12 };
        let cells = square.sqrt();
        let per_cells = cells / square;
        let (r, per_r) = (cells * smaller * per_largest, per_cells * radius);
        let age = (first >> 16) as i32 as f32 * (1.0 / 65_536.0);
        let since = (age - pits.clods) * per_old;
        // From the youngest to the oldest evenly in the logarithm.
        let worn = 0.12 * exp2_of_few(-2.584_962_5 * ((since - fresh_share) * per_worn));
        let worn = if worn < 0.1099 { worn } else { 0.1099 };
        let depth = if since < fresh_share { 0.15 - 0.04 * per_fresh * since } else { worn };
        // Inside the crest the derivative of the polynomial; outside that of the ejecta's power law, faded out.
        let bowl = 0.051_383_2 + r * (-0.150_474_8 + r * (2.937_590_4 + r * (-5.661_628 + r * 2.871_354)));
        let rr = r * r;
        let per_rr = per_r * per_r;
        let ejecta = EJECTA_EXPONENT * RIM * (per_rr * per_rr) * ((1.5 - r) * 2.5).clamp(0.0, 1.0);
        let crater = 2.0 / PROFILE_DEPTH * depth * if r < 1.0 { bowl } else { ejecta };
        let clod = -8.0 * CLOD_HEIGHT * r * if rr < 1.0 { 1.0 - rr } else { 0.0 };
        let steepness = if age < pits.clods { clod } else { crater };
        let is_asked = pits.asked * pits.largest_m >= 2.0 * CELLS_LEAST * places.cell_m[i];
        let is_there = is_asked & ((first & 0xffff) as i32 as f32 * (1.0 / 65_536.0) < pits.amount);
        let share = places.share(i, 2.0 * pits.cell_m * radius);
        let slope = if is_there { pits.cell_m * share * steepness * per_cells } else { 0.0 };
        let (along, across) = (slope * along, slope * across);
        sums.x[i] += pits.turn.x * along - pits.turn.y * across;
        sums.y[i] += pits.turn.y * along + pits.turn.x * across;
    }
}

/// 2 to a power from -2.7 to 0, within a millionth.
#[inline(always)]
fn exp2_of_few(power: f32) -> f32 {
    let x = 0.25 * power;
    let mut sum = EXP2[7];
    for coefficient in EXP2[..7].iter().rev() {
        sum = sum * x + coefficient;
    }
    let square = sum * sum;
    square * square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_of_two_is_one() {
        for i in 0..=270 {
            let power = -0.01 * i as f32;
            assert!((exp2_of_few(power) / libm::exp2f(power) - 1.0).abs() < 1e-6, "2^{power}");
        }
    }
}
