//! The only place that touches the disk: whole files or none, whatever happens in between.
//!
//! A file is written under a temporary name in its own folder, synchronised, and renamed. Temporary names start with
//! [`TEMPORARY_PREFIX`] and a tag of the writing process, so that the leftovers of a killed process can be distinguished
//! from files that another process is writing, and removed.
//! Must not know: what the bytes mean.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use twox_hash::XxHash3_128;

use super::artifact::Artifact;
use crate::error::{Error, Result};

/// Start of the names of files that are not yet complete.
pub const TEMPORARY_PREFIX: &str = ".writing-";

fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Write { path, cause }
}

fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Read { path, cause }
}

/// Refuses a folder that is a file, or that holds a name for which `is_ours` is false. Temporary files are allowed.
///
/// # Errors
/// [`Error::OutIsFile`], [`Error::OutNotEmpty`] unless `force`, [`Error::Read`] if the folder cannot be listed.
pub fn check_content(folder: &Path, force: bool, is_ours: impl Fn(&str) -> bool) -> Result<()> {
    if folder.is_file() {
        return Err(Error::OutIsFile(folder.to_owned()));
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
    let foreign =
        names(folder)?.into_iter().find(|name| !name.starts_with(TEMPORARY_PREFIX) && !is_ours(name));
    match foreign {
        Some(found) => Err(Error::OutNotEmpty { path: folder.to_owned(), found }),
        None => Ok(()),
    }
}

/// Names of the files and folders in a folder, sorted.
///
/// # Errors
/// [`Error::Read`].
pub fn names(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable(folder))? {
        let entry = entry.map_err(unreadable(folder))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort_unstable();
    Ok(names)
}

/// The content of a file.
///
/// # Errors
/// [`Error::Read`].
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(unreadable(path))
}

/// 128-bit XXH3 hash in hexadecimal, as printed by `xxhsum -H2`.
#[must_use]
pub fn content_hash(bytes: &[u8]) -> String {
    format!("{:032x}", XxHash3_128::oneshot(bytes))
}

/// Writes all files into a folder (created if missing), or none: each is written under a temporary name, and all are
/// renamed once all are complete. Returns their paths.
///
/// # Errors
/// [`Error::Write`].
pub fn write_all(folder: &Path, artifacts: &[Artifact]) -> Result<Vec<PathBuf>> {
    write_all_tagged(folder, "", artifacts)
}

/// Like [`write_all`], with the tag of the writing process in the temporary names.
///
/// # Errors
/// [`Error::Write`].
pub fn write_all_tagged(folder: &Path, tag: &str, artifacts: &[Artifact]) -> Result<Vec<PathBuf>> {
    let is_new = !folder.exists();
    let result = try_write_all(folder, tag, artifacts);
    if is_new && result.is_err() {
        // Removes the folder only if it is empty: another process may have written there meanwhile.
        let _ = std::fs::remove_dir(folder);
    }
    result
}

fn try_write_all(folder: &Path, tag: &str, artifacts: &[Artifact]) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder).map_err(failed(folder))?;
    let prefix = format!("{TEMPORARY_PREFIX}{tag}");
    let mut written = Vec::new();
    for artifact in artifacts {
        let path = folder.join(&artifact.name);
        if path.is_dir() {
            return Err(Error::Write { path, cause: std::io::ErrorKind::IsADirectory.into() });
        }
        let parent = path.parent().unwrap_or(folder).to_owned();
        if artifact.name.contains('/') {
            std::fs::create_dir_all(&parent).map_err(failed(&parent))?;
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = builder.tempfile_in(parent).map_err(failed(&path))?;
        file.write_all(&artifact.bytes).and_then(|()| file.as_file().sync_data()).map_err(failed(&path))?;
        written.push((file, path));
    }
    written
        .into_iter()
        .map(|(file, path)| match file.persist(&path) {
            Ok(_) => Ok(path),
            Err(error) => Err(Error::Write { path, cause: error.error }),
        })
        .collect()
}

/// Writes one file from a stream, completely or not at all.
///
/// # Errors
/// [`Error::Write`].
pub fn write_streamed(
    path: &Path,
    content: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>,
) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY_PREFIX);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.tempfile_in(folder).map_err(failed(path))?;
    let mut out = std::io::BufWriter::new(file);
    content(&mut out).map_err(failed(path))?;
    let file = out.into_inner().map_err(|error| failed(path)(error.into_error()))?;
    file.as_file().sync_data().map_err(failed(path))?;
    file.persist(path).map(drop).map_err(|error| failed(path)(error.error))
}

