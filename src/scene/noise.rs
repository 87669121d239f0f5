//! Value noise on an integer lattice and its fractal sums: the same bits on every machine.
//!
//! Only additions, multiplications and integer hashing, in a fixed order; no function whose result may differ
//! between processors. Sums over many places are the same code, compiled for each width of vectors that processors
//! have, and give the same bits as one place at a time.
//! Must not know: what the noise is for.

use fearless_simd::{Level, dispatch};

use crate::reuse::Reused;

/// Amplitude of each octave relative to the one before.
const GAIN: f32 = 0.5;

/// Parameters of a fractal sum of value noise (fractional Brownian motion).
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
    /// The sum at a point of the plane, in [-1, 1]; its standard deviation is about 0.25.
    #[must_use]
    pub fn at_2d(&self, [x, y]: [f32; 2]) -> f32 {
        let mut sum = 0.0;
        for Octave { gain, frequency, seed } in self.each() {
            sum += gain * value_noise_2d([x * frequency, y * frequency], seed);
        }
        scaled(sum, self.total())
    }

    /// The sum at a point of space, in [-1, 1].
    #[must_use]
    pub fn at_3d(&self, [x, y, z]: [f32; 3]) -> f32 {
        let mut sum = 0.0;
        for Octave { gain, frequency, seed } in self.each() {
            sum += gain * value_noise_3d([x * frequency, y * frequency, z * frequency], seed);
        }
        scaled(sum, self.total())
    }

    /// The sums of a grid whose columns are at these coordinates, to be taken line by line.
    #[must_use]
    pub fn lines<'a>(&self, x: &'a [f32]) -> Lines<'a> {
        let line =
            |octave| OctaveLines { octave, row: None, sides: [(); 2].map(|()| Reused::of_any(x.len())) };
        Lines { x, octaves: self.each().map(line).collect(), total: self.total() }
    }

    /// [`Self::at_3d`] of many places, given by their coordinates.
    ///
    /// # Panics
    /// Unless there is a sum for every place.
    pub fn at_many_3d(&self, [x, y, z]: [&[f32]; 3], sums: &mut [f32]) {
        assert!([y, z].map(<[f32]>::len) == [x.len(); 2] && sums.len() == x.len(), "a sum for every place");
        dispatch!(Level::new(), _simd => self.set_at_many_3d([x, y, z], sums));
    }

    /// [`Self::at_many_3d`] where it is compiled for a width already.
    // What vectors are made of is inlined wholly: a closure would be compiled for the narrowest of them.
    #[inline(always)]
    pub(super) fn set_at_many_3d(&self, [x, y, z]: [&[f32]; 3], sums: &mut [f32]) {
        sums.fill(0.0);
        for Octave { gain, frequency, seed } in self.each() {
            let gain = gain * HASH_UNIT;
            for (((sum, x), y), z) in sums.iter_mut().zip(x).zip(y).zip(z) {
                *sum += gain * hash_noise_3d([x * frequency, y * frequency, z * frequency], seed);
            }
        }
        let total = self.total();
        for sum in sums {
            *sum = scaled(*sum, total);
        }
    }

    fn each(&self) -> impl Iterator<Item = Octave> {
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
        self.each().map(|octave| octave.gain).sum()
    }
}

/// A term of a fractal sum.
#[derive(Debug)]
struct Octave {
    gain: f32,
    frequency: f32,
    seed: u32,
}

/// Sums of plane noise along the lines of a grid. Lines between the same rows of an octave's lattice share what it is along
/// these rows.
#[derive(Debug)]
pub struct Lines<'a> {
    x: &'a [f32],
    octaves: Vec<OctaveLines>,
    total: f32,
}

/// An octave along the two rows of its lattice that the last line lies between.
#[derive(Debug)]
struct OctaveLines {
    octave: Octave,
    /// The southern one.
    row: Option<i32>,
    /// In units of [`HASH_UNIT`].
    sides: [Reused<f32>; 2],
}

