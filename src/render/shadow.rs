//! What the sun's shadows need: tiles of casters in an atlas, the grid that finds them, the ground's horizon.
//!
//! Each rock whose shadow can fall into the picture is drawn, depth only, into a square of its own whose
//! resolution follows the size of a pixel where its shadow comes nearest to the eye. The ground casts by a map of
//! heights (see [`HorizonMap`]) instead, which needs no bias at grazing sun.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::selection::Frustum;
use super::shaders::CasterTile;
use crate::scene::Scene;
use crate::scene::sky::Sun;
use crate::scene::terrain::Terrain;

/// Texels of a tile per pixel of the picture, where the shadow is seen nearest. With half as many the shadows of
/// boulders on themselves miss their bounds against ray-cast truth.
const TEXELS_PER_PIXEL: f32 = 3.0;
/// Smallest and largest side of a tile, texels; nor is it more than four times the picture's longer side.
const TILE_PX: [u32; 2] = [16, 2048];
/// Columns of the atlas and most rows of one of its layers, texels; all tiles shrink until they fit.
pub const ATLAS_PX: u32 = 4096;
/// Cells along a side of the grid that finds the casters of a place.
pub const CASTER_CELLS: u32 = 128;
/// Samples of the horizon map per cell of the terrain.
const HORIZON_PER_CELL: f32 = 3.0;
/// Most samples along a side of the horizon map.
const HORIZON_MAX: u32 = 2048;
/// Lowest limb that is reckoned with, degrees.
const LOWEST_LIMB_DEG: f64 = 0.01;

/// A caster: a rock whose shadow can be seen.
#[derive(Clone, Copy, Debug)]
pub struct Caster {
    /// Index of the rock in the scene.
    pub rock: usize,
    /// Where it is drawn.
    pub tile: CasterTile,
    /// How far its shadow reaches along the sun's rays from its centre, metres.
    pub reach_m: f32,
}

/// The tiles of every rock that can throw a shadow into the picture, packed into the atlas.
#[must_use]
pub fn casters(scene: &Scene, frustum: &Frustum, size_px: [u32; 2]) -> Vec<Caster> {
    let pixel_angle = 1.0 / scene.camera.focal_px(size_px[0]) as f32;
    let largest_px = (4 * size_px[0].max(size_px[1])).clamp(TILE_PX[0], TILE_PX[1]);
    let lowest_ground_m = scene.terrain.vertices.iter().map(|v| v.position.z).fold(f32::MAX, f32::min);
    let sun = scene.sun.direction;
    let mut casters: Vec<Caster> = scene
        .rocks
        .iter()
        .enumerate()
        .filter_map(|(index, rock)| {
            let drop_m = (rock.centre.z + rock.z_range_m[1] - lowest_ground_m).max(0.0);
            let reach_m = (drop_m / sun.z.max(1e-3)).min(2.0 * scene.terrain.size_m) + rock.radius_m;
            let width_m = rock.radius_m + scene.sun.tan_half_angle() * reach_m;
            let end = rock.centre - reach_m * sun;
            if !frustum.may_see_swept_ball(rock.centre, end, width_m) {
                return None;
            }
            let nearest_m = (distance_to_segment(scene.camera.eye, rock.centre, end) - width_m).max(0.5);
            let texel_m = nearest_m * pixel_angle / TEXELS_PER_PIXEL;
            // A margin of a texel on each side keeps the outline inside the tile.
            let side_px = (2.0 * rock.radius_m / texel_m).ceil() as u32 + 2;
            let half_extent_m = rock.radius_m * 1.02;
            let size_px = side_px.clamp(TILE_PX[0], largest_px) as f32;
            // The icosahedron's edge spans 63 degrees of the sphere, and each level halves it.
            let facet_m = 1.1 * rock.radius_m / (1 << rock.level) as f32;
            let tile =
                CasterTile { centre: rock.centre, half_extent_m, size_px, facet_m, ..Default::default() };
            Some(Caster { rock: index, tile, reach_m })
        })
        .collect();
    while !pack(&mut casters) {
        for caster in &mut casters {
            caster.tile.size_px = (0.8 * caster.tile.size_px).floor().max(4.0);
        }
    }
    casters
}

