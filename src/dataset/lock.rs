//! Who may write to a dataset's folder, and when: only runs of the same dataset, and only those that do not disturb each
//! other. Every writer follows these rules: runs with and without `--shard`, `convert`, `dataset --merge`, and the merge at
//! the end of each run.
//!
//! There are three kinds of lock. Each is a file in the folder, whose name [`own_name`](crate::output::disk::own_name) has:
//!
//! | lock | taken by | how |
//! |---|---|---|
//! | `folder` | a run of all frames, or `convert`: its log is `frames.jsonl` | exclusively |
//! | | the run of a shard, whose log is its own | shared with shards of the same N |
//! | | a merge, which replaces `frames.jsonl` and the manifest | exclusively, else shared with shards |
//! | `I-of-N` | the run of shard I/N | exclusively |
//! | `merge` | a merge; and a run, while it takes its locks | exclusively |
//!
//! * Nobody waits for `folder` or `I-of-N`: who cannot have it ends with [`Error::Busy`]. `merge` is waited for; its holder
//!   waits for nothing. So there is no deadlock.
//! * As locks are taken under `merge`, no run starts during a merge.
//! * A merge that has `folder` for itself is alone: it removes the logs of shards, what killed runs left, and the lock
//!   files. Beside running shards it leaves all of these, and the last of them to finish removes them.
//! * The text of the `folder` lock is the N of the shards that share it.
//! * The system releases the locks of a process that ends, however it ends. A lock file that is removed under a process that
//!   waits for it does not count as locked; see [`Lock`].
//! * On a file system without locks every lock is granted, and nothing that another run may have left is removed. There, the
//!   count of frames at the end of a run is what shows that two runs disturbed each other.
//!
//! Must not know: how frames are made.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::gate::{Gate, read_manifest};
use super::log::{LOG, MANIFEST, check_digest, finished_frames, is_shard_file, shard_file_name, shard_files};
use super::manifest::{self, DatasetSpec};
use super::plan::{Range, Shard, differences};
use crate::error::{Error, Result};
use crate::output::disk::own_name::{lock_file_name, lock_name};
use crate::output::disk::{self, Lock};

/// Name of the lock on a folder's logs and manifests.
const FOLDER: &str = "folder";
/// Name of the lock of merges.
const MERGE: &str = "merge";
/// Tag of the temporary files of a merge.
pub(super) const MERGE_TAG: &str = "merge";