impl Lines<'_> {
    /// [`Fbm::at_2d`] of every place of a line: `sums[i]` is that of column `i` at `y`. Fastest where `y` rises.
    ///
    /// # Panics
    /// Unless there is a sum for every column.
    pub fn set(&mut self, y: f32, sums: &mut [f32]) {
        assert_eq!(self.x.len(), sums.len(), "a sum for every column");
        dispatch!(Level::new(), _simd => self.set_in_vectors(y, sums));
    }

    #[inline(always)]
    fn set_in_vectors(&mut self, y: f32, sums: &mut [f32]) {
        sums.fill(0.0);
        for OctaveLines { octave: Octave { gain, frequency, seed }, row, sides } in &mut self.octaves {
            let (south, v) = cell(y * *frequency);
            if *row != Some(south) {
                let terms = Terms::new(south, HASH_Y);
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
            *sum = scaled(*sum, self.total);
        }
    }
}

#[inline(always)]
fn set_along_row(x: &[f32], frequency: f32, rest: u32, values: &mut [f32]) {
    for (value, x) in values.iter_mut().zip(x) {
        let (x, u) = cell(x * frequency);
        *value = between(Terms::new(x, HASH_X), rest, smoothstep(u));
    }
}

/// A sum of octaves in [0, `total`), brought to [-1, 1).
#[inline(always)]
fn scaled(sum: f32, total: f32) -> f32 {
    2.0 * (sum / total) - 1.0
}

/// 2-D value noise in [0, 1): lattice values blended bilinearly with cubic smoothstep weights.
#[must_use]
pub fn value_noise_2d([x, y]: [f32; 2], seed: u32) -> f32 {
    let ((x, u), (y, v)) = (cell(x), cell(y));
    let (x, y, seed) = (Terms::new(x, HASH_X), Terms::new(y, HASH_Y), first_mixed(seed));
    let (south, north) = (between(x, y.low ^ seed, smoothstep(u)), between(x, y.high ^ seed, smoothstep(u)));
    HASH_UNIT * lerp(south, north, smoothstep(v))
}

/// What the two neighbours along an axis bring to the hash of a lattice point.
#[derive(Clone, Copy)]
struct Terms {
    low: u32,
    high: u32,
}

impl Terms {
    #[inline(always)]
    fn new(coordinate: i32, factor: u32) -> Self {
        // The products of neighbours differ by the factor.
        let low = (coordinate as u32).wrapping_mul(factor);
        Self { low: first_mixed(low), high: first_mixed(low.wrapping_add(factor)) }
    }
}

/// Noise between two neighbours along x; `rest` is all else that is hashed.
#[inline(always)]
fn between(x: Terms, rest: u32, u: f32) -> f32 {
    lerp(value_of(last_mixed(x.low ^ rest)), value_of(last_mixed(x.high ^ rest)), u)
}

/// 3-D value noise in [0, 1): lattice values blended trilinearly with cubic smoothstep weights.
#[must_use]
#[inline(always)]
pub fn value_noise_3d(place: [f32; 3], seed: u32) -> f32 {
    HASH_UNIT * hash_noise_3d(place, seed)
}

/// The same in units of [`HASH_UNIT`]. That is a power of two, and so is the weight of an octave: which of them is multiplied
/// by when changes no bit.
#[inline(always)]
fn hash_noise_3d([px, py, pz]: [f32; 3], seed: u32) -> f32 {
    let ((x, u), (y, v), (z, w)) = (cell(px), cell(py), cell(pz));
    let (x, y, z) = (Terms::new(x, HASH_X), Terms::new(y, HASH_Y), Terms::new(z, HASH_Z));
    let (u, v, w) = (smoothstep(u), smoothstep(v), smoothstep(w));
    let seed = first_mixed(seed);
    let (low, high) = (z.low ^ seed, z.high ^ seed);
    let below = lerp(between(x, y.low ^ low, u), between(x, y.high ^ low, u), v);
    let above = lerp(between(x, y.low ^ high, u), between(x, y.high ^ high, u), v);
    lerp(below, above, w)
}

