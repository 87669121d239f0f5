//! The ground and the rocks on it as what sunlit ground lights is found from: cells of nested grids with heights, slopes, the part that is
//! sunlit, and rocks.
//! Must not know: shadows of rocks.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::render::select::azimuths::{Azimuth, SunDirection};
use crate::render::select::lit_rocks::{Exposed, is_speck};
use crate::render::select::nested_grids::{CELLS, GRID_CELLS, LEVELS, NestedGrids};
use crate::render::select::rock_cover::{CoveringRock, RockCover};
use crate::render::select::selection::{SelectedRock, Selection};
use crate::scene::Scene;
use crate::scene::bounce::Bounce;
use crate::scene::photometry::Photometry;
use crate::scene::rocks::Rock;
use crate::scene::terrain::Terrain;

/// Distances of the samples along an azimuth, cells.
pub const DISTANCES: [f32; 14] =
    [1.0, 1.5, 2.2, 3.2, 4.7, 7.0, 10.0, 15.0, 22.0, 32.0, 48.0, 72.0, 108.0, 160.0];
/// Half the range of slopes of the horizon over which a cell comes to be sunlit, as a fraction of that of the sun: a cell has relief of its
/// own.
const SOFTNESS: f32 = 0.3;

/// The ground of a cell.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Height of its centre, metres, world.
    pub height_m: f32,
    /// Rise along x and y.
    pub slope: Vec2,
    /// The part that is sunlit, past other ground.
    pub sunlit: f32,
    /// Its rocks.
    pub rocks: RockCover,
    /// [`RockCover::half_height_m`] of these.
    pub half_height_m: f32,
}

/// The cells, and the azimuths in which they are looked at.
pub struct GroundGrids {
    /// Where they lie.
    pub grids: NestedGrids,
    /// All cells.
    pub cells: Vec<Cell>,
    /// The highest of them, metres.
    pub top_m: f32,
    /// The direction to the sun.
    pub sun: SunDirection,
    /// All azimuths.
    pub azimuths: Vec<Azimuth>,
    /// Exitance of level sunlit ground over pi, as a radiance factor.
    pub level_factor: f32,
    /// Of each rock of the selection, the part above the ground.
    pub exposed: Vec<Exposed>,
    /// Of each rock of the selection, what its cover is found from; `None` of parts of a rover.
    pub rocks: Vec<Option<CoveringRock>>,
}

