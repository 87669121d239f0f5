//! Same seed and knobs give the same bytes, independent of earlier frames, threads and the order of rendering.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Mat3;
use regolith::frame::{Annotation, Frame};
use regolith::gpu::Gpu;
use regolith::gpu::staging::PAGE_BYTES;
use regolith::render::select::selection::{SelectedRock, Selection};
use regolith::render::{
    InFlight, RasterBackend, RasterMode, RasterOptions, RenderSettings, Renderer, Staging,
};
use regolith::scene::Scene;
use regolith::scene::mesh::Icosphere;
use regolith::scene::sky::Sun;

use crate::support::{adapter, folder, json, program, render, renderer, renderer_by, run_ok, scene};

#[test]
fn two_runs_write_the_same_bytes() {
    let folder = folder();
    for out in ["a", "b"] {
        run_ok(folder.path(), &["--seed", "5", "--size", "160", "--out", out]);
    }
    let mut compared = 0;
    for entry in std::fs::read_dir(folder.path().join("a")).expect("a folder") {
        let name = entry.expect("an entry").file_name();
        if name.to_string_lossy().starts_with("frame") {
            continue; // it contains times
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
    let run = |stage: &str, threads: &str| {
        let out = format!("{stage}_{threads}");
        let status = program(folder.path())
            .args(["--seed", "6", "--size", "96", "--stage", stage, "--quiet", "--out", &out])
            .env("RAYON_NUM_THREADS", threads)
            .output()
            .expect("the program starts")
            .status;
        assert!(status.success());
        let out = folder.path().join(out);
        let hash = json(&out.join("frame_0000.json"))["geometry_hash"].clone();
        (hash, std::fs::read(out.join("rgb_0000.png")).expect("an image"))
    };
    for stage in ["nominal", "surface"] {
        let one = run(stage, "1");
        assert_eq!(one, run(stage, "2"));
        assert_eq!(one, run(stage, "8"));
    }
}

/// Hashes of the geometry of three seeds: equal on every machine, and unchanged within a version.
#[test]
fn geometry_has_the_recorded_hashes() {
    for (seed, recorded, all_vertices) in GEOMETRY_HASHES {
        let mut scene = scene(seed, &[]);
        assert_eq!(scene.geometry_hash(), recorded, "seed {seed}");
        // Rocks that were not generated from parameters are hashed by all their vertices.
        scene.rocks = scene.rocks.iter().cloned().collect::<Vec<_>>().into();
        assert_eq!(scene.geometry_hash(), all_vertices, "seed {seed}");
    }
}
/// Seed, hash as frames record it, and hash over all vertices.
const GEOMETRY_HASHES: [(u64, &str, &str); 3] = [
    (0, "8e014ffd0c8332a224492ee1fca2bbfd", "e7aa275b1f169504457e5b4f4b51fc34"),
    (42, "d4452633e3c5bf503df01c344744f256", "79694b141e6ad92f44895e18601f6b03"),
    (u64::MAX, "edced832c994a2bb574b647d8e788b4e", "4bfb9fc6f4eede6ee10242678bd55d81"),
];

#[test]
fn an_earlier_frame_leaves_no_trace() {
    let (first, other) = (scene(3, &[]), scene(4, &["sun.azimuth_deg=300", "terrain.cells=120"]));
    let alone = render(&first, 128, 4);
    render(&other, 200, 1);
    assert!(alone == render(&first, 128, 4));
}

#[test]
fn frames_in_flight_equal_frames_rendered_alone() {
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
    let in_flight: Vec<InFlight> =
        scenes.iter().map(|scene| renderer.submit(scene, &settings).expect("submitted")).collect();
    // In reverse order: each must wait for its own submission.
    for (index, in_flight) in in_flight.into_iter().enumerate().rev() {
        let frame = renderer.finish(in_flight, &scenes[index]).expect("a frame").0;
        assert!(frame == alone[index], "frame {index}");
    }
}

/// A device answers at once or after milliseconds: a second poll would let it idle.
#[test]
fn a_frame_polls_the_device_once() {
    let mut renderer = renderer();
    let own = renderer.raster();
    renderer.set_raster(on_device(own));
    let scene = scene(3, &[]);
    for _ in 0..2 {
        let before = renderer.gpu().waits();
        renderer.render(&scene, &all_planes(64)).expect("a frame");
        assert_eq!(renderer.gpu().waits() - before, 1);
    }
    renderer.set_raster(own);
}

/// Packets are planned by many threads at a time, staged or not, and submitted in another order: each frame is the one that is rendered
/// alone. The second time their memory is that of the first.
#[test]
fn frames_of_packets_equal_frames_rendered_alone() {
    let mut renderer = renderer();
    let own = renderer.raster();
    let mut moved = scene(3, &[]);
    moved.camera.eye.x += 0.4;
    let sets = [&[][..], &["stage.name=surface", "sensor.kind=bayer"], &["camera.k1=-0.1"]];
    let scenes: Vec<_> = [scene(3, &[]), moved].into_iter().chain(sets.map(|set| scene(3, set))).collect();
    for raster in [own, on_device(own), in_compute_passes(&renderer)] {
        renderer.set_raster(raster);
        let is_on_device = raster.visibility != RasterBackend::Host;
        let settings = all_planes(96);
        let alone: Vec<Frame> =
            scenes.iter().map(|scene| renderer.render(scene, &settings).expect("a frame").0).collect();
        let planner = renderer.planner();
        for staging in [None, Some(Staging::Whole), Some(Staging::Whole), Some(Staging::WithoutMeshes)] {
            let plan = |scene: &Scene| match staging {
                None => planner.plan(scene, &settings).expect("a packet"),
                Some(staging) => planner.plan_and_stage(scene, &settings, staging).expect("a packet"),
            };
            let packets: Vec<_> = std::thread::scope(|scope| {
                let threads: Vec<_> = scenes.iter().map(|scene| scope.spawn(move || plan(scene))).collect();
                threads.into_iter().map(|thread| thread.join().expect("a thread")).collect()
            });
            for (index, packet) in packets.into_iter().enumerate().rev() {
                let is_staged = staging.is_some() && is_on_device;
                assert_eq!(packet.is_staged(), is_staged, "{}, frame {index}", raster.name());
                let in_flight = renderer.submit_packet(&scenes[index], packet).expect("submitted");
                let raw = renderer.read_back(in_flight).expect("a frame");
                let (frame, _) = raw.post_process(&scenes[index]);
                assert!(frame == alone[index], "{}, frame {index}, {staging:?}", raster.name());
            }
        }
    }
    renderer.set_raster(own);
}

/// Four samples per pixel and all geometric planes.
fn all_planes(side: u32) -> RenderSettings {
    let mut settings = RenderSettings::new([side, side], 4).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
            .into_iter()
            .collect();
    settings
}

#[test]
fn shading_bins_change_no_label_and_no_colour() {
    let mut renderer = renderer_by(RasterMode::Host);
    let raster = renderer.raster();
    assert!(raster.bin_by_shadow_sources && raster.visibility == RasterBackend::Host, "bins of the host");
    let mut additional_draws = 0;
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
        let unbinned = renderer.render(&scene, &all_planes(192)).expect("a frame").0;
        let draws = renderer.last_cost().lighting_draws;
        renderer.set_raster(raster);
        let binned = renderer.render(&scene, &all_planes(192)).expect("a frame").0;
        additional_draws += renderer.last_cost().lighting_draws - draws;
        assert!(
            binned.class == unbinned.class && binned.instances == unbinned.instances,
            "seed {seed}: labels"
        );
        assert!(
            binned.depth_m == unbinned.depth_m && binned.normals == unbinned.normals,
            "seed {seed}: geometry"
        );
        assert!(
            binned.sun_occlusion == unbinned.sun_occlusion && binned.rocks == unbinned.rocks,
            "seed {seed}: shadows, boxes"
        );
        assert!(binned.rgb == unbinned.rgb, "seed {seed}: colours");
    }
    assert!(additional_draws >= 10, "only {additional_draws} additional lighting draws");
}

/// With the device as the rasteriser.
#[test]
fn multi_draw_and_single_draws_give_the_same_planes() {
    let mut renderer = renderer();
    let own = renderer.raster();
    assert!(own.multi_draw, "the device of the tests supports multi-draw");
    for (seed, set) in [(1, &[][..]), (7, &["stage.name=surface"]), (9, &["camera.pitch_deg=60"])] {
        let scene = scene(seed, set);
        let mut frame = |multi_draw| {
            renderer.set_raster(RasterOptions { multi_draw, ..on_device(own) });
            renderer.render(&scene, &all_planes(192)).expect("a frame").0
        };
        let (multi, single) = (frame(true), frame(false));
        assert!(multi.class == single.class && multi.rocks == single.rocks, "seed {seed}: labels");
        assert!(multi.depth_m == single.depth_m && multi.normals == single.normals, "seed {seed}");
        assert!(
            multi.sun_occlusion == single.sun_occlusion && multi.rgb == single.rgb,
            "seed {seed}: colours"
        );
    }
    renderer.set_raster(own);
}

/// The first frame uses fewer lighting variants, so that it waits for fewer pipelines to compile.
#[test]
fn the_first_frame_uses_fewer_lighting_variants_and_equals_the_second() {
    let gpu = Gpu::open(Some(&adapter())).expect("a device");
    let mut renderer = Renderer::new(gpu).expect("a renderer");
    let scene = scene(4, &["sun.elevation_deg=12"]);
    let mut frame = || {
        let frame = renderer.render(&scene, &all_planes(128)).expect("a frame").0;
        (frame, renderer.last_cost().lighting_draws)
    };
    let ((first, few), (second, more)) = (frame(), frame());
    // There are no shading bins when the device rasterises.
    let has_bins = few < more || renderer.raster().visibility != RasterBackend::Host;
    assert!(has_bins, "{few} lighting draws, then {more}");
    assert!(first.class == second.class && first.instances == second.instances, "labels");
    assert!(first.sun_occlusion == second.sun_occlusion && first.rgb == second.rgb, "shadows, colours");
}

/// While only the camera moves, tiles of the shadow map, the horizon map and meshes on the device are reused: the frames must be
/// those of a renderer that starts from nothing.
#[test]
fn reuse_between_frames_changes_no_plane() {
    let mut renderer = renderer();
    let own = renderer.raster();
    let computed = in_compute_passes(&renderer);
    for raster in [own, on_device(own), computed] {
        renderer.set_raster(raster);
        assert_reuse_changes_no_plane(&mut renderer);
    }
    renderer.set_raster(own);
}

/// On the device too the shadow map stays while sun and casters do, whatever the camera does besides.
#[test]
fn the_shadow_map_is_drawn_once_for_the_same_sun_and_casters() {
    let mut renderer = renderer();
    let own = renderer.raster();
    renderer.set_raster(on_device(own));
    let (still, other) = (scene(2, &["sun.elevation_deg=8"]), scene(3, &[]));
    let (mut brighter, mut lower) = (still.clone(), still.clone());
    brighter.camera.exposure_ev += 1.0;
    lower.sun = Sun::new(7.0, still.sun.azimuth_deg, still.sun.angular_diameter_deg, still.sun.irradiance);
    let settings = all_planes(128);
    let mut frame = |scene: &Scene| {
        let (frame, times) = renderer.render(scene, &settings).expect("a frame");
        (frame, times.iter().any(|(stage, _)| *stage == "shadow"))
    };
    let (first, is_drawn) = frame(&still);
    assert!(is_drawn);
    let (again, is_drawn) = frame(&still);
    assert!(again == first && !is_drawn, "the same frame");
    let (brighter_kept, is_drawn) = frame(&brighter);
    assert!(!is_drawn, "another exposure");
    let (lower_after, is_drawn) = frame(&lower);
    assert!(is_drawn, "another sun");
    assert!(frame(&other).1, "another scene");
    let (brighter_drawn, is_drawn) = frame(&brighter);
    assert!(is_drawn && brighter_drawn == brighter_kept);
    assert!(frame(&other).1 && frame(&lower).0 == lower_after);
    assert!(frame(&still).0 == first);
    renderer.set_raster(own);
}

fn assert_reuse_changes_no_plane(renderer: &mut Renderer) {
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
        let mut uploads = Vec::new();
        let mut meshes: Vec<BTreeMap<_, usize>> = Vec::new();
        for _ in 0..3 {
            let frame = renderer.render(&moving, &settings).expect("a frame").0;
            in_a_row.push((moving.clone(), frame));
            uploads.push(renderer.last_cost().uploaded_bytes);
            let drawn = Selection::new(&moving, &settings).rocks;
            // The vertices of the finest level that is drawn.
            let vertices_of = |drawn: &SelectedRock| {
                let level = drawn.visible_level.max(drawn.caster.map(|(_, level)| level)).expect("a level");
                (Arc::as_ptr(&moving.rocks[drawn.rock].vertices), Icosphere::vertex_count(level))
            };
            meshes.push(drawn.iter().map(vertices_of).collect());
            moving.camera.eye.x += 0.4;
        }
        // The third frame uploads all vertices of the first less, 16 bytes each, except those that are new, which take whole pages.
        let uploaded = |mesh| [0, 1].map(|frame: usize| meshes[frame].get(mesh)).into_iter().flatten().max();
        let new = meshes[2].iter().filter(|(mesh, count)| uploaded(*mesh) < Some(*count));
        let new: usize = new.map(|(_, count)| count).sum();
        let vertices = moving.terrain.vertices.len() + meshes[0].values().sum::<usize>();
        let page = if new > 0 { PAGE_BYTES } else { 0 };
        let uploads_less = uploads[2] + 16 * vertices as u64 <= uploads[0] + (16 * new + page) as u64;
        let is_host = renderer.raster().visibility == RasterBackend::Host;
        assert!(is_host || uploads_less, "seed {seed}: {uploads:?} bytes");
        // The device has the ground, but not all rocks of the new view.
        let built = moving.rocks.built().count();
        for axis in [&mut moving.camera.forward, &mut moving.camera.right, &mut moving.camera.up] {
            *axis = Mat3::from_rotation_z(0.8) * *axis;
        }
        let turned = renderer.render(&moving, &settings).expect("a frame").0;
        let is_on_demand = moving.rocks.built().count() > built;
        assert!(is_on_demand || set.contains(&"stage.name=surface"), "seed {seed}: {built} rocks");
        in_a_row.push((moving, turned));
        for (step, (scene, reused)) in in_a_row.iter().enumerate() {
            renderer.render(&other, &settings).expect("a frame");
            let alone = renderer.render(scene, &settings).expect("a frame").0;
            assert!(
                alone.class == reused.class && alone.instances == reused.instances,
                "seed {seed}, {step}: labels"
            );
            assert!(
                alone.depth_m == reused.depth_m && alone.normals == reused.normals,
                "seed {seed}, {step}: geometry"
            );
            assert!(alone.sun_occlusion == reused.sun_occlusion, "seed {seed}, {step}: shadows");
            assert!(
                alone.radiance == reused.radiance && alone.rgb == reused.rgb,
                "seed {seed}, {step}: colours"
            );
        }
    }
}

