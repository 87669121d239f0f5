//! Lighting: from the G-buffer to radiance and class, in one draw for each shading bin.
//! Must not know: how visibility was found.

pub mod gbuffer;
pub mod pass;
pub mod relief_bands;
pub mod slopes_host;
