//! The dataset's own layout: a folder for each output, `rgb/rgb_00000.png` beside `mask/mask_00000.png`.
//!
//! Every 25th preview only: they are for people to look at.
//! Must not know: scene, GPU, the disk.

use serde_json::Value;

use super::writer::{Index, Placed, Sample, Writer, below_split};
use super::{Artifact, Encoded, LabelIds};
use crate::error::Result;

/// One preview in so many frames.
pub const PREVIEW_STRIDE: u64 = 25;

/// See the module.
#[derive(Debug)]
pub struct Folder;

/// Where an encoded output of frame `index` lies below the folder of its split.
#[must_use]
pub fn file_path(output: &str, stem: &str, extension: &str, index: u64) -> String {
    // The mask is known by its short name here, the rest by what they are called everywhere.
    let stem = if output == "mask" { "mask" } else { stem };
    format!("{output}/{stem}_{index:05}.{extension}")
}

/// Whether the layout has this file: labels are the same for all frames and lie beside the manifest once.
#[must_use]
pub fn has_file(file: &Encoded, index: u64) -> bool {
    match file.output {
        "preview" => index.is_multiple_of(PREVIEW_STRIDE),
        "mask" => file.extension == "png",
        _ => true,
    }
}

/// The label file of a dataset, which every frame shares.
///
/// # Errors
/// [`crate::Error::Encode`].
pub fn labels_file(label_ids: LabelIds) -> Result<Artifact> {
    let bytes = super::encoders::json_bytes(&label_ids.labels())?;
    Ok(Artifact { name: "semantic_segmentation_labels.json".to_owned(), bytes })
}

impl Writer for Folder {
    fn holds(&self, _output: &str) -> bool {
        true
    }

    fn place(&self, sample: &Sample<'_>) -> Result<Placed> {
        let files = sample.files.iter().filter(|file| has_file(file, sample.index)).map(|file| Artifact {
            name: below_split(sample.split, &file_path(file.output, file.stem, file.extension, sample.index)),
            bytes: file.bytes.clone(),
        });
        Ok(Placed { files: files.collect(), entry: Value::Null })
    }

    fn pictures(&self, split: &str, index: u64) -> Option<[String; 2]> {
        Some(["rgb", "mask"].map(|output| below_split(split, &file_path(output, output, "png", index))))
    }

    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()> {
        put(labels_file(LabelIds::of(index.manifest))?)?;
        put(index.card_file())
    }
}
