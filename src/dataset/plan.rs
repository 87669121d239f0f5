//! What a dataset consists of: which frames, of which scenes, in which layout.
//!
//! Frame i is a function of the base seed, i and the configuration alone. Its scene's seed is
//! `first_seed(base) + attempt * 2^32 + i` (modulo 2^53, so that JSON readers keep every digit): frames of one base
//! seed never share a scene, whichever splits, shards and attempts they belong to. The range of seeds in a manifest shows
//! the same for two datasets.
//! Must not know: threads, files.

mod of_manifest;
mod shard;

use serde_json::{Map, Value, json};
use twox_hash::XxHash3_128;

use super::rules::{Rules, Violation};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::output::edges::{EdgePolicy, MaskIds};
use crate::output::layout::{self, Layout};
use crate::output::{self, LabelIds, Output};
use crate::params::config::Config;
use crate::render::RenderSettings;
use crate::scene::Scene;
pub use shard::Shard;

/// All seeds are smaller than this.
const SEEDS: u64 = 1 << 53;
/// Largest number of frames of a base seed, and distance between the seeds of a frame's attempts.
pub const MAX_FRAMES: u64 = 1 << 32;
/// Largest side of an image, pixels; no device renders a larger one.
const MAX_SIDE_PX: u32 = 1 << 15;

/// What a dataset consists of.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The distribution of each knob.
    pub config: Config,
    /// The options of a command line that give this configuration, and the rasteriser if it is named, for the manifest.
    pub options: String,
    /// Which frames are accepted.
    pub rules: Rules,
    /// The seed from which every frame's seed is derived.
    pub base_seed: u64,
    /// How the seed of a frame's scene follows from its index.
    pub seeds: Seeds,
    /// Size, samples per pixel, annotations.
    pub settings: RenderSettings,
    /// The outputs that are written for each frame.
    pub outputs: Vec<&'static Output>,
    /// What the mask holds where classes meet.
    pub edges: EdgePolicy,
    /// The numbering of the classes in the mask.
    pub label_ids: LabelIds,
    /// Name of the layout in the table of layouts.
    pub format: &'static str,
    /// The layout.
    pub layout: &'static dyn Layout,
    /// The frames of the dataset.
    pub range: Range,
    /// Name and number of frames of each split, in order from the first frame; empty for a dataset without splits.
    pub splits: Vec<(String, u64)>,
    /// The part of the frames that this run makes.
    pub shard: Shard,
}

/// How the seed of a frame's scene follows from its index.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Seeds {
    /// By [`frame_seed`], as in every dataset.
    #[default]
    OfBase,
    /// The index is the seed itself: frames that are asked for by seed. There is no other attempt at one.
    Given,
}

/// Frames from `start` to `start + count - 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range {
    /// Index of the first frame.
    pub start: u64,
    /// Number of frames.
    pub count: u64,
}

impl Range {
    /// The index after the last frame.
    #[must_use]
    pub const fn end(self) -> u64 {
        self.start + self.count
    }

    /// The smallest range that contains both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        let start = self.start.min(other.start);
        Self { start, count: self.end().max(other.end()) - start }
    }
}

/// Parses a list of splits, as in `train=1500,val=200`.
///
/// # Errors
/// [`Error::Usage`] for an empty or repeated name, a missing number of frames, or more frames than a dataset has.
pub fn parse_splits(text: &str) -> Result<Vec<(String, u64)>> {
    let refused = |why: &str| {
        Error::Usage(format!("--split {text}: {why}; the form is NAME=FRAMES,..., as in train=1500,val=200"))
    };
    let mut splits: Vec<(String, u64)> = Vec::new();
    let mut frames: u64 = 0;
    for part in text.split(',') {
        let (name, count) = part.split_once('=').ok_or_else(|| refused(&format!("`{part}` has no `=`")))?;
        let name = name.trim();
        if !is_split_name(name) {
            return Err(refused(&format!("`{name}` is not a name; allowed are letters, digits, - and _")));
        }
        if splits.iter().any(|(known, _)| known == name) {
            return Err(refused(&format!("`{name}` occurs twice")));
        }
        let count = count.trim().parse().ok().filter(|count| *count > 0);
        let count = count.ok_or_else(|| refused(&format!("`{part}` has no positive number of frames")))?;
        let sum = frames.checked_add(count).filter(|frames| *frames <= MAX_FRAMES);
        frames = sum.ok_or_else(|| refused(&format!("a dataset has at most {MAX_FRAMES} frames in all")))?;
        splits.push((name.to_owned(), count));
    }
    Ok(splits)
}

