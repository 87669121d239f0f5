//! The camera's optics and sensor: from the linear radiance of a frame to the 8-bit image of a real camera.
//!
//! In the order of the light: exposure, veiling glare, vignetting, point spread function, colour filter array, shot noise, read noise,
//! quantisation, demosaicing, black level, encoding. The sensor is the linear model of EMVA 1288 (release 4.0), with PRNU and DSNU as its
//! fixed pattern. Labels are not touched: nothing here moves anything in the image.
//! Every random number is a hash of pixel and frame, so that the same frame is the same to the bit for any number of threads.
//! Must not know: wgpu.

mod encoding;
mod fixed_pattern;
mod noise;
mod optics;

use glam::Vec3;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::class::ClassId;
use crate::frame::Frame;
use crate::render::post::sun_glare::SunGlare;
use crate::render::resolve::tone::exposure;
use crate::scene::sensor::{Mosaic, Sensor};
use encoding::{SrgbCodes, bayer_channel, demosaic_row, linear_from_srgb};
use fixed_pattern::fixed_pattern;
use noise::{normal, purpose, uniform};
use optics::convolve;

/// Weights of the channels in the signal of a monochrome sensor: even, as of a panchromatic one.
const PANCHROMATIC: [f32; 3] = [1.0 / 3.0; 3];
/// Mean number of electrons from which on Poisson's distribution is approximated by a normal one.
const MIN_NORMAL_MEAN_E: f64 = 40.0;

/// Replaces the 8-bit image of `frame`, whose radiance must be present, by what `sensor` records of it. `exposure_ev` is the
/// exposure of the camera, stops; `sun`, what was taken out of the radiance of a sun in or near the image. Returns the
/// light of each channel in each pixel, glare included, without noise; 1 is the full well.
pub fn expose(frame: &mut Frame, sensor: &Sensor, exposure_ev: f32, sun: Option<&SunGlare>) -> Vec<Vec<f32>> {
    let [width, height] = [frame.width as usize, frame.height as usize];
    let mut channels = spectral_channels(frame, sensor.mosaic);
    let gain = exposure_gain(frame, sensor, &channels, exposure(exposure_ev));
    let falloff = vignetting(width, height, frame.focal_px as f32, sensor);
    for channel in &mut channels {
        add_glare_and_vignetting(channel, &falloff, sensor, gain);
        *channel = convolve(channel, width, height, sensor.psf_px);
    }
    if let Some(sun) = sun {
        let channel_of = |channel: usize, rgb: Vec3| channel_of_rgb(sensor.mosaic, channel, rgb);
        sun.add(&mut channels, channel_of, (gain, &falloff), (sensor.psf_px, sensor.glare));
    }
    let pattern = (sensor.prnu != 0.0 || sensor.dsnu_e != 0.0).then(|| fixed_pattern([width, height]));
    let mut readings = vec![0.0; width * height];
    readings.par_chunks_exact_mut(width).enumerate().for_each(|(y, readings)| {
        for (x, reading) in readings.iter_mut().enumerate() {
            let pixel = y * width + x;
            let channel = if channels.len() == 1 { 0 } else { bayer_channel(x, y) };
            let of_pixel = pattern.as_ref().map_or([0.0; 2], |pattern| pattern[pixel]);
            *reading = read_pixel(sensor, channels[channel][pixel], of_pixel, x, y);
        }
    });
    let (codes, black) = (SrgbCodes::shared(), sensor.black_level as f32);
    let code = |linear: f32| codes.code((linear - black) / (1.0 - black));
    frame.rgb.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| match sensor.mosaic {
        Mosaic::Monochrome => {
            for (rgb, reading) in row.chunks_exact_mut(3).zip(&readings[y * width..]) {
                rgb.fill(code(*reading));
            }
        }
        Mosaic::Bayer => {
            let mut colours = vec![[0.0; 3]; width];
            demosaic_row(&readings, width, height, y, &mut colours);
            for (value, linear) in row.iter_mut().zip(colours.as_flattened()) {
                *value = code(*linear);
            }
        }
    });
    channels
}

