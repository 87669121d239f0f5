//! Cityscapes: `leftImg8bit` and `gtFine`, by split and city; the one city is `moon`.
//!
//! Train ids are the class ids (255 is ignored); label ids are one higher, 0 is unlabelled. An instance id is the label
//! id times 1000 plus the rank of the rock's instance among the frame's visible rocks. Pixels without an instance, and
//! rocks beyond the first thousand, carry the label id alone, which Cityscapes reserves for stuff and groups.
//! Must not know: scene, GPU, the disk.

use serde_json::{Map, Value, json};

use super::interface::{
    CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange, split_or_train,
};
use crate::class::ClassId;
use crate::error::Result;
use crate::frame::{LabelReason, RockLabel};
use crate::output::artifact::{Artifact, FileKind};
use crate::output::encode::{json, png};

/// The Cityscapes layout.
#[derive(Debug)]
pub struct Cityscapes;

const CITY: &str = "moon";
/// Frames of a sequence: frame numbers have six digits.
const SEQUENCE_FRAMES: u64 = 1_000_000;
/// Instances that a label id can number.
const INSTANCES_PER_LABEL: u16 = 1000;

/// File name of the description of the classes.
const LABELS_FILE: &str = "labels.json";

/// Paths of a frame's files: the image, then the ground truth as train ids, label ids, instance ids and colours.
fn file_paths(split: &str, index: u64) -> [String; 5] {
    let (sequence, frame) = (index / SEQUENCE_FRAMES, index % SEQUENCE_FRAMES);
    let split = split_or_train(split);
    let path = |kind: &str, name: &str| {
        format!("{kind}/{split}/{CITY}/{CITY}_{sequence:06}_{frame:06}_{kind}{name}.png")
    };
    [
        path("leftImg8bit", ""),
        path("gtFine", "_labelTrainIds"),
        path("gtFine", "_labelIds"),
        path("gtFine", "_instanceIds"),
        path("gtFine", "_color"),
    ]
}

fn label_id(class: u8) -> u8 {
    if ClassId(class).class().is_some() { class + 1 } else { 0 }
}

/// The `instanceIds` map of a frame.
fn instance_ids(sample: &Sample<'_>) -> Vec<u16> {
    let frame = sample.frame;
    // Ignored rocks have no id, so they take no rank either.
    let counts = |rock: &&RockLabel| rock.reason == LabelReason::Rock;
    let mut visible: Vec<u16> = frame.rocks.iter().filter(counts).map(|rock| rock.instance).collect();
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

    fn has_fixed_ids(&self) -> bool {
        true
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let frame = sample.frame;
        let (width, height) = (frame.width, frame.height);
        let labels: Vec<u8> = frame.class.iter().map(|class| label_id(*class)).collect();
        let colour = |class: &u8| ClassId(*class).class().map_or([0; 3], |class| class.preview_rgb);
        let colours: Vec<u8> = frame.class.iter().flat_map(colour).collect();
        let contents = [
            sample.rgb().to_vec(),
            png::ids_u8(width, height, &frame.class)?,
            png::ids_u8(width, height, &labels)?,
            png::ids_u16(width, height, &instance_ids(sample))?,
            png::label_colours(width, height, &colours)?,
        ];
        let paths = file_paths(&sample.record.split, sample.record.index);
        let files = paths.into_iter().zip(contents).map(|(name, bytes)| Artifact { name, bytes });
        Ok(FrameFiles { artifacts: files.collect(), entry: Value::Null })
    }

    fn frame_names(&self, _kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        FrameNames { files: file_paths(split, index).into(), entry: Map::new() }
    }

    fn image_and_mask(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let [image, train_ids, ..] = file_paths(split, index);
        Some([image, train_ids])
    }

    fn index_paths<'a>(&self, _splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        Box::new([LABELS_FILE, CARD_FILE].into_iter().map(str::to_owned))
    }

    fn index_files(
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
        write(Artifact { name: LABELS_FILE.to_owned(), bytes: json::to_bytes(&labels)? })?;
        write(index.card_file())
    }
}
