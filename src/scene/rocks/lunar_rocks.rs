//! The rocks of the surface stage at their positions: shape, pose, size and material.
//!
//! Must not know: where rocks lie, how a form is made, how many triangles of a rock are drawn.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::form::Form;
use super::lunar::Placement;
use super::lunar_shape::posed;
use super::rock::{Material, Rock};
use crate::params::{Knob, Params};
use crate::random::{Stream, Streams};

/// Minimum angle that a rock spans, radians, and its icosphere level, for a field of view of [`LEVELS_FOV_DEG`] or more.
const LEVELS: [(f32, usize); 5] = [(0.35, 5), (0.12, 4), (0.025, 3), (0.006, 2), (0.003, 1)];
/// See [`LEVELS`].
const LEVELS_FOV_DEG: f64 = 60.0;
/// Bounds of the ratio of a rock's albedo to the soil's.
const RATIO_RANGE: [f64; 2] = [0.7, 2.5];

/// Builds the rocks, each around the origin, as detailed as the eye, at this point seen from above, needs them.
#[must_use]
pub fn build(
    streams: &Streams,
    params: &Params,
    eye: Vec2,
    soil: &Material,
    placements: &[Placement],
) -> Vec<Rock> {
    let displacement = params.number(Knob::RocksDisplacement);
    // Pixels of a narrow lens span smaller angles.
    let fov_deg = params.number(Knob::CameraFovDeg);
    let magnification = (LEVELS_FOV_DEG / fov_deg).max(1.0) as f32;
    let build = |(index, placement): (usize, &Placement)| {
        let draw = |purpose: &str| streams.stream(purpose, placement.key);
        let diameter_m = placement.diameter_m as f32;
        let angle = diameter_m / placement.position.distance(eye).max(0.5);
        let level =
            LEVELS.iter().find(|(least, _)| magnification * angle >= *least).map_or(0, |(_, level)| *level);
        // Every rock has a form of its own: no two in an image have the same outline.
        let age = f64::from(placement.age);
        let form = Form::draw(&mut draw("rocks.shape"), age, displacement, level);
        let vertices = posed(&mut draw("rocks.pose"), &form, level, diameter_m);
        let ratio = albedo_ratio(params, &mut draw("rocks.albedo"));
        let tint = Vec3::new(0.985, 1.0, 1.03);
        let albedo = (soil.albedo * ratio as f32 * tint).min(Vec3::ONE);
        let roughness = params.sample(Knob::RocksRoughness, &mut draw("rocks.roughness")) as f32;
        let mut rock = Rock::unburied(index as u32, vertices, level, Material { albedo, roughness });
        rock.base_scale_m = 0.5 * diameter_m;
        rock
    };
    placements.par_iter().enumerate().map(build).collect()
}

/// Draws the ratio of a rock's albedo to the soil's.
fn albedo_ratio(params: &Params, draw: &mut Stream) -> f64 {
    let (median, spread) = (params.number(Knob::RocksAlbedoRatio), params.number(Knob::RocksAlbedoSpread));
    let ratio = median * libm::exp(spread * draw.normal());
    ratio.clamp(RATIO_RANGE[0].min(median), RATIO_RANGE[1].max(median))
}
