//! Parameters of the camera's sensor.
//!
//! Must not know: how they are applied.

use crate::params::{Knob, Params};
use crate::random::Streams;

/// Colour filter array of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mosaic {
    /// None.
    Monochrome,
    /// Bayer pattern RGGB (Bayer 1976).
    Bayer,
}

/// Least black level, standard deviations of the noise in the dark.
const BLACK_IN_NOISE: f64 = 2.0;
/// Largest black level that noise leads to: codes span black to the full well.
const MAX_BLACK_OF_NOISE: f64 = 0.5;
/// Film: exposure of the toe of its characteristic curve, 1 for the full well. Its density is D = gamma log10(1 + E / toe) at an exposure E.
pub const FILM_TOE: f32 = 0.02;
/// Slope of that curve, density per decade.
pub const FILM_GAMMA: f32 = 0.7;

/// A sensor in the linear model of EMVA 1288 (release 4.0, section 2.2), and the optics in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Colour filter array.
    pub mosaic: Mosaic,
    /// Automatic exposure: encoded level, 0 to 1, of the median of the sunlit ground; 0 for the fixed exposure.
    pub ground_level: f64,
    /// Longest exposure that automatic exposure chooses, stops above the fixed one.
    pub gain_max_ev: f64,
    /// Columns of pixels; its rows follow from the shape of the image. 0 for those of the image.
    pub width_px: u32,
    /// Veiling glare: the part of the light that the lens spreads uniformly over the image, before vignetting.
    pub glare: f64,
    /// Fraction of the natural vignetting (cos^4 of the angle to the optical axis), 0 to 1.
    pub vignetting: f64,
    /// Standard deviation of the point spread function, pixels, pixel aperture included; effective from 0.25 on.
    pub psf_px: f64,
    /// Full-well capacity, electrons. Radiance 1 at exposure 0 EV saturates it.
    pub full_well_e: f64,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_e: f64,
    /// Mean dark signal, electrons.
    pub dark_e: f64,
    /// Dark signal non-uniformity: standard deviation, electrons; a fixed pattern.
    pub dsnu_e: f64,
    /// Photo response non-uniformity: relative standard deviation; a fixed pattern.
    pub prnu: f64,
    /// Fraction of full scale that maps to black.
    pub black_level: f64,
    /// Bit depth of the analog-to-digital converter.
    pub bits: u32,
    /// Standard deviation of the density of film in a pixel where the density is 1; 0 for a digital sensor.
    pub grain: f64,
    /// Part of the light that the base of film reflects into a halo around highlights.
    pub halation: f64,
    /// Contrast stretch: fraction of the pixels of the image that becomes black, and as many white; 0 for none.
    pub stretch: f64,
    /// Quality of the JPEG compression of the image, 1 to 100; 0 for none.
    pub jpeg_quality: u32,
    /// Seed of this frame's noise.
    pub noise_seed: u32,
}

impl Sensor {
    /// The sensor of these parameters; `None` if it is off.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params) -> Option<Self> {
        let mosaic = match params.text(Knob::SensorKind) {
            "mono" => Mosaic::Monochrome,
            "bayer" => Mosaic::Bayer,
            _ => return None,
        };
        let number = |knob| params.number(knob);
        let mut sensor = Self {
            mosaic,
            ground_level: number(Knob::SensorGroundLevel),
            gain_max_ev: number(Knob::SensorGainMaxEv),
            width_px: params.count(Knob::SensorWidthPx),
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
            grain: number(Knob::SensorGrain),
            halation: number(Knob::SensorHalation),
            stretch: number(Knob::SensorStretch),
            jpeg_quality: params.count(Knob::SensorJpegQuality),
            noise_seed: streams.stream("sensor.noise", 0).bits(),
        };
        // Noise that is cut off at black from below would make the sky grey.
        let of_noise = (BLACK_IN_NOISE * sensor.noise_of(0.0, 1.0)).min(MAX_BLACK_OF_NOISE);
        sensor.black_level = sensor.black_level.max(of_noise);
        Some(sensor)
    }
    /// Pixels along the side of a pixel of an image with this many columns.
    #[must_use]
    pub fn pixels_per_side(&self, columns: u32) -> f64 {
        if self.width_px == 0 { 1.0 } else { f64::from(self.width_px) / f64::from(columns) }
    }

    /// Standard deviation of the noise of one pixel at this fill, as a fraction of the full well: photons, dark signal, read-out,
    /// fixed patterns and quantisation (EMVA 1288, release 4.0, section 2.3). `pixels` is the number of pixels of the sensor that a
    /// pixel of the image is the mean of: the square of [`Self::pixels_per_side`].
    #[must_use]
    pub fn noise_of(&self, fill: f64, pixels: f64) -> f64 {
        let signal_e = fill.clamp(0.0, 1.0) * self.full_well_e;
        let step_e = self.full_well_e / f64::from((1_u32 << self.bits) - 1);
        let square = |deviation_e: f64| deviation_e * deviation_e;
        let fixed_e = square(self.prnu * signal_e) + square(self.dsnu_e);
        // Of film: see `add_grain` of the read-out.
        let exposed = fill.clamp(0.0, 1.0) + f64::from(FILM_TOE);
        let density = f64::from(FILM_GAMMA) * libm::log10(exposed / f64::from(FILM_TOE));
        let per_density = exposed * std::f64::consts::LN_10 / f64::from(FILM_GAMMA);
        let grain_e = self.full_well_e * per_density * self.grain * density.max(0.0).sqrt();
        let fixed_e = fixed_e + square(grain_e);
        let variance_e = signal_e + self.dark_e + fixed_e + square(self.read_noise_e) + square(step_e) / 12.0;
        (variance_e / pixels.max(1.0)).sqrt() / self.full_well_e
    }
}

#[cfg(test)]
impl Sensor {
    /// A sensor without noise, blur and processing.
    pub(crate) const fn ideal(mosaic: Mosaic) -> Self {
        Self {
            mosaic,
            ground_level: 0.0,
            glare: 0.0,
            vignetting: 0.0,
            psf_px: 0.0,
            full_well_e: 20_000.0,
            read_noise_e: 0.0,
            dark_e: 0.0,
            dsnu_e: 0.0,
            prnu: 0.0,
            black_level: 0.0,
            bits: 14,
            width_px: 0,
            gain_max_ev: 4.0,
            stretch: 0.0,
            jpeg_quality: 0,
            grain: 0.0,
            halation: 0.0,
            noise_seed: 9,
        }
    }
}
