//! Tests of frames that fail. Those that lose a draw between preparation and recording: no sample gets a value that no draw wrote. And those
//! for which the device lacks a resource: the frames before and after them are whole.

use std::time::Instant;

use super::{FramePacket, LightingMode, RasterMode, RasterOptions, RenderSettings, Renderer};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::gpu::adapter::adapter_of_tests;
use crate::params::config::Config;
use crate::render::device::shading_bins::LightingVariant;
use crate::render::lighting::gbuffer::GBuffer;
use crate::render::select::draw_list::DrawBatch;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::visibility::VisibilityBackend;
use crate::scene::Scene;

const SIZE: [u32; 2] = [96, 64];

/// A frame whose G-buffer a fault has changed before it is recorded.
fn render_with(
    renderer: &mut Renderer,
    scene: &Scene,
    samples: u32,
    fault: impl FnOnce(&mut GBuffer),
) -> Result<Frame> {
    let settings = RenderSettings::new(SIZE, samples).expect("settings");
    let FramePacket { request, plan, plan_ms, .. } = renderer.planner().plan(scene, &settings)?;
    let mut frame = renderer.prepare(scene, &request, (plan, None))?;
    fault(&mut frame.gbuffer);
    let in_flight = renderer.submit_prepared(scene, request, frame, (Instant::now(), plan_ms))?;
    Ok(renderer.finish(in_flight, scene)?.0)
}

/// Rasterises as a mode says, and lights each shading bin with a draw of its own.
fn light_by_bins(renderer: &mut Renderer, mode: RasterMode) {
    let options = RasterOptions::new(mode, renderer.gpu()).expect("a mode");
    renderer.set_raster(options.with_lighting(LightingMode::Bins, renderer.gpu()).expect("a stencil"));
}

/// Asserts that a frame is refused, with as many pixels as `expected` allows.
fn assert_refused(what: &str, result: Result<Frame>, expected: impl Fn(u64) -> bool) {
    match result {
        Err(Error::Unlabelled { pixels, column, row, .. }) => {
            assert!(expected(pixels), "{what}: {pixels} pixels");
            assert!(column < SIZE[0] && row < SIZE[1], "{what}: {column}, {row}");
        }
        Err(other) => panic!("{what}: {other}"),
        Ok(_) => panic!("{what}: the frame passed"),
    }
}

#[test]
fn a_frame_that_loses_a_draw_is_refused_by_both_backends() {
    let mut renderer =
        Renderer::new(Gpu::open(Some(&adapter_of_tests())).expect("an adapter")).expect("a renderer");
    let mut lost = [0; 2];
    for (set, samples) in [("stage.name=surface", 1), ("camera.k1=-0.1", 4)] {
        let mut config = Config::new();
        config.apply_set(set).expect("a setting");
        let scene = Scene::build(5, &config.draw(5).expect("parameters")).expect("a scene");
        for (index, mode) in [RasterMode::Host, RasterMode::Device].into_iter().enumerate() {
            light_by_bins(&mut renderer, mode);
            let mut batches = Vec::new();
            // The second frame is binned by what shades it.
            for _ in 0..2 {
                let whole = render_with(&mut renderer, &scene, samples, |gbuffer| {
                    batches.clone_from(&gbuffer.batches);
                });
                whole.expect("a frame that lost nothing");
            }
            assert!(batches.iter().any(|batch| batch.variant == LightingVariant::Sky), "the dome has a draw");
            for (batch, DrawBatch { variant, .. }) in batches.iter().enumerate() {
                let what = format!("{set}, {mode}, without batch {batch}, {variant:?}");
                // The lighting draw of a batch covers nothing: what it should have lit is unwritten.
                let unlit = render_with(&mut renderer, &scene, samples, |gbuffer| {
                    gbuffer.batches[batch].bounds = ScreenBounds::EMPTY;
                });
                // A batch may have no sample, as that of stars behind a hill.
                if unlit.is_err() {
                    assert_refused(&what, unlit, |pixels| pixels > 0);
                    lost[index] += 1;
                }
            }
            let nothing = render_with(&mut renderer, &scene, samples, |gbuffer| gbuffer.batches.clear());
            assert_refused(&format!("{set}, {mode}, without batches"), nothing, |pixels| {
                pixels == u64::from(SIZE[0] * SIZE[1])
            });
        }
    }
    let scene = Scene::build(5, &Config::new().draw(5).expect("parameters")).expect("a scene");
    for lighting in [LightingMode::OneDraw, LightingMode::Compute] {
        let options = renderer.raster().with_lighting(lighting, renderer.gpu());
        renderer.set_raster(options.expect("a mode"));
        render_with(&mut renderer, &scene, 4, |_| ()).expect("a frame that lost nothing");
        let nothing = render_with(&mut renderer, &scene, 4, |gbuffer| gbuffer.batches.clear());
        let what = format!("{}, without batches", lighting.name());
        assert_refused(&what, nothing, |pixels| pixels == u64::from(SIZE[0] * SIZE[1]));
    }
    assert!(lost.iter().all(|&lost| lost >= 6), "{lost:?}");
}

