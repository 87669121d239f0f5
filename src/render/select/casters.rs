//! Shadow casters: which rocks can cast a shadow into the image, and the tile of the shadow atlas that each is drawn into.
//!
//! Each caster is drawn, depth only, into a square tile of its own (a fitted, per-object shadow map; Real-Time Rendering, 4th ed.,
//! section 7.4). The resolution of the tile follows the size of a pixel where the shadow comes nearest to the eye. The ground
//! casts its shadows by a horizon map instead ([`crate::render::shadow::horizon`]), which needs no bias at a grazing sun.
//! Must not know: how tiles are drawn.

use glam::{UVec2, Vec3};
use rayon::prelude::*;

use crate::render::device::shader_structs::CasterTile;
use crate::render::select::atlas::AtlasAllocator;
use crate::render::select::frustum::Frustum;
use crate::scene::Scene;
use crate::scene::rocks::Rock;

/// Texels of a tile per pixel of the image, where the shadow is nearest to the eye.
const TEXELS_PER_PIXEL: f32 = 3.0;
/// The same of rocks that are in view themselves. With fewer their shadows on themselves, which the sun grazes, miss their bound against
/// ray-traced truth.
const TEXELS_PER_PIXEL_IN_VIEW: f32 = 6.0;
/// Side up to which tiles have these: the larger a rock is in an image, the fewer of its pixels are at edges of shadows. Without this limit,
/// as many pixels are wrong in images of 256 and 512 pixels, and a fifth fewer of those of 1024.
const MAX_FINER_TILE_PX: f32 = 512.0;
/// Minimum distance from the eye for which tiles are resolved, metres.
const MIN_DISTANCE_M: f32 = 0.5;
/// Rocks of the surface stage cast no shadow if they, and their shadows on level ground, span fewer pixels, from where the shadow comes
/// nearest to the eye: many rocks of a dense field under a high sun.
const MIN_SHADOW_PX: f32 = 1.0;
/// Smallest and largest side of a tile, texels. The side is also at most four times the longer side of the image.
const TILE_PX: [u32; 2] = [16, 2048];
/// Texels of a tile that depths from 0 to 1 span along the sun: the side of the largest. Stands in `shadow.wgsl` too.
pub(crate) const DEPTH_RANGE_PX: f32 = TILE_PX[1] as f32;
/// Maximum columns of the atlas and rows of one of its layers, texels; fewer where textures are smaller. All tiles shrink until they fit.
const ATLAS_PX: u32 = 4096;
/// Minimum rocks of a task: fewer are not worth a thread.
const MIN_ROCKS_PER_TASK: usize = 64;
/// Minimum columns of the atlas, texels.
const MIN_ATLAS_PX: u32 = 512;

/// A shadow caster: a rock whose shadow may be visible.
#[derive(Clone, Copy, Debug)]
pub struct Caster {
    /// Index of the rock in the scene.
    pub rock: usize,
    /// Its tile of the shadow atlas, and the light-space bounds of the caster there.
    pub tile: CasterTile,
    /// Length of its shadow volume along the sun's rays, from the centre of the rock, metres.
    pub reach_m: f32,
}

/// Bounds of the shadow volume of a rock whose highest point is at `top_m`: its length along the sun's rays from the centre of the
/// rock, and half of its width at the far end, with the penumbra, metres.
#[must_use]
pub(crate) fn shadow_extent_m(scene: &Scene, top_m: f32, radius_m: f32) -> (f32, f32) {
    let [lowest_ground_m, _] = scene.terrain.z_range_m;
    let drop_m = (top_m - lowest_ground_m).max(0.0);
    // Rays from the lower limb fall least.
    let along_m = drop_m / (scene.sun.direction.z - scene.sun.tan_half_angle()).max(1e-3);
    let reach_m = along_m.min(2.0 * (2.0 * scene.terrain.half_extent_m)) + radius_m;
    (reach_m, radius_m + scene.sun.tan_half_angle() * reach_m)
}

