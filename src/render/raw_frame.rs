//! A frame in flight, and a frame as it was read back, before the stages that the host adds: rock labels, sensor, label rule, hazard maps.
//! Must not know: a device.

use std::time::Instant;

use crate::frame::{Annotation, Frame, ImageExposure};
use crate::render::device::timing::{StageTimes, milliseconds};
use crate::render::frame_packet::FrameRequest;
use crate::render::post;
use crate::render::post::sun_glare::SunGlare;
use crate::render::slots::Submission;
use crate::scene::Scene;

/// How much was drawn and uploaded for a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCost {
    /// Triangles that were rasterised for visibility.
    pub drawn_triangles: u64,
    /// Draws of the lighting pass: one for each shading bin that is visible, or one for all.
    pub lighting_draws: usize,
    /// Bytes that were uploaded.
    pub uploaded_bytes: u64,
    /// Bytes that were read back, of all tiles.
    pub readback_bytes: u64,
}

/// A frame that the device works on: from [`Renderer::submit`](super::Renderer::submit) to
/// [`Renderer::finish`](super::Renderer::finish).
#[derive(Debug)]
pub struct InFlight {
    pub(crate) request: FrameRequest,
    pub(crate) submission: Submission,
    /// Times of the stages up to the submission.
    pub(crate) times: StageTimes,
    /// How much was drawn and uploaded for it.
    pub cost: FrameCost,
}

/// A frame that was read back and is still to be post-processed, on any thread.
#[derive(Debug)]
pub struct RawFrame {
    pub(crate) frame: Frame,
    pub(crate) request: FrameRequest,
    pub(crate) times: StageTimes,
}

impl RawFrame {
    /// The finished frame of `scene`, whose frame it is, and the milliseconds of each stage.
    #[must_use]
    pub fn post_process(self, scene: &Scene) -> (Frame, StageTimes) {
        let Self { mut frame, request, mut times } = self;
        let (rendered_scene, rendered) = request.rendered(scene);
        frame.focal_px = rendered_scene.camera.focal_px(rendered.size[0]);
        frame.lens = rendered_scene.camera.lens;
        frame.samples = rendered.samples_per_side * rendered.samples_per_side;
        let mut timed = |frame: &mut Frame, stage, work: &mut dyn FnMut(&mut Frame)| {
            let start = Instant::now();
            work(frame);
            times.push((stage, milliseconds(start.elapsed())));
        };
        if request.annotations.contains(Annotation::Instances) {
            timed(&mut frame, "labels", &mut |frame| {
                frame.rocks = post::rock_labels::rocks(rendered_scene, rendered, request.image.size, frame);
            });
        }
        frame.exposure = ImageExposure { ev: scene.camera.exposure_ev, black: 0.0, white: 1.0 };
        let (mut exposure, mut sun) = (None, None);
        if let Some(sensor) = &scene.sensor {
            timed(&mut frame, "sensor", &mut |frame| {
                sun = SunGlare::take(frame, scene);
                let made = post::sensor::expose(frame, sensor, scene.camera.exposure_ev, sun.as_ref());
                let [black, white] = made.codes.light;
                frame.exposure = ImageExposure { ev: libm::log2f(made.gain), black, white };
                exposure = Some(made);
            });
        }
        if scene.label_rule.needs_instances() {
            timed(&mut frame, "label_policy", &mut |frame| {
                post::label_policy::apply(rendered_scene, rendered, frame, exposure.as_ref());
                if !request.annotations.contains(Annotation::Instances) {
                    frame.instances = Vec::new();
                }
            });
        }
        if scene.sensor.is_some() && !request.annotations.contains(Annotation::Hdr) {
            frame.radiance = Vec::new();
        } else if let Some(sun) = &sun {
            sun.restore(&mut frame);
        }
        if scene.rocks.built().any(|body| !body.body.is_rock() && body.body.is_visible()) {
            post::hardware::ignore(&mut frame);
        }
        if post::hazards::any_requested(request.annotations) {
            timed(&mut frame, "hazards", &mut |frame| post::hazards::add(frame, scene, request.annotations));
        }
        (frame, times)
    }
}
