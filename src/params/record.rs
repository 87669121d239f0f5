//! The record of a frame as a configuration: `--config frame_0000.json`.
//!
//! Must not know: the command line.

use std::path::Path;

use serde_json::{Map, Value};

use super::config::{Config, MAX_FILE_BYTES};
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

/// Whether a path is that of a record, by its extension.
#[must_use]
pub fn is_record(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// Reads a record.
///
/// # Errors
/// [`Error::Config`] if it cannot be read, or is none.
pub fn read(path: &Path) -> Result<Map<String, Value>> {
    let refused = |cause| Error::Config { path: path.to_owned(), cause };
    let text = input::read_named_text(path, MAX_FILE_BYTES).map_err(refused)?;
    let record: Map<String, Value> =
        input::json::parse(text.as_bytes()).map_err(|error| refused(std::io::Error::other(error)))?;
    if record.get("knobs").is_some_and(Value::is_object) {
        return Ok(record);
    }
    let message =
        "it is not the record of a frame: it has no `knobs`; a configuration that is not a record is TOML";
    Err(refused(std::io::Error::other(message)))
}

impl FrameOrigin {
    /// The origin of the record in a file.
    ///
    /// # Errors
    /// Those of [`read`]; [`Error::Config`] if a value has a wrong type or is out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let record = read(path)?;
        let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let label_ids =
            |value: &Value| text(value).filter(|name| matches!(name.as_str(), "canonical" | "replicator"));
        let size = |value: &Value| match value.as_array()?.as_slice() {
            [width, height] => Some([number(width)?, number(height)?]),
            _ => None,
        };
        Ok(Self {
            seed: value(&record, path, ("seed", "a whole number from 0 to 2^64 - 1"), Value::as_u64)?,
            size: value(&record, path, ("size", "two whole numbers, width and height in pixels"), size)?,
            samples: value(&record, path, ("samples", "a whole number"), number)?,
            edges: value(&record, path, ("edges", "a text"), text)?,
            label_ids: value(&record, path, ("label_ids", "canonical or replicator"), label_ids)?,
            version: value(&record, path, ("version", "a text"), text)?,
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
    /// Applies the knobs of a record.
    ///
    /// # Errors
    /// Those of [`read`] and [`Config::apply_json`].
    pub fn apply_record(&mut self, path: &Path) -> Result<()> {
        let record = read(path)?;
        match &record["knobs"] {
            Value::Object(knobs) => self.apply_json(knobs, &path.display().to_string()),
            _ => Ok(()),
        }
    }
}
