//! Value noise on an integer lattice and its fBm sums: the same bits on every machine.
//!
//! Only additions, multiplications and integer hashing, in a fixed order; no function whose result may differ
//! between processors. Batches of points run the same code, compiled for every SIMD width, and give the same bits as one
//! point at a time.
//! Must not know: what the noise is for.

mod cells;
mod gradient;
mod hash;

use fearless_simd::{Level, dispatch};

use crate::pool::PooledVec;
use crate::rounding::floor_and_fraction;
use cells::lerp;
pub(crate) use cells::smoothstep;
pub use gradient::{
    GRADIENT_NOISE_SIGMA, SHADE_SIGMA, gradient_noise_2d, gradient_noise_difference, gradient_noise_slope_2d,
    patchy_noise_2d,
};
#[cfg(test)]
pub(crate) use gradient::{PATCHY_BASE, PATCHY_PEAK};
pub use hash::lattice_hash;
use hash::{HASH_X, HASH_Y, HASH_Z, first_mixed, last_mixed};

/// Amplitude of each octave relative to the one before.
const GAIN: f32 = 0.5;

/// Fractional Brownian motion (fBm): a sum of octaves of value noise.
#[derive(Clone, Copy, Debug)]
pub struct Fbm {
    /// Number of octaves summed.
    pub octaves: u32,
    /// Frequency of the first octave, lattice cells per unit of the domain.
    pub frequency: f32,
    /// Frequency of each octave relative to the one before.
    pub lacunarity: f32,
    /// Seed of the lattice.
    pub seed: u32,
}

impl Fbm {
    /// The sum at a point of the plane, in [-1, 1]; standard deviation about 0.25.
    #[must_use]
    pub fn at_2d(&self, [x, y]: [f32; 2]) -> f32 {
        let mut sum = 0.0;
        for Octave { gain, frequency, seed } in self.octaves() {
            sum += gain * value_noise_2d([x * frequency, y * frequency], seed);
        }
        to_signed(sum, self.total())
    }

    /// The sum at a point of space, in [-1, 1].
    #[must_use]
    pub fn at_3d(&self, [x, y, z]: [f32; 3]) -> f32 {
        let mut sum = 0.0;
        for Octave { gain, frequency, seed } in self.octaves() {
            sum += gain * value_noise_3d([x * frequency, y * frequency, z * frequency], seed);
        }
        to_signed(sum, self.total())
    }

    /// Evaluates a grid whose columns have these x coordinates, line by line.
    #[must_use]
    pub fn lines<'a>(&self, x: &'a [f32]) -> Lines<'a> {
        let line = |octave| OctaveLines {
            octave,
            row: None,
            sides: [(); 2].map(|()| PooledVec::unspecified(x.len())),
        };
        Lines { x, octaves: self.octaves().map(line).collect(), total: self.total() }
    }

    /// [`Self::at_3d`] for many points, given as structure of arrays.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn at_many_3d(&self, [x, y, z]: [&[f32]; 3], sums: &mut [f32]) {
        assert!([y, z].map(<[f32]>::len) == [x.len(); 2] && sums.len() == x.len(), "one sum per point");
        dispatch!(Level::new(), _simd => self.set_at_many_3d([x, y, z], sums));
    }

    /// [`Self::at_many_3d`] inside a `dispatch!` of the caller.
    // Must be inlined into the dispatched code: otherwise it would be compiled for the baseline SIMD width.
    #[inline(always)]
    pub(super) fn set_at_many_3d(&self, [x, y, z]: [&[f32]; 3], sums: &mut [f32]) {
        sums.fill(0.0);
        for Octave { gain, frequency, seed } in self.octaves() {
            let gain = gain * HASH_UNIT;
            for (((sum, x), y), z) in sums.iter_mut().zip(x).zip(y).zip(z) {
                *sum += gain * hash_noise_3d([x * frequency, y * frequency, z * frequency], seed);
            }
        }
        let total = self.total();
        for sum in sums {
            *sum = to_signed(*sum, total);
        }
    }

    fn octaves(&self) -> impl Iterator<Item = Octave> {
        let first = Octave { gain: 1.0, frequency: self.frequency, seed: self.seed };
        let (octaves, lacunarity) = (self.octaves as usize, self.lacunarity);
        let next = move |octave: &Octave| {
            Some(Octave {
                gain: GAIN * octave.gain,
                frequency: lacunarity * octave.frequency,
                seed: octave.seed.wrapping_add(0x9e37_79b9),
            })
        };
        std::iter::successors(Some(first), next).take(octaves)
    }

    /// Sum of the amplitudes.
    fn total(&self) -> f32 {
        self.octaves().map(|octave| octave.gain).sum()
    }
}

