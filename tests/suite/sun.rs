//! The sun in the image: its disc at its radiance and size, the share that terrain hides, and what a lens makes of it.

use std::sync::Arc;

use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::post::sun_glare::SunGlare;
use regolith::render::{RasterMode, RenderSettings};
use regolith::scene::Scene;
use regolith::scene::sky::MAX_STORED_RADIANCE;
use regolith::scene::terrain::Terrain;

use crate::support::{BACKENDS, render, render_by, scene};

const SIDE: u32 = 192;
/// A narrow lens, in which the disc covers some 20 pixels.
const FOV_DEG: f64 = 20.0;
/// Elevation of the sun, and of the optical axis unless a case rotates it.
const ELEVATION_DEG: f64 = 20.0;

/// The nominal stage with the sun ahead and an empty sky; the camera looks at the sun, then is rotated by these angles.
fn sun_ahead(pitch_deg: f64, yaw_deg: f64, set: &[&str]) -> Scene {
    let pitch = format!("camera.pitch_deg={}", ELEVATION_DEG + pitch_deg);
    let yaw = format!("camera.yaw_deg={yaw_deg}");
    let elevation = format!("sun.elevation_deg={ELEVATION_DEG}");
    let fov = format!("camera.fov_deg={FOV_DEG}");
    let base = ["sun.azimuth_deg=0", "sky.star_count=0", &pitch, &yaw, &elevation, &fov];
    scene(5, &[&base, set].concat())
}

/// The same with a level ridge across the view whose crest runs through the middle of the disc.
fn behind_a_ridge(set: &[&str]) -> Scene {
    const CREST_Y_M: f32 = 40.0;
    let mut scene = sun_ahead(0.0, 0.0, set);
    let eye = scene.camera.eye;
    let rise = scene.sun.direction.z / scene.sun.direction.truncate().length();
    let crest_m = eye.z + rise * (CREST_Y_M - eye.y);
    let low_m = eye.z - 2.0;
    let height = |p: glam::Vec2| if p.y < CREST_Y_M - 0.1 { low_m } else { crest_m };
    scene.terrain = Arc::new(Terrain::from_height(400.0, 100, Vec::new(), height));
    scene.rocks = Vec::new().into();
    scene
}

fn settings() -> RenderSettings {
    let mut settings = RenderSettings::new([SIDE; 2], 16).expect("settings");
    settings.annotations = settings.annotations.with(Annotation::Hdr);
    settings
}

/// Pixels that the disc covers, its parts of pixels included.
fn disc_area_px(frame: &Frame) -> f64 {
    let red = frame.radiance.iter().step_by(3).map(|value| value.to_f64());
    red.map(|value| value / f64::from(MAX_STORED_RADIANCE)).filter(|part| *part > 0.01).sum()
}

/// Pixels that a disc of 0.53 degrees covers at this angle from the axis: a solid angle of f^-2 cos^3 a pixel.
fn expected_area_px(scene: &Scene) -> f64 {
    let cosine = f64::from(scene.camera.forward.dot(scene.sun.direction));
    let focal_px = scene.camera.focal_px(SIDE);
    scene.sun.solid_angle() * focal_px * focal_px / cosine.powi(3)
}

/// The irradiance at the lens that [`SunGlare`] puts into the image: of the disc alone, and of all scattered light.
fn light_in_image(scene: &Scene, frame: &Frame, scattered: f64) -> Vec<f32> {
    let mut frame = frame.clone();
    let pixels = (SIDE * SIDE) as usize;
    let mut channels = vec![vec![0.0_f32; pixels]];
    if let Some(glare) = SunGlare::take(&mut frame, scene) {
        assert_eq!(disc_area_px(&frame), 0.0, "the disc is taken out");
        glare.add_stray_light(&mut channels, |_, rgb| rgb.x, scattered);
        glare.add_disc(&mut channels, |_, rgb| rgb.x, (1.0, &vec![1.0; pixels]), (0.47, scattered));
    }
    channels.remove(0)
}

/// Solid angle of a pixel, steradians.
fn pixel_solid_angle(scene: &Scene, pixel: usize) -> f64 {
    let focal_px = scene.camera.focal_px(SIDE);
    let side = SIDE as usize;
    let [x, y] = [pixel % side, pixel / side].map(|at| (at as f64 + 0.5 - 0.5 * side as f64) / focal_px);
    (1.0 + x * x + y * y).powf(-1.5) / (focal_px * focal_px)
}