/// Draws of the sky come last.
#[test]
fn a_frame_that_loses_triangles_of_a_compute_pass_is_refused() {
    let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
    let mut renderer = Renderer::with_raster(gpu, RasterMode::Compute).expect("a renderer");
    let scene = Scene::build(5, &Config::new().draw(5).expect("parameters")).expect("a scene");
    render_with(&mut renderer, &scene, 4, |_| ()).expect("a frame that lost nothing");
    let all = u64::from(SIZE[0] * SIZE[1]);
    for rows in [0, 1] {
        let settings = RenderSettings::new(SIZE, 4).expect("settings");
        let FramePacket { request, plan, plan_ms, .. } =
            renderer.planner().plan(&scene, &settings).expect("a plan");
        let frame = renderer.prepare(&scene, &request, (plan, None)).expect("prepared");
        let VisibilityBackend::Compute(pass) = &mut renderer.visibility else { panic!("a compute pass") };
        pass.groups.lose(rows);
        let submitted = renderer.submit_prepared(&scene, request, frame, (Instant::now(), plan_ms));
        let result = submitted.and_then(|in_flight| renderer.finish(in_flight, &scene));
        assert_refused(&format!("{rows} rows"), result.map(|(frame, _)| frame), |pixels| {
            if rows == 0 { pixels == all } else { pixels > 0 && pixels < all }
        });
    }
}

/// Of four samples, one that is unwritten suffices.
#[test]
fn a_pixel_with_one_unwritten_sample_is_unlabelled() {
    let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
    // The host resolves one of all tiles that show nothing but the dome.
    let mut renderer = Renderer::new(gpu).expect("a renderer");
    light_by_bins(&mut renderer, RasterMode::Device);
    let scene = Scene::build(5, &Config::new().draw(5).expect("parameters")).expect("a scene");
    for samples in [4, 16] {
        // All lighting draws leave out the last column of samples.
        let cut = render_with(&mut renderer, &scene, samples, |gbuffer| {
            let [width, height] = gbuffer.sample_size.map(|side| side as i32);
            for batch in &mut gbuffer.batches {
                batch.bounds = ScreenBounds::of_samples((0, width - 3), (0, height));
            }
        });
        assert_refused(&format!("{samples} samples"), cut, |pixels| pixels == u64::from(SIZE[1]));
    }
}

/// A texture that is destroyed is as unusable as one that there was no memory for.
#[test]
fn a_frame_after_an_error_of_the_device_is_whole() {
    let scene = Scene::build(5, &Config::new().draw(5).expect("parameters")).expect("a scene");
    let settings = RenderSettings::new(SIZE, 4).expect("settings");
    for mode in [RasterMode::Host, RasterMode::Device, RasterMode::Compute] {
        let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
        let mut renderer = Renderer::with_raster(gpu, mode).expect("a renderer");
        let (whole, _) = renderer.render(&scene, &settings).expect("a frame");
        let without_samples = RenderSettings { samples_per_side: 0, ..settings };
        assert!(matches!(renderer.render(&scene, &without_samples), Err(Error::Usage(_))), "{mode}");
        renderer.shadow.map().texture().destroy();
        let failed = renderer.render(&scene, &settings);
        assert!(matches!(failed, Err(Error::Device(_))), "{mode}: {failed:?}");
        for _ in 0..2 {
            let (frame, _) = renderer.render(&scene, &settings).expect("a frame after an error");
            assert!(frame == whole, "{mode}");
        }
    }
}

#[test]
fn an_error_is_that_of_the_frame_that_failed_and_of_no_other_in_flight() {
    let gpu = Gpu::open(Some(&adapter_of_tests())).expect("an adapter");
    let mut renderer = Renderer::new(gpu).expect("a renderer");
    let scene = Scene::build(5, &Config::new().draw(5).expect("parameters")).expect("a scene");
    let settings = RenderSettings::new(SIZE, 4).expect("settings");
    let (whole, _) = renderer.render(&scene, &settings).expect("a frame");
    let in_flight = renderer.submit(&scene, &settings).expect("submitted");
    let FramePacket { request, plan, plan_ms, .. } =
        renderer.planner().plan(&scene, &settings).expect("a plan");
    let frame = renderer.prepare(&scene, &request, (plan, None)).expect("prepared");
    frame.slot.packed.buffer.destroy();
    let failed = renderer.submit_prepared(&scene, request, frame, (Instant::now(), plan_ms));
    assert!(matches!(failed, Err(Error::Device(_))), "{failed:?}");
    let (frame, _) = renderer.finish(in_flight, &scene).expect("the frame before it");
    assert!(frame == whole);
}