/// The casters among `rocks` (with their indices in the scene) whose shadow volume intersects the frustum, with their tiles packed
/// into the atlas, which fits into a texture of `max_texture_px` columns and rows. Nothing in view is nearer to the eye than
/// `nearest_visible_m`, which bounds their resolution.
#[must_use]
pub(crate) fn select_casters(
    scene: &Scene,
    rocks: &[(usize, &Rock)],
    frustum: &Frustum,
    (size_px, nearest_visible_m): ([u32; 2], f32),
    max_texture_px: u32,
) -> Vec<Caster> {
    let pixel_angle = 1.0 / scene.camera.focal_px(size_px[0]) as f32;
    let largest_px = size_px[0].max(size_px[1]).saturating_mul(4).clamp(TILE_PX[0], TILE_PX[1]);
    let sun = scene.sun.direction;
    let min_shadow_px = if scene.relief.is_some() { MIN_SHADOW_PX } else { 0.0 };
    // Length of a shadow on level ground, in heights; at least 1, for the width.
    let shadow_lengths = (sun.truncate().length() / sun.z.max(1e-3)).max(1.0);
    let (mut casters, plain_px): (Vec<Caster>, Vec<f32>) = rocks
        .par_iter()
        .with_min_len(MIN_ROCKS_PER_TASK)
        .filter_map(|&(index, rock)| {
            let top_m = rock.centre.z + rock.z_range_m[1];
            let (mut reach_m, width_m) = shadow_extent_m(scene, top_m, rock.radius_m);
            let reaches_view = |reach_m: f32| {
                frustum.intersects_swept_sphere(rock.centre, rock.centre - reach_m * sun, width_m)
            };
            let nearest_m = |reach_m: f32| {
                let end = rock.centre - reach_m * sun;
                let to_shadow_m = distance_to_segment(scene.camera.eye, rock.centre, end) - width_m;
                to_shadow_m.max(nearest_visible_m).max(MIN_DISTANCE_M)
            };
            let is_speck = |nearest_m: f32| {
                2.0 * rock.radius_m * shadow_lengths < min_shadow_px * pixel_angle * nearest_m
            };
            if !reaches_view(reach_m) || is_speck(nearest_m(reach_m)) {
                return None;
            }
            if let Some(ground) = scene.terrain.range() {
                reach_m = ground.shadow_reach_m(&scene.sun, rock.centre, top_m, rock.radius_m, reach_m);
                if !reaches_view(reach_m) {
                    return None;
                }
            }
            let nearest_m = nearest_m(reach_m);
            if is_speck(nearest_m) {
                return None;
            }
            let size_px = |texels_per_pixel: f32, nearest_m: f32| {
                let texel_m = nearest_m * pixel_angle / texels_per_pixel;
                // A margin of a texel on each side keeps the outline inside the tile.
                let side_px = quantized_side((2.0 * rock.radius_m / texel_m).ceil() as u32 + 2);
                side_px.clamp(TILE_PX[0], largest_px) as f32
            };
            let plain_px = size_px(TEXELS_PER_PIXEL, nearest_m);
            let size_px = if frustum.intersects_sphere(rock.centre, rock.radius_m) {
                let to_rock_m = rock.centre.distance(scene.camera.eye) - rock.radius_m;
                let finer_px = size_px(TEXELS_PER_PIXEL_IN_VIEW, to_rock_m.max(MIN_DISTANCE_M));
                plain_px.max(finer_px.min(MAX_FINER_TILE_PX))
            } else {
                plain_px
            };
            let half_extent_m = rock.radius_m * 1.02;
            // An edge of the icosahedron spans 63 degrees of the sphere, and each level of subdivision halves it.
            let edge_m = 1.1 * rock.radius_m / (1 << rock.level) as f32;
            let tile =
                CasterTile { centre: rock.centre, half_extent_m, size_px, edge_m, ..Default::default() };
            Some((Caster { rock: index, tile, reach_m }, plain_px))
        })
        .unzip();
    while !pack(&mut casters, max_texture_px) {
        shrink(&mut casters, &plain_px);
    }
    casters
}

/// Makes tiles smaller: as long as there are some, those that have more texels than [`TEXELS_PER_PIXEL`] gives them, `plain_px` along a
/// side; then all.
fn shrink(casters: &mut [Caster], plain_px: &[f32]) {
    let mut sizes = casters.iter().map(|caster| caster.tile.size_px).zip(plain_px);
    let some_are_finer = sizes.any(|(size_px, plain_px)| size_px > *plain_px);
    for (caster, plain_px) in casters.iter_mut().zip(plain_px) {
        let min_px = if some_are_finer { *plain_px } else { 4.0 };
        let size_px = &mut caster.tile.size_px;
        *size_px = (0.8 * *size_px).floor().max(min_px).min(*size_px);
    }
}

/// Rounds the side of a tile up to one of eight sizes per octave, so that tiles keep their size while the camera hardly moves.
const fn quantized_side(side_px: u32) -> u32 {
    let step_px = side_px.next_power_of_two() / 16;
    if step_px == 0 { side_px } else { side_px.next_multiple_of(step_px) }
}

/// Columns of the atlas, and rows of each of its layers, that these casters need. Rounded up, so that scenes share textures.
#[must_use]
pub(crate) fn atlas_size_px(casters: &[Caster]) -> [u32; 2] {
    let last_row = |caster: &Caster| (caster.tile.origin_px.y + caster.tile.size_px) as u32;
    [width_px(casters), casters.iter().map(last_row).max().unwrap_or(1).next_multiple_of(128)]
}

