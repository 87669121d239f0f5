//! The rocks of the nominal stage: near ones in view of the default camera, far ones towards the horizon.
//!
//! Every rock is a function of (seed, its index) and of the ground under it: rocks can be built in any order, on any number
//! of threads or not at all, and one more rock leaves all others as they are.
//! Must not know: how many triangles of a rock are drawn.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::on_demand::Rocks;
use super::plan::{Placement, RockPlan, Site};
use super::rock::{EYE_CLEARANCE_M, Material};
use crate::params::{Knob, Params};
use crate::random::Streams;
use crate::scene::terrain::Terrain;

/// Number of rock materials of a scene.
const MATERIALS: u64 = 12;
/// Colour of a rock relative to its base grey, linear RGB.
const TINT: [f64; 3] = [1.035, 1.00, 0.955];
/// Largest deviation of a channel from the tinted grey.
const CHANNEL_JITTER: f64 = 0.006;
/// Bounds of a channel's reflectance.
const ALBEDO_RANGE: [f64; 2] = [0.02, 0.55];
/// Half the width of the strip in which near rocks lie, metres.
const NEAR_HALF_WIDTH_M: f64 = 55.0;
/// Half the width of the strip in which far rocks lie, metres.
const FAR_HALF_WIDTH_M: f64 = 95.0;
/// Range of y in which far rocks lie, metres.
const FAR_Y_M: [f64; 2] = [-78.0, 230.0];
/// Number of near rocks placed in the wedge that the default camera always sees.
const NEAR_IN_VIEW: u64 = 3;
/// Apex (y, metres; x is 0) of that wedge and the tangent of its half angle (24 degrees): inside every field of view of
/// 48 degrees and more.
const WEDGE: (f64, f64) = (-90.0, 0.445);

/// The rocks of the nominal stage on this ground, none of them near the eye; each is built on first access.
#[must_use]
pub fn plan(streams: &Streams, params: &Params, terrain: &Arc<Terrain>, eye: Vec3) -> Rocks {
    let materials = draw_materials(streams, params);
    let near_count = u64::from(params.count(Knob::RocksNearCount));
    let count = params.count(Knob::RocksCount) as usize;
    let site = Arc::new(Site {
        terrain: Arc::clone(terrain),
        eye,
        embedding: params.number(Knob::RocksEmbedding) as f32,
    });
    // A range of `usize` has an exact length, so that the list is allocated once.
    let plans = (0..count).map(|k| {
        let k = k as u64;
        let placement =
            if k < near_count { place_near(streams, params, k) } else { place_far(streams, params, k) };
        let material =
            materials[streams.stream("rocks.material", k).uniform_int(0, MATERIALS as i64 - 1) as usize];
        RockPlan::draw(streams, params, &site, k, placement, material)
    });
    let rocks = Rocks::planned(plans);
    // A rock that overlaps the eye moves out of its bounds: build it now, so that culling uses its true position.
    rocks.build_where(|rock| rock.may_lie_within(EYE_CLEARANCE_M, eye));
    rocks
}

fn place_near(streams: &Streams, params: &Params, k: u64) -> Placement {
    let hero_scale_m = params.number(Knob::RocksHeroScaleM);
    if k == 0 && hero_scale_m > 0.0 {
        let position = [Knob::RocksHeroXM, Knob::RocksHeroYM].map(|knob| params.number(knob) as f32);
        let position = Vec2::from(position);
        return Placement { position, base_scale_m: hero_scale_m, band: [position; 2] };
    }
    let y = params.sample(Knob::RocksNearYM, &mut streams.stream(Knob::RocksNearYM.name(), k));
    let mut draw = streams.stream("rocks.near_place", k);
    let (apex_y, tan_half_angle) = WEDGE;
    let half_width_m = tan_half_angle * (y - apex_y);
    let x = if k < NEAR_IN_VIEW && half_width_m > 0.0 {
        // One rock in each third of the wedge's width.
        let third = 2.0 * (k as f64 + draw.unit()) / NEAR_IN_VIEW as f64 - 1.0;
        third * half_width_m.min(NEAR_HALF_WIDTH_M)
    } else {
        draw.uniform(-NEAR_HALF_WIDTH_M, NEAR_HALF_WIDTH_M)
    };
    let scale = params.sample(Knob::RocksNearScaleM, &mut streams.stream(Knob::RocksNearScaleM.name(), k));
    let (half_width_m, y) = (NEAR_HALF_WIDTH_M as f32, y as f32);
    let band = [Vec2::new(-half_width_m, y), Vec2::new(half_width_m, y)];
    Placement { position: Vec2::new(x as f32, y), base_scale_m: scale, band }
}

