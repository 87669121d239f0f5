//! Hills on the horizon of the surface stage: massifs that rise towards the border of the ground.
//!
//! Ground near the camera of the scene is as without them to the bit. Slopes are those of lunar massifs, up to some 25 degrees for the highest.
//! Must not know: the rest of the relief.

use glam::Vec2;

use super::lattice::Lattice;
use super::noise::{GRADIENT_NOISE_SIGMA, gradient_noise_2d};
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Distances from the camera at which they begin and at which they have their full height, in radii of the ground.
const BEGIN: f32 = 0.33;
const FULL: f32 = 0.9;
/// Longest wavelength, in radii of the ground.
const LONGEST: f64 = 0.6;
/// Octaves; the amplitude halves with each.
const OCTAVES: u32 = 4;
/// Mean height, and standard deviation of the longest octave, relative to the height of the peaks. What is below 0 is level ground.
const MEAN: f32 = 0.3;
const DEVIATION: f32 = 0.35;

/// The hills.
#[derive(Clone, Debug)]
pub struct FarHills {
    height_m: f32,
    radius_m: f32,
    /// The point that they surround, metres from the centre of the ground.
    middle: Vec2,
    /// By falling wavelength.
    octaves: Vec<Lattice>,
}

impl FarHills {
    /// The hills of these parameters around `centre`, metres, world; `None` if there are none.
    #[must_use]
    pub fn new(streams: &Streams, params: &Params, centre: Vec2) -> Option<Self> {
        let height_m = params.number(Knob::ReliefFarHillsM) as f32;
        let radius_m = 0.5 * params.number(Knob::TerrainSizeM);
        let octave = |k: u32| {
            let wavelength_m = LONGEST * radius_m / f64::from(1_u32 << k);
            Lattice::new(wavelength_m, centre, &mut streams.stream("relief.far_hills", k.into()))
        };
        let octaves = || (0..OCTAVES).map(octave).collect();
        let middle = Vec2::ZERO;
        (height_m > 0.0).then(|| Self { height_m, radius_m: radius_m as f32, middle, octaves: octaves() })
    }

    /// The hills around a point elsewhere, by this many metres.
    #[must_use]
    pub(super) fn moved(self, by: Vec2) -> Self {
        Self { middle: self.middle + by, ..self }
    }

    /// Adds their height at points (structure of arrays, metres from the centre of the ground). `in_mesh` is the fraction of a
    /// feature of some size, metres, that a mesh through these points has.
    #[inline(always)]
    pub(super) fn add_heights(&self, [x, y]: [&[f32]; 2], in_mesh: impl Fn(f32) -> f32, heights: &mut [f32]) {
        for ((height, x), y) in heights.iter_mut().zip(x).zip(y) {
            let point = Vec2::new(*x, *y);
            let t = ((point.distance(self.middle) / self.radius_m - BEGIN) / (FULL - BEGIN)).clamp(0.0, 1.0);
            if t == 0.0 {
                continue;
            }
            let mut shape = MEAN;
            let mut deviation = DEVIATION / GRADIENT_NOISE_SIGMA;
            for lattice in &self.octaves {
                let (cell, at) = lattice.cell(lattice.local(point));
                let noise = gradient_noise_2d(cell, at, lattice.seed);
                shape += in_mesh(lattice.cell_m) * deviation * noise;
                deviation *= 0.5;
            }
            *height += self.height_m * t * t * (3.0 - 2.0 * t) * shape.max(0.0);
        }
    }
}
