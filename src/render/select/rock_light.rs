//! Light of sunlit ground and of the rocks on it on each rock (`common/indirect.wgsl`).
//!
//! What a rock on level sunlit ground receives is known by its normals and heights (`src/scene/bounce.rs`). Real ground is partly in
//! shadow, rises and falls, and has other rocks on it. From each rock the ground is looked at in some azimuths, near by as it is and
//! further away on nested grids, from half the rock's height. The same sum over level sunlit ground gives the ratio, for faces to four
//! sides. What comes from above the horizon, and from rocks, adds to that.
//! Must not know: how shadows are found.

use std::f32::consts::PI;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use rayon::prelude::*;

use crate::render::select::azimuths::{AZIMUTHS, Azimuth, SeenRocks, WIDTH};
use crate::render::select::ground_grids::{CellsOfLanes, GroundGrids};
use crate::render::select::lane_math::{LANES, exp, load, splat, store};
use crate::render::select::lit_rocks::Exposed;
use crate::render::select::nested_grids::{CELLS, GRID_CELLS, LocatedLanes};
use crate::render::select::rock_cover::{CoverOfLanes, Passed, PassedRocks, RockCover, Spreads};
use crate::render::select::rock_views::{EYE, Horizon, OPEN_ROCKS, OpenRocks, Views, add, middle};
use crate::render::select::selection::Selection;
use crate::render::select::sunlight::LimbsAtLanes;
use crate::scene::Scene;
use crate::scene::rings_mesh::CornersOfLanes;
use crate::scene::terrain::Terrain;

/// Distance up to which the ground is looked at as it is, cells.
const NEAR_CELLS: f32 = 2.0;

/// Light on a rock. Faces to its sides are upright: towards the sun, to its left, away from it, to its right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightOnRock {
    /// On each side, of ground below the horizon: relative to level sunlit ground all around.
    pub below: [f32; 4],
    /// On each side, of rocks and from above the horizon: relative to uniform light of the radiance of level sunlit ground.
    pub beside: [f32; 4],
    /// The same on a level face; below zero if it comes from below.
    pub beside_on_top: f32,
}

impl LightOnRock {
    /// In the open.
    pub const OPEN: Self = Self { below: [1.0; 4], beside: [0.0; 4], beside_on_top: 0.0 };

    /// On each rock of a selection; those out of view are taken to lie in the open.
    #[must_use]
    pub fn on_selection(
        scene: &Scene,
        selection: &Selection,
        ground: &GroundGrids,
        limbs: LimbsAtLanes<'_>,
    ) -> Vec<Self> {
        let is_speck = |index: usize| ground.rocks[index].is_some_and(|rock| !rock.is_listed);
        let in_view = selection.rocks.iter().enumerate().filter(|(_, rock)| rock.visible_level.is_some());
        let (specks, others): (Vec<_>, Vec<_>) =
            in_view.map(|(index, _)| index).partition(|index| is_speck(*index));
        let (all, some) = (Views::all(ground), Views::of_specks(ground));
        let chunks: Vec<(&[usize], &Views)> = others
            .chunks(LANES)
            .map(|rocks| (rocks, &all))
            .chain(specks.chunks(LANES).map(|rocks| (rocks, &some)))
            .collect();
        let place = |index: usize| Place {
            exposed: ground.exposed[index],
            radius_m: scene.rocks[selection.rocks[index].rock].base_scale_m,
            own: ground.rocks[index].map_or_else(Spreads::default, |rock| rock.spreads(ground.grids)),
        };
        let surroundings = Surroundings { terrain: &scene.terrain, ground, limbs };
        let light = |(rocks, views): (&[usize], &Views)| {
            // Lanes past the last rock look as that does.
            surroundings.light(&std::array::from_fn(|lane| place(rocks[lane.min(rocks.len() - 1)])), views)
        };
        let of_chunks: Vec<[Self; LANES]> = chunks.par_iter().map(|chunk| light(*chunk)).collect();
        let mut on_rocks = vec![Self::OPEN; selection.rocks.len()];
        for ((rocks, _), of_chunk) in chunks.iter().zip(of_chunks) {
            for (rock, light) in rocks.iter().zip(of_chunk) {
                on_rocks[*rock] = light;
            }
        }
        on_rocks
    }
}

