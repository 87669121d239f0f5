//! The craters of the nominal stage: a parabolic bowl with a Gaussian rim.
//!
//! Must not know: the grid that they are cut into.

use glam::Vec2;

use crate::params::{Knob, Params};
use crate::random::Streams;

/// Half the width of the square in which crater centres lie, as a fraction of half the terrain's side: 383 of 460 m.
const CENTRE_SPREAD: f64 = 383.0 / 460.0;

/// A crater of the nominal stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crater {
    /// Centre, metres.
    pub centre: Vec2,
    /// Radius from the centre to the crest of the rim, metres.
    pub radius_m: f32,
    /// Depth of the bowl below the ground around, metres.
    pub depth_m: f32,
    /// Height of the rim above the ground around, metres.
    pub rim_m: f32,
}

impl Crater {
    /// Whether the crater changes the height anywhere on the line where `axis` (0 is x, 1 is y) has this coordinate, metres.
    fn reaches(&self, axis: usize, at_m: f32) -> bool {
        // The rim is cut off at 2.5 radii.
        (at_m - self.centre[axis]).abs() < 2.51 * self.radius_m
    }

    /// Height that the crater adds at a point, metres: a parabolic bowl and a Gaussian rim.
    #[must_use]
    pub fn height_at(&self, p: Vec2) -> f32 {
        let distance = p.distance(self.centre);
        let from_crest = (distance - self.radius_m) / (0.30 * self.radius_m);
        if from_crest > 5.0 {
            return 0.0; // exp(-25): below the resolution of the sum
        }
        let rim = self.rim_m * libm::expf(-from_crest * from_crest);
        let t = distance / self.radius_m;
        if t < 1.0 { rim - self.depth_m * (1.0 - t * t) } else { rim }
    }
}

/// Sums the heights of all craters at the points of a line along x, metres.
pub fn set_crater_heights(craters: &[Crater], x: &[f32], y: f32, heights_m: &mut [f32]) {
    let mut near = craters.iter().filter(|crater| crater.reaches(1, y)).peekable();
    // The value of an empty sum of floats: -0.0.
    heights_m.fill(if near.peek().is_none() { -0.0 } else { 0.0 });
    for crater in near {
        let first = x.partition_point(|&x| x < crater.centre.x && !crater.reaches(0, x));
        for (height_m, &x) in heights_m[first..].iter_mut().zip(&x[first..]) {
            if !crater.reaches(0, x) {
                break;
            }
            *height_m += crater.height_at(Vec2::new(x, y));
        }
    }
}

/// Draws the craters of the nominal stage.
pub fn draw_craters(streams: &Streams, params: &Params) -> Vec<Crater> {
    let spread_m = 0.5 * params.number(Knob::TerrainSizeM) * CENTRE_SPREAD;
    let count = params.count(Knob::CratersCount);
    (0..u64::from(count))
        .map(|k| {
            let draw = |knob: Knob| params.sample(knob, &mut streams.stream(knob.name(), k)) as f32;
            let mut position = streams.stream("craters.place", k);
            let depth_m = draw(Knob::CratersDepthM);
            Crater {
                centre: Vec2::new(
                    position.uniform(-spread_m, spread_m) as f32,
                    position.uniform(-spread_m, spread_m) as f32,
                ),
                radius_m: draw(Knob::CratersRadiusM),
                depth_m,
                rim_m: depth_m * draw(Knob::CratersRimRatio),
            }
        })
        .collect()
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may be computed with std's functions")]
mod tests {
    use super::*;

    #[test]
    fn crater_profile_is_the_stated_one() {
        let crater = Crater { centre: Vec2::new(3.0, 4.0), radius_m: 10.0, depth_m: 2.0, rim_m: 0.5 };
        let at = |d: f32| crater.height_at(Vec2::new(3.0 + d, 4.0));
        let rim = |d: f32| 0.5 * (-((d - 10.0) / 3.0).powi(2)).exp();
        for (distance, bowl) in [(0.0, -2.0), (5.0, -1.5), (10.0, 0.0), (14.0, 0.0), (30.0, 0.0)] {
            assert!((at(distance) - bowl - rim(distance)).abs() < 1e-5, "{distance} m: {}", at(distance));
        }
    }
}
