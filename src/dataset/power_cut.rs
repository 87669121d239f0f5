//! A test of what a power cut leaves: no frame with a line lacks a file, and a resumed run ends with the same bytes.
//!
//! The operations of a small run are recorded. POSIX promises that an operation has reached the disk only once the file or
//! the folder that it changed is synchronised; until then a power cut may lose it, whatever happens to later ones, and may
//! leave a part of a write. So each state of the disk that a power cut can leave is an instant of the run, and a choice of
//! the operations before it that are not yet synchronised. The test makes these states, all of them where there are few, and
//! resumes the run in each. Lock files are not recorded: a power cut ends every process that held one.
//! Must not know: how frames are rendered.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde_json::json;
use twox_hash::XxHash3_128;

use super::gate::Gate;
use super::log::{FrameLog, find_lines};
use super::log_writer::{FrameLogWriter, record_files};
use super::manifest::DatasetSpec;
use super::merge::finalize_run;
use super::plan::{Plan, Range, Seeds, Shard, frame_seed};
use super::rules::Rules;
use crate::frame::Frame;
use crate::output::disk::{self, Operation, recorder};
use crate::output::edges::{EdgePolicy, MaskIds};
use crate::output::layout::{self, FrameFiles, FrameLine, FrameLines as _, Sample};
use crate::output::{self, Artifact, EncodeInput, LabelIds};
use crate::params::config::Config;
use crate::render::RenderSettings;

/// Frames of the run.
const FRAMES: u64 = 3;
/// An instant with more states than this is sampled.
const STATES_MAX: usize = 200;
/// States of an instant that is sampled, besides those in which one operation is lost or one is not.
const SAMPLES: usize = 20;

fn plan(format: &str, shard: Shard) -> Plan {
    let (format, layout) = layout::find(format).expect("a layout");
    Plan {
        options: String::new(),
        config: Config::new(),
        rules: Rules::default(),
        base_seed: 42,
        seeds: Seeds::OfBase,
        settings: RenderSettings::new([8, 8], 1).expect("settings"),
        outputs: output::parse_outputs("rgb,mask").expect("outputs"),
        edges: EdgePolicy::Hard,
        label_ids: LabelIds::default(),
        format,
        layout,
        range: Range { start: 0, count: FRAMES },
        splits: Vec::new(),
        shard,
    }
}

/// The gate of the run's dataset.
fn gate(format: &str) -> Gate {
    Gate::of_spec(&DatasetSpec::of_plan(&plan(format, Shard::WHOLE))).expect("a gate")
}

/// A frame that takes no device: its image depends on its index.
fn frame(plan: &Plan, index: u64) -> (FrameLine, FrameFiles) {
    let frame = Frame {
        width: 8,
        height: 8,
        rgb: (0..192).map(|i| (i + 7 * index) as u8).collect(),
        class: (0..64).map(|i| ((i + index) % 3) as u8).collect(),
        ..Frame::default()
    };
    let line = json!({
        "index": index, "attempt": 0, "seed": frame_seed(plan.base_seed, index, 0), "stage": "nominal", "adapter": "none",
        "knobs": { "sun.elevation_deg": 10.5 + index as f64 }, "geometry_hash": "", "camera": {}, "sun": {},
        "coverage": { "regolith": 0.5, "rock": 0.25, "sky": 0.25, "unlabelled": 0.0 },
        "rgb": { "mean": 95.5, "p99": 200, "max": 201 }, "moved_rocks": [],
    });
    let mut line: FrameLine = serde_json::from_value(line).expect("a line");
    let mask = MaskIds::new(plan.edges);
    let input = EncodeInput { frame: &frame, meta: &json!({}), label_ids: plan.label_ids, mask: &mask };
    let encoded = output::encode(&input, &plan.outputs).expect("encoded");
    let files = plan.layout.frame_files(&Sample { frame: &frame, files: &encoded, record: &line });
    let files = files.expect("files");
    record_files(&mut line, &files);
    (line, files)
}

/// Makes the frames that the folder lacks, by one run after another, and completes it.
fn make(format: &str, shards: u64, folder: &Path) {
    for number in 0..shards {
        let plan = plan(format, Shard { number, of: shards });
        let mut log = FrameLogWriter::open(folder, &DatasetSpec::of_plan(&plan), false).expect("opened");
        for index in plan.own_indices().filter(|index| !log.finished().contains(index)).collect::<Vec<_>>() {
            let (line, files) = frame(&plan, index);
            log.write_files(&files).and_then(|()| log.append(&line)).expect("written");
        }
        log.write_manifest("done").expect("written");
        finalize_run(folder, log.close(), plan.range, plan.shard).expect("completed");
    }
}

