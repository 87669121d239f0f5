//! Who may write to a dataset's folder at the same time, what a run finds at its end, and whose files stay.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{folder, json, program, run, run_ok, run_with_file_limit, send_signal};

/// Small frames of a small scene.
const SMALL: [&str; 6] = [
    "--size=48",
    "--samples=1",
    "--set=terrain.cells=40",
    "--set=rocks.count=14",
    "--set=sky.star_count=20",
    "-q",
];

fn dataset<'a>(count: &'a str, words: &[&'a str]) -> Vec<&'a str> {
    [&["dataset", "--out", "data", "--count", count], SMALL.as_slice(), words].concat()
}

fn frames(log: &Path) -> BTreeSet<u64> {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let lines = text.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    lines.filter_map(|line| line["index"].as_u64()).collect()
}

/// A run that is stopped by the system in the middle of its work, and continues later.
struct PausedRun(Child);

impl PausedRun {
    /// Starts a run and pauses it when `log` has a line.
    fn start(folder: &Path, words: &[&str], log: &str) -> Self {
        let child = program(folder).args(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let run = Self(child.expect("started"));
        let start = Instant::now();
        while frames(&folder.join("data").join(log)).is_empty() {
            assert!(start.elapsed().as_secs() < 120, "no frame was made within two minutes");
            std::thread::sleep(Duration::from_millis(1));
        }
        run.signal("-STOP");
        run
    }

    fn signal(&self, signal: &str) {
        send_signal(&self.0, signal);
    }

    /// Lets it continue to its end.
    fn finish(self) -> Output {
        self.signal("-CONT");
        self.0.wait_with_output().expect("ended")
    }
}

#[track_caller]
fn assert_fails(output: &Output, expected: &str) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains(expected), "{message}");
}

#[track_caller]
fn assert_complete_log(data: &Path, count: u64) {
    assert_eq!(frames(&data.join("frames.jsonl")), (0..count).collect());
    assert_eq!(json(&data.join("manifest.json"))["status"], "done");
}

#[track_caller]
fn assert_complete(data: &Path, count: u64) {
    assert_complete_log(data, count);
    let names = std::fs::read_dir(data).expect("a folder").map(|entry| entry.expect("an entry").file_name());
    let left: Vec<_> = names.filter(|name| name.to_string_lossy().starts_with('.')).collect();
    assert!(left.is_empty(), "{left:?}");
    let images = std::fs::read_dir(data.join("rgb")).expect("images").count();
    assert_eq!(images as u64, count, "an image for each frame, and nothing else");
}

#[test]
fn nothing_replaces_the_log_of_a_run_of_all_frames() {
    let folder = folder();
    let first = PausedRun::start(folder.path(), &dataset("120", &[]), "frames.jsonl");
    for words in [&["dataset", "--merge", "--out", "data"][..], &dataset("120", &["--shard", "0/3"])] {
        assert_fails(&run(folder.path(), words), "another run is writing data: a run of all frames");
    }
    assert_fails(&run(folder.path(), &dataset("120", &[])), "another run is writing data");
    let output = first.finish();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_complete(&folder.path().join("data"), 120);
}

#[test]
fn a_conversion_has_its_folder_for_itself() {
    let folder = folder();
    run_ok(folder.path(), &[&["dataset", "--out", "source", "--count", "200"], SMALL.as_slice()].concat());
    let words = ["convert", "source", "--format", "basic", "--out", "data"];
    let first = PausedRun::start(folder.path(), &words, "frames.jsonl");
    for words in [&["dataset", "--merge", "--out", "data"][..], &words] {
        assert_fails(&run(folder.path(), words), "another run is writing data");
    }
    assert!(first.finish().status.success());
    assert_eq!(frames(&folder.path().join("data/frames.jsonl")).len(), 200);
}

#[test]
fn only_shards_of_the_same_number_share_a_folder() {
    let folder = folder();
    let data = folder.path().join("data");
    let first = PausedRun::start(folder.path(), &dataset("40", &["--shard", "0/2"]), "frames-0-of-2.jsonl");
    let other = run(folder.path(), &dataset("40", &["--shard", "1/3"]));
    assert_fails(&other, "its frames are divided into 2 shards, not 3");
    assert_fails(&run(folder.path(), &dataset("40", &["--shard", "0/2"])), "data: the same shard");
    assert_fails(&run(folder.path(), &dataset("40", &[])), "another run is writing data");
    // The other shard finishes, and a merge can say how far they are: both leave the log of the first one.
    run_ok(folder.path(), &dataset("40", &["--shard", "1/2"]));
    assert_fails(
        &run(folder.path(), &["dataset", "--merge", "--out", "data"]),
        "frames are missing from data",
    );
    assert!(data.join("frames-0-of-2.jsonl").is_file());
    assert!(first.finish().status.success());
    assert_complete(&data, 40);
}