/// Columns that make a layer of the atlas about as wide as it is high.
fn width_px(casters: &[Caster]) -> u32 {
    let sides = || casters.iter().map(|caster| caster.tile.size_px as u32);
    let area: u64 = sides().map(|side| u64::from(side) * u64::from(side)).sum();
    let width = (area.isqrt() as u32).max(sides().max().unwrap_or(0));
    width.next_power_of_two().clamp(MIN_ATLAS_PX, ATLAS_PX)
}

/// Packs the tiles into the atlas, largest first; `false` if they do not fit. A texture has two layers, one below the other.
fn pack(casters: &mut [Caster], max_texture_px: u32) -> bool {
    let columns_px = width_px(casters);
    let mut atlas = AtlasAllocator::new([columns_px, ATLAS_PX.min(max_texture_px / 2)]);
    let fits_all = largest_first(casters).into_iter().all(|caster| {
        let tile = &mut casters[caster].tile;
        let allocation = atlas.allocate([tile.size_px as u32; 2]);
        if let Some(allocation) = allocation {
            tile.origin_px = UVec2::from(allocation.corner).as_vec2();
        }
        allocation.is_some()
    });
    fits_all && columns_px <= max_texture_px
}

/// Indices of the casters, those with the largest tiles first.
#[must_use]
pub(crate) fn largest_first(casters: &[Caster]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..casters.len()).collect();
    order.sort_by_key(|&caster| std::cmp::Reverse(casters[caster].tile.size_px as u32));
    order
}

/// Distance of a point from the line segment between `a` and `b`.
fn distance_to_segment(point: Vec3, a: Vec3, b: Vec3) -> f32 {
    let ab = b - a;
    let t = ((point - a).dot(ab) / ab.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    point.distance(a + t * ab)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::render::settings::DEFAULT_TEXTURE_PX;

    #[test]
    fn shadows_reach_as_far_as_rays_from_the_lower_limb() {
        for (elevation_deg, diameter_deg) in [(1.0_f64, 0.53), (3.0, 2.0), (17.0, 5.0)] {
            let mut config = Config::new();
            for (knob, value) in [("elevation_deg", elevation_deg), ("angular_diameter_deg", diameter_deg)] {
                config.apply_set(&format!("sun.{knob}={value}")).expect("a knob");
            }
            let scene = Scene::build(3, &config.draw(3).expect("drawn")).expect("built");
            let top_m = scene.terrain.z_range_m[0] + 0.8;
            let (reach_m, _) = shadow_extent_m(&scene, top_m, 0.4);
            let furthest_m = 0.8 / (elevation_deg - 0.5 * diameter_deg).to_radians().tan();
            let way_m = f64::from(reach_m) * elevation_deg.to_radians().cos();
            assert!(way_m >= furthest_m, "{elevation_deg} deg: {way_m} of {furthest_m} m");
        }
    }

    /// What rocks in view have more costs no other shadow a texel.
    #[test]
    fn finer_tiles_shrink_first() {
        let mut casters: Vec<Caster> = [100.0, 50.0, 16.0]
            .map(|size_px| Caster {
                rock: 0,
                tile: CasterTile { size_px, ..Default::default() },
                reach_m: 0.0,
            })
            .into();
        let mut sizes = |times: usize| {
            (0..times).for_each(|_| shrink(&mut casters, &[70.0, 50.0, 16.0]));
            casters.iter().map(|caster| caster.tile.size_px).collect::<Vec<_>>()
        };
        assert_eq!(sizes(1), [80.0, 50.0, 16.0]);
        assert_eq!(sizes(1), [70.0, 50.0, 16.0]);
        assert_eq!(sizes(1), [56.0, 40.0, 12.0]);
        assert_eq!(sizes(20), [4.0; 3]);
    }

    #[test]
    fn tiles_do_not_overlap_and_lie_inside_the_atlas() {
        let mut casters: Vec<Caster> = (0..200)
            .map(|i| Caster {
                rock: i,
                tile: CasterTile { size_px: (16 + (i * 37) % 150) as f32, ..Default::default() },
                reach_m: 0.0,
            })
            .collect();
        assert!(!pack(&mut casters, 1024), "too many for half as many rows");
        assert!(pack(&mut casters, DEFAULT_TEXTURE_PX));
        for (i, a) in casters.iter().enumerate() {
            let far = a.tile.origin_px + a.tile.size_px;
            assert!(far.max_element() <= ATLAS_PX as f32);
            for b in &casters[i + 1..] {
                let apart = |axis: usize| {
                    a.tile.origin_px[axis] + a.tile.size_px <= b.tile.origin_px[axis]
                        || b.tile.origin_px[axis] + b.tile.size_px <= a.tile.origin_px[axis]
                };
                assert!(apart(0) || apart(1));
            }
        }
    }
}
