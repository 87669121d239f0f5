//! The mask: no pixel without a class, no class that does not exist, and the outline that the colour has.

use glam::Vec3;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::RenderSettings;

use crate::support::{folder, render, renderer, run, run_ok, scene};

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
    std::fs::write(folder.path().join("raw/camera/semantic_segmentation_labels_0000.json"), "{}")
        .expect("written");
    let output = run(folder.path(), &["remap", "raw", "--out", "again"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("it is empty"), "{message}");
    assert!(!folder.path().join("again").exists());
}
