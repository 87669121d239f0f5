//! The surface stage compared with published values: relief, craters, rocks, light.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use std::collections::HashSet;
use std::sync::Arc;

use glam::Vec2;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::random::Streams;
use regolith::render::RenderSettings;
use regolith::scene::craters::{Pit, Region, profile};
use regolith::scene::relief::Relief;
use regolith::scene::rocks::lunar::rocks_larger_than;
use regolith::scene::{Scene, mesh};

use crate::support::{params, renderer, scene};

const SURFACE: &str = "stage.name=surface";

fn relief(seed: u64, set: &[&str]) -> Relief {
    let set: Vec<&str> = [SURFACE].iter().chain(set).copied().collect();
    Relief::new(&Streams::new(seed), &params(seed, &set), Vec2::new(0.0, -90.0))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Spacing of the grid on which the height function is sampled, metres.
const STEP_M: f32 = 0.005;
/// Samples along its side.
const SIDE: usize = 500;

/// Heights on a square of 2.5 m, at full detail.
fn heights(relief: &Relief, corner: Vec2) -> Vec<f32> {
    let half = 0.5 * STEP_M * SIDE as f32;
    let nearby = relief.nearby(&Region::circle(corner + half, 1.5 * half), 1e-4);
    let along = |from: f32, step: usize| from + STEP_M * step as f32;
    let x: Vec<f32> = (0..SIDE * SIDE).map(|i| along(corner.x, i % SIDE)).collect();
    let y: Vec<f32> = (0..SIDE * SIDE).map(|i| along(corner.y, i / SIDE)).collect();
    let mut heights = vec![0.0; x.len()];
    relief.set_heights([&x, &y], 1e-4, &nearby, &mut heights);
    for ((height, x), y) in heights.iter_mut().zip(x).zip(y) {
        *height += relief.grains.height_at(Vec2::new(x, y));
    }
    heights
}

/// Median slope, degrees, between samples that are `steps` apart along x.
fn median_slope_deg(heights: &[f32], steps: usize) -> f64 {
    let rows = heights.chunks_exact(SIDE).step_by(3);
    let rises = rows.flat_map(|row| row.iter().zip(&row[steps..]).map(|(a, b)| f64::from((b - a).abs())));
    (median(rises.collect()) / (steps as f64 * f64::from(STEP_M))).atan().to_degrees()
}

/// Standard deviation of the heights in windows of 125 mm from their best-fitting planes, mm.
fn window_deviations_mm(heights: &[f32]) -> Vec<f64> {
    const WINDOW: usize = 25;
    let middle = (WINDOW as f64 - 1.0) / 2.0;
    let spread: f64 = (0..WINDOW).map(|i| (i as f64 - middle).powi(2)).sum::<f64>() * WINDOW as f64;
    let mut found = Vec::new();
    for corner in (0..SIDE - WINDOW)
        .step_by(WINDOW)
        .flat_map(|y| (0..SIDE - WINDOW).step_by(WINDOW).map(move |x| y * SIDE + x))
    {
        let at = |i: usize| f64::from(heights[corner + (i / WINDOW) * SIDE + i % WINDOW]);
        let offset = |i: usize| ((i % WINDOW) as f64 - middle, (i / WINDOW) as f64 - middle);
        let all = 0..WINDOW * WINDOW;
        let n = all.len() as f64;
        let mean = all.clone().map(at).sum::<f64>() / n;
        let along =
            |axis: fn((f64, f64)) -> f64| all.clone().map(|i| axis(offset(i)) * at(i)).sum::<f64>() / spread;
        let (rise_x, rise_y) = (along(|o| o.0), along(|o| o.1));
        let residual = |i: usize| at(i) - mean - rise_x * offset(i).0 - rise_y * offset(i).1;
        found.push(1e3 * (all.clone().map(|i| residual(i).powi(2)).sum::<f64>() / n).sqrt());
    }
    found
}

/// Guo et al. 2021 (GRL 48, 2021GL094931): Hurst exponent 0.6 to 0.85, a median slope of 10 degrees at 7 mm, a median
/// deviation of 4 mm in windows of 125 mm.
#[test]
fn ground_has_the_measured_relief() {
    let (mut slopes_7mm, mut hursts, mut deviations) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..12 {
        let relief = relief(seed, &[]);
        let heights = heights(&relief, Vec2::new(3.0 * seed as f32, 4.0));
        // 7 mm lie between one and two steps; the slope falls as the distance to the power H - 1.
        let slopes: Vec<f64> = [1, 2, 4, 8, 16, 32].map(|steps| median_slope_deg(&heights, steps)).into();
        slopes_7mm.push((slopes[0] * slopes[1]).sqrt());
        // Fit of log(rise) over log(distance) between 5 and 160 mm.
        let points = slopes.iter().enumerate().map(|(k, slope)| {
            let distance = (1_u32 << k) as f64;
            (distance.ln(), (slope.to_radians().tan() * distance).ln())
        });
        let points: Vec<(f64, f64)> = points.collect();
        let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / points.len() as f64;
        let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
        hursts.push(
            points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
                / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>(),
        );
        deviations.extend(window_deviations_mm(&heights));
    }
    let (slope, hurst, deviation) = (median(slopes_7mm), median(hursts), median(deviations));
    println!(
        "slope at 7 mm {slope:.2} deg, Hurst exponent {hurst:.3}, deviation at 125 mm {deviation:.2} mm"
    );
    assert!((8.0..=12.0).contains(&slope), "{slope} degrees");
    assert!((0.6..=0.85).contains(&hurst), "{hurst}");
    assert!((2.5..=6.0).contains(&deviation), "{deviation} mm");
}

/// Soil is intermittent: smooth fines between patches of clods. Of the root mean square slopes over 5 mm in windows of 60 mm, the ninth
/// decile is several times the first; noise without patches has windows that are all alike.
#[test]
fn soil_has_smooth_and_rough_patches() {
    const WINDOW: usize = 12;
    let spread = |patchy: bool| {
        let mut slopes = Vec::new();
        for seed in 0..4 {
            let mut relief = relief(seed, &["grains.density=0", "craters.density=0"]);
            if !patchy {
                relief.octaves.iter_mut().for_each(|octave| octave.patchy = 0.0);
            }
            let heights = heights(&relief, Vec2::new(3.0 * seed as f32, 4.0));
            for (y, x) in (0..SIDE - WINDOW)
                .step_by(WINDOW)
                .flat_map(|y| (0..SIDE - WINDOW).step_by(WINDOW).map(move |x| (y, x)))
            {
                let rises = (y..y + WINDOW).flat_map(|y| (x..x + WINDOW).map(move |x| y * SIDE + x));
                let square: f64 =
                    rises.map(|i| f64::from(heights[i + 1] - heights[i])).map(|rise| rise * rise).sum();
                slopes.push((square / (WINDOW * WINDOW) as f64).sqrt());
            }
        }
        slopes.sort_by(f64::total_cmp);
        slopes[slopes.len() * 9 / 10] / slopes[slopes.len() / 10]
    };
    let (patchy, even) = (spread(true), spread(false));
    println!("ninth over first decile of slopes: {patchy:.2}, without patches {even:.2}");
    assert!(patchy > 2.2 && patchy > 1.4 * even, "{patchy}, without patches {even}");
}

#[test]
fn relief_knobs_set_the_slope() {
    for (deg, hurst) in [(7.0, 0.85), (13.0, 0.6)] {
        let set = [format!("relief.slope_deg={deg}"), format!("relief.hurst={hurst}")];
        let set: Vec<&str> = set.iter().map(String::as_str).collect();
        let slopes = (0..6).map(|seed| {
            let heights = heights(&relief(seed, &set), Vec2::new(5.0, 5.0));
            (median_slope_deg(&heights, 1) * median_slope_deg(&heights, 2)).sqrt()
        });
        let slope = median(slopes.collect());
        assert!((slope / deg - 1.0).abs() < 0.2, "{slope} degrees for {deg}");
    }
}

/// Detail below the cell size fades out smoothly: the height changes little when the cell size does.
#[test]
fn detail_fades_without_a_step() {
    let relief = relief(4, &[]);
    let mut worst = 0.0_f32;
    for k in 0..400_u16 {
        let point = Vec2::new(f32::from(k) * 0.37, f32::from(k % 17) * 1.3);
        let cell_m = 0.01 * 1.02_f32.powi(i32::from(k));
        let (fine, coarse) = (relief.height_at(point, cell_m), relief.height_at(point, 1.02 * cell_m));
        worst = worst.max((fine - coarse).abs() / cell_m);
    }
    assert!(worst < 0.06, "a change of 2 % of the cell moves the ground by {worst} cells");
}

/// A camera that drives ahead gets another mesh of the same ground, which must not swim. In pixels of an image 512 wide.
#[test]
fn ground_does_not_swim_as_the_camera_drives() {
    let (first, second) = (scene(6, &[SURFACE]), scene(6, &[SURFACE, "camera.y_m=-89.75"]));
    assert_ne!(first.camera.eye, second.camera.eye);
    let focal_px = first.camera.focal_px(512);
    let mut shifts_px = Vec::new();
    for k in 0..4000_u32 {
        // Evenly in the logarithm of the distance, from 4 to 400 m, over 40 degrees.
        let distance_m = 4.0 * 100.0_f64.powf(f64::from(k) / 4000.0);
        let angle = (f64::from(k % 41) - 20.0).to_radians();
        let offset = distance_m * glam::DVec2::new(angle.sin(), angle.cos());
        let point = first.camera.eye.truncate() + offset.as_vec2();
        let [a, b] = [&first, &second].map(|scene| f64::from(scene.terrain.surface_height_at(point)));
        shifts_px.push((a - b).abs() * focal_px / distance_m);
    }
    shifts_px.sort_by(f64::total_cmp);
    let [median, p99] = [shifts_px.len() / 2, shifts_px.len() * 99 / 100].map(|index| shifts_px[index]);
    println!(
        "the ground moves by {median:.3} px in the median, 99 % by up to {p99:.3}, all {:.3}",
        shifts_px[3999]
    );
    assert!(
        median < 0.05 && p99 < 0.25,
        "the ground moves by {median} px in the median, 99 % by up to {p99}"
    );
}

fn pits(seed: u64, set: &[&str], radius_m: f32, min_diameter_m: f32) -> Vec<Pit> {
    let mut found = Vec::new();
    relief(seed, set).craters.around(&Region::circle(Vec2::ZERO, radius_m), min_diameter_m, |pit| {
        if pit.offset.length() < radius_m && pit.depth > 0.0 {
            found.push(pit);
        }
    });
    found
}

/// Trask 1966: N(>D) = 0.0794 D^-2 a square metre, here without what is larger than 80 m; Wu et al. 2021: mean depth over diameter 0.061.
#[test]
fn craters_have_the_equilibrium_density_and_depth() {
    let mut counts = Vec::new();
    let (mut depths, mut fresh) = (Vec::new(), 0.0);
    for (radius_m, diameters) in [
        (900.0_f32, [40.0_f32, 55.0, 70.0]),
        (300.0, [10.0, 16.0, 25.0]),
        (60.0, [2.0, 3.2, 5.0]),
        (12.0, [0.3, 0.5, 0.9]),
        (4.0, [0.1, 0.15, 0.2]),
    ] {
        let mut found: Vec<Pit> = Vec::new();
        for seed in 0..4 {
            found.extend(pits(seed, &["relief.clods=0"], radius_m, diameters[0]));
        }
        let area_m2 = 4.0 * std::f64::consts::PI * f64::from(radius_m).powi(2);
        for diameter_m in diameters {
            let count = found.iter().filter(|pit| pit.diameter_m > diameter_m).count() as f64;
            let expected = area_m2 * 0.0794 * (f64::from(diameter_m).powi(-2) - 80.0_f64.powi(-2));
            println!("{count} craters of more than {diameter_m} m, {expected:.0} expected");
            assert!(
                (count - expected).abs() < 3.3 * expected.sqrt() + 0.02 * expected,
                "{count} for {expected}"
            );
            if diameter_m < 20.0 {
                counts.push((f64::from(diameter_m).ln(), (count / area_m2).ln()));
            }
        }
        depths.extend(found.iter().map(|pit| f64::from(pit.depth)));
        fresh += found.iter().filter(|pit| pit.is_fresh()).count() as f64;
    }
    let n = counts.len() as f64;
    let (mx, my) = (counts.iter().map(|p| p.0).sum::<f64>() / n, counts.iter().map(|p| p.1).sum::<f64>() / n);
    let slope = counts.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
        / counts.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
    let depth = depths.iter().sum::<f64>() / depths.len() as f64;
    println!("slope {slope:.3}, mean depth {depth:.4}, fresh {:.4}", fresh / depths.len() as f64);
    assert!((slope + 2.0).abs() < 0.1, "{slope}");
    assert!((0.05..=0.07).contains(&depth), "{depth}");
    assert!((0.02..=0.05).contains(&(fresh / depths.len() as f64)));
}

/// Yang et al. 2021, for a diameter of 1 m.
#[test]
fn crater_profile_has_its_published_values() {
    for (r, height) in [(0.0, -0.0889), (0.5, -0.030), (1.0, 0.0251), (2.0, 0.0028)] {
        assert!((profile(r) - height).abs() < 1e-3, "{} at {r} radii", profile(r));
    }
}

#[test]
fn a_higher_density_adds_craters_and_moves_none() {
    let (few, many) =
        (pits(5, &["craters.density=0.6"], 40.0, 1.0), pits(5, &["craters.density=1.2"], 40.0, 1.0));
    assert!(many.len() > few.len());
    for pit in &few {
        assert!(many.iter().any(|other| other.key == pit.key && other.offset == pit.offset));
    }
}

/// Diameters of the rocks near the camera, where all sizes are generated, for many seeds.
fn diameters(seeds: std::ops::Range<u64>, set: &[&str], radius_m: f32) -> Vec<f64> {
    let set: Vec<&str> =
        [SURFACE, "camera.pitch_deg=-89", "craters.fresh_share=0"].iter().chain(set).copied().collect();
    let mut found = Vec::new();
    for seed in seeds {
        let scene = scene(seed, &set);
        let near = scene
            .rocks
            .iter()
            .filter(|rock| !rock.moved && rock.centre.truncate().distance(scene.terrain.centre) < radius_m);
        found.extend(near.map(|rock| 2.0 * f64::from(rock.base_scale_m)));
    }
    found
}

/// Li and Wu 2018 above 10 cm, the power law of the Surveyors below; counts have a Poisson distribution.
#[test]
fn rocks_follow_the_lunar_law() {
    for (coverage, set) in [(0.008, "rocks.coverage=0.008"), (0.05, "rocks.coverage=0.05")] {
        let radius_m = 12.0;
        let mut found = diameters(0..20, &[set], radius_m);
        let area_m2 = 20.0 * std::f64::consts::PI * f64::from(radius_m).powi(2);
        let min_m = 0.10;
        let expected = area_m2 * rocks_larger_than(min_m, coverage);
        found.retain(|diameter| *diameter > min_m);
        println!("coverage {coverage}: {} rocks of more than 10 cm, {expected:.0} expected", found.len());
        assert!(
            (found.len() as f64 - expected).abs() < 2.576 * expected.sqrt(),
            "{} for {expected}",
            found.len()
        );
        // Kolmogorov-Smirnov test at a level of 0.01.
        found.sort_by(f64::total_cmp);
        let n = found.len() as f64;
        let law =
            |diameter: f64| 1.0 - rocks_larger_than(diameter, coverage) / rocks_larger_than(min_m, coverage);
        let distance = found.iter().enumerate().fold(0.0_f64, |worst, (i, diameter)| {
            let i = i as f64;
            worst.max((law(*diameter) - i / n).abs()).max(((i + 1.0) / n - law(*diameter)).abs())
        });
        assert!(distance * n.sqrt() < 1.63, "{distance} over {n} rocks");
    }
    // Tabulated values of the law: rocks larger than 10 cm per 100 m^2.
    for (coverage, per_100_m2) in [(0.0021, 4.4), (0.005, 9.0), (0.01, 14.0), (0.05, 40.0), (0.1, 69.0)] {
        let found = 100.0 * rocks_larger_than(0.1, coverage);
        assert!((found / per_100_m2 - 1.0).abs() < 0.06, "{found} at {coverage}");
    }
}

/// Exposed height over diameter: the middle half of 136 scanned rocks (POLAR-digital) lies within 0.41 to 0.57.
#[test]
fn rocks_stand_out_by_about_half_their_diameter() {
    let mut ratios = Vec::new();
    for seed in 0..6 {
        let scene = scene(seed, &[SURFACE]);
        for rock in scene.rocks.iter().filter(|rock| rock.base_scale_m > 0.05) {
            let top = rock.centre.z + rock.z_range_m[1];
            let ground = scene.terrain.surface_height_at(rock.centre.truncate());
            ratios.push(f64::from((top - ground) / (2.0 * rock.base_scale_m)));
        }
    }
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| ratios[(share * ratios.len() as f64) as usize];
    println!("height over diameter {:.2}, {:.2}, {:.2}", at(0.25), at(0.5), at(0.75));
    assert!((0.41..=0.57).contains(&at(0.5)), "{}", at(0.5));
}

#[test]
fn rocks_lie_closer_around_fresh_craters() {
    let (mut inside, mut inside_m2, mut outside, mut outside_m2) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..8 {
        let set = [SURFACE, "camera.height_m=12", "camera.pitch_deg=-60", "rocks.coverage=0.008"];
        let scene = scene(seed, &set);
        let mut fresh = Vec::new();
        let relief = scene.relief.as_ref().expect("a relief");
        relief.craters.around(&Region::circle(Vec2::ZERO, 60.0), 2.0, |pit| {
            if pit.is_fresh() {
                fresh.push(pit);
            }
        });
        // Sizes that are generated everywhere within 25 m.
        let large = |rock: &&regolith::scene::rocks::Rock| (0.05..0.10).contains(&(2.0 * rock.base_scale_m));
        let ring = |point: Vec2| {
            fresh.iter().any(|pit| {
                let r = 2.0 * (point - scene.terrain.centre).distance(pit.offset) / pit.diameter_m;
                (1.0..2.0).contains(&r)
            })
        };
        for i in 0..40_000_u32 {
            let point = Vec2::new((i % 200) as f32 - 100.0, (i / 200) as f32 - 100.0) * 0.4;
            if point.length() < 25.0 && point.y > point.x.abs() {
                let to = if ring(scene.terrain.centre + point) { &mut inside_m2 } else { &mut outside_m2 };
                *to += 0.16;
            }
        }
        for rock in scene.rocks.iter().filter(large) {
            let point = rock.centre.truncate() - scene.terrain.centre;
            if point.length() < 25.0 && point.y > point.x.abs() {
                let to = if ring(rock.centre.truncate()) { &mut inside } else { &mut outside };
                *to += 1.0;
            }
        }
    }
    println!("{inside} rocks on {inside_m2:.0} m2 of rings, {outside} on {outside_m2:.0} m2 elsewhere");
    let ratio = (inside / inside_m2) / (outside / outside_m2);
    assert!(ratio >= 3.0, "{ratio} times as many");
}

/// Ratio of the rocks' albedo to the soil's: median 1.2 to 1.5, a tenth to a quarter of them darker.
#[test]
fn rocks_are_brighter_and_darker_than_the_soil() {
    let scene = scene(3, &[SURFACE, "rocks.coverage=0.03"]);
    let soil = scene.regolith.albedo.y;
    let ratios: Vec<f64> = scene.rocks.iter().map(|rock| f64::from(rock.material.albedo.y / soil)).collect();
    assert!(ratios.len() > 1000 && ratios.iter().all(|ratio| (0.699..2.501).contains(ratio)));
    // Log-normal with a spread of 0.3: a sixth is below the median over its exponential.
    let mut sorted = ratios.clone();
    sorted.sort_by(f64::total_cmp);
    let spread = (sorted[sorted.len() / 2] / sorted[(0.1587 * sorted.len() as f64) as usize]).ln();
    assert!((spread / 0.3 - 1.0).abs() < 0.1, "{spread}");
    // One draw of brightness a rock, and a hue less red than the soil's.
    let hues = |albedo: glam::Vec3| [albedo.x / albedo.y, albedo.z / albedo.y];
    let of_soil = hues(scene.regolith.albedo);
    let of_rocks: Vec<[f32; 2]> = scene.rocks.iter().map(|rock| hues(rock.material.albedo)).collect();
    for hue in &of_rocks {
        assert!(hue[0] < of_soil[0] && hue[1] > of_soil[1], "{hue:?} beside {of_soil:?}");
        let apart = [0, 1].map(|channel| (hue[channel] / of_rocks[0][channel] - 1.0).abs());
        assert!(apart.iter().all(|apart| *apart < 1e-4), "hues {hue:?} and {:?}", of_rocks[0]);
    }
    let darker = ratios.iter().filter(|ratio| **ratio < 1.0).count() as f64 / ratios.len() as f64;
    let middle = median(ratios);
    println!("ratio {middle:.3}, darker {darker:.3}");
    assert!((1.2..=1.5).contains(&middle) && (0.10..=0.25).contains(&darker), "{middle}, {darker}");
}

#[test]
fn no_rock_floats_and_each_has_the_vertices_of_its_level() {
    for seed in 0..4 {
        let scene = scene(seed, &[SURFACE]);
        assert!(scene.rocks.len() > 500, "{}", scene.rocks.len());
        for rock in &scene.rocks {
            let lowest =
                rock.vertices.iter().map(|v| v.position + rock.centre).min_by(|a, b| a.z.total_cmp(&b.z));
            let lowest = lowest.expect("vertices");
            assert!(
                lowest.z < scene.terrain.surface_height_at(lowest.truncate()),
                "rock {} floats",
                rock.index
            );
            assert_eq!(rock.vertices.len(), mesh::Icosphere::vertex_count(rock.level));
        }
    }
}

/// The scene does not depend on where the camera looks: rocks that both of two views show are the same ones.
#[test]
fn turning_the_camera_moves_no_rock() {
    let (ahead, aside) = (scene(6, &[SURFACE]), scene(6, &[SURFACE, "camera.yaw_deg=20"]));
    let is_in_view = |scene: &Scene, point: Vec2| {
        let forward = scene.camera.forward.truncate().normalize();
        let offset = point - scene.camera.eye.truncate();
        let along = offset.dot(forward);
        along > 0.0 && offset.perp_dot(forward).abs() < 0.95 * scene.camera.tan_half_fov * along
    };
    let in_both = |scene: &Scene| -> HashSet<[u32; 2]> {
        let positions = scene.rocks.iter().map(|rock| rock.centre.truncate());
        let seen = positions.filter(|point| [&ahead, &aside].iter().all(|view| is_in_view(view, *point)));
        seen.map(|point| point.to_array().map(f32::to_bits)).collect()
    };
    let (first, second) = (in_both(&ahead), in_both(&aside));
    assert!(first.len() > 500, "{} rocks are in both views", first.len());
    assert_eq!(first.difference(&second).count(), 0, "of {} rocks", first.len());
    assert_eq!(second.difference(&first).count(), 0, "of {} rocks", second.len());
}

#[test]
fn no_rock_of_the_surface_is_at_the_same_position_in_two_scenes() {
    let mut positions = Vec::new();
    for seed in 0..6 {
        let scene = scene(seed, &[SURFACE]);
        positions.extend(scene.rocks.iter().map(|rock| rock.centre.truncate().to_array().map(f32::to_bits)));
    }
    let count = positions.len();
    let different: HashSet<[u32; 2]> = positions.into_iter().collect();
    assert!(count > 3000, "{count} rocks");
    assert_eq!(different.len(), count);
}

fn frame(scene: &Scene, side: u32, annotations: &[Annotation]) -> Frame {
    let mut settings = RenderSettings::new([side, side], 4).expect("settings");
    settings.annotations = annotations.iter().copied().collect();
    renderer().render(scene, &settings).unwrap_or_else(|error| panic!("{error}")).0
}

#[test]
fn fifty_seeds_have_no_unlabelled_pixel() {
    for seed in 0..50 {
        let scene = scene(seed, &[SURFACE]);
        let frame = frame(&scene, 128, &[]);
        assert_eq!(frame.count(ClassId::UNLABELLED), 0, "seed {seed}");
        let [regolith, sky] = [ClassId::REGOLITH, ClassId::SKY].map(|class| frame.coverage(class));
        assert!(regolith > 0.3 && sky > 0.05, "seed {seed}: regolith {regolith}, sky {sky}");
    }
}

/// Real skies over sunlit ground are 0 to 2 of 255. In path-traced frames cast shadows are below 1 % of lit soil, and rock faces that
/// the sun does not reach are at 1 to 8 %.
#[test]
fn sky_is_black_and_shadows_are_dark() {
    for seed in [1, 5] {
        let scene = scene(seed, &[SURFACE, "rocks.coverage=0.04", "sun.azimuth_deg=100"]);
        let frame = frame(&scene, 192, &[Annotation::Shadow, Annotation::Hdr]);
        let (mut lit, mut dark, mut unlit) = (Vec::new(), Vec::new(), Vec::new());
        for (pixel, rgb) in frame.rgb.chunks_exact(3).enumerate() {
            let (x, y) = (pixel % 192, pixel / 192);
            let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(191);
            let is_inside = near(y).all(|y| near(x).all(|x| frame.class[y * 192 + x] == frame.class[pixel]));
            match (frame.class[pixel], frame.sun_occlusion[pixel]) {
                _ if !is_inside => {}
                (2, _) => assert!(rgb.iter().all(|value| *value <= 2), "seed {seed}: sky {rgb:?}"),
                (0, 0) => lit.push(f64::from(frame.radiance[3 * pixel + 1].to_f32())),
                (0, 255) => dark.push(f64::from(frame.radiance[3 * pixel + 1].to_f32())),
                (1, 255) => unlit.push(f64::from(frame.radiance[3 * pixel + 1].to_f32())),
                _ => {}
            }
        }
        assert!(unlit.len() > 20, "seed {seed}: {} pixels of unlit rock", unlit.len());
        assert!(dark.len() > 20, "seed {seed}: {} pixels in shadow", dark.len());
        let lit = median(lit);
        let (ratio, faces) = (median(dark) / lit, median(unlit) / lit);
        println!("seed {seed}: shadow {ratio:.4} of lit soil, unlit faces of rocks {faces:.4}");
        assert!((0.01..=0.08).contains(&faces), "seed {seed}: unlit faces are {faces} of lit soil");
        assert!(ratio < 0.01, "seed {seed}: cast shadows are {ratio} of lit soil");
    }
}

/// A label rule removes whole rocks from the labels and does not change the image.
#[test]
fn label_rules_remove_whole_rocks() {
    let all = scene(3, &[SURFACE]);
    let few = scene(3, &[SURFACE, "label.min_pixels=30", "label.min_diameter_m=0.05"]);
    let (before, after) =
        (frame(&all, 192, &[Annotation::Instances]), frame(&few, 192, &[Annotation::Instances]));
    assert!(before.rgb == after.rgb, "the image changes");
    let mut kept = 0;
    for label in &before.rocks {
        let pixels = before.instances.iter().enumerate().filter(|(_, id)| **id == label.instance);
        let pixels: Vec<usize> = pixels.map(|(pixel, _)| pixel).collect();
        let still = pixels.iter().filter(|pixel| after.class[**pixel] == ClassId::ROCK.0).count();
        // At the outline of a rock the majority of the samples may change.
        assert!(
            still == 0 || 2 * still > pixels.len(),
            "rock {} is cut: {still} of {}",
            label.instance,
            pixels.len()
        );
        kept += u32::from(still > 0);
    }
    assert!(kept > 0 && (kept as usize) < before.rocks.len() / 2, "{kept} of {}", before.rocks.len());
    assert_eq!(few.geometry_hash(), all.geometry_hash());
}

/// Hazard planes compared with values computed from the scene.
#[test]
fn hazard_planes_agree_with_the_scene() {
    use regolith::render::post::hazards::{CRATER_INTERIOR, CRATER_RIM, FiveClasses, SLOPE_BASELINE_M};
    let scene = scene(11, &[SURFACE, "camera.pitch_deg=-15"]);
    let annotations = [
        Annotation::Slope,
        Annotation::Craters,
        Annotation::Angles,
        Annotation::FiveClasses,
        Annotation::Depth,
        Annotation::Normals,
        Annotation::Instances,
    ];
    let frame = frame(&scene, 160, &annotations);
    let camera = &scene.camera;
    let focal = camera.focal_px(160) as f32;
    let mut craters = Vec::new();
    let relief = scene.relief.as_ref().expect("a relief");
    relief.craters.around(
        &Region::circle(Vec2::ZERO, 100.0),
        // Those of the least diameter too.
        scene.label_rule.crater_min_diameter_m.next_down(),
        |pit| {
            if pit.depth >= scene.label_rule.crater_min_depth {
                craters.push((scene.terrain.centre + pit.offset, 0.5 * pit.diameter_m));
            }
        },
    );
    let mut counts = [0_u32; 5];
    for pixel in 0..frame.class.len() {
        counts[usize::from(frame.five_classes[pixel])] += 1;
        let collapsed = match frame.five_classes[pixel] {
            FiveClasses::CRATER | FiveClasses::MOUNTAIN => ClassId::REGOLITH.0,
            id => id,
        };
        assert_eq!(collapsed, frame.class[pixel], "five classes collapse to three");
        let (x, y) = ((pixel % 160) as f32 - 79.5, (pixel / 160) as f32 - 79.5);
        let ray = camera.forward + x / focal * camera.right - y / focal * camera.up;
        let point = camera.eye + frame.depth_m[pixel] * ray;
        if frame.class[pixel] == ClassId::SKY.0 {
            assert!(frame.slope_deg[pixel].is_nan() && frame.phase_deg[pixel].is_nan());
            continue;
        }
        let phase = (-ray.normalize()).dot(scene.sun.direction).acos().to_degrees();
        assert!((frame.phase_deg[pixel] - phase).abs() < 0.05, "{phase}");
        let normal = glam::Vec3::from_slice(&frame.normals[3 * pixel..3 * pixel + 3]);
        let incidence = normal.dot(scene.sun.direction).clamp(-1.0, 1.0).acos().to_degrees();
        assert!((frame.incidence_deg[pixel] - incidence).abs() < 0.05, "{incidence}");
        if frame.class[pixel] != ClassId::REGOLITH.0 {
            assert_eq!(frame.craters[pixel], 0, "a rock is not part of a crater");
            continue;
        }
        let half = 0.5 * SLOPE_BASELINE_M;
        let height = |x: f32, y: f32| scene.terrain.surface_height_at(point.truncate() + Vec2::new(x, y));
        let rise = Vec2::new(height(half, 0.0) - height(-half, 0.0), height(0.0, half) - height(0.0, -half));
        let slope = (rise / SLOPE_BASELINE_M).length().atan().to_degrees();
        assert!((frame.slope_deg[pixel] - slope).abs() < 0.5, "{} and {slope}", frame.slope_deg[pixel]);
        let nearest = craters
            .iter()
            .map(|(centre, radius)| point.truncate().distance(*centre) / radius)
            .fold(f32::INFINITY, f32::min);
        // Only as far as the list of craters reaches, and not where rounding decides.
        let is_near = point.distance(camera.eye) < 90.0;
        if is_near && [1.0, 1.3].iter().all(|edge: &f32| (nearest - edge).abs() > 1e-3) {
            let expected = if nearest < 1.0 {
                CRATER_INTERIOR
            } else if nearest < 1.3 {
                CRATER_RIM
            } else {
                0
            };
            assert_eq!(frame.craters[pixel], expected, "{nearest} radii from a centre");
        }
        let distance_m = point.distance(camera.eye);
        if (distance_m / 400.0 - 1.0).abs() > 1e-3 {
            let expected = if frame.craters[pixel] == CRATER_INTERIOR {
                FiveClasses::CRATER
            } else if distance_m > 400.0 {
                FiveClasses::MOUNTAIN
            } else {
                ClassId::REGOLITH.0
            };
            assert_eq!(frame.five_classes[pixel], expected, "{distance_m} m away");
        }
    }
    assert!(counts[0] > 1000 && counts[1] > 20 && counts[2] > 100 && counts[3] > 100, "{counts:?}");
    assert!(counts[4] > 50, "{counts:?}");
    for rock in &frame.rocks {
        let of = &scene.rocks[usize::from(rock.instance) - 1];
        assert!((rock.diameter_m / (2.0 * of.base_scale_m) - 1.0).abs() < 0.01, "{rock:?}");
        assert!(rock.height_m > 0.1 * rock.diameter_m && rock.height_m < 1.2 * rock.diameter_m, "{rock:?}");
    }
}

/// Contrast of a class at scales of 1 to 4 pixels, relative to its mean: the RMS difference between the image and a blurred copy,
/// over lit pixels whose surroundings are of that class.
fn band_contrast(frame: &Frame, side: usize, class: u8, phases_deg: [f32; 2]) -> Option<f64> {
    let value = |pixel: usize| f64::from(frame.radiance[3 * pixel + 1].to_f32());
    let mean = |x: usize, y: usize, reach: usize| {
        let span = |v: usize| v - reach..=v + reach;
        let all = span(y).flat_map(|y| span(x).map(move |x| value(y * side + x)));
        all.sum::<f64>() / ((2 * reach + 1) as f64).powi(2)
    };
    let (mut squares, mut sum, mut n) = (0.0, 0.0, 0.0);
    for (y, x) in (4..side - 4).flat_map(|y| (4..side - 4).map(move |x| (y, x))) {
        let is_uniform = (y - 2..=y + 2).all(|y| (x - 2..=x + 2).all(|x| frame.class[y * side + x] == class));
        let lit = (y - 2..=y + 2).all(|y| (x - 2..=x + 2).all(|x| frame.sun_occlusion[y * side + x] < 128));
        let phase_deg = frame.phase_deg[y * side + x];
        if is_uniform && lit && phases_deg[0] <= phase_deg && phase_deg <= phases_deg[1] {
            squares += (value(y * side + x) - mean(x, y, 2)).powi(2);
            sum += value(y * side + x);
            n += 1.0;
        }
    }
    (n > 40.0).then(|| (squares / n).sqrt() / (sum / n))
}

/// Real frames of Chang'e-3: rocks have as much texture as soil in side light (0.85 to 1.1), and more with the sun behind the
/// camera, where the relief of soil does not show (2 to 4).
#[test]
fn rocks_have_as_much_texture_as_soil_in_side_light() {
    let ratio = |azimuth_deg: f64, elevation_deg: f64, phases_deg: [f32; 2]| {
        let set = [format!("sun.azimuth_deg={azimuth_deg}"), format!("sun.elevation_deg={elevation_deg}")];
        let mut ratios = Vec::new();
        for seed in 0..SEEDS_OF_TEXTURE {
            let scene =
                scene(seed, &[SURFACE, "rocks.coverage=0.05", "camera.pitch_deg=-12", &set[0], &set[1]]);
            let frame = frame(&scene, 256, &[Annotation::Hdr, Annotation::Shadow, Annotation::Angles]);
            let [soil, rock] = [ClassId::REGOLITH, ClassId::ROCK]
                .map(|class| band_contrast(&frame, 256, class.0, phases_deg));
            ratios.extend(rock.zip(soil).map(|(rock, soil)| rock / soil));
        }
        println!(
            "sun at {azimuth_deg}, {elevation_deg}: {} frames, median {:.2}",
            ratios.len(),
            median(ratios.clone())
        );
        median(ratios)
    };
    let (side, behind) = (ratio(90.0, 20.0, [50.0, 180.0]), ratio(180.0, 30.0, [0.0, 25.0]));
    assert!((0.8..=1.3).contains(&side), "side light: {side}");
    assert!((1.5..=4.5).contains(&behind), "sun behind: {behind}");
}
const SEEDS_OF_TEXTURE: u64 = 20;

/// Skewness and excess kurtosis of sunlit soil at scales below 9 pixels: of the difference between linear radiance and its mean
/// around.
fn soil_moments(frame: &Frame, side: usize) -> [f64; 2] {
    let value = |pixel: usize| f64::from(frame.radiance[3 * pixel + 1].to_f32());
    let soil = |pixel: usize| frame.class[pixel] == ClassId::REGOLITH.0 && frame.sun_occlusion[pixel] < 128;
    let around =
        |x: usize, y: usize| (y - 4..=y + 4).flat_map(move |y| (x - 4..=x + 4).map(move |x| y * side + x));
    let mut differences = Vec::new();
    for (y, x) in (4..side - 4).flat_map(|y| (4..side - 4).map(move |x| (y, x))) {
        if around(x, y).all(soil) {
            let mean = around(x, y).map(value).sum::<f64>() / 81.0;
            differences.push(value(y * side + x) / mean - 1.0);
        }
    }
    let n = differences.len() as f64;
    assert!(n > 2000.0, "{n} pixels of soil");
    let mean = differences.iter().sum::<f64>() / n;
    let moment = |power: i32| differences.iter().map(|d| (d - mean).powi(power)).sum::<f64>() / n;
    let variance = moment(2);
    [moment(3) / variance.powf(1.5), moment(4) / (variance * variance) - 3.0]
}

/// Real frames of Chang'e-3 (encoded, reduced to 256 pixels): skewness 0.8 to 2.3 and excess kurtosis 8 to 24 at 1 to 4 pixels,
/// bright grains on smoother soil. A sum of Gaussian slopes has neither.
#[test]
fn soil_has_bright_grains_on_smoother_ground() {
    let moments = |set: &[&str]| {
        let views = [("90", "-15"), ("60", "-25"), ("250", "-18"), ("130", "-20")];
        let all = (300..).zip(views).map(|(seed, (azimuth_deg, pitch_deg))| {
            let view = [format!("sun.azimuth_deg={azimuth_deg}"), format!("camera.pitch_deg={pitch_deg}")];
            let fixed = [
                SURFACE,
                "sun.elevation_deg=25",
                "camera.fov_deg=22",
                "camera.height_m=1.5",
                "rocks.coverage=0.02",
            ];
            let set: Vec<&str> =
                fixed.into_iter().chain(view.iter().map(String::as_str)).chain(set.iter().copied()).collect();
            soil_moments(&frame(&scene(seed, &set), 256, &[Annotation::Hdr, Annotation::Shadow]), 256)
        });
        let all: Vec<[f64; 2]> = all.collect();
        println!("{set:?}: {all:.2?}");
        [0, 1].map(|k| median(all.iter().map(|moments| moments[k]).collect()))
    };
    let [skewness, kurtosis] = moments(&[]);
    let [bare_skewness, bare_kurtosis] = moments(&["grains.density=0"]);
    assert!(
        skewness > bare_skewness + 0.3 && skewness > 0.0,
        "skewness {skewness}, without grains {bare_skewness}"
    );
    assert!(
        kurtosis > 6.0 && kurtosis > 1.5 * bare_kurtosis,
        "kurtosis {kurtosis}, without grains {bare_kurtosis}"
    );
}

/// Fraction of a Gaussian rough surface that is in shadow, seen from above (Smith 1967, "Lunar surface roughness: shadowing and
/// thermal emission", eq. 24): `slope` is the tangent of the deviation along a line, `mu` that of the sun's elevation.
fn smith_shadow(slope: f64, mu: f64) -> f64 {
    // Complementary error function (Abramowitz and Stegun, 7.1.26: within 1.5e-7).
    let erfc = |x: f64| {
        let t = 1.0 / (1.0 + 0.327_591_1 * x);
        t * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))))
            * (-x * x).exp()
    };
    let v = mu / (std::f64::consts::SQRT_2 * slope);
    let lambda = 0.5 * ((-v * v).exp() / (std::f64::consts::PI.sqrt() * v) - erfc(v));
    1.0 - (1.0 - 0.5 * erfc(v)) / (1.0 + lambda)
}

