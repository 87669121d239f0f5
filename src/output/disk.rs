//! The only place that touches the disk: whole files or none, whatever happens in between.
//!
//! A file is written under a temporary name in its own folder, synchronised, and renamed; then its folder is synchronised,
//! so that the new name survives a power cut. A [`FileWriter`] synchronises folders for many files at once. Temporary
//! names contain a tag of the writer, so that the leftovers of a killed process can be distinguished from files that
//! another process is writing, and removed; [`own_name`] has the pattern.
//! Must not know: what the bytes mean.

mod line_file;
mod lock;
mod operations;
pub mod own_name;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use twox_hash::XxHash3_128;

use super::artifact::Artifact;
use super::dataset_path;
use crate::error::{Error, Result};
pub use line_file::LineFile;
pub use lock::Lock;
pub use operations::remove_unfinished;
#[cfg(test)]
pub(crate) use operations::{Operation, recorder};
use operations::{TemporaryFile, failed};
use own_name::{RANDOM_LENGTH, TEMPORARY_SUFFIX, is_own_name, temporary_prefix, temporary_tag};

/// Tag of files that no lock protects; nobody removes what a killed process leaves of them.
const SINGLE_TAG: &str = "single";
/// Time between two synchronisations of folders while many files are written.
const SYNC_INTERVAL: Duration = Duration::from_millis(200);

fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Read { path, cause }
}

/// Refuses a folder that is a file, or that holds a name for which `is_ours` is false. Temporary and lock files are
/// allowed.
///
/// # Errors
/// [`Error::OutIsFile`], [`Error::OutNotEmpty`] unless `force`, [`Error::Read`] if the folder cannot be listed.
pub fn check_content(folder: &Path, force: bool, is_ours: impl Fn(&str) -> bool) -> Result<()> {
    // A device and a link that leads nowhere are none either.
    if folder.symlink_metadata().is_ok() && !folder.is_dir() {
        return Err(Error::OutIsFile(folder.to_owned()));
    }
    if let Some(file) = folder.ancestors().find(|path| path.is_file()) {
        return Err(Error::OutIsFile(file.to_owned()));
    }
    if folder.as_os_str() == "-" {
        return Err(Error::Usage(
            "--out -: only `dataset --format webdataset` streams to standard output; give a folder (./- for a folder \
             named -)"
                .to_owned(),
        ));
    }
    if force || !folder.exists() {
        return Ok(());
    }
    let foreign = names(folder)?.into_iter().find(|name| !is_own_name(name) && !is_ours(name));
    match foreign {
        Some(found) => Err(Error::OutNotEmpty { path: folder.to_owned(), found }),
        None => Ok(()),
    }
}

/// Names of the files and folders in a folder, sorted. Of names that are not UTF-8 the invalid bytes are replaced, so that no file is found
/// under them.
///
/// # Errors
/// [`Error::Read`].
pub fn names(folder: &Path) -> Result<Vec<String>> {
    let mut names: Vec<String> =
        os_names(folder)?.into_iter().map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort_unstable();
    Ok(names)
}

/// Names of the files and folders in a folder as the system has them, sorted by their bytes.
///
/// # Errors
/// [`Error::Read`].
pub fn os_names(folder: &Path) -> Result<Vec<OsString>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable(folder))? {
        names.push(entry.map_err(unreadable(folder))?.file_name());
    }
    names.sort_unstable();
    Ok(names)
}

/// 128-bit XXH3 hash in hexadecimal, as printed by `xxhsum -H2`.
#[must_use]
pub fn content_hash(bytes: &[u8]) -> String {
    format!("{:032x}", XxHash3_128::oneshot(bytes))
}

/// Writes all files into a folder (created if missing), or none: each is written under a temporary name, and all are
/// renamed once all are complete. Returns their paths; files and names are on the disk.
///
/// # Errors
/// [`Error::Write`].
pub fn write_all(folder: &Path, artifacts: &[Artifact]) -> Result<Vec<PathBuf>> {
    let mut writer = FileWriter::new(folder, SINGLE_TAG);
    let is_new = !folder.exists();
    let result = writer
        .create_folders(folder, Path::new(""))
        .and_then(|()| writer.write_all(artifacts))
        .and_then(|paths| writer.sync_folders().map(|()| paths));
    if is_new && result.is_err() {
        // Removes the folder only if it is empty: another process may have written there meanwhile.
        let _ = std::fs::remove_dir(folder);
    }
    result
}

