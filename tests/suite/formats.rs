//! The formats of datasets: the same labels in each, and the same bytes whether rendered or converted.

use std::collections::BTreeMap;
use std::path::Path;

use image::DynamicImage;
use regolith::output::layout::LAYOUTS;
use serde_json::Value;

use crate::support::{folder, json, program, run, run_ok};

const SMALL: [&str; 9] = [
    "dataset",
    "-q",
    "--size=56",
    "--samples=1",
    "--preset=train_dr",
    "--set=terrain.cells=60",
    "--set=rocks.count=20",
    "--edges=ignore:1",
    "--outputs=rgb,mask,instances,preview",
];

/// Makes a small dataset with the outputs that every format can hold, and previews where the format has them.
fn make(folder: &Path, out: &str, format: &str, more: &[&str]) {
    let format = format!("--format={format}");
    let outputs = if matches!(format.as_str(), "--format=folder" | "--format=basic") {
        &SMALL[..]
    } else {
        &SMALL[..8]
    };
    let instances = if outputs.len() == 8 { &["--outputs=rgb,mask,instances"][..] } else { &[] };
    run_ok(folder, &[outputs, instances, &["--out", out, &format], more].concat());
}

/// Every file below a folder; `frames.jsonl` without its milliseconds.
pub(crate) fn content(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(root).expect("below").display().to_string();
            let mut bytes = std::fs::read(&path).expect("read");
            if name == "frames.jsonl" {
                let without_ms = String::from_utf8_lossy(&bytes)
                    .lines()
                    .map(|line| {
                        let mut line: Value = serde_json::from_str(line).expect("JSON");
                        line.as_object_mut().expect("an object").remove("ms");
                        format!("{line}\n")
                    })
                    .collect::<String>();
                bytes = without_ms.into_bytes();
            }
            files.insert(name, bytes);
        }
    }
    files
}

fn decode(files: &BTreeMap<String, Vec<u8>>, name: &str) -> DynamicImage {
    let bytes = files.get(name).unwrap_or_else(|| panic!("{name} is missing: {:?}", files.keys()));
    image::load_from_memory(bytes).expect("an image")
}

fn ids(files: &BTreeMap<String, Vec<u8>>, name: &str) -> Vec<u8> {
    decode(files, name).into_luma8().into_raw()
}

#[test]
fn a_converted_dataset_has_the_bytes_of_a_rendered_one() {
    let ignored = [
        "--count=3",
        "--set=label.too_small=ignore",
        "--set=label.min_pixels=6",
        "--set=label.unseen=ignore",
    ];
    for splits in [&["--count=4"][..], &["--split=train=3,val=2"], &ignored] {
        let folder = folder();
        make(folder.path(), "folder", "folder", splits);
        for format in LAYOUTS.iter().map(|row| row.name).filter(|name| *name != "folder") {
            make(folder.path(), format, format, splits);
            let converted = format!("converted_{format}");
            let words = ["convert", "folder", "--format", format, "--out", &converted, "-q"];
            run_ok(folder.path(), &words);
            // A second time there is nothing to do, and nothing changes.
            run_ok(folder.path(), &words);
            let (rendered, converted) =
                (content(&folder.path().join(format)), content(&folder.path().join(&converted)));
            let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
            // A converted dataset has every output of the folder that its format can hold.
            assert_eq!(names(&rendered), names(&converted), "{format}");
            for (name, bytes) in &rendered {
                assert!(*bytes == converted[name], "{format}: {name} differs");
            }
            let report = run_ok(folder.path(), &["verify", format, "--rerender", "1", "--json"]);
            assert!(report.contains("\"good\": true"), "{format}: {report}");
        }
    }
}

