//! The wall of a large old crater on the surface stage, in which or before which the camera stands: a floor, an inner wall, the crest of
//! the rim, and the ground beyond.
//!
//! Impact craters of some hundred metres are bowls with walls of up to the angle of repose, which erosion lowers and rounds (Fassett and
//! Thomson 2014). The wall here is concave at its foot, straight above that, and rounded at its crest. Noise shifts it across itself, so
//! that the crest has no circle for a plan and the wall has spurs and gullies, and scales its height from place to place.
//! The floor is the ground as it is without the crater, to the bit.
//! Must not know: the rest of the relief, rocks.

use glam::Vec2;

use super::azimuth;
use super::lattice::Lattice;
use super::noise::{GRADIENT_NOISE_SIGMA, gradient_noise_2d};
use crate::error::{Error, Result};
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Parts of the width of the wall in which its slope grows from none at the foot, and falls to none at the crest.
const FOOT: f32 = 0.35;
const CREST: f32 = 0.2;
/// Mean slope of the wall over that of its straight part.
const MEAN_SLOPE: f32 = 1.0 - 0.5 * (FOOT + CREST);
/// How far the ground beyond lies below the crest, relative to the height of the wall, and at which distance from the crest half of that,
/// radii of the crater.
const RIM: f32 = 0.25;
const RIM_RADII: f32 = 0.3;
/// Wavelengths of the noise that shifts the wall: the longest in radii of the crater; each is half the one before.
const LONGEST_SHIFT: f64 = 0.4;
const SHIFT_OCTAVES: u32 = 5;
/// Amplitude of an octave, wavelengths.
const SHIFT: f32 = 0.17;
/// Wavelengths of the noise that scales its height, radii of the crater, with its standard deviations.
const SCALES: [(f64, f32); 2] = [(0.9, 0.14), (0.25, 0.05)];
/// Maximum width of the wall, radii of the crater.
const MAX_WIDTH: f32 = 0.9;
/// Wavelength of patches of rocks, metres.
const PATCH_M: f64 = 70.0;

/// The wall.
#[derive(Clone, Debug)]
pub struct CraterWall {
    /// Centre of the crater, metres from the centre of the ground.
    centre: Vec2,
    /// From there to the crest, metres.
    radius_m: f32,
    /// Of the crest above the floor, metres.
    height_m: f32,
    /// From the foot to the crest, metres.
    width_m: f32,
    /// By falling wavelength.
    shifts: Vec<Lattice>,
    scales: Vec<(Lattice, f32)>,
    patches: Lattice,
}

impl CraterWall {
    /// The wall of these parameters around `centre` (metres, world), where the camera stands; `None` if there is none.
    #[must_use]
    pub fn new(streams: &Streams, params: &Params, centre: Vec2) -> Option<Self> {
        let number = |knob| params.number(knob);
        let (height_m, radius_m) = (number(Knob::WallHeightM), number(Knob::WallRadiusM));
        if height_m <= 0.0 {
            return None;
        }
        let towards = azimuth::direction(
            (number(Knob::CameraYawDeg) + number(Knob::WallRelativeAzimuthDeg)).to_radians(),
        );
        let to_centre_m = number(Knob::WallDistanceM) - radius_m;
        let lattice = |purpose: &str, k: u32, wavelength_m: f64| {
            Lattice::new(wavelength_m, centre, &mut streams.stream(purpose, k.into()))
        };
        let shift = |k: u32| lattice("wall.shift", k, LONGEST_SHIFT * radius_m / f64::from(1_u32 << k));
        let scale = |(k, (radii, deviation)): (u32, (f64, f32))| {
            (lattice("wall.scale", k, radii * radius_m), deviation)
        };
        let slope = libm::tan(number(Knob::WallSlopeDeg).to_radians());
        Some(Self {
            centre: to_centre_m as f32 * towards,
            radius_m: radius_m as f32,
            height_m: height_m as f32,
            width_m: (height_m / (slope * f64::from(MEAN_SLOPE))) as f32,
            shifts: (0..SHIFT_OCTAVES).map(shift).collect(),
            scales: (0..).zip(SCALES).map(scale).collect(),
            patches: lattice("wall.patches", 0, PATCH_M),
        })
    }

    /// # Errors
    /// [`Error::Scene`] if the wall takes more than [`MAX_WIDTH`] of the crater's radius: it would have no floor, and less height.
    pub(super) fn check(&self) -> Result<()> {
        let Self { radius_m, height_m, width_m, .. } = self;
        if *width_m <= MAX_WIDTH * radius_m {
            return Ok(());
        }
        Err(Error::Scene(format!(
            "wall.height_m = {height_m} takes a wall {width_m:.0} m wide, which leaves no floor in a crater with wall.radius_m = \
             {radius_m}; lower the wall, raise wall.slope_deg, or enlarge the crater"
        )))
    }

    /// The wall with its crater elsewhere, by this many metres.
    #[must_use]
    pub(super) fn moved(self, by: Vec2) -> Self {
        Self { centre: self.centre + by, ..self }
    }

