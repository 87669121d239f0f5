//! Every change of a dataset is found: each key of the manifest and of a line, each kind of file of each layout, everything
//! that does not belong into the folder.
//!
//! The places to change are listed from a dataset with all outputs, so that a new output, key or file cannot be forgotten.
//! Where each check has its own tests is in `verify.rs`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use regolith::dataset::merge::{Finalized, finalize};
use regolith::dataset::verify::{Report, check, check_rendering};
use regolith::output::disk::content_hash;
use regolith::output::layout::LAYOUTS;
use regolith::render::{RasterBackend, RasterOptions};
use serde_json::Value;

use crate::support::{self, folder, json, renderer, run_ok};

/// Keys of a line that any run may give another value, with the reason. Nothing else is free.
const FREE: [(&str, &str); 1] = [("/ms", "milliseconds differ in every run; only their form is checked")];

/// Keys of a line that say which renderer made it. They are covered by the digest alone: somebody who computes that again can
/// name any renderer, and frames are then compared with tolerances.
const RENDERER: [&str; 2] = ["/adapter", "/raster"];

/// A dataset in the layout `folder` with all outputs, two splits and redrawn frames, and its conversions, each in a folder with
/// the name of its layout.
static DATASETS: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = folder();
    let words = ["dataset", "-q", "--split=train=3,val=2", "--size=48", "--samples=1", "--outputs=all"];
    let scene = ["--preset=train_dr", "--set=terrain.cells=60", "--set=rocks.count=20", "--out=folder"];
    let rule = ["--set=rules.require={rock=[0.05, 0.9]}"];
    run_ok(folder.path(), &[&words[..], &scene, &rule].concat());
    for row in LAYOUTS.iter().filter(|row| row.name != "folder") {
        run_ok(folder.path(), &["convert", "folder", "--format", row.name, "--out", row.name, "-q"]);
    }
    folder
});

/// A copy of the dataset in a layout.
struct Copy(tempfile::TempDir);

impl Copy {
    fn new(layout: &str) -> Self {
        let copy = folder();
        let source = DATASETS.path().join(layout);
        for (path, bytes) in files(&source) {
            let to = copy.path().join(path);
            fs::create_dir_all(to.parent().expect("a folder")).expect("created");
            fs::write(to, bytes).expect("written");
        }
        Self(copy)
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Whether anything is found without rendering.
    fn is_found(&self) -> bool {
        check(self.path(), |_, _| {}).map_or(true, |report| !report.problems.is_empty())
    }

    /// Whether anything is found by rendering all frames again.
    fn is_found_by_rendering(&self, frames: u64) -> bool {
        let mut report = Report::default();
        let result = check_rendering(self.path(), &mut renderer(), frames, &mut report);
        result.is_err() || !report.problems.is_empty()
    }

    /// Changes a file, and restores it afterwards. Returns whether the change is found.
    fn is_change_found(&self, path: &str, change: impl FnOnce(&Path, &[u8])) -> bool {
        let file = self.path().join(path);
        let before = fs::read(&file).expect("read");
        change(&file, &before);
        let is_found = self.is_found();
        fs::write(file, before).expect("written");
        is_found
    }

    fn line(&self, number: usize) -> Value {
        let text = fs::read_to_string(self.path().join("frames.jsonl")).expect("read");
        serde_json::from_str(text.lines().nth(number).expect("a line")).expect("JSON")
    }

    /// Replaces a line.
    fn set_line(&self, number: usize, line: &Value) {
        let path = self.path().join("frames.jsonl");
        let text = fs::read_to_string(&path).expect("read");
        let lines = text
            .lines()
            .enumerate()
            .map(|(i, old)| if i == number { format!("{line}\n") } else { format!("{old}\n") });
        let changed: String = lines.collect();
        fs::write(path, changed).expect("written");
    }
}

/// Path and content of every file below a folder, sorted.
fn files(root: &Path) -> Vec<(String, Vec<u8>)> {
    let (mut files, mut folders) = (Vec::new(), vec![root.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).expect("below").display().to_string();
                files.push((name, fs::read(path).expect("read")));
            }
        }
    }
    files.sort();
    files
}

