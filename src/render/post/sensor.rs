//! The camera's optics and sensor: from the linear radiance of a frame to the 8-bit image of a real camera.
//!
//! In the order of the light: exposure, veiling glare, vignetting, halation; then at the resolution of the sensor point spread function,
//! colour filter array, grain, shot noise, read noise, quantisation, demosaicing, black level, encoding; then the reduction to the image,
//! its contrast stretch and its compression. The sensor is the linear model of EMVA 1288 (release 4.0), with PRNU and DSNU as its fixed
//! pattern. Labels are not affected: nothing here moves anything in the image.
//! Every random number is a hash of pixel and frame, so that the same frame is the same to the bit for any number of threads.
//! Must not know: wgpu.

mod demosaic;
mod encoding;
mod film;
mod histogram;
mod jpeg;
mod metering;
mod noise;
mod optics;
mod readout;
mod recorder;
mod resampling;
mod stretch;

use std::borrow::Cow;

use glam::{Vec2, Vec3};
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::frame::Frame;
use crate::render::post::image_rays::ImageRays;
use crate::render::post::sun_glare::SunGlare;
use crate::scene::sensor::{Mosaic, Sensor};
use metering::exposure_gain;
use optics::aperture_variance;
pub(super) use optics::gaussian_blur;
use recorder::Recorder;

/// Weights of the channels in the signal of a monochrome sensor: even, as of a panchromatic one.
const PANCHROMATIC: [f32; 3] = [1.0 / 3.0; 3];

/// Fill at which light is cut off where the sun is in the image, 1 for the full well: its radiance would make the negative side lobes
/// of the point spread function visible as black rings.
const MAX_FILL: f32 = 4.0;

/// What a sensor got of a frame, and what the image shows of it.
#[derive(Clone, Debug)]
pub struct Exposure {
    /// The light of each channel in each pixel of the image, glare included, before point spread and noise; 1 is the full well.
    pub light: Vec<Vec<f32>>,
    /// The part of it that comes from the sun without the scene: what the lens scatters, ghosts and the disc. Empty without them.
    pub stray: Vec<Vec<f32>>,
    /// What the 8 bits of the image are of it.
    pub codes: CodeRange,
    /// Factor from radiance to light, 1 at 0 EV.
    pub gain: f32,
}

/// The light of the 8-bit codes of an image.
#[derive(Clone, Copy, Debug)]
pub struct CodeRange {
    /// The light that becomes black, and the light that becomes white; at most 1, the full well.
    pub light: [f32; 2],
    /// A step of the codes in the sRGB encoding of the light, 1 for white: 1/255 without a contrast stretch.
    pub step: f32,
}

/// Replaces the 8-bit image of `frame`, whose radiance must be present, by what `sensor` records of it. `exposure_ev` is the
/// exposure of the camera, stops; `sun`, what was taken out of the radiance of a sun in or near the image.
pub fn expose(frame: &mut Frame, sensor: &Sensor, exposure_ev: f32, sun: Option<&SunGlare>) -> Exposure {
    let size @ [width, height] = [frame.width as usize, frame.height as usize];
    let samples_per_side = frame.samples.isqrt();
    let mut channels = spectral_channels(frame, sensor.mosaic);
    channels.par_iter_mut().for_each(|channel| add_veil(channel, sensor.glare));
    let channel_of = |channel: usize, rgb: Vec3| channel_of_rgb(sensor.mosaic, channel, rgb);
    let mut stray = sun.map_or_else(Vec::new, |sun| {
        let mut stray = vec![vec![0.0; width * height]; channels.len()];
        sun.add_stray_light(&mut stray, channel_of, sensor.glare);
        stray
    });
    for (channel, stray) in channels.iter_mut().zip(&stray) {
        channel.iter_mut().zip(stray).for_each(|(value, stray)| *value += stray);
    }
    let falloff = vignetting(frame, sensor, sun);
    // What the sun veils is metered, its disc is not.
    let green = channels.len() / 2;
    let metered: Vec<f32> =
        channels[green].iter().zip(&falloff).map(|(value, falloff)| falloff * value).collect();
    let gain = exposure_gain(frame, sensor, (&metered, sun.is_some()), exposure_ev);
    for channel in channels.iter_mut().chain(&mut stray) {
        channel.iter_mut().zip(&falloff).for_each(|(value, falloff)| *value *= gain * falloff);
    }
    if let Some(sun) = sun {
        let psf_px = sensor.psf_px / sensor.pixels_per_side(frame.width);
        let sigma_px = (psf_px * psf_px - aperture_variance(samples_per_side)).max(0.0).sqrt();
        for channels in [&mut channels, &mut stray] {
            sun.add_disc(channels, channel_of, (gain, &falloff), (sigma_px, sensor.glare));
            channels.iter_mut().flatten().for_each(|value| *value = value.min(MAX_FILL));
        }
    }
    if sensor.halation > 0.0 {
        let channels = channels.iter_mut().chain(&mut stray);
        channels.for_each(|channel| film::add_halation(channel, size, sensor.halation));
    }
    let codes = record((&mut frame.rgb, &frame.class), sensor, (&channels, samples_per_side), size);
    if sensor.jpeg_quality > 0 {
        jpeg::compress(&mut frame.rgb, size, sensor.jpeg_quality);
    }
    Exposure { light: channels, stray, codes, gain }
}

