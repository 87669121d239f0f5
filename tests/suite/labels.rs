//! The mask: no pixel without a class, no class that does not exist, and the outline that the colour has.

use glam::Vec3;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::{RasterMode, RenderSettings};

use crate::support::{BACKENDS, folder, render, render_by, renderer, run, run_ok, scene};

fn assert_labelled(seed: u64, set: &[&str], samples: u32) {
    let frame = render(&scene(seed, set), 96, samples);
    let known = |id: &u8| ClassId::ALL.iter().any(|class| class.id.0 == *id);
    assert!(frame.class.iter().all(known), "seed {seed}, {set:?}");
}

#[test]
fn fifty_seeds_have_no_pixel_without_a_class() {
    for seed in 0..50 {
        assert_labelled(seed, &[], if seed % 5 == 0 { 4 } else { 1 });
    }
}

#[test]
fn extreme_knobs_have_no_pixel_without_a_class() {
    let extremes: [&[&str]; 16] = [
        &["sun.elevation_deg=0.5", "sun.azimuth_deg=0"],
        &["sun.elevation_deg=90"],
        &["sun.angular_diameter_deg=0"],
        &["sun.angular_diameter_deg=5", "sun.elevation_deg=3"],
        &["sun.intensity=0"],
        &["camera.fov_deg=150", "camera.roll_deg=45"],
        &["camera.fov_deg=5"],
        &["camera.pitch_deg=89"],
        &["camera.pitch_deg=-89"],
        &["camera.yaw_deg=180"],
        &["camera.x_m=455", "camera.y_m=455", "camera.yaw_deg=45", "camera.pitch_deg=-20"],
        &["camera.height_m=150", "camera.pitch_deg=-30"],
        &["terrain.amplitude_m=50", "camera.height_m=3"],
        &["terrain.size_m=100", "terrain.cells=10", "camera.y_m=-45", "craters.count=40"],
        &["rocks.count=0", "craters.count=0", "sky.star_count=0"],
        &["rocks.count=600", "rocks.displacement=0.8", "sky.dome_radius_m=60", "sky.star_count=2000"],
    ];
    for (seed, set) in (100..).zip(extremes) {
        assert_labelled(seed, set, 1);
        assert_labelled(seed, set, 16);
    }
}

/// An independent check of the mask: repaint the rocks and compare. At one sample per pixel exactly the rock pixels of the mask
/// change.
#[test]
fn repainting_the_rocks_changes_exactly_the_rock_pixels() {
    for seed in [1, 2, 3] {
        let plain = scene(seed, &["sky.star_count=0"]);
        let mut painted = plain.clone();
        for rock in painted.rocks.iter_mut() {
            rock.material.albedo = Vec3::new(0.9, 0.02, 0.9);
        }
        let (before, after) = (render(&plain, 256, 1), render(&painted, 256, 1));
        assert_eq!(before.class, after.class);
        let mut rocks = 0;
        for (pixel, class) in before.class.iter().enumerate() {
            let at = 3 * pixel..3 * pixel + 3;
            let changed = before.rgb[at.clone()] != after.rgb[at];
            assert_eq!(changed, *class == ClassId::ROCK.0, "seed {seed}, pixel {pixel}");
            rocks += u32::from(changed);
        }
        assert!(rocks > 300, "only {rocks} pixels of rock");
    }
}

/// The threshold for small rocks uses the diameter that is reported for each.
#[test]
fn rocks_below_the_minimum_diameter_are_labelled_as_ground() {
    let frame = |set: &[&str]| {
        let mut settings = RenderSettings::new([256; 2], 1).expect("settings");
        settings.annotations = [Annotation::Instances].into_iter().collect();
        renderer().render(&scene(4, set), &settings).expect("a frame").0
    };
    let (all, large) = (frame(&[]), frame(&["label.min_diameter_m=2.5"]));
    let instances = |frame: &Frame| frame.rocks.iter().map(|rock| rock.instance).collect::<Vec<_>>();
    let expected: Vec<u16> =
        all.rocks.iter().filter(|rock| rock.diameter_m >= 2.5).map(|rock| rock.instance).collect();
    assert!(expected.len() > 3 && expected.len() < all.rocks.len());
    assert_eq!(instances(&large), expected);
}