/// A large G-buffer is uploaded in several parts, here two.
#[test]
fn a_large_image_has_the_same_labels_from_host_and_device() {
    let (scene, settings) = (scene(11, &[]), RenderSettings::new([1024, 1024], 4).expect("settings"));
    let mut renderer = renderer();
    let raster = renderer.raster();
    let host = renderer.render(&scene, &settings).expect("a frame").0;
    renderer.set_raster(RasterOptions { visibility: RasterBackend::Device, ..raster });
    let device = renderer.render(&scene, &settings).expect("a frame").0;
    let computed = in_compute_passes(&renderer);
    renderer.set_raster(computed);
    let computed = renderer.render(&scene, &settings).expect("a frame").0;
    renderer.set_raster(raster);
    let labels = share(&host.class, &device.class, |a, b| a != b);
    assert!(labels < 1e-5, "{labels} of the labels differ");
    assert!(host.class == computed.class, "labels of a compute pass");
}

/// Triangles of the sky have more blocks of samples there than a loop on Mesa's CPU driver has steps.
#[test]
fn a_wide_image_has_the_same_labels_from_a_compute_pass() {
    let (scene, settings) = (scene(42, &[]), RenderSettings::new([8192, 1024], 1).expect("settings"));
    let mut renderer = renderer();
    let raster = renderer.raster();
    let host = renderer.render(&scene, &settings).expect("a frame").0;
    let computed = in_compute_passes(&renderer);
    renderer.set_raster(computed);
    let computed = renderer.render(&scene, &settings);
    renderer.set_raster(raster);
    assert!(host.class == computed.expect("a frame").0.class);
}