/// Writes the 8-bit image of `size` columns and rows that a sensor makes of the light of its channels. Returns what its codes are.
fn record(
    (rgb, classes): (&mut [u8], &[u8]),
    sensor: &Sensor,
    (channels, samples_per_side): (&[Vec<f32>], u32),
    size @ [width, _]: [usize; 2],
) -> CodeRange {
    let recorder = Recorder::new(sensor, samples_per_side, channels, size);
    let rows = recorder.band_rows();
    let band_len = 3 * width * rows;
    let [black, white] = if sensor.stretch > 0.0 {
        let mut levels = vec![0; rgb.len()];
        let bands = levels.par_chunks_mut(band_len).enumerate();
        bands.for_each(|(band, levels)| recorder.record(band * rows, levels, stretch::fine_level));
        stretch::stretch(&levels, classes, sensor.stretch, rgb)
    } else {
        let bands = rgb.par_chunks_mut(band_len).enumerate();
        bands.for_each(|(band, rgb)| recorder.record(band * rows, rgb, |value| (value + 0.5) as u8));
        [0.0, 1.0]
    };
    CodeRange {
        light: [black, white].map(|encoded| recorder.light_of(encoded)),
        step: (white - black) / 255.0,
    }
}

/// The radiance of a frame in each channel that the filters of a sensor pass.
fn spectral_channels(frame: &Frame, mosaic: Mosaic) -> Vec<Vec<f32>> {
    let mut radiance = vec![0.0; frame.radiance.len()];
    frame.radiance.convert_to_f32_slice(&mut radiance);
    let pixels = radiance.as_chunks::<3>().0;
    match mosaic {
        Mosaic::Monochrome => {
            let [red, green, blue] = PANCHROMATIC;
            vec![pixels.iter().map(|[r, g, b]| red * r + green * g + blue * b).collect()]
        }
        Mosaic::Bayer => (0..3).map(|channel| pixels.iter().map(|rgb| rgb[channel]).collect()).collect(),
    }
}

/// What a channel of [`spectral_channels`] has of a colour.
fn channel_of_rgb(mosaic: Mosaic, channel: usize, rgb: Vec3) -> f32 {
    match mosaic {
        Mosaic::Monochrome => rgb.dot(PANCHROMATIC.into()),
        Mosaic::Bayer => rgb[channel],
    }
}

/// The part of the light that the vignetting leaves at each pixel, a share of the natural cos^4 falloff with the angle of its ray.
fn vignetting(frame: &Frame, sensor: &Sensor, sun: Option<&SunGlare>) -> Vec<f32> {
    let part = sensor.vignetting as f32;
    let width = frame.width as usize;
    let mut falloff = vec![1.0; width * frame.height as usize];
    if part > 0.0 {
        let rays = sun.map_or_else(|| Cow::Owned(ImageRays::new(frame)), |sun| Cow::Borrowed(&sun.rays));
        let mut of_row = vec![Vec2::ZERO; width];
        for (y, row) in falloff.chunks_exact_mut(width).enumerate() {
            rays.row(y, &mut of_row);
            for (value, ray) in row.iter_mut().zip(&of_row) {
                let cos2 = 1.0 / (1.0 + ray.length_squared());
                *value = 1.0 - part * (1.0 - cos2 * cos2);
            }
        }
    }
    falloff
}

