//! Tests: devices that offer less than others render the same.

use half::f16;

use crate::error::Error;
use crate::frame::Frame;
use crate::frame::plane::{PLANES, Plane, Values, every_annotation};
use crate::gpu::adapter::{self, adapter_of_tests};
use crate::gpu::{Gpu, Requested};
use crate::params::config::Config;
use crate::render::device::light_table::Transport;
use crate::render::tiling::TileLimits;
use crate::render::{LightingMode, RasterMode, RasterOptions, RenderSettings, Renderer};
use crate::scene::Scene;

/// The modes that every device supports.
const MODES: [RasterMode; 2] = [RasterMode::Device, RasterMode::Host];
/// All.
const ALL_MODES: [RasterMode; 3] = [RasterMode::Device, RasterMode::Compute, RasterMode::Host];

fn scene(seed: u64, set: &[&str]) -> Scene {
    let mut config = Config::new();
    for assignment in set {
        config.apply_set(assignment).expect("a knob");
    }
    Scene::build(seed, &config.draw(seed).expect("parameters")).expect("a scene")
}

/// Both stages, in which every shading bin has samples: sky with stars, rocks, ground of several relief bands.
fn scenes() -> [Scene; 2] {
    [
        scene(4, &["camera.pitch_deg=5", "sky.star_count=40"]),
        scene(11, &["stage.name=surface", "sun.elevation_deg=9"]),
    ]
}

/// Settings with every annotation.
fn all_planes(size: [u32; 2], samples: u32) -> RenderSettings {
    let annotations = every_annotation();
    RenderSettings { annotations, ..RenderSettings::new(size, samples).expect("settings") }
}

fn renderer(requested: Requested, mode: RasterMode) -> Renderer {
    let gpu = Gpu::open_with(Some(&adapter_of_tests()), requested).expect("a device");
    Renderer::with_raster(gpu, mode).expect("a renderer")
}

fn frame(renderer: &mut Renderer, scene: &Scene, settings: &RenderSettings) -> Frame {
    renderer.render(scene, settings).expect("a frame").0
}

/// Fraction of the bytes of colour, and of those of sun occlusion, that may differ by a step.
const MAX_DIFFERING_SHARE: f64 = 0.005;

/// Checks every bit of every plane, and every label.
fn assert_equal(left: &Frame, right: &Frame, what: &str) {
    compare(left, right, what, 0.0);
}

/// The same of frames by other programs, which round differently in the last bit: textures of a millimetre magnify it. A step of a byte of
/// colour, or of sun occlusion, is allowed, in few of them.
fn assert_equal_but_for_rounding(left: &Frame, right: &Frame, what: &str) {
    compare(left, right, what, MAX_DIFFERING_SHARE);
}

fn compare(left: &Frame, right: &Frame, what: &str, max_share: f64) {
    for row in &PLANES {
        let [left, right] = [left, right].map(|frame| bytes(frame.plane(row.plane)));
        let differing = left.iter().zip(right.iter()).filter(|(left, right)| left != right).count();
        let most =
            left.iter().zip(right.iter()).map(|(left, right)| left.abs_diff(*right)).max().unwrap_or(0);
        let is_right = match row.plane {
            Plane::Rgb | Plane::SunOcclusion => {
                most <= 1 && differing as f64 <= max_share * left.len() as f64
            }
            // Its last bits round too: `assert_radiance_is_close`.
            Plane::Radiance => differing == 0 || max_share > 0.0,
            _ => differing == 0,
        };
        assert!(
            left.len() == right.len() && is_right,
            "{what}: {differing} of {} bytes of {}, by {most} at most",
            left.len(),
            row.name
        );
    }
    assert!(left.rocks == right.rocks, "{what}: labels");
    assert_radiance_is_close(left, right, what, max_share);
}

/// Most by which values of radiance may differ, as a fraction of the larger, but for a share of them.
const MAX_RADIANCE_ERROR: f32 = 0.01;

