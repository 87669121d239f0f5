//! How deep the rocks of the surface stage lie in the soil.
//!
//! A fresh rock has settled on its underside, part of which overhangs. With time soil fills what is hollow below it and the rock sinks
//! into what it sheds: an aged rock comes out of the ground at its widest section, and stands over nothing.
//! Must not know: how a rock is shaped, where it lies.

use std::sync::Arc;

use glam::{DMat3, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::dust::dust_above;
use super::lunar::Placement;
use super::rock::Rock;
use crate::params::{Knob, Params};
use crate::pool::PooledVec;
use crate::random::Streams;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::terrain::Terrain;

/// Age up to which a rock is fresh.
pub const FRESH_AGE: f32 = 0.15;
/// Level of the icosphere on whose vertices the widest section is measured.
const MEASURED_LEVEL: usize = 2;
/// A vertex is on the outline seen from above if the z of its normal is below this, on either side.
const OUTLINE_NORMAL_Z: f32 = 0.3;
/// A vertex overhangs if the z of its normal is below this.
const OVERHANG_NORMAL_Z: f32 = -0.12;
/// Overhangs up to this fraction of the height above the widest section are buried.
const OVERHANG_MAX: f32 = 0.65;
/// Largest distance of the ground above the plane of the widest section, as a fraction of the height above that plane.
const MAX_ABOVE_WIDEST: f32 = 0.5;
/// Range of the factors by which a rock is stretched along z.
const STRETCH: [f32; 2] = [0.5, 2.1];
/// What of a rock's height is above the ground is this many times the drawn fraction: to a median height of 0.49 diameters
/// (136 scanned rocks, POLAR-digital).
const EXPOSURE: f32 = 1.12;
/// How far down the underside of a fresh rock, from the widest section to the lowest point, the ground is.
const FRESH_UNDERSIDE: f32 = 0.45;
/// Depth below the ground of the widest section of an aged rock, diameters.
const DEPTH: f32 = 0.02;
/// Largest slope along which the widest section is laid.
const MAX_SLOPE: f32 = 0.7;

/// Height of a rock above the soil against it, metres.
pub(super) fn exposed_m(streams: &Streams, params: &Params, placement: &Placement, rock: &Rock) -> f32 {
    let exposed = params.sample(Knob::RocksExposed, &mut streams.stream("rocks.exposed", placement.key));
    let height_m = EXPOSURE * exposed as f32 * (rock.z_range_m[1] - rock.z_range_m[0]);
    height_m.min(placement.max_height_m())
}

/// Puts rocks into the ground at their positions.
pub fn bury(
    streams: &Streams,
    params: &Params,
    (terrain, eye): (&Terrain, Vec3),
    placements: &[Placement],
    rocks: &mut [Rock],
) {
    (placements, rocks).into_par_iter().for_each(|(placement, rock)| {
        let exposed_m = exposed_m(streams, params, placement, rock);
        let is_tiny = rock.level < MEASURED_LEVEL;
        let slope = if is_tiny { Vec2::ZERO } else { slope(terrain, placement) };
        let depth_m = DEPTH * placement.diameter_m as f32;
        let vertices: &mut PooledVec<Vertex> = Arc::make_mut(&mut rock.vertices);
        let waterline_m = lay_waterline(vertices, placement.age < FRESH_AGE, slope, exposed_m + depth_m);
        let share = params.sample(Knob::RocksDust, &mut streams.stream("rocks.dust", placement.key));
        rock.dust_above = dust_above(vertices, (waterline_m + depth_m, slope), share);
        rock.measure();
        let [bottom_m, top_m] = rock.z_range_m;
        let embedding = (waterline_m + depth_m - bottom_m) / (top_m - bottom_m);
        rock.put_on_ground(terrain, eye, placement.position, embedding);
    });
}

/// Slope of the mesh of the ground across a rock, rise per metre along x and y.
fn slope(terrain: &Terrain, placement: &Placement) -> Vec2 {
    let reach_m = 0.45 * placement.diameter_m as f32;
    let along = |axis: Vec2| {
        let point = |side: f32| placement.position + side * reach_m * axis;
        let [far, near] = [1.0, -1.0].map(|side| terrain.surface_height_at(point(side)));
        (far - near) / (2.0 * reach_m)
    };
    Vec2::new(along(Vec2::X), along(Vec2::Y)).clamp_length_max(MAX_SLOPE)
}

/// Stretches and shears vertices along z, so that the widest section of a rock lies along a slope, and that the highest vertex is
/// `top_m` above the plane of its waterline: on the widest section or just above, of a fresh rock below. Returns the height of that
/// plane at the origin, metres. Seen from above the vertices stay where they are.
fn lay_waterline(vertices: &mut [Vertex], is_fresh: bool, slope: Vec2, top_m: f32) -> f32 {
    let coarse = &vertices[..vertices.len().min(Icosphere::vertex_count(MEASURED_LEVEL))];
    let (middle_m, tilt) = plane_of_outline(coarse);
    let above = |p: Vec3| p.z - middle_m - tilt.dot(p.truncate());
    let highest_m = coarse.iter().map(|vertex| above(vertex.position)).fold(0.0, f32::max);
    let raised_m = if is_fresh {
        FRESH_UNDERSIDE * coarse.iter().map(|vertex| above(vertex.position)).fold(0.0, f32::min)
    } else {
        let overhanging = coarse.iter().filter(|vertex| vertex.normal.z < OVERHANG_NORMAL_Z);
        let heights_m = overhanging.map(|vertex| above(vertex.position));
        // An overhang in the upper half stays above the ground.
        let below_middle_m = heights_m.filter(|height_m| *height_m < OVERHANG_MAX * highest_m);
        below_middle_m.fold(0.0, f32::max).min(MAX_ABOVE_WIDEST * highest_m)
    };
    let heights_m = vertices.iter().map(|vertex| above(vertex.position));
    let highest_m = heights_m.fold(1e-6, |high: f32, height_m| if height_m > high { height_m } else { high });
    // One linear map: what is flat stays flat, and the surface star-shaped around its centre.
    let factor = (top_m / (highest_m - raised_m).max(1e-6)).clamp(STRETCH[0], STRETCH[1]);
    let steepness = slope - factor * tilt;
    for Vertex { position, normal } in vertices {
        position.z = factor * position.z + steepness.dot(position.truncate());
        // Normals are transformed by the inverse transpose.
        let z = normal.z / factor;
        let moved = (normal.truncate() - z * steepness).extend(z);
        *normal = moved / moved.length();
    }
    factor * (middle_m + raised_m)
}

/// The plane through the outline seen from above, by least squares: height at the origin, metres, and rise per metre along x and y.
fn plane_of_outline(vertices: &[Vertex]) -> (f32, Vec2) {
    let outline = vertices.iter().filter(|vertex| vertex.normal.z.abs() < OUTLINE_NORMAL_Z);
    let (mut matrix, mut right, mut count) = (DMat3::ZERO, DVec3::ZERO, 0);
    for vertex in outline {
        let p = vertex.position.as_dvec3();
        let terms = DVec3::new(1.0, p.x, p.y);
        matrix += DMat3::from_cols(terms, p.x * terms, p.y * terms);
        right += p.z * terms;
        count += 1;
    }
    // With fewer points, or all near a line, a level plane is the better guess.
    let scale = matrix.x_axis.x * matrix.y_axis.y * matrix.z_axis.z;
    if count < 6 || matrix.determinant() < 0.05 * scale {
        return (if count > 0 { (right.x / f64::from(count)) as f32 } else { 0.0 }, Vec2::ZERO);
    }
    let plane = matrix.inverse() * right;
    (plane.x as f32, Vec2::new(plane.y as f32, plane.z as f32).clamp_length_max(MAX_SLOPE))
}
