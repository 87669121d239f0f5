//! Scenes whose result follows from a formula.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use regolith::class::ClassId;
use regolith::frame::Annotation;
use regolith::lens::Lens;
use regolith::pool::PooledVec;
use regolith::render::RenderSettings;
use regolith::render::resolve::tone::srgb_code;
use regolith::scene::Scene;
use regolith::scene::camera::Camera;
use regolith::scene::flare::Flare;
use regolith::scene::label_rule::LabelRule;
use regolith::scene::mesh::{Icosphere, Vertex};
use regolith::scene::photometry::{Law, Photometry};
use regolith::scene::rocks::{Body, Material, NO_DUST, Rock};
use regolith::scene::sky::{Sky, Sun};
use regolith::scene::terrain::Terrain;

use crate::support::{render, renderer, scene};

/// Radiance of the nominal stage's sky.
const DOME_RADIANCE: Vec3 = Vec3::new(0.010, 0.010, 0.016);

const PI: f32 = std::f32::consts::PI;

/// Flat Lambert ground of albedo 0.2 under a white sun, seen from straight above; `rocks` on it.
fn flat_scene(sun: Sun, rocks: Vec<Rock>, eye: Vec3, fov_deg: f64) -> Scene {
    Scene {
        terrain: Terrain::from_height(400.0, 100, Vec::new(), |_| 0.0).into(),
        relief: None,
        photometry: Photometry::default(),
        label_rule: LabelRule::default(),
        sensor: None,
        flare: Flare::default(),
        regolith: Material { albedo: Vec3::splat(0.2), roughness: 0.0 },
        rocks: rocks.into(),
        left_out_rocks: 0,
        sky: Sky {
            centre: Vec3::ZERO,
            radius_m: 600.0,
            stars: Vec::new(),
            radiance: DOME_RADIANCE,
            star_radiance: DOME_RADIANCE,
            earthshine: Vec3::ZERO,
        },
        sun,
        camera: Camera::new(eye, [-90.0, 0.0, 0.0], fov_deg, 2000.0, 0.0),
    }
}

fn ball(centre: Vec3, radius_m: f32) -> Rock {
    let sphere = Icosphere::shared();
    let vertices: Vec<Vertex> =
        sphere.directions.iter().map(|&d| Vertex { position: radius_m * d, normal: d }).collect();
    Rock {
        index: 0,
        centre,
        level: Icosphere::MAX_LEVEL,
        level_errors_m: sphere.level_errors_m(&vertices),
        vertices: Arc::new(PooledVec::from(&vertices[..])),
        radius_m,
        z_range_m: [-radius_m, radius_m],
        base_scale_m: radius_m,
        material: Material { albedo: Vec3::splat(0.1), roughness: 0.0 },
        dust_above: NO_DUST,
        moved: false,
        body: Body::Rock,
    }
}

/// Radiance of flat Lambert ground of albedo 0.2 from which this fraction of the sun's disc is visible.
fn ground_radiance(sun: &Sun, visible: f32) -> Vec3 {
    0.2 * (visible * sun.irradiance * sun.direction.z / PI + DOME_RADIANCE)
}

#[test]
fn lambert_ground_has_the_radiance_of_the_formula() {
    for elevation_deg in [5.0, 17.0, 60.0] {
        let sun = Sun::new(elevation_deg, 120.0, 0.53, Vec3::new(3.0, 2.0, 1.0));
        let frame = render(&flat_scene(sun, Vec::new(), Vec3::new(0.0, 0.0, 30.0), 40.0), 32, 4);
        let expected = ground_radiance(&sun, 1.0).to_array().map(|x| srgb_code(f64::from(x)));
        for pixel in frame.rgb.chunks_exact(3) {
            for (value, expected) in pixel.iter().zip(expected) {
                assert!(
                    (f64::from(*value) - expected).abs() <= 0.6,
                    "{pixel:?} for {expected} at {elevation_deg}"
                );
            }
        }
        assert_eq!(frame.count(ClassId::REGOLITH), 32 * 32);
    }
}

