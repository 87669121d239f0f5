//! Sub-pixel positions: fixed point with 8 fractional bits.
//!
//! Must not know: triangles.

use glam::Vec2;

use crate::rounding::floor;

/// Fractional bits of a position, as `VkPhysicalDeviceLimits::subPixelPrecisionBits` of common devices.
pub(crate) const SUBPIXEL_BITS: i32 = 8;
/// Steps per pixel that positions are rounded to.
pub(crate) const SUBPIXEL_STEPS: i32 = 1 << SUBPIXEL_BITS;
/// Largest magnitude of a coordinate that [`SubpixelPoint::rounded`] takes, pixels. What reaches further is clipped: the guard
/// band around the image.
pub(crate) const GUARD_BAND_PX: f32 = 16_384.0;

/// A position in sub-pixel steps from the centre of the first pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubpixelPoint {
    /// To the right.
    pub x: i32,
    /// Down.
    pub y: i32,
}

impl SubpixelPoint {
    /// The nearest point to a position in pixels from the centre of the first pixel.
    #[must_use]
    #[inline(always)]
    pub fn rounded(position_px: Vec2) -> Self {
        Self { x: Self::steps(position_px.x), y: Self::steps(position_px.y) }
    }

    /// The nearest number of steps to a distance in pixels.
    #[must_use]
    #[inline(always)]
    pub fn steps(distance_px: f32) -> i32 {
        floor(distance_px * SUBPIXEL_STEPS as f32 + 0.5)
    }
}

/// Twice the signed area of a triangle, square sub-pixel steps. Rows run down, so it is negative if the vertices run
/// counter-clockwise in the image.
#[must_use]
#[inline(always)]
pub(crate) fn twice_area(a: SubpixelPoint, b: SubpixelPoint, c: SubpixelPoint) -> i64 {
    i64::from(b.x - a.x) * i64::from(c.y - a.y) - i64::from(b.y - a.y) * i64::from(c.x - a.x)
}
