//! The label rule, applied to a finished image: rocks that are too small, and rocks that nobody can see.
//!
//! A rock is compared with its surroundings in the signal that the sensor would record without noise: electrons, between black level
//! and full well, behind the point spread function. Without a sensor the signal is the 8-bit image. A rock is unseen if
//!
//! * the root of the sum of squares of the differences in mean and in standard deviation between its pixels and those around it is
//!   below a number of standard deviations of the noise of a pixel, by default 3, the limit of detection (Currie 1968), or
//! * the mean of its signal above that of the darkest pixel of the image is below the same number of standard deviations of the noise
//!   in the dark: a rock in shadow, whose outline cannot be distinguished from the shadow's.
//!
//! Each rock is summed by itself in the order of its pixels, so that no number depends on threads.
//! Must not know: how rocks were drawn.

use rayon::prelude::*;

use crate::class::ClassId;
use crate::frame::{Frame, LabelReason};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::label_rule::{LabelPolicy, LabelRule};
use crate::scene::sensor::Sensor;

/// Width of the surroundings that a rock is compared with, pixels.
const RING_PX: usize = 3;
/// Largest value, in means of the image, that counts as dark.
const MAX_DARK: f64 = 0.1;
/// Fewest pixels of surroundings without rocks; with fewer, other rocks are part of the surroundings.
const MIN_RING_PX: f64 = 4.0;

/// Applies the label rule to the class, the instances and the rock labels of a frame with instances. `scene` and `drawn` are those
/// that were drawn; `light` is that of each of the sensor's channels, as `sensor::expose` returns it.
pub(crate) fn apply(scene: &Scene, drawn: &RenderSettings, frame: &mut Frame, light: &[Vec<f32>]) {
    let rule = &scene.label_rule;
    let regions = Region::all(frame);
    let signal = (rule.unseen != LabelPolicy::Rock).then(|| Signal::new(frame, scene.sensor.as_ref(), light));
    let focal_px = scene.camera.focal_px(drawn.size[0]) as f32;
    let reason = |region: &Region| {
        let rock = &scene.rocks[usize::from(region.instance) - 1];
        // Below the ground or behind others, most of a rock can be out of view.
        let is_large = || {
            region.pixels as f32 >= rule.min_pixels && rule.is_large_enough(rock, scene.camera.eye, focal_px)
        };
        match &signal {
            // What becomes regolith was drawn as such.
            _ if rule.too_small == LabelPolicy::Ignore && !is_large() => LabelReason::TooSmall,
            Some(signal) if signal.hides(frame, region, rule.unseen_contrast) => LabelReason::Unseen,
            _ => LabelReason::Rock,
        }
    };
    let reasons: Vec<(u16, LabelReason)> =
        regions.par_iter().map(|region| (region.instance, reason(region))).collect();
    let mut reason_of = vec![LabelReason::Rock; usize::from(u16::MAX) + 1];
    for &(instance, reason) in &reasons {
        reason_of[usize::from(instance)] = reason;
    }
    relabel(frame, rule, &reason_of);
}

/// Writes the reason of each rock, by its instance id, and what the rule makes of its pixels.
fn relabel(frame: &mut Frame, rule: &LabelRule, reason_of: &[LabelReason]) {
    let becomes_ground =
        |reason: LabelReason| reason == LabelReason::Unseen && rule.unseen == LabelPolicy::Regolith;
    for (class, instance) in frame.class.iter_mut().zip(&mut frame.instances) {
        let reason = reason_of[usize::from(*instance)];
        if reason == LabelReason::Rock {
            continue;
        }
        let counts = &mut frame.label_pixels;
        *(if reason == LabelReason::TooSmall { &mut counts.too_small } else { &mut counts.unseen }) += 1;
        if becomes_ground(reason) {
            (*class, *instance) = (ClassId::REGOLITH.0, 0);
        } else {
            *class = ClassId::UNLABELLED.0;
            counts.ignored += 1;
        }
    }
    for rock in &mut frame.rocks {
        rock.reason = reason_of[usize::from(rock.instance)];
    }
    frame.rocks.retain(|rock| !becomes_ground(rock.reason));
}

