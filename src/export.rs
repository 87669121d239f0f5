//! The scene as files for other programs, one module for each format.
//!
//! A file holds the authored triangles, or exactly those that a frame draws.
//! Must not know: where bytes are written.
//! To add a format: a file in `export/` with a function from [`Stage`] to bytes, a row in [`Format::ALL`], an arm in
//! [`export`].

mod gltf;
mod npz;
mod sky;
mod stage;
mod usd;

use std::path::Path;

use crate::error::{Error, Result};
pub use stage::{Detail, Stage};

/// A file format for scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// NumPy arrays.
    Npz,
    /// Binary glTF 2.0.
    Glb,
    /// OpenUSD as text.
    Usda,
    /// OpenUSD as a binary crate file.
    Usdc,
}

impl Format {
    /// Every format with its extension.
    pub const ALL: [(Self, &'static str); 4] =
        [(Self::Npz, "npz"), (Self::Glb, "glb"), (Self::Usda, "usda"), (Self::Usdc, "usdc")];

    /// The format of a file by its extension.
    ///
    /// # Errors
    /// [`Error::Usage`] for any other.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        let known = Self::ALL.iter().find(|(_, known)| extension.as_deref() == Some(*known));
        known.map(|(format, _)| *format).ok_or_else(|| {
            let names: Vec<String> = Self::ALL.iter().map(|(_, name)| format!(".{name}")).collect();
            Error::Usage(format!(
                "{}: the extension selects the format; use one of {}",
                path.display(),
                names.join(", ")
            ))
        })
    }
}

/// Encodes a stage.
///
/// # Errors
/// [`Error::Encode`].
pub fn export(stage: &Stage<'_>, format: Format) -> Result<Vec<u8>> {
    match format {
        Format::Npz => npz::encode(stage),
        Format::Glb => gltf::encode(stage),
        Format::Usda => usd::encode_text(stage),
        Format::Usdc => usd::encode_crate(stage),
    }
}