/// An effect of an operation on the disk, which a power cut may lose as long as it is not synchronised.
struct Effect {
    /// Index of its operation.
    at: usize,
    /// Index of the operation that synchronised it.
    synced_at: usize,
    kind: Kind,
}

enum Kind {
    /// Names in one folder now mean other files, or none. They change together.
    Names(Vec<(PathBuf, Option<Node>)>),
    /// Bytes at an offset of a file.
    Bytes { file: usize, offset: usize, bytes: Vec<u8> },
    /// A file ends here.
    Length { file: usize, length: usize },
}

/// What a name means.
#[derive(Clone, Copy, PartialEq)]
enum Node {
    Folder,
    File(usize),
}

/// How much of an unsynchronised effect reached the disk.
#[derive(Clone, Copy, PartialEq)]
enum Fate {
    Lost,
    /// The first half of the bytes.
    Half,
    Whole,
}

/// The effects of operations, in their order.
fn effects(operations: &[Operation]) -> Vec<Effect> {
    let mut effects: Vec<Effect> = Vec::new();
    let mut names: BTreeMap<PathBuf, usize> = BTreeMap::new();
    let mut files = 0;
    for (at, operation) in operations.iter().enumerate() {
        let kind = match operation {
            Operation::CreateFolder(path) => Kind::Names(vec![(path.clone(), Some(Node::Folder))]),
            Operation::Create(path) => {
                names.insert(path.clone(), files);
                files += 1;
                Kind::Names(vec![(path.clone(), Some(Node::File(files - 1)))])
            }
            Operation::Rename(from, to) => {
                let file = names.remove(from).expect("a file");
                names.insert(to.clone(), file);
                Kind::Names(vec![(to.clone(), Some(Node::File(file))), (from.clone(), None)])
            }
            Operation::Remove(path) => {
                names.remove(path);
                Kind::Names(vec![(path.clone(), None)])
            }
            Operation::Write(path, offset, bytes) => {
                Kind::Bytes { file: names[path], offset: *offset as usize, bytes: bytes.clone() }
            }
            Operation::Truncate(path, length) => Kind::Length { file: names[path], length: *length as usize },
            Operation::SyncFile(path) => {
                let synced = names[path];
                for effect in effects.iter_mut().filter(|effect| effect.synced_at == usize::MAX) {
                    if matches!(effect.kind, Kind::Bytes { file, .. } | Kind::Length { file, .. } if file == synced)
                    {
                        effect.synced_at = at;
                    }
                }
                continue;
            }
            Operation::SyncFolder(folder) => {
                for effect in effects.iter_mut().filter(|effect| effect.synced_at == usize::MAX) {
                    if matches!(&effect.kind, Kind::Names(names) if names[0].0.parent() == Some(folder)) {
                        effect.synced_at = at;
                    }
                }
                continue;
            }
        };
        effects.push(Effect { at, synced_at: usize::MAX, kind });
    }
    effects
}

/// The files of a folder by path below it, and `None` for each folder.
type Tree = BTreeMap<PathBuf, Option<Vec<u8>>>;

