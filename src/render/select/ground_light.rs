//! Light of sunlit ground on ground in shadow: a map of what each place sees (`common/ground_light.wgsl`).
//!
//! A place in shadow is lit by ground that rises above its own plane: the far wall of its crater, the slope behind it. How much that is
//! differs from place to place by a factor of ten, so it is found from the heights. From each cell of nested grids around the
//! ground's centre the heights are followed in some azimuths. A stretch that rises above all before it is seen; it lights by its
//! slope, unless it is in shadow itself or rocks hide it. So do the rocks on it, but for those that are sources of their own.
//!
//! The normals of what is lit have relief that the grids lack. Where ground of even radiance fills the view up to some height in one
//! azimuth, the root of the irradiance is linear in the slope of the normal: the map holds the coefficients for each place, and
//! from where the light comes. That of sunlit ground within a cell is left out: it depends on how far inside a rock's shadow a point
//! lies, and goes by a law for all places (`common/indirect.wgsl`).
//!
//! The map is found for cells in view alone, with the rocks that are in view or cast shadows into it; beyond the last grid, for the mean of
//! some of its border.
//! Must not know: shadows of rocks.

use std::f32::consts::PI;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8};
use glam::Vec3;
use rayon::prelude::*;

use crate::render::select::azimuths::{Azimuth, SeenRocks, WIDTH};
use crate::render::select::footprint::Footprint;
use crate::render::select::ground_grids::{CellsOfLanes, DISTANCES, GroundGrids};
use crate::render::select::lane_math::{LANES, exp, splat, store};
use crate::render::select::nested_grids::{CELLS, GRID_CELLS, LEVELS, NestedGrids};
use crate::render::select::rock_cover::{CoverOfLanes, Passed, PassedRocks};

/// Slope by which normals lean from that of a cell, to either side, to find how its light changes.
const LEAN: f32 = 0.2;

/// The map of a frame.
#[derive(Clone, Debug, Default)]
pub struct GroundLight {
    /// Whole rows of texels, the grids beside each other. Irradiance is relative to uniform light of the radiance of level sunlit ground.
    /// First the root of the irradiance on a level normal, what it gains by leaning towards the sun and to its left, and the root on the
    /// cell's own normal; then for each cell the mean direction of the light on that, not normalised, and the sunlit part.
    pub texels: Vec<[f32; 4]>,
    grids: NestedGrids,
}

impl GroundLight {
    /// The map for what is in view.
    #[must_use]
    pub fn new(ground: &GroundGrids, footprint: &Footprint) -> Self {
        Self::of_cells(ground, &needed(ground.grids, footprint))
    }

    /// The map for these cells.
    fn of_cells(ground: &GroundGrids, is_needed: &[bool]) -> Self {
        let mut of_cells = vec![[[0.0; 4]; 2]; ground.cells.len()];
        of_cells.par_chunks_exact_mut(LANES).enumerate().with_min_len(CELLS / LANES).for_each(
            |(chunk, of_cells)| {
                let first = chunk * LANES;
                if is_needed[first..first + LANES].contains(&true) {
                    set_light(ground, first, of_cells);
                }
            },
        );
        let mut texels = vec![[0.0; 4]; 2 * LEVELS * GRID_CELLS];
        for (index, [root, direction]) in
            of_cells.into_iter().enumerate().filter(|(index, _)| is_needed[*index])
        {
            texels[texel_of(index)] = root;
            texels[LEVELS * GRID_CELLS + texel_of(index)] = direction;
        }
        for texels in texels.chunks_exact_mut(LEVELS * GRID_CELLS) {
            level_border(texels);
        }
        Self { texels, grids: ground.grids }
    }

    /// `FrameUniforms::ground_light` for a map that starts in a row of the texture.
    #[must_use]
    pub fn uniform(&self, row: u32) -> [f32; 4] {
        let NestedGrids { centre, half_m } = self.grids;
        [centre.x, centre.y, half_m, row as f32]
    }
}

/// Index of the texel of a cell.
const fn texel_of(index: usize) -> usize {
    let (level, row, column) = (index / GRID_CELLS, index / CELLS % CELLS, index % CELLS);
    (row * LEVELS + level) * CELLS + column
}

/// Sets what the texels hold of eight cells from an index on.
fn set_light(ground: &GroundGrids, first: usize, of_cells: &mut [[[f32; 4]; 2]]) {
    let (on_ground, directions) = dispatch!(Level::new(), simd => {
        let mut received = Received::none(simd);
        let cells = Cells::new(simd, ground, first);
        for azimuth in &ground.azimuths {
            cells.follow(simd, ground, azimuth, &mut received);
        }
        received.stored()
    });
    let sun = ground.sun;
    let per_exitance = 1.0 / (PI * ground.level_factor);
    for (lane, of_cell) in of_cells.iter_mut().enumerate() {
        let cell = &ground.cells[first + lane];
        let [own, sunward, from_sun, left, right] =
            on_ground.map(|light| (per_exitance * light[lane]).sqrt());
        let gains = [sunward - from_sun, left - right].map(|gain| 0.5 / LEAN * gain);
        let leans = [-cell.slope.dot(sun.towards), -cell.slope.dot(sun.towards.perp())];
        let root = [own - gains[0] * leans[0] - gains[1] * leans[1], gains[0], gains[1], own];
        let direction = Vec3::from(directions.map(|sum| sum[lane])) / on_ground[0][lane].max(1e-9);
        *of_cell = [root, direction.extend(cell.sunlit).to_array()];
    }
}