#[test]
fn a_killed_run_holds_no_lock() {
    let folder = folder();
    let mut first =
        PausedRun::start(folder.path(), &dataset("40", &["--shard", "0/2"]), "frames-0-of-2.jsonl");
    first.0.kill().expect("killed");
    first.0.wait().expect("ended");
    run_ok(folder.path(), &dataset("40", &[]));
    assert_complete(&folder.path().join("data"), 40);
}

#[test]
fn a_run_whose_frames_were_removed_does_not_succeed() {
    type Change = fn(&Path) -> std::io::Result<()>;
    let changes: [(Change, &str); 5] = [
        (|data| std::fs::remove_file(data.join("frames.jsonl")), "the log of this run is no longer there"),
        (
            |data| {
                std::fs::copy(data.join("frames.jsonl"), data.join("other"))?;
                std::fs::rename(data.join("other"), data.join("frames.jsonl"))
            },
            "the log of this run is no longer there",
        ),
        (
            |data| std::fs::rename(data, data.with_extension("moved")),
            "the log of this run is no longer there",
        ),
        (|data| std::fs::remove_dir_all(data), "the log of this run is no longer there"),
        (|data| std::fs::remove_file(data.join("rgb/rgb_00000.png")), "1 of the 60 frames of this run"),
    ];
    for (change, expected) in changes {
        let folder = folder();
        let data = folder.path().join("data");
        let paused = PausedRun::start(folder.path(), &dataset("60", &["--threads=1"]), "frames.jsonl");
        assert!(frames(&data.join("frames.jsonl")).contains(&0));
        change(&data).expect("changed");
        let is_gone = !data.exists();
        assert_fails(&paused.finish(), expected);
        assert!(!is_gone || !data.exists(), "a folder that was removed is not created again");
        run_ok(folder.path(), &dataset("60", &[]));
        assert_complete(&data, 60);
    }
}

#[test]
fn files_of_others_stay_and_leftovers_of_killed_runs_go() {
    let folder = folder();
    let data = folder.path().join("data");
    run_ok(folder.path(), &dataset("2", &["--shard", "0/2"]));
    std::fs::create_dir(data.join("notes")).expect("made");
    let foreign = [
        ".lock",
        ".lockfile",
        ".lock-0-of-1",
        ".writing-notes",
        "rgb/.writing-0of1-abc",
        "notes/.writing-down",
        "notes/.regolith-render-0of2-Ab3dE6gH.tmp",
        ".regolith-render-0of2-thoughts.md",
        ".regolith-render-0of2-Ab3dE6gH.tmp.bak",
        ".regolith-render-mine-Ab3dE6gH.tmp",
    ];
    let leftovers = [
        ".regolith-render-0of2-Ab3dE6gH.tmp",
        "rgb/.regolith-render-0of2-Ab3dE6gH.tmp",
        "mask/.regolith-render-1of2-Ab3dE6gH.tmp",
        ".regolith-render-merge-Ab3dE6gH.tmp",
    ];
    for name in foreign.iter().chain(&leftovers) {
        std::fs::write(data.join(name), "years of work").expect("written");
    }
    run_ok(folder.path(), &dataset("2", &["--shard", "1/2"]));
    assert_eq!(json(&data.join("manifest.json"))["status"], "done");
    for name in foreign {
        assert!(data.join(name).is_file(), "{name} was removed");
    }
    for name in leftovers {
        assert!(!data.join(name).exists(), "{name} is still there");
    }
    run_ok(folder.path(), &["dataset", "--merge", "--out", "data"]);
    assert!(foreign.iter().all(|name| data.join(name).is_file()));
}

