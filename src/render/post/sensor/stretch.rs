//! The contrast stretch of published images: the darkest pixels become black, the brightest white, and what lies between is spread evenly.
//!
//! Archives of missions show most images so (a linear stretch between percentiles of the histogram: Gonzalez and Woods, "Digital Image
//! Processing", 4th ed., section 3.2). All channels have the same two levels, so that hues stay: a pixel is black where
//! its darkest channel is, and white where its brightest is. A sky that the sun veils gets no brighter: black is raised as far as no
//! more of the ground becomes black than is asked for, and beyond that white is raised too.
//! Must not know: a sensor.

use super::histogram::Histogram;
use crate::class::ClassId;

/// Codes of fine levels to one of 8 bits.
const FINE: f32 = 256.0;
/// Number of fine levels.
const LEVELS: usize = 1 << 16;
/// The fine level of white.
const WHITE: f32 = 255.0 * FINE;
/// Least distance of the two levels: a quarter of the range, so that noise in a dark image is raised four times at most.
const MIN_SPAN: f32 = 64.0 * FINE;

/// Level of a sky that nothing veils but noise: black may be raised for its sake whatever ground is as dark.
const MAX_NOISE: f32 = 4.0 * FINE;

/// The fine level of an encoded value, 0 to 255.
pub(super) fn fine_level(value: f32) -> u16 {
    (value * FINE + 0.5) as u16
}

/// Writes the 8-bit image of the fine levels of an image, red, green and blue in turn, of which this fraction becomes black and as many
/// white, unless the two levels are closer than a quarter of the range. `classes` has the class of each pixel. Returns the encoded values
/// that become black and white, 0 to 1; above 1 if none becomes white.
pub(super) fn stretch(levels: &[u16], classes: &[u8], share: f64, rgb: &mut [u8]) -> [f32; 2] {
    let [low, high] = limits(levels, classes, share);
    let per_level = 255.0 / (high - low);
    for (value, level) in rgb.iter_mut().zip(levels) {
        // A cast to `u8` ends at 0 and 255.
        *value = ((f32::from(*level) - low) * per_level + 0.5) as u8;
    }
    [low / WHITE, high / WHITE]
}

