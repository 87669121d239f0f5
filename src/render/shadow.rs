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
pub const CASTER_CELLS: u32 = 512;
/// Set in the start of a cell's list if the ground may hide the sun from a place above the cell.
pub const ASK_HORIZON: u32 = 1 << 31;
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
/// the start of each cell's list (and the end of the last), with [`ASK_HORIZON`] where the horizon map is to be asked
/// too, then the lists.
#[must_use]
pub fn caster_grid(scene: &Scene, casters: &[Caster], horizon: &HorizonMap) -> Vec<u32> {
    let side = CASTER_CELLS as usize;
    let cells = CasterCells::new(&scene.terrain);
    let mut lists: Vec<(u32, u32)> = Vec::new();
    for (index, caster) in casters.iter().enumerate() {
        cells.shaded_by(scene, caster, |cell| lists.push((cell, index as u32)));
    }
    // By cell; within a cell the casters keep their order.
    let mut counts = vec![0_u32; side * side];
    for &(cell, _) in &lists {
        counts[cell as usize] += 1;
    }
    let mut asks = vec![false; side * side];
    for place in &horizon.shaded {
        let at = |metres: f32| cells.place(metres).min(side - 1);
        let (low, high) = (*place - 1.5 * horizon.step_m, *place + 1.5 * horizon.step_m);
        for row in at(low.y)..=at(high.y) {
            asks[row * side + at(low.x)..=row * side + at(high.x)].fill(true);
        }
    }
    let first = (side * side + 1) as u32;
    let mut grid = Vec::with_capacity(first as usize + lists.len());
    let mut start = first;
    for (count, asks) in counts.iter_mut().zip(asks) {
        grid.push(if asks { start | ASK_HORIZON } else { start });
        let end = start + *count;
        *count = start;
        start = end;
    }
    grid.push(start);
    grid.resize(start as usize, 0);
    for (cell, index) in lists {
        grid[counts[cell as usize] as usize] = index;
        counts[cell as usize] += 1;
    }
    grid
}

/// The geometry of the caster grid.
struct CasterCells<'a> {
    terrain: &'a Terrain,
    cell_m: f32,
    origin_m: f32,
}

impl<'a> CasterCells<'a> {
    fn new(terrain: &'a Terrain) -> Self {
        Self { terrain, cell_m: terrain.size_m / CASTER_CELLS as f32, origin_m: -0.5 * terrain.size_m }
    }

    /// Column or row of a coordinate, which may lie outside.
    fn place(&self, metres: f32) -> usize {
        ((metres - self.origin_m) / self.cell_m).clamp(0.0, CASTER_CELLS as f32) as usize
    }

    /// Gives every cell that the shadow of a caster can touch above the ground.
    fn shaded_by(&self, scene: &Scene, caster: &Caster, mut give: impl FnMut(u32)) {
        let sun = &scene.sun;
        let away = -sun.direction.truncate();
        // The steepness of the rays that reach furthest: those of the lower limb.
        let lowest = (sun.direction.z - sun.tan_half_angle()).max(1e-4);
        let (steepness, away) = if away.length() > 1e-6 {
            (lowest / away.length(), away / away.length())
        } else {
            (1e6, Vec2::X)
        };
        let rock = &scene.rocks[caster.rock];
        let (centre, extent_m) = (caster.tile.centre, caster.tile.half_extent_m);
        let top_m = centre.z + rock.z_range_m[1];
        let half_diagonal_m = self.cell_m * std::f32::consts::FRAC_1_SQRT_2;
        let penumbra = sun.tan_half_angle();
        let start = centre.truncate();
        let end = (centre - caster.reach_m * sun.direction).truncate();
        let widest_m = extent_m + penumbra * caster.reach_m;
        let (low, high) = (start.min(end) - widest_m, start.max(end) + widest_m);
        for row in self.place(low.y)..(self.place(high.y) + 1).min(CASTER_CELLS as usize) {
            for column in self.place(low.x)..(self.place(high.x) + 1).min(CASTER_CELLS as usize) {
                let middle = (Vec2::new(column as f32, row as f32) + 0.5) * self.cell_m + self.origin_m;
                let along_m = (middle - start).dot(away);
                let across_m = (middle - start).perp_dot(away).abs();
                let nearest_m = (along_m - half_diagonal_m).max(0.0);
                let furthest_m = (along_m + half_diagonal_m).max(0.0);
                let width_m =
                    extent_m + 2.0 * penumbra * (furthest_m + extent_m) * (1.0 + steepness.min(10.0));
                if across_m > width_m + half_diagonal_m || along_m < -(extent_m + half_diagonal_m) {
                    continue;
                }
                // The highest ray that can have passed the rock falls below the ground somewhere.
                let ray_m = top_m - (nearest_m - extent_m).max(0.0) * steepness;
                if ray_m >= self.lowest_ground_m(column, row) {
                    give((row * CASTER_CELLS as usize + column) as u32);
                }
            }
        }
    }

