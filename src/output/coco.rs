//! COCO: pictures by split, instances of rocks with boxes and run-length masks, panoptic segments.
//!
//! Rocks are the one category of things (1); regolith (2) and sky (3) are stuff and stand in the panoptic files alone.
//! Category 0 is not used: readers drop it. Ids are functions of frame and instance, so that every run gives the same.
//! Must not know: scene, GPU, the disk.

use serde_json::{Map, Value, json};

use super::writer::{Index, Placed, Sample, Writer, split_or_train};
use super::{Artifact, encoders};
use crate::class::ClassId;
use crate::error::Result;
use crate::frame::Frame;

/// See the module.
#[derive(Debug)]
pub struct Coco;

/// Ids of the panoptic segments of stuff; rock k has `FIRST_ROCK` + k.
const REGOLITH: u32 = 1;
const SKY: u32 = 2;
const FIRST_ROCK: u32 = 2;
/// Frames are this far apart in the ids of annotations; instances are below it.
const IDS_PER_FRAME: u64 = 1 << 16;

impl Writer for Coco {
    fn outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask", "instances"]
    }

    fn holds(&self, output: &str) -> bool {
        self.outputs().contains(&output)
    }

    fn has_own_ids(&self) -> bool {
        true
    }

    fn place(&self, sample: &Sample<'_>) -> Result<Placed> {
        let split = split_or_train(sample.split);
        let (frame, name) = (sample.frame, file_name(sample.index));
        let rgb = sample.files.iter().find(|file| file.stem == "rgb").map_or(&[][..], |file| &file.bytes);
        let segments = panoptic_ids(frame);
        let colours: Vec<u8> =
            segments.iter().flat_map(|id| [*id as u8, (*id >> 8) as u8, (*id >> 16) as u8]).collect();
        let files = vec![
            Artifact { name: format!("{split}/{name}"), bytes: rgb.to_vec() },
            Artifact {
                name: format!("annotations/panoptic_{split}/{name}"),
                bytes: encoders::rgb_bytes_png(frame.width, frame.height, &colours)?,
            },
        ];
        Ok(Placed {
            files,
            entry: json!({ "instances": instances(sample), "segments": segments_info(frame, &segments) }),
        })
    }

    fn pictures(&self, _split: &str, _index: u64) -> Option<[String; 2]> {
        None
    }

    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()> {
        let info = json!({
            "description": "Labelled pictures of the Moon, rendered by regolith-render",
            "version": index.manifest.get("version"),
        });
        let licenses = json!([{ "id": 1, "name": "CC0 1.0", "url": "https://creativecommons.org/publicdomain/zero/1.0/" }]);
        let size = index.manifest.get("size").cloned().unwrap_or_default();
        for split in index.split_names() {
            let (mut images, mut instances, mut panoptic) = (Vec::new(), Vec::new(), Vec::new());
            index.lines.for_each(&mut |mut line| {
                if split_or_train(line.get("split").and_then(Value::as_str).unwrap_or_default()) != split {
                    return Ok(());
                }
                let number = line.get("index").and_then(Value::as_u64).unwrap_or_default();
                let name = file_name(number);
                images.push(json!({
                    "id": number, "file_name": name, "width": size[0], "height": size[1], "license": 1,
                }));
                let mut entry = line.remove("entry").unwrap_or_default();
                if let Value::Array(rows) = entry["instances"].take() {
                    instances.extend(rows);
                }
                let segments = entry["segments"].take();
                panoptic.push(json!({ "image_id": number, "file_name": name, "segments_info": segments }));
                Ok(())
            })?;
            for (kind, annotations, categories) in
                [("instances", instances, thing_categories()), ("panoptic", panoptic, panoptic_categories())]
            {
                let content = json!({
                    "info": info, "licenses": licenses, "images": images, "annotations": annotations,
                    "categories": categories,
                });
                let mut bytes = content.to_string().into_bytes();
                bytes.push(b'\n');
                put(Artifact { name: format!("annotations/{kind}_{split}.json"), bytes })?;
            }
        }
        put(index.card_file())
    }
}

fn file_name(index: u64) -> String {
    format!("{index:06}.png")
}

fn thing_categories() -> Value {
    json!([{ "id": 1, "name": "rock", "supercategory": "hazard" }])
}

fn panoptic_categories() -> Value {
    let row = |id: u32, class: ClassId, is_thing: u8| {
        let (name, colour) = class.class().map_or(("", [0; 3]), |class| (class.name, class.preview_rgb));
        json!({ "id": id, "name": name, "supercategory": name, "isthing": is_thing, "color": colour })
    };
    json!([row(1, ClassId::ROCK, 1), row(2, ClassId::REGOLITH, 0), row(3, ClassId::SKY, 0)])
}

/// The rock of each pixel whose class is rock; 0 elsewhere. (Where classes meet the mask may say to ignore a pixel.)
fn rock_at(frame: &Frame, pixel: usize) -> u16 {
    if frame.class[pixel] == ClassId::ROCK.0 { frame.instances[pixel] } else { 0 }
}

