//! Frames in memory: equal to the files of the command, in order, while others use the renderer.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use regolith::Error;
use regolith::dataset::attempt::build_scene;
use regolith::dataset::frame_stream::render_scene;
use regolith::dataset::plan::{Plan, Seeds};
use regolith::dataset::pose::Pose;
use regolith::dataset::rules::Rules;
use regolith::dataset::{Concurrency, FrameInMemory, FrameStream};
use regolith::frame::plane::OwnedValues;
use regolith::gpu::Gpu;
use regolith::output;
use regolith::params::config::Config;
use regolith::render::{RasterMode, RenderSettings, Renderer};

use crate::support::{adapter, folder, json, run_ok, scene};

fn shared_renderer() -> Arc<Mutex<Renderer>> {
    let gpu = Gpu::open(Some(&adapter())).unwrap_or_else(|error| panic!("{error}"));
    Arc::new(Mutex::new(Renderer::new(gpu).unwrap_or_else(|error| panic!("{error}"))))
}

fn plan(preset: &str, side: u32, outputs: &str) -> Plan {
    let mut config = Config::new();
    config.apply_preset(preset).expect("a preset");
    let rules = Rules::from_config(&config).expect("rules");
    let settings = RenderSettings::new([side, side], 4).expect("settings");
    Plan::in_memory(config, rules, 42, settings, output::parse_outputs(outputs).expect("outputs"))
}

fn stream(plan: &Plan, renderer: &Arc<Mutex<Renderer>>, indices: &[u64]) -> FrameStream {
    let indices = Vec::from(indices).into_iter();
    let concurrency = Concurrency::with_threads(2);
    FrameStream::start(plan.clone(), Arc::clone(renderer), indices, concurrency, 2).expect("threads")
}

fn array<'a>(frame: &'a FrameInMemory, name: &str) -> &'a OwnedValues {
    &frame.arrays.iter().find(|array| array.name == name).expect(name).values
}

fn image(path: &Path) -> Vec<u8> {
    image::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).into_bytes()
}

#[test]
fn frames_in_memory_are_those_of_a_dataset() {
    let folder = folder();
    run_ok(
        folder.path(),
        &[
            "dataset",
            "--preset",
            "surface_train_full",
            "--count",
            "4",
            "--size",
            "64",
            "--out",
            "d",
            "--outputs",
            "rgb,mask,depth,instances",
        ],
    );
    let lines = std::fs::read_to_string(folder.path().join("d/frames.jsonl")).expect("lines");
    let plan = plan("surface_train_full", 64, "rgb,mask,depth,instances");
    let order = [3, 0, 1, 1, 2];
    let frames: Vec<FrameInMemory> =
        stream(&plan, &shared_renderer(), &order).map(|frame| frame.expect("a frame")).collect();
    assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), order);
    for frame in &frames {
        let path = |output: &str, stem: &str, extension: &str| {
            folder.path().join(format!("d/{output}/{stem}_{:05}.{extension}", frame.index))
        };
        assert_eq!(*array(frame, "rgb"), OwnedValues::U8(image(&path("rgb", "rgb", "png"))));
        assert_eq!(*array(frame, "mask"), OwnedValues::U8(image(&path("mask", "mask", "png"))));
        let stored = std::fs::read(path("depth", "distance_to_camera", "npy")).expect("an array");
        let OwnedValues::F32(distances) = array(frame, "distance_to_camera") else { panic!("float32") };
        assert!(stored.ends_with(bytemuck::cast_slice(distances)));
        let mapping = json(&path("instances", "instance_segmentation_mapping", "json"));
        assert_eq!(serde_json::Value::from(frame.rocks.clone()), mapping);
        let line = lines.lines().find(|line| line.starts_with(&format!("{{\"index\":{},", frame.index)));
        let line: serde_json::Value = serde_json::from_str(line.expect("a line")).expect("JSON");
        for key in ["seed", "attempt", "knobs", "geometry_hash", "coverage", "camera"] {
            assert_eq!(frame.record[key], line[key], "{key}");
        }
    }
}

