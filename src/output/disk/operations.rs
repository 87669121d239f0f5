//! The operations that change the disk, one function for each.
//!
//! In unit tests a thread can record them, so that every state in which a power cut may leave the disk can be built from
//! the record.
//! Must not know: names of files, what the bytes mean.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;

use crate::error::Error;
use crate::host_time::{self, Role};

/// Threads that wait for files at a time.
const SYNC_THREADS: usize = 8;
/// A file that is on the disk sooner is no reason to start threads for the others.
const SLOW_SYNC: Duration = Duration::from_micros(300);

/// One change of the disk.
#[cfg(test)]
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Operation {
    /// A folder was created.
    CreateFolder(std::path::PathBuf),
    /// An empty file was created.
    Create(std::path::PathBuf),
    /// Bytes were written at an offset of a file.
    Write(std::path::PathBuf, u64, Vec<u8>),
    /// A file was cut to a length.
    Truncate(std::path::PathBuf, u64),
    /// A file's content was synchronised.
    SyncFile(std::path::PathBuf),
    /// A folder's entries were synchronised.
    SyncFolder(std::path::PathBuf),
    /// A file was renamed within its folder.
    Rename(std::path::PathBuf, std::path::PathBuf),
    /// A file or an empty folder was removed.
    Remove(std::path::PathBuf),
}

#[cfg(test)]
pub(crate) mod recorder {
    use std::cell::RefCell;

    use super::Operation;

    thread_local! {
        static RECORD: RefCell<Option<Vec<Operation>>> = const { RefCell::new(None) };
    }

    /// Runs `work` and returns its result with the operations of this thread.
    pub(crate) fn record<T>(work: impl FnOnce() -> T) -> (T, Vec<Operation>) {
        RECORD.set(Some(Vec::new()));
        let result = work();
        (result, RECORD.take().unwrap_or_default())
    }

    pub(super) fn add(operation: impl FnOnce() -> Operation) {
        RECORD.with_borrow_mut(|record| record.as_mut().map(|record| record.push(operation())));
    }
}

macro_rules! record {
    ($operation:expr) => {
        #[cfg(test)]
        recorder::add(|| {
            use Operation::*;
            $operation
        });
    };
}

/// The error of a file that cannot be written.
pub(super) fn failed(path: &Path) -> impl FnOnce(io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Write { path, cause: of_system(cause) }
}

/// The error of the operating system in one that names the temporary file, too.
fn of_system(error: io::Error) -> io::Error {
    let wrapped = error.get_ref().and_then(|inner| inner.source()?.downcast_ref::<io::Error>());
    wrapped.and_then(io::Error::raw_os_error).map_or(error, io::Error::from_raw_os_error)
}

/// Creates a folder in an existing one. It is no error if it exists.
pub(super) fn create_folder(path: &Path) -> io::Result<()> {
    match std::fs::create_dir(path) {
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => Ok(()),
        Err(cause) => Err(cause),
        Ok(()) => {
            record!(CreateFolder(path.to_owned()));
            Ok(())
        }
    }
}

/// Waits until the content of these files is on the disk.
///
/// # Errors
/// The first that occurs, with the index of its file.
pub(super) fn sync_files(files: &[&TemporaryFile]) -> Result<(), (usize, io::Error)> {
    share_out(files.len(), |index| files[index].file.as_file().sync_data())?;
    #[cfg(test)]
    for file in files {
        record!(SyncFile(file.file.path().to_owned()));
    }
    Ok(())
}

/// Calls `sync` for each index below `count`. A file system writes together what several threads wait for, which takes a tenth of the time
/// of one file after the other; so threads share the files out, if the first of them takes its time.
fn share_out(count: usize, sync: impl Fn(usize) -> io::Result<()> + Sync) -> Result<(), (usize, io::Error)> {
    let next = AtomicUsize::new(0);
    let failed: Mutex<Option<(usize, io::Error)>> = Mutex::new(None);
    let lock = || failed.lock().unwrap_or_else(PoisonError::into_inner);
    let sync_next = || {
        let index = next.fetch_add(1, Ordering::Relaxed);
        if index >= count || lock().is_some() {
            return false;
        }
        match sync(index) {
            Ok(()) => true,
            Err(cause) => {
                lock().get_or_insert((index, cause));
                false
            }
        }
    };
    let start = Instant::now();
    let others = if sync_next() && start.elapsed() >= SLOW_SYNC { count - 1 } else { 0 };
    thread::scope(|scope| {
        for _ in 1..others.min(SYNC_THREADS) {
            let work = || {
                let _registration = host_time::register(Role::Writer);
                while sync_next() {}
            };
            // Without a further thread the others take its files.
            if thread::Builder::new().spawn_scoped(scope, work).is_err() {
                break;
            }
        }
        while sync_next() {}
    });
    failed.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

/// Waits until the names in a folder are on the disk. Does nothing where folders cannot be synchronised.
pub(super) fn sync_folder(path: &Path) -> io::Result<()> {
    use io::ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    let sync = || if cfg!(unix) { File::open(path)?.sync_all() } else { Ok(()) };
    match sync() {
        Err(cause) if !matches!(cause.kind(), InvalidInput | PermissionDenied | Unsupported) => Err(cause),
        _ => {
            record!(SyncFolder(path.to_owned()));
            Ok(())
        }
    }
}

/// Removes a file.
pub(super) fn remove_file(path: &Path) -> io::Result<()> {
    std::fs::remove_file(path)?;
    record!(Remove(path.to_owned()));
    Ok(())
}

/// Removes an empty folder.
pub(super) fn remove_folder(path: &Path) -> io::Result<()> {
    std::fs::remove_dir(path)?;
    record!(Remove(path.to_owned()));
    Ok(())
}

/// The temporary files of this process.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Removes the temporary files of this process before it ends: whoever creates another one afterwards waits until then.
pub fn remove_unfinished() {
    let unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    for path in &*unfinished {
        let _ = std::fs::remove_file(path);
    }
    std::mem::forget(unfinished);
}

/// Lists a temporary file in [`UNFINISHED`] as long as it exists.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.0);
    }
}