/// Radiance times solid angle that eight cells receive, per albedo and irradiance of the sun, times pi.
struct Received<S: Simd> {
    /// Irradiance by normals over their z: that of the cell, and leaning to the sun and from it, to its left and to its right.
    on_ground: [f32x8<S>; 5],
    /// Directions of the light times the irradiance on the cell's own normal.
    directions: [f32x8<S>; 3],
}

// Its functions are inlined into `dispatch!`, so that they are compiled for each SIMD level.
impl<S: Simd> Received<S> {
    #[inline(always)]
    fn none(simd: S) -> Self {
        Self { on_ground: [splat(simd, 0.0); 5], directions: [splat(simd, 0.0); 3] }
    }

    #[inline(always)]
    fn stored(&self) -> ([[f32; LANES]; 5], [[f32; LANES]; 3]) {
        let (mut on_ground, mut directions) = ([[0.0; LANES]; 5], [[0.0; LANES]; 3]);
        for (stored, sum) in on_ground.iter_mut().zip(self.on_ground) {
            *stored = store(sum);
        }
        for (stored, sum) in directions.iter_mut().zip(self.directions) {
            *stored = store(sum);
        }
        (on_ground, directions)
    }

    /// Adds ground of this radiance between two slopes; `leans` are those of the normals towards the azimuth.
    #[inline(always)]
    fn add_ground(
        &mut self,
        simd: S,
        azimuth: &Azimuth,
        radiance: f32x8<S>,
        [low, high, middle]: [f32x8<S>; 3],
        leans: &[f32x8<S>; 5],
    ) {
        let one = splat(simd, 1.0);
        let square = one / (one + middle * middle);
        // Of the integral over the slopes: to the power of 3/2 for the solid angle, 1/2 for the projection.
        let half_per_slope = radiance * square * square * (0.5 * WIDTH);
        let mut light = *leans;
        for light in &mut light {
            let (low, high) = ((low + *light).max(0.0), (high + *light).max(0.0));
            *light = half_per_slope * (high * high - low * low);
        }
        self.add(simd, azimuth, middle, &light);
    }

    /// Adds rocks, whose light on an upright normal comes from this slope.
    #[inline(always)]
    fn add_rocks(
        &mut self,
        simd: S,
        azimuth: &Azimuth,
        [light, slope]: [f32x8<S>; 2],
        leans: &[f32x8<S>; 5],
    ) {
        let light = light * WIDTH;
        let mut on_ground = *leans;
        for on_ground in &mut on_ground {
            *on_ground = light * (slope + *on_ground).max(0.0);
        }
        self.add(simd, azimuth, slope, &on_ground);
    }

    #[inline(always)]
    fn add(&mut self, simd: S, azimuth: &Azimuth, slope: f32x8<S>, light: &[f32x8<S>; 5]) {
        for (sum, light) in self.on_ground.iter_mut().zip(light) {
            *sum += *light;
        }
        let one = splat(simd, 1.0);
        let weight = light[0] / (one + slope * slope).sqrt();
        self.directions[0] += weight * azimuth.direction.x;
        self.directions[1] += weight * azimuth.direction.y;
        self.directions[2] += weight * slope;
    }
}

/// Which cells are read: those of the footprint that no finer grid covers.
fn needed(grids: NestedGrids, footprint: &Footprint) -> Vec<bool> {
    let mut is_needed = vec![false; LEVELS * GRID_CELLS];
    for (line, is_needed) in is_needed.chunks_exact_mut(CELLS).enumerate() {
        // Four cells are read at once.
        let margin_m = 1.5 * grids.cell_m(line / CELLS);
        let y = grids.position(line * CELLS).y;
        let Some([west, east]) = footprint.span(y - margin_m, y + margin_m) else { continue };
        let covered_m = 0.5 * grids.half_side_m(line / CELLS) - margin_m;
        for (column, is_needed) in is_needed.iter_mut().enumerate() {
            let position = grids.position(line * CELLS + column);
            let is_covered = line >= CELLS && (position - grids.centre).abs().max_element() < covered_m;
            *is_needed = position.x > west - margin_m && position.x < east + margin_m && !is_covered;
        }
    }
    for index in border_samples() {
        is_needed[index] = true;
    }
    is_needed
}

/// Cells along the border of the last grid whose mean stands for all ground beyond: the same ones, wherever the camera looks.
fn border_samples() -> impl Iterator<Item = usize> {
    let last = CELLS - 1;
    let along = (LANES / 2..CELLS).step_by(LANES);
    along
        .flat_map(move |along| [(along, 0), (along, last), (0, along), (last, along)])
        .map(|(column, row)| NestedGrids::index(LEVELS - 1, column, row))
}

