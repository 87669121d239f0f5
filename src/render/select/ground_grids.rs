//! The ground and the rocks on it as what sunlit ground lights is found from: cells of nested grids with heights, slopes, the part that is
//! sunlit, and rocks.
//! Must not know: shadows of rocks.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::render::select::azimuths::{Azimuth, SunDirection};
use crate::render::select::lane_math::{LANES, load, splat, store};
use crate::render::select::lit_rocks::{Exposed, is_speck};
use crate::render::select::nested_grids::{CELLS, GRID_CELLS, LEVELS, LocatedLanes, NestedGrids};
use crate::render::select::rock_cover::{CoverOfLanes, CoveringRock, RockCover};
use crate::render::select::selection::{SelectedRock, Selection};
use crate::scene::Scene;
use crate::scene::bounce::Bounce;
use crate::scene::photometry::Photometry;
use crate::scene::rings_mesh::CornersOfLanes;
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
    /// Heights above it, metres, world, from which all of it would be sunlit and from which any would.
    pub limbs_m: [f32; 2],
    /// Its rocks.
    pub rocks: RockCover,
    /// [`CoverOfLanes::half_height_m`] of these.
    pub half_height_m: f32,
}

/// The ground of eight cells.
pub struct CellsOfLanes<S: Simd> {
    /// See [`Cell`].
    pub height_m: f32x8<S>,
    /// Rise along x and y.
    pub slope: [f32x8<S>; 2],
    /// See [`Cell`].
    pub sunlit: f32x8<S>,
    /// See [`Cell`].
    pub half_height_m: f32x8<S>,
}

// Inlined into `dispatch!`, so that it is compiled for each SIMD level.
impl<S: Simd> CellsOfLanes<S> {
    /// Of these cells.
    #[inline(always)]
    #[must_use]
    pub fn new(simd: S, cells: [&Cell; LANES]) -> Self {
        let mut fields = [[0.0; LANES]; 5];
        for (lane, cell) in cells.into_iter().enumerate() {
            (fields[0][lane], fields[3][lane]) = (cell.height_m, cell.sunlit);
            (fields[1][lane], fields[2][lane]) = (cell.slope.x, cell.slope.y);
            fields[4][lane] = cell.half_height_m;
        }
        let [height_m, x, y, sunlit, half_height_m] = &fields;
        Self {
            height_m: load(simd, height_m),
            slope: [load(simd, x), load(simd, y)],
            sunlit: load(simd, sunlit),
            half_height_m: load(simd, half_height_m),
        }
    }

