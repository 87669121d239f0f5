//! Functions of eight numbers at once, with the same bits on every machine: those of the C library take one number at a time.
//! Must not know: what is computed.

use std::f32::consts::{FRAC_PI_2, LOG2_E};

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};

use crate::rounding::ROUND_TO_INTEGER;

/// Numbers of a vector.
pub(crate) const LANES: usize = 8;

/// Coefficients of arctan(x) / x by powers of the square of x, for |x| <= 1: Abramowitz and Stegun 1964, 4.4.49.
const ARCTANGENT: [f32; 9] = [
    1.0,
    -0.333_331_45,
    0.199_935_51,
    -0.142_089,
    0.106_562_64,
    -0.075_289_64,
    0.042_909_614,
    -0.016_165_737,
    0.002_866_225_7,
];
/// Coefficients of the exponential function by powers: its Taylor series.
const EXPONENTIAL: [f32; 7] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0];
/// The natural logarithm of 2 in two parts: multiples of the first below 2^8 are exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
/// Bounds of exponents whose powers are neither zero nor infinite.
const EXPONENTS: [f32; 2] = [-87.0, 88.0];

/// Numbers, one of each lane.
#[inline(always)]
pub(crate) fn load<S: Simd>(simd: S, values: &[f32; LANES]) -> f32x8<S> {
    f32x8::from_slice(simd, values)
}

/// The same number in all lanes.
#[inline(always)]
pub(crate) fn splat<S: Simd>(simd: S, value: f32) -> f32x8<S> {
    f32x8::splat(simd, value)
}

/// The numbers of all lanes.
#[inline(always)]
pub(crate) fn store<S: Simd>(values: f32x8<S>) -> [f32; LANES] {
    let mut stored = [0.0; LANES];
    values.store_slice(&mut stored);
    stored
}

/// A polynomial by its coefficients, from that of the zeroth power on.
#[inline(always)]
fn polynomial<S: Simd, const COUNT: usize>(simd: S, x: f32x8<S>, coefficients: &[f32; COUNT]) -> f32x8<S> {
    let mut sum = splat(simd, coefficients[COUNT - 1]);
    for coefficient in coefficients.iter().rev().skip(1) {
        sum = sum * x + *coefficient;
    }
    sum
}

/// The exponential function, to 2e-7 of its value; of exponents beyond -87 and 88 that of these.
#[inline(always)]
#[must_use]
pub(crate) fn exp<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let x = x.max(EXPONENTS[0]).min(EXPONENTS[1]);
    let shifted = x * LOG2_E + ROUND_TO_INTEGER;
    let power = shifted - ROUND_TO_INTEGER;
    let rest = x - power * LN_2[0] - power * LN_2[1];
    let bias = u32x8::splat(simd, 127_u32.wrapping_sub(ROUND_TO_INTEGER.to_bits()));
    let power_of_two = f32x8::from_bits((shifted.to_bits() + bias) << 23);
    polynomial(simd, rest, &EXPONENTIAL) * power_of_two
}

/// The arctangent, radians, to 2e-7.
#[inline(always)]
#[must_use]
pub(crate) fn arctangent<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let size = x.abs();
    let is_steep = size.simd_gt(1.0);
    let reduced = is_steep.select(splat(simd, 1.0) / size.max(1e-30), size);
    let of_reduced = reduced * polynomial(simd, reduced * reduced, &ARCTANGENT);
    is_steep.select(splat(simd, FRAC_PI_2) - of_reduced, of_reduced).copysign(x)
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    fn many() -> impl Iterator<Item = [f32; LANES]> {
        (-4_000..4_000).map(|step| std::array::from_fn(|lane| 0.02 * (step as f32 + 0.125 * lane as f32)))
    }

    #[test]
    fn exp_is_that_of_the_c_library() {
        for x in many() {
            let found = dispatch!(Level::new(), simd => store(exp(simd, load(simd, &x))));
            for (x, found) in x.into_iter().zip(found) {
                let expected = libm::expf(x);
                assert!((found - expected).abs() <= 3e-7 * expected, "{x}: {found}, not {expected}");
            }
        }
        let ends = dispatch!(Level::new(), simd => store(exp(simd, load(simd, &[-1e9, 1e9, -88.0, 89.0, 0.0, -0.0, f32::MIN, f32::MAX]))));
        assert!(ends.iter().all(|end| end.is_finite() && *end > 0.0), "{ends:?}");
        assert_eq!(ends[4..6], [1.0; 2]);
    }

    #[test]
    fn arctangent_is_that_of_the_c_library() {
        for x in many() {
            for scale in [1.0, 0.01, 1e6] {
                let x = x.map(|x| scale * x);
                let found = dispatch!(Level::new(), simd => store(arctangent(simd, load(simd, &x))));
                for (x, found) in x.into_iter().zip(found) {
                    let expected = libm::atanf(x);
                    assert!((found - expected).abs() < 3e-7, "{x}: {found}, not {expected}");
                }
            }
        }
    }

    /// The same bits with the narrowest vectors and the widest.
    #[test]
    fn bits_do_not_depend_on_the_width_of_vectors() {
        for x in many().step_by(7) {
            let widest = dispatch!(Level::new(), simd => {
                let x = load(simd, &x);
                [store(exp(simd, x)), store(arctangent(simd, x))]
            });
            let narrowest = dispatch!(Level::baseline(), simd => {
                let x = load(simd, &x);
                [store(exp(simd, x)), store(arctangent(simd, x))]
            });
            assert_eq!(
                widest.map(|values| values.map(f32::to_bits)),
                narrowest.map(|values| values.map(f32::to_bits))
            );
        }
    }
}
