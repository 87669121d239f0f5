//! COCO: images by split, instance annotations of rocks (boxes and run-length encoded masks), panoptic segments.
//!
//! Rock (1) is the only category with instances; regolith (2) and sky (3) are stuff and appear in the panoptic files
//! only. The rocks of a frame that the label rule ignores are one crowd (`iscrowd`), which evaluation ignores too.
//! Category 0 is not used, because common readers drop it. Annotation ids depend on frame and instance alone, so that
//! every run gives the same ones.
//! Must not know: scene, GPU, the disk.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::interface::{
    AnnotationIds, CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange,
    split_or_train,
};
use super::regions::{CROWD, annotated_rocks, regions};
use crate::class::ClassId;
use crate::error::Result;
use crate::frame::{Frame, LabelReason, RockLabel};
use crate::output::artifact::{Artifact, FileKind};
use crate::output::encode::png;

/// The COCO layout.
#[derive(Debug)]
pub struct Coco;

// Category ids.
const ROCK: u32 = 1;
const REGOLITH: u32 = 2;
const SKY: u32 = 3;

/// What the data card says of them.
static CATEGORIES: AnnotationIds = AnnotationIds {
    of_class: [Some(REGOLITH), Some(ROCK), Some(SKY)],
    note: "The ids are those of the categories; category 0 is not used. Regolith and sky are in the panoptic files only. Rocks to ignore are \
           one crowd of a frame (`iscrowd` 1); other pixels to ignore are void, 0 in the panoptic images.",
};

// Panoptic segment ids; 0 is void. Rock instance k has `ROCK_SEGMENT_BASE` + k.
const REGOLITH_SEGMENT: u32 = 1;
const SKY_SEGMENT: u32 = 2;
const ROCK_SEGMENT_BASE: u32 = 2;
/// The segment, and with [`ROCK_SEGMENT_BASE`] taken off the annotation, of the ignored rocks: above all instance ids.
const CROWD_SEGMENT: u32 = ROCK_SEGMENT_BASE + CROWD;

/// Kinds of annotation files.
const ANNOTATION_KINDS: [&str; 2] = ["instances", "panoptic"];

/// Annotation ids of consecutive frames are this far apart; instance ids are smaller.
const IDS_PER_FRAME: u64 = 1 << 16;

impl Layout for Coco {
    fn required_outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask", "instances"]
    }

    fn has_fixed_ids(&self) -> bool {
        true
    }

    fn annotation_ids(&self) -> Option<&'static AnnotationIds> {
        Some(&CATEGORIES)
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let frame = sample.frame;
        let segments = panoptic_ids(frame);
        // A panoptic PNG stores the segment id as R + 256 G + 65536 B.
        let colours: Vec<u8> =
            segments.iter().flat_map(|id| [*id as u8, (*id >> 8) as u8, (*id >> 16) as u8]).collect();
        let [image, panoptic] = file_paths(&sample.record.split, sample.record.index);
        let files = vec![
            Artifact { name: image, bytes: sample.rgb().to_vec() },
            Artifact { name: panoptic, bytes: png::label_colours(frame.width, frame.height, &colours)? },
        ];
        let entry =
            json!({ "instances": instance_annotations(sample), "segments": segments_info(frame, &segments) });
        Ok(FrameFiles { artifacts: files, entry })
    }

    fn frame_names(&self, _kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        FrameNames { files: file_paths(split, index).into(), entry: Map::new() }
    }

    fn index_paths<'a>(&self, splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        let annotations = splits.iter().flat_map(|split| {
            ANNOTATION_KINDS.map(|kind| annotations_path(kind, split_or_train(&split.name)))
        });
        Box::new(annotations.chain([CARD_FILE.to_owned()]))
    }

    fn decode_labels(&self, path: &str, image: &image::DynamicImage) -> Option<Frame> {
        if !path.starts_with(&format!("annotations/{}_", ANNOTATION_KINDS[1])) {
            return None;
        }
        let (width, height, image) = (image.width(), image.height(), image.to_rgb8());
        let segments = image.pixels().map(|pixel| {
            let [r, g, b] = pixel.0.map(u32::from);
            match r | g << 8 | b << 16 {
                0 => (ClassId::UNLABELLED.0, 0),
                REGOLITH_SEGMENT => (ClassId::REGOLITH.0, 0),
                SKY_SEGMENT => (ClassId::SKY.0, 0),
                CROWD_SEGMENT => (ClassId::UNLABELLED.0, CROWD as u16),
                rock => (ClassId::ROCK.0, (rock - ROCK_SEGMENT_BASE) as u16),
            }
        });
        let (class, instances): (Vec<u8>, Vec<u16>) = segments.unzip();
        // One rock stands for all that are ignored.
        let rocks = instances.contains(&(CROWD as u16)).then(crowd_label).into_iter().collect();
        Some(Frame { width, height, class, instances, rocks, ..Frame::default() })
    }

    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        for split in index.split_names() {
            write_annotations(index, &split, write)?;
        }
        write(index.card_file())
    }
}