/// What is looked at from rocks.
struct Surroundings<'a> {
    terrain: &'a Terrain,
    ground: &'a GroundGrids,
    limbs: LimbsAtLanes<'a>,
}

/// Where a rock lies.
struct Place {
    exposed: Exposed,
    radius_m: f32,
    /// What it adds to the cells.
    own: Spreads,
}

/// Where eight rocks lie.
struct Places<'a, S: Simd> {
    rocks: &'a [Place; LANES],
    /// Their feet, metres, world.
    foot: [f32x8<S>; 3],
    radius_m: f32x8<S>,
    height_m: f32x8<S>,
    /// Distances up to which the ground is looked at as it is, metres.
    near_m: f32x8<S>,
    /// Of each, the last of the [`OpenRocks`] that is not higher.
    open: [usize; LANES],
    /// How far it is to the next.
    above_open: f32x8<S>,
}

/// Sums over what is seen. On the sides: irradiance per radian of azimuth, as radiance factor times solid angle.
struct Received<S: Simd> {
    below: [f32x8<S>; 4],
    beside: [f32x8<S>; 4],
    on_top: f32x8<S>,
}

impl Surroundings<'_> {
    fn light(&self, rocks: &[Place; LANES], views: &Views) -> [LightOnRock; LANES] {
        let (sums, open) = dispatch!(Level::new(), simd => {
            let places = Places::new(simd, self.ground, rocks);
            let received = self.received(simd, &places, views);
            let mut open = [[0.0; LANES]; 4];
            for (open, sides) in open.iter_mut().zip(&views.open.sides) {
                *open = store(places.of_open(simd, sides));
            }
            (received.stored(), open)
        });
        let relative = views.step as f32 * WIDTH / (PI * self.ground.level_factor);
        std::array::from_fn(|lane| LightOnRock {
            below: std::array::from_fn(|side| sums[side][lane] / open[side][lane].max(1e-9)),
            beside: std::array::from_fn(|side| relative * sums[4 + side][lane]),
            beside_on_top: relative * sums[8][lane],
        })
    }

    // What takes vectors is inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    fn received<S: Simd>(&self, simd: S, places: &Places<'_, S>, views: &Views) -> Received<S> {
        let mut received = Received::none(simd);
        let mut known = CornersOfLanes::default();
        for index in (0..AZIMUTHS).step_by(views.step) {
            self.follow(simd, places, views, index, &mut known, &mut received);
        }
        received
    }

    /// Adds what comes from one azimuth.
    #[inline(always)]
    fn follow<S: Simd>(
        &self,
        simd: S,
        places: &Places<'_, S>,
        views: &Views,
        index: usize,
        known: &mut CornersOfLanes,
        received: &mut Received<S>,
    ) {
        let azimuth = &self.ground.azimuths[index];
        let [foot_x, foot_y, foot_m] = places.foot;
        let eye_m = foot_m + places.height_m * EYE;
        let mut passed = PassedRocks::none(simd);
        let (mut before_m, mut before_height_m, mut before_sunlit) = (places.radius_m, foot_m, None);
        let mut horizon = Horizon::lowest(simd);
        for (distance, unshadowed) in views.distances.iter().zip(&views.open.unshadowed[index]) {
            let distance_m = places.radius_m * *distance;
            let points =
                [foot_x + distance_m * azimuth.direction.x, foot_y + distance_m * azimuth.direction.y];
            let located = self.ground.grids.locate_lanes(simd, 0, points);
            let mut cells = CellsOfLanes::new(simd, self.ground.cells_at(&located.indices));
            let rocks = self.other_rocks(simd, places, &located, &mut cells);
            let is_near = distance_m.simd_lt(places.near_m);
            let (mut height_m, mut sunlit) = (cells.height_at(&located), cells.sunlit);
            if is_near.any_true() {
                let near = self.near(simd, points, is_near, known);
                (height_m, sunlit) = (is_near.select(near[0], height_m), is_near.select(near[1], sunlit));
            }
            let (stretch_m, from_m) = (distance_m - before_m, distance_m - places.radius_m);
            let above_m = height_m - eye_m;
            passed.push(&Passed {
                distance_m: from_m,
                above_m,
                depth: rocks.depth * stretch_m,
                half_height_m: cells.half_height_m,
            });
            let slope = above_m / from_m;
            let seen = Horizon::at(simd, slope).or_higher(horizon);
            let seen_rocks = SeenRocks {
                cover: &rocks,
                passed: &passed,
                horizon: horizon.slope,
                slope,
                from_m,
                stretch_m,
            };
            if let Some(light) = azimuth.light_of_rocks(simd, &seen_rocks, sunlit) {
                received.add_rocks(azimuth, light);
            }
            let rise = (height_m - before_height_m) / stretch_m;
            let mean_sunlit = (sunlit + before_sunlit.unwrap_or(sunlit)) * 0.5;
            (before_m, before_height_m, before_sunlit) = (distance_m, height_m, Some(sunlit));
            let lowest = std::mem::replace(&mut horizon, seen);
            let lit = mean_sunlit * places.of_open(simd, unshadowed);
            let is_lit = seen.slope.simd_gt(lowest.slope) & lit.simd_gt(0.0);
            if !is_lit.any_true() {
                continue;
            }
            let middle = middle(lowest.slope, seen.slope);
            let hidden = azimuth.depth_of_shadows(&rocks) + passed.depth(simd, middle);
            let factor = azimuth.radiance_factor(simd, cells.slope, rise, middle);
            let radiance = is_lit.select(lit * exp(simd, -hidden) * factor, splat(simd, 0.0));
            received.add_ground(simd, azimuth, radiance, [lowest, seen]);
        }
    }

    /// Heights of the ground near by, metres, and the part of the sun that is visible there; of points in a mask, anything elsewhere.
    #[inline(always)]
    fn near<S: Simd>(
        &self,
        simd: S,
        points: [f32x8<S>; 2],
        mask: mask32x8<S>,
        known: &mut CornersOfLanes,
    ) -> [f32x8<S>; 2] {
        let heights_m = self.terrain.surface_heights_at(simd, points, mask, known);
        let [lower, upper] = (self.limbs)(&[store(points[0]), store(points[1])]);
        let [lower, upper] = [load(simd, &lower), load(simd, &upper)];
        let visible = (heights_m - upper) / (lower - upper).max(1e-6);
        [heights_m, visible.max(0.0).min(1.0)]
    }

    /// The other rocks of cells, and sets the height above which half of what they hide is left.
    #[inline(always)]
    fn other_rocks<S: Simd>(
        &self,
        simd: S,
        places: &Places<'_, S>,
        located: &LocatedLanes<S>,
        cells: &mut CellsOfLanes<S>,
    ) -> CoverOfLanes<S> {
        let mut rocks = [RockCover::default(); LANES];
        let mut has_own = false;
        for (lane, rocks) in rocks.iter_mut().enumerate() {
            let index = located.indices[lane];
            *rocks = self.ground.cells[index].rocks;
            let (column, row) = (index % CELLS, index / CELLS % CELLS);
            if let Some(own) = &places.rocks[lane].own[index / GRID_CELLS]
                && own.columns.contains(&column)
                && own.rows.contains(&row)
            {
                *rocks = *rocks - own.cover;
                has_own = true;
            }
        }
        let rocks = CoverOfLanes::new(simd, rocks.each_ref());
        if has_own {
            cells.half_height_m = rocks.half_height_m(simd);
        }
        rocks
    }
}

