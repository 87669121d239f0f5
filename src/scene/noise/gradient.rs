//! Gradient noise on the plane, and its analytic gradient.
//!
//! Must not know: what the noise is for.

use super::cells::lerp;
use super::hash::{HASH_X, HASH_Y, first_mixed, last_mixed};

/// Gradient noise at a point of a lattice cell (`t` in [0, 1) along both axes), after Perlin 2002, "Improving Noise":
/// gradients at the corners, each component uniform in [-1, 1), blended with quintic weights. The corners also have values,
/// uniform in [-0.5, 0.5): with zeros at all lattice points the lattice would be visible. Mean 0, standard deviation
/// [`GRADIENT_NOISE_SIGMA`].
#[must_use]
#[inline(always)]
pub fn gradient_noise_2d(cell: [i32; 2], t: [f32; 2], seed: u32) -> f32 {
    let [value, _] = patchy_noise_2d(cell, t, seed, 0.0);
    value
}

/// [`gradient_noise_2d`], and the strength of finer noise, blended from the corners with the same weights: with `patchy` 1 it is drawn at
/// each corner, `PATCHY_BASE` + `PATCHY_PEAK` v^3 with v uniform in [0, 1); with 0 it is 1 everywhere.
#[must_use]
#[inline(always)]
pub fn patchy_noise_2d(cell: [i32; 2], t: [f32; 2], seed: u32, patchy: f32) -> [f32; 2] {
    let [u, v] = [quintic(t[0]), quintic(t[1])];
    let ([sw, se, nw, ne], [a, b, c, d]) = corners_of_cell(cell, t, seed, patchy);
    [lerp(lerp(a, b, u), lerp(c, d, u), v), strength_of_finer([sw, se, nw, ne], [u, v])]
}

/// Gradient of [`gradient_noise_2d`], per cell along both axes; a shade: other values at the corners, uniform in [-0.5, 0.5),
/// blended with the same weights, with a standard deviation of [`SHADE_SIGMA`]; the noise itself; and the strength of finer
/// noise.
#[must_use]
#[inline(always)]
pub fn gradient_noise_slope_2d(cell: [i32; 2], t: [f32; 2], seed: u32, patchy: f32) -> [f32; 5] {
    let [u, v] = [quintic(t[0]), quintic(t[1])];
    let ([sw, se, nw, ne], [a, b, c, d]) = corners_of_cell(cell, t, seed, patchy);
    [
        lerp(lerp(sw.x, se.x, u), lerp(nw.x, ne.x, u), v) + quintic_derivative(t[0]) * lerp(b - a, d - c, v),
        lerp(lerp(sw.y, se.y, u), lerp(nw.y, ne.y, u), v) + quintic_derivative(t[1]) * lerp(c - a, d - b, u),
        lerp(lerp(sw.shade, se.shade, u), lerp(nw.shade, ne.shade, u), v),
        lerp(lerp(a, b, u), lerp(c, d, u), v),
        strength_of_finer([sw, se, nw, ne], [u, v]),
    ]
}

/// The corners of a cell (south-west, south-east, north-west, north-east), and what each extrapolates to `t`.
#[inline(always)]
fn corners_of_cell(cell: [i32; 2], t: [f32; 2], seed: u32, patchy: f32) -> ([Corner; 4], [f32; 4]) {
    // The parts of `lattice_hash` that corners have in common: the first step of the finaliser is linear.
    let (x, y) = ((cell[0] as u32).wrapping_mul(HASH_X), (cell[1] as u32).wrapping_mul(HASH_Y));
    let (west, east) = (first_mixed(x), first_mixed(x.wrapping_add(HASH_X)));
    let (south, north) = (first_mixed(y ^ seed), first_mixed(y.wrapping_add(HASH_Y) ^ seed));
    // Written out: a closure over an array would not be inlined into the vectors of the caller.
    let sw = gradient_corner(last_mixed(west ^ south), patchy);
    let se = gradient_corner(last_mixed(east ^ south), patchy);
    let nw = gradient_corner(last_mixed(west ^ north), patchy);
    let ne = gradient_corner(last_mixed(east ^ north), patchy);
    let (a, b) = (sw.extrapolated(t, [0, 0]), se.extrapolated(t, [1, 0]));
    let (c, d) = (nw.extrapolated(t, [0, 1]), ne.extrapolated(t, [1, 1]));
    ([sw, se, nw, ne], [a, b, c, d])
}

