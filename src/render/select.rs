//! Selection: what of a scene is drawn for one camera and one sun. Plain data.
//! Must not know: wgpu.

pub(crate) mod atlas;
pub mod azimuths;
pub mod caster_grid;
pub(crate) mod casters;
pub(crate) mod draw_list;
pub mod footprint;
pub(crate) mod frustum;
pub mod full_sun;
pub(crate) mod ground_blocks;
pub mod ground_grids;
pub mod ground_light;
pub(crate) mod lane_math;
pub mod lit_rocks;
pub mod near_plane;
pub mod nested_grids;
pub mod rock_cover;
pub mod rock_light;
pub(crate) mod rock_views;
pub(crate) mod sampled_texels;
pub(crate) mod screen_bounds;
pub mod selection;
pub(crate) mod shadow_strip;
pub mod sunlight;
pub mod tiles;
