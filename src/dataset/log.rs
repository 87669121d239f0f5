//! The logs of a dataset's folder, read: `frames.jsonl` has a line for each finished frame.
//!
//! A frame's line is written after its files, so a line means complete files. A shard has a log and a manifest of its
//! own (`frames-0-of-4.jsonl`, `manifest-0-of-4.json`), so that shards can share a folder or be copied into one;
//! [`merge`](super::merge) makes one of each out of all.
//! Must not know: how frames are made, who writes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::digest::{self, Digest};
use super::gate::{Gate, MAX_LINE_BYTES};
use super::manifest;
use super::plan::Shard;
use crate::error::{Error, Result};
use crate::input::{self, Lines};
use crate::output::layout::webdataset::{sample_key, whole_samples};
use crate::output::layout::{FrameLine, FrameLines};
use crate::output::{dataset_path, disk};

/// Stem and extension of the log's file name.
pub(super) const LOG: (&str, &str) = ("frames", "jsonl");
/// Stem and extension of the manifest's file name.
pub(super) const MANIFEST: (&str, &str) = ("manifest", "json");

/// File name of a shard's log or manifest.
pub(super) fn shard_file_name((stem, extension): (&str, &str), shard: Shard) -> String {
    if shard == Shard::WHOLE {
        format!("{stem}.{extension}")
    } else {
        format!("{stem}-{}-of-{}.{extension}", shard.number, shard.of)
    }
}

/// Whether a file name is that of some shard's log or manifest.
pub(super) fn is_shard_file(name: &str, (stem, extension): (&str, &str)) -> bool {
    let middle = name.strip_prefix(stem).and_then(|rest| rest.strip_suffix(&format!(".{extension}")));
    middle.is_some_and(|middle| {
        middle.is_empty()
            || middle
                .strip_prefix('-')
                .and_then(|numbers| numbers.split_once("-of-"))
                .is_some_and(|(i, n)| i.parse::<u64>().is_ok() && n.parse::<u64>().is_ok())
    })
}