/// The pointers to all values in a JSON value, and whether each is an object or an array.
fn pointers(value: &Value) -> Vec<(String, bool)> {
    let mut found = Vec::new();
    let mut waiting = vec![(String::new(), value)];
    while let Some((pointer, value)) = waiting.pop() {
        match value {
            Value::Object(map) => {
                let escape = |key: &str| key.replace('~', "~0").replace('/', "~1");
                waiting.extend(map.iter().map(|(key, value)| (format!("{pointer}/{}", escape(key)), value)));
            }
            Value::Array(list) => {
                waiting.extend(list.iter().enumerate().map(|(i, value)| (format!("{pointer}/{i}"), value)));
            }
            _ => {}
        }
        found.push((pointer, value.is_object() || value.is_array()));
    }
    found.sort();
    found
}

/// All changes of a JSON value: each value changed, of another type, removed; each object and list with one more.
fn changes(value: &Value) -> Vec<(String, Value)> {
    let mut changed = Vec::new();
    for (pointer, is_container) in pointers(value) {
        let mut add = |what: &str, change: &dyn Fn(&mut Value)| {
            let mut copy = value.clone();
            change(copy.pointer_mut(&pointer).expect("a value"));
            assert_ne!(copy, *value, "{what} {pointer}");
            changed.push((format!("{pointer} {what}"), copy));
        };
        add("of another type", &|value| *value = if value.is_string() { 7.into() } else { "seven".into() });
        if is_container {
            add("with one more", &|value| match value {
                Value::Object(map) => drop(map.insert("surplus".to_owned(), 7.into())),
                Value::Array(list) => list.push(list.last().cloned().unwrap_or(7.into())),
                _ => {}
            });
        } else {
            add("with another value", &|value| {
                *value = match &*value {
                    Value::String(text) => other_text(text).into(),
                    Value::Number(number) if number.is_u64() => (number.as_u64().expect("whole") ^ 1).into(),
                    Value::Number(number) => other_number(number.as_f64().expect("a number")).into(),
                    _ => Value::Bool(true),
                }
            });
        }
        if let Some((parent, key)) = pointer.rsplit_once('/') {
            let mut copy = value.clone();
            match copy.pointer_mut(parent).expect("a parent") {
                Value::Object(map) => {
                    drop(map.shift_remove(&key.replace("~1", "/").replace("~0", "~")).expect("a key"));
                }
                Value::Array(list) => drop(list.remove(key.parse().expect("an index"))),
                _ => {}
            }
            changed.push((format!("{pointer} removed"), copy));
        }
    }
    changed
}

/// Another number of the same magnitude: half of it and an eighth, which of a quarter, as a time may be, would be a quarter again.
fn other_number(number: f64) -> f64 {
    if number == 0.25 { 0.125 } else { number * 0.5 + 0.125 }
}

/// Another text of the same form.
fn other_text(text: &str) -> String {
    let last = text.chars().last().unwrap_or('a');
    let kept = text.strip_suffix(last).unwrap_or_default();
    format!("{kept}{}", if last == '1' { '2' } else { '1' })
}

/// A file's name with its digits replaced: the same for all frames.
fn kind_of(path: &str) -> String {
    path.replace("train", "*").replace("val", "*").replace(|c: char| c.is_ascii_digit(), "#")
}

/// The first file of each kind, and the kinds that the manifest and the log are.
fn one_of_each_kind(root: &Path) -> Vec<(String, Vec<u8>)> {
    let mut kinds = std::collections::BTreeSet::new();
    files(root).into_iter().filter(|(path, _)| kinds.insert(kind_of(path))).collect()
}

