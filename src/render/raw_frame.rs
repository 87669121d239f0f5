//! What the host adds to a frame that was read back: rock labels, sensor, hazard maps.
//! Must not know: a device.

use std::time::Instant;

use crate::frame::{Annotation, Frame};
use crate::render::device::timing::{StageTimes, milliseconds};
use crate::render::frame_packet::FrameRequest;
use crate::render::post;
use crate::scene::Scene;

/// Adds to a frame what is not computed on the device, and the time that each stage took.
pub(crate) fn post_process(frame: &mut Frame, request: &FrameRequest, scene: &Scene, times: &mut StageTimes) {
    let (rendered_scene, rendered) = request.rendered(scene);
    frame.focal_px = rendered_scene.camera.focal_px(rendered.size[0]);
    frame.lens = rendered_scene.camera.lens;
    let mut timed = |stage, work: &mut dyn FnMut(&mut Frame)| {
        let start = Instant::now();
        work(frame);
        times.push((stage, milliseconds(start.elapsed())));
    };
    if rendered.annotations.contains(Annotation::Instances) {
        timed("labels", &mut |frame| {
            frame.rocks = post::rock_labels::rocks(rendered_scene, rendered, request.image.size, frame);
        });
    }
    if let Some(sensor) = &scene.sensor {
        timed("sensor", &mut |frame| {
            post::sensor::expose(frame, sensor, scene.camera.exposure_ev);
            if !request.annotations.contains(Annotation::Hdr) {
                frame.radiance = Vec::new();
            }
        });
    }
    if post::hazards::any_requested(request.annotations) {
        timed("hazards", &mut |frame| post::hazards::add(frame, scene, request.annotations));
    }
}
