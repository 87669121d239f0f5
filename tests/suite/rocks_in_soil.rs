//! How rocks lie in the soil, and how many of them there are.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use glam::{Vec2, Vec3};
use regolith::export::{Detail, Format, Stage, export};
use regolith::random::Streams;
use regolith::render::RenderSettings;
use regolith::scene::Scene;
use regolith::scene::camera::ground_view;
use regolith::scene::relief::Relief;
use regolith::scene::rings::View;
use regolith::scene::rocks::Rock;
use regolith::scene::rocks::burial::FRESH_AGE;
use regolith::scene::rocks::lunar::{self, Placement, rocks_larger_than};
use regolith::scene::terrain::Layout;

use crate::support::{params, scene};

const SURFACE: &str = "stage.name=surface";

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Rocks of more than a diameter on the ground ahead of the camera between two distances, and the area of that ground.
fn rocks_ahead(scene: &Scene, [near_m, far_m]: [f32; 2], min_m: f32) -> (usize, f64) {
    // A sector of 40 degrees, which lies within the field of view.
    let half = 20.0_f32.to_radians();
    let eye = scene.camera.eye.truncate();
    let count = scene.rocks.iter().filter(|rock| {
        let offset = rock.centre.truncate() - eye;
        let is_ahead = offset.y > 0.0 && (offset.x / offset.y).abs() < half.tan();
        is_ahead && (near_m..far_m).contains(&offset.length()) && 2.0 * rock.base_scale_m > min_m
    });
    (count.count(), f64::from(half * (far_m * far_m - near_m * near_m)))
}

/// Li and Wu 2018, at three distances: no rock that spans 2 mrad, less than a pixel of an image 512 wide, is left out.
#[test]
fn small_rocks_follow_the_lunar_law_at_every_distance() {
    for coverage in [0.005, 0.03, 0.08] {
        let set = format!("rocks.coverage={coverage}");
        let scenes: Vec<Scene> =
            (0..4).map(|seed| scene(seed, &[SURFACE, &set, "craters.fresh_share=0"])).collect();
        for ring_m in [[6.0, 12.0], [12.0, 24.0], [24.0, 48.0]] {
            let min_m = 2.1e-3 * ring_m[1];
            let (mut count, mut area_m2) = (0, 0.0);
            for scene in &scenes {
                let (rocks, m2) = rocks_ahead(scene, ring_m, min_m);
                (count, area_m2) = (count + rocks, area_m2 + m2);
            }
            let expected = area_m2 * rocks_larger_than(f64::from(min_m.max(0.032)), coverage);
            println!(
                "coverage {coverage}, {ring_m:?} m: {count} rocks of {min_m:.3} m, {expected:.0} expected"
            );
            assert!(
                // The debris of blocks comes on top.
                (count as f64 - expected).abs() < 3.3 * expected.sqrt() + 0.05 * expected,
                "coverage {coverage}, {ring_m:?} m: {count} rocks for {expected:.0}"
            );
        }
    }
}

/// The rocks of a scene that span at least an angle, with their placements, near and not moved.
fn placed_rocks(seed: u64, set: &[&str], min_angle: f32) -> (Scene, Vec<(usize, Placement)>) {
    let set: Vec<&str> = [SURFACE].iter().chain(set).copied().collect();
    let (params, scene) = (params(seed, &set), scene(seed, &set));
    let relief = scene.relief.as_ref().expect("a relief");
    let view = ground_view(&params);
    let (placements, _) =
        lunar::placements(&Streams::new(seed), &params, relief, &view, scene.terrain.centre);
    assert_eq!(placements.len(), scene.rocks.len());
    let eye = scene.camera.eye.truncate();
    let is_near = |(index, placement): &(usize, Placement)| {
        !scene.rocks[*index].moved
            && placement.diameter_m as f32 > min_angle * placement.position.distance(eye)
    };
    let near = placements.iter().copied().enumerate().filter(is_near).collect();
    (scene, near)
}

/// SCENE.md, section 9: changing one knob never moves what another one draws.
#[test]
fn another_coverage_adds_rocks_and_moves_none() {
    for (seed, coverages) in [(2, ["0.004", "0.0044"]), (3, ["0.008", "0.03"]), (5, ["0.002", "0.1"])] {
        let fields = coverages.map(|coverage| {
            let set = [&format!("rocks.coverage={coverage}"), "wall.height_m=60", "craters.fresh_share=0.2"];
            placed_rocks(seed, &set, 0.008)
        });
        let [sparse, dense] = &fields;
        for (index, rock) in &sparse.1 {
            let same = |(_, other): &&(usize, Placement)| other.position == rock.position;
            let (of_dense, other) =
                dense.1.iter().find(same).unwrap_or_else(|| panic!("no {rock:?} at the higher coverage"));
            assert_eq!((rock.diameter_m, rock.age), (other.diameter_m, other.age), "{rock:?}");
            let [one, two] = [&sparse.0.rocks[*index], &dense.0.rocks[*of_dense]];
            assert_eq!(one.material.albedo, two.material.albedo, "{rock:?}");
        }
        let [few, many] = [sparse.1.len(), dense.1.len()];
        println!("seed {seed}: {few} rocks at {}, {many} at {}", coverages[0], coverages[1]);
        assert!(few > 60 && many > few, "{few}, {many}");
    }
}

