//! Sunlit rocks as sources of light, and which ground around each rock is sunlit: what lights shadows (`common/lit_rocks.wgsl`).
//!
//! A rock lights what is within some diameters of it. Grids like those of the casters, with fewer cells, list the rocks that
//! reach each cell. Rocks too small to be more than specks in the image are left out.
//! What the horizon map tells of the ground comes in as a function, so that imports go from `shadow/` to `select/` and not back.
//! Must not know: how the horizon map is made.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::render::select::caster_grid::{CasterGrids, TEST_HORIZON};
use crate::render::select::casters::Caster;
use crate::render::select::selection::{SelectedRock, Selection, Slots};
use crate::scene::Scene;
use crate::scene::rocks::Rock;

/// Distance that a rock lights, in geometric means of its height and its radius. `common/lit_rocks.wgsl` has the same.
pub const REACH: f32 = 12.0;
/// Cells of the caster grids along a side of a cell of these.
const CASTER_CELLS: u32 = 8;
/// Minimum diameter of a rock that lights anything, pixels.
const MIN_PX: f32 = 5.0;
/// Points around a rock at which the ground is sunlit or not: degrees from the direction away from the sun, and distance in
/// radii. Those in the rock's own shadow are left out: the fit of the bounced light has it.
const GROUND_AROUND: [(f64, f32); 6] =
    [(-45.0, 2.5), (45.0, 2.5), (-110.0, 2.5), (110.0, 2.5), (-35.0, 6.0), (35.0, 6.0)];
/// Radius of a sphere with the shadow of a rock, as a fraction of the rock's largest.
const SHADOW_RADIUS: f32 = 0.8;

/// Words of [`LitRocks::words`] for a rock. `common/lit_rocks.wgsl` has the same.
pub const ROCK_WORDS: usize = size_of::<LitRock>() / size_of::<u32>();

/// A sunlit rock, as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct LitRock {
    /// Point on the ground below its centre, metres, world.
    foot: Vec3,
    /// Height of its top above that, metres.
    height_m: f32,
    /// Its colour times the irradiance of the sun, times the sunlit fraction of its sunny side.
    light: Vec3,
    /// Its radius, metres.
    radius_m: f32,
    /// Its slot among the instances.
    slot: u32,
}

/// The sunlit rocks of a frame, and the cells that each lights.
#[derive(Clone, Debug, Default)]
pub struct LitRocks {
    /// For each cell the start of its list (and after the last cell the end of the last list), then the lists of indices of
    /// rocks, then the rocks.
    pub words: Vec<u32>,
    /// Word at which the rocks begin.
    pub first_rock: u32,
    /// Cells along a side of each grid.
    pub cells: u32,
    /// Of each rock of the selection, the light on the ground around it relative to that on all ground. Relief that shadows
    /// itself takes none away: what is sunlit faces the sun all the more.
    pub sunlit_ground: Vec<f32>,
}

/// The light that falls on rocks and ground.
#[derive(Clone, Copy)]
struct SunlitScene<'a> {
    scene: &'a Scene,
    casters: &'a [Caster],
    grids: CasterGrids,
    caster_grid: &'a [u32],
    /// Heights above a point from which the lower and the upper limb of the sun are visible past the ground, metres.
    limbs: &'a (dyn Fn(Vec2) -> [f32; 2] + Sync),
}

impl LitRocks {
    /// The sunlit rocks among those of a selection. `limbs` are the heights above a point from which the lower and the upper limb
    /// of the sun are visible past the ground; `colour` is the factor from albedo to colour of a rock.
    #[must_use]
    pub fn new(
        scene: &Scene,
        selection: &Selection,
        caster_grid: &[u32],
        limbs: &(dyn Fn(Vec2) -> [f32; 2] + Sync),
        (colour, pixel_angle): (f32, f32),
    ) -> Self {
        let grids = CasterGrids::new(&scene.terrain);
        let sunlit = SunlitScene { scene, casters: &selection.casters, grids, caster_grid, limbs };
        let of_rock = |(index, selected): (usize, &SelectedRock)| {
            let rock = &scene.rocks[selected.rock];
            let exposed = Exposed::new(scene, rock);
            let is_speck = 2.0 * rock.base_scale_m < MIN_PX * pixel_angle * selected.nearest_m;
            let lit = (!is_speck && rock.body.is_rock()).then(|| LitRock {
                foot: exposed.foot,
                height_m: exposed.height_m,
                radius_m: rock.base_scale_m,
                light: colour
                    * rock.material.albedo
                    * scene.sun.irradiance
                    * sunlit.of_rock(selected, &exposed),
                slot: Slots::rock(index),
            });
            let is_judged = !is_speck && selected.visible_level.is_some();
            (is_judged.then(|| sunlit.around(selected, rock, &exposed)), lit)
        };
        let (around, rocks): (Vec<Option<[f32; 2]>>, Vec<Option<LitRock>>) =
            selection.rocks.par_iter().enumerate().map(of_rock).unzip();
        let judged = || around.iter().flatten();
        let past_ground =
            judged().map(|[past_ground, _]| past_ground).sum::<f32>() / judged().count().max(1) as f32;
        let relative = |[_, past_all]: [f32; 2]| (past_all / past_ground.max(1e-3)).min(1.0);
        let sunlit_ground = around.iter().map(|around| around.map_or(1.0, relative)).collect();
        let rocks: Vec<LitRock> = rocks.into_iter().flatten().filter(|rock| rock.light.y > 0.0).collect();
        Self { sunlit_ground, ..Self::listed(grids, &rocks) }
    }

