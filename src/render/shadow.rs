//! Shadow maps: of rocks by midpoint shadow maps, of the ground by its horizon.
//! Must not know: what is visible.

pub mod device;
pub mod horizon;
pub mod host;