#[test]
fn a_view_of_the_sky_is_labelled_sky_and_has_its_radiance() {
    let frame = render(&scene(4, &["camera.pitch_deg=60", "camera.fov_deg=40", "sky.star_count=0"]), 64, 4);
    assert_eq!(frame.count(ClassId::SKY), 64 * 64);
    let expected = DOME_RADIANCE.to_array().map(|x| srgb_code(f64::from(x)).round() as u8);
    assert!(
        frame.rgb.chunks_exact(3).all(|pixel| pixel == expected),
        "{expected:?}, not {:?}",
        &frame.rgb[..3]
    );
}

#[test]
fn stars_are_labelled_sky() {
    let sky = scene(4, &[]).sky;
    assert_eq!([sky.radiance, sky.star_radiance], [DOME_RADIANCE, Vec3::new(4.0, 4.0, 4.2)]);
    let frame = render(&scene(4, &["camera.pitch_deg=40", "sky.star_count=4000"]), 128, 4);
    assert_eq!(frame.count(ClassId::SKY), 128 * 128);
    assert!(frame.rgb.iter().filter(|value| **value > 200).count() > 100, "stars shine");
}

#[test]
fn a_rock_that_fills_the_view_is_all_rock() {
    let mut scene = scene(4, &["rocks.count=0"]);
    scene.rocks = vec![ball(scene.camera.eye + Vec3::new(0.0, 25.0, 0.0), 24.0)].into();
    let frame = render(&scene, 64, 4);
    assert_eq!(frame.count(ClassId::ROCK), 64 * 64);
}

/// A ball at height H casts an ellipse: half axes R across the sun's direction and R / sin(elevation) along it, centred
/// H / tan(elevation) from the point below the ball.
#[test]
fn the_shadow_of_a_ball_has_its_area_and_position() {
    for azimuth_deg in [0.0, 90.0, 120.0, 250.0] {
        let sun = Sun::new(17.0, azimuth_deg, 0.53, Vec3::splat(3.0));
        let (height_m, radius_m) = (4.0_f32, 1.0_f32);
        let away = -sun.direction.truncate() / sun.direction.truncate().length();
        let sine = sun.direction.z;
        let centre = away * height_m / 17_f32.to_radians().tan();
        let eye = centre.extend(40.0);
        let scene = flat_scene(sun, vec![ball(Vec3::new(0.0, 0.0, height_m), radius_m)], eye, 16.0);
        let side = 256;
        let frame = render(&scene, side, 4);
        let lit = srgb_code(f64::from(ground_radiance(&sun, 0.5).x));
        let metres_per_px = 2.0 * 40.0 * scene.camera.tan_half_fov / side as f32;
        let (mut dark, mut offset) = (0.0_f32, Vec2::ZERO);
        for (i, pixel) in frame.rgb.chunks_exact(3).enumerate() {
            if frame.class[i] == ClassId::REGOLITH.0 && f64::from(pixel[0]) < lit {
                let (x, y) = ((i as u32 % side) as f32 + 0.5, (i as u32 / side) as f32 + 0.5);
                let half = side as f32 / 2.0;
                dark += 1.0;
                offset += Vec2::new(x - half, half - y) * metres_per_px;
            }
        }
        let area = dark * metres_per_px * metres_per_px;
        let expected = PI * radius_m * radius_m / sine;
        assert!((area / expected - 1.0).abs() < 0.02, "azimuth {azimuth_deg}: {area} m2 for {expected}");
        assert!((offset / dark).length() < 0.05, "azimuth {azimuth_deg}: off by {} m", offset / dark);
    }
}

