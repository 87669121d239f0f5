//! A frame's line against its seed and the configuration.
//!
//! Every key has a rule: it follows from index, seed and configuration; or from the frame's files, which other checks compare
//! with it; or from the scene, which only a new rendering knows; or it says where and how fast the frame was rendered and is
//! free (`adapter`, `raster`, `ms`). The digest covers all but `ms`.
//! Must not know: files, rendering.

use serde_json::{Map, Value, json};

use super::context::{Context, Version};
use super::differences::{Difference, differences};
use super::report::{Report, Subject, name};
use super::templates::ExpectedFrame;
use crate::class::ClassId;
use crate::dataset::plan::frame_seed;
use crate::frame::ImageExposure;
use crate::meta;
use crate::output::edges::EdgePolicy;
use crate::output::layout::FrameLine;
use crate::params::{Knob, Params};
use crate::render::RasterOptions;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// Hexadecimal digits of a hash.
const HASH_DIGITS: usize = 32;
/// Keys that say which frame it is.
const POSITION_KEYS: [&str; 5] = ["index", "split", "attempt", "redrawn", "seed"];

/// Checks every key of a line. `number` is that of the line in `frames.jsonl`, from 1.
pub(super) fn check_record(
    context: &Context<'_>,
    line: &FrameLine,
    number: u64,
    frame: &ExpectedFrame,
    report: &mut Report,
) {
    report.look(name::LOG);
    report.look(name::RECORDS);
    let subject = Subject::Line(line.index);
    if context.version == Version::Other {
        return;
    }
    let mut found = list_problems(context, line);
    // An attempt that is beyond the limit has no seed.
    if found.iter().all(|difference| difference.key != "attempt") {
        let seed = frame_seed(context.plan.base_seed, line.index, line.attempt);
        match context.plan.config.draw(seed) {
            Ok(params) => {
                let expected = expected_line(context, line, seed, &params, frame);
                found.extend(differences(&json!(line), &json!(expected)));
            }
            Err(error) => return report.problem(name::RECORDS, subject, format!("manifest.json: {error}")),
        }
    }
    for Difference { key, text } in found {
        let top = key.split(['.', '[']).next().unwrap_or_default();
        let check = if POSITION_KEYS.contains(&top) { name::LOG } else { name::RECORDS };
        report.problem(check, subject, format!("frames.jsonl, line {number}: {text}"));
    }
}

/// The line as it should be. What only files or the scene know is as recorded.
fn expected_line(
    context: &Context<'_>,
    line: &FrameLine,
    seed: u64,
    params: &Params,
    frame: &ExpectedFrame,
) -> FrameLine {
    let size = context.plan.settings.size;
    // The camera stands on the ground, whose height only the scene knows.
    let eye_m = line.camera["world_from_camera"][2][3].as_f64().unwrap_or_default();
    let fraction = |class: &str| Value::from(line.coverage_of(class).unwrap_or_default());
    let mut coverage: Map<String, Value> =
        ClassId::ALL.iter().map(|class| (class.name.to_owned(), fraction(class.name))).collect();
    coverage.insert("unlabelled".to_owned(), 0.0.into());
    coverage.extend(["ignored", "too_small", "unseen"].map(|name| (name.to_owned(), fraction(name))));
    let mut mask_coverage = Map::new();
    if !line.mask_coverage.is_empty() {
        let names = ClassId::ALL.iter().map(|class| class.name).chain(["ignored"]);
        let fraction = |name: &str| Value::from(line.mask_coverage_of(name).unwrap_or_default());
        mask_coverage.extend(names.map(|name| (name.to_owned(), fraction(name))));
    }
    let hash = |path: &String| {
        let recorded = line.hashes.get(path).cloned().unwrap_or_default();
        (path.clone(), recorded)
    };
    FrameLine {
        index: line.index,
        split: context.plan.split_of(line.index).to_owned(),
        attempt: line.attempt,
        redrawn: line.redrawn.clone(),
        seed,
        stage: params.text(Knob::StageName).to_owned(),
        adapter: line.adapter.clone(),
        raster: line.raster.clone(),
        knobs: params.to_json(),
        geometry_hash: line.geometry_hash.clone(),
        camera: meta::camera(&Camera::above(params, eye_m as f32), size),
        sun: meta::sun(&Sun::build(params)),
        coverage,
        mask_coverage,
        exposure: line.exposure,
        rgb: line.rgb,
        moved_rocks: line.moved_rocks.clone(),
        left_out_rocks: line.left_out_rocks,
        other: Map::new(),
        hashes: frame.paths.iter().map(hash).collect(),
        entry: match &frame.entry {
            // It depends on what the frame shows, and is compared with the labels.
            Value::Object(entry) if entry.values().any(Value::is_array) => line.entry.clone(),
            entry => entry.clone(),
        },
        ms: line.ms.clone(),
    }
}

