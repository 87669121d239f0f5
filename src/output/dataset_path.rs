//! Paths of files below a folder: never out of it, and never through a link.
//!
//! Must not know: which files a dataset has.

use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

use twox_hash::XxHash3_128;

use crate::error::{Error, Result};
use crate::input::{self, MIB};

/// Why a text is not the path of a file below a folder, with `/` between its parts; `None` if it is one.
#[must_use]
pub fn problem(path: &str) -> Option<&'static str> {
    if path.is_empty() {
        return Some("it is empty");
    }
    if path.contains(['\0', '\\']) {
        return Some("it contains a NUL or a backslash");
    }
    if path.starts_with('/') || Path::new(path).is_absolute() {
        return Some("it is absolute");
    }
    path.split('/').find_map(|part| match part {
        "" => Some("a part of it is empty"),
        "." | ".." => Some("it contains `.` or `..`"),
        _ => None,
    })
}

/// The first link among the folders between `folder` and the file at `path` below it; `None` if there is none.
#[must_use]
pub fn linked_folder(folder: &Path, path: &str) -> Option<PathBuf> {
    let (parents, _) = path.rsplit_once('/')?;
    let mut below = folder.to_owned();
    parents.split('/').find_map(|part| {
        below.push(part);
        below.is_symlink().then(|| below.clone())
    })
}

/// The file at `path` below `folder`; with the cause if the path leads out of the folder.
fn below(folder: &Path, path: &str) -> std::result::Result<PathBuf, (PathBuf, std::io::Error)> {
    let full = folder.join(path);
    match problem(path) {
        None => Ok(full),
        Some(problem) => {
            let message = format!("`{path}` is not the path of a file below {}: {problem}", folder.display());
            Err((full, std::io::Error::other(message)))
        }
    }
}

/// Where to write the file at `path` below `folder`. A link at that very place is replaced, not followed.
///
/// # Errors
/// [`Error::Write`] if the path leads out of the folder, or through a link.
pub fn for_writing(folder: &Path, path: &str) -> Result<PathBuf> {
    let refused = |(path, cause)| Error::Write { path, cause };
    let full = below(folder, path).map_err(refused)?;
    match linked_folder(folder, path) {
        Some(link) => {
            let message = format!("{} is a symbolic link, which is not followed", link.display());
            Err(refused((full, std::io::Error::other(message))))
        }
        None => Ok(full),
    }
}

/// Where to read the file at `path` below `folder`, which need not exist.
///
/// # Errors
/// [`Error::Read`] if the path leads out of the folder, or if it or a folder on the way is a link.
pub fn for_reading(folder: &Path, path: &str) -> Result<PathBuf> {
    let refused = |(path, cause)| Error::Read { path, cause };
    let full = below(folder, path).map_err(refused)?;
    match linked_folder(folder, path).or_else(|| full.is_symlink().then(|| full.clone())) {
        Some(link) => {
            let link = link.display();
            let message =
                format!("{link} is a symbolic link, which is not followed; replace it by what it leads to");
            Err(refused((full, std::io::Error::other(message))))
        }
        None => Ok(full),
    }
}

/// The path of a file directly in a dataset's folder, which may itself be a link while the file may not.
///
/// # Errors
/// As [`for_reading`].
pub fn own_file(path: &Path) -> Result<PathBuf> {
    let folder = path.parent().unwrap_or(Path::new(""));
    for_reading(folder, path.file_name().and_then(|name| name.to_str()).unwrap_or_default())
}

/// Checks a file directly in a dataset's folder that is to be opened for writing: if it exists, it is a regular one.
///
/// # Errors
/// [`Error::Write`].
pub fn check_own_file(path: &Path) -> Result<()> {
    let Ok(found) = path.symlink_metadata() else { return Ok(()) };
    let kind =
        if found.is_symlink() { Some("a symbolic link") } else { input::special_kind(found.file_type()) };
    kind.map_or(Ok(()), |kind| {
        let cause = std::io::Error::other(format!("it is {kind}, not a regular file; delete it"));
        Err(Error::Write { path: path.to_owned(), cause })
    })
}