/// Writes the instance and the panoptic annotation file of a split.
fn write_annotations(
    index: &DatasetIndex<'_>,
    split: &str,
    write: &mut dyn FnMut(Artifact) -> Result<()>,
) -> Result<()> {
    let info = json!({
        "description": "Labelled images of the Moon, rendered by regolith-render",
        "version": index.manifest.get("version"),
    });
    let size = index.manifest.get("size").cloned().unwrap_or_default();
    let (mut images, mut instances, mut panoptic) = (Rows::default(), Rows::default(), Rows::default());
    index.lines.for_each(&mut |mut line| {
        if split_or_train(&line.split) != split {
            return Ok(());
        }
        let (image_id, name) = (line.index, file_name(line.index));
        images.add(&json!({
            "id": image_id, "file_name": name, "width": size[0], "height": size[1],
        }));
        let mut take = |key: &str| line.entry.get_mut(key).map(Value::take).unwrap_or_default();
        let segments = take("segments");
        if let Value::Array(rows) = take("instances") {
            rows.iter().for_each(|row| instances.add(row));
        }
        panoptic.add(&json!({ "image_id": image_id, "file_name": name, "segments_info": segments }));
        Ok(())
    })?;
    let contents = [(instances, instance_categories()), (panoptic, panoptic_categories())];
    for (kind, (annotations, categories)) in ANNOTATION_KINDS.into_iter().zip(contents) {
        let bytes = format!(
            "{{\"info\":{info},\"licenses\":[],\"images\":[{}],\"annotations\":[{}],\"categories\":{categories}}}\n",
            images.0, annotations.0
        );
        write(Artifact { name: annotations_path(kind, split), bytes: bytes.into_bytes() })?;
    }
    Ok(())
}

/// Rows of a JSON array as text, which takes a tenth of the memory of values.
#[derive(Default)]
struct Rows(String);

impl Rows {
    fn add(&mut self, row: &Value) {
        let separator = if self.0.is_empty() { "" } else { "," };
        // Text can be written to a text.
        let _ = write!(self.0, "{separator}{row}");
    }
}

fn file_name(index: u64) -> String {
    format!("{index:06}.png")
}

/// Paths of a frame's image and its panoptic segments.
fn file_paths(split: &str, index: u64) -> [String; 2] {
    let (split, name) = (split_or_train(split), file_name(index));
    [format!("{split}/{name}"), format!("annotations/panoptic_{split}/{name}")]
}

/// Path of the file with a split's annotations of a kind.
fn annotations_path(kind: &str, split: &str) -> String {
    format!("annotations/{kind}_{split}.json")
}

fn instance_categories() -> Value {
    json!([{ "id": ROCK, "name": "rock", "supercategory": "hazard" }])
}

fn panoptic_categories() -> Value {
    let row = |id: u32, class: ClassId, has_instances: u8| {
        let (name, colour) = class.class().map_or(("", [0; 3]), |class| (class.name, class.preview_rgb));
        json!({ "id": id, "name": name, "supercategory": name, "isthing": has_instances, "color": colour })
    };
    json!([row(ROCK, ClassId::ROCK, 1), row(REGOLITH, ClassId::REGOLITH, 0), row(SKY, ClassId::SKY, 0)])
}

/// The label of the rocks of a crowd.
fn crowd_label() -> RockLabel {
    RockLabel {
        instance: CROWD as u16,
        visible_px: 0,
        exposed_px: 0,
        box_px: [0; 4],
        height_m: 0.0,
        diameter_m: 0.0,
        reason: LabelReason::TooSmall,
    }
}

