//! Completing a dataset: the logs and manifests of all shards become one of each, and index files are written once
//! every frame exists.
//!
//! Must not know: how frames are made.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::slice;

use serde_json::{Map, Value, json};

use super::digest::{self, Digest};
use super::gate::{Gate, no_dataset, read_manifest};
use super::lock::{MERGE_TAG, MergeLock, RunLock};
use super::log::{
    FoundLines, FrameLog, LinePosition, MANIFEST, check_digest, find_lines, has_files, is_filled, shard_files,
};
use super::plan::{Range, Shard, differences, frame_seed};
use super::totals::Totals;
use super::{contact_sheet, data_card, histograms, manifest};
use crate::error::{Error, Result};
use crate::input;
use crate::output::disk::own_name::is_own_name;
use crate::output::disk::{self, FileWriter};
use crate::output::layout::{self, Bundle, DatasetIndex, FrameLines as _, Layout, interface::CARD_FILE};
use crate::output::{Artifact, dataset_path};

/// A folder with one log and one manifest.
#[derive(Clone, Debug)]
pub struct Finalized {
    /// Its manifest.
    pub manifest: Map<String, Value>,
    /// Frames of the dataset that do not exist yet.
    pub missing: MissingFrames,
}

/// Frames that do not exist, as the ranges between those that do: a dataset can have more frames than the memory has room for.
#[derive(Clone, Debug)]
pub struct MissingFrames(Vec<std::ops::Range<u64>>);

impl MissingFrames {
    /// Those of a range where these frames, ascending, exist.
    fn between(range: Range, existing: impl Iterator<Item = u64>) -> Self {
        let mut gaps = Vec::new();
        let mut next = range.start;
        for index in existing.filter(|index| (range.start..range.end()).contains(index)).chain([range.end()])
        {
            if next < index {
                gaps.push(next..index);
            }
            next = index + 1;
        }
        Self(gaps)
    }

    /// Whether every frame exists.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Number of missing frames.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.iter().map(|gap| gap.end - gap.start).sum()
    }

    /// Their indices, ascending.
    pub fn indices(&self) -> impl Iterator<Item = u64> {
        self.0.iter().cloned().flatten()
    }
}

/// Makes one `frames.jsonl` in ascending order of index and one `manifest.json` out of those of all runs. Once every
/// frame exists, also writes the index files, the data card, the histograms and the contact sheet, and removes the
/// files of the shards. Can be repeated: in a complete folder, which may be read-only, nothing is written. A data card that was edited
/// stays where nothing else has changed.
///
/// # Errors
/// [`Error::Dataset`] if the folder has no manifest, [`Error::OtherDataset`] if its shards are of different
/// configurations, [`Error::Busy`] if a run of all frames is writing to it, [`Error::Read`], [`Error::Write`].
pub fn finalize(folder: &Path) -> Result<Finalized> {
    if !folder.is_dir() || shard_files(folder, MANIFEST)?.is_empty() {
        return Err(no_dataset(folder));
    }
    if let Some(complete) = find_complete(folder)? {
        return Ok(complete);
    }
    finalize_locked(folder, MergeLock::acquire(folder)?)
}

/// The folder as it is, if it has what [`finalize_locked`] would write and nothing that it would remove. Only reads.
///
/// # Errors
/// Those of reading.
pub(super) fn find_complete(folder: &Path) -> Result<Option<Finalized>> {
    let log = folder.join("frames.jsonl");
    let path = folder.join("manifest.json");
    let manifests = shard_files(folder, MANIFEST)?;
    if manifests != slice::from_ref(&path) || disk::names(folder)?.iter().any(|name| is_own_name(name)) {
        return Ok(None);
    }
    let Some((identity, options, range)) = merged_identity(&manifests)? else { return Ok(None) };
    let gate = Gate::of_identity(&identity, range)?;
    let FoundLines { logs, positions, folders } = find_lines(folder, &gate)?;
    let missing = MissingFrames::between(range, positions.keys().copied());
    let is_whole = missing.is_empty() && with_found(range, &positions) == range;
    if !is_whole || logs != slice::from_ref(&log) || !is_in_order(&log, &positions) {
        return Ok(None);
    }
    // Those of a bundled frame are gone.
    for below in folders.iter().map(|below| folder.join(below)).filter(|below| below.is_dir()) {
        if disk::names(&below)?.iter().any(|name| is_own_name(name)) {
            return Ok(None);
        }
    }
    let lines = FrameLog::new(folder, gate.clone());
    let totals = Totals::of(&lines, gate.size())?;
    let mut manifest =
        merged_manifest(identity.clone(), &options, range, positions.len() as u64, true, &totals);
    let Some(hashes) = hashes_on_disk(folder, &manifest, &totals)? else { return Ok(None) };
    manifest.insert("index_files".to_owned(), hashes.into());
    manifest.insert(digest::KEY.to_owned(), Digest::of(&identity, &lines)?.into());
    let written = manifest::to_file("manifest.json".to_owned(), manifest.clone())?;
    let is_same = input::read(&path, written.bytes.len() as u64).is_ok_and(|bytes| bytes == written.bytes);
    Ok(is_same.then_some(Finalized { manifest, missing }))
}

