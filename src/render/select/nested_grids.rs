//! Nested grids around the ground's centre, on which the light of sunlit ground is found: where their cells lie.
//! Must not know: what the cells hold.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::Vec2;

use crate::render::select::lane_math::{LANES, splat};
use crate::render::select::lit_rocks::ROW_TEXELS;
use crate::scene::terrain::{Layout, Terrain};

/// Cells along a side of each grid. `common/ground_light.wgsl` has the same.
pub const CELLS: usize = 48;
/// Grids, each twice as wide as the one before; they lie side by side in the rows of the texture of the faces of rocks.
pub const LEVELS: usize = ROW_TEXELS / CELLS;
/// Cells of a grid.
pub const GRID_CELLS: usize = CELLS * CELLS;
/// Largest half of the side of the first grid, metres: with cells of half a metre the light is as with cells of 0.15 m (docs/realism.md).
const MAX_HALF_M: f32 = 12.0;

/// Where the grids lie. Cells have one index: grid by grid, row by row.
#[derive(Clone, Copy, Debug, Default)]
pub struct NestedGrids {
    /// Their centre, metres, world.
    pub centre: Vec2,
    /// Half the side of the first grid, metres.
    pub half_m: f32,
}

/// The cells of eight points.
pub struct LocatedLanes<S: Simd> {
    /// Their indices.
    pub indices: [usize; LANES],
    /// Their sides, metres.
    pub cell_m: f32x8<S>,
    /// The points from the centres of their cells along x and y, cells; from the border of the last grid no further than one.
    pub from_centre: [f32x8<S>; 2],
}

impl NestedGrids {
    /// Those of a scene's ground.
    #[must_use]
    pub fn new(terrain: &Terrain) -> Self {
        let whole_m = terrain.half_extent_m / (1 << (LEVELS - 1)) as f32;
        let half_m = match terrain.layout {
            Layout::Square => whole_m,
            Layout::Rings(_) => whole_m.min(MAX_HALF_M),
        };
        Self { centre: terrain.centre, half_m }
    }

    /// The cells of eight points, each of the finest grid that covers it from a level on.
    // Inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    #[must_use]
    pub fn locate_lanes<S: Simd>(
        self,
        simd: S,
        first_level: usize,
        [x, y]: [f32x8<S>; 2],
    ) -> LocatedLanes<S> {
        let (x, y) = (x - self.centre.x, y - self.centre.y);
        let furthest_m = x.abs().max(y.abs());
        let mut level = splat(simd, first_level as f32);
        let mut half_m = splat(simd, self.half_side_m(first_level));
        for _ in first_level + 1..LEVELS {
            let is_beyond = furthest_m.simd_ge(half_m);
            level = is_beyond.select(level + 1.0, level);
            half_m = is_beyond.select(half_m * 2.0, half_m);
        }
        let per_cell = splat(simd, 0.5 * CELLS as f32) / half_m;
        let (x, y) = ((x + half_m) * per_cell, (y + half_m) * per_cell);
        let last = (CELLS - 1) as f32;
        let (column, row) = (x.max(0.0).min(last).floor(), y.max(0.0).min(last).floor());
        let mut stored = [0; LANES];
        let index = (level * CELLS as f32 + row) * CELLS as f32 + column;
        index.to_int::<i32x8<S>>().store_slice(&mut stored);
        let mut indices = [0; LANES];
        for (index, stored) in indices.iter_mut().zip(stored) {
            *index = stored as usize;
        }
        LocatedLanes {
            indices,
            cell_m: half_m * (2.0 / CELLS as f32),
            from_centre: [(x - column - 0.5).max(-1.0).min(1.0), (y - row - 0.5).max(-1.0).min(1.0)],
        }
    }

    /// Index of the cell of a point, of the finest grid that covers it; beyond the last grid that of its border.
    #[must_use]
    pub fn index_at(self, point: Vec2) -> usize {
        let from_centre = point - self.centre;
        let furthest_m = from_centre.abs().max_element();
        let level = (0..LEVELS - 1).find(|level| furthest_m < self.half_side_m(*level)).unwrap_or(LEVELS - 1);
        let cells = (from_centre + self.half_side_m(level)) / self.cell_m(level);
        let [column, row] = [cells.x, cells.y].map(|cells| (cells.max(0.0) as usize).min(CELLS - 1));
        Self::index(level, column, row)
    }

    /// Index of a cell.
    #[must_use]
    pub const fn index(level: usize, column: usize, row: usize) -> usize {
        (level * CELLS + row) * CELLS + column
    }

    /// Half the side of a grid, metres.
    #[must_use]
    pub fn half_side_m(self, level: usize) -> f32 {
        self.half_m * (1 << level) as f32
    }

    /// Side of a cell, metres.
    #[must_use]
    pub fn cell_m(self, level: usize) -> f32 {
        2.0 * self.half_side_m(level) / CELLS as f32
    }

    /// Centre of a cell, metres, world.
    #[must_use]
    pub fn position(self, index: usize) -> Vec2 {
        let level = index / GRID_CELLS;
        let cells = Vec2::new((index % CELLS) as f32, (index / CELLS % CELLS) as f32) + 0.5;
        self.centre + self.cell_m(level) * cells - self.half_side_m(level)
    }
}