#[test]
fn the_files_of_a_live_run_stay() {
    let folder = folder();
    let data = folder.path().join("data");
    let first = PausedRun::start(folder.path(), &dataset("40", &["--shard", "0/2"]), "frames-0-of-2.jsonl");
    // As if it had been paused while writing.
    let live = data.join("rgb/.regolith-render-0of2-Ab3dE6gH.tmp");
    std::fs::write(&live, "half").expect("written");
    run_ok(folder.path(), &dataset("40", &["--shard", "1/2"]));
    let _ = run(folder.path(), &["dataset", "--merge", "--out", "data"]);
    assert!(live.is_file());
    assert!(first.finish().status.success());
    assert!(!live.exists(), "at the end nobody writes it any more");
}

/// A shard that has all of its own frames still has to say that the dataset is larger now.
#[test]
fn a_range_that_grows_by_frames_of_another_shard_is_recorded() {
    let folder = folder();
    let copy = |from: &str, to: &str| {
        let words = ["-r", &format!("{from}/."), to];
        assert!(Command::new("cp").args(words).current_dir(folder.path()).status().expect("cp").success());
    };
    let make = |out: &str, words: &[&str]| {
        let output = run(folder.path(), &[&["dataset", "--out", out], &SMALL[..5], words].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{message}");
        message
    };
    make("a", &["--count=3"]);
    ["b", "all", "other"]
        .iter()
        .for_each(|name| std::fs::create_dir(folder.path().join(name)).expect("made"));
    copy("a", "b");
    let message = make("a", &["--count=4", "--shard=0/2"]);
    assert!(message.contains("1 frame of another shard is still missing: 3"), "{message}");
    let a = folder.path().join("a");
    assert!(a.join("frames-0-of-2.jsonl").is_file());
    for (name, status) in [("manifest.json", "incomplete"), ("manifest-0-of-2.json", "done")] {
        let manifest = json(&a.join(name));
        assert_eq!((&manifest["count"], &manifest["status"]), (&4.into(), &status.into()), "{name}");
    }
    make("b", &["--count=4", "--shard=1/2"]);
    assert_complete(&folder.path().join("b"), 4);
    // Copied into one folder, whichever log is the last: no frame is left out without a word.
    copy("a", "all");
    copy("b", "all");
    run_ok(folder.path(), &["dataset", "--merge", "--out", "all", "-q"]);
    assert_complete(&folder.path().join("all"), 4);
    copy("b", "other");
    copy("a", "other");
    let merge = run(folder.path(), &["dataset", "--merge", "--out", "other", "-q"]);
    assert_fails(&merge, "1 frame is missing from other: 3");
    make("other", &["--count=4", "--shard=1/2"]);
    assert_complete(&folder.path().join("other"), 4);
}

#[test]
fn a_complete_dataset_needs_no_room_and_an_error_leaves_no_lock() {
    for format in ["folder", "webdataset", "coco"] {
        let folder = folder();
        let data = folder.path().join("data");
        let words = dataset("3", &["--format", format]);
        run_ok(folder.path(), &words);
        let files = || -> BTreeSet<_> {
            let entries = std::fs::read_dir(&data).expect("a folder").map(|entry| entry.expect("an entry"));
            entries
                .map(|entry| {
                    (entry.file_name(), entry.metadata().and_then(|of| of.modified()).expect("a time"))
                })
                .collect()
        };
        let before = files();
        // No file may have a byte, as on a full disk.
        let added = ["dataset", "--add-outputs", "rgb,mask", "data"];
        let commands = [&words[..], &["dataset", "--merge", "--out", "data"], &added];
        let can_add = format == "folder";
        for words in &commands[..if can_add { 3 } else { 2 }] {
            let output = run_with_file_limit(folder.path(), (0, "trap '' XFSZ;"), words);
            assert!(output.status.success(), "{format}: {}", String::from_utf8_lossy(&output.stderr));
            assert_eq!(files(), before, "{format}: nothing is written");
        }
        std::fs::remove_file(data.join("histograms.svg")).expect("removed");
        assert_fails(&run_with_file_limit(folder.path(), (0, "trap '' XFSZ;"), &words), "cannot write data/");
        let left: Vec<_> =
            files().into_iter().filter(|(name, _)| name.to_string_lossy().starts_with('.')).collect();
        assert!(left.is_empty(), "{format}: {left:?}");
        run_ok(folder.path(), &words);
        assert!(data.join("histograms.svg").is_file(), "{format}");
        assert_complete_log(&data, 3);
    }
}
