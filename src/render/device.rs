//! What the passes share on the device: layouts of bind groups, structs that shaders read, timestamps, shading bins.
//! Must not know: a scene.

pub(crate) mod bind_groups;
pub(crate) mod depth;
pub(crate) mod light_table;
pub(crate) mod packing;
pub(crate) mod planes;
#[cfg(test)]
mod shader_constants;
pub mod shader_programs;
pub mod shader_structs;
pub(crate) mod shading_bins;
mod specialisation;
pub(crate) mod timing;
