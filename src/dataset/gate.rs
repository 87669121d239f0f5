//! The gate: what a dataset's manifest and lines may say, whoever wrote them.
//!
//! Every number and every name that is read from a dataset passes here before anything is done with it. Files that a line
//! names must be those that the layout gives to this frame: names are compared, never trusted. So no text of a file
//! becomes a path.
//! Must not know: how frames are made, who reads.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Map, Value};

use super::manifest::{self, DatasetSpec};
use super::plan::{MAX_FRAMES, Plan, Range};
use crate::error::{Error, Result};
use crate::input::{self, MIB};
use crate::output::dataset_path;
use crate::output::layout::{FrameLine, FrameNames, Layout, SplitRange};
use crate::output::{FileKind, Output};

/// Largest size of a manifest. The longest part of one is its table of index files, with a row for 1000 frames.
const MAX_MANIFEST_BYTES: u64 = 256 * MIB;
/// Largest size of a line of `frames.jsonl`. The longest have an outline for each of thousands of rocks.
pub(super) const MAX_LINE_BYTES: u64 = 128 * MIB;
/// Texts of a file are quoted up to this length, characters.
const MAX_QUOTE: usize = 200;

/// What the lines of a dataset may say.
#[derive(Clone, Debug)]
pub struct Gate {
    layout: &'static dyn Layout,
    kinds: Vec<FileKind>,
    /// In the order of the frames; one without a name if the dataset has no splits.
    splits: Vec<SplitRange>,
    size: [u32; 2],
}

impl Gate {
    /// The gate of the dataset that a manifest describes.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] that names the key and its value.
    pub fn of_manifest(manifest: &Map<String, Value>) -> Result<Self> {
        let content = Plan::content_of_manifest(manifest)?;
        Ok(Self {
            layout: content.layout,
            kinds: content.outputs.iter().copied().flat_map(Output::file_kinds).collect(),
            splits: manifest::splits_of(manifest),
            size: content.size,
        })
    }

    /// The gate of a run.
    ///
    /// # Errors
    /// As [`Self::of_manifest`].
    pub fn of_spec(spec: &DatasetSpec) -> Result<Self> {
        Self::of_identity(&spec.identity, spec.range)
    }

    /// The gate of a dataset with this identity and range.
    ///
    /// # Errors
    /// As [`Self::of_manifest`].
    pub fn of_identity(identity: &Map<String, Value>, range: Range) -> Result<Self> {
        let mut manifest = identity.clone();
        manifest.insert("start".to_owned(), range.start.into());
        manifest.insert("count".to_owned(), range.count.into());
        Self::of_manifest(&manifest)
    }

    /// Width and height of every image, pixels.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The paths and names of a frame.
    #[must_use]
    pub fn names_of(&self, line: &FrameLine) -> FrameNames {
        self.layout.frame_names(&self.kinds, &line.split, line.index)
    }

    /// Whether every file that a frame has is in its line.
    #[must_use]
    pub fn lists_all_files(&self, line: &FrameLine) -> bool {
        self.names_of(line).files.iter().all(|path| line.hashes.contains_key(path))
    }

    /// The folders, below the dataset's, that the files of frames are in; the empty path is the dataset's own.
    #[must_use]
    pub fn frame_folders(&self) -> BTreeSet<String> {
        let first = |split: &SplitRange| self.layout.frame_names(&self.kinds, &split.name, split.start).files;
        let paths = self.splits.iter().flat_map(first);
        paths.map(|path| path.rsplit_once('/').map_or("", |(folder, _)| folder).to_owned()).collect()
    }

    /// Whether a path is that of the file of a frame.
    #[must_use]
    pub fn is_frame_file(&self, path: &str) -> bool {
        self.frame_of(path).is_some()
    }

    /// The index of the frame whose file a path is. It is a number in the file name, or two that follow each other.
    #[must_use]
    pub fn frame_of(&self, path: &str) -> Option<u64> {
        let name = path.rsplit_once('/').map_or(path, |(_, name)| name);
        let numbers: Vec<&str> =
            name.split(|c: char| !c.is_ascii_digit()).filter(|number| !number.is_empty()).collect();
        let candidates = numbers.windows(1).chain(numbers.windows(2)).map(<[&str]>::concat);
        let indices = candidates.filter_map(|number| number.parse().ok());
        let mut indices = indices.filter(|index| *index < MAX_FRAMES);
        indices.find(|index| {
            self.split_of(*index).is_some_and(|split| {
                self.layout.frame_names(&self.kinds, split, *index).files.iter().any(|file| file == path)
            })
        })
    }

    /// Checks a line.
    ///
    /// # Errors
    /// What is wrong, with key and value.
    pub fn check(&self, line: &FrameLine) -> Result<(), String> {
        if line.index >= MAX_FRAMES {
            return Err(format!("index is {}; the largest is {}", line.index, MAX_FRAMES - 1));
        }
        let split =
            self.split_of(line.index).ok_or_else(|| format!("index is {}, in no split", line.index))?;
        if line.split != split {
            let expected = if split.is_empty() { "none".to_owned() } else { format!("`{split}`") };
            return Err(format!(
                "split is {}; frame {} is in {expected}",
                quote(&line.split.as_str().into()),
                line.index
            ));
        }
        let names = self.names_of(line);
        for (path, hash) in &line.hashes {
            if !names.files.contains(path) {
                let why = dataset_path::problem(path).unwrap_or("the layout gives this frame no such file");
                return Err(format!("hashes has the file {}: {why}", quote(&path.as_str().into())));
            }
            if !hash.is_string() {
                return Err(format!("hashes: the hash of {path} is {}; expected is text", quote(hash)));
            }
        }
        check_entry(&line.entry, &names.entry)
    }

