//! The host's frames against the device's, in render passes and in a compute pass, over many scenes: depth, colour and class.
//!
//! All round the corners of triangles to a grid before they decide which samples a triangle covers (Vulkan specification,
//! `subPixelPrecisionBits`). The host's grid has 256 steps a pixel, as that of nearly every device. Where the device's is
//! coarser, a sample near an edge may belong to another triangle in a render pass: such samples are counted apart. The compute pass has
//! the host's grid on every device.
//!
//! `tests/outside/check_drivers.py` runs this on other drivers and on more scenes.

#![allow(clippy::print_stdout, reason = "figures for people who run it with --nocapture")]

use glam::Vec2;
use regolith::frame::{Annotation, Frame};
use regolith::params::config::Config;
use regolith::params::{KNOBS, Kind, KnobInfo, Stage};
use regolith::random::Streams;
use regolith::render::{RasterMode, RenderSettings};
use regolith::scene::Scene;

use crate::support::{render_by, renderer, scene};
use crate::truth::Truth;

/// Variable with the number of scenes.
const SCENES: &str = "REGOLITH_BACKEND_SCENES";
/// Scenes where it is not set: all kinds, twice.
const DEFAULT_SCENES: u64 = 2 * KINDS;
/// Pixels along a side.
const SIDE: u32 = 72;

/// Sub-pixel steps of the host's grid, per pixel.
const HOST_STEPS: u32 = 256;
/// Sub-pixel steps of devices with a coarser grid, by a part of the adapter's name.
const COARSE_STEPS: [(&str, u32); 1] = [("SwiftShader", 16)];

/// Largest relative difference of depth, and the share of the pixels that may exceed it.
const DEPTH: (f32, f64) = (1e-5, 0.001);
/// Largest difference of a colour value, steps of 255, and the share of the values that may exceed it.
const COLOUR: (u8, f64) = (2, 0.0005);

/// Share of the pixels whose class may differ where a compute pass rasterises: surfaces that meet there, at depths that round differently.
const MAX_COMPUTED_CLASS: f64 = 1e-5;

const STAGES: [&str; 2] = ["nominal", "surface"];
const SAMPLES: [u32; 2] = [1, 4];
const VIEWS: [&[&str]; 5] = [
    &["camera.height_m=3"],
    &["camera.height_m=1.5"],
    &["camera.fov_deg=85"],
    &["sun.elevation_deg=5"],
    // Coordinates are large there: what is not relative to the eye has rounding errors of 1e-5 m.
    &["camera.x_m=-440", "camera.yaw_deg=121", "camera.pitch_deg=-20"],
];
const KINDS: u64 = (STAGES.len() * SAMPLES.len() * VIEWS.len()) as u64;

/// How often the backends differ.
#[derive(Default)]
struct Tally {
    pixels: u64,
    depth: u64,
    /// Of colour values, three a pixel.
    colour: u64,
    class: u64,
    /// The same, away from edges.
    depth_inside: u64,
    colour_inside: u64,
    class_inside: u64,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.depth += other.depth;
        self.colour += other.colour;
        self.class += other.class;
        self.depth_inside += other.depth_inside;
        self.colour_inside += other.colour_inside;
        self.class_inside += other.class_inside;
    }

    fn share(&self, count: u64) -> f64 {
        count as f64 / self.pixels as f64
    }

    /// Shares of the pixels whose depth and of the values whose colour differs. On a grid as fine as the host's no sample is excused.
    fn counted(&self, steps: u32) -> [f64; 2] {
        let (depth, colour) = if steps < HOST_STEPS {
            (self.depth_inside, self.colour_inside)
        } else {
            (self.depth, self.colour)
        };
        [self.share(depth), self.share(colour) / 3.0]
    }

    fn print(&self, name: &str) {
        let percent = |count| 100.0 * self.share(count);
        println!(
            "{name}: {} px; depth off {:.4} % (away from edges {:.4} %), colour {:.4} % ({:.4} %), class {} px ({})",
            self.pixels,
            percent(self.depth),
            percent(self.depth_inside),
            percent(self.colour) / 3.0,
            percent(self.colour_inside) / 3.0,
            self.class,
            self.class_inside,
        );
    }
}

