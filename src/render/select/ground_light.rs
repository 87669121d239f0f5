//! Light of sunlit ground on ground in shadow: a map of what each place sees (`common/ground_light.wgsl`).
//!
//! A place in shadow is lit by ground that rises above its own plane: the far wall of its crater, the slope behind it. How much that is
//! differs from place to place by a factor of ten, so it is found from the heights. From each cell of nested grids around the
//! ground's centre the heights are followed in some azimuths. A stretch that rises above all before it is seen; it lights by its
//! slope, unless it is in shadow itself or rocks hide it. Rocks are no part of the heights: a ray passes them with the probability
//! of Poisson's law.
//!
//! The normals of what is lit have relief that the grids lack. Where ground of even radiance fills the view up to some height in one
//! azimuth, the root of the irradiance is linear in the slope of the normal: the map holds the coefficients for each place, and
//! from where the light comes. That of sunlit ground within a cell is left out: it depends on how far inside a rock's shadow a point
//! lies, and goes by a law for all places (`common/indirect.wgsl`).
//!
//! The map is found for cells in view alone, with the rocks that are in view or cast shadows into it.
//! Must not know: shadows of rocks.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::render::select::footprint::Footprint;
use crate::render::select::lit_rocks::ROW_TEXELS;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::photometry::{Law, Photometry};
use crate::scene::rocks::Rock;
use crate::scene::terrain::{Layout, Terrain};

/// Cells along a side of each grid. `common/ground_light.wgsl` has the same.
pub const CELLS: usize = 48;
/// Grids, each twice as wide as the one before; they lie side by side in the rows of the texture of the faces of rocks.
pub const LEVELS: usize = ROW_TEXELS / CELLS;
/// Cells of a grid.
const GRID_CELLS: usize = CELLS * CELLS;
/// Largest half of the side of the first grid, metres: with cells of half a metre the light is as with cells of 0.15 m (docs/realism.md).
const MAX_HALF_M: f32 = 12.0;
/// Azimuths in which the heights are followed, from that of the sun on.
const AZIMUTHS: usize = 12;
/// Distances of the samples along an azimuth, cells.
const DISTANCES: [f32; 14] = [1.0, 1.5, 2.2, 3.2, 4.7, 7.0, 10.0, 15.0, 22.0, 32.0, 48.0, 72.0, 108.0, 160.0];
/// Slope by which normals lean from that of a cell, to either side, to find how its light changes.
const LEAN: f32 = 0.2;
/// Half the range of slopes of the horizon over which a cell comes to be sunlit, as a fraction of that of the sun: a cell has relief of its
/// own.
const SOFTNESS: f32 = 0.3;
/// Least cosine of emission, for ground that is seen edge-on.
const MIN_EMISSION: f32 = 0.02;
/// Frontal area of a rock over its width times its height: that of half an ellipse.
const FRONTAL_AREA: f32 = 0.25 * PI;
/// Steps of a table of radiance factors.
const STEPS: usize = 8;

/// The map of a frame.
#[derive(Clone, Debug, Default)]
pub struct GroundLight {
    /// Whole rows of texels, the grids beside each other. Irradiance is relative to uniform light of the radiance of level sunlit ground.
    /// First the root of the irradiance on a level normal, what it gains by leaning towards the sun and to its left, and the root on the
    /// cell's own normal; then for each cell the mean direction of the light on that, not normalised, and the sunlit part.
    pub texels: Vec<[f32; 4]>,
    extent: Extent,
}

impl GroundLight {
    /// The map of a scene under Hapke's law; empty under other laws, which take light from level ground alone.
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection, footprint: &Footprint) -> Self {
        if scene.photometry.law != Law::Hapke {
            return Self::default();
        }
        let mut grids = Grids::new(&scene.terrain);
        let is_needed = grids.needed(footprint);
        grids.add_rocks(selection.rocks.iter().map(|selected| &scene.rocks[selected.rock]));
        grids.of_sun(&scene.photometry, scene.sun.direction, &is_needed)
    }

    /// `FrameUniforms::ground_light` for a map that starts in a row of the texture.
    #[must_use]
    pub fn uniform(&self, row: u32) -> [f32; 4] {
        let Extent { centre, half_m } = self.extent;
        [centre.x, centre.y, half_m, row as f32]
    }
}