/// Whether a log consists of these lines, ascending by frame, and nothing else.
fn is_in_order(log: &Path, positions: &BTreeMap<u64, LinePosition>) -> bool {
    let end =
        positions.values().try_fold(0, |end, line| (line.offset == end).then_some(end + line.length as u64));
    end.is_some_and(|end| log.metadata().is_ok_and(|file| file.len() == end))
}

/// The content hashes by name that [`write_index_files`] would return, if it would change no file.
fn hashes_on_disk(
    folder: &Path,
    manifest: &Map<String, Value>,
    totals: &Totals,
) -> Result<Option<Map<String, Value>>> {
    let old = read_manifest(&folder.join("manifest.json"))?;
    let old_hash = |name: &str| old.get("index_files")?.get(name)?.as_str().map(str::to_owned);
    let hash_of = |name: &str| dataset_path::hash(folder, name).ok().map(|(_, hash)| hash);
    let old_card = hash_of_card(folder);
    let mut hashes = Map::new();
    let mut is_same = true;
    FrameLog::new(folder, Gate::of_manifest(manifest)?).for_each(&mut |line| {
        let Some(bundle) = line.bundle() else { return Ok(()) };
        if !hashes.contains_key(bundle) {
            let hash = hash_of(bundle);
            is_same &= hash.is_some() && hash == old_hash(bundle);
            hashes.insert(bundle.to_owned(), hash.into());
        }
        // What a bundle contains is removed.
        is_same = is_same && !has_files(folder, &line)?;
        Ok(())
    })?;
    let mut compare = |file: Artifact| {
        let hash = disk::content_hash(&file.bytes);
        let is_kept = file.name == CARD_FILE && old_card.as_ref() == Some(&hash);
        is_same = is_same && (is_kept || hash_of(&file.name).as_ref() == Some(&hash));
        hashes.insert(file.name, hash.into());
        Ok(())
    };
    index_files(folder, manifest, totals, &mut compare)?;
    Ok(is_same.then_some(hashes))
}

/// Like [`finalize`], at the end of a run of the frames of a range that belong to a shard. Counts what is on the disk.
///
/// # Errors
/// [`Error::FramesLost`] if one of the run's frames is missing; those of [`finalize`].
pub(super) fn finalize_run(folder: &Path, lock: RunLock, range: Range, shard: Shard) -> Result<Finalized> {
    check_frames(folder, finalize_locked(folder, MergeLock::after(lock)?)?, range, shard)
}

/// Like [`finalize`], where these frames were found. Counts what is on the disk.
///
/// # Errors
/// [`Error::FramesLost`] if one of them is missing; those of [`finalize`].
pub fn finalize_frames(folder: &Path, range: Range, shard: Shard) -> Result<Finalized> {
    check_frames(folder, finalize(folder)?, range, shard)
}

fn check_frames(folder: &Path, finalized: Finalized, range: Range, shard: Shard) -> Result<Finalized> {
    let own_in = |start: u64, end: u64| shard.count_in(&(start.max(range.start)..end.min(range.end())));
    let of_dataset = manifest::range_of(&finalized.manifest);
    let wanted = own_in(range.start, range.end());
    let missing: u64 = finalized.missing.0.iter().map(|gap| own_in(gap.start, gap.end)).sum();
    let found = own_in(of_dataset.start, of_dataset.end()) - missing;
    if found < wanted {
        return Err(Error::FramesLost { path: folder.to_owned(), missing: wanted - found, wanted });
    }
    Ok(finalized)
}