/// The points of an image, by rays.
struct Rays<'a> {
    scene: &'a Scene,
    truth: Truth,
    samples_per_side: u32,
}

impl Rays<'_> {
    /// The triangle at a position in samples, none in the sky.
    fn triangle_at(&self, position: Vec2) -> Option<usize> {
        let (camera, side) = (&self.scene.camera, SIDE * self.samples_per_side);
        let across = (position - 0.5 * side as f32) / camera.focal_px(side) as f32;
        let ray = (camera.forward + across.x * camera.right - across.y * camera.up).normalize();
        let (triangle, distance_m) = self.truth.triangle(camera.eye, ray)?;
        let point = camera.eye + distance_m * ray;
        (point.distance(self.scene.sky.centre) < self.scene.sky.radius_m).then_some(triangle)
    }

    /// Whether one triangle ends and another begins within a distance, samples, of a sample of a pixel.
    fn is_near_edge(&self, pixel: usize, distance: f32) -> bool {
        let side = self.samples_per_side as usize;
        let first = [pixel % SIDE as usize, pixel / SIDE as usize].map(|at| at * side);
        (0..side * side).any(|i| {
            let centre = Vec2::new((first[0] + i % side) as f32, (first[1] + i / side) as f32) + 0.5;
            let own = self.triangle_at(centre);
            let mut around = (0..8).map(|i| Vec2::from_angle(std::f32::consts::TAU * i as f32 / 8.0));
            around.any(|direction| self.triangle_at(centre + distance * direction) != own)
        })
    }
}

/// Name and sub-pixel steps of the adapter of the tests.
fn adapter_and_steps() -> (String, u32) {
    let adapter = renderer().gpu().info.name.clone();
    let coarse = COARSE_STEPS.iter().find(|(name, _)| adapter.contains(name));
    (adapter, coarse.map_or(HOST_STEPS, |(_, steps)| *steps))
}

/// Differences in a scene between the host and another backend, with this many sub-pixel steps.
fn compare(scene: &Scene, samples: u32, (backend, steps): (RasterMode, u32)) -> Tally {
    let mut settings = RenderSettings::new([SIDE; 2], samples).expect("settings");
    settings.annotations = [Annotation::Depth].into_iter().collect();
    let [host, device]: [Frame; 2] =
        [RasterMode::Host, backend].map(|backend| render_by(backend, scene, &settings));
    let mut tally = Tally { pixels: host.class.len() as u64, ..Tally::default() };
    let mut rays = None;
    for pixel in 0..host.class.len() {
        let (expected, found) = (host.depth_m[pixel], device.depth_m[pixel]);
        let is_near = expected == found || (found / expected - 1.0).abs() <= DEPTH.0;
        let colours = 3 * pixel..3 * pixel + 3;
        let colours = host.rgb[colours.clone()].iter().zip(&device.rgb[colours]);
        let depth = u64::from(!is_near);
        let colour = colours.filter(|(a, b)| a.abs_diff(**b) > COLOUR.0).count() as u64;
        let class = u64::from(host.class[pixel] != device.class[pixel]);
        if depth + colour + class == 0 {
            continue;
        }
        let mut is_near_edge = false;
        // The rays need a while to set up.
        if class > 0 || steps < HOST_STEPS {
            let rays = rays.get_or_insert_with(|| Rays {
                scene,
                truth: Truth::new(scene, Some(&settings)),
                samples_per_side: settings.samples_per_side,
            });
            is_near_edge = rays.is_near_edge(pixel, 1.0 / steps as f32);
        }
        tally.add(&Tally {
            pixels: 0,
            depth,
            colour,
            class,
            depth_inside: if is_near_edge { 0 } else { depth },
            colour_inside: if is_near_edge { 0 } else { colour },
            class_inside: if is_near_edge { 0 } else { class },
        });
    }
    tally
}