#[test]
fn every_format_has_the_labels_of_the_folder() {
    let folder = folder();
    for format in LAYOUTS.iter().map(|row| row.name) {
        make(folder.path(), format, format, &["--count=3"]);
    }
    let of = |format: &str| content(&folder.path().join(format));
    let (plain, basic, cityscapes, hf, coco) =
        (of("folder"), of("basic"), of("cityscapes"), of("hf"), of("coco"));
    let instances_json = json(&folder.path().join("coco/annotations/instances_train.json"));
    let panoptic_json = json(&folder.path().join("coco/annotations/panoptic_train.json"));
    let rows = |json: &Value| json["annotations"].as_array().expect("annotations").clone();
    let mut used_ids = std::collections::BTreeSet::new();
    for index in 0..3 {
        let mask = ids(&plain, &format!("mask/mask_{index:05}.png"));
        assert!(mask.contains(&0) && mask.contains(&255), "regolith survives, outlines are ignored");
        assert_eq!(ids(&basic, &format!("semantic_segmentation_{index:04}.png")), mask);
        assert_eq!(ids(&hf, &format!("train/masks/{index:06}.png")), mask);
        let city = |what: &str| format!("gtFine/train/moon/moon_000000_{index:06}_gtFine_{what}.png");
        assert_eq!(ids(&cityscapes, &city("labelTrainIds")), mask);
        let labels: Vec<u8> = mask.iter().map(|id| id.wrapping_add(1)).collect();
        assert_eq!(ids(&cityscapes, &city("labelIds")), labels);
        let city_instances = decode(&cityscapes, &city("instanceIds")).into_luma16().into_raw();
        assert!(city_instances.iter().zip(&labels).all(|(instance, label)| {
            let class = if *instance >= 1000 { instance / 1000 } else { *instance };
            class == u16::from(*label) && (*instance >= 1000) == (*label == 2)
        }));

        // COCO instances: each mask covers exactly the pixels of its rock.
        let rocks = decode(&plain, &format!("instances/instance_segmentation_{index:05}.png"))
            .into_luma16()
            .into_raw();
        let mut covered = vec![false; mask.len()];
        for row in rows(&instances_json).iter().filter(|row| row["image_id"] == index) {
            assert!(used_ids.insert(row["id"].as_u64().expect("an id")) && row["category_id"] == 1);
            let pixels = decoded(row["segmentation"]["counts"].as_str().expect("text"), 56, 56);
            let rock = row["id"].as_u64().expect("an id") % 65536;
            for (pixel, inside) in pixels.iter().enumerate() {
                // Also where the mask is ignored: --edges leaves rocks whole.
                assert_eq!(*inside, u64::from(rocks[pixel]) == rock, "rock {rock}");
                covered[pixel] |= inside;
            }
            assert_eq!(row["area"], pixels.iter().filter(|inside| **inside).count());
            let extent = |coordinate: fn(usize) -> usize| {
                let values: Vec<usize> = (0..pixels.len()).filter(|p| pixels[*p]).map(coordinate).collect();
                (*values.iter().min().expect("a pixel"), *values.iter().max().expect("a pixel"))
            };
            let ((left, right), (top, bottom)) = (extent(|p| p % 56), extent(|p| p / 56));
            let expected = [left, top, right - left + 1, bottom - top + 1].map(|side| side as f64);
            assert_eq!(row["bbox"], serde_json::json!(expected));
        }
        assert!(
            covered.iter().zip(&rocks).all(|(covered, rock)| *covered == (*rock > 0)),
            "every rock pixel belongs to an instance"
        );
        assert!(covered.iter().zip(&mask).any(|(covered, id)| *covered && *id == 255));

        // Panoptic segments cover the image without overlap.
        let colours = decode(&coco, &format!("annotations/panoptic_train/{index:06}.png")).into_rgb8();
        let segments: Vec<u64> = colours
            .pixels()
            .map(|p| u64::from(p[0]) + 256 * u64::from(p[1]) + 65536 * u64::from(p[2]))
            .collect();
        let row = rows(&panoptic_json).into_iter().find(|row| row["image_id"] == index).expect("a row");
        let listed: BTreeMap<u64, Value> = row["segments_info"]
            .as_array()
            .expect("segments")
            .iter()
            .map(|segment| (segment["id"].as_u64().expect("an id"), segment.clone()))
            .collect();
        for (segment, id) in segments.iter().zip(&mask) {
            let category =
                listed.get(segment).map_or(0, |segment| segment["category_id"].as_u64().expect("a number"));
            assert_eq!(category, [2, 1, 3].get(usize::from(*id)).copied().unwrap_or(0));
        }
        for (id, segment) in &listed {
            assert_eq!(segment["area"], segments.iter().filter(|other| *other == id).count());
        }
    }
    check_yolo(&plain, &of("yolo"), &of("yolo-seg"));
    assert_eq!(instances_json["licenses"], serde_json::json!([]));
    assert_eq!(instances_json["images"][0].get("license"), None);
    let lines = String::from_utf8_lossy(&hf["train/metadata.jsonl"]).into_owned();
    for line in lines.lines() {
        let row: Value = serde_json::from_str(line).expect("JSON");
        for column in ["file_name", "mask_file_name", "instance_segmentation_file_name"] {
            let name = format!("train/{}", row[column].as_str().expect(column));
            assert!(hf.contains_key(&name), "{name}");
        }
    }
    assert!(hf["README.md"].starts_with(b"---\nlicense: unknown\n"), "whoever publishes it chooses");
    for (files, rows) in [
        (&plain, ["| 0 | regolith |", "| 1 | rock |", "255 is the ignore index"]),
        (&coco, ["| 2 | regolith |", "| 1 | rock |", "| 3 | sky |"]),
        (&of("yolo"), ["| not annotated | regolith |", "| 0 | rock |", "| not annotated | sky |"]),
    ] {
        let card = String::from_utf8_lossy(&files["README.md"]);
        assert!(rows.iter().all(|row| card.contains(row)), "{rows:?}: {card}");
    }
}

