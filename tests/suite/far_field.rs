//! The far field of the surface stage: hills on the horizon, the wall of a crater, rays across the ground.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use glam::Vec2;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::RenderSettings;
use regolith::scene::Scene;

use crate::support::{BACKENDS, render, render_by, scene};

fn with_hills(seed: u64, height_m: u32) -> Scene {
    scene(seed, &["stage.name=surface", "camera.pitch_deg=0", &format!("relief.far_hills_m={height_m}")])
}

/// Angle of the skyline above the horizontal in each column, degrees.
fn skyline_deg(scene: &Scene, frame: &Frame) -> Vec<f64> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let focal_px = scene.camera.focal_px(frame.width);
    let top = |x: usize| (0..height).find(|y| frame.class[y * width + x] != ClassId::SKY.0).unwrap_or(height);
    (0..width).map(|x| ((0.5 * height as f64 - top(x) as f64) / focal_px).atan().to_degrees()).collect()
}

#[test]
fn far_hills_rise_on_the_horizon_and_leave_the_ground_near_the_camera() {
    const HEIGHT_M: u32 = 120;
    let (mut highest, mut lowest) = (0.0_f64, f64::MAX);
    for seed in [3, 4, 5] {
        let (level, hilly) = (with_hills(seed, 0), with_hills(seed, HEIGHT_M));
        let centre = level.camera.eye.truncate();
        let (mut near, mut top_m) = (0, 0.0_f32);
        for (a, b) in level.terrain.vertices.iter().zip(&hilly.terrain.vertices) {
            let from_m = a.position.truncate().distance(centre);
            if from_m < 0.32 * level.terrain.half_extent_m {
                assert_eq!(a.position, b.position, "seed {seed}, {from_m} m away");
                near += 1;
            }
            top_m = top_m.max(b.position.z - a.position.z);
        }
        assert!(near > 1000, "seed {seed}");
        assert!(top_m > 0.4 * HEIGHT_M as f32 && top_m < 1.7 * HEIGHT_M as f32, "seed {seed}: {top_m} m");
        assert_eq!(level.camera.eye, hilly.camera.eye);
        assert_eq!(
            level.terrain.height_at(centre + Vec2::new(50.0, 80.0)),
            hilly.terrain.height_at(centre + Vec2::new(50.0, 80.0))
        );
        let [flat, skyline] = [&level, &hilly].map(|scene| skyline_deg(scene, &render(scene, 160, 1)));
        for (flat, hills) in flat.iter().zip(&skyline) {
            highest = highest.max(hills - flat);
            lowest = lowest.min(hills - flat);
        }
    }
    // Hills of 120 m some 900 m away span up to 7 degrees or a little more, and leave gaps.
    assert!(highest > 2.5 && highest < 13.0, "{highest} degrees above the level horizon");
    assert!(lowest < 1.0, "{lowest} degrees");
}

const WALL: [&str; 6] = [
    "stage.name=surface",
    "camera.pitch_deg=0",
    "relief.hills_m=0",
    "relief.undulation_m=0",
    "wall.distance_m=500",
    "wall.slope_deg=24",
];

