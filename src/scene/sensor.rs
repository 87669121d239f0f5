//! The camera's sensor: what becomes of the light, as numbers.
//!
//! Must not know: how it is reckoned.

use crate::params::{Knob, Params};
use crate::random::Streams;

/// How a sensor sees colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mosaic {
    /// Not at all.
    Monochrome,
    /// Through filters, one a pixel: red and green, green and blue in turn (Bayer 1976), filled in bilinearly.
    Bayer,
}

/// A sensor in the linear model of EMVA 1288 (release 4.0, part 2.2), and the optics before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// How it sees colour.
    pub mosaic: Mosaic,
    /// Encoded level, 0 to 1, that the median of the sunlit ground is put at; 0 for the fixed exposure.
    pub ground_level: f64,
    /// Light that is spread evenly over the picture, as a part of its mean.
    pub glare: f64,
    /// Share of the natural fall of light to the corners (cos^4 of the angle from the axis).
    pub vignetting: f64,
    /// Standard deviation of a point's picture, pixels, the pixel's own width included: from 0.25 on.
    pub psf_px: f64,
    /// Electrons that a pixel holds; more are clipped. Radiance 1 at exposure 0 EV fills it.
    pub full_well_e: f64,
    /// Deviation of the electrons that reading adds.
    pub read_noise_e: f64,
    /// Electrons that come without light.
    pub dark_e: f64,
    /// Their deviation from pixel to pixel, the same in every frame.
    pub dsnu_e: f64,
    /// Deviation of the pixels' sensitivity, relative, the same in every frame.
    pub prnu: f64,
    /// Part of the full scale that becomes black.
    pub black_level: f64,
    /// Bits of a reading.
    pub bits: u32,
    /// Seed of this frame's noise.
    pub noise_seed: u32,
}

impl Sensor {
    /// The sensor of these settings; none where it is off.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params) -> Option<Self> {
        let mosaic = match params.text(Knob::SensorKind) {
            "mono" => Mosaic::Monochrome,
            "bayer" => Mosaic::Bayer,
            _ => return None,
        };
        let number = |knob| params.number(knob);
        Some(Self {
            mosaic,
            ground_level: number(Knob::SensorGroundLevel),
            glare: number(Knob::SensorGlare),
            vignetting: number(Knob::SensorVignetting),
            psf_px: number(Knob::SensorPsfPx),
            full_well_e: number(Knob::SensorFullWellE),
            read_noise_e: number(Knob::SensorReadNoiseE),
            dark_e: number(Knob::SensorDarkE),
            dsnu_e: number(Knob::SensorDsnuE),
            prnu: number(Knob::SensorPrnu),
            black_level: number(Knob::SensorBlackLevel),
            bits: params.count(Knob::SensorBits),
            noise_seed: streams.stream("sensor.noise", 0).bits(),
        })
    }
}