/// One octave: a term of the sum.
#[derive(Debug)]
struct Octave {
    gain: f32,
    frequency: f32,
    seed: u32,
}

/// 2-D fBm along the lines of a grid. Consecutive lines between the same two rows of an octave's lattice share the values
/// interpolated along these rows.
#[derive(Debug)]
pub struct Lines<'a> {
    x: &'a [f32],
    octaves: Vec<OctaveLines>,
    total: f32,
}

/// An octave, interpolated along the two lattice rows on both sides of the last line.
#[derive(Debug)]
struct OctaveLines {
    octave: Octave,
    /// The southern (lower) row.
    row: Option<i32>,
    /// Values along the southern and the northern row, in units of [`HASH_UNIT`].
    sides: [PooledVec<f32>; 2],
}

impl Lines<'_> {
    /// [`Fbm::at_2d`] along a line: `sums[i]` is that of column `i` at `y`. Fastest if `y` increases from call to call.
    ///
    /// # Panics
    /// If there is not one sum per column.
    pub fn set(&mut self, y: f32, sums: &mut [f32]) {
        assert_eq!(self.x.len(), sums.len(), "one sum per column");
        dispatch!(Level::new(), _simd => self.set_in_vectors(y, sums));
    }

    #[inline(always)]
    fn set_in_vectors(&mut self, y: f32, sums: &mut [f32]) {
        sums.fill(0.0);
        for OctaveLines { octave: Octave { gain, frequency, seed }, row, sides } in &mut self.octaves {
            let (south, v) = floor_and_fraction(y * *frequency);
            if *row != Some(south) {
                let terms = HashTerms::new(south, HASH_Y);
                if *row == Some(south.wrapping_sub(1)) {
                    sides.swap(0, 1);
                } else {
                    set_along_row(self.x, *frequency, terms.low ^ first_mixed(*seed), &mut sides[0]);
                }
                set_along_row(self.x, *frequency, terms.high ^ first_mixed(*seed), &mut sides[1]);
                *row = Some(south);
            }
            let (gain, v) = (*gain * HASH_UNIT, smoothstep(v));
            let [south, north] = sides;
            for ((sum, south), north) in sums.iter_mut().zip(south).zip(north) {
                *sum += gain * lerp(*south, *north, v);
            }
        }
        for sum in sums {
            *sum = to_signed(*sum, self.total);
        }
    }
}

/// Interpolates the lattice values of a row; `rest` is the hash of the other coordinates and the seed.
#[inline(always)]
fn set_along_row(x: &[f32], frequency: f32, rest: u32, values: &mut [f32]) {
    for (value, x) in values.iter_mut().zip(x) {
        let (x, u) = floor_and_fraction(x * frequency);
        *value = between(HashTerms::new(x, HASH_X), rest, smoothstep(u));
    }
}

/// Maps a sum of octaves from [0, `total`) to [-1, 1).
#[inline(always)]
fn to_signed(sum: f32, total: f32) -> f32 {
    2.0 * (sum / total) - 1.0
}

/// 2-D value noise in [0, 1): lattice values blended bilinearly with cubic smoothstep weights.
#[must_use]
#[inline(always)]
pub fn value_noise_2d([x, y]: [f32; 2], seed: u32) -> f32 {
    let ((x, u), (y, v)) = (floor_and_fraction(x), floor_and_fraction(y));
    let (x, y, seed) = (HashTerms::new(x, HASH_X), HashTerms::new(y, HASH_Y), first_mixed(seed));
    let (south, north) = (between(x, y.low ^ seed, smoothstep(u)), between(x, y.high ^ seed, smoothstep(u)));
    HASH_UNIT * lerp(south, north, smoothstep(v))
}

/// The parts of the lattice hash that come from the two neighbours along an axis.
#[derive(Clone, Copy)]
struct HashTerms {
    low: u32,
    high: u32,
}

impl HashTerms {
    #[inline(always)]
    fn new(coordinate: i32, factor: u32) -> Self {
        // The products of neighbours differ by the factor.
        let low = (coordinate as u32).wrapping_mul(factor);
        Self { low: first_mixed(low), high: first_mixed(low.wrapping_add(factor)) }
    }
}

/// Interpolates between two neighbours along x; `rest` is the hash of the other coordinates and the seed.
#[inline(always)]
fn between(x: HashTerms, rest: u32, u: f32) -> f32 {
    lerp(value_of(last_mixed(x.low ^ rest)), value_of(last_mixed(x.high ^ rest)), u)
}