    /// Heights of points in the planes of their cells, metres. Beyond the last grid the ground is level.
    #[inline(always)]
    #[must_use]
    pub fn height_at(&self, located: &LocatedLanes<S>) -> f32x8<S> {
        let [x, y] = located.from_centre;
        self.height_m + located.cell_m * (self.slope[0] * x + self.slope[1] * y)
    }
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
        let covering = rocks().zip(&selection.rocks).zip(&ground.exposed).map(covering).collect();
        ground.set_rocks(covering);
        ground
    }

    /// Spreads rocks over the cells below them; there are none before.
    pub(super) fn set_rocks(&mut self, rocks: Vec<Option<CoveringRock>>) {
        for rock in rocks.iter().flatten() {
            spread(rock, self.grids, &mut self.cells);
        }
        for cells in self.cells.as_chunks_mut::<LANES>().0 {
            let half_heights_m = half_heights_m(cells.each_ref().map(|cell| &cell.rocks));
            for (cell, half_height_m) in cells.iter_mut().zip(half_heights_m) {
                cell.half_height_m = half_height_m;
            }
        }
        self.rocks = rocks;
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
        let sunlit = |chunk| dispatch!(Level::new(), simd => ground.sunlit(simd, chunk * LANES).map(store));
        let chunks = (0..ground.cells.len() / LANES).into_par_iter().with_min_len(CELLS / LANES);
        let of_chunks: Vec<[[f32; LANES]; 3]> = chunks.map(sunlit).collect();
        for (cells, [sunlit, lower_m, upper_m]) in ground.cells.chunks_exact_mut(LANES).zip(of_chunks) {
            for (lane, cell) in cells.iter_mut().enumerate() {
                (cell.sunlit, cell.limbs_m) = (sunlit[lane], [lower_m[lane], upper_m[lane]]);
            }
        }
        ground
    }

    /// The cells of these indices.
    #[inline(always)]
    pub(super) fn cells_at(&self, indices: &[usize; LANES]) -> [&Cell; LANES] {
        let mut cells = [&self.cells[0]; LANES];
        for (cell, index) in cells.iter_mut().zip(indices) {
            *cell = &self.cells[*index];
        }
        cells
    }

    /// The sunlit parts of eight cells from an index on, by the slopes of their horizons towards the sun, and [`Cell::limbs_m`].
    // Inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    fn sunlit<S: Simd>(&self, simd: S, first: usize) -> [f32x8<S>; 3] {
        let level = first / GRID_CELLS;
        let [x, y, height_m] = self.centres(simd, first);
        let of_sun = self.sun.sine / self.sun.cosine;
        let lowest = splat(simd, f32::MIN);
        let (mut horizon, mut lower_m, mut upper_m) = (lowest, lowest, lowest);
        for cells in DISTANCES {
            let distance_m = cells * self.grids.cell_m(level);
            let step = distance_m * self.sun.towards;
            let located = self.grids.locate_lanes(simd, level, [x + step.x, y + step.y]);
            let seen_m = CellsOfLanes::new(simd, self.cells_at(&located.indices)).height_at(&located);
            let fall_m = distance_m * of_sun;
            horizon = horizon.max((seen_m - height_m) / distance_m);
            (lower_m, upper_m) = (
                lower_m.max(seen_m - fall_m * (1.0 - SOFTNESS)),
                upper_m.max(seen_m - fall_m * (1.0 + SOFTNESS)),
            );
        }
        let above = (splat(simd, of_sun) - horizon) * (0.5 / (SOFTNESS * of_sun));
        [(above + 0.5).max(0.0).min(1.0), lower_m, upper_m]
    }

    /// Centres of eight cells of a row from an index on: x, y and height, metres, world.
    #[inline(always)]
    pub(super) fn centres<S: Simd>(&self, simd: S, first: usize) -> [f32x8<S>; 3] {
        let mut centres = [[0.0; LANES]; 3];
        for (lane, cell) in self.cells[first..first + LANES].iter().enumerate() {
            let position = self.grids.position(first + lane);
            (centres[0][lane], centres[1][lane], centres[2][lane]) = (position.x, position.y, cell.height_m);
        }
        let [x, y, height_m] = &centres;
        [load(simd, x), load(simd, y), load(simd, height_m)]
    }
}

/// [`CoverOfLanes::half_height_m`] of eight covers.
fn half_heights_m(covers: [&RockCover; LANES]) -> [f32; LANES] {
    dispatch!(Level::new(), simd => store(CoverOfLanes::new(simd, covers).half_height_m(simd)))
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
    let mut heights_m = vec![0.0; LEVELS * GRID_CELLS];
    heights_m.par_chunks_exact_mut(CELLS).enumerate().for_each(|(row, heights_m)| {
        let mut known = CornersOfLanes::default();
        for (chunk, heights_m) in heights_m.chunks_exact_mut(LANES).enumerate() {
            let first = row * CELLS + chunk * LANES;
            let position = |lane: usize| grids.position(first + lane);
            let (x, y) =
                (std::array::from_fn(|lane| position(lane).x), std::array::from_fn(|lane| position(lane).y));
            dispatch!(Level::new(), simd => {
                let points = [load(simd, &x), load(simd, &y)];
                let all = points[0].simd_eq(points[0]);
                terrain.surface_heights_at(simd, points, all, &mut known).store_slice(heights_m);
            });
        }
    });
    heights_m
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
