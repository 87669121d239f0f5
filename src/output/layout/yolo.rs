//! YOLO as Ultralytics reads it: `images/`, and `labels/` with a text file for each image: a row for each rock, of numbers normalised by
//! width and height. For detection a row is class, centre and size of the box; for segmentation, class and corners of a polygon.
//!
//! Rock (0) is the only class. The rocks that the label rule ignores have no row, as those of a crowd have none in Ultralytics' converter.
//! Must not know: scene, GPU, the disk.

use std::fmt::Write as _;

use serde_json::{Map, Value};

use super::interface::{
    AnnotationIds, CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange,
    split_or_train,
};
use super::outline::polygon;
use super::regions::{CROWD, annotated_rocks, regions};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::output::artifact::{Artifact, FileKind};

/// What a row of a label file says of a rock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Task {
    /// Its box.
    Detection,
    /// Its outline.
    Segmentation,
}

/// A YOLO layout.
#[derive(Debug)]
pub struct Yolo(Task);

/// That of detection.
pub static DETECTION: Yolo = Yolo(Task::Detection);
/// That of segmentation.
pub static SEGMENTATION: Yolo = Yolo(Task::Segmentation);

/// What the data card says of the classes.
static CLASSES: AnnotationIds = AnnotationIds {
    of_class: [None, Some(0), None],
    note: "Rock is the only class of the label files. Rocks to ignore have no row.",
};

/// File name of the description of the dataset.
const DATA_FILE: &str = "data.yaml";
/// Names that splits for validation go by.
const VALIDATION: [&str; 3] = ["val", "valid", "validation"];

/// Paths of a frame's image and its labels.
fn file_paths(split: &str, index: u64) -> [String; 2] {
    let split = split_or_train(split);
    [format!("images/{split}/{index:06}.png"), format!("labels/{split}/{index:06}.txt")]
}

/// The label file of a frame. One without rocks is an empty line: files of a dataset are never empty.
fn labels(frame: &Frame, task: Task) -> String {
    let rocks = annotated_rocks(frame);
    let mut text = String::new();
    // Writing into a string cannot fail.
    for (rock, region) in regions(frame, |pixel| rocks[pixel]).into_iter().filter(|(rock, _)| *rock != CROWD)
    {
        text.push('0');
        let mut add = |x: f64, y: f64| {
            let _ = write!(text, " {:.6} {:.6}", x / f64::from(frame.width), y / f64::from(frame.height));
        };
        let [left, top, width, height] = region.bbox();
        match task {
            Task::Detection => {
                add(left + 0.5 * width, top + 0.5 * height);
                add(width, height);
            }
            Task::Segmentation => {
                let [left, top, right, bottom] = region.bounds;
                let is_inside = |x: u32, y: u32| rocks[((top + y) * frame.width + left + x) as usize] == rock;
                for [x, y] in polygon([right - left + 1, bottom - top + 1], is_inside) {
                    add(f64::from(left + x), f64::from(top + y));
                }
            }
        }
        text.push('\n');
    }
    if text.is_empty() { "\n".to_owned() } else { text }
}

/// `data.yaml`. Its folder is the root of the paths.
fn data_file(splits: &[String]) -> String {
    let of_role = |names: &[&str]| splits.iter().find(|split| names.contains(&split.as_str()));
    let has_role = |split: &String| split == "test" || VALIDATION.contains(&split.as_str());
    let of_training = of_role(&["train"]).or_else(|| splits.iter().find(|split| !has_role(split)));
    let train = of_training.or(splits.first()).map_or("train", String::as_str);
    let mut text = "# Rocks on the Moon, rendered by regolith-render; for Ultralytics YOLO\n".to_owned();
    let remark = if of_training.is_none() { " # there is no split for training" } else { "" };
    let _ = writeln!(text, "train: images/{train}{remark}");
    match of_role(&VALIDATION) {
        Some(split) => {
            let _ = writeln!(text, "val: images/{split}");
        }
        None => {
            let _ = writeln!(text, "val: images/{train} # the same: there is no split called val");
        }
    }
    if let Some(split) = of_role(&["test"]) {
        let _ = writeln!(text, "test: images/{split}");
    }
    text + "names:\n  0: rock\n"
}

impl Layout for Yolo {
    fn check_splits(&self, names: &[&str]) -> Result<()> {
        if names.contains(&"images") {
            return Err(Error::Usage(
                "a split called `images` does not go with the YOLO formats: Ultralytics looks for labels where the last `images` of a path \
                 is `labels`; use another name"
                    .to_owned(),
            ));
        }
        Ok(())
    }

