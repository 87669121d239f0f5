//! Random numbers of the pixels, each a hash of pixel, purpose and seed, computed in blocks that vectorise.
//! Must not know: what they are for.

use crate::rounding::floor_and_fraction;
use crate::scene::noise::lattice_hash;

/// Numbers that are computed at a time.
pub(super) const BLOCK: usize = 64;
/// Mean number of electrons from which on Poisson's distribution is approximated by a normal one, corrected for its skewness.
const MIN_NORMAL_MEAN: f32 = 10.0;

/// Largest number of which the cumulative distribution is inverted, below what its sums reach in spite of rounding: a number above
/// would count as many electrons as there are steps.
const MAX_UNIFORM: f32 = 1.0 - 5e-6;

/// What each random number of a pixel is for: pairs of normal ones take two purposes.
pub(super) mod purpose {
    pub(in super::super) const FIXED_PATTERN: i32 = 0;
    pub(in super::super) const READOUT: i32 = 2;
    pub(in super::super) const FEW_PHOTONS: i32 = 4;
    pub(in super::super) const GRAIN: i32 = 5;
}

/// Numbers of a block of pixels.
pub(super) type Block = [f32; BLOCK];

/// Uniform numbers in (0, 1) for the pixels of a row from column `x` on.
#[inline(always)]
pub(super) fn uniform(x: usize, y: usize, purpose: i32, seed: u32) -> Block {
    let mut numbers = [0.0; BLOCK];
    for (lane, number) in numbers.iter_mut().enumerate() {
        let hash = lattice_hash((x + lane) as i32, y as i32, purpose, seed);
        *number = ((hash >> 9) as i32 as f32 + 0.5) * (1.0 / 8_388_608.0);
    }
    numbers
}

/// Two independent standard normal numbers for each of these pixels (Box and Muller 1958).
#[inline(always)]
pub(super) fn normal_pairs(x: usize, y: usize, purpose: i32, seed: u32) -> [Block; 2] {
    let (mut first, mut second) = (uniform(x, y, purpose, seed), uniform(x, y, purpose + 1, seed));
    for (u, v) in first.iter_mut().zip(&mut second) {
        let radius = (-2.0 * ln(*u)).sqrt();
        let [cos, sin] = direction(*v);
        (*u, *v) = (radius * cos, radius * sin);
    }
    [first, second]
}

/// Natural logarithm of a number in (0, 1), to 2e-7 of it or of 1 (the polynomial of Cephes' `logf`).
#[inline(always)]
fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let mantissa = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    let is_large = mantissa > std::f32::consts::SQRT_2;
    let exponent = (bits >> 23) as i32 - 127 + i32::from(is_large);
    let f = if is_large { 0.5 * mantissa } else { mantissa } - 1.0;
    let mut sum = 7.037_683_6e-2;
    for factor in [
        -0.115_146_1,
        0.116_769_99,
        -0.124_201_41,
        0.142_493_23,
        -0.166_680_58,
        0.200_007_15,
        -0.249_999_94,
        0.333_333_3,
    ] {
        sum = sum * f + factor;
    }
    let square = f * f;
    f + (sum * f * square - 0.5 * square) + exponent as f32 * std::f32::consts::LN_2
}

/// Cosine and sine of this part of a turn less an eighth, to 4e-7: of any direction if the part is uniform in (0, 1).
#[inline(always)]
fn direction(part: f32) -> [f32; 2] {
    let (quarter, fraction) = floor_and_fraction(4.0 * part);
    let angle = (fraction - 0.5) * std::f32::consts::FRAC_PI_2;
    let square = angle * angle;
    let sin = angle * (1.0 + square * (-1.0 / 6.0 + square * (1.0 / 120.0 - square / 5040.0)));
    let cos = 1.0 + square * (-0.5 + square * (1.0 / 24.0 + square * (-1.0 / 720.0 + square / 40_320.0)));
    let (x, y) = if quarter & 1 == 0 { (cos, sin) } else { (-sin, cos) };
    if quarter & 2 == 0 { [x, y] } else { [-x, -y] }
}

