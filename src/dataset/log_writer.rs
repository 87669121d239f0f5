//! The log and the manifest of one run, written as frames are finished.
//!
//! A line promises that its frame survives a power cut. So lines wait until the frames' files and their names are on the
//! disk: names are synchronised for all frames that were finished within a fraction of a second, and then their lines are
//! appended. A killed process loses the lines that wait; their frames are made again.
//!
//! Must not know: how frames are made.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Map, Value};

use super::gate::Gate;
use super::lock::{RunLock, merged_range};
use super::log::{LOG, MANIFEST, find_lines, shard_file_name};
use super::manifest::{self, DatasetSpec};
use super::plan::{Range, Shard};
use crate::error::{Error, Result};
use crate::output::Artifact;
use crate::output::disk::{self, FileWriter, LineFile};
use crate::output::layout::{FrameFiles, FrameLine};

/// The log of a run; holds its locks.
#[derive(Debug)]
pub struct FrameLogWriter {
    identity: Map<String, Value>,
    options: String,
    range: Range,
    shard: Shard,
    files: FileWriter,
    lines: LineFile,
    /// Lines of frames whose files are written, but whose names may not be on the disk yet.
    waiting: Vec<(u64, String)>,
    finished: BTreeSet<u64>,
    lock: RunLock,
}

impl FrameLogWriter {
    /// Opens the log of a run in a folder, which is created if missing. The run continues with the frames found there.
    ///
    /// # Errors
    /// Those of [`check_folder`](super::lock::check_folder), [`Error::Busy`], [`Error::Write`].
    pub fn open(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<Self> {
        // Before the folder is created and locked, so that nothing is left in one that is refused.
        merged_range(folder, spec, force)?;
        let shard = spec.shard;
        let mut files = FileWriter::new(folder, &shard.tag());
        files.create_folder()?;
        let lock = RunLock::acquire(folder, shard)?;
        let range = merged_range(folder, spec, force)?;
        let found = find_lines(folder, &Gate::of_spec(spec)?)?;
        lock.remove_leftovers(&found.folders)?;
        let mut log = Self {
            lines: LineFile::open(&folder.join(shard_file_name(LOG, shard)))?,
            files,
            identity: spec.identity.clone(),
            options: spec.options.clone(),
            range,
            shard,
            waiting: Vec::new(),
            finished: found.positions.into_keys().collect(),
            lock,
        };
        log.write_manifest("running")?;
        Ok(log)
    }

    /// The dataset's folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.files.folder()
    }

    /// The frames that are finished, of all shards, as far as their lines are written.
    #[must_use]
    pub const fn finished(&self) -> &BTreeSet<u64> {
        &self.finished
    }

    /// Writes the files of a frame.
    ///
    /// # Errors
    /// [`Error::Write`], [`Error::LogLost`].
    pub fn write_files(&mut self, files: &FrameFiles) -> Result<()> {
        self.write_artifacts(&files.artifacts)
    }

    /// Writes the files of one or several frames, which are open at the same time.
    ///
    /// # Errors
    /// Those of [`write_files`](Self::write_files).
    pub(super) fn write_artifacts<'a>(
        &mut self,
        artifacts: impl IntoIterator<Item = &'a Artifact>,
    ) -> Result<()> {
        let written = self.files.write_all(artifacts);
        written.map(drop).map_err(|error| self.lost_or(error))
    }

    /// Adds the line of a frame whose files are written. It is appended with those of other frames, after a fraction of a
    /// second or with [`flush`](Self::flush).
    ///
    /// # Errors
    /// [`Error::Encode`]; those of [`flush`](Self::flush).
    pub fn append(&mut self, line: &FrameLine) -> Result<()> {
        let text = serde_json::to_string(line).map_err(|error| Error::Encode {
            name: "a line of frames.jsonl".to_owned(),
            message: error.to_string(),
        })?;
        self.waiting.push((line.index, text));
        if self.files.is_sync_due() { self.flush() } else { Ok(()) }
    }

    /// Appends the lines that wait, after the names of their frames' files are on the disk.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::LogLost`] if the log was removed or replaced, or its folder renamed.
    pub fn flush(&mut self) -> Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        if !self.lines.is_in_place() {
            return Err(self.lost());
        }
        self.files.sync_folders().map_err(|error| self.lost_or(error))?;
        for (index, text) in self.waiting.drain(..) {
            self.lines.append(&text)?;
            self.finished.insert(index);
        }
        Ok(())
    }

    /// Appends the lines that wait, and writes the run's manifest.
    ///
    /// # Errors
    /// Those of [`flush`](Self::flush).
    pub fn write_manifest(&mut self, status: &str) -> Result<()> {
        self.flush()?;
        self.lines.sync()?;
        let range = self.range;
        let own = self.finished.range(range.start..range.end());
        let own = own.filter(|index| self.shard.contains(**index)).count();
        let mut manifest = Map::new();
        manifest.insert("status".to_owned(), status.into());
        manifest.insert("start".to_owned(), range.start.into());
        manifest.insert("count".to_owned(), range.count.into());
        manifest.insert("n_completed".to_owned(), own.into());
        manifest.extend(manifest::command(&self.options, &self.identity, range));
        manifest.extend(self.identity.clone());
        let file = manifest::to_file(shard_file_name(MANIFEST, self.shard), manifest)?;
        let written = self.files.write_all(&[file]).and_then(|_| self.files.sync_folders());
        written.map_err(|error| self.lost_or(error))
    }

    /// Closes the log; the locks stay, for the merge.
    pub(super) fn close(self) -> RunLock {
        self.lock
    }

    /// The error, or its cause if that is a folder that was removed or renamed.
    fn lost_or(&self, error: Error) -> Error {
        if self.folder().is_dir() { error } else { self.lost() }
    }

    fn lost(&self) -> Error {
        Error::LogLost(self.lines.path().to_owned())
    }
}

/// Adds to a frame's line the hashes of its files, and what its layout keeps for the index.
pub(super) fn record_files(line: &mut FrameLine, files: &FrameFiles) {
    let hash = |file: &Artifact| (file.name.clone(), disk::content_hash(&file.bytes).into());
    line.hashes = files.artifacts.iter().map(hash).collect();
    line.entry = files.entry.clone();
}
