//! Azimuths in which a place looks at the ground and the rocks around it, and how bright they are there under the sun.
//! Must not know: where the place lies.

use std::f32::consts::{PI, TAU};

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::{Vec2, Vec3};

use crate::render::select::lane_math::{LANES, exp, load, splat};
use crate::render::select::rock_cover::{CoverOfLanes, PassedRocks};
use crate::scene::bounce::Bounce;
use crate::scene::photometry::Photometry;

/// Azimuths, from that of the sun on.
pub const AZIMUTHS: usize = 12;
/// Angle between them, radians.
pub const WIDTH: f32 = TAU / AZIMUTHS as f32;
/// Least cosine of emission, for ground that is seen edge-on.
const MIN_EMISSION: f32 = 0.02;
/// Steps of a table of radiance factors.
const STEPS: usize = 8;
/// Height up to which the rocks of a stretch are seen, in their mean heights: those that are higher than the mean have most of the area.
const SPAN: f32 = 1.3;

/// The direction to the sun, the same from all places.
#[derive(Clone, Copy, Debug)]
pub struct SunDirection {
    /// Horizontal unit vector towards it.
    pub towards: Vec2,
    /// Sine of its elevation.
    pub sine: f32,
    /// Cosine of its elevation.
    pub cosine: f32,
}

impl SunDirection {
    /// From the unit vector towards the sun.
    #[must_use]
    pub fn new(sun: Vec3) -> Self {
        let sine = sun.z.max(1e-3);
        let towards = sun.truncate().normalize_or(Vec2::X);
        Self { towards, sine, cosine: (1.0 - sine * sine).max(1e-6).sqrt() }
    }
}

/// An azimuth.
pub struct Azimuth {
    /// Horizontal unit vector.
    pub direction: Vec2,
    /// Cosine of its angle to the left of the sun's azimuth.
    pub to_sun: f32,
    /// Sine of that angle.
    pub to_left: f32,
    sun: SunDirection,
    /// Radiance factors of ground that is seen in it, by the roots of the cosines of incidence and of emission.
    of_ground: [f32; (STEPS + 1) * (STEPS + 1)],
    /// That of a sunlit rock of the soil's colour, mean over its outline.
    of_rock: f32,
}

/// The rocks on a stretch of ground, as eight places see them.
#[derive(Clone, Copy)]
pub struct SeenRocks<'a, S: Simd> {
    /// What they are.
    pub cover: &'a CoverOfLanes<S>,
    /// All stretches up to this one.
    pub passed: &'a PassedRocks<S>,
    /// The greatest slope up to ground before the stretch.
    pub horizon: f32x8<S>,
    /// The slope up to its ground.
    pub slope: f32x8<S>,
    /// Its distance, metres.
    pub from_m: f32x8<S>,
    /// Its length, metres.
    pub stretch_m: f32x8<S>,
}

// What takes vectors is inlined into `dispatch!`, so that it is compiled for each SIMD level.
impl Azimuth {
    /// All azimuths.
    #[must_use]
    pub fn all(photometry: &Photometry, bounce: &Bounce, sun: SunDirection) -> Vec<Self> {
        let cosine = |step: usize| (step * step) as f64 / (STEPS * STEPS) as f64;
        let azimuth = |index: usize| {
            let (to_left, to_sun) = libm::sincosf(WIDTH * index as f32);
            let direction = to_sun * sun.towards + to_left * sun.towards.perp();
            // Seen level.
            let cos_phase = -to_sun * sun.cosine;
            let of_ground = std::array::from_fn(|index| {
                let [incidence, emission] = [index / (STEPS + 1), index % (STEPS + 1)].map(cosine);
                photometry.soil.radiance_factor(incidence, emission, cos_phase.into()) as f32
            });
            Self { direction, to_sun, to_left, sun, of_ground, of_rock: factor_of_rock(bounce, cos_phase) }
        };
        (0..AZIMUTHS).map(azimuth).collect()
    }

    /// Radiance factor of ground for these cosines of incidence and emission.
    #[inline(always)]
    fn factor<S: Simd>(&self, simd: S, incidence: f32x8<S>, emission: f32x8<S>) -> f32x8<S> {
        let (i, u) = step_and_rest(incidence);
        let (j, v) = step_and_rest(emission);
        let mut first = [0; LANES];
        (i * (STEPS + 1) as f32 + j).to_int::<i32x8<S>>().store_slice(&mut first);
        let mut corners = [[0.0; LANES]; 4];
        for (lane, first) in first.into_iter().enumerate() {
            // The last step but one: what is compared here is never greater.
            let first = (first as usize).min(STEPS * (STEPS + 1) - 2);
            corners[0][lane] = self.of_ground[first];
            corners[1][lane] = self.of_ground[first + 1];
            corners[2][lane] = self.of_ground[first + STEPS + 1];
            corners[3][lane] = self.of_ground[first + STEPS + 2];
        }
        let [low, low_next] = [load(simd, &corners[0]), load(simd, &corners[1])];
        let [high, high_next] = [load(simd, &corners[2]), load(simd, &corners[3])];
        let low = low + v * (low_next - low);
        let high = high + v * (high_next - high);
        low + u * (high - low)
    }