    /// Adds its height at points (structure of arrays, metres from the centre of the ground). `in_mesh` is the fraction of a feature
    /// of some size, metres, that a mesh through these points has.
    #[inline(always)]
    pub(super) fn add_heights(&self, [x, y]: [&[f32]; 2], in_mesh: impl Fn(f32) -> f32, heights: &mut [f32]) {
        for ((height, x), y) in heights.iter_mut().zip(x).zip(y) {
            let point = Vec2::new(*x, *y);
            let outside_m = self.outside_m(point, &in_mesh);
            if outside_m <= -self.width_m {
                continue;
            }
            let mut scale = 1.0;
            for (lattice, deviation) in &self.scales {
                scale += deviation / GRADIENT_NOISE_SIGMA * noise(lattice, point);
            }
            *height += self.height_m * scale * self.profile(outside_m);
        }
    }

    /// How far a point lies outside of the crest, metres: from minus the radius in the centre to minus the width at the foot.
    #[inline(always)]
    fn outside_m(&self, point: Vec2, in_mesh: impl Fn(f32) -> f32) -> f32 {
        let outside_m = point.distance(self.centre) - self.radius_m;
        // What the noise shifts at most: its amplitudes are a geometric series, its values below 1.
        let max_shift_m = 2.0 * SHIFT * self.shifts[0].cell_m;
        if outside_m + max_shift_m <= -self.width_m {
            return outside_m;
        }
        self.shifts.iter().fold(outside_m, |outside_m, lattice| {
            outside_m + in_mesh(lattice.cell_m) * SHIFT * lattice.cell_m * noise(lattice, point)
        })
    }

    /// Height at a distance outside of the crest, metres, relative to that of the crest.
    #[inline(always)]
    fn profile(&self, outside_m: f32) -> f32 {
        if outside_m >= 0.0 {
            let q = outside_m / (RIM_RADII * self.radius_m);
            return 1.0 - RIM * q * q / (1.0 + q * q);
        }
        // Integrals of the slope: it grows evenly, stays, and falls evenly.
        let t = 1.0 + outside_m / self.width_m;
        let rise = if t < FOOT {
            0.5 * t * t / FOOT
        } else if t < 1.0 - CREST {
            t - 0.5 * FOOT
        } else {
            MEAN_SLOPE - 0.5 * (1.0 - t) * (1.0 - t) / CREST
        };
        rise / MEAN_SLOPE
    }

    /// Whether any of the wall may lie within a circle (metres from the centre of the ground).
    #[must_use]
    pub fn reaches(&self, point: Vec2, radius_m: f32) -> bool {
        let outside_m = point.distance(self.centre) - self.radius_m;
        let margin_m = radius_m + 2.0 * SHIFT * self.shifts[0].cell_m;
        outside_m - margin_m < 0.0 && outside_m + margin_m > -self.width_m
    }

    /// Position on the wall, 0 at its foot to 1 at the crest; `None` beside it.
    #[must_use]
    pub fn climb(&self, point: Vec2) -> Option<f32> {
        let t = 1.0 + self.outside_m(point, |_| 1.0) / self.width_m;
        (0.0..=1.0).contains(&t).then_some(t)
    }

    /// How many of the most rocks of the wall lie at a point (metres from the centre of the ground), 0 to 1: below the crest, where they
    /// break out, and at the foot, where they come to rest, in patches.
    #[must_use]
    pub fn rock_share(&self, point: Vec2) -> f32 {
        let Some(t) = self.climb(point) else { return 0.0 };
        let outcrop = 1.0 - ((t - 0.78) / 0.22).abs();
        let talus = 1.0 - ((t - 0.2) / 0.2).abs();
        let across = 0.25 + 0.75 * outcrop.max(0.8 * talus).max(0.0);
        let patch = 0.5 + noise(&self.patches, point) / GRADIENT_NOISE_SIGMA;
        across * patch.clamp(0.1, 1.0)
    }
}

/// Gradient noise of a lattice at a point.
#[inline(always)]
fn noise(lattice: &Lattice, point: Vec2) -> f32 {
    let (cell, at) = lattice.cell(lattice.local(point));
    gradient_noise_2d(cell, at, lattice.seed)
}

#[cfg(test)]
mod tests {
    use crate::params::config::Config;
    use crate::scene::Scene;

    #[test]
    fn a_wall_without_room_for_a_floor_is_refused() {
        let built = |height: &str| {
            let mut config = Config::new();
            for set in ["stage.name=surface", "rocks.coverage=0", height] {
                config.apply_set(set).expect(set);
            }
            Scene::build(3, &config.draw(3).expect("parameters"))
        };
        built("wall.height_m=150").expect("a wall");
        let error = built("wall.height_m=400").expect_err("no room").to_string();
        assert!(error.contains("wall.height_m = 400") && error.contains("wall.radius_m"), "{error}");
    }
}
