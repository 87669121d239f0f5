//! Thousands of damaged inputs for every parser: none panics, and nothing that is accepted names a file outside.
//!
//! Inputs are mutations of valid ones, drawn from a fixed seed. Inputs that once did harm are kept in `tests/corpus`, in files whose
//! names begin with that of their target; they are tried first.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use glam::Vec3;
use regolith::dataset::gate::{Gate, read_manifest};
use regolith::dataset::plan::Plan;
use regolith::lens::Lens;
use regolith::output::dataset_path;
use regolith::output::layout::FrameLine;
use regolith::params::config::Config;
use regolith::random::{Stream, Streams};
use regolith::remap;
use regolith::render::select::near_plane;
use regolith::scene::camera::Camera;
use serde_json::{Map, Value};

use crate::support::{folder, run_ok};

/// A small dataset with splits: its manifest and its lines.
static DATASET: LazyLock<(Vec<u8>, Vec<u8>)> = LazyLock::new(|| {
    let folder = folder();
    let words = "dataset -q --split train=2,val=1 --size 16 --samples 1 --outputs rgb,mask,instances --set terrain.cells=40";
    let words: Vec<&str> = words.split(' ').collect();
    run_ok(folder.path(), &[&words[..], &["--set", "rocks.count=9", "--out", "data"]].concat());
    let read = |name: &str| fs::read(folder.path().join("data").join(name)).expect("read");
    (read("manifest.json"), read("frames.jsonl"))
});

/// Texts that are put into inputs.
const FRAGMENTS: [&str; 24] = [
    "../evil",
    "/etc/passwd",
    "rgb/../../evil.png",
    "\\u0000",
    "\"",
    "{",
    "}",
    "[[[[[[[[",
    "null",
    "true",
    "-1",
    "0",
    "1e999",
    "NaN",
    "inf",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "-9223372036854775808",
    "0.1",
    "\u{202e}",
    "{\"class\": \"rock\", \"class\": \"sky\"}",
    "uniform = [2, 1]",
    "=",
];

fn below(stream: &mut Stream, count: usize) -> usize {
    (stream.unit() * count as f64) as usize
}

/// A few changes of a valid input: bytes flipped, cut, repeated, replaced by fragments.
fn mutate(stream: &mut Stream, valid: &[u8]) -> Vec<u8> {
    let mut bytes = valid.to_vec();
    for _ in 0..=below(stream, 4) {
        if bytes.is_empty() {
            break;
        }
        let at = below(stream, bytes.len());
        let end = (at + 1 + below(stream, 24)).min(bytes.len());
        let fragment = FRAGMENTS[below(stream, FRAGMENTS.len())].as_bytes();
        match below(stream, 7) {
            0 => bytes[at] ^= 1 << below(stream, 8),
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end)),
            3 => drop(bytes.splice(at..at, bytes[at..end].to_vec())),
            4 => drop(bytes.splice(at..at, fragment.to_vec())),
            5 => {
                let (start, end) = token(&bytes, at);
                bytes.splice(start..end, fragment.to_vec());
            }
            _ => {
                // Another token of the input takes the place of this one.
                let other = token(&bytes, below(stream, bytes.len()));
                let other = bytes[other.0..other.1].to_vec();
                let (start, end) = token(&bytes, at);
                bytes.splice(start..end, other);
            }
        }
    }
    bytes
}

/// The ends of the number, word or quoted text around a position.
fn token(bytes: &[u8], at: usize) -> (usize, usize) {
    let is_end = |byte: &u8| b",:=[]{}\n \"".contains(byte);
    let start = bytes[..at].iter().rposition(is_end).map_or(0, |start| start + 1);
    let end = bytes[at..].iter().position(is_end).map_or(bytes.len(), |end| at + end);
    (start.min(end), end)
}

/// The inputs of a target: those kept, then mutations of the valid ones.
fn inputs<'a>(target: &'a str, valid: &'a [Vec<u8>], count: usize) -> impl Iterator<Item = Vec<u8>> + 'a {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let mut kept: Vec<_> = fs::read_dir(corpus)
        .expect("the corpus")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(target)))
        .collect();
    kept.sort();
    let mut stream = Streams::new(1).stream(target, 0);
    let mutated = (0..count).map(move |i| mutate(&mut stream, &valid[i % valid.len()]));
    kept.into_iter().map(|path| fs::read(path).expect("read")).chain(valid.iter().cloned()).chain(mutated)
}

#[track_caller]
fn assert_below<'a>(paths: impl IntoIterator<Item = &'a str>) {
    for path in paths {
        assert_eq!(dataset_path::problem(path), None, "{path:?} was accepted");
    }
}

#[test]
fn whatever_a_manifest_says_no_path_leaves_its_folder() {
    let folder = folder();
    let path = folder.path().join("manifest.json");
    let mut accepted = 0;
    for input in inputs("manifest", std::slice::from_ref(&DATASET.0), 4000) {
        fs::write(&path, &input).expect("written");
        let Ok(manifest) = read_manifest(&path) else { continue };
        accepted += 1;
        let gate = Gate::of_manifest(&manifest).expect("checked when it was read");
        let indexed = manifest.get("index_files").and_then(Value::as_object).into_iter().flatten();
        assert_below(indexed.map(|(path, _)| path.as_str()));
        for line in DATASET.1.split(|byte| *byte == b'\n').filter_map(|text| FrameLine::parse(text).ok()) {
            assert_below(gate.names_of(&line).files.iter().map(String::as_str));
            let _ = gate.check(&line);
        }
        if let Ok(plan) = Plan::of_manifest(&manifest) {
            let start = plan.range.start;
            assert!(start.checked_add(plan.range.count).is_some(), "{start}");
            assert_below([plan.split_of(start)].into_iter().filter(|split| !split.is_empty()));
        }
    }
    assert!(accepted > 100, "only {accepted} inputs were accepted: they test the parser alone");
}

