//! Random numbers of the pixels, each a hash of pixel and seed.
//! Must not know: what they are for.

use crate::scene::noise::lattice_hash;

/// What each random number of a pixel is for: normal ones take two purposes.
pub(super) mod purpose {
    pub(in super::super) const PRNU: i32 = 0;
    pub(in super::super) const DSNU: i32 = 2;
    pub(in super::super) const SHOT_NORMAL: i32 = 4;
    pub(in super::super) const READ: i32 = 6;
    pub(in super::super) const SHOT_POISSON: i32 = 8;
}
/// A uniform number in (0, 1) for a pixel.
pub(super) fn uniform(x: usize, y: usize, purpose: i32, seed: u32) -> f64 {
    (f64::from(lattice_hash(x as i32, y as i32, purpose, seed)) + 0.5) / 4_294_967_296.0
}

/// A standard normal number for a pixel (Box and Muller 1958).
pub(super) fn normal(x: usize, y: usize, purpose: i32, seed: u32) -> f64 {
    let (u, v) = (uniform(x, y, purpose, seed), uniform(x, y, purpose + 1, seed));
    (-2.0 * libm::log(u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
}
