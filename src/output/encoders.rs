//! A plane of a frame to the bytes of a file.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use serde_json::{Value, json};

use super::Source;
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::Frame;

impl Source<'_> {
    /// The class ids under the edge policy.
    fn classes(&self) -> Vec<u8> {
        self.edges.apply(self.frame)
    }
}

pub(super) fn rgb_png(source: &Source<'_>) -> Result<Vec<u8>> {
    png(source.frame, &source.frame.rgb, ExtendedColorType::Rgb8, FilterType::Adaptive)
}

pub(super) fn mask_png(source: &Source<'_>) -> Result<Vec<u8>> {
    let ids: Vec<u8> = source.classes().iter().map(|&id| source.label_ids.mask_id(id)).collect();
    png(source.frame, &ids, ExtendedColorType::L8, FilterType::Up)
}

pub(super) fn preview_png(source: &Source<'_>) -> Result<Vec<u8>> {
    let colour = |id: &u8| ClassId(*id).class().map_or([0; 3], |class| class.preview_rgb);
    let rgb: Vec<u8> = source.classes().iter().flat_map(colour).collect();
    png(source.frame, &rgb, ExtendedColorType::Rgb8, FilterType::Up)
}

pub(super) fn plane_distance_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    Ok(npy(source.frame, 1, &source.frame.depth_m))
}

pub(super) fn camera_distance_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    let frame = source.frame;
    let along_ray = |(pixel, depth_m): (u32, &f32)| {
        let x = f64::from(pixel % frame.width) + 0.5 - f64::from(frame.width) / 2.0;
        let y = f64::from(pixel / frame.width) + 0.5 - f64::from(frame.height) / 2.0;
        let [x, y] = frame.lens.undistort([x / frame.focal_px, y / frame.focal_px]);
        (f64::from(*depth_m) * (1.0 + x * x + y * y).sqrt()) as f32
    };
    let distances: Vec<f32> = (0..).zip(&frame.depth_m).map(along_ray).collect();
    Ok(npy(frame, 1, &distances))
}

pub(super) fn normals_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    Ok(npy(source.frame, 3, &source.frame.normals))
}

pub(super) fn coverage_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    let share = |counts: &[u8; 3]| {
        let all: f32 = counts.iter().map(|count| f32::from(*count)).sum();
        counts.map(|count| f32::from(count) / all)
    };
    let shares: Vec<f32> = source.frame.sample_counts.iter().flat_map(share).collect();
    Ok(npy(source.frame, 3, &shares))
}

pub(super) fn instances_png(source: &Source<'_>) -> Result<Vec<u8>> {
    let bytes: &[u8] = bytemuck::cast_slice(&source.frame.instances);
    png(source.frame, bytes, ExtendedColorType::L16, FilterType::Up)
}

pub(super) fn instances_json(source: &Source<'_>) -> Result<Vec<u8>> {
    let rows = source.frame.rocks.iter().map(|rock| {
        let row = json!({
            "path": format!("/World/Rocks/Rock_{:03}", rock.instance - 1),
            "class": "rock",
            "visible_px": rock.visible_px,
            "box_px": rock.box_px,
            "occluded": rock.occluded(),
            "height_m": rock.height_m,
            "diameter_m": rock.diameter_m,
        });
        (rock.instance.to_string(), row)
    });
    json_bytes(&rows.collect::<serde_json::Map<_, _>>().into())
}

pub(super) fn slope_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    Ok(npy(source.frame, 1, &source.frame.slope_deg))
}

pub(super) fn incidence_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    Ok(npy(source.frame, 1, &source.frame.incidence_deg))
}

pub(super) fn phase_npy(source: &Source<'_>) -> Result<Vec<u8>> {
    Ok(npy(source.frame, 1, &source.frame.phase_deg))
}

pub(super) fn craters_png(source: &Source<'_>) -> Result<Vec<u8>> {
    png(source.frame, &source.frame.craters, ExtendedColorType::L8, FilterType::Up)
}

/// Id, name and colour of each of five classes: the first three as in the mask; the colours are those of the LuSNAR dataset.
const FIVE_CLASSES: [(u8, &str, [u8; 3]); 5] = [
    (0, "regolith", [0xbb, 0x46, 0x9c]),
    (1, "rock", [0xe8, 0xfa, 0x50]),
    (2, "sky", [0x22, 0xc9, 0xf8]),
    (3, "crater", [0x78, 0x00, 0xc8]),
    (4, "mountain", [0xad, 0x45, 0x1f]),
];

pub(super) fn five_classes_png(source: &Source<'_>) -> Result<Vec<u8>> {
    png(source.frame, &source.frame.five_classes, ExtendedColorType::L8, FilterType::Up)
}

pub(super) fn five_classes_preview_png(source: &Source<'_>) -> Result<Vec<u8>> {
    let colour = |id: &u8| FIVE_CLASSES.get(usize::from(*id)).map_or([0; 3], |(.., rgb)| *rgb);
    let rgb: Vec<u8> = source.frame.five_classes.iter().flat_map(colour).collect();
    png(source.frame, &rgb, ExtendedColorType::Rgb8, FilterType::Up)
}

pub(super) fn five_classes_json(_: &Source<'_>) -> Result<Vec<u8>> {
    let rows = FIVE_CLASSES.iter().map(|(id, name, _)| (id.to_string(), json!({ "class": name })));
    json_bytes(&rows.collect::<serde_json::Map<_, _>>().into())
}

