//! Selection: what of a scene is drawn for one camera and one sun. Plain data.
//! Must not know: wgpu.

pub mod atlas;
pub mod caster_grid;
pub mod casters;
pub mod draw_list;
pub mod footprint;
pub mod frustum;
pub mod ground_blocks;
pub mod near_plane;
pub mod screen_bounds;
pub mod selection;
