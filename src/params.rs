//! The knobs: one table, and the values of one frame.
//!
//! Parsing, checking, the listing of `params` and the record in a frame's JSON all come from [`KNOBS`].
//! Must not know: what a knob does.
//! To add a knob: a row in `params/knobs.rs`, and the line of code that uses it.

mod azimuth;
pub mod config;
pub mod distribution;
mod document;
pub mod groups;
mod knob_info;
mod knobs;
mod listing;
pub mod presets;
pub mod record;
mod variant;
mod variants;

use serde_json::{Map, Value as Json};

use crate::random::Stream;
use Distribution::Fixed;
use Kind::Integer;
pub use distribution::{Distribution, Value};
pub use knob_info::{Kind, KnobInfo, Scope, Stage};
pub use knobs::{KNOBS, Knob};

/// The parameters of one frame, validated.
///
/// A knob that is drawn once per frame has its value; one that is drawn for each element keeps its distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    settings: Vec<Distribution>,
}

impl Params {
    /// What a knob is: a fixed value, or the distribution that each element draws from.
    #[must_use]
    pub fn setting(&self, knob: Knob) -> &Distribution {
        &self.settings[knob as usize]
    }

    /// Takes a knob over from other parameters.
    pub(crate) fn take_over(&mut self, knob: Knob, from: &Self) {
        self.settings[knob as usize] = from.settings[knob as usize].clone();
    }

    fn value(&self, knob: Knob) -> &Value {
        match &self.settings[knob as usize] {
            Fixed(value) => value,
            _ => panic!("{} is drawn for each element: use `sample`", knob.name()),
        }
    }

    /// The value of a number knob that is drawn once per frame.
    ///
    /// # Panics
    /// If the knob is of another type or scope.
    #[must_use]
    pub fn number(&self, knob: Knob) -> f64 {
        match self.value(knob) {
            Value::Number(value) => *value,
            _ => panic!("{} is not a number", knob.name()),
        }
    }

    /// The value of an integer knob that is drawn once per frame.
    ///
    /// # Panics
    /// If the knob is of another type or scope.
    #[must_use]
    pub fn count(&self, knob: Knob) -> u32 {
        self.number(knob) as u32
    }

    /// The value of a colour knob, linear RGB.
    ///
    /// # Panics
    /// If the knob is of another type or scope.
    #[must_use]
    pub fn rgb(&self, knob: Knob) -> [f64; 3] {
        match self.value(knob) {
            Value::Rgb(rgb) => *rgb,
            _ => panic!("{} is not a colour", knob.name()),
        }
    }

    /// The value of a text knob.
    ///
    /// # Panics
    /// If the knob is of another type or scope.
    #[must_use]
    pub fn text(&self, knob: Knob) -> &str {
        match self.value(knob) {
            Value::Text(text) => text,
            _ => panic!("{} is not a text", knob.name()),
        }
    }

    /// Draws the value of a number knob for one element.
    ///
    /// # Panics
    /// If the knob is of another type.
    #[must_use]
    pub fn sample(&self, knob: Knob, stream: &mut Stream) -> f64 {
        match self.settings[knob as usize].sample(stream) {
            Value::Number(value) => value,
            _ => panic!("{} is not a number", knob.name()),
        }
    }

    /// The stage.
    ///
    /// # Panics
    /// Never: the table allows no other value.
    #[must_use]
    pub fn stage(&self) -> Stage {
        Stage::from_name(self.text(Knob::StageName)).expect("the table allows stages only")
    }

    /// Every knob of the stage under its dotted name: values, or distributions for knobs that are drawn per element.
    #[must_use]
    pub fn to_json(&self) -> Map<String, Json> {
        KNOBS
            .iter()
            .zip(&self.settings)
            .filter(|(info, _)| info.is_of(self.stage()))
            .map(|(info, setting)| (info.name.to_owned(), setting.to_json(info.kind == Integer)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Kind::{Number, Rgb, Text};
    use Scope::{Element, Frame};

    #[test]
    fn every_knob_has_a_value_of_its_kind() {
        let mut stream = crate::random::Streams::new(1).stream("test", 0);
        for (stage, name) in Stage::ALL {
            let mut config = super::config::Config::new();
            config.set_stage(name).expect("a stage");
            let params = config.draw(1).expect("drawn");
            assert_eq!(params.stage(), stage);
            for (knob, info) in Knob::ALL.into_iter().zip(&KNOBS) {
                match (info.kind, info.scope) {
                    (Number | Integer, Element(_)) => assert!(params.sample(knob, &mut stream).is_finite()),
                    (Number, Frame) => assert!(params.number(knob).is_finite()),
                    (Integer, Frame) => assert_eq!(f64::from(params.count(knob)), params.number(knob)),
                    (Rgb, _) => assert_eq!(params.rgb(knob).len(), 3),
                    (Text(words), _) => assert!(words.contains(&params.text(knob))),
                }
            }
            let json = params.to_json();
            assert_eq!(json.len(), KNOBS.iter().filter(|info| info.is_of(stage)).count());
        }
        let json = Params::draw_default(1).to_json();
        assert_eq!(json["rocks.scale_m"].to_string(), r#"{"uniform":[0.3,1.3]}"#);
        assert!(json["rocks.count"].is_u64() && json["sun.elevation_deg"] == 17.0);
    }
}