/// Checks radiance, of which colour shows little in shadows and where it is clipped.
fn assert_radiance_is_close(left: &Frame, right: &Frame, what: &str, max_share: f64) {
    let is_off = |(left, right): (&f16, &f16)| {
        let [left, right] = [left, right].map(|radiance| radiance.to_f32());
        let is_close = (left - right).abs() <= MAX_RADIANCE_ERROR * left.max(right);
        !is_close
    };
    let off = left.radiance.iter().zip(&right.radiance).filter(|pair| is_off(*pair)).count();
    assert!(
        off as f64 <= max_share * left.radiance.len() as f64,
        "{what}: {off} of {} values of radiance differ by more than {MAX_RADIANCE_ERROR}",
        left.radiance.len()
    );
}

fn bytes(values: Values<'_>) -> &[u8] {
    match values {
        Values::U8(values) => values,
        Values::U16(values) => bytemuck::cast_slice(values),
        Values::F16(values) => bytemuck::cast_slice(half::slice::HalfFloatSliceExt::reinterpret_cast(values)),
        Values::F32(values) => bytemuck::cast_slice(values),
    }
}

#[test]
fn the_least_device_renders_what_any_other_does() {
    // A narrow view has more of the finer grids of the horizon map, which would not fit into the side of a texture one below the other.
    let narrow = scene(3, &["stage.name=surface", "camera.fov_deg=8"]);
    for mode in MODES {
        let mut full = renderer(Requested::Offered, mode);
        let mut least = renderer(Requested::Least, mode);
        let features = least.gpu().device.features();
        assert!(features.is_empty(), "{features:?}");
        assert_eq!(least.gpu().device.limits().max_color_attachments, 4);
        for scene in scenes().iter().chain([&narrow]) {
            for settings in [all_planes([96, 64], 4), RenderSettings::new([64, 64], 16).expect("settings")] {
                let expected = frame(&mut full, scene, &settings);
                assert_equal_but_for_rounding(
                    &frame(&mut least, scene, &settings),
                    &expected,
                    &mode.to_string(),
                );
            }
        }
    }
}

/// Shadows of large images, or of many rocks, would take more texels than the textures of such a device have: they are coarser there.
#[test]
fn shadow_maps_fit_into_the_textures_of_the_least_device() {
    let scenes = [scene(3, &[]), scene(1, &["stage.name=surface", "rocks.coverage=0.08"])];
    let settings = all_planes([800, 600], 1);
    for mode in MODES {
        let mut full = renderer(Requested::Offered, mode);
        let mut least = renderer(Requested::Least, mode);
        let map_px = |renderer: &Renderer| {
            let map = renderer.shadow.map().texture();
            [map.width(), map.height()]
        };
        let mut largest_px = 0;
        // The second of equal frames finds the tiles of the first in the map.
        for scene in scenes.iter().chain([&scenes[1]]) {
            let [expected, found] = [&mut full, &mut least].map(|renderer| frame(renderer, scene, &settings));
            assert!(map_px(&least).into_iter().all(|side| side <= 2048), "{mode}: {:?}", map_px(&least));
            largest_px = map_px(&full).into_iter().fold(largest_px, u32::max);
            let is_label = |plane| !matches!(plane, Plane::Rgb | Plane::Radiance | Plane::SunOcclusion);
            for row in PLANES.iter().filter(|row| is_label(row.plane)) {
                let [found, expected] = [&found, &expected].map(|frame| bytes(frame.plane(row.plane)));
                assert!(found == expected, "{mode}: {}", row.name);
            }
            let off = found.sun_occlusion.iter().zip(&expected.sun_occlusion);
            let off = off.filter(|(found, expected)| found.abs_diff(**expected) > 64).count();
            assert!(off * 100 < found.class.len(), "{mode}: {off} pixels of shadow");
        }
        assert!(largest_px > 2048, "{mode}: the maps of these scenes are not too large");
    }
}