impl<'a, S: Simd> Places<'a, S> {
    #[inline(always)]
    fn new(simd: S, ground: &GroundGrids, rocks: &'a [Place; LANES]) -> Self {
        let mut fields = [[0.0; LANES]; 5];
        let (mut open, mut above_open) = ([0; LANES], [0.0; LANES]);
        for (lane, Place { exposed, radius_m, .. }) in rocks.iter().enumerate() {
            let numbers = [exposed.foot.x, exposed.foot.y, exposed.foot.z, *radius_m, exposed.height_m];
            for (field, number) in fields.iter_mut().zip(numbers) {
                field[lane] = number;
            }
            (open[lane], above_open[lane]) = OpenRocks::locate(exposed.height_m / radius_m);
        }
        let foot = [load(simd, &fields[0]), load(simd, &fields[1]), load(simd, &fields[2])];
        Self {
            rocks,
            foot,
            radius_m: load(simd, &fields[3]),
            height_m: load(simd, &fields[4]),
            near_m: ground.grids.locate_lanes(simd, 0, [foot[0], foot[1]]).cell_m * NEAR_CELLS,
            open,
            above_open: load(simd, &above_open),
        }
    }

    /// What [`OpenRocks`] have, between those of the rocks' heights.
    #[inline(always)]
    fn of_open(&self, simd: S, of_rocks: &[f32; OPEN_ROCKS]) -> f32x8<S> {
        let mut ends = [[0.0; LANES]; 2];
        for (lane, open) in self.open.into_iter().enumerate() {
            let open = open.min(OPEN_ROCKS - 2);
            (ends[0][lane], ends[1][lane]) = (of_rocks[open], of_rocks[open + 1]);
        }
        let [low, high] = [load(simd, &ends[0]), load(simd, &ends[1])];
        low + (high - low) * self.above_open
    }
}