fn irradiance(scene: &Scene, light: &[f32]) -> f64 {
    (0..light.len()).map(|pixel| f64::from(light[pixel]) * pixel_solid_angle(scene, pixel)).sum()
}

#[test]
fn the_disc_is_drawn_with_its_size_its_radiance_and_the_class_sky() {
    // In the centre, at the edge, in a corner; half beyond the edge; and behind a ridge.
    let cases = [
        ("centre", sun_ahead(0.0, 0.0, &[]), 1.0),
        ("edge", sun_ahead(0.0, 9.5, &[]), 1.0),
        ("corner", sun_ahead(-9.2, -9.0, &[]), 1.0),
        ("half beyond the edge", sun_ahead(-10.0, 0.0, &[]), 0.5),
        ("half behind a ridge", behind_a_ridge(&[]), 0.5),
    ];
    for backend in BACKENDS {
        for (name, scene, share) in &cases {
            let frame = render_by(backend, scene, &settings());
            let (area, expected) = (disc_area_px(&frame), share * expected_area_px(scene));
            assert!((area / expected - 1.0).abs() < 0.04, "{name}, {backend}: {area} px, not {expected}");
            let brightest = frame.radiance.iter().map(|value| value.to_f32()).fold(0.0, f32::max);
            assert_eq!(brightest, MAX_STORED_RADIANCE, "{name}, {backend}");
            assert_eq!(frame.count(ClassId::UNLABELLED), 0);
            for (pixel, rgb) in frame.radiance.chunks_exact(3).enumerate() {
                if rgb[0].to_f32() > 0.6 * MAX_STORED_RADIANCE {
                    assert_eq!(frame.class[pixel], ClassId::SKY.0, "{name}, {backend}");
                    assert!(frame.rgb[3 * pixel] >= 248, "{name}, {backend}: white");
                }
            }
        }
        let hidden = sun_ahead(-20.0, 0.0, &[]);
        let frame = render_by(backend, &hidden, &settings());
        assert_eq!(disc_area_px(&frame), 0.0, "outside of the image");
    }
}

/// A disc below the largest half-precision number has its exact radiance.
#[test]
fn a_dim_disc_has_the_radiance_of_its_irradiance() {
    // So wide that the darkening within a pixel in its centre is negligible.
    let scene = sun_ahead(0.0, 0.0, &["sun.intensity=50000", "sun.angular_diameter_deg=4"]);
    let frame = render_by(RasterMode::Host, &scene, &settings());
    // In its centre: the limb is darker, and the mean is the irradiance over the solid angle.
    let expected = f64::from(scene.sun.radiance_at(1.0).x);
    let light: f64 = (0..(SIDE * SIDE) as usize)
        .map(|pixel| frame.radiance[3 * pixel].to_f64() * pixel_solid_angle(&scene, pixel))
        .sum();
    let irradiance = f64::from(scene.sun.irradiance.x);
    assert!((light / irradiance - 1.0).abs() < 0.02, "{light}, not {irradiance}");
    let brightest = frame.radiance.iter().map(|value| value.to_f64()).fold(0.0, f64::max);
    assert!((brightest / expected - 1.0).abs() < 1e-3, "{brightest}, not {expected}");
}