/// Removes the temporary files of killed processes with this tag from a folder and its subfolders; an empty tag matches
/// all.
///
/// # Errors
/// [`Error::Write`] or [`Error::Read`].
pub fn remove_temporary(folder: &Path, tag: &str) -> Result<()> {
    let prefix = format!("{TEMPORARY_PREFIX}{tag}");
    for name in names(folder)? {
        let path = folder.join(&name);
        if name.starts_with(&prefix) {
            remove(&path)?;
        } else if path.is_dir() && !path.is_symlink() {
            remove_temporary(&path, tag)?;
        }
    }
    Ok(())
}

/// Removes a file. A file that does not exist is not an error.
///
/// # Errors
/// [`Error::Write`].
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(failed(path)(cause)),
        _ => Ok(()),
    }
}

/// Removes a folder if it is empty.
pub fn remove_empty_folder(path: &Path) {
    let _ = std::fs::remove_dir(path);
}

/// A text file to which whole lines are appended. Opening it cuts off an incomplete last line of a killed process.
#[derive(Debug)]
pub struct LineFile {
    file: File,
    path: PathBuf,
}

impl LineFile {
    /// Opens the file, or creates it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn open(path: &Path) -> Result<Self> {
        let open = || {
            let mut file =
                OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
            let mut content = Vec::new();
            file.read_to_end(&mut content)?;
            let whole = content.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
            file.set_len(whole as u64)?;
            file.seek(SeekFrom::End(0))?;
            Ok(file)
        };
        Ok(Self { file: open().map_err(failed(path))?, path: path.to_owned() })
    }

    /// Appends a line in one write.
    ///
    /// # Errors
    /// [`Error::Write`]; then no part of the line is in the file.
    pub fn append(&mut self, line: &str) -> Result<()> {
        let before = self.file.stream_position().map_err(failed(&self.path))?;
        let written = self.file.write_all(format!("{line}\n").as_bytes());
        written.map_err(|cause| {
            // A full disk may have accepted a part of the line.
            let _ = self.file.set_len(before).and_then(|()| self.file.seek(SeekFrom::Start(before)));
            failed(&self.path)(cause)
        })
    }

    /// Waits until all lines are on the disk.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(failed(&self.path))
    }
}

/// An exclusive lock on a file, released on drop; the system releases the lock of a killed process.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "the open file is the lock")] File);

impl Lock {
    /// Acquires the lock, or returns `None` if another process holds it. On a file system without locks it always
    /// succeeds.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn try_acquire(path: &Path) -> Result<Option<Self>> {
        let file = Self::open(path)?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Ok(None),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(Self(file))),
        }
    }

    /// Waits for the lock and acquires it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn acquire(path: &Path) -> Result<Self> {
        let file = Self::open(path)?;
        let _ = file.lock();
        Ok(Self(file))
    }

    fn open(path: &Path) -> Result<File> {
        let opened = OpenOptions::new().write(true).create(true).truncate(false).open(path);
        opened.map_err(failed(path))
    }
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
    fn an_incomplete_last_line_is_cut_off() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lines");
        let mut file = LineFile::open(&path).expect("made");
        file.append("one").expect("written");
        std::fs::write(&path, "one\ntwo\nthr").expect("torn");
        let mut file = LineFile::open(&path).expect("opened");
        file.append("three").expect("written");
        assert_eq!(std::fs::read_to_string(&path).expect("read"), "one\ntwo\nthree\n");
    }

    #[test]
    fn a_lock_is_exclusive_and_ends_on_drop() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let held = Lock::try_acquire(&path).expect("a file").expect("free");
        assert!(Lock::try_acquire(&path).expect("a file").is_none(), "taken");
        drop(held);
        assert!(Lock::try_acquire(&path).expect("a file").is_some(), "free again");
    }

    #[test]
    fn only_temporary_files_of_the_tag_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        write_all(folder.path(), &[Artifact { name: "a/b/c.txt".to_owned(), bytes: vec![7] }])
            .expect("written");
        for name in [".writing-x", "a/b/.writing-y", ".writing-1of2-z"] {
            std::fs::write(folder.path().join(name), "half").expect("written");
        }
        remove_temporary(folder.path(), "1of2-").expect("removed");
        assert_eq!(names(folder.path()).expect("read"), [".writing-x", "a"]);
        remove_temporary(folder.path(), "").expect("removed");
        assert_eq!(names(folder.path()).expect("read"), ["a"]);
        assert_eq!(names(&folder.path().join("a/b")).expect("read"), ["c.txt"]);
    }
}