#[test]
fn backends_agree_in_depth_colour_and_class() {
    let (adapter, steps) = adapter_and_steps();
    check_many((RasterMode::Device, steps), &adapter);
    let computed = check_many((RasterMode::Compute, HOST_STEPS), &format!("{adapter}, compute"));
    assert!(
        computed.share(computed.class) <= MAX_COMPUTED_CLASS,
        "{} pixels of another class",
        computed.class
    );
}

/// Compares the host with a backend in as many scenes as are asked for.
fn check_many((backend, steps): (RasterMode, u32), name: &str) -> Tally {
    let count =
        std::env::var(SCENES).map_or(DEFAULT_SCENES, |text| text.parse().expect("a number of scenes"));
    let mut all = Tally::default();
    for (k, stage) in STAGES.iter().enumerate() {
        for (l, samples) in SAMPLES.into_iter().enumerate() {
            let mut tally = Tally::default();
            let kind = (k * SAMPLES.len() + l) as u64;
            for seed in (0..count).filter(|seed| seed % (STAGES.len() * SAMPLES.len()) as u64 == kind) {
                let view = VIEWS[(seed / (STAGES.len() * SAMPLES.len()) as u64) as usize % VIEWS.len()];
                let stage = format!("stage.name={stage}");
                let set = [&[&*stage], view].concat();
                tally.add(&compare(&scene(seed, &set), samples, (backend, steps)));
            }
            tally.print(&format!("{name}, {stage}, {samples} samples"));
            all.add(&tally);
        }
    }
    all.print(&format!("{name}, {count} scenes"));
    assert!(all.pixels > 0, "no scene: {SCENES}={count}");
    let [depth, colour] = all.counted(steps);
    assert!(depth <= DEPTH.1, "depth differs by over {:e} in {depth} of the pixels", DEPTH.0);
    assert!(colour <= COLOUR.1, "colour differs by over {} steps in {colour} of the values", COLOUR.0);
    assert_eq!(all.class_inside, 0, "of {} pixels of another class: not at an edge", all.class);
    all
}

/// Scenes of [`any_scene`].
const ANY_SCENES: u64 = 24;
/// Knobs of the camera's pose, which is drawn for each scene, and the largest magnitude of their values.
const POSE: [(&str, f64); 4] =
    [("camera.x_m", 440.0), ("camera.y_m", 440.0), ("camera.yaw_deg", 180.0), ("camera.pitch_deg", 40.0)];
/// Number of other knobs that are drawn for each.
const OTHER_KNOBS: usize = 6;
/// Sections of the knobs of what is rasterised and lit.
const SECTIONS: [&str; 10] =
    ["camera", "terrain", "relief", "craters", "rocks", "rover", "wall", "tracks", "sun", "regolith"];
/// Among them those whose largest values take minutes, leave the image black, or fold it over.
const UNFIT_KNOBS: [&str; 8] = [
    "terrain.cell_mrad",
    "terrain.cells",
    "camera.exposure_ev",
    "camera.k1",
    "camera.k2",
    "camera.k3",
    "camera.p1",
    "camera.p2",
];

/// A scene with a pose and knobs from anywhere in their ranges, and what is set for it; none where that cannot be built.
fn any_scene(seed: u64) -> Option<(Vec<String>, Scene)> {
    let draw = &mut Streams::new(seed).stream("tests.backends", 0);
    let stage_name = STAGES[seed as usize % STAGES.len()];
    let stage = Stage::from_name(stage_name).expect("a stage");
    let is_number = |info: &&KnobInfo| matches!(info.kind, Kind::Number | Kind::Integer);
    let is_fit = |info: &&KnobInfo| SECTIONS.contains(&info.section()) && !UNFIT_KNOBS.contains(&info.name);
    let numbers: Vec<&KnobInfo> =
        KNOBS.iter().filter(|info| info.is_of(stage)).filter(is_number).filter(is_fit).collect();
    let mut set = vec![format!("stage.name={stage_name}")];
    set.extend((0..OTHER_KNOBS).map(|_| {
        let info = numbers[draw.uniform_int(0, numbers.len() as i64 - 1) as usize];
        let value = draw.uniform(info.range[0], info.range[1]);
        format!("{}={}", info.name, if info.kind == Kind::Integer { value.round() } else { value })
    }));
    set.extend(POSE.map(|(name, most)| format!("{name}={}", draw.uniform(-most, most))));
    let mut config = Config::new();
    for assignment in &set {
        config.apply_set(assignment).expect("a value in its range");
    }
    let scene = Scene::build(seed, &config.draw(seed).ok()?).ok()?;
    Some((set, scene))
}