fn finalize_locked(folder: &Path, lock: MergeLock) -> Result<Finalized> {
    let manifests = shard_files(folder, MANIFEST)?;
    let (identity, options, range) = merged_identity(&manifests)?.ok_or_else(|| no_dataset(folder))?;
    let gate = Gate::of_identity(&identity, range)?;
    let FoundLines { logs, positions, folders } = find_lines(folder, &gate)?;
    // Frames of a run whose manifest was lost belong to the dataset as those of other manifests do.
    let range = with_found(range, &positions);
    let gate = Gate::of_identity(&identity, range)?;
    if let [manifest] = &manifests[..] {
        check_digest(folder, &read_manifest(manifest)?, &gate)?;
    }
    lock.remove_leftovers(&folders)?;
    let mut files = FileWriter::new(folder, MERGE_TAG);
    merge_logs(&mut files, &logs, &positions)?;
    let missing = MissingFrames::between(range, positions.keys().copied());
    let totals = Totals::of(&FrameLog::new(folder, gate.clone()), gate.size())?;
    let mut manifest =
        merged_manifest(identity, &options, range, positions.len() as u64, missing.is_empty(), &totals);
    if missing.is_empty() {
        let hashes = write_index_files(&mut files, &manifest, &totals)?;
        manifest.insert("index_files".to_owned(), hashes.into());
        let digest = Digest::of(&manifest::identity_of(manifest.clone()), &FrameLog::new(folder, gate))?;
        manifest.insert(digest::KEY.to_owned(), digest.into());
    }
    files.write_all(&[manifest::to_file("manifest.json".to_owned(), manifest.clone())?])?;
    files.sync_folders()?;
    // Beside runs that have yet to finish, their logs stay; the last of them removes all.
    if missing.is_empty() && lock.is_alone() {
        let merged = ["frames.jsonl", "manifest.json"].map(|name| folder.join(name));
        for path in logs.iter().chain(&manifests).filter(|path| !merged.contains(path)) {
            disk::remove(path)?;
        }
    }
    lock.release()?;
    Ok(Finalized { manifest, missing })
}

/// An identity, the options of its command, and its range.
type MergedIdentity = (Map<String, Value>, String, Range);

/// What the manifests of all shards agree on, the options of the first, and the range that covers theirs; `None` if there is no
/// manifest.
fn merged_identity(manifests: &[PathBuf]) -> Result<Option<MergedIdentity>> {
    let Some((first, others)) = manifests.split_first() else { return Ok(None) };
    let first = read_manifest(first)?;
    let mut range = manifest::range_of(&first);
    let options = manifest::options_of(&first);
    let identity = manifest::identity_of(first);
    for path in others {
        let other = read_manifest(path)?;
        let differences = differences(&other, &identity);
        if !differences.is_empty() {
            return Err(Error::OtherDataset { path: path.clone(), differences });
        }
        range = range.hull(manifest::range_of(&other));
    }
    Ok(Some((identity, options, range)))
}

/// The smallest range that contains a range and the frames that were found.
fn with_found(range: Range, positions: &BTreeMap<u64, LinePosition>) -> Range {
    let ends = positions.first_key_value().zip(positions.last_key_value());
    ends.map_or(range, |((&first, _), (&last, _))| {
        range.hull(Range { start: first, count: last - first + 1 })
    })
}

/// Copies the lines at these positions to `frames.jsonl`, byte for byte.
fn merge_logs(
    files: &mut FileWriter,
    logs: &[PathBuf],
    positions: &BTreeMap<u64, LinePosition>,
) -> Result<()> {
    files.write_streamed("frames.jsonl", |out| {
        let mut files = logs
            .iter()
            .map(|path| input::open(path))
            .collect::<Result<Vec<_>>>()
            .map_err(std::io::Error::other)?;
        for &LinePosition { log, offset, length } in positions.values() {
            let mut line = vec![0; length];
            files[log].seek(SeekFrom::Start(offset))?;
            files[log].read_exact(&mut line)?;
            out.write_all(&line)?;
        }
        Ok(())
    })?;
    Ok(())
}

/// The manifest of a folder with this range and these totals, still without the hashes of a complete one.
pub(super) fn merged_manifest(
    identity: Map<String, Value>,
    options: &str,
    range: Range,
    completed: u64,
    is_complete: bool,
    totals: &Totals,
) -> Map<String, Value> {
    let status = if is_complete { "done" } else { "incomplete" };
    let base_seed = identity.get("base_seed").and_then(Value::as_u64).unwrap_or_default();
    let seeds = [range.start, range.end().saturating_sub(1)].map(|index| frame_seed(base_seed, index, 0));
    let mut manifest = Map::new();
    for (key, value) in [
        ("status", status.into()),
        ("start", range.start.into()),
        ("count", range.count.into()),
        ("n_completed", completed.into()),
        ("seeds", json!(seeds)),
        ("adapters", json!(totals.adapters)),
        ("totals", totals.to_json()),
    ] {
        manifest.insert(key.to_owned(), value);
    }
    manifest.extend(manifest::command(options, &identity, range));
    manifest.extend(identity);
    manifest
}

