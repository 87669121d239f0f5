//! The rocks of the surface stage at their positions: shape, pose, size and material.
//!
//! Must not know: where rocks lie, how a form is made, how many triangles of a rock are drawn.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::lunar::Placement;
use super::lunar_shape::{form, posed};
use super::rock::{Material, Rock};
use crate::params::{Knob, Params};
use crate::pool::PooledVec;
use crate::random::{Stream, Streams};
use crate::scene::mesh::Icosphere;

/// Number of shapes that the smaller rocks share.
const PROTOTYPES: u64 = 16;
/// Icosphere level of these shapes: 642 vertices.
const PROTOTYPE_LEVEL: usize = 3;
/// Angle from which a rock has a shape of its own, radians.
const OWN_SHAPE_ANGLE: f32 = 0.03;
/// Minimum angle that a rock spans, radians, and its icosphere level.
const LEVELS: [(f32, usize); 5] = [(0.35, 5), (0.12, 4), (0.025, 3), (0.006, 2), (0.003, 1)];
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
    let prototypes: Vec<PooledVec<Vec3>> = (0..PROTOTYPES)
        .into_par_iter()
        .map(|k| form(&mut streams.stream("rocks.prototype", k), params, PROTOTYPE_LEVEL))
        .collect();
    let build = |(index, placement): (usize, &Placement)| {
        let draw = |purpose: &str| streams.stream(purpose, placement.key);
        let diameter_m = placement.diameter_m as f32;
        let angle = diameter_m / placement.position.distance(eye).max(0.5);
        let level = LEVELS.iter().find(|(least, _)| angle >= *least).map_or(0, |(_, level)| *level);
        let own = (angle >= OWN_SHAPE_ANGLE || level > PROTOTYPE_LEVEL)
            .then(|| form(&mut draw("rocks.shape"), params, level));
        let mut pose = draw("rocks.pose");
        let prototype = pose.uniform_int(0, PROTOTYPES as i64 - 1) as usize;
        let count = Icosphere::vertex_count(level);
        let form = own.as_deref().unwrap_or_else(|| &prototypes[prototype][..count]);
        let vertices = posed(&mut pose, form, level, diameter_m);
        let ratio = albedo_ratio(params, &mut draw("rocks.albedo"));
        let tint = Vec3::new(0.985, 1.0, 1.03);
        let albedo = (soil.albedo * ratio as f32 * tint).min(Vec3::ONE);
        let roughness = params.sample(Knob::RocksRoughness, &mut draw("rocks.roughness")) as f32;
        let mut rock = Rock::of_vertices(index as u32, vertices, level, Material { albedo, roughness });
        rock.base_scale_m = 0.5 * diameter_m;
        // The upper half of a sphere is uniformly distributed over z.
        rock.dust_above = 1.0 - params.sample(Knob::RocksDust, &mut draw("rocks.dust")) as f32;
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
