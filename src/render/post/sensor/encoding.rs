//! The sRGB transfer function.
//! Must not know: what is encoded.

use std::sync::OnceLock;

use crate::pool;

/// Steps of the table that finds an sRGB code from above: a power of two, so that scaling by it is exact.
const TABLE_STEPS: usize = 4096;

/// The 8-bit sRGB code of each linear value, found in a table: the smallest value of each code.
pub(super) struct SrgbCodes {
    /// Smallest linear value of each code, then infinity.
    thresholds: [f32; 257],
    /// Code of each multiple of a step.
    codes: Vec<u8>,
}

impl SrgbCodes {
    /// The table, made once.
    pub(super) fn shared() -> &'static Self {
        static SHARED: OnceLock<SrgbCodes> = OnceLock::new();
        pool::made_once(&SHARED, Self::new)
    }

    fn new() -> Self {
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
        let codes = (0..=TABLE_STEPS).map(|step| srgb_code(step as f32 / TABLE_STEPS as f32)).collect();
        Self { thresholds, codes }
    }

    /// The code of a linear value, clamped to 0 to 1.
    #[inline]
    pub(super) fn code(&self, linear: f32) -> u8 {
        let linear = linear.clamp(0.0, 1.0);
        let code = self.codes[(linear * TABLE_STEPS as f32) as usize];
        // A step of the table is less than one of the codes, of which there are 12.92 * 255 to 1 at most.
        code + u8::from(self.thresholds[usize::from(code) + 1] <= linear)
    }
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
pub(super) fn linear_from_srgb(x: f32) -> f32 {
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
        let near = codes.thresholds[..256].iter().flat_map(around);
        for linear in steps.chain(near).chain([-0.5, 1.5]) {
            assert_eq!(codes.code(linear), srgb_code(linear), "{linear}");
        }
    }
}
