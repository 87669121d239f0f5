//! A file with a configuration: TOML, or the record of a frame (`--config frame_0000.json`).
//!
//! Must not know: the command line.

use std::path::Path;

use serde_json::{Map, Value};

use super::config::Config;
use super::knobs::Knob;
use crate::error::{Error, Result};
use crate::input;

/// What a frame was made from besides its knobs; `None` where the record does not say.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameOrigin {
    /// Seed of its scene.
    pub seed: Option<u64>,
    /// Width and height, pixels.
    pub size: Option<[u32; 2]>,
    /// Samples per pixel.
    pub samples: Option<u32>,
    /// What its mask holds where classes meet.
    pub edges: Option<String>,
    /// The numbering of the classes in its mask.
    pub label_ids: Option<String>,
    /// Version that made it.
    pub version: Option<String>,
}

/// Whether a text is JSON, by its first character, with which no TOML begins, or by the extension of its path, which a pipe lacks.
fn is_json(text: &str, path: &Path) -> bool {
    text.trim_start().starts_with('{')
        || path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// The record that a text is.
///
/// # Errors
/// [`Error::Config`] if it is none.
fn parse(text: &str, path: &Path) -> Result<Map<String, Value>> {
    let refused = |cause| Error::Config { path: path.to_owned(), cause };
    let record: Map<String, Value> =
        input::json::parse(text.as_bytes()).map_err(|error| refused(std::io::Error::other(error)))?;
    if record.get("knobs").is_some_and(Value::is_object) {
        return Ok(record);
    }
    let message = "it is not the record of a frame: it has no table `knobs`; a configuration that is not a record is TOML";
    Err(refused(std::io::Error::other(message)))
}

impl FrameOrigin {
    /// The origin of the frame of a record.
    ///
    /// # Errors
    /// [`Error::Config`] if a value has a wrong type or is out of range.
    fn of_record(record: &Map<String, Value>, path: &Path) -> Result<Self> {
        let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
        let samples = |value: &Value| number(value).filter(|number| matches!(number, 1 | 4 | 16));
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let label_ids =
            |value: &Value| text(value).filter(|name| matches!(name.as_str(), "canonical" | "replicator"));
        let size = |value: &Value| match value.as_array()?.as_slice() {
            [width, height] => Some([number(width)?, number(height)?]),
            _ => None,
        };
        Ok(Self {
            seed: value(record, path, ("seed", "a whole number from 0 to 2^64 - 1"), Value::as_u64)?,
            size: value(record, path, ("size", "two whole numbers, width and height in pixels"), size)?,
            samples: value(record, path, ("samples", "1, 4 or 16"), samples)?,
            edges: value(record, path, ("edges", "a text"), text)?,
            label_ids: value(record, path, ("label_ids", "canonical or replicator"), label_ids)?,
            version: value(record, path, ("version", "a text"), text)?,
        })
    }
}

/// A value of a record, if it has the key.
fn value<T>(
    record: &Map<String, Value>,
    path: &Path,
    (key, wanted): (&str, &str),
    read: impl Fn(&Value) -> Option<T>,
) -> Result<Option<T>> {
    let refused = |value| {
        let message = format!("`{key}` is {value}; it has to be {wanted}");
        Error::Config { path: path.to_owned(), cause: std::io::Error::other(message) }
    };
    record.get(key).map(|value| read(value).ok_or_else(|| refused(value))).transpose()
}

impl Config {
    /// Applies a file, TOML or the record of a frame, and returns what that frame was made from; nothing for TOML. The path `-` is
    /// standard input. The file is read once, as a pipe can be.
    ///
    /// # Errors
    /// [`Error::Config`] if it cannot be read, or is JSON but no record; [`Error::Contradiction`] if the record's stage is not that of its
    /// knobs; those of [`Config::apply_toml`] and [`Config::apply_json`].
    pub fn apply_named_file(&mut self, path: &Path) -> Result<FrameOrigin> {
        let (text, origin) = (Self::read_file(path)?, path.display().to_string());
        if !is_json(&text, path) {
            return self.apply_toml(&text, &origin).map(|()| FrameOrigin::default());
        }
        let record = parse(&text, path)?;
        if let Some(knobs) = record["knobs"].as_object() {
            self.apply_json(knobs, &origin)?;
        }
        let stage = |value: &Value| value.as_str().map(str::to_owned);
        if let Some(stage) = value(&record, path, ("stage", "a text"), stage)? {
            self.check_recorded_stage(&stage, &origin)?;
        }
        FrameOrigin::of_record(&record, path)
    }

    /// Checks that the knobs of a record gave its stage.
    fn check_recorded_stage(&self, name: &str, origin: &str) -> Result<()> {
        let drawn = self.distribution(Knob::StageName);
        if self.has_stage(name) {
            return Ok(());
        }
        Err(Error::Contradiction(format!(
            "{origin} has `stage` {name}, while its `knobs` give stage.name = {drawn}; correct one of them"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stage_of_a_record_is_that_of_its_knobs() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("frame.json");
        let applied = |text: &str| {
            std::fs::write(&path, text).expect("written");
            Config::new().apply_named_file(&path)
        };
        for good in [
            r#"{"stage": "surface", "knobs": {"stage.name": "surface"}}"#,
            r#"{"stage": "nominal", "knobs": {"rocks.count": 3}}"#,
            r#"{"knobs": {"stage.name": "surface"}}"#,
        ] {
            applied(good).expect(good);
        }
        for (wrong, said) in [
            (r#"{"stage": "nominal", "knobs": {"stage.name": "surface"}}"#, "`stage` nominal, while"),
            (r#"{"stage": "surface", "knobs": {"rocks.count": 3}}"#, "stage.name = \"nominal\"; correct"),
        ] {
            let error = applied(wrong).expect_err(wrong);
            assert!(matches!(error, Error::Contradiction(_)) && error.to_string().contains(said), "{error}");
        }
        let error = applied(r#"{"stage": 3, "knobs": {}}"#).expect_err("a number");
        assert!(error.to_string().contains("`stage` is 3; it has to be a text"), "{error}");
        let error = applied(r#"{"samples": 3, "knobs": {}}"#).expect_err("no grid");
        assert!(error.to_string().contains("`samples` is 3; it has to be 1, 4 or 16"), "{error}");
    }

    #[test]
    fn a_record_is_known_by_its_content_or_its_extension() {
        let folder = tempfile::tempdir().expect("a folder");
        let applied = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            Config::new().apply_named_file(&path).map(|origin| origin.seed)
        };
        let record = "\u{feff}\n {\"knobs\": {\"rocks.count\": 3}, \"seed\": 7}";
        for name in ["frame.json", "frame.JSON", "frame", "frame.toml"] {
            assert_eq!(applied(name, record).expect(name), Some(7), "{name}");
        }
        assert_eq!(applied("knobs", "[rocks]\ncount = 3\n").expect("TOML"), None);
        assert!(matches!(applied("frame", "{}"), Err(Error::Config { .. })));
        assert!(matches!(applied("knobs.json", "rocks.count = 3"), Err(Error::Config { .. })));
        assert!(matches!(applied("knobs", "= 3"), Err(Error::Toml { .. })));
    }
}
