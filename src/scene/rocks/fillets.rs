//! The soil against the rocks of the surface stage: which rocks have a fillet, and how wide and high it is.
//!
//! Must not know: how a rock is shaped, the mesh of the ground.

use glam::Vec2;
use rayon::prelude::*;

use super::burial::exposed_m;
use super::lunar::Placement;
use super::rock::Rock;
use crate::params::Params;
use crate::random::Streams;
use crate::scene::craters::Region;
use crate::scene::fillet::{Fillet, OUTLINE_TERMS};
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::relief::{Relief, mesh_share};
use crate::scene::rings::View;

/// Height of the soil against a rock, mean diameters: against a new rock, and what its age adds.
const HEIGHT: [f32; 2] = [0.012, 0.14];
/// The soil reaches at most this far up what is above the ground.
const MAX_HEIGHT: f32 = 0.42;
/// Width, mean diameters, of the fillet of a new rock, and what its age adds. Height and width give a slope at the rock, twice the mean
/// slope, of 35 degrees at most: the angle of repose.
const WIDTH: [f32; 2] = [0.06, 0.42];
/// How much higher the soil is uphill, relative to the mean, per tangent of the slope of the ground; and at most.
const UPHILL: [f32; 2] = [2.6, 0.75];
/// Amplitude of the longest ripples, mean diameters. With the shorter ones the height of the contact has a deviation of 2 %.
const RIPPLE: f32 = 0.06;
/// Directions in which the outline of a rock is measured.
const DIRECTIONS: usize = 16;
/// Level of the icosphere on whose vertices it is measured.
const OUTLINE_LEVEL: usize = 2;

/// The fillets of these rocks that the mesh of a view can show; offsets are from `centre`, metres. The relief is the one without
/// fillets.
#[must_use]
pub fn fillets(
    streams: &Streams,
    params: &Params,
    (relief, view, centre): (&Relief, &View, Vec2),
    placements: &[Placement],
    rocks: &[Rock],
) -> Vec<Fillet> {
    let directions: [Vec2; DIRECTIONS] = std::array::from_fn(|k| {
        let angle = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
        Vec2::new(libm::cos(angle) as f32, libm::sin(angle) as f32)
    });
    let fillet_of = |(placement, rock): (&Placement, &Rock)| {
        let diameter_m = placement.diameter_m as f32;
        let offset = placement.position - centre;
        let width_m = diameter_m * (WIDTH[0] + WIDTH[1] * placement.age);
        let nearest_m = (offset.length() - diameter_m - width_m).max(0.0);
        if mesh_share(diameter_m + width_m, view.cell_m(nearest_m)) == 0.0 {
            return None;
        }
        let height_m = diameter_m * (HEIGHT[0] + HEIGHT[1] * placement.age);
        Some(Fillet {
            offset,
            outline_m: outline_m(&rock.vertices, &directions),
            width_m,
            height_m: height_m.min(MAX_HEIGHT * exposed_m(streams, params, placement, rock)),
            uphill: (UPHILL[0] * slope(relief, offset, diameter_m)).clamp_length_max(UPHILL[1]),
            ripple_m: RIPPLE * diameter_m,
            seed: placement.key as u32,
        })
    };
    (placements, rocks).into_par_iter().filter_map(fillet_of).collect()
}

/// Slope of the ground beneath a rock, rise per metre along x and y; uphill is where it points.
fn slope(relief: &Relief, offset: Vec2, diameter_m: f32) -> Vec2 {
    let cell_m = 0.35 * diameter_m;
    let nearby = relief.nearby(&Region::circle(offset, 1.5 * diameter_m), cell_m);
    let [x, y] = offset.to_array();
    let (west, east, south, north) = (x - diameter_m, x + diameter_m, y - diameter_m, y + diameter_m);
    let mut heights = [0.0; 4];
    relief.set_heights([&[west, east, x, x], &[y, y, south, north]], cell_m, &nearby, &mut heights);
    Vec2::new(heights[1] - heights[0], heights[3] - heights[2]) / (2.0 * diameter_m)
}

/// Outline of a rock seen from above ([`Fillet::outline_m`]): of the polygon of its tangents in some directions.
fn outline_m(vertices: &[Vertex], directions: &[Vec2; DIRECTIONS]) -> [f32; OUTLINE_TERMS] {
    let coarse = &vertices[..vertices.len().min(Icosphere::vertex_count(OUTLINE_LEVEL))];
    let tangents_m = directions.map(|direction| {
        coarse.iter().map(|vertex| vertex.position.truncate().dot(direction)).fold(0.0, f32::max)
    });
    let radius_m = |along: Vec2| {
        let crossed = directions.iter().zip(tangents_m).filter_map(|(direction, tangent_m)| {
            let cosine = along.dot(*direction);
            (cosine > 0.3).then(|| tangent_m / cosine)
        });
        crossed.fold(f32::INFINITY, f32::min)
    };
    let mut terms = [0.0; OUTLINE_TERMS];
    for along in directions {
        let radius_m = radius_m(*along) / DIRECTIONS as f32;
        terms[0] += radius_m;
        let mut multiple = *along;
        for term in terms[1..].as_chunks_mut::<2>().0 {
            term[0] += 2.0 * radius_m * multiple.x;
            term[1] += 2.0 * radius_m * multiple.y;
            multiple = along.rotate(multiple);
        }
    }
    terms
}