/// Smallest and largest column and row, and number, of the pixels of each id, by rising id; 0 does not count.
fn extents(frame: &Frame, id_at: impl Fn(usize) -> u32) -> std::collections::BTreeMap<u32, ([u32; 4], u64)> {
    let mut extents = std::collections::BTreeMap::new();
    for pixel in 0..frame.class.len() {
        let id = id_at(pixel);
        if id > 0 {
            let (x, y) = (pixel as u32 % frame.width, pixel as u32 / frame.width);
            let (reach, area) = extents.entry(id).or_insert(([x, y, x, y], 0));
            *reach = [reach[0].min(x), reach[1].min(y), reach[2].max(x), reach[3].max(y)];
            *area += 1;
        }
    }
    extents
}

fn bbox([left, top, right, bottom]: [u32; 4]) -> [f64; 4] {
    [left, top, right - left + 1, bottom - top + 1].map(f64::from)
}

fn instances(sample: &Sample<'_>) -> Vec<Value> {
    let frame = sample.frame;
    extents(frame, |pixel| u32::from(rock_at(frame, pixel)))
        .into_iter()
        .map(|(rock, (reach, area))| {
            let counts = run_lengths(frame, reach, rock as u16);
            json!({
                "id": sample.index * IDS_PER_FRAME + u64::from(rock),
                "image_id": sample.index,
                "category_id": 1,
                "segmentation": { "size": [frame.height, frame.width], "counts": compressed(&counts) },
                "area": area,
                "bbox": bbox(reach),
                "iscrowd": 0,
            })
        })
        .collect()
}

/// Lengths of the runs of pixels that are not and that are of a rock, column by column.
fn run_lengths(frame: &Frame, [left, top, right, bottom]: [u32; 4], rock: u16) -> Vec<u32> {
    let (width, height) = (frame.width, frame.height);
    let (mut counts, mut run, mut inside) = (Vec::new(), left * height, false);
    for x in left..=right {
        for y in 0..height {
            let is_rock = (top..=bottom).contains(&y) && rock_at(frame, (y * width + x) as usize) == rock;
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

/// COCO's text of run lengths: from the fourth on the difference to the one two before; five bits a character, the
/// sixth says that more follow.
fn compressed(counts: &[u32]) -> String {
    let mut text = String::new();
    for (place, &count) in counts.iter().enumerate() {
        let mut rest = i64::from(count) - if place > 2 { i64::from(counts[place - 2]) } else { 0 };
        loop {
            let bits = (rest & 0x1f) as u8;
            rest >>= 5;
            // The fifth bit is the sign of what is left out.
            let more = if bits & 0x10 == 0 { rest != 0 } else { rest != -1 };
            text.push(char::from(bits + if more { 0x20 } else { 0 } + 48));
            if !more {
                break;
            }
        }
    }
    text
}

/// The panoptic segment of every pixel; 0 for none.
fn panoptic_ids(frame: &Frame) -> Vec<u32> {
    (0..frame.class.len())
        .map(|pixel| match ClassId(frame.class[pixel]) {
            ClassId::REGOLITH => REGOLITH,
            ClassId::SKY => SKY,
            ClassId::ROCK => FIRST_ROCK + u32::from(frame.instances[pixel]),
            _ => 0,
        })
        .collect()
}

fn segments_info(frame: &Frame, segments: &[u32]) -> Vec<Map<String, Value>> {
    extents(frame, |pixel| segments[pixel])
        .into_iter()
        .map(|(id, (reach, area))| {
            let category = match id {
                REGOLITH => 2,
                SKY => 3,
                _ => 1,
            };
            let row =
                json!({ "id": id, "category_id": category, "area": area, "bbox": bbox(reach), "iscrowd": 0 });
            row.as_object().cloned().unwrap_or_default()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_lengths_are_those_of_the_columns() {
        let frame = Frame {
            width: 4,
            height: 3,
            class: vec![0, 1, 1, 2, 0, 1, 2, 2, 0, 0, 1, 2],
            instances: vec![0, 7, 7, 0, 0, 7, 0, 0, 0, 0, 7, 0],
            ..Frame::default()
        };
        let (reach, area) = extents(&frame, |pixel| u32::from(rock_at(&frame, pixel)))[&7];
        assert_eq!((reach, area), ([1, 0, 2, 2], 4));
        // Columns: 000 110 101 000.
        assert_eq!(run_lengths(&frame, reach, 7), [3, 2, 1, 1, 1, 1, 3]);
        assert_eq!(bbox(reach), [1.0, 0.0, 2.0, 3.0]);
    }

    #[test]
    fn compressed_text_is_that_of_the_official_tools() {
        // What pycocotools 2.0 gives for these runs.
        assert_eq!(compressed(&[3, 2, 1, 1, 1, 1, 3]), "321O002");
        assert_eq!(compressed(&[31, 32, 1000]), "o0P1Xo0");
        assert_eq!(compressed(&[100, 200, 300, 50, 40, 500, 12, 3]), "T3X6\\9ZKlGR>TO_@");
    }
}
