//! The flat layout of Replicator's BasicWriter, whose readers work unchanged: `rgb_0000.png`,
//! `semantic_segmentation_0000.png`, ...
//!
//! Must not know: scene, GPU, the disk.

use serde_json::{Map, Value};

use super::interface::{
    CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange, below_split,
};
use crate::error::Result;
use crate::output::artifact::{Artifact, FileKind, frame_file_name};

/// The BasicWriter layout.
#[derive(Debug)]
pub struct Basic;

/// Path of a file of frame `index`.
fn file_path(split: &str, stem: &str, extension: &str, index: u64) -> String {
    below_split(split, &frame_file_name(stem, index, extension))
}

impl Layout for Basic {
    fn supports(&self, _output: &str) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let files = sample.files.iter().map(|file| Artifact {
            name: file_path(&sample.record.split, file.stem, file.extension, sample.record.index),
            bytes: file.bytes.clone(),
        });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn frame_names(&self, kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        let files = kinds.iter().map(|kind| file_path(split, kind.stem, kind.extension, index)).collect();
        FrameNames { files, entry: Map::new() }
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        Some(["rgb", "semantic_segmentation"].map(|stem| file_path(split, stem, "png", index)))
    }

    fn index_paths<'a>(&self, _splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        Box::new([CARD_FILE.to_owned()].into_iter())
    }

    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        write(index.card_file())
    }
}