/// Gradient noise of a place in a cell of the plane's lattice (`t` in [0, 1) along both axes), after Perlin 2002,
/// "Improving Noise": gradients at the corners, each component uniform in [-1, 1), blended with quintic weights. The
/// corners have values too, uniform in [-0.5, 0.5), or every one of them would be on the same level and the lattice would
/// show. Mean 0, deviation [`GRADIENT_NOISE_SIGMA`].
#[must_use]
#[inline(always)]
pub fn gradient_noise_2d(cell: [i32; 2], t: [f32; 2], seed: u32) -> f32 {
    let [u, v] = [quintic(t[0]), quintic(t[1])];
    let at = |away| gradient_corner(cell, away, seed).seen_from(t, away);
    lerp(lerp(at([0, 0]), at([1, 0]), u), lerp(at([0, 1]), at([1, 1]), u), v)
}

/// Rise of [`gradient_noise_2d`] per cell along both axes.
#[must_use]
#[inline(always)]
pub fn gradient_noise_slope_2d(cell: [i32; 2], t: [f32; 2], seed: u32) -> [f32; 2] {
    let [u, v] = [quintic(t[0]), quintic(t[1])];
    let [sw, se] = [gradient_corner(cell, [0, 0], seed), gradient_corner(cell, [1, 0], seed)];
    let [nw, ne] = [gradient_corner(cell, [0, 1], seed), gradient_corner(cell, [1, 1], seed)];
    let (a, b) = (sw.seen_from(t, [0, 0]), se.seen_from(t, [1, 0]));
    let (c, d) = (nw.seen_from(t, [0, 1]), ne.seen_from(t, [1, 1]));
    [
        lerp(lerp(sw.x, se.x, u), lerp(nw.x, ne.x, u), v) + quintic_rise(t[0]) * lerp(b - a, d - c, v),
        lerp(lerp(sw.y, se.y, u), lerp(nw.y, ne.y, u), v) + quintic_rise(t[1]) * lerp(c - a, d - b, u),
    ]
}

/// Gradient and value of a corner.
#[derive(Clone, Copy)]
struct Corner {
    x: f32,
    y: f32,
    value: f32,
}

impl Corner {
    /// What the corner so many cells away gives at `t`.
    #[inline(always)]
    fn seen_from(self, t: [f32; 2], away: [i32; 2]) -> f32 {
        self.value + self.x * (t[0] - away[0] as f32) + self.y * (t[1] - away[1] as f32)
    }
}

#[inline(always)]
fn gradient_corner(cell: [i32; 2], away: [i32; 2], seed: u32) -> Corner {
    let hash = lattice_hash(cell[0].wrapping_add(away[0]), cell[1].wrapping_add(away[1]), 0, seed);
    // Signed, as in `value_of`.
    Corner {
        x: (hash & 0xffff) as i32 as f32 * (1.0 / 32_768.0) - 1.0,
        y: (hash >> 16) as i32 as f32 * (1.0 / 32_768.0) - 1.0,
        value: (hash.wrapping_mul(0x9e37_79b1) >> 16) as i32 as f32 * (1.0 / 65_536.0) - 0.5,
    }
}

/// Derivative of [`quintic`].
#[inline(always)]
fn quintic_rise(t: f32) -> f32 {
    30.0 * t * t * (t * (t - 2.0) + 1.0)
}

