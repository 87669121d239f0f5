//! The plan of the dataset that a manifest describes, so that everything else can be derived from it again.
//!
//! Must not know: threads, files.

use serde_json::{Map, Value};

use super::{MAX_FRAMES, MAX_SIDE_PX, Plan, Range, Seeds, Shard, is_split_name};
use crate::dataset::rules::Rules;
use crate::error::{Error, Result};
use crate::output::layout::{self, Layout};
use crate::output::{self, LabelIds, OUTPUTS, Output};
use crate::params::config::Config;
use crate::render::RenderSettings;

/// Which files a dataset has: the part of its plan that every reader of its folder needs.
#[derive(Clone, Debug)]
pub struct Content {
    /// Name of the layout.
    pub format: &'static str,
    /// The layout.
    pub layout: &'static dyn Layout,
    /// The outputs of each frame.
    pub outputs: Vec<&'static Output>,
    /// The frames.
    pub range: Range,
    /// Name and number of frames of each split, in order.
    pub splits: Vec<(String, u64)>,
    /// Width and height of every image, pixels.
    pub size: [u32; 2],
}

impl Plan {
    /// Which files the dataset has that a manifest describes.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] that names the key, its value and what is expected.
    pub fn content_of_manifest(manifest: &Map<String, Value>) -> Result<Content> {
        let (format, layout) = read(manifest, "format", "the name of a dataset format", |value| {
            layout::find(value.as_str()?).ok()
        })?;
        let listed = read(manifest, "outputs", "a list of outputs", output_names)?;
        let is_written = |output: &&Output| {
            layout.supports(output.name)
                && (listed.contains(&output.name) || layout.required_outputs().contains(&output.name))
        };
        let range = range_of(manifest)?;
        let splits = read(manifest, "splits", "names with numbers of frames, `count` in all", |value| {
            splits(value, range.count)
        })?;
        Ok(Content {
            format,
            layout,
            outputs: OUTPUTS.iter().filter(is_written).collect(),
            range,
            splits,
            size: size_of(manifest)?,
        })
    }

    /// The plan of the dataset that a manifest describes. Keys that follow from others (class map, seeds of splits) are not
    /// read: [`Self::identity`] gives them.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] that names the key, its value and what is expected.
    pub fn of_manifest(manifest: &Map<String, Value>) -> Result<Self> {
        let Content { format, layout, outputs, range, splits, size } = Self::content_of_manifest(manifest)?;
        let recorded_ids = read(manifest, "label_ids", "canonical or replicator", |value| {
            LabelIds::from_name(value.as_str()?)
        })?;
        let mut settings = settings_of(manifest, size)?;
        settings.annotations = output::annotations(&outputs);
        Ok(Self {
            options: String::new(),
            config: config_of(manifest)?,
            rules: read(manifest, "rules", "the rules of a dataset", Rules::from_json)?,
            base_seed: read(manifest, "base_seed", "a whole number", Value::as_u64)?,
            seeds: Seeds::OfBase,
            settings,
            outputs,
            edges: read(manifest, "edges", "hard or ignore:N", |value| value.as_str()?.parse().ok())?,
            label_ids: if layout.has_fixed_ids() { LabelIds::default() } else { recorded_ids },
            format,
            layout,
            range,
            splits,
            shard: Shard::WHOLE,
        })
    }
}

/// The value of a key.
fn read<'a, T>(
    manifest: &'a Map<String, Value>,
    key: &str,
    expected: &str,
    parse: impl FnOnce(&'a Value) -> Option<T>,
) -> Result<T> {
    let value = manifest.get(key).unwrap_or(&Value::Null);
    parse(value).ok_or_else(|| refused(key, value, expected))
}

fn refused(key: &str, value: &Value, expected: &str) -> Error {
    let mut value = value.to_string();
    if value.len() > 200 {
        value = value.chars().take(200).chain("...".chars()).collect();
    }
    Error::CheckFailed(format!(
        "manifest.json: {key} is {value}; expected is {expected}. Delete the file and run the dataset's command with \
         --force, which writes it again"
    ))
}

fn output_names(value: &Value) -> Option<Vec<&str>> {
    let names = value.as_array()?.iter().map(|name| {
        let name = name.as_str()?;
        OUTPUTS.iter().any(|output| output.name == name).then_some(name)
    });
    names.collect()
}

fn range_of(manifest: &Map<String, Value>) -> Result<Range> {
    let start = read(manifest, "start", "a frame index below 2^32", |value| {
        value.as_u64().filter(|start| *start < MAX_FRAMES)
    })?;
    let expected = "a number of frames, at least 1, none of them after index 2^32 - 1";
    let count = read(manifest, "count", expected, |value| {
        value.as_u64().filter(|count| (1..=MAX_FRAMES - start).contains(count))
    })?;
    Ok(Range { start, count })
}

/// Names and numbers of frames.
fn splits(value: &Value, frames: u64) -> Option<Vec<(String, u64)>> {
    let mut left = frames;
    let rows = value.as_object()?.iter().map(|(name, split)| {
        let count = split.get("count")?.as_u64().filter(|count| *count > 0)?;
        left = left.checked_sub(count)?;
        is_split_name(name).then(|| (name.clone(), count))
    });
    let rows = rows.collect::<Option<Vec<_>>>()?;
    (rows.is_empty() || left == 0).then_some(rows)
}

fn size_of(manifest: &Map<String, Value>) -> Result<[u32; 2]> {
    read(manifest, "size", "[width, height] in pixels", |value| {
        let [width, height] = value.as_array()?.as_slice() else { return None };
        let side = |value: &Value| {
            u32::try_from(value.as_u64()?).ok().filter(|side| (1..=MAX_SIDE_PX).contains(side))
        };
        Some([side(width)?, side(height)?])
    })
}

fn settings_of(manifest: &Map<String, Value>, size: [u32; 2]) -> Result<RenderSettings> {
    read(manifest, "samples", "1, 4 or 16", |value| {
        RenderSettings::new(size, u32::try_from(value.as_u64()?).ok()?).ok()
    })
}

fn config_of(manifest: &Map<String, Value>) -> Result<Config> {
    let knobs = read(manifest, "config", "the distributions of the knobs", Value::as_object)?;
    let mut config = Config::new();
    config
        .apply_json(knobs, "manifest.json")
        .and_then(|()| config.check())
        .map_err(|error| Error::CheckFailed(format!("manifest.json: config: {error}")))?;
    Ok(config)
}
