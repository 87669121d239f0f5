//! What is computed on the host after the readback: rock labels, the sun's glare, the sensor, the label rule, hazard maps.
//! Must not know: wgpu.

pub mod amodal;
pub mod hardware;
pub mod hazards;
mod image_rays;
pub mod label_policy;
pub mod rock_labels;
pub mod sensor;
pub mod sun_glare;
mod sun_share;
