//! Value noise on an integer lattice and its fractal sums: the same bits on every machine.
//!
//! Only additions, multiplications and integer hashing, in a fixed order; no function whose result may differ
//! between processors.
//! Must not know: what the noise is for.

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
    pub fn at_2d(&self, p: [f32; 2]) -> f32 {
        self.sum(|frequency, seed| value_noise_2d([p[0] * frequency, p[1] * frequency], seed))
    }

    /// The sum at a point of space, in [-1, 1].
    #[must_use]
    pub fn at_3d(&self, p: [f32; 3]) -> f32 {
        self.sum(|frequency, seed| {
            value_noise_3d([p[0] * frequency, p[1] * frequency, p[2] * frequency], seed)
        })
    }

    #[inline]
    fn sum(&self, noise: impl Fn(f32, u32) -> f32) -> f32 {
        let (mut sum, mut total, mut gain, mut frequency) = (0.0, 0.0, 1.0, self.frequency);
        for octave in 0..self.octaves {
            let seed = self.seed.wrapping_add(octave.wrapping_mul(0x9e37_79b9));
            sum += gain * noise(frequency, seed);
            total += gain;
            gain *= GAIN;
            frequency *= self.lacunarity;
        }
        2.0 * (sum / total) - 1.0
    }
}

/// 2-D value noise in [0, 1): lattice values blended bilinearly with cubic smoothstep weights.
#[must_use]
pub fn value_noise_2d(p: [f32; 2], seed: u32) -> f32 {
    let ([x, y], [u, v]) = (p.map(floor), p.map(fraction).map(smoothstep));
    let corner = |dx, dy| lattice_value(x.wrapping_add(dx), y.wrapping_add(dy), 0, seed);
    lerp(lerp(corner(0, 0), corner(1, 0), u), lerp(corner(0, 1), corner(1, 1), u), v)
}

/// 3-D value noise in [0, 1): lattice values blended trilinearly with cubic smoothstep weights.
#[must_use]
pub fn value_noise_3d(p: [f32; 3], seed: u32) -> f32 {
    let ([x, y, z], [u, v, w]) = (p.map(floor), p.map(fraction).map(smoothstep));
    let corner = |dx, dy, dz| lattice_value(x.wrapping_add(dx), y.wrapping_add(dy), z.wrapping_add(dz), seed);
    let plane = |dz| {
        lerp(lerp(corner(0, 0, dz), corner(1, 0, dz), u), lerp(corner(0, 1, dz), corner(1, 1, dz), u), v)
    };
    lerp(plane(0), plane(1), w)
}

/// Gradient noise of a place in a cell of the plane's lattice (`t` in [0, 1) along both axes), after Perlin 2002,
/// "Improving Noise": gradients at the corners, each component uniform in [-1, 1), blended with quintic weights. The
/// corners have values too, uniform in [-0.5, 0.5), or every one of them would be on the same level and the lattice would
/// show. Mean 0, deviation [`GRADIENT_NOISE_SIGMA`].
#[must_use]
pub fn gradient_noise_2d(cell: [i32; 2], t: [f32; 2], seed: u32) -> f32 {
    let [u, v] = t.map(|t| t * t * t * (t * (6.0 * t - 15.0) + 10.0));
    let corner = |dx: i32, dy: i32| {
        let hash = lattice_hash(cell[0].wrapping_add(dx), cell[1].wrapping_add(dy), 0, seed);
        let gradient = [hash & 0xffff, hash >> 16].map(|bits| bits as f32 * (1.0 / 32_768.0) - 1.0);
        let value = (hash.wrapping_mul(0x9e37_79b1) >> 16) as f32 * (1.0 / 65_536.0) - 0.5;
        value + gradient[0] * (t[0] - dx as f32) + gradient[1] * (t[1] - dy as f32)
    };
    lerp(lerp(corner(0, 0), corner(1, 0), u), lerp(corner(0, 1), corner(1, 1), u), v)
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

/// Value of a lattice point, uniform in [0, 1) with 24 bits.
fn lattice_value(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    (lattice_hash(x, y, z, seed) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Hash of a lattice point: a linear form in the coordinates (odd constants, from Teschner et al. 2003,
/// "Optimized Spatial Hashing", made odd 32-bit), then the 32-bit finaliser "lowbias32" of Chris Wellons
/// (2018, hash-prospector).
#[must_use]
pub const fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f)
        ^ seed;
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

fn smoothstep(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Largest integer not above `x`, for |x| < 2^31.
#[must_use]
pub fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(truncated as f32 > x)
}

fn fraction(x: f32) -> f32 {
    x - floor(x) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn floor_and_fraction_hold_for_negative_numbers() {
        assert_eq!((floor(-0.25), floor(-1.0), floor(1.75)), (-1, -1, 1));
        assert!((fraction(-0.25) - 0.75).abs() < 1e-7);
    }
}