    /// The name of a frame's split, empty without splits; `None` if the dataset has splits and the frame is in none.
    fn split_of(&self, index: u64) -> Option<&str> {
        let is_in = |split: &&SplitRange| {
            split.name.is_empty() || (split.start..split.start.saturating_add(split.count)).contains(&index)
        };
        self.splits.iter().find(is_in).map(|split| split.name.as_str())
    }

    /// Checks the names of a manifest's index files.
    fn check_index_files(&self, manifest: &Map<String, Value>) -> Result<(), String> {
        let Some(files) = manifest.get("index_files") else { return Ok(()) };
        let files = files
            .as_object()
            .ok_or_else(|| format!("index_files is {}; expected is an object", quote(files)))?;
        let mut unknown: BTreeSet<&str> = files.keys().map(String::as_str).collect();
        for path in manifest::index_paths(self.layout, &self.splits) {
            if unknown.is_empty() {
                break;
            }
            unknown.remove(path.as_str());
        }
        if let Some(path) = unknown.first() {
            let why = dataset_path::problem(path).unwrap_or("the layout has no such file");
            return Err(format!("index_files has the file {}: {why}", quote(&(*path).into())));
        }
        match files.iter().find(|(_, hash)| !hash.is_string()) {
            Some((path, hash)) => {
                Err(format!("index_files: the hash of {path} is {}; expected is text", quote(hash)))
            }
            None => Ok(()),
        }
    }
}

/// Checks the names that a frame's entry holds: all of these, and no others.
fn check_entry(entry: &Value, names: &Map<String, Value>) -> Result<(), String> {
    let texts = entry.as_object().into_iter().flatten().filter(|(_, value)| value.is_string());
    for (key, value) in texts {
        if names.get(key) != Some(value) {
            return Err(format!(
                "entry: {key} is {}; the layout gives this frame another name",
                quote(value)
            ));
        }
    }
    match names.iter().find(|(key, name)| entry.get(key.as_str()) != Some(name)) {
        Some((key, name)) => Err(format!(
            "entry: {key} is {}; expected is {name}",
            quote(entry.get(key).unwrap_or(&Value::Null))
        )),
        None => Ok(()),
    }
}

/// A value of a file for a message, shortened.
fn quote(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= MAX_QUOTE {
        return text;
    }
    text.chars().take(MAX_QUOTE).chain("...".chars()).collect()
}

/// Reads a manifest, a file directly in its dataset's folder, and checks it.
///
/// # Errors
/// [`Error::Read`]; [`Error::CheckFailed`] that names the key and its value.
pub fn read_manifest(path: &Path) -> Result<Map<String, Value>> {
    let text = input::read(&dataset_path::own_file(path)?, MAX_MANIFEST_BYTES)?;
    let manifest = parse_manifest(path, &text)?;
    let at_path = |message: &str| {
        let message = message.strip_prefix("manifest.json: ").unwrap_or(message);
        Error::CheckFailed(format!("{}: {message}", path.display()))
    };
    let gate = Gate::of_manifest(&manifest).map_err(|error| at_path(&error.to_string()))?;
    gate.check_index_files(&manifest).map_err(|message| at_path(&message))?;
    Ok(manifest)
}

/// The error for a folder that has no manifest.
#[must_use]
pub fn no_dataset(folder: &Path) -> Error {
    let message = if folder.is_dir() {
        "not a dataset: it has no manifest.json"
    } else {
        "there is no such folder; name the folder of the dataset"
    };
    Error::Dataset { path: folder.to_owned(), message: message.to_owned() }
}

fn parse_manifest(path: &Path, text: &[u8]) -> Result<Map<String, Value>> {
    input::json::parse(text).map_err(|error| {
        Error::CheckFailed(format!(
            "{}: not a manifest ({error}); delete it and run the dataset's command with --force, which writes it again",
            path.display()
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::OUTPUTS;
    use crate::output::layout::LAYOUTS;

    #[test]
    fn files_of_frames_are_distinguished_from_others_in_every_layout() {
        for row in &LAYOUTS {
            let outputs = OUTPUTS.iter().filter(|output| row.layout.supports(output.name));
            let gate = Gate {
                layout: row.layout,
                kinds: outputs.flat_map(Output::file_kinds).collect(),
                splits: vec![SplitRange { name: String::new(), start: 0, count: MAX_FRAMES }],
                size: [8, 8],
            };
            for index in [0, 7, 12, 1_000_012, MAX_FRAMES - 1] {
                for path in gate.names_of(&FrameLine { index, ..FrameLine::default() }).files {
                    assert!(gate.is_frame_file(&path), "{}: {path}", row.name);
                    assert!(!gate.is_frame_file(&format!("{path}.bak")), "{}: {path}.bak", row.name);
                    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
                    assert!(gate.frame_folders().contains(folder), "{}: {folder}", row.name);
                }
            }
            assert!(
                !gate.is_frame_file("README.md") && !gate.is_frame_file("rgb/notes 7.txt"),
                "{}",
                row.name
            );
        }
    }
}
