//! The command as a process: signals, limits, and what it prints with `-q`.

use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{
    adapter, adapter_below_file_limit, folder, run, run_ok, run_with_file_limit, send_signal, stoppable,
};

/// Small frames of a small scene.
const SMALL: [&str; 5] =
    ["--size=48", "--samples=1", "--set=terrain.cells=40", "--set=rocks.count=14", "--set=sky.star_count=20"];

fn start(folder: &Path, words: &[&str]) -> Child {
    let child = stoppable(folder).args(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    child.expect("started")
}

fn wait_until(mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed().as_secs() < 120, "the condition did not hold within two minutes");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Starts a command, sends it signals once `exists` is there, and returns how it ended.
fn stopped(folder: &Path, words: &[&str], exists: &str, signals: &[&str]) -> Output {
    let child = start(folder, words);
    wait_until(|| folder.join(exists).exists());
    // Held while the signals are sent, so that it cannot finish between them.
    send_signal(&child, "-STOP");
    signals.iter().for_each(|name| send_signal(&child, name));
    send_signal(&child, "-CONT");
    child.wait_with_output().expect("ended")
}

fn masks(folder: &Path, count: usize) {
    std::fs::create_dir(folder.join("masks")).expect("made");
    let mask = image::GrayImage::from_pixel(64, 64, image::Luma([2]));
    for i in 0..count {
        mask.save(folder.join(format!("masks/semantic_segmentation_{i:04}.png"))).expect("written");
        let labels = folder.join(format!("masks/semantic_segmentation_labels_{i:04}.json"));
        std::fs::write(labels, r#"{"2": {"class": "sky"}}"#).expect("written");
    }
}

#[test]
fn every_long_command_ends_with_the_status_of_its_signal() {
    let folder = folder();
    let path = folder.path();
    masks(path, 2000);
    run_ok(path, &[&["dataset", "--out", "source", "--count", "300", "-q"], SMALL.as_slice()].concat());
    let dataset = |out| [&["dataset", "--out", out, "--count", "400"], SMALL.as_slice()].concat();
    for (words, exists, name, status) in [
        (dataset("a"), "a/rgb/rgb_00002.png", "-INT", 130),
        (dataset("b"), "b/rgb/rgb_00002.png", "-TERM", 143),
        (dataset("c"), "c/rgb/rgb_00002.png", "-HUP", 129),
        (vec!["convert", "source", "--format", "basic", "--out", "d"], "d/rgb_0000.png", "-INT", 130),
        (vec!["remap", "masks", "--out", "e"], "e/semantic_segmentation_0002.png", "-TERM", 143),
    ] {
        let output = stopped(path, &words, exists, &[name]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{words:?}: {message}");
        assert!(message.contains("are finished") && message.contains("same command"), "{words:?}: {message}");
        assert!(output.stdout.is_empty(), "{words:?}");
    }
}

/// They have no way to go on: what they have not finished is removed.
#[test]
fn a_stopped_frame_or_export_leaves_no_unfinished_file() {
    let folder = folder();
    let frame = ["--size=1024", "--samples=1", "--outputs=all", "--out=."];
    let export = ["export", "stage.usda", "--force"];
    let unfinished = || {
        let names = std::fs::read_dir(folder.path()).expect("a folder").map(|entry| entry.expect("an entry"));
        names.filter(|entry| entry.path().extension().is_some_and(|extension| extension == "tmp")).count()
    };
    let ended_by = |words: &[&str], signal: &str| {
        let child = start(folder.path(), words);
        wait_until(|| unfinished() > 0);
        send_signal(&child, signal);
        let output = child.wait_with_output().expect("ended");
        assert_eq!(unfinished(), 0, "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        output.status.code().expect("a status")
    };
    for (words, signal, status) in
        [(&frame[..], "-INT", 130), (&frame[..], "-TERM", 143), (&export[..], "-INT", 130)]
    {
        // It may be done before the signal comes.
        let ended = (0..5).map(|_| ended_by(words, signal)).find(|ended| *ended != 0);
        assert_eq!(ended, Some(status), "{words:?}");
    }
}

#[test]
fn a_stopped_measurement_leaves_no_files() {
    let folder = folder();
    let words = [&["bench", "--cases=dataset", "--frames=5000"], SMALL.as_slice()].concat();
    let child = stoppable(folder.path())
        .args(&words)
        .env("TMPDIR", folder.path())
        .stderr(Stdio::piped())
        .spawn()
        .expect("started");
    let entries = || std::fs::read_dir(folder.path()).expect("a folder").count();
    wait_until(|| entries() > 0);
    send_signal(&child, "-INT");
    let output = child.wait_with_output().expect("ended");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(entries(), 0);
}

#[test]
fn a_second_signal_ends_a_run_at_once() {
    let folder = folder();
    let words = [&["dataset", "--out", "data", "--count", "400"], SMALL.as_slice()].concat();
    let output = stopped(folder.path(), &words, "data/rgb/rgb_00002.png", &["-INT", "-TERM"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(130 | 143)), "{:?}: {message}", output.status);
    assert!(!message.contains("are finished"), "{message}");
}

/// As a driver that gives up, or an allocation that fails, aborts it.
#[test]
fn an_aborted_run_says_so() {
    let folder = folder();
    let words = [&["dataset", "--out", "data", "--count", "400", "-q"], SMALL.as_slice()].concat();
    let output = stopped(folder.path(), &words, "data/rgb/rgb_00002.png", &["-ABRT"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{:?}: {message}", output.status);
    assert!(message.starts_with("error: ") && message.contains("was aborted"), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
}

/// A pipeline such as `regolith-render ... | head -c 20000` must not look as if the archive were whole.
#[test]
fn a_stream_whose_reader_closes_it_fails() {
    let folder = folder();
    let words = ["dataset", "--count", "200", "--format", "webdataset", "--out", "-", "-q"];
    let mut child = start(folder.path(), &[words.as_slice(), SMALL.as_slice()].concat());
    let mut reader = child.stdout.take().expect("a pipe");
    reader.read_exact(&mut [0; 512]).expect("the first header");
    drop(reader);
    let output = child.wait_with_output().expect("ended");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("closed it after") && message.contains("of 200 frames"), "{message}");
}

/// As `nohup` ignores HUP, and a shell without job control INT for what runs in the background.
#[test]
fn a_signal_that_was_ignored_at_the_start_stays_ignored() {
    for signal in ["HUP", "INT", "TERM"] {
        let output = signalled_while_ignored(signal);
        assert!(output.status.success(), "{signal}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Runs a command that is started with a signal ignored, and sends it the signal.
fn signalled_while_ignored(signal: &str) -> Output {
    let folder = folder();
    let words = [&["dataset", "--out", "data", "--count", "40", "-q"], SMALL.as_slice()].concat();
    let words = words.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(" ");
    let script = format!("trap '' {signal}; exec '{}' {words}", env!("CARGO_BIN_EXE_regolith-render"));
    let child = Command::new("sh")
        .args(["-c", &script])
        .current_dir(folder.path())
        .env("WGPU_ADAPTER_NAME", adapter())
        .stderr(Stdio::piped())
        .spawn()
        .expect("started");
    wait_until(|| folder.path().join("data/rgb/rgb_00002.png").exists());
    send_signal(&child, &format!("-{signal}"));
    child.wait_with_output().expect("ended")
}

/// Without a handler the signal XFSZ would end the process, without a word and with its temporary files left behind.
#[test]
fn a_limit_of_the_file_size_is_named_as_such() {
    let folder = folder();
    let dataset = [&["dataset", "--out", "data", "--count", "3", "-q"], SMALL.as_slice()].concat();
    for words in [&["--out", "data", "-q"][..], &dataset] {
        let words = [words, &adapter_below_file_limit()].concat();
        let output = run_with_file_limit(folder.path(), (4, ""), &words);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{:?}: {message}", output.status);
        for text in ["cannot write data/", "File too large", "ulimit -f", "same command"] {
            assert!(message.contains(text), "{text}: {message}");
        }
        assert!(!message.contains("free some space"), "{message}");
        let files = Command::new("find").args(["data", "-name", "*.tmp"]).current_dir(folder.path()).output();
        assert!(files.expect("find").stdout.is_empty());
    }
}

/// A driver that keeps its memory in a file would be ended by a signal below such a limit.
#[test]
fn no_driver_crashes_below_a_limit_of_the_file_size() {
    let folder = folder();
    let output = run_with_file_limit(folder.path(), (4, ""), &["--out", "data", "-q"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{:?}: {message}", output.status);
    assert!(message.contains("ulimit -f") && message.trim_end().lines().count() == 1, "{message}");
    assert!(!folder.path().join("data").exists(), "nothing is left");
}

#[test]
fn quiet_commands_print_only_what_was_asked_for() {
    let folder = folder();
    masks(folder.path(), 1);
    let dataset = [&["dataset", "--count", "2", "--out", "data"], SMALL.as_slice()].concat();
    let commands: [&[&str]; 6] = [
        &["--size", "32"],
        &dataset,
        &["dataset", "--merge", "--out", "data"],
        &["convert", "data", "--format", "basic", "--out", "basic"],
        &["remap", "masks", "--out", "remapped"],
        &["export", "stage.npz", "--force"],
    ];
    for words in commands {
        let words = [words, &["-q"]].concat();
        let output = run(folder.path(), &words);
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(output.stdout.is_empty() && output.stderr.is_empty(), "{words:?}: {output:?}");
        let result = run_ok(folder.path(), &[words.as_slice(), &["--json"]].concat());
        assert!(serde_json::from_str::<serde_json::Value>(&result).is_ok(), "{words:?} --json: {result}");
    }
    for words in [&["verify", "data", "--rerender", "0", "-q"][..], &["verify", "data", "-q"]] {
        assert_eq!(run_ok(folder.path(), words), "");
    }
    for words in [&["params", "-q"][..], &["adapters", "-q"], &["completions", "bash", "-q"]] {
        assert!(!run_ok(folder.path(), words).is_empty(), "{words:?}: its output is what it is for");
    }
}
