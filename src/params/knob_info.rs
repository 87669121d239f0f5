//! The type, range and stage of a knob, and the checks that follow from them.
//!
//! Must not know: which knobs there are.

use super::distribution::Distribution::{self, Fixed, UniformInt};
use super::distribution::Value;
use crate::error::{Error, Result, nearest};
use Kind::{Integer, Number, Rgb, Text};

/// Type of a knob's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Any number in the range.
    Number,
    /// A whole number in the range.
    Integer,
    /// A colour, each channel in the range.
    Rgb,
    /// One of these texts.
    Text(&'static [&'static str]),
}

/// What a knob is drawn for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Once per frame.
    Frame,
    /// Once for each of these elements.
    Element(&'static str),
}

/// The kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The reference stage: simple and exactly specified.
    Nominal,
    /// The realistic lunar surface.
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

/// One row of the table of knobs.
#[derive(Debug)]
pub struct KnobInfo {
    /// Dotted name.
    pub name: &'static str,
    /// Unit, empty for none.
    pub unit: &'static str,
    /// Type of its value.
    pub kind: Kind,
    /// What it is drawn for.
    pub scope: Scope,
    /// The only stage that has it; `None` if every stage has.
    pub stage: Option<Stage>,
    /// Its default.
    pub default: Distribution,
    /// Its default on the surface stage, if different.
    pub surface_default: Option<Distribution>,
    /// Smallest and largest allowed number.
    pub range: [f64; 2],
    /// One-line description for users.
    pub doc: &'static str,
}

impl KnobInfo {
    /// Its section: the part of its name before the dot.
    #[must_use]
    pub fn section(&self) -> &'static str {
        self.name.split_once('.').map_or(self.name, |(section, _)| section)
    }

    /// Whether a stage has this knob.
    #[must_use]
    pub fn is_of(&self, stage: Stage) -> bool {
        self.stage.is_none_or(|own| own == stage)
    }

    /// Its default on a stage.
    #[must_use]
    pub fn default_on(&self, stage: Stage) -> &Distribution {
        self.surface_default.as_ref().filter(|_| stage == Stage::Surface).unwrap_or(&self.default)
    }

    /// The allowed values as text, with the unit.
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

    /// Checks that every value that the distribution can give is allowed.
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
            allowed: self.allowed(),
            suggestion: match (self.kind, distribution) {
                (Text(words), Fixed(Value::Text(word))) => nearest(word, words.iter().copied()),
                _ => None,
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
