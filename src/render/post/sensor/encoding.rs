//! From the readings of the pixels to 8-bit colours: demosaicing and the sRGB transfer function.
//! Must not know: what a reading is made of.

use std::sync::LazyLock;

/// Steps of the table that finds an sRGB code from above: a power of two, so that scaling by it is exact.
const TABLE_STEPS: usize = 4096;

/// The channel of a pixel's filter in the Bayer mosaic RGGB: 0 red, 1 green, 2 blue.
pub(super) const fn bayer_channel(x: usize, y: usize) -> usize {
    (x % 2) + (y % 2)
}

/// The colours of a row of pixels by bilinear demosaicing: of each its own channel, and the means of the others over the 3 x 3 pixels
/// around.
pub(super) fn demosaic_row(
    readings: &[f32],
    width: usize,
    height: usize,
    y: usize,
    colours: &mut [[f32; 3]],
) {
    let is_inner_row = y > 0 && y + 1 < height;
    let inner = if is_inner_row && width > 2 { 1..width - 1 } else { 0..0 };
    for x in (0..width).filter(|x| !inner.contains(x)) {
        colours[x] = demosaic(readings, width, height, x, y);
    }
    if inner.is_empty() {
        return;
    }
    let [above, row, below] = [y - 1, y, y + 1].map(|y| &readings[y * width..][..width]);
    // Sums in the order of the pixels, from 0, as in `demosaic`.
    for x in inner {
        let (own, beside, across) = (row[x], 0.0 + row[x - 1] + row[x + 1], 0.0 + above[x] + below[x]);
        let cross = 0.0 + above[x] + row[x - 1] + row[x + 1] + below[x];
        let diagonal = 0.0 + above[x - 1] + above[x + 1] + below[x - 1] + below[x + 1];
        colours[x] = match (x % 2, y % 2) {
            (0, 0) => [own, cross / 4.0, diagonal / 4.0],
            (1, 0) => [beside / 2.0, own, across / 2.0],
            (0, _) => [across / 2.0, own, beside / 2.0],
            _ => [diagonal / 4.0, cross / 4.0, own],
        };
    }
}

/// The colour of any pixel, see [`demosaic_row`]; at the border of the image over fewer pixels.
fn demosaic(readings: &[f32], width: usize, height: usize, x: usize, y: usize) -> [f32; 3] {
    let (mut sums, mut counts) = ([0.0_f32; 3], [0.0_f32; 3]);
    let own = bayer_channel(x, y);
    for (dx, dy) in (-1..=1).flat_map(|dy: isize| (-1..=1).map(move |dx: isize| (dx, dy))) {
        let (px, py) = (x as isize + dx, y as isize + dy);
        if px < 0 || py < 0 || px >= width as isize || py >= height as isize {
            continue;
        }
        let (px, py) = (px as usize, py as usize);
        let channel = bayer_channel(px, py);
        if channel != own || (dx, dy) == (0, 0) {
            sums[channel] += readings[py * width + px];
            counts[channel] += 1.0;
        }
    }
    [0, 1, 2].map(|channel| {
        if counts[channel] > 0.0 { sums[channel] / counts[channel] } else { readings[y * width + x] }
    })
}

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
        static SHARED: LazyLock<SrgbCodes> = LazyLock::new(SrgbCodes::new);
        &SHARED
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
        let mut code = self.codes[(linear * TABLE_STEPS as f32) as usize];
        while self.thresholds[usize::from(code) + 1] <= linear {
            code += 1;
        }
        code
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

    #[test]
    fn rows_have_the_colours_of_pixels_to_the_bit() {
        for (width, height) in [(1, 1), (2, 5), (3, 3), (16, 7)] {
            let readings: Vec<f32> = (0..width * height).map(|i| libm::sinf(i as f32 * 1.7)).collect();
            for y in 0..height {
                let mut colours = vec![[f32::NAN; 3]; width];
                demosaic_row(&readings, width, height, y, &mut colours);
                for (x, colour) in colours.iter().enumerate() {
                    assert_eq!(*colour, demosaic(&readings, width, height, x, y), "{x}, {y}");
                }
            }
        }
    }
}
