//! Integer parts of floats, in a form that vectorises.
//!
//! Must not know: any other module of this crate.

/// 1.5 * 2^23: adding it to a number of magnitude below 2^22 rounds that to an integer, in the low bits of the mantissa.
pub(crate) const ROUND_TO_INTEGER: f32 = 12_582_912.0;

/// Largest integer not above `x`, for |x| < 2^22; beyond that an f32 has at most one fraction bit.
#[must_use]
#[inline(always)]
pub fn floor(x: f32) -> i32 {
    floor_and_fraction(x).0
}

/// [`floor`] of `x`, and its fraction, 0 to 1.
///
/// Computed with the rounding of a float addition, as a saturating cast does not vectorise.
#[must_use]
#[inline(always)]
pub fn floor_and_fraction(x: f32) -> (i32, f32) {
    let nearest = x + ROUND_TO_INTEGER;
    // Exact: both numbers are close to each other (Sterbenz).
    let past = x - (nearest - ROUND_TO_INTEGER);
    let is_below = past < 0.0;
    let nearest = nearest.to_bits().wrapping_sub(ROUND_TO_INTEGER.to_bits()) as i32;
    (nearest - i32::from(is_below), past + if is_below { 1.0 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fraction(x: f32) -> f32 {
        x - floor(x) as f32
    }

    #[test]
    fn floor_is_the_largest_integer_not_above() {
        let max = 4_194_303.8_f32;
        for x in
            [0.0, -0.0, 0.5, -0.5, 1.0, -1.0, 2.5, -2.5, 0.999_999_9, -1e-30, 1e-30, max, -max, 77.499_99]
        {
            assert_eq!(floor(x), f64::from(x).floor() as i32, "{x}");
            assert_eq!(floor_and_fraction(x), (floor(x), fraction(x)), "{x}");
        }
        for i in -100_000..100_000 {
            let x = i as f32 * 0.377;
            assert_eq!(floor(x), f64::from(x).floor() as i32, "{x}");
            assert_eq!(floor_and_fraction(x), (floor(x), fraction(x)), "{x}");
        }
    }

    #[test]
    fn floor_and_fraction_hold_for_negative_numbers() {
        assert_eq!((floor(-0.25), floor(-1.0), floor(1.75)), (-1, -1, 1));
        assert!((fraction(-0.25) - 0.75).abs() < 1e-7);
    }
}