/// The strength of finer noise at a point of a cell, from its corners (south-west, south-east, north-west, north-east) and their weights.
#[inline(always)]
fn strength_of_finer([sw, se, nw, ne]: [Corner; 4], [u, v]: [f32; 2]) -> f32 {
    lerp(lerp(sw.strength, se.strength, u), lerp(nw.strength, ne.strength, u), v)
}

/// Gradient, value, shade and strength at a corner of a cell.
#[derive(Clone, Copy)]
struct Corner {
    x: f32,
    y: f32,
    value: f32,
    shade: f32,
    strength: f32,
}

impl Corner {
    /// Linear extrapolation from this corner, `away` cells from the cell's origin, to `t`.
    #[inline(always)]
    fn extrapolated(self, t: [f32; 2], away: [i32; 2]) -> f32 {
        self.value + self.x * (t[0] - away[0] as f32) + self.y * (t[1] - away[1] as f32)
    }
}

/// The corner with this hash.
#[inline(always)]
fn gradient_corner(hash: u32, patchy: f32) -> Corner {
    // Signed: see `value_of`.
    let unit = |bits: u32| bits as i32 as f32 * (1.0 / 65_536.0);
    let product = hash.wrapping_mul(0x85eb_ca6b);
    let draw = unit(product & 0xffff);
    let strength = 1.0 + patchy * (PATCHY_BASE - 1.0 + PATCHY_PEAK * (draw * draw * draw));
    Corner {
        x: (hash & 0xffff) as i32 as f32 * (1.0 / 32_768.0) - 1.0,
        y: (hash >> 16) as i32 as f32 * (1.0 / 32_768.0) - 1.0,
        value: unit(hash.wrapping_mul(0x9e37_79b1) >> 16) - 0.5,
        shade: unit(product >> 16) - 0.5,
        strength,
    }
}

/// Derivative of [`quintic`].
#[inline(always)]
fn quintic_derivative(t: f32) -> f32 {
    30.0 * t * t * (t * (t - 2.0) + 1.0)
}