#[test]
fn one_draw_and_a_compute_pass_light_as_shading_bins_do() {
    let mut renderer = renderer(Requested::Offered, RasterMode::Device);
    let own = renderer.raster();
    let low_sun =
        ["stage.name=surface", "sun.elevation_deg=6", "sun.relative_azimuth_deg=5", "camera.pitch_deg=2"];
    // A lens needs textures that are larger than the frame.
    let distorted = ["stage.name=surface", "camera.k1=-0.1"];
    for scene in scenes().iter().chain([&scene(12, &low_sun), &scene(4, &distorted)]) {
        let settings = all_planes([160, 120], 4);
        let mut frame_with = |lighting| {
            renderer.set_raster(own.with_lighting(lighting, renderer.gpu()).expect("supported"));
            let frame = frame(&mut renderer, scene, &settings);
            (frame, renderer.last_cost().lighting_draws)
        };
        let (by_bins, bins) = frame_with(LightingMode::Bins);
        let (at_once, draws) = frame_with(LightingMode::OneDraw);
        let (computed, none) = frame_with(LightingMode::Compute);
        assert!(bins >= 4 && (draws, none) == (1, 0), "{bins} bins, {draws} draws, {none} draws");
        assert_equal_but_for_rounding(&at_once, &by_bins, "one draw");
        assert_equal_but_for_rounding(&computed, &at_once, "a compute pass");
    }
}

/// As on GPUs, and in a compute pass as on NVIDIA's Hopper.
#[test]
fn what_compute_passes_rasterise_is_lit_by_a_draw_or_a_compute_pass() {
    let mut renderer = renderer(Requested::Offered, RasterMode::Compute);
    let own = renderer.raster();
    assert!(own.lighting == LightingMode::OneDraw || adapter::is_hopper(&renderer.gpu().info));
    let bins = own.with_lighting(LightingMode::Bins, renderer.gpu());
    assert!(matches!(bins, Err(Error::Usage(message)) if message.starts_with("--lighting bins")));
    for scene in &scenes() {
        let settings = all_planes([96, 64], 4);
        let mut frame_with = |lighting| {
            renderer.set_raster(own.with_lighting(lighting, renderer.gpu()).expect("supported"));
            frame(&mut renderer, scene, &settings)
        };
        let [computed, drawn] = [LightingMode::Compute, LightingMode::OneDraw].map(&mut frame_with);
        assert_equal_but_for_rounding(&drawn, &computed, "one draw");
    }
}

/// Which stores fewer planes at a time.
#[test]
fn the_least_device_lights_in_a_compute_pass_too() {
    let [mut full, mut least] = [Requested::Offered, Requested::Least].map(|requested| {
        let mut renderer = renderer(requested, RasterMode::Device);
        let options = renderer.raster().with_lighting(LightingMode::Compute, renderer.gpu());
        renderer.set_raster(options.expect("supported"));
        renderer
    });
    for scene in &scenes() {
        for settings in [all_planes([96, 64], 4), RenderSettings::new([64, 64], 16).expect("settings")] {
            let expected = frame(&mut full, scene, &settings);
            assert_equal_but_for_rounding(
                &frame(&mut least, scene, &settings),
                &expected,
                "the least device",
            );
        }
    }
}

/// On drivers that have both ways: others never take varyings.
#[test]
fn light_numbers_in_uniforms_are_those_in_varyings() {
    for mode in MODES {
        let [mut varyings, mut uniforms] = [(); 2].map(|()| renderer(Requested::Offered, mode));
        if varyings.lighting.transport == Transport::Uniforms {
            let version = adapter::mesa_version(&varyings.gpu().info);
            assert!(version.is_none_or(|major| major >= 25), "Mesa {version:?}");
            continue;
        }
        uniforms.lighting.transport = Transport::Uniforms;
        for scene in &scenes() {
            let settings = all_planes([96, 64], 4);
            let expected = frame(&mut varyings, scene, &settings);
            assert_equal(&frame(&mut uniforms, scene, &settings), &expected, &mode.to_string());
        }
    }
}

#[test]
fn lighting_that_a_device_cannot_draw_is_refused() {
    let gpu = Gpu::open_with(Some(&adapter_of_tests()), Requested::Least).expect("a device");
    let refused = |mode, lighting| {
        let options = RasterOptions::new(mode, &gpu).expect("a mode").with_lighting(lighting, &gpu);
        matches!(options, Err(Error::Usage(message)) if message.starts_with("--lighting"))
    };
    assert!(refused(RasterMode::Device, LightingMode::Bins), "without a stencil");
    assert!(refused(RasterMode::Host, LightingMode::OneDraw), "of samples from the host");
    assert!(refused(RasterMode::Host, LightingMode::Compute), "of samples from the host");
    let computed = RasterOptions::new(RasterMode::Compute, &gpu);
    assert!(matches!(computed, Err(Error::Usage(message)) if message.starts_with("--raster compute")));
    assert!(!refused(RasterMode::Device, LightingMode::OneDraw));
    assert!(!refused(RasterMode::Host, LightingMode::Bins));
}