/// Another file of the same kind with other content, if there is one.
fn file_of_another_frame(root: &Path, path: &str, bytes: &[u8]) -> Option<Vec<u8>> {
    let is_other = |(other, content): &(String, Vec<u8>)| {
        kind_of(other) == kind_of(path) && other != path && content != bytes
    };
    files(root).into_iter().find(is_other).map(|(_, content)| content)
}

#[test]
fn intact_datasets_pass() {
    for row in &LAYOUTS {
        let copy = Copy::new(row.name);
        let mut report = check(copy.path(), |_, _| {}).expect("checked");
        check_rendering(copy.path(), &mut renderer(), u64::MAX, &mut report).expect("rendered");
        assert!(report.problems.is_empty(), "{}: {:#?}", row.name, report.problems);
        assert_eq!(report.frames, 5);
    }
    let lines = fs::read_to_string(DATASETS.path().join("folder/frames.jsonl")).expect("read");
    assert!(lines.contains("\"redrawn\""), "the test needs a frame that was redrawn");
}

#[test]
fn every_key_of_the_manifest_is_checked() {
    // COCO has no contact sheet, which takes longer than all other checks.
    for (layout, is_wanted) in [("coco", ""), ("folder", "/index_files"), ("webdataset", "/index_files")] {
        let copy = Copy::new(layout);
        let manifest = json(&copy.path().join("manifest.json"));
        let missed: Vec<String> = changes(&manifest)
            .into_iter()
            .filter(|(what, _)| what.starts_with(is_wanted))
            .filter(|(_, changed)| {
                !copy.is_change_found("manifest.json", |path, _| {
                    fs::write(path, format!("{changed:#}\n")).expect("written");
                })
            })
            .map(|(what, _)| what)
            .collect();
        assert!(missed.is_empty(), "{layout}: not found: {missed:#?}");
    }
}

#[test]
fn every_key_of_a_line_is_checked() {
    for (layout, is_wanted) in
        [("coco", &[""][..]), ("webdataset", &["/hashes", "/entry"]), ("hf", &["/entry"])]
    {
        let copy = Copy::new(layout);
        let text = fs::read_to_string(copy.path().join("frames.jsonl")).expect("read");
        let redrawn = text.lines().position(|line| line.contains("\"redrawn\"")).expect("a redrawn frame");
        let line = copy.line(redrawn);
        let missed: Vec<String> = changes(&line)
            .into_iter()
            .filter(|(what, _)| is_wanted.iter().any(|wanted| what.starts_with(wanted)))
            .filter(|(what, _)| !FREE.iter().any(|(free, _)| what.starts_with(free)))
            .filter(|(_, changed)| {
                !copy.is_change_found("frames.jsonl", |_, _| copy.set_line(redrawn, changed))
            })
            .map(|(what, _)| what)
            .collect();
        assert!(missed.is_empty(), "{layout}: not found: {missed:#?}");
        // Keys of the free ones are of a fixed form.
        let mut changed = line.clone();
        changed["ms"]["scene"] = "fast".into();
        assert!(copy.is_change_found("frames.jsonl", |_, _| copy.set_line(redrawn, &changed)));
        changed.as_object_mut().expect("an object").shift_remove("ms");
        assert!(copy.is_change_found("frames.jsonl", |_, _| copy.set_line(redrawn, &changed)));
    }
}

#[test]
fn every_kind_of_file_is_checked() {
    for row in &LAYOUTS {
        let copy = Copy::new(row.name);
        let mut missed = Vec::new();
        for (path, bytes) in one_of_each_kind(copy.path()) {
            let mut try_change = |what: &str, change: &dyn Fn(&Path)| {
                if !copy.is_change_found(&path, |file, _| change(file)) {
                    missed.push(format!("{path} {what}"));
                }
            };
            try_change("removed", &|file| fs::remove_file(file).expect("removed"));
            for (what, content) in [
                ("emptied", Vec::new()),
                ("cut off", bytes[..bytes.len() / 2].to_vec()),
                ("continued", [&bytes[..], b"x"].concat()),
            ] {
                try_change(what, &|file| fs::write(file, &content).expect("written"));
            }
            if path != "frames.jsonl" {
                let mut flipped = bytes.clone();
                flipped[bytes.len() / 2] ^= 1;
                try_change("flipped", &|file| fs::write(file, &flipped).expect("written"));
            }
            if let Some(other) = file_of_another_frame(copy.path(), &path, &bytes) {
                try_change("swapped", &|file| fs::write(file, &other).expect("written"));
            }
        }
        assert!(missed.is_empty(), "{}: not found: {missed:#?}", row.name);
    }
}