/// Where the grids lie.
#[derive(Clone, Copy, Debug, Default)]
struct Extent {
    /// Their centre, metres, world.
    centre: Vec2,
    /// Half the side of the first grid, metres.
    half_m: f32,
}

impl Extent {
    /// The level of the finest grid that covers a point, from a level on, its cell at the point or nearest to it, and the point from the
    /// corner of the grid, cells.
    #[inline]
    fn locate(self, mut level: usize, point: Vec2) -> (usize, [usize; 2], Vec2) {
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

    /// Side of a cell, metres.
    fn cell_m(self, level: usize) -> f32 {
        2.0 * self.half_m * (1 << level) as f32 / CELLS as f32
    }

    /// Centre of a cell, metres, world.
    fn position(self, index: usize) -> Vec2 {
        let level = index / GRID_CELLS;
        let cells = Vec2::new((index % CELLS) as f32, (index / CELLS % CELLS) as f32) + 0.5;
        self.centre + self.cell_m(level) * cells - self.half_m * (1 << level) as f32
    }
}

/// Index of the texel of a cell.
const fn texel_of(index: usize) -> usize {
    let (level, row, column) = (index / GRID_CELLS, index / CELLS % CELLS, index % CELLS);
    (row * LEVELS + level) * CELLS + column
}

/// The ground of a cell.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    height_m: f32,
    /// Rise along x and y.
    slope: Vec2,
    /// The part that is sunlit.
    sunlit: f32,
    /// Sum of the widths of rocks over the area, 1/m.
    rock_width: f32,
    /// Sum of the frontal areas of rocks over the area.
    rock_front: f32,
}

/// The direction to the sun, the same from all cells.
#[derive(Clone, Copy, Debug)]
struct SunDirection {
    /// Horizontal unit vector towards it.
    towards: Vec2,
    /// Sine and cosine of its elevation.
    sine: f32,
    cosine: f32,
}

/// An azimuth in which heights are followed.
struct Way {
    direction: Vec2,
    /// Cosine and sine of its angle to the left of the sun's azimuth.
    to_sun: f32,
    to_left: f32,
    /// Radiance factors of ground that is seen in it, by the roots of the cosines of incidence and of emission.
    factors: [[f32; STEPS + 1]; STEPS + 1],
}

impl Way {
    /// All azimuths.
    fn all(photometry: &Photometry, sun: SunDirection) -> Vec<Self> {
        let cosine = |step: usize| (step * step) as f64 / (STEPS * STEPS) as f64;
        let way = |azimuth: usize| {
            let (to_left, to_sun) = libm::sincosf(TAU * azimuth as f32 / AZIMUTHS as f32);
            let direction = to_sun * sun.towards + to_left * sun.towards.perp();
            let cos_phase = f64::from(-to_sun * sun.cosine);
            let factor =
                |i: usize, j: usize| photometry.soil.radiance_factor(cosine(i), cosine(j), cos_phase) as f32;
            let factors = std::array::from_fn(|i| std::array::from_fn(|j| factor(i, j)));
            Self { direction, to_sun, to_left, factors }
        };
        (0..AZIMUTHS).map(way).collect()
    }

    /// Radiance factor for these cosines.
    fn factor(&self, incidence: f32, emission: f32) -> f32 {
        let at = |cosine: f32| {
            let along = STEPS as f32 * cosine.clamp(0.0, 1.0).sqrt();
            let step = (along as usize).min(STEPS - 1);
            (step, along - step as f32)
        };
        let ((i, u), (j, v)) = (at(incidence), at(emission));
        let line = |i: usize| self.factors[i][j] + v * (self.factors[i][j + 1] - self.factors[i][j]);
        line(i) + u * (line(i + 1) - line(i))
    }
}

