//! Whether a dataset is what it says: every file against its hash, every mask against its statistics, a sample of
//! frames rendered again, depth put back into the world.
//!
//! Must not know: the command line.
//! To add a check: a name in [`CHECKS`], a line where the frame, the folder or the rendered frame is looked at.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::journal::{self, Book, Totals, hashes, index_of};
use super::plan::{Plan, Range, frame_seed};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::{Annotation, Frame, RgbStatistics};
use crate::lens::Lens;
use crate::meta;
use crate::output::edges::EdgePolicy;
use crate::output::layout::{self, Layout};
use crate::output::{LabelIds, disk};
use crate::params::Knob;
use crate::params::sampler::Config;
use crate::render::{RenderSettings, Renderer};
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// What is checked, in the order of the table.
pub const CHECKS: [(&str, &str); 10] = [
    ("books", "manifest and frames.jsonl agree, frames contiguous, seeds right"),
    ("records", "knobs, camera and sun are those of seed and configuration"),
    ("files", "every file is there, and none beside them that no frame has"),
    ("hashes", "content is what was written"),
    ("pictures", "pictures decode, with the right size and type"),
    ("masks", "ids are those of the classes, shares are those recorded"),
    ("labels", "the label files name the ids"),
    ("statistics", "brightness is that recorded"),
    ("rendering", "a sample of frames rendered again comes out the same"),
    ("depth", "depth put back through K and pose lies on the surface (of that sample)"),
];

/// Lines that are checked at a time.
const CHUNK: usize = 256;
/// On another adapter, the share of a mask's pixels that may differ (outlines), and the mean difference of a picture's
/// values (rounding).
const OTHER_ADAPTER: (f64, f64) = (2e-3, 1.0);
/// How far a point may be off the surface: metres, as a fraction of its distance, and in pixels (a rock is drawn within
/// a quarter of a pixel of its authored outline).
const DEPTH_TOLERANCE: (f64, f64, f64) = (0.02, 1e-3, 0.25);
/// Pixels are put back whose depth is that of their centre, but for so much of it: elsewhere it is a mean of what lies before
/// and behind an edge.
const DEPTH_EDGE: f64 = 0.005;
/// Share of the points that must keep it.
const DEPTH_SHARE: f64 = 0.99;
/// One pixel in so many is put back into the world.
const DEPTH_STRIDE: usize = 31;

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Problem {
    /// Name of the check.
    pub check: &'static str,
    /// The frame, if it is one's.
    pub index: Option<u64>,
    /// What was found, with the file.
    pub found: String,
}

/// The result of a check-up.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// How many things each check has looked at, by name; absent if it was not done.
    pub looked_at: BTreeMap<&'static str, u64>,
    /// What is wrong.
    pub problems: Vec<Problem>,
    /// Frames.
    pub frames: u64,
}

impl Report {
    fn look(&mut self, check: &'static str) {
        *self.looked_at.entry(check).or_default() += 1;
    }

    fn problem(&mut self, check: &'static str, index: Option<u64>, found: String) {
        self.problems.push(Problem { check, index, found });
    }

    fn expect(
        &mut self,
        check: &'static str,
        index: Option<u64>,
        good: bool,
        found: impl FnOnce() -> String,
    ) {
        self.look(check);
        if !good {
            self.problem(check, index, found());
        }
    }

    fn add(&mut self, other: Self) {
        for (check, count) in other.looked_at {
            *self.looked_at.entry(check).or_default() += count;
        }
        self.problems.extend(other.problems);
        self.frames += other.frames;
    }

    /// As JSON.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let checks: Map<String, Value> = CHECKS
            .iter()
            .map(|(name, what)| {
                let wrong = self.problems.iter().filter(|problem| problem.check == *name).count();
                let row = json!({ "what": what, "looked_at": self.looked_at.get(name), "wrong": wrong });
                ((*name).to_owned(), row)
            })
            .collect();
        json!({ "good": self.problems.is_empty(), "frames": self.frames, "checks": checks, "problems": self.problems })
    }
}

