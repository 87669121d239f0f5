//! Ghosts of the sun: its light after two reflections at surfaces of the lens.
//!
//! A lens of n surfaces has n (n - 1) / 2 such paths (Hullin et al. 2011, "Physically-Based Real-Time Lens Flare Rendering"). A few
//! that are in focus enough to be seen lie on the line through the sun and the centre of the image. Which ones is drawn for each
//! scene.
//! Must not know: images, where the sun stands.

use glam::Vec3;

use crate::params::{Knob, Params};
use crate::random::Streams;

/// Ghosts of a lens that are bright enough to be seen.
const GHOSTS: u64 = 6;
/// Range of their positions on the line from the sun through the centre of the image, in distances of the sun from the centre;
/// negative beyond the centre.
const POSITIONS: [f64; 2] = [-1.6, 0.6];
/// Range of the tangents of their angular radii.
const RADII: [f64; 2] = [0.03, 0.12];
/// Half the range of the reflectance of a coating over the channels, relative to its mean.
const TINT: f64 = 0.6;

/// One ghost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ghost {
    /// Its position, as a factor on that of the sun relative to the centre of the image.
    pub position: f32,
    /// Tangent of its angular radius.
    pub tan_radius: f32,
    /// Part of the sun's light that is in it, linear RGB.
    pub share: Vec3,
}

/// The ghosts of a lens; none of a lens without reflections.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flare {
    /// The ghosts.
    pub ghosts: Vec<Ghost>,
}

impl Flare {
    /// The ghosts of these parameters. Each has the square of the reflectance of a surface as its share of the light.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params) -> Self {
        let reflectance = params.number(Knob::SensorFlare);
        if reflectance <= 0.0 {
            return Self::default();
        }
        let ghost = |index| {
            let mut draw = streams.stream("sensor.flare", index);
            let position = draw.uniform(POSITIONS[0], POSITIONS[1]);
            let tan_radius = libm::exp(draw.uniform(libm::log(RADII[0]), libm::log(RADII[1])));
            let share =
                [(); 3].map(|()| (reflectance * reflectance * draw.uniform(1.0 - TINT, 1.0 + TINT)) as f32);
            Ghost { position: position as f32, tan_radius: tan_radius as f32, share: share.into() }
        };
        Self { ghosts: (0..GHOSTS).map(ghost).collect() }
    }
}
