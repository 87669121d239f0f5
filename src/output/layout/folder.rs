//! The project's own layout: a folder for each output, `rgb/rgb_00000.png` beside `mask/mask_00000.png`.
//!
//! Only every 25th preview is kept: previews are for people to look at.
//! Must not know: scene, GPU, the disk.

use serde_json::Value;

use super::interface::{DatasetIndex, FrameFiles, Layout, Sample, below_split};
use crate::error::Result;
use crate::output::artifact::{Artifact, EncodedFile};
use crate::output::encode::json;
use crate::output::label_ids::LabelIds;

/// Only frames whose index is a multiple of this have a preview.
pub const PREVIEW_STRIDE: u64 = 25;

/// The folder layout.
#[derive(Debug)]
pub struct Folder;

/// Path of an encoded output of frame `index`, below the folder of its split.
#[must_use]
pub fn file_path(output: &str, stem: &str, extension: &str, index: u64) -> String {
    // The mask has a short name here; the other outputs keep their usual stems.
    let stem = if output == "mask" { "mask" } else { stem };
    format!("{output}/{stem}_{index:05}.{extension}")
}

/// Whether the layout stores this file. The mask's label file is the same for all frames and is stored once, beside the
/// manifest.
#[must_use]
pub fn has_file(file: &EncodedFile, index: u64) -> bool {
    match file.output {
        "preview" => index.is_multiple_of(PREVIEW_STRIDE),
        "mask" => file.extension == "png",
        _ => true,
    }
}

/// The label file that all frames of a dataset share.
///
/// # Errors
/// [`crate::Error::Encode`].
pub fn labels_file(label_ids: LabelIds) -> Result<Artifact> {
    let bytes = json::to_bytes(&label_ids.labels())?;
    Ok(Artifact { name: "semantic_segmentation_labels.json".to_owned(), bytes })
}

impl Layout for Folder {
    fn supports(&self, _output: &str) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let files =
            sample.files.iter().filter(|file| has_file(file, sample.record.index)).map(|file| Artifact {
                name: below_split(
                    &sample.record.split,
                    &file_path(file.output, file.stem, file.extension, sample.record.index),
                ),
                bytes: file.bytes.clone(),
            });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        Some(["rgb", "mask"].map(|output| below_split(split, &file_path(output, output, "png", index))))
    }

    fn write_index(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        write(labels_file(LabelIds::of_manifest(index.manifest))?)?;
        write(index.card_file())
    }
}