    /// A height that the ground of a cell does not fall below.
    fn lowest_ground_m(&self, column: usize, row: usize) -> f32 {
        let per_cell = self.terrain.cells as f32 / CASTER_CELLS as f32;
        let last = self.terrain.cells as usize;
        let span = |cell: usize| {
            let low = (cell as f32 * per_cell - 1e-3).max(0.0) as usize;
            low..=(((cell + 1) as f32 * per_cell + 1e-3).ceil() as usize).min(last)
        };
        let heights = span(row).flat_map(|row| {
            let first = row * (last + 1);
            span(column).map(move |column| self.terrain.vertices[first + column].position.z)
        });
        heights.fold(f32::INFINITY, f32::min)
    }
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
    /// Places, metres, within [`Self::step_m`] of which the ground may hide any of the sun from what lies on it or above.
    pub shaded: Vec<Vec2>,
}

impl HorizonMap {
    /// The map of a ground and a sun over a region, given by its corners in the world: what is seen. Samples lie
    /// where they would in a map of the whole terrain, and have the values that they would have there.
    #[must_use]
    pub fn build(terrain: &Terrain, sun: &Sun, corners: &[Vec2]) -> Self {
        let azimuth = sun.azimuth_deg.to_radians();
        let towards = Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32);
        let across = Vec2::new(-towards.y, towards.x);
        // The turned square that holds the terrain.
        let side_m = terrain.size_m * (towards.x.abs() + towards.y.abs());
        let step_m = (terrain.cell_m() / HORIZON_PER_CELL).max(side_m / (HORIZON_MAX - 2) as f32);
        let samples = (side_m / step_m).ceil() as usize + 2;
        let whole_origin = -0.5 * (samples - 1) as f32 * step_m * (towards + across);
        let half_disc = 0.5 * sun.angular_diameter_deg;
        let fall_m = [-half_disc, half_disc].map(|offset| {
            let limb = (sun.elevation_deg + offset).clamp(LOWEST_LIMB_DEG, 89.9).to_radians();
            libm::tan(limb) as f32 * step_m
        });
        // The samples around the region.
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for corner in corners {
            let offset = (*corner - whole_origin) / step_m;
            let at = Vec2::new(offset.dot(towards), offset.dot(across));
            (low, high) = (low.min(at), high.max(at));
        }
        let first = |at: f32| (at.floor() - 1.0).clamp(0.0, (samples - 2) as f32) as usize;
        let end = |at: f32| (at.ceil() + 2.0).clamp(2.0, samples as f32) as usize;
        let (columns, rows) = (first(low.x)..end(high.x), first(low.y)..end(high.y));
        let (columns, rows) =
            (columns.start..columns.end.max(columns.start + 2), rows.start..rows.end.max(rows.start + 2));
        // No ground is so high that it would hide the sun from further off than this.
        let heights = terrain.vertices.iter().map(|vertex| vertex.position.z);
        let (lowest_m, highest_m) =
            heights.fold((f32::MAX, f32::MIN), |(low, high), z| (low.min(z), high.max(z)));
        let reach = ((highest_m - lowest_m) / fall_m[0].max(1e-6)).ceil().min(samples as f32) as usize + 2;
        let last = (columns.end + reach).min(samples);
        let half_m = 0.5 * terrain.size_m;
        let mut heights_m = vec![[f32::MIN; 2]; columns.len() * rows.len()];
        let bends = Bends::new(terrain, step_m);
        let lines = heights_m.par_chunks_mut(columns.len()).zip(rows.clone());
        let shaded = lines.map(|(heights, row)| {
            let start = whole_origin + row as f32 * step_m * across;
            let mut limbs = [-1.0e9_f32; 2];
            let mut shaded = Vec::new();
            for column in (columns.start..last).rev() {
                limbs = [limbs[0] - fall_m[0], limbs[1] - fall_m[1]];
                let place = start + column as f32 * step_m * towards;
                let ground_m = if place.abs().max_element() <= half_m {
                    terrain.surface_height_at(place)
                } else {
                    f32::MIN
                };
                if columns.contains(&column) {
                    heights[column - columns.start] = limbs;
                    if ground_m > f32::MIN && ground_m - limbs[0] <= bends.at(place) {
                        shaded.push(place);
                    }
                }
                limbs = limbs.map(|limb| limb.max(ground_m));
            }
            shaded
        });
        let shaded: Vec<Vec2> = shaded.collect::<Vec<_>>().into_iter().flatten().collect();
        let origin = whole_origin + step_m * (columns.start as f32 * towards + rows.start as f32 * across);
        Self { origin, towards, step_m, size: [columns.len() as u32, rows.len() as u32], heights_m, shaded }
    }
}

