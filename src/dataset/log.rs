//! The logs of a dataset's folder, read: `frames.jsonl` has a line for each finished frame.
//!
//! A frame's line is written after its files, so a line means complete files. A shard has a log and a manifest of its
//! own (`frames-0-of-4.jsonl`, `manifest-0-of-4.json`), so that shards can share a folder or be copied into one;
//! [`merge`](super::merge) makes one of each out of all.
//! Must not know: how frames are made, who writes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use super::plan::Shard;
use crate::error::{Error, Result};
use crate::output::disk;
use crate::output::layout::{FrameLine, FrameLines};

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
    /// For each frame whose files exist, the position of its last complete line.
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
pub(super) fn find_lines(folder: &Path) -> Result<FoundLines> {
    let logs = shard_files(folder, LOG)?;
    let mut found = FoundLines { logs: logs.clone(), ..FoundLines::default() };
    for (log, path) in logs.iter().enumerate() {
        let unreadable = |cause| Error::Read { path: path.clone(), cause };
        let mut reader = match std::fs::File::open(path) {
            // Another shard has just completed the folder; these lines are in its merged log.
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => continue,
            file => BufReader::new(file.map_err(unreadable)?),
        };
        let (mut offset, mut text) = (0, Vec::new());
        loop {
            text.clear();
            let length = reader.read_until(b'\n', &mut text).map_err(unreadable)?;
            if length == 0 {
                break;
            }
            // A line that is incomplete, damaged or not a frame's does not count.
            let is_whole = text.ends_with(b"\n");
            let line = is_whole.then(|| serde_json::from_slice::<FrameLine>(&text).ok()).flatten();
            if let Some(line) = line {
                found.add_folders(&line);
                if has_files(folder, &line) {
                    found.positions.insert(line.index, LinePosition { log, offset, length });
                }
            }
            offset += length as u64;
        }
    }
    Ok(found)
}

/// Whether a frame's files exist, on their own or in their bundle.
fn has_files(folder: &Path, line: &FrameLine) -> bool {
    // A file of a frame is never empty; an empty one is the result of a crash.
    let exists = |path: &str| folder.join(path).metadata().is_ok_and(|file| file.is_file() && file.len() > 0);
    line.bundle().is_some_and(exists)
        || (line.hashes().next().is_some() && line.hashes().all(|(path, _)| exists(path)))
}

/// The frames that are finished in a folder, which need not exist.
///
/// # Errors
/// [`Error::Read`].
pub fn finished_frames(folder: &Path) -> Result<BTreeSet<u64>> {
    Ok(if folder.exists() { find_lines(folder)?.positions.into_keys().collect() } else { BTreeSet::new() })
}

/// The merged log of a dataset: `frames.jsonl` in ascending order of index.
#[derive(Debug)]
pub struct FrameLog(PathBuf);

impl FrameLog {
    /// The log in a dataset's folder.
    #[must_use]
    pub fn new(folder: &Path) -> Self {
        Self(folder.join("frames.jsonl"))
    }

    /// Calls `visit` with each line, or with the reason why it cannot be read.
    ///
    /// # Errors
    /// [`Error::Read`], and those of `visit`.
    pub fn for_each_result(&self, visit: &mut dyn FnMut(Result<FrameLine>) -> Result<()>) -> Result<()> {
        let unreadable = |cause| Error::Read { path: self.0.clone(), cause };
        let file = std::fs::File::open(&self.0).map_err(unreadable)?;
        for (i, text) in BufReader::new(file).split(b'\n').enumerate() {
            let line = serde_json::from_slice(&text.map_err(unreadable)?);
            visit(line.map_err(|error| {
                Error::CheckFailed(format!("{}: line {} cannot be read: {error}", self.0.display(), i + 1))
            }))?;
        }
        Ok(())
    }
}

impl FrameLines for FrameLog {
    fn for_each(&self, visit: &mut dyn FnMut(FrameLine) -> Result<()>) -> Result<()> {
        self.for_each_result(&mut |line| visit(line?))
    }
}