/// The light of the disc in the image is the irradiance of what is not hidden; what is scattered is the same part of it at every
/// distance, as the scatter model has it.
#[test]
fn the_light_that_reaches_the_sensor_is_that_of_the_visible_part() {
    let cases = [
        ("centre", sun_ahead(0.0, 0.0, &[]), 1.0),
        ("edge", sun_ahead(0.0, 9.5, &[]), 1.0),
        ("corner", sun_ahead(-9.2, -9.0, &[]), 1.0),
        ("half behind a ridge", behind_a_ridge(&[]), 0.5),
    ];
    const SCATTERED: f64 = 0.02;
    for (name, scene, share) in &cases {
        let frame = render_by(RasterMode::Host, scene, &settings());
        let of_sun = f64::from(scene.sun.irradiance.x);
        let disc = irradiance(scene, &light_in_image(scene, &frame, 0.0)) / of_sun;
        assert!((disc / share - 1.0).abs() < 0.04, "{name}: {disc} of the sun's light");
        let light = light_in_image(scene, &frame, SCATTERED);
        // At 5 degrees from the sun, and everywhere as far.
        let chord = 2.0 * (2.5_f64.to_radians()).sin();
        let density = SCATTERED / (std::f64::consts::PI * (1.0_f64 + 4e4).ln()) / (1e-4 + chord * chord);
        let rays = (0..light.len()).map(|pixel| (pixel, ray(scene, pixel)));
        let near: Vec<usize> = rays
            .filter(|(_, ray)| (f64::from(ray.distance(scene.sun.direction)) - chord).abs() < 5e-4)
            .map(|(pixel, _)| pixel)
            .collect();
        assert!(near.len() > 20, "{name}");
        let mean = near.iter().map(|pixel| f64::from(light[*pixel])).sum::<f64>() / near.len() as f64;
        let expected = share * of_sun * density;
        assert!((mean / expected - 1.0).abs() < 0.02, "{name}: veil {mean}, not {expected}");
    }
    // Within 9 degrees of the sun: ln(1 + c^2 / B) / ln(1 + 4 / B) of the scattered light, and the rest of the sun's.
    let (_, scene, _) = &cases[0];
    let frame = render_by(RasterMode::Host, scene, &settings());
    let light = light_in_image(scene, &frame, SCATTERED);
    let chord = 2.0 * (4.5_f64.to_radians()).sin();
    let within = (0..light.len())
        .filter(|pixel| f64::from(ray(scene, *pixel).distance(scene.sun.direction)) < chord)
        .map(|pixel| f64::from(light[pixel]) * pixel_solid_angle(scene, pixel))
        .sum::<f64>()
        / f64::from(scene.sun.irradiance.x);
    let expected = 1.0 - SCATTERED * (1.0 - (1.0 + 1e4 * chord * chord).ln() / (1.0_f64 + 4e4).ln());
    assert!((within - expected).abs() < 0.02, "{within}, not {expected}");
}

/// Unit vector along which a pixel looks.
fn ray(scene: &Scene, pixel: usize) -> glam::Vec3 {
    let camera = &scene.camera;
    let focal_px = camera.focal_px(SIDE) as f32;
    let (side, pixel) = (SIDE as usize, pixel);
    let [x, y] = [pixel % side, pixel / side].map(|at| (at as f32 + 0.5 - 0.5 * side as f32) / focal_px);
    (camera.forward + x * camera.right - y * camera.up).normalize()
}

#[test]
fn a_sun_beside_the_image_veils_it_less_and_less() {
    let veil = |above_deg: f64| {
        let scene = sun_ahead(-above_deg, 0.0, &[]);
        let frame = render_by(RasterMode::Host, &scene, &settings());
        let light = light_in_image(&scene, &frame, 0.02);
        let middle = (SIDE * SIDE / 2 + SIDE / 2) as usize;
        f64::from(light[middle]) / f64::from(scene.sun.irradiance.x)
    };
    // 1, 5 and 15 degrees above the image: the scatter model, times the part of the lens that the hood leaves in the sun.
    for above_deg in [11.0, 15.0, 25.0] {
        let lit = 1.0 - (above_deg - 10.0_f64).to_radians() / 0.35;
        let chord = 2.0 * (0.5 * above_deg.to_radians()).sin();
        let density = 0.02 / (std::f64::consts::PI * (1.0_f64 + 4e4).ln()) / (1e-4 + chord * chord);
        let found = veil(above_deg);
        assert!((found / (lit * density) - 1.0).abs() < 0.03, "{above_deg}: {found}, not {}", lit * density);
    }
    assert_eq!(veil(32.0), 0.0, "the hood shades the lens");
}

const SENSOR: [&str; 4] =
    ["sensor.kind=mono", "sensor.read_noise_e=0", "sensor.glare=0.01", "sensor.ground_level=0.4"];