/// Blending weight of `t` in [0, 1] with zero first and second derivatives at both ends (Perlin 2002).
#[inline(always)]
fn quintic(t: f32) -> f32 {
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

/// Strength of finer noise at the smoothest corners, and how much stronger it is at the roughest: between the corners the mean square is 1,
/// and at them the deviation of the logarithm 0.57. Terrain that is intermittent at all scales has 0.58 where scales differ by a factor
/// of four (Gagnon, Lovejoy and Schertzer 2006, "Multifractal Earth topography": codimension of the mean 0.12).
pub(crate) const PATCHY_BASE: f32 = 0.427;
/// See [`PATCHY_BASE`].
pub(crate) const PATCHY_PEAK: f32 = 1.948;

/// Standard deviation of [`gradient_noise_2d`].
pub const GRADIENT_NOISE_SIGMA: f32 = 0.286;

/// Standard deviation of the shade of [`gradient_noise_slope_2d`].
pub const SHADE_SIGMA: f32 = 0.212;

/// Root mean square difference of [`gradient_noise_2d`] over a distance in lattice cells. It rises with the gradient's
/// standard deviation, 0.67 per cell, and saturates at sqrt(2) standard deviations; accurate to 4 % at any distance.
#[must_use]
pub fn gradient_noise_difference(cells: f64) -> f64 {
    let sigma = f64::from(GRADIENT_NOISE_SIGMA);
    let level = 2.0 * sigma * sigma;
    let rise = 0.6675 * cells;
    (level * (1.0 - libm::exp(-rise * rise / level))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rounding::{floor, floor_and_fraction};

    fn fraction(x: f32) -> f32 {
        x - floor(x) as f32
    }

    #[test]
    fn gradient_noise_has_the_stated_deviation_and_differences() {
        let at = |x: f32, y: f32| gradient_noise_2d([floor(x), floor(y)], [fraction(x), fraction(y)], 5);
        let points: Vec<(f32, f32)> =
            (0..200).flat_map(|i| (0..200).map(move |j| (i as f32 * 1.37, j as f32 * 1.73))).collect();
        let rms = |values: Vec<f64>| {
            (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
        };
        let deviation = rms(points.iter().map(|&(x, y)| f64::from(at(x, y))).collect());
        assert!((deviation - f64::from(GRADIENT_NOISE_SIGMA)).abs() < 0.004, "{deviation}");
        for distance in [0.05_f32, 0.2, 0.5, 1.0, 3.0] {
            let found = rms(points
                .iter()
                .map(|&(x, y)| f64::from(at(x + 0.6 * distance, y + 0.8 * distance) - at(x, y)))
                .collect());
            let stated = gradient_noise_difference(f64::from(distance));
            assert!((found / stated - 1.0).abs() < 0.1, "{distance}: {found} and {stated}");
        }
    }

    #[test]
    fn the_analytic_slope_is_the_finite_difference() {
        let step = 5e-3_f32;
        for i in 0..400 {
            let (x, y) = (0.173 * i as f32 - 31.0, 0.059 * i as f32 - 7.0);
            let ((column, u), (row, v)) = (floor_and_fraction(x), floor_and_fraction(y));
            let patchy = (i % 2) as f32;
            // The differences stay within the cell.
            let t = [u.clamp(step, 1.0 - step), v.clamp(step, 1.0 - step)];
            let slope = gradient_noise_slope_2d([column, row], t, 5, patchy);
            let at = |u, v| gradient_noise_2d([column, row], [u, v], 5);
            let along = (at(t[0] + step, t[1]) - at(t[0] - step, t[1])) / (2.0 * step);
            let across = (at(t[0], t[1] + step) - at(t[0], t[1] - step)) / (2.0 * step);
            assert!(
                (slope[0] - along).abs() < 1e-3 && (slope[1] - across).abs() < 1e-3,
                "({x}, {y}): {slope:?}, {along} {across} at {t:?}"
            );
            let [value, strength] = patchy_noise_2d([column, row], t, 5, patchy);
            assert_eq!(slope[3..], [value, strength], "value and strength at ({x}, {y})");
        }
    }

    #[test]
    fn the_strength_of_finer_noise_has_a_mean_square_of_1() {
        let (mut squares, mut logs, mut points) = (0.0, [0.0, 0.0], 0.0);
        for (i, j) in (0..300).flat_map(|i| (0..300).map(move |j| (i as f32 * 1.37, j as f32 * 1.73))) {
            let at = |patchy| patchy_noise_2d([floor(i), floor(j)], [fraction(i), fraction(j)], 9, patchy)[1];
            assert_eq!(at(0.0).to_bits(), 1.0_f32.to_bits(), "without patches");
            let strength = f64::from(at(1.0));
            squares += strength * strength;
            let log = libm::log(strength);
            logs = [logs[0] + log, logs[1] + log * log];
            points += 1.0;
        }
        let mean_square = squares / points;
        let deviation = (logs[1] / points - (logs[0] / points) * (logs[0] / points)).sqrt();
        assert!((mean_square - 1.0).abs() < 0.03, "{mean_square}");
        assert!((0.35..0.5).contains(&deviation), "{deviation}");
    }
}
