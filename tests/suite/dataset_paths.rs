//! The paths of a dataset's files, known before anything is rendered.

use regolith::Result;
use regolith::dataset::manifest;
use regolith::frame::Frame;
use regolith::output::edges::MaskIds;
use regolith::output::layout::{DatasetIndex, FrameLine, FrameLines, LAYOUTS, Layout, Sample};
use regolith::output::{self, EncodeInput, FileKind, LabelIds, OUTPUTS, Output};
use serde_json::{Map, Value, json};

use crate::support::folder;

/// A frame of 2 x 2 pixels with every plane.
fn frame() -> Frame {
    Frame {
        width: 2,
        height: 2,
        focal_px: 2.0,
        rgb: vec![7; 12],
        class: vec![0, 1, 2, 255],
        depth_m: vec![1.0; 4],
        normals: vec![0.5; 12],
        instances: vec![0, 3, 0, 0],
        sun_occlusion: vec![0; 4],
        radiance: (0..12).map(|_| half::f16::from_f32(0.25)).collect(),
        sample_counts: vec![[4, 0, 0]; 4],
        slope_deg: vec![1.0; 4],
        craters: vec![0; 4],
        incidence_deg: vec![10.0; 4],
        phase_deg: vec![20.0; 4],
        five_classes: vec![0; 4],
        ..Frame::default()
    }
}

fn line(split: &str, index: u64) -> FrameLine {
    let line = json!({
        "index": index, "split": split, "attempt": 0, "seed": 1, "stage": "nominal", "adapter": "cpu", "knobs": {},
        "geometry_hash": "", "camera": {}, "sun": {}, "coverage": {}, "rgb": { "mean": 1.0, "p99": 1, "max": 1 },
        "moved_rocks": [],
    });
    serde_json::from_value(line).expect("a line")
}

/// The outputs that a layout can hold, all of them and each alone with those that it needs.
fn output_lists(layout: &dyn Layout) -> Vec<Vec<&'static Output>> {
    let supported = || OUTPUTS.iter().filter(|output| layout.supports(output.name));
    let is_needed = |output: &Output| layout.required_outputs().contains(&output.name);
    let mut lists = vec![supported().collect()];
    for one in supported() {
        lists.push(supported().filter(|output| output.name == one.name || is_needed(output)).collect());
    }
    lists
}

#[test]
fn the_paths_of_a_frame_are_those_that_its_files_get() {
    let (frame, meta, mask) = (frame(), json!({}), MaskIds::default());
    let input = EncodeInput { frame: &frame, meta: &meta, label_ids: LabelIds::Canonical, mask: &mask };
    for row in &LAYOUTS {
        for outputs in output_lists(row.layout) {
            let files = output::encode(&input, &outputs).expect("encoded");
            let kinds: Vec<FileKind> = outputs.iter().flat_map(|output| output.file_kinds()).collect();
            for (split, index) in [("", 0), ("val", 7), ("train", 25), ("a-b", 123_456_789)] {
                let record = line(split, index);
                let sample = Sample { frame: &frame, files: &files, record: &record };
                let made = row.layout.frame_files(&sample).expect("files");
                let names = row.layout.frame_names(&kinds, split, index);
                let paths: Vec<&str> = made.artifacts.iter().map(|file| file.name.as_str()).collect();
                assert_eq!(names.files, paths, "{} {split} {index}", row.name);
                let of_names = |(_, value): &(&String, &Value)| value.is_string();
                let entry: Vec<_> = made.entry.as_object().into_iter().flatten().filter(of_names).collect();
                assert_eq!(names.entry.iter().collect::<Vec<_>>(), entry, "{} {split} {index}", row.name);
            }
        }
    }
}

/// The lines of a dataset in memory.
#[derive(Debug)]
struct Lines(Vec<FrameLine>);

impl FrameLines for Lines {
    fn for_each(&self, visit: &mut dyn FnMut(FrameLine) -> Result<()>) -> Result<()> {
        self.0.iter().cloned().try_for_each(visit)
    }
}

#[test]
fn the_paths_of_the_index_files_are_those_that_are_written() {
    let of = |splits: Value, start: u64, count: u64| {
        let manifest = json!({ "start": start, "count": count, "splits": splits, "size": [2, 2] });
        manifest.as_object().expect("an object").clone()
    };
    let manifests: [Map<String, Value>; 3] = [
        of(json!({}), 0, 3),
        of(json!({}), 998, 1005),
        of(json!({ "train": { "start": 0, "count": 1001 }, "val": { "start": 1001, "count": 2 } }), 0, 1003),
    ];
    for manifest in &manifests {
        let splits = manifest::splits_of(manifest);
        for row in &LAYOUTS {
            let folder = folder();
            let mut lines = Vec::new();
            for split in &splits {
                for index in split.start..split.start + split.count {
                    let names = row.layout.frame_names(&[], &split.name, index);
                    lines.push(FrameLine { entry: names.entry.into(), ..line(&split.name, index) });
                    // What WebDataset joins.
                    for name in names.files.iter().filter(|name| name.starts_with(".parts")) {
                        let path = folder.path().join(name);
                        std::fs::create_dir_all(path.parent().expect("a folder")).expect("created");
                        std::fs::write(path, [0; 512]).expect("written");
                    }
                }
            }
            let lines = Lines(lines);
            let index = DatasetIndex { folder: folder.path(), lines: &lines, manifest, card: "" };
            let mut written = Vec::new();
            let bundles = row.layout.write_bundles(&index, &mut |bundle| {
                written.push(bundle.name.to_owned());
                Ok(())
            });
            bundles.expect("written");
            let index_files = row.layout.index_files(&index, &mut |file| {
                written.push(file.name);
                Ok(())
            });
            index_files.expect("written");
            let paths: Vec<String> = row.layout.index_paths(&splits).collect();
            assert_eq!(paths, written, "{}", row.name);
        }
    }
}
