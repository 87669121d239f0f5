//! Cityscapes: `leftImg8bit` and `gtFine`, by split and city; the one city is `moon`.
//!
//! Train ids are the class ids (255 is ignored); label ids are one higher, 0 is unlabelled. An instance id is the label
//! id times 1000 plus the rank of the rock's instance among the frame's visible rocks. Pixels without an instance, and
//! rocks beyond the first thousand, carry the label id alone, which Cityscapes reserves for stuff and groups.
//! Must not know: scene, GPU, the disk.

use serde_json::{Value, json};

use super::interface::{DatasetIndex, FrameFiles, Layout, Sample, split_or_train};
use crate::class::ClassId;
use crate::error::Result;
use crate::output::artifact::Artifact;
use crate::output::encode::{json, png};

/// The Cityscapes layout.
#[derive(Debug)]
pub struct Cityscapes;

const CITY: &str = "moon";
/// Frames of a sequence: frame numbers have six digits.
const SEQUENCE_FRAMES: u64 = 1_000_000;
/// Instances that a label id can number.
const INSTANCES_PER_LABEL: u16 = 1000;

fn stem(split: &str, kind: &str, index: u64) -> String {
    let (sequence, frame) = (index / SEQUENCE_FRAMES, index % SEQUENCE_FRAMES);
    format!("{kind}/{split}/{CITY}/{CITY}_{sequence:06}_{frame:06}_{kind}")
}

fn label_id(class: u8) -> u8 {
    if ClassId(class).class().is_some() { class + 1 } else { 0 }
}

/// The `instanceIds` map of a frame.
fn instance_ids(sample: &Sample<'_>) -> Vec<u16> {
    let frame = sample.frame;
    let mut visible: Vec<u16> = frame.rocks.iter().map(|rock| rock.instance).collect();
    visible.sort_unstable();
    let instance_id = |(class, rock): (&u8, &u16)| {
        let label = u16::from(label_id(*class));
        let rank = visible.binary_search(rock).ok();
        let rank = rank.filter(|rank| *class == ClassId::ROCK.0 && *rank < usize::from(INSTANCES_PER_LABEL));
        rank.map_or(label, |rank| label * INSTANCES_PER_LABEL + rank as u16)
    };
    frame.class.iter().zip(&frame.instances).map(instance_id).collect()
}

impl Layout for Cityscapes {
    fn required_outputs(&self) -> &'static [&'static str] {
        &["rgb", "mask", "instances"]
    }

    fn supports(&self, output: &str) -> bool {
        self.required_outputs().contains(&output)
    }

    fn has_fixed_ids(&self) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let split = split_or_train(&sample.record.split);
        let frame = sample.frame;
        let (width, height) = (frame.width, frame.height);
        let labels: Vec<u8> = frame.class.iter().map(|class| label_id(*class)).collect();
        let colour = |class: &u8| ClassId(*class).class().map_or([0; 3], |class| class.preview_rgb);
        let colours: Vec<u8> = frame.class.iter().flat_map(colour).collect();
        let ground_truth = |kind: &str, bytes| Artifact {
            name: format!("{}_{kind}.png", stem(split, "gtFine", sample.record.index)),
            bytes,
        };
        let files = vec![
            Artifact {
                name: format!("{}.png", stem(split, "leftImg8bit", sample.record.index)),
                bytes: sample.rgb().to_vec(),
            },
            ground_truth("labelTrainIds", png::ids_u8(width, height, &frame.class)?),
            ground_truth("labelIds", png::ids_u8(width, height, &labels)?),
            ground_truth("instanceIds", png::ids_u16(width, height, &instance_ids(sample))?),
            ground_truth("color", png::label_colours(width, height, &colours)?),
        ];
        Ok(FrameFiles { artifacts: files, entry: Value::Null })
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let split = split_or_train(split);
        Some([
            format!("{}.png", stem(split, "leftImg8bit", index)),
            format!("{}_labelTrainIds.png", stem(split, "gtFine", index)),
        ])
    }

    fn write_index(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        let labels: Vec<Value> = ClassId::ALL
            .iter()
            .map(|class| {
                json!({
                    "name": class.name, "id": label_id(class.id.0), "trainId": class.id.0,
                    "hasInstances": class.id == ClassId::ROCK, "color": class.preview_rgb,
                })
            })
            .collect();
        write(Artifact { name: "labels.json".to_owned(), bytes: json::to_bytes(&labels)? })?;
        write(index.card_file())
    }
}
