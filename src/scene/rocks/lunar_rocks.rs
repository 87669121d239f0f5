//! The rocks of the surface stage at their positions: shape, pose, size and material.
//!
//! Must not know: where rocks lie, how a form is made, how many triangles of a rock are drawn.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::form::Form;
use super::lunar::Placement;
use super::lunar_shape::posed;
use super::rock::{Material, NO_DUST, Rock};
use crate::params::{Knob, Params};
use crate::random::{Stream, Streams};
use crate::scene::mesh::{Icosphere, Vertex};

/// Minimum angle that a rock spans, radians, and its icosphere level, for a field of view of [`LEVELS_FOV_DEG`] or more.
const LEVELS: [(f32, usize); 5] = [(0.35, 5), (0.12, 4), (0.025, 3), (0.006, 2), (0.003, 1)];
/// See [`LEVELS`].
const LEVELS_FOV_DEG: f64 = 60.0;
/// Level of the icosphere on whose vertices the share of the surface with dust is measured.
const DUST_LEVEL: usize = 2;
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
        let mut rock = Rock::of_vertices(index as u32, vertices, level, Material { albedo, roughness });
        rock.base_scale_m = 0.5 * diameter_m;
        rock.dust_above = dust_above(&rock.vertices, params.sample(Knob::RocksDust, &mut draw("rocks.dust")));
        rock
    };
    placements.par_iter().enumerate().map(build).collect()
}

/// The z that the normal exceeds on a share of the upward-facing surface, on which vertices lie about evenly.
fn dust_above(vertices: &[Vertex], share: f64) -> f32 {
    let coarse = &vertices[..vertices.len().min(Icosphere::vertex_count(DUST_LEVEL))];
    let mut upward: Vec<f32> = coarse.iter().map(|vertex| vertex.normal.z).filter(|z| *z > 0.0).collect();
    if upward.is_empty() {
        return NO_DUST;
    }
    let rank = ((1.0 - share) * (upward.len() - 1) as f64) as usize;
    *upward.select_nth_unstable_by(rank, f32::total_cmp).1
}

/// Draws the ratio of a rock's albedo to the soil's.
fn albedo_ratio(params: &Params, draw: &mut Stream) -> f64 {
    let (median, spread) = (params.number(Knob::RocksAlbedoRatio), params.number(Knob::RocksAlbedoSpread));
    let ratio = median * libm::exp(spread * draw.normal());
    ratio.clamp(RATIO_RANGE[0].min(median), RATIO_RANGE[1].max(median))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block whose top is level: dust covers a share of the top, not all of it; and no more than a share of a ball.
    #[test]
    fn dust_covers_its_share_of_any_shape() {
        let of = |z: &dyn Fn(usize) -> f32| -> Vec<Vertex> {
            let vertex = |k| Vertex { position: Vec3::ZERO, normal: Vec3::new(1.0, 0.0, z(k)) };
            (0..162).map(vertex).collect()
        };
        let block = of(&|k| if k < 81 { 0.95 + 0.0005 * k as f32 } else { -0.5 });
        let ball = of(&|k| 1.0 - (2 * k) as f32 / 161.0);
        for vertices in [block, ball] {
            for share in [0.1, 0.35, 0.6] {
                let above = dust_above(&vertices, share);
                let upward = vertices.iter().filter(|vertex| vertex.normal.z > 0.0).count();
                let dusty = vertices.iter().filter(|vertex| vertex.normal.z > above).count();
                let found = dusty as f64 / upward as f64;
                assert!((found - share).abs() < 0.03, "{found} for {share}");
            }
        }
    }
}