/// The radiance of a frame in each channel that the filters of a sensor pass.
fn spectral_channels(frame: &Frame, mosaic: Mosaic) -> Vec<Vec<f32>> {
    let mut radiance = vec![0.0; frame.radiance.len()];
    frame.radiance.convert_to_f32_slice(&mut radiance);
    let channel = |of_rgb: &dyn Fn(&[f32]) -> f32| radiance.chunks_exact(3).map(of_rgb).collect();
    match mosaic {
        Mosaic::Monochrome => vec![channel(&|rgb| (0..3).map(|c| PANCHROMATIC[c] * rgb[c]).sum())],
        Mosaic::Bayer => (0..3).map(|c| channel(&|rgb| rgb[c])).collect(),
    }
}

/// What a channel of [`spectral_channels`] has of a colour.
fn channel_of_rgb(mosaic: Mosaic, channel: usize, rgb: Vec3) -> f32 {
    match mosaic {
        Mosaic::Monochrome => rgb.dot(PANCHROMATIC.into()),
        Mosaic::Bayer => rgb[channel],
    }
}

/// Factor from radiance to the fill of a pixel, where 1 is the full well: the exposure of the camera, or the one that puts the median
/// of the sunlit ground at the chosen level. Ground is sunlit where it is brighter than a tenth of its 90th percentile.
fn exposure_gain(frame: &Frame, sensor: &Sensor, channels: &[Vec<f32>], fixed: f32) -> f32 {
    if sensor.ground_level <= 0.0 {
        return fixed;
    }
    let green = &channels[channels.len() / 2];
    let ground = green.iter().zip(&frame.class).filter(|(_, class)| **class == ClassId::REGOLITH.0);
    let mut values: Vec<f32> = ground.map(|(value, _)| *value).collect();
    if values.is_empty() {
        return fixed;
    }
    let quantile = |values: &mut [f32], rank: usize| *values.select_nth_unstable_by(rank, f32::total_cmp).1;
    let rank = values.len() * 9 / 10;
    let bright = quantile(&mut values, rank);
    values.retain(|value| *value >= 0.1 * bright);
    let rank = values.len() / 2;
    let median = quantile(&mut values, rank);
    if median > 0.0 { linear_from_srgb(sensor.ground_level as f32) / median } else { fixed }
}

/// The part of the light that the vignetting leaves at each pixel, a share of the natural cos^4 falloff.
fn vignetting(width: usize, height: usize, focal_px: f32, sensor: &Sensor) -> Vec<f32> {
    let of_pixel = |x: usize, y: usize| {
        let (dx, dy) = (x as f32 + 0.5 - 0.5 * width as f32, y as f32 + 0.5 - 0.5 * height as f32);
        let cos2 = 1.0 / (1.0 + (dx * dx + dy * dy) / (focal_px * focal_px));
        1.0 - sensor.vignetting as f32 * (1.0 - cos2 * cos2)
    };
    (0..height).flat_map(|y| (0..width).map(move |x| of_pixel(x, y))).collect()
}

/// Adds the veiling glare, an even part of the channel's mean, and applies the gain and the vignetting.
fn add_glare_and_vignetting(channel: &mut [f32], falloff: &[f32], sensor: &Sensor, gain: f32) {
    let mean = channel.iter().map(|value| f64::from(*value)).sum::<f64>() / channel.len() as f64;
    let veil = (sensor.glare * mean) as f32;
    for (value, falloff) in channel.iter_mut().zip(falloff) {
        *value = gain * falloff * (*value + veil);
    }
}

/// The digital reading of a pixel with this fill (1 is the full well) and these numbers of the fixed pattern, as a part of full
/// scale, with the mean dark signal subtracted.
fn read_pixel(sensor: &Sensor, fill: f32, [prnu, dsnu]: [f64; 2], x: usize, y: usize) -> f32 {
    let sensitivity = 1.0 + sensor.prnu * prnu;
    let dark_e = sensor.dark_e + sensor.dsnu_e * dsnu;
    let mean_e = (f64::from(fill) * sensor.full_well_e * sensitivity + dark_e).max(0.0);
    let seed = sensor.noise_seed;
    let collected_e = if mean_e > MIN_NORMAL_MEAN_E {
        mean_e + mean_e.sqrt() * normal(x, y, purpose::SHOT_NORMAL, seed)
    } else {
        poisson(mean_e, x, y, seed)
    };
    let electrons = collected_e.min(sensor.full_well_e + dark_e)
        + sensor.read_noise_e * normal(x, y, purpose::READ, seed);
    let max_code = f64::from((1_u32 << sensor.bits) - 1);
    // The converter spans the dark signal to the full well, with some room below for noise.
    let code =
        ((electrons - dark_e) / sensor.full_well_e * max_code).round().clamp(-0.02 * max_code, max_code);
    (code / max_code) as f32
}

