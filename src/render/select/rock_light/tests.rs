//! Tests of the light on rocks, against rays.

use glam::{Vec2, Vec3};

use super::*;
use crate::render::select::ground_light::tests::{by_rays, crater, height_m, photometry, sun};
use crate::render::select::rock_cover::CoveringRock;
use crate::scene::bounce::Bounce;

/// Everything is sunlit past the ground within two cells.
const SUNLIT: [[f32; LANES]; 2] = [[f32::MIN; LANES]; 2];

fn ground(terrain: &Terrain) -> GroundGrids {
    GroundGrids::without_rocks(terrain, &photometry(), &Bounce::new(&photometry(), sun().z.into()), sun())
}

/// Rocks at these places, of these radii and as high.
fn places(terrain: &Terrain, rocks: [(Vec2, f32); LANES]) -> [Place; LANES] {
    rocks.map(|(at, radius_m)| Place {
        exposed: Exposed { foot: at.extend(terrain.surface_height_at(at)), height_m: radius_m },
        radius_m,
        own: Spreads::default(),
    })
}

#[test]
fn rocks_on_level_sunlit_ground_lie_in_the_open() {
    let flat = Terrain::from_height(64.0, 64, Vec::new(), |_| 1.0);
    let ground = ground(&flat);
    let radii_m = [0.03, 0.2, 1.3, 0.07, 0.5, 0.01, 2.0, 0.1];
    let places = places(&flat, radii_m.map(|radius_m| (Vec2::new(3.0, -2.0 + radius_m), radius_m)));
    let surroundings = Surroundings { terrain: &flat, ground: &ground, limbs: &|_| SUNLIT };
    for views in [Views::all(&ground), Views::of_specks(&ground)] {
        for (radius_m, light) in radii_m.into_iter().zip(surroundings.light(&places, &views)) {
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
}

/// A rock's light does not depend on the rocks that are looked from at once, nor on itself: some of these lie among others, some are no
/// part of the cells' rocks.
#[test]
fn lanes_do_not_depend_on_each_other() {
    let terrain = crater();
    let mut ground = ground(&terrain);
    let rocks: [(Vec2, f32); LANES] =
        std::array::from_fn(|lane| (Vec2::new(0.6 * lane as f32 - 2.0, 0.3), 0.04 * (lane + 1) as f32));
    let covering = |(place, radius_m): (Vec2, f32)| CoveringRock {
        place,
        radius_m,
        height_m: radius_m,
        colour: 1.4,
        is_listed: radius_m > 0.2,
    };
    ground.set_rocks(rocks.map(|rock| (rock.1 > 0.1).then(|| covering(rock))).to_vec());
    let places = |rocks: [(Vec2, f32); LANES]| {
        let mut places = places(&terrain, rocks);
        for (place, rock) in places.iter_mut().zip(rocks).filter(|(_, rock)| rock.1 > 0.1) {
            place.own = covering(rock).spreads(ground.grids);
        }
        places
    };
    let surroundings = Surroundings { terrain: &terrain, ground: &ground, limbs: &|_| SUNLIT };
    for views in [Views::all(&ground), Views::of_specks(&ground)] {
        let together = surroundings.light(&places(rocks), &views);
        for (rock, together) in rocks.into_iter().zip(together) {
            assert_eq!(surroundings.light(&places([rock; LANES]), &views), [together; LANES], "{rock:?}");
            assert!(together.beside.iter().any(|light| *light > 0.0), "{rock:?}: {together:?}");
        }
    }
}

/// In the shadow of a crater's wall, and on the sunlit floor, without the rock's own shadow.
#[test]
fn light_on_a_rock_in_a_crater_is_that_of_rays() {
    let terrain = crater();
    let ground = ground(&terrain);
    let towards = sun().truncate().normalize();
    let mut views = Views::all(&ground);
    for unshadowed in views.open.unshadowed.as_flattened_mut() {
        unshadowed.fill(1.0);
    }
    let is_sunlit = |at: Vec2| {
        let start = at.extend(height_m(at) + 0.01);
        let blocked = (1..600).map(|step| start + 0.02 * step as f32 * sun());
        !blocked.into_iter().any(|point| point.z < height_m(point.truncate()))
    };
    let limbs = |[x, y]: &[[f32; LANES]; 2]| {
        let limb = |lane: usize| if is_sunlit(Vec2::new(x[lane], y[lane])) { f32::MIN } else { f32::MAX };
        [std::array::from_fn(limb); 2]
    };
    let rocks = [(1.5, 0.1), (2.5, 0.2), (3.0, 0.05), (-2.0, 0.15)]
        .map(|(along_m, radius_m)| (along_m * towards, radius_m));
    let places = places(&terrain, std::array::from_fn(|lane| rocks[lane % rocks.len()]));
    let surroundings = Surroundings { terrain: &terrain, ground: &ground, limbs: &limbs };
    let sums = dispatch!(Level::new(), simd => {
        surroundings.received(simd, &Places::new(simd, &ground, &places), &views).stored()
    });
    let (mut compared, mut largest) = (0, 1.0_f32);
    for (lane, (_, radius_m)) in rocks.into_iter().enumerate() {
        let exposed = &places[lane].exposed;
        for (side, normal) in [towards, towards.perp(), -towards, -towards.perp()].into_iter().enumerate() {
            let eye = exposed.foot + EYE * exposed.height_m * Vec3::Z;
            let expected = by_rays(eye + radius_m * normal.extend(0.0), normal.extend(0.0));
            let found = WIDTH / (PI * ground.level_factor) * (sums[side][lane] + sums[4 + side][lane]);
            if expected > 0.02 {
                let ratio = found / expected;
                (compared, largest) = (compared + 1, largest.max(ratio.max(1.0 / ratio)));
            }
        }
    }
    assert!(compared > 8 && largest < 1.35, "{compared} sides, {largest}");
}
