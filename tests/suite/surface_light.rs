//! The light of the surface stage compared with published values: contrast of the soil, colour, exposure, stars.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::params::Knob;
use regolith::params::config::Config;
use regolith::render::RenderSettings;
use regolith::scene::Scene;

use crate::support::{renderer, scene};

const REGOLITH: u8 = ClassId::REGOLITH.0;
const SKY: u8 = ClassId::SKY.0;

fn frame(scene: &Scene, side: u32, annotations: &[Annotation]) -> Frame {
    let mut settings = RenderSettings::new([side, side], 4).expect("settings");
    settings.annotations = annotations.iter().copied().collect();
    renderer().render(scene, &settings).unwrap_or_else(|error| panic!("{error}")).0
}

fn surface(seed: u64, set: &[&str]) -> Scene {
    let set: Vec<&str> = ["stage.name=surface"].iter().chain(set).copied().collect();
    scene(seed, &set)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn green(frame: &Frame, pixel: usize) -> f64 {
    f64::from(frame.radiance[3 * pixel + 1].to_f32())
}

/// Side of the patches in which contrast is measured, pixels: 0.22 m here, so that neither hills nor the change of phase across
/// the image contribute.
const PATCH: usize = 16;

/// Standard deviation over mean of the linear radiance of each soil patch whose phase is at most `max_phase_deg`.
fn soil_variation(frame: &Frame, max_phase_deg: f32) -> Vec<f64> {
    let side = frame.width as usize;
    let patches = side / PATCH;
    let mut found = Vec::new();
    for (row, column) in (0..patches).flat_map(|row| (0..patches).map(move |column| (row, column))) {
        let first = PATCH * (row * side + column);
        let pixels: Vec<usize> = (0..PATCH * PATCH).map(|i| first + i / PATCH * side + i % PATCH).collect();
        if pixels.iter().any(|p| frame.class[*p] != REGOLITH || frame.phase_deg[*p] > max_phase_deg) {
            continue;
        }
        let n = pixels.len() as f64;
        let mean = pixels.iter().map(|p| green(frame, *p)).sum::<f64>() / n;
        let variance = pixels.iter().map(|p| (green(frame, *p) - mean).powi(2)).sum::<f64>() / n;
        found.push(variance.sqrt() / mean);
    }
    found
}

/// Relief as measured at the site of Chang'e-4, a sun 17 degrees high, pixels 14 mm wide on the ground: shading varies by 0.3 to
/// 0.6 of its mean in light from the side (real frames: 0.23 and 0.40), and by less than 0.08 at a phase below 3 degrees (real
/// frames: 0.05 and 0.09).
#[test]
fn soil_has_contrast_in_side_light_and_none_at_zero_phase() {
    let variation = |azimuth_deg: f64, pitch_deg: f64, max_phase_deg: f32| {
        // 64 pixels of 14 mm across the line of sight, where it meets the ground.
        let distance_m = 2.1 / (-pitch_deg).to_radians().sin();
        let fov_deg = 2.0 * (32.0 * 0.014 / distance_m).atan().to_degrees();
        let set = [
            format!("sun.azimuth_deg={azimuth_deg}"),
            format!("camera.pitch_deg={pitch_deg}"),
            format!("camera.fov_deg={fov_deg}"),
        ];
        let mut found = Vec::new();
        for seed in 0..4 {
            let set = ["rocks.coverage=0", "sun.elevation_deg=17", &set[0], &set[1], &set[2]];
            let frame = frame(&surface(seed, &set), 64, &[Annotation::Hdr, Annotation::Angles]);
            found.extend(soil_variation(&frame, max_phase_deg));
        }
        println!("sun at {azimuth_deg}: {} patches, median {:.3}", found.len(), median(found.clone()));
        assert!(found.len() >= 12, "{} patches", found.len());
        median(found)
    };
    let (side, behind) = (variation(90.0, -14.0, 180.0), variation(180.0, -17.0, 3.0));
    assert!((0.3..=0.6).contains(&side), "side light: {side}");
    assert!(behind < 0.08, "zero phase: {behind}");
}

/// Mean linear radiance of the soil: red over green, blue over green.
fn soil_colour(frame: &Frame) -> [f64; 2] {
    let mut sums = [0.0; 3];
    for (rgb, _) in frame.radiance.chunks_exact(3).zip(&frame.class).filter(|(_, id)| **id == REGOLITH) {
        (0..3).for_each(|channel| sums[channel] += f64::from(rgb[channel].to_f32()));
    }
    [sums[0] / sums[1], sums[2] / sums[1]]
}

/// Published colour frames of Chang'e-3, linear: red over green 1.00 to 1.12, blue over green 0.72 to 0.95.
#[test]
fn soil_has_the_colour_of_the_moon_and_a_monochrome_sensor_is_grey() {
    for preset in ["surface_train_dr", "surface_train_nodr", "surface_train_full", "surface_test_photoreal"] {
        let mut config = Config::new();
        config.apply_preset(preset).expect("a preset");
        let params = config.draw(5).expect("drawn");
        let frame = frame(&Scene::build(5, &params).expect("a scene"), 48, &[Annotation::Hdr]);
        let wanted =
            [Knob::RegolithRedOverGreen, Knob::RegolithBlueOverGreen].map(|knob| params.number(knob));
        assert!(
            (1.0..=1.12).contains(&wanted[0]) && (0.72..=0.95).contains(&wanted[1]),
            "{preset}: {wanted:?}"
        );
        // Half floats have steps of 0.0005 to 0.001 of themselves.
        for (found, wanted) in soil_colour(&frame).into_iter().zip(wanted) {
            assert!((found / wanted - 1.0).abs() < 1e-3, "{preset}: {found}, not {wanted}");
        }
    }
    let grey = |kind: &str| {
        let frame = frame(&surface(3, &[kind]), 48, &[]);
        frame.rgb.chunks_exact(3).all(|rgb| rgb[0] == rgb[1] && rgb[1] == rgb[2])
    };
    assert!(grey("sensor.kind=mono") && !grey("sensor.kind=bayer"));
}

/// In frames of Chang'e-3 part of the boundary between rock and soil has almost no contrast: the two differ by less than 10 % at
/// 15 % or more of the outermost rock pixels, where both are sunlit. The sun has elevations of the middle latitudes, where it
/// landed; low light from the side falls on faces of rocks more directly than on soil, and fewer boundary pixels are similar.
#[test]
fn part_of_the_boundary_of_rocks_has_almost_no_contrast() {
    const SIDE: usize = 512;
    const SEEDS: u64 = 12;
    let (mut similar, mut sunlit, mut outermost) = (0.0, 0.0, 0.0);
    for seed in 0..SEEDS {
        let share = (seed as f64 + 0.5) / SEEDS as f64;
        let elevation = format!("sun.elevation_deg={}", 15.0 + 30.0 * share);
        // By the golden angle: evenly spread, and uncorrelated with the elevation.
        let azimuth = format!("sun.azimuth_deg={}", (137.508 * seed as f64) % 360.0);
        let frame = frame(
            &surface(seed, &[&elevation, &azimuth]),
            SIDE as u32,
            &[Annotation::Hdr, Annotation::Shadow],
        );
        let is_sunlit = |pixel: usize| frame.sun_occlusion[pixel] < 128;
        for pixel in (0..SIDE * SIDE).filter(|pixel| frame.class[*pixel] == ClassId::ROCK.0) {
            let (y, x) = (pixel / SIDE, pixel % SIDE);
            let soil: Vec<usize> = [(y, x.wrapping_sub(1)), (y, x + 1), (y.wrapping_sub(1), x), (y + 1, x)]
                .into_iter()
                .filter(|(y, x)| *y < SIDE && *x < SIDE)
                .map(|(y, x)| y * SIDE + x)
                .filter(|neighbour| frame.class[*neighbour] == REGOLITH)
                .collect();
            outermost += f64::from(u8::from(!soil.is_empty()));
            if soil.is_empty() || !is_sunlit(pixel) || !soil.iter().all(|pixel| is_sunlit(*pixel)) {
                continue;
            }
            let around = soil.iter().map(|pixel| green(&frame, *pixel)).sum::<f64>() / soil.len() as f64;
            sunlit += 1.0;
            similar += f64::from(u8::from((green(&frame, pixel) / around - 1.0).abs() < 0.1));
        }
    }
    println!("{outermost} pixels, {sunlit} of them sunlit, {similar} of them with less contrast than 10 %");
    assert!(sunlit > 5000.0 && similar / sunlit >= 0.15, "{similar} of {sunlit}");
}

/// Real frames clip up to 3 % of the ground (1.8 % and 0 in two of Chang'e-3's) and have skies of 0 to 2 of 255.
#[test]
fn a_sensor_clips_little_and_keeps_the_sky_black() {
    const SIDE: usize = 128;
    for kind in ["sensor.kind=bayer", "sensor.kind=mono"] {
        let (mut ground, mut clipped, mut skies) = (0.0, 0.0, Vec::new());
        for seed in 0..2 {
            let frame = frame(&surface(seed, &[kind]), SIDE as u32, &[]);
            for (pixel, rgb) in frame.rgb.chunks_exact(3).enumerate() {
                if frame.class[pixel] != SKY {
                    ground += 1.0;
                    clipped += f64::from(u8::from(rgb.iter().any(|value| *value >= 250)));
                }
            }
            // Away from the glare at the horizon.
            for (y, x) in (5..SIDE - 5).flat_map(|y| (5..SIDE - 5).map(move |x| (y, x))) {
                let mut near = (y - 5..=y + 5).flat_map(|y| (x - 5..=x + 5).map(move |x| y * SIDE + x));
                if near.all(|pixel| frame.class[pixel] == SKY) {
                    skies.extend(frame.rgb[3 * (y * SIDE + x)..][..3].iter().map(|value| f64::from(*value)));
                }
            }
        }
        skies.sort_by(f64::total_cmp);
        let mean = skies.iter().sum::<f64>() / skies.len() as f64;
        let almost_all = skies[skies.len() * 99 / 100];
        println!("{kind}: clipped {:.4}, sky {mean:.3}, 99 % up to {almost_all}", clipped / ground);
        assert!(clipped / ground <= 0.03, "{kind}: {} of the ground is clipped", clipped / ground);
        assert!(skies.len() > 10_000 && mean <= 2.0 && almost_all <= 2.0, "{kind}: sky {mean}, {almost_all}");
    }
}

/// The largest star is Sirius (-1.46): 2.54e-6 x 10^(-0.4 m) lux under a sun of 133 000 lux. A daylight exposure does
/// not show it; an exposure of minutes does.
#[test]
fn stars_are_as_bright_as_real_ones() {
    let sirius = 2.54e-6 * 10_f64.powf(0.4 * 1.46) / 133_000.0;
    let expose = |exposure: &str| {
        let set = ["camera.pitch_deg=25", "camera.fov_deg=25", "sky.star_count=400", exposure];
        let scene = surface(8, &set);
        let frame = frame(&scene, 256, &[Annotation::Hdr]);
        (scene, frame)
    };
    let (scene, frame) = expose("camera.exposure_ev=1.9");
    assert!(frame.class.iter().all(|id| *id == SKY), "only sky is in view");
    // Flux of each star in view and away from the others: radiance x solid angle of the pixels around it.
    let focal = frame.focal_px;
    let mut brightest = 0.0_f64;
    for star in &scene.sky.stars {
        let offset = star.centre - scene.camera.eye;
        let along = offset.dot(scene.camera.forward);
        let (x, y) = (offset.dot(scene.camera.right) / along, -offset.dot(scene.camera.up) / along);
        let (u, v) = (f64::from(x) * focal + 128.0, f64::from(y) * focal + 128.0);
        if along <= 0.0 || !(6.0..250.0).contains(&u) || !(6.0..250.0).contains(&v) {
            continue;
        }
        let cos = 1.0 / f64::from(1.0 + x * x + y * y).sqrt();
        let around = (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (u as i32 + dx, v as i32 + dy)));
        let light: f64 = around.map(|(x, y)| green(&frame, (y * 256 + x) as usize)).sum();
        let own = f64::from(star.radius_m / offset.length()).powi(2) * std::f64::consts::PI;
        let flux = light * cos.powi(3) / (focal * focal);
        // Another star in the square would add to the flux.
        if flux < 1.5 * own * f64::from(scene.sky.star_radiance.y) {
            brightest = brightest.max(flux / f64::from(scene.sun.irradiance.y));
        }
    }
    println!("the brightest star is {:.3} of Sirius", brightest / sirius);
    assert!((brightest / sirius - 1.0).abs() < 0.2, "{} of Sirius", brightest / sirius);
    assert!(frame.rgb.iter().all(|value| *value <= 1), "no star by daylight");
    let long = expose("camera.exposure_ev=10").1;
    assert!(long.rgb.iter().filter(|value| **value > 30).count() > 30, "stars after ten stops");
}