/// Radiance times solid angle that a cell receives, per albedo and irradiance of the sun, times pi.
#[derive(Default)]
struct Received {
    /// Irradiance by normals over their z: that of the cell, and leaning to the sun and from it, to its left and to its right.
    on_ground: [f32; 5],
    /// Directions of the light times the irradiance on the cell's own normal.
    directions: Vec3,
}

/// Rocks that a ray passes at a sample: distance and height of the place above the cell, metres; sum of the widths of the rocks per
/// metre across the ray; their mean height, metres.
type Passed = [f32; 4];

/// The cells of all grids.
struct Grids {
    extent: Extent,
    cells: Vec<Cell>,
    /// The highest of them, metres.
    top_m: f32,
}

impl Grids {
    /// Heights and slopes around the centre of the ground.
    fn new(terrain: &Terrain) -> Self {
        let whole_m = terrain.half_extent_m / (1 << (LEVELS - 1)) as f32;
        let half_m = match terrain.layout {
            Layout::Square => whole_m,
            Layout::Rings(_) => whole_m.min(MAX_HALF_M),
        };
        let extent = Extent { centre: terrain.centre, half_m };
        let heights: Vec<f32> = (0..LEVELS * GRID_CELLS)
            .into_par_iter()
            .with_min_len(CELLS)
            .map(|index| terrain.surface_height_at(extent.position(index)))
            .collect();
        let cell = |index: usize| {
            let cell_m = extent.cell_m(index / GRID_CELLS);
            let slope = |along: usize, stride: usize| {
                let (before, after) = (usize::from(along > 0), usize::from(along + 1 < CELLS));
                let rise = heights[index + after * stride] - heights[index - before * stride];
                rise / ((before + after) as f32 * cell_m)
            };
            let slope = Vec2::new(slope(index % CELLS, 1), slope(index / CELLS % CELLS, CELLS));
            Cell { height_m: heights[index], slope, ..Cell::default() }
        };
        let top_m = heights.iter().copied().fold(f32::MIN, f32::max);
        Self { extent, cells: (0..heights.len()).map(cell).collect(), top_m }
    }

    /// The cell at a point, of the finest grid that covers it from a level on, and the height of the point in its plane, metres.
    #[inline]
    fn at(&self, level: usize, point: Vec2) -> (&Cell, f32) {
        let (level, [column, row], from_corner) = self.extent.locate(level, point);
        let cell = &self.cells[(level * CELLS + row) * CELLS + column];
        let from_centre = from_corner - Vec2::new(column as f32, row as f32) - 0.5;
        // Beyond the last grid the ground is level.
        let offset = from_centre.clamp(Vec2::NEG_ONE, Vec2::ONE);
        (cell, cell.height_m + self.extent.cell_m(level) * cell.slope.dot(offset))
    }

    /// Which cells are read: those of the footprint that no finer grid covers.
    fn needed(&self, footprint: &Footprint) -> Vec<bool> {
        let mut is_needed = vec![false; LEVELS * GRID_CELLS];
        for (line, is_needed) in is_needed.chunks_exact_mut(CELLS).enumerate() {
            // Four cells are read at once.
            let margin_m = 1.5 * self.extent.cell_m(line / CELLS);
            let y = self.extent.position(line * CELLS).y;
            let Some([west, east]) = footprint.span(y - margin_m, y + margin_m) else { continue };
            let covered_m = 0.5 * self.extent.half_m * (1 << (line / CELLS)) as f32 - margin_m;
            for (column, is_needed) in is_needed.iter_mut().enumerate() {
                let position = self.extent.position(line * CELLS + column);
                let is_covered =
                    line >= CELLS && (position - self.extent.centre).abs().max_element() < covered_m;
                *is_needed = position.x > west - margin_m && position.x < east + margin_m && !is_covered;
            }
        }
        is_needed
    }