/// What the manifest says of all frames.
struct Facts<'a> {
    folder: &'a Path,
    layout: &'static dyn Layout,
    base_seed: u64,
    range: Range,
    settings: RenderSettings,
    edges: EdgePolicy,
    label_ids: LabelIds,
    config: Config,
}

impl<'a> Facts<'a> {
    fn of(folder: &'a Path, manifest: &Map<String, Value>) -> Option<Self> {
        let number = |key: &str| manifest.get(key)?.as_u64();
        let text = |key: &str| manifest.get(key)?.as_str();
        let size = manifest.get("size")?.as_array()?;
        let side = |place: usize| u32::try_from(size.get(place)?.as_u64()?).ok();
        let layout = layout::find(text("format")?).ok()?.1;
        let asked = LabelIds::from_name(text("label_ids")?)?;
        let label_ids = if layout.has_fixed_ids() { LabelIds::default() } else { asked };
        let mut config = Config::new();
        config.apply_json(manifest.get("config")?.as_object()?, "manifest.json").ok()?;
        Some(Self {
            folder,
            layout,
            base_seed: number("base_seed")?,
            range: Range { start: number("start")?, count: number("count")? },
            settings: RenderSettings::new([side(0)?, side(1)?], u32::try_from(number("samples")?).ok()?)
                .ok()?,
            edges: text("edges")?.parse().ok()?,
            label_ids,
            config,
        })
    }
}

/// Checks a dataset: everything that needs no rendering. `watch` is told how many frames are checked, and of how
/// many.
///
/// # Errors
/// [`Error::Dataset`] if there is none, [`Error::CheckFailed`] if its manifest cannot be used; what else is wrong with one is in
/// the report.
pub fn check(folder: &Path, mut watch: impl FnMut(u64, u64)) -> Result<Report> {
    let manifest = open(folder)?;
    let facts = facts(folder, &manifest)?;
    let mut report = Report::default();
    let status = manifest.get("status").and_then(Value::as_str).unwrap_or_default();
    report.expect("books", None, status == "done", || {
        format!("manifest.json: status is `{status}`; run the dataset command again, or `dataset --merge` for shards")
    });
    for (key, value) in Plan::identity_of_ids(facts.label_ids) {
        report.expect("labels", None, manifest.get(&key) == Some(&value), || {
            format!("manifest.json: {key} should be {value}")
        });
    }
    let (mut known, mut next, mut totals) = (BTreeSet::new(), facts.range.start, Totals::default());
    let mut chunk = Vec::new();
    let mut check_chunk = |chunk: &mut Vec<Map<String, Value>>, report: &mut Report| {
        let parts: Vec<Report> = chunk.par_iter().map(|line| check_frame(&facts, line)).collect();
        parts.into_iter().for_each(|part| report.add(part));
        chunk.clear();
        watch(report.frames, facts.range.count);
    };
    let read = Book::new(folder).for_each_as_it_is(&mut |line| {
        let line = match line {
            Ok(line) => line,
            Err(error) => {
                report.problem("books", None, error.to_string());
                return Ok(());
            }
        };
        totals.add(&line);
        let index = index_of(&line);
        report.expect("books", index, index == Some(next), || {
            format!("frames.jsonl: frame {next} should stand here")
        });
        next = index.unwrap_or(next) + 1;
        known.extend(hashes(&line).map(|(path, _)| path.to_owned()));
        chunk.push(line);
        if chunk.len() == CHUNK {
            check_chunk(&mut chunk, &mut report);
        }
        Ok(())
    });
    check_chunk(&mut chunk, &mut report);
    if let Err(error) = read {
        report.problem("books", None, error.to_string());
    }
    report.expect("books", None, next == facts.range.end(), || {
        format!(
            "frames.jsonl ends before frame {next}; the manifest has frames {} to {}",
            facts.range.start,
            facts.range.end() - 1
        )
    });
    let frames = report.frames;
    report.expect("books", None, manifest.get("n_completed").and_then(Value::as_u64) == Some(frames), || {
        format!("manifest.json: n_completed is not the {frames} frames of frames.jsonl")
    });
    report.expect("books", None, manifest.get("totals") == Some(&totals.to_json()), || {
        format!("manifest.json: totals are not those of frames.jsonl, {}", totals.to_json())
    });
    for (path, hash) in manifest.get("index_files").and_then(Value::as_object).into_iter().flatten() {
        known.insert(path.clone());
        if let Some(bytes) = check_file(&facts, path, hash.as_str(), None, &mut report) {
            check_labels(&facts, path, &bytes, None, &mut report);
        }
    }
    check_strangers(folder, &known, &mut report)?;
    Ok(report)
}

