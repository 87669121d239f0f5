//! The stored bytes of frames, as files of their own or as parts of archives.
//!
//! Must not know: what the bytes mean.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::ops::Range;
use std::path::Path;

use super::context::Context;
use super::templates::ExpectedFrame;
use crate::error::{Error, Result};
use crate::input;
use crate::output::dataset_path;
use crate::output::layout::webdataset::{archive_end, members, sample_key, samples};

/// Where the frames are in archives, by name of the archive; empty for layouts that do not bundle files.
#[derive(Debug, Default)]
pub(super) struct Archives(BTreeMap<String, BTreeMap<String, Range<u64>>>);

impl Archives {
    /// Those of these names. Archives that cannot be read have no frames.
    pub(super) fn open<'a>(folder: &Path, names: impl Iterator<Item = &'a str>) -> Self {
        let mut archives = BTreeMap::new();
        for name in names {
            archives.entry(name.to_owned()).or_insert_with(|| read_samples(folder, name).unwrap_or_default());
        }
        Self(archives)
    }
}

fn read_samples(folder: &Path, name: &str) -> Result<BTreeMap<String, Range<u64>>> {
    samples(open(folder, name)?).map_err(|cause| Error::Read { path: folder.join(name), cause })
}

fn open(folder: &Path, name: &str) -> Result<File> {
    input::open(&dataset_path::for_reading(folder, name)?)
}

/// A stored file, or a member of an archive.
pub(super) struct StoredFile {
    /// Its path in messages.
    pub(super) path: String,
    pub(super) bytes: Vec<u8>,
}

/// The bytes under the key `path` of a frame's hashes: a file, or the frame's part of its archive.
pub(super) fn read_hashed(
    context: &Context<'_>,
    archives: &Archives,
    frame: &ExpectedFrame,
    index: u64,
    path: &str,
) -> Result<StoredFile> {
    let (folder, max_bytes) =
        (context.folder, dataset_path::max_frame_file_bytes(context.plan.settings.size));
    let Some(bundle) = &frame.bundle else {
        let bytes = dataset_path::read(folder, path, max_bytes)?;
        return Ok(StoredFile { path: path.to_owned(), bytes });
    };
    let key = sample_key(index);
    let range = archives.0.get(bundle).and_then(|samples| samples.get(&key));
    // Before a dataset is complete its frames are not in archives.
    let Some(range) = range else {
        let max_bytes = max_bytes.saturating_mul(frame.files.len() as u64);
        let bytes = dataset_path::read(folder, path, max_bytes).map_err(|_| {
            Error::CheckFailed(format!("{bundle}: it cannot be read, or has no sample {key}"))
        })?;
        return Ok(StoredFile { path: path.to_owned(), bytes });
    };
    let bytes = read_range(folder, bundle, range)?;
    Ok(StoredFile { path: format!("{bundle}/{key}"), bytes })
}

fn read_range(folder: &Path, name: &str, range: &Range<u64>) -> Result<Vec<u8>> {
    let mut file = open(folder, name)?;
    let mut bytes = Vec::new();
    let read = file
        .seek(SeekFrom::Start(range.start))
        .and_then(|_| file.take(range.end - range.start).read_to_end(&mut bytes));
    read.map(|_| bytes).map_err(|cause| Error::Read { path: folder.join(name), cause })
}

/// The files in the bytes under a key of a frame's hashes, with their names as in [`ExpectedFrame::files`].
pub(super) fn files_in(frame: &ExpectedFrame, stored: StoredFile) -> Result<Vec<(String, StoredFile)>> {
    let Some(bundle) = &frame.bundle else { return Ok(vec![(stored.path.clone(), stored)]) };
    let members = members(&stored.bytes).map_err(|error| {
        Error::CheckFailed(format!("{}: it is not a part of a tar archive ({error})", stored.path))
    })?;
    let named = |(name, bytes): (String, Vec<u8>)| {
        let path = format!("{bundle}/{name}");
        (name, StoredFile { path, bytes })
    };
    Ok(members.into_iter().map(named).collect())
}

/// What is wrong with an archive that should hold the frames of these indices, one after the other, and nothing else.
pub(super) fn archive_problem(folder: &Path, name: &str, frames: Range<u64>) -> Option<String> {
    let samples = match read_samples(folder, name) {
        Ok(samples) => samples,
        Err(error) => return Some(format!("{name}: {error}")),
    };
    let mut end = 0;
    for index in frames.clone() {
        let key = sample_key(index);
        match samples.get(&key) {
            None => return Some(format!("{name}: it has no sample {key}")),
            Some(range) if range.start != end => {
                return Some(format!(
                    "{name}: sample {key} begins at byte {}, expected is {end}",
                    range.start
                ));
            }
            Some(range) => end = range.end,
        }
    }
    let (count, expected) = (samples.len() as u64, frames.end - frames.start);
    if count != expected {
        return Some(format!("{name}: it has {count} samples, expected are {expected}"));
    }
    let end_of_archive = archive_end();
    let length = folder.join(name).metadata().map(|file| file.len()).unwrap_or_default();
    let expected = end.saturating_add(end_of_archive.len() as u64);
    let tail = read_range(folder, name, &(end..expected)).unwrap_or_default();
    (length != expected || tail != end_of_archive)
        .then(|| format!("{name}: it has {length} bytes, expected are {expected}, the last of them zero"))
}