#[inline(always)]
fn quintic(t: f32) -> f32 {
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

/// Standard deviation of [`gradient_noise_2d`].
pub const GRADIENT_NOISE_SIGMA: f32 = 0.286;

/// Root mean square of the difference of [`gradient_noise_2d`] over a distance in lattice cells: it rises with the
/// gradient's deviation, 0.67 a cell, and levels out at the square root of 2 deviations. Within 4 % at any distance.
#[must_use]
pub fn gradient_noise_difference(cells: f64) -> f64 {
    let sigma = f64::from(GRADIENT_NOISE_SIGMA);
    let level = 2.0 * sigma * sigma;
    let rise = 0.6675 * cells;
    (level * (1.0 - libm::exp(-rise * rise / level))).sqrt()
}

/// What [`value_of`] counts.
const HASH_UNIT: f32 = 1.0 / 16_777_216.0;

/// Value of a lattice point with this hash: 24 bits, uniform, in units of [`HASH_UNIT`].
#[inline(always)]
fn value_of(hash: u32) -> f32 {
    // Signed, for processors convert these faster; 24 bits are the same number either way.
    (hash >> 8) as i32 as f32
}

/// Factors of the coordinates in [`lattice_hash`].
const HASH_X: u32 = 0x8da6_b343;
const HASH_Y: u32 = 0xd816_3841;
const HASH_Z: u32 = 0xcb1a_b31f;

/// Hash of a lattice point: a linear form in the coordinates (odd constants, from Teschner et al. 2003,
/// "Optimized Spatial Hashing", made odd 32-bit), then the 32-bit finaliser "lowbias32" of Chris Wellons
/// (2018, hash-prospector).
#[must_use]
#[inline(always)]
pub const fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let (x, y) = ((x as u32).wrapping_mul(HASH_X), (y as u32).wrapping_mul(HASH_Y));
    last_mixed(first_mixed(x ^ y ^ (z as u32).wrapping_mul(HASH_Z) ^ seed))
}

/// The finaliser's first step. That of a sum without carries is the sum of the terms' steps.
#[inline(always)]
const fn first_mixed(h: u32) -> u32 {
    h ^ (h >> 16)
}

