//! The layouts that a dataset can have on disk: one row of [`LAYOUTS`] for each.
//!
//! Must not know: scene, GPU, how a layout works ([`interface`] says what each provides).
//! To add a layout: a file in `output/layout/` that implements [`Layout`], and a row in [`LAYOUTS`].

pub mod basic;
pub mod cityscapes;
pub mod coco;
pub mod folder;
pub mod frame_line;
pub mod hugging_face;
pub mod interface;
mod outline;
mod regions;
pub mod webdataset;
pub mod yolo;

use crate::error::{Error, Result, nearest};
pub use frame_line::FrameLine;
pub use interface::{Bundle, DatasetIndex, FrameFiles, FrameLines, FrameNames, Layout, Sample, SplitRange};

/// A row of the table of layouts.
#[derive(Debug)]
pub struct LayoutRow {
    /// Its name in `--format`.
    pub name: &'static str,
    /// One line for the help.
    pub summary: &'static str,
    /// The layout.
    pub layout: &'static dyn Layout,
}

const fn row(name: &'static str, summary: &'static str, layout: &'static dyn Layout) -> LayoutRow {
    LayoutRow { name, summary, layout }
}

/// Every layout, in the order of the help.
pub static LAYOUTS: [LayoutRow; 8] = [
    row("folder", "one folder per output; the format that convert reads", &folder::Folder),
    row("basic", "flat, with the names of Replicator's BasicWriter", &basic::Basic),
    row("coco", "COCO: rock instances and panoptic segments", &coco::Coco),
    row("cityscapes", "Cityscapes: leftImg8bit and gtFine, with the one city moon", &cityscapes::Cityscapes),
    row("hf", "Hugging Face imagefolder, with a data card", &hugging_face::HuggingFace),
    row("yolo", "YOLO: images and boxes of rocks for detection", &yolo::DETECTION),
    row("yolo-seg", "YOLO: images and outlines of rocks for segmentation", &yolo::SEGMENTATION),
    row("webdataset", "WebDataset: tar shards of 1000 frames", &webdataset::WebDataset),
];

/// The first of the table, with its name: that of datasets without `--format`.
#[must_use]
pub fn default() -> (&'static str, &'static dyn Layout) {
    (LAYOUTS[0].name, LAYOUTS[0].layout)
}

/// The layout of this name, with the name as it stands in the table.
///
/// # Errors
/// [`Error::Usage`] for an unknown name.
pub fn find(name: &str) -> Result<(&'static str, &'static dyn Layout)> {
    LAYOUTS.iter().find(|row| row.name == name).map(|row| (row.name, row.layout)).ok_or_else(|| {
        let names: Vec<&str> = LAYOUTS.iter().map(|row| row.name).collect();
        let suggestion = nearest(name, names.iter().copied())
            .map_or_else(String::new, |name| format!(" (did you mean `{name}`?)"));
        Error::Usage(format!("--format {name}: unknown format{suggestion}; there are {}", names.join(", ")))
    })
}
