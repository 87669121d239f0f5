//! From the planes of a frame to the bytes of a file: one module for each file format.
//!
//! Must not know: file names, folders, the disk.
//! To add an encoder: a function from [`EncodeInput`] to bytes in the module of its format, and a row in
//! [`OUTPUTS`](crate::output::OUTPUTS).

pub(super) mod exr;
pub(crate) mod json;
mod label_sets;
pub(crate) mod npy;
pub(crate) mod png;
pub(super) mod values;

use serde_json::Value;

use super::edges::MaskIds;
use super::label_ids::LabelIds;
use crate::frame::Frame;

/// What the encoders read.
#[derive(Clone, Copy, Debug)]
pub struct EncodeInput<'a> {
    /// The planes.
    pub frame: &'a Frame,
    /// Content of the frame's JSON file.
    pub meta: &'a Value,
    /// The numbering of the classes in the mask.
    pub label_ids: LabelIds,
    /// The mask of the frame as it is written.
    pub mask: &'a MaskIds,
}

impl EncodeInput<'_> {
    /// The class ids under the edge policy.
    fn classes(&self) -> &[u8] {
        self.mask.of(self.frame)
    }
}