/// Three columns and several rows of tiles, with and without a lens.
#[test]
fn tiles_make_the_frame_that_is_drawn_whole() {
    for mode in ALL_MODES {
        let mut renderer = renderer(Requested::Offered, mode);
        let whole = renderer.tile_limits;
        let lens = ["camera.k1=-0.12", "camera.p1=0.004"];
        let [nominal, surface] = scenes();
        let distorted = scene(4, &[&["camera.pitch_deg=5"][..], &lens].concat());
        for (scene, size, samples) in [
            (&nominal, [101, 75], 4),
            (&surface, [96, 70], 4),
            (&distorted, [90, 61], 4),
            (&surface, [48, 40], 16),
        ] {
            let settings = all_planes(size, samples);
            renderer.tile_limits = whole;
            let expected = frame(&mut renderer, scene, &settings);
            let side_samples = size[0] * settings.samples_per_side / 2 - 3;
            renderer.tile_limits = TileLimits { bytes: 400_000, side_samples };
            let tiled = frame(&mut renderer, scene, &settings);
            match mode {
                RasterMode::Device => assert_close(&tiled, &expected, &format!("{size:?}")),
                _ => assert_equal(&tiled, &expected, &format!("{size:?}")),
            }
        }
    }
}

/// Labels and colours of a frame do not depend on the outputs that are asked for besides, also where these need more memory than one tile
/// may have: a device rounds the corners of triangles relative to the tile.
#[test]
fn labels_do_not_depend_on_what_else_is_asked_for() {
    let [_, scene] = scenes();
    let (size, samples) = ([96, 70], 4);
    for mode in ALL_MODES {
        let mut renderer = renderer(Requested::Offered, mode);
        for bytes in [700_000, 1_000_000, 1_300_000, 1_600_000, 2_000_000] {
            renderer.tile_limits.bytes = bytes;
            let few = frame(&mut renderer, &scene, &RenderSettings::new(size, samples).expect("settings"));
            let every = frame(&mut renderer, &scene, &all_planes(size, samples));
            assert!(few.class == every.class && few.rgb == every.rgb, "{mode}: {bytes} bytes a tile");
        }
    }
}

/// And where one frame is in flight at a time, the buffers of its tiles serve the next.
#[test]
fn a_frame_in_tiles_has_the_times_of_a_whole_one() {
    for mode in ALL_MODES {
        let mut renderer = renderer(Requested::Offered, mode);
        renderer.expect_in_flight(1);
        let [scene, _] = scenes();
        let settings = all_planes([90, 61], 4);
        let mut stages = |bytes| {
            renderer.tile_limits.bytes = bytes;
            // The first frame compiles pipelines.
            let [_, (_, times)] = [(); 2].map(|()| renderer.render(&scene, &settings).expect("a frame"));
            let total_ms: f64 = times.iter().map(|(_, ms)| ms).sum();
            assert!(times.iter().all(|(_, ms)| *ms >= 0.0) && total_ms > 0.0, "{mode}: {times:?}");
            (times.iter().map(|(stage, _)| *stage).collect::<Vec<_>>(), renderer.slots.len())
        };
        let (mut whole, slots) = stages(640 << 20);
        let (mut in_tiles, slots_with_tiles) = stages(400_000);
        whole.sort_unstable();
        in_tiles.sort_unstable();
        assert_eq!(whole, in_tiles, "{mode}");
        assert!(
            ["lighting", "resolve", "gpu", "readback"].iter().all(|stage| whole.contains(stage)),
            "{whole:?}"
        );
        let is_kept = mode == RasterMode::Host && renderer.gpu().capabilities.software_adapter;
        assert_eq!([slots, slots_with_tiles], [1, 1 + usize::from(is_kept)], "{mode}");
    }
}