/// The pixels of a rock.
struct Region {
    instance: u16,
    pixels: u64,
    /// First and last column and row.
    columns: [usize; 2],
    rows: [usize; 2],
}

impl Region {
    /// The regions of a frame, by instance id.
    fn all(frame: &Frame) -> Vec<Self> {
        let mut regions: Vec<Option<Self>> = Vec::new();
        for (y, row) in frame.instances.chunks_exact(frame.width as usize).enumerate() {
            for (x, &instance) in row.iter().enumerate().filter(|(_, instance)| **instance > 0) {
                let index = usize::from(instance);
                if regions.len() <= index {
                    regions.resize_with(index + 1, || None);
                }
                let new = || Self { instance, pixels: 0, columns: [x, x], rows: [y, y] };
                let region = regions[index].get_or_insert_with(new);
                region.pixels += 1;
                region.columns = [region.columns[0].min(x), region.columns[1].max(x)];
                region.rows[1] = y;
            }
        }
        regions.into_iter().flatten().collect()
    }

    /// Calls `inside` with each pixel of the rock, and `around` with each one within [`RING_PX`] columns and rows of one.
    fn for_each_pixel(&self, frame: &Frame, mut inside: impl FnMut(usize), mut around: impl FnMut(usize)) {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let (left, top) = (self.columns[0].saturating_sub(RING_PX), self.rows[0].saturating_sub(RING_PX));
        let (right, bottom) =
            ((self.columns[1] + RING_PX + 1).min(width), (self.rows[1] + RING_PX + 1).min(height));
        let columns = right - left;
        let is_rock = |x: usize, y: usize| frame.instances[y * width + x] == self.instance;
        // The last row, from the top, that has the rock within RING_PX columns of each column.
        let near_in_row = |y: usize| {
            let mut near = vec![false; columns];
            for x in (left..right).filter(|&x| is_rock(x, y)) {
                let (first, last) = (x.saturating_sub(RING_PX).max(left), (x + RING_PX + 1).min(right));
                near[first - left..last - left].fill(true);
            }
            near
        };
        let rows: Vec<Vec<bool>> = (top..bottom).map(near_in_row).collect();
        for y in top..bottom {
            let nearby = &rows[(y - top).saturating_sub(RING_PX)..(y - top + RING_PX + 1).min(rows.len())];
            for x in left..right {
                if is_rock(x, y) {
                    inside(y * width + x);
                } else if nearby.iter().any(|row| row[x - left]) {
                    around(y * width + x);
                }
            }
        }
    }
}

/// Number, sum and sum of squares of values.
#[derive(Clone, Copy, Default)]
struct Moments([f64; 3]);

impl Moments {
    fn add(&mut self, value: f64) {
        let Self([count, sum, squares]) = self;
        (*count, *sum, *squares) = (*count + 1.0, *sum + value, *squares + value * value);
    }

    const fn count(&self) -> f64 {
        self.0[0]
    }

    fn mean(&self) -> f64 {
        self.0[1] / self.0[0].max(1.0)
    }

    fn deviation(&self) -> f64 {
        (self.0[2] / self.0[0].max(1.0) - self.mean() * self.mean()).max(0.0).sqrt()
    }
}

/// What the sensor records without noise.
struct Signal<'a> {
    /// Of each pixel: electrons, the mean of the channels; without a sensor 8-bit values.
    values: Vec<f32>,
    sensor: Option<&'a Sensor>,
    /// The value of the darkest pixel, as far as that is dark: the veil that lies over the image.
    dark: f64,
    /// Pixels of the sensor that a pixel of the image is the mean of, 1 or more.
    averaged: f64,
}

