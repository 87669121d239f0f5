//! What is known of a knob: its type, its range, its stage, and the checks that follow from them.
//!
//! Must not know: which knobs there are.

use super::distribution::Distribution::{self, Fixed, UniformInt};
use super::distribution::Value;
use crate::error::{Error, Result, nearest};
use Kind::{Integer, Number, Rgb, Text};

/// What sort of value a knob takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Any number in the range.
    Number,
    /// A whole number in the range.
    Integer,
    /// A colour, each channel in the range.
    Rgb,
    /// One of these words.
    Text(&'static [&'static str]),
}

/// How often a knob is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Once a frame.
    Frame,
    /// Once for each of these.
    Element(&'static str),
}

/// A stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The reference stage: simple and exactly specified.
    Nominal,
    /// The realistic ground.
    Surface,
}

impl Stage {
    /// Every stage with its name.
    pub const ALL: [(Self, &'static str); 2] = [(Self::Nominal, "nominal"), (Self::Surface, "surface")];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// The stage of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|(_, known)| *known == name).map(|(stage, _)| stage)
    }
}

/// All that is known of a knob.
#[derive(Debug)]
pub struct KnobInfo {
    /// Dotted name.
    pub name: &'static str,
    /// Unit, empty for none.
    pub unit: &'static str,
    /// What it takes.
    pub kind: Kind,
    /// How often it is drawn.
    pub scope: Scope,
    /// The stage that it belongs to; none for those of every stage.
    pub stage: Option<Stage>,
    /// Its default.
    pub default: Distribution,
    /// Its default on the surface stage, where that is another one.
    pub surface_default: Option<Distribution>,
    /// Smallest and largest allowed number.
    pub range: [f64; 2],
    /// What it does.
    pub doc: &'static str,
}

impl KnobInfo {
    /// Whether a stage has it.
    #[must_use]
    pub fn is_of(&self, stage: Stage) -> bool {
        self.stage.is_none_or(|own| own == stage)
    }

    /// Its default on a stage.
    #[must_use]
    pub fn default_on(&self, stage: Stage) -> &Distribution {
        self.surface_default.as_ref().filter(|_| stage == Stage::Surface).unwrap_or(&self.default)
    }

    /// The allowed values in words, with the unit.
    #[must_use]
    pub fn allowed(&self) -> String {
        let [low, high] = self.range;
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        match self.kind {
            Number => format!("{low} to {high}{unit}"),
            Integer => format!("whole numbers, {low} to {high}{unit}"),
            Rgb => format!("[r, g, b], each {low} to {high}"),
            Text(words) => words.join(", "),
        }
    }

    /// Checks that whatever the distribution can give is right for this knob.
    pub(super) fn check(&self, distribution: &Distribution, origin: &str) -> Result<()> {
        let wrong_type = |expected: &str| Error::KnobType {
            name: self.name.to_owned(),
            value: distribution.to_string(),
            origin: origin.to_owned(),
            expected: match self.kind {
                Text(_) => expected.to_owned(),
                _ => format!("{expected} (allowed: {})", self.allowed()),
            },
        };
        let out_of_range = || Error::KnobOutOfRange {
            name: self.name.to_owned(),
            value: distribution.to_string(),
            origin: origin.to_owned(),
            allowed: match (self.kind, distribution) {
                (Text(words), Fixed(Value::Text(word))) => nearest(word, words.iter().copied()).map_or_else(
                    || self.allowed(),
                    |near| format!("{} (did you mean `{near}`?)", self.allowed()),
                ),
                _ => self.allowed(),
            },
        };
        let within = |value: &f64| (self.range[0]..=self.range[1]).contains(value);
        let whole_draws = matches!(distribution, Fixed(_) | UniformInt { .. } | Distribution::Choice { .. });
        for bound in distribution.bounds() {
            let allowed = match (self.kind, bound) {
                (Number, Value::Number(value)) => within(&value),
                (Integer, Value::Number(value)) if whole_draws && value.fract() == 0.0 => within(&value),
                (Rgb, Value::Rgb(rgb)) => rgb.iter().all(within),
                (Text(words), Value::Text(word)) => words.contains(&&*word),
                (Number, _) => return Err(wrong_type("a number, or a distribution of numbers")),
                (Integer, _) => {
                    return Err(wrong_type("a whole number, {uniform_int=[a,b]}, or a choice of them"));
                }
                (Rgb, _) => return Err(wrong_type("a colour [r, g, b]")),
                (Text(words), _) => return Err(wrong_type(&format!("one of {}", words.join(", ")))),
            };
            if !allowed {
                return Err(out_of_range());
            }
        }
        Ok(())
    }
}
