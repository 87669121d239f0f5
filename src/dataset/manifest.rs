//! `manifest.json`: what a dataset holds and how far it is.
//!
//! Must not know: the lines of frames.

use serde_json::{Map, Value};

use super::contact_sheet::CONTACT_SHEET_FILE;
use super::digest;
use super::histograms::HISTOGRAMS_FILE;
use super::plan::{Plan, Range, Shard};
use crate::error::Result;
use crate::output::Artifact;
use crate::output::encode::json;
use crate::output::layout::{Layout, SplitRange};

/// Keys of a manifest that describe its state; all others identify the dataset.
const STATE_KEYS: [&str; 11] = [
    "status",
    "start",
    "count",
    "n_completed",
    "seeds",
    PRESET,
    COMMAND,
    "adapters",
    "totals",
    "index_files",
    digest::KEY,
];
/// Key of the preset that the knobs come from; null if there is none.
const PRESET: &str = "preset";
/// Key of the command that makes the dataset, but for the folder and what has no effect on the files.
const COMMAND: &str = "command";
/// How every command begins, and the first option after those that set the knobs or name the rasteriser.
const PROGRAM: &str = "regolith-render dataset";
const SEED: &str = " --seed ";

/// Which dataset a folder is to hold, and which of its frames.
#[derive(Clone, Debug)]
pub struct DatasetSpec {
    /// Everything that decides the content of the files; see [`Plan::identity`].
    pub identity: Map<String, Value>,
    /// The options of the command that set the knobs or name the rasteriser.
    pub options: String,
    /// The frames.
    pub range: Range,
    /// Whether the frames are divided into splits, so that no other range can be added.
    pub is_split: bool,
    /// The frames of the range that this run makes.
    pub shard: Shard,
}

impl DatasetSpec {
    /// The dataset of a plan.
    #[must_use]
    pub fn of_plan(plan: &Plan) -> Self {
        Self {
            identity: plan.identity(),
            options: plan.options.clone(),
            range: plan.range,
            is_split: !plan.splits.is_empty(),
            shard: plan.shard,
        }
    }

    /// The dataset that a manifest describes.
    #[must_use]
    pub fn of_manifest(manifest: &Map<String, Value>) -> Self {
        let is_split =
            manifest.get("splits").and_then(Value::as_object).is_some_and(|splits| !splits.is_empty());
        let (identity, options) = (identity_of(manifest.clone()), options_of(manifest));
        Self { identity, options, range: range_of(manifest), is_split, shard: Shard::WHOLE }
    }
}

/// The part of a manifest that identifies the dataset.
#[must_use]
pub fn identity_of(mut manifest: Map<String, Value>) -> Map<String, Value> {
    manifest.retain(|key, _| !STATE_KEYS.contains(&key.as_str()));
    manifest
}

/// The options of a manifest's command that set the knobs or name the rasteriser; empty if it has no command.
#[must_use]
pub fn options_of(manifest: &Map<String, Value>) -> String {
    let command = manifest.get(COMMAND).and_then(Value::as_str).and_then(|text| text.strip_prefix(PROGRAM));
    command.and_then(|text| text.rsplit_once(SEED)).map_or("", |(options, _)| options.trim()).to_owned()
}

/// The keys of a manifest that say which command makes the dataset. It follows from the options that set the knobs or name the rasteriser,
/// the identity and the range, so that shards, resumed runs and conversions have the same.
#[must_use]
pub fn command(options: &str, identity: &Map<String, Value>, range: Range) -> Map<String, Value> {
    let text = |key: &str| identity.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
    let number = |key: &str| identity.get(key).and_then(Value::as_u64).unwrap_or_default();
    let list = |key: &str, separator: &str| {
        let items = identity.get(key).and_then(Value::as_array).into_iter().flatten();
        items
            .map(|item| item.as_str().map_or_else(|| item.to_string(), str::to_owned))
            .collect::<Vec<_>>()
            .join(separator)
    };
    let splits: Vec<String> = identity
        .get("splits")
        .and_then(Value::as_object)
        .into_iter()
        .flatten()
        .map(|(name, split)| format!("{name}={}", split["count"]))
        .collect();
    let frames = match (splits.is_empty(), range.start) {
        (false, _) => format!("--split {}", splits.join(",")),
        (true, 0) => format!("--count {}", range.count),
        (true, start) => format!("--start {start} --count {}", range.count),
    };
    let space = if options.is_empty() { "" } else { " " };
    let command = format!(
        "{PROGRAM}{space}{options}{SEED}{} --size {} --samples {} --edges {} --label-ids {} --outputs {} --format {} {frames}",
        number("base_seed"),
        list("size", "x"),
        number("samples"),
        text("edges"),
        text("label_ids"),
        list("outputs", ","),
        text("format"),
    );
    let words = shell_words(options);
    // Each option has a value.
    let preset = words.chunks(2).find(|pair| pair[0] == "--preset").and_then(|pair| pair.get(1));
    let preset = preset.map_or(Value::Null, |preset| preset.as_str().into());
    [(PRESET, preset), (COMMAND, command.into())]
        .map(|(key, value)| (key.to_owned(), value))
        .into_iter()
        .collect()
}