#[test]
fn everything_that_does_not_belong_there_is_found() {
    for row in &LAYOUTS {
        let copy = Copy::new(row.name);
        let mut folders: Vec<PathBuf> = vec![PathBuf::new()];
        folders.extend(files(copy.path()).iter().filter_map(|(path, _)| {
            Some(Path::new(path).parent()?.to_owned()).filter(|folder| folder != Path::new(""))
        }));
        folders.sort();
        folders.dedup();
        let names = [
            "notes.txt",
            ".DS_Store",
            ".lock",
            ".lock-0-of-1",
            ".writing-x",
            "frames-0-of-2.jsonl",
            "manifest-0-of-2.json",
            "rgb_00099.png",
            "000099.png",
        ];
        for folder in &folders {
            let is_root = folder == Path::new("");
            for name in names.iter().take(if is_root { names.len() } else { 1 }) {
                let path = copy.path().join(folder).join(name);
                fs::write(&path, "{}").expect("written");
                assert!(copy.is_found(), "{}: {}", row.name, path.display());
                fs::remove_file(path).expect("removed");
            }
            let path = copy.path().join(folder).join("stranger");
            fs::create_dir(&path).expect("created");
            assert!(copy.is_found(), "{}: {}", row.name, path.display());
            fs::remove_dir(path).expect("removed");
        }
        assert!(!copy.is_found(), "{}", row.name);
    }
}

#[test]
fn a_frame_without_image_mask_and_their_hashes_is_found() {
    for (layout, paths) in [
        ("folder", ["train/rgb/rgb_00001.png", "train/mask/mask_00001.png"]),
        ("hf", ["train/images/000001.png", "train/masks/000001.png"]),
    ] {
        let copy = Copy::new(layout);
        let mut line = copy.line(1);
        for path in paths {
            fs::remove_file(copy.path().join(path)).expect("removed");
            line["hashes"].as_object_mut().expect("hashes").shift_remove(path).expect("its hash");
        }
        copy.set_line(1, &line);
        let report = check(copy.path(), |_, _| {}).expect("checked");
        for path in paths {
            let is_named = |check: &str| {
                report.problems.iter().any(|problem| problem.check == check && problem.found.contains(path))
            };
            assert!(is_named("files") && is_named("records"), "{path}: {:#?}", report.problems);
        }
    }
}

/// Completes a dataset again as somebody does who wants its changes to count: without the digest of what it had.
fn complete_again(folder: &Path) -> regolith::Result<Finalized> {
    let path = folder.join("manifest.json");
    let mut manifest = json(&path);
    manifest.as_object_mut().expect("a manifest").shift_remove("digest");
    fs::write(path, manifest.to_string()).expect("written");
    finalize(folder)
}

/// Replaces a file of frame `index`, with its hash in the line, and has the dataset completed again: everything that can be
/// computed from the files agrees with the change.
fn forge(copy: &Copy, index: usize, path: &str, bytes: &[u8]) {
    fs::write(copy.path().join(path), bytes).expect("written");
    let mut line = copy.line(index);
    line["hashes"][path] = content_hash(bytes).into();
    copy.set_line(index, &line);
    complete_again(copy.path()).expect("completed");
}