/// Counts the samples again in a frame of twice the size with one sample per pixel, which has the same sample positions.
#[test]
fn the_class_of_a_pixel_is_the_majority_of_its_samples() {
    let scene = scene(9, &[]);
    let full_detail = |side, samples| {
        let settings = RenderSettings::new([side; 2], samples).expect("settings");
        let settings = RenderSettings { outline_error_px: 0.0, ..settings };
        renderer().render(&scene, &settings).expect("a frame").0
    };
    let (samples, pixels) = (full_detail(256, 1), full_detail(128, 4));
    let mut mixed = 0;
    for y in 0..128 {
        for x in 0..128 {
            let votes: Vec<u8> = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .map(|(dx, dy)| samples.class[(2 * y + dy) * 256 + 2 * x + dx])
                .collect();
            let count = |class: u8| votes.iter().filter(|vote| **vote == class).count();
            let max = votes.iter().map(|vote| count(*vote)).max().expect("four votes");
            let winner = pixels.class[y * 128 + x];
            assert_eq!(count(winner), max, "pixel {x}, {y}: {votes:?} gave {winner}");
            // The sky is farthest: it never wins a tie.
            let tied = votes.iter().any(|vote| *vote != winner && count(*vote) == max);
            assert!(!(tied && winner == ClassId::SKY.0), "pixel {x}, {y}: {votes:?}");
            mixed += u32::from(max < 4);
        }
    }
    assert!(mixed > 100, "only {mixed} pixels had mixed votes");
}