/// Rocks from this diameter on are large in [`SIZED_CLASSES`], metres: the dataset that the colours come from states none, and
/// half a metre is what a rover drives around.
const LARGE_ROCK_M: f32 = 0.5;

/// Name and colour of each class of rocks told apart by size: those of the Artificial Lunar Landscape dataset (Pessia and
/// Ishigami). The part before the comma, or all of it, is the class in the mask.
const SIZED_CLASSES: [(&str, [u8; 3]); 4] =
    [("regolith", [0, 0, 0]), ("rock,small", [0, 255, 0]), ("rock,large", [0, 0, 255]), ("sky", [255, 0, 0])];

pub(super) fn rock_sizes_png(source: &Source<'_>) -> Result<Vec<u8>> {
    let frame = source.frame;
    let most = frame.rocks.iter().map(|rock| rock.instance).max().unwrap_or(0);
    let mut is_large = vec![false; usize::from(most) + 1];
    for rock in &frame.rocks {
        is_large[usize::from(rock.instance)] = rock.diameter_m >= LARGE_ROCK_M;
    }
    let rgb: Vec<u8> = frame
        .class
        .iter()
        .zip(&frame.instances)
        .flat_map(|(id, instance)| {
            let row = match ClassId(*id) {
                ClassId::SKY => 3,
                ClassId::ROCK => 1 + usize::from(is_large.get(usize::from(*instance)) == Some(&true)),
                _ => 0,
            };
            SIZED_CLASSES[row].1
        })
        .collect();
    png(frame, &rgb, ExtendedColorType::Rgb8, FilterType::Up)
}

pub(super) fn rock_sizes_json(_: &Source<'_>) -> Result<Vec<u8>> {
    let rows = SIZED_CLASSES
        .iter()
        .map(|(name, [r, g, b])| (format!("({r}, {g}, {b}, 255)"), json!({ "class": name })));
    json_bytes(&rows.collect::<serde_json::Map<_, _>>().into())
}

pub(super) fn shadow_png(source: &Source<'_>) -> Result<Vec<u8>> {
    png(source.frame, &source.frame.sun_occlusion, ExtendedColorType::L8, FilterType::Up)
}

pub(super) fn hdr_exr(source: &Source<'_>) -> Result<Vec<u8>> {
    use exr::prelude::{Encoding, SpecificChannels, WritableImage as _};
    let frame = source.frame;
    let size = (frame.width as usize, frame.height as usize);
    let pixel = |at: exr::math::Vec2<usize>| {
        let first = 3 * (at.y() * size.0 + at.x());
        (frame.radiance[first], frame.radiance[first + 1], frame.radiance[first + 2])
    };
    let layer = exr::image::Layer::new(
        size,
        exr::meta::header::LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        SpecificChannels::rgb(pixel),
    );
    let mut bytes = std::io::Cursor::new(Vec::new());
    exr::image::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    Ok(bytes.into_inner())
}

/// A NumPy array of float32, rows x columns, or rows x columns x `channels`.
fn npy(frame: &Frame, channels: usize, values: &[f32]) -> Vec<u8> {
    let shape = [frame.height as usize, frame.width as usize, channels];
    let mut bytes = npy_header("<f4", if channels == 1 { &shape[..2] } else { &shape });
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// What stands before the data of a NumPy array file (format version 1.0) of this type (`<f4`, `|u1`, ...) and shape.
#[must_use]
pub fn npy_header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let shape: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let shape = shape.join(", ");
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}{comma}), }}");
    // Magic, version and length take ten bytes; the data start at a multiple of 64.
    header.push_str(&" ".repeat(63 - (header.len() + 10) % 64));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes
}

pub(super) fn labels_json(source: &Source<'_>) -> Result<Vec<u8>> {
    json_bytes(&source.label_ids.labels())
}

pub(super) fn meta_json(source: &Source<'_>) -> Result<Vec<u8>> {
    json_bytes(source.meta)
}

fn png(frame: &Frame, bytes: &[u8], kind: ExtendedColorType, filter: FilterType) -> Result<Vec<u8>> {
    encode_png([frame.width, frame.height], bytes, kind, filter)
}

/// A mask of these ids, one byte a pixel.
pub(crate) fn ids_png(width: u32, height: u32, ids: &[u8]) -> Result<Vec<u8>> {
    encode_png([width, height], ids, ExtendedColorType::L8, FilterType::Up)
}

/// A mask of these ids, two bytes a pixel.
pub(crate) fn wide_ids_png(width: u32, height: u32, ids: &[u16]) -> Result<Vec<u8>> {
    encode_png([width, height], bytemuck::cast_slice(ids), ExtendedColorType::L16, FilterType::Up)
}

/// A picture of these colours that is no photograph, three bytes a pixel.
pub(crate) fn rgb_bytes_png(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>> {
    encode_png([width, height], rgb, ExtendedColorType::Rgb8, FilterType::Up)
}

fn encode_png(
    [width, height]: [u32; 2],
    bytes: &[u8],
    kind: ExtendedColorType,
    filter: FilterType,
) -> Result<Vec<u8>> {
    let mut encoded = Vec::new();
    PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, filter)
        .write_image(bytes, width, height, kind)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    Ok(encoded)
}

pub(crate) fn json_bytes(value: &Value) -> Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}