fn open(folder: &Path) -> Result<Map<String, Value>> {
    let path = folder.join("manifest.json");
    if !path.is_file() {
        let shards = folder.is_dir() && disk::names(folder)?.iter().any(|name| name.starts_with("manifest-"));
        let remedy = if shards {
            "shards that are not merged yet; run `regolith-render dataset --merge --out` with this folder"
        } else {
            "no dataset is here: it has no manifest.json"
        };
        return Err(Error::Dataset { path: folder.to_owned(), message: remedy.to_owned() });
    }
    journal::read_manifest(&path)
}

fn facts<'a>(folder: &'a Path, manifest: &Map<String, Value>) -> Result<Facts<'a>> {
    Facts::of(folder, manifest).ok_or_else(|| {
        Error::CheckFailed(format!(
            "{}: it lacks a base seed, range, size, samples, format, edges, label ids or configuration that could be used; \
             delete it, and the dataset's own command with --force makes it again",
            folder.join("manifest.json").display()
        ))
    })
}

/// Reads a file and compares it with its hash.
fn check_file(
    facts: &Facts<'_>,
    path: &str,
    hash: Option<&str>,
    index: Option<u64>,
    report: &mut Report,
) -> Option<Vec<u8>> {
    report.look("files");
    match disk::read(&facts.folder.join(path)) {
        Ok(bytes) => {
            let actual = disk::content_hash(&bytes);
            report.expect("hashes", index, hash == Some(actual.as_str()), || {
                format!("{path}: its content has changed ({} bytes, hash {actual})", bytes.len())
            });
            Some(bytes)
        }
        Err(error) => {
            report.problem("files", index, format!("{path}: {error}"));
            None
        }
    }
}

/// Of a file that names the ids of masks.
fn check_labels(facts: &Facts<'_>, path: &str, bytes: &[u8], index: Option<u64>, report: &mut Report) {
    let expected = if path == "id2label.json" {
        facts.label_ids.id2label()
    } else if path.contains("semantic_segmentation_labels") {
        facts.label_ids.labels()
    } else {
        return;
    };
    let labels = serde_json::from_slice::<Value>(bytes).ok();
    report.expect("labels", index, labels == Some(expected), || {
        format!("{path}: it does not name the ids of {} masks", facts.label_ids.name())
    });
}

