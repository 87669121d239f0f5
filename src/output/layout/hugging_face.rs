//! Hugging Face `imagefolder`: one folder per split with `images`, `masks` and `metadata.jsonl`, and a data card with a
//! YAML header.
//!
//! The loader reads columns whose names end in `file_name` as images; other files have columns that end in `path`.
//! Must not know: scene, GPU, the disk.

use std::fmt::Write as _;

use serde_json::{Map, Value};

use super::frame_line::FrameLine;
use super::interface::{DatasetIndex, FrameFiles, Layout, Sample, split_or_train};
use crate::class::ClassId;
use crate::error::Result;
use crate::output::artifact::Artifact;
use crate::output::encode::json;
use crate::output::label_ids::LabelIds;

/// The Hugging Face layout.
#[derive(Debug)]
pub struct HuggingFace;

/// Folder and metadata column of an encoded file; `None` if the layout does not store it.
fn folder_and_column(output: &str, stem: &str, extension: &str) -> Option<(String, String)> {
    match (output, extension) {
        ("rgb", _) => Some(("images".to_owned(), "file_name".to_owned())),
        ("mask", "png") => Some(("masks".to_owned(), "mask_file_name".to_owned())),
        ("mask" | "preview" | "meta", _) => None,
        (_, "png") => Some((stem.to_owned(), format!("{stem}_file_name"))),
        _ => Some((stem.to_owned(), format!("{stem}_path"))),
    }
}

/// The row of `metadata.jsonl` for a line of `frames.jsonl`.
fn metadata_row(line: FrameLine) -> Map<String, Value> {
    let mut row = match line.entry {
        Value::Object(columns) => columns,
        _ => Map::new(),
    };
    row.insert("index".to_owned(), line.index.into());
    row.insert("seed".to_owned(), line.seed.into());
    for class in ClassId::ALL {
        let fraction = line.coverage.get(class.name);
        row.insert(format!("{}_share", class.name), fraction.cloned().unwrap_or_default());
    }
    row
}

/// The YAML header of the data card, by which the Hub lists the dataset and the loader finds its splits.
fn yaml_header(frames: u64, splits: &[String]) -> String {
    let size = match frames {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        _ => "1M<n<10M",
    };
    let mut header = format!(
        "---\nlicense: cc0-1.0\ntask_categories:\n- image-segmentation\nsize_categories:\n- {size}\nconfigs:\n\
         - config_name: default\n  data_files:\n"
    );
    for split in splits {
        // Hugging Face allows no hyphen in a split's name.
        let _ = writeln!(header, "  - split: {}\n    path: \"{split}/**\"", split.replace('-', "_"));
    }
    header.push_str("---\n\n");
    header
}

impl Layout for HuggingFace {
    fn supports(&self, output: &str) -> bool {
        !matches!(output, "preview" | "meta")
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let split = split_or_train(&sample.record.split);
        let (mut files, mut columns) = (Vec::new(), Map::new());
        for file in sample.files {
            let Some((folder, column)) = folder_and_column(file.output, file.stem, file.extension) else {
                continue;
            };
            let name = format!("{folder}/{:06}.{}", sample.record.index, file.extension);
            columns.insert(column, name.clone().into());
            files.push(Artifact { name: format!("{split}/{name}"), bytes: file.bytes.clone() });
        }
        Ok(FrameFiles { artifacts: files, entry: columns.into() })
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let split = split_or_train(split);
        Some(["images", "masks"].map(|folder| format!("{split}/{folder}/{index:06}.png")))
    }

    fn write_index(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        let splits = index.split_names();
        for split in &splits {
            let mut rows = String::new();
            index.lines.for_each(&mut |line| {
                if split_or_train(&line.split) == split {
                    let _ = writeln!(rows, "{}", Value::Object(metadata_row(line)));
                }
                Ok(())
            })?;
            write(Artifact { name: format!("{split}/metadata.jsonl"), bytes: rows.into_bytes() })?;
        }
        let id2label = LabelIds::of_manifest(index.manifest).id2label();
        write(Artifact { name: "id2label.json".to_owned(), bytes: json::to_bytes(&id2label)? })?;
        let frames = index.manifest.get("n_completed").and_then(Value::as_u64).unwrap_or_default();
        let card = yaml_header(frames, &splits) + index.card;
        write(Artifact { name: "README.md".to_owned(), bytes: card.into_bytes() })
    }
}
