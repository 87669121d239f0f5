//! Automatic exposure, from a histogram as cameras do it.
//! Must not know: how light becomes a reading.

use super::encoding::reading_of;
use super::histogram::Histogram;
use crate::class::ClassId;
use crate::frame::Frame;
use crate::render::resolve::tone::exposure;
use crate::scene::sensor::Sensor;

/// Bins of a histogram: the upper half of the bits of a positive float, 128 to an octave.
const BINS: usize = 1 << 15;
/// The quantile of ground and rocks relative to which ground counts as sunlit.
const BRIGHT: f64 = 0.98;
/// Ground is sunlit if it is brighter than this part of [`BRIGHT`].
const MIN_SUNLIT: f32 = 0.1;
/// Largest part of the whole image that may be brighter than [`HEADROOM`].
const MAX_SATURATED: f64 = 0.015;
/// Fill that counts as nearly saturated.
const HEADROOM: f32 = 0.9;
/// Largest encoded level, 0 to 1, of the median of a sky that the sun veils: a camera into the sun keeps what is black dark.
const MAX_VEILED_SKY: f32 = 0.155;

/// The bin of a value.
fn bin_of(value: f32) -> usize {
    (value.max(0.0).to_bits() >> 16) as usize & (BINS - 1)
}

/// The value that this part of all values is below, of those from `least` on; `None` if there are none.
fn quantile(histogram: &Histogram, part: f64, least: f32) -> Option<f32> {
    let first = bin_of(least);
    let rank = (histogram.count(first) as f64 * part) as u64;
    let bin = histogram.bin_of_rank(rank, first)?;
    Some(f32::from_bits((bin as u32) << 16 | 0x8000))
}

/// Factor from radiance to the fill of a pixel, where 1 is the full well. The exposure of the camera; or, with automatic exposure,
/// the one that puts the median of the sunlit ground at the chosen level, unless that nearly saturates more than 1.5 % of the image or is
/// more than the longest exposure. `green` is the radiance that is metered; where the sun veils it (`is_veiled`), the median of the sky
/// stays below a level too.
pub(super) fn exposure_gain(
    frame: &Frame,
    sensor: &Sensor,
    (green, is_veiled): (&[f32], bool),
    exposure_ev: f32,
) -> f32 {
    let fixed = exposure(exposure_ev);
    if sensor.ground_level <= 0.0 {
        return fixed;
    }
    let of = |is_counted: fn(u8) -> bool| {
        let counted = green.iter().zip(&frame.class).filter(move |(_, class)| is_counted(**class));
        Histogram::new(BINS, counted.map(|(value, _)| bin_of(*value)))
    };
    let longest = exposure(exposure_ev + sensor.gain_max_ev as f32);
    let is_ground = |class: u8| class != ClassId::SKY.0 && class != ClassId::HARDWARE.0;
    let bright = quantile(&of(is_ground), BRIGHT, 0.0).unwrap_or(0.0);
    let median = quantile(&of(|class| class == ClassId::REGOLITH.0), 0.5, MIN_SUNLIT * bright);
    let Some(median) = median.filter(|_| bright > 0.0) else { return fixed };
    let sky = quantile(&of(|class| class == ClassId::SKY.0), 0.5, 0.0).filter(|_| is_veiled).unwrap_or(0.0);
    let saturating = quantile(&of(|_| true), 1.0 - MAX_SATURATED, 0.0).unwrap_or(0.0);
    let black = sensor.black_level as f32;
    (reading_of(sensor.ground_level as f32, black) / median)
        .min(HEADROOM / saturating.max(1e-30))
        .min(reading_of(MAX_VEILED_SKY, black) / sky.max(1e-30))
        .min(longest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::post::sensor::encoding::SrgbCodes;

    /// The veil of the sun is part of what is metered, and keeps the sky dark; without it neither counts.
    #[test]
    fn a_veil_shortens_the_exposure() {
        use crate::scene::sensor::Mosaic;
        let sensor = Sensor { ground_level: 0.5, ..Sensor::ideal(Mosaic::Monochrome) };
        let frame = Frame {
            width: 20,
            height: 10,
            class: [vec![ClassId::SKY.0; 100], vec![ClassId::REGOLITH.0; 100]].concat(),
            ..Frame::default()
        };
        let gain = |sky: f32, ground: f32, is_veiled| {
            let light = [vec![sky; 100], vec![ground; 100]].concat();
            exposure_gain(&frame, &sensor, (&light, is_veiled), 0.0)
        };
        let target = reading_of(0.5, 0.0);
        let of_ground = gain(0.0, 0.1, false);
        assert!((of_ground * 0.1 / target - 1.0).abs() < 0.01);
        assert_eq!(gain(0.0, 0.1, true), of_ground);
        assert!(
            (gain(0.001, 0.12, true) * 0.12 / target - 1.0).abs() < 0.01,
            "light of the ground and the veil"
        );
        let veiled = gain(0.06, 0.16, true);
        assert!((veiled * 0.06 / reading_of(MAX_VEILED_SKY, 0.0) - 1.0).abs() < 0.01, "{veiled}");
        assert!((gain(0.06, 0.16, false) * 0.16 / target - 1.0).abs() < 0.01, "a sky that shines by itself");
    }

    /// An encoded level is counted from the black level on.
    #[test]
    fn ground_has_its_level_above_black() {
        use crate::scene::sensor::Mosaic;
        let sensor = Sensor { ground_level: 0.3, black_level: 0.1, ..Sensor::ideal(Mosaic::Monochrome) };
        let class = vec![ClassId::REGOLITH.0; 100];
        let frame = Frame { width: 10, height: 10, class, ..Frame::default() };
        let mut readings = [0.2];
        readings[0] *= exposure_gain(&frame, &sensor, (&[0.2; 100], false), 0.0);
        SrgbCodes::shared().encode(&mut readings, 0.1);
        assert!((readings[0] - 0.3 * 255.0).abs() < 1.0, "{readings:?}");
    }

    #[test]
    fn quantiles_are_right_to_a_hundredth() {
        let histogram = Histogram::new(BINS, (1..=1000).map(|i| bin_of(i as f32 * 0.003)));
        for (part, least, expected) in [(0.5, 0.0, 1.5), (0.98, 0.0, 2.94), (0.5, 1.0, 2.0)] {
            let found = quantile(&histogram, part, least).expect("values");
            assert!((found / expected - 1.0).abs() < 0.01, "{part} from {least}: {found}");
        }
        assert_eq!(quantile(&histogram, 0.5, 4.0), None);
        assert_eq!(quantile(&Histogram::new(BINS, std::iter::empty()), 0.5, 0.0), None);
    }
}
