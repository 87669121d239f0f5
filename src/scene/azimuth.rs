//! Directions on the plane by azimuth.
//!
//! Must not know: what lies in them.

use glam::Vec2;

/// The horizontal unit vector along an azimuth, radians clockwise from +Y towards +X.
#[must_use]
pub fn direction(azimuth: f64) -> Vec2 {
    Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32)
}