#[test]
fn whatever_a_line_says_its_files_are_those_of_its_frame() {
    let manifest: Map<String, Value> = serde_json::from_slice(&DATASET.0).expect("JSON");
    let gate = Gate::of_manifest(&manifest).expect("a gate");
    let valid: Vec<Vec<u8>> = DATASET.1.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
    let mut accepted = 0;
    for input in inputs("line", &valid, 20_000) {
        let Ok(line) = FrameLine::parse(&input) else { continue };
        let written = serde_json::to_vec(&line).expect("JSON");
        assert_eq!(FrameLine::parse(&written).expect("written by us"), line);
        if gate.check(&line).is_ok() {
            accepted += 1;
            let names = gate.names_of(&line).files;
            assert!(
                line.hashes().all(|(path, _)| names.iter().any(|name| name == path)),
                "{:?}",
                line.hashes
            );
            assert_below(names.iter().map(String::as_str));
        }
    }
    assert!(accepted > 100, "only {accepted} inputs were accepted: they test the parser alone");
}

#[test]
fn every_configuration_is_refused_or_can_be_drawn() {
    let valid: Vec<Vec<u8>> =
        regolith::params::presets::presets().iter().map(|(_, text)| text.as_bytes().to_vec()).collect();
    let mut accepted = 0;
    for input in inputs("config", &valid, 20_000) {
        let Ok(text) = std::str::from_utf8(&input) else { continue };
        let mut config = Config::new();
        if config.apply_toml(text, "a file").is_err() || config.check().is_err() {
            continue;
        }
        accepted += 1;
        let Ok(params) = config.draw(7) else { continue };
        assert!(!params.to_json().is_empty());
    }
    assert!(accepted > 100, "only {accepted} inputs were accepted: they test the parser alone");
}

#[test]
fn every_label_file_is_refused_or_maps_every_pixel() {
    let folder = folder();
    let [masks, out] = ["masks", "out"].map(|name| folder.path().join(name));
    fs::create_dir(&masks).expect("created");
    let mask = image::GrayImage::from_fn(4, 4, |x, y| image::Luma([(4 * y + x) as u8]));
    mask.save(masks.join("semantic_segmentation_0000.png")).expect("saved");
    let valid = [
        br#"{"0": {"class": "regolith"}, "1": {"class": "rock"}, "2": {"class": "BACKGROUND"}}"#.to_vec(),
        br#"{"(0, 0, 0, 255)": {"class": "rock"}, "(1, 1, 1, 255)": {"class": "sky,unlabelled"}}"#.to_vec(),
    ];
    let mut accepted = 0;
    for input in inputs("labels", &valid, 2000) {
        fs::write(masks.join("semantic_segmentation_labels_0000.json"), &input).expect("written");
        let Ok(pairs) = remap::find(&masks) else { continue };
        for pair in &pairs {
            if remap::remap(&masks, std::slice::from_ref(pair), &out, true).is_ok() {
                accepted += 1;
            }
        }
    }
    assert!(accepted > 100, "only {accepted} inputs were accepted: they test the parser alone");
}

#[test]
fn every_lens_is_refused_or_invertible_in_the_image() {
    let mut stream = Streams::new(2).stream("lens", 0);
    let mut accepted = 0;
    for case in 0..2000 {
        let mut term = |scale: f64| {
            let magnitude = if stream.unit() < 0.05 { 1e12 } else { scale };
            if stream.unit() < 0.3 { 0.0 } else { stream.uniform(-magnitude, magnitude) }
        };
        let lens = Lens { k1: term(0.5), k2: term(0.3), k3: term(0.1), p1: term(0.05), p2: term(0.05) };
        let angles = [term(60.0), term(180.0), term(30.0)];
        let fov_deg = 1.0 + term(150.0).abs().min(170.0);
        let mut camera = Camera::new(Vec3::new(0.0, 0.0, 2.0), angles, fov_deg, 2000.0, 0.0);
        camera.lens = lens;
        let size = [1 + (case % 640) as u32, 1 + (case * 7 % 480) as u32];
        let Ok((drawn, drawn_size)) = near_plane::drawn(&camera, size) else { continue };
        accepted += 1;
        assert!(drawn_size[0] >= 1 && drawn_size[1] >= 1 && drawn.fov_deg().is_finite(), "{camera:?}");
        // A corner of the image, undistorted and distorted again, is itself.
        let focal = camera.focal_px(size[0]);
        let corner = [0.5 * f64::from(size[0]) / focal, 0.5 * f64::from(size[1]) / focal];
        let back = lens.distort(lens.undistort(corner));
        let error = (back[0] - corner[0]).hypot(back[1] - corner[1]) * focal;
        assert!(error < 0.01, "{lens:?}, {size:?}, {fov_deg}: {error} px");
    }
    assert!(accepted > 200, "only {accepted} lenses were accepted");
}
