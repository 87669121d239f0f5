//! Outputs that are added to a finished dataset are those of a dataset that was made with them, whatever interrupts the addition.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::formats::content;
use crate::support::{folder, json, program, run, run_ok};

const SMALL: [&str; 9] = [
    "dataset",
    "-q",
    "--size=48",
    "--samples=1",
    "--preset=train_dr",
    "--set=terrain.cells=60",
    "--set=rocks.count=20",
    "--set=label.min_pixels=6",
    "--set=label.too_small=ignore",
];
const ALL: &str = "--outputs=rgb,mask,depth,instances,preview,meta";
const FEW: &str = "--outputs=rgb,mask,preview";

fn make(folder: &Path, out: &str, more: &[&str]) {
    run_ok(folder, &[&SMALL[..], &["--out", out], more].concat());
}

#[track_caller]
fn assert_same(folder: &Path, a: &str, b: &str) {
    let (a, b) = (content(&folder.join(a)), content(&folder.join(b)));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name} differs");
    }
}

/// Copies a folder with all below it.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("made");
    for entry in fs::read_dir(from).expect("a folder") {
        let path = entry.expect("an entry").path();
        let target = to.join(path.file_name().expect("a name"));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, target).expect("copied");
        }
    }
}

#[test]
fn added_outputs_are_those_of_a_dataset_made_at_once() {
    let folder = folder();
    let path = folder.path();
    for (format, frames) in [("folder", "--split=train=3,val=2"), ("basic", "--count=2"), ("hf", "--count=2")]
    {
        let (all, few) = if format == "hf" {
            ("--outputs=rgb,mask,depth,instances", "--outputs=rgb,mask")
        } else {
            (ALL, FEW)
        };
        let format_word = format!("--format={format}");
        let whole = format!("{format}_whole");
        make(path, &whole, &[frames, all, &format_word]);
        make(path, format, &[frames, few, &format_word]);
        let before = content(&path.join(format));
        let added = if format == "hf" { "depth,instances" } else { "instances,meta,depth" };
        let words = ["dataset", "--add-outputs", added, format, "--json", "-q"];
        let summary: Value = serde_json::from_str(&run_ok(path, &words)).expect("JSON");
        assert_eq!(summary["status"], "done");
        assert_same(path, format, &whole);
        let kept = before.keys().filter(|name| name.ends_with(".png") && *name != "contact_sheet.png");
        assert!(kept.clone().count() >= 4);
        // A second time nothing is rendered, and nothing changes.
        let summary: Value = serde_json::from_str(&run_ok(path, &words)).expect("JSON");
        assert_eq!(summary["made"], 0);
        assert_same(path, format, &whole);
        let report = run_ok(path, &["verify", format, "--rerender", "1", "--json"]);
        assert!(report.contains("\"good\": true"), "{report}");
    }
    // The manifest's command makes the dataset with what was added.
    let manifest = json(&path.join("folder/manifest.json"));
    assert!(
        manifest["command"].as_str().is_some_and(|command| command.contains("depth,instances")),
        "{manifest}"
    );
    run_ok(path, &["convert", "folder", "--format=coco", "--out=coco", "-q"]);
}

#[test]
fn a_killed_addition_leaves_the_dataset_as_it_was_and_is_continued() {
    let folder = folder();
    let path = folder.path();
    make(path, "whole", &["--count=40", ALL]);
    make(path, "data", &["--count=40", FEW]);
    let before = content(&path.join("data"));
    let words = ["dataset", "--add-outputs", "depth,instances,meta", "data", "-q", "--threads=1"];
    let mut child = program(path).args(words).spawn().expect("started");
    let start = Instant::now();
    let log = path.join("data/frames-added.jsonl");
    let lines = || fs::read_to_string(&log).map_or(0, |text| text.lines().count());
    while lines() < 3 && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().and_then(|()| child.wait()).expect("killed");
    assert!((3..41).contains(&lines()), "{} lines: killed in between", lines());
    // Every file of the dataset is what it was; other outputs have to wait, and whoever asks for less changes nothing.
    let during = content(&path.join("data"));
    assert!(before.iter().all(|(name, bytes)| during.get(name) == Some(bytes)));
    for words in [["--add-outputs", "normals"], ["--add-outputs", "rgb"]] {
        let refused = run(path, &[&["dataset"], &words[..], &["data"]].concat());
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(2) && message.contains("depth,instances,meta"), "{message}");
    }
    let summary: Value =
        serde_json::from_str(&run_ok(path, &[&words[..], &["--json"]].concat())).expect("JSON");
    assert!(summary["made"].as_u64().is_some_and(|made| (1..39).contains(&made)), "{summary}");
    assert_same(path, "data", "whole");
}

#[test]
fn an_addition_that_stopped_at_its_end_is_completed() {
    let folder = folder();
    let path = folder.path();
    make(path, "whole", &["--count=3", ALL]);
    make(path, "few", &["--count=3", FEW]);
    let read = |name: &str| fs::read_to_string(path.join(name)).expect("read");
    let log = format!("{{\"adds\":[\"depth\",\"instances\",\"meta\"]}}\n{}", read("whole/frames.jsonl"));
    let mut running = json(&path.join("whole/manifest.json"));
    for key in ["seeds", "adapters", "totals", "index_files", "digest"] {
        running.as_object_mut().expect("an object").shift_remove(key);
    }
    running["status"] = "running".into();
    let running = format!("{running:#}\n");
    // Before the manifest is replaced; after that; after the lines as well.
    for state in 0..3 {
        let data = format!("data{state}");
        let at = |name: &str| path.join(&data).join(name);
        copy(&path.join("few"), &path.join(&data));
        for output in ["depth", "instances", "meta"] {
            copy(&path.join("whole").join(output), &at(output));
        }
        match state {
            0 => fs::write(at("frames-added.jsonl"), &log).expect("written"),
            1 => {
                fs::write(at("frames-added.jsonl"), &log).expect("written");
                fs::write(at("manifest.json"), &running).expect("written");
            }
            _ => {
                fs::write(at("frames.jsonl"), read("whole/frames.jsonl")).expect("written");
                fs::write(at("manifest.json"), &running).expect("written");
            }
        }
        let words = ["dataset", "--add-outputs", "depth,instances,meta", &data, "-q", "--json"];
        let summary: Value = serde_json::from_str(&run_ok(path, &words)).expect("JSON");
        assert_eq!(summary["made"], 0, "state {state}");
        assert_same(path, &data, "whole");
    }
}