#[test]
fn remap_turns_replicator_ids_into_canonical_masks() {
    let folder = folder();
    let frame = ["--size", "96", "--samples", "1", "--outputs", "mask", "-q"];
    run_ok(
        folder.path(),
        &[frame.as_slice(), &["--out", "raw/camera", "--label-ids", "replicator"]].concat(),
    );
    run_ok(folder.path(), &[frame.as_slice(), &["--out", "canonical"]].concat());
    let summary = run_ok(folder.path(), &["remap", "raw", "--out", "remapped", "--json"]);
    let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
    assert_eq!((&summary["masks"], &summary["pixels"]["unlabelled"]), (&1.into(), &0.into()));
    for name in ["semantic_segmentation_0000.png", "semantic_segmentation_labels_0000.json"] {
        let read = |inner: &str| std::fs::read(folder.path().join(inner).join(name)).expect(name);
        assert!(read("remapped/camera") == read("canonical"), "{name}");
    }
    run_ok(folder.path(), &["remap", "raw", "--out", "remapped", "-q"]);
    // Work of the user under the name of a mask or a label file.
    for name in ["semantic_segmentation_0000.png", "semantic_segmentation_labels_0000.json"] {
        let path = folder.path().join("remapped/camera").join(name);
        let whole = std::fs::read(&path).expect(name);
        std::fs::write(&path, "drawn by hand").expect("written");
        let output = run(folder.path(), &["remap", "raw", "--out", "remapped"]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(name) && message.contains("--force to replace it"), "{message}");
        assert_eq!(std::fs::read(&path).expect(name), b"drawn by hand");
        run_ok(folder.path(), &["remap", "raw", "--out", "remapped", "--force", "-q"]);
        assert!(std::fs::read(&path).expect(name) == whole, "{name}");
    }
    std::fs::write(folder.path().join("raw/camera/semantic_segmentation_labels_0000.json"), "{}")
        .expect("written");
    let output = run(folder.path(), &["remap", "raw", "--out", "again"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("it is empty"), "{message}");
    // Of two frames one has lost its mask.
    let lost = folder.path().join("raw/camera/semantic_segmentation_labels_0001.json");
    std::fs::write(lost, r#"{"2": {"class": "sky"}}"#).expect("written");
    let output = run(folder.path(), &["remap", "raw", "--out", "again"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("its mask semantic_segmentation_0001.png is missing"), "{message}");
    assert!(!folder.path().join("again").exists());
}

/// Depth that lies between a crest of the ground and what it hides part of would be a point in mid-air. The samples of a pixel lie where
/// an image twice as large has the centres of its pixels.
#[test]
fn depth_at_a_crest_is_that_of_the_surface_with_most_samples() {
    const SIDE: usize = 256;
    for (stage, backend) in ["nominal", "surface"].into_iter().zip([RasterMode::Compute, RasterMode::Host]) {
        let scene = scene(36, &[&format!("stage.name={stage}")]);
        let take = |side: usize, samples| {
            let mut settings = RenderSettings::new([side as u32; 2], samples).expect("settings");
            settings.annotations = [Annotation::Depth].into_iter().collect();
            render_by(backend, &scene, &settings)
        };
        let (frame, samples) = (take(SIDE, 4), take(2 * SIDE, 1));
        let camera = scene.camera;
        let fall_at = |sample: usize| {
            let [x, y] = [sample % (2 * SIDE), sample / (2 * SIDE)]
                .map(|at| (at as f64 + 0.5 - SIDE as f64) / samples.focal_px);
            y * f64::from(camera.up.z) - x * f64::from(camera.right.z) - f64::from(camera.forward.z)
        };
        let (mut equal, mut compared, mut crests) = (0, 0, [0, 0]);
        for pixel in 0..SIDE * SIDE {
            let first = 4 * SIDE * (pixel / SIDE) + 2 * (pixel % SIDE);
            let all = [0, 1, 2 * SIDE, 2 * SIDE + 1].map(|step| first + step);
            if all.iter().any(|sample| samples.class[*sample] != ClassId::REGOLITH.0) {
                continue;
            }
            let depths_m = all.map(|sample| f64::from(samples.depth_m[sample]));
            let nearest = (0..4).min_by(|a, b| depths_m[*a].total_cmp(&depths_m[*b])).expect("four samples");
            // On a level plane inverse depths are as the falls of the rays.
            let falls = all.map(fall_at);
            let is_in_front = |i: &usize| {
                let of_level =
                    if falls[nearest] > 0.0 { (falls[*i] / falls[nearest]).clamp(0.0, 1.0) } else { 1.0 };
                depths_m[nearest] >= 0.8 * of_level * depths_m[*i]
            };
            let (front, behind): (Vec<usize>, Vec<usize>) = (0..4).partition(is_in_front);
            let most = if front.len() >= behind.len() { &front } else { &behind };
            let expected_m = most.len() as f64 / most.iter().map(|i| 1.0 / depths_m[*i]).sum::<f64>();
            let found_m = f64::from(frame.depth_m[pixel]);
            let is_equal = (found_m / expected_m - 1.0).abs() < 1e-4;
            equal += usize::from(is_equal);
            compared += 1;
            let is_crest = !behind.is_empty();
            crests[usize::from(is_equal)] += usize::from(is_crest);
        }
        // The larger image rounds vertices to other subpixel positions, which moves a few crests past a sample.
        let [wrong, right] = crests;
        assert!(right > 20 && 10 * wrong <= right, "{stage}: {right} crests, {wrong} other ones");
        assert!(1000 * equal > 999 * compared, "{stage}: {equal} of {compared} pixels");
    }
}

/// Ground that faces away from the sun is in shadow, also where only relief below the mesh faces away.
#[test]
fn what_faces_away_from_the_sun_is_in_shadow() {
    for backend in BACKENDS {
        let scene = scene(36, &["stage.name=surface"]);
        let mut settings = RenderSettings::new([128, 128], 1).expect("settings");
        settings.annotations = [Annotation::Angles, Annotation::Shadow].into_iter().collect();
        let frame = render_by(backend, &scene, &settings);
        let is_ground = |pixel: &usize| frame.class[*pixel] == ClassId::REGOLITH.0;
        // Incidence is that of the stored normal, which is rounded.
        let turned: Vec<usize> =
            (0..128 * 128).filter(is_ground).filter(|pixel| frame.incidence_deg[*pixel] > 90.2).collect();
        let lit = turned.iter().filter(|pixel| frame.sun_occlusion[**pixel] != 255).count();
        assert!(turned.len() > 300 && lit == 0, "{backend}: {lit} of {} are lit", turned.len());
    }
}

#[test]
fn remap_says_which_ids_and_colours_have_no_name() {
    let folder = folder();
    let raw = folder.path().join("raw");
    std::fs::create_dir(&raw).expect("made");
    let mask = |number: u32, labels: &str, image: image::DynamicImage| {
        image.save(raw.join(format!("semantic_segmentation_{number:04}.png"))).expect("saved");
        std::fs::write(raw.join(format!("semantic_segmentation_labels_{number:04}.json")), labels)
            .expect("written");
    };
    let ids = r#"{"0": {"class": "BACKGROUND"}, "2": {"class": "sky"}}"#;
    mask(0, ids, image::GrayImage::from_raw(4, 1, vec![0, 2, 3, 1]).expect("a mask").into());
    let ramp: Vec<u16> = (0..40).map(|i| if i < 5 { 2 } else { 1000 - i }).collect();
    let ramp: image::ImageBuffer<image::Luma<u16>, _> =
        image::ImageBuffer::from_raw(40, 1, ramp).expect("a mask");
    mask(1, ids, ramp.into());
    let colours = image::RgbaImage::from_raw(2, 1, vec![9, 9, 9, 255, 1, 2, 3, 4]).expect("a mask");
    mask(2, r#"{"(9, 9, 9, 255)": {"class": "rock"}}"#, colours.into());
    let summary = run_ok(folder.path(), &["remap", "raw", "--out", "remapped", "--json"]);
    let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
    let unnamed = summary["unnamed_ids"].as_array().expect("ids");
    assert_eq!((unnamed.len(), &unnamed[0], &unnamed[36]), (37, &1.into(), &995.into()));
    assert_eq!(summary["unnamed_colours"], serde_json::json!([[1, 2, 3, 4]]));
    let output = run(folder.path(), &["remap", "raw", "--out", "remapped"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("ids without a name, written as 255: 1, 3, 961, 962,"), "{message}");
    assert!(message.contains("978 and 17 more\n"), "{message}");
    assert!(message.contains("colours without a name, written as 255: (1, 2, 3, 4)\n"), "{message}");
}