#[test]
fn every_output_of_a_frame_that_is_rendered_again_is_compared() {
    for row in LAYOUTS.iter().filter(|row| row.name != "webdataset") {
        let mut outputs = 0;
        let root = DATASETS.path().join(row.name);
        let line = Copy::new(row.name).line(0);
        for (path, bytes) in files(&root) {
            // The label files are the same for all frames.
            let is_of_frame = line["hashes"].get(&path).is_some();
            let other = file_of_another_frame(&root, &path, &bytes).filter(|_| is_of_frame);
            if let Some(other) = other {
                let copy = Copy::new(row.name);
                forge(&copy, 0, &path, &other);
                assert!(copy.is_found_by_rendering(1), "{}: {path}", row.name);
                outputs += 1;
            }
        }
        assert!(outputs >= 2, "{}", row.name);
    }
}

/// Frames of another raster backend pass, in every output and format, and those of another scene do not.
#[test]
fn tolerances_for_other_renderers_hold_and_show_another_scene() {
    let root = DATASETS.path().join("folder");
    let line = Copy::new("folder").line(0);
    let (mut wrong, mut missed) = (Vec::new(), Vec::new());
    let mut renderer = renderer();
    let own = renderer.raster();
    renderer.set_raster(RasterOptions {
        visibility: RasterBackend::Device,
        shadow: RasterBackend::Device,
        ..own
    });
    for row in &LAYOUTS {
        let mut report = Report::default();
        let result = check_rendering(&DATASETS.path().join(row.name), &mut renderer, u64::MAX, &mut report);
        wrong.extend(report.problems.into_iter().map(|problem| format!("{}: {problem:?}", row.name)));
        wrong.extend(result.err().map(|error| error.to_string()));
    }
    let mut exchanged = 0;
    for (path, bytes) in files(&root).into_iter().filter(|(path, _)| line["hashes"].get(path).is_some()) {
        let Some(other) = file_of_another_frame(&root, &path, &bytes) else { continue };
        exchanged += 1;
        let copy = Copy::new("folder");
        forge(&copy, 0, &path, &other);
        let mut report = Report::default();
        let result = check_rendering(copy.path(), &mut renderer, 1, &mut report);
        if result.is_ok() && report.problems.is_empty() {
            missed.push(path);
        }
    }
    renderer.set_raster(own);
    drop(renderer);
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(missed.is_empty(), "not found: {missed:#?}");
    assert!(exchanged > 10, "{exchanged} files differ from those of another frame");
}

#[test]
fn every_member_of_a_sample_that_is_rendered_again_is_compared() {
    let archive = fs::read(DATASETS.path().join("webdataset/train-000000.tar")).expect("read");
    let members = regolith::output::layout::webdataset::members(&archive).expect("an archive");
    let sample = |key: &str| members.iter().filter(|(name, _)| name.starts_with(key)).collect::<Vec<_>>();
    let [first, second] = ["000000000", "000000001"].map(sample);
    assert!(first.len() > 15 && first.len() == second.len());
    let different: Vec<usize> = (0..first.len()).filter(|&i| first[i].1 != second[i].1).collect();
    assert!(different.len() > 10, "{} members differ", different.len());
    for changed in different {
        let copy = Copy::new("webdataset");
        let mut fragment = tar::Builder::new(Vec::new());
        for (i, (name, bytes)) in first.iter().enumerate() {
            let bytes = if i == changed { &second[i].1 } else { bytes };
            let mut header = tar::Header::new_ustar();
            header.set_mode(0o644);
            header.set_uid(0);
            header.set_gid(0);
            header.set_size(bytes.len() as u64);
            fragment.append_data(&mut header, name, &bytes[..]).expect("added");
        }
        let mut fragment = fragment.into_inner().expect("an archive");
        fragment.truncate(fragment.len() - 1024);
        fs::create_dir(copy.path().join(".parts")).expect("created");
        forge(&copy, 0, ".parts/000000000.tar", &fragment);
        assert!(copy.is_found_by_rendering(1), "{}", first[changed].0);
    }
}