/// The rest of the finaliser.
#[inline(always)]
const fn last_mixed(mut h: u32) -> u32 {
    h = h.wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

#[inline(always)]
fn smoothstep(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Added to a number below 2^22 either way, it leaves no room for fractions: 1.5 times 2^23.
const NO_FRACTIONS: f32 = 12_582_912.0;

/// Largest integer not above `x`, for |x| < 2^22: beyond, numbers have no fraction left that noise could be made of.
#[must_use]
#[inline(always)]
pub fn floor(x: f32) -> i32 {
    cell(x).0
}

/// [`floor`], and how far above it the number lies: from 0 to 1.
///
/// By a sum that has no room for fractions. A cast, with its rules for what does not fit, is made one lane after the other.
#[must_use]
#[inline(always)]
pub fn cell(x: f32) -> (i32, f32) {
    let nearest = x + NO_FRACTIONS;
    // Exact, as is the difference to any integer near by.
    let past = x - (nearest - NO_FRACTIONS);
    let is_below = past < 0.0;
    let nearest = nearest.to_bits().wrapping_sub(NO_FRACTIONS.to_bits()) as i32;
    (nearest - i32::from(is_below), past + if is_below { 1.0 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fraction(x: f32) -> f32 {
        x - floor(x) as f32
    }

    fn lattice_value(x: i32, y: i32, z: i32, seed: u32) -> f32 {
        HASH_UNIT * value_of(lattice_hash(x, y, z, seed))
    }

    #[test]
    fn floor_is_the_largest_integer_not_above() {
        let most = 4_194_303.8_f32;
        for x in
            [0.0, -0.0, 0.5, -0.5, 1.0, -1.0, 2.5, -2.5, 0.999_999_9, -1e-30, 1e-30, most, -most, 77.499_99]
        {
            assert_eq!(floor(x), f64::from(x).floor() as i32, "{x}");
            assert_eq!(cell(x), (floor(x), fraction(x)), "{x}");
        }
        for i in -100_000..100_000 {
            let x = i as f32 * 0.377;
            assert_eq!(floor(x), f64::from(x).floor() as i32, "{x}");
            assert_eq!(cell(x), (floor(x), fraction(x)), "{x}");
        }
    }

    #[test]
    fn many_places_have_the_bits_of_one_at_a_time() {
        let fbm = Fbm { octaves: 4, frequency: 1.37, lacunarity: 2.05, seed: 77 };
        // A length that no width of vectors divides.
        let coordinate = |k: f32| (0..101).map(|i| k * (i as f32 - 50.3)).collect::<Vec<f32>>();
        let [x, y, z] = [0.731, -1.93, 0.117].map(coordinate);
        let mut sums = vec![f32::NAN; x.len()];
        fbm.at_many_3d([&x, &y, &z], &mut sums);
        for i in 0..x.len() {
            assert_eq!(sums[i].to_bits(), fbm.at_3d([x[i], y[i], z[i]]).to_bits());
        }
        // Within a row of the lattice, to the next one, past some, back.
        let mut lines = fbm.lines(&x);
        for y in [-7.7, -7.69, -7.4, -6.9, 3.3, 3.31, -2.0] {
            lines.set(y, &mut sums);
            for i in 0..x.len() {
                assert_eq!(sums[i].to_bits(), fbm.at_2d([x[i], y]).to_bits());
            }
        }
    }

    /// Computed by hand-written Python integers from the definition in the docs, not by this code.
    #[test]
    fn lattice_hash_has_its_known_values() {
        for (x, y, z, seed, expected) in KNOWN_HASHES {
            assert_eq!(lattice_hash(x, y, z, seed), expected, "({x}, {y}, {z}) seed {seed}");
        }
    }
    const KNOWN_HASHES: [(i32, i32, i32, u32, u32); 4] = [
        (0, 0, 0, 0, 0x00000000),
        (1, 2, 3, 42, 0x70b24687),
        (-5, 7, -11, 1, 0xe55ecafb),
        (1000, -2000, 3000, 0xdeadbeef, 0xc4f60271),
    ];

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

    #[test]
    fn gradient_noise_has_the_stated_deviation_and_differences() {
        let at = |x: f32, y: f32| gradient_noise_2d([floor(x), floor(y)], [fraction(x), fraction(y)], 5);
        let places: Vec<(f32, f32)> =
            (0..200).flat_map(|i| (0..200).map(move |j| (i as f32 * 1.37, j as f32 * 1.73))).collect();
        let rms = |values: Vec<f64>| {
            (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
        };
        let deviation = rms(places.iter().map(|&(x, y)| f64::from(at(x, y))).collect());
        assert!((deviation - f64::from(GRADIENT_NOISE_SIGMA)).abs() < 0.004, "{deviation}");
        for distance in [0.05_f32, 0.2, 0.5, 1.0, 3.0] {
            let found = rms(places
                .iter()
                .map(|&(x, y)| f64::from(at(x + 0.6 * distance, y + 0.8 * distance) - at(x, y)))
                .collect());
            let stated = gradient_noise_difference(f64::from(distance));
            assert!((found / stated - 1.0).abs() < 0.1, "{distance}: {found} and {stated}");
        }
    }

    #[test]
    fn slope_of_gradient_noise_is_its_rise() {
        let step = 5e-3_f32;
        for i in 0..400 {
            let (x, y) = (0.173 * i as f32 - 31.0, 0.059 * i as f32 - 7.0);
            let ((column, u), (row, v)) = (cell(x), cell(y));
            // Not across a border.
            let t = [u.clamp(step, 1.0 - step), v.clamp(step, 1.0 - step)];
            let slope = gradient_noise_slope_2d([column, row], t, 5);
            let at = |u, v| gradient_noise_2d([column, row], [u, v], 5);
            let along = (at(t[0] + step, t[1]) - at(t[0] - step, t[1])) / (2.0 * step);
            let across = (at(t[0], t[1] + step) - at(t[0], t[1] - step)) / (2.0 * step);
            assert!(
                (slope[0] - along).abs() < 1e-3 && (slope[1] - across).abs() < 1e-3,
                "({x}, {y}): {slope:?}, {along} {across} at {t:?}"
            );
        }
    }

    #[test]
    fn floor_and_fraction_hold_for_negative_numbers() {
        assert_eq!((floor(-0.25), floor(-1.0), floor(1.75)), (-1, -1, 1));
        assert!((fraction(-0.25) - 0.75).abs() < 1e-7);
    }
}