/// For each cell of a terrain, how far its ground may lie below the straight course between places a step apart.
///
/// Along a line the ground is straight but for kinks where it crosses the triangles' edges; a kink by J (change of
/// slope) within a step of length s takes it at most J s / 4 off the straight line. Two axes make twice that; the three
/// kinds of edges are added up over the cells around.
struct Bends {
    cells: usize,
    cell_m: f32,
    half_m: f32,
    bends_m: Vec<f32>,
}

impl Bends {
    fn new(terrain: &Terrain, step_m: f32) -> Self {
        let (cells, row_len) = (terrain.cells as usize, terrain.cells as usize + 1);
        let last = row_len - 1;
        let height = |column: usize, row: usize| terrain.vertices[row * row_len + column].position.z;
        // Changes of slope at a vertex, times a cell: along both axes and the diagonal.
        let kinks_at = |column: usize, row: usize| {
            let (west, east) = (column.saturating_sub(1), (column + 1).min(last));
            let (south, north) = (row.saturating_sub(1), (row + 1).min(last));
            let middle = 2.0 * height(column, row);
            (height(west, row) + height(east, row) - middle).abs()
                + (height(column, south) + height(column, north) - middle).abs()
                + (height(west, south) + height(east, north) - middle).abs()
        };
        // Largest over two cells each way: first along rows, then along columns.
        let wide = |at: usize, end: usize| at.saturating_sub(1)..=(at + 2).min(end);
        let scale = 0.5 * step_m / terrain.cell_m();
        let rows: Vec<Vec<f32>> = (0..row_len)
            .into_par_iter()
            .map(|row| {
                let kinks: Vec<f32> = (0..row_len).map(|column| scale * kinks_at(column, row)).collect();
                (0..cells).map(|column| wide(column, last).map(|c| kinks[c]).fold(0.0, f32::max)).collect()
            })
            .collect();
        let bends_m = (0..cells * cells)
            .into_par_iter()
            .map(|cell| wide(cell / cells, last).map(|row| rows[row][cell % cells]).fold(0.0, f32::max))
            .collect();
        Self { cells, cell_m: terrain.cell_m(), half_m: 0.5 * terrain.size_m, bends_m }
    }

    fn at(&self, place: Vec2) -> f32 {
        let cell = |metres: f32| (((metres + self.half_m) / self.cell_m) as usize).min(self.cells - 1);
        self.bends_m[cell(place.y) * self.cells + cell(place.x)]
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
        let corners =
            [Vec2::splat(-100.0), Vec2::splat(100.0), Vec2::new(-100.0, 100.0), Vec2::new(100.0, -100.0)];
        let map = HorizonMap::build(&terrain, &sun, &corners);
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
