//! Same seed and knobs: same bytes, whatever ran before and on however many threads.

use regolith::frame::{Annotation, Frame};
use regolith::render::{InFlight, RenderSettings};

use crate::support::{folder, json, program, render, renderer, run_ok, scene};

#[test]
fn the_program_makes_the_same_bytes_twice() {
    let folder = folder();
    for out in ["a", "b"] {
        run_ok(folder.path(), &["--seed", "5", "--size", "160", "--out", out]);
    }
    let mut compared = 0;
    for entry in std::fs::read_dir(folder.path().join("a")).expect("a folder") {
        let name = entry.expect("an entry").file_name();
        if name.to_string_lossy().starts_with("frame") {
            continue; // it tells how long things took
        }
        let read = |out: &str| std::fs::read(folder.path().join(out).join(&name)).expect("a file");
        assert!(read("a") == read("b"), "{}", name.to_string_lossy());
        compared += 1;
    }
    assert_eq!(compared, 4);
    let meta = |out: &str| {
        let mut meta = json(&folder.path().join(out).join("frame_0000.json"));
        meta.as_object_mut().expect("an object").remove("ms");
        meta
    };
    assert_eq!(meta("a"), meta("b"));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let folder = folder();
    let run = |threads: &str| {
        let status = program(folder.path())
            .args(["--seed", "6", "--size", "96", "--quiet", "--out", threads])
            .env("RAYON_NUM_THREADS", threads)
            .output()
            .expect("the program starts")
            .status;
        assert!(status.success());
        let out = folder.path().join(threads);
        let hash = json(&out.join("frame_0000.json"))["geometry_hash"].clone();
        (hash, std::fs::read(out.join("rgb_0000.png")).expect("a picture"))
    };
    let one = run("1");
    assert_eq!(one, run("2"));
    assert_eq!(one, run("8"));
}

/// The exact geometry of three seeds: it must be the same on every machine and never change within a version.
#[test]
fn geometry_is_the_same_on_every_machine() {
    for (seed, expected) in GEOMETRY_HASHES {
        assert_eq!(scene(seed, &[]).geometry_hash(), expected, "seed {seed}");
    }
}
const GEOMETRY_HASHES: [(u64, &str); 3] = [
    (0, "380b8bffe46eceb408480958e8bedc72"),
    (42, "3f1182441b60215cd2fed80cc86f4ebd"),
    (u64::MAX, "1a933840d0412be8460b18ce9108fece"),
];

#[test]
fn what_was_rendered_before_leaves_no_trace() {
    let (first, other) = (scene(3, &[]), scene(4, &["sun.azimuth_deg=300", "terrain.cells=120"]));
    let alone = render(&first, 128, 4);
    render(&other, 200, 1);
    assert!(alone == render(&first, 128, 4));
}

#[test]
fn frames_in_flight_have_the_bytes_of_frames_one_at_a_time() {
    let scenes = [
        scene(3, &[]),
        scene(4, &["sun.azimuth_deg=300", "terrain.cells=120"]),
        scene(5, &["camera.k1=-0.1", "rocks.count=300"]),
        scene(6, &["stage.name=surface", "sensor.kind=bayer", "terrain.cell_mrad=30"]),
    ];
    let mut settings = RenderSettings::new([160, 112], 4).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Instances, Annotation::Shadow].into_iter().collect();
    let mut renderer = renderer();
    let alone: Vec<Frame> =
        scenes.iter().map(|scene| renderer.render(scene, &settings).expect("a frame").0).collect();
    let flying: Vec<InFlight> =
        scenes.iter().map(|scene| renderer.submit(scene, &settings).expect("submitted")).collect();
    // The last first: each waits for its own.
    for (index, in_flight) in flying.into_iter().enumerate().rev() {
        let frame = renderer.finish(in_flight, &scenes[index]).expect("a frame").0;
        assert!(frame == alone[index], "frame {index}");
    }
}

