//! Sums over the frames of a dataset.
//!
//! Must not know: files, how frames are made.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};

use crate::class::ClassId;
use crate::error::Result;
use crate::output::layout::{FrameLine, FrameLines};

/// Sums over the frames of a dataset.
#[derive(Clone, Debug, Default)]
pub struct Totals {
    /// Number of frames.
    pub frames: u64,
    /// Number of pixels of a frame.
    frame_px: u64,
    /// Sum of each class's coverage, in the order of [`ClassId::ALL`].
    coverage_sum: [f64; ClassId::ALL.len()],
    /// Number of pixels of each class in the masks as they are written, and of frames that have any.
    class_px: [u64; ClassId::ALL.len()],
    class_frames: [u64; ClassId::ALL.len()],
    /// Sums of the values of each channel and of their squares: whole numbers, so that no order of the frames matters.
    channel_sum: [u128; 3],
    channel_squares: [u128; 3],
    /// Whether some frame has no such sums, as those of version 0.1.
    lacks_channels: bool,
    /// Sum of the fractions of pixels that carry the ignore index by the label rule.
    ignored_sum: f64,
    /// Sum of the mean RGB values.
    rgb_mean_sum: f64,
    /// Number of rejected attempts by the rule that they broke.
    pub redraws: BTreeMap<String, u64>,
    /// Names of the adapters that rendered frames.
    pub adapters: BTreeSet<String>,
}

impl Totals {
    /// Totals of no frame yet, of images of this width and height in pixels.
    #[must_use]
    pub fn new([width, height]: [u32; 2]) -> Self {
        Self { frame_px: u64::from(width) * u64::from(height), ..Self::default() }
    }

    /// Totals of these lines, of images of this width and height in pixels.
    ///
    /// # Errors
    /// Those of reading.
    pub fn of(lines: &dyn FrameLines, size: [u32; 2]) -> Result<Self> {
        let mut totals = Self::new(size);
        lines.for_each(&mut |line| {
            totals.add(&line);
            Ok(())
        })?;
        Ok(totals)
    }

    /// Adds a frame.
    pub fn add(&mut self, line: &FrameLine) {
        self.frames += 1;
        self.rgb_mean_sum += line.rgb.mean;
        for (i, class) in ClassId::ALL.iter().enumerate() {
            self.coverage_sum[i] += line.coverage_of(class.name).unwrap_or_default();
            let of_mask = line.mask_coverage_of(class.name).unwrap_or_default();
            // A fraction of fewer than 2^52 pixels gives their number back.
            let pixels = (of_mask * self.frame_px as f64).round() as u64;
            self.class_px[i] = self.class_px[i].saturating_add(pixels);
            self.class_frames[i] += u64::from(pixels > 0);
        }
        if let (Some(sum), Some(squares)) = (line.rgb.sum, line.rgb.sum_of_squares) {
            for channel in 0..3 {
                self.channel_sum[channel] += u128::from(sum[channel]);
                self.channel_squares[channel] += u128::from(squares[channel]);
            }
        } else {
            self.lacks_channels = true;
        }
        self.ignored_sum += line.coverage_of("ignored").unwrap_or_default();
        for rule in &line.redrawn {
            *self.redraws.entry(rule.clone()).or_default() += 1;
        }
        self.adapters.insert(line.adapter.clone());
    }

    /// Mean fraction of the pixels that a class covers, by its index in [`ClassId::ALL`].
    #[must_use]
    pub fn coverage(&self, class: usize) -> f64 {
        self.coverage_sum[class] / self.frames.max(1) as f64
    }

    /// Mean fraction of the pixels that carry the ignore index by the label rule.
    #[must_use]
    pub fn ignored(&self) -> f64 {
        self.ignored_sum / self.frames.max(1) as f64
    }

    /// Fraction of the pixels of all masks as they are written that a class covers, by its index in [`ClassId::ALL`].
    #[must_use]
    pub fn mask_coverage(&self, class: usize) -> f64 {
        self.class_px[class] as f64 / self.all_px().max(1) as f64
    }

    /// Fraction of the pixels of all masks as they are written that carry the ignore index.
    #[must_use]
    pub fn mask_ignored(&self) -> f64 {
        let labelled = self.class_px.iter().map(|pixels| u128::from(*pixels)).sum();
        self.all_px().saturating_sub(labelled) as f64 / self.all_px().max(1) as f64
    }

    /// Number of pixels of all frames.
    fn all_px(&self) -> u128 {
        u128::from(self.frames) * u128::from(self.frame_px)
    }

    /// Mean of the images' mean values, 0 to 255.
    #[must_use]
    pub fn rgb_mean(&self) -> f64 {
        self.rgb_mean_sum / self.frames.max(1) as f64
    }

    /// The weight of each class in a loss, by median frequency balancing (Eigen and Fergus 2015, section 6.3.2): the median over
    /// classes of the frequency, divided by that of the class. A frequency is the share of a class in the pixels of the frames that have
    /// it. 0 for a class that no frame has.
    #[must_use]
    pub fn class_weights(&self) -> [f64; ClassId::ALL.len()] {
        let frequency = |i: usize| self.class_px[i] as f64 / (self.class_frames[i] * self.frame_px) as f64;
        let mut sorted: Vec<f64> =
            (0..ClassId::ALL.len()).filter(|i| self.class_px[*i] > 0).map(frequency).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let middle = |i: usize| sorted.get(i).copied().unwrap_or_default();
        let median = 0.5 * (middle(sorted.len().saturating_sub(1) / 2) + middle(sorted.len() / 2));
        std::array::from_fn(|i| if self.class_px[i] > 0 { median / frequency(i) } else { 0.0 })
    }

