//! Bounds of the ground's height on coarse nested grids, and how far the shadow of a rock can reach above it.
//!
//! Rings have cells of all sizes: blocks of them are entered into square grids around the centre, each over twice the side of the one
//! before, as of the caster grid. Bounds are conservative: nowhere does a shadow end too early.
//! Must not know: what a shadow is drawn into.

use std::ops::RangeInclusive;

use glam::{Vec2, Vec3};

use super::mesh::Vertex;
use super::sky::Sun;

/// Cells along a side of each grid.
const CELLS: usize = 64;
/// Half the side of the innermost grid, metres.
const INNERMOST_M: f32 = 4.0;
/// Cells of the mesh along a side of the blocks that are entered as one.
const BLOCK_CELLS: usize = 4;
/// Cells of a grid along a side of the boxes that are asked for, at most about.
const BOX_CELLS: f32 = 4.0;
/// Length of a step along a shadow as a fraction of the way to it.
const STEP: f32 = 0.4;

/// Bounds of the height of ground with rings.
#[derive(Clone, Debug)]
pub(crate) struct GroundRange {
    centre: Vec2,
    levels: usize,
    /// Lower bounds, level by level and row by row, metres; infinite where there is no ground.
    lowest_m: Vec<f32>,
    /// Upper bounds.
    highest_m: Vec<f32>,
}

impl GroundRange {
    /// Of rings around `centre`: `rows` of them, each with `columns` cells, out to `radius_m`.
    #[must_use]
    pub(super) fn new(
        vertices: &[Vertex],
        [columns, rows]: [usize; 2],
        (centre, radius_m): (Vec2, f32),
    ) -> Self {
        let mut levels = 1;
        while radius_m > half_m(levels - 1) {
            levels += 1;
        }
        let lowest_m = vec![f32::INFINITY; levels * CELLS * CELLS];
        let highest_m = vec![f32::NEG_INFINITY; lowest_m.len()];
        let mut ground = Self { centre, levels, lowest_m, highest_m };
        for row in (0..rows).step_by(BLOCK_CELLS) {
            for column in (0..columns).step_by(BLOCK_CELLS) {
                let last = [(column + BLOCK_CELLS).min(columns), (row + BLOCK_CELLS).min(rows)];
                let block = (row..=last[1]).flat_map(|row| {
                    let first = row * (columns + 1);
                    &vertices[first + column..=first + last[0]]
                });
                let bounds = block.fold([Vec3::MAX, Vec3::MIN], |[low, high], vertex| {
                    [low.min(vertex.position), high.max(vertex.position)]
                });
                ground.enter(bounds);
            }
        }
        // The middle of each grid from the next finer one.
        for level in 1..levels {
            for (row, column) in (0..CELLS / 2).flat_map(|row| (0..CELLS / 2).map(move |c| (row, c))) {
                let finer = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .map(|(dx, dy)| index(level - 1, 2 * column + dx, 2 * row + dy));
                let coarser = index(level, CELLS / 4 + column, CELLS / 4 + row);
                for finer in finer {
                    ground.lowest_m[coarser] = ground.lowest_m[coarser].min(ground.lowest_m[finer]);
                    ground.highest_m[coarser] = ground.highest_m[coarser].max(ground.highest_m[finer]);
                }
            }
        }
        ground
    }

    /// Enters what lies within a box, into the grids that no finer one covers there.
    fn enter(&mut self, [low, high]: [Vec3; 2]) {
        let (from, to) = (low.truncate() - self.centre, high.truncate() - self.centre);
        let nearest = Vec2::ZERO.clamp(from, to).abs().max_element();
        let furthest = from.abs().max(to.abs()).max_element();
        for level in 0..self.levels {
            let half_m = half_m(level);
            if nearest > half_m || (level > 0 && furthest < 0.5 * half_m) {
                continue;
            }
            let [columns, rows] = [0, 1].map(|axis| cell(level, from[axis])..=cell(level, to[axis]));
            for (row, column) in rows.flat_map(|row| columns.clone().map(move |column| (row, column))) {
                let cell = index(level, column, row);
                self.lowest_m[cell] = self.lowest_m[cell].min(low.z);
                self.highest_m[cell] = self.highest_m[cell].max(high.z);
            }
        }
    }

    /// The rows of cells that bound the ground in a box, metres from the centre: ranges of indices.
    fn cells_under(&self, low: Vec2, high: Vec2) -> impl Iterator<Item = RangeInclusive<usize>> + use<> {
        let furthest = low.abs().max(high.abs()).max_element();
        let side = (high - low).max_element();
        let is_enough = |level: &usize| half_m(*level) >= furthest && BOX_CELLS * cell_m(*level) >= side;
        let level = (0..self.levels).find(is_enough).unwrap_or(self.levels - 1);
        let [columns, rows] = [0, 1].map(|axis| cell(level, low[axis])..=cell(level, high[axis]));
        rows.map(move |row| index(level, *columns.start(), row)..=index(level, *columns.end(), row))
    }

