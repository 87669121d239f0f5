//! What the compression of JPEG (ITU-T T.81) loses: colours at half the resolution, and coefficients of the cosine transform that are
//! rounded to multiples of the tables of its annex K, scaled by the quality as libjpeg does. Its entropy coding loses nothing and is left
//! out.
//! Must not know: a sensor.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

const SIDE: usize = 8;
type Block = [f32; SIDE * SIDE];

/// Annex K, tables K.1 and K.2.
const LUMINANCE: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17,
    22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78,
    87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];
const CHROMINANCE: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];

/// The steps of a table at this quality, 1 to 100.
fn steps(table: &[u16; 64], quality: u32) -> Block {
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    table.map(|step| ((u32::from(step) * percent + 50) / 100).clamp(1, 255) as f32)
}

/// The cosine transform of eight values as a matrix.
fn cosines() -> [[f32; SIDE]; SIDE] {
    let value = |k: usize, n: usize| {
        let scale = if k == 0 { 0.125_f64 } else { 0.25 };
        scale.sqrt() * libm::cos(std::f64::consts::PI / 8.0 * (n as f64 + 0.5) * k as f64)
    };
    std::array::from_fn(|k| std::array::from_fn(|n| value(k, n) as f32))
}

/// `left` times `right`.
#[inline(always)]
fn product(left: &Block, right: &Block) -> Block {
    let mut out = [0.0; SIDE * SIDE];
    for (row, out) in left.chunks_exact(SIDE).zip(out.chunks_exact_mut(SIDE)) {
        for (factor, right) in row.iter().zip(right.chunks_exact(SIDE)) {
            for (out, value) in out.iter_mut().zip(right) {
                *out += factor * value;
            }
        }
    }
    out
}

/// Rounds the coefficients of a block.
#[inline(always)]
fn quantise(block: &mut Block, transform: &[Block; 2], steps: &Block) {
    let [forward, back] = transform;
    let mut coefficients = product(&product(forward, block), back);
    for (value, step) in coefficients.iter_mut().zip(steps) {
        *value = crate::rounding::floor(*value / step + 0.5) as f32 * step;
    }
    *block = product(&product(back, &coefficients), forward);
}

/// Compresses a plane of values around 0, whose border is repeated to whole blocks.
fn compress_plane(plane: &mut [f32], [width, height]: [usize; 2], steps: &Block) {
    let matrix = cosines();
    let forward: Block = std::array::from_fn(|at| matrix[at / SIDE][at % SIDE]);
    let back: Block = std::array::from_fn(|at| matrix[at % SIDE][at / SIDE]);
    plane.par_chunks_mut(SIDE * width).for_each(|rows| {
        let last = (rows.len() / width).min(height) - 1;
        for left in (0..width).step_by(SIDE) {
            let source = |at: usize| (at / SIDE).min(last) * width + (left + at % SIDE).min(width - 1);
            let mut block: Block = std::array::from_fn(|at| rows[source(at)]);
            dispatch!(Level::new(), _simd => quantise(&mut block, &[forward, back], steps));
            for row in 0..=last {
                let columns = SIDE.min(width - left);
                rows[row * width + left..][..columns].copy_from_slice(&block[row * SIDE..][..columns]);
            }
        }
    });
}

/// Replaces 8-bit pixels by what is left of them after compression at this quality, 1 to 100.
pub(super) fn compress(rgb: &mut [u8], [width, height]: [usize; 2], quality: u32) {
    let pixel = |rgb: &[u8]| [0, 1, 2].map(|channel| f32::from(rgb[channel]));
    let luminance = |[r, g, b]: [f32; 3]| 0.299 * r + 0.587 * g + 0.114 * b;
    let mut luma: Vec<f32> = rgb.chunks_exact(3).map(|rgb| luminance(pixel(rgb)) - 128.0).collect();
    let half = [width.div_ceil(2), height.div_ceil(2)];
    let mut chroma = [vec![0.0; half[0] * half[1]], vec![0.0; half[0] * half[1]]];
    let [blue, red] = &mut chroma;
    for (index, (blue, red)) in blue.iter_mut().zip(red).enumerate() {
        let (x, y) = (2 * (index % half[0]), 2 * (index / half[0]));
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let at = (y + dy).min(height - 1) * width + (x + dx).min(width - 1);
            let [r, g, b] = pixel(&rgb[3 * at..]);
            *blue += 0.25 * (-0.168_736 * r - 0.331_264 * g + 0.5 * b);
            *red += 0.25 * (0.5 * r - 0.418_688 * g - 0.081_312 * b);
        }
    }
    compress_plane(&mut luma, [width, height], &steps(&LUMINANCE, quality));
    for plane in &mut chroma {
        compress_plane(plane, half, &steps(&CHROMINANCE, quality));
    }
    for (index, (rgb, luma)) in rgb.chunks_exact_mut(3).zip(luma).enumerate() {
        let at = index / width / 2 * half[0] + index % width / 2;
        let [y, cb, cr] = [luma + 128.0, chroma[0][at], chroma[1][at]];
        let colour = [y + 1.402 * cr, y - 0.344_136 * cb - 0.714_136 * cr, y + 1.772 * cb];
        for (value, found) in rgb.iter_mut().zip(colour) {
            *value = (found + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::*;

    fn image(width: usize, height: usize) -> Vec<u8> {
        let value = |i: usize| {
            128.0 + 60.0 * libm::sinf(0.31 * (i % width) as f32) * libm::cosf(0.17 * (i / width) as f32)
        };
        (0..width * height).flat_map(|i| [value(i) as u8, value(i) as u8, (0.9 * value(i)) as u8]).collect()
    }

    #[test]
    fn loss_grows_as_the_quality_falls_and_even_grey_stays() {
        let size @ [width, height] = [45, 30];
        let whole = image(width, height);
        let error = |quality| {
            let mut found = whole.clone();
            compress(&mut found, size, quality);
            let sum: f64 = found.iter().zip(&whole).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
            (sum / whole.len() as f64).sqrt()
        };
        let errors = [100, 90, 50, 10].map(error);
        assert!(errors[0] < 1.5 && errors[3] > 3.0, "{errors:?}");
        assert!(errors.windows(2).all(|pair| pair[0] < pair[1]), "{errors:?}");
        let mut even = vec![128; 3 * width * height];
        compress(&mut even, size, 75);
        assert!(even.iter().all(|value| *value == 128), "an even plane");
    }
}
