//! Who may write to a dataset's folder: only runs of the same dataset, and one process per shard.
//!
//! Must not know: how frames are made.

use std::collections::BTreeSet;
use std::path::Path;

use super::log::{self, LOG, MANIFEST, finished_frames, is_shard_file, shard_file_name, shard_files};
use super::manifest::{self, DatasetSpec};
use super::plan::{Range, Shard, differences};
use crate::error::{Error, Result};
use crate::output::disk::{self, Lock};

/// Checks whether a run may continue in a folder, and returns the frames that are finished there. Writes nothing.
///
/// # Errors
/// [`Error::OtherDataset`], [`Error::OutNotEmpty`], [`Error::OutIsFile`], [`Error::Usage`] for frames that would
/// leave a gap.
pub fn check_folder(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<BTreeSet<u64>> {
    merged_range(folder, spec, force)?;
    finished_frames(folder)
}

/// Whether a folder has a manifest of some run.
///
/// # Errors
/// [`Error::Read`].
pub fn has_manifest(folder: &Path) -> Result<bool> {
    Ok(folder.is_dir() && !shard_files(folder, MANIFEST)?.is_empty())
}

/// The range of frames that covers the planned ones and those of the dataset in the folder, if that is the same dataset.
pub(super) fn merged_range(folder: &Path, spec: &DatasetSpec, force: bool) -> Result<Range> {
    if folder.is_file() {
        return Err(Error::OutIsFile(folder.to_owned()));
    }
    let mut range = spec.range;
    let manifests = if folder.exists() { shard_files(folder, MANIFEST)? } else { Vec::new() };
    for path in &manifests {
        let manifest = match manifest::read(path) {
            // Another shard has just completed the folder and removed its manifest.
            Err(Error::Read { .. }) if !path.exists() => continue,
            manifest => manifest?,
        };
        let existing = manifest::range_of(&manifest);
        let differences = spec_differences(spec, &manifest, existing);
        if !differences.is_empty() {
            let is_own = path.ends_with(shard_file_name(MANIFEST, spec.shard)) && manifests.len() == 1;
            if is_own && log::find_lines(folder)?.1.is_empty() {
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
        // A run that was stopped right at its start, or another shard that is starting, leaves only these.
        let is_ours = |name: &str| name.starts_with(".lock") || is_shard_file(name, LOG);
        if let Err(foreign) = disk::check_content(folder, force, is_ours) {
            // Another shard may have started since the manifests were listed.
            return if has_manifest(folder)? { merged_range(folder, spec, force) } else { Err(foreign) };
        }
    }
    Ok(range)
}

/// Where the dataset of a manifest differs from the planned one, one line each.
fn spec_differences(
    spec: &DatasetSpec,
    manifest: &serde_json::Map<String, serde_json::Value>,
    existing: Range,
) -> Vec<String> {
    let mut differences = differences(manifest, &spec.identity);
    if spec.is_split && existing != spec.range {
        differences.push(format!("  --split: there {} frames, now {}", existing.count, spec.range.count));
    }
    differences
}

/// The lock of a shard's run.
///
/// # Errors
/// [`Error::Busy`] if another process runs this shard, [`Error::Write`].
pub(super) fn acquire_run_lock(folder: &Path, shard: Shard) -> Result<Lock> {
    let path = folder.join(format!(".lock-{}-of-{}", shard.number, shard.of));
    Lock::try_acquire(&path)?.ok_or_else(|| Error::Busy(folder.to_owned()))
}

/// The lock of a merge; waits for another process that is merging.
///
/// # Errors
/// [`Error::Write`].
pub(super) fn acquire_merge_lock(folder: &Path) -> Result<Lock> {
    Lock::acquire(&folder.join(".lock"))
}

/// Removes all lock files of a completed folder.
///
/// # Errors
/// [`Error::Read`], [`Error::Write`].
pub(super) fn remove_lock_files(folder: &Path) -> Result<()> {
    let names = disk::names(folder)?;
    names
        .iter()
        .filter(|name| name.starts_with(".lock"))
        .try_for_each(|name| disk::remove(&folder.join(name)))
}