#[test]
fn frames_can_be_asked_for_by_seed_and_the_renderer_serves_others_in_between() {
    let renderer = shared_renderer();
    let plan = Plan { seeds: Seeds::Given, ..plan("train_dr", 48, "rgb,mask") };
    let mut frames = stream(&plan, &renderer, &[u64::MAX, 7, 7, 8]);
    let first = frames.next().expect("a frame").expect("rendered");
    assert_eq!(first.record["seed"], u64::MAX);
    let other = scene(5, &[]);
    let settings = RenderSettings::new([32, 32], 1).expect("settings");
    let alone = renderer.lock().unwrap_or_else(PoisonError::into_inner).render(&other, &settings);
    assert_eq!(alone.expect("a frame").0.rgb.len(), 3 * 32 * 32);
    let rest: Vec<FrameInMemory> = frames.map(|frame| frame.expect("rendered")).collect();
    assert_eq!(rest.len(), 3);
    assert_eq!(rest[0].arrays, rest[1].arrays);
    assert_ne!(rest[1].arrays, rest[2].arrays);
}

/// On the host, and on the device, which keeps the meshes of a scene whose ground stays.
#[test]
fn frames_of_poses_are_those_of_the_poses_alone() {
    for (preset, raster) in [
        ("train_dr", RasterMode::Host),
        ("train_dr", RasterMode::Compute),
        ("surface_train_dr", RasterMode::Compute),
    ] {
        let gpu = Gpu::open(Some(&adapter())).unwrap_or_else(|error| panic!("{error}"));
        let renderer = Arc::new(Mutex::new(Renderer::with_raster(gpu, raster).expect("a renderer")));
        let plan = plan(preset, 48, "rgb,mask,depth,instances");
        let built = build_scene(&plan, 11).expect("a scene");
        let pose = |set: &str| Pose::new(&plan, &built, set, None).expect("a pose");
        let poses: Vec<Pose> = [
            "",
            "camera.yaw_deg = 20",
            "sun.azimuth_deg = 300",
            "camera.yaw_deg = 60\ncamera.pitch_deg = -20",
            "sun.elevation_deg = 9\nsun.azimuth_deg = 10",
            "camera.yaw_deg = 20",
        ]
        .map(pose)
        .to_vec();
        let concurrency = Concurrency::with_threads(3);
        let of_scene = (built.clone(), poses.clone());
        let frames = FrameStream::of_poses(plan.clone(), Arc::clone(&renderer), of_scene, concurrency, 1);
        let frames: Vec<FrameInMemory> =
            frames.expect("threads").map(|frame| frame.expect("a frame")).collect();
        assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
        assert_eq!(frames[1].arrays, frames[5].arrays);
        for (index, (frame, pose)) in frames.iter().zip(&poses).enumerate() {
            let (posed, _) = pose.in_scene(&built, &plan.settings).expect("a scene");
            let alone = render_scene(&plan, &renderer, posed).expect("a frame");
            assert_eq!(frame.arrays, alone.arrays, "{preset}, {raster:?}, pose {index}");
            assert_eq!((&frame.record["seed"], &frame.rocks), (&11.into(), &alone.rocks));
            let others = frames.iter().enumerate().filter(|(other, _)| *other != index);
            let same = others.filter(|(_, other)| other.arrays == frame.arrays).count();
            assert_eq!(same, usize::from(index == 1 || index == 5), "pose {index} shows");
        }
        let wrong = Pose::new(&plan, &built, "rocks.count = 3", None).expect_err("no pose");
        assert!(wrong.to_string().contains("rocks.count"), "{wrong}");
    }
}

#[test]
fn a_stream_that_is_dropped_stops_and_one_with_an_impossible_scene_ends_with_the_error() {
    let renderer = shared_renderer();
    let mut plan = plan("train_dr", 32, "rgb");
    let endless =
        FrameStream::start(plan.clone(), Arc::clone(&renderer), 0.., Concurrency::with_threads(2), 1);
    let mut endless = endless.expect("threads");
    assert_eq!(endless.next().expect("a frame").expect("rendered").index, 0);
    drop(endless);
    // A dome lower than the camera.
    plan.config.apply_set("sky.dome_radius_m=60").expect("a knob");
    plan.config.apply_set("camera.height_m=200").expect("a knob");
    plan.seeds = Seeds::Given;
    let mut impossible = stream(&plan, &renderer, &[1, 2]);
    let error = impossible.next().expect("an end").expect_err("an error");
    assert!(matches!(error, Error::Scene(_)), "{error}");
    assert!(impossible.next().is_none());
}
