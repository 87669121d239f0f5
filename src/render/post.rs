//! What is computed on the host after the readback: rock labels, hazard maps, the sun's glare, the sensor.
//! Must not know: wgpu.

pub mod amodal;
pub mod hazards;
pub mod rock_labels;
pub mod sensor;
pub mod sun_glare;
mod sun_share;