impl<S: Simd> Received<S> {
    #[inline(always)]
    fn none(simd: S) -> Self {
        let zero = splat(simd, 0.0);
        Self { below: [zero; 4], beside: [zero; 4], on_top: zero }
    }

    /// The sums below, beside and on top.
    #[inline(always)]
    fn stored(&self) -> [[f32; LANES]; 9] {
        let mut sums = [[0.0; LANES]; 9];
        for side in 0..4 {
            (sums[side], sums[4 + side]) = (store(self.below[side]), store(self.beside[side]));
        }
        sums[8] = store(self.on_top);
        sums
    }

    /// Adds ground of this radiance between two slopes.
    #[inline(always)]
    fn add_ground(&mut self, simd: S, azimuth: &Azimuth, radiance: f32x8<S>, [low, high]: [Horizon<S>; 2]) {
        add(&mut self.below, azimuth, radiance * (high.upright.min(0.0) - low.upright.min(0.0)));
        if high.slope.simd_gt(0.0).any_true() {
            add(&mut self.beside, azimuth, radiance * (high.upright.max(0.0) - low.upright.max(0.0)));
            let squares = [square_of_sine(simd, low.slope), square_of_sine(simd, high.slope)];
            self.on_top += radiance * (squares[1] - squares[0]) * 0.5;
        }
    }

    /// Adds rocks, whose light on an upright face comes from this slope.
    #[inline(always)]
    fn add_rocks(&mut self, azimuth: &Azimuth, [light, slope]: [f32x8<S>; 2]) {
        add(&mut self.beside, azimuth, light);
        self.on_top += light * slope;
    }
}

/// The square of the sine of the elevation of a slope; of what lies below the horizon zero.
#[inline(always)]
fn square_of_sine<S: Simd>(simd: S, slope: f32x8<S>) -> f32x8<S> {
    let square = slope.max(0.0) * slope.max(0.0);
    square / (splat(simd, 1.0) + square)
}

#[cfg(test)]
mod tests;