#[test]
fn smiths_formula_has_its_tabulated_values() {
    for (elevation, slope, expected) in
        [(5.0, 10.0, 0.51), (10.0, 10.0, 0.22), (17.0, 15.0, 0.17), (30.0, 20.0, 0.07)]
    {
        let tan = |degrees: f64| degrees.to_radians().tan();
        let found = smith_shadow(tan(slope), tan(elevation));
        assert!((found - expected).abs() < 0.006, "{elevation}, {slope}: {found}");
    }
}

/// A Gaussian surface (waves of random directions and phases) viewed from straight above.
#[test]
fn rough_ground_is_in_shadow_as_often_as_smiths_formula_says() {
    use regolith::scene::camera::Camera;
    use regolith::scene::sky::Sun;
    use regolith::scene::terrain::Terrain;
    let (mut worst, mut worst_formula) = (0.0_f64, 0.0_f64);
    for (slope_deg, elevations_deg) in [(10.0_f64, [5.0, 10.0, 17.0]), (20.0, [10.0, 17.0, 30.0])] {
        let mut stream = Streams::new(1).stream("test.waves", slope_deg as u64);
        // Wave numbers normal about 0: a Gaussian correlation, 7 m long.
        let waves: Vec<[f64; 3]> = (0..300)
            .map(|_| {
                [stream.normal() * 0.2, stream.normal() * 0.2, stream.uniform(0.0, std::f64::consts::TAU)]
            })
            .collect();
        // Towards the sun, along which the slope counts.
        let towards = [60.0_f64.to_radians().sin(), 60.0_f64.to_radians().cos()];
        let variance: f64 = waves.iter().map(|w| 0.5 * (w[0] * towards[0] + w[1] * towards[1]).powi(2)).sum();
        let amplitude = slope_deg.to_radians().tan() / variance.sqrt();
        let height = |p: Vec2| {
            let p = p.as_dvec2();
            let sum: f64 = waves.iter().map(|w| (w[0] * p.x + w[1] * p.y + w[2]).sin()).sum();
            (amplitude * sum) as f32
        };
        let terrain = Arc::new(Terrain::from_height(400.0, 400, Vec::new(), height));
        for elevation_deg in elevations_deg {
            let mut scene = scene(1, &["rocks.count=0"]);
            scene.rocks = Vec::new().into();
            scene.terrain = Arc::clone(&terrain);
            scene.sun = Sun::new(elevation_deg, 60.0, 0.0, glam::Vec3::ONE);
            scene.camera =
                Camera::new(glam::Vec3::new(0.0, 0.0, 2000.0), [-90.0, 0.0, 0.0], 8.0, 5000.0, 0.0);
            scene.sky.radius_m = 4000.0;
            let frame = frame(&scene, 256, &[Annotation::Shadow]);
            let occluded = frame.sun_occlusion.iter().map(|value| f64::from(*value) / 255.0).sum::<f64>()
                / frame.sun_occlusion.len() as f64;
            // The slopes of this part of the surface along the sun's direction.
            let visible =
                terrain.vertices.iter().filter(|v| v.position.truncate().abs().max_element() < 139.0);
            let squares: Vec<f64> = visible
                .map(|v| {
                    f64::from(
                        v.normal.truncate().dot(scene.sun.direction.truncate().normalize()) / v.normal.z,
                    )
                })
                .map(|slope| slope * slope)
                .collect();
            let slope = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            let expected = smith_shadow(slope, elevation_deg.to_radians().tan());
            // An independent value, by marching from points of the surface towards the sun.
            let towards = scene.sun.direction;
            let is_occluded = |i: i32| {
                let point = Vec2::new((i % 64 - 32) as f32, (i / 64 - 32) as f32) * 4.3;
                let start = point.extend(terrain.surface_height_at(point) + 1e-3);
                (1..1600).any(|step| {
                    let at = start + 0.1 * step as f32 * towards / towards.truncate().length();
                    terrain.surface_height_at(at.truncate()) > at.z
                })
            };
            let marched = (0..4096).filter(|i| is_occluded(*i)).count() as f64 / 4096.0;
            println!(
                "slope {slope_deg}, sun {elevation_deg}: {occluded:.3} in shadow, marched {marched:.3}, Smith {expected:.3}"
            );
            worst = worst.max((occluded - marched).abs());
            worst_formula = worst_formula.max((occluded - expected).abs());
        }
    }
    assert!(worst < 0.02, "off by {worst}");
    // Smith takes heights and slopes as independent of each other; marching differs from him by as much.
    assert!(worst_formula < 0.05, "off by {worst_formula} from Smith");
}

