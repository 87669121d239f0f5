//! Datasets: each frame reproducible from its index, interrupted runs resumed to the same bytes; rules, shards, splits.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use regolith::params::Knob;
use regolith::params::config::Config;
use regolith::random::Streams;
use regolith::scene::Scene;
use regolith::scene::rocks::Rock;
use serde_json::{Map, Value};

use crate::support::{
    adapter_below_file_limit, folder, json, program, run, run_ok, run_with_file_limit, send_signal, stoppable,
};

/// Small frames of a small scene.
const SMALL: [&str; 9] = [
    "--size",
    "48",
    "--samples",
    "1",
    "--set=terrain.cells=40",
    "--set=rocks.count=14",
    "--set=sun.elevation_deg={uniform=[5,40]}",
    "--set=camera.exposure_ev=-1",
    "--set=sky.star_count=20",
];

fn dataset<'a>(out: &'a str, words: &[&'a str]) -> Vec<&'a str> {
    [&["dataset", "--out", out], SMALL.as_slice(), words].concat()
}

/// Every file below a folder; `frames.jsonl` without its milliseconds.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn collect(root: &Path, folder: &Path, files: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                collect(root, &path, files);
            } else {
                let name = path.strip_prefix(root).expect("below").display().to_string();
                files.insert(name, std::fs::read(&path).expect("read"));
            }
        }
    }
    let mut files = BTreeMap::new();
    collect(folder, folder, &mut files);
    if files.contains_key("frames.jsonl") {
        let mut lines = lines(folder);
        lines.iter_mut().for_each(|line| drop(line.remove("ms")));
        files.insert("frames.jsonl".to_owned(), format!("{lines:?}").into_bytes());
    }
    files
}