/// Refuses to read one folder and write another if one of them contains the other, or both are the same.
///
/// # Errors
/// [`Error::Usage`].
pub fn check_apart(source: &Path, out: &Path) -> Result<()> {
    let (read, written) = (resolved(source), resolved(out));
    if !read.starts_with(&written) && !written.starts_with(&read) {
        return Ok(());
    }
    let how = if read == written { "are the same folder" } else { "contain each other" };
    Err(Error::Usage(format!(
        "--out {} and the folder that is read, {}, {how}; choose another --out",
        out.display(),
        source.display()
    )))
}

/// The path without links, as far as it exists.
fn resolved(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let existing = path.ancestors().find_map(|ancestor| Some((ancestor, ancestor.canonicalize().ok()?)));
    let Some((ancestor, canonical)) = existing else { return path };
    let below = path.strip_prefix(ancestor).unwrap_or(Path::new(""));
    below.components().fold(canonical, |mut whole, part| {
        match part {
            Component::ParentDir => drop(whole.pop()),
            part => whole.push(part),
        }
        whole
    })
}

/// Largest size of a file of a frame with images of this size: 64 bytes a pixel, and a list of 65535 rocks.
#[must_use]
pub fn max_frame_file_bytes([width, height]: [u32; 2]) -> u64 {
    64 * MIB + 64 * u64::from(width) * u64::from(height)
}

/// Size and content hash of the regular file at `path` below `folder`, which is not read into memory at once.
///
/// # Errors
/// Those of [`for_reading`] and of [`input::open`].
pub fn hash(folder: &Path, path: &str) -> Result<(u64, String)> {
    let path = for_reading(folder, path)?;
    let mut file = input::open(&path)?;
    let mut hash = XxHash3_128::new();
    let (mut bytes, mut size) = (vec![0; MIB as usize], 0);
    loop {
        match file.read(&mut bytes) {
            Ok(0) => return Ok((size, format!("{:032x}", hash.finish_128()))),
            Ok(length) => {
                hash.write(&bytes[..length]);
                size += length as u64;
            }
            Err(cause) if cause.kind() == std::io::ErrorKind::Interrupted => {}
            Err(cause) => return Err(Error::Read { path, cause }),
        }
    }
}

/// The content of the regular file at `path` below `folder`, of at most `max_bytes`.
///
/// # Errors
/// Those of [`for_reading`] and of [`input::read`].
pub fn read(folder: &Path, path: &str, max_bytes: u64) -> Result<Vec<u8>> {
    input::read(&for_reading(folder, path)?, max_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_below_the_folder_are_accepted() {
        for good in ["a.png", "rgb/rgb_00000.png", ".parts/000000001.tar", "a/b/c", "..a", "a..", "~"] {
            assert_eq!(problem(good), None, "{good}");
        }
        for wrong in [
            "",
            ".",
            "..",
            "../evil",
            "a/../b",
            "a/..",
            "/etc/passwd",
            "//x",
            "a//b",
            "a/",
            "./a",
            "a/.",
            "a\0b",
            "..\\evil",
            "\\\\server\\share",
            "C:\\x",
        ] {
            assert!(problem(wrong).is_some(), "{wrong}");
            let folder = Path::new("/nonexistent");
            assert!(for_writing(folder, wrong).is_err() && read(folder, wrong, 9).is_err());
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().expect("a folder");
        let (root, outside) = (folder.path().join("root"), folder.path().join("outside"));
        for path in [root.join("a"), outside.clone()] {
            std::fs::create_dir_all(path).expect("created");
        }
        std::fs::write(outside.join("secret"), "secret").expect("written");
        symlink(&outside, root.join("a/link")).expect("a link");
        symlink(outside.join("secret"), root.join("a/file")).expect("a link");
        for path in ["a/link/secret", "a/link/new/file"] {
            let message = for_writing(&root, path).expect_err(path).to_string();
            assert!(message.contains("a/link is a symbolic link"), "{message}");
            assert!(read(&root, path, 9).is_err());
        }
        assert!(for_writing(&root, "a/file").is_ok(), "it would be replaced");
        assert!(read(&root, "a/file", 9).expect_err("a link").to_string().contains("not followed"));
        // The folder itself may be a link.
        symlink(&root, folder.path().join("named")).expect("a link");
        std::fs::write(root.join("a/own"), "own").expect("written");
        assert_eq!(read(&folder.path().join("named"), "a/own", 9).expect("read"), b"own");
        let expected = (3, crate::output::disk::content_hash(b"own"));
        assert_eq!(hash(&root, "a/own").expect("read"), expected);
        assert!(hash(&root, "a/file").is_err());
    }
}
