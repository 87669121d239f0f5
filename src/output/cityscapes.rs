//! Cityscapes: `leftImg8bit` and `gtFine` by split and city, of which there is one: `moon`.
//!
//! Train ids are the classes' own (255 to be ignored); label ids are one more, 0 for unlabelled. An instance id is the
//! label id times 1000 plus the rock's place in the frame; the label id alone, which stands for a group, where there is
//! no rock or a thousand came before.
//! Must not know: scene, GPU, the disk.

use serde_json::{Value, json};

use super::writer::{Index, Placed, Sample, Writer, split_or_train};
use super::{Artifact, encoders};
use crate::class::ClassId;
use crate::error::Result;

/// See the module.
#[derive(Debug)]
pub struct Cityscapes;

const CITY: &str = "moon";

fn stem(split: &str, kind: &str, index: u64) -> String {
    // A sequence has a million frames.
    let (sequence, frame) = (index / 1_000_000, index % 1_000_000);
    format!("{kind}/{split}/{CITY}/{CITY}_{sequence:06}_{frame:06}_{kind}")
}

fn label_id(class: u8) -> u8 {
    if ClassId(class).class().is_some() { class + 1 } else { 0 }
}

impl Writer for Cityscapes {
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
        let frame = sample.frame;
        let (width, height) = (frame.width, frame.height);
        let rgb = sample.files.iter().find(|file| file.stem == "rgb").map_or(&[][..], |file| &file.bytes);
        let labels: Vec<u8> = frame.class.iter().map(|class| label_id(*class)).collect();
        let mut seen: Vec<u16> = frame.rocks.iter().map(|rock| rock.instance).collect();
        seen.sort_unstable();
        let instance_id = |(class, rock): (&u8, &u16)| {
            let label = u16::from(label_id(*class));
            let place = seen.binary_search(rock).ok();
            let place = place.filter(|place| *class == ClassId::ROCK.0 && *place < 1000);
            place.map_or(label, |place| label * 1000 + place as u16)
        };
        let instances: Vec<u16> = frame.class.iter().zip(&frame.instances).map(instance_id).collect();
        let colour = |class: &u8| ClassId(*class).class().map_or([0; 3], |class| class.preview_rgb);
        let colours: Vec<u8> = frame.class.iter().flat_map(colour).collect();
        let truth = |what: &str, bytes| Artifact {
            name: format!("{}_{what}.png", stem(split, "gtFine", sample.index)),
            bytes,
        };
        let files = vec![
            Artifact {
                name: format!("{}.png", stem(split, "leftImg8bit", sample.index)),
                bytes: rgb.to_vec(),
            },
            truth("labelTrainIds", encoders::ids_png(width, height, &frame.class)?),
            truth("labelIds", encoders::ids_png(width, height, &labels)?),
            truth("instanceIds", encoders::wide_ids_png(width, height, &instances)?),
            truth("color", encoders::rgb_bytes_png(width, height, &colours)?),
        ];
        Ok(Placed { files, entry: Value::Null })
    }

    fn pictures(&self, split: &str, index: u64) -> Option<[String; 2]> {
        let split = split_or_train(split);
        Some([
            format!("{}.png", stem(split, "leftImg8bit", index)),
            format!("{}_labelTrainIds.png", stem(split, "gtFine", index)),
        ])
    }

    fn index(&self, index: &Index<'_>, put: &mut dyn FnMut(Artifact) -> Result<()>) -> Result<()> {
        let labels: Vec<Value> = ClassId::ALL
            .iter()
            .map(|class| {
                json!({
                    "name": class.name, "id": label_id(class.id.0), "trainId": class.id.0,
                    "hasInstances": class.id == ClassId::ROCK, "color": class.preview_rgb,
                })
            })
            .collect();
        put(Artifact { name: "labels.json".to_owned(), bytes: encoders::json_bytes(&labels.into())? })?;
        put(index.card_file())
    }
}
