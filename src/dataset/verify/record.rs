//! A frame's line against its seed and the configuration.
//!
//! Must not know: files, rendering.

use serde_json::Value;

use super::context::Context;
use super::report::{Report, name};
use crate::dataset::plan::frame_seed;
use crate::meta;
use crate::output::layout::FrameLine;
use crate::params::Knob;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// Checks everything in the line that follows from base seed and configuration. The camera's height is taken from the
/// line, because the camera stands on the ground, which only the scene knows.
pub(super) fn check_record(context: &Context<'_>, line: &FrameLine, report: &mut Report) {
    let index = Some(line.index);
    let seed = frame_seed(context.base_seed, line.index, line.attempt);
    report.expect(name::LOG, index, line.seed == seed, || format!("frames.jsonl: its seed should be {seed}"));
    let params = match context.config.draw(seed) {
        Ok(params) => params,
        Err(error) => return report.problem(name::RECORDS, index, format!("manifest.json: {error}")),
    };
    let eye_m = line.camera["world_from_camera"][2][3].as_f64().unwrap_or_default();
    let camera = meta::camera(&Camera::above(&params, eye_m as f32), context.settings.size);
    let mut expect = |name: &str, recorded: Option<&Value>, expected: &Value| {
        report.expect(name::RECORDS, index, recorded == Some(expected), || {
            let recorded = recorded.unwrap_or(&Value::Null);
            format!("frames.jsonl: {name} should be {expected}, recorded is {recorded}")
        });
    };
    expect("stage", Some(&line.stage.as_str().into()), &params.text(Knob::StageName).into());
    expect("coverage.unlabelled", line.coverage.get("unlabelled"), &0.0.into());
    for (key, value) in &params.to_json() {
        expect(&format!("knobs.{key}"), line.knobs.get(key), value);
    }
    let sections = [("camera", &line.camera, camera), ("sun", &line.sun, meta::sun(&Sun::build(&params)))];
    for (section, recorded, expected) in sections {
        for (key, value) in expected.as_object().into_iter().flatten() {
            expect(&format!("{section}.{key}"), recorded.get(key), value);
        }
    }
}