    /// Radiance factor of ground with these slopes along x and y that rises by so much in this azimuth and is seen at a slope.
    #[inline(always)]
    #[must_use]
    pub fn radiance_factor<S: Simd>(
        &self,
        simd: S,
        [x, y]: [f32x8<S>; 2],
        rise: f32x8<S>,
        seen_at: f32x8<S>,
    ) -> f32x8<S> {
        let missing = rise - (x * self.direction.x + y * self.direction.y);
        let (x, y) = (x + missing * self.direction.x, y + missing * self.direction.y);
        let one = splat(simd, 1.0);
        let per_length = one / (one + x * x + y * y).sqrt();
        let emission = per_length * (rise - seen_at) / (one + seen_at * seen_at).sqrt();
        let towards = self.sun.cosine * self.sun.towards;
        let incidence = per_length * (splat(simd, self.sun.sine) - (x * towards.x + y * towards.y));
        self.factor(simd, incidence, emission.max(MIN_EMISSION))
    }

    /// Optical depth of the shadows of rocks. Seen along the sunlight, rocks hide their own.
    #[inline(always)]
    #[must_use]
    pub fn depth_of_shadows<S: Simd>(&self, cover: &CoverOfLanes<S>) -> f32x8<S> {
        cover.front * (self.sun.cosine / self.sun.sine * (0.5 + 0.5 * self.to_sun))
    }

    /// Light of rocks that are sunlit to this part, on a normal that faces the azimuth, per radian of it, as radiance factor times solid
    /// angle; and the slope from which it comes. `None` if it is dark in all lanes.
    #[inline(always)]
    #[must_use]
    pub fn light_of_rocks<S: Simd>(
        &self,
        simd: S,
        seen: &SeenRocks<'_, S>,
        sunlit: f32x8<S>,
    ) -> Option<[f32x8<S>; 2]> {
        let span = seen.cover.mean_height_m() * SPAN / seen.from_m;
        let visible = ((seen.slope + span - seen.horizon) / span.max(1e-9)).max(0.0).min(1.0);
        let lit = visible * sunlit;
        if !(span * lit).simd_gt(0.0).any_true() {
            return None;
        }
        let middle = seen.slope + span * 0.5;
        // Half of a rock's height is above the shadows.
        let hidden = seen.passed.depth(simd, middle) + self.depth_of_shadows(seen.cover) * 0.5;
        let one = splat(simd, 1.0);
        let per_square = one / (one + middle * middle);
        let solid_angle = seen.cover.lighting(seen.from_m) * seen.stretch_m / seen.from_m;
        let light = solid_angle * per_square * per_square.sqrt() * self.of_rock;
        Some([lit * exp(simd, -hidden) * light, middle])
    }
}

/// The step of a table of radiance factors that a cosine lies in, and how far.
#[inline(always)]
fn step_and_rest<S: Simd>(cosine: f32x8<S>) -> (f32x8<S>, f32x8<S>) {
    let along = cosine.max(0.0).min(1.0).sqrt() * STEPS as f32;
    let step = along.floor().min((STEPS - 1) as f32);
    (step, along - step)
}

/// Radiance factor of a sunlit sphere, mean over its disc, by the cosine of the phase angle. The mean of the law of Lommel and Seeliger, to
/// which `rock_phase` is relative, is half of its phase function (Seeliger 1887).
fn factor_of_rock(bounce: &Bounce, cos_phase: f32) -> f32 {
    let half = 0.5 * libm::acosf(cos_phase.clamp(-0.9999, 0.9999));
    let by_seeliger = 1.0 - libm::sinf(half) * libm::tanf(half) * libm::logf(1.0 / libm::tanf(0.5 * half));
    let relative = bounce.rock_phase.iter().rev().fold(0.0, |sum, c| sum * cos_phase + c).max(0.0);
    PI * relative * 0.5 * by_seeliger
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::photometry::Law;

    /// Means of the whole law over the disc of a sphere, which is looked at from all sides of the phase angle alike.
    #[test]
    fn a_rock_is_as_bright_as_a_sphere_by_the_whole_law() {
        let photometry = Photometry { law: Law::Hapke, ..Photometry::default() };
        let bounce = Bounce::new(&photometry, 0.3);
        let rock = photometry.with_surge(photometry.rock_b_s0);
        for cos_phase in [0.9_f64, 0.5, 0.0, -0.5] {
            let sine = (1.0 - cos_phase * cos_phase).sqrt();
            let (mut sum, steps) = (0.0, 200);
            for (column, row) in (0..steps).flat_map(|column| (0..steps).map(move |row| (column, row))) {
                let at = [column, row].map(|index| (2.0 * f64::from(index) + 1.0) / f64::from(steps) - 1.0);
                let square = 1.0 - at[0] * at[0] - at[1] * at[1];
                if square > 0.0 {
                    let emission = square.sqrt();
                    let incidence = (cos_phase * emission + sine * at[0]).max(0.0);
                    sum += rock.radiance_factor(incidence, emission, cos_phase);
                }
            }
            let expected = sum * 4.0 / f64::from(steps * steps) / std::f64::consts::PI;
            let found = f64::from(factor_of_rock(&bounce, cos_phase as f32));
            assert!((found / expected - 1.0).abs() < 0.12, "{cos_phase}: {found}, not {expected}");
        }
    }
}
