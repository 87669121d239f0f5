//! What a layout of a dataset provides.
//!
//! A [`Layout`] decides where a frame's files go and which files index the dataset. It reads encoded files and planes,
//! never a scene, so that a finished dataset can be converted without rendering.
//! Must not know: which layouts there are, scene, GPU, the disk.

use std::io::Write;
use std::path::Path;

use serde_json::{Map, Value};

use super::frame_line::FrameLine;
use crate::error::Result;
use crate::frame::Frame;
use crate::output::artifact::{Artifact, EncodedFile, FileKind};

/// File name of the data card, which every layout has.
pub const CARD_FILE: &str = "README.md";

/// One frame of a dataset, rendered and encoded.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// Its planes: `class` under the edge policy, and the planes of [`Layout::required_outputs`].
    pub frame: &'a Frame,
    /// Its encoded outputs.
    pub files: &'a [EncodedFile],
    /// Its line of `frames.jsonl`, still without hashes, entry and times.
    pub record: &'a FrameLine,
}

impl Sample<'_> {
    /// The encoded RGB image; empty if it was not encoded.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        self.files.iter().find(|file| file.stem == "rgb").map_or(&[][..], |file| &file.bytes)
    }
}

/// The files of a frame in a layout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameFiles {
    /// The files, with their paths below the dataset's folder.
    pub artifacts: Vec<Artifact>,
    /// What [`Layout::index_files`] needs to know about the frame besides its record; null if nothing. It is kept in
    /// the frame's line of `frames.jsonl`.
    pub entry: Value,
}

/// What is known about a frame's [`FrameFiles`] before it is rendered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameNames {
    /// Paths of its files below the dataset's folder, in the order of [`FrameFiles::artifacts`].
    pub files: Vec<String>,
    /// The part of [`FrameFiles::entry`] that consists of names, by key; empty if there are none.
    pub entry: Map<String, Value>,
}

/// Name and frames of a split; the one of a dataset without splits has an empty name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitRange {
    /// Its name.
    pub name: String,
    /// Index of its first frame.
    pub start: u64,
    /// Number of its frames.
    pub count: u64,
}

/// The lines of `frames.jsonl` in ascending order of frame index, read one at a time: there may be too many for memory.
pub trait FrameLines: std::fmt::Debug {
    /// Calls `visit` with each line.
    ///
    /// # Errors
    /// Those of reading and of `visit`.
    fn for_each(&self, visit: &mut dyn FnMut(FrameLine) -> Result<()>) -> Result<()>;
}

/// A complete dataset, from which its index files are made.
#[derive(Clone, Copy, Debug)]
pub struct DatasetIndex<'a> {
    /// The dataset's folder.
    pub folder: &'a Path,
    /// Its lines, each with the `entry` of its frame.
    pub lines: &'a dyn FrameLines,
    /// The manifest.
    pub manifest: &'a Map<String, Value>,
    /// The data card, in Markdown.
    pub card: &'a str,
}

impl DatasetIndex<'_> {
    /// Names of the splits in their order; `train` in a dataset without splits.
    #[must_use]
    pub fn split_names(&self) -> Vec<String> {
        let splits =
            self.manifest.get("splits").and_then(Value::as_object).filter(|splits| !splits.is_empty());
        splits.map_or_else(|| vec!["train".to_owned()], |splits| splits.keys().cloned().collect())
    }

    /// The data card as [`CARD_FILE`].
    #[must_use]
    pub fn card_file(&self) -> Artifact {
        Artifact { name: CARD_FILE.to_owned(), bytes: self.card.as_bytes().to_vec() }
    }
}

/// An archive of the files of many frames.
#[derive(Clone, Copy)]
pub struct Bundle<'a> {
    /// Path below the dataset's folder.
    pub name: &'a str,
    /// Writes its bytes piece by piece: it may be larger than the memory.
    pub content: &'a dyn Fn(&mut dyn Write) -> std::io::Result<()>,
}

impl std::fmt::Debug for Bundle<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bundle").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Ids of the classes in the annotations of a layout that has no masks.
#[derive(Debug)]
pub struct AnnotationIds {
    /// That of each class, in the order of [`ClassId::ALL`](crate::class::ClassId::ALL); `None` for one that is not annotated.
    pub of_class: [Option<u32>; 3],
    /// What they are ids of, and what stands for pixels to ignore.
    pub note: &'static str,
}

/// A layout of a dataset.
pub trait Layout: std::fmt::Debug + Sync {
    /// Outputs that the layout needs, whatever else the user asks for.
    fn required_outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask"]
    }

    /// Whether the layout can store this output; one with a place for what it needs only, no other.
    fn supports(&self, output: &str) -> bool {
        self.required_outputs().contains(&output)
    }

    /// Whether the layout numbers the classes itself, so that `--label-ids` does not apply.
    fn has_fixed_ids(&self) -> bool {
        false
    }

    /// The ids of the classes in a layout with annotations in place of masks; `None` where those of the masks count.
    fn annotation_ids(&self) -> Option<&'static AnnotationIds> {
        None
    }

    /// Checks that the layout can hold splits of these names beside each other.
    ///
    /// # Errors
    /// [`crate::Error::Usage`].
    fn check_splits(&self, _names: &[&str]) -> Result<()> {
        Ok(())
    }

    /// The files of one frame. Called by many threads at once.
    ///
    /// # Errors
    /// [`crate::Error::Encode`].
    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles>;

    /// The paths and names that [`Self::frame_files`] gives to a frame with files of these kinds.
    fn frame_names(&self, kinds: &[FileKind], split: &str, index: u64) -> FrameNames;

    /// Paths of a frame's RGB image and mask for the contact sheet and `verify`; `None` if they are not files of their
    /// own.
    fn image_and_mask(&self, _split: &str, _index: u64) -> Option<[String; 2]> {
        None
    }

    /// Paths of the files of [`Self::write_bundles`] and [`Self::index_files`] for a complete dataset with these splits, in
    /// that order.
    fn index_paths<'a>(&self, splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a>;

    /// Passes the archives that bundle the files of frames to `write`, one by one, and removes the bundled files. Called
    /// before [`Self::index_files`].
    ///
    /// # Errors
    /// Those of reading and `write`.
    fn write_bundles(
        &self,
        _index: &DatasetIndex<'_>,
        _write: &mut dyn FnMut(Bundle<'_>) -> Result<()>,
    ) -> Result<()> {
        Ok(())
    }

    /// Passes the files that index the whole dataset to `write`, one by one. Their content follows from the manifest and the
    /// lines; nothing else is read. Called again whenever the dataset has grown.
    ///
    /// # Errors
    /// Those of reading the lines, encoding and `write`.
    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()>;

    /// The classes and rock instances in a label image of a frame, if `path` is one and the layout has a form of its own for
    /// them.
    fn decode_labels(&self, _path: &str, _image: &image::DynamicImage) -> Option<Frame> {
        None
    }
}

/// The split's name; `train` in a dataset without splits, for layouts that need one.
#[must_use]
pub fn split_or_train(split: &str) -> &str {
    if split.is_empty() { "train" } else { split }
}

/// A path below the dataset's folder, inside the split's folder if there are splits.
#[must_use]
pub fn below_split(split: &str, path: &str) -> String {
    if split.is_empty() { path.to_owned() } else { format!("{split}/{path}") }
}