/// A word as a shell reads it.
#[must_use]
pub fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_.,:/=+-".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// The words of a command line as a shell reads them, but for what it expands.
#[must_use]
pub fn shell_words(text: &str) -> Vec<String> {
    let (mut words, mut word, mut is_quoted) = (Vec::new(), String::new(), false);
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        match c {
            '\'' => is_quoted = !is_quoted,
            '\\' if !is_quoted => word.extend(chars.next()),
            ' ' if !is_quoted => words.push(std::mem::take(&mut word)),
            _ => word.push(c),
        }
    }
    words.push(word);
    words
}

/// The frames of a manifest.
#[must_use]
pub fn range_of(manifest: &Map<String, Value>) -> Range {
    let number = |key: &str| manifest.get(key).and_then(Value::as_u64).unwrap_or_default();
    Range { start: number("start"), count: number("count") }
}

/// The splits of a manifest in their order; one without a name, with all frames, if there are none.
#[must_use]
pub fn splits_of(manifest: &Map<String, Value>) -> Vec<SplitRange> {
    let range = range_of(manifest);
    let mut start = range.start;
    let rows = manifest.get("splits").and_then(Value::as_object).into_iter().flatten();
    let mut splits: Vec<SplitRange> = rows
        .map(|(name, row)| {
            let count = row.get("count").and_then(Value::as_u64).unwrap_or_default();
            let split = SplitRange { name: name.clone(), start, count };
            start = start.saturating_add(count);
            split
        })
        .collect();
    if splits.is_empty() {
        splits.push(SplitRange { name: String::new(), start: range.start, count: range.count });
    }
    splits
}

/// Paths of the files that a complete dataset has besides its frames, its log and its manifest: the keys of
/// `index_files`.
pub fn index_paths<'a>(
    layout: &'static dyn Layout,
    splits: &'a [SplitRange],
) -> impl Iterator<Item = String> + 'a {
    let has_sheet = layout.image_and_mask("", 0).is_some();
    let own = [Some(HISTOGRAMS_FILE), has_sheet.then_some(CONTACT_SHEET_FILE)];
    layout.index_paths(splits).chain(own.into_iter().flatten().map(str::to_owned))
}

/// A manifest as a file of this name.
///
/// # Errors
/// [`Error::Encode`](crate::Error::Encode).
pub fn to_file(name: String, manifest: Map<String, Value>) -> Result<Artifact> {
    Ok(Artifact { name, bytes: json::to_bytes(&manifest)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_has_its_options_and_the_preset_among_them() {
        let quoted = r"--config 'a --preset b'\''s.toml'";
        for (options, preset) in [
            ("", None),
            ("--raster host", None),
            (
                "--stage surface --preset train_dr,sun_polar --set a=1 --raster host",
                Some("train_dr,sun_polar"),
            ),
            (quoted, None),
            ("--config --preset --set a=1", None),
            (&format!("--preset train_dr {quoted}"), Some("train_dr")),
        ] {
            let manifest = command(options, &Map::new(), Range { start: 0, count: 3 });
            assert_eq!(options_of(&manifest), options);
            assert_eq!(manifest[PRESET].as_str(), preset, "{options}");
        }
        assert_eq!(shell_words(quoted), ["--config", "a --preset b's.toml"]);
        for word in ["", "plain", "a b", "$(x)", "it's", r"''"] {
            assert_eq!(shell_words(&shell_word(word)), [word]);
        }
    }
}
