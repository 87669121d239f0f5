//! The flat layout of Replicator's BasicWriter, whose readers work unchanged: `rgb_0000.png`,
//! `semantic_segmentation_0000.png`, ...
//!
//! Must not know: scene, GPU, the disk.

use serde_json::Value;

use super::writer::{Index, Placed, Sample, Writer, below_split};
use super::{Artifact, frame_file_name};
use crate::error::Result;

/// See the module.
#[derive(Debug)]
pub struct Basic;

impl Writer for Basic {
    fn holds(&self, _output: &str) -> bool {
        true
    }

    fn place(&self, sample: &Sample<'_>) -> Result<Placed> {
        let files = sample.files.iter().map(|file| Artifact {
            name: below_split(sample.split, &frame_file_name(file.stem, sample.index, file.extension)),
            bytes: file.bytes.clone(),
        });
        Ok(Placed { files: files.collect(), entry: Value::Null })
    }

    fn pictures(&self, split: &str, index: u64) -> Option<[String; 2]> {
        Some(
            ["rgb", "semantic_segmentation"]
                .map(|stem| below_split(split, &frame_file_name(stem, index, "png"))),
        )
    }

    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()> {
        put(index.card_file())
    }
}
