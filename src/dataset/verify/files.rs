//! The files of a dataset against their hashes and the lines that list them.
//!
//! Must not know: rendering.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use super::context::Context;
use super::images;
use super::report::{Report, name};
use crate::error::Result;
use crate::output::disk;
use crate::output::layout::FrameLine;

/// First bytes of an OpenEXR file.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Checks all files of a frame.
pub(super) fn check_frame_files(context: &Context<'_>, line: &FrameLine, report: &mut Report) {
    let index = Some(line.index);
    if line.bundle().is_some_and(|bundle| context.folder.join(bundle).is_file()) {
        // The frame's bytes are checked with the hash of its bundle.
        report.look(name::FILES);
        return;
    }
    for (path, hash) in line.hashes() {
        let Some(bytes) = read_checked(context, path, Some(hash), index, report) else { continue };
        match Path::new(path).extension().and_then(|extension| extension.to_str()) {
            Some("png") => images::check_image(context, line, path, &bytes, report),
            Some("json") if is_labels_file(path) => check_labels(context, path, &bytes, index, report),
            Some("json") => {
                let is_json = serde_json::from_slice::<Value>(&bytes).is_ok();
                report.expect(name::IMAGES, index, is_json, || format!("{path}: it is not JSON"));
            }
            Some("npy") => {
                let [width, height] = context.settings.size;
                let has_shape = String::from_utf8_lossy(&bytes[..bytes.len().min(128)])
                    .contains(&format!("({height}, {width}"));
                report.expect(name::IMAGES, index, has_shape, || {
                    format!("{path}: it is not an array of {height} x {width}")
                });
            }
            Some("exr") => {
                let is_exr = bytes.starts_with(&EXR_MAGIC);
                report.expect(name::IMAGES, index, is_exr, || format!("{path}: it is not an OpenEXR file"));
            }
            _ => {}
        }
    }
}

/// Reads a file and compares it with its hash; `None` if it cannot be read.
pub(super) fn read_checked(
    context: &Context<'_>,
    path: &str,
    hash: Option<&str>,
    index: Option<u64>,
    report: &mut Report,
) -> Option<Vec<u8>> {
    report.look(name::FILES);
    match disk::read(&context.folder.join(path)) {
        Ok(bytes) => {
            let actual = disk::content_hash(&bytes);
            report.expect(name::HASHES, index, hash == Some(actual.as_str()), || {
                format!("{path}: its content has changed ({} bytes, hash {actual})", bytes.len())
            });
            Some(bytes)
        }
        Err(error) => {
            report.problem(name::FILES, index, format!("{path}: {error}"));
            None
        }
    }
}

fn is_labels_file(path: &str) -> bool {
    path.contains("semantic_segmentation_labels")
}

/// Checks a file that names the ids of the masks; other files pass.
pub(super) fn check_labels(
    context: &Context<'_>,
    path: &str,
    bytes: &[u8],
    index: Option<u64>,
    report: &mut Report,
) {
    let expected = if path == "id2label.json" {
        context.label_ids.id2label()
    } else if is_labels_file(path) {
        context.label_ids.labels()
    } else {
        return;
    };
    let labels = serde_json::from_slice::<Value>(bytes).ok();
    report.expect(name::LABELS, index, labels == Some(expected), || {
        format!("{path}: it does not name the ids of {} masks", context.label_ids.name())
    });
}

/// Reports files in the folders of frames that no frame and no index lists.
pub(super) fn check_foreign_files(
    folder: &Path,
    known: &BTreeSet<String>,
    report: &mut Report,
) -> Result<()> {
    let folders: BTreeSet<&str> = known.iter().filter_map(|path| Some(path.rsplit_once('/')?.0)).collect();
    for inner in folders {
        let path = folder.join(inner);
        if !path.is_dir() {
            continue;
        }
        for name in disk::names(&path)? {
            let file = format!("{inner}/{name}");
            if !path.join(&name).is_dir() && !known.contains(&file) {
                report.problem(name::FILES, None, format!("{file}: it belongs to no frame of the dataset"));
            }
        }
    }
    Ok(())
}
