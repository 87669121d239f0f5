//! Resolve: from samples to pixels.
//! Must not know: a scene.

pub mod pass;
pub mod tile_list;
pub mod tone;
pub mod unpack;