#[test]
fn every_section_of_a_line_of_a_frame_that_is_rendered_again_is_compared() {
    let copy = Copy::new("folder");
    let line = copy.line(0);
    let mut compared = Vec::new();
    for key in line.as_object().expect("an object").keys() {
        let pointer = format!("/{key}");
        let is_free = FREE.iter().any(|(free, _)| *free == pointer) || RENDERER.contains(&pointer.as_str());
        if is_free || key == "hashes" || key == "index" {
            continue;
        }
        // The last change of each section that a completed dataset can have.
        let wanted = |(what, _): &(String, Value)| {
            what.starts_with(&pointer) && what.contains("with another value") && !what.contains("surplus")
        };
        let Some((what, changed)) = changes(&line).into_iter().rfind(wanted) else { continue };
        let copy = Copy::new("folder");
        copy.set_line(0, &changed);
        if complete_again(copy.path()).is_ok() {
            let is_found = copy.is_found_by_rendering(1);
            assert!(is_found, "{what}");
            compared.push(key.as_str());
        }
    }
    assert!(compared.len() > 5, "only {compared:?} could be changed");
}

/// The same number of pixels of each class at other positions, with the hash changed too: only the digest shows it in a frame
/// that is not rendered again.
#[test]
fn swapped_pixels_are_found_in_every_frame_by_the_digest() {
    for index in 0..3 {
        let copy = Copy::new("folder");
        let path = format!("train/mask/mask_{index:05}.png");
        let mask = image::open(copy.path().join(&path)).expect("a mask").into_luma8();
        let mut bytes = std::io::Cursor::new(Vec::new());
        let flipped = image::imageops::flip_horizontal(&mask);
        flipped.write_to(&mut bytes, image::ImageFormat::Png).expect("encoded");
        let bytes = bytes.into_inner();
        fs::write(copy.path().join(&path), &bytes).expect("written");
        let mut line = copy.line(index);
        line["hashes"][path] = content_hash(&bytes).into();
        copy.set_line(index, &line);
        let report = check(copy.path(), |_, _| {}).expect("checked");
        let is_digest = report.problems.iter().any(|problem| problem.check == "digest");
        assert!(is_digest, "{:#?}", report.problems);
        // Somebody who completes the dataset again has another digest; a new rendering still shows it.
        complete_again(copy.path()).expect("completed");
        assert!(copy.is_found_by_rendering(u64::MAX));
    }
}

#[test]
fn numbers_near_the_limits_are_refused_at_once() {
    let copy = Copy::new("coco");
    let manifest = json(&copy.path().join("manifest.json"));
    for (key, value) in [
        ("count", u64::MAX.into()),
        ("count", (1_u64 << 63).into()),
        ("count", (1_u64 << 32).into()),
        ("start", u64::MAX.into()),
        ("start", (i64::MAX).into()),
        ("samples", u64::MAX.into()),
        ("size", serde_json::json!([u32::MAX, u32::MAX])),
        ("splits", serde_json::json!({ "train": { "start": 0, "count": u64::MAX, "seeds": [0, 0] } })),
        ("splits", serde_json::json!({ "../x": { "start": 0, "count": 5, "seeds": [0, 0] } })),
    ] {
        let mut changed = manifest.clone();
        changed[key] = value;
        let begin = std::time::Instant::now();
        let is_found = copy.is_change_found("manifest.json", |path, _| {
            fs::write(path, changed.to_string()).expect("written");
        });
        assert!(is_found && begin.elapsed().as_secs() < 5, "{key} {}", changed[key]);
    }
    let line = copy.line(2);
    for (key, value) in [("index", u64::MAX), ("attempt", u64::from(u32::MAX)), ("seed", u64::MAX)] {
        let mut changed = line.clone();
        changed[key] = value.into();
        assert!(copy.is_change_found("frames.jsonl", |_, _| copy.set_line(2, &changed)), "{key}");
        let output = support::run(copy.path(), &["verify", ".", "--rerender", "0", "-q"]);
        assert_eq!(output.status.code(), Some(0));
    }
}
