//! The stored bytes of frames, as files of their own or as parts of archives.
//!
//! Must not know: what the bytes mean.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::ops::Range;
use std::path::Path;

use twox_hash::XxHash3_128;

use super::templates::ExpectedFrame;
use crate::error::{Error, Result};
use crate::output::disk;
use crate::output::layout::webdataset::{archive_end, members, sample_key, samples};

/// Bytes that are hashed at a time.
const BLOCK: usize = 1 << 20;

/// Where the frames are in archives, by name of the archive; empty for layouts that do not bundle files.
#[derive(Debug, Default)]
pub(super) struct Archives(BTreeMap<String, BTreeMap<String, Range<u64>>>);

impl Archives {
    /// Those of these names. Archives that cannot be read have no frames.
    pub(super) fn open<'a>(folder: &Path, names: impl Iterator<Item = &'a str>) -> Self {
        let mut archives = BTreeMap::new();
        for name in names {
            archives
                .entry(name.to_owned())
                .or_insert_with(|| read_samples(&folder.join(name)).unwrap_or_default());
        }
        Self(archives)
    }
}

fn read_samples(path: &Path) -> Result<BTreeMap<String, Range<u64>>> {
    let read = |cause| Error::Read { path: path.to_owned(), cause };
    samples(open(path).map_err(read)?).map_err(read)
}

/// Opens a file, and nothing that is not one: a pipe would never end.
fn open(path: &Path) -> std::io::Result<File> {
    if path.metadata()?.is_file() { File::open(path) } else { Err(std::io::ErrorKind::InvalidInput.into()) }
}

/// A stored file, or a member of an archive.
pub(super) struct StoredFile {
    /// Its path in messages.
    pub(super) path: String,
    pub(super) bytes: Vec<u8>,
}

/// The bytes under the key `path` of a frame's hashes: a file, or the frame's part of its archive.
pub(super) fn read_hashed(
    folder: &Path,
    archives: &Archives,
    frame: &ExpectedFrame,
    index: u64,
    path: &str,
) -> Result<StoredFile> {
    let Some(bundle) = &frame.bundle else {
        return Ok(StoredFile { path: path.to_owned(), bytes: disk::read(&folder.join(path))? });
    };
    let key = sample_key(index);
    let file = folder.join(bundle);
    let range = archives.0.get(bundle).and_then(|samples| samples.get(&key));
    // Before a dataset is complete its frames are not in archives.
    let fragment = folder.join(path);
    let Some(range) = range else {
        let bytes = disk::read(&fragment).map_err(|_| {
            Error::CheckFailed(format!("{}: it cannot be read, or has no sample {key}", file.display()))
        })?;
        return Ok(StoredFile { path: path.to_owned(), bytes });
    };
    let bytes = read_range(&file, range).map_err(|cause| Error::Read { path: file, cause })?;
    Ok(StoredFile { path: format!("{bundle}/{key}"), bytes })
}

fn read_range(path: &Path, range: &Range<u64>) -> std::io::Result<Vec<u8>> {
    let mut file = open(path)?;
    file.seek(SeekFrom::Start(range.start))?;
    let mut bytes = Vec::new();
    file.take(range.end - range.start).read_to_end(&mut bytes)?;
    Ok(bytes)
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
    let path = folder.join(name);
    let samples = match read_samples(&path) {
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
    let length = path.metadata().map(|file| file.len()).unwrap_or_default();
    let expected = end.saturating_add(end_of_archive.len() as u64);
    let tail = read_range(&path, &(end..expected)).unwrap_or_default();
    (length != expected || tail != end_of_archive)
        .then(|| format!("{name}: it has {length} bytes, expected are {expected}, the last of them zero"))
}

/// Content hash of a file of any size, as [`disk::content_hash`] gives it.
///
/// # Errors
/// [`Error::Read`].
pub(super) fn hash_of_file(path: &Path) -> Result<String> {
    let hash = || {
        let (mut file, mut hasher) = (open(path)?, XxHash3_128::new());
        let mut block = vec![0; BLOCK];
        loop {
            match file.read(&mut block)? {
                0 => return Ok(format!("{:032x}", hasher.finish_128())),
                length => hasher.write(&block[..length]),
            }
        }
    };
    hash().map_err(|cause| Error::Read { path: path.to_owned(), cause })
}
