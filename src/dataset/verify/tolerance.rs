//! How much a frame may differ that another adapter, raster backend or version rendered. On the same ones nothing may, and where compute
//! passes rasterised both, no label.
//!
//! Must not know: files, rendering.

use serde_json::Value;

use super::files::array_header;
use super::images::{decode_exr, decode_png, size_of_exr};
use super::templates::ExpectedFile;
use crate::output::layout::yolo::row_boxes;

/// Largest fraction of the pixels of a label map that may differ (at outlines).
const LABEL_FRACTION: f64 = 2e-3;
/// The same for rock instances and what is coloured by them, which have more outlines.
const INSTANCE_FRACTION: f64 = 5e-3;
/// Largest mean difference of 8-bit values, of colour and of shadow.
const MEAN_U8: f64 = 1.0;
/// Values of an array that differ by less than this, plus this fraction of the value, are equal.
const EQUAL: f64 = 1e-2;
/// Largest fraction of an array's values that may differ by more (at outlines).
const ARRAY_FRACTION: f64 = 2e-2;
/// Largest mean difference of radiance, as a fraction of the mean.
const RADIANCE_FRACTION: f64 = 1e-2;
/// Largest difference of the 99th percentile and of the largest 8-bit value.
const EXTREME_U8: f64 = 8.0;
/// Largest difference of exposures, stops, and of the light that is black or white, parts of the full well.
const EXPOSURE_EV: f64 = 0.05;
const LIGHT: f64 = 0.02;
/// Rocks of fewer pixels may be missing, or be added.
const SMALL_ROCK_PX: f64 = 8.0;
/// Largest difference of a rock's pixels, as a fraction of them, and of its box in pixels.
const ROCK_FRACTION: f64 = 0.15;
const ROCK_BOX_PX: f64 = 2.0;
/// The same for a box whose pixels are unknown, as a fraction of the image's sides.
const ROW_BOX: f64 = 0.05;

/// In what a frame must agree with one that is rendered again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Agreement {
    /// In every byte.
    Bytes,
    /// In every label of an image.
    Labels,
    /// But for what another renderer may change.
    Near,
}

/// Copies a value of the other to a record where the two may differ.
fn forgive(found: &Value, expected: &mut Value, path: &[&str], is_near: impl FnOnce(f64, f64) -> bool) {
    let at = |value: &Value| path.iter().try_fold(value, |value, key| value.get(key)).cloned();
    if let (Some(a), Some(b)) = (at(found), at(expected))
        && a.as_f64().zip(b.as_f64()).is_some_and(|(a, b)| is_near(a, b))
        && let Some(slot) = path.iter().try_fold(expected, |value, key| value.get_mut(key))
    {
        *slot = a;
    }
}

/// Makes `expected` equal to `found` in what another renderer may change in a line or a metadata file.
pub(super) fn forgive_record(found: &mut Value, expected: &mut Value) {
    let (Value::Object(record), Value::Object(wanted)) = (&*found, &mut *expected) else { return };
    // Segments follow from label images, which are compared themselves.
    for key in ["adapter", "raster", "entry", "version"] {
        if let (Some(value), Some(slot)) = (record.get(key), wanted.get_mut(key)) {
            slot.clone_from(value);
        }
    }
    for class in ["regolith", "rock", "sky", "unlabelled", "ignored", "too_small", "unseen"] {
        for key in ["coverage", "mask_coverage"] {
            forgive(found, expected, &[key, class], |a, b| (a - b).abs() <= LABEL_FRACTION);
        }
    }
    forgive(found, expected, &["exposure", "ev"], |a, b| (a - b).abs() <= EXPOSURE_EV);
    for key in ["black", "white"] {
        forgive(found, expected, &["exposure", key], |a, b| (a - b).abs() <= LIGHT);
    }
    forgive(found, expected, &["rgb", "mean"], |a, b| (a - b).abs() <= MEAN_U8);
    for key in ["p99", "max"] {
        forgive(found, expected, &["rgb", key], |a, b| (a - b).abs() <= EXTREME_U8);
    }
    // The image and its mean are compared themselves.
    for key in ["sum", "sum_of_squares"] {
        let sums = found.get("rgb").and_then(|rgb| rgb.get(key)).cloned();
        if let (Some(sums), Some(slot)) = (sums, expected.get_mut("rgb").and_then(|rgb| rgb.get_mut(key))) {
            *slot = sums;
        }
    }
}

/// Makes `expected` equal to `found` in the backend and the driver of a metadata file.
pub(super) fn forgive_driver(found: &mut Value, expected: &mut Value) {
    for key in ["backend", "driver"] {
        if let (Some(found), Some(expected)) =
            (found["adapter"].get(key), expected.get_mut("adapter").and_then(|adapter| adapter.get_mut(key)))
            && found.is_string()
        {
            expected.clone_from(found);
        }
    }
}