impl GroundGrids {
    /// Around the centre of a scene's ground, with the rocks of a selection.
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection, bounce: &Bounce, pixel_angle: f32) -> Self {
        let mut ground = Self::without_rocks(&scene.terrain, &scene.photometry, bounce, scene.sun.direction);
        let rocks = || selection.rocks.iter().map(|selected| &scene.rocks[selected.rock]);
        ground.exposed = rocks().map(|rock| Exposed::new(scene, rock)).collect();
        let at_normal = |surge: f64| scene.photometry.at_normal(surge) as f32;
        let of_rock = at_normal(scene.photometry.rock_b_s0);
        let of_soil = scene.regolith.albedo.y / at_normal(scene.photometry.soil.b_s0);
        let covering = |((rock, selected), exposed): ((&Rock, &SelectedRock), &Exposed)| {
            rock.body.is_rock().then(|| CoveringRock {
                place: rock.centre.truncate(),
                radius_m: rock.base_scale_m,
                height_m: exposed.height_m,
                colour: rock.material.albedo.y / of_rock / of_soil.max(1e-6),
                is_listed: !is_speck(rock, selected, pixel_angle),
            })
        };
        ground.rocks = rocks().zip(&selection.rocks).zip(&ground.exposed).map(covering).collect();
        for rock in ground.rocks.iter().flatten() {
            spread(rock, ground.grids, &mut ground.cells);
        }
        for cell in &mut ground.cells {
            cell.half_height_m = cell.rocks.half_height_m();
        }
        ground
    }

    /// Around the centre of the ground, under a sun in this direction.
    pub(super) fn without_rocks(
        terrain: &Terrain,
        photometry: &Photometry,
        bounce: &Bounce,
        sun: Vec3,
    ) -> Self {
        let grids = NestedGrids::new(terrain);
        let sun = SunDirection::new(sun);
        let exitance = photometry.exitance(sun.sine.into()) * photometry.at_normal(photometry.soil.b_s0);
        let heights = heights_m(terrain, grids);
        let mut ground = Self {
            grids,
            cells: (0..heights.len()).map(|index| cell(grids, &heights, index)).collect(),
            top_m: heights.iter().copied().fold(f32::MIN, f32::max),
            sun,
            azimuths: Azimuth::all(photometry, bounce, sun),
            level_factor: exitance as f32,
            exposed: Vec::new(),
            rocks: Vec::new(),
        };
        let sunlit: Vec<f32> = (0..ground.cells.len())
            .into_par_iter()
            .with_min_len(CELLS)
            .map(|index| ground.sunlit(index))
            .collect();
        ground.cells.iter_mut().zip(sunlit).for_each(|(cell, sunlit)| cell.sunlit = sunlit);
        ground
    }

    /// The cell at a point, of the finest grid that covers it from a level on, with its index, and the height of the point in its plane,
    /// metres.
    #[inline]
    #[must_use]
    pub fn at(&self, level: usize, point: Vec2) -> (usize, &Cell, f32) {
        let (level, [column, row], from_corner) = self.grids.locate(level, point);
        let index = NestedGrids::index(level, column, row);
        let cell = &self.cells[index];
        let from_centre = from_corner - Vec2::new(column as f32, row as f32) - 0.5;
        // Beyond the last grid the ground is level.
        let offset = from_centre.clamp(Vec2::NEG_ONE, Vec2::ONE);
        (index, cell, cell.height_m + self.grids.cell_m(level) * cell.slope.dot(offset))
    }

    /// The sunlit part of a cell, by the slope of its horizon towards the sun.
    fn sunlit(&self, index: usize) -> f32 {
        let (level, start) = (index / GRID_CELLS, self.grids.position(index));
        let slope = |cells: &f32| {
            let distance_m = cells * self.grids.cell_m(level);
            let (_, _, height_m) = self.at(level, start + distance_m * self.sun.towards);
            (height_m - self.cells[index].height_m) / distance_m
        };
        let horizon = DISTANCES.iter().map(slope).fold(f32::MIN, f32::max);
        let of_sun = self.sun.sine / self.sun.cosine;
        (0.5 + 0.5 * (of_sun - horizon) / (SOFTNESS * of_sun)).clamp(0.0, 1.0)
    }
}

/// Spreads a rock over the cells below it.
fn spread(rock: &CoveringRock, grids: NestedGrids, cells: &mut [Cell]) {
    for (level, spread) in rock.spreads(grids).into_iter().enumerate() {
        let Some(spread) = spread else { continue };
        for row in spread.rows {
            let first = NestedGrids::index(level, 0, row);
            for cell in &mut cells[first + spread.columns.start..first + spread.columns.end] {
                cell.rocks += spread.cover;
            }
        }
    }
}

/// Heights of the centres of all cells, metres.
fn heights_m(terrain: &Terrain, grids: NestedGrids) -> Vec<f32> {
    (0..LEVELS * GRID_CELLS)
        .into_par_iter()
        .with_min_len(CELLS)
        .map(|index| terrain.surface_height_at(grids.position(index)))
        .collect()
}

/// A cell's ground, by its neighbours.
fn cell(grids: NestedGrids, heights_m: &[f32], index: usize) -> Cell {
    let cell_m = grids.cell_m(index / GRID_CELLS);
    let slope = |along: usize, stride: usize| {
        let (before, after) = (usize::from(along > 0), usize::from(along + 1 < CELLS));
        let rise_m = heights_m[index + after * stride] - heights_m[index - before * stride];
        rise_m / ((before + after) as f32 * cell_m)
    };
    let slope = Vec2::new(slope(index % CELLS, 1), slope(index / CELLS % CELLS, CELLS));
    Cell { height_m: heights_m[index], slope, ..Cell::default() }
}