/// Under a sun near the horizon rocks far beside the view cast shadows into it.
#[test]
fn every_rock_whose_shadow_falls_into_the_view_is_made() {
    for (seed, elevation_deg, azimuth_deg) in [(2, 0.7, 90), (8, 1.5, 250), (3, 3.0, 180), (5, 0.5, 300)] {
        let sun = [
            format!("sun.elevation_deg={elevation_deg}"),
            format!("sun.azimuth_deg={azimuth_deg}"),
            "rocks.coverage=0.004".to_owned(),
        ];
        let set: Vec<&str> = [SURFACE].into_iter().chain(sun.iter().map(String::as_str)).collect();
        let (params, scene) = (params(seed, &set), scene(seed, &set));
        let (relief, centre) = (scene.relief.as_ref().expect("a relief"), scene.terrain.centre);
        let view = ground_view(&params);
        let all_around = View { half_sector: std::f64::consts::PI, ..view };
        let [made, all] = [&view, &all_around]
            .map(|view| lunar::placements(&Streams::new(seed), &params, relief, view, centre).0);
        let is_made = |rock: &Placement| {
            made.iter().any(|made| made.position == rock.position && made.diameter_m == rock.diameter_m)
        };
        let away = -scene.sun.direction.truncate() / scene.sun.direction.z;
        let ahead = Vec2::Y;
        let is_in_view = |point: Vec2| {
            let offset = point - centre;
            f64::from(offset.perp_dot(ahead).abs().atan2(offset.dot(ahead))) < view.half_sector
        };
        let mut beside = 0;
        for rock in &all {
            // The last tenth is that of a tip.
            let falls_into_view =
                (0..=30).any(|k| is_in_view(rock.position + 0.03 * k as f32 * rock.max_height_m() * away));
            if falls_into_view {
                beside += usize::from(!is_in_view(rock.position));
                assert!(
                    is_made(rock),
                    "seed {seed}: a rock of {:.2} m at {}",
                    rock.diameter_m,
                    rock.position
                );
            }
        }
        assert!(beside > 20, "seed {seed}: {beside} rocks beside the view");
        assert!(made.len() < all.len() / 2, "{} of {} rocks", made.len(), all.len());
    }
}

/// Share of the flank of a rock, between the ground and half its height, that overhangs by more than ten degrees.
fn overhang(scene: &Scene, rock: &Rock) -> f64 {
    let ground = |p: Vec3| scene.terrain.surface_height_at(p.truncate());
    let top_m = rock.centre.z + rock.z_range_m[1];
    let middle_m = 0.5 * (top_m + ground(rock.centre));
    let (mut flank, mut overhanging) = (1e-12, 0.0);
    for triangle in rock.triangles(rock.level) {
        let [a, b, c] = triangle.map(|corner| rock.centre + rock.vertices[corner as usize].position);
        let centroid = (a + b + c) / 3.0;
        if centroid.z > ground(centroid) && centroid.z < middle_m {
            let normal = (b - a).cross(c - a);
            flank += f64::from(normal.length());
            overhanging += if normal.z < -0.17 * normal.length() { f64::from(normal.length()) } else { 0.0 };
        }
    }
    overhanging / flank
}

/// A rock that has lain for long stands over nothing: its widest section is in the soil.
#[test]
fn no_aged_rock_overhangs_below_half_its_height() {
    let (mut aged, mut fresh) = (Vec::new(), Vec::new());
    for seed in 0..4 {
        let (scene, placements) = placed_rocks(seed, &["rocks.coverage=0.04"], 0.02);
        for (index, placement) in placements {
            let shares = if placement.age < FRESH_AGE { &mut fresh } else { &mut aged };
            shares.push(overhang(&scene, &scene.rocks[index]));
        }
    }
    let overhanging = |shares: &[f64]| shares.iter().filter(|share| **share > 0.2).count();
    println!(
        "{} of {} aged rocks overhang, {} of {} fresh ones",
        overhanging(&aged),
        aged.len(),
        overhanging(&fresh),
        fresh.len()
    );
    // Of a few angular rocks a chip at the waterline faces downwards.
    let is_rare = 200 * overhanging(&aged) < aged.len();
    assert!(aged.len() > 200 && is_rare, "{} of {}", overhanging(&aged), aged.len());
    assert!(3 * overhanging(&fresh) > fresh.len(), "fresh rocks lie as they fell");
}