/// The folder `root` after a power cut, when `fates` are those of the effects before it.
fn state<'a>(root: &Path, fates: impl Iterator<Item = (&'a Effect, Fate)>) -> Tree {
    let mut names: BTreeMap<&Path, Node> = BTreeMap::new();
    let mut files: BTreeMap<usize, Vec<u8>> = BTreeMap::new();
    for (effect, fate) in fates.filter(|(_, fate)| *fate != Fate::Lost) {
        match &effect.kind {
            Kind::Names(changes) => {
                for (path, node) in changes {
                    match node {
                        Some(node) => drop(names.insert(path, *node)),
                        None => drop(names.remove(path.as_path())),
                    }
                }
            }
            Kind::Bytes { file, offset, bytes } => {
                let bytes = if fate == Fate::Half { &bytes[..bytes.len() / 2] } else { bytes };
                let content = files.entry(*file).or_default();
                content.resize(content.len().max(offset + bytes.len()), 0);
                content[*offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            Kind::Length { file, length } => files.entry(*file).or_default().resize(*length, 0),
        }
    }
    let is_there = |path: &Path| names.get(path) == Some(&Node::Folder);
    let mut tree = Tree::new();
    for (path, node) in &names {
        let Ok(below) = path.strip_prefix(root) else { continue };
        // What is in a folder whose own name was lost is lost.
        if path.ancestors().skip(1).take_while(|above| *above != root).all(is_there) {
            let content = match node {
                Node::Folder => None,
                Node::File(file) => Some(files.get(file).cloned().unwrap_or_default()),
            };
            tree.insert(below.to_owned(), content);
        }
    }
    tree
}

/// The states in which a power cut before operation `at` may leave the disk.
fn states(root: &Path, effects: &[Effect], at: usize, draw: &mut impl FnMut(usize) -> usize) -> Vec<Tree> {
    let before: Vec<&Effect> = effects.iter().filter(|effect| effect.at < at).collect();
    let open: Vec<usize> = (0..before.len()).filter(|i| before[*i].synced_at >= at).collect();
    let is_write = |i: usize| matches!(before[i].kind, Kind::Bytes { .. });
    let choices: Vec<&[Fate]> = open
        .iter()
        .map(|i| {
            if is_write(*i) { &[Fate::Lost, Fate::Half, Fate::Whole][..] } else { &[Fate::Lost, Fate::Whole] }
        })
        .collect();
    let count = choices.iter().try_fold(1_usize, |count, fates| count.checked_mul(fates.len()));
    let mut chosen: Vec<Vec<Fate>> = Vec::new();
    if let Some(count) = count.filter(|count| *count <= STATES_MAX) {
        chosen.extend((0..count).map(|mut number| {
            let fate = |fates: &&[Fate]| {
                let fate = fates[number % fates.len()];
                number /= fates.len();
                fate
            };
            choices.iter().map(fate).collect()
        }));
    } else {
        for (most, one) in [(Fate::Whole, Fate::Lost), (Fate::Lost, Fate::Whole), (Fate::Whole, Fate::Half)] {
            let usual = vec![most; open.len()];
            chosen.extend((0..open.len()).map(|i| {
                let mut fates = usual.clone();
                fates[i] = one;
                fates
            }));
            chosen.push(usual);
        }
        chosen.extend((0..SAMPLES).map(|_| choices.iter().map(|fates| fates[draw(fates.len())]).collect()));
    }
    let fate_of = |fates: &[Fate], i: usize| open.binary_search(&i).map_or(Fate::Whole, |open| fates[open]);
    chosen
        .iter()
        .map(|fates| state(root, before.iter().enumerate().map(|(i, effect)| (*effect, fate_of(fates, i)))))
        .collect()
}

/// An empty folder, in memory where the system has such a place: the states are many.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a folder")
}

fn read_tree(folder: &Path) -> Tree {
    fn add(root: &Path, folder: &Path, tree: &mut Tree) {
        for name in disk::names(folder).expect("a folder") {
            let path = folder.join(name);
            let below = path.strip_prefix(root).expect("below").to_owned();
            if path.is_dir() {
                tree.insert(below, None);
                add(root, &path, tree);
            } else {
                tree.insert(below, Some(std::fs::read(&path).expect("read")));
            }
        }
    }
    let mut tree = Tree::new();
    add(folder, folder, &mut tree);
    tree
}

fn write_tree(folder: &Path, tree: &Tree) {
    for (path, content) in tree {
        let path = folder.join(path);
        match content {
            None => std::fs::create_dir(path).expect("made"),
            Some(content) => {
                let name = path.file_name().expect("a name").to_string_lossy().into_owned();
                let artifact = Artifact { name, bytes: content.clone() };
                disk::write_all(path.parent().expect("a folder"), &[artifact]).map(drop).expect("written");
            }
        }
    }
}

/// What is wrong with a state that a power cut left; `None` if nothing is, also after resuming the run.
/// With no `shards` the run is not resumed.
fn problem(format: &str, shards: u64, left: &Tree, whole: &Tree, is_complete: bool) -> Option<String> {
    let folder = folder();
    let data = folder.path().join("data");
    if is_complete {
        // The run had ended: removed files may be back, but none may be lacking.
        let differs = |(path, content): &(&PathBuf, &Option<Vec<u8>>)| left.get(*path) != Some(content);
        if let Some((path, _)) = whole.iter().find(|entry| differs(entry)) {
            return Some(format!("the run had ended, but {} is lost", path.display()));
        }
    }
    write_tree(folder.path(), left);
    let finished = if data.is_dir() {
        find_lines(&data, &gate(format)).expect("read").positions
    } else {
        BTreeMap::new()
    };
    for name in ["frames.jsonl", "frames-0-of-2.jsonl", "frames-1-of-2.jsonl"] {
        let text = std::fs::read(data.join(name)).unwrap_or_default();
        let lines = text.split_inclusive(|byte| *byte == b'\n').filter(|line| line.ends_with(b"\n"));
        for line in lines.filter_map(|line| serde_json::from_slice::<FrameLine>(line).ok()) {
            if !finished.contains_key(&line.index) {
                return Some(format!("frame {} has a line, but not its files", line.index));
            }
            for (path, hash) in line.hashes() {
                let content = std::fs::read(data.join(path)).ok();
                if content.is_some_and(|content| disk::content_hash(&content) != hash) {
                    return Some(format!("{path} is torn"));
                }
            }
        }
    }
    if shards == 0 {
        return None;
    }
    make(format, shards, &data);
    let resumed = read_tree(folder.path());
    let paths: BTreeSet<_> = resumed.keys().chain(whole.keys()).collect();
    let different = paths.into_iter().find(|path| resumed.get(*path) != whole.get(*path));
    different.map(|path| format!("after resuming, {} differs", path.display()))
}

/// The number of different states that a power cut can leave, as far as they are made, and what is wrong with some of them.
/// `is_kept` chooses the operations that count; `resumes` says whether the run is resumed in each state.
fn problems(
    format: &str,
    shards: u64,
    is_kept: impl Fn(&Operation) -> bool,
    resumes: bool,
) -> (usize, Vec<String>) {
    let folder = folder();
    let data = folder.path().join("data");
    let ((), mut operations) = recorder::record(|| make(format, shards, &data));
    operations.retain(is_kept);
    let whole = read_tree(folder.path());
    let mut lines = 0;
    let mut count = |_| {
        lines += 1;
        Ok(())
    };
    FrameLog::new(&data, gate(format)).for_each(&mut count).expect("read");
    assert_eq!(lines, FRAMES);
    let effects = effects(&operations);
    let mut drawn = 0_u64;
    let mut draw = |below: usize| {
        drawn += 1;
        (XxHash3_128::oneshot(&drawn.to_le_bytes()) % below as u128) as usize
    };
    let mut seen: BTreeSet<u128> = BTreeSet::new();
    let mut different = Vec::new();
    for at in 0..=operations.len() {
        let is_complete = at == operations.len();
        for left in states(folder.path(), &effects, at, &mut draw) {
            if seen.insert(XxHash3_128::oneshot(format!("{is_complete} {left:?}").as_bytes())) {
                different.push((at, left, is_complete));
            }
        }
    }
    let found = different.par_iter().filter_map(|(at, left, is_complete)| {
        let found = problem(format, if resumes { shards } else { 0 }, left, &whole, *is_complete)?;
        let next = operations.get(*at).map_or("the end".to_owned(), |next| format!("{next:?}"));
        Some(format!("power cut before {}: {found}", next.chars().take(120).collect::<String>()))
    });
    (different.len(), found.collect())
}

fn check(format: &str, shards: u64) {
    let (states, problems) = problems(format, shards, |_| true, true);
    assert!(states > 100, "{states} states");
    let some = problems[..problems.len().min(12)].join("\n");
    assert!(problems.is_empty(), "{} of {states} states:\n{some}", problems.len());
}

/// Without the calls that synchronise folders, or those that synchronise files, the test finds lost frames.
#[test]
fn a_lack_of_synchronisation_is_found() {
    for (is_kept, expected) in [
        (
            (|operation| !matches!(operation, Operation::SyncFolder(_))) as fn(&Operation) -> bool,
            "but not its files",
        ),
        (|operation| !matches!(operation, Operation::SyncFile(_)), "is torn"),
    ] {
        let (_, problems) = problems("folder", 1, is_kept, false);
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{expected}: {problems:?}");
        assert!(problems.iter().any(|problem| problem.contains("the run had ended")), "{problems:?}");
    }
}

#[test]
fn a_power_cut_loses_no_finished_frame_of_a_folder() {
    check("folder", 1);
}

#[test]
fn a_power_cut_loses_no_finished_frame_of_an_archive() {
    check("webdataset", 1);
}

#[test]
fn a_power_cut_loses_no_finished_frame_of_shards() {
    check("folder", 2);
}
