//! The point spread function of the optics.
//! Must not know: the sensor.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

/// Frequencies at which the inverse Fourier integral of [`psf_kernel`] is summed, up to Nyquist's.
const FREQUENCIES: u32 = 64;

/// One half of the symmetric, separable kernel of the point spread function, the middle weight first; the weights sum to 1.
///
/// It is designed in the frequency domain: with the [`aperture`] of the pixel the modulation transfer function is that of a Gaussian
/// of this standard deviation, exp(-2 (pi sigma f)^2), up to Nyquist's frequency. A Gaussian sampled at the pixels would pass twice as
/// much there. Side lobes stay below 2 %. A pixel of 2 x 2 samples has a standard deviation of 0.25 by itself: up to there the kernel is
/// a single 1.
fn psf_kernel(sigma_px: f64, samples_per_side: u32) -> Vec<f32> {
    let reach = (3.0 * sigma_px).ceil() as u32 + 2;
    let pi = std::f64::consts::PI;
    let transfer = |f: f64| {
        let phase = pi * sigma_px * f;
        (libm::exp(-2.0 * phase * phase) / aperture(samples_per_side, f)).min(1.0)
    };
    let weight = |offset: u32| {
        let frequency = |step: u32| (f64::from(step) + 0.5) / f64::from(2 * FREQUENCIES);
        let wave =
            |step| transfer(frequency(step)) * libm::cos(2.0 * pi * f64::from(offset) * frequency(step));
        (0..FREQUENCIES).map(wave).sum::<f64>()
    };
    let weights: Vec<f64> = (0..=reach).map(weight).collect();
    let sum = 2.0 * weights.iter().sum::<f64>() - weights[0];
    weights.into_iter().map(|weight| (weight / sum) as f32).collect()
}

/// Transfer at f cycles a pixel, above 0, of a pixel that is the mean of this many evenly spaced samples along its side.
fn aperture(samples_per_side: u32, f: f64) -> f64 {
    let (n, phase) = (f64::from(samples_per_side), std::f64::consts::PI * f);
    libm::sin(phase) / (n * libm::sin(phase / n))
}

/// Variance of the aperture of such a pixel, px^2.
pub(in crate::render::post) fn aperture_variance(samples_per_side: u32) -> f64 {
    let n = f64::from(samples_per_side);
    (1.0 - 1.0 / (n * n)) / 12.0
}

/// All taps of the point spread function of pixels with this many samples along a side, see [`psf_kernel`].
pub(super) fn psf_taps(sigma_px: f64, samples_per_side: u32) -> Vec<f32> {
    symmetric(&psf_kernel(sigma_px, samples_per_side))
}

/// All taps of a Gaussian of this standard deviation, pixels.
pub(super) fn gaussian_taps(sigma_px: f64) -> Vec<f32> {
    let reach = (3.0 * sigma_px).ceil() as u32;
    let weight = |offset: u32| libm::exp(-0.5 * f64::from(offset * offset) / (sigma_px * sigma_px));
    let weights: Vec<f64> = (0..=reach).map(weight).collect();
    let sum = 2.0 * weights.iter().sum::<f64>() - weights[0];
    symmetric(&weights.iter().map(|weight| (weight / sum) as f32).collect::<Vec<f32>>())
}

/// Standard deviation, pixels, up to which three taps stand for a Gaussian: a sampled one has too small a variance.
const MAX_THREE_TAPS_PX: f64 = 0.8;

/// An image blurred by a Gaussian of this standard deviation, pixels, without the pixels' aperture.
pub(in crate::render::post) fn gaussian_blur(
    values: &[f32],
    [width, height]: [usize; 2],
    sigma_px: f64,
) -> Vec<f32> {
    let side = (0.5 * sigma_px * sigma_px) as f32;
    let taps = if sigma_px <= MAX_THREE_TAPS_PX {
        vec![side, 1.0 - 2.0 * side, side]
    } else {
        gaussian_taps(sigma_px)
    };
    convolve(values, width, height, &taps)
}

fn symmetric(half: &[f32]) -> Vec<f32> {
    half[1..].iter().rev().chain(half).copied().collect()
}

/// A row convolved with taps, with the border repeated; `padded` is scratch memory.
pub(super) fn convolve_row(taps: &[f32], row: &[f32], padded: &mut Vec<f32>, target: &mut [f32]) {
    let (reach, width) = (taps.len() / 2, row.len());
    padded.clear();
    padded.resize(reach, row[0]);
    padded.extend(row);
    padded.resize(width + 2 * reach, row[width - 1]);
    let shifted = |tap: usize| &padded[tap..tap + width];
    dispatch!(Level::new(), _simd => weighted_sum(taps, shifted, target));
}

/// A channel convolved with the same taps along rows, then columns, with the border repeated.
pub(super) fn convolve(channel: &[f32], width: usize, height: usize, taps: &[f32]) -> Vec<f32> {
    let reach = taps.len() / 2;
    let mut rows = vec![0.0; channel.len()];
    let of_rows = rows.par_chunks_exact_mut(width).zip(channel.par_chunks_exact(width));
    of_rows.for_each_init(Vec::new, |padded, (row, channel)| convolve_row(taps, channel, padded, row));
    let mut columns = vec![0.0; channel.len()];
    columns.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        let shifted = |tap: usize| &rows[(y + tap).saturating_sub(reach).min(height - 1) * width..][..width];
        dispatch!(Level::new(), _simd => weighted_sum(taps, shifted, row));
    });
    columns
}

/// The sum of lists of values, each times its tap, in the order of the taps.
// Inlined into `dispatch!`, so that it is compiled for each SIMD level.
#[inline(always)]
pub(super) fn weighted_sum<'a>(taps: &[f32], values: impl Fn(usize) -> &'a [f32], sums: &mut [f32]) {
    sums.fill(-0.0);
    for (index, tap) in taps.iter().enumerate() {
        for (sum, value) in sums.iter_mut().zip(values(index)) {
            *sum += tap * value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_by_rows_have_the_bits_of_sums_by_pixels() {
        let (width, height, sigma_px) = (19, 6, 0.7);
        let channel: Vec<f32> = (0..width * height).map(|i| 0.5 + libm::sinf(i as f32 * 2.3)).collect();
        let weights = psf_kernel(sigma_px, 2);
        let reach = weights.len() as isize - 1;
        let clamped =
            |at: usize, offset: isize, end: usize| (at as isize + offset).clamp(0, end as isize - 1) as usize;
        let sum = |tap: &dyn Fn(isize) -> f32| -> f32 {
            (-reach..=reach).map(|i| weights[i.unsigned_abs()] * tap(i)).sum()
        };
        let of_pixels = |of_pixel: &dyn Fn(usize, usize) -> f32| -> Vec<f32> {
            (0..width * height).map(|pixel| of_pixel(pixel % width, pixel / width)).collect()
        };
        let rows = of_pixels(&|x, y| sum(&|i| channel[y * width + clamped(x, i, width)]));
        let expected = of_pixels(&|x, y| sum(&|i| rows[clamped(y, i, height) * width + x]));
        assert_eq!(convolve(&channel, width, height, &psf_taps(sigma_px, 2)), expected);
    }
}