    /// `FrameUniforms::lit_rocks`, where [`Self::words`] follow this many other words.
    #[must_use]
    pub fn uniform(&self, before: usize) -> [u32; 4] {
        let before = before as u32;
        [before, before + self.first_rock, self.cells, u32::from(!self.words.is_empty())]
    }

    /// Lists the rocks by the cells that they reach: a counting sort.
    fn listed(grids: CasterGrids, rocks: &[LitRock]) -> Self {
        let grids = CasterGrids { cells: (grids.cells / CASTER_CELLS).max(1), ..grids };
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (index, rock) in (0..).zip(rocks) {
            let reach_m = REACH * (rock.height_m * rock.radius_m).sqrt();
            for_cells_within(&grids, rock.foot.truncate(), reach_m, |cell| {
                pairs.push((cell, index));
            });
        }
        pairs.sort_unstable();
        let cells = grids.cell_count();
        let first_rock = cells + 1 + pairs.len();
        let mut words = vec![0; first_rock + ROCK_WORDS * rocks.len()];
        for &(cell, _) in &pairs {
            words[cell as usize + 1] += 1;
        }
        let mut start = (cells + 1) as u32;
        for word in &mut words[..=cells] {
            start += *word;
            *word = start;
        }
        for (word, (_, rock)) in words[cells + 1..].iter_mut().zip(&pairs) {
            *word = *rock;
        }
        words[first_rock..].copy_from_slice(bytemuck::cast_slice(rocks));
        Self { words, first_rock: first_rock as u32, cells: grids.cells, sunlit_ground: Vec::new() }
    }
}

/// Calls `visit` with the cells within a distance of a point, of each grid those that no finer one covers.
fn for_cells_within(grids: &CasterGrids, point: Vec2, reach_m: f32, mut visit: impl FnMut(u32)) {
    let from_centre = point - grids.centre;
    let (nearest_m, furthest_m) =
        ((from_centre.abs() - reach_m).max_element(), (from_centre.abs() + reach_m).max_element());
    for level in 0..grids.levels {
        let half_m = grids.half_m * (1_u32 << level) as f32;
        let is_last = level + 1 == grids.levels;
        // With a margin: a device may round to the other side of a border.
        if (level > 0 && furthest_m < 0.499 * half_m) || (nearest_m > 1.001 * half_m && !is_last) {
            continue;
        }
        let cells = grids.cells as f32;
        let cell_m = 2.0 * half_m / cells;
        let index = |metres: f32| ((metres + half_m) / cell_m).floor().clamp(0.0, cells - 1.0) as u32;
        let (low, high) = (from_centre - 1.01 * reach_m, from_centre + 1.01 * reach_m);
        for row in index(low.y)..=index(high.y) {
            for column in index(low.x)..=index(high.x) {
                visit((level * grids.cells + row) * grids.cells + column);
            }
        }
    }
}

/// The part of a rock above the ground.
#[derive(Clone, Copy, Debug)]
pub struct Exposed {
    /// Point on the ground below its centre, metres, world.
    pub foot: Vec3,
    /// Height of its top above that, metres.
    pub height_m: f32,
}

impl Exposed {
    /// Of a rock on the scene's ground.
    #[must_use]
    pub fn new(scene: &Scene, rock: &Rock) -> Self {
        let position = rock.centre.truncate();
        let ground_m = scene.terrain.surface_height_at(position);
        let top_m = rock.centre.z + rock.z_range_m[1];
        Self { foot: position.extend(ground_m), height_m: (top_m - ground_m).max(0.1 * rock.base_scale_m) }
    }

    /// The point at a fraction of its height.
    fn at(&self, fraction: f32) -> Vec3 {
        self.foot + fraction * self.height_m * Vec3::Z
    }
}

