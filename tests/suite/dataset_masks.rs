//! What a dataset says about its masks is what is in the files: rules, records, totals, data card and summary with a band of ignored pixels.

use std::path::Path;

use serde_json::Value;

use crate::support::{folder, json, run, run_ok};

const SIDE: usize = 64;
const FRAMES: usize = 6;
const NAMES: [&str; 3] = ["regolith", "rock", "sky"];

/// A dataset of small frames of a small scene with a band of ignored pixels.
fn dataset<'a>(out: &'a str, words: &[&'a str]) -> Vec<&'a str> {
    let scene = ["--samples=1", "--set=terrain.cells=40", "--set=rocks.count=14", "--set=sky.star_count=20"];
    [&["dataset", "--out", out, "--size=64", "--edges=ignore:2"], &scene[..], words].concat()
}

fn lines(data: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(data.join("frames.jsonl")).expect("frames.jsonl");
    text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

/// Pixels of each class, and of the ignore index, of the mask of a frame.
fn mask_px(data: &Path, index: usize) -> [u64; 4] {
    let mask = image::open(data.join(format!("mask/mask_{index:05}.png"))).expect("a mask").into_luma8();
    [0, 1, 2, 255].map(|id| mask.iter().filter(|pixel| **pixel == id).count() as u64)
}

#[test]
fn records_totals_card_and_summary_count_the_masks_as_they_are_written() {
    let folder = folder();
    let output = run(folder.path(), &dataset("data", &["--count=6", "-v"]));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    let data = folder.path().join("data");
    let mut sums = [0; 4];
    for (index, line) in lines(&data).iter().enumerate() {
        let pixels = mask_px(&data, index);
        for (i, name) in NAMES.into_iter().chain(["ignored"]).enumerate() {
            assert_eq!(line["mask_coverage"][name], pixels[i] as f64 / (SIDE * SIDE) as f64, "frame {index}");
            sums[i] += pixels[i];
        }
        assert!(line["coverage"]["rock"].as_f64() > line["mask_coverage"]["rock"].as_f64());
    }
    let totals = json(&data.join("manifest.json"))["totals"].clone();
    assert_eq!(
        NAMES.map(|name| totals["class_pixels"][name].as_u64()),
        [sums[0], sums[1], sums[2]].map(Some)
    );
    let percent = |pixels: u64| 100.0 * pixels as f64 / (FRAMES * SIDE * SIDE) as f64;
    let shares: Vec<String> = NAMES
        .iter()
        .chain(&["ignored"])
        .zip(sums)
        .map(|(name, pixels)| format!("{name} {:.1} %", percent(pixels)))
        .collect();
    assert!(sums[3] > 0 && message.contains(&format!("mean coverage: {};", shares.join(", "))), "{message}");
    assert!(message.contains("peak memory") || !cfg!(target_os = "linux"), "{message}");
    let card = std::fs::read_to_string(data.join("README.md")).expect("a card");
    assert!(card.contains(&format!("(`--edges`), {:.2} % of the pixels.", percent(sums[3]))), "{card}");
    assert!(card.contains(&format!("| 1 | rock | {:.2} % |", percent(sums[1]))), "{card}");

    // Of shards, of a run that is continued, and in another format the numbers are the same.
    for shard in ["0/2", "1/2"] {
        run_ok(folder.path(), &dataset("shards", &["--count=6", "-q", "--shard", shard]));
    }
    for count in ["--count=2", "--count=6"] {
        run_ok(folder.path(), &dataset("continued", &["-q", count]));
    }
    run_ok(folder.path(), &["convert", "data", "--format=webdataset", "--out=converted", "-q"]);
    for other in ["shards", "continued", "converted"] {
        assert_eq!(totals, json(&folder.path().join(other).join("manifest.json"))["totals"], "{other}");
    }
    for name in ["data", "converted"] {
        let report = run(folder.path(), &["verify", name, "--rerender=2"]);
        assert!(report.status.success(), "{}", String::from_utf8_lossy(&report.stdout));
    }

    // Without a band nothing is ignored, and no line says so.
    let hard: Vec<&str> =
        dataset("hard", &["--count=1"]).into_iter().filter(|word| !word.contains("edges")).collect();
    let output = run(folder.path(), &hard);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("ignored"));
    let hard = folder.path().join("hard");
    assert_eq!(lines(&hard)[0].get("mask_coverage"), None);
    assert!(
        std::fs::read_to_string(hard.join("README.md")).expect("a card").contains("No pixel carries 255.")
    );
}

#[test]
fn a_record_of_a_mask_that_is_not_its_own_is_found() {
    let folder = folder();
    run_ok(folder.path(), &dataset("data", &["--count=1", "-q"]));
    let path = folder.path().join("data/frames.jsonl");
    let text = std::fs::read_to_string(&path).expect("read");
    let change = |key: &str, value: Option<Value>| {
        let mut line: Value = serde_json::from_str(&text).expect("JSON");
        let slot = key.split('.').fold(&mut line, |line, key| &mut line[key]);
        if let Some(value) = value {
            *slot = value;
        } else if let Value::Object(line) = &mut line {
            line.remove(key);
        }
        std::fs::write(&path, format!("{line}\n")).expect("written");
        let report = run(folder.path(), &["verify", "data", "--rerender=0"]);
        assert_eq!(report.status.code(), Some(1), "{key}");
        String::from_utf8_lossy(&report.stdout).into_owned()
    };
    assert!(change("mask_coverage.rock", Some(0.5.into())).contains("recorded is 0.500000"));
    assert!(
        change("mask_coverage.ignored", Some(0.5.into())).contains("of it is ignored, recorded is 0.500000")
    );
    assert!(
        change("mask_coverage.craters", Some(0.5.into()))
            .contains("mask_coverage.craters is 0.5; it should not be")
    );
    assert!(change("mask_coverage", None).contains("mask_coverage is {}; it should be the fractions"));
}

#[test]
fn frames_are_judged_by_the_mask_that_is_written() {
    let folder = folder();
    // Every mask has the rocks that are required, though not every frame that has them keeps them in its mask.
    let require = "--set=require={rock=[0.01,0.5]}";
    run_ok(folder.path(), &dataset("data", &["--count=6", "-q", require]));
    let data = folder.path().join("data");
    let lines = lines(&data);
    for index in 0..FRAMES {
        assert!(mask_px(&data, index)[1] as f64 >= 0.01 * (SIDE * SIDE) as f64, "frame {index}");
    }
    assert!(lines.iter().any(|line| line["attempt"].as_u64() > Some(0)), "no frame was redrawn");
    for (words, expected) in [
        (
            &["--set=require={rock=[0.4,1]}"][..],
            &[
                "rule each time, the last time `require.rock`",
                "of the mask; allowed is 0.4 to 1",
                "before --edges ignore:2 it",
            ][..],
        ),
        (
            &["--set=rules.ignored_max=0.01"],
            &[
                "`ignored`",
                "of the mask is ignored; the limit is rules.ignored_max = 0.01",
                "smaller N or a larger --size",
            ],
        ),
    ] {
        let words = [words, &["--count=1", "--set=rules.attempts_max=2"]].concat();
        let output = run(folder.path(), &dataset("never", &words));
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(expected.iter().all(|expected| message.contains(expected)), "{message}");
    }
    let wide = [
        "dataset",
        "--out=wide",
        "--size=32",
        "--edges=ignore:40",
        "--count=1",
        "--set=rules.attempts_max=2",
    ];
    let message = String::from_utf8_lossy(&run(folder.path(), &wide).stderr).into_owned();
    assert!(
        message.contains("1.000 of the mask is ignored; the limit is rules.ignored_max = 0.9"),
        "{message}"
    );
}