#[test]
fn a_crater_wall_has_its_height_and_slope_and_leaves_the_floor() {
    const HEIGHT_M: f64 = 90.0;
    let (mut slopes_deg, mut crests_m) = (Vec::new(), Vec::new());
    for seed in [3, 4, 5, 6] {
        let height = format!("wall.height_m={HEIGHT_M}");
        let [level, walled] = [&WALL[..], &[&WALL[..], &[&height]].concat()].map(|set| scene(seed, set));
        let wall = walled.relief.as_ref().and_then(|relief| relief.wall.as_ref()).expect("a wall");
        let centre = walled.camera.eye.truncate();
        assert_eq!(level.camera.eye, walled.camera.eye);
        let mut floor = 0;
        for (a, b) in level.terrain.vertices.iter().zip(&walled.terrain.vertices) {
            if a.position.truncate().distance(centre) < 100.0 {
                assert_eq!(a.position, b.position, "seed {seed}");
                floor += 1;
            }
        }
        assert!(floor > 1000, "seed {seed}");
        // Along rays ahead of the camera, between its azimuths of -30 and 30 degrees: what the wall adds, by steps of 4 m.
        for azimuth_deg in -30..=30_i32 {
            let azimuth = f64::from(azimuth_deg).to_radians();
            let ahead = Vec2::new(azimuth.sin() as f32, azimuth.cos() as f32);
            let rise_m = |from_m: f32| {
                let at = centre + from_m * ahead;
                f64::from(walled.terrain.height_at(at) - level.terrain.height_at(at))
            };
            let steps: Vec<f32> = (50..190).map(|k| 4.0 * k as f32).collect();
            crests_m.push(steps.iter().map(|m| rise_m(*m)).fold(0.0, f64::max));
            let on_straight = steps
                .iter()
                .filter(|m| wall.climb(**m * ahead).is_some_and(|climb| (0.4..0.75).contains(&climb)));
            slopes_deg
                .extend(on_straight.map(|m| ((rise_m(m + 4.0) - rise_m(m - 4.0)) / 8.0).atan().to_degrees()));
        }
        let [flat, skyline] = [&level, &walled].map(|scene| skyline_deg(scene, &render(scene, 160, 1)));
        let rises: Vec<f64> = flat.iter().zip(&skyline).map(|(flat, wall)| wall - flat).collect();
        let mean = rises.iter().sum::<f64>() / rises.len() as f64;
        let deviation =
            (rises.iter().map(|rise| (rise - mean).powi(2)).sum::<f64>() / rises.len() as f64).sqrt();
        // 90 m at 500 m are 10.2 degrees; the crest is no level line.
        assert!((6.0..13.0).contains(&mean), "seed {seed}: {mean} degrees");
        assert!(deviation > 0.3, "seed {seed}: the crest varies by {deviation} degrees");
    }
    let mean_m = crests_m.iter().sum::<f64>() / crests_m.len() as f64;
    assert!((mean_m / HEIGHT_M - 1.0).abs() < 0.15, "crest at {mean_m} m");
    slopes_deg.sort_by(f64::total_cmp);
    let at = |part: f64| slopes_deg[(part * slopes_deg.len() as f64) as usize];
    println!("wall: crest {mean_m:.1} m, slopes {:.1}, {:.1}, {:.1} degrees", at(0.1), at(0.5), at(0.9));
    assert!((20.0..27.0).contains(&at(0.5)), "median slope {}", at(0.5));
    assert!(at(0.1) > 8.0 && at(0.9) < 36.0, "slopes {} to {}", at(0.1), at(0.9));
}

#[test]
fn rocks_lie_closer_on_a_crater_wall() {
    let (mut on_wall, mut on_plain) = (0, 0);
    for seed in 3..8 {
        let set = [&WALL[..], &["rocks.coverage=0.01", "wall.height_m=90"]].concat();
        let walled = scene(seed, &set);
        let level = scene(seed, &[&set[..], &["wall.height_m=0"]].concat());
        let wall = walled.relief.as_ref().and_then(|relief| relief.wall.as_ref()).expect("a wall");
        let centre = walled.camera.eye.truncate();
        let count = |scene: &Scene| {
            let counted = scene.rocks.iter().filter(|rock| {
                let offset = rock.centre.truncate() - centre;
                rock.base_scale_m > 0.5 && wall.climb(offset).is_some()
            });
            counted.count()
        };
        // The same rocks of the plain lie on the wall, and further ones.
        on_plain += count(&level);
        on_wall += count(&walled);
        let deepest = walled.rocks.iter().map(|rock| {
            let foot = rock.centre.truncate();
            (rock.centre.z - walled.terrain.surface_height_at(foot)) / rock.radius_m
        });
        assert!(
            deepest.fold(0.0_f32, |most, gap| most.max(gap.abs())) < 1.5,
            "seed {seed}: a rock off the ground"
        );
    }
    println!("rocks over 1 m on walls: {on_wall}, on as much of the plain: {on_plain}");
    assert!(on_wall as f64 > 2.0 * on_plain as f64, "{on_wall} on walls, {on_plain} on as much of the plain");
    assert!(on_wall > 300, "{on_wall}");
}