/// Writes files below a folder. Their content is on the disk when a call returns, their names after
/// [`sync_folders`](Self::sync_folders).
#[derive(Debug)]
pub struct FileWriter {
    folder: PathBuf,
    tag: String,
    /// Folders with names that may not be on the disk yet.
    unsynced: BTreeSet<PathBuf>,
    synced: Option<Instant>,
}

impl FileWriter {
    /// A writer below `folder`. Its temporary names contain `tag`: small letters and digits.
    #[must_use]
    pub fn new(folder: &Path, tag: &str) -> Self {
        Self { folder: folder.to_owned(), tag: tag.to_owned(), unsynced: BTreeSet::new(), synced: None }
    }

    /// The folder below which it writes.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Creates the folder and those above it, as far as they are missing. The next synchronisation includes its name,
    /// even if it exists: another process may have created it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn create_folder(&mut self) -> Result<()> {
        let folder = self.folder.clone();
        self.create_folders(&folder, Path::new(""))?;
        self.unsynced.extend([parent(&folder), folder]);
        Ok(())
    }

    /// Creates a folder and those above it, as far as they are missing and below `base`.
    fn create_folders(&mut self, folder: &Path, base: &Path) -> Result<()> {
        let is_missing =
            |folder: &&Path| *folder != base && !folder.as_os_str().is_empty() && !folder.exists();
        let missing: Vec<&Path> = folder.ancestors().take_while(is_missing).collect();
        for new in missing.into_iter().rev() {
            operations::create_folder(new).map_err(failed(folder))?;
            self.unsynced.insert(parent(new));
        }
        Ok(())
    }

    /// Writes all files, or none: each is written under a temporary name, and all are renamed once all are complete.
    /// Returns their paths. The writer's folder must exist: one that was removed meanwhile is not created again.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_all<'a>(
        &mut self,
        artifacts: impl IntoIterator<Item = &'a Artifact>,
    ) -> Result<Vec<PathBuf>> {
        let folder = self.folder.clone();
        let mut written = Vec::new();
        for artifact in artifacts {
            let path = dataset_path::for_writing(&folder, &artifact.name)?;
            if path.is_dir() {
                return Err(Error::Write { path, cause: std::io::ErrorKind::IsADirectory.into() });
            }
            if artifact.name.contains('/') {
                self.create_folders(&parent(&path), &folder)?;
            }
            let mut file = self.temporary_for(&path)?;
            file.write_all(&artifact.bytes).map_err(failed(&path))?;
            written.push((file, path));
        }
        let files: Vec<&TemporaryFile> = written.iter().map(|(file, _)| file).collect();
        operations::sync_files(&files).map_err(|(index, cause)| failed(&written[index].1)(cause))?;
        written.into_iter().map(|(file, path)| self.rename(file, path)).collect()
    }

    /// Writes one file from a stream, completely or not at all, and returns its content hash. Its folder must exist.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_streamed(
        &mut self,
        name: &str,
        content: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>,
    ) -> Result<String> {
        let path = dataset_path::for_writing(&self.folder, name)?;
        let mut out = Hashing { out: self.temporary_for(&path)?, hasher: XxHash3_128::new() };
        let mut buffered = std::io::BufWriter::new(&mut out);
        content(&mut buffered).and_then(|()| buffered.flush()).map_err(failed(&path))?;
        drop(buffered);
        let Hashing { out: file, hasher } = out;
        file.sync().map_err(failed(&path))?;
        self.rename(file, path)?;
        Ok(format!("{:032x}", hasher.finish_128()))
    }

    /// An empty file beside `path`.
    fn temporary_for(&self, path: &Path) -> Result<TemporaryFile> {
        let prefix = temporary_prefix(&self.tag);
        TemporaryFile::create(&parent(path), &prefix, RANDOM_LENGTH, TEMPORARY_SUFFIX).map_err(failed(path))
    }

    fn rename(&mut self, file: TemporaryFile, path: PathBuf) -> Result<PathBuf> {
        file.rename(&path).map_err(failed(&path))?;
        self.unsynced.insert(parent(&path));
        Ok(path)
    }

    /// Whether the names of files have not been synchronised for so long that it is time to.
    #[must_use]
    pub fn is_sync_due(&self) -> bool {
        self.synced.is_none_or(|synced| synced.elapsed() >= SYNC_INTERVAL)
    }

    /// Waits until the names of all files and folders are on the disk.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn sync_folders(&mut self) -> Result<()> {
        self.unsynced
            .iter()
            .try_for_each(|folder| operations::sync_folder(folder).map_err(failed(folder)))?;
        self.unsynced.clear();
        self.synced = Some(Instant::now());
        Ok(())
    }
}