/// In every frame by itself, where [`backends_agree_in_depth_colour_and_class`] asks for all of its frames together.
#[test]
fn backends_agree_whatever_the_knobs() {
    let (adapter, steps) = adapter_and_steps();
    let mut compared = 0;
    for (set, scene) in (0..ANY_SCENES).filter_map(any_scene) {
        for (backend, steps) in [(RasterMode::Device, steps), (RasterMode::Compute, HOST_STEPS)] {
            let tally = compare(&scene, 1, (backend, steps));
            tally.print(&format!("{adapter}, {backend}, {set:?}"));
            let [depth, colour] = tally.counted(steps);
            assert!(
                depth <= 2.0 * DEPTH.1,
                "{backend}, {set:?}: depth differs by over {:e} in {depth} of the pixels",
                DEPTH.0
            );
            assert!(colour <= 2.0 * COLOUR.1, "{backend}, {set:?}: colour differs in {colour} of the values");
            assert_eq!(
                tally.class_inside, 0,
                "{backend}, {set:?}: of {} pixels of another class",
                tally.class
            );
        }
        compared += 1;
    }
    assert!(2 * compared > ANY_SCENES, "{compared} scenes could be built");
}

/// The scenes above are too far away to show it. What grains cover is a fiftieth of the values, most of which would differ without
/// their texture.
#[test]
fn backends_agree_in_the_texture_of_grains() {
    let (_, steps) = adapter_and_steps();
    let close = [
        "stage.name=surface",
        "camera.fov_deg=5",
        "camera.height_m=1",
        "camera.pitch_deg=-50",
        "grains.density=2.5",
    ];
    for (backend, steps) in [(RasterMode::Device, steps), (RasterMode::Compute, HOST_STEPS)] {
        let mut all = Tally::default();
        for seed in 0..6 {
            all.add(&compare(&scene(seed, &close), 1, (backend, steps)));
        }
        all.print(&format!("{backend}, grains"));
        assert!(all.pixels > 0 && all.counted(steps)[1] <= COLOUR.1, "{} values differ", all.colour);
    }
}

/// A plane is the same whatever else a frame has: each set of planes is resolved by a pipeline of its own.
#[test]
fn a_plane_does_not_depend_on_those_beside_it() {
    let scenes = [
        scene(5, &["stage.name=surface", "camera.k1=-0.09", "rocks.coverage=0.05"]),
        scene(6, &["camera.pitch_deg=-4", "sky.star_count=60"]),
    ];
    let every =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow, Annotation::Hdr];
    for (scene, samples) in scenes.iter().zip([4, 16]) {
        let with = |annotations: &[Annotation]| {
            let mut settings = RenderSettings::new([96, 64], samples).expect("settings");
            settings.annotations = annotations.iter().copied().collect();
            renderer().render(scene, &settings).expect("a frame").0
        };
        let whole = with(&every);
        assert!(whole.instances.iter().any(|instance| *instance > 0), "rocks");
        let sets = [&[][..], &every[2..3], &every[..1], &[every[2], every[4]], &every[1..4]];
        for set in sets {
            let part = with(set);
            assert!(part.rgb == whole.rgb && part.class == whole.class, "{set:?}");
            let has = |annotation| set.contains(&annotation);
            assert!(!has(Annotation::Depth) || part.depth_m == whole.depth_m, "{set:?}");
            assert!(!has(Annotation::Normals) || part.normals == whole.normals, "{set:?}");
            assert!(!has(Annotation::Instances) || part.instances == whole.instances, "{set:?}");
            assert!(!has(Annotation::Shadow) || part.sun_occlusion == whole.sun_occlusion, "{set:?}");
            assert!(!has(Annotation::Hdr) || part.radiance == whole.radiance, "{set:?}");
        }
    }
}