    /// Lower bound of the height of the ground in a box, metres from the centre.
    fn lowest_m(&self, low: Vec2, high: Vec2) -> f32 {
        let mut lowest_m = f32::INFINITY;
        for cells in self.cells_under(low, high) {
            for &here_m in &self.lowest_m[cells] {
                // `f32::min` is more than a comparison (NaN).
                lowest_m = if here_m < lowest_m { here_m } else { lowest_m };
            }
        }
        lowest_m
    }

    /// Lower and upper bound of the height of the ground in a box, metres, world; infinite where there is none.
    #[must_use]
    pub(crate) fn under(&self, low: Vec2, high: Vec2) -> [f32; 2] {
        let (low, high) = (low - self.centre, high - self.centre);
        let cells = self.cells_under(low, high).flatten();
        let highest_m = cells.map(|cell| self.highest_m[cell]).fold(f32::NEG_INFINITY, f32::max);
        [self.lowest_m(low, high), highest_m]
    }

    /// How far from its centre a rock can shadow what stands on the ground, along the sun's rays, metres: at most `longest_m`. `top_m` is
    /// the height of its highest point.
    #[must_use]
    pub(crate) fn shadow_reach_m(
        &self,
        sun: &Sun,
        centre: Vec3,
        top_m: f32,
        radius_m: f32,
        longest_m: f32,
    ) -> f32 {
        let level = sun.direction.truncate().length();
        if level < 1e-3 {
            return longest_m;
        }
        let away = -sun.direction.truncate() / level;
        let start = centre.truncate() - self.centre;
        let (penumbra, steepness) = (sun.tan_half_angle(), sun.lower_limb_slope());
        let end_m = longest_m * level;
        // From the side of the rock that faces away from the sun.
        let (mut way_m, mut reach_m) = (radius_m, radius_m);
        while way_m < end_m {
            let step_m = (STEP * way_m).max(radius_m);
            let half_width_m = radius_m + 3.0 * penumbra * (way_m + step_m);
            let (a, b) = (start + way_m * away, start + (way_m + step_m) * away);
            let lowest_m = self.lowest_m(a.min(b) - half_width_m, a.max(b) + half_width_m);
            way_m += step_m;
            // Where the interval begins the rays are highest.
            if top_m - (way_m - step_m - radius_m) * steepness >= lowest_m {
                reach_m = way_m;
            }
        }
        (reach_m / level + radius_m).min(longest_m)
    }
}

/// Half the side of a grid, metres.
fn half_m(level: usize) -> f32 {
    INNERMOST_M * (1_u32 << level) as f32
}

/// Side of a cell of a grid, metres.
fn cell_m(level: usize) -> f32 {
    2.0 * half_m(level) / CELLS as f32
}

/// Column or row of a coordinate, metres from the centre; the first or last beyond the border.
fn cell(level: usize, metres: f32) -> usize {
    ((metres + half_m(level)) / cell_m(level)).clamp(0.0, (CELLS - 1) as f32) as usize
}

const fn index(level: usize, column: usize, row: usize) -> usize {
    (level * CELLS + row) * CELLS + column
}

#[cfg(test)]
mod tests {
    use crate::params::config::Config;
    use crate::scene::Scene;

    #[test]
    fn no_ray_meets_the_ground_beyond_the_reach() {
        let mut config = Config::new();
        config.set_stage("surface").expect("a stage");
        let (mut shorter, mut rocks) = (0, 0);
        for (seed, elevation_deg) in [(3, 5), (4, 12), (5, 30)] {
            config.apply_set(&format!("sun.elevation_deg={elevation_deg}")).expect("a knob");
            let scene = Scene::build(seed, &config.draw(seed).expect("drawn")).expect("built");
            let (terrain, sun) = (&scene.terrain, &scene.sun);
            let ground = terrain.range().expect("rings");
            for rock in scene.rocks.iter().step_by(7) {
                let top_m = rock.centre.z + rock.z_range_m[1];
                let longest_m = (top_m - terrain.z_range_m[0]) / sun.direction.z + rock.radius_m;
                let reach_m = ground.shadow_reach_m(sun, rock.centre, top_m, rock.radius_m, longest_m);
                rocks += 1;
                shorter += u32::from(reach_m < 0.5 * longest_m);
                for k in 1..60_u8 {
                    let way_m = reach_m + f32::from(k) / 60.0 * (longest_m - reach_m);
                    let ray = rock.centre - way_m * sun.direction;
                    let height_m = ray.z + rock.z_range_m[1];
                    let is_above = terrain.contains(ray.truncate())
                        && height_m > terrain.surface_height_at(ray.truncate());
                    assert!(!is_above, "seed {seed}: a rock of {} m, {way_m} m away", rock.radius_m);
                }
            }
        }
        assert!(rocks > 100 && 2 * shorter > rocks, "{shorter} of {rocks} shadows are much shorter");
    }
}