/// Whether a split can have this name, which is also that of a folder.
fn is_split_name(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

/// The seed of the first attempt at frame 0.
#[must_use]
pub fn first_seed(base_seed: u64) -> u64 {
    let hash = XxHash3_128::oneshot(&[b"dataset".as_slice(), &base_seed.to_le_bytes()].concat());
    (hash % u128::from(SEEDS)) as u64
}

/// The seed of the scene of an attempt at a frame.
#[must_use]
pub fn frame_seed(base_seed: u64, index: u64, attempt: u32) -> u64 {
    let offset = u64::from(attempt) * MAX_FRAMES % SEEDS;
    (first_seed(base_seed) + offset + index) % SEEDS
}

impl Plan {
    /// The outputs of a frame when `--outputs` is not given.
    pub const DEFAULT_OUTPUTS: &'static str = "rgb,mask,preview";

    /// A plan of frames that stay in memory.
    #[must_use]
    pub fn in_memory(
        config: Config,
        rules: Rules,
        base_seed: u64,
        mut settings: RenderSettings,
        outputs: Vec<&'static Output>,
    ) -> Self {
        settings.annotations = output::annotations(&outputs);
        let (format, layout) = layout::default();
        Self {
            options: String::new(),
            config,
            rules,
            base_seed,
            seeds: Seeds::OfBase,
            settings,
            outputs,
            edges: EdgePolicy::default(),
            label_ids: LabelIds::default(),
            format,
            layout,
            range: Range { start: 0, count: MAX_FRAMES },
            splits: Vec::new(),
            shard: Shard::WHOLE,
        }
    }

    /// The rule that a frame breaks, if any. A frame that was asked for by its seed is not held to rules.
    #[must_use]
    pub fn violation(&self, scene: &Scene, frame: &Frame, mask: &MaskIds) -> Option<Violation> {
        match self.seeds {
            Seeds::OfBase => self.rules.violation(scene, frame, mask),
            Seeds::Given => None,
        }
    }

    /// The rule that a scene breaks before its frame is rendered, if any, as [`Self::violation`] names it.
    #[must_use]
    pub fn violation_of_scene(&self, scene: &Scene) -> Option<Violation> {
        match self.seeds {
            Seeds::OfBase => Rules::violation_of_scene(scene),
            Seeds::Given => None,
        }
    }

    /// The seed of the scene of an attempt at a frame.
    #[must_use]
    pub fn seed_of(&self, index: u64, attempt: u32) -> u64 {
        match self.seeds {
            Seeds::OfBase => frame_seed(self.base_seed, index, attempt),
            Seeds::Given => index,
        }
    }

    /// The indices of the frames that this run makes, ascending.
    pub fn own_indices(&self) -> impl Iterator<Item = u64> + Clone + Send + use<> {
        let first = self.shard.first_from(self.range.start);
        // No range has as many frames as a step that is too large for the machine.
        (first..self.range.end()).step_by(usize::try_from(self.shard.of).unwrap_or(usize::MAX))
    }

    /// Number of frames that this run makes.
    #[must_use]
    pub fn own_count(&self) -> u64 {
        self.shard.count_in(&(self.range.start..self.range.end()))
    }

    /// The split that a frame belongs to; empty if there are no splits.
    #[must_use]
    pub fn split_of(&self, index: u64) -> &str {
        let mut end = self.range.start;
        for (name, count) in &self.splits {
            end += count;
            if index < end {
                return name;
            }
        }
        ""
    }

    /// The `splits` of a manifest: frames, and the first and last seed of their first attempts.
    #[must_use]
    pub fn splits_json(&self) -> Value {
        let mut start = self.range.start;
        let rows = self.splits.iter().map(|(name, count)| {
            let last = start + count - 1;
            let seeds = [start, last].map(|index| frame_seed(self.base_seed, index, 0));
            let row = json!({ "start": start, "count": count, "seeds": seeds });
            start = last + 1;
            (name.clone(), row)
        });
        rows.collect::<Map<_, _>>().into()
    }

    /// Everything that decides the content of the files: two runs with the same identity make the same dataset.
    #[must_use]
    pub fn identity(&self) -> Map<String, Value> {
        let outputs: Vec<&str> = self.outputs.iter().map(|output| output.name).collect();
        let ids = Self::identity_of_ids(self.label_ids);
        let identity = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "format": self.format,
            "base_seed": self.base_seed,
            "size": self.settings.size,
            "samples": self.settings.samples_per_side.pow(2),
            "outputs": outputs,
            "edges": self.edges.to_string(),
            "label_ids": ids["label_ids"],
            "class_map": ids["class_map"],
            "ignore_index": ids["ignore_index"],
            "splits": self.splits_json(),
            "rules": self.rules.to_json(),
            "config": self.config.distributions_json(),
        });
        match identity {
            Value::Object(identity) => identity,
            _ => unreachable!("it is an object"),
        }
    }

    /// Checks the requested size of the images, pixels.
    ///
    /// # Errors
    /// [`Error::Usage`] for one that no device renders.
    pub fn check_size([width, height]: [u32; 2]) -> Result<()> {
        if width.max(height) > MAX_SIDE_PX {
            let message = format!("--size {width}x{height}: no side has more than {MAX_SIDE_PX} pixels");
            return Err(Error::Usage(message));
        }
        Ok(())
    }

    /// Checks the requested numbering of the classes against the layout.
    ///
    /// # Errors
    /// [`Error::Usage`] if the layout numbers the classes itself.
    pub fn label_ids(requested: LabelIds, format: &str, layout: &dyn Layout) -> Result<LabelIds> {
        if layout.has_fixed_ids() && requested != LabelIds::default() {
            return Err(Error::Usage(format!(
                "--label-ids {}: --format {format} has ids of its own; leave out --label-ids, or choose another format",
                requested.name()
            )));
        }
        Ok(requested)
    }

    /// The part of [`Self::identity`] that describes the ids in the masks.
    #[must_use]
    pub fn identity_of_ids(label_ids: LabelIds) -> Map<String, Value> {
        let classes: Map<String, Value> = ClassId::ALL
            .iter()
            .map(|class| (class.name.to_owned(), label_ids.mask_id(class.id.0).into()))
            .collect();
        [
            ("label_ids", label_ids.name().into()),
            ("class_map", classes.into()),
            ("ignore_index", label_ids.mask_id(ClassId::UNLABELLED.0).into()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into_iter()
        .collect()
    }

    /// The requested outputs (without a list, the default ones that the layout supports) and those that the layout
    /// requires.
    ///
    /// # Errors
    /// [`Error::Usage`] for an unknown output, or one that the layout does not support.
    pub fn outputs(list: Option<&str>, format: &str, layout: &dyn Layout) -> Result<Vec<&'static Output>> {
        let requested = output::parse_outputs(list.unwrap_or(Self::DEFAULT_OUTPUTS))?;
        let takes_any = list.is_none_or(|list| list.split(',').any(|word| word.trim() == "all"));
        if let Some(unsupported) = requested.iter().find(|output| !takes_any && !layout.supports(output.name))
        {
            let supported: Vec<&str> = output::OUTPUTS
                .iter()
                .map(|output| output.name)
                .filter(|name| layout.supports(name))
                .collect();
            return Err(Error::Usage(format!(
                "--outputs {}: --format {format} has no place for it; it holds {}",
                unsupported.name,
                supported.join(", ")
            )));
        }
        let named = |name: &str| requested.iter().any(|output| output.name == name);
        Ok(output::OUTPUTS
            .iter()
            .filter(|o| {
                layout.supports(o.name) && (named(o.name) || layout.required_outputs().contains(&o.name))
            })
            .collect())
    }
}