/// A device rounds the corners of triangles and what it interpolates relative to the tile: where the host rasterises every bit is that
/// of the whole frame, else nearly every value.
fn assert_close(tiled: &Frame, whole: &Frame, what: &str) {
    let differing = |plane: Plane| {
        let [tiled, whole] = [tiled, whole].map(|frame| bytes(frame.plane(plane)));
        assert_eq!(tiled.len(), whole.len(), "{what}: {plane:?}");
        tiled.iter().zip(whole).filter(|(tiled, whole)| tiled != whole).count()
    };
    let found =
        [Plane::Class, Plane::Instances, Plane::Rgb, Plane::SunOcclusion, Plane::SampleCounts].map(differing);
    let pixels = tiled.class.len();
    let most = [pixels / 2000, pixels / 1000, pixels / 100, pixels / 200, pixels / 500];
    let is_within = found.iter().zip(most).all(|(found, most)| *found <= most);
    assert!(
        is_within,
        "{what}: {found:?} values of class, instance, colour, shadow and coverage, of {pixels} pixels"
    );
    let beyond =
        tiled.rgb.iter().zip(&whole.rgb).filter(|(tiled, whole)| tiled.abs_diff(**whole) > 3).count();
    assert!(beyond <= pixels / 1000, "{what}: {beyond} values of colour by more than 3 steps");
}

#[test]
fn a_frame_beyond_the_guard_band_is_refused() {
    let mut renderer = renderer(Requested::Offered, RasterMode::Host);
    let [scene, _] = scenes();
    let settings = RenderSettings::new([9000, 100], 16).expect("settings");
    let error = renderer.render(&scene, &settings).expect_err("too large");
    assert!(matches!(error, Error::SizeBeyondDevice { .. }), "{error}");
    assert!(error.to_string().contains("36000 samples"), "{error}");
}

#[test]
fn frames_of_two_sizes_in_turn_find_their_textures_again() {
    for mode in MODES {
        let mut renderer = renderer(Requested::Offered, mode);
        let [scene, _] = scenes();
        let settings = [all_planes([80, 64], 4), RenderSettings::new([48, 40], 4).expect("settings")];
        let alone = settings.map(|settings| frame(&mut renderer, &scene, &settings));
        let mut first = renderer.gbuffers.textures();
        for _ in 0..2 {
            for (settings, alone) in settings.iter().zip(&alone) {
                assert_equal(&frame(&mut renderer, &scene, settings), alone, "again");
            }
        }
        let mut later = renderer.gbuffers.textures();
        assert_eq!((first.len(), renderer.slots.len()), (2, 2));
        for list in [&mut first, &mut later] {
            list.sort_by_key(wgpu::Texture::width);
        }
        assert!(first == later, "{mode}: textures were made again");
        // They give way to what needs their room.
        renderer.tile_limits.bytes = 2_000_000;
        frame(&mut renderer, &scene, &all_planes([96, 80], 4));
        assert_eq!(renderer.gbuffers.textures().len(), 2, "{mode}");
    }
}

/// Frames of different lenses have different sizes, share textures that are larger than they need, and have the bytes of frames that
/// are drawn alone.
#[test]
fn frames_of_different_lenses_share_textures() {
    for mode in MODES {
        let lens = |k1: &str, pitch: &str| scene(4, &["stage.name=surface", k1, pitch]);
        let scenes = [
            lens("camera.k1=-0.01", "camera.pitch_deg=-30"),
            lens("camera.k1=-0.15", "camera.pitch_deg=4"),
            lens("camera.k1=-0.05", "camera.pitch_deg=-8"),
        ];
        let settings = all_planes([80, 64], 4);
        let alone = scenes.each_ref().map(|scene| {
            let mut fresh = renderer(Requested::Offered, mode);
            frame(&mut fresh, scene, &settings);
            frame(&mut fresh, scene, &settings)
        });
        let mut shared = renderer(Requested::Offered, mode);
        // The first frame is lit by general pipelines.
        frame(&mut shared, &scenes[0], &settings);
        let mut textures = Vec::new();
        for round in 0..2 {
            for (scene, alone) in scenes.iter().zip(&alone) {
                assert_equal(&frame(&mut shared, scene, &settings), alone, "in turn");
                if round == 0 {
                    textures = shared.gbuffers.textures();
                }
                let is_known = |texture: &wgpu::Texture| textures.contains(texture);
                assert!(shared.gbuffers.textures().iter().all(is_known), "{mode}: made again");
            }
        }
    }
}