    /// Mean and standard deviation of each channel over all pixels of all frames, 0 to 1; `None` if a frame lacks the sums.
    #[must_use]
    pub fn channels(&self) -> Option<[[f64; 3]; 2]> {
        let pixels = self.all_px();
        if self.lacks_channels || pixels == 0 {
            return None;
        }
        let mean = self.channel_sum.map(|sum| sum as f64 / pixels as f64 / 255.0);
        let deviation = std::array::from_fn(|i| {
            let variance_px2 = pixels
                .saturating_mul(self.channel_squares[i])
                .saturating_sub(self.channel_sum[i].saturating_pow(2));
            (variance_px2 as f64).sqrt() / pixels as f64 / 255.0
        });
        Some([mean, deviation])
    }

    /// The `totals` of a manifest.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let by_class = |value: &dyn Fn(usize) -> Value| {
            let rows = ClassId::ALL.iter().enumerate();
            rows.map(|(i, class)| (class.name.to_owned(), value(i))).collect::<Map<String, Value>>()
        };
        let mut coverage = by_class(&|i| self.coverage(i).into());
        coverage.insert("ignored".to_owned(), self.ignored().into());
        let weights = self.class_weights();
        let mut totals = json!({
            "redraws": self.redraws, "coverage_mean": coverage, "rgb_mean": self.rgb_mean(),
            "class_pixels": by_class(&|i| self.class_px[i].into()),
            "class_weights": by_class(&|i| weights[i].into()),
        });
        if let (Some([mean, deviation]), Value::Object(totals)) = (self.channels(), &mut totals) {
            totals.insert("channel_mean".to_owned(), json!(mean));
            totals.insert("channel_std".to_owned(), json!(deviation));
        }
        totals
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::RgbStatistics;

    fn line(rgb: &[u8], coverage: [f64; 3]) -> FrameLine {
        let coverage = ClassId::ALL.iter().zip(coverage);
        FrameLine {
            rgb: RgbStatistics::of(rgb),
            coverage: coverage.map(|(class, share)| (class.name.to_owned(), share.into())).collect(),
            ..FrameLine::default()
        }
    }

    #[test]
    fn weights_and_channels_are_those_of_all_pixels_in_any_order() {
        // Two frames of three pixels; the second has no rock.
        let images = [[10, 20, 30, 40, 50, 60, 70, 80, 90], [0, 0, 255, 0, 0, 255, 3, 0, 255]];
        let lines = [line(&images[0], [1.0 / 3.0; 3]), line(&images[1], [2.0 / 3.0, 0.0, 1.0 / 3.0])];
        let mut totals = Totals::new([3, 1]);
        lines.iter().for_each(|line| totals.add(line));
        let mut reversed = Totals::new([3, 1]);
        lines.iter().rev().for_each(|line| reversed.add(line));
        assert_eq!((totals.channels(), totals.class_px), (reversed.channels(), reversed.class_px));
        assert_eq!(totals.class_px, [3, 1, 2]);
        // Frequencies: 3 of 6 pixels, 1 of 3, 2 of 6.
        let weights = totals.class_weights();
        assert!(
            (weights[0] - 2.0 / 3.0).abs() < 1e-12 && weights[1] == 1.0 && weights[2] == 1.0,
            "{weights:?}"
        );
        let [mean, deviation] = totals.channels().expect("sums");
        for channel in 0..3 {
            let values: Vec<f64> = images
                .iter()
                .flatten()
                .skip(channel)
                .step_by(3)
                .map(|value| f64::from(*value) / 255.0)
                .collect();
            let expected = values.iter().sum::<f64>() / 6.0;
            let variance =
                values.iter().map(|value| (value - expected) * (value - expected)).sum::<f64>() / 6.0;
            assert!((mean[channel] - expected).abs() < 1e-12, "{mean:?}");
            assert!((deviation[channel] - variance.sqrt()).abs() < 1e-12, "{deviation:?}");
        }
    }

    #[test]
    fn pixels_and_weights_are_those_of_the_masks_as_they_are_written() {
        let mut with_band = line(&[1; 24], [0.5, 0.25, 0.25]);
        for (name, pixels) in [("regolith", 3.0), ("rock", 0.0), ("sky", 1.0), ("ignored", 4.0)] {
            with_band.mask_coverage.insert(name.to_owned(), (pixels / 8.0).into());
        }
        let mut totals = Totals::new([8, 1]);
        totals.add(&with_band);
        totals.add(&line(&[1; 24], [0.5, 0.25, 0.25]));
        assert_eq!(totals.class_px, [7, 2, 3]);
        assert_eq!(
            ([0, 1, 2].map(|i| totals.mask_coverage(i)), totals.mask_ignored()),
            ([7.0, 2.0, 3.0].map(|px| px / 16.0), 0.25)
        );
        // Frequencies: 7 of 16 pixels, 2 of 8, 3 of 16.
        assert_eq!(totals.class_weights(), [0.25 / (7.0 / 16.0), 1.0, 0.25 / (3.0 / 16.0)]);
        assert_eq!([0, 1, 2].map(|i| totals.coverage(i)), [0.5, 0.25, 0.25], "before the band");
    }

    #[test]
    fn what_is_unknown_is_left_out() {
        assert_eq!(Totals::new([3, 1]).class_weights(), [0.0; 3]);
        let mut old = line(&[1; 9], [1.0, 0.0, 0.0]);
        old.rgb.sum = None;
        let mut totals = Totals::new([3, 1]);
        totals.add(&old);
        assert!(totals.channels().is_none() && totals.to_json().get("channel_mean").is_none());
        assert_eq!(totals.class_weights(), [1.0, 0.0, 0.0]);
    }
}
