//! Light of sunlit ground and of the rocks on it on each rock (`common/indirect.wgsl`).
//!
//! What a rock on level sunlit ground receives is known by its normals and heights (`src/scene/bounce.rs`). Real ground is partly in
//! shadow, rises and falls, and has other rocks on it. From each rock the ground is looked at in some azimuths, near by as it is and
//! further away on nested grids, from half the rock's height. The same sum over level sunlit ground gives the ratio, for faces to four
//! sides. What comes from above the horizon, and from rocks, adds to that.
//! Must not know: how shadows are found.

use std::f32::consts::PI;

use glam::{FloatExt, Vec2};
use rayon::prelude::*;

use crate::render::select::azimuths::{AZIMUTHS, Azimuth, SeenRocks, SunDirection, WIDTH};
use crate::render::select::ground_grids::{Cell, GroundGrids};
use crate::render::select::lit_rocks::Exposed;
use crate::render::select::nested_grids::{CELLS, GRID_CELLS};
use crate::render::select::rock_cover::{Passed, PassedRocks, RockCover, Spreads};
use crate::render::select::selection::{SelectedRock, Selection};
use crate::render::select::sunlight::{LimbsAt, visible_above};
use crate::scene::Scene;
use crate::scene::terrain::Terrain;

/// Distances from the middle of a rock at which the ground is looked at, in its radii.
const DISTANCES: [f32; 12] = [1.4, 2.0, 3.0, 4.5, 7.0, 11.0, 17.0, 27.0, 43.0, 70.0, 120.0, 200.0];
/// Distance up to which the ground is looked at as it is, cells.
const NEAR_CELLS: f32 = 2.0;
/// Height from which it is looked at, as a fraction of the rock's.
const EYE: f32 = 0.5;
/// Steepest slope at which ground counts as seen: below it lies the foot of the rock.
const STEEPEST: f32 = -3.0;
/// The same for rocks that are specks in the image. With these and every second azimuth their light differs by some 7 % from that by all
/// (root mean square of the logarithm, medians of five scenes).
const DISTANCES_OF_SPECKS: [f32; 5] = [2.0, 4.5, 11.0, 43.0, 200.0];
/// Of specks every second azimuth is looked at.
const STEP_OF_SPECKS: usize = 2;
/// Heights over radii for which a rock in the open is found.
const OPEN_ROCKS: usize = 24;
/// The quotient of two of them in turn.
const OPEN_QUOTIENT: f32 = 1.18;
/// The least of them. [`Exposed`] has it, too.
const OPEN_LEAST: f32 = 0.1;

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
        limbs: LimbsAt<'_>,
    ) -> Vec<Self> {
        let all = Views::new(ground, 1, &DISTANCES);
        let some = Views::new(ground, STEP_OF_SPECKS, &DISTANCES_OF_SPECKS);
        let on_rock = |(index, selected): (usize, &SelectedRock)| {
            if selected.visible_level.is_none() {
                return Self::OPEN;
            }
            let rock = ground.rocks[index];
            let place = Place {
                terrain: &scene.terrain,
                ground,
                limbs,
                exposed: ground.exposed[index],
                radius_m: scene.rocks[selected.rock].base_scale_m,
                own: rock.map_or_else(Spreads::default, |rock| rock.spreads(ground.grids)),
            };
            place.light(if rock.is_some_and(|rock| !rock.is_listed) { &some } else { &all })
        };
        selection.rocks.par_iter().enumerate().map(on_rock).collect()
    }
}

/// Azimuths and distances at which the ground is looked at, with rocks in the open.
struct Views {
    /// 1 for all azimuths, 2 for every second.
    step: usize,
    /// In radii of a rock.
    distances: &'static [f32],
    /// By height over radius: [`OPEN_LEAST`] times powers of [`OPEN_QUOTIENT`].
    open: Vec<OpenRock>,
}

/// What a rock on level sunlit ground sees.
struct OpenRock {
    /// On its sides, in the units of [`Received`].
    sides: [f32; 4],
    /// The part of the ground outside its own shadow, by azimuth and distance.
    unshadowed: [[f32; DISTANCES.len()]; AZIMUTHS],
}

