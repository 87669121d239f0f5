//! Lighting: from the G-buffer to radiance and class, in one draw for each shading bin, in one for all, or in a compute pass.
//! Must not know: how visibility was found.

pub(crate) mod compute;
pub(crate) mod crater_rays_host;
pub(crate) mod detail_sums;
pub(crate) mod frame_key;
pub(crate) mod gbuffer;
pub(crate) mod grain_texture_host;
pub(crate) mod grains_host;
pub(crate) mod ground_batch;
pub(crate) mod pass;
pub(crate) mod pits_host;
pub mod relief_bands;
pub(crate) mod slopes_host;
pub(crate) mod waves_host;
