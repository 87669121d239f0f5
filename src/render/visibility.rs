//! Visibility: the nearest surface in each sample, written to the G-buffer.
//! Must not know: lighting.

pub mod device;
pub mod geometry;
pub mod host;
pub mod meshes;