/// Rows of each of the atlas's layers that these casters need, in steps, so that scenes share atlases.
#[must_use]
pub fn layer_px(casters: &[Caster]) -> u32 {
    let last_row = |caster: &Caster| (caster.tile.origin_px.y + caster.tile.size_px) as u32;
    casters.iter().map(last_row).max().unwrap_or(1).next_multiple_of(512)
}

/// Places the tiles in shelves, largest first; `false` if they do not fit.
fn pack(casters: &mut [Caster]) -> bool {
    let mut order: Vec<usize> = (0..casters.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(casters[i].tile.size_px as u32), i));
    let (mut x, mut y, mut shelf) = (0, 0, 0);
    for i in order {
        let size = casters[i].tile.size_px as u32;
        if x + size > ATLAS_PX {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        if y + size > ATLAS_PX {
            return false;
        }
        casters[i].tile.origin_px = Vec2::new(x as f32, y as f32);
        shelf = shelf.max(size);
        x += size;
    }
    true
}

/// For each cell of a square grid over the terrain, the casters whose shadow can fall on a place above it: first
/// the start of each cell's list (and the end of the last), then the lists.
#[must_use]
pub fn caster_grid(scene: &Scene, casters: &[Caster]) -> Vec<u32> {
    let side = CASTER_CELLS as usize;
    let cell_m = scene.terrain.size_m / CASTER_CELLS as f32;
    let half_diagonal_m = cell_m * std::f32::consts::FRAC_1_SQRT_2;
    let sun = scene.sun.direction;
    let mut lists = vec![Vec::new(); side * side];
    for (index, caster) in casters.iter().enumerate() {
        let start = caster.tile.centre.truncate();
        let end = (caster.tile.centre - caster.reach_m * sun).truncate();
        let radius_m = caster.tile.half_extent_m + scene.sun.tan_half_angle() * caster.reach_m;
        let to_cell =
            |metres: f32| ((metres / scene.terrain.size_m + 0.5) * side as f32).clamp(0.0, side as f32);
        let (low, high) = (start.min(end) - radius_m, start.max(end) + radius_m);
        for row in to_cell(low.y) as usize..to_cell(high.y).ceil() as usize {
            for column in to_cell(low.x) as usize..to_cell(high.x).ceil() as usize {
                let centre =
                    (Vec2::new(column as f32, row as f32) + 0.5) * cell_m - 0.5 * scene.terrain.size_m;
                let distance = distance_to_segment(centre.extend(0.0), start.extend(0.0), end.extend(0.0));
                if distance <= radius_m + half_diagonal_m {
                    lists[row * side + column].push(index as u32);
                }
            }
        }
    }
    let mut grid = Vec::with_capacity(side * side + 1 + lists.iter().map(Vec::len).sum::<usize>());
    let mut start = (side * side + 1) as u32;
    for list in &lists {
        grid.push(start);
        start += list.len() as u32;
    }
    grid.push(start);
    grid.extend(lists.iter().flatten());
    grid
}

/// For places on a grid that is aligned with the sun: from which height each limb of the sun is just seen past
/// all the ground between.
///
/// Along a row, which runs towards the sun, the height falls from sample to sample by the limb's slope, and rises
/// to the ground where that is higher: one running maximum (the horizon map of Max 1988, "Horizon mapping: shadows
/// for bump-mapped surfaces", for a single azimuth, kept as a height so that it serves things above the ground).
#[derive(Clone, Debug)]
pub struct HorizonMap {
    /// World place of sample (0, 0), metres.
    pub origin: Vec2,
    /// Horizontal unit vector towards the sun, along the rows.
    pub towards: Vec2,
    /// Distance between samples, metres.
    pub step_m: f32,
    /// Samples along and across.
    pub size: [u32; 2],
    /// Height for the lower and for the upper limb, metres.
    pub heights_m: Vec<[f32; 2]>,
}