/// 3-D value noise in [0, 1): lattice values blended trilinearly with cubic smoothstep weights.
#[must_use]
#[inline(always)]
pub fn value_noise_3d(point: [f32; 3], seed: u32) -> f32 {
    HASH_UNIT * hash_noise_3d(point, seed)
}

/// The same in units of [`HASH_UNIT`]. That is a power of two, as is the weight of an octave: the order of these
/// multiplications changes no bit.
#[inline(always)]
fn hash_noise_3d([px, py, pz]: [f32; 3], seed: u32) -> f32 {
    let ((x, u), (y, v), (z, w)) = (floor_and_fraction(px), floor_and_fraction(py), floor_and_fraction(pz));
    let (x, y, z) = (HashTerms::new(x, HASH_X), HashTerms::new(y, HASH_Y), HashTerms::new(z, HASH_Z));
    let (u, v, w) = (smoothstep(u), smoothstep(v), smoothstep(w));
    let seed = first_mixed(seed);
    let (low, high) = (z.low ^ seed, z.high ^ seed);
    let below = lerp(between(x, y.low ^ low, u), between(x, y.high ^ low, u), v);
    let above = lerp(between(x, y.low ^ high, u), between(x, y.high ^ high, u), v);
    lerp(below, above, w)
}

/// Unit of [`value_of`].
const HASH_UNIT: f32 = 1.0 / 16_777_216.0;

/// Value of a lattice point with this hash: 24 bits, uniform, in units of [`HASH_UNIT`].
#[inline(always)]
fn value_of(hash: u32) -> f32 {
    // Via i32, which converts to f32 faster than u32; 24 bits fit in both.
    (hash >> 8) as i32 as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice_value(x: i32, y: i32, z: i32, seed: u32) -> f32 {
        HASH_UNIT * value_of(lattice_hash(x, y, z, seed))
    }

    #[test]
    fn batches_have_the_bits_of_single_points() {
        let fbm = Fbm { octaves: 4, frequency: 1.37, lacunarity: 2.05, seed: 77 };
        // A length that is no multiple of any SIMD width.
        let coordinate = |k: f32| (0..101).map(|i| k * (i as f32 - 50.3)).collect::<Vec<f32>>();
        let [x, y, z] = [0.731, -1.93, 0.117].map(coordinate);
        let mut sums = vec![f32::NAN; x.len()];
        fbm.at_many_3d([&x, &y, &z], &mut sums);
        for i in 0..x.len() {
            assert_eq!(sums[i].to_bits(), fbm.at_3d([x[i], y[i], z[i]]).to_bits());
        }
        // Within a row of lattice cells, into the next, across several, and back.
        let mut lines = fbm.lines(&x);
        for y in [-7.7, -7.69, -7.4, -6.9, 3.3, 3.31, -2.0] {
            lines.set(y, &mut sums);
            for i in 0..x.len() {
                assert_eq!(sums[i].to_bits(), fbm.at_2d([x[i], y]).to_bits());
            }
        }
    }

    #[test]
    fn noise_is_the_lattice_value_at_lattice_points_and_the_mean_half_way() {
        for (x, y, z) in [(0, 0, 0), (3, -4, 5), (-1, -1, -1)] {
            let at = value_noise_3d([x as f32, y as f32, z as f32], 9);
            assert_eq!(at, lattice_value(x, y, z, 9));
            let half = value_noise_3d([x as f32 + 0.5, y as f32, z as f32], 9);
            let mean = 0.5 * (lattice_value(x, y, z, 9) + lattice_value(x + 1, y, z, 9));
            assert!((half - mean).abs() < 1e-6);
        }
        assert_eq!(value_noise_2d([-2.0, 7.0], 3), lattice_value(-2, 7, 0, 3));
    }

    #[test]
    fn fbm_has_zero_mean_stays_in_range_and_has_the_stated_deviation() {
        let fbm = Fbm { octaves: 5, frequency: 0.37, lacunarity: 2.0, seed: 11 };
        let (mut sum, mut square, mut n) = (0.0_f64, 0.0_f64, 0.0);
        for i in 0..200 {
            for j in 0..200 {
                let value = f64::from(fbm.at_2d([i as f32 * 1.7, j as f32 * 1.3]));
                assert!((-1.0..=1.0).contains(&value));
                sum += value;
                square += value * value;
                n += 1.0;
            }
        }
        let (mean, deviation) = (sum / n, (square / n - (sum / n) * (sum / n)).sqrt());
        assert!(mean.abs() < 0.02, "{mean}");
        assert!((deviation - 0.25).abs() < 0.03, "{deviation}");
    }
}
