//! Nested grids around the ground's centre, on which the light of sunlit ground is found: where their cells lie.
//! Must not know: what the cells hold.

use glam::Vec2;

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

    /// The level of the finest grid that covers a point, from a level on, its cell at the point or nearest to it (column and row), and the
    /// point from the corner of the grid, cells.
    #[inline]
    #[must_use]
    pub fn locate(self, mut level: usize, point: Vec2) -> (usize, [usize; 2], Vec2) {
        let offset = point - self.centre;
        let furthest_m = offset.abs().max_element();
        let mut half_m = self.half_m * (1 << level) as f32;
        while furthest_m >= half_m && level + 1 < LEVELS {
            (level, half_m) = (level + 1, 2.0 * half_m);
        }
        let from_corner = (offset + half_m) * (0.5 * CELLS as f32 / half_m);
        let cell = from_corner.to_array().map(|along| (along as usize).min(CELLS - 1));
        (level, cell, from_corner)
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
