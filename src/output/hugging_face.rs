//! Hugging Face `imagefolder`: a folder a split with `images`, `masks` and `metadata.jsonl`; a data card with its head.
//!
//! Columns that end in `file_name` are loaded as pictures; what is no picture has a column that ends in `path`.
//! Must not know: scene, GPU, the disk.

use std::fmt::Write as _;

use serde_json::{Map, Value};

use super::writer::{Index, Placed, Sample, Writer, split_or_train};
use super::{Artifact, LabelIds, encoders};
use crate::class::ClassId;
use crate::error::Result;

/// See the module.
#[derive(Debug)]
pub struct HuggingFace;

/// Folder and column of an encoded output.
fn place_of(output: &str, stem: &str, extension: &str) -> Option<(String, String)> {
    match (output, extension) {
        ("rgb", _) => Some(("images".to_owned(), "file_name".to_owned())),
        ("mask", "png") => Some(("masks".to_owned(), "mask_file_name".to_owned())),
        ("mask" | "preview" | "meta", _) => None,
        (_, "png") => Some((stem.to_owned(), format!("{stem}_file_name"))),
        _ => Some((stem.to_owned(), format!("{stem}_path"))),
    }
}

impl Writer for HuggingFace {
    fn holds(&self, output: &str) -> bool {
        !matches!(output, "preview" | "meta")
    }

    fn place(&self, sample: &Sample<'_>) -> Result<Placed> {
        let split = split_or_train(sample.split);
        let (mut files, mut columns) = (Vec::new(), Map::new());
        for file in sample.files {
            let Some((folder, column)) = place_of(file.output, file.stem, file.extension) else { continue };
            let name = format!("{folder}/{:06}.{}", sample.index, file.extension);
            columns.insert(column, name.clone().into());
            files.push(Artifact { name: format!("{split}/{name}"), bytes: file.bytes.clone() });
        }
        Ok(Placed { files, entry: columns.into() })
    }

    fn pictures(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let split = split_or_train(split);
        Some(["images", "masks"].map(|folder| format!("{split}/{folder}/{index:06}.png")))
    }

    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()> {
        let names = index.split_names();
        for split in &names {
            let mut rows = String::new();
            index.lines.for_each(&mut |mut line| {
                if split_or_train(line.get("split").and_then(Value::as_str).unwrap_or_default()) == split {
                    let mut row = match line.remove("entry") {
                        Some(Value::Object(columns)) => columns,
                        _ => Map::new(),
                    };
                    for key in ["index", "seed"] {
                        row.insert(key.to_owned(), line.remove(key).unwrap_or_default());
                    }
                    for class in ClassId::ALL {
                        let share = line.get("coverage").and_then(|coverage| coverage.get(class.name));
                        row.insert(format!("{}_share", class.name), share.cloned().unwrap_or_default());
                    }
                    let _ = writeln!(rows, "{}", Value::Object(row));
                }
                Ok(())
            })?;
            put(Artifact { name: format!("{split}/metadata.jsonl"), bytes: rows.into_bytes() })?;
        }
        let labels = LabelIds::of(index.manifest).id2label();
        put(Artifact { name: "id2label.json".to_owned(), bytes: encoders::json_bytes(&labels)? })?;
        let frames = index.manifest.get("n_completed").and_then(Value::as_u64).unwrap_or_default();
        let size = match frames {
            0..1_000 => "n<1K",
            1_000..10_000 => "1K<n<10K",
            10_000..100_000 => "10K<n<100K",
            100_000..1_000_000 => "100K<n<1M",
            _ => "1M<n<10M",
        };
        let mut card = format!(
            "---\nlicense: cc0-1.0\ntask_categories:\n- image-segmentation\nsize_categories:\n- {size}\nconfigs:\n\
             - config_name: default\n  data_files:\n"
        );
        for split in &names {
            // A split's name is one word there.
            let _ = writeln!(card, "  - split: {}\n    path: \"{split}/**\"", split.replace('-', "_"));
        }
        let _ = write!(card, "---\n\n{}", index.card);
        put(Artifact { name: "README.md".to_owned(), bytes: card.into_bytes() })
    }
}