/// YOLO's rows are the rocks of the masks: boxes around their pixels, and polygons that enclose them, the holes and nothing else.
fn check_yolo(
    plain: &BTreeMap<String, Vec<u8>>,
    boxes: &BTreeMap<String, Vec<u8>>,
    outlines: &BTreeMap<String, Vec<u8>>,
) {
    let side = 56;
    for index in 0..3 {
        for yolo in [boxes, outlines] {
            let [image, of_folder] =
                [format!("images/train/{index:06}.png"), format!("rgb/rgb_{index:05}.png")];
            assert!(yolo[&image] == plain[&of_folder]);
            assert!(String::from_utf8_lossy(&yolo["data.yaml"]).contains("train: images/train\n"));
        }
        let rocks = decode(plain, &format!("instances/instance_segmentation_{index:05}.png")).into_luma16();
        let mut of_rock: BTreeMap<u16, Vec<bool>> = BTreeMap::new();
        for (pixel, rock) in rocks.into_raw().into_iter().enumerate().filter(|(_, rock)| *rock > 0) {
            of_rock.entry(rock).or_insert_with(|| vec![false; side * side])[pixel] = true;
        }
        let rows = |files: &BTreeMap<String, Vec<u8>>| -> Vec<Vec<f64>> {
            let text = String::from_utf8_lossy(&files[&format!("labels/train/{index:06}.txt")]).into_owned();
            let numbers = |row: &str| row.split(' ').map(|word| word.parse().expect("a number")).collect();
            text.lines().filter(|row| !row.is_empty()).map(numbers).collect()
        };
        let (boxes, outlines) = (rows(boxes), rows(outlines));
        assert!(boxes.len() == of_rock.len() && outlines.len() == of_rock.len() && !boxes.is_empty());
        for ((bounds, outline), inside) in boxes.iter().zip(&outlines).zip(of_rock.values()) {
            let pixels: Vec<usize> = (0..inside.len()).filter(|pixel| inside[*pixel]).collect();
            let extent = |coordinate: &dyn Fn(usize) -> usize| {
                let values = pixels.iter().map(|pixel| coordinate(*pixel));
                let low = values.clone().min().expect("a pixel") as f64;
                (low, values.max().expect("a pixel") as f64 + 1.0)
            };
            let ((left, right), (top, bottom)) = (extent(&|p| p % side), extent(&|p| p / side));
            let expected = [left + right, top + bottom, 2.0 * (right - left), 2.0 * (bottom - top)];
            for (found, expected) in bounds[1..].iter().zip(expected) {
                assert!((found * 2.0 * side as f64 - expected).abs() < 1e-3, "{bounds:?}: {expected:?}");
            }
            let corners: Vec<[f64; 2]> =
                outline[1..].chunks_exact(2).map(|c| [c[0] * side as f64, c[1] * side as f64]).collect();
            let drawn = enclosed(&corners, side);
            assert!(pixels.iter().all(|pixel| drawn[*pixel]), "every pixel is enclosed");
            // What is enclosed besides are holes: no way leads out of them but across the rock.
            let holes = drawn.iter().zip(inside).filter(|(drawn, inside)| **drawn && !**inside).count();
            assert_eq!(holes, filled(inside, side) - pixels.len());
        }
    }
}