/// The penumbra of a ball at distance d is d x 2 tan(0.265 deg) wide; across it the visible fraction of the sun is the area of a
/// disc beyond a chord.
#[test]
fn the_penumbra_widens_with_distance_by_the_size_of_the_sun() {
    let sun = Sun::new(17.0, 90.0, 0.53, Vec3::splat(3.0));
    for distance_m in [2.0_f32, 5.0, 10.0, 40.0] {
        // The northern edge of the shadow: beside the middle of a ball so large that its outline is straight there.
        let width_m = distance_m * 2.0 * 0.265_f32.to_radians().tan();
        let radius_m = (16.0 * width_m).clamp(0.6, 3.0);
        let centre = Vec3::new(0.0, -radius_m, 0.0) + distance_m * sun.direction;
        let eye = Vec3::new(0.0, 0.0, 1.2 * distance_m * sun.direction.z + 8.0);
        let fov_deg = 2.0 * f64::from(2.5 * width_m / eye.z).atan().to_degrees();
        let scene = flat_scene(sun, vec![ball(centre, radius_m)], eye, fov_deg);
        let side = 256;
        let frame = render(&scene, side, 4);
        let (mut sum, mut worst, mut n) = (0.0_f64, 0.0_f64, 0);
        for row in 0..side {
            let y = (0.5 - (f64::from(row) + 0.5) / f64::from(side)) * 2.0 * f64::from(2.5 * width_m);
            let i = (row * side + side / 2) as usize;
            if frame.class[i] != ClassId::REGOLITH.0 {
                continue;
            }
            let u = (2.0 * y / f64::from(width_m)).clamp(-1.0, 1.0);
            let visible = 0.5 + (u * (1.0 - u * u).sqrt() + u.asin()) / std::f64::consts::PI;
            let expected = srgb_code(f64::from(ground_radiance(&sun, visible as f32).x));
            let error = (f64::from(frame.rgb[3 * i]) - expected).abs() / 255.0;
            sum += error;
            worst = worst.max(error);
            n += 1;
        }
        // The width from a tenth to nine tenths of the sun, by interpolation between pixels.
        let visible_at = |row: u32| {
            let i = (row * side + side / 2) as usize;
            let linear = |code: f64| {
                let (mut low, mut high) = (0.0, 2.0);
                for _ in 0..40 {
                    let middle = 0.5 * (low + high);
                    if srgb_code(middle) < code { low = middle } else { high = middle }
                }
                low
            };
            let (dark, lit) = (ground_radiance(&sun, 0.0).x, ground_radiance(&sun, 1.0).x);
            (linear(f64::from(frame.rgb[3 * i])) - f64::from(dark)) / f64::from(lit - dark)
        };
        let row_at = |level: f64| {
            let row = (0..side - 1)
                .find(|&row| visible_at(row) >= level && visible_at(row + 1) < level)
                .expect("a crossing");
            f64::from(row) + (visible_at(row) - level) / (visible_at(row) - visible_at(row + 1))
        };
        let metres_per_row = 5.0 * f64::from(width_m) / f64::from(side);
        let measured = (row_at(0.1) - row_at(0.9)) * metres_per_row;
        // Beyond a chord at 0.6870 of the radius lies a tenth of a disc.
        let expected = 0.6870 * f64::from(width_m);
        assert!(
            (measured / expected - 1.0).abs() < 0.15,
            "{distance_m} m: {measured:.4} m wide for {expected:.4}"
        );
        assert!(n > 40, "the edge is in view");
        let mean = sum / f64::from(n);
        assert!(mean < 0.02 && worst < 0.12, "{distance_m} m: mean error {mean:.3}, worst {worst:.3}");
    }
}