#[test]
fn host_and_device_rasterise_the_same_frame() {
    let mut renderer = renderer_by(RasterMode::Host);
    let raster = renderer.raster();
    assert_eq!((raster.visibility, raster.shadow), (RasterBackend::Host, RasterBackend::Host));
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
        let host = renderer.render(&scene, &settings).expect("a frame").0;
        renderer.set_raster(on_device(raster));
        let device = renderer.render(&scene, &settings).expect("a frame").0;
        for (shadow, visibility) in
            [(RasterBackend::Host, RasterBackend::Device), (RasterBackend::Device, RasterBackend::Host)]
        {
            renderer.set_raster(RasterOptions { visibility, shadow, ..raster });
            let mixed = renderer.render(&scene, &settings).expect("a frame").0;
            let same_visibility = if visibility == RasterBackend::Host { &host } else { &device };
            assert!(
                mixed.class == same_visibility.class && mixed.depth_m == same_visibility.depth_m,
                "seed {seed}: a backend of each"
            );
        }
        let computed = in_compute_passes(&renderer);
        renderer.set_raster(computed);
        let computed = renderer.render(&scene, &settings).expect("a frame").0;
        renderer.set_raster(raster);
        assert!(
            host.class == computed.class && host.instances == computed.instances,
            "seed {seed}: labels of a compute pass"
        );
        let depth = share(&host.depth_m, &computed.depth_m, |a, b| (a - b).abs() > 1e-5 * a);
        assert!(depth < 1e-3, "seed {seed}: {depth} of the depths of a compute pass differ");
        // Where a vertex rounds to another subpixel position, a sample of an outline or a texel of a shadow may differ, and with it
        // every plane.
        let labels = share(&host.class, &device.class, |a, b| a != b)
            + share(&host.instances, &device.instances, |a, b| a != b);
        let depth = share(&host.depth_m, &device.depth_m, |a, b| (a - b).abs() > 1e-3 * a);
        let normals = share(&host.normals, &device.normals, |a, b| (a - b).abs() > 1e-2);
        let occlusion = share(&host.sun_occlusion, &device.sun_occlusion, |a, b| a.abs_diff(b) > 2);
        let rgb = share(&host.rgb, &device.rgb, |a, b| a.abs_diff(b) > 2);
        assert!(labels < 1e-4, "seed {seed}: {labels} of the labels differ");
        assert!(
            depth < 1e-4 && normals < 1e-4,
            "seed {seed}: {depth} of depths, {normals} of normals differ"
        );
        assert!(
            occlusion < 5e-4 && rgb < 5e-4,
            "seed {seed}: {occlusion} of shadows, {rgb} of colours differ"
        );
    }
}

/// The same options with the device as every stage's backend.
const fn on_device(raster: RasterOptions) -> RasterOptions {
    RasterOptions { visibility: RasterBackend::Device, shadow: RasterBackend::Device, ..raster }
}

/// The options of a renderer's device with compute passes as every stage's backend.
fn in_compute_passes(renderer: &Renderer) -> RasterOptions {
    RasterOptions::new(RasterMode::Compute, renderer.gpu()).expect("enough storage buffers")
}

/// Fraction of the pairs of two lists for which a condition holds.
fn share<T: Copy>(a: &[T], b: &[T], holds: impl Fn(T, T) -> bool) -> f64 {
    a.iter().zip(b).filter(|(a, b)| holds(**a, **b)).count() as f64 / a.len() as f64
}