fn place_far(streams: &Streams, params: &Params, k: u64) -> Placement {
    let mut draw = streams.stream("rocks.far_place", k);
    let x = draw.uniform(-FAR_HALF_WIDTH_M, FAR_HALF_WIDTH_M);
    let y = draw.uniform(FAR_Y_M[0], FAR_Y_M[1]);
    let mut scale = params.sample(Knob::RocksScaleM, &mut streams.stream(Knob::RocksScaleM.name(), k));
    if draw.unit() < params.number(Knob::RocksLargeShare) {
        scale *= params.sample(Knob::RocksLargeFactor, &mut streams.stream(Knob::RocksLargeFactor.name(), k));
    }
    let band = [[-FAR_HALF_WIDTH_M, FAR_Y_M[0]], [FAR_HALF_WIDTH_M, FAR_Y_M[1]]];
    let band = band.map(|end| Vec2::from(end.map(|metres| metres as f32)));
    Placement { position: Vec2::new(x as f32, y as f32), base_scale_m: scale, band }
}

fn draw_materials(streams: &Streams, params: &Params) -> Vec<Material> {
    (0..MATERIALS)
        .map(|k| {
            let grey = params.sample(Knob::RocksAlbedo, &mut streams.stream(Knob::RocksAlbedo.name(), k));
            let roughness =
                params.sample(Knob::RocksRoughness, &mut streams.stream(Knob::RocksRoughness.name(), k));
            let mut jitter = streams.stream("rocks.channel_jitter", k);
            let albedo = TINT.map(|tint| {
                let channel = grey * tint + jitter.uniform(-CHANNEL_JITTER, CHANNEL_JITTER);
                channel.clamp(ALBEDO_RANGE[0], ALBEDO_RANGE[1]) as f32
            });
            Material { albedo: albedo.into(), roughness: roughness as f32 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::rocks::plan::{RockBounds, authored_level};

    fn flat() -> Arc<Terrain> {
        Arc::new(Terrain::from_height(920.0, 30, Vec::new(), |_| 0.0))
    }

    #[test]
    fn no_rock_floats_even_on_a_steep_slope() {
        let slope = Arc::new(Terrain::from_height(920.0, 300, Vec::new(), |p| 0.6 * p.x + 0.3 * p.y));
        let params = Params::draw_default(5);
        for rock in &plan(&Streams::new(5), &params, &slope, Vec3::new(0.0, -90.0, 500.0)) {
            let lowest =
                rock.vertices.iter().map(|v| v.position + rock.centre).min_by(|a, b| a.z.total_cmp(&b.z));
            let lowest = lowest.expect("a rock has vertices");
            assert!(lowest.z < slope.surface_height_at(lowest.truncate()), "rock {}", rock.index);
        }
    }

    #[test]
    fn embedding_is_the_buried_fraction_of_the_height_on_flat_ground() {
        let params = Params::draw_default(8);
        for rock in &plan(&Streams::new(8), &params, &flat(), Vec3::new(0.0, -90.0, 500.0)) {
            let [bottom, top] = rock.z_range_m.map(|z| z + rock.centre.z);
            assert!((-bottom / (top - bottom) - 0.30).abs() < 1e-3, "rock {}", rock.index);
        }
    }

    #[test]
    fn only_a_rock_over_the_eye_is_moved_clear_of_it() {
        let params = Params::draw_default(11);
        let streams = Streams::new(11);
        let before = plan(&streams, &params, &flat(), Vec3::new(0.0, -90.0, 500.0));
        let eye = before[4].centre + Vec3::new(0.05, 0.02, 0.1);
        assert_eq!(before[4].distance_to(eye, 0.5), 0.0);
        let after = plan(&streams, &params, &flat(), eye);
        assert!(after[4].moved && after[4].distance_to(eye, 1.0) >= EYE_CLEARANCE_M);
        for (a, b) in before.iter().zip(&after) {
            let too_near = a.distance_to(eye, 0.5) < EYE_CLEARANCE_M;
            assert_eq!(b.moved, too_near);
            assert_eq!(a.centre == b.centre, !too_near);
            assert_eq!(a.vertices, b.vertices);
        }
    }

    #[test]
    fn one_rock_more_leaves_the_others_as_they_were() {
        let mut config = crate::params::config::Config::new();
        let mut rocks = |count: &str| {
            config.apply_set(&format!("rocks.count={count}")).expect("a count");
            let params = config.draw(21).expect("drawn");
            plan(&Streams::new(21), &params, &flat(), Vec3::new(0.0, -90.0, 2.0))
        };
        let (few, more) = (rocks("30"), rocks("31"));
        assert_eq!((few.len(), more.len()), (30, 31));
        for (a, b) in few.iter().zip(&more) {
            assert!(a.centre == b.centre && a.vertices == b.vertices && a.material == b.material);
        }
    }

    #[test]
    fn a_rock_lies_within_its_bounds() {
        let slope = Arc::new(Terrain::from_height(920.0, 300, Vec::new(), |p| 0.6 * p.x + 0.3 * p.y));
        for displacement in ["0", "0.34", "0.8"] {
            let mut config = crate::params::config::Config::new();
            config.apply_set(&format!("rocks.displacement={displacement}")).expect("a displacement");
            let params = config.draw(6).expect("drawn");
            let rocks = plan(&Streams::new(6), &params, &slope, Vec3::new(0.0, -90.0, 500.0));
            assert_eq!(rocks.built().count(), 0);
            let mut bounds = Vec::new();
            let none = rocks.build_where(|rock| {
                bounds.push(*rock);
                false
            });
            assert!(none.is_empty() && rocks.built().count() == 0);
            for (rock, RockBounds { centres: [low, high], radius_m }) in rocks.iter().zip(bounds) {
                assert_eq!(rock.centre.truncate(), low.truncate(), "rock {}", rock.index);
                assert!((low.z..=high.z).contains(&rock.centre.z), "rock {}: {}", rock.index, rock.centre);
                assert!((rock.radius_m..2.5 * rock.radius_m).contains(&radius_m), "rock {}", rock.index);
            }
        }
    }

    #[test]
    fn the_hash_of_a_rock_is_the_same_before_and_after_it_is_built() {
        let hashed = |rocks: &Rocks| {
            let mut bytes = Vec::new();
            rocks.write_to(|more| bytes.extend_from_slice(more));
            bytes
        };
        let of = |seed, embedding: &str| {
            let mut config = crate::params::config::Config::new();
            config.apply_set(&format!("rocks.embedding={embedding}")).expect("an embedding");
            plan(&Streams::new(seed), &config.draw(9).expect("drawn"), &flat(), Vec3::new(0.0, -90.0, 2.0))
        };
        let rocks = of(9, "0.3");
        let before = hashed(&rocks);
        assert!(hashed(&of(10, "0.3")) != before && hashed(&of(9, "0.31")) != before);
        let mut changed = rocks.clone();
        assert_eq!(rocks.iter().count(), rocks.built().count());
        assert!(hashed(&rocks) == before);
        changed[3].centre.z += 0.01;
        assert!(hashed(&changed) != before && hashed(&rocks) == before);
    }

    #[test]
    fn faces_point_outward_and_shapes_are_those_of_boulders() {
        let params = Params::draw_default(2);
        let rocks = plan(&Streams::new(2), &params, &flat(), Vec3::new(0.0, -90.0, 2.0));
        for rock in &rocks {
            let outward = rock.triangles(rock.level).iter().filter(|t| {
                let [a, b, c] = t.map(|v| rock.vertices[v as usize].position);
                (b - a).cross(c - a).dot(a) > 0.0
            });
            assert_eq!(
                outward.count(),
                20 << (2 * rock.level),
                "a star-shaped surface has no face turned inward"
            );
            assert_eq!(rock.level, authored_level(f64::from(rock.base_scale_m)));
            let flatness = (rock.z_range_m[1] - rock.z_range_m[0]) / (2.0 * rock.radius_m);
            assert!((0.2..1.0).contains(&flatness), "rock {}: {flatness}", rock.index);
        }
        let roughness: Vec<f32> = rocks.iter().map(|r| r.material.roughness).collect();
        assert!(roughness.iter().all(|r| (0.85..0.97).contains(r)));
    }
}