/// Height of the mesh of the ground above the relief without fillets, metres.
fn banked_m(scene: &Scene, bare: &Relief, point: Vec2) -> f32 {
    let Layout::Rings(rings) = &scene.terrain.layout else { panic!("no rings") };
    let offset = point - scene.terrain.centre;
    scene.terrain.surface_height_at(point) - bare.height_at(offset, rings.cell_m(offset.length()))
}

/// Soil lies against rocks, higher and wider with their age and higher uphill; the mesh, and with it every export, has it.
#[test]
fn soil_is_banked_against_rocks_by_age_and_uphill() {
    let mut by_age: [Vec<[f64; 2]>; 2] = [Vec::new(), Vec::new()];
    let (mut uphill, mut downhill) = (Vec::new(), Vec::new());
    for seed in 0..8 {
        let (scene, placements) = placed_rocks(seed, &["rocks.coverage=0.03", "terrain.cell_mrad=4"], 0.06);
        let mut bare = scene.relief.clone().expect("a relief");
        bare.fillets.clear();
        for (index, placement) in placements {
            let diameter_m = placement.diameter_m as f32;
            let radius_m = scene.rocks[index].base_scale_m;
            // Other rocks have fillets too: only those that lie alone.
            let is_alone = scene.rocks.iter().filter(|rock| rock.base_scale_m > 0.3 * radius_m).all(|rock| {
                rock.index as usize == index
                    || rock.centre.truncate().distance(placement.position)
                        > 2.5 * (radius_m + rock.base_scale_m)
            });
            if !is_alone {
                continue;
            }
            let around = |distance_m: f32| {
                let heights = (0..24).map(|k| {
                    let angle = std::f32::consts::TAU * k as f32 / 24.0;
                    f64::from(banked_m(
                        &scene,
                        &bare,
                        placement.position + distance_m * Vec2::from_angle(angle),
                    ))
                });
                heights.sum::<f64>() / 24.0
            };
            let foot_m = around(radius_m);
            let width_m = (1..30)
                .map(|k| 0.05 * k as f32 * diameter_m)
                .find(|beyond_m| around(radius_m + beyond_m) < 0.15 * foot_m);
            let measured = [foot_m, f64::from(width_m.unwrap_or(1.5 * diameter_m))]
                .map(|metres| metres / f64::from(diameter_m));
            match placement.age {
                age if age < 0.3 => by_age[0].push(measured),
                age if age > 0.7 => by_age[1].push(measured),
                _ => {}
            }
            let at = |point: Vec2| bare.height_at(point - scene.terrain.centre, 0.35 * diameter_m);
            let slope = Vec2::new(
                at(placement.position + diameter_m * Vec2::X) - at(placement.position - diameter_m * Vec2::X),
                at(placement.position + diameter_m * Vec2::Y) - at(placement.position - diameter_m * Vec2::Y),
            ) / (2.0 * diameter_m);
            if slope.length() > 0.1 && placement.age > 0.4 {
                let to_side = 1.1 * radius_m * slope.normalize();
                uphill.push(f64::from(banked_m(&scene, &bare, placement.position + to_side) / diameter_m));
                downhill.push(f64::from(banked_m(&scene, &bare, placement.position - to_side) / diameter_m));
            }
        }
    }
    let middle = |values: &[f64]| median(values.to_vec());
    let of = |age: usize, which: usize| {
        middle(&by_age[age].iter().map(|measured| measured[which]).collect::<Vec<_>>())
    };
    println!(
        "{} young rocks: height {:.3}, width {:.3} diameters; {} old ones: {:.3}, {:.3}; {} on slopes: uphill {:.3}, downhill {:.3}",
        by_age[0].len(),
        of(0, 0),
        of(0, 1),
        by_age[1].len(),
        of(1, 0),
        of(1, 1),
        uphill.len(),
        middle(&uphill),
        middle(&downhill)
    );
    assert!(by_age.iter().all(|measured| measured.len() > 20) && uphill.len() > 15);
    assert!(of(1, 0) > 2.0 * of(0, 0) && of(1, 0) > 0.05, "height");
    assert!(of(1, 1) > 1.25 * of(0, 1), "width");
    assert!(middle(&uphill) > 1.3 * middle(&downhill), "uphill");
}

