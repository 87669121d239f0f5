//! From radiance to 8-bit sRGB: exposure, tone curve, transfer function.
//! Must not know: a pass.

/// Display-linear value up to which the tone curve is the identity.
pub const TONE_KNEE: f64 = 0.85;
/// Limit of the tone curve for endless radiance, display-linear: 249 of 255 after sRGB encoding.
pub const TONE_WHITE: f64 = 0.947_307;

/// Factor on radiance of an exposure value in stops: 1 at 0 EV, doubled by each stop.
#[must_use]
pub fn exposure(ev: f32) -> f32 {
    libm::exp2f(ev)
}

/// The tone curve on the largest channel of exposed radiance: linear up to [`TONE_KNEE`], then an exponential shoulder that
/// starts with the same slope and approaches [`TONE_WHITE`]. CPU counterpart of `tone` in `common/tone.wgsl`.
#[must_use]
pub fn tone(x: f64) -> f64 {
    let room = TONE_WHITE - TONE_KNEE;
    if x <= TONE_KNEE { x } else { TONE_KNEE + room * (1.0 - libm::exp(-(x - TONE_KNEE) / room)) }
}

/// sRGB code value in [0, 255], not rounded, of a radiance at 0 EV: tone curve, then the transfer function of IEC 61966-2-1.
#[must_use]
pub fn srgb_code(radiance: f64) -> f64 {
    let x = tone(radiance);
    255.0 * if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tone_curve_is_smooth_rises_and_ends_at_249() {
        assert!((tone(TONE_KNEE) - TONE_KNEE).abs() < 1e-12);
        let step = 1e-6;
        let slope = (tone(TONE_KNEE + step) - tone(TONE_KNEE)) / step;
        assert!((slope - 1.0).abs() < 1e-4, "{slope}");
        let mut last = -1.0;
        for i in 0..1000 {
            let value = srgb_code(f64::from(i) * 0.01);
            assert!(value >= last);
            last = value;
        }
        assert!((srgb_code(1e9) - 249.0).abs() < 0.01, "{}", srgb_code(1e9));
    }

    #[test]
    fn exposure_doubles_with_each_stop() {
        assert_eq!((exposure(0.0), exposure(1.0), exposure(-2.0)), (1.0, 2.0, 0.25));
    }
}