/// A writer that hashes what it passes on.
struct Hashing<W> {
    out: W,
    hasher: XxHash3_128,
}

impl<W: std::io::Write> std::io::Write for Hashing<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.hasher.write(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

/// The folder that has a path's name.
fn parent(path: &Path) -> PathBuf {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    parent.unwrap_or(Path::new(".")).to_owned()
}

/// Removes from a folder, not from those in it, the temporary files of writers for whose tags `is_dead` is true. A folder
/// that does not exist has none.
///
/// # Errors
/// [`Error::Write`] or [`Error::Read`].
pub fn remove_temporary(folder: &Path, is_dead: impl Fn(&str) -> bool) -> Result<()> {
    if !folder.is_dir() {
        return Ok(());
    }
    let names = names(folder)?;
    let dead = names.iter().filter(|name| temporary_tag(name).is_some_and(&is_dead));
    dead.map(|name| folder.join(name)).filter(|path| path.is_file()).try_for_each(|path| remove(&path))
}

/// Removes a file. A file that does not exist is not an error.
///
/// # Errors
/// [`Error::Write`].
pub fn remove(path: &Path) -> Result<()> {
    match operations::remove_file(path) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(failed(path)(cause)),
        _ => Ok(()),
    }
}

/// Removes a folder if it is empty.
pub fn remove_empty_folder(path: &Path) {
    let _ = operations::remove_folder(path);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_are_written_or_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("deep/out");
        let artifact = |name: &str| Artifact { name: name.to_owned(), bytes: vec![1, 2, 3] };
        let paths = write_all(&out, &[artifact("a"), artifact("b")]).expect("written");
        assert_eq!(std::fs::read(&paths[1]).expect("read"), [1, 2, 3]);
        std::fs::create_dir(out.join("c")).expect("a folder in the way");
        let error = write_all(&out, &[artifact("d"), artifact("c")]).expect_err("c is a folder");
        assert!(matches!(error, Error::Write { .. }));
        let mut left: Vec<_> =
            std::fs::read_dir(&out).expect("read").map(|e| e.expect("an entry").file_name()).collect();
        left.sort();
        assert_eq!(left, ["a", "b", "c"], "neither d nor a temporary file");
    }

    #[test]
    fn only_temporary_files_of_dead_writers_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let (dead, live) = (".regolith-render-1of2-Ab3dE6gH.tmp", ".regolith-render-0of2-Ab3dE6gH.tmp");
        std::fs::create_dir(folder.path().join("a")).expect("made");
        let kept = [live, ".lock", ".regolith-render-0-of-2.lock", ".writing-1of2-z", "a"];
        for name in [dead, "a/.regolith-render-1of2-Ab3dE6gH.tmp"].iter().chain(&kept[..4]) {
            std::fs::write(folder.path().join(name), "half").expect("written");
        }
        remove_temporary(folder.path(), |tag| tag == "1of2").expect("removed");
        let mut left = names(folder.path()).expect("read");
        left.sort();
        let mut kept: Vec<_> = kept.into();
        kept.sort();
        assert_eq!(left, kept);
        assert_eq!(names(&folder.path().join("a")).expect("read").len(), 1, "folders below stay as they are");
        remove_temporary(&folder.path().join("missing"), |_| true).expect("there is none");
    }
}