impl Views {
    fn new(ground: &GroundGrids, step: usize, distances: &'static [f32]) -> Self {
        let open_rock = |index: usize| {
            let height = OPEN_LEAST * libm::powf(OPEN_QUOTIENT, index as f32);
            let mut open = OpenRock { sides: [0.0; 4], unshadowed: [[1.0; DISTANCES.len()]; AZIMUTHS] };
            for (azimuth, unshadowed) in ground.azimuths.iter().zip(&mut open.unshadowed).step_by(step) {
                let (mut before, mut lowest) = (1.0, f32::MIN);
                for (&distance, unshadowed) in distances.iter().zip(unshadowed) {
                    let slope = -EYE * height / (distance - 1.0);
                    let width = step as f32 * WIDTH;
                    *unshadowed =
                        1.0 - own_shadow(ground.sun, azimuth, width, height, 0.5 * (before + distance));
                    let light = azimuth.radiance_factor(Vec2::ZERO, 0.0, middle(lowest, slope));
                    add(&mut open.sides, azimuth, *unshadowed * light * (upright(slope) - upright(lowest)));
                    (before, lowest) = (distance, slope);
                }
            }
            open
        };
        Self { step, distances, open: (0..OPEN_ROCKS).map(open_rock).collect() }
    }

    /// The rocks in the open on either side of a height over radius, and where between them it lies.
    fn open(&self, height: f32) -> ([&OpenRock; 2], f32) {
        let along = libm::logf((height / OPEN_LEAST).max(1.0)) / libm::logf(OPEN_QUOTIENT);
        let index = (along as usize).min(OPEN_ROCKS - 2);
        ([&self.open[index], &self.open[index + 1]], (along - index as f32).min(1.0))
    }
}

/// Where a rock lies.
struct Place<'a> {
    terrain: &'a Terrain,
    ground: &'a GroundGrids,
    limbs: LimbsAt<'a>,
    exposed: Exposed,
    radius_m: f32,
    /// What it adds to the cells.
    own: Spreads,
}

/// The highest ground so far.
#[derive(Clone, Copy)]
struct Horizon {
    slope: f32,
    /// [`upright`] of it.
    upright: f32,
}

impl Horizon {
    const LOWEST: Self = Self { slope: f32::MIN, upright: -0.25 * PI };

    fn at(slope: f32) -> Self {
        Self { slope, upright: upright(slope) }
    }
}

/// Sums over what is seen. On the sides: irradiance per radian of azimuth, as radiance factor times solid angle.
#[derive(Default)]
struct Received {
    below: [f32; 4],
    beside: [f32; 4],
    on_top: f32,
}

impl Place<'_> {
    fn light(&self, views: &Views) -> LightOnRock {
        let mut received = Received::default();
        let ([low, high], t) = views.open(self.exposed.height_m / self.radius_m);
        for index in (0..AZIMUTHS).step_by(views.step) {
            let unshadowed = std::array::from_fn(|sample| {
                low.unshadowed[index][sample].lerp(high.unshadowed[index][sample], t)
            });
            self.follow(&self.ground.azimuths[index], views, &unshadowed, &mut received);
        }
        let ratio = |side: usize| received.below[side] / low.sides[side].lerp(high.sides[side], t).max(1e-9);
        let relative = views.step as f32 * WIDTH / (PI * self.ground.level_factor);
        LightOnRock {
            below: std::array::from_fn(ratio),
            beside: received.beside.map(|light| relative * light),
            beside_on_top: relative * received.on_top,
        }
    }

    /// Adds what comes from one azimuth.
    fn follow(
        &self,
        azimuth: &Azimuth,
        views: &Views,
        unshadowed: &[f32; DISTANCES.len()],
        received: &mut Received,
    ) {
        let start = self.exposed.foot.truncate();
        let eye_m = self.exposed.foot.z + EYE * self.exposed.height_m;
        let near_m = NEAR_CELLS * self.ground.grids.cell_m(self.ground.grids.locate(0, start).0);
        let mut passed = PassedRocks::NONE;
        let (mut before_m, mut before_height_m, mut before_sunlit) =
            (self.radius_m, self.exposed.foot.z, None);
        let mut horizon = Horizon::LOWEST;
        for (distance, unshadowed) in views.distances.iter().zip(unshadowed) {
            let distance_m = distance * self.radius_m;
            let place = start + distance_m * azimuth.direction;
            let (index, cell, plane_m) = self.ground.at(0, place);
            let (rocks, half_height_m) = self.others(index, cell);
            let (height_m, sunlit) =
                if distance_m < near_m { self.near(place) } else { (plane_m, cell.sunlit) };
            let (stretch_m, from_m) = (distance_m - before_m, distance_m - self.radius_m);
            let above_m = height_m - eye_m;
            passed.push(&Passed {
                distance_m: from_m,
                above_m,
                depth: stretch_m * rocks.depth,
                half_height_m,
            });
            let slope = above_m / from_m;
            let seen = SeenRocks {
                cover: &rocks,
                passed: &passed,
                horizon: horizon.slope,
                slope,
                from_m,
                stretch_m,
            };
            received.add_rocks(azimuth, azimuth.light_of_rocks(&seen, sunlit));
            let rise = (height_m - before_height_m) / stretch_m;
            let mean_sunlit = 0.5 * (sunlit + before_sunlit.unwrap_or(sunlit));
            (before_m, before_height_m, before_sunlit) = (distance_m, height_m, Some(sunlit));
            if slope <= horizon.slope {
                continue;
            }
            let lowest = std::mem::replace(&mut horizon, Horizon::at(slope));
            let lit = mean_sunlit * unshadowed;
            if lit == 0.0 {
                continue;
            }
            let middle = middle(lowest.slope, slope);
            let hidden = azimuth.depth_of_shadows(&rocks) + passed.depth(middle);
            let radiance = lit * libm::expf(-hidden) * azimuth.radiance_factor(cell.slope, rise, middle);
            received.add_ground(azimuth, radiance, [lowest, horizon]);
        }
    }

    /// Height of the ground near by, metres, and whether it is sunlit.
    fn near(&self, place: Vec2) -> (f32, f32) {
        let height_m = self.terrain.surface_height_at(place);
        (height_m, visible_above((self.limbs)(place), height_m))
    }

    /// The other rocks of a cell, and the height above which half of what they hide is left, metres.
    fn others(&self, index: usize, cell: &Cell) -> (RockCover, f32) {
        let (column, row) = (index % CELLS, index / CELLS % CELLS);
        match &self.own[index / GRID_CELLS] {
            Some(own) if own.columns.contains(&column) && own.rows.contains(&row) => {
                let others = cell.rocks - own.cover;
                (others, others.half_height_m())
            }
            _ => (cell.rocks, cell.half_height_m),
        }
    }
}