/// Makes `expected` equal to `found` in what another renderer may change in an instance mapping.
pub(super) fn forgive_rocks(found: &mut Value, expected: &mut Value) {
    let visible = |row: &Value| row.get("visible_px").and_then(Value::as_f64);
    let (Value::Object(rocks), Value::Object(wanted)) = (&mut *found, &mut *expected) else { return };
    let is_small = |row: &Value| visible(row).is_some_and(|pixels| pixels < SMALL_ROCK_PX);
    rocks.retain(|id, row| wanted.contains_key(id) || !is_small(row));
    wanted.retain(|id, row| rocks.contains_key(id) || !is_small(row));
    for (id, row) in rocks.iter() {
        let Some(wanted) = wanted.get_mut(id) else { continue };
        let Some(pixels) = visible(row) else { continue };
        let allowed_px = 2.0 + ROCK_FRACTION * pixels;
        forgive(row, wanted, &["visible_px"], |a, b| (a - b).abs() <= allowed_px);
        forgive(row, wanted, &["occluded"], |a, b| (a - b).abs() <= ROCK_FRACTION + 2.0 / pixels);
        if let (Some(a), Some(b)) = (row["box_px"].as_array(), wanted["box_px"].as_array_mut())
            && a.len() == b.len()
        {
            for (a, b) in a.iter().zip(b) {
                if a.as_f64().zip(b.as_f64()).is_some_and(|(a, b)| (a - b).abs() <= ROCK_BOX_PX) {
                    b.clone_from(a);
                }
            }
        }
    }
}

/// What a comparison of a stored file found: `Err` is a difference that is not allowed; `None` if the file cannot be decoded, which is in
/// the report already.
type Comparison = Option<Result<(), String>>;

/// The comparison that finds this difference if it is not allowed.
fn compared(is_allowed: bool, difference: impl FnOnce() -> String) -> Comparison {
    Some(if is_allowed { Ok(()) } else { Err(difference()) })
}

/// What differs between a stored file and the same file made again, if it is more than allowed.
pub(super) fn difference(
    file: &ExpectedFile,
    stored: &[u8],
    made: &[u8],
    agreement: Agreement,
) -> Option<String> {
    let compared = match file.extension() {
        Some("png") => compare_images(file, stored, made, agreement),
        Some("npy") => compare_arrays(stored, made, agreement),
        Some("exr") => compare_radiance(stored, made, agreement),
        Some("txt") => compare_rows(stored, made, agreement),
        // Two that can be decoded are compared as records.
        Some("json") => None,
        _ => Some(Err("it differs".to_owned())),
    };
    match compared? {
        Ok(()) if agreement == Agreement::Bytes => {
            Some("its bytes differ, though its values are the same".to_owned())
        }
        compared => compared.err(),
    }
}

/// Compares two label files of rocks, of either task of YOLO.
fn compare_rows(stored: &[u8], made: &[u8], agreement: Agreement) -> Comparison {
    let (found, expected) = row_boxes(stored).zip(row_boxes(made))?;
    if agreement != Agreement::Near {
        return Some(Err("its rows differ".to_owned()));
    }
    // Rocks of a few pixels may be missing, be added, or have another box.
    let is_near = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= ROW_BOX);
    let others = |rows: &[[f64; 4]], of: &[[f64; 4]]| {
        rows.iter().filter(|row| !of.iter().any(|other| is_near(row, other))).count()
    };
    let wrong = others(&found, &expected) + others(&expected, &found);
    let allowed = 2 + (ROCK_FRACTION * (found.len() + expected.len()) as f64) as usize;
    compared(wrong <= allowed, || format!("{wrong} of its rows have no counterpart; at most {allowed} may"))
}

fn compare_images(file: &ExpectedFile, stored: &[u8], made: &[u8], agreement: Agreement) -> Comparison {
    let decode = |bytes: &[u8]| decode_png(bytes).ok();
    let (stored, made) = decode(stored).zip(decode(made))?;
    if (stored.width(), stored.height(), stored.color()) != (made.width(), made.height(), made.color()) {
        return Some(Err("it has another size or type".to_owned()));
    }
    let stem = file.kind.map_or("labels", |kind| kind.stem);
    if matches!(stem, "rgb" | "shadow") {
        let (a, b) = (stored.as_bytes(), made.as_bytes());
        let mean = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
        let allowed = if agreement == Agreement::Bytes { 0.0 } else { MEAN_U8 };
        return compared(mean <= allowed, || {
            format!("its values differ by {mean:.3} on average; allowed is {allowed}")
        });
    }
    let pixel = usize::from(stored.color().bytes_per_pixel());
    let pixels = stored.as_bytes().chunks_exact(pixel).zip(made.as_bytes().chunks_exact(pixel));
    let (count, differing) = (pixels.len(), pixels.filter(|(a, b)| a != b).count());
    let fraction = match stem {
        "semantic_segmentation" | "preview" | "craters" => LABEL_FRACTION,
        _ => INSTANCE_FRACTION,
    };
    let allowed = if agreement == Agreement::Near { fraction * count as f64 } else { 0.0 };
    compared(differing as f64 <= allowed, || {
        format!("{differing} pixels come out as another class; allowed are {allowed:.0}")
    })
}