/// All that can be told of a frame from its line and its files.
fn check_frame(facts: &Facts<'_>, line: &Map<String, Value>) -> Report {
    let mut report = Report { frames: 1, ..Report::default() };
    let index = index_of(line);
    let number = |key: &str| line.get(key).and_then(Value::as_u64);
    if let (Some(index), Some(attempt)) = (index, number("attempt").and_then(|n| u32::try_from(n).ok())) {
        let seed = frame_seed(facts.base_seed, index, attempt);
        report.expect("books", Some(index), number("seed") == Some(seed), || {
            format!("frames.jsonl: its seed should be {seed}")
        });
        check_record(facts, line, seed, &mut report);
    } else {
        report.problem("books", index, "frames.jsonl: a line without index or attempt".to_owned());
    }
    let bundle = line.get("entry").and_then(|entry| entry.get("bundle")).and_then(Value::as_str);
    if bundle.is_some_and(|bundle| facts.folder.join(bundle).is_file()) {
        // Its bytes are checked with the bundle's.
        report.look("files");
        return report;
    }
    let split = line.get("split").and_then(Value::as_str).unwrap_or_default();
    let [picture, mask] =
        index.and_then(|index| facts.layout.image_and_mask(split, index)).unwrap_or_default();
    for (path, hash) in hashes(line) {
        let Some(bytes) = check_file(facts, path, Some(hash), index, &mut report) else { continue };
        match Path::new(path).extension().and_then(|extension| extension.to_str()) {
            Some("png") => check_picture(facts, line, path, &bytes, [&picture, &mask], &mut report),
            Some("json") if path.contains("semantic_segmentation_labels") => {
                check_labels(facts, path, &bytes, index, &mut report);
            }
            Some("json") => {
                let good = serde_json::from_slice::<Value>(&bytes).is_ok();
                report.expect("pictures", index, good, || format!("{path}: it is no JSON"));
            }
            Some("npy") => {
                let [width, height] = facts.settings.size;
                let good = String::from_utf8_lossy(&bytes[..bytes.len().min(128)])
                    .contains(&format!("({height}, {width}"));
                report.expect("pictures", index, good, || {
                    format!("{path}: it is no array of {height} x {width}")
                });
            }
            Some("exr") => {
                let good = bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]);
                report.expect("pictures", index, good, || format!("{path}: it is no OpenEXR file"));
            }
            _ => {}
        }
    }
    report
}

/// What of a frame's record follows from its seed and the configuration: all but what the scene itself or the picture tells. Of the
/// camera that is the height of the eye, which stands on the ground.
fn check_record(facts: &Facts<'_>, line: &Map<String, Value>, seed: u64, report: &mut Report) {
    let index = index_of(line);
    let recorded = |key: &str| line.get(key).unwrap_or(&Value::Null);
    let params = match facts.config.draw(seed) {
        Ok(params) => params,
        Err(error) => return report.problem("records", index, format!("manifest.json: {error}")),
    };
    let eye_m = recorded("camera")["world_from_camera"][2][3].as_f64().unwrap_or_default();
    let camera = meta::camera(&Camera::above(&params, eye_m as f32), facts.settings.size);
    let mut expect = |name: &str, recorded: Option<&Value>, expected: &Value| {
        report.expect("records", index, recorded == Some(expected), || {
            let recorded = recorded.unwrap_or(&Value::Null);
            format!("frames.jsonl: {name} should be {expected}, recorded is {recorded}")
        });
    };
    expect("stage", line.get("stage"), &params.text(Knob::StageName).into());
    expect("coverage.unlabelled", recorded("coverage").get("unlabelled"), &0.0.into());
    let sections =
        [("knobs", params.to_json().into()), ("camera", camera), ("sun", meta::sun(&Sun::build(&params)))];
    for (section, expected) in sections {
        let rows = expected.as_object().into_iter().flatten();
        rows.for_each(|(key, value)| expect(&format!("{section}.{key}"), recorded(section).get(key), value));
    }
}

