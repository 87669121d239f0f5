//! A variant: knobs that are drawn together, because some frames are of another kind.
//!
//! Must not know: presets, files.

use super::distribution::Distribution;
use super::knobs::Knob;
use crate::random::Streams;

/// A set of distributions that a part of the frames draws from, instead of those of the configuration.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Variant {
    /// Its share of the frames, relative to the other variants.
    pub(super) weight: f64,
    /// What it sets.
    pub(super) settings: Vec<Option<Distribution>>,
}

impl Variant {
    /// The variant of a seed; `None` if there are none. It has a random stream of its own.
    pub(super) fn choose<'a>(variants: &'a [Self], streams: &Streams) -> Option<&'a Self> {
        let mut left = streams.stream("variant", 0).unit() * variants.iter().map(|v| v.weight).sum::<f64>();
        let chosen = variants.iter().find(|variant| {
            left -= variant.weight;
            left < 0.0
        });
        chosen.or(variants.last())
    }

    /// Forgets a knob, which was set for all frames since. The sun has one azimuth, absolute or relative.
    pub(super) fn clear(&mut self, knob: Knob) {
        self.settings[knob as usize] = None;
        if let Some(other) = super::azimuth::other(knob) {
            self.settings[other as usize] = None;
        }
    }
}
