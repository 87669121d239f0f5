//! A machine to look at: its files and its environment.
//!
//! Everything is read below a root folder, so that tests can build machines out of files.
//! Must not know: what the files mean.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// A machine to look at: its files below a root folder and its environment.
#[derive(Debug)]
pub struct Machine {
    root: PathBuf,
    variables: BTreeMap<String, String>,
    open: fn(&Path) -> io::Result<()>,
}

impl Machine {
    /// This machine; tests set `REGOLITH_MACHINE` to a folder that looks like the root of another.
    #[must_use]
    pub fn here() -> Self {
        let root = std::env::var_os("REGOLITH_MACHINE").map_or_else(|| PathBuf::from("/"), PathBuf::from);
        let variables = std::env::vars_os();
        let variables =
            variables.filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
        Self::new(&root, variables.collect(), |path| std::fs::File::open(path).map(drop))
    }

    /// A machine whose files are below `root`. `open` says whether a device file can be opened.
    #[must_use]
    pub fn new(root: &Path, variables: BTreeMap<String, String>, open: fn(&Path) -> io::Result<()>) -> Self {
        Self { root: root.to_owned(), variables, open }
    }

    /// Why a file cannot be opened; `None` if it can.
    pub(crate) fn refusal(&self, path: &str) -> Option<String> {
        (self.open)(&self.path(path)).err().map(|error| error.to_string())
    }

    /// Every variable.
    pub(crate) const fn variables(&self) -> &BTreeMap<String, String> {
        &self.variables
    }

    pub(crate) fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    pub(crate) fn exists(&self, path: &str) -> bool {
        self.path(path).exists()
    }

    /// Text of a small file; empty if it cannot be read.
    pub(crate) fn text(&self, path: &str) -> String {
        std::fs::read(self.path(path))
            .map(|bytes| String::from_utf8_lossy(&bytes).trim().to_owned())
            .unwrap_or_default()
    }

    /// Names in a folder, sorted; none if it cannot be listed.
    pub(crate) fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder)).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort_unstable();
        names
    }

    /// The last component of the target of a symbolic link.
    pub(crate) fn link(&self, path: &str) -> Option<String> {
        let target = std::fs::read_link(self.path(path)).ok()?;
        Some(target.file_name()?.to_string_lossy().into_owned())
    }

    pub(crate) fn variable(&self, name: &str) -> Option<&str> {
        self.variables.get(name).map(String::as_str).filter(|value| !value.is_empty())
    }
}