impl HorizonMap {
    /// The map of a ground and a sun. Covers the whole terrain.
    #[must_use]
    pub fn build(terrain: &Terrain, sun: &Sun) -> Self {
        let azimuth = sun.azimuth_deg.to_radians();
        let towards = Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32);
        let across = Vec2::new(-towards.y, towards.x);
        // The turned square that holds the terrain.
        let side_m = terrain.size_m * (towards.x.abs() + towards.y.abs());
        let step_m = (terrain.cell_m() / HORIZON_PER_CELL).max(side_m / (HORIZON_MAX - 2) as f32);
        let samples = (side_m / step_m).ceil() as u32 + 2;
        let origin = -0.5 * (samples - 1) as f32 * step_m * (towards + across);
        let half_disc = 0.5 * sun.angular_diameter_deg;
        let fall_m = [-half_disc, half_disc].map(|offset| {
            let limb = (sun.elevation_deg + offset).clamp(LOWEST_LIMB_DEG, 89.9).to_radians();
            libm::tan(limb) as f32 * step_m
        });
        let mut heights_m = vec![[f32::MIN; 2]; samples as usize * samples as usize];
        let half_m = 0.5 * terrain.size_m;
        heights_m.par_chunks_mut(samples as usize).enumerate().for_each(|(row, heights)| {
            let start = origin + row as f32 * step_m * across;
            let mut limbs = [-1.0e9_f32; 2];
            for (column, height) in heights.iter_mut().enumerate().rev() {
                limbs = [limbs[0] - fall_m[0], limbs[1] - fall_m[1]];
                *height = limbs;
                let place = start + column as f32 * step_m * towards;
                if place.abs().max_element() <= half_m {
                    let ground_m = terrain.surface_height_at(place);
                    limbs = limbs.map(|limb| limb.max(ground_m));
                }
            }
        });
        Self { origin, towards, step_m, size: [samples; 2], heights_m }
    }
}

fn distance_to_segment(point: Vec3, a: Vec3, b: Vec3) -> f32 {
    let ab = b - a;
    let t = ((point - a).dot(ab) / ab.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    point.distance(a + t * ab)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "what is expected may be reckoned with std's functions")]
mod tests {
    use super::*;

    #[test]
    fn horizon_of_a_ridge_falls_with_the_slope_of_each_limb() {
        // A ridge 4 m high along x = 0; the sun stands in the east (azimuth 90).
        let terrain = Terrain::from_height(200.0, 200, Vec::new(), |p| (4.0 - p.x.abs()).max(0.0));
        let sun = Sun::new(17.0, 90.0, 0.53, Vec3::ONE);
        let map = HorizonMap::build(&terrain, &sun);
        // Beyond 13 m the shadow of the ridge has met the ground.
        for x in [-5.0_f32, -8.0, -12.0] {
            let column = ((x - map.origin.x) / map.step_m).round();
            let row = (map.size[1] / 2) as usize;
            let at = map.origin.x + column * map.step_m;
            let [lower, upper] = map.heights_m[row * map.size[0] as usize + column as usize];
            for (height, limb_deg) in [(lower, 17.0 - 0.265), (upper, 17.0 + 0.265)] {
                let expected = 4.0 + at * f64::to_radians(limb_deg).tan() as f32;
                assert!((height - expected).abs() < 0.15, "x = {at}: {height} m for {expected} m");
            }
        }
    }

    #[test]
    fn tiles_do_not_overlap_and_lie_in_the_atlas() {
        let mut casters: Vec<Caster> = (0..200)
            .map(|i| Caster {
                rock: i,
                tile: CasterTile { size_px: (16 + (i * 37) % 150) as f32, ..Default::default() },
                reach_m: 0.0,
            })
            .collect();
        assert!(pack(&mut casters));
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
