//! The label rule, applied to a finished image: rocks that are too small, and rocks that nobody can see.
//!
//! A rock is compared with its surroundings in the signal that the sensor would record without noise: electrons, between black level
//! and full well. Without a sensor the signal is the 8-bit image. A rock is unseen if
//!
//! * the root of the sum of squares of the differences in mean and in standard deviation, noise included, between its pixels and those
//!   around it, behind the point spread function, is below a number of standard deviations of the noise of a pixel, by default 3, the
//!   limit of detection (Currie 1968), or
//! * in more than nine tenths of its pixels its own signal above that of the darkest pixel of the image is below the same number of
//!   standard deviations of the noise in the dark: a rock in shadow, whose outline cannot be distinguished from the shadow's.
//!
//! A pixel at the outline with more than one sample shows what is beside the rock too, in at most half of them: half of the brightest pixel
//! beside it is not the rock's own signal. Light of the sun that the lens scatters and reflects lies over the scene: no signal of a rock,
//! but with a noise of its own. What a contrast stretch makes black is dark, and what it makes white is equal, whatever the sensor got of it.
//! Each rock is summed by itself in the order of its pixels, so that no number depends on threads.
//! Must not know: how rocks were drawn.

use rayon::prelude::*;

use crate::class::ClassId;
use crate::frame::{Frame, LabelReason};
use crate::render::post::sensor::{CodeRange, Exposure, gaussian_blur};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::label_rule::{LabelPolicy, LabelRule};
use crate::scene::sensor::Sensor;

/// Width of the surroundings that a rock is compared with, pixels.
const RING_PX: usize = 3;
/// Largest value, in means of the image, that counts as dark.
const MAX_DARK: f64 = 0.1;
/// Least share of the pixels of a rock that must stand out from the dark.
const MIN_LIT_SHARE: f64 = 0.1;
/// Largest share of a pixel of a rock that shows what is beside the rock.
const MAX_SHARE_BESIDE: f32 = 0.5;
/// What that share of its light is of its 8-bit value at most: 0.5^(1 / 2.4).
const MAX_CODE_BESIDE: f32 = 0.75;
/// Fewest pixels of surroundings without rocks; with fewer, other rocks are part of the surroundings.
const MIN_RING_PX: f64 = 4.0;

