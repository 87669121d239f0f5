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
//! The map is found for cells in view alone, with the rocks that are in view or cast shadows into it.
//! Must not know: shadows of rocks.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use crate::render::select::azimuths::{Azimuth, SeenRocks, WIDTH};
use crate::render::select::footprint::Footprint;
use crate::render::select::ground_grids::{DISTANCES, GroundGrids};
use crate::render::select::nested_grids::{CELLS, GRID_CELLS, LEVELS, NestedGrids};
use crate::render::select::rock_cover::{Passed, PassedRocks};

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
        let sun = ground.sun;
        let per_exitance = 1.0 / (PI * ground.level_factor);
        let of_cell = |index: usize| {
            if !is_needed[index] {
                return [[0.0; 4]; 2];
            }
            let mut received = Received::default();
            ground.azimuths.iter().for_each(|azimuth| follow(ground, index, azimuth, &mut received));
            let [own, sunward, from_sun, left, right] =
                received.on_ground.map(|light| (per_exitance * light).sqrt());
            let gains = [sunward - from_sun, left - right].map(|gain| 0.5 / LEAN * gain);
            let lean = -ground.cells[index].slope;
            let leans = [lean.dot(sun.towards), lean.dot(sun.towards.perp())];
            let root = [own - gains[0] * leans[0] - gains[1] * leans[1], gains[0], gains[1], own];
            let direction = received.directions / received.on_ground[0].max(1e-9);
            [root, direction.extend(ground.cells[index].sunlit).to_array()]
        };
        let of_cells: Vec<[[f32; 4]; 2]> =
            (0..ground.cells.len()).into_par_iter().with_min_len(CELLS).map(of_cell).collect();
        let mut texels = vec![[0.0; 4]; 2 * LEVELS * GRID_CELLS];
        for (index, [root, direction]) in of_cells.into_iter().enumerate() {
            texels[texel_of(index)] = root;
            texels[LEVELS * GRID_CELLS + texel_of(index)] = direction;
        }
        for texels in texels.chunks_exact_mut(LEVELS * GRID_CELLS) {
            level_border(texels, is_needed);
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

/// Radiance times solid angle that a cell receives, per albedo and irradiance of the sun, times pi.
#[derive(Default)]
struct Received {
    /// Irradiance by normals over their z: that of the cell, and leaning to the sun and from it, to its left and to its right.
    on_ground: [f32; 5],
    /// Directions of the light times the irradiance on the cell's own normal.
    directions: Vec3,
}

impl Received {
    /// Adds ground of this radiance between two slopes; `leans` are those of the normals towards the azimuth.
    fn add_ground(
        &mut self,
        azimuth: &Azimuth,
        radiance: f32,
        slopes: [f32; 2],
        middle: f32,
        leans: [f32; 5],
    ) {
        let square = 1.0 / (1.0 + middle * middle);
        // Of the integral over the slopes: to the power of 3/2 for the solid angle, 1/2 for the projection.
        let per_slope = WIDTH * radiance * square * square;
        self.add(
            azimuth,
            middle,
            leans.map(|lean| {
                let [low, high] = slopes.map(|slope| (slope + lean).max(0.0));
                0.5 * per_slope * (high * high - low * low)
            }),
        );
    }

    /// Adds rocks, whose light on an upright normal comes from this slope.
    fn add_rocks(&mut self, azimuth: &Azimuth, (light, slope): (f32, f32), leans: [f32; 5]) {
        if light > 0.0 {
            self.add(azimuth, slope, leans.map(|lean| WIDTH * light * (slope + lean).max(0.0)));
        }
    }

    fn add(&mut self, azimuth: &Azimuth, slope: f32, light: [f32; 5]) {
        self.on_ground.iter_mut().zip(light).for_each(|(sum, light)| *sum += light);
        let per_length = 1.0 / (1.0 + slope * slope).sqrt();
        self.directions += light[0] * per_length * azimuth.direction.extend(slope);
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
    is_needed
}

/// Adds what a cell receives from one azimuth.
fn follow(ground: &GroundGrids, index: usize, azimuth: &Azimuth, received: &mut Received) {
    let (own, start, level) = (&ground.cells[index], ground.grids.position(index), index / GRID_CELLS);
    let own_lean = -own.slope.dot(azimuth.direction);
    let (to_sun, to_left) = (LEAN * azimuth.to_sun, LEAN * azimuth.to_left);
    let leans = [0.0, to_sun, -to_sun, to_left, -to_left].map(|lean| own_lean + lean);
    let mut passed = PassedRocks::NONE;
    let (mut before_m, mut before_height_m, mut before_sunlit) = (0.0, own.height_m, own.sunlit);
    let mut highest = -1.0_f32;
    for (sample, distance) in DISTANCES.into_iter().enumerate() {
        let distance_m = distance * ground.grids.cell_m(level);
        if (ground.top_m - own.height_m).max(0.0) <= highest * distance_m {
            break;
        }
        let (_, cell, height_m) = ground.at(level, start + distance_m * azimuth.direction);
        let (stretch_m, above_m) = (distance_m - before_m, height_m - own.height_m);
        let rise = (height_m - before_height_m) / stretch_m;
        (before_m, before_height_m) = (distance_m, height_m);
        let sunlit = 0.5 * (cell.sunlit + std::mem::replace(&mut before_sunlit, cell.sunlit));
        let depth = stretch_m * cell.rocks.depth;
        passed.push(&Passed { distance_m, above_m, depth, half_height_m: cell.half_height_m });
        let slope = above_m / distance_m;
        let seen = SeenRocks {
            cover: &cell.rocks,
            passed: &passed,
            horizon: highest,
            slope,
            from_m: distance_m,
            stretch_m,
        };
        received.add_rocks(azimuth, azimuth.light_of_rocks(&seen, sunlit), leans);
        if slope <= highest {
            continue;
        }
        let lowest = std::mem::replace(&mut highest, slope);
        // Of sunlit ground the nearest stretch is left out.
        let sunlit = if sample == 0 { sunlit * (1.0 - own.sunlit) } else { sunlit };
        if sunlit == 0.0 || slope + leans[0] + LEAN <= 0.0 {
            continue;
        }
        // The middle of what the leaning normals see.
        let middle = 0.5 * (slope + lowest.max((-LEAN - own_lean).min(slope)));
        let hidden = azimuth.depth_of_shadows(&cell.rocks) + passed.depth(middle);
        let radiance = sunlit * libm::expf(-hidden) * azimuth.radiance_factor(cell.slope, rise, middle);
        received.add_ground(azimuth, radiance, [lowest, slope], middle, leans);
    }
}

/// Gives the border of the last grid the mean of what is needed of it: it stands for all ground beyond.
fn level_border(texels: &mut [[f32; 4]], is_needed: &[bool]) {
    let (mut mean, mut count) = ([0.0; 4], 0.0_f32);
    for index in ((LEVELS - 1) * GRID_CELLS..LEVELS * GRID_CELLS).filter(|index| is_needed[*index]) {
        mean.iter_mut().zip(texels[texel_of(index)]).for_each(|(sum, value)| *sum += value);
        count += 1.0;
    }
    let mean = mean.map(|sum| sum / count.max(1.0));
    for along in 0..CELLS {
        for (column, row) in [(along, 0), (along, CELLS - 1), (0, along), (CELLS - 1, along)] {
            texels[texel_of((LEVELS - 1) * GRID_CELLS + row * CELLS + column)] = mean;
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