#[test]
fn flat_ground_at_grazing_sun_has_no_acne_and_no_leak_under_a_rock() {
    for (elevation_deg, azimuth_deg) in [(1.0, 33.0), (5.0, 0.0), (17.0, 120.0)] {
        let sun = Sun::new(elevation_deg, azimuth_deg, 0.53, Vec3::splat(3.0));
        // A ball sunk to its middle: where it meets the ground on the far side from the sun it is dark.
        let scene = flat_scene(sun, vec![ball(Vec3::ZERO, 1.5)], Vec3::new(0.0, 0.0, 20.0), 16.0);
        let side = 256;
        let frame = render(&scene, side, 4);
        let away = -sun.direction.truncate() / sun.direction.truncate().length();
        let metres_per_px = 2.0 * 20.0 * scene.camera.tan_half_fov / side as f32;
        let (lit, dark) = (ground_radiance(&sun, 1.0).x, ground_radiance(&sun, 0.0).x);
        let (lit, dark) = (srgb_code(f64::from(lit)), srgb_code(f64::from(dark)));
        let (mut lit_count, mut dark_count) = (0, 0);
        for (i, pixel) in frame.rgb.chunks_exact(3).enumerate() {
            if frame.class[i] != ClassId::REGOLITH.0 {
                continue;
            }
            let half = side as f32 / 2.0;
            let p = Vec2::new((i as u32 % side) as f32 + 0.5 - half, half - (i as u32 / side) as f32 - 0.5);
            let p = p * metres_per_px;
            let (along, across) = (p.dot(away), p.perp_dot(away).abs());
            let value = f64::from(pixel[0]);
            if (along < -0.1 || across > 1.7) && p.length() > 1.6 {
                assert!((value - lit).abs() <= 0.6, "{p} m, sun {elevation_deg}: {value} for {lit}");
                lit_count += 1;
            } else if along > 0.0 && across < 1.3 && along < 1.9 && p.length() > 1.52 {
                assert!((value - dark).abs() <= 0.6, "{p} m, sun {elevation_deg}: {value} for {dark}");
                dark_count += 1;
            }
        }
        assert!(lit_count > 5000 && dark_count > 100, "{lit_count} lit, {dark_count} dark");
    }
}

/// The photometric laws of the shader compared with their CPU counterparts, which golden values check: level ground all around
/// the camera, from straight down to grazing, at high and low sun.
#[test]
fn every_photometric_law_equals_its_cpu_counterpart() {
    let mut worst = 0.0_f64;
    for (law, _) in Law::ALL.into_iter().filter(|(law, _)| *law != Law::OrenNayar) {
        for (elevation_deg, pitch_deg) in [(60.0, -80.0), (17.0, -20.0), (5.0, -35.0)] {
            for yaw_deg in [0.0, 100.0, 180.0, 250.0] {
                let sun = Sun::new(elevation_deg, 30.0, 0.0, Vec3::ONE);
                let mut scene = flat_scene(sun, Vec::new(), Vec3::new(0.0, 0.0, 3.0), 60.0);
                scene.photometry.law = law;
                scene.sky.radiance = Vec3::ZERO;
                scene.camera = Camera::new(scene.camera.eye, [pitch_deg, yaw_deg, 0.0], 60.0, 2000.0, 0.0);
                let mut settings = RenderSettings::new([48, 48], 1).expect("settings");
                settings.annotations = [Annotation::Hdr].into_iter().collect();
                let frame = renderer().render(&scene, &settings).expect("a frame").0;
                let focal = scene.camera.focal_px(48) as f32;
                for (pixel, radiance) in frame.radiance.chunks_exact(3).enumerate() {
                    if frame.class[pixel] != ClassId::REGOLITH.0 {
                        continue;
                    }
                    let (x, y) = ((pixel % 48) as f32 - 23.5, (pixel / 48) as f32 - 23.5);
                    let camera = &scene.camera;
                    let ray = (camera.forward + x / focal * camera.right - y / focal * camera.up).normalize();
                    let [mu0, mu, g] = [sun.direction.z, -ray.z, -ray.dot(sun.direction)].map(f64::from);
                    let factor = match law {
                        Law::Lambert => mu0,
                        Law::LommelSeeliger => 2.0 * mu0 / (mu0 + mu),
                        _ => {
                            let soil = scene.photometry.soil;
                            soil.radiance_factor(mu0, mu, g) / soil.radiance_factor(1.0, 1.0, 1.0)
                        }
                    };
                    let expected = 0.2 * factor / std::f64::consts::PI;
                    worst = worst.max((f64::from(radiance[0].to_f32()) / expected - 1.0).abs());
                }
            }
        }
    }
    assert!((1e-6..0.01).contains(&worst), "off by {worst}");
}