/// Rays are bright, radial, mottled and of the contrast of their knob.
#[test]
fn rays_of_fresh_craters_are_radial_and_limited() {
    let set = ["stage.name=surface", "regolith.rays=0.3", "craters.fresh_share=0.1"];
    let (mut along, mut across, mut brightest, mut bright, mut points) = (0.0, 0.0, 0.0_f32, 0, 0);
    for seed in 3..9 {
        let scene = scene(seed, &set);
        let rays = &scene.relief.as_ref().expect("a relief").crater_rays;
        assert!(!rays.craters.is_empty() && rays.contrast == 0.3, "seed {seed}");
        for crater in &rays.craters {
            for k in 0..2000_u16 {
                // Where there are rays, but no halo.
                let turn = f32::from(k) * 2.399_963;
                let radii = 3.5 + 6.0 * f32::from(k) / 2000.0;
                let towards = Vec2::new(turn.sin(), turn.cos());
                let at = |out: f32, beside: f32| {
                    let offset = (radii + out) * towards + beside * towards.perp();
                    crater.brightness(crater.offset + crater.radius_m * offset, 0.01)
                };
                let here = at(0.0, 0.0);
                along += f64::from((at(0.5, 0.0) - here).abs());
                across += f64::from((at(0.0, 0.5) - here).abs());
                brightest = brightest.max(here);
                bright += u32::from(here > 0.25);
                points += 1;
            }
            let rim = crater.brightness(crater.offset + Vec2::new(crater.radius_m, 0.0), 0.01);
            assert!((0.6..=1.0).contains(&rim), "the halo at the rim: {rim}");
            let beyond = Vec2::new(16.5 * crater.radius_m, 0.0);
            assert_eq!(crater.brightness(crater.offset + beyond, 0.01), 0.0, "beyond the rays");
        }
    }
    let share = f64::from(bright) / f64::from(points);
    println!("rays: brightest {brightest:.2}, {share:.2} bright, across over along {:.2}", across / along);
    assert!(brightest <= 1.0 && brightest > 0.6, "{brightest}");
    assert!((0.08..0.5).contains(&share), "{share} of the ground between 3.5 and 9.5 radii is bright");
    assert!(across > 1.5 * along, "differences along {along}, across {across}");
}

/// Both backends multiply the soil's albedo by the same rays, and nothing else changes.
#[test]
fn backends_agree_on_rays() {
    let set = ["stage.name=surface", "craters.fresh_share=0.4", "camera.pitch_deg=-20", "sensor.kind=off"];
    let frame = |backend, rays: &str| {
        let mut settings = RenderSettings::new([128, 128], 1).expect("settings");
        settings.annotations = [Annotation::Hdr, Annotation::Depth].into_iter().collect();
        render_by(backend, &scene(7, &[&set[..], &[rays]].concat()), &settings)
    };
    // Of each pixel the factor that rays make, in half-precision numbers.
    let [host, others @ ..] = BACKENDS.map(|backend| {
        let [without, with] = ["regolith.rays=0", "regolith.rays=0.4"].map(|rays| frame(backend, rays));
        assert_eq!(without.class, with.class);
        assert_eq!(with.depth_m.len(), 128 * 128);
        assert_eq!(without.depth_m, with.depth_m);
        let green =
            |frame: &Frame| frame.radiance.iter().skip(1).step_by(3).map(|v| v.to_f64()).collect::<Vec<_>>();
        let (without, with) = (green(&without), green(&with));
        without.iter().zip(&with).map(|(a, b)| if *a > 1e-2 { b / a } else { 1.0 }).collect::<Vec<f64>>()
    });
    let brighter = host.iter().filter(|factor| **factor > 1.05).count();
    assert!(brighter > 1000, "{brighter} pixels are brighter");
    assert!(host.iter().all(|factor| *factor < 1.5 && *factor > 0.99), "at most exp(0.4)");
    for other in others {
        let apart = host.iter().zip(&other).filter(|(a, b)| (*a - *b).abs() > 0.01).count();
        println!("rays: {brighter} pixels brighter, {apart} of {} differ between backends", host.len());
        assert!(apart < host.len() / 200, "{apart} pixels differ");
    }
}
