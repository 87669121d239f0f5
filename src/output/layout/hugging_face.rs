//! Hugging Face `imagefolder`: one folder per split with `images`, `masks` and `metadata.jsonl`, and a data card with a
//! YAML header.
//!
//! The loader reads columns whose names end in `file_name` as images; other files have columns that end in `path`.
//! Must not know: scene, GPU, the disk.

use std::fmt::Write as _;

use serde_json::{Map, Value};

use super::frame_line::FrameLine;
use super::interface::{
    CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange, split_or_train,
};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::output::artifact::{Artifact, EncodedFile, FileKind};
use crate::output::encode::json;
use crate::output::label_ids::LabelIds;

/// The Hugging Face layout.
#[derive(Debug)]
pub struct HuggingFace;

/// File name of the class names.
const LABELS_FILE: &str = "id2label.json";

/// Folder and metadata column of a file; `None` if the layout does not store it.
fn folder_and_column(kind: FileKind) -> Option<(String, String)> {
    let stem = kind.stem;
    match (kind.output, kind.extension) {
        ("rgb", _) => Some(("images".to_owned(), "file_name".to_owned())),
        ("mask", "png") => Some(("masks".to_owned(), "mask_file_name".to_owned())),
        ("mask" | "preview" | "meta", _) => None,
        (_, "png") => Some((stem.to_owned(), format!("{stem}_file_name"))),
        _ => Some((stem.to_owned(), format!("{stem}_path"))),
    }
}

/// Path of a file of frame `index` below its split's folder, and its metadata column; `None` if the layout does not
/// store it.
fn path_and_column(kind: FileKind, index: u64) -> Option<(String, String)> {
    let (folder, column) = folder_and_column(kind)?;
    Some((format!("{folder}/{index:06}.{}", kind.extension), column))
}

/// Path of the metadata of a split.
fn metadata_path(split: &str) -> String {
    format!("{split}/metadata.jsonl")
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

/// Name of a split in the data card: Hugging Face allows no hyphen.
fn card_name(split: &str) -> String {
    split.replace('-', "_")
}

/// The YAML header of the data card, by which the Hub lists the dataset and the loader finds its splits. Whoever
/// publishes the dataset chooses its licence: until then it is unknown, in the Hub's words.
fn yaml_header(frames: u64, splits: &[String]) -> String {
    let size = match frames {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        1_000_000..10_000_000 => "1M<n<10M",
        10_000_000..100_000_000 => "10M<n<100M",
        100_000_000..1_000_000_000 => "100M<n<1B",
        _ => "1B<n<10B",
    };
    let mut header = format!(
        "---\nlicense: unknown\ntask_categories:\n- image-segmentation\nsize_categories:\n- {size}\nconfigs:\n\
         - config_name: default\n  data_files:\n"
    );
    for split in splits {
        // In quotes, as YAML would read a number, a date, a truth value or null.
        let _ = writeln!(header, "  - split: \"{}\"\n    path: \"{split}/**\"", card_name(split));
    }
    header.push_str("---\n\n");
    header
}

impl Layout for HuggingFace {
    fn supports(&self, output: &str) -> bool {
        !matches!(output, "preview" | "meta")
    }

    fn check_splits(&self, names: &[&str]) -> Result<()> {
        for (i, name) in names.iter().enumerate() {
            if card_name(name) == "all" {
                return Err(Error::Usage(
                    "a split called `all` does not go with --format hf: the library `datasets` reads that name as every split \
                     together; use another name"
                        .to_owned(),
                ));
            }
            if let Some(other) = names[..i].iter().find(|other| card_name(other) == card_name(name)) {
                return Err(Error::Usage(format!(
                    "splits called `{other}` and `{name}` do not go together with --format hf: Hugging Face allows no hyphen, and \
                     both would be `{}`; rename one",
                    card_name(name)
                )));
            }
        }
        Ok(())
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let kinds: Vec<FileKind> = sample.files.iter().map(EncodedFile::kind).collect();
        let names = self.frame_names(&kinds, &sample.record.split, sample.record.index);
        let stored = sample.files.iter().filter(|file| folder_and_column(file.kind()).is_some());
        let files = names
            .files
            .into_iter()
            .zip(stored)
            .map(|(name, file)| Artifact { name, bytes: file.bytes.clone() });
        Ok(FrameFiles { artifacts: files.collect(), entry: names.entry.into() })
    }

    fn frame_names(&self, kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        let split = split_or_train(split);
        let mut names = FrameNames::default();
        for (path, column) in kinds.iter().filter_map(|kind| path_and_column(*kind, index)) {
            names.files.push(format!("{split}/{path}"));
            names.entry.insert(column, path.into());
        }
        names
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let split = split_or_train(split);
        Some(["images", "masks"].map(|folder| format!("{split}/{folder}/{index:06}.png")))
    }

    fn index_paths<'a>(&self, splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        let metadata = splits.iter().map(|split| metadata_path(split_or_train(&split.name)));
        Box::new(metadata.chain([LABELS_FILE, CARD_FILE].map(str::to_owned)))
    }

    fn index_files(
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
            write(Artifact { name: metadata_path(split), bytes: rows.into_bytes() })?;
        }
        let id2label = LabelIds::of_manifest(index.manifest).id2label();
        write(Artifact { name: LABELS_FILE.to_owned(), bytes: json::to_bytes(&id2label)? })?;
        let frames = index.manifest.get("n_completed").and_then(Value::as_u64).unwrap_or_default();
        let card = yaml_header(frames, &splits) + index.card;
        write(Artifact { name: CARD_FILE.to_owned(), bytes: card.into_bytes() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_splits_are_text_in_the_card() {
        let names = ["train", "2024-01-01", "0", "no", "null"].map(str::to_owned);
        let header = yaml_header(5, &names);
        for (quoted, folder) in
            [("train", "train"), ("2024_01_01", "2024-01-01"), ("0", "0"), ("no", "no"), ("null", "null")]
        {
            let rows = format!("  - split: \"{quoted}\"\n    path: \"{folder}/**\"\n");
            assert!(header.contains(&rows), "{header}");
        }
    }

    #[test]
    fn names_that_the_card_cannot_hold_are_refused() {
        HuggingFace.check_splits(&["train", "a-b", "a-c", "ALL"]).expect("different names");
        for (names, expected) in
            [(&["train", "all"][..], "`all`"), (&["a-b", "train", "a_b"], "`a-b` and `a_b`")]
        {
            let message = HuggingFace.check_splits(names).expect_err("refused").to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