/// Writes the files that a complete dataset has besides its frames, and returns their content hashes by name.
fn write_index_files(
    files: &mut FileWriter,
    manifest: &Map<String, Value>,
    totals: &Totals,
) -> Result<Map<String, Value>> {
    let (_, layout) = layout_of(manifest)?;
    let folder = files.folder().to_owned();
    let lines = FrameLog::new(&folder, Gate::of_manifest(manifest)?);
    // A card that was edited is not replaced by the one that was there before.
    let old_card = hash_of_card(&folder);
    let mut hashes = Map::new();
    let mut write_bundle = |bundle: Bundle<'_>| {
        let hash = files.write_streamed(bundle.name, bundle.content)?;
        hashes.insert(bundle.name.to_owned(), hash.into());
        // What a bundle contains is removed once the bundle is on the disk.
        files.sync_folders()
    };
    let index = DatasetIndex { folder: &folder, lines: &lines, manifest, card: "" };
    layout.write_bundles(&index, &mut write_bundle)?;
    let mut write = |file: Artifact| {
        let hash = disk::content_hash(&file.bytes);
        let is_kept = file.name == CARD_FILE && old_card.as_ref() == Some(&hash);
        hashes.insert(file.name.clone(), hash.into());
        if is_kept { Ok(()) } else { files.write_all(&[file]).map(drop) }
    };
    index_files(&folder, manifest, totals, &mut write)?;
    files.sync_folders()?;
    Ok(hashes)
}

/// The hash of the data card that was written into a complete dataset, whatever it says now; `None` if there is no card.
fn hash_of_card(folder: &Path) -> Option<String> {
    let manifest =
        is_filled(&folder.join(CARD_FILE)).then(|| read_manifest(&folder.join("manifest.json")))?.ok()?;
    manifest.get("index_files")?.get(CARD_FILE)?.as_str().map(str::to_owned)
}

/// Passes the files that a complete dataset has besides its frames and their bundles to `write`, one by one. They follow
/// from the manifest, the lines and, for the contact sheet, the first frames; nothing is written.
///
/// # Errors
/// Those of reading, encoding and `write`.
pub(super) fn index_files(
    folder: &Path,
    manifest: &Map<String, Value>,
    totals: &Totals,
    write: &mut dyn FnMut(Artifact) -> Result<()>,
) -> Result<()> {
    let (_, layout) = layout_of(manifest)?;
    let gate = Gate::of_manifest(manifest)?;
    let lines = FrameLog::new(folder, gate.clone());
    let card = data_card::markdown(manifest, totals, layout.annotation_ids());
    let size = gate.size();
    layout.index_files(&DatasetIndex { folder, lines: &lines, manifest, card: &card }, write)?;
    write(histograms::svg(&lines)?)?;
    if let Some(sheet) = contact_sheet::png(folder, &lines, layout, size)? {
        write(sheet)?;
    }
    Ok(())
}

fn layout_of(manifest: &Map<String, Value>) -> Result<(&'static str, &'static dyn Layout)> {
    layout::find(manifest.get("format").and_then(Value::as_str).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hostile manifest names billions of frames.
    #[test]
    fn missing_frames_are_counted_without_a_list_of_them() {
        let range = Range { start: 2, count: (1 << 32) - 2 };
        let missing = MissingFrames::between(range, [0, 2, 3, 6, u64::from(u32::MAX)].into_iter());
        assert_eq!(missing.count(), range.count - 4);
        assert_eq!(missing.indices().take(4).collect::<Vec<_>>(), [4, 5, 7, 8]);
        assert!(!missing.is_empty() && missing.0.len() == 2);
        assert!(MissingFrames::between(Range { start: 3, count: 2 }, 0..9).is_empty());
    }

    #[test]
    fn a_run_misses_the_frames_of_its_own_only() {
        let frames = |start, count| Range { start, count };
        let missing = |range, shard| {
            let manifest = [("start", 2.into()), ("count", 8.into())]
                .map(|(key, value): (_, Value)| (key.to_owned(), value));
            let missing = MissingFrames::between(frames(2, 8), [2, 3, 4, 6, 8, 9].into_iter());
            let finalized = Finalized { manifest: manifest.into_iter().collect(), missing };
            match check_frames(Path::new("data"), finalized, range, shard) {
                Err(Error::FramesLost { missing, wanted, .. }) => (missing, wanted),
                result => result.map(|_| (0, 0)).expect("no other error"),
            }
        };
        let [even, odd] = [0, 1].map(|number| Shard { number, of: 2 });
        assert_eq!(missing(frames(2, 8), Shard::WHOLE), (2, 8));
        assert_eq!(missing(frames(2, 8), even), (0, 0));
        assert_eq!(missing(frames(2, 8), odd), (2, 4));
        assert_eq!(missing(frames(8, 2), Shard::WHOLE), (0, 0));
        assert_eq!(missing(frames(8, 5), Shard::WHOLE), (3, 5), "frames beyond the dataset are missing");
        assert_eq!(missing(frames(20, 4), odd), (2, 2));
    }
}
