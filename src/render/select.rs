//! Selection: what of a scene is drawn for one camera and one sun. Plain data.
//! Must not know: wgpu.

pub mod atlas;
pub mod casters;
pub mod footprint;
pub mod near_plane;
pub mod selection;