fn check_picture(
    facts: &Facts<'_>,
    line: &Map<String, Value>,
    path: &str,
    bytes: &[u8],
    [picture, mask]: [&str; 2],
    report: &mut Report,
) {
    let index = index_of(line);
    let decoded = match image::load_from_memory_with_format(bytes, image::ImageFormat::Png) {
        Ok(decoded) => decoded,
        Err(error) => {
            report.look("pictures");
            return report.problem("pictures", index, format!("{path}: it cannot be decoded ({error})"));
        }
    };
    let (size, colour) = ([decoded.width(), decoded.height()], decoded.color());
    let wanted = if path == picture {
        Some(image::ColorType::Rgb8)
    } else if path == mask {
        Some(image::ColorType::L8)
    } else {
        None
    };
    let good = size == facts.settings.size && wanted.is_none_or(|wanted| wanted == colour);
    report.expect("pictures", index, good, || {
        format!("{path}: it is {} x {} pixels of {colour:?}, not {:?}", size[0], size[1], facts.settings.size)
    });
    if !good {
        return;
    }
    if path == mask {
        check_mask(facts, line, path, decoded.as_bytes(), report);
    } else if path == picture {
        let statistics = json!(RgbStatistics::of(decoded.as_bytes()));
        report.expect("statistics", index, line.get("rgb") == Some(&statistics), || {
            format!(
                "{path}: its brightness is {statistics}, recorded is {}",
                line.get("rgb").unwrap_or(&Value::Null)
            )
        });
    }
}

fn check_mask(facts: &Facts<'_>, line: &Map<String, Value>, path: &str, ids: &[u8], report: &mut Report) {
    let index = index_of(line);
    let mut counts = [0_u64; 256];
    for id in ids {
        counts[usize::from(*id)] += 1;
    }
    let ignored = facts.label_ids.mask_id(ClassId::UNLABELLED.0);
    let known = |id: u8| ClassId::ALL.iter().any(|class| facts.label_ids.mask_id(class.id.0) == id);
    let hard = facts.edges == EdgePolicy::Hard;
    let strange: Vec<u8> = (0..=u8::MAX)
        .filter(|&id| counts[usize::from(id)] > 0 && !known(id) && (hard || id != ignored))
        .collect();
    report.expect("masks", index, strange.is_empty(), || format!("{path}: it has pixels of ids {strange:?}"));
    for class in ClassId::ALL {
        let share = counts[usize::from(facts.label_ids.mask_id(class.id.0))] as f64 / ids.len() as f64;
        let recorded =
            line.get("coverage").and_then(|coverage| coverage.get(class.name)).and_then(Value::as_f64);
        // A band of ignored pixels takes from every class.
        let good = recorded.is_some_and(|recorded| if hard { share == recorded } else { share <= recorded });
        report.expect("masks", index, good, || {
            let recorded = recorded.map_or_else(|| "nothing".to_owned(), |share| format!("{share:.6}"));
            format!("{path}: {} covers {share:.6} of it, recorded is {recorded}", class.name)
        });
    }
}

/// Files that no frame and no index has, where frames' files lie.
fn check_strangers(folder: &Path, known: &BTreeSet<String>, report: &mut Report) -> Result<()> {
    let folders: BTreeSet<&str> = known.iter().filter_map(|path| Some(path.rsplit_once('/')?.0)).collect();
    for inner in folders {
        let path = folder.join(inner);
        if !path.is_dir() {
            continue;
        }
        for name in disk::names(&path)? {
            let file = format!("{inner}/{name}");
            if !path.join(&name).is_dir() && !known.contains(&file) {
                report.problem("files", None, format!("{file}: no frame has this file"));
            }
        }
    }
    Ok(())
}

/// Renders a sample of frames again, spread evenly, and compares; puts their recorded depth back into the world.
/// What is found goes into the report.
///
/// # Errors
/// Those of reading the books and of rendering.
pub fn check_rendering(
    folder: &Path,
    renderer: &mut Renderer,
    sample: u64,
    report: &mut Report,
) -> Result<()> {
    let manifest = open(folder)?;
    let facts = facts(folder, &manifest)?;
    let stride = (facts.range.count / sample.max(1)).max(1);
    let mut lines = Vec::new();
    Book::new(folder).for_each_as_it_is(&mut |line| {
        // What cannot be read has been reported.
        let Ok(line) = line else { return Ok(()) };
        let index = index_of(&line).unwrap_or_default();
        if index.saturating_sub(facts.range.start).is_multiple_of(stride) && (lines.len() as u64) < sample {
            lines.push(line);
        }
        Ok(())
    })?;
    for line in &lines {
        if let Err(error) = check_again(&facts, line, renderer, report) {
            match error {
                Error::DeviceLost(_) | Error::Device(_) | Error::OutOfMemory => return Err(error),
                other => report.problem("rendering", index_of(line), other.to_string()),
            }
        }
    }
    Ok(())
}