/// Hapke's ground over phases from 0 to 90 degrees, viewed from straight above and at 45 degrees; from above, the surge
/// from 5 to 0 degrees (Buratti 1996, Shkuratov 1998: 1.3 to 1.5 for the Moon).
#[test]
fn the_opposition_surge_follows_hapkes_law() {
    let mut worst = 0.0_f64;
    for (pitch_deg, limit_deg) in [(-89.999, 89.0), (-45.0, 90.0)] {
        let measure = |phase_deg: f64| {
            // The sun moves from behind the camera over the zenith.
            let elevation_deg = -pitch_deg + phase_deg;
            let (elevation_deg, azimuth_deg) =
                if elevation_deg <= 90.0 { (elevation_deg, 180.0) } else { (180.0 - elevation_deg, 0.0) };
            let sun = Sun::new(elevation_deg, azimuth_deg, 0.0, Vec3::ONE);
            let mut scene = flat_scene(sun, Vec::new(), Vec3::new(0.0, 0.0, 3.0), 6.0);
            scene.photometry.law = Law::Hapke;
            scene.sky.radiance = Vec3::ZERO;
            scene.camera = Camera::new(scene.camera.eye, [pitch_deg, 0.0, 0.0], 6.0, 2000.0, 0.0);
            let mut settings = RenderSettings::new([33, 33], 1).expect("settings");
            settings.annotations = [Annotation::Hdr].into_iter().collect();
            let frame = renderer().render(&scene, &settings).expect("a frame").0;
            let found = f64::from(frame.radiance[3 * (16 * 33 + 16)].to_f32());
            let [mu0, mu, g] =
                [sun.direction.z, -scene.camera.forward.z, -scene.camera.forward.dot(sun.direction)]
                    .map(f64::from);
            let soil = scene.photometry.soil;
            let factor = soil.radiance_factor(mu0, mu, g) / soil.radiance_factor(1.0, 1.0, 1.0);
            (found, 0.2 * factor / std::f64::consts::PI)
        };
        for phase_deg in [0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0_f64] {
            let (found, expected) = measure(phase_deg.min(limit_deg));
            worst = worst.max((found / expected - 1.0).abs());
        }
        // From above the incidence hardly changes with the phase, so the ratio is the surge.
        if pitch_deg < -89.0 {
            let surge = measure(0.0).0 / measure(5.0).0;
            assert!((1.3..=1.5).contains(&surge), "{surge}");
        }
    }
    assert!((1e-6..0.02).contains(&worst), "off by {worst}");
}

/// A full Earth gives 1.1e-4 of the sun's light: shadows then have at most 4e-4 of the radiance of ground lit by a sun at 17
/// degrees.
#[test]
fn earthshine_lights_the_shadows() {
    let dark_and_lit = |earthshine: &str| {
        let shining = scene(1, &[earthshine, "sky.glow=0", "sun.elevation_deg=17"]);
        let mut scene = flat_scene(
            shining.sun,
            vec![ball(Vec3::new(0.0, 0.0, 3.0), 2.0)],
            Vec3::new(-8.0, 5.0, 30.0),
            50.0,
        );
        scene.sky = shining.sky;
        let mut settings = RenderSettings::new([64, 64], 1).expect("settings");
        settings.annotations = [Annotation::Hdr, Annotation::Shadow].into_iter().collect();
        let frame = renderer().render(&scene, &settings).expect("a frame").0;
        [255, 0].map(|occlusion| {
            let pixels = (0..frame.class.len())
                .filter(|p| frame.class[*p] == ClassId::REGOLITH.0 && frame.sun_occlusion[*p] == occlusion);
            let values: Vec<f64> = pixels.map(|p| f64::from(frame.radiance[3 * p + 1].to_f32())).collect();
            assert!(values.len() > 20, "{} pixels", values.len());
            values.iter().sum::<f64>() / values.len() as f64
        })
    };
    let [dark, lit] = dark_and_lit("sky.earthshine=0");
    // Less than a 255th of the disc may still be visible there.
    assert!(dark < 1e-5 * lit, "{dark}, {lit}");
    let without = dark;
    for share in [1.1e-4, 0.05] {
        let [shadow, still_lit] = dark_and_lit(&format!("sky.earthshine={share}"));
        let dark = shadow - without;
        let expected = share / 17.0_f64.to_radians().sin();
        assert!((dark / lit / expected - 1.0).abs() < 0.01, "{} of lit ground, not {expected}", dark / lit);
        assert!(((still_lit - lit) / dark - 1.0).abs() < 0.05 || share < 1e-3, "lit ground has it too");
        assert!(share > 1e-3 || dark / lit < 4e-4);
    }
}

