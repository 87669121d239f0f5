//! `verify` finds every kind of damage to a dataset, and accepts an intact one.

use std::fs;
use std::path::Path;

use image::GrayImage;
use regolith::output::disk::content_hash;
use serde_json::Value;

use crate::support::{folder, json, program, run, run_ok};

fn make(folder: &Path) {
    let words = ["dataset", "--out", "data", "--count", "6", "--size", "64", "--samples", "1", "-q"];
    let scene =
        ["--set=terrain.cells=60", "--set=rocks.count=20", "--preset=train_dr", "--outputs=rgb,mask,depth"];
    run_ok(folder, &[words.as_slice(), &scene].concat());
}

/// Runs `verify` after a change; returns the names of the checks that fail, and the report as text.
fn found_after(change: impl FnOnce(&Path)) -> (Vec<String>, String) {
    let folder = folder();
    make(folder.path());
    change(&folder.path().join("data"));
    let output = run(folder.path(), &["verify", "data", "--json", "--rerender", "3"]);
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
    let problems = report["problems"].as_array().expect("problems");
    let mut checks: Vec<String> =
        problems.iter().map(|p| p["check"].as_str().expect("a name").to_owned()).collect();
    checks.sort();
    checks.dedup();
    // Every change of a line shows in the digest too.
    checks.retain(|check| check != "digest");
    assert_eq!(output.status.code(), Some(i32::from(!problems.is_empty())), "{report:#}");
    assert_eq!(report["good"], problems.is_empty());
    (checks, report.to_string())
}

/// Rewrites `frames.jsonl` line by line.
fn rewrite(data: &Path, change: impl Fn(usize, &mut Value)) {
    let path = data.join("frames.jsonl");
    let text = fs::read_to_string(&path).expect("read");
    let lines = text.lines().enumerate().map(|(i, line)| {
        let mut line: Value = serde_json::from_str(line).expect("JSON");
        change(i, &mut line);
        format!("{line}\n")
    });
    let changed: String = lines.collect();
    fs::write(path, changed).expect("written");
}

/// Replaces a file together with its recorded hash.
fn replace(data: &Path, frame: usize, name: &str, bytes: &[u8]) {
    fs::write(data.join(name), bytes).expect("written");
    rewrite(data, |i, line| {
        if i == frame {
            line["hashes"][name] = content_hash(bytes).into();
        }
    });
}

fn png(image: &GrayImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).expect("encoded");
    bytes.into_inner()
}

fn mask(data: &Path, frame: usize) -> GrayImage {
    image::open(data.join(format!("mask/mask_{frame:05}.png"))).expect("a mask").into_luma8()
}

#[test]
fn an_intact_dataset_passes_and_the_table_counts_what_was_checked() {
    let folder = folder();
    make(folder.path());
    let table = run_ok(folder.path(), &["verify", "data"]);
    for (check, count) in [("files", "28"), ("masks", "30"), ("statistics", "6"), ("depth", "4")] {
        let row = table.lines().find(|line| line.starts_with(check)).expect("a row");
        assert_eq!(row.split_whitespace().nth(1), Some(count), "{table}");
    }
    let none = run(folder.path(), &["verify", "nowhere"]);
    assert_eq!(none.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&none.stderr).contains("nowhere: there is no such folder"));
    let empty = run(folder.path(), &["verify", "."]);
    assert!(String::from_utf8_lossy(&empty.stderr).contains("no manifest.json"));
}