    fn required_outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask", "instances"]
    }

    fn has_fixed_ids(&self) -> bool {
        true
    }

    fn annotation_ids(&self) -> Option<&'static AnnotationIds> {
        Some(&CLASSES)
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let contents = [sample.rgb().to_vec(), labels(sample.frame, self.0).into_bytes()];
        let paths = file_paths(&sample.record.split, sample.record.index);
        let files = paths.into_iter().zip(contents).map(|(name, bytes)| Artifact { name, bytes });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn frame_names(&self, _kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        FrameNames { files: file_paths(split, index).into(), entry: Map::new() }
    }

    fn index_paths<'a>(&self, _splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        Box::new([DATA_FILE, CARD_FILE].into_iter().map(str::to_owned))
    }

    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        let data = data_file(&index.split_names());
        write(Artifact { name: DATA_FILE.to_owned(), bytes: data.into_bytes() })?;
        write(index.card_file())
    }
}

/// The boxes of the rows of a label file of either task: left, top, right, bottom, normalised. `None` if it is not one.
#[must_use]
pub fn row_boxes(bytes: &[u8]) -> Option<Vec<[f64; 4]>> {
    let text = std::str::from_utf8(bytes).ok().filter(|text| text.ends_with('\n'))?;
    let row_box = |row: &str| {
        let numbers = row.strip_prefix("0 ")?.split(' ').map(|word| word.parse::<f64>().ok());
        let numbers = numbers.collect::<Option<Vec<f64>>>()?;
        if numbers.len() % 2 != 0 || numbers.iter().any(|number| !(0.0..=1.0).contains(number)) {
            return None;
        }
        match numbers[..] {
            [x, y, width, height] => {
                Some([x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height])
            }
            [_, _, _, _, _, _, _, _, ..] => {
                let extent = |axis: usize| {
                    let values = numbers.iter().skip(axis).step_by(2);
                    values.fold([1.0_f64, 0.0_f64], |[low, high], value| [low.min(*value), high.max(*value)])
                };
                let ([left, right], [top, bottom]) = (extent(0), extent(1));
                Some([left, top, right, bottom])
            }
            _ => None,
        }
    };
    text.lines().filter(|row| !row.is_empty()).map(row_box).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{LabelReason, RockLabel};

    fn frame() -> Frame {
        let rock = |instance, reason| RockLabel {
            instance,
            visible_px: 1,
            exposed_px: 1,
            box_px: [0; 4],
            height_m: 1.0,
            diameter_m: 1.0,
            reason,
        };
        Frame {
            width: 4,
            height: 2,
            class: vec![1, 1, 255, 2, 1, 0, 255, 1],
            instances: vec![7, 7, 9, 0, 7, 0, 9, 3],
            rocks: vec![
                rock(3, LabelReason::Rock),
                rock(7, LabelReason::Rock),
                rock(9, LabelReason::TooSmall),
            ],
            ..Frame::default()
        }
    }

    #[test]
    fn rows_are_rocks_that_count() {
        let boxes = "0 0.875000 0.750000 0.250000 0.500000\n0 0.250000 0.500000 0.500000 1.000000\n";
        assert_eq!(labels(&frame(), Task::Detection), boxes);
        let outlines = labels(&frame(), Task::Segmentation);
        let l = "0 0.000000 0.000000 0.500000 0.000000 0.500000 0.500000 0.250000 0.500000 0.250000 1.000000 0.000000 1.000000\n";
        assert!(outlines.ends_with(l), "{outlines}");
        assert_eq!(row_boxes(outlines.as_bytes()), row_boxes(boxes.as_bytes()));
        let empty = Frame { class: vec![0; 8], instances: vec![0; 8], ..frame() };
        assert_eq!(labels(&empty, Task::Detection), "\n");
        assert_eq!(row_boxes(b"\n"), Some(Vec::new()));
        for wrong in ["", "0", "1 0.5 0.5 0.1 0.1\n", "0 0.5 0.5 1.5 0.1\n", "0 0.5 0.5 0.1\n", "0 a b c d\n"]
        {
            assert_eq!(row_boxes(wrong.as_bytes()), None, "{wrong}");
        }
    }

    #[test]
    fn the_description_has_train_and_val_whatever_the_splits() {
        let of = |names: &[&str]| data_file(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert!(
            of(&["train", "val", "test"])
                .contains("train: images/train\nval: images/val\ntest: images/test\n")
        );
        assert!(of(&["train"]).contains("val: images/train #"));
        assert!(of(&["a", "validation"]).contains("train: images/a\nval: images/validation\n"));
        let data = of(&["test", "valid", "train_a"]);
        assert!(
            data.contains("train: images/train_a\nval: images/valid\ntest: images/test\n"),
            "no role of another split: {data}"
        );
        assert!(
            of(&["test", "val"])
                .contains("train: images/test # there is no split for training\nval: images/val\n")
        );
    }
}
