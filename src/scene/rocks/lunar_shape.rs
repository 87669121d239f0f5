//! The shape of a rock of the surface stage: a displaced sphere cut by planes.
//!
//! Must not know: where the rock lies, what it is made of.

use glam::{Mat3, Vec3};

use super::shape::{Shape, rotated};
use crate::params::{Knob, Params};
use crate::pool::PooledVec;
use crate::random::Stream;
use crate::scene::mesh::{Icosphere, Vertex};

/// Number of planes that cut a rock.
const PLANES: u32 = 8;
/// Range of the distance of these planes, as a fraction of the rock's extent.
const CUTS: (f64, f64) = (0.60, 0.90);

/// A displaced unit sphere, cut by planes.
pub(super) fn form(draw: &mut Stream, params: &Params, level: usize) -> PooledVec<Vec3> {
    let shape = Shape::draw(draw, params.number(Knob::RocksDisplacement));
    let directions = &Icosphere::shared().directions;
    let mut positions: PooledVec<Vec3> = PooledVec::unspecified(Icosphere::vertex_count(level));
    for ((position, &u), radius) in positions.iter_mut().zip(directions).zip(&shape.radii(level)) {
        *position = radius * u;
    }
    // Extents come from a coarse level, so that the cuts are the same at every level.
    let coarse = Icosphere::vertex_count(level.min(2));
    for _ in 0..PLANES {
        let z = draw.uniform(-1.0, 1.0);
        let (angle, across) = (draw.uniform(0.0, std::f64::consts::TAU), (1.0 - z * z).sqrt());
        let normal =
            Vec3::new((across * libm::cos(angle)) as f32, (across * libm::sin(angle)) as f32, z as f32);
        let extent = positions[..coarse].iter().map(|p| p.dot(normal)).fold(0.0, f32::max);
        let cut = extent * draw.uniform(CUTS.0, CUTS.1) as f32;
        for p in &mut positions {
            let height = p.dot(normal);
            if height > cut {
                *p *= cut / height;
            }
        }
    }
    positions
}

/// A form scaled along its axes, rotated, and scaled to its diameter.
pub(super) fn posed(draw: &mut Stream, form: &[Vec3], level: usize, diameter_m: f32) -> PooledVec<Vertex> {
    let scale = [draw.uniform(0.85, 1.18), draw.uniform(0.85, 1.18), draw.uniform(0.55, 0.95)];
    let world_from_form: Mat3 = rotated(draw, scale.map(|s| s as f32));
    let mut vertices: PooledVec<Vertex> = PooledVec::unspecified(form.len());
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (vertex, &p) in vertices.iter_mut().zip(form) {
        vertex.position = world_from_form * p;
        low = low.min(vertex.position);
        high = high.max(vertex.position);
    }
    let factor = 2.0 * diameter_m / ((high.x - low.x) + (high.y - low.y));
    for vertex in &mut vertices {
        vertex.position *= factor;
    }
    Icosphere::shared().set_smooth_normals(&mut vertices, level);
    vertices
}