/// Slope of the power spectrum of the ground in the image; real frames of Chang'e-3 have -1.6 to -2.2.
#[test]
fn ground_has_the_spectrum_of_a_photograph() {
    const PATCH: usize = 64;
    let mut slopes = Vec::new();
    for seed in 0..6 {
        let scene = scene(seed, &[SURFACE, "rocks.coverage=0", "camera.pitch_deg=-20", "camera.fov_deg=40"]);
        let frame = frame(&scene, 384, &[]);
        let value = |x: usize, y: usize| f64::from(frame.rgb[3 * (y * 384 + x) + 1]);
        for (x0, y0) in [(40, 200), (160, 220), (280, 260), (100, 300)] {
            // Hann window after subtracting the mean; transform along rows, then along columns.
            let hann = |i: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (i as f64 + 0.5) / PATCH as f64).cos();
            let mean = (0..PATCH * PATCH).map(|i| value(x0 + i % PATCH, y0 + i / PATCH)).sum::<f64>()
                / (PATCH * PATCH) as f64;
            let mut plane: Vec<(f64, f64)> = (0..PATCH * PATCH)
                .map(|i| {
                    ((value(x0 + i % PATCH, y0 + i / PATCH) - mean) * hann(i % PATCH) * hann(i / PATCH), 0.0)
                })
                .collect();
            for along in [1, PATCH] {
                let before = plane.clone();
                for line in 0..PATCH {
                    let start = if along == 1 { line * PATCH } else { line };
                    for k in 0..PATCH {
                        let mut sum = (0.0, 0.0);
                        for i in 0..PATCH {
                            let (re, im) = before[start + i * along];
                            let (sin, cos) =
                                (-std::f64::consts::TAU * (i * k % PATCH) as f64 / PATCH as f64).sin_cos();
                            sum = (sum.0 + re * cos - im * sin, sum.1 + re * sin + im * cos);
                        }
                        plane[start + k * along] = sum;
                    }
                }
            }
            let mut rings = vec![(0.0, 0.0); PATCH / 2];
            for (i, (re, im)) in plane.iter().enumerate() {
                let signed = |k: usize| if k < PATCH / 2 { k as f64 } else { k as f64 - PATCH as f64 };
                let radius = signed(i % PATCH).hypot(signed(i / PATCH)).round() as usize;
                if radius < PATCH / 2 {
                    rings[radius] = (rings[radius].0 + re * re + im * im, rings[radius].1 + 1.0);
                }
            }
            let points: Vec<(f64, f64)> =
                (4..PATCH * 3 / 10).map(|k| ((k as f64).ln(), (rings[k].0 / rings[k].1).ln())).collect();
            let n = points.len() as f64;
            let (mx, my) =
                (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
            slopes.push(
                points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
                    / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>(),
            );
        }
    }
    let slope = median(slopes);
    println!("spectrum of ground patches: {slope:.2}");
    assert!((-3.0..=-1.2).contains(&slope), "{slope}");
}

