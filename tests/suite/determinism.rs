//! Same seed and knobs: same bytes, whatever ran before and on however many threads.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Mat3;
use regolith::frame::{Annotation, Frame};
use regolith::gpu::Gpu;
use regolith::gpu::staging::PAGE_BYTES;
use regolith::render::select::selection::Selection;
use regolith::render::{InFlight, RasterBackend, RasterOptions, RenderSettings, Renderer};
use regolith::scene::Scene;

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
    for (seed, recorded, of_all_vertices) in GEOMETRY_HASHES {
        let mut scene = scene(seed, &[]);
        assert_eq!(scene.geometry_hash(), recorded, "seed {seed}");
        // Of rocks that are there as they are every vertex counts.
        scene.rocks = scene.rocks.iter().cloned().collect::<Vec<_>>().into();
        assert_eq!(scene.geometry_hash(), of_all_vertices, "seed {seed}");
    }
}
/// Seed, hash as it is recorded, and of all vertices.
const GEOMETRY_HASHES: [(u64, &str, &str); 3] = [
    (0, "c2fdcc0c181e875094a07599d75b82c0", "380b8bffe46eceb408480958e8bedc72"),
    (42, "85977465c646efad1356886a608d52d0", "3f1182441b60215cd2fed80cc86f4ebd"),
    (u64::MAX, "a2a3f26b8686abf66471ba06c2a4c0bf", "1a933840d0412be8460b18ce9108fece"),
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

/// Four samples a pixel, and all that is drawn.
fn all_planes(side: u32) -> RenderSettings {
    let mut settings = RenderSettings::new([side, side], 4).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
            .into_iter()
            .collect();
    settings
}

#[test]
fn telling_apart_what_can_shade_changes_no_label_and_no_colour() {
    let mut renderer = renderer();
    let raster = renderer.raster();
    assert!(raster.bin_by_shadow_sources && raster.visibility == RasterBackend::Host, "a software adapter");
    let mut told_apart = 0;
    for (seed, set) in [
        (1, &[][..]),
        (2, &["sun.elevation_deg=3", "sun.azimuth_deg=10"]),
        (3, &["sun.elevation_deg=2", "sun.azimuth_deg=250", "terrain.amplitude_m=7"]),
        (4, &["camera.height_m=15", "camera.pitch_deg=-35", "sun.elevation_deg=60", "craters.count=30"]),
        (5, &["sun.elevation_deg=1", "sun.angular_diameter_deg=3", "camera.yaw_deg=120"]),
        (6, &["terrain.size_m=200", "terrain.cells=400", "camera.y_m=-60", "rocks.count=300"]),
        (7, &["stage.name=surface", "sun.elevation_deg=8"]),
    ] {
        let scene = scene(seed, set);
        renderer.set_raster(RasterOptions { bin_by_shadow_sources: false, ..raster });
        let alike = renderer.render(&scene, &all_planes(192)).expect("a frame").0;
        let groups = renderer.last_cost().lighting_draws;
        renderer.set_raster(raster);
        let apart = renderer.render(&scene, &all_planes(192)).expect("a frame").0;
        told_apart += renderer.last_cost().lighting_draws - groups;
        assert!(apart.class == alike.class && apart.instances == alike.instances, "seed {seed}: labels");
        assert!(apart.depth_m == alike.depth_m && apart.normals == alike.normals, "seed {seed}: geometry");
        assert!(
            apart.sun_occlusion == alike.sun_occlusion && apart.rocks == alike.rocks,
            "seed {seed}: shadows, boxes"
        );
        assert!(apart.rgb == alike.rgb, "seed {seed}: colours");
    }
    assert!(told_apart >= 10, "only {told_apart} groups more");
}

/// On a device that draws what is seen itself.
#[test]
fn draws_in_one_command_or_one_by_one_change_no_plane() {
    let mut renderer = renderer();
    let own = renderer.raster();
    assert!(own.multi_draw, "the device of the tests takes many draws at once");
    for (seed, set) in [(1, &[][..]), (7, &["stage.name=surface"]), (9, &["camera.pitch_deg=60"])] {
        let scene = scene(seed, set);
        let mut frame = |multi_draw| {
            renderer.set_raster(RasterOptions { multi_draw, ..on_device(own) });
            renderer.render(&scene, &all_planes(192)).expect("a frame").0
        };
        let (at_once, one_by_one) = (frame(true), frame(false));
        assert!(
            at_once.class == one_by_one.class && at_once.rocks == one_by_one.rocks,
            "seed {seed}: labels"
        );
        assert!(
            at_once.depth_m == one_by_one.depth_m && at_once.normals == one_by_one.normals,
            "seed {seed}"
        );
        assert!(
            at_once.sun_occlusion == one_by_one.sun_occlusion && at_once.rgb == one_by_one.rgb,
            "seed {seed}: colours"
        );
    }
    renderer.set_raster(own);
}

/// The first waits for the fewest programs.
#[test]
fn a_first_frame_is_lit_by_fewer_programs_and_is_the_same() {
    let gpu = Gpu::open(Some("cpu")).expect("a device");
    let mut renderer = Renderer::new(gpu).expect("a renderer");
    let scene = scene(4, &["sun.elevation_deg=12"]);
    let mut frame = || {
        let frame = renderer.render(&scene, &all_planes(128)).expect("a frame").0;
        (frame, renderer.last_cost().lighting_draws)
    };
    let ((first, few), (second, more)) = (frame(), frame());
    // A device that draws what is seen tells nothing apart.
    let told_apart = few < more || renderer.raster().visibility == RasterBackend::Device;
    assert!(told_apart, "{few} groups, then {more}");
    assert!(first.class == second.class && first.instances == second.instances, "labels");
    assert!(first.sun_occlusion == second.sun_occlusion && first.rgb == second.rgb, "shadows, colours");
}

/// Where the sun stands still and the camera moves, tiles of the shadow map are kept, the horizon map of all of the ground, and
/// the meshes of a device that draws them.
#[test]
fn a_frame_is_the_same_whatever_was_drawn_before_it() {
    let mut renderer = renderer();
    let own = renderer.raster();
    for raster in [own, on_device(own)] {
        renderer.set_raster(raster);
        frames_are_the_same_whatever_was_drawn_before_them(&mut renderer);
    }
    renderer.set_raster(own);
}

fn frames_are_the_same_whatever_was_drawn_before_them(renderer: &mut Renderer) {
    let (mut settings, other) = (all_planes(192), scene(3, &[]));
    settings.annotations = settings.annotations.with(Annotation::Hdr);
    for (seed, set) in [
        (1, &[][..]),
        (2, &["sun.elevation_deg=3", "sun.azimuth_deg=10"]),
        (5, &["sun.elevation_deg=1", "sun.angular_diameter_deg=3", "camera.yaw_deg=120"]),
        (7, &["stage.name=surface", "sun.elevation_deg=8"]),
    ] {
        let mut moving = scene(seed, set);
        let mut in_a_row: Vec<(Scene, Frame)> = Vec::new();
        let mut given_bytes = Vec::new();
        let mut meshes: Vec<BTreeMap<_, usize>> = Vec::new();
        for _ in 0..3 {
            let frame = renderer.render(&moving, &settings).expect("a frame").0;
            in_a_row.push((moving.clone(), frame));
            given_bytes.push(renderer.last_cost().uploaded_bytes);
            let drawn = Selection::new(&moving, &settings).rocks;
            let meshes_of = drawn.iter().map(|drawn| &moving.rocks[drawn.rock].vertices);
            meshes.push(meshes_of.map(|mesh| (Arc::as_ptr(mesh), mesh.len())).collect());
            moving.camera.eye.x += 0.4;
        }
        // All vertices of the first frame, of 16 bytes each, but for those that are new in the third, which come in whole pages.
        let is_new = |mesh: &&_| !meshes[0].contains_key(*mesh) && !meshes[1].contains_key(*mesh);
        let new: usize = meshes[2].keys().filter(is_new).map(|mesh| meshes[2][mesh]).sum();
        let vertices = moving.terrain.vertices.len() + meshes[0].values().sum::<usize>() - new;
        let page = if new > 0 { PAGE_BYTES as u64 } else { 0 };
        let given_less = given_bytes[2] + 16 * vertices as u64 <= given_bytes[0] + page;
        let is_host = renderer.raster().visibility == RasterBackend::Host;
        assert!(is_host || given_less, "seed {seed}: {given_bytes:?} bytes");
        // The device has the ground, but not all rocks that it now is to draw.
        let built = moving.rocks.built().count();
        for axis in [&mut moving.camera.forward, &mut moving.camera.right, &mut moving.camera.up] {
            *axis = Mat3::from_rotation_z(0.8) * *axis;
        }
        let turned = renderer.render(&moving, &settings).expect("a frame").0;
        let is_on_demand = moving.rocks.built().count() > built;
        assert!(is_on_demand || set.contains(&"stage.name=surface"), "seed {seed}: {built} rocks");
        in_a_row.push((moving, turned));
        for (step, (scene, kept)) in in_a_row.iter().enumerate() {
            renderer.render(&other, &settings).expect("a frame");
            let alone = renderer.render(scene, &settings).expect("a frame").0;
            assert!(
                alone.class == kept.class && alone.instances == kept.instances,
                "seed {seed}, {step}: labels"
            );
            assert!(
                alone.depth_m == kept.depth_m && alone.normals == kept.normals,
                "seed {seed}, {step}: geometry"
            );
            assert!(alone.sun_occlusion == kept.sun_occlusion, "seed {seed}, {step}: shadows");
            assert!(alone.radiance == kept.radiance && alone.rgb == kept.rgb, "seed {seed}, {step}: colours");
        }
    }
}

/// What samples show is given to the device in parts where it is much, here two.
#[test]
fn a_large_picture_drawn_here_has_the_labels_that_the_device_draws() {
    let (scene, settings) = (scene(11, &[]), RenderSettings::new([1024, 1024], 4).expect("settings"));
    let mut renderer = renderer();
    let raster = renderer.raster();
    let here = renderer.render(&scene, &settings).expect("a frame").0;
    renderer.set_raster(RasterOptions { visibility: RasterBackend::Device, ..raster });
    let there = renderer.render(&scene, &settings).expect("a frame").0;
    renderer.set_raster(raster);
    let labels = share(&here.class, &there.class, |a, b| a != b);
    assert!(labels < 1e-5, "{labels} of the labels differ");
}

#[test]
fn what_is_drawn_here_is_what_the_device_draws() {
    let mut renderer = renderer();
    let raster = renderer.raster();
    assert_eq!(
        (raster.visibility, raster.shadow),
        (RasterBackend::Host, RasterBackend::Host),
        "a software adapter"
    );
    for (seed, set) in [
        (1, &[][..]),
        (2, &["sun.elevation_deg=3", "sun.azimuth_deg=10"]),
        (4, &["camera.height_m=15", "camera.pitch_deg=-35", "sun.elevation_deg=60", "craters.count=30"]),
        (5, &["sun.elevation_deg=12", "sun.angular_diameter_deg=3", "camera.yaw_deg=120"]),
        (6, &["camera.height_m=0.4", "camera.pitch_deg=-60", "camera.fov_deg=110"]),
        (7, &["rocks.hero_scale_m=4", "rocks.hero_x_m=0", "rocks.hero_y_m=-80"]),
        (8, &["stage.name=surface", "sun.elevation_deg=8"]),
        (9, &["camera.pitch_deg=60", "sky.star_count=3000"]),
    ] {
        let scene = scene(seed, set);
        let settings = all_planes(192);
        let here = renderer.render(&scene, &settings).expect("a frame").0;
        renderer.set_raster(on_device(raster));
        let there = renderer.render(&scene, &settings).expect("a frame").0;
        for (shadow, visibility) in
            [(RasterBackend::Host, RasterBackend::Device), (RasterBackend::Device, RasterBackend::Host)]
        {
            renderer.set_raster(RasterOptions { visibility, shadow, ..raster });
            let mixed = renderer.render(&scene, &settings).expect("a frame").0;
            let alike = if visibility == RasterBackend::Host { &here } else { &there };
            assert!(
                mixed.class == alike.class && mixed.depth_m == alike.depth_m,
                "seed {seed}: a backend of each"
            );
        }
        renderer.set_raster(raster);
        // Where the places of corners are rounded the other way, a sample of an outline or a texel of a shadow may differ, and
        // with it all that is reckoned of it.
        let labels = share(&here.class, &there.class, |a, b| a != b)
            + share(&here.instances, &there.instances, |a, b| a != b);
        let depth = share(&here.depth_m, &there.depth_m, |a, b| (a - b).abs() > 1e-3 * a);
        let normals = share(&here.normals, &there.normals, |a, b| (a - b).abs() > 1e-2);
        let hidden = share(&here.sun_occlusion, &there.sun_occlusion, |a, b| a.abs_diff(b) > 2);
        let rgb = share(&here.rgb, &there.rgb, |a, b| a.abs_diff(b) > 2);
        assert!(labels < 1e-4, "seed {seed}: {labels} of the labels differ");
        assert!(
            depth < 1e-4 && normals < 1e-4,
            "seed {seed}: {depth} of depths, {normals} of normals differ"
        );
        assert!(hidden < 5e-4 && rgb < 5e-4, "seed {seed}: {hidden} of shadows, {rgb} of colours differ");
    }
}

/// The same options with the device as every stage's backend.
const fn on_device(raster: RasterOptions) -> RasterOptions {
    RasterOptions { visibility: RasterBackend::Device, shadow: RasterBackend::Device, ..raster }
}

/// Of how many of two lists' pairs something holds.
fn share<T: Copy>(here: &[T], there: &[T], holds: impl Fn(T, T) -> bool) -> f64 {
    here.iter().zip(there).filter(|(a, b)| holds(**a, **b)).count() as f64 / here.len() as f64
}