/// Numbers with Poisson's distribution of these means; `normal` are standard normal numbers. Small means by inversion of the
/// cumulative distribution, large ones by the expansion of Cornish and Fisher (1938) up to the skewness.
#[inline(always)]
pub(super) fn poisson(means: &Block, normal: &Block, x: usize, y: usize, seed: u32) -> Block {
    let mut numbers = [0.0; BLOCK];
    let mut largest_small = -1.0_f32;
    for ((number, mean), z) in numbers.iter_mut().zip(means).zip(normal) {
        *number = mean + mean.sqrt() * z + (z * z - 1.0) * (1.0 / 6.0);
        largest_small = largest_small.max(if *mean < MIN_NORMAL_MEAN { *mean } else { -1.0 });
    }
    if largest_small < 0.0 {
        return numbers;
    }
    let uniform = uniform(x, y, purpose::FEW_PHOTONS, seed).map(|number| number.min(MAX_UNIFORM));
    let (mut probabilities, mut counts) = ([0.0_f32; BLOCK], [0.0_f32; BLOCK]);
    for (probability, mean) in probabilities.iter_mut().zip(means) {
        *probability = exp_of_negative(mean.min(MIN_NORMAL_MEAN));
    }
    let mut sums = probabilities;
    // Beyond there are fewer than one in 10^8.
    let steps = (largest_small + 7.0 * largest_small.sqrt() + 8.0) as u32;
    for step in 1..=steps {
        let per_step = 1.0 / step as f32;
        for lane in 0..BLOCK {
            counts[lane] += if uniform[lane] > sums[lane] { 1.0 } else { 0.0 };
            probabilities[lane] *= means[lane] * per_step;
            sums[lane] += probabilities[lane];
        }
    }
    for lane in 0..BLOCK {
        if means[lane] < MIN_NORMAL_MEAN {
            numbers[lane] = counts[lane];
        }
    }
    numbers
}

/// exp(-x) for x from 0 to 10, to 3e-6 of it.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
    let t = -x * (1.0 / 32.0);
    let mut value = 1.0
        + t * (1.0
            + t * (0.5
                + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0 + t / 5040.0))))));
    for _ in 0..5 {
        value *= value;
    }
    value
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::*;

    #[test]
    fn functions_are_those_of_libm() {
        for i in 1..4000 {
            let x = i as f32 / 4000.0;
            assert!((ln(x) - libm::logf(x)).abs() < 1e-6, "ln {x}");
            let [cos, sin] = direction(x);
            let angle = std::f32::consts::TAU * (x - 0.125);
            assert!((cos - libm::cosf(angle)).abs() < 2e-6 && (sin - libm::sinf(angle)).abs() < 2e-6, "{x}");
            let expected = libm::expf(-10.0 * x);
            assert!((exp_of_negative(10.0 * x) / expected - 1.0).abs() < 3e-6, "exp {x}");
        }
    }

    fn moments(values: &[f32]) -> [f64; 3] {
        let n = values.len() as f64;
        let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / n;
        let central =
            |power| values.iter().map(|value| (f64::from(*value) - mean).powi(power)).sum::<f64>() / n;
        [mean, central(2), central(3)]
    }

    #[test]
    fn normal_numbers_are_normal_and_independent() {
        let pairs: Vec<[Block; 2]> = (0..2000).map(|y| normal_pairs(0, y, 0, 7)).collect();
        let of = |index: usize| pairs.iter().flat_map(|pair| pair[index]).collect::<Vec<f32>>();
        let [first, second] = [of(0), of(1)];
        for values in [&first, &second] {
            let [mean, variance, third] = moments(values);
            assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02 && third.abs() < 0.05);
            let beyond = values.iter().filter(|value| value.abs() > 2.0).count() as f64 / values.len() as f64;
            assert!((beyond - 0.0455).abs() < 0.004, "{beyond} beyond two standard deviations");
        }
        let product: f64 = first.iter().zip(&second).map(|(a, b)| f64::from(a * b)).sum();
        assert!((product / first.len() as f64).abs() < 0.01);
        let next: f64 = first.windows(2).map(|pair| f64::from(pair[0] * pair[1])).sum();
        assert!((next / first.len() as f64).abs() < 0.01, "neighbours");
    }

    #[test]
    fn few_electrons_have_the_moments_of_poisson() {
        for mean in [0.5, 3.0, 9.9, 10.1, 20.0, 39.0] {
            let row = |y| poisson(&[mean; BLOCK], &normal_pairs(0, y, purpose::READOUT, 4)[0], 0, y, 4);
            let counts: Vec<f32> = (0..2000).flat_map(row).collect();
            let [found, variance, third] = moments(&counts);
            let mean = f64::from(mean);
            assert!((found / mean - 1.0).abs() < 0.02, "{mean}: mean {found}");
            assert!((variance / mean - 1.0).abs() < 0.04, "{mean}: variance {variance}");
            assert!((third / mean - 1.0).abs() < 0.35, "{mean}: third moment {third}");
        }
    }

    /// Of a million numbers with a mean below 10 one in three sets has one above 27, and one in 10^5 sets one above 33.
    #[test]
    fn no_pixel_has_many_electrons_more_than_the_others() {
        for mean in [3.0, 8.0, 9.0, 9.9, 9.99] {
            let row = |y| poisson(&[mean; BLOCK], &normal_pairs(0, y, purpose::READOUT, 4)[0], 0, y, 4);
            let most = (0..15_625).flat_map(row).fold(0.0, f32::max);
            assert!(most < mean + 7.4 * mean.sqrt(), "{most} electrons of {mean}");
        }
    }
}