fn instance_annotations(sample: &Sample<'_>) -> Vec<Value> {
    let frame = sample.frame;
    let rocks = annotated_rocks(frame);
    regions(frame, |pixel| rocks[pixel])
        .into_iter()
        .map(|(rock, region)| {
            let counts = run_lengths(frame, region.bounds, |pixel| rocks[pixel] == rock);
            json!({
                "id": sample.record.index * IDS_PER_FRAME + u64::from(rock),
                "image_id": sample.record.index,
                "category_id": ROCK,
                "segmentation": { "size": [frame.height, frame.width], "counts": compress_counts(&counts) },
                "area": region.area,
                "bbox": region.bbox(),
                "iscrowd": u8::from(rock == CROWD),
            })
        })
        .collect()
}

/// Run-length encoding of a rock's mask: lengths of alternating runs of 0 and 1 in column-major order, starting with 0.
fn run_lengths(
    frame: &Frame,
    [left, top, right, bottom]: [u32; 4],
    is_inside: impl Fn(usize) -> bool,
) -> Vec<u32> {
    let (width, height) = (frame.width, frame.height);
    let (mut counts, mut run, mut inside) = (Vec::new(), left * height, false);
    for x in left..=right {
        for y in 0..height {
            let is_rock = (top..=bottom).contains(&y) && is_inside((y * width + x) as usize);
            if is_rock != inside {
                counts.push(run);
                (run, inside) = (0, is_rock);
            }
            run += 1;
        }
    }
    if inside {
        counts.push(run);
        run = 0;
    }
    counts.push(run + (width - 1 - right) * height);
    if counts.last() == Some(&0) {
        counts.pop();
    }
    counts
}

/// COCO's compressed text of run lengths (`rleToString` of cocoapi's `maskApi.c`). From the fourth run on, the difference
/// to the run two before is stored. Numbers are split into groups of five bits, lowest first; the sixth bit of a
/// character says that another group follows.
fn compress_counts(counts: &[u32]) -> String {
    let mut text = String::new();
    for (i, &count) in counts.iter().enumerate() {
        let mut rest = i64::from(count) - if i > 2 { i64::from(counts[i - 2]) } else { 0 };
        loop {
            let bits = (rest & 0x1f) as u8;
            rest >>= 5;
            // The reader extends the sign from the fifth bit of the last group.
            let more = if bits & 0x10 == 0 { rest != 0 } else { rest != -1 };
            text.push(char::from(bits + if more { 0x20 } else { 0 } + 48));
            if !more {
                break;
            }
        }
    }
    text
}

/// Whether the entry of a frame agrees with that of its panoptic segments under an edge policy, which takes pixels from the segments of
/// rocks and none from their annotations: these contain the segments.
#[must_use]
pub fn contains_segments(entry: &Value, of_segments: &Value) -> bool {
    let annotations = |entry: &Value| entry["instances"].as_array().cloned().unwrap_or_default();
    let whole = annotations(entry);
    let bounds = |row: &Value| {
        let [left, top, width, height] = [0, 1, 2, 3].map(|i| row["bbox"][i].as_f64().unwrap_or(f64::NAN));
        [-left, -top, left + width, top + height]
    };
    let contains = |whole: &Value, part: &Value| {
        whole["area"].as_u64() >= part["area"].as_u64()
            && bounds(whole).iter().zip(bounds(part)).all(|(whole, part)| *whole >= part)
            && ["image_id", "category_id", "iscrowd"].iter().all(|key| whole[*key] == part[*key])
    };
    entry["segments"] == of_segments["segments"]
        && annotations(of_segments)
            .iter()
            .all(|part| whole.iter().any(|row| row["id"] == part["id"] && contains(row, part)))
}

/// The panoptic segment id of every pixel; 0 is void.
fn panoptic_ids(frame: &Frame) -> Vec<u32> {
    let segment = |(class, rock): (&u8, u32)| match ClassId(*class) {
        ClassId::REGOLITH => REGOLITH_SEGMENT,
        ClassId::SKY => SKY_SEGMENT,
        ClassId::ROCK if rock > 0 => ROCK_SEGMENT_BASE + rock,
        // Other rocks are void where the edge policy ignores them.
        _ if rock == CROWD => CROWD_SEGMENT,
        _ => 0,
    };
    frame.class.iter().zip(annotated_rocks(frame)).map(segment).collect()
}