#[test]
fn leaving_out_what_cannot_be_seen_changes_no_label_and_no_colour() {
    let settings = |side| {
        let mut settings = RenderSettings::new([side, side], 4).expect("settings");
        settings.annotations =
            [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
                .into_iter()
                .collect();
        settings
    };
    for (seed, set) in [
        (1, &[][..]),
        (2, &["sun.elevation_deg=3", "sun.azimuth_deg=10"]),
        (3, &["sun.elevation_deg=2", "sun.azimuth_deg=250", "terrain.amplitude_m=7"]),
        (4, &["camera.height_m=15", "camera.pitch_deg=-35", "sun.elevation_deg=60", "craters.count=30"]),
        (5, &["sun.elevation_deg=1", "sun.angular_diameter_deg=3", "camera.yaw_deg=120"]),
        (6, &["terrain.size_m=200", "terrain.cells=400", "camera.y_m=-60", "rocks.count=300"]),
    ] {
        let scene = scene(seed, set);
        let mut renderer = renderer();
        assert!(renderer.ways.pick_triangles, "the device of the tests is a CPU");
        let picked = renderer.render(&scene, &settings(192)).expect("a frame").0;
        let triangles = renderer.gpu_scene().drawn_triangles();
        renderer.ways.pick_triangles = false;
        let whole = renderer.render(&scene, &settings(192)).expect("a frame").0;
        renderer.ways.pick_triangles = true;
        assert!(renderer.gpu_scene().drawn_triangles() > triangles, "seed {seed}: nothing was left out");
        assert!(picked.class == whole.class && picked.instances == whole.instances, "seed {seed}: labels");
        assert!(picked.depth_m == whole.depth_m && picked.normals == whole.normals, "seed {seed}: geometry");
        assert!(picked.hidden == whole.hidden && picked.rocks == whole.rocks, "seed {seed}: shadows, boxes");
        assert!(picked.rgb == whole.rgb, "seed {seed}: colours");
    }
}

#[test]
fn a_shadow_map_drawn_here_is_that_of_the_device() {
    let mut settings = RenderSettings::new([192, 192], 4).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
            .into_iter()
            .collect();
    let mut renderer = renderer();
    assert!(renderer.ways.own_shadow_map, "the device of the tests is a CPU");
    for (seed, set) in [
        (1, &[][..]),
        (2, &["sun.elevation_deg=3", "sun.azimuth_deg=10"]),
        (5, &["sun.elevation_deg=12", "sun.angular_diameter_deg=3", "camera.yaw_deg=120"]),
        (7, &["rocks.hero_scale_m=4", "rocks.hero_x_m=0", "rocks.hero_y_m=-80"]),
        (8, &["stage.name=surface", "sun.elevation_deg=8"]),
    ] {
        let scene = scene(seed, set);
        let here = renderer.render(&scene, &settings).expect("a frame").0;
        renderer.ways.own_shadow_map = false;
        let there = renderer.render(&scene, &settings).expect("a frame").0;
        renderer.ways.own_shadow_map = true;
        assert!(here.class == there.class && here.instances == there.instances, "seed {seed}: labels");
        assert!(here.depth_m == there.depth_m && here.normals == there.normals, "seed {seed}: geometry");
        let apart = |here: &[u8], there: &[u8]| {
            here.iter().zip(there).filter(|(a, b)| a.abs_diff(**b) > 1).count() as f64 / here.len() as f64
        };
        let (hidden, rgb) = (apart(&here.hidden, &there.hidden), apart(&here.rgb, &there.rgb));
        // Where the places of corners are rounded the other way, a texel of an outline may differ.
        assert!(
            hidden < 1e-3 && rgb < 1e-3,
            "seed {seed}: {hidden} of the shadows, {rgb} of the colours differ"
        );
        assert!(here.hidden.contains(&255), "seed {seed}: there are shadows");
    }
}