/// A file under a temporary name; it is removed when dropped.
pub(super) struct TemporaryFile {
    file: NamedTempFile,
    // Behind the file, which is dropped first.
    _unfinished: Unfinished,
    #[cfg(test)]
    length: u64,
}

impl TemporaryFile {
    /// Creates it in a folder. Its name consists of `prefix`, `random` letters and digits, and `suffix`.
    pub(super) fn create(folder: &Path, prefix: &str, random: usize, suffix: &str) -> io::Result<Self> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(prefix).rand_bytes(random).suffix(suffix);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let (file, unfinished) = {
            let mut all = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
            let file = builder.tempfile_in(folder)?;
            let path = file.path().to_owned();
            all.insert(path.clone());
            (file, Unfinished(path))
        };
        record!(Create(file.path().to_owned()));
        Ok(Self {
            file,
            _unfinished: unfinished,
            #[cfg(test)]
            length: 0,
        })
    }

    /// Waits until its content is on the disk.
    pub(super) fn sync(&self) -> io::Result<()> {
        self.file.as_file().sync_data()?;
        record!(SyncFile(self.file.path().to_owned()));
        Ok(())
    }

    /// Renames it; a file of that name is replaced.
    pub(super) fn rename(self, path: &Path) -> io::Result<()> {
        #[cfg(test)]
        let from = self.file.path().to_owned();
        self.file.persist(path).map_err(|error| error.error)?;
        record!(Rename(from, path.to_owned()));
        Ok(())
    }
}

impl Write for TemporaryFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        record!(Write(self.file.path().to_owned(), self.length, bytes[..written].to_vec()));
        #[cfg(test)]
        {
            self.length += written as u64;
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// A file that grows at its end.
#[derive(Debug)]
pub(super) struct GrowingFile {
    file: File,
    length: u64,
    #[cfg(test)]
    path: std::path::PathBuf,
}

impl GrowingFile {
    /// Opens the file, or creates it, and returns it with its content.
    pub(super) fn open(path: &Path) -> io::Result<(Self, Vec<u8>)> {
        #[cfg(test)]
        let is_new = !path.exists();
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        #[cfg(test)]
        if is_new {
            record!(Create(path.to_owned()));
        }
        let mut content = Vec::new();
        file.read_to_end(&mut content)?;
        let opened = Self {
            file,
            length: content.len() as u64,
            #[cfg(test)]
            path: path.to_owned(),
        };
        Ok((opened, content))
    }

    /// The open file.
    pub(super) const fn file(&self) -> &File {
        &self.file
    }

    /// Cuts it to this length, bytes.
    pub(super) fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.file.set_len(length)?;
        record!(Truncate(self.path.clone(), length));
        self.length = length;
        Ok(())
    }

    /// Appends bytes. On an error the file keeps its length.
    pub(super) fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(self.length))?;
        if let Err(cause) = self.file.write_all(bytes) {
            // A full disk may have accepted a part.
            let _ = self.file.set_len(self.length);
            return Err(cause);
        }
        record!(Write(self.path.clone(), self.length, bytes.to_vec()));
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// Waits until its content is on the disk.
    pub(super) fn sync(&self) -> io::Result<()> {
        self.file.sync_data()?;
        record!(SyncFile(self.path.clone()));
        Ok(())
    }
}

/// Opens a file for reading and writing, or creates it empty.
pub(super) fn open_or_create(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)
}

/// Whether an open file is the one that has this path now.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let id = |file: std::fs::Metadata| (file.dev(), file.ino());
        let (open, there) = (file.metadata().map(id), path.metadata().map(id));
        open.is_ok_and(|open| there.is_ok_and(|there| open == there))
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        path.exists()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn files_that_take_their_time_are_waited_for_together() {
        let (calls, are_together) = (Mutex::new(Vec::new()), AtomicBool::new(false));
        let sync = |index| {
            calls.lock().expect("a list").push(index);
            let start = Instant::now();
            if index == 0 {
                thread::sleep(2 * SLOW_SYNC);
            }
            // Until another thread waits for a file as well.
            while index == 1 && start.elapsed() < Duration::from_secs(20) {
                if calls.lock().expect("a list").len() > 2 {
                    are_together.store(true, Ordering::Relaxed);
                    break;
                }
                thread::yield_now();
            }
            Ok(())
        };
        share_out(20, sync).expect("synchronised");
        let mut calls = calls.into_inner().expect("a list");
        calls.sort_unstable();
        assert_eq!(calls, (0..20).collect::<Vec<_>>(), "each file once");
        assert!(are_together.into_inner());
    }

    #[test]
    fn the_file_that_cannot_be_synchronised_is_named() {
        for slow in [Duration::ZERO, 2 * SLOW_SYNC] {
            let (index, cause) = share_out(9, |index| {
                thread::sleep(slow);
                if index == 4 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
            })
            .expect_err("the disk is full");
            assert_eq!((index, cause.kind()), (4, io::ErrorKind::StorageFull));
        }
        share_out(0, |_| Ok(())).expect("nothing to do");
    }
}