/// The levels that become black and white.
fn limits(levels: &[u16], classes: &[u8], share: f64) -> [f32; 2] {
    let pixels = || levels.as_chunks::<3>().0.iter().zip(classes);
    let darkest = |&[red, green, blue]: &[u16; 3]| usize::from(red.min(green).min(blue));
    let brightest = |&[red, green, blue]: &[u16; 3]| usize::from(red.max(green).max(blue));
    let is_sky = |(_, class): &(&[u16; 3], &u8)| **class == ClassId::SKY.0;
    let quantile = |levels: &mut dyn Iterator<Item = usize>, part: f64| {
        let histogram = Histogram::new(LEVELS, levels);
        let rank = part * histogram.count(0).saturating_sub(1) as f64;
        histogram.bin_of_rank(rank.round() as u64, 0).unwrap_or(0) as f32
    };
    let high = quantile(&mut pixels().map(|(pixel, _)| brightest(pixel)), 1.0 - share);
    let veil = quantile(&mut pixels().filter(is_sky).map(|(pixel, _)| brightest(pixel)), 0.5);
    // The level of black that leaves half of the sky where it is, and the one that leaves the ground its light.
    let of_veil = veil * (WHITE - high) / (WHITE - veil).max(FINE);
    let ground = pixels().filter(|pixel| !is_sky(pixel));
    let of_ground = quantile(&mut ground.map(|(pixel, _)| darkest(pixel)), share);
    let low = quantile(&mut pixels().map(|(pixel, _)| darkest(pixel)), share);
    let low = low.max(if veil <= MAX_NOISE { of_veil } else { of_veil.min(of_ground) });
    // The level of white, at most its own, that leaves half of the sky where it is above this black.
    let of_white = if veil > low { low + (veil - low) * WHITE / veil } else { 0.0 };
    [low, high.max(low + MIN_SPAN).max(of_white)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The 8-bit image of grey values from 0 to 255, stretched.
    fn stretched(values: &[f32], share: f64) -> Vec<u8> {
        let levels: Vec<u16> = values.iter().flat_map(|value| [fine_level(*value); 3]).collect();
        let mut rgb = vec![0; levels.len()];
        stretch(&levels, &vec![ClassId::REGOLITH.0; values.len()], share, &mut rgb);
        rgb.chunks_exact(3).map(|pixel| pixel[0]).collect()
    }

    #[test]
    fn the_share_becomes_black_and_white_and_the_rest_is_spread_evenly() {
        let values: Vec<f32> = (0..1000).map(|k| 60.0 + 0.1 * k as f32).collect();
        let found = stretched(&values, 0.02);
        assert_eq!([found[20], found[979]], [0, 255], "60 + 2 and 60 + 97.9");
        assert!(found[23] > 0 && found[976] < 255);
        for (value, found) in values.iter().zip(found).skip(20).take(960) {
            let expected = 255.0 * (value - 62.0) / (157.9 - 62.0);
            assert!((f32::from(found) - expected).abs() < 0.6, "{found} for {value}");
        }
    }

    /// Of an image whose darkest and brightest values are 0 and 255 nothing changes if nothing is clipped.
    #[test]
    fn a_full_range_stays_as_it_is() {
        let values: Vec<f32> = (0..=255_u8).map(f32::from).collect();
        assert_eq!(stretched(&values, 0.001), (0..=255).collect::<Vec<u8>>());
    }

    #[test]
    fn noise_in_a_dark_image_stays_dark() {
        let values: Vec<f32> = (0..1000).map(|k| (k % 4) as f32).collect();
        let found = stretched(&values, 0.01);
        assert_eq!(found[..4], [0, 4, 8, 12], "four times as bright");
    }

    /// Blue decides what is black, red what is white, and hues between stay.
    #[test]
    fn colours_share_two_levels() {
        let levels: Vec<u16> =
            (0..501).flat_map(|k| [1.1, 1.0, 0.8].map(|c| fine_level(c * (50.0 + 0.2 * k as f32)))).collect();
        let classes = [ClassId::ROCK.0; 501];
        let mut rgb = vec![0; levels.len()];
        stretch(&levels, &classes, 0.02, &mut rgb);
        // The tenth darkest and the tenth brightest of 501 pixels.
        let [low, high] = [0.8 * (50.0 + 0.2 * 10.0), 1.1 * (50.0 + 0.2 * 490.0)];
        for (value, level) in rgb.iter().zip(&levels) {
            let expected = (255.0 * (f32::from(*level) / FINE - low) / (high - low)).clamp(0.0, 255.0);
            assert!((f32::from(*value) - expected).abs() < 0.6, "{value} for {level}");
        }
    }

    /// The sun veils the third of an image that is sky: its median, 35, stays while the ground, from 50 on, gets brighter.
    #[test]
    fn a_veiled_sky_gets_no_brighter() {
        let levels: Vec<u16> = (0..900_u32).flat_map(|k| [fine_level(20.0 + 0.1 * k as f32); 3]).collect();
        let classes: Vec<u8> =
            (0..900).map(|k| if k < 300 { ClassId::SKY.0 } else { ClassId::REGOLITH.0 }).collect();
        let mut rgb = vec![0; levels.len()];
        stretch(&levels, &classes, 0.01, &mut rgb);
        let values: Vec<u8> = rgb.chunks_exact(3).map(|pixel| pixel[0]).collect();
        assert!(
            values[150].abs_diff(35) <= 1 && values[0] < 10,
            "{} of 35, {} of 20",
            values[150],
            values[0]
        );
        assert!(values[300] > 75 && values[600] > 150, "{} of 50, {} of 80", values[300], values[600]);
        assert!(values[880] < 255 && values[891..].iter().all(|value| *value == 255));
    }

    /// The sky, at 40, is brighter than much of the ground, from 5 on: no more of the ground becomes black than is asked for.
    #[test]
    fn ground_that_is_darker_than_a_veiled_sky_keeps_its_light() {
        for brightest in [75.0, 250.0] {
            let ground = (0..600_u32).map(|k| 5.0 + (brightest - 5.0) * k as f32 / 600.0);
            let levels: Vec<u16> =
                [40.0; 300].into_iter().chain(ground).flat_map(|value| [fine_level(value); 3]).collect();
            let classes: Vec<u8> =
                (0..900).map(|k| if k < 300 { ClassId::SKY.0 } else { ClassId::REGOLITH.0 }).collect();
            let mut rgb = vec![0; levels.len()];
            let [black, white] = stretch(&levels, &classes, 0.01, &mut rgb);
            let values: Vec<u8> = rgb.chunks_exact(3).map(|pixel| pixel[0]).collect();
            assert!((30..=41).contains(&values[0]), "{}: the sky gets no brighter than 40", values[0]);
            let of_black = values[300..].iter().filter(|value| **value == 0).count();
            assert!(of_black < 20, "{of_black} of 600 are black, between {black} and {white}");
            assert!(white <= 1.0 && values[899] >= values[600] && values[899] >= 70, "{}", values[899]);
        }
    }
}
