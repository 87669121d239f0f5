//! The layouts that a dataset can have: one row of [`WRITERS`] for each.
//!
//! A [`Writer`] says where a frame's files go, and which files index the whole. It is given encoded outputs and
//! planes, never a scene, so that a finished dataset converts without rendering.
//! Must not know: scene, GPU, the disk.
//! To add a layout: a file in `output/` with its `Writer`, and its row in [`WRITERS`].

use std::path::Path;

use serde_json::{Map, Value};

use super::basic::Basic;
use super::cityscapes::Cityscapes;
use super::coco::Coco;
use super::folder::Folder;
use super::hugging_face::HuggingFace;
use super::webdataset::WebDataset;
use super::{Artifact, Encoded};
use crate::error::{Error, Result, nearest};
use crate::frame::Frame;

/// One frame of a dataset, rendered and encoded.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// Its number in the dataset.
    pub index: u64,
    /// The split that it belongs to; empty if there are none.
    pub split: &'a str,
    /// Its planes: `class` under the edge policy, and what [`Writer::outputs`] asks for.
    pub frame: &'a Frame,
    /// Its encoded outputs.
    pub files: &'a [Encoded],
    /// What is recorded of it: its line of `frames.jsonl` but for files and times.
    pub record: &'a Map<String, Value>,
}

/// Where a frame's files go.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Placed {
    /// The files, by their path below the dataset's folder.
    pub files: Vec<Artifact>,
    /// What [`Writer::index`] needs to know of the frame besides its record; null for nothing.
    pub entry: Value,
}

/// The lines of `frames.jsonl` by rising index, which may be too many for memory.
pub trait Lines: std::fmt::Debug {
    /// Gives one after the other.
    ///
    /// # Errors
    /// Those of reading and of `visit`.
    fn for_each(&self, visit: &mut dyn FnMut(Map<String, Value>) -> Result<()>) -> Result<()>;
}

/// A whole dataset, for the files that index it.
#[derive(Clone, Copy, Debug)]
pub struct Index<'a> {
    /// Where it lies.
    pub folder: &'a Path,
    /// Its lines; a line has the frame's `entry`, and its `split` if there are any.
    pub lines: &'a dyn Lines,
    /// The manifest.
    pub manifest: &'a Map<String, Value>,
    /// Text of the data card: what a person should know of the dataset, in Markdown.
    pub card: &'a str,
}

impl Index<'_> {
    /// Names of the splits in their order; `train` if there are none.
    #[must_use]
    pub fn split_names(&self) -> Vec<String> {
        let splits =
            self.manifest.get("splits").and_then(Value::as_object).filter(|splits| !splits.is_empty());
        splits.map_or_else(|| vec!["train".to_owned()], |splits| splits.keys().cloned().collect())
    }

    /// The data card as a file.
    #[must_use]
    pub fn card_file(&self) -> Artifact {
        Artifact { name: "README.md".to_owned(), bytes: self.card.as_bytes().to_vec() }
    }
}

/// The split's name, `train` if there are none: for layouts that cannot be without.
#[must_use]
pub fn split_or_train(split: &str) -> &str {
    if split.is_empty() { "train" } else { split }
}

/// A layout of a dataset.
pub trait Writer: std::fmt::Debug + Sync {
    /// Outputs without which the layout cannot be, besides those that the user asks for.
    fn outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask"]
    }

    /// Outputs for which the layout has a place.
    fn holds(&self, output: &str) -> bool;

    /// Whether its classes have ids of its own, whatever `--label-ids` says.
    fn has_own_ids(&self) -> bool {
        false
    }

    /// The files of one frame. Called by many threads at once.
    ///
    /// # Errors
    /// [`Error::Encode`].
    fn place(&self, sample: &Sample<'_>) -> Result<Placed>;

    /// Paths of the picture and the mask of a frame, if they lie there as files: for the contact sheet.
    fn pictures(&self, _split: &str, _index: u64) -> Option<[String; 2]> {
        None
    }

    /// Gives the files that index the whole dataset to `put`, one after the other; done again whenever it has grown.
    ///
    /// # Errors
    /// Those of reading, encoding and `put`.
    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()>;
}

/// Every layout by its word in `--format`, with what it is.
pub static WRITERS: [(&str, &str, &dyn Writer); 6] = [
    ("folder", "a folder for each output; what verify checks in full and convert reads", &Folder),
    ("basic", "flat, with the names of Replicator's BasicWriter", &Basic),
    ("coco", "COCO: rocks as instances, everything as panoptic segments", &Coco),
    ("cityscapes", "Cityscapes: leftImg8bit and gtFine of the city moon", &Cityscapes),
    ("hf", "Hugging Face imagefolder, with a data card", &HuggingFace),
    ("webdataset", "WebDataset: tar shards of 1000 frames", &WebDataset),
];

/// The layout of this name.
///
/// # Errors
/// [`Error::Usage`] for an unknown one.
pub fn writer(name: &str) -> Result<(&'static str, &'static dyn Writer)> {
    WRITERS.iter().find(|row| row.0 == name).map(|row| (row.0, row.2)).ok_or_else(|| {
        let names = || WRITERS.iter().map(|row| row.0);
        let meant =
            nearest(name, names()).map_or_else(String::new, |name| format!(" (did you mean `{name}`?)"));
        let all: Vec<&str> = names().collect();
        Error::Usage(format!("--format {name}: unknown format{meant}; there are {}", all.join(", ")))
    })
}

/// A path below the dataset's folder, in the split's folder if there are splits.
#[must_use]
pub fn below_split(split: &str, path: &str) -> String {
    if split.is_empty() { path.to_owned() } else { format!("{split}/{path}") }
}
