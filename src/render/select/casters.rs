//! What the rocks' shadows need: tiles of casters in an atlas, and the grids that find them.
//!
//! Each rock whose shadow can fall into the picture is drawn, depth only, into a square of its own whose
//! resolution follows the size of a pixel where its shadow comes nearest to the eye. The ground casts by a map of
//! heights ([`crate::render::shadow::horizon`]) instead, which needs no bias at grazing sun.

use std::ops::Range;

use glam::{UVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::render::device::shader_structs::CasterTile;
use crate::render::select::atlas::Atlas;
use crate::render::select::footprint::Footprint;
use crate::render::select::selection::Frustum;
use crate::render::shadow::horizon::HorizonMap;
use crate::reuse::Reused;
use crate::scene::Scene;
use crate::scene::rocks::Rock;
use crate::scene::sky::Sun;
use crate::scene::terrain::{Layout, Terrain};

/// Texels of a tile per pixel of the picture, where the shadow is seen nearest. With half as many the shadows of
/// boulders on themselves miss their bounds against ray-cast truth.
const TEXELS_PER_PIXEL: f32 = 3.0;
/// Smallest and largest side of a tile, texels; nor is it more than four times the picture's longer side.
const TILE_PX: [u32; 2] = [16, 2048];
/// Most columns of the atlas and most rows of one of its layers, texels; all tiles shrink until they fit.
pub const ATLAS_PX: u32 = 4096;
/// Fewest columns.
const LEAST_ATLAS_PX: u32 = 512;
/// Cells along a side of the grid that finds the casters of a place, over a square of ground.
pub const CASTER_CELLS: u32 = 512;
/// The same for each of the grids over rings.
const RING_CASTER_CELLS: u32 = 192;
/// Half the side of the innermost grid over rings, metres.
const INNERMOST_M: f32 = 4.0;
/// Rows of a grid that are looked at by one thread.
const BAND_ROWS: usize = 32;
/// Set in the start of a cell's list if the ground may hide the sun from a place above the cell.
pub const ASK_HORIZON: u32 = 1 << 31;

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

/// How far the shadow of a rock whose highest point is at `top_m` reaches along the sun's rays from its centre, and half of how wide
/// it is there, metres.
#[must_use]
pub fn reach_m(scene: &Scene, top_m: f32, radius_m: f32) -> (f32, f32) {
    let [lowest_ground_m, _] = scene.terrain.z_range_m;
    let drop_m = (top_m - lowest_ground_m).max(0.0);
    let along_m = drop_m / scene.sun.direction.z.max(1e-3);
    let reach_m = along_m.min(2.0 * (2.0 * scene.terrain.half_extent_m)) + radius_m;
    (reach_m, radius_m + scene.sun.tan_half_angle() * reach_m)
}

/// The tiles of those of `rocks` (with their indices) that can throw a shadow into the picture, packed into the atlas.
#[must_use]
pub fn casters(scene: &Scene, rocks: &[(usize, &Rock)], frustum: &Frustum, size_px: [u32; 2]) -> Vec<Caster> {
    let pixel_angle = 1.0 / scene.camera.focal_px(size_px[0]) as f32;
    let largest_px = (4 * size_px[0].max(size_px[1])).clamp(TILE_PX[0], TILE_PX[1]);
    let sun = scene.sun.direction;
    let mut casters: Vec<Caster> = rocks
        .iter()
        .filter_map(|&(index, rock)| {
            let (reach_m, width_m) = reach_m(scene, rock.centre.z + rock.z_range_m[1], rock.radius_m);
            let end = rock.centre - reach_m * sun;
            if !frustum.may_see_swept_ball(rock.centre, end, width_m) {
                return None;
            }
            let nearest_m = (distance_to_segment(scene.camera.eye, rock.centre, end) - width_m).max(0.5);
            let texel_m = nearest_m * pixel_angle / TEXELS_PER_PIXEL;
            // A margin of a texel on each side keeps the outline inside the tile.
            let side_px = in_steps((2.0 * rock.radius_m / texel_m).ceil() as u32 + 2);
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

/// Not smaller, and one of eight sizes to each that is twice as large: a tile stays what it is while the camera hardly moves.
const fn in_steps(side_px: u32) -> u32 {
    let step_px = side_px.next_power_of_two() / 16;
    if step_px == 0 { side_px } else { side_px.next_multiple_of(step_px) }
}

/// Columns of the atlas, and rows of each of its layers, that these casters need, in steps, so that scenes share
/// atlases.
#[must_use]
pub fn atlas_px(casters: &[Caster]) -> [u32; 2] {
    let last_row = |caster: &Caster| (caster.tile.origin_px.y + caster.tile.size_px) as u32;
    [width_px(casters), casters.iter().map(last_row).max().unwrap_or(1).next_multiple_of(128)]
}

/// Columns that make a layer of the atlas about as wide as it is high.
fn width_px(casters: &[Caster]) -> u32 {
    let sides = || casters.iter().map(|caster| caster.tile.size_px as u32);
    let area: u64 = sides().map(|side| u64::from(side) * u64::from(side)).sum();
    let width = (area.isqrt() as u32).max(sides().max().unwrap_or(0));
    width.next_power_of_two().clamp(LEAST_ATLAS_PX, ATLAS_PX)
}

/// Places the tiles, largest first; `false` if they do not fit.
fn pack(casters: &mut [Caster]) -> bool {
    let mut atlas = Atlas::new([width_px(casters), ATLAS_PX]);
    largest_first(casters).into_iter().all(|caster| {
        let tile = &mut casters[caster].tile;
        let room = atlas.place(tile.size_px as u32);
        if let Some(room) = room {
            tile.origin_px = UVec2::from(room.corner).as_vec2();
        }
        room.is_some()
    })
}

/// Casters by their numbers, those with the largest tiles first.
#[must_use]
pub fn largest_first(casters: &[Caster]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..casters.len()).collect();
    order.sort_by_key(|&caster| std::cmp::Reverse(casters[caster].tile.size_px as u32));
    order
}

/// What can occlude the sun at a surface. The values are those of `SHADES` in `shaders/surface.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShadowSources {
    /// Nothing: a surface that faces the sun sees all of it.
    None,
    /// Other ground, by the horizon map.
    Ground,
    /// Rocks, by the shadow atlas.
    Rocks,
    /// Both.
    GroundAndRocks,
}

impl ShadowSources {
    /// Every variant, in the order of its value.
    pub const ALL: [Self; 4] = [Self::None, Self::Ground, Self::Rocks, Self::GroundAndRocks];

    /// Whether rocks are among them.
    #[must_use]
    pub const fn has_rocks(self) -> bool {
        matches!(self, Self::Rocks | Self::GroundAndRocks)
    }
}

/// Square grids over the ground, each over twice the side of the one before: which casters a place asks.
#[derive(Clone, Copy, Debug)]
pub struct CasterGrids {
    /// Centre of all, metres.
    pub centre: Vec2,
    /// Half the side of the first, metres.
    pub half_m: f32,
    /// Cells along a side of each.
    pub cells: u32,
    /// How many there are.
    pub levels: u32,
}

impl CasterGrids {
    /// The grids over a ground: one for a square.
    #[must_use]
    pub fn new(terrain: &Terrain) -> Self {
        let (centre, reach_m) = (terrain.centre, terrain.half_extent_m);
        match terrain.layout {
            Layout::Square => Self { centre, half_m: reach_m, cells: CASTER_CELLS, levels: 1 },
            Layout::Rings(_) => {
                let mut levels = 1;
                while reach_m > INNERMOST_M * (1_u32 << (levels - 1)) as f32 {
                    levels += 1;
                }
                Self { centre, half_m: INNERMOST_M, cells: RING_CASTER_CELLS, levels }
            }
        }
    }

    /// What can shade what lies in a box (its lowest and highest corner, seen from above, metres).
    #[must_use]
    pub fn shadow_sources_over(&self, grid: &[u32], low: Vec2, high: Vec2) -> ShadowSources {
        let (from, to) = (low - self.centre, high - self.centre);
        let nearest = Vec2::ZERO.clamp(from, to).abs().max_element();
        let furthest = from.abs().max(to.abs()).max_element();
        let (mut has_casters, mut asks_horizon) = (false, false);
        for level in 0..self.levels {
            let half_m = self.half_m * (1_u32 << level) as f32;
            // A little more, for a device may choose the grid of a place at their borders otherwise than we.
            let serves = (level == 0 || furthest * 1.001 >= 0.5 * half_m)
                && (level + 1 == self.levels || nearest <= 1.001 * half_m);
            if !serves {
                continue;
            }
            let per_m = 0.5 * self.cells as f32 / half_m;
            let place = |metres: f32| (metres + half_m) * per_m;
            let first =
                |metres: f32| (place(metres) - 1e-3).floor().clamp(0.0, (self.cells - 1) as f32) as u32;
            let last =
                |metres: f32| (place(metres) + 1e-3).floor().clamp(0.0, (self.cells - 1) as f32) as u32;
            for row in first(from.y)..=last(to.y) {
                for column in first(from.x)..=last(to.x) {
                    let cell = ((level * self.cells + row) * self.cells + column) as usize;
                    has_casters |= grid[cell] & !ASK_HORIZON != grid[cell + 1] & !ASK_HORIZON;
                    asks_horizon |= grid[cell] & ASK_HORIZON != 0;
                }
            }
        }
        match (has_casters, asks_horizon) {
            (false, false) => ShadowSources::None,
            (false, true) => ShadowSources::Ground,
            (true, false) => ShadowSources::Rocks,
            (true, true) => ShadowSources::GroundAndRocks,
        }
    }

    /// Cells of one grid.
    const fn cells_each(&self) -> usize {
        (self.cells * self.cells) as usize
    }

    /// Cells of all grids.
    #[must_use]
    pub const fn cells_in_all(&self) -> usize {
        self.cells_each() * self.levels as usize
    }
}

/// For each cell of the grids that lies in a footprint, the casters whose shadow can fall on a place above it: first the start of
/// each cell's list (and the end of the last), with [`ASK_HORIZON`] where the horizon map is to be asked too, then the lists.
#[must_use]
pub fn caster_grid(
    scene: &Scene,
    casters: &[Caster],
    horizon: &HorizonMap,
    footprint: &Footprint,
) -> Reused<u32> {
    let grids = CasterGrids::new(&scene.terrain);
    let bands = (0..grids.levels)
        .flat_map(|level| (0..grids.cells as usize).step_by(BAND_ROWS).map(move |row| (level, row)));
    let lists_of = |(level, first): (u32, usize)| {
        let rows = first..(first + BAND_ROWS).min(grids.cells as usize);
        CasterCells::new(&scene.terrain, &grids, level, rows, footprint).lists(scene, casters)
    };
    let bands: Vec<_> = bands.collect();
    let (lists, asks) = rayon::join(
        || bands.into_par_iter().with_max_len(1).map(lists_of).collect::<Vec<Lists>>(),
        || asks_horizon(&grids, horizon),
    );
    let first = grids.cells_in_all() + 1;
    let listed: usize = lists.iter().map(|lists| lists.casters.len()).sum();
    let mut grid: Reused<u32> = Reused::of_any(first + listed);
    let (mut starts, mut rest) = grid.split_at_mut(first);
    let (mut start, mut asks) = (first as u32, &asks[..]);
    let mut parts = Vec::new();
    for lists in &lists {
        let (own, others) = starts.split_at_mut(lists.ends.len());
        let (listed, behind) = rest.split_at_mut(lists.casters.len());
        let (ask, not_yet) = asks.split_at(lists.ends.len());
        parts.push((lists, start, own, ask, listed));
        start += lists.casters.len() as u32;
        (starts, rest, asks) = (others, behind, not_yet);
    }
    starts[0] = start;
    parts.into_par_iter().for_each(|(lists, start, starts, asks, listed)| {
        // A list begins where the one before ends.
        if let Some((first, others)) = starts.split_first_mut() {
            *first = start;
            for (place, end) in others.iter_mut().zip(&lists.ends) {
                *place = start + end;
            }
        }
        for (place, ask) in starts.iter_mut().zip(asks) {
            *place |= if *ask == YES { ASK_HORIZON } else { 0 };
        }
        listed.copy_from_slice(&lists.casters);
    });
    grid
}

const NO: u8 = 0;
const YES: u8 = 1;

/// Of each cell, whether the ground may hide any of the sun above it.
fn asks_horizon(grids: &CasterGrids, horizon: &HorizonMap) -> Reused<u8> {
    // Rings have relief everywhere.
    let mut asks = Reused::filled(grids.cells_in_all(), if grids.levels > 1 { YES } else { NO });
    if grids.levels == 1 {
        let side = grids.cells as usize;
        let (origin, cell_m) = (grids.centre - grids.half_m, 2.0 * grids.half_m / grids.cells as f32);
        let at = |metres: f32, axis: usize| place(metres - origin[axis], cell_m, side).min(side - 1);
        let margin = Vec2::splat(1.5 * horizon.levels[0].step_m);
        for place in &horizon.shaded {
            let (low, high) = (*place - margin, *place + margin);
            for row in at(low.y, 1)..=at(high.y, 1) {
                asks[row * side + at(low.x, 0)..=row * side + at(high.x, 0)].fill(YES);
            }
        }
    }
    asks
}

/// Column or row that lies so far from where the first of `cells` begins; one beyond the last for what lies beyond.
fn place(metres: f32, cell_m: f32, cells: usize) -> usize {
    (metres / cell_m).clamp(0.0, cells as f32) as usize
}

/// The sun's rays over the ground.
struct Rays {
    /// Where they go, seen from above; unit.
    away: Vec2,
    /// Fall a metre of those that reach furthest: from the lower limb.
    steepness: f32,
    /// How much a penumbra widens, metres a metre, on each side.
    penumbra: f32,
}

impl Rays {
    fn of(sun: &Sun) -> Self {
        let (away, penumbra) = (-sun.direction.truncate(), sun.tan_half_angle());
        let lowest = (sun.direction.z - penumbra).max(1e-4);
        if away.length() > 1e-6 {
            Self { away: away / away.length(), steepness: lowest / away.length(), penumbra }
        } else {
            Self { away: Vec2::X, steepness: 1e6, penumbra }
        }
    }
}

/// The lists of some cells, one after the other.
struct Lists {
    /// Where that of each cell ends.
    ends: Reused<u32>,
    /// Casters by their numbers.
    casters: Reused<u32>,
}

/// Some rows of one of the grids.
struct CasterCells<'a> {
    terrain: &'a Terrain,
    cells: usize,
    cell_m: f32,
    origin: Vec2,
    rows: Range<usize>,
    /// Cells from here to as far from the other side are those of the grid before.
    inner: usize,
    /// Of each of its cells, a height that its ground does not fall below, once that is known.
    lowest_m: Reused<f32>,
    /// Of each row, the columns that are asked for.
    spans: Vec<Range<usize>>,
}

impl<'a> CasterCells<'a> {
    fn new(
        terrain: &'a Terrain,
        grids: &CasterGrids,
        level: u32,
        rows: Range<usize>,
        footprint: &Footprint,
    ) -> Self {
        let half_m = grids.half_m * (1_u32 << level) as f32;
        let cells = grids.cells as usize;
        let mut made = Self {
            terrain,
            cells,
            cell_m: 2.0 * half_m / grids.cells as f32,
            origin: grids.centre - half_m,
            inner: if level == 0 { cells } else { cells / 4 },
            lowest_m: Reused::filled(rows.len() * cells, f32::NAN),
            spans: Vec::new(),
            rows: rows.clone(),
        };
        made.spans = rows.map(|row| made.span(row, footprint)).collect();
        made
    }

    /// Columns of a row that a footprint touches, and one to each side; on the border of the ground, those next to what juts out
    /// over it.
    fn span(&self, row: usize, footprint: &Footprint) -> Range<usize> {
        let north = |row: usize| self.origin.y + row as f32 * self.cell_m;
        let south_m = if row == 0 { f32::MIN } else { north(row - 1) };
        let north_m = if row + 1 == self.cells { f32::MAX } else { north(row + 2) };
        footprint.span(south_m, north_m).map_or(0..0, |[low, high]| {
            let last = self.place(high + self.cell_m, 0).min(self.cells - 1);
            self.place(low - self.cell_m, 0).min(last)..last + 1
        })
    }

    /// Column (axis 0) or row (axis 1) of a coordinate, which may lie outside.
    fn place(&self, metres: f32, axis: usize) -> usize {
        place(metres - self.origin[axis], self.cell_m, self.cells)
    }

    /// The casters of each cell, in their order.
    fn lists(mut self, scene: &Scene, casters: &[Caster]) -> Lists {
        let mut found: Vec<(u32, u32)> = Vec::new();
        let rays = Rays::of(&scene.sun);
        for (number, caster) in (0..).zip(casters) {
            self.shaded_by(scene, &rays, caster, |cell| found.push((cell as u32, number)));
        }
        let mut ends = Reused::filled(self.rows.len() * self.cells, 0);
        let mut casters: Reused<u32> = Reused::of_any(found.len());
        if found.is_empty() {
            return Lists { ends, casters };
        }
        for &(cell, _) in &found {
            ends[cell as usize] += 1;
        }
        // How many there are becomes where they begin, and then, as they are listed, where they end.
        let mut start = 0;
        for end in &mut ends {
            let count = std::mem::replace(end, start);
            start += count;
        }
        for (cell, number) in found {
            let end = &mut ends[cell as usize];
            casters[*end as usize] = number;
            *end += 1;
        }
        Lists { ends, casters }
    }

    /// Gives every one of the cells, counted from the first, that the shadow of a caster can touch above the ground.
    fn shaded_by(&mut self, scene: &Scene, rays: &Rays, caster: &Caster, mut give: impl FnMut(usize)) {
        let &Rays { away, steepness, penumbra } = rays;
        let rock = &scene.rocks[caster.rock];
        let (centre, extent_m) = (caster.tile.centre, caster.tile.half_extent_m);
        let top_m = centre.z + rock.z_range_m[1];
        let half_diagonal_m = self.cell_m * std::f32::consts::FRAC_1_SQRT_2;
        let start = centre.truncate();
        let end = (centre - caster.reach_m * scene.sun.direction).truncate();
        let widest_m = extent_m + penumbra * caster.reach_m;
        let (low, high) = (start.min(end) - widest_m, start.max(end) + widest_m);
        let inner = self.inner..self.cells - self.inner.min(self.cells);
        let rows = self.place(low.y, 1).max(self.rows.start)..(self.place(high.y, 1) + 1).min(self.rows.end);
        let width_at =
            |along_m: f32| extent_m + 2.0 * penumbra * (along_m + extent_m) * (1.0 + steepness.min(10.0));
        // The shadow is a strip across the box.
        let strip_m = 1.01 * (width_at((high - low).length() + 2.0 * half_diagonal_m) + half_diagonal_m);
        for row in rows {
            let span = self.spans[row - self.rows.start].clone();
            let (mut west_m, mut east_m) = (low.x, high.x);
            if away.y.abs() > 1e-3 {
                let north_m = (row as f32 + 0.5) * self.cell_m + self.origin.y - start.y;
                let (middle_m, half_m) = (start.x + north_m * away.x / away.y, strip_m / away.y.abs());
                west_m = west_m.max(middle_m - half_m - self.cell_m);
                east_m = east_m.min(middle_m + half_m + self.cell_m);
            }
            for column in self.place(west_m, 0).max(span.start)..(self.place(east_m, 0) + 1).min(span.end) {
                if inner.contains(&row) && inner.contains(&column) {
                    continue;
                }
                let middle = (Vec2::new(column as f32, row as f32) + 0.5) * self.cell_m + self.origin;
                let along_m = (middle - start).dot(away);
                let across_m = (middle - start).perp_dot(away).abs();
                let nearest_m = (along_m - half_diagonal_m).max(0.0);
                let furthest_m = (along_m + half_diagonal_m).max(0.0);
                if across_m > width_at(furthest_m) + half_diagonal_m
                    || along_m < -(extent_m + half_diagonal_m)
                {
                    continue;
                }
                // The highest ray that can have passed the rock falls below the ground somewhere.
                let ray_m = top_m - (nearest_m - extent_m).max(0.0) * steepness;
                if ray_m >= self.lowest_ground_m(column, row) {
                    give((row - self.rows.start) * self.cells + column);
                }
            }
        }
    }

    /// A height that the ground of a cell does not fall below.
    fn lowest_ground_m(&mut self, column: usize, row: usize) -> f32 {
        let known = &mut self.lowest_m[(row - self.rows.start) * self.cells + column];
        if known.is_nan() {
            let low = Vec2::new(column as f32, row as f32) * self.cell_m + self.origin;
            *known = self.terrain.lowest_over(low, low + self.cell_m);
        }
        *known
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