/// Through a barrel lens every plane is the pinhole image displaced by the distortion formula, so that colour and labels stay
/// aligned.
#[test]
fn a_lens_moves_every_plane_by_the_formula() {
    let annotations = [Annotation::Depth, Annotation::Instances, Annotation::Hdr];
    let take = |scene: &Scene| {
        let mut settings = RenderSettings::new([200, 160], 1).expect("settings");
        settings.annotations = annotations.into_iter().collect();
        renderer().render(scene, &settings).expect("a frame").0
    };
    for stage in ["nominal", "surface"] {
        let stage = format!("stage.name={stage}");
        let plain = scene(12, &[&stage]);
        let bent =
            scene(12, &[&stage, "camera.k1=-0.2", "camera.k2=0.03", "camera.p1=0.01", "camera.p2=-0.008"]);
        let (straight, moved) = (take(&plain), take(&bent));
        assert_eq!(plain.geometry_hash(), bent.geometry_hash());
        let lens = bent.camera.lens;
        let (focal, middle) = (straight.focal_px, [100.0, 80.0]);
        let (mut compared, mut equal, mut furthest) = (0.0, 0.0, 0.0_f64);
        for pixel in 0..200 * 160 {
            let at = [(pixel % 200) as f64 + 0.5, (pixel / 200) as f64 + 0.5];
            let across = [0, 1].map(|axis| (at[axis] - middle[axis]) / focal);
            let point = lens.undistort(across);
            let from = [0, 1].map(|axis| point[axis] * focal + middle[axis]);
            let inside = from[0] >= 1.0 && from[0] < 199.0 && from[1] >= 1.0 && from[1] < 159.0;
            let near_edge = from.iter().any(|value| (value - value.round()).abs() < 0.01);
            if !inside || near_edge {
                continue;
            }
            let source = from[1] as usize * 200 + from[0] as usize;
            compared += 1.0;
            furthest = furthest.max((from[0] - at[0]).hypot(from[1] - at[1]));
            // Depth comes from a point up to half a pixel away.
            let (column, row) = (source % 200, source / 200);
            let around = (row.max(1) - 1..=row + 1)
                .flat_map(|row| (column.max(1) - 1..=column + 1).map(move |c| row * 200 + c));
            let (low, high) = around
                .filter_map(|beside| straight.depth_m.get(beside))
                .fold((f32::INFINITY, 0.0_f32), |(low, high), depth_m| {
                    (low.min(*depth_m), high.max(*depth_m))
                });
            let same = moved.class[pixel] == straight.class[source]
                && moved.instances[pixel] == straight.instances[source]
                && moved.depth_m[pixel] >= low * (1.0 - 1e-3)
                && moved.depth_m[pixel] <= high * (1.0 + 1e-3);
            equal += f64::from(u8::from(same));
        }
        assert!(compared > 20_000.0 && furthest > 5.0, "{compared} pixels, {furthest} px at most");
        // The wider image rounds its vertices to other subpixel positions.
        assert!(equal / compared > 0.998, "{stage}: {equal} of {compared} are the source's");
    }
}

