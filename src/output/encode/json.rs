//! JSON files: label files, the instance mapping, the frame's metadata.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::EncodeInput;
use super::label_sets::{FIVE_CLASSES, ROCK_SIZE_CLASSES};
use crate::error::{Error, Result};
use crate::frame::Frame;

/// Indented JSON with a final newline.
pub(crate) fn to_bytes(value: &impl Serialize) -> Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// `frame_N.json`.
pub(in crate::output) fn meta(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    to_bytes(input.meta)
}

/// The mask's ids and their class names.
pub(in crate::output) fn labels(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    to_bytes(&input.label_ids.labels())
}

/// Instance id to prim path, bounding box, visible pixels, occluded fraction, size in metres, and why it is ignored, if it is.
pub(in crate::output) fn instance_mapping(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    to_bytes(&rocks_json(input.frame))
}

/// The content of the instance mapping.
#[must_use]
pub fn rocks_json(frame: &Frame) -> Map<String, Value> {
    let rows = frame.rocks.iter().map(|rock| {
        let row = json!({
            "path": format!("/World/Rocks/Rock_{:03}", rock.instance - 1),
            "class": "rock",
            "visible_px": rock.visible_px,
            "box_px": rock.box_px,
            "occluded": rock.occluded(),
            "height_m": rock.height_m,
            "diameter_m": rock.diameter_m,
            "label": rock.reason.name(),
        });
        (rock.instance.to_string(), row)
    });
    rows.collect()
}

/// Names of the five classes by id.
pub(in crate::output) fn five_classes(_: &EncodeInput<'_>) -> Result<Vec<u8>> {
    let rows = FIVE_CLASSES.iter().map(|(id, name, _)| (id.to_string(), json!({ "class": name })));
    to_bytes(&rows.collect::<Map<_, _>>())
}

/// Names of the classes by rock size, by RGBA colour.
pub(in crate::output) fn rock_sizes(_: &EncodeInput<'_>) -> Result<Vec<u8>> {
    let rows = ROCK_SIZE_CLASSES
        .iter()
        .map(|(name, [r, g, b])| (format!("({r}, {g}, {b}, 255)"), json!({ "class": name })));
    to_bytes(&rows.collect::<Map<_, _>>())
}