/// The height of the contact varies around a rock, at several wavelengths: deviations, in diameters, of the second to fifth and of the
/// sixth to twelfth harmonic.
#[test]
fn waterlines_are_ragged() {
    const POINTS: usize = 64;
    let (mut long, mut short) = (Vec::new(), Vec::new());
    for seed in 0..4 {
        let (scene, placements) = placed_rocks(seed, &["rocks.coverage=0.03", "terrain.cell_mrad=4"], 0.12);
        for (_, placement) in placements {
            let radius_m = 0.5 * placement.diameter_m as f32;
            let heights: Vec<f64> = (0..POINTS)
                .map(|k| {
                    let angle = std::f32::consts::TAU * k as f32 / POINTS as f32;
                    let point = placement.position + 1.02 * radius_m * Vec2::from_angle(angle);
                    f64::from(scene.terrain.surface_height_at(point)) / placement.diameter_m
                })
                .collect();
            let deviation = |harmonics: std::ops::RangeInclusive<usize>| {
                let variance: f64 = harmonics
                    .map(|harmonic| {
                        let (mut re, mut im) = (0.0, 0.0);
                        for (k, height) in heights.iter().enumerate() {
                            let (sin, cos) =
                                (std::f64::consts::TAU * (harmonic * k) as f64 / POINTS as f64).sin_cos();
                            (re, im) = (re + height * cos, im + height * sin);
                        }
                        2.0 * (re * re + im * im) / (POINTS * POINTS) as f64
                    })
                    .sum();
                variance.sqrt()
            };
            long.push(deviation(2..=5));
            short.push(deviation(6..=12));
        }
    }
    println!("{} rocks: {:.4} and {:.4} diameters", long.len(), median(long.clone()), median(short.clone()));
    assert!(long.len() > 30);
    assert!((0.017..0.05).contains(&median(long)) && (0.005..0.03).contains(&median(short)));
}

/// Exports hold the soil against rocks: the very vertices of the ground.
#[test]
fn exports_hold_the_fillets() {
    let (scene, placements) = placed_rocks(3, &["rocks.coverage=0.03"], 0.12);
    let mut bare = scene.relief.clone().expect("a relief");
    bare.fillets.clear();
    let settings = RenderSettings::new([64, 64], 4).expect("settings");
    let knobs = params(3, &[SURFACE]).to_json();
    let stage =
        Stage { scene: &scene, seed: 3, knobs: &knobs, settings: &settings, detail: Detail::Authored };
    let bytes = export(&stage, Format::Npz).expect("exported");
    let Layout::Rings(rings) = &scene.terrain.layout else { panic!("no rings") };
    let foot = scene.terrain.vertices.iter().find(|vertex| {
        let point = vertex.position.truncate();
        placements.iter().any(|(_, rock)| {
            let distance = point.distance(rock.position) / rock.diameter_m as f32;
            let offset = point - scene.terrain.centre;
            (0.4..0.7).contains(&distance)
                && vertex.position.z
                    > bare.height_at(offset, rings.cell_m(offset.length())) + 0.04 * rock.diameter_m as f32
        })
    });
    let foot = foot.expect("a vertex of the soil against a rock");
    let wanted: &[u8] = bytemuck::bytes_of(&foot.position);
    assert!(bytes.windows(wanted.len()).any(|window| window == wanted));
}

/// Pieces lie at the feet of fresh blocks: more than there is of their size elsewhere.
#[test]
fn fresh_blocks_lie_in_their_debris() {
    // Pieces and area, close to a block and further away.
    let mut around = [[(0, 0.0); 2]; 2];
    for seed in 0..10 {
        let (scene, placements) =
            placed_rocks(seed, &["rocks.coverage=0.02", "craters.fresh_share=0", "camera.height_m=4"], 0.05);
        for (_, block) in placements.iter().filter(|(_, rock)| rock.diameter_m > 0.5) {
            let of_age = match block.age {
                age if age < 0.35 => &mut around[0],
                age if age > 0.65 => &mut around[1],
                _ => continue,
            };
            for (ring, (count, area_m2)) in [[0.5, 0.9], [1.5, 2.5]].into_iter().zip(of_age) {
                let [near_m, far_m] = ring.map(|diameters: f64| diameters * block.diameter_m);
                *area_m2 += std::f64::consts::PI * (far_m * far_m - near_m * near_m);
                let pieces = scene.rocks.iter().filter(|rock| {
                    let distance_m = f64::from(rock.centre.truncate().distance(block.position));
                    rock.base_scale_m < 0.05 && (near_m..far_m).contains(&distance_m)
                });
                *count += pieces.count();
            }
        }
    }
    let [fresh, old] = around.map(|rings| {
        let [close, far] = rings.map(|(count, area_m2)| count as f64 / area_m2);
        close / far
    });
    println!("{around:?}: {fresh:.2} times as many close to fresh blocks, {old:.2} to old ones");
    assert!(fresh > 1.8 && old < 1.5, "{fresh} times as many close to fresh blocks, {old} to old ones");
}
