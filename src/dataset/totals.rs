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
    /// Sum of each class's coverage, in the order of [`ClassId::ALL`].
    coverage_sum: [f64; ClassId::ALL.len()],
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
    /// Totals of these lines.
    ///
    /// # Errors
    /// Those of reading.
    pub fn of(lines: &dyn FrameLines) -> Result<Self> {
        let mut totals = Self::default();
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
        for (sum, class) in self.coverage_sum.iter_mut().zip(ClassId::ALL) {
            *sum += line.coverage_of(class.name).unwrap_or_default();
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

    /// Mean of the images' mean values, 0 to 255.
    #[must_use]
    pub fn rgb_mean(&self) -> f64 {
        self.rgb_mean_sum / self.frames.max(1) as f64
    }

    /// The `totals` of a manifest.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let coverage: Map<String, Value> = ClassId::ALL
            .iter()
            .enumerate()
            .map(|(i, class)| (class.name.to_owned(), self.coverage(i).into()))
            .chain([("ignored".to_owned(), self.ignored().into())])
            .collect();
        json!({ "redraws": self.redraws, "coverage_mean": coverage, "rgb_mean": self.rgb_mean() })
    }
}
