//! The rover: its shadow against the ray tracer, what the camera sees of it, and its prims in exports.

#![allow(clippy::print_stdout, reason = "figures for people who run it with --nocapture")]

use glam::{Vec2, Vec3};
use regolith::class::ClassId;
use regolith::export::{Detail, Format, Stage, export};
use regolith::frame::{Annotation, Frame};
use regolith::render::{RasterMode, RenderSettings};
use regolith::scene::Scene;
use regolith::scene::rocks::lunar::PRESSED_M;

use crate::support::{BACKENDS, folder, npy, params, render_by, run_ok, scene};
use crate::truth::Truth;

const SIDE: u32 = 192;
const SEED: u64 = 61;

/// Sun behind the camera, which looks down at its shadow.
const BEHIND: [&str; 6] = [
    "stage.name=surface",
    "sun.azimuth_deg=170",
    "sun.elevation_deg=30",
    "camera.pitch_deg=-30",
    "camera.fov_deg=70",
    "rocks.coverage=0",
];

fn settings() -> RenderSettings {
    let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Instances, Annotation::Shadow].into_iter().collect();
    settings
}

fn scene_with(more: &[&str]) -> Scene {
    scene(SEED, &[&BEHIND[..], more].concat())
}

/// The point of the world that a pixel shows.
fn point(scene: &Scene, frame: &Frame, pixel: usize) -> Vec3 {
    let camera = &scene.camera;
    let focal_px = camera.focal_px(SIDE) as f32;
    let side = SIDE as usize;
    let [x, y] = [pixel % side, pixel / side].map(|at| (at as f32 + 0.5 - 0.5 * side as f32) / focal_px);
    camera.eye + frame.depth_m[pixel] * (camera.forward + x * camera.right - y * camera.up)
}

/// The silhouette of the shadow on ground that nothing else shadows, as the ray tracer has it on the exported triangles.
#[test]
fn the_shadow_is_that_of_the_ray_tracer() {
    let cases: [&[&str]; 4] = [
        &[],
        &["rover.heading_deg=70", "sun.elevation_deg=18"],
        &["rover.heading_deg=180", "rover.panel_m=0"],
        &["rover.length_m=0.8", "rover.deck_m=1.2", "rover.wheel_m=0.5", "rover.heading_deg=-30"],
    ];
    for set in cases {
        let with = scene_with(&[&["rover.kind=rover"], set].concat());
        let without = scene_with(set);
        let (of_rover, of_ground) =
            (Truth::new(&with, Some(&settings())), Truth::new(&without, Some(&settings())));
        for backend in BACKENDS {
            let frame = render_by(backend, &with, &settings());
            let (mut both, mut either, mut error, mut tested) = (0, 0, 0.0, 0);
            for pixel in (0..frame.class.len()).step_by(3) {
                if frame.class[pixel] != ClassId::REGOLITH.0 {
                    continue;
                }
                let point = point(&with, &frame, pixel) + Vec3::new(0.0, 0.0, 2e-3);
                if of_ground.sun_occlusion(&without, point, pixel as u64) > 0.0 {
                    continue;
                }
                let truth = of_rover.sun_occlusion(&with, point, pixel as u64);
                let found = f32::from(frame.sun_occlusion[pixel]) / 255.0;
                both += u32::from(truth > 0.5 && found > 0.5);
                either += u32::from(truth > 0.5 || found > 0.5);
                error += (truth - found).abs();
                tested += 1;
            }
            let (iou, error) = (f64::from(both) / f64::from(either), error / tested as f32);
            println!("{set:?}, {backend}: IoU {iou:.4}, {either} of {tested}, mean error {error:.4}");
            assert!(either > tested / 100, "{set:?}, {backend}: {either} pixels of {tested} in shadow");
            assert!(iou > 0.95 && error < 0.01, "{set:?}, {backend}: IoU {iou}, mean error {error}");
        }
    }
}

/// A camera cannot look at its own shadow and see sunlit ground there.
#[test]
fn the_antisolar_point_is_in_the_shadow_of_the_camera() {
    for (azimuth, elevation) in [(170, 30), (190, 22), (180, 38)] {
        let sun = [format!("sun.azimuth_deg={azimuth}"), format!("sun.elevation_deg={elevation}")];
        let scene = scene_with(&["rover.kind=rover", &sun[0], &sun[1]]);
        let frame = render_by(RasterMode::Host, &scene, &settings());
        let camera = &scene.camera;
        let away = -scene.sun.direction;
        let at = Vec3::new(away.dot(camera.right), -away.dot(camera.up), away.dot(camera.forward));
        let focal_px = camera.focal_px(SIDE) as f32;
        let [x, y] = [at.x, at.y].map(|x| (x / at.z * focal_px + 0.5 * SIDE as f32) as usize);
        let occlusion = frame.sun_occlusion[y * SIDE as usize + x];
        assert!(occlusion > 128, "sun at {azimuth}, {elevation}: occlusion {occlusion}");
    }
}

