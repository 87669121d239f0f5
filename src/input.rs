//! Reading files that anybody may have written: only regular files, and only up to a bound.
//!
//! A FIFO blocks for ever, a device such as `/dev/zero` has no end, and opening some devices has effects: none of them is
//! opened.
//! Must not know: what the bytes mean.

pub mod json;

use std::fs::{File, FileType};
use std::io::{BufRead as _, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// One binary megabyte, bytes.
pub const MIB: u64 = 1 << 20;

/// What some editors put before text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Opens a regular file, or what a link to one leads to.
///
/// # Errors
/// [`Error::Read`], also for a folder, a FIFO, a device and a socket, which are not opened.
pub fn open(path: &Path) -> Result<File> {
    try_open(path, false).map_err(|cause| Error::Read { path: path.to_owned(), cause })
}

fn try_open(path: &Path, may_be_pipe: bool) -> std::io::Result<File> {
    check_kind(std::fs::metadata(path)?.file_type(), may_be_pipe)?;
    let file = File::open(path)?;
    // Another file may have taken its name meanwhile.
    check_kind(file.metadata()?.file_type(), may_be_pipe)?;
    Ok(file)
}

/// Refuses everything but regular files and, if allowed, pipes.
fn check_kind(kind: FileType, may_be_pipe: bool) -> std::io::Result<()> {
    if kind.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    match special_kind(kind) {
        None => Ok(()),
        Some(FIFO) if may_be_pipe => Ok(()),
        Some(name) => Err(std::io::Error::other(format!("it is {name}, not a regular file"))),
    }
}

/// What a pipe is called, with a name in a folder or without.
const FIFO: &str = "a FIFO";

/// What a special file is called; `None` for regular files, folders and links.
#[must_use]
pub fn special_kind(kind: FileType) -> Option<&'static str> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if kind.is_fifo() {
            return Some(FIFO);
        }
        if kind.is_char_device() || kind.is_block_device() {
            return Some("a device");
        }
        if kind.is_socket() {
            return Some("a socket");
        }
    }
    (!kind.is_file() && !kind.is_dir() && !kind.is_symlink()).then_some("a special file")
}

/// The content of a regular file of at most `max_bytes`.
///
/// # Errors
/// [`Error::Read`].
pub fn read(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let read = || {
        let file = try_open(path, false)?;
        let size = file.metadata()?.len();
        if size > max_bytes { Err(too_large(Some(size), max_bytes)) } else { read_bounded(file, max_bytes) }
    };
    read().map_err(|cause| Error::Read { path: path.to_owned(), cause })
}

/// The text of a file that the user named: a regular file, a pipe (as the shell passes in `<(...)`), or, for `-`, standard
/// input. At most `max_bytes`, also of a pipe; without a byte order mark.
///
/// # Errors
/// Those of the operating system; invalid UTF-8; a device, which is not opened.
pub fn read_named_text(path: &Path, max_bytes: u64) -> std::io::Result<String> {
    let mut bytes = if path.as_os_str() == "-" {
        read_bounded(std::io::stdin().lock(), max_bytes)?
    } else {
        read_bounded(try_open(path, true)?, max_bytes)?
    };
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        std::io::Error::new(
            std::io::ErrorKind::InvalidData,
            format!("it is not text in UTF-8 (byte {at} is not valid)"),
        )
    })
}

fn read_bounded(source: impl Read, max_bytes: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large(None, max_bytes)) } else { Ok(bytes) }
}

fn too_large(size: Option<u64>, max_bytes: u64) -> std::io::Error {
    let size = size.map_or_else(|| "more".to_owned(), |size| format!("{size} bytes"));
    std::io::Error::new(
        std::io::ErrorKind::FileTooLarge,
        format!("it has {size}, and such a file has at most {max_bytes} bytes"),
    )
}

/// The lines of a regular file, one at a time, each of bounded length.
#[derive(Debug)]
pub struct Lines {
    path: PathBuf,
    reader: BufReader<File>,
    max_bytes: u64,
    /// Number of the last line read, from 1.
    number: u64,
}

impl Lines {
    /// Opens a file whose lines have at most `max_bytes`.
    ///
    /// # Errors
    /// Those of [`open`].
    pub fn open(path: &Path, max_bytes: u64) -> Result<Self> {
        Ok(Self { path: path.to_owned(), reader: BufReader::new(open(path)?), max_bytes, number: 0 })
    }

    /// Replaces the content of `line` with the next line and its newline, which the last line may lack. Returns the line's
    /// number from 1; `None` at the end.
    ///
    /// # Errors
    /// [`Error::Read`], also for a line that is too long.
    pub fn next_into(&mut self, line: &mut Vec<u8>) -> Result<Option<u64>> {
        line.clear();
        let mut bounded = self.reader.by_ref().take(self.max_bytes.saturating_add(1));
        let read = bounded.read_until(b'\n', line);
        self.number += 1;
        let failed = |cause| Err(Error::Read { path: self.path.clone(), cause });
        match read {
            Err(cause) => failed(cause),
            Ok(0) => Ok(None),
            Ok(length) if length as u64 > self.max_bytes => failed(std::io::Error::new(
                std::io::ErrorKind::FileTooLarge,
                format!("line {} has more than {} bytes", self.number, self.max_bytes),
            )),
            Ok(_) => Ok(Some(self.number)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_bound() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 10]).expect("written");
        assert_eq!(read(&path, 10).expect("read"), [7; 10]);
        let message = read(&path, 9).expect_err("too large").to_string();
        assert!(message.contains("10 bytes") && message.contains("at most 9 bytes"), "{message}");
        let message = read(folder.path(), 9).expect_err("a folder").to_string();
        assert!(message.contains("directory"), "{message}");
        assert!(read_named_text(&path, 9).is_err() && read_named_text(&path, 10).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn special_files_are_not_opened() {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).expect("a socket");
        let fifo = folder.path().join("fifo");
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().expect("mkfifo").success());
        let zero = Path::new("/dev/zero");
        for (path, kind) in [(socket.as_path(), "a socket"), (&fifo, "a FIFO"), (zero, "a device")] {
            let message = read(path, MIB).expect_err(kind).to_string();
            assert!(message.contains(kind) && message.contains(&path.display().to_string()), "{message}");
            assert!(Lines::open(path, MIB).is_err());
        }
        assert!(read_named_text(zero, MIB).is_err() && read_named_text(&socket, MIB).is_err());
    }

    #[test]
    fn lines_have_numbers_and_a_bound() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lines");
        std::fs::write(&path, b"one\n\xff\xfe\n\nlonger than that\nlast").expect("written");
        let mut lines = Lines::open(&path, 8).expect("opened");
        let mut line = Vec::new();
        for (number, expected) in [(1, &b"one\n"[..]), (2, b"\xff\xfe\n"), (3, b"\n")] {
            assert_eq!(lines.next_into(&mut line).expect("read"), Some(number));
            assert_eq!(line, expected);
        }
        let message = lines.next_into(&mut line).expect_err("too long").to_string();
        assert!(message.contains("line 4 has more than 8 bytes"), "{message}");
    }
}
