//! Locks on files. The system releases those of a process that ends, however it ends.
//!
//! Must not know: what is locked.

use std::fs::{File, TryLockError};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use super::operations::{failed, is_at, open_or_create};
use crate::error::Result;
use crate::output::dataset_path;

/// How often a lock file that another process removed is opened again.
const ATTEMPTS_MAX: usize = 1000;

/// A lock on a file, exclusive or shared, released on drop. On a file system without locks every attempt succeeds.
///
/// A process that was forked from this one has it too. There a drop changes nothing, and here it releases the lock for both.
#[derive(Debug)]
pub struct Lock {
    file: File,
    path: PathBuf,
    is_held: bool,
    /// The process that took it.
    process: u32,
}

impl Lock {
    /// The lock for this process alone; `None` if another process has it.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn try_exclusive(path: &Path) -> Result<Option<Self>> {
        Self::acquire(path, File::try_lock)
    }

    /// The lock together with other processes that share it; `None` if another process has it for itself.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn try_shared(path: &Path) -> Result<Option<Self>> {
        Self::acquire(path, File::try_lock_shared)
    }

    /// The lock for this process alone; waits until no other process has it.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn wait(path: &Path) -> Result<Self> {
        loop {
            if let Some(lock) = Self::acquire(path, |file| file.lock().map_err(TryLockError::Error))? {
                return Ok(lock);
            }
        }
    }

    fn acquire(
        path: &Path,
        lock: impl Fn(&File) -> std::result::Result<(), TryLockError>,
    ) -> Result<Option<Self>> {
        for attempt in 1.. {
            dataset_path::check_own_file(path)?;
            let file = open_or_create(path).map_err(failed(path))?;
            let is_held = match lock(&file) {
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(_)) => false,
                Ok(()) => true,
            };
            // The process that had the lock may have removed the file: then the lock protects nothing.
            if !is_held || is_at(&file, path) || attempt == ATTEMPTS_MAX {
                let process = std::process::id();
                return Ok(Some(Self { file, path: path.to_owned(), is_held, process }));
            }
        }
        Ok(None)
    }

    /// Whether no other process can have the lock: false on a file system without locks.
    #[must_use]
    pub const fn is_held(&self) -> bool {
        self.is_held
    }

    /// The text in the lock file.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn text(&mut self) -> Result<String> {
        let read = |file: &mut File| {
            file.seek(SeekFrom::Start(0))?;
            std::io::read_to_string(file)
        };
        read(&mut self.file).map_err(failed(&self.path))
    }

    /// Replaces the text in the lock file.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn set_text(&mut self, text: &str) -> Result<()> {
        let write = |file: &mut File| {
            file.set_len(0)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(text.as_bytes())
        };
        write(&mut self.file).map_err(failed(&self.path))
    }

    /// Removes the lock file and releases the lock. Only for an exclusive lock.
    pub fn remove(self) {
        // The path may lead elsewhere by now, if the folder was renamed.
        if self.is_held && self.is_of_this_process() && is_at(&self.file, &self.path) {
            let _ = std::fs::remove_file(&self.path);
        }
    }

    fn is_of_this_process(&self) -> bool {
        self.process == std::process::id()
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing the file would leave the lock with any process that was forked meanwhile, if only to start another program.
        if self.is_held && self.is_of_this_process() {
            let _ = self.file.unlock();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_is_exclusive_or_shared_and_ends_on_drop() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let exclusive = || Lock::try_exclusive(&path).expect("a file");
        let shared = || Lock::try_shared(&path).expect("a file");
        let held = exclusive().expect("free");
        assert!(exclusive().is_none() && shared().is_none(), "taken");
        drop(held);
        let (first, second) = (shared().expect("free"), shared().expect("shared"));
        assert!(exclusive().is_none(), "taken");
        drop((first, second));
        assert!(exclusive().is_some(), "free again");
    }

    #[test]
    fn a_lock_ends_although_a_forked_process_has_its_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let lock = Lock::wait(&path).expect("a file");
        let of_child = lock.file.try_clone().expect("a descriptor");
        drop(lock);
        let mut again = Lock::try_exclusive(&path).expect("a file").expect("free");
        drop(of_child);
        assert!(Lock::try_exclusive(&path).expect("a file").is_none(), "taken again");
        // As that process has it.
        again.process += 1;
        let file = again.file.try_clone().expect("a descriptor");
        again.remove();
        assert!(is_at(&file, &path) && Lock::try_exclusive(&path).expect("a file").is_none(), "kept");
        drop(file);
        assert!(Lock::try_exclusive(&path).expect("a file").is_some(), "free again");
    }

    #[test]
    fn a_lock_on_a_removed_file_does_not_count() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let first = Lock::wait(&path).expect("a file");
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| Lock::wait(&path).expect("a file"));
            // The other thread waits for the file that is now removed, and must then lock the new one.
            std::thread::sleep(std::time::Duration::from_millis(50));
            first.remove();
            let second = waiting.join().expect("a lock");
            assert!(Lock::try_exclusive(&path).expect("a file").is_none(), "the new file is locked");
            drop(second);
        });
    }
}