fn check_again(
    facts: &Facts<'_>,
    line: &Map<String, Value>,
    renderer: &mut Renderer,
    report: &mut Report,
) -> Result<()> {
    let index = index_of(line);
    let knobs = line.get("knobs").and_then(Value::as_object).cloned().unwrap_or_default();
    let seed = line.get("seed").and_then(Value::as_u64).unwrap_or_default();
    let mut config = Config::new();
    config.apply_json(&knobs, "frames.jsonl")?;
    let scene = Scene::build(seed, &config.draw(seed)?)?;
    let hash = scene.geometry_hash();
    report.expect(
        "rendering",
        index,
        line.get("geometry_hash").and_then(Value::as_str) == Some(&hash),
        || format!("its scene has the hash {hash}, recorded is another"),
    );
    for (key, value) in [
        ("camera", meta::camera(&scene.camera, facts.settings.size)),
        ("moved_rocks", scene.moved_rocks().into()),
    ] {
        report.expect("rendering", index, line.get(key) == Some(&value), || {
            format!("frames.jsonl: {key} is not that of its scene")
        });
    }
    let split = line.get("split").and_then(Value::as_str).unwrap_or_default();
    let Some([picture, mask]) = index.and_then(|index| facts.layout.image_and_mask(split, index)) else {
        return Ok(());
    };
    let (frame, _) = renderer.render(&scene, &facts.settings)?;
    // Datasets of earlier versions do not record the raster backend.
    let recorded = |key| line.get(key).and_then(Value::as_str);
    let same_adapter = recorded("adapter") == Some(renderer.gpu().info.name.as_str())
        && recorded("raster").is_none_or(|raster| raster == renderer.raster().name());
    let decode = |path: &str| {
        let bytes = disk::read(&facts.folder.join(path)).ok()?;
        Some(image::load_from_memory(&bytes).ok()?.as_bytes().to_vec())
    };
    let ids: Vec<u8> = facts.edges.apply(&frame).iter().map(|id| facts.label_ids.mask_id(*id)).collect();
    // What cannot be read has been reported.
    if let Some(stored) = decode(&mask) {
        let off = stored.iter().zip(&ids).filter(|(a, b)| a != b).count();
        let allowed = if same_adapter { 0.0 } else { OTHER_ADAPTER.0 * ids.len() as f64 };
        report.expect("rendering", index, stored.len() == ids.len() && off as f64 <= allowed, || {
            format!("{mask}: {off} pixels come out as another class")
        });
    }
    if let Some(stored) = decode(&picture) {
        let difference: f64 =
            stored.iter().zip(&frame.rgb).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>()
                / stored.len() as f64;
        let allowed = if same_adapter { 0.0 } else { OTHER_ADAPTER.1 };
        report.expect("rendering", index, stored.len() == frame.rgb.len() && difference <= allowed, || {
            format!("{picture}: its values differ by {difference:.3} in the mean")
        });
    }
    let depth = hashes(line).find(|(path, _)| path.contains("distance_to_image_plane"));
    if let Some((path, _)) = depth {
        check_depth(facts, line, path, &scene, renderer, report)?;
    }
    Ok(())
}

