//! The knobs: one table, and the values of one frame.
//!
//! Parsing, checking, the listing of `params` and the record in a frame's JSON all come from [`KNOBS`].
//! Must not know: what a knob does.
//! To add a knob: a row in `params/knobs.rs`, and the line of code that uses it.

pub mod distribution;
mod document;
mod knob_info;
mod knobs;
mod listing;
pub mod presets;
pub mod sampler;

use serde_json::{Map, Value as Json};

use crate::random::Stream;
use Distribution::Fixed;
use Kind::Integer;
pub use distribution::{Distribution, Value};
pub use knob_info::{Kind, KnobInfo, Scope, Stage};
pub use knobs::{KNOBS, Knob};

/// The values of one frame, checked.
///
/// Knobs that are drawn once a frame have their value; those drawn for each element keep their distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    settings: Vec<Distribution>,
}

impl Params {
    fn value(&self, knob: Knob) -> &Value {
        match &self.settings[knob as usize] {
            Fixed(value) => value,
            _ => panic!("{} is drawn for each element: use `sample`", knob.name()),
        }
    }

    /// The number of a knob that is drawn once a frame.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn number(&self, knob: Knob) -> f64 {
        match self.value(knob) {
            Value::Number(value) => *value,
            _ => panic!("{} is no number", knob.name()),
        }
    }

    /// The whole number of a knob that is drawn once a frame.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn count(&self, knob: Knob) -> u32 {
        self.number(knob) as u32
    }

    /// The colour of a knob.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn rgb(&self, knob: Knob) -> [f64; 3] {
        match self.value(knob) {
            Value::Rgb(rgb) => *rgb,
            _ => panic!("{} is no colour", knob.name()),
        }
    }

    /// The word of a knob.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn text(&self, knob: Knob) -> &str {
        match self.value(knob) {
            Value::Text(text) => text,
            _ => panic!("{} is no word", knob.name()),
        }
    }

    /// Draws the number of a knob for one element.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn sample(&self, knob: Knob, stream: &mut Stream) -> f64 {
        match self.settings[knob as usize].sample(stream) {
            Value::Number(value) => value,
            _ => panic!("{} is no number", knob.name()),
        }
    }

    /// The stage.
    ///
    /// # Panics
    /// Never: the table allows no other word.
    #[must_use]
    pub fn stage(&self) -> Stage {
        Stage::from_name(self.text(Knob::StageName)).expect("a stage that there is")
    }

    /// Every knob of the stage as used, under its dotted name; those drawn for each element as what they are drawn from.
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
    fn every_knob_can_be_asked_as_its_kind() {
        let mut stream = crate::random::Streams::new(1).stream("test", 0);
        for (stage, name) in Stage::ALL {
            let mut config = sampler::Config::new();
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
