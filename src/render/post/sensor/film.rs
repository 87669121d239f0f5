//! Halation: light that passes the emulsion of film, is reflected by the back of its base, and exposes it again around highlights.
//! Must not know: digital sensors.

use super::optics::{convolve, gaussian_taps};

/// Standard deviation of the halo, as a part of the width of the image: light is reflected totally from the critical angle on, at twice
/// the thickness of a base of 0.1 mm times its tangent, 0.18 mm on a frame of 53 mm.
const RADIUS: f64 = 0.0035;

/// Spreads this part of the light of a channel around it.
pub(super) fn add_halation(channel: &mut [f32], [width, height]: [usize; 2], part: f64) {
    let taps = gaussian_taps((RADIUS * width as f64).max(0.5));
    let halo = convolve(channel, width, height, &taps);
    for (value, halo) in channel.iter_mut().zip(halo) {
        *value += part as f32 * (halo - *value);
    }
}