/// Applies the label rule to the class, the instances and the rock labels of a frame with instances. `scene` and `drawn` are those
/// that were drawn; `exposure` is that of the scene's sensor, if it has one.
pub(crate) fn apply(scene: &Scene, drawn: &RenderSettings, frame: &mut Frame, exposure: Option<&Exposure>) {
    let rule = &scene.label_rule;
    let regions = Region::all(frame);
    let seen_by = scene.sensor.as_ref().zip(exposure);
    let signal = (rule.unseen != LabelPolicy::Rock).then(|| Signal::new(frame, seen_by));
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
    if rule.unseen == LabelPolicy::Regolith {
        for pixel in outline_pixels(frame, |instance| becomes_ground(reason_of[usize::from(instance)])) {
            let [ground, rock, _] = &mut frame.sample_counts[pixel];
            *ground += std::mem::take(rock);
        }
    }
    for (pixel, (class, instance)) in frame.class.iter_mut().zip(&mut frame.instances).enumerate() {
        let reason = reason_of[usize::from(*instance)];
        if reason == LabelReason::Rock {
            continue;
        }
        let counts = &mut frame.label_pixels;
        *(if reason == LabelReason::TooSmall { &mut counts.too_small } else { &mut counts.unseen }) += 1;
        if becomes_ground(reason) {
            (*class, *instance) = (ClassId::REGOLITH.0, 0);
            if let Some([ground, rock, _]) = frame.sample_counts.get_mut(pixel) {
                *ground += std::mem::take(rock);
            }
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

/// Pixels of something else whose samples of rocks are of rocks that become ground: of the pixels around them some show such a rock, and none
/// another.
fn outline_pixels(frame: &Frame, becomes_ground: impl Fn(u16) -> bool + Sync) -> Vec<usize> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let is_outline = |pixel: usize| {
        if frame.instances[pixel] != 0 || frame.sample_counts[pixel][1] == 0 {
            return false;
        }
        let (x, y) = (pixel % width, pixel / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let near = rows.flat_map(|y| columns.clone().map(move |x| y * width + x));
        let mut rocks = near.map(|pixel| frame.instances[pixel]).filter(|instance| *instance > 0).peekable();
        rocks.peek().is_some() && rocks.all(&becomes_ground)
    };
    let counted = if frame.sample_counts.is_empty() { 0 } else { frame.class.len() };
    (0..counted).into_par_iter().filter(|pixel| is_outline(*pixel)).collect()
}

/// Pixels beside each other in a row that show the same rock.
#[derive(Clone, Copy, Default)]
struct Run {
    row: usize,
    /// First column, and the one behind the last.
    start: usize,
    end: usize,
}

/// The pixels of a rock.
struct Region {
    instance: u16,
    pixels: u64,
    /// Its runs, from the top and the left on.
    runs: Vec<Run>,
}

impl Region {
    /// The regions of a frame, by instance id.
    fn all(frame: &Frame) -> Vec<Self> {
        let mut regions: Vec<Option<Self>> = Vec::new();
        for (row, instances) in frame.instances.chunks_exact(frame.width as usize).enumerate() {
            let mut start = 0;
            for run in instances.chunk_by(|a, b| a == b) {
                let (instance, end) = (run[0], start + run.len());
                if instance > 0 {
                    let index = usize::from(instance);
                    if regions.len() <= index {
                        regions.resize_with(index + 1, || None);
                    }
                    let new = || Self { instance, pixels: 0, runs: Vec::new() };
                    let region = regions[index].get_or_insert_with(new);
                    region.pixels += run.len() as u64;
                    region.runs.push(Run { row, start, end });
                }
                start = end;
            }
        }
        regions.into_iter().flatten().collect()
    }

    /// Calls `inside` with each pixel of the rock, and `around` with each one within [`RING_PX`] columns and rows of one, from the
    /// top and the left on. Takes time for these pixels alone, however large the rectangle around them is.
    fn for_each_pixel(&self, frame: &Frame, mut inside: impl FnMut(usize), mut around: impl FnMut(usize)) {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let (Some(first), Some(last)) = (self.runs.first(), self.runs.last()) else { return };
        // Runs of rows near the current one: from `near` on to `beyond`; those of the row itself from `own` on.
        let (mut near, mut beyond, mut own) = (0, 0, 0);
        let mut widened: Vec<[usize; 2]> = Vec::new();
        for row in first.row.saturating_sub(RING_PX)..(last.row + RING_PX + 1).min(height) {
            let before = |index: usize, row: usize| self.runs.get(index).is_some_and(|run| run.row < row);
            while before(near, row.saturating_sub(RING_PX)) {
                near += 1;
            }
            while before(beyond, row + RING_PX + 1) {
                beyond += 1;
            }
            while before(own, row) {
                own += 1;
            }
            widened.clear();
            let widen = |run: &Run| [run.start.saturating_sub(RING_PX), (run.end + RING_PX).min(width)];
            widened.extend(self.runs[near..beyond].iter().map(widen));
            widened.sort_unstable();
            let mut column = 0;
            for &[start, end] in &widened {
                column = column.max(start);
                while column < end {
                    let run = self.runs.get(own).filter(|run| run.row == row && run.start < end);
                    let gap = run.map_or(end, |run| run.start);
                    (column..gap).for_each(|column| around(row * width + column));
                    if let Some(run) = run {
                        (run.start..run.end).for_each(|column| inside(row * width + column));
                        own += 1;
                    }
                    column = run.map_or(gap, |run| run.end);
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

    /// Standard deviation of the values with independent noise of this standard deviation.
    fn deviation(&self, noise: f64) -> f64 {
        let variance = self.0[2] / self.0[0].max(1.0) - self.mean() * self.mean();
        (variance.max(0.0) + noise * noise).sqrt()
    }
}

/// What the sensor records without noise. Of each pixel: electrons, the mean of the channels; without a sensor 8-bit values.
struct Signal<'a> {
    /// What the light of the scene adds to that of the sun in the lens.
    values: Vec<f32>,
    /// The same before the point spread, which takes light across the outlines of rocks.
    sharp: Vec<f32>,
    /// What scattered light, ghosts and the disc of the sun give by themselves. Empty without them.
    stray: Vec<f32>,
    sensor: Option<(&'a Sensor, CodeRange)>,
    /// The value of the darkest pixel, as far as that is dark: the veil that lies over the image. What is black in the image is dark.
    dark: f64,
    /// Pixels of the sensor that a pixel of the image is the mean of, 1 or more.
    averaged: f64,
}

impl<'a> Signal<'a> {
    fn new(frame: &Frame, seen_by: Option<(&'a Sensor, &Exposure)>) -> Self {
        let (sharp, stray) = if let Some((sensor, exposure)) = seen_by {
            let shown = |channels: &[Vec<f32>]| shown(channels, sensor.full_well_e, exposure.codes.light);
            let (mut sharp, mut stray) = (shown(&exposure.light), shown(&exposure.stray));
            let black = sensor.full_well_e as f32 * exposure.codes.light[0];
            for (value, stray) in sharp.iter_mut().zip(&mut stray) {
                *stray -= black;
                *value -= *stray;
            }
            (sharp, stray)
        } else {
            let mean = |rgb: &[u8]| rgb.iter().map(|v| f32::from(*v)).sum::<f32>() / 3.0;
            (frame.rgb.chunks_exact(3).map(mean).collect(), Vec::new())
        };
        let psf_px = seen_by.map_or(0.0, |(sensor, _)| sensor.psf_px / sensor.pixels_per_side(frame.width));
        let values = gaussian_blur(&sharp, [frame.width, frame.height].map(|side| side as usize), psf_px);
        let darkest = sharp.iter().copied().fold(f32::INFINITY, f32::min);
        let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
        let sensor = seen_by.map(|(sensor, exposure)| (sensor, exposure.codes));
        let per_side = sensor.map_or(1.0, |(sensor, _)| sensor.pixels_per_side(frame.width).max(1.0));
        let black = sensor.map_or(0.0, |(sensor, codes)| sensor.full_well_e * f64::from(codes.light[0]));
        let dark = f64::from(darkest).min(MAX_DARK * mean).max(black);
        Self { values, sharp, stray, sensor, dark, averaged: per_side * per_side }
    }

    /// Whether nobody can see a rock: see the head of this file.
    fn hides(&self, frame: &Frame, region: &Region, contrast: f64) -> bool {
        if contrast <= 0.0 {
            return false;
        }
        let value = |pixel: usize| f64::from(self.values[pixel]);
        let stray = |pixel: usize| self.stray.get(pixel).map_or(0.0, |stray| f64::from(*stray));
        let [mut rock, mut stray_there, mut ground, mut others] = [Moments::default(); 4];
        let dark_noise = self.noise(self.dark);
        let mut lit_px = 0.0;
        region.for_each_pixel(
            frame,
            |pixel| {
                let stray = stray(pixel);
                rock.add(value(pixel));
                stray_there.add(stray);
                let noise = if stray > 0.0 { self.noise(self.dark + stray) } else { dark_noise };
                lit_px += f64::from(u8::from(self.own_signal(frame, pixel) >= self.dark + contrast * noise));
            },
            |pixel| (if frame.instances[pixel] == 0 { &mut ground } else { &mut others }).add(value(pixel)),
        );
        if lit_px < MIN_LIT_SHARE * rock.count() {
            return true;
        }
        if ground.count() < MIN_RING_PX {
            ground.0 = [0, 1, 2].map(|i| ground.0[i] + others.0[i]);
        }
        let noise = self.noise(0.5 * (rock.mean() + ground.mean()) + stray_there.mean());
        let level = rock.mean() - ground.mean();
        let texture = rock.deviation(noise) - ground.deviation(noise);
        let least = contrast * noise;
        ground.count() > 0.0 && level * level + texture * texture < least * least
    }

    /// The least that a pixel of a rock has of the rock's own signal.
    fn own_signal(&self, frame: &Frame, pixel: usize) -> f64 {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let (x, y) = (pixel % width, pixel / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let near = (y.saturating_sub(1)..(y + 2).min(height))
            .flat_map(|y| columns.clone().map(move |x| y * width + x));
        let beside = near.filter(|near| frame.instances[*near] != frame.instances[pixel]);
        let brightest = beside.map(|pixel| self.sharp[pixel]).fold(0.0, f32::max);
        let share = match self.sensor {
            // A single sample shows nothing beside it.
            _ if frame.samples == 1 => 0.0,
            Some(_) => MAX_SHARE_BESIDE,
            None => MAX_CODE_BESIDE,
        };
        f64::from(self.sharp[pixel] - share * brightest)
    }

    /// Standard deviation of a pixel's noise at this signal, electrons: the sensor's, and a step of the 8-bit image, below which no
    /// difference is visible. Without a sensor that step alone.
    fn noise(&self, signal_e: f64) -> f64 {
        let Some((sensor, codes)) = self.sensor else { return 1.0 };
        let fill = signal_e / sensor.full_well_e;
        let noise = sensor.noise_of(fill, self.averaged);
        // Codes span black to the full well.
        let (black, white) = (sensor.black_level, 1.0 - sensor.black_level);
        let step = f64::from(codes.step) * white * srgb_slope((fill - black) / white);
        sensor.full_well_e * (noise * noise + step * step).sqrt()
    }
}

/// What an image whose codes are of this light shows of channels, before the point spread: electrons, the mean of the channels.
fn shown(channels: &[Vec<f32>], full_well_e: f64, [black, white]: [f32; 2]) -> Vec<f32> {
    let Some((first, others)) = channels.split_first() else { return Vec::new() };
    let (part, scale) = (1.0 / channels.len() as f32, full_well_e as f32);
    let mut values = first.clone();
    for channel in others {
        values.iter_mut().zip(channel).for_each(|(value, light)| *value += light);
    }
    values.iter_mut().for_each(|value| *value = scale * (part * *value).max(black).min(white));
    values
}

/// Derivative of the inverse of the sRGB curve (IEC 61966-2-1) at a linear value, 0 to 1.
fn srgb_slope(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 1.0 / 12.92 } else { 2.4 / 1.055 * libm::pow(linear.min(1.0), 1.4 / 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sensor::Mosaic;

    /// [`is_hidden_behind`] without stray light.
    fn is_hidden(rock: impl Fn(usize, usize) -> f32, ground: f32, codes: [f32; 2]) -> bool {
        is_hidden_behind(|_| 0.0, rock, ground, codes)
    }

    /// Whether a rock on even ground is hidden, in an image whose codes span this light. `rock` maps the columns and rows of its 10 x 10
    /// pixels to light, `stray` the columns of the image, 10 to 19 with the rock, to the sun's light in the lens.
    fn is_hidden_behind(
        stray: impl Fn(usize) -> f32,
        rock: impl Fn(usize, usize) -> f32,
        ground: f32,
        codes: [f32; 2],
    ) -> bool {
        is_hidden_from(stray, rock, ground, (codes, 4, 3.0))
    }

    /// The same with this many samples a pixel, and with this contrast as the limit.
    fn is_hidden_from(
        stray: impl Fn(usize) -> f32,
        rock: impl Fn(usize, usize) -> f32,
        ground: f32,
        (codes, samples, contrast): ([f32; 2], u32, f64),
    ) -> bool {
        const SIDE: usize = 30;
        let within = |at: usize| at.checked_sub(10).filter(|from_edge| *from_edge < 10);
        let pixels = || (0..SIDE * SIDE).map(|pixel| within(pixel % SIDE).zip(within(pixel / SIDE)));
        let frame = Frame {
            width: SIDE as u32,
            height: SIDE as u32,
            samples,
            instances: pixels().map(|in_rock| u16::from(in_rock.is_some())).collect(),
            ..Frame::default()
        };
        let light = |in_rock: Option<(usize, usize)>| in_rock.map_or(ground, |(x, y)| rock(x, y));
        let mut light: Vec<f32> = pixels().map(light).collect();
        // The image has a black sky.
        light[..SIDE].fill(0.0);
        let stray: Vec<f32> = (0..light.len()).map(|pixel| stray(pixel % SIDE)).collect();
        light.iter_mut().zip(&stray).for_each(|(light, stray)| *light += stray);
        let sensor = Sensor { read_noise_e: 20.0, ..Sensor::ideal(Mosaic::Monochrome) };
        let codes = CodeRange { light: codes, step: 1.0 / 255.0 };
        let exposure = Exposure { light: vec![light], stray: vec![stray], codes, gain: 1.0 };
        Signal::new(&frame, Some((&sensor, &exposure))).hides(&frame, &Region::all(&frame)[0], contrast)
    }

    #[test]
    fn rocks_that_are_black_but_for_a_few_pixels_are_hidden() {
        let lit =
            |count: usize| is_hidden(|x, y| if x + 10 * y < count { 0.5 } else { 0.0 }, 0.01, [0.0, 1.0]);
        assert_eq!([0, 3, 9, 10, 40].map(lit), [true, true, true, false, false]);
        // A mean of as much light, spread evenly, is seen.
        assert!(!is_hidden(|_, _| 0.015, 0.01, [0.0, 1.0]));
    }

    /// Mixed with the ground along its outline, with a bright edge, and dim.
    #[test]
    fn light_of_the_ground_beside_a_rock_is_not_its_own() {
        let hidden = |outline: f32, inside: f32| {
            let is_outline = |at: usize| at == 0 || at == 9;
            let rock = |x, y| if is_outline(x) || is_outline(y) { outline } else { inside };
            is_hidden(rock, 0.2, [0.0, 1.0])
        };
        assert_eq!([0.0, 0.1, 0.15].map(|outline| hidden(outline, 0.0)), [true, true, false]);
        assert!(!hidden(0.1, 0.01), "dim all over");
    }

    #[test]
    fn a_single_sample_is_all_of_the_rock_and_without_a_contrast_nothing_is_hidden() {
        let is_outline = |at: usize| at == 0 || at == 9;
        let rock = |x, y| if is_outline(x) || is_outline(y) { 0.1 } else { 0.0 };
        let hidden = |samples, contrast| is_hidden_from(|_| 0.0, rock, 0.2, ([0.0, 1.0], samples, contrast));
        assert_eq!([hidden(4, 3.0), hidden(1, 3.0), hidden(4, 0.0)], [true, false, false]);
        assert!(!is_hidden_from(|_| 0.0, |_, _| 0.2, 0.2, ([0.0, 1.0], 4, 0.0)), "a rock like the ground");
    }

    #[test]
    fn what_a_contrast_stretch_makes_black_or_white_is_hidden() {
        let hidden = |rock: f32, ground: f32, codes| is_hidden(|_, _| rock, ground, codes);
        for (rock, ground, range) in [(0.05, 0.07, [0.08, 1.0]), (0.9, 0.8, [0.0, 0.7])] {
            assert!(!hidden(rock, ground, [0.0, 1.0]) && hidden(rock, ground, range), "{rock} on {ground}");
        }
        assert!(hidden(1.0, 1.0, [1.000_000_1, 1.2]), "white all over");
        // One that is black on brighter ground looks like a shadow, one that is white is a rock.
        assert!(hidden(0.05, 0.2, [0.08, 1.0]) && !hidden(0.9, 0.5, [0.0, 0.7]));
    }

    #[test]
    fn stray_light_shows_no_rock_and_hides_those_that_it_outshines() {
        let ghost = |light: f32| move |column: usize| if column < 15 { light } else { 0.1 };
        let hidden = |stray: f32, rock: f32, codes| is_hidden_behind(ghost(stray), |_, _| rock, 0.05, codes);
        for stray in [0.1, 0.3, 0.9] {
            assert!(hidden(stray, 0.0, [0.0, 1.0]), "a black rock below {stray}");
        }
        // A step of the codes at 0.5 is 0.004, at 0.1 0.0012.
        assert!(!hidden(0.1, 0.02, [0.0, 1.0]) && !hidden(0.5, 0.02, [0.0, 1.0]));
        assert!(is_hidden_behind(|_| 0.5, |_, _| 0.008, 0.2, [0.0, 1.0]), "less than a step of the codes");
        assert!(!is_hidden_behind(|_| 0.0, |_, _| 0.008, 0.2, [0.0, 1.0]));
        assert!(is_hidden_behind(|_| 1.1, |_, _| 0.5, 0.2, [0.0, 1.0]), "white all over");
    }

    /// Rocks with holes, in several parts, at the edges, and one that surrounds another.
    #[test]
    fn the_surroundings_of_a_rock_are_the_pixels_near_it() {
        let (width, height) = (61_usize, 47_usize);
        let instance = |pixel: usize| {
            let (x, y) = ((pixel % width) as i32, (pixel / width) as i32);
            let distance = (x - 30).pow(2) + (y - 20).pow(2);
            match distance {
                0..9 => 1,
                60..150 if (x + y) % 11 > 1 => 2,
                _ if x > 55 || (y > 43 && x < 9) => 3,
                _ if (x * 7 + y * 13) % 97 == 5 => 4,
                _ => 0,
            }
        };
        let frame = Frame {
            width: width as u32,
            height: height as u32,
            instances: (0..width * height).map(instance).collect(),
            ..Frame::default()
        };
        let regions = Region::all(&frame);
        assert_eq!(regions.iter().map(|region| region.instance).collect::<Vec<_>>(), [1, 2, 3, 4]);
        for region in regions {
            let (mut inside, mut around) = (Vec::new(), Vec::new());
            region.for_each_pixel(&frame, |pixel| inside.push(pixel), |pixel| around.push(pixel));
            let shows = |pixel: &usize| frame.instances[*pixel] == region.instance;
            let is_near = |pixel: &usize| {
                let (x, y) = (pixel % width, pixel / width);
                let rows = y.saturating_sub(RING_PX)..(y + RING_PX + 1).min(height);
                let columns = x.saturating_sub(RING_PX)..(x + RING_PX + 1).min(width);
                rows.flat_map(|y| columns.clone().map(move |x| y * width + x)).any(|near| shows(&near))
            };
            let pixels = 0..width * height;
            assert_eq!(inside, pixels.clone().filter(shows).collect::<Vec<_>>());
            assert_eq!(around, pixels.filter(|pixel| !shows(pixel) && is_near(pixel)).collect::<Vec<_>>());
            assert_eq!(region.pixels, inside.len() as u64);
        }
    }
}