/// The logs or manifests in a folder, sorted by name.
pub(super) fn shard_files(folder: &Path, kind: (&str, &str)) -> Result<Vec<PathBuf>> {
    let mut names = disk::names(folder)?;
    names.retain(|name| is_shard_file(name, kind));
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// Position of a frame's line.
pub(super) struct LinePosition {
    /// Index of the log among the folder's logs.
    pub(super) log: usize,
    /// Offset in the log, bytes.
    pub(super) offset: u64,
    /// Length with its newline, bytes.
    pub(super) length: usize,
}

/// What the logs of a folder contain.
#[derive(Default)]
pub(super) struct FoundLines {
    /// The logs, sorted by name.
    pub(super) logs: Vec<PathBuf>,
    /// For each frame whose files exist, the position of its last complete line. Of lines that differ in their hashes the one counts that
    /// has those of the files.
    pub(super) positions: BTreeMap<u64, LinePosition>,
    /// Paths of the folders, below the dataset's, that frames' files are in; with those above them.
    pub(super) folders: BTreeSet<String>,
}

impl FoundLines {
    fn add_folders(&mut self, line: &FrameLine) {
        for (path, _) in line.hashes() {
            let mut path = path;
            while let Some((folder, _)) = path.rsplit_once('/')
                && !self.folders.contains(folder)
            {
                self.folders.insert(folder.to_owned());
                path = folder;
            }
        }
    }
}

/// Reads the logs of a folder.
///
/// # Errors
/// [`Error::Read`]; [`Error::CheckFailed`] for a line that the gate refuses.
pub(super) fn find_lines(folder: &Path, gate: &Gate) -> Result<FoundLines> {
    let logs = shard_files(folder, LOG)?;
    let mut found = FoundLines { logs: logs.clone(), ..FoundLines::default() };
    let mut bundles = Bundles::new(folder);
    for (log, path) in logs.iter().enumerate() {
        let mut lines = match open_log(path) {
            // Another shard has just completed the folder; these lines are in its merged log.
            Err(Error::Read { cause, .. }) if cause.kind() == std::io::ErrorKind::NotFound => continue,
            lines => lines?,
        };
        let (mut offset, mut text) = (0, Vec::new());
        while let Some(number) = lines.next_into(&mut text)? {
            // A line that is incomplete, damaged or not a frame's does not count.
            let line = text.ends_with(b"\n").then(|| FrameLine::parse(&text).ok()).flatten();
            if let Some(line) = line {
                gate.check(&line).map_err(|message| refused(path, number, &message))?;
                let has_files = has_files(folder, &line)? || bundles.contain(&line)?;
                found.add_folders(&line);
                let earlier = found.positions.get(&line.index);
                let is_last = || earlier.is_none_or(|earlier| !is_outdated(folder, &line, (&logs, earlier)));
                if has_files && gate.lists_all_files(&line) && is_last() {
                    found.positions.insert(line.index, LinePosition { log, offset, length: text.len() });
                }
            }
            offset += text.len() as u64;
        }
    }
    Ok(found)
}

/// Whether a frame's files are those of an earlier line, and not those of this one. No order of the logs says so: a shard makes a frame again
/// that a run of all frames has made, or the other way round.
fn is_outdated(folder: &Path, line: &FrameLine, (logs, earlier): (&[PathBuf], &LinePosition)) -> bool {
    // A log that another shard has just removed is merged; the lines of the merged log count.
    let Ok(earlier) = line_at(&logs[earlier.log], Some(earlier)) else { return false };
    earlier.hashes != line.hashes && !has_hashed_files(folder, line) && has_hashed_files(folder, &earlier)
}

/// Whether a frame's own files have the hashes of its line.
fn has_hashed_files(folder: &Path, line: &FrameLine) -> bool {
    let is_same = |(path, hash): (&str, &str)| {
        dataset_path::hash(folder, path).is_ok_and(|(_, of_file)| of_file == hash)
    };
    line.hashes().all(is_same)
}

/// The line at a position of a log.
pub(super) fn line_at(path: &Path, position: Option<&LinePosition>) -> Result<FrameLine> {
    let failed = |cause| Error::Read { path: path.to_owned(), cause };
    let Some(&LinePosition { offset, length, .. }) = position else {
        return Err(failed(std::io::ErrorKind::NotFound.into()));
    };
    let mut text = vec![0; length];
    let mut file = input::open(path)?;
    file.seek(SeekFrom::Start(offset)).and_then(|_| file.read_exact(&mut text)).map_err(failed)?;
    FrameLine::parse(&text).map_err(|error| failed(std::io::Error::other(error)))
}

/// Opens a log in a dataset's folder.
fn open_log(path: &Path) -> Result<Lines> {
    Lines::open(&dataset_path::own_file(path)?, MAX_LINE_BYTES)
}

/// The error for a line that the gate refuses.
fn refused(log: &Path, number: u64, message: &str) -> Error {
    Error::CheckFailed(format!(
        "{}: line {number}: {message}; if this line is damaged, delete it and run the dataset command again, which makes its frame again",
        log.display()
    ))
}

/// Whether each of a frame's files exists on its own, outside a bundle.
pub(super) fn has_files(folder: &Path, line: &FrameLine) -> Result<bool> {
    for (path, _) in line.hashes() {
        if !is_filled(&dataset_path::for_reading(folder, path)?) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether a file exists. A file of a frame is never empty; an empty one is the result of a crash.
pub(super) fn is_filled(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|file| file.is_file() && file.len() > 0)
}

/// The frames in the bundles of a folder. Each bundle's index is read once, when the first of its frames is asked for.
struct Bundles<'a> {
    folder: &'a Path,
    /// By name of the bundle.
    frames: BTreeMap<String, BTreeSet<u64>>,
}

impl<'a> Bundles<'a> {
    const fn new(folder: &'a Path) -> Self {
        Self { folder, frames: BTreeMap::new() }
    }

    /// Whether a frame is in its bundle.
    fn contain(&mut self, line: &FrameLine) -> Result<bool> {
        let Some(name) = line.bundle() else { return Ok(false) };
        if !self.frames.contains_key(name) {
            self.frames.insert(name.to_owned(), self.read(name)?);
        }
        Ok(self.frames.get(name).is_some_and(|frames| frames.contains(&line.index)))
    }

    /// The frames of a bundle. One that does not exist, was cut short or is no archive has none: they are made again.
    fn read(&self, name: &str) -> Result<BTreeSet<u64>> {
        let path = dataset_path::for_reading(self.folder, name)?;
        if !is_filled(&path) {
            return Ok(BTreeSet::new());
        }
        let samples = whole_samples(input::open(&path)?).unwrap_or_default();
        let index_of = |key: &String| key.parse().ok().filter(|index| sample_key(*index) == *key);
        Ok(samples.keys().filter_map(index_of).collect())
    }
}

/// The frames that are finished in a folder, which need not exist.
///
/// # Errors
/// [`Error::Read`]; [`Error::CheckFailed`] for a line that the gate refuses.
pub fn finished_frames(folder: &Path, gate: &Gate) -> Result<BTreeSet<u64>> {
    Ok(if folder.exists() {
        find_lines(folder, gate)?.positions.into_keys().collect()
    } else {
        BTreeSet::new()
    })
}

/// Checks that the lines of a finished dataset are those that its manifest has the digest of, where it has the line of every frame: a line
/// that is lost, or cannot be read, is made again. Nothing that was changed since may get a digest of its own.
///
/// # Errors
/// [`Error::CheckFailed`].
pub(super) fn check_digest(folder: &Path, manifest: &Map<String, Value>, gate: &Gate) -> Result<()> {
    let text = |key: &str| manifest.get(key).and_then(Value::as_str);
    let (Some("done"), Some(recorded)) = (text("status"), text(digest::KEY)) else { return Ok(()) };
    let mut digest = Digest::new(&manifest::identity_of(manifest.clone()));
    let range = manifest::range_of(manifest);
    let mut next = range.start;
    let log = FrameLog::new(folder, gate.clone());
    let is_whole = log.for_each(&mut |line| {
        next += u64::from(line.index == next);
        digest.add(&line)
    });
    if is_whole.is_err() || next < range.end() || digest.to_hex() == recorded {
        return Ok(());
    }
    Err(Error::CheckFailed(format!(
        "{}: its lines have another digest than manifest.json: one of them was changed or damaged since the dataset was finished. `verify \
         --rerender all` finds wrong ones; delete such a line and run the dataset command again, which makes its frame again. If all lines \
         are right, delete `digest` from manifest.json",
        log.path.display()
    )))
}

/// The merged log of a dataset: `frames.jsonl` in ascending order of index. Every line passes the gate.
#[derive(Debug)]
pub struct FrameLog {
    path: PathBuf,
    gate: Gate,
}

impl FrameLog {
    /// The log in a dataset's folder.
    #[must_use]
    pub fn new(folder: &Path, gate: Gate) -> Self {
        Self { path: folder.join("frames.jsonl"), gate }
    }

    /// Calls `visit` with each line, or with the reason why it cannot be read or is refused.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] without a log, [`Error::Read`], and those of `visit`.
    pub fn for_each_result(&self, visit: &mut dyn FnMut(Result<FrameLine>) -> Result<()>) -> Result<()> {
        let mut lines = open_log(&self.path).map_err(|error| match error {
            Error::Read { cause, .. } if cause.kind() == std::io::ErrorKind::NotFound => Error::CheckFailed(
                format!("{} is missing; run the dataset command again", self.path.display()),
            ),
            other => other,
        })?;
        let mut text = Vec::new();
        while let Some(number) = lines.next_into(&mut text)? {
            visit(self.parse(number, &text))?;
        }
        Ok(())
    }

    /// The number of the first line, from 1, that is not written as this version writes it.
    pub(super) fn first_other_line(&self) -> Option<u64> {
        let mut lines = open_log(&self.path).ok()?;
        let mut text = Vec::new();
        while let Ok(Some(number)) = lines.next_into(&mut text) {
            let written = FrameLine::parse(&text).ok().and_then(|line| serde_json::to_vec(&line).ok());
            if written.is_none_or(|written| [&written[..], b"\n"].concat() != text) {
                return Some(number);
            }
        }
        None
    }

    fn parse(&self, number: u64, text: &[u8]) -> Result<FrameLine> {
        let line = FrameLine::parse(text).map_err(|error| {
            Error::CheckFailed(format!(
                "{}: line {number} cannot be read: {error}; run the dataset command again, which makes its frame again",
                self.path.display()
            ))
        })?;
        self.gate.check(&line).map_err(|message| refused(&self.path, number, &message))?;
        Ok(line)
    }
}

impl FrameLines for FrameLog {
    fn for_each(&self, visit: &mut dyn FnMut(FrameLine) -> Result<()>) -> Result<()> {
        self.for_each_result(&mut |line| visit(line?))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::output::disk::content_hash;

    /// A frame that was made again has two lines, and any of the logs may have the new one.
    #[test]
    fn of_two_lines_the_one_with_the_hashes_of_the_files_counts() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let manifest = json!({
            "format": "folder", "outputs": ["rgb", "mask"], "splits": {}, "start": 0, "count": 1, "size": [8, 8],
        });
        let gate = Gate::of_manifest(manifest.as_object().expect("an object")).expect("a gate");
        let paths = gate.names_of(&FrameLine::default()).files;
        let write_files = |content: &str| {
            for path in &paths {
                let path = folder.join(path);
                std::fs::create_dir_all(path.parent().expect("a folder")).expect("created");
                std::fs::write(path, content).expect("written");
            }
        };
        for (log, content) in [("frames-0-of-2.jsonl", "of a shard"), ("frames.jsonl", "of a whole run")] {
            let hash = |path: &String| (path.clone(), content_hash(content.as_bytes()).into());
            let line = FrameLine { hashes: paths.iter().map(hash).collect(), ..FrameLine::default() };
            std::fs::write(folder.join(log), json!(line).to_string() + "\n").expect("written");
        }
        for (content, log) in [("of a shard", 0), ("of a whole run", 1), ("of neither", 1)] {
            write_files(content);
            let found = find_lines(folder, &gate).expect("read");
            assert_eq!(found.positions[&0].log, log, "the files are {content}");
        }
    }
}