#[test]
fn depth_through_a_lens_is_that_of_the_pixel_centre() {
    let mut scene =
        scene(3, &["terrain.amplitude_m=0", "craters.count=0", "rocks.count=0", "camera.pitch_deg=-30"]);
    scene.camera.lens = Lens { k1: -0.1, k2: 0.02, p1: 0.004, ..Lens::default() };
    let camera = scene.camera;
    for samples in [1, 4, 16] {
        let mut settings = RenderSettings::new([256, 200], samples).expect("settings");
        settings.annotations = [Annotation::Depth].into_iter().collect();
        let frame = renderer().render(&scene, &settings).expect("a frame").0;
        let mut compared = 0;
        for pixel in (0..256 * 200).filter(|pixel| frame.depth_m[*pixel].is_finite()) {
            let at = [(pixel % 256) as f64 + 0.5 - 128.0, (pixel / 256) as f64 + 0.5 - 100.0];
            let [x, y] = camera.lens.undistort(at.map(|value| value / frame.focal_px));
            let fall =
                -(f64::from(camera.forward.z) + x * f64::from(camera.right.z) - y * f64::from(camera.up.z));
            let expected_m = f64::from(camera.eye.z) / fall;
            // Towards the horizon a pixel spans any distance.
            if (0.0..60.0).contains(&expected_m) {
                let off = f64::from(frame.depth_m[pixel]) / expected_m - 1.0;
                assert!(off.abs() < 2e-4, "{samples} samples, pixel {pixel}: {off} of {expected_m} m");
                compared += 1;
            }
        }
        assert!(compared > 30_000, "{compared}");
    }
}

/// The shadow of a wall of height h ends in a penumbra h x 0.0093 / sin^2(elevation) wide on level ground.
#[test]
fn the_penumbra_of_a_wall_has_its_width_at_every_sun_elevation() {
    let wall_m = 4.0_f32;
    for elevation_deg in [5.0_f32, 10.0, 17.0, 30.0] {
        let sun = Sun::new(f64::from(elevation_deg), 90.0, 0.53, Vec3::ONE);
        let wall = |p: Vec2| if (-0.5..=0.0).contains(&p.x) { wall_m } else { 0.0 };
        let width_m = wall_m * 0.53_f32.to_radians() / elevation_deg.to_radians().sin().powi(2);
        let edge_m = -0.4 - wall_m / elevation_deg.to_radians().tan();
        let eye = Vec3::new(edge_m, 0.0, 20.0);
        let fov_deg = 2.0 * f64::from(1.5 * width_m / eye.z).atan().to_degrees();
        let mut scene = flat_scene(sun, Vec::new(), eye, fov_deg);
        scene.terrain = Terrain::from_height(200.0, 1000, Vec::new(), wall).into();
        let mut settings = RenderSettings::new([256, 64], 1).expect("settings");
        settings.annotations = [Annotation::Shadow].into_iter().collect();
        let frame = renderer().render(&scene, &settings).expect("a frame").0;
        // From the right, which is in shadow, to the left: where a tenth and nine tenths of the disc are occluded.
        let occlusion: Vec<f32> =
            (0..256).map(|x| f32::from(frame.sun_occlusion[32 * 256 + x]) / 255.0).collect();
        let crossing = |level: f32| {
            let x =
                (0..255).find(|&x| occlusion[x] <= level && occlusion[x + 1] > level).expect("a crossing");
            x as f32 + (level - occlusion[x]) / (occlusion[x + 1] - occlusion[x])
        };
        let measured_m = (crossing(0.9) - crossing(0.1)) * 3.0 * width_m / 256.0;
        // Of a disc that a straight edge crosses, the middle 80 % of the area take 0.687 of the way.
        let expected_m = 0.687 * width_m;
        assert!(
            (measured_m / expected_m - 1.0).abs() < 0.10,
            "{elevation_deg} degrees: {measured_m} m for {expected_m} m"
        );
    }
}
