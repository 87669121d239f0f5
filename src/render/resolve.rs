//! Resolve: from samples to pixels.
//! Must not know: a scene.

pub(crate) mod assemble;
#[cfg(test)]
mod lens_check;
pub mod pass;
mod tile_list;
pub mod tone;
mod unpack;