/// Checks whether a run may continue in a folder, and returns the frames that are finished there. Writes nothing.
///
/// # Errors
/// [`Error::OtherDataset`], [`Error::OutNotEmpty`], [`Error::OutIsFile`], [`Error::Usage`] for frames that would
/// leave a gap; [`Error::CheckFailed`] if the lines of a finished dataset were changed.
pub fn check_folder(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<BTreeSet<u64>> {
    merged_range(folder, spec, force)?;
    let merged = folder.join(shard_file_name(MANIFEST, Shard::WHOLE));
    if merged.is_file()
        && let Some(manifest) = read_if_there(&merged)?
    {
        check_digest(folder, &manifest, &Gate::of_manifest(&manifest)?)?;
    }
    finished_frames(folder, &Gate::of_spec(spec)?)
}

/// Whether a folder has a manifest of some run.
fn has_manifest(folder: &Path) -> Result<bool> {
    Ok(folder.is_dir() && !shard_files(folder, MANIFEST)?.is_empty())
}

/// Whether the range that the manifests of a folder cover has all frames of this one. Without a manifest it has none.
///
/// # Errors
/// [`Error::Read`]; [`Error::CheckFailed`] for a manifest that the gate refuses.
pub fn is_recorded(folder: &Path, range: Range) -> Result<bool> {
    let mut recorded: Option<Range> = None;
    let manifests = if folder.is_dir() { shard_files(folder, MANIFEST)? } else { Vec::new() };
    for path in manifests {
        if let Some(manifest) = read_if_there(&path)? {
            let other = manifest::range_of(&manifest);
            recorded = Some(recorded.map_or(other, |known| known.hull(other)));
        }
    }
    Ok(recorded.is_some_and(|known| known.hull(range) == known))
}

/// A manifest, unless another shard has just completed the folder and removed it.
fn read_if_there(path: &Path) -> Result<Option<Map<String, Value>>> {
    match read_manifest(path) {
        Err(Error::Read { .. }) if !path.exists() => Ok(None),
        manifest => manifest.map(Some),
    }
}

/// The range of frames that covers the planned ones and those of the dataset in the folder, if that is the same dataset.
pub(super) fn merged_range(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<Range> {
    // Below a file there is no folder either.
    if let Some(file) = folder.ancestors().find(|path| path.is_file()) {
        return Err(Error::OutIsFile(file.to_owned()));
    }
    let mut range = spec.range;
    let manifests = if folder.exists() { shard_files(folder, MANIFEST)? } else { Vec::new() };
    for path in &manifests {
        let Some(manifest) = read_if_there(path)? else { continue };
        let existing = manifest::range_of(&manifest);
        let differences = spec_differences(spec, &manifest, existing);
        if !differences.is_empty() {
            let is_own = path.ends_with(shard_file_name(MANIFEST, spec.shard)) && manifests.len() == 1;
            if is_own && is_without_frames(folder, &manifest)? {
                // An earlier run that finished no frame: nothing is lost by replacing it.
                continue;
            }
            return Err(Error::OtherDataset { path: folder.to_owned(), differences });
        }
        if existing.start > range.end() || existing.end() < range.start {
            return Err(Error::Usage(format!(
                "--start {} --count {}: the folder has frames {} to {}, and the frames in between would be missing; choose \
                 a range that adjoins these, or another --out",
                spec.range.start,
                spec.range.count,
                existing.start,
                existing.end().saturating_sub(1)
            )));
        }
        range = range.hull(existing);
    }
    if manifests.is_empty() {
        // A run that was stopped right at its start, or another shard that is starting, leaves only logs and locks.
        if let Err(foreign) = disk::check_content(folder, force, |name| is_shard_file(name, LOG)) {
            // Another shard may have started since the manifests were listed.
            return if has_manifest(folder)? { merged_range(folder, spec, force) } else { Err(foreign) };
        }
    }
    Ok(range)
}

/// Whether the dataset of a manifest never had a frame: none is counted, and there is no line and no file of one.
fn is_without_frames(folder: &Path, manifest: &Map<String, Value>) -> Result<bool> {
    let is_filled = |log: &PathBuf| log.metadata().is_ok_and(|file| file.len() > 0);
    let counted = manifest.get("n_completed").and_then(Value::as_u64);
    if counted != Some(0) || shard_files(folder, LOG)?.iter().any(is_filled) {
        return Ok(false);
    }
    let gate = Gate::of_manifest(manifest)?;
    for below in gate.frame_folders() {
        let path = folder.join(&below);
        let names = if path.is_dir() { disk::names(&path)? } else { Vec::new() };
        let path_of = |name: String| if below.is_empty() { name } else { format!("{below}/{name}") };
        if names.into_iter().any(|name| gate.is_frame_file(&path_of(name))) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where the dataset of a manifest differs from the planned one, one line each.
fn spec_differences(spec: &DatasetSpec, manifest: &Map<String, Value>, existing: Range) -> Vec<String> {
    let mut differences = differences(manifest, &spec.identity);
    if spec.is_split && existing != spec.range {
        differences.push(format!("  --split: there {} frames, now {}", existing.count, spec.range.count));
    }
    differences
}

fn lock_path(folder: &Path, name: &str) -> PathBuf {
    folder.join(lock_file_name(name))
}

/// The error of a writer that cannot have a lock.
fn busy(folder: &Path, holder: impl Into<String>) -> Error {
    Error::Busy { path: folder.to_owned(), holder: holder.into() }
}

/// The locks of a run.
#[derive(Debug)]
pub(super) struct RunLock {
    folder: PathBuf,
    shard: Shard,
    /// `None` once a merge has taken it over.
    folder_lock: Option<Lock>,
    shard_lock: Option<Lock>,
}

impl RunLock {
    /// Takes the locks of a run in an existing folder.
    ///
    /// # Errors
    /// [`Error::Busy`] if a run is writing there that this one would disturb, [`Error::Write`].
    pub(super) fn acquire(folder: &Path, shard: Shard) -> Result<Self> {
        let taking = Lock::wait(&lock_path(folder, MERGE))?;
        let run = Self::acquire_alone(folder, shard);
        taking.remove();
        run
    }

    /// Takes the locks while no other process takes or releases any.
    fn acquire_alone(folder: &Path, shard: Shard) -> Result<Self> {
        let path = lock_path(folder, FOLDER);
        let mut run = Self {
            folder: folder.to_owned(),
            shard,
            folder_lock: Lock::try_exclusive(&path)?,
            shard_lock: None,
        };
        let shards = shard.of.to_string();
        if let Some(lock) = &mut run.folder_lock {
            // Nobody else has the folder. Only a shard's run lets others in.
            lock.set_text(&shards)?;
            if shard != Shard::WHOLE {
                run.folder_lock = None;
            }
        } else if shard == Shard::WHOLE {
            return Err(busy(folder, "its frames.jsonl is being written"));
        }
        if shard != Shard::WHOLE {
            let mut lock = Lock::try_shared(&path)?
                .ok_or_else(|| busy(folder, "a run of all frames, without --shard"))?;
            let text = lock.text()?;
            if lock.is_held() && text != shards {
                return Err(busy(folder, format!("its frames are divided into {text} shards, not {shards}")));
            }
            run.folder_lock = Some(lock);
            let name = format!("{}-of-{}", shard.number, shard.of);
            let lock = Lock::try_exclusive(&lock_path(folder, &name))?;
            run.shard_lock = Some(lock.ok_or_else(|| busy(folder, "the same shard"))?);
        }
        Ok(run)
    }

    /// Removes what a killed run of this shard, or of all frames, left in the folder and in these folders below it.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Write`].
    pub(super) fn remove_leftovers(&self, below: &BTreeSet<String>) -> Result<()> {
        let own_lock = self.shard_lock.as_ref().or(self.folder_lock.as_ref());
        let is_held = own_lock.is_some_and(Lock::is_held);
        let tag = self.shard.tag();
        remove_temporary(&self.folder, below, |other| is_held && other == tag)
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        // Those that are exclusive: a shared lock's file belongs to the others as well.
        let exclusive =
            if self.shard == Shard::WHOLE { self.folder_lock.take() } else { self.shard_lock.take() };
        if let Some(lock) = exclusive {
            lock.remove();
        }
    }
}

/// The locks of a merge.
#[derive(Debug)]
pub(super) struct MergeLock {
    folder: PathBuf,
    /// `None` once it is released: before `merge`, as the next merge must not find it shared by one that has ended.
    folder_lock: Option<Lock>,
    merge: Option<Lock>,
    is_alone: bool,
}

impl MergeLock {
    /// Takes the locks of a merge; waits for another merge.
    ///
    /// # Errors
    /// [`Error::Busy`] if a run of all frames is writing to the folder, [`Error::Write`].
    pub(super) fn acquire(folder: &Path) -> Result<Self> {
        Self::with(folder, Lock::wait(&lock_path(folder, MERGE))?)
    }

    /// Like [`acquire`](Self::acquire), for the merge at the end of a run.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(super) fn after(mut run: RunLock) -> Result<Self> {
        let folder = run.folder.clone();
        let merge = Lock::wait(&lock_path(&folder, MERGE))?;
        if run.shard == Shard::WHOLE
            && let Some(folder_lock) = run.folder_lock.take()
        {
            return Ok(Self { folder, merge: Some(merge), folder_lock: Some(folder_lock), is_alone: true });
        }
        drop(run);
        Self::with(&folder, merge)
    }

    fn with(folder: &Path, merge: Lock) -> Result<Self> {
        let path = lock_path(folder, FOLDER);
        // Before the folder's lock is asked for: if it cannot be had, the file of `merge` goes.
        let mut lock =
            Self { folder: folder.to_owned(), merge: Some(merge), folder_lock: None, is_alone: false };
        lock.folder_lock = Lock::try_exclusive(&path)?;
        lock.is_alone = lock.folder_lock.is_some();
        if !lock.is_alone {
            let shared = Lock::try_shared(&path)?;
            lock.folder_lock =
                Some(shared.ok_or_else(|| busy(folder, "a run of all frames, without --shard"))?);
        }
        Ok(lock)
    }

    /// Whether no run is writing to the folder.
    pub(super) const fn is_alone(&self) -> bool {
        self.is_alone
    }

    /// Removes what killed merges and, if there is none that runs, killed runs left in the folder and in these folders
    /// below it.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Write`].
    pub(super) fn remove_leftovers(&self, below: &BTreeSet<String>) -> Result<()> {
        let no_runs = self.has_no_runs();
        let no_merges = self.merge.as_ref().is_some_and(Lock::is_held);
        remove_temporary(&self.folder, below, |tag| {
            if tag == MERGE_TAG { no_merges } else { no_runs && Shard::has_tag(tag) }
        })
    }

    /// Whether it is certain that no run is writing to the folder.
    fn has_no_runs(&self) -> bool {
        self.is_alone && self.folder_lock.as_ref().is_some_and(Lock::is_held)
    }

    /// Releases the locks. Removes all lock files if no run is writing to the folder.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Write`].
    pub(super) fn release(self) -> Result<()> {
        if self.has_no_runs() {
            let names = disk::names(&self.folder)?;
            let of_shards = names.iter().filter(|name| lock_name(name).is_some_and(is_shard_lock));
            of_shards.map(|name| self.folder.join(name)).try_for_each(|path| disk::remove(&path))?;
        }
        Ok(())
    }
}

impl Drop for MergeLock {
    /// Also after an error, so that it leaves no files of locks.
    fn drop(&mut self) {
        let is_alone = self.is_alone;
        match self.folder_lock.take() {
            Some(lock) if is_alone => lock.remove(),
            lock => drop(lock),
        }
        if let Some(merge) = self.merge.take() {
            merge.remove();
        }
    }
}

/// Whether a lock of this name is that of a shard.
fn is_shard_lock(name: &str) -> bool {
    let numbers = name.split_once("-of-");
    numbers.is_some_and(|(i, n)| i.parse::<u64>().is_ok() && n.parse::<u64>().is_ok())
}

fn remove_temporary(folder: &Path, below: &BTreeSet<String>, is_dead: impl Fn(&str) -> bool) -> Result<()> {
    disk::remove_temporary(folder, &is_dead)?;
    below.iter().try_for_each(|below| disk::remove_temporary(&folder.join(below), &is_dead))
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    /// Else the logs of shards would stay in a complete folder.
    #[test]
    fn of_the_merges_after_shards_the_last_is_alone() {
        const SHARDS: u64 = 4;
        for round in 0..100 {
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path();
            let barrier = Barrier::new(SHARDS as usize);
            let is_alone = |lock: MergeLock| {
                let is_alone = lock.is_alone();
                lock.release().expect("released");
                is_alone
            };
            let shard = |number| {
                let run = RunLock::acquire(path, Shard { number, of: SHARDS }).expect("shared");
                assert!(matches!(RunLock::acquire(path, Shard::WHOLE), Err(Error::Busy { .. })));
                barrier.wait();
                is_alone(MergeLock::after(run).expect("a lock"))
            };
            let alone: Vec<bool> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..SHARDS)
                    .map(|number| {
                        scope.spawn({
                            let shard = &shard;
                            move || shard(number)
                        })
                    })
                    .collect();
                threads.into_iter().map(|thread| thread.join().expect("ended")).collect()
            });
            assert!(alone.contains(&true), "round {round}: {alone:?}");
            assert_eq!(disk::names(path).expect("read"), [""; 0], "round {round}");
        }
    }
}
