//! Files in memory, before anything is written to disk.
//!
//! Must not know: what the bytes mean.

/// A file's path and content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Artifact {
    /// Path below the output folder, with `/` between its parts.
    pub name: String,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Which of its outputs' files a file of a frame is: with split and index, all that a layout needs to give it a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileKind {
    /// Name of the output that it belongs to, as in `--outputs`.
    pub output: &'static str,
    /// The part of its file name before the frame number.
    pub stem: &'static str,
    /// File name extension, without the dot.
    pub extension: &'static str,
}

/// One encoded file of a frame, before a layout gives it a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedFile {
    /// Name of the output that it belongs to, as in `--outputs`.
    pub output: &'static str,
    /// The part of its file name before the frame number.
    pub stem: &'static str,
    /// File name extension, without the dot.
    pub extension: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

impl EncodedFile {
    /// Its kind.
    #[must_use]
    pub const fn kind(&self) -> FileKind {
        FileKind { output: self.output, stem: self.stem, extension: self.extension }
    }

    /// The file under its BasicWriter name, as written for a single frame.
    #[must_use]
    pub fn into_artifact(self, index: u64) -> Artifact {
        Artifact { name: frame_file_name(self.stem, index, self.extension), bytes: self.bytes }
    }
}

/// File name in Replicator's BasicWriter scheme: stem, frame number with at least four digits, extension.
#[must_use]
pub fn frame_file_name(stem: &str, index: u64, extension: &str) -> String {
    format!("{stem}_{index:04}.{extension}")
}
