//! A fillet: the soil that lies banked against a rock.
//!
//! Soil creeps and is thrown against a rock for as long as it lies there, and the rock itself wears down into it: fillets are wider
//! and higher around older rocks, and higher on the uphill side (Ruesch and Woehler 2022, "Degradation of rocks on the surface
//! of the Moon", Planetary Science Journal). The height of the contact varies around the rock.
//! Must not know: rocks, the rest of the relief.

use glam::Vec2;

use super::noise::gradient_noise_2d;
use crate::rounding::floor_and_fraction;

/// Terms of the Fourier series of an outline: the mean, then cosine and sine of one, two and three times the azimuth.
pub const OUTLINE_TERMS: usize = 7;
/// Ripples of the soil against the rock: wavelength in mean diameters of the rock, and amplitude relative to the first.
const RIPPLES: [(f32, f32); 3] = [(0.55, 1.0), (0.26, 0.7), (0.12, 0.5)];
/// Points per batch at most.
pub(super) const BATCH: usize = 32;

/// The soil against a rock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fillet {
    /// Centre of the rock, metres from the centre of the ground.
    pub offset: Vec2,
    /// Outline of the rock seen from above: its radius, metres, as a Fourier series of the azimuth from +X to +Y.
    pub outline_m: [f32; OUTLINE_TERMS],
    /// Distance from the rock at which it ends, metres.
    pub width_m: f32,
    /// Mean height of the soil against the rock, metres.
    pub height_m: f32,
    /// Points uphill; its length is how much higher the soil is there than the mean, relative to the mean.
    pub uphill: Vec2,
    /// Amplitude of the longest ripples, metres.
    pub ripple_m: f32,
    /// Seed of the ripples.
    pub seed: u32,
}

impl Fillet {
    /// Radius within which it changes the height, metres.
    #[must_use]
    pub fn reach_m(&self) -> f32 {
        let [mean_m, terms_m @ ..] = self.outline_m;
        mean_m + terms_m.iter().map(|term| term.abs()).sum::<f32>() + self.max_width_m()
    }

    /// Its size for a mesh that samples it, metres.
    #[must_use]
    pub fn size_m(&self) -> f32 {
        2.0 * self.outline_m[0] + self.width_m
    }

    fn max_width_m(&self) -> f32 {
        self.width_m * (1.0 + 0.5 * self.uphill.length())
    }

    /// Adds its height at points (structure of arrays, metres from the centre of the ground). `in_mesh` is the fraction of a
    /// feature of some size, metres, that a mesh through these points has.
    #[inline(always)]
    pub(super) fn add_heights(&self, [x, y]: [&[f32]; 2], in_mesh: impl Fn(f32) -> f32, heights: &mut [f32]) {
        let share = in_mesh(self.size_m());
        if share == 0.0 {
            return;
        }
        let mut ripples = [0.0; BATCH];
        for (seed, (diameters, amplitude)) in (self.seed..).zip(RIPPLES) {
            let wavelength_m = 2.0 * diameters * self.outline_m[0];
            let amplitude_m = in_mesh(wavelength_m) * amplitude * self.ripple_m;
            if amplitude_m == 0.0 {
                break;
            }
            let per_m = 1.0 / wavelength_m;
            for ((ripple, x), y) in ripples.iter_mut().zip(x).zip(y) {
                let (column, u) = floor_and_fraction((x - self.offset.x) * per_m);
                let (row, v) = floor_and_fraction((y - self.offset.y) * per_m);
                let noise = gradient_noise_2d([column, row], [u, v], seed);
                *ripple += amplitude_m * noise;
            }
        }
        let [mean_m, cos1, sin1, cos2, sin2, cos3, sin3] = self.outline_m;
        for (((height, x), y), ripple) in heights.iter_mut().zip(x).zip(y).zip(ripples) {
            let (dx, dy) = (x - self.offset.x, y - self.offset.y);
            let distance_m = (dx * dx + dy * dy).sqrt();
            let per_m = 1.0 / distance_m.max(1e-6);
            let (c, s) = (dx * per_m, dy * per_m);
            let (c2, s2) = (c * c - s * s, 2.0 * c * s);
            let (c3, s3) = (c * c2 - s * s2, c * s2 + s * c2);
            let outline_m = mean_m + cos1 * c + sin1 * s + cos2 * c2 + sin2 * s2 + cos3 * c3 + sin3 * s3;
            let uphill = self.uphill.x * c + self.uphill.y * s;
            let beyond = (distance_m - outline_m) / (self.width_m * (1.0 + 0.5 * uphill));
            let fall = 1.0 - beyond.clamp(0.0, 1.0);
            // Below the rock the two sides meet.
            let side = uphill * (distance_m / outline_m).min(1.0);
            *height += share * fall * fall * (self.height_m * (1.0 + side) + ripple);
        }
    }
}