/// The pixels whose centres a polygon encloses, by the even-odd rule.
fn enclosed(corners: &[[f64; 2]], side: usize) -> Vec<bool> {
    let is_inside = |pixel: usize| {
        let (x, y) = ((pixel % side) as f64 + 0.5, (pixel / side) as f64 + 0.5);
        let edges = corners.iter().zip(corners.iter().cycle().skip(1));
        let crossed = edges.filter(|([ax, ay], [bx, by])| {
            (*ay > y) != (*by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
        });
        crossed.count() % 2 == 1
    };
    (0..side * side).map(is_inside).collect()
}

/// Number of pixels of a region and its holes: all that cannot be reached from outside by steps along rows and columns.
fn filled(inside: &[bool], side: usize) -> usize {
    let (mut reached, wide) = (vec![false; (side + 2) * (side + 2)], side + 2);
    let mut waiting = vec![0];
    while let Some(cell) = waiting.pop() {
        let (x, y) = (cell % wide, cell / wide);
        let is_pixel = (1..=side).contains(&x) && (1..=side).contains(&y);
        if reached[cell] || is_pixel && inside[(y - 1) * side + x - 1] {
            continue;
        }
        reached[cell] = true;
        let right = (x + 1 < wide).then_some(cell + 1);
        let down = (y + 1 < wide).then_some(cell + wide);
        waiting.extend(
            [(x > 0).then(|| cell - 1), right, (y > 0).then(|| cell - wide), down].into_iter().flatten(),
        );
    }
    (side + 2) * (side + 2) - reached.iter().filter(|reached| **reached).count()
}

/// The pixels of a mask in COCO's compressed run-length encoding, in row-major order.
fn decoded(text: &str, width: usize, height: usize) -> Vec<bool> {
    let (mut counts, mut value, mut shift): (Vec<i64>, i64, u32) = (Vec::new(), 0, 0);
    for byte in text.bytes().map(|byte| i64::from(byte) - 48) {
        value |= (byte & 0x1f) << shift;
        shift += 5;
        if byte & 0x20 == 0 {
            if byte & 0x10 != 0 {
                value |= -1 << shift;
            }
            if counts.len() > 2 {
                value += counts[counts.len() - 2];
            }
            counts.push(value);
            (value, shift) = (0, 0);
        }
    }
    assert_eq!(counts.iter().sum::<i64>(), (width * height) as i64);
    let columns: Vec<bool> = counts
        .iter()
        .enumerate()
        .flat_map(|(i, count)| std::iter::repeat_n(i % 2 == 1, *count as usize))
        .collect();
    (0..width * height).map(|pixel| columns[pixel % width * height + pixel / width]).collect()
}

/// Names and content of the members of a tar archive; checks their headers.
fn members(archive: &[u8]) -> Vec<(String, Vec<u8>)> {
    let (mut at, mut members) = (0, Vec::new());
    while archive[at] != 0 {
        let header = &archive[at..at + 512];
        let text = |from: usize, to: usize| {
            String::from_utf8_lossy(&header[from..to]).trim_end_matches('\0').to_owned()
        };
        let octal = |from: usize, to: usize| u64::from_str_radix(text(from, to).trim(), 8).expect("octal");
        assert_eq!((octal(108, 116), octal(116, 124), octal(136, 148)), (0, 0, 0), "owner, group, time");
        assert_eq!(&header[257..265], b"ustar\x0000");
        let sum: u64 = header
            .iter()
            .enumerate()
            .map(|(i, b)| if (148..156).contains(&i) { 32 } else { u64::from(*b) })
            .sum();
        assert_eq!(octal(148, 155), sum, "the checksum");
        let size = octal(124, 136) as usize;
        members.push((text(0, 100), archive[at + 512..at + 512 + size].to_vec()));
        at += 512 + size.next_multiple_of(512);
    }
    assert!(archive[at..].len() == 1024 && archive[at..].iter().all(|byte| *byte == 0), "the archive's end");
    members
}

#[test]
fn shards_hold_complete_samples_in_order_and_a_stream_has_the_same_members() {
    let folder = folder();
    make(folder.path(), "shards", "webdataset", &["--count=3", "--start=999"]);
    make(folder.path(), "plain", "folder", &["--count=3", "--start=999"]);
    let (shards, plain) = (content(&folder.path().join("shards")), content(&folder.path().join("plain")));
    let table: Value = serde_json::from_slice(&shards["shards.json"]).expect("JSON");
    assert_eq!(table, serde_json::json!({ "000000.tar": 1, "000001.tar": 2 }));
    assert!(!shards.keys().any(|name| name.starts_with('.')), "{:?}", shards.keys());
    let all = [members(&shards["000000.tar"]), members(&shards["000001.tar"])].concat();
    let names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
    let fields =
        ["rgb.png", "mask.png", "instance_segmentation.png", "instance_segmentation_mapping.txt", "json"];
    let expected: Vec<String> =
        (999..1002).flat_map(|index| fields.map(|field| format!("{index:09}.{field}"))).collect();
    assert_eq!(names, expected);
    for (sample, index) in (999..1002).enumerate() {
        assert!(all[5 * sample].1 == plain[&format!("rgb/rgb_{index:05}.png")]);
        assert!(all[5 * sample + 1].1 == plain[&format!("mask/mask_{index:05}.png")]);
        let mapping = format!("instances/instance_segmentation_mapping_{index:05}.json");
        assert!(all[5 * sample + 3].1 == plain[&mapping], "{mapping}");
        let record: Value = serde_json::from_slice(&all[5 * sample + 4].1).expect("JSON");
        assert_eq!(record["index"], index);
    }
    let words = [&SMALL[..8], &["--outputs=rgb,mask,instances", "--format=webdataset", "--out=-"]].concat();
    let output = program(folder.path()).args(words).args(["--count=3", "--start=999"]).output().expect("run");
    assert!(output.status.success());
    assert!(members(&output.stdout) == all, "the stream has the same members");
    let refused = run(folder.path(), &["dataset", "--count=1", "--out=-"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--format webdataset"));
}

#[test]
fn every_format_has_its_own_default_outputs() {
    let folder = folder();
    for format in LAYOUTS.iter().map(|row| row.name) {
        run_ok(folder.path(), &[&SMALL[..8], &["--count=1", "--format", format, "--out", format]].concat());
        let manifest = json(&folder.path().join(format).join("manifest.json"));
        let outputs: Vec<&str> =
            manifest["outputs"].as_array().expect("outputs").iter().filter_map(Value::as_str).collect();
        assert!(outputs.starts_with(&["rgb", "mask"]), "{format}: {outputs:?}");
        assert_eq!(outputs.contains(&"preview"), ["folder", "basic"].contains(&format), "{format}");
    }
    let refused =
        run(folder.path(), &["dataset", "--count=1", "--format=coco", "--outputs=rgb,depth", "--out=new"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--format coco has no place for it"));
}

#[test]
fn replicator_ids_are_named_by_formats_that_allow_them_and_refused_by_others() {
    let folder = folder();
    let ids = ["--count=2", "--label-ids=replicator"];
    for format in ["folder", "hf"] {
        run_ok(folder.path(), &[&SMALL[..8], &ids, &["--format", format, "--out", format]].concat());
        run_ok(folder.path(), &["verify", format, "-q"]);
        let card = std::fs::read_to_string(folder.path().join(format).join("README.md")).expect("a card");
        assert!(card.contains("1 is the ignore index. The ids are those of a Replicator pipeline"), "{card}");
    }
    let names = json(&folder.path().join("hf/id2label.json"));
    assert_eq!(
        [&names["1"], &names["2"], &names["3"], &names["4"]],
        ["UNLABELLED", "sky", "rock", "regolith"]
    );
    std::fs::write(folder.path().join("hf/id2label.json"), "{\"3\": \"sky\"}").expect("written");
    let damaged = run(folder.path(), &["verify", "hf", "-q"]);
    assert!(String::from_utf8_lossy(&damaged.stdout).contains("labels: id2label.json"));
    for format in ["coco", "cityscapes"] {
        let refused =
            run(folder.path(), &[&SMALL[..8], &ids, &["--format", format, "--out", format]].concat());
        let message = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && message.contains("has ids of its own"), "{message}");
    }
    // A folder with such ids can still be converted to them.
    let all = ["--outputs=rgb,mask,instances", "--out=whole"];
    run_ok(folder.path(), &[&SMALL[..8], &ids, &all].concat());
    run_ok(folder.path(), &["convert", "whole", "--format", "cityscapes", "--out", "cityscapes", "-q"]);
    run_ok(folder.path(), &["verify", "cityscapes", "-q"]);
    assert_eq!(json(&folder.path().join("cityscapes/manifest.json"))["class_map"]["rock"], 1);
    let stream = run(folder.path(), &["convert", "whole", "--format", "webdataset", "--out", "-"]);
    assert!(stream.status.code() == Some(2) && stream.stdout.is_empty() && !folder.path().join("-").exists());
}

#[test]
fn an_impossible_conversion_is_refused_with_the_remedy() {
    let folder = folder();
    run_ok(folder.path(), &[&SMALL[..8], &["--outputs=rgb,mask", "--out=plain", "--count=2"]].concat());
    run_ok(
        folder.path(),
        &[&SMALL[..8], &["--outputs=rgb,mask", "--out=half", "--count=2", "--shard=0/2"]].concat(),
    );
    for (words, expected) in [
        (
            ["plain", "coco"],
            "lacks the output `instances`, which coco needs; `regolith-render dataset --add-outputs instances plain` adds it",
        ),
        (["plain", "yolo"], "dataset --add-outputs instances plain"),
        (["half", "hf"], "not finished"),
        (["plain", "cocoo"], "unknown format"),
        (["nowhere", "hf"], "there is no such folder"),
        ([".", "hf"], "no manifest.json"),
    ] {
        let output = run(folder.path(), &["convert", words[0], "--format", words[1], "--out", "new"]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(expected), "{message}");
        assert!(!folder.path().join("new").exists());
    }
}

#[test]
fn splits_that_a_format_cannot_name_are_refused_before_rendering() {
    let folder = folder();
    let refused = |words: &[&str], expected: &str| {
        let output = run(folder.path(), words);
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(expected), "{message}");
        assert!(!folder.path().join("new").exists());
    };
    for (splits, expected) in [("train=1,all=1", "`all`"), ("a-b=1,a_b=1", "`a-b` and `a_b`")] {
        refused(&["dataset", "--format=hf", "--out=new", "--split", splits], expected);
    }
    run_ok(
        folder.path(),
        &[&SMALL[..8], &["--split=a-b=1,a_b=1", "--outputs=rgb,mask", "--out=plain"]].concat(),
    );
    refused(&["convert", "plain", "--format", "hf", "--out", "new"], "`a-b` and `a_b`");
}

#[test]
fn a_shard_survives_a_stop_between_joining_and_removing_its_fragments() {
    let folder = folder();
    make(folder.path(), "whole", "webdataset", &["--count=5"]);
    make(folder.path(), "grown", "webdataset", &["--count=2"]);
    make(folder.path(), "grown", "webdataset", &["--count=5"]);
    let whole = content(&folder.path().join("whole"));
    assert!(whole == content(&folder.path().join("grown")));
    // As after such a stop: the shard is complete, and some of its fragments still exist.
    let grown = folder.path().join("grown");
    let archive = std::fs::read(grown.join("000000.tar")).expect("a shard");
    let frame = archive.windows(9).position(|window| window == b"000000001").expect("the second sample");
    std::fs::create_dir(grown.join(".parts")).expect("made");
    std::fs::write(grown.join(".parts/000000000.tar"), &archive[..frame]).expect("written");
    make(folder.path(), "grown", "webdataset", &["--count=5"]);
    assert!(whole == content(&grown));
}

/// That an archive exists does not mean that it has each of its thousand frames.
#[test]
fn frames_of_lost_fragments_and_damaged_archives_are_made_again() {
    let folder = folder();
    make(folder.path(), "whole", "webdataset", &["--count=6"]);
    let whole = content(&folder.path().join("whole"));
    make(folder.path(), "grown", "webdataset", &["--count=2"]);
    make(folder.path(), "grown", "webdataset", &["--count=6", "--shard=0/2"]);
    let fragment = folder.path().join("grown/.parts/000000004.tar");
    std::fs::remove_file(&fragment).expect("removed");
    make(folder.path(), "grown", "webdataset", &["--count=6", "--shard=0/2"]);
    assert!(fragment.is_file(), "the lost frame was not made again");
    std::fs::remove_file(&fragment).expect("removed");
    make(folder.path(), "grown", "webdataset", &["--count=6"]);
    assert!(whole == content(&folder.path().join("grown")));
    // Cut within a file, at the end of the last sample, before it, and to nothing; and no archive at all.
    let path = folder.path().join("grown/000000.tar");
    let archive = &whole["000000.tar"];
    let last = archive.windows(9).position(|window| window == b"000000005").expect("the last sample");
    let not_zero = [&archive[..last], &[7; 700]].concat();
    for damaged in [&archive[..5000], &archive[..archive.len() - 1024], &archive[..last], &[], &not_zero] {
        std::fs::write(&path, damaged).expect("written");
        make(folder.path(), "grown", "webdataset", &["--count=6"]);
        assert!(whole == content(&folder.path().join("grown")), "of {} bytes", damaged.len());
    }
}

#[test]
fn a_log_that_lacks_a_frame_is_not_converted() {
    let folder = folder();
    make(folder.path(), "plain", "folder", &["--count=3"]);
    let path = folder.path().join("plain/frames.jsonl");
    let text = std::fs::read_to_string(&path).expect("read");
    let convert = ["convert", "plain", "--format=basic", "--out=new", "-q"];
    for lost in [0, 1, 2] {
        let lines = text.lines().enumerate().filter(|(i, _)| *i != lost);
        let kept: String = lines.map(|(_, line)| format!("{line}\n")).collect();
        std::fs::write(&path, kept).expect("written");
        let output = run(folder.path(), &convert);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        let missing = format!("plain/frames.jsonl: the line of frame {lost} is missing");
        assert!(message.contains(&missing) && message.contains("dataset command of plain"), "{message}");
        assert!(!folder.path().join("new").exists());
    }
    // The remedy works.
    make(folder.path(), "plain", "folder", &["--count=3"]);
    run_ok(folder.path(), &convert);
}

/// A folder with a part of another conversion is not completed with frames of this one, and nothing in it changes.
#[test]
fn a_conversion_continues_with_frames_of_its_own_source_only() {
    let folder = folder();
    make(folder.path(), "small", "folder", &["--count=2"]);
    make(folder.path(), "large", "folder", &["--count=4"]);
    // As by another adapter: the same configuration, another line.
    make(folder.path(), "other", "folder", &["--count=2"]);
    let lines = folder.path().join("other/frames.jsonl");
    let text =
        std::fs::read_to_string(&lines).expect("read").replace("\"adapter\":\"", "\"adapter\":\"Another ");
    std::fs::write(&lines, text).expect("written");
    let manifest = folder.path().join("other/manifest.json");
    let mut values: Value = serde_json::from_slice(&std::fs::read(&manifest).expect("read")).expect("JSON");
    values.as_object_mut().expect("an object").remove("digest");
    std::fs::write(&manifest, values.to_string()).expect("written");

    let convert =
        |source: &str| run(folder.path(), &["convert", source, "--format=basic", "--out=new", "-q"]);
    for (first, second, message) in [
        (
            "large",
            "small",
            "new: it is for frames 0 to 3 of another conversion, of which small has 0 to 1 only",
        ),
        ("other", "small", "new: its frame 0 was converted from another dataset"),
    ] {
        let new = folder.path().join("new");
        assert!(convert(first).status.success(), "{first}");
        // As if interrupted after the first frame.
        let log = new.join("frames.jsonl");
        let text = std::fs::read_to_string(&log).expect("read");
        std::fs::write(&log, format!("{}\n", text.lines().next().expect("a line"))).expect("written");
        let before = content(&new);
        let output = convert(second);
        let printed = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{printed}");
        assert!(printed.contains(message) && printed.contains("another --out"), "{printed}");
        assert!(before == content(&new), "{first}, then {second}");
        std::fs::remove_dir_all(&new).expect("removed");
    }
    // A larger source of the same frames continues.
    assert!(convert("small").status.success() && convert("large").status.success());
    assert_eq!(content(&folder.path().join("new")).keys().filter(|name| name.contains("rgb")).count(), 4);
}
