//! How rocks look at the ground around them: in which azimuths, at which distances; and what rocks on level sunlit ground receive from it.
//! Must not know: where a rock lies.

use std::f32::consts::PI;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8};

use crate::render::select::azimuths::{AZIMUTHS, Azimuth, SunDirection, WIDTH};
use crate::render::select::ground_grids::GroundGrids;
use crate::render::select::lane_math::{LANES, arctangent, load, splat};

/// Distances from the middle of a rock at which the ground is looked at, in its radii.
const DISTANCES: [f32; 12] = [1.4, 2.0, 3.0, 4.5, 7.0, 11.0, 17.0, 27.0, 43.0, 70.0, 120.0, 200.0];
/// The same for rocks that are specks in the image. With these and every second azimuth their light differs by some 7 % from that by all
/// (root mean square of the logarithm, medians of five scenes).
const DISTANCES_OF_SPECKS: [f32; 5] = [2.0, 4.5, 11.0, 43.0, 200.0];
/// Of specks every second azimuth is looked at.
const STEP_OF_SPECKS: usize = 2;
/// Height from which it is looked at, as a fraction of the rock's.
pub(crate) const EYE: f32 = 0.5;
/// Steepest slope at which ground counts as seen: below it lies the foot of the rock.
const STEEPEST: f32 = -3.0;
/// Heights over radii for which a rock in the open is found.
pub(crate) const OPEN_ROCKS: usize = 24;
/// The quotient of two of them in turn.
const OPEN_QUOTIENT: f32 = 1.18;
/// The least of them; `lit_rocks::Exposed` has it, too.
const OPEN_LEAST: f32 = 0.1;

/// Azimuths and distances at which the ground is looked at, with rocks in the open.
pub(crate) struct Views {
    /// 1 for all azimuths, 2 for every second.
    pub(crate) step: usize,
    /// In radii of a rock.
    pub(crate) distances: &'static [f32],
    /// What rocks on level sunlit ground receive.
    pub(crate) open: OpenRocks,
}

/// What rocks on level sunlit ground receive, by height over radius: [`OPEN_LEAST`] times powers of [`OPEN_QUOTIENT`].
pub(crate) struct OpenRocks {
    /// On their sides, per radian of azimuth: radiance factor times solid angle.
    pub(crate) sides: [[f32; OPEN_ROCKS]; 4],
    /// The part of the ground outside their own shadows, by azimuth and distance.
    pub(crate) unshadowed: [[[f32; OPEN_ROCKS]; DISTANCES.len()]; AZIMUTHS],
}

impl OpenRocks {
    /// The last that is not higher than a rock of this height over radius, or the last but one, and how far it is from there to the next.
    pub(crate) fn locate(height: f32) -> (usize, f32) {
        let along = libm::logf((height / OPEN_LEAST).max(1.0)) / libm::logf(OPEN_QUOTIENT);
        let index = (along as usize).min(OPEN_ROCKS - 2);
        (index, (along - index as f32).min(1.0))
    }
}

impl Views {
    /// In all azimuths and at all distances.
    pub(crate) fn all(ground: &GroundGrids) -> Self {
        Self::new(ground, 1, &DISTANCES)
    }

    /// Those that do for rocks that are specks in the image.
    pub(crate) fn of_specks(ground: &GroundGrids) -> Self {
        Self::new(ground, STEP_OF_SPECKS, &DISTANCES_OF_SPECKS)
    }

    fn new(ground: &GroundGrids, step: usize, distances: &'static [f32]) -> Self {
        let nothing = [[[1.0; OPEN_ROCKS]; DISTANCES.len()]; AZIMUTHS];
        let open = OpenRocks { sides: [[0.0; OPEN_ROCKS]; 4], unshadowed: nothing };
        let mut views = Self { step, distances, open };
        for first in (0..OPEN_ROCKS).step_by(LANES) {
            dispatch!(Level::new(), simd => views.set_open(simd, ground, first));
        }
        views
    }

    /// Sets what eight rocks in the open receive.
    // Inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    fn set_open<S: Simd>(&mut self, simd: S, ground: &GroundGrids, first: usize) {
        let mut heights = [0.0; LANES];
        for (lane, height) in heights.iter_mut().enumerate() {
            *height = OPEN_LEAST * libm::powf(OPEN_QUOTIENT, (first + lane) as f32);
        }
        let zero = splat(simd, 0.0);
        let mut sides = [zero; 4];
        let width = self.step as f32 * WIDTH;
        for (azimuth, unshadowed) in ground.azimuths.iter().zip(&mut self.open.unshadowed).step_by(self.step)
        {
            let (mut before, mut lowest) = (1.0, Horizon::lowest(simd));
            for (&distance, unshadowed) in self.distances.iter().zip(unshadowed) {
                let unshadowed = &mut unshadowed[first..first + LANES];
                for (unshadowed, height) in unshadowed.iter_mut().zip(heights) {
                    let middle = 0.5 * (before + distance);
                    *unshadowed = 1.0 - own_shadow(ground.sun, azimuth, width, height, middle);
                }
                let seen = Horizon::at(simd, load(simd, &heights) * (-EYE / (distance - 1.0)));
                let middle = middle(lowest.slope, seen.slope);
                let factor = azimuth.radiance_factor(simd, [zero; 2], zero, middle);
                let light = f32x8::from_slice(simd, unshadowed) * factor * (seen.upright - lowest.upright);
                add(&mut sides, azimuth, light);
                (before, lowest) = (distance, seen);
            }
        }
        for (stored, side) in self.open.sides.iter_mut().zip(sides) {
            side.store_slice(&mut stored[first..first + LANES]);
        }
    }
}

/// The highest ground so far.
#[derive(Clone, Copy)]
pub(crate) struct Horizon<S: Simd> {
    /// Its slope.
    pub(crate) slope: f32x8<S>,
    /// The integral of the square of the cosine of elevation up to it: what an upright face sees.
    pub(crate) upright: f32x8<S>,
}

// What takes vectors is inlined into `dispatch!`, so that it is compiled for each SIMD level.
impl<S: Simd> Horizon<S> {
    #[inline(always)]
    pub(crate) fn lowest(simd: S) -> Self {
        Self { slope: splat(simd, f32::MIN), upright: splat(simd, -0.25 * PI) }
    }

    #[inline(always)]
    pub(crate) fn at(simd: S, slope: f32x8<S>) -> Self {
        let square = splat(simd, 1.0) + slope * slope;
        Self { slope, upright: (arctangent(simd, slope) + slope / square) * 0.5 }
    }

    #[inline(always)]
    pub(crate) fn or_higher(self, other: Self) -> Self {
        Self { slope: self.slope.max(other.slope), upright: self.upright.max(other.upright) }
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
#[inline(always)]
pub(crate) fn add<S: Simd>(sides: &mut [f32x8<S>; 4], azimuth: &Azimuth, light: f32x8<S>) {
    let cosines = [azimuth.to_sun, azimuth.to_left, -azimuth.to_sun, -azimuth.to_left];
    for (sum, cosine) in sides.iter_mut().zip(cosines) {
        *sum += light * cosine.max(0.0);
    }
}

/// The slope at which what lies between two is seen.
#[inline(always)]
pub(crate) fn middle<S: Simd>(low: f32x8<S>, high: f32x8<S>) -> f32x8<S> {
    (high + low.max(STEEPEST).min(high)) * 0.5
}