fn compare_arrays(stored: &[u8], made: &[u8], agreement: Agreement) -> Comparison {
    let values = |npy: &[u8]| {
        let (shape, start) = array_header(npy)?;
        let floats =
            npy[start..].chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        Some((shape, floats.collect::<Vec<_>>()))
    };
    let ((shape, a), (expected_shape, b)) = values(stored).zip(values(made))?;
    if shape != expected_shape || a.len() != b.len() {
        return Some(Err("it has another shape".to_owned()));
    }
    let is_equal = |(a, b): (&f64, &f64)| {
        let is_near = agreement != Agreement::Bytes && (a - b).abs() <= EQUAL + EQUAL * b.abs();
        a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()) || is_near
    };
    let differing = a.iter().zip(&b).filter(|pair| !is_equal(*pair)).count();
    let allowed = if agreement == Agreement::Bytes { 0.0 } else { ARRAY_FRACTION * a.len() as f64 };
    compared(differing as f64 <= allowed, || {
        format!("{differing} of {} values differ; allowed are {allowed:.0}", a.len())
    })
}

fn compare_radiance(stored: &[u8], made: &[u8], agreement: Agreement) -> Comparison {
    // A file of another size is already in the report.
    let size = size_of_exr(made)?;
    let (a, b) = decode_exr(stored, size).zip(decode_exr(made, size))?;
    let sum = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>();
    let difference = sum(&mut a.iter().zip(&b).map(|(a, b)| f64::from((a - b).abs())));
    let fraction = difference / sum(&mut b.iter().map(|value| f64::from(value.abs()))).max(f64::MIN_POSITIVE);
    let allowed = if agreement == Agreement::Bytes { 0.0 } else { RADIANCE_FRACTION };
    compared(fraction <= allowed, || {
        format!("its values differ by {fraction:.5} of their mean; allowed is {allowed}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::FileKind;

    fn file(path: &str) -> ExpectedFile {
        ExpectedFile { path: path.to_owned(), kind: None, template: Vec::new(), is_constant: false }
    }

    fn png(class: u8) -> Vec<u8> {
        let mut labels = image::GrayImage::new(64, 64);
        labels.put_pixel(3, 5, image::Luma([class]));
        let mut bytes = std::io::Cursor::new(Vec::new());
        labels.write_to(&mut bytes, image::ImageFormat::Png).expect("encoded");
        bytes.into_inner()
    }

    #[test]
    fn one_label_may_differ_only_where_not_every_label_must_agree() {
        let found = |agreement| difference(&file("labels.png"), &png(0), &png(1), agreement);
        assert_eq!(found(Agreement::Near), None);
        for agreement in [Agreement::Labels, Agreement::Bytes] {
            assert!(found(agreement).is_some_and(|text| text.starts_with("1 pixels")), "{agreement:?}");
        }
    }

    /// In an archive the copy of a mapping has the extension that rows of rocks have elsewhere.
    #[test]
    fn what_a_file_is_follows_from_its_output() {
        let kind = FileKind { output: "instances", stem: "instance_segmentation_mapping", extension: "json" };
        let mapping = ExpectedFile { kind: Some(kind), ..file("000000007.mapping.txt") };
        assert_eq!([mapping.extension(), file("labels/000007.txt").extension()], [Some("json"), Some("txt")]);
        // Both are label files without rows, and neither is JSON.
        let found = |file: &ExpectedFile| difference(file, b"\n", b"\n\n", Agreement::Bytes);
        assert_eq!((found(&mapping), found(&file("rows.txt"))), (None, Some("its rows differ".to_owned())));
    }

    /// The check of the file's form has reported it: its values are not the same, they are unknown.
    #[test]
    fn nothing_is_said_of_a_file_that_cannot_be_decoded() {
        let png = png(1);
        for (path, made) in [
            ("labels.png", &png[..]),
            ("depth.npy", b"\x93NUMPY"),
            ("radiance.exr", b"\x76\x2f\x31\x01"),
            ("rocks.txt", b"0 0.5 0.5 0.1 0.1\n"),
            ("mapping.json", b"{}"),
        ] {
            for agreement in [Agreement::Bytes, Agreement::Labels, Agreement::Near] {
                assert_eq!(difference(&file(path), b"damaged", made, agreement), None, "{path}");
            }
        }
        // The same values in another form: with bytes behind the end of the image, which decoders skip.
        let longer = [&png[..], b"more"].concat();
        let found = difference(&file("labels.png"), &longer, &png, Agreement::Bytes);
        assert!(found.is_some_and(|text| text.starts_with("its bytes differ")));
        assert_eq!(difference(&file("labels.png"), &longer, &png, Agreement::Labels), None);
    }
}