impl SunlitScene<'_> {
    /// Sunlit fraction of the side of a rock that faces the sun.
    fn of_rock(&self, selected: &SelectedRock, exposed: &Exposed) -> f32 {
        let [lower, upper] = (self.limbs)(exposed.foot.truncate());
        let hidden_m = 0.5 * (lower + upper) - exposed.foot.z;
        let past_ground = (1.0 - hidden_m / exposed.height_m).clamp(0.0, 1.0);
        let radius_m = self.scene.rocks[selected.rock].base_scale_m.min(exposed.height_m);
        past_ground * self.past_rocks(exposed.at(0.5), radius_m, selected.rock)
    }

    /// Sunlit fraction of the ground around a rock, past other ground and past everything.
    fn around(&self, selected: &SelectedRock, rock: &Rock, exposed: &Exposed) -> [f32; 2] {
        let away = -self.scene.sun.direction.truncate().normalize_or(Vec2::X);
        let mut sums = [0.0; 2];
        for (turn_deg, radii) in GROUND_AROUND {
            let (sin, cos) = (libm::sin(turn_deg.to_radians()), libm::cos(turn_deg.to_radians()));
            let towards = away.rotate(Vec2::new(cos as f32, sin as f32));
            let position = exposed.foot.truncate() + radii * rock.base_scale_m * towards;
            let point = position.extend(self.scene.terrain.surface_height_at(position));
            let [lower, upper] = (self.limbs)(position);
            let past_ground = ((point.z - upper) / (lower - upper).max(1e-6)).clamp(0.0, 1.0);
            sums[0] += past_ground;
            sums[1] += past_ground * self.past_rocks(point, 0.25 * rock.base_scale_m, selected.rock);
        }
        sums.map(|sum| sum / GROUND_AROUND.len() as f32)
    }

    /// Fraction of a disc of this radius that is sunlit past all rocks but one.
    fn past_rocks(&self, point: Vec3, radius_m: f32, but: usize) -> f32 {
        let sun = self.scene.sun.direction;
        let others = self.casters_at(point.truncate()).iter().map(|&caster| &self.casters[caster as usize]);
        others.filter(|caster| caster.rock != but).fold(1.0, |sunlit, caster| {
            let offset = caster.tile.centre - point;
            let along_m = offset.dot(sun);
            if along_m <= 0.0 {
                return sunlit;
            }
            let across_m = (offset - along_m * sun).length();
            let own_m = SHADOW_RADIUS * caster.tile.half_extent_m;
            let covered = ((own_m + radius_m - across_m) / (2.0 * own_m.min(radius_m))).clamp(0.0, 1.0);
            sunlit * (1.0 - covered * (own_m * own_m / (radius_m * radius_m)).min(1.0))
        })
    }

    /// The casters that can shade a point.
    fn casters_at(&self, point: Vec2) -> &[u32] {
        let CasterGrids { centre, half_m, cells, levels } = self.grids;
        let from_centre = (point - centre).abs().max_element();
        let mut level = 0;
        while level + 1 < levels && from_centre > half_m * (1_u32 << level) as f32 {
            level += 1;
        }
        let half_m = half_m * (1_u32 << level) as f32;
        let index = |metres: f32| {
            ((metres + half_m) * 0.5 * cells as f32 / half_m).clamp(0.0, (cells - 1) as f32) as u32
        };
        let cell = ((level * cells + index(point.y - centre.y)) * cells + index(point.x - centre.x)) as usize;
        let [start, end] = [cell, cell + 1].map(|cell| (self.caster_grid[cell] & !TEST_HORIZON) as usize);
        &self.caster_grid[start..end]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rock_is_listed_in_every_cell_that_it_reaches() {
        let grids = CasterGrids { centre: Vec2::new(3.0, -8.0), half_m: 4.0, cells: 192, levels: 5 };
        let rocks: Vec<LitRock> = (0..40)
            .map(|k| {
                let (angle, distance_m) = (2.4 * f64::from(k), 1.3 * f64::from(k));
                let offset = distance_m * glam::DVec2::new(libm::cos(angle), libm::sin(angle));
                let foot = (grids.centre + offset.as_vec2()).extend(0.0);
                let size_m = 0.05 * (1 + k % 7) as f32;
                LitRock { foot, height_m: size_m, light: Vec3::ONE, radius_m: size_m, slot: k as u32 + 1 }
            })
            .collect();
        let lit = LitRocks::listed(grids, &rocks);
        assert_eq!(lit.words.len(), lit.first_rock as usize + ROCK_WORDS * rocks.len());
        let mut listed = 0;
        for (x, y) in (-300..300).flat_map(|x| (-300..300).map(move |y| (x, y))).step_by(17) {
            let from_centre = 0.2 * Vec2::new(x as f32 + 0.37, y as f32 + 0.11);
            let furthest_m = from_centre.abs().max_element();
            let level = (0..grids.levels).find(|level| furthest_m <= 4.0 * (1 << level) as f32).unwrap_or(4);
            let half_m = 4.0 * (1_u32 << level) as f32;
            let index = |metres: f32| ((metres + half_m) * 0.5 * lit.cells as f32 / half_m) as u32;
            let cell = (level * lit.cells + index(from_centre.y)) * lit.cells + index(from_centre.x);
            let [first, end] = [cell, cell + 1].map(|cell| lit.words[cell as usize] as usize);
            let list = &lit.words[first..end];
            for (index, rock) in (0..).zip(&rocks) {
                let distance_m = (grids.centre + from_centre).distance(rock.foot.truncate());
                let is_reached = distance_m < REACH * rock.height_m;
                assert!(!is_reached || list.contains(&index), "rock {index} at {from_centre}");
            }
            listed += list.len();
        }
        assert!(listed > 100, "{listed}");
    }
}