#[test]
fn flipped_missing_truncated_and_swapped_files_are_found() {
    let (checks, _) = found_after(|data| {
        let path = data.join("rgb/rgb_00001.png");
        let mut bytes = fs::read(&path).expect("read");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(path, bytes).expect("written");
    });
    assert!(checks.contains(&"hashes".to_owned()), "{checks:?}");
    let (checks, report) =
        found_after(|data| fs::remove_file(data.join("mask/mask_00002.png")).expect("removed"));
    assert!(checks == ["files"] && report.contains("mask_00002.png"), "{report}");
    let (checks, report) = found_after(|data| {
        let path = data.join("mask/mask_00003.png");
        let bytes = fs::read(&path).expect("read");
        fs::write(path, &bytes[..bytes.len() / 2]).expect("written");
    });
    assert!(checks.contains(&"hashes".to_owned()) && checks.contains(&"pictures".to_owned()), "{report}");
    let (checks, _) = found_after(|data| {
        let [a, b] = [4, 5].map(|i| data.join(format!("mask/mask_{i:05}.png")));
        let (first, second) = (fs::read(&a).expect("read"), fs::read(&b).expect("read"));
        fs::write(a, second).expect("written");
        fs::write(b, first).expect("written");
    });
    assert!(checks.contains(&"hashes".to_owned()) && checks.contains(&"masks".to_owned()), "{checks:?}");
    let (checks, report) = found_after(|data| {
        fs::copy(data.join("rgb/rgb_00000.png"), data.join("rgb/rgb_00099.png")).map(drop).expect("copied");
    });
    assert!(checks == ["files"] && report.contains("rgb_00099.png"), "{report}");
}

#[test]
fn changes_with_matching_hashes_are_found() {
    let (checks, report) = found_after(|data| {
        let mut image = mask(data, 2);
        image.put_pixel(3, 3, image::Luma([3]));
        replace(data, 2, "mask/mask_00002.png", &png(&image));
    });
    assert!(checks.contains(&"masks".to_owned()) && report.contains("ids [3]"), "{report}");
    // The same number of pixels of each class at other positions: only rendering again finds it.
    let (checks, report) = found_after(|data| {
        let image = image::imageops::flip_horizontal(&mask(data, 0));
        replace(data, 0, "mask/mask_00000.png", &png(&image));
    });
    assert!(checks == ["pictures", "rendering"] && report.contains("come out as another class"), "{report}");
    let (checks, _) =
        found_after(|data| replace(data, 1, "mask/mask_00001.png", &png(&GrayImage::new(32, 64))));
    assert!(checks.contains(&"pictures".to_owned()), "{checks:?}");
    let (checks, _) = found_after(|data| {
        fs::write(data.join("semantic_segmentation_labels.json"), "{\"0\": {\"class\": \"rock\"}}")
            .expect("written");
    });
    assert!(checks.contains(&"labels".to_owned()) && checks.contains(&"hashes".to_owned()), "{checks:?}");
}

#[test]
fn wrong_books_and_a_wrong_camera_are_found() {
    let (checks, _) = found_after(|data| {
        rewrite(data, |i, line| {
            if i == 3 {
                line["index"] = 7.into()
            }
        })
    });
    assert!(checks.contains(&"books".to_owned()), "{checks:?}");
    let (checks, _) = found_after(|data| {
        rewrite(data, |i, line| {
            if i == 3 {
                line["seed"] = 7.into()
            }
        })
    });
    assert_eq!(checks, ["books"]);
    let (checks, _) = found_after(|data| rewrite(data, |_, line| line["rgb"]["p99"] = 3.into()));
    assert!(checks.contains(&"statistics".to_owned()), "{checks:?}");
    let (checks, report) = found_after(|data| {
        rewrite(data, |_, line| line["camera"]["world_from_camera"][2][3] = 40.0.into());
    });
    assert_eq!(checks, ["depth", "records", "rendering"]);
    assert!(report.contains("off the surface"), "{report}");
    // In a frame that is not rendered again.
    for (section, key) in
        [("camera", "K"), ("camera", "world_from_camera"), ("sun", "direction"), ("knobs", "rocks.count")]
    {
        let (checks, report) = found_after(|data| {
            rewrite(data, |i, line| {
                if i == 3 {
                    line[section][key] = 3.into()
                }
            });
        });
        assert!(checks.contains(&"records".to_owned()) && report.contains(key), "{report}");
    }
    let (checks, _) =
        found_after(|data| rewrite(data, |_, line| line["coverage"]["unlabelled"] = 0.5.into()));
    assert!(checks.contains(&"records".to_owned()), "{checks:?}");
    let (checks, _) = found_after(|data| rewrite(data, |_, line| line["knobs"]["rocks.count"] = 3.into()));
    assert!(checks.contains(&"rendering".to_owned()), "{checks:?}");
    // In the manifest itself.
    let manifest = |change: fn(&mut Value)| {
        found_after(|data| {
            let path = data.join("manifest.json");
            let mut manifest = json(&path);
            change(&mut manifest);
            fs::write(path, manifest.to_string()).expect("written");
        })
    };
    assert_eq!(manifest(|manifest| manifest["class_map"]["rock"] = 5.into()).0, ["labels"]);
    assert_eq!(manifest(|manifest| manifest["totals"]["rgb_mean"] = 5.into()).0, ["books"]);
    let (checks, _) = manifest(|manifest| manifest["config"]["sun.elevation_deg"] = 44.into());
    assert!(checks.contains(&"records".to_owned()), "{checks:?}");
    // A truncated line does not hide the findings about the others.
    let (checks, report) = found_after(|data| {
        let path = data.join("frames.jsonl");
        let text = fs::read_to_string(&path).expect("read");
        fs::write(path, &text[..text.len() - 40]).expect("written");
    });
    assert!(checks.contains(&"books".to_owned()) && report.contains("line 6 cannot be read"), "{report}");
}