/// A bright, clipped patch around the sun that falls off outwards, wider than the disc; no dark ring; ground as bright as without.
#[test]
fn a_sensor_shows_the_sun_clipped_in_its_bloom() {
    for backend in BACKENDS {
        let wide = ["camera.fov_deg=60", "camera.pitch_deg=0", "sensor.psf_px=0.47"];
        let scene = sun_ahead(0.0, 0.0, &[&SENSOR[..], &wide].concat());
        let mut settings = RenderSettings::new([SIDE; 2], 4).expect("settings");
        let frame = render_by(backend, &scene, &settings);
        let side = SIDE as usize;
        let focal_px = scene.camera.focal_px(SIDE);
        let row = (0.5 * f64::from(SIDE) - focal_px * ELEVATION_DEG.to_radians().tan()) as usize;
        let value = |x: usize| frame.rgb[3 * (row * side + x)];
        assert_eq!(value(side / 2), 255);
        let falling: Vec<u8> = (side / 2..side).map(value).collect();
        let clipped = falling.iter().take_while(|value| **value == 255).count();
        assert!(clipped as f64 > 2.0 * focal_px * 0.265_f64.to_radians(), "{backend}: bloom {clipped}");
        assert!(clipped < side / 4, "{backend}: {clipped} of {side} are white");
        for pair in falling.windows(6) {
            assert!(pair[5] <= pair[0].saturating_add(6), "{backend}: a ring, {falling:?}");
        }
        assert!(value(side - 1) > 2, "{backend}: the veil reaches the border");
        settings.annotations = settings.annotations.with(Annotation::Hdr);
        let with_radiance = render_by(backend, &scene, &settings);
        let brightest = with_radiance.radiance.iter().map(|v| v.to_f32()).fold(0.0, f32::max);
        assert_eq!(brightest, MAX_STORED_RADIANCE, "{backend}: radiance is that of the scene");
        assert_eq!(with_radiance.rgb, frame.rgb);
    }
    let of = |glare: &str, diameter: &str| {
        let set = [&SENSOR[..], &["camera.fov_deg=60", "camera.pitch_deg=0", glare, diameter]].concat();
        render(&sun_ahead(0.0, 0.0, &set), SIDE, 4)
    };
    let (with, without) = (
        of("sensor.glare=0", "sun.angular_diameter_deg=0.53"),
        of("sensor.glare=0", "sun.angular_diameter_deg=0"),
    );
    let ground = |frame: &Frame| {
        let lit = frame.rgb.chunks_exact(3).zip(&frame.class).filter(|(_, class)| **class == 0);
        let values: Vec<f64> = lit.map(|(rgb, _)| f64::from(rgb[0])).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    let (with, without) = (ground(&with), ground(&without));
    assert!((with / without - 1.0).abs() < 0.03, "the sun is not metered: ground {with}, without {without}");
}

/// Six ghosts on the line through the sun and the centre of the image, stronger with the reflectance, none at 0.
#[test]
fn ghosts_lie_on_the_line_through_the_sun_and_the_centre() {
    let light = |flare: &str| {
        let scene = sun_ahead(-5.0, 4.0, &["camera.fov_deg=60", "sensor.kind=mono", flare]);
        let frame = render_by(RasterMode::Host, &scene, &settings());
        (light_in_image(&scene, &frame, 0.0), scene)
    };
    let (without, _) = light("sensor.flare=0");
    let (with, scene) = light("sensor.flare=0.05");
    let ghosts: Vec<f64> = with.iter().zip(&without).map(|(a, b)| f64::from(a - b)).collect();
    let all: f64 = ghosts.iter().enumerate().map(|(pixel, l)| l * pixel_solid_angle(&scene, pixel)).sum();
    let share = all / f64::from(scene.sun.irradiance.x);
    let expected = 6.0 * 0.05_f64.powi(2);
    assert!(share > 0.5 * expected && share < 1.6 * expected, "{share} of the light, not {expected}");
    let camera = &scene.camera;
    let sun = scene.sun.direction / scene.sun.direction.dot(camera.forward);
    let axis = glam::Vec2::new(sun.dot(camera.right), -sun.dot(camera.up)).normalize();
    for (pixel, light) in ghosts.iter().enumerate() {
        let ray = ray(&scene, pixel);
        let point = glam::Vec2::new(ray.dot(camera.right), -ray.dot(camera.up)) / ray.dot(camera.forward);
        assert!(*light < 1e-4 || axis.perp_dot(point).abs() < 0.125, "a ghost at {point}");
    }
}

/// With a lens that distorts, disc and bloom are where the lens images the sun.
#[test]
fn disc_and_bloom_follow_the_distortion_of_the_lens() {
    let scene = sun_ahead(-12.0, 14.0, &["camera.fov_deg=60", "camera.k1=-0.2", "sensor.kind=mono"]);
    let frame = render_by(RasterMode::Host, &Scene { sensor: None, ..scene.clone() }, &settings());
    let camera = &scene.camera;
    let sun = scene.sun.direction / scene.sun.direction.dot(camera.forward);
    let at = camera.lens.distort([sun.dot(camera.right), -sun.dot(camera.up)].map(f64::from));
    let expected = at.map(|x| x * camera.focal_px(SIDE) + 0.5 * f64::from(SIDE));
    let light = light_in_image(&scene, &frame, 0.02);
    let brightest = (0..light.len()).max_by(|a, b| light[*a].total_cmp(&light[*b])).expect("pixels");
    let found = [brightest % SIDE as usize, brightest / SIDE as usize].map(|px| px as f64 + 0.5);
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1.5, "{found}, not {expected}");
    }
}