/// Spreads the part of a channel's light that is veiling glare evenly over the image.
fn add_veil(channel: &mut [f32], part: f64) {
    let mean = channel.iter().map(|value| f64::from(*value)).sum::<f64>() / channel.len() as f64;
    let (veil, direct) = ((part * mean) as f32, (1.0 - part) as f32);
    channel.iter_mut().for_each(|value| *value = direct * *value + veil);
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::encoding::srgb_from_linear;
    use super::optics::{convolve, psf_taps};
    use super::*;
    use crate::class::ClassId;

    fn frame(width: u32, height: u32, radiance: impl Fn(u32, u32) -> [f32; 3]) -> Frame {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Frame {
            width,
            height,
            focal_px: 100.0,
            samples: 4,
            rgb: vec![0; (3 * width * height) as usize],
            class: vec![ClassId::REGOLITH.0; (width * height) as usize],
            radiance: pixels.flat_map(|(x, y)| radiance(x, y)).map(half::f16::from_f32).collect(),
            ..Default::default()
        }
    }

    #[test]
    fn an_ideal_sensor_records_the_radiance() {
        let sensor = Sensor { full_well_e: 1e9, ..Sensor::ideal(Mosaic::Bayer) };
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
        let sensor = Sensor { full_well_e: 1e9, ..Sensor::ideal(Mosaic::Bayer) };
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
        assert!(deviation(&edge, 18..22) > 2.0, "{}", deviation(&edge, 18..22));
        assert!(deviation(&edge, 3..17) < 0.5, "{}", deviation(&edge, 3..17));
        expose(&mut edge, &Sensor { mosaic: Mosaic::Monochrome, ..sensor }, 0.0, None);
        assert_eq!(deviation(&edge, 0..40), 0.0);
    }

    /// A grey chart with edges at 5 degrees, along rows and columns.
    fn edge_chart(side: u32) -> Frame {
        frame(side, side, |x, y| {
            let along = |a: u32, b: u32| (f64::from(a) + 0.087 * f64::from(b)).rem_euclid(24.0) < 12.0;
            [if along(x, y) == along(y, x) { 0.05 } else { 0.5 }; 3]
        })
    }

    /// Root mean square of red less green and blue less green over a chart: what is left of a grey scene as colour.
    fn chroma(frame: &Frame) -> f64 {
        let differences = frame
            .rgb
            .chunks_exact(3)
            .flat_map(|rgb| [0, 2].map(|channel| (f64::from(rgb[channel]) - f64::from(rgb[1])).powi(2)));
        (differences.sum::<f64>() / (2 * frame.class.len()) as f64).sqrt()
    }

    /// A camera's image that is reduced from 2352 columns has hardly any fringes: below 2.5 of 255 (root mean square), noise included.
    #[test]
    fn fringes_of_a_reduced_image_are_below_a_stated_bound() {
        let camera = Sensor {
            psf_px: 0.47,
            full_well_e: 25_000.0,
            read_noise_e: 21.0,
            bits: 10,
            ..Sensor::ideal(Mosaic::Bayer)
        };
        let mut chart = edge_chart(128);
        let mut at = |width_px| {
            expose(&mut chart, &Sensor { width_px, ..camera }, 0.0, None);
            chroma(&chart)
        };
        let [own, twice, pcam] = [0, 256, 588].map(&mut at);
        assert!(own < 16.0, "the sensor of the image's own resolution: {own}");
        assert!(twice < 0.65 * own && pcam < 2.5, "{own}, {twice}, {pcam}");
    }

    #[test]
    fn a_sensor_of_more_pixels_has_less_noise_and_the_same_light() {
        let sensor = Sensor { read_noise_e: 40.0, full_well_e: 4000.0, ..Sensor::ideal(Mosaic::Monochrome) };
        let moments = |sensor: &Sensor| {
            let mut even = frame(96, 80, |_, _| [0.2; 3]);
            expose(&mut even, sensor, 0.0, None);
            let values: Vec<f64> = even.rgb.chunks_exact(3).map(|rgb| f64::from(rgb[0])).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
        };
        // Codes per linear unit at 0.2: 255 * 1.055 / 2.4 * 0.2^(1 / 2.4 - 1).
        let slope = 255.0 * 1.055 / 2.4 * 0.2_f64.powf(1.0 / 2.4 - 1.0);
        for (width_px, pixels) in [(0, 1.0), (192, 4.0), (288, 9.0)] {
            let (mean, deviation) = moments(&Sensor { width_px, ..sensor });
            assert!((mean - 123.5).abs() < 1.0, "{width_px}: {mean}");
            let expected = (slope * sensor.noise_of(0.2, pixels)).hypot(12.0_f64.powf(-0.5));
            assert!((deviation / expected - 1.0).abs() < 0.06, "{width_px}: {deviation} for {expected}");
        }
        // Sizes that are no multiples, and a sensor of fewer pixels than the image.
        for width_px in [237, 61] {
            let (mean, _) = moments(&Sensor { width_px, ..sensor });
            assert!((mean - 123.5).abs() < 1.0, "{width_px}: {mean}");
        }
    }

    /// Bands of rows have the bits of the whole.
    #[test]
    fn bands_make_the_image() {
        for (mosaic, width_px) in [(Mosaic::Bayer, 0), (Mosaic::Bayer, 150), (Mosaic::Monochrome, 97)] {
            let sensor =
                Sensor { width_px, psf_px: 0.6, read_noise_e: 9.0, prnu: 0.01, ..Sensor::ideal(mosaic) };
            let channels = spectral_channels(&edge_chart(60), mosaic);
            let recorder = Recorder::new(&sensor, 2, &channels, [60, 60]);
            let [mut whole, mut bands] = [(); 2].map(|()| vec![0; 3 * 60 * 60]);
            recorder.record(0, &mut whole, stretch::fine_level);
            for (band, rgb) in bands.chunks_mut(3 * 60 * 7).enumerate() {
                recorder.record(band * 7, rgb, stretch::fine_level);
            }
            assert!(whole == bands, "{mosaic:?}, {width_px}");
        }
    }

    /// A sliver of sunlit ground neither saturates nor sets the exposure, and nothing is exposed longer than allowed.
    #[test]
    fn metering_keeps_to_the_full_well_and_the_longest_exposure() {
        let sensor = Sensor { ground_level: 0.45, full_well_e: 1e9, ..Sensor::ideal(Mosaic::Monochrome) };
        let clipped = |sunlit_rows: u32, dark: f32| {
            let mut scene = frame(50, 50, |_, y| if y < sunlit_rows { [0.3; 3] } else { [dark; 3] });
            expose(&mut scene, &sensor, 0.0, None);
            let of = |row: usize| scene.rgb[3 * 50 * row];
            (of(0), of(49))
        };
        let (sunlit, dark) = clipped(3, 0.003);
        assert!(sunlit < 130 && dark < 15, "6 % of the image: {sunlit}, {dark}");
        // Shadow that the longest exposure, 16 times the fixed one, leaves dark.
        let (_, dark) = clipped(0, 0.001);
        let expected = 255.0 * srgb_from_linear(0.016);
        assert!((f32::from(dark) - expected).abs() < 1.5, "{dark} for {expected}");
        // Bright rocks on dark ground.
        let mut rocks = frame(50, 50, |x, _| if x < 10 { [0.6; 3] } else { [0.07; 3] });
        rocks.class.iter_mut().enumerate().for_each(|(at, class)| *class = u8::from(at % 50 < 10));
        expose(&mut rocks, &sensor, 0.0, None);
        let white = rocks.rgb.chunks_exact(3).filter(|rgb| rgb[0] >= 254).count();
        assert!(white < 2500 / 50, "{white} of 2500 saturate");
    }

    #[test]
    fn halation_adds_a_halo_and_no_light() {
        let film = Sensor { halation: 0.05, ..Sensor::ideal(Mosaic::Monochrome) };
        let bright =
            |x: u32, y: u32| if x.abs_diff(150) < 3 && y.abs_diff(20) < 3 { [0.9; 3] } else { [0.0; 3] };
        let [mut with, mut without] = [(); 2].map(|()| frame(300, 40, bright));
        expose(&mut with, &film, 0.0, None);
        expose(&mut without, &Sensor { halation: 0.0, ..film }, 0.0, None);
        let at = |frame: &Frame, x: usize| frame.rgb[3 * (20 * 300 + x)];
        assert!(at(&with, 147) > at(&without, 147) + 20, "a halo");
        assert_eq!(at(&with, 130), at(&without, 130), "which ends");
        assert!(at(&with, 150) <= at(&without, 150), "which is taken from the highlight");
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
        let blurred = convolve(&plane, SIDE, SIDE, &psf_taps(sigma_px, samples));
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
        // The Gaussian has 0.336. The fewer samples, the more of it is left to the kernel, whose last taps are cut off.
        for (samples, bound) in [(1, 0.035), (2, 0.015), (4, 0.021)] {
            let contrast = slanted_edge_mtf(0.47, samples, &[0.5])[0];
            assert!((contrast - 0.336).abs() < bound, "{samples} samples: {contrast}");
        }
    }

    #[test]
    fn optics_spread_veil_and_vignette_the_light() {
        let sensor = Sensor { full_well_e: 1e9, psf_px: 1.0, ..Sensor::ideal(Mosaic::Monochrome) };
        let mut plane = vec![0.0; 31 * 31];
        plane[15 * 31 + 15] = 1.0;
        let spread = convolve(&plane, 31, 31, &psf_taps(sensor.psf_px, 2));
        assert!((spread.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        // 1 / (2 pi sigma^2), less the pixel's own variance.
        assert!((spread[15 * 31 + 15] - 0.170).abs() < 0.003, "{}", spread[15 * 31 + 15]);
        let mut veiled = frame(20, 20, |x, _| if x < 10 { [0.0; 3] } else { [0.5; 3] });
        expose(&mut veiled, &Sensor { psf_px: 0.0, glare: 0.02, ..sensor }, 0.0, None);
        // 2 % of the mean of 0.25.
        assert_eq!(veiled.rgb[0], (255.0 * srgb_from_linear(0.005) + 0.5) as u8);
        let mut even = frame(101, 101, |_, _| [0.5; 3]);
        let vignetting = Sensor { psf_px: 0.0, vignetting: 1.0, ..sensor };
        expose(&mut even, &vignetting, 0.0, None);
        let code = |tan2: f32| (255.0 * srgb_from_linear(0.5 / (1.0 + tan2).powi(2)) + 0.5) as u8;
        assert!(even.rgb[0].abs_diff(code(2.0 * 50.0_f32.powi(2) / 100.0_f32.powi(2))) <= 1);
        // Through a lens that shows at 0.5 what stands at 0.6: 0.6 (1 + k1 0.36) = 0.5.
        even.lens.k1 = (0.5 / 0.6 - 1.0) / 0.36;
        expose(&mut even, &vignetting, 0.0, None);
        let at_the_side = even.rgb[3 * 50 * 101];
        assert!(at_the_side.abs_diff(code(0.36)) <= 1, "{at_the_side}, not {}", code(0.36));
    }

    #[test]
    fn auto_exposure_puts_the_sunlit_ground_at_its_level() {
        let sensor = Sensor {
            ground_level: 0.45,
            gain_max_ev: 8.0,
            full_well_e: 1e9,
            ..Sensor::ideal(Mosaic::Monochrome)
        };
        let mut scene = frame(40, 40, |x, y| [0.001 + 0.0004 * (x * y % 40) as f32; 3]);
        for sensor in [sensor, Sensor { vignetting: 1.0, glare: 0.05, ..sensor }] {
            expose(&mut scene, &sensor, 0.0, None);
            let mut values: Vec<u8> =
                scene.rgb.chunks_exact(3).map(|rgb| rgb[0]).filter(|value| *value > 30).collect();
            values.sort_unstable();
            assert!(values[values.len() / 2].abs_diff(115) < 12, "{}", values[values.len() / 2]);
        }
    }
}
