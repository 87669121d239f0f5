//! A text file to which whole lines are appended.
//!
//! Must not know: what the lines mean.

use std::path::{Path, PathBuf};

use super::operations::{GrowingFile, failed, is_at};
use crate::error::Result;
use crate::output::dataset_path;

/// A text file to which whole lines are appended. Opening it cuts off an incomplete last line of a killed process.
#[derive(Debug)]
pub struct LineFile {
    file: GrowingFile,
    path: PathBuf,
}

impl LineFile {
    /// Opens the file, or creates it. The name of a new file is on the disk once its folder is synchronised.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn open(path: &Path) -> Result<Self> {
        dataset_path::check_own_file(path)?;
        let open = || {
            let (mut file, content) = GrowingFile::open(path)?;
            let whole = content.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
            if whole < content.len() {
                file.truncate(whole as u64)?;
            }
            Ok(file)
        };
        Ok(Self { file: open().map_err(failed(path))?, path: path.to_owned() })
    }

    /// Appends a line in one write.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write); then no part of the line is in the file.
    pub fn append(&mut self, line: &str) -> Result<()> {
        self.file.append(format!("{line}\n").as_bytes()).map_err(failed(&self.path))
    }

    /// Waits until all lines are on the disk.
    ///
    /// # Errors
    /// [`Error::Write`](crate::Error::Write).
    pub fn sync(&self) -> Result<()> {
        self.file.sync().map_err(failed(&self.path))
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file at its path is still this one: neither removed nor replaced, in a folder that still has its name.
    #[must_use]
    pub fn is_in_place(&self) -> bool {
        is_at(self.file.file(), &self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_replaced_removed_or_moved_file_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let data = folder.path().join("data");
        for change in [
            (|data| std::fs::remove_file(data.join("lines"))) as fn(&Path) -> std::io::Result<()>,
            |data| {
                std::fs::write(data.join("new"), "")?;
                std::fs::rename(data.join("new"), data.join("lines"))
            },
            |data| std::fs::rename(data, data.with_extension("old")),
        ] {
            std::fs::create_dir_all(&data).expect("a folder");
            let file = LineFile::open(&data.join("lines")).expect("opened");
            assert!(file.is_in_place());
            change(&data).expect("changed");
            assert!(!file.is_in_place());
        }
    }
}
