//! Tests of the light on rocks, against rays.

use glam::Vec3;

use super::*;
use crate::render::select::ground_light::tests::{by_rays, crater, height_m, photometry, sun};
use crate::scene::bounce::Bounce;

/// Everything is sunlit past the ground within two cells.
const SUNLIT: [f32; 2] = [f32::MIN, f32::MIN];

fn ground(terrain: &Terrain) -> GroundGrids {
    GroundGrids::without_rocks(terrain, &photometry(), &Bounce::new(&photometry(), sun().z.into()), sun())
}

/// A rock of this radius and as high.
fn place<'a>(
    terrain: &'a Terrain,
    ground: &'a GroundGrids,
    limbs: LimbsAt<'a>,
    at: Vec2,
    radius_m: f32,
) -> Place<'a> {
    let exposed = Exposed { foot: at.extend(terrain.surface_height_at(at)), height_m: radius_m };
    Place { terrain, ground, limbs, exposed, radius_m, own: Spreads::default() }
}

#[test]
fn rocks_on_level_sunlit_ground_lie_in_the_open() {
    let flat = Terrain::from_height(64.0, 64, Vec::new(), |_| 1.0);
    let ground = ground(&flat);
    let [all, some] = [(1, &DISTANCES[..]), (STEP_OF_SPECKS, &DISTANCES_OF_SPECKS[..])]
        .map(|(step, distances)| Views::new(&ground, step, distances));
    for (radius_m, views) in [(0.03, &all), (0.03, &some), (0.2, &all), (1.3, &all)] {
        let place = place(&flat, &ground, &|_| SUNLIT, Vec2::new(3.0, -2.0), radius_m);
        let light = place.light(views);
        for side in 0..4 {
            assert!(
                (light.below[side] - 1.0).abs() < 0.02,
                "radius {radius_m} m, step {}: {light:?}",
                views.step
            );
        }
        assert_eq!((light.beside, light.beside_on_top), ([0.0; 4], 0.0));
    }
}

/// In the shadow of a crater's wall, and on the sunlit floor, without the rock's own shadow.
#[test]
fn light_on_a_rock_in_a_crater_is_that_of_rays() {
    let terrain = crater();
    let ground = ground(&terrain);
    let towards = sun().truncate().normalize();
    let views = Views::new(&ground, 1, &DISTANCES);
    let is_sunlit = |at: Vec2| {
        let start = at.extend(height_m(at) + 0.01);
        let blocked = (1..600).map(|step| start + 0.02 * step as f32 * sun());
        !blocked.into_iter().any(|point| point.z < height_m(point.truncate()))
    };
    let limbs = |at| if is_sunlit(at) { SUNLIT } else { [f32::MAX, f32::MAX] };
    let (mut compared, mut largest) = (0, 1.0_f32);
    for (along_m, radius_m) in [(1.5, 0.1), (2.5, 0.2), (3.0, 0.05), (-2.0, 0.15)] {
        let place = place(&terrain, &ground, &limbs, along_m * towards, radius_m);
        let mut received = Received::default();
        for azimuth in &ground.azimuths {
            place.follow(azimuth, &views, &[1.0; DISTANCES.len()], &mut received);
        }
        for (side, normal) in [towards, towards.perp(), -towards, -towards.perp()].into_iter().enumerate() {
            let eye = place.exposed.foot + EYE * place.exposed.height_m * Vec3::Z;
            let expected = by_rays(eye + radius_m * normal.extend(0.0), normal.extend(0.0));
            let sum = received.below[side] + received.beside[side];
            let found = WIDTH / (PI * ground.level_factor) * sum;
            if expected > 0.02 {
                let ratio = found / expected;
                (compared, largest) = (compared + 1, largest.max(ratio.max(1.0 / ratio)));
            }
        }
    }
    assert!(compared > 8 && largest < 1.35, "{compared} sides, {largest}");
}