/// Puts depth back into the world through the recorded K and pose, and looks how far it is from the scene's surface.
fn check_depth(
    facts: &Facts<'_>,
    line: &Map<String, Value>,
    path: &str,
    scene: &Scene,
    renderer: &mut Renderer,
    report: &mut Report,
) -> Result<()> {
    let index = index_of(line);
    let Ok(bytes) = disk::read(&facts.folder.join(path)) else { return Ok(()) };
    let [width, height] = facts.settings.size.map(|side| side as usize);
    let depths: Vec<f64> = bytes[bytes.len().saturating_sub(4 * width * height)..]
        .chunks_exact(4)
        .map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
        .collect();
    let camera = line.get("camera").unwrap_or(&Value::Null);
    let number =
        |rows: &str, row: usize, column: usize| camera[rows][row][column].as_f64().unwrap_or(f64::NAN);
    let k = DMat3::from_cols_array_2d(&std::array::from_fn(|c| std::array::from_fn(|r| number("K", r, c))));
    let axes = DMat3::from_cols_array_2d(&std::array::from_fn(|c| {
        std::array::from_fn(|r| number("world_from_camera", r, c))
    }));
    let eye = DVec3::from_array(std::array::from_fn(|r| number("world_from_camera", r, 3)));
    let term = |name: &str| camera["distortion"][name].as_f64().unwrap_or(0.0);
    let lens = Lens { k1: term("k1"), k2: term("k2"), k3: term("k3"), p1: term("p1"), p2: term("p2") };
    let annotations = [Annotation::Instances, Annotation::Depth].into_iter().collect();
    let settings = RenderSettings { annotations, ..facts.settings };
    let (frame, _): (Frame, _) = renderer.render(scene, &settings)?;
    let (centres, _): (Frame, _) =
        renderer.render(scene, &RenderSettings { samples_per_side: 1, ..settings })?;
    // By what is drawn now, not by what is recorded, which is to be checked.
    let is_one_surface = |pixel: usize| {
        let [mean_m, centre_m] = [&frame, &centres].map(|frame| f64::from(frame.depth_m[pixel]));
        mean_m == centre_m || (mean_m - centre_m).abs() <= DEPTH_EDGE * centre_m
    };
    let (mut seen, mut off, mut worst) = (0_u64, 0_u64, 0.0_f64);
    let thing = |pixel: usize| (frame.class[pixel], frame.instances[pixel]);
    let is_inside = |pixel: usize| {
        let (x, y) = (pixel % width, pixel / width);
        let near = |at: usize, side: usize| at.saturating_sub(1)..=(at + 1).min(side - 1);
        near(y, height).all(|y| near(x, width).all(|x| thing(y * width + x) == thing(pixel)))
    };
    // At outlines depth is a mean over a part of a pixel.
    let is_told = |pixel: &usize| is_inside(*pixel) && is_one_surface(*pixel);
    for pixel in (0..depths.len()).step_by(DEPTH_STRIDE).filter(is_told) {
        let sky = frame.class[pixel] == ClassId::SKY.0;
        if depths[pixel].is_infinite() != sky {
            (seen, off) = (seen + 1, off + 1);
            continue;
        }
        if sky {
            continue;
        }
        let centre = DVec3::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5, 1.0);
        let across = k.inverse() * centre;
        let [x, y] = lens.undistort([across.x, across.y]);
        let point = (eye + axes * (depths[pixel] * DVec3::new(x, y, 1.0))).as_vec3();
        let pixel_m = depths[pixel] / k.x_axis.x;
        let allowed_m = DEPTH_TOLERANCE.0 + DEPTH_TOLERANCE.1 * depths[pixel] + DEPTH_TOLERANCE.2 * pixel_m;
        let rock = frame.instances[pixel].checked_sub(1).and_then(|i| scene.rocks.get(usize::from(i)));
        let distance_m = f64::from(match rock {
            Some(rock) => rock.distance_to_surface(point),
            None => (point.z - scene.terrain.surface_height_at(point.truncate())).abs(),
        });
        seen += 1;
        if distance_m.is_nan() || distance_m > allowed_m {
            off += 1;
            worst = worst.max(distance_m);
        }
    }
    report.expect("depth", index, off as f64 <= (1.0 - DEPTH_SHARE) * seen as f64, || {
        format!("{path}: {off} of {seen} points are off the surface, {worst:.3} m at worst")
    });
    Ok(())
}