impl Received {
    /// Adds ground of this radiance between two slopes.
    fn add_ground(&mut self, azimuth: &Azimuth, radiance: f32, [low, high]: [Horizon; 2]) {
        add(&mut self.below, azimuth, radiance * (high.upright.min(0.0) - low.upright.min(0.0)));
        if high.slope > 0.0 {
            add(&mut self.beside, azimuth, radiance * (high.upright - low.upright.max(0.0)));
            let square_of_sine = |slope: f32| slope * slope / (1.0 + slope * slope);
            self.on_top += 0.5 * radiance * (square_of_sine(high.slope) - square_of_sine(low.slope.max(0.0)));
        }
    }

    /// Adds rocks, whose light on an upright face comes from this slope.
    fn add_rocks(&mut self, azimuth: &Azimuth, (light, slope): (f32, f32)) {
        if light > 0.0 {
            add(&mut self.beside, azimuth, light);
            self.on_top += light * slope;
        }
    }
}

/// The part of the ground at a distance from the middle of a rock, in an azimuth of this width (radians), that is in its shadow: half of an
/// ellipse, as behind a dome. Height and distance are in radii.
fn own_shadow(sun: SunDirection, azimuth: &Azimuth, width: f32, height: f32, distance: f32) -> f32 {
    let cotangents = height * sun.cosine / sun.sine;
    let per_length = 1.0 / (1.0 + cotangents * cotangents);
    let sine_square = (1.0 / (distance * distance) - per_length) / (1.0 - per_length).max(1e-9);
    let half = libm::asinf(sine_square.clamp(0.0, 1.0).sqrt());
    let from_away = libm::acosf((-azimuth.to_sun).clamp(-1.0, 1.0));
    let across = half.min(from_away + 0.5 * width) - (-half).max(from_away - 0.5 * width);
    (across / width).clamp(0.0, 1.0)
}

/// Adds what faces to the sides receive of light on a face towards an azimuth.
fn add(sides: &mut [f32; 4], azimuth: &Azimuth, light: f32) {
    let cosines = [azimuth.to_sun, azimuth.to_left, -azimuth.to_sun, -azimuth.to_left];
    sides.iter_mut().zip(cosines).for_each(|(sum, cosine)| *sum += cosine.max(0.0) * light);
}

/// The slope at which what lies between two is seen.
fn middle(low: f32, high: f32) -> f32 {
    0.5 * (high + low.max(STEEPEST).min(high))
}

/// The integral of the square of the cosine of elevation from the horizon to a slope: what an upright face sees.
fn upright(slope: f32) -> f32 {
    if slope == f32::MIN { -0.25 * PI } else { 0.5 * (libm::atanf(slope) + slope / (1.0 + slope * slope)) }
}

#[cfg(test)]
mod tests;
