//! Tests: devices that offer less than others render the same.

use crate::error::Error;
use crate::frame::plane::{PLANES, Values};
use crate::frame::{Annotations, Frame};
use crate::gpu::{Gpu, Requested};
use crate::params::config::Config;
use crate::render::device::light_table::Transport;
use crate::render::{LightingMode, RasterMode, RasterOptions, RenderSettings, Renderer};
use crate::scene::Scene;

const MODES: [RasterMode; 2] = [RasterMode::Device, RasterMode::Host];

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
    let annotations: Annotations = PLANES.iter().filter_map(|row| row.annotation).collect();
    RenderSettings { annotations, ..RenderSettings::new(size, samples).expect("settings") }
}

fn renderer(requested: Requested, mode: RasterMode) -> Renderer {
    let gpu = Gpu::open_with(Some("cpu"), requested).expect("a device");
    Renderer::with_raster(gpu, mode).expect("a renderer")
}

fn frame(renderer: &mut Renderer, scene: &Scene, settings: &RenderSettings) -> Frame {
    renderer.render(scene, settings).expect("a frame").0
}

/// Checks every bit of every plane, and every label.
fn assert_equal(left: &Frame, right: &Frame, what: &str) {
    for row in &PLANES {
        let [left, right] = [left, right].map(|frame| bytes(frame.plane(row.plane)));
        let differing = left.iter().zip(right.iter()).filter(|(left, right)| left != right).count();
        assert!(left.len() == right.len() && differing == 0, "{what}: {differing} bytes of {}", row.name);
    }
    assert!(left.rocks == right.rocks, "{what}: labels");
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
    for mode in MODES {
        let mut full = renderer(Requested::Offered, mode);
        let mut least = renderer(Requested::Least, mode);
        let features = least.gpu().device.features();
        assert!(features.is_empty(), "{features:?}");
        assert_eq!(least.gpu().device.limits().max_color_attachments, 4);
        for scene in &scenes() {
            for settings in [all_planes([96, 64], 4), RenderSettings::new([64, 64], 16).expect("settings")] {
                let expected = frame(&mut full, scene, &settings);
                assert_equal(&frame(&mut least, scene, &settings), &expected, &mode.to_string());
            }
        }
    }
}

#[test]
fn one_draw_lights_as_shading_bins_do() {
    let mut renderer = renderer(Requested::Offered, RasterMode::Device);
    let own = renderer.raster();
    for scene in &scenes() {
        let settings = all_planes([160, 120], 4);
        let mut frame_with = |lighting| {
            renderer.set_raster(own.with_lighting(lighting, renderer.gpu()).expect("supported"));
            let frame = frame(&mut renderer, scene, &settings);
            (frame, renderer.last_cost().lighting_draws)
        };
        let (by_bins, bins) = frame_with(LightingMode::Bins);
        let (at_once, draws) = frame_with(LightingMode::OneDraw);
        assert!(bins >= 4 && draws == 1, "{bins} bins, {draws} draws");
        assert_equal(&at_once, &by_bins, "one draw");
    }
}

#[test]
fn light_numbers_in_uniforms_are_those_in_varyings() {
    for mode in MODES {
        let [mut varyings, mut uniforms] = [(); 2].map(|()| renderer(Requested::Offered, mode));
        assert_eq!(varyings.lighting.transport, Transport::Varyings, "on a software adapter");
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
    let gpu = Gpu::open_with(Some("cpu"), Requested::Least).expect("a device");
    let refused = |mode, lighting| {
        let options = RasterOptions::new(mode, &gpu).expect("a mode").with_lighting(lighting, &gpu);
        matches!(options, Err(Error::Usage(message)) if message.starts_with("--lighting"))
    };
    assert!(refused(RasterMode::Device, LightingMode::Bins), "without a stencil");
    assert!(refused(RasterMode::Host, LightingMode::OneDraw), "of samples from the host");
    assert!(!refused(RasterMode::Device, LightingMode::OneDraw));
    assert!(!refused(RasterMode::Host, LightingMode::Bins));
}
