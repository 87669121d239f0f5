//! The log and the manifest of one run, written as frames are finished.
//!
//! Must not know: how frames are made.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::lock::{acquire_run_lock, merged_range};
use super::log::{LOG, MANIFEST, finished_frames, shard_file_name};
use super::manifest::{self, DatasetSpec};
use super::plan::{Range, Shard};
use crate::error::{Error, Result};
use crate::output::Artifact;
use crate::output::disk::{self, LineFile, Lock};
use crate::output::layout::{FrameFiles, FrameLine};

/// The log of a run; holds the lock of its shard.
#[derive(Debug)]
pub struct FrameLogWriter {
    folder: PathBuf,
    identity: Map<String, Value>,
    range: Range,
    shard: Shard,
    lines: LineFile,
    finished: BTreeSet<u64>,
    _lock: Lock,
}

impl FrameLogWriter {
    /// Opens the log of a run in a folder, which is created if missing. The run continues with the frames found there.
    ///
    /// # Errors
    /// Those of [`check_folder`](super::lock::check_folder), [`Error::Busy`], [`Error::Write`].
    pub fn open(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<Self> {
        let range = merged_range(folder, spec, force)?;
        let shard = spec.shard;
        std::fs::create_dir_all(folder).map_err(|cause| Error::Write { path: folder.to_owned(), cause })?;
        let lock = acquire_run_lock(folder, shard)?;
        disk::remove_temporary(folder, &shard.tag())?;
        let finished = finished_frames(folder)?;
        let log = Self {
            lines: LineFile::open(&folder.join(shard_file_name(LOG, shard)))?,
            folder: folder.to_owned(),
            identity: spec.identity.clone(),
            range,
            shard,
            finished,
            _lock: lock,
        };
        log.write_manifest("running")?;
        Ok(log)
    }

    /// The dataset's folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The frames that are finished, of all shards.
    #[must_use]
    pub const fn finished(&self) -> &BTreeSet<u64> {
        &self.finished
    }

    /// Appends the line of a frame whose files are on the disk.
    ///
    /// # Errors
    /// [`Error::Encode`], [`Error::Write`].
    pub fn append(&mut self, line: &FrameLine) -> Result<()> {
        let text = serde_json::to_string(line).map_err(|error| Error::Encode {
            name: "a line of frames.jsonl".to_owned(),
            message: error.to_string(),
        })?;
        self.lines.append(&text)?;
        self.finished.insert(line.index);
        Ok(())
    }

    /// Writes the run's manifest.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_manifest(&self, status: &str) -> Result<()> {
        self.lines.sync()?;
        let range = self.range;
        let own = self.finished.range(range.start..range.end());
        let own = own.filter(|index| self.shard.contains(**index)).count();
        let mut manifest = Map::new();
        manifest.insert("status".to_owned(), status.into());
        manifest.insert("start".to_owned(), range.start.into());
        manifest.insert("count".to_owned(), range.count.into());
        manifest.insert("n_completed".to_owned(), own.into());
        manifest.extend(self.identity.clone());
        let file = manifest::to_file(shard_file_name(MANIFEST, self.shard), manifest)?;
        disk::write_all_tagged(&self.folder, &self.shard.tag(), &[file]).map(drop)
    }
}

/// Adds to a frame's line the hashes of its files, and what its layout keeps for the index.
pub(super) fn record_files(line: &mut FrameLine, files: &FrameFiles) {
    let hash = |file: &Artifact| (file.name.clone(), disk::content_hash(&file.bytes).into());
    line.hashes = files.artifacts.iter().map(hash).collect();
    line.entry = files.entry.clone();
}
