//! The shape of a rock: a displaced and scaled sphere, turned into the world.
//!
//! Must not know: where the rock lies.

use fearless_simd::{Level, dispatch};
use glam::{Mat3, Vec3};

use crate::pool::PooledVec;
use crate::random::Stream;
use crate::scene::mesh::Icosphere;
use crate::scene::noise::Fbm;

/// Vertices per batch: few enough for the intermediate values to stay in the first-level cache.
const BATCH: usize = 512;
/// Deviation and bound of the tilt of rocks of the nominal stage, degrees; the bound is 1.5 radians.
const NOMINAL_TILT_DEG: (f64, f64) = (20.0, 85.943_669_269_623_48);
/// Bounds of the radius of the displaced unit sphere.
const RADIUS_RANGE: [f32; 2] = [0.50, 1.85];

/// Draws axis scales, tilt and heading: maps the unit sphere to metres in world axes.
pub(super) fn draw_scale_and_rotation(draw: &mut Stream, base_scale_m: f64) -> Mat3 {
    let (sx, sy, sz) = (draw.uniform(0.78, 1.34), draw.uniform(0.78, 1.34), draw.uniform(0.50, 0.92));
    rotated(draw, [sx, sy, sz].map(|s| (s * base_scale_m) as f32), NOMINAL_TILT_DEG)
}

/// A scale along the axes, then a random heading and a tilt whose deviation and bound are given in degrees.
pub(super) fn rotated(draw: &mut Stream, scale: [f32; 3], (tilt_deg, max_tilt_deg): (f64, f64)) -> Mat3 {
    let heading = draw.uniform(0.0, std::f64::consts::TAU);
    let max_tilt = max_tilt_deg.to_radians();
    let tilt = (tilt_deg.to_radians() * draw.normal()).clamp(-max_tilt, max_tilt);
    let tilt_axis = draw.uniform(0.0, std::f64::consts::TAU);
    let about_z = |angle: f64| {
        let (sin, cos) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
        Mat3::from_cols(Vec3::new(cos, sin, 0.0), Vec3::new(-sin, cos, 0.0), Vec3::Z)
    };
    let (sin, cos) = (libm::sin(tilt) as f32, libm::cos(tilt) as f32);
    let about_x = Mat3::from_cols(Vec3::X, Vec3::new(0.0, cos, sin), Vec3::new(0.0, -sin, cos));
    about_z(tilt_axis) * about_x * about_z(heading) * Mat3::from_diagonal(scale.into())
}

/// Displacement of the unit sphere along its normal: a sum of four noise terms.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    amplitude: f32,
    domain_scale: Vec3,
    domain_offset: Vec3,
    lumps: (Fbm, f32),
    ridges: (Fbm, f32),
    bumps: (Fbm, f32),
    grain: (Fbm, f32),
}

impl Shape {
    /// Draws a shape; `amplitude` is that of the displacement, relative to the radius.
    pub(super) fn draw(draw: &mut Stream, amplitude: f64) -> Self {
        let mut uniform = |low, high| draw.uniform(low, high) as f32;
        let domain_scale = Vec3::from([(); 3].map(|()| uniform(0.70, 1.55)));
        let domain_offset = Vec3::from([(); 3].map(|()| uniform(-41.0, 41.0)));
        let f = uniform(1.05, 1.75);
        let weights =
            [(0.90, 1.15), (0.26, 0.42), (0.12, 0.19), (0.05, 0.09)].map(|(low, high)| uniform(low, high));
        let mut term = |octaves, frequency, lacunarity, weight| {
            (Fbm { octaves, frequency, lacunarity, seed: draw.bits() }, weight)
        };
        Self {
            amplitude: amplitude as f32,
            domain_scale,
            domain_offset,
            lumps: term(4, 0.85 * f, 2.05, weights[0]),
            ridges: term(4, f, 2.2, weights[1]),
            bumps: term(3, 1.7 * f, 2.3, weights[2]),
            grain: term(2, 2.7 * f, 2.5, weights[3]),
        }
    }

    /// Upper bound on the radius of the displaced unit sphere.
    pub(super) fn max_radius(&self) -> f32 {
        let weights = self.lumps.1 + self.ridges.1 + self.bumps.1 + self.grain.1;
        (1.0 + self.amplitude * weights).min(RADIUS_RANGE[1])
    }

    /// Radius of the displaced unit sphere in the direction of each vertex of an icosphere level.
    pub(super) fn radii(&self, level: usize) -> PooledVec<f32> {
        let mut radii: PooledVec<f32> = PooledVec::recurring(Icosphere::vertex_count(level));
        for (chunk, radii) in radii.chunks_mut(BATCH).enumerate() {
            let first = chunk * BATCH;
            let axes = Icosphere::shared().axes.each_ref().map(|axis| &axis[first..first + radii.len()]);
            dispatch!(Level::new(), _simd => self.set_radii(axes, radii));
        }
        radii
    }

    // Must be inlined into the dispatched code to be compiled for its SIMD width.
    #[inline(always)]
    fn set_radii(&self, axes: [&[f32]; 3], radii: &mut [f32]) {
        let mut sums = [[0.0; BATCH]; 4];
        let terms = [(&self.lumps.0, 1.0), (&self.ridges.0, 1.7), (&self.bumps.0, 3.0), (&self.grain.0, 7.0)];
        for ((fbm, zoom), sums) in terms.into_iter().zip(&mut sums) {
            let mut points = [[0.0; BATCH]; 3];
            for axis in 0..3 {
                let (scale, offset) = (self.domain_scale[axis], self.domain_offset[axis]);
                for (coordinate, u) in points[axis].iter_mut().zip(axes[axis]) {
                    *coordinate = zoom * (scale * u + offset);
                }
            }
            let [x, y, z] = &points;
            let len = radii.len();
            fbm.set_at_many_3d([&x[..len], &y[..len], &z[..len]], &mut sums[..len]);
        }
        let [lumps, ridges, bumps, grain] = &sums;
        let terms = lumps.iter().zip(ridges).zip(bumps).zip(grain);
        for (radius, (((lump, ridge), bump), grain)) in radii.iter_mut().zip(terms) {
            let crease = 1.0 - ridge.abs();
            let sum = self.lumps.1 * lump
                + self.ridges.1 * (2.0 * crease * crease - 1.0)
                + self.bumps.1 * bump
                + self.grain.1 * grain;
            *radius = (1.0 + self.amplitude * sum).clamp(RADIUS_RANGE[0], RADIUS_RANGE[1]);
        }
    }
}