/// The three classes of craters: radii of 14 to 40, 3 to 12 and 0.6 to 3 m, in the numbers of the knobs, and no other
/// larger than 1.25 m.
#[test]
fn craters_can_be_counted_by_class() {
    let relief = relief(7, &["craters.law=classes", "craters.small_count=250"]);
    let mut found: [u32; 3] = [0; 3];
    let mut deepened = 0;
    relief.craters.around(&Region::circle(Vec2::ZERO, 1000.0), 1.25, |pit| {
        let class = match 0.5 * pit.diameter_m {
            r if (14.0..=40.0).contains(&r) => 0,
            r if (3.0..=12.0).contains(&r) => 1,
            r if (0.6..=3.0).contains(&r) => 2,
            r => panic!("a radius of {r} m"),
        };
        found[class] += 1;
        let point = pit.offset + Vec2::new(0.0, -90.0);
        assert!(point.abs().max_element() <= 383.0, "a crater at {point}");
        assert!((0.02..=0.15).contains(&pit.depth), "{}", pit.depth);
        let without = {
            let mut craters = relief.clone();
            craters.craters.listed.retain(|other| other.key != pit.key);
            craters.height_at(pit.offset, 0.05)
        };
        deepened +=
            u32::from(relief.height_at(pit.offset, 0.05) < without - 0.5 * pit.depth * pit.diameter_m);
    });
    // A few of the small ones, of 1.2 to 1.25 m, are below the smallest diameter of the search.
    let expected = relief.craters.listed.iter().filter(|pit| pit.diameter_m > 1.25).count() as u32;
    assert_eq!((found[0], found[1], found[2]), (7, 42, expected - 49));
    assert_eq!((relief.craters.listed.len(), deepened), (7 + 42 + 250, expected));
}