/// Nobody is told to remove frames of which only the lines are lost, and the dataset's command brings the lines back.
#[test]
fn files_of_frames_without_a_line_are_no_strangers() {
    let folder = folder();
    make(folder.path());
    let path = folder.path().join("data/frames.jsonl");
    let text = fs::read_to_string(&path).expect("read");
    fs::write(folder.path().join("data/rgb/rgb_00099.png"), "of another dataset").expect("written");
    let verify = || {
        let output = run(folder.path(), &["verify", "data", "--json", "--rerender", "0"]);
        assert_eq!(output.status.code(), Some(1));
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(!message.contains("delete a damaged file"), "{message}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    fs::write(&path, &text[..text.len() - 40]).expect("written");
    let report = verify();
    assert!(
        report.contains("line 6 cannot be read") && report.contains("run the dataset command again"),
        "{report}"
    );
    for file in ["rgb/rgb_00005.png", "mask/mask_00005.png", "depth/distance_to_camera_00005.npy"] {
        assert!(report.contains(&format!("{file}: its line is missing from frames.jsonl")), "{report}");
    }
    assert!(report.contains("rgb/rgb_00099.png: it is no part of the dataset"), "{report}");
    fs::remove_file(&path).expect("removed");
    let report = verify();
    assert!(report.contains("frames.jsonl is missing; run the dataset command again"), "{report}");
    for output in ["rgb", "mask", "depth"] {
        let found = format!("{output}: the lines of the frames in this folder are missing");
        assert!(report.contains(&found), "{report}");
    }
    assert!(!report.contains("no part of the dataset"), "{report}");
    fs::remove_file(folder.path().join("data/rgb/rgb_00099.png")).expect("removed");
    make(folder.path());
    run_ok(folder.path(), &["verify", "data", "--rerender", "0"]);
}

#[test]
fn without_an_adapter_all_other_checks_run() {
    let folder = folder();
    make(folder.path());
    let output = program(folder.path())
        .args(["verify", "data"])
        .envs([
            ("VK_DRIVER_FILES", "/none.json"),
            ("VK_ICD_FILENAMES", "/none.json"),
            ("WGPU_BACKEND", "vulkan"),
        ])
        .output()
        .expect("the program starts");
    let (table, message) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(table.contains("hashes") && message.contains("--rerender 0"), "{table}{message}");
    fs::write(folder.path().join("data/manifest.json"), "{").expect("written");
    let output = run(folder.path(), &["verify", "data"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && message.contains("not a manifest"), "{message}");
}

#[test]
fn depth_at_edges_between_ground_meshes_passes() {
    let folder = folder();
    let words =
        ["dataset", "--out", "data", "--count", "8", "--size", "64", "--preset", "surface_train_full", "-q"];
    run_ok(folder.path(), &[&words[..], &["--outputs=rgb,mask,depth"]].concat());
    run_ok(folder.path(), &["verify", "data", "--rerender", "8"]);
}

/// Rocks that are labelled regolith are no part of the ground's surface.
#[test]
fn depth_of_rocks_that_became_regolith_passes() {
    let folder = folder();
    for (data, rule) in [
        ("small", &["--stage=nominal", "--set", "label.min_pixels=1000"][..]),
        (
            "unseen",
            &[
                "--stage=surface",
                "--set",
                "label.unseen=regolith",
                "--set",
                "label.unseen_contrast=100",
                "--set",
                "rocks.coverage=0.05",
            ],
        ),
    ] {
        let words =
            ["dataset", "--out", data, "--count=2", "--seed=5", "--size=128", "--outputs=depth", "-q"];
        run_ok(folder.path(), &[&words[..], rule].concat());
        run_ok(folder.path(), &["verify", data]);
    }
}

#[test]
fn datasets_of_other_versions_are_named_as_such() {
    let folder = folder();
    make(folder.path());
    let path = folder.path().join("data/manifest.json");
    let mut manifest = json(&path);
    let own = manifest["version"].as_str().expect("a version").to_owned();
    let mut report_of = |version: &str| {
        manifest["version"] = version.into();
        fs::write(&path, format!("{manifest:#}\n")).expect("written");
        let output = run(folder.path(), &["verify", "data", "--json", "--rerender", "1"]);
        let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
        (output.status.code(), report)
    };
    // Another minor version makes other scenes: one problem says so, and files are checked.
    let (status, report) = report_of("0.1.0");
    let problems = report["problems"].as_array().expect("problems");
    assert_eq!((status, problems.len()), (Some(1), 1), "{report:#}");
    let found = problems[0]["found"].as_str().expect("text");
    assert!(found.contains("\"0.1.0\"") && found.contains(&own), "{found}");
    assert_eq!(
        (&report["checks"]["hashes"]["looked_at"], &report["checks"]["rendering"]["looked_at"]),
        (&24.into(), &Value::Null)
    );
    // Another patch makes the same scenes, and only the digest knows which it was.
    let (status, report) = report_of(&format!("{}.999", own.rsplit_once('.').expect("numbers").0));
    let checks = report["problems"].as_array().expect("problems").iter().map(|problem| &problem["check"]);
    assert_eq!((status, checks.collect::<Vec<_>>()), (Some(1), vec![&Value::from("digest")]), "{report:#}");
    assert_eq!(report["checks"]["rendering"]["looked_at"], 5);
}

#[test]
fn all_frames_can_be_rendered_again() {
    let folder = folder();
    make(folder.path());
    let report = run_ok(folder.path(), &["verify", "data", "--rerender", "all", "--json"]);
    let report: Value = serde_json::from_str(&report).expect("JSON");
    // The line, the image, the mask and two arrays of each frame.
    assert_eq!(report["checks"]["rendering"]["looked_at"], 6 * 5);
    assert_eq!(report["checks"]["depth"]["looked_at"], 6);
    let output = run(folder.path(), &["verify", "data", "--rerender", "many"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("whole numbers and `all`"), "{message}");
}

#[test]
fn a_dataset_that_is_not_finished_is_named_as_such_and_its_frames_pass() {
    let folder = folder();
    for format in ["folder", "webdataset"] {
        let words =
            ["dataset", "--count=4", "--size=32", "--samples=1", "--shard=0/2", "-q", "--out", format];
        run_ok(folder.path(), &[&words[..], &["--set=rocks.count=5", "--format", format]].concat());
        let output = run(folder.path(), &["verify", format, "--json", "--rerender", "2"]);
        let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
        let problems = report["problems"].as_array().expect("problems");
        assert!(problems.iter().all(|problem| problem["check"] == "books"), "{report:#}");
        assert!(report.to_string().contains("dataset --merge"), "{report:#}");
    }
}

#[test]
fn a_command_that_does_not_make_the_dataset_is_found() {
    let folder = folder();
    make(folder.path());
    let path = folder.path().join("data/manifest.json");
    let manifest = json(&path);
    let command = manifest["command"].as_str().expect("a command");
    let options = "--preset train_dr --set terrain.cells=60 --set rocks.count=20";
    assert!(command.contains(options), "{command}");
    for (preset, changed, said) in [
        (
            "train_dr",
            "--preset train_dr --set terrain.cells=60 --set rocks.count=21",
            "another rocks.count than",
        ),
        ("train_full", &options.replace("train_dr", "train_full"), "its options give another "),
        ("train_dr", "--preset train_dr --set terrain.cells=60", "another rocks.count than"),
        ("train_dr", &format!("{options} --set rules.black_max=0.9"), "other rules"),
        ("train_dr", &format!("{options} --stage surface"), "--stage occurs twice, or behind"),
        ("train_dr", &format!("{options}; rm -rf /"), "the word rm is no option"),
        ("train_dr", &format!("{options} rm"), "the word rm has no value"),
        ("train_dr", &format!("{options}$(rm)"), "should be written as"),
        ("train_dr", &format!("{options} --raster gpu"), "--raster gpu is no rasteriser"),
        ("train_drr", &options.replace("train_dr", "train_drr"), "unknown preset `train_drr`"),
        ("train_dr", "--preset train_dr --config a.toml --set rocks.count=21", "another rocks.count than"),
    ] {
        let mut forged = manifest.clone();
        forged["preset"] = preset.into();
        forged["command"] = command.replace(options, changed).into();
        fs::write(&path, forged.to_string()).expect("written");
        let output = run(folder.path(), &["verify", "data", "--json", "--rerender=0"]);
        let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
        let problems = report["problems"].as_array().expect("problems");
        assert!(output.status.code() == Some(1) && problems.len() == 1, "{changed}: {report:#}");
        assert_eq!(problems[0]["check"], "books");
        let found = problems[0]["found"].as_str().expect("text");
        assert!(found.starts_with("manifest.json: command: ") && found.contains(said), "{changed}: {found}");
    }
    // What cannot be compared: the file.
    let mut other = manifest.clone();
    let with_file = "--preset train_dr --config 'my knobs.toml' --set rocks.count=20";
    other["command"] = command.replace(options, with_file).into();
    fs::write(&path, other.to_string()).expect("written");
    run_ok(folder.path(), &["verify", "data", "--rerender=0"]);
}

#[test]
fn every_command_line_of_the_knobs_passes() {
    let folder = folder();
    fs::write(folder.path().join("my knobs.toml"), "[camera]\nroll_deg = 3\n[rules]\nblack_max = 0.97\n")
        .expect("written");
    for (i, options) in [
        &["--preset=surface_train_full, navcam,sun_polar", "--set=sun.azimuth_deg={uniform=[0.1,40]}"][..],
        &["--stage=surface", "--config=my knobs.toml", "--set=sun.elevation_deg=0.3e1", "--raster=host"],
        &["--preset=train_full", "--set=sun.relative_azimuth_deg=170", "--set=rules.black_max=0.98"],
        &["--set=terrain.cells=60", "--set=terrain.cells=50", "--set=camera.exposure_ev=-0.5"],
        &[],
    ]
    .iter()
    .enumerate()
    {
        let out = format!("data{i}");
        let words = ["dataset", "--count=1", "--size=24", "--samples=1", "-q", "--out", &out];
        run_ok(folder.path(), &[&words[..], options].concat());
        run_ok(folder.path(), &["verify", &out, "--rerender=0"]);
    }
}