/// Whatever the heading: the same surfaces as without a rover, unless it is visible.
#[test]
fn a_rover_is_seen_only_if_visible() {
    let down = "camera.pitch_deg=-55";
    let without = scene_with(&[down]);
    let hardware = |frame: &Frame| frame.count(ClassId::UNLABELLED);
    for backend in BACKENDS {
        let reference = render_by(backend, &without, &settings());
        for heading in ["rover.heading_deg=0", "rover.heading_deg=90", "rover.heading_deg=180"] {
            let hidden = scene_with(&[down, "rover.kind=rover", heading]);
            let frame = render_by(backend, &hidden, &settings());
            assert!(frame.class == reference.class, "{backend}, {heading}: classes");
            assert!(frame.depth_m == reference.depth_m, "{backend}, {heading}: depth");
            assert!(frame.instances == reference.instances, "{backend}, {heading}: instances");
        }
        let visible = |heading| {
            let scene = scene_with(&[down, "rover.kind=rover", "rover.visible=yes", heading]);
            render_by(backend, &scene, &settings())
        };
        let frame = visible("rover.heading_deg=180");
        let share = hardware(&frame) as f64 / frame.class.len() as f64;
        assert!(share > 0.05 && share < 0.9, "{backend}: {share} of the image is rover");
        for (pixel, class) in frame.class.iter().enumerate() {
            assert!([0, 1, 2, 255].contains(class), "{backend}: class {class}");
            if *class == 255 {
                assert!(frame.depth_m[pixel] < 4.0 && frame.instances[pixel] == 0, "{backend}");
            }
        }
    }
}

/// The rover's samples are of no class: they count in none of the fractions, and as samples.
#[test]
fn class_fractions_are_those_of_all_samples_of_a_pixel() {
    let folder = folder();
    let words = [
        "--size=96x72",
        "--outputs=coverage,mask",
        "--set=rover.kind=rover",
        "--set=rover.visible=yes",
        "--set=rover.heading_deg=180",
        "--set=camera.pitch_deg=-55",
    ];
    run_ok(folder.path(), &words);
    let out = folder.path().join("out");
    let mask = image::open(out.join("semantic_segmentation_0000.png")).expect("a mask").into_luma8();
    let coverage = npy(&out.join("semantic_coverage_0000.npy"));
    let mut sums = [0; 3];
    for (id, shares) in mask.iter().zip(coverage.chunks_exact(3)) {
        let sum: f32 = shares.iter().sum();
        assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)) && sum <= 1.0, "{shares:?}");
        assert!(if *id == 255 { sum <= 0.75 } else { sum >= 0.25 }, "{id}: {shares:?}");
        sums[if sum == 0.0 { 0 } else { 1 + usize::from(sum == 1.0) }] += 1;
    }
    assert!(
        sums.iter().all(|count| *count > 10),
        "pixels of the rover, of its outline, and others: {sums:?}"
    );
}

/// Faces along the axes have normals at the end of what their codes hold. The rover's own frame turns with it, so that a turn by a
/// hundredth of a degree changes only outlines.
#[test]
fn a_visible_rover_along_the_axes_looks_as_one_turned_a_little() {
    for backend in BACKENDS {
        for [along, turned] in [[180.0, 179.99], [90.0, 89.99]] {
            let [along, turned] = [along, turned].map(|heading_deg: f64| {
                let heading = format!("rover.heading_deg={heading_deg}");
                let set = ["camera.pitch_deg=-55", "rover.kind=rover", "rover.visible=yes", &heading];
                render_by(backend, &scene_with(&set), &settings())
            });
            let pixels = along.class.len();
            let other_classes = along.class.iter().zip(&turned.class).filter(|(a, b)| a != b).count();
            let steps = along.rgb.chunks_exact(3).zip(turned.rgb.chunks_exact(3));
            let is_other = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 20);
            let other_colours = steps.filter(is_other).count();
            assert!(
                other_classes <= pixels / 1000 && other_colours <= pixels / 1000,
                "{backend}: {other_classes} classes and {other_colours} colours of {pixels}"
            );
        }
    }
}

