//! The files of a frame against their hashes and the form that they must have.
//!
//! Must not know: rendering.

use serde_json::Value;

use super::context::Context;
use super::differences::differences;
use super::images;
use super::report::{Report, Subject, name};
use super::store::{Archives, StoredFile, files_in, read_hashed};
use super::templates::{ExpectedFile, ExpectedFrame};
use crate::dataset::plan::Plan;
use crate::error::Error;
use crate::output::disk;
use crate::output::layout::FrameLine;
use crate::output::layout::yolo::row_boxes;

/// Checks all files of a frame.
pub(super) fn check_frame_files(
    context: &Context<'_>,
    archives: &Archives,
    line: &FrameLine,
    frame: &ExpectedFrame,
    report: &mut Report,
) {
    let subject = Subject::File(line.index);
    for path in &frame.paths {
        report.look(name::FILES);
        let stored = match read_hashed(context, archives, frame, line.index, path) {
            Ok(stored) => stored,
            Err(error) => {
                report.problem(name::FILES, subject, named(path, &error));
                continue;
            }
        };
        let recorded = line.hashes.get(path).and_then(Value::as_str).unwrap_or("nothing");
        let actual = disk::content_hash(&stored.bytes);
        report.expect(name::HASHES, subject, recorded == actual, || {
            let length = stored.bytes.len();
            format!(
                "{}: its content has changed ({length} bytes, hash {actual}; recorded is {recorded})",
                stored.path
            )
        });
        match files_in(frame, stored) {
            Ok(files) => check_files(context, line, frame, path, files, report),
            Err(error) => report.problem(name::IMAGES, subject, error.to_string()),
        }
    }
}

/// A message that begins with the path.
fn named(path: &str, error: &Error) -> String {
    format!("{path}: {error}")
}

/// Checks the files under a key of a frame's hashes.
fn check_files(
    context: &Context<'_>,
    line: &FrameLine,
    frame: &ExpectedFrame,
    key: &str,
    files: Vec<(String, StoredFile)>,
    report: &mut Report,
) {
    let subject = Subject::File(line.index);
    if let Some(bundle) = &frame.bundle {
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        let expected: Vec<&str> = frame.files.iter().map(|file| file.path.as_str()).collect();
        report.expect(name::FILES, subject, names == expected, || {
            format!("{bundle}: the members of the frame are {names:?}, expected are {expected:?}")
        });
    }
    for (name, stored) in files {
        let expected = frame.files.iter().find(|file| file.path == name);
        if let Some(expected) = expected.filter(|_| frame.bundle.is_some() || name == key) {
            check_content(context, line, expected, &stored, report);
        }
    }
}

/// Checks the form of a file, and its content as far as it is known without rendering.
fn check_content(
    context: &Context<'_>,
    line: &FrameLine,
    expected: &ExpectedFile,
    stored: &StoredFile,
    report: &mut Report,
) {
    let (subject, path) = (Subject::File(line.index), &stored.path);
    match expected.extension() {
        Some("png") => images::check_image(context, line, expected, stored, report),
        Some("json") => check_json(context, line, expected, stored, report),
        Some("npy") => {
            let problem = array_problem(&stored.bytes, &expected.template, context.plan.settings.size);
            report.expect(name::IMAGES, subject, problem.is_none(), || {
                format!("{path}: {}", problem.unwrap_or_default())
            });
        }
        Some("exr") => {
            let size = context.plan.settings.size;
            let is_decoded = images::decode_exr(&stored.bytes, size).is_some();
            report.expect(name::IMAGES, subject, is_decoded, || {
                let found = images::size_of_exr(&stored.bytes);
                let found = found.map_or("none that can be read".to_owned(), |found| format!("{found:?}"));
                format!("{path}: expected is an OpenEXR file of {size:?} pixels, it is {found}")
            });
        }
        Some("txt") => {
            let is_good = row_boxes(&stored.bytes).is_some();
            report.expect(name::IMAGES, subject, is_good, || {
                format!("{path}: it is not a label file of rows `0 x y ...` with numbers from 0 to 1")
            });
        }
        _ => {}
    }
}

/// Shape of the values of an `.npy` file of float32, and where they begin.
pub(super) fn array_header(npy: &[u8]) -> Option<(Vec<usize>, usize)> {
    let length = usize::from(u16::from_le_bytes([*npy.get(8)?, *npy.get(9)?]));
    let header = std::str::from_utf8(npy.get(10..10 + length)?).ok()?;
    let is_float32 = npy.starts_with(b"\x93NUMPY\x01\x00") && header.contains("'descr': '<f4'");
    let shape = header.split_once("'shape': (")?.1.split_once(')')?.0;
    let shape = shape.split(',').map(|side| side.trim().parse().ok()).collect::<Option<Vec<_>>>()?;
    is_float32.then_some((shape, 10 + length))
}

fn array_problem(npy: &[u8], template: &[u8], [width, height]: [u32; 2]) -> Option<String> {
    let (mut expected, _) = array_header(template)?;
    expected[..2].copy_from_slice(&[height as usize, width as usize]);
    let Some((shape, start)) = array_header(npy) else {
        return Some("it is not an array of float32".to_owned());
    };
    if shape != expected {
        return Some(format!("it is an array of shape {shape:?}, expected is {expected:?}"));
    }
    let (values, needed) = (npy.len() - start, 4 * expected.iter().product::<usize>());
    (values != needed).then(|| format!("it has {values} bytes of values, expected are {needed}"))
}

fn check_json(
    context: &Context<'_>,
    line: &FrameLine,
    expected: &ExpectedFile,
    stored: &StoredFile,
    report: &mut Report,
) {
    let (subject, path) = (Subject::File(line.index), &stored.path);
    let Ok(found) = serde_json::from_slice::<Value>(&stored.bytes) else {
        report.look(name::IMAGES);
        return report.problem(name::IMAGES, subject, format!("{path}: it is not JSON"));
    };
    report.look(name::IMAGES);
    let is_meta = expected.kind.is_some_and(|kind| kind.output == "meta");
    let (check, wanted) = if is_meta {
        (name::RECORDS, expected_meta(&context.plan, context.manifest.get("version"), line, &found))
    } else if expected.is_constant {
        let wanted = serde_json::from_slice(&expected.template).unwrap_or_default();
        (if expected.kind.is_some() { name::LABELS } else { name::RECORDS }, wanted)
    } else {
        return;
    };
    report.look(check);
    for difference in differences(&found, &wanted) {
        report.problem(check, subject, format!("{path}: {}", difference.text));
    }
}

/// The content of a frame's metadata file, by its line and the manifest. Backend and driver are stored nowhere else.
fn expected_meta(plan: &Plan, version: Option<&Value>, line: &FrameLine, found: &Value) -> Value {
    let mut meta = serde_json::to_value(line).unwrap_or_default();
    if let Value::Object(meta) = &mut meta {
        meta.retain(|key, _| !matches!(key.as_str(), "hashes" | "entry" | "ms"));
        let text = |key: &str| Value::from(found["adapter"][key].as_str().unwrap_or_default());
        let adapter =
            [("name", line.adapter.clone().into()), ("backend", text("backend")), ("driver", text("driver"))];
        let adapter = adapter.map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
        meta.insert("adapter".to_owned(), Value::Object(adapter));
        for (key, value) in plan.identity() {
            if matches!(key.as_str(), "size" | "samples" | "edges" | "label_ids") {
                meta.insert(key, value);
            }
        }
        meta.insert("version".to_owned(), version.cloned().unwrap_or_default());
    }
    meta
}