/// Else the dataset would get the line that the frame had before it was made again.
#[test]
fn a_frame_that_was_made_again_meanwhile_is_rendered_again() {
    let folder = folder();
    let path = folder.path();
    make(path, "whole", &["--count=3", ALL]);
    make(path, "few", &["--count=3", FEW]);
    let lines = fs::read_to_string(path.join("whole/frames.jsonl")).expect("read");
    let line: Value = serde_json::from_str(lines.lines().nth(1).expect("a line")).expect("JSON");
    let hash = line["hashes"]["rgb/rgb_00001.png"].as_str().expect("a hash");
    let log =
        "{\"adds\":[\"depth\",\"instances\",\"meta\"]}\n".to_owned() + &lines.replace(hash, &"0".repeat(32));
    for output in ["depth", "instances", "meta"] {
        copy(&path.join("whole").join(output), &path.join("few").join(output));
    }
    // The addition is resumed; and it was finished by other means, and its log is left.
    copy(&path.join("whole"), &path.join("finished"));
    for (data, made) in [("few", 1), ("finished", 0)] {
        fs::write(path.join(data).join("frames-added.jsonl"), &log).expect("written");
        let words = ["dataset", "--add-outputs", "depth,instances,meta", data, "-q", "--json"];
        let summary: Value = serde_json::from_str(&run_ok(path, &words)).expect("JSON");
        assert_eq!(summary["made"], made, "{data}");
        assert_same(path, data, "whole");
    }
}

#[test]
fn frames_that_do_not_come_out_again_get_nothing() {
    let folder = folder();
    let path = folder.path();
    make(path, "data", &["--count=6", FEW]);
    let lines = path.join("data/frames.jsonl");
    let good = fs::read_to_string(&lines).expect("read");
    let hash = |frame: usize| {
        let line: Value = serde_json::from_str(good.lines().nth(frame).expect("a line")).expect("JSON");
        line["hashes"][format!("rgb/rgb_{frame:05}.png")].as_str().expect("a hash").to_owned()
    };
    for (frame, what, changed) in [
        (0, "rgb/rgb_00000.png", good.replace(&hash(0), &"0".repeat(32))),
        (5, "rgb/rgb_00005.png", good.replace(&hash(5), &"0".repeat(32))),
        (0, "adapter", good.replacen("\"adapter\":\"", "\"adapter\":\"Voodoo ", 1)),
    ] {
        assert_ne!(changed, good);
        fs::write(&lines, changed).expect("written");
        let before = content(&path.join("data"));
        let refused = run(path, &["dataset", "--add-outputs", "depth,instances", "data", "-q"]);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(1), "{message}");
        assert!(message.contains(&format!("frame {frame}:")) && message.contains(what), "{message}");
        let after = content(&path.join("data"));
        assert!(before == after, "{:?}", after.keys());
        assert!(!path.join("data/depth").exists() && !path.join("data/instances").exists());
    }
}

#[test]
fn what_cannot_be_added_to_is_refused_with_the_remedy() {
    let folder = folder();
    let path = folder.path();
    make(path, "plain", &["--count=2", "--outputs=rgb,mask,instances"]);
    make(path, "half", &["--count=2", FEW, "--shard=0/2"]);
    make(path, "other", &["--count=2", FEW]);
    let manifest = path.join("other/manifest.json");
    let text = fs::read_to_string(&manifest).expect("read");
    let version = format!("\"version\": \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(text.contains(&version));
    fs::write(&manifest, text.replace(&version, "\"version\": \"0.0.1\"")).expect("written");
    for format in ["webdataset", "coco", "yolo"] {
        run_ok(path, &["convert", "plain", "--format", format, "--out", format, "-q"]);
    }
    for (data, list, expected) in [
        ("webdataset", "depth", "add the outputs to the dataset of format folder"),
        ("coco", "depth", "has no place for depth"),
        ("yolo", "depth", "has no place for depth"),
        ("half", "depth", "not finished"),
        ("other", "depth", "made by version 0.0.1"),
        ("plain", "deph", "--add-outputs: unknown output `deph` (did you mean `depth`?)"),
        ("nowhere", "depth", "there is no such folder"),
        (".", "depth", "no manifest.json"),
    ] {
        let before = path.join(data).is_dir().then(|| content(&path.join(data)));
        let refused = run(path, &["dataset", "--add-outputs", list, data]);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(2), "{data}: {message}");
        assert!(message.contains(expected), "{data}: {message}");
        assert!(before == path.join(data).is_dir().then(|| content(&path.join(data))), "{data} is unchanged");
    }
    for words in [["--preset", "train_dr"], ["--count", "3"], ["--out", "plain"], ["--size", "64"]] {
        let words = [&["dataset", "--add-outputs", "depth", "plain"][..], &words].concat();
        assert_eq!(run(path, &words).status.code(), Some(2), "{words:?}");
    }
}