/// The four bands of rocks: radii of 1.6 to 3.4, 0.5 to 1.4, 0.18 to 0.5 and 0.04 to 0.18 m, in the numbers of the knobs.
#[test]
fn rocks_can_be_counted_by_band_and_more_of_one_band_move_nothing_else() {
    let bands = [
        "rocks.law=bands",
        "craters.law=classes",
        "rocks.pebble_count=200",
        "rocks.small_count=80",
        "rocks.mid_count=30",
    ];
    let make = |more: &str| {
        let set: Vec<&str> = [SURFACE].into_iter().chain(bands).chain([more]).collect();
        scene(5, &set)
    };
    let few = make("rocks.large_count=12");
    let count = |low: f32, high: f32| {
        few.rocks.iter().filter(|rock| (low..=high).contains(&rock.base_scale_m)).count()
    };
    assert_eq!([count(1.6, 3.4), count(0.5, 1.4), count(0.18, 0.5), count(0.04, 0.18)], [12, 30, 80, 200]);
    assert_eq!(few.rocks.len(), 322);
    for more in
        ["rocks.pebble_count=260", "rocks.mid_count=35", "craters.small_count=300", "craters.big_count=9"]
    {
        let many = make(more);
        for rock in &few.rocks {
            // Seen from above: a rock is laid along the slope of the ground.
            let outline = |rock: &regolith::scene::rocks::Rock| -> Vec<Vec2> {
                rock.vertices.iter().map(|vertex| vertex.position.truncate()).collect()
            };
            let same = many.rocks.iter().any(|other| {
                other.centre.truncate() == rock.centre.truncate() && outline(other) == outline(rock)
            });
            assert!(same, "{more} moves rock {}", rock.index);
        }
        let listed = |scene: &Scene| scene.relief.as_ref().expect("a relief").craters.listed.clone();
        let after = listed(&many);
        assert!(listed(&few).iter().all(|pit| after.contains(pit)), "{more} moves a crater");
        let added = many.rocks.len() + after.len() - few.rocks.len() - listed(&few).len();
        assert!([60, 5, 60, 2].contains(&added), "{more} adds {added}");
        let stars = |scene: &Scene| -> Vec<_> { scene.sky.stars.iter().map(|star| star.radius_m).collect() };
        assert_eq!(stars(&few), stars(&many));
    }
}