/// Eight cells of a row that are looked from.
struct Cells<S: Simd> {
    level: usize,
    /// Their centres, metres, world.
    x: f32x8<S>,
    y: f32x8<S>,
    own: CellsOfLanes<S>,
}

// Its functions are inlined into `dispatch!`, so that they are compiled for each SIMD level.
impl<S: Simd> Cells<S> {
    #[inline(always)]
    fn new(simd: S, ground: &GroundGrids, first: usize) -> Self {
        let [x, y, _] = ground.centres(simd, first);
        let mut indices = [first; LANES];
        for (lane, index) in indices.iter_mut().enumerate() {
            *index += lane;
        }
        Self { level: first / GRID_CELLS, x, y, own: CellsOfLanes::new(simd, ground.cells_at(&indices)) }
    }

    /// Adds what they receive from one azimuth.
    #[inline(always)]
    fn follow(&self, simd: S, ground: &GroundGrids, azimuth: &Azimuth, received: &mut Received<S>) {
        let Self { own, .. } = self;
        let zero = splat(simd, 0.0);
        let own_lean = -(own.slope[0] * azimuth.direction.x + own.slope[1] * azimuth.direction.y);
        let (to_sun, to_left) = (LEAN * azimuth.to_sun, LEAN * azimuth.to_left);
        let leans = [own_lean, own_lean + to_sun, own_lean - to_sun, own_lean + to_left, own_lean - to_left];
        let max_above_m = (splat(simd, ground.top_m) - own.height_m).max(0.0);
        let mut passed = PassedRocks::none(simd);
        let (mut before_m, mut before_height_m, mut before_sunlit) = (0.0, own.height_m, own.sunlit);
        let mut highest = splat(simd, -1.0);
        for (sample, distance) in DISTANCES.into_iter().enumerate() {
            let distance_m = distance * ground.grids.cell_m(self.level);
            // Ground that can rise above what is before it.
            let is_open = max_above_m.simd_gt(highest * distance_m);
            if !is_open.any_true() {
                break;
            }
            let step = distance_m * azimuth.direction;
            let points = [self.x + step.x, self.y + step.y];
            let located = ground.grids.locate_lanes(simd, self.level, points);
            let cells = ground.cells_at(&located.indices);
            let seen = CellsOfLanes::new(simd, cells);
            let rocks = CoverOfLanes::new(simd, cells.map(|cell| &cell.rocks));
            let height_m = seen.height_at(&located);
            let (stretch_m, above_m) = (distance_m - before_m, height_m - own.height_m);
            let rise = (height_m - before_height_m) / stretch_m;
            let sunlit = is_open.select((seen.sunlit + before_sunlit) * 0.5, zero);
            (before_m, before_height_m, before_sunlit) = (distance_m, height_m, seen.sunlit);
            passed.push(&Passed {
                distance_m: splat(simd, distance_m),
                above_m,
                depth: rocks.depth * stretch_m,
                half_height_m: seen.half_height_m,
            });
            let slope = above_m / distance_m;
            let seen_rocks = SeenRocks {
                cover: &rocks,
                passed: &passed,
                horizon: highest,
                slope,
                from_m: splat(simd, distance_m),
                stretch_m: splat(simd, stretch_m),
            };
            if let Some(light) = azimuth.light_of_rocks(simd, &seen_rocks, sunlit) {
                received.add_rocks(simd, azimuth, light, &leans);
            }
            let lowest = highest;
            highest = highest.max(slope);
            // Of sunlit ground the nearest stretch is left out.
            let lit = if sample == 0 { sunlit * (splat(simd, 1.0) - own.sunlit) } else { sunlit };
            let is_lit = slope.simd_gt(lowest) & lit.simd_gt(0.0) & (slope + own_lean + LEAN).simd_gt(0.0);
            if !is_lit.any_true() {
                continue;
            }
            // The middle of what the leaning normals see.
            let middle = (slope + lowest.max((zero - own_lean - LEAN).min(slope))) * 0.5;
            let hidden = azimuth.depth_of_shadows(&rocks) + passed.depth(simd, middle);
            let factor = azimuth.radiance_factor(simd, seen.slope, rise, middle);
            let radiance = is_lit.select(lit * exp(simd, -hidden) * factor, zero);
            received.add_ground(simd, azimuth, radiance, [lowest, highest, middle], &leans);
        }
    }
}

/// Gives the border of the last grid the mean of some of its cells: it stands for all ground beyond.
fn level_border(texels: &mut [[f32; 4]]) {
    let (mut mean, mut count) = ([0.0; 4], 0.0_f32);
    for index in border_samples() {
        mean.iter_mut().zip(texels[texel_of(index)]).for_each(|(sum, value)| *sum += value);
        count += 1.0;
    }
    let mean = mean.map(|sum| sum / count);
    for along in 0..CELLS {
        for (column, row) in [(along, 0), (along, CELLS - 1), (0, along), (CELLS - 1, along)] {
            texels[texel_of((LEVELS - 1) * GRID_CELLS + row * CELLS + column)] = mean;
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