/// Problems of values that are not derived but must be of some form.
fn list_problems(context: &Context<'_>, line: &FrameLine) -> Vec<Difference> {
    let rules = &context.plan.rules;
    let is_hash = |text: &str| text.len() == HASH_DIGITS && text.bytes().all(|c| c.is_ascii_hexdigit());
    let mut list = Vec::new();
    let mut expect = |key: &str, is_good: bool, found: Value, expected: &str| {
        if !is_good {
            let text = format!("{key} is {found}; it should be {expected}");
            list.push(Difference { key: key.to_owned(), text });
        }
    };
    let is_attempt = line.attempt < rules.attempts_max && line.attempt as usize == line.redrawn.len();
    expect(
        "attempt",
        is_attempt,
        line.attempt.into(),
        "the number of rules in `redrawn`, and below attempts_max",
    );
    for rule in line.redrawn.iter().filter(|rule| !rules.has(rule)) {
        expect("redrawn", false, rule.as_str().into(), "a rule of the dataset");
    }
    expect("adapter", !line.adapter.is_empty(), line.adapter.as_str().into(), "the name of an adapter");
    let is_raster = line.raster.as_deref().is_some_and(|raster| RasterOptions::NAMES.contains(&raster));
    expect("raster", is_raster, json!(line.raster), &format!("one of {}", RasterOptions::NAMES.join(", ")));
    let has_band = context.plan.edges != EdgePolicy::Hard;
    let wanted =
        if has_band { "the fractions of the mask under --edges" } else { "absent: the mask has no band" };
    let is_as_wanted = has_band != line.mask_coverage.is_empty();
    expect("mask_coverage", is_as_wanted, json!(line.mask_coverage), wanted);
    let is_exposure = |exposure: ImageExposure| {
        let ImageExposure { ev, black, white } = exposure;
        ev.is_finite() && (0.0..1.0).contains(&black) && black < white && white <= 1.0
    };
    let wanted = "stops, and the light of black and white, from 0 to 1";
    expect("exposure", line.exposure.is_some_and(is_exposure), json!(line.exposure), wanted);
    let hash = line.geometry_hash.as_str();
    expect("geometry_hash", is_hash(hash), hash.into(), "32 hexadecimal digits");
    let is_ascending = line.moved_rocks.is_sorted_by(|a, b| a < b);
    expect("moved_rocks", is_ascending, json!(line.moved_rocks), "indices of rocks, ascending");
    for (path, hash) in &line.hashes {
        let is_good = hash.as_str().is_some_and(is_hash);
        expect(&format!("hashes.{path}"), is_good, hash.clone(), "32 hexadecimal digits");
    }
    let is_time = |ms: &Value| ms.as_f64().is_some_and(|ms| ms >= 0.0);
    let are_times = !line.ms.is_empty() && line.ms.values().all(is_time);
    expect("ms", are_times, json!(line.ms), "milliseconds by stage");
    list
}
