//! Weights that blend values across the cells of an integer lattice.
//!
//! Must not know: what is blended.

/// Cubic blending weight of `t` in [0, 1].
#[inline(always)]
pub(crate) fn smoothstep(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Linear interpolation from `a` (`t` = 0) to `b` (`t` = 1).
#[inline(always)]
pub(super) fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
