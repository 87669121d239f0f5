//! A line of `frames.jsonl`: what a dataset records about one frame.
//!
//! It stands here rather than in `dataset`, because layouts read it to make their index files.
//! Must not know: files, how frames are made.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::frame::{ImageExposure, RgbStatistics};
use crate::input;

/// A line of `frames.jsonl`. Fields are written in this order; absent and empty ones are left out where marked.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameLine {
    /// Number of the frame in the dataset.
    pub index: u64,
    /// The split that it belongs to; empty, and not written, in a dataset without splits.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub split: String,
    /// Number of the attempt that was accepted, from 0.
    pub attempt: u32,
    /// The rule that each rejected attempt broke; not written if none was rejected.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub redrawn: Vec<String>,
    /// Seed of the scene.
    pub seed: u64,
    /// Name of the stage.
    pub stage: String,
    /// Name of the adapter that rendered it.
    pub adapter: String,
    /// Name of the raster backend; datasets of version 0.1 do not record it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raster: Option<String>,
    /// Every knob as used, by dotted name.
    pub knobs: Map<String, Value>,
    /// Hash of the scene's geometry.
    pub geometry_hash: String,
    /// Intrinsics, pose and lens.
    pub camera: Value,
    /// Direction and size of the sun.
    pub sun: Value,
    /// Fraction of the pixels by class name, and under `unlabelled`.
    pub coverage: Map<String, Value>,
    /// Fraction of the pixels of the mask as it is written, by class name and under `ignored`; not written if it has no band of ignored
    /// pixels at the boundaries of classes, since `coverage` has the same then.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub mask_coverage: Map<String, Value>,
    /// How the radiance became the RGB image; datasets of version 0.1 do not record it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ImageExposure>,
    /// Statistics of the RGB image.
    pub rgb: RgbStatistics,
    /// Rocks that were moved out of the camera's way.
    pub moved_rocks: Vec<u32>,
    /// Number of rocks that were left out because they would stand in or beside the camera; datasets of version 0.1 do not record it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out_rocks: Option<u32>,
    /// Keys that this version does not know; they are kept.
    #[serde(flatten)]
    pub other: Map<String, Value>,
    /// Content hash of each of the frame's files, by path below the dataset's folder.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub hashes: Map<String, Value>,
    /// What the layout keeps for its index files; see `FrameFiles::entry`.
    #[serde(default, skip_serializing_if = "Value::is_null")]
    pub entry: Value,
    /// Milliseconds of work by stage. Last in the line: all before it is the same in every run.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub ms: Map<String, Value>,
}

impl FrameLine {
    /// Reads a line. A key that occurs twice is an error.
    ///
    /// # Errors
    /// Those of the parser.
    pub fn parse(text: &[u8]) -> serde_json::Result<Self> {
        input::json::parse(text)
    }

    /// Fraction of the pixels that a class covers; `None` if the line does not say.
    #[must_use]
    pub fn coverage_of(&self, class: &str) -> Option<f64> {
        self.coverage.get(class).and_then(Value::as_f64)
    }

    /// Fraction of the pixels of the mask as it is written: of a class, or `ignored`; `None` if the line does not say.
    #[must_use]
    pub fn mask_coverage_of(&self, name: &str) -> Option<f64> {
        let fractions = if self.mask_coverage.is_empty() { &self.coverage } else { &self.mask_coverage };
        fractions.get(name).and_then(Value::as_f64)
    }

    /// Path and content hash of each of the frame's files.
    pub fn hashes(&self) -> impl Iterator<Item = (&str, &str)> {
        self.hashes.iter().filter_map(|(path, hash)| Some((path.as_str(), hash.as_str()?)))
    }

    /// The archive that the frame's files end up in, if its layout bundles files.
    #[must_use]
    pub fn bundle(&self) -> Option<&str> {
        self.entry.get("bundle").and_then(Value::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_its_bytes_and_unknown_keys() {
        let text = r#"{"index":7,"split":"val","attempt":1,"redrawn":["black"],"seed":9007199254740991,"stage":"nominal","adapter":"cpu","raster":"host","knobs":{"rocks.count":3,"sun.elevation_deg":17.5},"geometry_hash":"ab","camera":{"fx":0.1},"sun":{},"coverage":{"regolith":0.30000000000000004,"unlabelled":0.0},"rgb":{"mean":120.0,"p99":249,"max":250},"moved_rocks":[4],"weather":"clear","hashes":{"a.png":"00"},"entry":{"bundle":"x.tar"},"ms":{"scene":1.5}}"#;
        let line: FrameLine = serde_json::from_str(text).expect("a line");
        assert_eq!(serde_json::to_string(&line).expect("JSON"), text);
        assert_eq!((line.bundle(), line.coverage_of("regolith")), (Some("x.tar"), Some(0.1 + 0.2)));
        let plain = text
            .replace(r#""split":"val","#, "")
            .replace(r#","raster":"host""#, "")
            .replace(r#","entry":{"bundle":"x.tar"}"#, "");
        let line: FrameLine = serde_json::from_str(&plain).expect("a line");
        assert_eq!(serde_json::to_string(&line).expect("JSON"), plain);
        let with_band =
            plain.replace(r#""rgb":"#, r#""mask_coverage":{"regolith":0.25,"ignored":0.75},"rgb":"#);
        let with_band: FrameLine = serde_json::from_str(&with_band).expect("a line");
        let of = |line: &FrameLine| ["regolith", "ignored"].map(|name| line.mask_coverage_of(name));
        assert_eq!((of(&line), of(&with_band)), ([Some(0.1 + 0.2), None], [Some(0.25), Some(0.75)]));
        assert_eq!(with_band.coverage_of("regolith"), line.coverage_of("regolith"));
    }

    #[test]
    fn a_line_without_a_seed_is_refused() {
        let error = serde_json::from_str::<FrameLine>(r#"{"index":7,"attempt":0}"#).expect_err("no seed");
        assert!(error.to_string().contains("missing field `seed`"), "{error}");
    }
}
