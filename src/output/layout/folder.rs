//! The project's own layout: a folder for each output, `rgb/rgb_00000.png` beside `mask/mask_00000.png`.
//!
//! Only every 25th preview is kept: previews are for people to look at.
//! Must not know: scene, GPU, the disk.

use serde_json::{Map, Value};

use super::interface::{
    CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange, below_split,
};
use crate::error::Result;
use crate::output::artifact::{Artifact, FileKind};
use crate::output::encode::json;
use crate::output::label_ids::LabelIds;

/// Only frames whose index is a multiple of this have a preview.
pub const PREVIEW_STRIDE: u64 = 25;

/// The folder layout.
#[derive(Debug)]
pub struct Folder;

/// File name of the label file that all frames share.
const LABELS_FILE: &str = "semantic_segmentation_labels.json";

/// Path of a file of frame `index`.
#[must_use]
pub fn file_path(kind: FileKind, split: &str, index: u64) -> String {
    let FileKind { output, stem, extension } = kind;
    // The mask has a short name here; the other outputs keep their usual stems.
    let stem = if output == "mask" { "mask" } else { stem };
    below_split(split, &format!("{output}/{stem}_{index:05}.{extension}"))
}

/// Whether the layout stores such a file of frame `index`. The mask's label file is the same for all frames and is stored once, beside the
/// manifest.
#[must_use]
pub fn has_file(kind: FileKind, index: u64) -> bool {
    match kind.output {
        "preview" => index.is_multiple_of(PREVIEW_STRIDE),
        "mask" => kind.extension == "png",
        _ => true,
    }
}

/// The label file that all frames of a dataset share.
///
/// # Errors
/// [`crate::Error::Encode`].
pub fn labels_file(label_ids: LabelIds) -> Result<Artifact> {
    let bytes = json::to_bytes(&label_ids.labels())?;
    Ok(Artifact { name: LABELS_FILE.to_owned(), bytes })
}

impl Layout for Folder {
    fn supports(&self, _output: &str) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let (split, index) = (&sample.record.split, sample.record.index);
        let files = sample
            .files
            .iter()
            .filter(|file| has_file(file.kind(), index))
            .map(|file| Artifact { name: file_path(file.kind(), split, index), bytes: file.bytes.clone() });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn frame_names(&self, kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        let stored = kinds.iter().filter(|kind| has_file(**kind, index));
        let files = stored.map(|kind| file_path(*kind, split, index)).collect();
        FrameNames { files, entry: Map::new() }
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let path = |output| file_path(FileKind { output, stem: output, extension: "png" }, split, index);
        Some(["rgb", "mask"].map(path))
    }

    fn index_paths<'a>(&self, _splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        Box::new([LABELS_FILE, CARD_FILE].into_iter().map(str::to_owned))
    }

    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        write(labels_file(LabelIds::of_manifest(index.manifest))?)?;
        write(index.card_file())
    }
}