#[test]
fn exports_hold_the_rover() {
    let set = ["rover.kind=rover", "terrain.cells=20", "rocks.count=12"];
    let (params, scene) = (params(SEED, &set), scene(SEED, &set));
    let (knobs, settings) = (params.to_json(), RenderSettings::new([64; 2], 1).expect("settings"));
    let bytes = |format| {
        let detail = Detail::Authored;
        let stage = Stage { scene: &scene, seed: SEED, knobs: &knobs, settings: &settings, detail };
        export(&stage, format).expect("exported")
    };
    let text = |format| String::from_utf8_lossy(&bytes(format)).into_owned();
    let parts = scene.rocks.len() - scene.rocks.count();
    assert!(scene.rocks.count() == 12 && parts > 10, "{parts} parts");
    let last = format!("Part_{:02}", parts - 1);
    let usd = text(Format::from_path("a.usda".as_ref()).expect("a format"));
    assert!(usd.contains("def Xform \"Rover\"") && usd.contains(&last) && !usd.contains("Rock_012"));
    let glb = text(Format::from_path("a.glb".as_ref()).expect("a format"));
    assert!(glb.contains("\"Rover\"") && glb.contains(&last) && !glb.contains("Rock_012"));
    let npz = bytes(Format::from_path("a.npz".as_ref()).expect("a format"));
    let of_rover = npz.windows(64).filter(|window| window.iter().all(|byte| *byte == 255)).count();
    let triangles: usize = scene.rocks.iter().skip(12).map(|part| part.triangles(part.level).len()).sum();
    assert!(of_rover >= triangles - 64, "{of_rover} of {triangles} triangles have the class 255");
}

/// Ruts are ground: they lie as deep as said below the ground without them, their label is regolith, and no rock stands in one.
#[test]
fn wheels_press_ruts_into_the_ground_and_go_around_rocks() {
    let sets = ["tracks.count=2", "tracks.depth_m=0.05", "tracks.distance_m=2.5", "tracks.direction_deg=20"];
    let (with, without) = (scene_with(&sets), scene_with(&[]));
    let relief = with.relief.as_ref().expect("a relief");
    assert_eq!(relief.tracks.len(), 2);
    let [mut inside, mut beside] = [Vec::new(), Vec::new()];
    for k in 0..40_000 {
        let offset = Vec2::new((k % 200) as f32, (k / 200) as f32) / 40.0 + Vec2::new(-2.5, 0.5);
        let at = with.terrain.centre + offset;
        let change_m = with.terrain.height_at(at) - without.terrain.height_at(at);
        if relief.tracks.iter().any(|track| track.runs_over(offset, -0.03)) {
            inside.push(change_m);
        } else if !relief.tracks.iter().any(|track| track.is_near(offset, 0.03)) {
            beside.push(change_m);
        }
    }
    let mean = |changes_m: &[f32]| changes_m.iter().sum::<f32>() / changes_m.len() as f32;
    assert!(inside.len() > 1000 && (-0.075..-0.04).contains(&mean(&inside)), "{}", mean(&inside));
    assert!(beside.len() > 1000 && mean(&beside).abs() < 1e-3, "{}", mean(&beside));
    let [before, after] = [&without, &with].map(|scene| render_by(RasterMode::Host, scene, &settings()));
    assert_ne!(before.rgb, after.rgb);
    let ground = |frame: &Frame| frame.count(ClassId::REGOLITH);
    assert!(ground(&before).abs_diff(ground(&after)) <= u64::from(SIDE) / 8, "a skyline moves by little");
    assert_eq!(after.count(ClassId::ROCK), 0);
    let rocks = |more: &[&str]| {
        let scene = scene_with(&[&["rocks.coverage=0.08"], more].concat());
        let standing = |rock: &&regolith::scene::rocks::Rock| {
            let offset = rock.centre.truncate() - scene.terrain.centre;
            2.0 * f64::from(rock.base_scale_m) >= PRESSED_M
                && relief.tracks.iter().any(|track| track.runs_over(offset, 0.0))
        };
        scene.rocks.iter().filter(standing).count()
    };
    let (free, cleared) = (rocks(&[]), rocks(&sets));
    assert!(free > 0 && cleared == 0, "{free} rocks lie where the ruts are, {cleared} in them");
}
