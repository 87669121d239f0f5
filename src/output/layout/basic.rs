//! The flat layout of Replicator's BasicWriter, whose readers work unchanged: `rgb_0000.png`,
//! `semantic_segmentation_0000.png`, ...
//!
//! Must not know: scene, GPU, the disk.

use serde_json::Value;

use super::interface::{DatasetIndex, FrameFiles, Layout, Sample, below_split};
use crate::error::Result;
use crate::output::artifact::{Artifact, frame_file_name};

/// The BasicWriter layout.
#[derive(Debug)]
pub struct Basic;

impl Layout for Basic {
    fn supports(&self, _output: &str) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let files = sample.files.iter().map(|file| Artifact {
            name: below_split(
                &sample.record.split,
                &frame_file_name(file.stem, sample.record.index, file.extension),
            ),
            bytes: file.bytes.clone(),
        });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        Some(
            ["rgb", "semantic_segmentation"]
                .map(|stem| below_split(split, &frame_file_name(stem, index, "png"))),
        )
    }

    fn write_index(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        write(index.card_file())
    }
}