fn lines(folder: &Path) -> Vec<Map<String, Value>> {
    let text = std::fs::read_to_string(folder.join("frames.jsonl")).expect("frames.jsonl");
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[track_caller]
fn assert_same(a: &Path, b: &Path) {
    let (a, b) = (content(a), content(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name} differs");
    }
}

#[test]
fn a_dataset_has_its_layout_and_each_frame_can_be_rendered_alone() {
    let folder = folder();
    run_ok(folder.path(), &dataset("data", &["--count", "27", "--outputs", "all", "-q"]));
    let data = folder.path().join("data");
    let files = content(&data);
    for name in [
        "rgb/rgb_00000.png",
        "mask/mask_00026.png",
        "preview/preview_00025.png",
        "depth/distance_to_image_plane_00003.npy",
        "instances/instance_segmentation_mapping_00026.json",
        "meta/frame_00001.json",
        "hdr/hdr_00001.exr",
        "contact_sheet.png",
        "histograms.svg",
        "README.md",
        "semantic_segmentation_labels.json",
    ] {
        assert!(files.contains_key(name), "{name} is missing");
    }
    assert_eq!(files.keys().filter(|name| name.starts_with("preview/")).count(), 2);
    assert!(!files.keys().any(|name| name.contains("/.") || name.starts_with('.')), "{:?}", files.keys());
    let manifest = json(&data.join("manifest.json"));
    assert_eq!((&manifest["status"], &manifest["n_completed"]), (&"done".into(), &27.into()));
    assert_eq!(manifest["class_map"]["rock"], 1);
    assert_eq!(manifest["ignore_index"], 255);
    assert_eq!(manifest["config"]["sun.elevation_deg"]["uniform"][1], 40.0);

    let lines = lines(&data);
    assert!((0..).zip(&lines).all(|(index, line)| line["index"] == index));
    let line = &lines[17];
    let (seed, exposure) = (line["seed"].to_string(), line["knobs"]["camera.exposure_ev"].as_f64());
    assert_eq!(exposure, Some(-1.0));
    let alone = [&["--seed", &seed, "--out", "alone", "--outputs", "all"], SMALL.as_slice()].concat();
    run_ok(folder.path(), &alone);
    let alone = content(&folder.path().join("alone"));
    for (in_dataset, by_itself) in [
        ("rgb/rgb_00017.png", "rgb_0000.png"),
        ("mask/mask_00017.png", "semantic_segmentation_0000.png"),
        ("normals/normals_00017.npy", "normals_0000.npy"),
    ] {
        assert!(files[in_dataset] == alone[by_itself], "{in_dataset} differs from the frame of its seed");
    }
    let record: Value = serde_json::from_slice(&alone["frame_0000.json"]).expect("JSON");
    for key in ["knobs", "camera", "sun", "coverage", "rgb", "geometry_hash"] {
        assert_eq!(record[key], line[key], "{key}");
    }
    for (path, hash) in line["hashes"].as_object().expect("hashes") {
        assert_eq!(*hash, regolith::output::disk::content_hash(&files[path]), "{path}");
    }
}

#[test]
fn a_run_killed_a_hundred_times_ends_with_the_same_bytes() {
    const KILLS: u64 = 100;
    let folder = folder();
    // Every thread may finish some frames before a kill takes effect: as many as half of the kills do not get through.
    let count = 700.max(300 * std::thread::available_parallelism().map_or(1, usize::from));
    let frames = count.to_string();
    let words =
        |out| dataset(out, &["--count", &frames, "--preset", "train_dr", "-q", "--outputs", "rgb,mask"]);
    let start = Instant::now();
    run_ok(folder.path(), &words("whole"));
    let frame_s = start.elapsed().as_secs_f64() / count as f64;
    let killed = folder.path().join("killed");
    // The time until the first frame exists, on this machine.
    let start = Instant::now();
    let mut child = program(folder.path()).args(words("first")).spawn().expect("started");
    wait_until(|| whole_lines(&folder.path().join("first")) > 0);
    let mut first_s = start.elapsed().as_secs_f64();
    child.kill().and_then(|()| child.wait()).map(drop).expect("killed");

    let mut draw = Streams::new(4).stream("test", 0);
    let (mut at_work, mut before) = (0, 0);
    for kill in 0..KILLS {
        let start = Instant::now();
        let mut child = program(folder.path()).args(words("killed")).spawn().expect("started");
        // Every other kill at any moment, also during startup; the rest shortly after a frame was made.
        if kill % 2 == 0 {
            std::thread::sleep(Duration::from_secs_f64(draw.uniform(0.02, first_s + 5.0 * frame_s)));
        } else {
            wait_until(|| whole_lines(&killed) > before);
            // The machine may have been busy while the first run was timed.
            first_s = first_s.min(start.elapsed().as_secs_f64());
            std::thread::sleep(Duration::from_secs_f64(draw.uniform(0.0, 3.0 * frame_s)));
        }
        child.kill().expect("killed");
        let _ = child.wait();
        let there = whole_lines(&killed);
        at_work += u64::from(there > before);
        before = there;
    }
    assert!(before < count, "the dataset was finished before the last kill");
    assert!(at_work > KILLS / 4, "only {at_work} kills came after a frame was made");
    // A power failure can also leave a truncated line, and a frame without its file.
    use std::io::Write as _;
    let mut journal =
        std::fs::OpenOptions::new().append(true).open(killed.join("frames.jsonl")).expect("open");
    journal.write_all(b"{\"index\": 3, \"seed").expect("truncated");
    std::fs::remove_file(killed.join("mask/mask_00002.png")).expect("removed");
    run_ok(folder.path(), &words("killed"));
    assert_same(&folder.path().join("whole"), &killed);
}

/// Waits until a condition holds that a background process will bring about.
#[track_caller]
fn wait_until(mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed().as_secs() < 120, "the condition did not hold within two minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Lines of a journal that were written whole.
fn whole_lines(folder: &Path) -> usize {
    let text = std::fs::read_to_string(folder.join("frames.jsonl")).unwrap_or_default();
    text.matches('\n').count()
}

/// Resident memory of a process, KiB.
fn resident_kib(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn memory_does_not_grow_over_two_thousand_frames() {
    let folder = folder();
    let words = dataset("data", &["--count", "2000", "-q", "--outputs", "rgb,mask"]);
    let mut child = program(folder.path()).args(&words).stdout(Stdio::null()).spawn().expect("started");
    let path = folder.path().join("data/frames.jsonl");
    let frames = || std::fs::read(&path).map_or(0, |text| text.iter().filter(|byte| **byte == b'\n').count());
    // Scenes differ in size, so the mean memory of two parts of the run is compared.
    let (mut early, mut late) = (Vec::new(), Vec::new());
    while child.try_wait().expect("a process").is_none() {
        let memory = resident_kib(child.id());
        match frames() {
            100..400 => early.extend(memory),
            1600..1990 => late.extend(memory),
            _ => {}
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(child.wait().expect("ended").success());
    let mean = |samples: &[u64]| samples.iter().sum::<u64>() as f64 / samples.len() as f64;
    assert!(early.len() > 10 && late.len() > 10, "{} and {} samples", early.len(), late.len());
    let (early, late) = (mean(&early), mean(&late));
    println!("resident memory: {:.1} MiB early, {:.1} MiB late", early / 1024.0, late / 1024.0);
    assert!(late < 1.05 * early, "resident memory grew from {early} KiB to {late} KiB");
}

#[test]
fn ctrl_c_finishes_frames_in_flight_and_says_how_to_continue() {
    let folder = folder();
    let words = dataset("data", &["--count", "400"]);
    let child = stoppable(folder.path()).args(&words).stderr(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let child = child.expect("started");
    wait_until(|| whole_lines(&folder.path().join("data")) > 2);
    send_signal(&child, "-INT");
    let output = child.wait_with_output().expect("ended");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{message}");
    assert!(message.contains("of 400 frames are finished") && message.contains("same command"), "{message}");
    let data = folder.path().join("data");
    assert_eq!(json(&data.join("manifest.json"))["status"], "stopped");
    let lines = lines(&data);
    let images = std::fs::read_dir(data.join("rgb")).expect("images").count();
    assert!(!lines.is_empty() && lines.len() == images, "{} lines, {images} images", lines.len());
    assert_eq!(json(&data.join("manifest.json"))["n_completed"], lines.len());
}

#[test]
fn shards_in_one_folder_or_merged_equal_an_unsharded_run() {
    let folder = folder();
    run_ok(folder.path(), &dataset("whole", &["--count", "10", "-q"]));
    let words = |out, shard| dataset(out, &["--count", "10", "-q", "--shard", shard]);
    let mut together: Vec<_> = ["0/3", "1/3", "2/3"]
        .map(|shard| {
            program(folder.path())
                .args(words("together", shard))
                .stdout(Stdio::null())
                .spawn()
                .expect("started")
        })
        .into();
    for child in &mut together {
        assert!(child.wait().expect("ended").success());
    }
    assert_same(&folder.path().join("whole"), &folder.path().join("together"));

    for (out, shard) in [("a", "0/2"), ("b", "1/2")] {
        run_ok(folder.path(), &words(out, shard));
        let manifest = json(&folder.path().join(out).join("manifest.json"));
        assert_eq!(manifest["status"], "incomplete");
        assert_eq!(lines(&folder.path().join(out)).len(), 5);
    }
    let refused = run(folder.path(), &["dataset", "--merge", "--out", "a"]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && message.contains("5 frames are missing"), "{message}");
    let copied = Command::new("cp").args(["-r", "b/.", "a"]).current_dir(folder.path()).status().expect("cp");
    assert!(copied.success());
    run_ok(folder.path(), &["dataset", "--merge", "--out", "a"]);
    assert_same(&folder.path().join("whole"), &folder.path().join("a"));
}

#[test]
fn threads_order_and_later_growth_change_no_byte() {
    let folder = folder();
    run_ok(folder.path(), &dataset("one", &["--count", "8", "--threads", "1", "-q"]));
    for threads in ["2", "8"] {
        let words = dataset(threads, &["--count", "8", "--threads", threads, "-q"]);
        let output =
            program(folder.path()).args(words).env("RAYON_NUM_THREADS", threads).output().expect("run");
        assert!(output.status.success());
        assert_same(&folder.path().join("one"), &folder.path().join(threads));
    }
    run_ok(folder.path(), &dataset("grown", &["--count", "3", "--start", "2", "-q"]));
    run_ok(folder.path(), &dataset("grown", &["--count", "3", "--start", "5", "-q"]));
    run_ok(folder.path(), &dataset("grown", &["--count", "8", "-q"]));
    assert_same(&folder.path().join("one"), &folder.path().join("grown"));
    let separate = run(folder.path(), &dataset("grown", &["--count", "1", "--start", "50", "-q"]));
    assert!(String::from_utf8_lossy(&separate.stderr).contains("frames in between would be missing"));
}

#[test]
fn a_folder_of_another_configuration_or_with_other_files_is_refused() {
    let folder = folder();
    run_ok(folder.path(), &dataset("data", &["--count", "2", "-q"]));
    let before = content(&folder.path().join("data"));
    for (words, expected) in [
        (
            vec!["--count", "2", "--set", "sun.elevation_deg=9"],
            "sun.elevation_deg: there {\"uniform\":[5.0,40.0]}, now 9.0",
        ),
        (vec!["--count", "2", "--seed", "43"], "base_seed: there 42, now 43"),
        (vec!["--count", "2", "--outputs", "rgb,mask,depth"], "outputs"),
        (vec!["--count", "2", "--set", "rules.clipped_max=0.1"], "rules.clipped_max: there 0.5, now 0.1"),
        (vec!["--count", "2", "--edges", "ignore:1", "--force"], "edges"),
    ] {
        let output = run(folder.path(), &dataset("data", &words));
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains("another configuration") && message.contains(expected),
            "{words:?}: {message}"
        );
    }
    assert_eq!(content(&folder.path().join("data")), before);

    std::fs::create_dir(folder.path().join("thesis")).expect("made");
    std::fs::write(folder.path().join("thesis/thesis.tex"), "years of work").expect("written");
    let output = run(folder.path(), &dataset("thesis", &["--count", "1"]));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("thesis.tex"), "{message}");
    run_ok(folder.path(), &dataset("thesis", &["--count", "1", "--force", "-q"]));
    assert!(folder.path().join("thesis/thesis.tex").exists());
}

#[test]
fn a_wrong_configuration_is_refused_before_anything_is_written() {
    let folder = folder();
    std::fs::write(folder.path().join("broken.toml"), "[sun\nelevation_deg = 3\n").expect("written");
    std::fs::write(folder.path().join("typo.toml"), "[rocks]\ncuont = 3\n").expect("written");
    std::fs::write(folder.path().join("rules.toml"), "[rules]\nrequire = { boulder = [0, 1] }\n")
        .expect("written");
    for (words, expected) in [
        (vec![], "--count"),
        (vec!["--count", "0"], "from 1 to 4294967296"),
        (vec!["--count", "many"], "--count"),
        (vec!["--count", "2", "--start", "4294967295"], "none after index 4294967295"),
        (vec!["--count", "1", "--shard", "2/2"], "I/N"),
        (vec!["--count", "1", "--shard", "half"], "I/N"),
        (vec!["--count", "1", "--split", "train=1"], "--split"),
        (vec!["--merge", "--dry-run"], "cannot be used with '--dry-run'"),
        (vec!["--split", "train=2,train=3"], "occurs twice"),
        (vec!["--split", "../up=2"], "is not a name; allowed are letters"),
        (vec!["--split", "train"], "has no `=`"),
        (vec!["--split", "a=18446744073709551615,b=2"], "at most 4294967296 frames in all"),
        (vec!["--count", "1", "--size", "40000x10"], "--size 40000x10: no side has more than 32768 pixels"),
        (vec!["--count", "1", "--format", "cocoo"], "unknown format"),
        (vec!["--count", "1", "--outputs", "rgb,masks"], "did you mean `mask`"),
        (vec!["--count", "1", "--preset", "train_rd"], "did you mean `train_dr`"),
        (vec!["--count", "1", "--stage", "mars"], "nominal"),
        (vec!["--count", "1", "--samples", "2"], "1, 4 (2 x 2) and 16"),
        (vec!["--count", "1", "--size", "0"], "at least one pixel"),
        (vec!["--count", "1", "--edges", "soft"], "--edges soft"),
        (vec!["--count", "1", "--label-ids", "mine"], "canonical"),
        (vec!["--count", "1", "--config", "broken.toml"], "broken.toml, line 1"),
        (vec!["--count", "1", "--config", "typo.toml"], "did you mean `rocks.count`"),
        (vec!["--count", "1", "--config", "missing.toml"], "cannot read missing.toml"),
        (vec!["--count", "1", "--config", "rules.toml"], "no class `boulder`"),
        (vec!["--count", "1", "--set", "rules.clipped=1"], "did you mean `rules.clipped_max`"),
        (vec!["--count", "1", "--set", "rules.black_max=2"], "0 to 1"),
        (vec!["--count", "1", "--set", "sun.elevation_deg={uniform=[5,95]}"], "0.5 to 90 deg"),
        (vec!["--count", "1", "--set", "sun.elevation_deg={uniform=[9,5]}"], "a <= b"),
        (vec!["--count", "1", "--set", "sun.elevation_deg={unifrom=[5,9]}"], "uniform=[a,b]"),
        (vec!["--count", "1", "--set", "rocks.count={uniform=[1,9]}"], "whole number"),
        (vec!["--count", "1", "--set", "stage.name={choice=[\"nominal\",\"mars\"]}"], "nominal"),
        (vec!["--count", "1", "--set", "camera.height_m={normal=[2,0.2],clip=[-1,3]}"], "0.2 to 200 m"),
        (vec!["--count", "1", "--set", "camera.x_m={uniform=[-900,900]}"], "off the ground"),
        (vec!["--count", "1", "--threads", "0"], "--threads"),
        (vec!["--count", "1", "--adapter", "voodoo"], "no adapter matches"),
    ] {
        let output = run(folder.path(), &[&["dataset", "--out", "new"], words.as_slice()].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {message}");
        assert!(message.contains(expected), "{words:?}: {message}");
        assert!(!folder.path().join("new").exists(), "{words:?}");
    }
}

#[test]
fn a_frame_that_breaks_a_rule_is_redrawn_and_counted() {
    let folder = folder();
    let rule = "--set=require={rock=[0.05,1]}";
    run_ok(folder.path(), &dataset("data", &["--count", "12", "-q", rule]));
    let lines = lines(&folder.path().join("data"));
    let attempts: Vec<u64> = lines.iter().map(|line| line["attempt"].as_u64().expect("a number")).collect();
    let redrawn: u64 = attempts.iter().sum();
    assert!(redrawn > 0, "the rule must fail for some frames, or this tests nothing");
    for line in &lines {
        assert!(line["coverage"]["rock"].as_f64() >= Some(0.05));
        let rules = line.get("redrawn").and_then(Value::as_array).map_or(0, Vec::len);
        assert_eq!(Some(rules as u64), line["attempt"].as_u64());
    }
    let manifest = json(&folder.path().join("data/manifest.json"));
    assert_eq!(manifest["totals"]["redraws"]["require.rock"], redrawn);
    let impossible = ["--count", "4", "--set=require={rock=[0.99,1]}", "--set=rules.attempts_max=3"];
    let output = run(folder.path(), &dataset("never", &impossible));
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    for expected in ["require.rock", "drawn 3 times", "allowed is 0.99 to 1"] {
        assert!(message.contains(expected), "{message}");
    }
    // No frame was finished there, so another configuration may use the folder.
    run_ok(folder.path(), &dataset("never", &["--count", "12", "-q", rule]));
    assert_same(&folder.path().join("never"), &folder.path().join("data"));
}

#[test]
fn an_edited_card_stays_until_frames_are_made() {
    let folder = folder();
    let command = dataset("data", &["--count", "2", "--json", "-q"]);
    let summary: Value = serde_json::from_str(&run_ok(folder.path(), &command)).expect("JSON");
    assert!(summary["peak_rss_bytes"].as_u64() > Some(10_000_000) || !cfg!(target_os = "linux"));
    let data = folder.path().join("data");
    let before = content(&data);
    let card = String::from_utf8_lossy(&before["README.md"]).into_owned();
    assert!(card.contains("regolith-render claims no rights in the images and labels."), "{card}");
    let edited = format!("{card}My licence: CC BY 4.0.\n");
    std::fs::write(data.join("README.md"), &edited).expect("written");
    std::fs::write(data.join("histograms.svg"), "damaged").expect("written");
    for command in [&command[..], &["dataset", "--merge", "--out=data", "-q"]] {
        run_ok(folder.path(), command);
        let mut now = content(&data);
        assert_eq!(
            now.insert("README.md".to_owned(), card.clone().into_bytes()),
            Some(edited.clone().into_bytes())
        );
        assert!(now == before, "the other files are written again");
    }
    let report = run(folder.path(), &["verify", "data", "--rerender=0"]);
    assert!(String::from_utf8_lossy(&report.stdout).contains("README.md: its content has changed"));
    std::fs::remove_file(data.join("README.md")).expect("removed");
    run_ok(folder.path(), &command);
    assert!(content(&data) == before);
    std::fs::write(data.join("README.md"), &edited).expect("written");
    run_ok(folder.path(), &dataset("data", &["--count", "3", "-q"]));
    let grown = std::fs::read_to_string(data.join("README.md")).expect("a card");
    assert!(grown.contains("\n3 synthetic frames") && !grown.contains("My licence"), "{grown}");
}

#[test]
fn lost_and_damaged_files_are_made_again() {
    let folder = folder();
    let command = dataset("data", &["--count", "3", "-q"]);
    run_ok(folder.path(), &command);
    let data = folder.path().join("data");
    let before = content(&data);
    // An empty file, as a power failure can leave.
    std::fs::write(data.join("mask/mask_00001.png"), "").expect("written");
    run_ok(folder.path(), &command);
    assert!(content(&data) == before);
    // A damaged file: the message names it and a remedy that works.
    std::fs::write(data.join("rgb/rgb_00002.png"), "not an image").expect("written");
    let output = run(folder.path(), &command);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && message.contains("rgb_00002.png: it cannot be decoded"), "{message}");
    assert!(message.contains("delete it"), "{message}");
    std::fs::remove_file(data.join("rgb/rgb_00002.png")).expect("removed");
    run_ok(folder.path(), &command);
    assert!(content(&data) == before);
    // Without its manifest the folder counts as one with other content.
    std::fs::remove_file(data.join("manifest.json")).expect("removed");
    let message = String::from_utf8_lossy(&run(folder.path(), &command).stderr).into_owned();
    assert!(message.contains("add --force"), "{message}");
    run_ok(folder.path(), &[command.as_slice(), &["--force"]].concat());
    assert!(content(&data) == before);
    // Frames beyond the command's are not left out of the new manifest.
    std::fs::remove_file(data.join("manifest.json")).expect("removed");
    run_ok(folder.path(), &dataset("data", &["--count", "2", "-q", "--force"]));
    assert!(content(&data) == before);
}

/// A line that was changed gets no digest of its own, neither here nor in another format.
#[test]
fn a_changed_line_of_a_finished_dataset_is_refused_until_it_is_deleted() {
    let folder = folder();
    let command = dataset("data", &["--count", "3", "-q"]);
    run_ok(folder.path(), &command);
    let data = folder.path().join("data");
    let (before, log) = (content(&data), data.join("frames.jsonl"));
    let lines = std::fs::read_to_string(&log).expect("lines");
    let changed = lines.replacen("\"geometry_hash\":\"", "\"geometry_hash\":\"0", 1);
    assert_ne!(changed, lines);
    std::fs::write(&log, &changed).expect("written");
    let merge = ["dataset", "--merge", "--out", "data"];
    for words in [&command[..], &merge, &["convert", "data", "--format", "basic", "--out", "converted"]] {
        let output = run(folder.path(), words);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{words:?}: {message}");
        assert!(message.contains("another digest") && message.contains("delete such a line"), "{message}");
    }
    assert_eq!(std::fs::read_to_string(&log).expect("lines"), changed);
    let kept: Vec<&str> = changed.lines().skip(1).collect();
    std::fs::write(&log, kept.join("\n") + "\n").expect("written");
    run_ok(folder.path(), &command);
    assert!(content(&data) == before);
}

/// A run that is no shard ends well only if the folder has every frame that was ever begun there.
#[test]
fn frames_of_a_larger_run_that_are_missing_are_an_error() {
    let folder = folder();
    let command = dataset("data", &["--count", "5", "-q"]);
    run_ok(folder.path(), &command);
    let data = folder.path().join("data");
    let (before, log) = (content(&data), data.join("frames.jsonl"));
    let lines = std::fs::read_to_string(&log).expect("lines");
    let kept: Vec<&str> = lines.lines().take(4).collect();
    std::fs::write(&log, kept.join("\n") + "\n").expect("written");
    let output = run(folder.path(), &dataset("data", &["--count", "3"]));
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("begun with frames 0 to 4, of which 1 is missing: 4. "), "{message}");
    assert!(message.contains("the larger --count") && !message.contains("shard"), "{message}");
    run_ok(folder.path(), &command);
    assert!(content(&data) == before);
}

#[test]
fn the_record_of_a_frame_is_the_same_in_a_dataset_and_alone() {
    let folder = folder();
    run_ok(folder.path(), &dataset("data", &["--count", "1", "-q", "--format", "basic", "--outputs", "all"]));
    let record = json(&folder.path().join("data/frame_0000.json"));
    let seed = record["seed"].to_string();
    run_ok(folder.path(), &[&["--seed", &seed, "--out", "alone", "-q"], SMALL.as_slice()].concat());
    let mut alone = json(&folder.path().join("alone/frame_0000.json"));
    alone.as_object_mut().expect("a record").remove("ms").expect("times");
    for (key, value) in alone.as_object().expect("a record") {
        assert_eq!(record.get(key), Some(value), "{key}");
    }
}

#[test]
fn splits_share_no_scene_and_record_their_seed_ranges() {
    let folder = folder();
    run_ok(folder.path(), &dataset("data", &["--split", "train=5,val=2,test=3", "-q"]));
    let data = folder.path().join("data");
    for (split, first, count) in [("train", 0, 5), ("val", 5, 2), ("test", 7, 3)] {
        let masks = std::fs::read_dir(data.join(split).join("mask")).expect("masks").count();
        assert_eq!(masks, count, "{split}");
        assert!(data.join(format!("{split}/rgb/rgb_{first:05}.png")).is_file());
    }
    let manifest = json(&data.join("manifest.json"));
    let mut end = None;
    for split in ["train", "val", "test"] {
        let seeds = &manifest["splits"][split]["seeds"];
        let [low, high] = [0, 1].map(|i| seeds[i].as_u64().expect("a seed"));
        assert!(low <= high && end.is_none_or(|end| end < low), "the ranges do not overlap");
        end = Some(high);
        for line in lines(&data).iter().filter(|line| line["split"] == split) {
            assert!((low..=high).contains(&line["seed"].as_u64().expect("a seed")));
        }
    }
    let hashes: Vec<Value> = lines(&data).iter().map(|line| line["geometry_hash"].clone()).collect();
    let mut distinct: Vec<String> = hashes.iter().map(ToString::to_string).collect();
    distinct.sort();
    distinct.dedup();
    assert_eq!(distinct.len(), 10);
}

#[test]
fn paired_presets_have_the_same_layout_frame_by_frame() {
    let draw = |preset: &str, seed| {
        let mut config = Config::new();
        config.apply_preset(preset).expect("a preset");
        let params = config.draw(seed).expect("drawn");
        (Scene::build(seed, &params).expect("a scene"), params)
    };
    for index in 0..3 {
        let seed = regolith::dataset::plan::frame_seed(42, index, 0);
        let ((varied, varied_params), (fixed, fixed_params)) =
            (draw("train_dr", seed), draw("train_nodr", seed));
        for knob in [Knob::CratersCount, Knob::RocksCount] {
            assert_eq!(varied_params.count(knob), fixed_params.count(knob));
        }
        assert_eq!(varied.terrain.craters, fixed.terrain.craters);
        for (a, b) in varied.rocks.iter().zip(&fixed.rocks).filter(|(a, b)| !a.moved && !b.moved) {
            assert_eq!(a.centre.truncate(), b.centre.truncate(), "rock {}", a.index);
            assert_eq!(a.vertices, b.vertices);
        }
        assert_ne!(varied.sun.direction, fixed.sun.direction);
    }
}

/// The rocks of the sparser ground are those of the denser one as well.
#[test]
fn paired_presets_of_the_surface_have_the_same_places_of_rocks() {
    for index in 0..6 {
        let seed = regolith::dataset::plan::frame_seed(42, index, 0);
        let mut fields = ["surface_train_dr", "surface_train_nodr"].map(|preset| {
            let mut config = Config::new();
            config.apply_preset(preset).expect("a preset");
            let params = config.draw(seed).expect("drawn");
            let scene = Scene::build(seed, &params).expect("a scene");
            (params.number(Knob::RocksCoverage), scene)
        });
        fields.sort_by(|a, b| a.0.total_cmp(&b.0));
        let [(_, sparse), (_, dense)] = &fields;
        let place = |rock: &Rock| rock.centre.truncate().to_array().map(f32::to_bits);
        let places: HashSet<[u32; 2]> = dense.rocks.iter().map(place).collect();
        // Ahead and near enough for both cameras, and rocks that are no debris of others.
        let eye = sparse.camera.eye.truncate();
        let is_seen = |rock: &&Rock| {
            let offset = rock.centre.truncate() - eye;
            rock.body.is_rock() && (2.0..20.0).contains(&offset.length()) && offset.y > 3.0 * offset.x.abs()
        };
        let seen: Vec<&Rock> =
            sparse.rocks.iter().filter(is_seen).filter(|rock| rock.base_scale_m > 0.05).collect();
        let shared = seen.iter().filter(|rock| places.contains(&place(rock))).count();
        println!("{shared} of {} rocks are at the same places", seen.len());
        assert!(seen.len() > 2 && shared == seen.len(), "{shared} of {}", seen.len());
    }
}

#[test]
fn a_run_stopped_by_a_full_disk_can_be_resumed() {
    let folder = folder();
    let words = |out| [dataset(out, &["--count", "6", "-q"]), adapter_below_file_limit().to_vec()].concat();
    run_ok(folder.path(), &words("whole"));
    // Files of more than 2 KiB, which are the images, cannot be written.
    let output = run_with_file_limit(folder.path(), (2, "trap '' XFSZ;"), &words("data"));
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot write") && !message.contains("panicked"), "{message}");
    let data = folder.path().join("data");
    let partial = content(&data).into_keys().filter(|name| name.contains(".writing-")).count();
    assert_eq!(partial, 0);
    run_ok(folder.path(), &words("data"));
    assert_same(&folder.path().join("whole"), &data);
}

#[test]
fn a_run_stopped_by_a_lost_device_can_be_resumed() {
    let folder = folder();
    let words = dataset("data", &["--count", "3", "-q"]);
    let output =
        program(folder.path()).args(&words).env("REGOLITH_FAULT", "device-lost").output().expect("started");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("device was lost") && message.contains("again"), "{message}");
    run_ok(folder.path(), &words);
    assert_eq!(lines(&folder.path().join("data")).len(), 3);
}

#[test]
fn a_second_run_of_a_shard_is_refused_while_the_first_writes() {
    let folder = folder();
    let words = dataset("data", &["--count", "100000", "-q"]);
    let mut first = program(folder.path()).args(&words).stdout(Stdio::null()).spawn().expect("started");
    wait_until(|| whole_lines(&folder.path().join("data")) > 0);
    let output = run(folder.path(), &words);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("another run is writing"), "{message}");
    first.kill().expect("killed");
    let _ = first.wait();
}

#[test]
fn a_dry_run_prints_the_knobs_and_writes_nothing() {
    let folder = folder();
    let text = run_ok(folder.path(), &dataset("data", &["--count", "3", "--dry-run"]));
    assert!(
        text.contains("sun.elevation_deg") && text.contains("camera.exposure_ev") && text.contains("in all")
    );
    let rows = run_ok(folder.path(), &dataset("data", &["--count", "3", "--dry-run", "--json"]));
    let rows: Value = serde_json::from_str(&rows).expect("JSON");
    assert_eq!(rows.as_array().map(Vec::len), Some(3));
    // A shard without frames, and frames of both stages, which have different knobs.
    let none = run_ok(folder.path(), &dataset("data", &["--count", "1", "--shard", "1/2", "--dry-run"]));
    assert!(none.contains("has no frame of this range"), "{none}");
    let stages = "--set=stage.name={choice=[\"nominal\",\"surface\"]}";
    let both = run_ok(folder.path(), &["dataset", "--count", "5", "--out", "data", stages, "--dry-run"]);
    let row = |knob: &str| both.lines().find(|line| line.starts_with(knob)).map(str::to_owned);
    assert!(
        row("stage.name").is_some_and(|row| row.contains("nominal") && row.contains("surface")),
        "{both}"
    );
    assert!(row("grains.density").is_some_and(|row| row.contains(" -")), "{both}");
    assert!(!folder.path().join("data").exists());
    run_ok(folder.path(), &dataset("data", &["--count", "3", "-q"]));
    for (row, line) in rows.as_array().expect("rows").iter().zip(lines(&folder.path().join("data"))) {
        assert_eq!((&row["seed"], &row["knobs"]), (&line["seed"], &line["knobs"]));
    }
}

#[test]
fn the_digest_is_that_of_the_frames_and_not_of_the_run() {
    let folder = folder();
    let make = |out: &str, more: &[&str]| {
        let words =
            ["dataset", "-q", "--size=32", "--samples=1", "--set=terrain.cells=60", "--set=rocks.count=9"];
        run_ok(folder.path(), &[&words[..], &["--out", out], more].concat());
        json(&folder.path().join(out).join("manifest.json"))["digest"].clone()
    };
    let whole = make("whole", &["--count=4", "--threads=1"]);
    assert_eq!(whole.as_str().map(str::len), Some(32));
    assert_eq!(make("threads", &["--count=4", "--threads=4"]), whole);
    make("grown", &["--count=2"]);
    assert_eq!(make("grown", &["--count=4"]), whole);
    assert!(make("shards", &["--count=4", "--shard=0/2"]).is_null(), "an incomplete dataset has none");
    assert_eq!(make("shards", &["--count=4", "--shard=1/2"]), whole);
    assert_ne!(make("other", &["--count=4", "--seed=43"]), whole);
    assert_ne!(make("rules", &["--count=4", "--set=rules.black_max=0.94"]), whole);
    // The rule of the documentation, applied to the text of the files.
    let manifest = std::fs::read_to_string(folder.path().join("whole/manifest.json")).expect("read");
    let mut manifest: serde_json::Map<String, Value> = serde_json::from_str(&manifest).expect("JSON");
    let state = "status start count n_completed seeds preset command adapters totals index_files digest";
    state.split(' ').for_each(|key| drop(manifest.shift_remove(key).expect(key)));
    let mut text = Value::from(manifest).to_string() + "\n";
    for line in std::fs::read_to_string(folder.path().join("whole/frames.jsonl")).expect("read").lines() {
        let end = line.rfind(",\"ms\":").expect("times");
        text += &format!("{}}}\n", &line[..end]);
    }
    assert_eq!(whole, regolith::output::disk::content_hash(text.as_bytes()));
}

/// The manifest names the preset, and a command that makes the same dataset, whoever made it: shards, or a conversion.
#[test]
fn the_manifest_s_command_makes_the_dataset_again() {
    let folder = folder();
    let words = [
        "dataset",
        "-q",
        "--preset",
        "train_dr, sun_polar",
        "--set",
        "terrain.cells=60",
        "--set=rocks.scale_m={uniform=[0.4, 1]}",
        "--seed=5",
        "--size=40x32",
        "--samples=1",
        "--outputs=rgb,mask,instances",
        "--threads=1",
    ];
    run_ok(folder.path(), &[&words[..], &["--split=train=2,val=1", "--out=first"]].concat());
    let first = json(&folder.path().join("first/manifest.json"));
    let command = first["command"].as_str().expect("a command");
    assert_eq!(first["preset"], "train_dr,sun_polar");
    assert_eq!(
        command,
        "regolith-render dataset --preset train_dr,sun_polar --set terrain.cells=60 --set 'rocks.scale_m={uniform=[0.4, 1]}' \
         --seed 5 --size 40x32 --samples 1 --edges hard --label-ids canonical --outputs rgb,mask,instances --format folder \
         --split train=2,val=1"
    );
    let again = std::process::Command::new("sh")
        .current_dir(folder.path())
        .env("WGPU_ADAPTER_NAME", crate::support::adapter())
        .args([
            "-c",
            &format!(
                "{} -q --out again",
                command.replace("regolith-render", env!("CARGO_BIN_EXE_regolith-render"))
            ),
        ])
        .status();
    assert!(again.expect("a shell").success());
    assert_eq!(json(&folder.path().join("again/manifest.json")), first);
    run_ok(folder.path(), &["convert", "first", "--format=coco", "--out=coco", "-q"]);
    let coco = json(&folder.path().join("coco/manifest.json"));
    assert_eq!(coco["command"], command.replace("--format folder", "--format coco"));
    // Another way to say the same is the same dataset: the run finds that nothing is missing.
    let other =
        [&words[..3], &["train_dr,sun_polar"], &words[4..], &["--split=train=2,val=1", "--out=first"]]
            .concat();
    run_ok(folder.path(), &other);
    let mut changed = first.clone();
    changed["command"] = command.replace("--size 40x32", "--size 40x40").into();
    std::fs::write(folder.path().join("first/manifest.json"), changed.to_string()).expect("written");
    let report = run(folder.path(), &["verify", "first", "--rerender=0"]);
    assert!(String::from_utf8_lossy(&report.stdout).contains("command"), "a wrong command is found");
}

#[test]
fn the_manifest_has_weights_and_channel_statistics_of_all_pixels() {
    let folder = folder();
    run_ok(
        folder.path(),
        &dataset("data", &["--count", "7", "--set=camera.pitch_deg={uniform=[-60,0]}", "-q"]),
    );
    for shard in ["0/2", "1/2"] {
        let words = ["--count", "7", "--set=camera.pitch_deg={uniform=[-60,0]}", "--shard", shard, "-q"];
        run_ok(folder.path(), &dataset("shards", &words));
    }
    let data = folder.path().join("data");
    let totals = json(&data.join("manifest.json"))["totals"].clone();
    assert_eq!(totals, json(&folder.path().join("shards/manifest.json"))["totals"]);
    let (mut values, mut pixels, mut of_frames) = (vec![Vec::new(); 3], [0_u64; 3], [0_u64; 3]);
    for index in 0..7 {
        let open = |path: String| image::open(data.join(path)).expect("an image");
        let rgb = open(format!("rgb/rgb_{index:05}.png")).into_rgb8();
        for pixel in rgb.pixels() {
            (0..3).for_each(|channel| values[channel].push(f64::from(pixel[channel]) / 255.0));
        }
        let mask = open(format!("mask/mask_{index:05}.png")).into_luma8().into_raw();
        for class in 0..3 {
            let count = mask.iter().filter(|id| usize::from(**id) == class).count() as u64;
            pixels[class] += count;
            of_frames[class] += if count > 0 { mask.len() as u64 } else { 0 };
        }
    }
    assert!(
        of_frames.iter().any(|frames| *frames < 7 * 48 * 48),
        "a class is missing from a frame: {of_frames:?}"
    );
    let number = |key: &str, at: &str| totals[key][at].as_f64().expect("a number");
    let frequency: Vec<f64> = (0..3).map(|class| pixels[class] as f64 / of_frames[class] as f64).collect();
    let mut sorted = frequency.clone();
    sorted.sort_by(f64::total_cmp);
    for (class, name) in ["regolith", "rock", "sky"].into_iter().enumerate() {
        assert_eq!(totals["class_pixels"][name], pixels[class]);
        let expected = sorted[1] / frequency[class];
        assert!((number("class_weights", name) - expected).abs() < 1e-12 * expected, "{name}: {totals}");
    }
    for (channel, values) in values.iter().enumerate() {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!((totals["channel_mean"][channel].as_f64().expect("a number") - mean).abs() < 1e-9);
        assert!((totals["channel_std"][channel].as_f64().expect("a number") - variance.sqrt()).abs() < 1e-9);
    }
}

/// Also if the damage leaves no frame whole: it has lost the files of an output, its log, or the count in its manifest.
#[test]
fn a_damaged_folder_of_another_configuration_is_refused() {
    type Damage = fn(&Path) -> std::io::Result<()>;
    let remove_log: Damage = |data| std::fs::remove_file(data.join("frames.jsonl"));
    let damages: [Damage; 3] = [
        |data| std::fs::rename(data.join("depth"), data.with_extension("depth")),
        remove_log,
        // As a run leaves it that is killed between the files of its first frame and the line of it.
        |data| {
            let mut manifest = json(&data.join("manifest.json"));
            manifest["n_completed"] = 0.into();
            std::fs::write(data.join("manifest.json"), manifest.to_string())?;
            std::fs::write(data.join("frames.jsonl"), "")
        },
    ];
    for (damage, format) in damages.iter().zip(["folder", "folder", "basic"]) {
        let folder = folder();
        let of_format = ["--format", format, "-q"];
        let outputs = ["--outputs=rgb,mask,depth"];
        run_ok(folder.path(), &[&dataset("data", &["--count=3"])[..], &outputs, &of_format].concat());
        let data = folder.path().join("data");
        // Only the first has the folder `depth`.
        damage(&data).expect("damaged");
        let before = content(&data);
        for (words, expected) in [
            (&["--seed=7", outputs[0]][..], "base_seed: there 42, now 7"),
            (&["--outputs=rgb,mask"], "outputs"),
        ] {
            let command = [&dataset("data", &["--count=2"])[..], &of_format, words].concat();
            let output = run(folder.path(), &command);
            let message = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{message}");
            assert!(message.contains("another configuration") && message.contains(expected), "{message}");
        }
        assert!(content(&data) == before);
    }
}

/// The frames of the other shards are not gone through.
#[test]
fn one_frame_of_four_billion_is_made() {
    let folder = folder();
    let words = ["--count=4294967296", "--shard=4294967295/4294967296", "--json", "-q"];
    let summary = run_ok(folder.path(), &dataset("data", &words));
    let summary: Value = serde_json::from_str(&summary).expect("JSON");
    assert_eq!((&summary["made"], &summary["n_missing"]), (&1.into(), &u64::from(u32::MAX).into()));
    assert!(folder.path().join("data/rgb/rgb_4294967295.png").is_file());
}