impl<'a> Signal<'a> {
    fn new(frame: &Frame, sensor: Option<&'a Sensor>, light: &[Vec<f32>]) -> Self {
        let values: Vec<f32> = if let Some(sensor) = sensor {
            let (black, scale) = (sensor.black_level as f32, sensor.full_well_e as f32);
            let part = 1.0 / light.len() as f32;
            let fill = |pixel: usize| part * light.iter().map(|channel| channel[pixel]).sum::<f32>();
            let values: Vec<f32> =
                (0..frame.class.len()).map(|pixel| scale * fill(pixel).clamp(black, 1.0)).collect();
            blurred(&values, frame.width as usize, sensor.psf_px / sensor.pixels_per_side(frame.width))
        } else {
            frame
                .rgb
                .chunks_exact(3)
                .map(|rgb| rgb.iter().map(|v| f32::from(*v)).sum::<f32>() / 3.0)
                .collect()
        };
        let darkest = values.iter().copied().fold(f32::INFINITY, f32::min);
        let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
        let per_side = sensor.map_or(1.0, |sensor| sensor.pixels_per_side(frame.width).max(1.0));
        Self { dark: f64::from(darkest).min(MAX_DARK * mean), values, sensor, averaged: per_side * per_side }
    }

    /// Whether nobody can see a rock: see the head of this file.
    fn hides(&self, frame: &Frame, region: &Region, contrast: f64) -> bool {
        let value = |pixel: usize| f64::from(self.values[pixel]);
        let (mut rock, mut ground, mut others) = (Moments::default(), Moments::default(), Moments::default());
        region.for_each_pixel(
            frame,
            |pixel| rock.add(value(pixel)),
            |pixel| (if frame.instances[pixel] == 0 { &mut ground } else { &mut others }).add(value(pixel)),
        );
        if rock.mean() - self.dark < contrast * self.noise(self.dark) {
            return true;
        }
        if ground.count() < MIN_RING_PX {
            ground.0 = [0, 1, 2].map(|i| ground.0[i] + others.0[i]);
        }
        let (level, texture) = (rock.mean() - ground.mean(), rock.deviation() - ground.deviation());
        let least = contrast * self.noise(0.5 * (rock.mean() + ground.mean()));
        ground.count() > 0.0 && level * level + texture * texture < least * least
    }

    /// Standard deviation of a pixel's noise at this signal, electrons: the sensor's, and a step of the 8-bit image, below which no
    /// difference is visible. Without a sensor that step alone.
    fn noise(&self, signal_e: f64) -> f64 {
        let Some(sensor) = self.sensor else { return 1.0 };
        let fill = signal_e / sensor.full_well_e;
        let (noise, step) = (sensor.noise_of(fill, self.averaged), srgb_step(fill));
        sensor.full_well_e * (noise * noise + step * step).sqrt()
    }
}

/// Height of a step of the 8-bit image at a linear value, 0 to 1: the derivative of the inverse of the sRGB curve (IEC 61966-2-1).
fn srgb_step(linear: f64) -> f64 {
    let slope =
        if linear <= 0.003_130_8 { 1.0 / 12.92 } else { 2.4 / 1.055 * libm::pow(linear.min(1.0), 1.4 / 2.4) };
    slope / 255.0
}

/// An image behind a narrow point spread function of this standard deviation: three taps along rows and columns with the same variance.
fn blurred(values: &[f32], width: usize, sigma_px: f64) -> Vec<f32> {
    let side = (0.5 * sigma_px * sigma_px).min(1.0 / 3.0) as f32;
    let middle = 1.0 - 2.0 * side;
    let mut along_rows = vec![0.0; values.len()];
    for (row, out) in values.chunks_exact(width).zip(along_rows.chunks_exact_mut(width)) {
        for x in 0..width {
            let (left, right) = (row[x.saturating_sub(1)], row[(x + 1).min(width - 1)]);
            out[x] = middle * row[x] + side * (left + right);
        }
    }
    let row = |y: usize| &along_rows[y * width..(y + 1) * width];
    let height = values.len() / width;
    let mut both = vec![0.0; values.len()];
    for (y, out) in both.chunks_exact_mut(width).enumerate() {
        let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        for x in 0..width {
            out[x] = middle * here[x] + side * (above[x] + below[x]);
        }
    }
    both
}