/// Where two identities differ, one line for each knob or key: the value in the folder and that of the run.
#[must_use]
pub fn differences(folder: &Map<String, Value>, run: &Map<String, Value>) -> Vec<String> {
    fn collect(prefix: &str, a: &Value, b: &Value, lines: &mut Vec<String>) {
        // A distribution is shown as a whole.
        let section = |value: &Value, prefix: &str| value.is_object() && matches!(prefix, "config" | "rules");
        if section(a, prefix) && section(b, prefix) {
            let (Value::Object(a), Value::Object(b)) = (a, b) else { return };
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                let null = Value::Null;
                let name = if prefix == "config" { key.clone() } else { format!("{prefix}.{key}") };
                collect(&name, a.get(key).unwrap_or(&null), b.get(key).unwrap_or(&null), lines);
            }
        } else if a != b {
            lines.push(format!("  {prefix}: there {a}, now {b}"));
        }
    }
    let mut lines = Vec::new();
    for (key, now) in run {
        collect(key, folder.get(key).unwrap_or(&Value::Null), now, &mut lines);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_of_a_base_are_distinct_and_survive_json() {
        for base in [0, 1, 42, 7777, u64::MAX] {
            let mut seeds: Vec<u64> =
                (0..1000).flat_map(|i| [0, 1, 19].map(|a| frame_seed(base, i, a))).collect();
            seeds.sort_unstable();
            seeds.dedup();
            assert_eq!(seeds.len(), 3000);
            assert!(seeds.iter().all(|seed| (*seed as f64) as u64 == *seed));
        }
        // Neighbouring base seeds are far apart.
        let near = first_seed(42).abs_diff(first_seed(43));
        assert!(near > MAX_FRAMES, "{near}");
        // A change here changes every dataset ever made.
        assert_eq!(frame_seed(42, 17, 0), 8_006_897_132_670_268);
        assert!(frame_seed(42, MAX_FRAMES - 1, u32::MAX) < SEEDS);
    }

    #[test]
    fn splits_keep_their_order_and_invalid_ones_are_refused() {
        let splits = parse_splits("train=1500, val=200").expect("read");
        assert_eq!(splits, [("train".to_owned(), 1500), ("val".to_owned(), 200)]);
        assert!(parse_splits("a=4294967295,b=1").is_ok());
        for wrong in ["train", "train=", "train=0", "=3", "a=1,a=2", "a/b=1", "../x=2", "a=4294967296,b=1"] {
            assert!(parse_splits(wrong).is_err(), "{wrong}");
        }
        let message = parse_splits("a=18446744073709551615,b=2").expect_err("too many").to_string();
        assert!(message.contains("at most 4294967296 frames"), "{message}");
    }

    #[test]
    fn sizes_beyond_those_of_devices_are_errors_of_usage() {
        assert!(Plan::check_size([32_768, 1]).is_ok());
        let error = Plan::check_size([40_000, 10]).expect_err("too wide");
        assert!(matches!(error, Error::Usage(_)) && error.to_string().contains("--size 40000x10"), "{error}");
    }

    #[test]
    fn differences_name_the_knob() {
        let of = |value: Value| value.as_object().expect("an object").clone();
        let a = of(
            json!({ "size": [64, 64], "config": { "sun.elevation_deg": { "uniform": [5, 40] }, "x": 1 } }),
        );
        let b = of(json!({ "size": [64, 64], "config": { "sun.elevation_deg": 17, "x": 1 } }));
        assert_eq!(differences(&a, &b), ["  sun.elevation_deg: there {\"uniform\":[5,40]}, now 17"]);
        assert!(differences(&a, &a).is_empty());
    }
}