    /// Spreads each rock over the cells below it.
    fn add_rocks<'a>(&mut self, rocks: impl Iterator<Item = &'a Rock>) {
        for rock in rocks.filter(|rock| rock.body.is_rock()) {
            let (place, radius_m) = (rock.centre.truncate(), rock.base_scale_m);
            let exposed_m = rock.centre.z + rock.z_range_m[1] - self.at(0, place).1;
            for level in 0..LEVELS {
                let (cell_m, half_m) = (self.extent.cell_m(level), self.extent.half_m * (1 << level) as f32);
                let from_border = place - self.extent.centre + half_m;
                if from_border.min_element() < 0.0 || from_border.max_element() >= 2.0 * half_m {
                    continue;
                }
                let beyond_m = (radius_m - 0.5 * cell_m).max(0.0);
                let range = |along_m: f32| {
                    let index = |metres: f32| ((metres / cell_m).max(0.0) as usize).min(CELLS - 1);
                    index(along_m - beyond_m)..index(along_m + beyond_m) + 1
                };
                let (columns, rows) = (range(from_border.x), range(from_border.y));
                let width = 2.0 * radius_m / ((columns.len() * rows.len()) as f32 * cell_m * cell_m);
                for row in rows {
                    let first = level * GRID_CELLS + row * CELLS;
                    for cell in &mut self.cells[first + columns.start..first + columns.end] {
                        cell.rock_width += width;
                        cell.rock_front += FRONTAL_AREA * width * exposed_m.max(0.0);
                    }
                }
            }
        }
    }

    /// The map under a sun.
    fn of_sun(mut self, photometry: &Photometry, sun: Vec3, is_needed: &[bool]) -> GroundLight {
        let sine = sun.z.max(1e-3);
        let towards = sun.truncate().normalize_or(Vec2::X);
        let sun = SunDirection { towards, sine, cosine: (1.0 - sine * sine).max(1e-6).sqrt() };
        let sunlit: Vec<f32> = (0..self.cells.len())
            .into_par_iter()
            .with_min_len(CELLS)
            .map(|index| self.sunlit(index, sun))
            .collect();
        self.cells.iter_mut().zip(sunlit).for_each(|(cell, sunlit)| cell.sunlit = sunlit);
        let ways = Way::all(photometry, sun);
        let exitance = photometry.exitance(sine.into()) * photometry.at_normal(photometry.soil.b_s0);
        let per_exitance = 1.0 / (PI * exitance as f32);
        let of_cell = |index: usize| {
            if !is_needed[index] {
                return [[0.0; 4]; 2];
            }
            let mut received = Received::default();
            ways.iter().for_each(|way| self.follow(index, sun, way, &mut received));
            let [own, sunward, from_sun, left, right] =
                received.on_ground.map(|light| (per_exitance * light).sqrt());
            let gains = [sunward - from_sun, left - right].map(|gain| 0.5 / LEAN * gain);
            let lean = -self.cells[index].slope;
            let leans = [lean.dot(sun.towards), lean.dot(sun.towards.perp())];
            let root = [own - gains[0] * leans[0] - gains[1] * leans[1], gains[0], gains[1], own];
            let direction = received.directions / received.on_ground[0].max(1e-9);
            [root, direction.extend(self.cells[index].sunlit).to_array()]
        };
        let of_cells: Vec<[[f32; 4]; 2]> =
            (0..self.cells.len()).into_par_iter().with_min_len(CELLS).map(of_cell).collect();
        let mut texels = vec![[0.0; 4]; 2 * LEVELS * GRID_CELLS];
        for (index, [root, direction]) in of_cells.into_iter().enumerate() {
            texels[texel_of(index)] = root;
            texels[LEVELS * GRID_CELLS + texel_of(index)] = direction;
        }
        for texels in texels.chunks_exact_mut(LEVELS * GRID_CELLS) {
            level_border(texels, is_needed);
        }
        GroundLight { texels, extent: self.extent }
    }

    /// The sunlit part of a cell, by the slope of its horizon towards the sun.
    fn sunlit(&self, index: usize, sun: SunDirection) -> f32 {
        let (level, start) = (index / GRID_CELLS, self.extent.position(index));
        let slope = |cells: &f32| {
            let distance_m = cells * self.extent.cell_m(level);
            (self.at(level, start + distance_m * sun.towards).1 - self.cells[index].height_m) / distance_m
        };
        let horizon = DISTANCES.iter().map(slope).fold(f32::MIN, f32::max);
        let of_sun = sun.sine / sun.cosine;
        (0.5 + 0.5 * (of_sun - horizon) / (SOFTNESS * of_sun)).clamp(0.0, 1.0)
    }

    /// Adds what a cell receives from one way.
    fn follow(&self, index: usize, sun: SunDirection, way: &Way, received: &mut Received) {
        let (own, start, level) = (&self.cells[index], self.extent.position(index), index / GRID_CELLS);
        let own_lean = -own.slope.dot(way.direction);
        let leans = [0.0, LEAN * way.to_sun, -LEAN * way.to_sun, LEAN * way.to_left, -LEAN * way.to_left];
        let leans = leans.map(|lean| own_lean + lean);
        let mut passed: [Passed; DISTANCES.len()] = Default::default();
        let (mut before_m, mut before_height_m, mut before_sunlit) = (0.0, own.height_m, own.sunlit);
        let mut highest = -1.0_f32;
        for (sample, distance) in DISTANCES.into_iter().enumerate() {
            let distance_m = distance * self.extent.cell_m(level);
            if (self.top_m - own.height_m).max(0.0) <= highest * distance_m {
                break;
            }
            let (cell, height_m) = self.at(level, start + distance_m * way.direction);
            let (stretch_m, above_m) = (distance_m - before_m, height_m - own.height_m);
            let rise = (height_m - before_height_m) / stretch_m;
            (before_m, before_height_m) = (distance_m, height_m);
            let sunlit = 0.5 * (cell.sunlit + std::mem::replace(&mut before_sunlit, cell.sunlit));
            let rocks_m = cell.rock_front / (FRONTAL_AREA * cell.rock_width).max(1e-9);
            passed[sample] = [distance_m, above_m, stretch_m * cell.rock_width, rocks_m];
            let slope = above_m / distance_m;
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
            let square = 1.0 / (1.0 + middle * middle);
            let slopes = cell.slope + (rise - cell.slope.dot(way.direction)) * way.direction;
            let per_length = 1.0 / (1.0 + slopes.length_squared()).sqrt();
            let emission = (per_length * square.sqrt() * (rise - middle)).max(MIN_EMISSION);
            let incidence = (per_length * (sun.sine - sun.cosine * slopes.dot(sun.towards))).max(0.0);
            // Seen along the sunlight, rocks hide their own shadows.
            let in_shadow = cell.rock_front * sun.cosine / sun.sine * (0.5 + 0.5 * way.to_sun);
            let visible = libm::expf(-in_shadow - depth_of_rocks(&passed[..sample], middle));
            let radiance = visible * sunlit * way.factor(incidence, emission);
            // Of the integral over the slopes: to the power of 3/2 for the solid angle, 1/2 for the projection.
            let per_slope = TAU / AZIMUTHS as f32 * radiance * square * square;
            let light = leans.map(|lean| {
                let [low, high] = [lowest, slope].map(|slope| (slope + lean).max(0.0));
                0.5 * per_slope * (high * high - low * low)
            });
            received.on_ground.iter_mut().zip(light).for_each(|(sum, light)| *sum += light);
            received.directions += light[0] * square.sqrt() * way.direction.extend(middle);
        }
    }
}

/// Optical depth of the rocks that a ray of this slope passes. By power laws of their sizes, what stands higher than some height falls
/// with its first power.
fn depth_of_rocks(passed: &[Passed], slope: f32) -> f32 {
    let of_place = |[distance_m, above_m, widths, rocks_m]: &Passed| {
        let ray_m = (slope * distance_m - above_m).max(0.0);
        widths * rocks_m / (rocks_m + ray_m).max(1e-6)
    };
    passed.iter().map(of_place).sum()
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
mod tests;
