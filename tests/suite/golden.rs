//! Frames compared with golden images, on the CPU driver: colour by similarity, masks exactly.

use std::path::Path;

use image::{GrayImage, RgbImage};

use crate::support::compare::{assert_image, assert_mask, golden};
use crate::support::{folder, json, render, run_ok, scene};

fn check(name: &str, seed: u64, set: &[&str]) {
    let side = 192;
    let frame = render(&scene(seed, set), side, 4);
    let image = RgbImage::from_raw(side, side, frame.rgb).expect("planes of the image's size");
    let mask = GrayImage::from_raw(side, side, frame.class).expect("planes of the image's size");
    assert_image(&golden(&format!("{name}.png")), &image, true);
    assert_mask(&format!("{name}_mask.png"), &mask);
}

#[test]
fn nominal_42() {
    check("nominal_42", 42, &[]);
}

#[test]
fn sun_in_front_7() {
    check("sun_in_front_7", 7, &["sun.azimuth_deg=5", "sun.elevation_deg=9", "camera.exposure_ev=0.5"]);
}

#[test]
fn high_view_1001() {
    check("high_view_1001", 1001, &["camera.height_m=12", "camera.pitch_deg=-14", "craters.count=12"]);
}

#[test]
fn surface_4() {
    check("surface_4", 4, &["stage.name=surface"]);
}

#[test]
fn surface_sensor_15() {
    let set = [
        "stage.name=surface",
        "sensor.kind=bayer",
        "sensor.ground_level=0.45",
        "sun.azimuth_deg=70",
        "camera.roll_deg=4",
    ];
    check("surface_sensor_15", 15, &set);
}

/// The image at the top of the README is the output of the command below it, with the coverage and brightness of the
/// reference.
#[test]
fn the_readme_image_is_the_output_of_its_command_and_matches_the_reference() {
    let folder = folder();
    run_ok(folder.path(), &["--preset", "reference", "--out", "out"]);
    let image = image::open(folder.path().join("out/rgb_0000.png")).expect("an image").into_rgb8();
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/reference_42.png");
    assert_image(&readme, &image, false);
    let meta = json(&folder.path().join("out/frame_0000.json"));
    for (class, expected) in [("regolith", 0.37), ("rock", 0.22), ("sky", 0.41)] {
        let covered = meta["coverage"][class].as_f64().expect("a fraction");
        assert!((covered - expected).abs() <= 0.02, "{class} covers {covered}");
    }
    assert_eq!(meta["coverage"]["unlabelled"], 0.0);
    for (statistic, expected) in [("mean", 103.0), ("p99", 240.0), ("max", 249.0)] {
        let value = meta["rgb"][statistic].as_f64().expect("a number");
        assert!((value - expected).abs() <= 4.0, "{statistic} is {value}");
    }
}