/// A number with Poisson's distribution for a pixel, by inversion of the cumulative distribution.
fn poisson(mean: f64, x: usize, y: usize, seed: u32) -> f64 {
    let mut left = uniform(x, y, purpose::SHOT_POISSON, seed);
    let mut probability = libm::exp(-mean);
    let mut count = 0.0;
    while left > probability && count < 200.0 {
        left -= probability;
        count += 1.0;
        probability *= mean / count;
    }
    count
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::encoding::srgb_from_linear;
    use super::*;

    fn ideal(mosaic: Mosaic) -> Sensor {
        Sensor {
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
            noise_seed: 9,
        }
    }

    /// Mean and variance of the readings at a fill.
    fn readings(sensor: &Sensor, fill: f32) -> (f64, f64) {
        let n = 60_000;
        let values: Vec<f64> =
            (0..n).map(|i| f64::from(read_pixel(sensor, fill, [0.0; 2], i % 300, i / 300))).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        (mean, values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n as f64)
    }

    /// Photon transfer (EMVA 1288, section 2.4): variance over mean is 1 for electrons, and the gain for readings.
    #[test]
    fn photon_transfer_curve_has_the_gain_as_slope_and_the_dark_noise_as_floor() {
        let sensor = Sensor { read_noise_e: 15.0, dark_e: 30.0, ..ideal(Mosaic::Monochrome) };
        let points: Vec<(f64, f64)> =
            [0.001, 0.01, 0.1, 0.2, 0.4, 0.6].map(|fill| readings(&sensor, fill)).into();
        let n = points.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
        let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
        let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
            / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
        assert!((slope * 20_000.0 - 1.0).abs() < 0.03, "gain {}", slope * 20_000.0);
        let (dark_mean, dark_variance) = readings(&sensor, 0.0);
        let floor_e = dark_variance.sqrt() * 20_000.0;
        assert!(dark_mean.abs() < 1e-4, "{dark_mean}");
        // Read noise, shot noise of the dark signal, and quantisation noise.
        let expected = (15.0_f64.powi(2) + 30.0 + (20_000.0 / 16_383.0_f64).powi(2) / 12.0).sqrt();
        assert!((floor_e / expected - 1.0).abs() < 0.03, "{floor_e} for {expected}");
    }

    #[test]
    fn few_electrons_have_the_mean_and_variance_of_poisson() {
        for mean in [0.5, 3.0, 20.0, 39.0] {
            let counts: Vec<f64> = (0..40_000).map(|i| poisson(mean, i % 200, i / 200, 4)).collect();
            let found = counts.iter().sum::<f64>() / counts.len() as f64;
            let variance =
                counts.iter().map(|count| (count - found).powi(2)).sum::<f64>() / counts.len() as f64;
            assert!((found / mean - 1.0).abs() < 0.02 && (variance / mean - 1.0).abs() < 0.04, "{mean}");
        }
    }

    fn frame(width: u32, height: u32, radiance: impl Fn(u32, u32) -> [f32; 3]) -> Frame {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Frame {
            width,
            height,
            focal_px: 100.0,
            rgb: vec![0; (3 * width * height) as usize],
            class: vec![ClassId::REGOLITH.0; (width * height) as usize],
            radiance: pixels.flat_map(|(x, y)| radiance(x, y)).map(half::f16::from_f32).collect(),
            ..Default::default()
        }
    }

    #[test]
    fn an_ideal_sensor_records_the_radiance() {
        let sensor = Sensor { full_well_e: 1e9, ..ideal(Mosaic::Bayer) };
        let mut even = frame(32, 32, |_, _| [0.4, 0.2, 0.1]);
        expose(&mut even, &sensor, 0.0, None);
        let expected = [0.4, 0.2, 0.1].map(|value| (255.0 * srgb_from_linear(value) + 0.5) as u8);
        for rgb in even.rgb.chunks_exact(3) {
            assert!(
                rgb.iter().zip(expected).all(|(value, expected)| value.abs_diff(expected) <= 1),
                "{rgb:?}"
            );
        }
        let mut grey = frame(32, 32, |_, _| [0.3, 0.3, 0.3]);
        expose(&mut grey, &Sensor { mosaic: Mosaic::Monochrome, ..sensor }, 1.0, None);
        assert!(grey.rgb.chunks_exact(3).all(|rgb| rgb[0] == rgb[1] && rgb[1] == rgb[2]));
        assert!(grey.rgb[0].abs_diff((255.0 * srgb_from_linear(0.6) + 0.5) as u8) <= 1);
    }

    #[test]
    fn demosaicing_colours_edges_and_only_edges() {
        let sensor = Sensor { full_well_e: 1e9, ..ideal(Mosaic::Bayer) };
        let mut edge = frame(40, 40, |x, _| if x < 20 { [0.05; 3] } else { [0.6; 3] });
        expose(&mut edge, &sensor, 0.0, None);
        let colour = |x: u32| {
            let rgb = &edge.rgb[(3 * (20 * 40 + x)) as usize..][..3];
            i32::from(rgb[0]) - i32::from(rgb[2])
        };
        assert!((18..22).any(|x| colour(x).abs() > 10), "an edge shows the mosaic");
        assert!((3..17).chain(23..37).all(|x| colour(x).abs() <= 1));
        // Standard deviation of red less green, which is 0 for grey light on a sensor without a mosaic.
        let deviation = |frame: &Frame, columns: std::ops::Range<usize>| {
            let pixels = (4..36).flat_map(|y| columns.clone().map(move |x| 3 * (y * 40 + x)));
            let values: Vec<f64> =
                pixels.map(|at| f64::from(frame.rgb[at]) - f64::from(frame.rgb[at + 1])).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
        };
        assert!(deviation(&edge, 18..22) > 3.0, "{}", deviation(&edge, 18..22));
        assert!(deviation(&edge, 3..17) < 0.5, "{}", deviation(&edge, 3..17));
        expose(&mut edge, &Sensor { mosaic: Mosaic::Monochrome, ..sensor }, 0.0, None);
        assert_eq!(deviation(&edge, 0..40), 0.0);
    }

    /// The modulation transfer at each of these frequencies, cycles a pixel, by the slanted edge method (ISO 12233). The edge is sampled
    /// as the renderer samples it, with `samples` along a side of a pixel.
    fn slanted_edge_mtf(sigma_px: f64, samples: u32, frequencies: &[f64]) -> Vec<f64> {
        const SIDE: usize = 128;
        const BINS_PER_PX: f64 = 8.0;
        let (sin, cos) = 0.09_f64.sin_cos();
        let distance = |x: f64, y: f64| (x - 64.0) * cos + (y - 64.0) * sin;
        let offsets =
            || (0..samples).map(|i| (f64::from(i) + 0.5) / f64::from(samples)).collect::<Vec<f64>>();
        let plane: Vec<f32> = (0..SIDE * SIDE)
            .map(|pixel| {
                let (x, y) = ((pixel % SIDE) as f64, (pixel / SIDE) as f64);
                let positions =
                    offsets().into_iter().flat_map(|v| offsets().into_iter().map(move |u| (u, v)));
                let bright = positions.filter(|(u, v)| distance(x + u, y + v) > 0.0).count();
                bright as f32 / (samples * samples) as f32
            })
            .collect();
        let blurred = convolve(&plane, SIDE, SIDE, sigma_px);
        // The edge spread function in bins of an eighth of a pixel, and its derivative, the line spread function.
        let mut bins = vec![(0.0, 0.0); (16.0 * BINS_PER_PX) as usize];
        for (pixel, value) in blurred.iter().enumerate() {
            let (x, y) = (pixel % SIDE, pixel / SIDE);
            let at = (distance(x as f64 + 0.5, y as f64 + 0.5) + 8.0) * BINS_PER_PX;
            if (0.0..bins.len() as f64).contains(&at) && (20..108).contains(&y) {
                bins[at as usize].0 += f64::from(*value);
                bins[at as usize].1 += 1.0;
            }
        }
        let edge: Vec<f64> = bins.iter().map(|(sum, n)| sum / n).collect();
        let line: Vec<f64> = edge.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let amplitude = |f: f64| {
            let (mut re, mut im) = (0.0, 0.0);
            for (i, value) in line.iter().enumerate() {
                let angle = std::f64::consts::TAU * f * i as f64 / BINS_PER_PX;
                (re, im) = (re + value * angle.cos(), im - value * angle.sin());
            }
            re.hypot(im)
        };
        frequencies.iter().map(|f| amplitude(*f) / amplitude(0.0)).collect()
    }

    /// The PCAM of Chang'e-3 keeps a contrast of 0.33 at Nyquist's frequency, as a standard deviation of 0.47 px does: 0.30 to 0.35.
    #[test]
    fn modulation_transfer_is_that_of_the_gaussian() {
        for sigma_px in [0.4, 0.47, 0.7] {
            let gaussian = |f: f64| (-2.0 * (std::f64::consts::PI * sigma_px * f).powi(2)).exp();
            let frequencies: Vec<f64> = (0..=50).map(|k| f64::from(k) / 100.0).collect();
            let found = slanted_edge_mtf(sigma_px, 2, &frequencies);
            for (f, contrast) in frequencies.iter().zip(&found) {
                assert!((contrast - gaussian(*f)).abs() < 0.02, "{sigma_px} px, {f}: {contrast}");
            }
            // MTF50 of a Gaussian: sqrt(ln 2 / 2) / (pi sigma).
            let half = (0.5 * 2.0_f64.ln()).sqrt() / (std::f64::consts::PI * sigma_px);
            let crossed = found.iter().position(|contrast| *contrast < 0.5).expect("a contrast below a half");
            let (before, after) = (found[crossed - 1], found[crossed]);
            let mtf50 = frequencies[crossed - 1] + 0.01 * (before - 0.5) / (before - after);
            assert!((mtf50 / half - 1.0).abs() < 0.03, "{sigma_px} px: {mtf50}, not {half}");
        }
        for samples in [2, 4] {
            let contrast = slanted_edge_mtf(0.47, samples, &[0.5])[0];
            assert!((0.30..=0.35).contains(&contrast), "{samples} samples: {contrast}");
        }
    }

    #[test]
    fn optics_spread_veil_and_vignette_the_light() {
        let sensor = Sensor { full_well_e: 1e9, psf_px: 1.0, ..ideal(Mosaic::Monochrome) };
        let mut plane = vec![0.0; 31 * 31];
        plane[15 * 31 + 15] = 1.0;
        let spread = convolve(&plane, 31, 31, sensor.psf_px);
        assert!((spread.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        // 1 / (2 pi sigma^2), less the pixel's own variance.
        assert!((spread[15 * 31 + 15] - 0.170).abs() < 0.003, "{}", spread[15 * 31 + 15]);
        let mut veiled = frame(20, 20, |x, _| if x < 10 { [0.0; 3] } else { [0.5; 3] });
        expose(&mut veiled, &Sensor { psf_px: 0.0, glare: 0.02, ..sensor }, 0.0, None);
        // 2 % of the mean of 0.25.
        assert_eq!(veiled.rgb[0], (255.0 * srgb_from_linear(0.005) + 0.5) as u8);
        let mut even = frame(101, 101, |_, _| [0.5; 3]);
        expose(&mut even, &Sensor { psf_px: 0.0, vignetting: 1.0, ..sensor }, 0.0, None);
        let cos2 = 1.0 / (1.0 + 2.0 * 50.0_f32.powi(2) / 100.0_f32.powi(2));
        assert!(even.rgb[0].abs_diff((255.0 * srgb_from_linear(0.5 * cos2 * cos2) + 0.5) as u8) <= 1);
    }

    #[test]
    fn auto_exposure_puts_the_sunlit_ground_at_its_level() {
        let sensor = Sensor { ground_level: 0.45, full_well_e: 1e9, ..ideal(Mosaic::Monochrome) };
        let mut scene = frame(40, 40, |x, y| [0.001 + 0.0004 * (x * y % 40) as f32; 3]);
        expose(&mut scene, &sensor, 0.0, None);
        let mut values: Vec<u8> =
            scene.rgb.chunks_exact(3).map(|rgb| rgb[0]).filter(|value| *value > 30).collect();
        values.sort_unstable();
        assert!(values[values.len() / 2].abs_diff(115) < 12, "{}", values[values.len() / 2]);
    }
}
