//! What the passes share on the device: layouts of bind groups, structs that shaders read, timestamps, shading bins.
//! Must not know: a scene.

pub mod bind_groups;
pub mod depth;
pub mod light_table;
pub mod packing;
pub mod planes;
pub mod shader_programs;
pub mod shader_structs;
pub mod shading_bins;
pub mod timing;