/// The `segments_info` of a panoptic annotation.
fn segments_info(frame: &Frame, segments: &[u32]) -> Vec<Map<String, Value>> {
    regions(frame, |pixel| segments[pixel])
        .into_iter()
        .map(|(id, region)| {
            let category = match id {
                REGOLITH_SEGMENT => REGOLITH,
                SKY_SEGMENT => SKY,
                _ => ROCK,
            };
            let row = json!({
                "id": id, "category_id": category, "area": region.area, "bbox": region.bbox(),
                "iscrowd": u8::from(id == CROWD_SEGMENT),
            });
            row.as_object().cloned().unwrap_or_default()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::frame_line::FrameLine;
    use super::super::regions::Region;
    use super::*;

    #[test]
    fn run_lengths_are_column_major() {
        let frame = Frame {
            width: 4,
            height: 3,
            class: vec![0, 1, 1, 2, 0, 1, 2, 2, 0, 0, 1, 2],
            instances: vec![0, 7, 7, 0, 0, 7, 0, 0, 0, 0, 7, 0],
            ..Frame::default()
        };
        let rocks = annotated_rocks(&frame);
        let region = regions(&frame, |pixel| rocks[pixel])[&7];
        assert_eq!(region, Region { bounds: [1, 0, 2, 2], area: 4 });
        // Columns: 000 110 101 000.
        assert_eq!(run_lengths(&frame, region.bounds, |pixel| rocks[pixel] == 7), [3, 2, 1, 1, 1, 1, 3]);
        assert_eq!(region.bbox(), [1.0, 0.0, 2.0, 3.0]);
    }

    #[test]
    fn an_edge_policy_leaves_rocks_whole_and_takes_pixels_from_segments() {
        let rock = |instance, reason| RockLabel { instance, reason, ..crowd_label() };
        // Rock 7 loses two of three pixels, rock 8 its only one; rock 9 is ignored by rule.
        let frame = Frame {
            width: 4,
            height: 2,
            class: vec![255, 1, 255, 0, 255, 255, 255, 0],
            instances: vec![7, 7, 7, 0, 8, 9, 9, 0],
            rocks: vec![rock(7, LabelReason::Rock), rock(8, LabelReason::Rock), rock(9, LabelReason::Unseen)],
            ..Frame::default()
        };
        let record = FrameLine::default();
        let sample = Sample { frame: &frame, files: &[], record: &record };
        let files = Coco.frame_files(&sample).expect("files");
        let areas = |list: &str| -> Vec<u64> {
            files.entry[list]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(|row| row["area"].as_u64())
                .collect()
        };
        assert_eq!(areas("instances"), [3, 1, 2]);
        assert_eq!(files.entry["instances"][0]["bbox"], json!([0.0, 0.0, 3.0, 1.0]));
        assert_eq!(panoptic_ids(&frame), [0, 9, 0, 1, 0, CROWD_SEGMENT, CROWD_SEGMENT, 1]);
        assert_eq!(areas("segments"), [2, 1, 2]);

        // `verify` has the segments only.
        let panoptic = image::load_from_memory(&files.artifacts[1].bytes).expect("an image");
        let decoded = Coco.decode_labels("annotations/panoptic_train/000000.png", &panoptic).expect("labels");
        let of_segments = Coco.frame_files(&Sample { frame: &decoded, ..sample }).expect("files").entry;
        assert!(contains_segments(&files.entry, &of_segments));
        for (pointer, value) in [
            ("/instances/0/id", json!(5)),
            ("/instances/0/bbox/2", json!(1.0)),
            ("/instances/0/area", json!(0)),
            ("/instances/2/iscrowd", json!(0)),
            ("/segments/1/area", json!(2)),
        ] {
            let mut changed = files.entry.clone();
            *changed.pointer_mut(pointer).expect(pointer) = value;
            assert!(!contains_segments(&changed, &of_segments), "{pointer}");
        }
    }

    #[test]
    fn compressed_counts_equal_those_of_pycocotools() {
        // Expected values from pycocotools 2.0.
        assert_eq!(compress_counts(&[3, 2, 1, 1, 1, 1, 3]), "321O002");
        assert_eq!(compress_counts(&[31, 32, 1000]), "o0P1Xo0");
        assert_eq!(compress_counts(&[100, 200, 300, 50, 40, 500, 12, 3]), "T3X6\\9ZKlGR>TO_@");
    }
}
