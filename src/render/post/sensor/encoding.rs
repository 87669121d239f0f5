//! The sRGB transfer function.
//! Must not know: what is encoded.

use std::sync::OnceLock;

use fearless_simd::{Level, dispatch};

use crate::pool;

/// Steps of the table that finds an sRGB code from above: a power of two, so that scaling by it is exact.
const TABLE_STEPS: usize = 4096;

/// Readings that are encoded at once: their memory stays in the nearest cache.
const AT_ONCE: usize = 1024;

/// The 8-bit sRGB code of each linear value, found in a table.
pub(super) struct SrgbCodes {
    /// Code of each multiple of a step.
    codes: [u8; TABLE_STEPS + 1],
    /// Smallest linear value of the code after each of them.
    next: [f32; TABLE_STEPS + 1],
}

impl SrgbCodes {
    /// The table, made once.
    pub(super) fn shared() -> &'static Self {
        static SHARED: OnceLock<SrgbCodes> = OnceLock::new();
        pool::made_once(&SHARED, Self::new)
    }

    fn new() -> Self {
        let thresholds = thresholds();
        let codes: [u8; TABLE_STEPS + 1] =
            std::array::from_fn(|step| srgb_code(step as f32 / TABLE_STEPS as f32));
        Self { codes, next: codes.map(|code| thresholds[usize::from(code) + 1]) }
    }

    /// The code of a linear value in 0 to 1.
    #[inline]
    fn code(&self, linear: f32) -> u8 {
        let step = ((linear * TABLE_STEPS as f32) as usize).min(TABLE_STEPS);
        // A step of the table is less than one of the codes, of which there are 12.92 * 255 to 1 at most.
        self.codes[step] + u8::from(self.next[step] <= linear)
    }

    /// Replaces readings, 1 for the full well, by their codes, 0 to 255, where `black` is the reading of no light.
    pub(super) fn encode(&self, readings: &mut [f32], black: f32) {
        let white = 1.0 - black;
        for readings in readings.chunks_mut(AT_ONCE) {
            // In vectors what can be done in them; the table is looked up one by one.
            dispatch!(Level::new(), _simd => set_linear(readings, black, white));
            for value in readings {
                *value = f32::from(self.code(*value));
            }
        }
    }
}

/// Replaces readings by the linear values that they stand for, clamped to 0 to 1.
#[inline(always)]
fn set_linear(readings: &mut [f32], black: f32, white: f32) {
    for value in readings {
        *value = ((*value - black) / white).clamp(0.0, 1.0);
    }
}

/// The reading, 1 for the full well, that an encoded value, 0 to 1, stands for, where `black` is the reading of no light.
pub(super) fn reading_of(encoded: f32, black: f32) -> f32 {
    black + (1.0 - black) * linear_from_srgb(encoded)
}

/// Smallest linear value of each 8-bit sRGB code, then infinity.
fn thresholds() -> [f32; 257] {
    let mut thresholds = [f32::INFINITY; 257];
    for (code, threshold) in thresholds.iter_mut().enumerate().take(256) {
        // By bisection over the bits of the numbers from 0 to 1, which are in the order of their values.
        let (mut low, mut high) = (0_u32, 1.0_f32.to_bits());
        while low < high {
            let middle = low + (high - low) / 2;
            if usize::from(srgb_code(f32::from_bits(middle))) < code {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        *threshold = f32::from_bits(low);
    }
    thresholds
}

/// The nearest 8-bit sRGB code of a linear value.
fn srgb_code(linear: f32) -> u8 {
    (255.0 * srgb_from_linear(linear) + 0.5) as u8
}

/// The sRGB transfer function (IEC 61966-2-1), linear to encoded, clamped to 0 to 1.
pub(super) fn srgb_from_linear(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::powf(x, 1.0 / 2.4) - 0.055 }
}

/// The inverse of the sRGB transfer function, encoded to linear.
fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { libm::powf((x + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_the_codes_of_the_transfer_function() {
        let codes = SrgbCodes::shared();
        let steps = (0..=1_000_003).map(|i| i as f32 / 1_000_003.0);
        let around = |threshold: &f32| {
            let bits = threshold.to_bits();
            (bits.saturating_sub(300)..bits + 300).map(f32::from_bits)
        };
        let thresholds = thresholds();
        let near = thresholds[..256].iter().flat_map(around);
        for linear in steps.chain(near).chain([-0.5, 1.5]) {
            let mut found = [linear];
            codes.encode(&mut found, 0.0);
            assert_eq!(found, [f32::from(srgb_code(linear))], "{linear}");
        }
    }
}
