//! Thousands of frames, checked, in a folder that survives anything.
//!
//! Threads build scenes, this one draws, others encode and write, and every queue between them is bounded:
//!
//! ```text
//! indices -> scenes (threads) -> frames (one device) -> files (threads) -> line of frames.jsonl
//! ```
//!
//! [`plan`] says what frame i is, [`rules`] which frames are taken, [`journal`] what is finished.
//! Must not know: the command line.

pub mod convert;
pub mod journal;
pub mod plan;
pub mod rules;
pub mod summary;
pub mod verify;

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Map, Value, json};

use crate::error::{Error, RUN_AGAIN, Result};
use crate::frame::Frame;
use crate::meta::FrameRecord;
use crate::output::layout::{FrameFiles, Sample};
use crate::output::{self, Artifact, EncodeInput, disk};
use crate::params::Params;
use crate::render::{FRAMES_IN_FLIGHT, InFlight, RasterOptions, Renderer, StageTimes, select::selection};
use crate::scene::Scene;
use journal::Journal;
use plan::{Plan, frame_seed};

/// Scenes that wait for the device.
const SCENES_WAITING: usize = 1;
/// The manifest is written anew after so many seconds.
const MANIFEST_SECONDS: u64 = 5;

/// A frame's scene, not yet drawn.
struct Built {
    index: u64,
    attempt: u32,
    seed: u64,
    params: Params,
    scene: Scene,
    times: StageTimes,
    /// Rules that earlier attempts broke.
    redrawn: Vec<String>,
}

/// A frame that was drawn and taken.
struct Drawn {
    built: Built,
    frame: Frame,
    adapter: wgpu::AdapterInfo,
    raster: RasterOptions,
    cost: Cost,
}

/// What drawing a frame took of the device.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Triangles drawn of what is seen.
    pub triangles: u64,
    /// Bytes written to the device.
    pub uploaded_bytes: u64,
    /// Bytes read back.
    pub readback_bytes: u64,
}

/// A frame whose files are made.
#[derive(Debug)]
pub struct Finished {
    /// Its number.
    pub index: u64,
    /// Its line of `frames.jsonl`.
    pub line: Map<String, Value>,
    /// Its files.
    pub placed: FrameFiles,
    /// Milliseconds of work by stage.
    pub times: StageTimes,
    /// How often it was drawn again.
    pub redraws: u32,
    /// What drawing it took of the device.
    pub cost: Cost,
}

/// Builds the scene of an attempt at a frame.
fn build(plan: &Plan, index: u64, attempt: u32, redrawn: Vec<String>) -> Result<Built> {
    let start = Instant::now();
    let seed = frame_seed(plan.base_seed, index, attempt);
    let params = plan.config.draw(seed)?;
    let scene = Scene::build(seed, &params)?;
    selection::build_rocks(&scene, &plan.settings);
    let times = vec![("scene", milliseconds_since(start))];
    Ok(Built { index, attempt, seed, params, scene, times, redrawn })
}

/// An attempt at a frame.
enum Attempt {
    /// The device works on it.
    Begun(Box<Built>, Box<InFlight>),
    /// Its scene could not be built or shown, and why.
    Failed(rules::Broken),
}

impl Attempt {
    fn begin(plan: &Plan, renderer: &mut Renderer, built: Result<Built>) -> Result<Self> {
        let begun = built.and_then(|built| {
            let in_flight = renderer.submit(&built.scene, &plan.settings)?;
            Ok(Self::Begun(Box::new(built), Box::new(in_flight)))
        });
        match begun {
            Ok(begun) => Ok(begun),
            Err(Error::Scene(found)) => Ok(Self::Failed(rules::Broken { rule: "scene".to_owned(), found })),
            Err(other) => Err(other),
        }
    }

    /// Finishes the first attempt at a frame, and makes others until one keeps the rules.
    fn settle(mut self, plan: &Plan, renderer: &mut Renderer, index: u64) -> Result<Drawn> {
        let (mut attempt, mut redrawn) = (0, Vec::new());
        loop {
            let broken = match self {
                Self::Failed(broken) => broken,
                Self::Begun(mut built, in_flight) => {
                    let mut cost = Cost {
                        triangles: in_flight.cost.drawn_triangles,
                        uploaded_bytes: in_flight.cost.uploaded_bytes,
                        readback_bytes: 0,
                    };
                    let (frame, times) = renderer.finish(*in_flight, &built.scene)?;
                    cost.readback_bytes = frame.bytes();
                    built.times.extend(times);
                    let Some(broken) = plan.rules.broken_by(&built.scene, &frame) else {
                        let adapter = renderer.gpu().info.clone();
                        let raster = renderer.raster();
                        return Ok(Drawn { built: *built, frame, adapter, raster, cost });
                    };
                    broken
                }
            };
            attempt += 1;
            if attempt == plan.rules.attempts_max {
                return Err(Error::RuleBroken {
                    index,
                    attempts: attempt,
                    rule: broken.rule,
                    found: broken.found,
                });
            }
            redrawn.push(broken.rule);
            self = Self::begin(plan, renderer, build(plan, index, attempt, redrawn.clone()))?;
        }
    }
}

/// Draws frames as their scenes come, several in flight, until no more come.
fn draw_all(
    plan: &Plan,
    renderer: &mut Renderer,
    frames_in_flight: usize,
    scenes: &Receiver<(u64, Result<Built>)>,
    frames: &SyncSender<Drawn>,
    failure: &Failure,
) {
    let mut flying: VecDeque<(u64, Attempt)> = VecDeque::new();
    loop {
        // A scene that is there goes to the device before a frame is waited for.
        let next = if flying.is_empty() {
            scenes.recv().ok()
        } else if flying.len() < frames_in_flight {
            scenes.try_recv().ok()
        } else {
            None
        };
        if let Some((index, built)) = next {
            // After a failure scenes are taken and left, so that nobody waits to be rid of them.
            if !failure.occurred()
                && let Some(attempt) = failure.keep(Attempt::begin(plan, renderer, built))
            {
                flying.push_back((index, attempt));
            }
        } else if let Some((index, attempt)) = flying.pop_front() {
            if !failure.occurred()
                && let Some(drawn) = failure.keep(attempt.settle(plan, renderer, index))
            {
                let _ = frames.send(drawn);
            }
        } else {
            break;
        }
    }
}

/// Encodes a frame and finds the place of its files.
fn encode(plan: &Plan, drawn: Drawn) -> Result<Finished> {
    let start = Instant::now();
    let Drawn { built, mut frame, adapter, raster, cost } = drawn;
    let meta = record(plan, &built, &frame, &adapter, raster);
    let mut line = meta.clone();
    // The manifest has these, for all frames alike.
    line.retain(|key, _| !["size", "samples", "edges", "version"].contains(&key.as_str()));
    line.insert("adapter".to_owned(), adapter.name.clone().into());
    let meta = Value::Object(meta);
    let input = EncodeInput { frame: &frame, meta: &meta, label_ids: plan.label_ids, edges: plan.edges };
    let files = output::encode(&input, &plan.outputs)?;
    frame.class = plan.edges.apply(&frame);
    let sample = Sample {
        index: built.index,
        split: plan.split_of(built.index),
        frame: &frame,
        files: &files,
        record: &line,
    };
    let placed = plan.layout.frame_files(&sample)?;
    let mut times = built.times;
    times.push(("encode", milliseconds_since(start)));
    add_files(&mut line, &placed);
    // Times come last: all before them is the same in every run.
    line.insert("ms".to_owned(), milliseconds_json(&times));
    Ok(Finished { index: built.index, line, placed, times, redraws: built.attempt, cost })
}

/// Adds to a frame's line its files with their hashes, and what its layout needs to know of it.
fn add_files(line: &mut Map<String, Value>, placed: &FrameFiles) {
    let hash = |file: &Artifact| (file.name.clone(), disk::content_hash(&file.bytes).into());
    line.insert("hashes".to_owned(), placed.files.iter().map(hash).collect::<Map<_, _>>().into());
    if !placed.entry.is_null() {
        line.insert("entry".to_owned(), placed.entry.clone());
    }
}

/// What is recorded of a frame, as for one by itself, but for its times.
fn record(
    plan: &Plan,
    built: &Built,
    frame: &Frame,
    adapter: &wgpu::AdapterInfo,
    raster: RasterOptions,
) -> Map<String, Value> {
    let record = FrameRecord {
        seed: built.seed,
        params: &built.params,
        scene: &built.scene,
        settings: &plan.settings,
        adapter,
        raster,
        frame,
        edges: plan.edges,
        times: &Vec::new(),
    };
    let mut line = Map::new();
    line.insert("index".to_owned(), built.index.into());
    let split = plan.split_of(built.index);
    if !split.is_empty() {
        line.insert("split".to_owned(), split.into());
    }
    line.insert("attempt".to_owned(), built.attempt.into());
    if !built.redrawn.is_empty() {
        line.insert("redrawn".to_owned(), json!(built.redrawn));
    }
    if let Value::Object(record) = record.to_json() {
        line.extend(record.into_iter().filter(|(key, _)| key != "ms"));
    }
    line
}

fn milliseconds_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

fn milliseconds_json(times: &StageTimes) -> Value {
    let rounded = times.iter().map(|&(stage, ms)| (stage.to_owned(), json!((ms * 1e3).round() / 1e3)));
    rounded.collect::<Map<_, _>>().into()
}

/// How much is done at a time. No frame depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Threads that build scenes, and as many that encode.
    pub threads: usize,
    /// Frames that the device may have at a time.
    pub frames_in_flight: usize,
}

impl Pace {
    /// So many threads and [`FRAMES_IN_FLIGHT`].
    #[must_use]
    pub const fn of_threads(threads: usize) -> Self {
        Self { threads, frames_in_flight: FRAMES_IN_FLIGHT }
    }
}

/// Makes these frames and gives each, finished, to `sink`, in any order. Once `stop` is true no frame is begun any more,
/// and those in flight are finished.
///
/// # Errors
/// The first that occurs: that of drawing, encoding or `sink`.
pub fn make(
    plan: &Plan,
    renderer: &mut Renderer,
    indices: impl Iterator<Item = u64> + Send,
    pace: Pace,
    stop: &AtomicBool,
    sink: impl FnMut(Finished) -> Result<()> + Send,
) -> Result<()> {
    let threads = pace.threads;
    let failure = Failure::default();
    let indices = Mutex::new(indices);
    let (scenes, built) = sync_channel::<(u64, Result<Built>)>(SCENES_WAITING);
    let (frames, drawn) = sync_channel::<Drawn>(threads);
    let (done, finished) = sync_channel::<Finished>(threads);
    let drawn = Mutex::new(drawn);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (scenes, indices, failure) = (scenes.clone(), &indices, &failure);
            // A scene a thread: its own parallel loops run on it alone, and those of the device's thread need not wait.
            let builder = move || {
                while !stop.load(Ordering::Relaxed) && !failure.occurred() {
                    let next = indices.lock().unwrap_or_else(PoisonError::into_inner).next();
                    let Some(index) = next else { break };
                    if scenes.send((index, build(plan, index, 0, Vec::new()))).is_err() {
                        break;
                    }
                }
            };
            scope.spawn(move || match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                Ok(pool) => pool.install(builder),
                Err(_) => builder(),
            });
        }
        drop(scenes);
        for _ in 0..threads {
            let (drawn, done, failure) = (&drawn, done.clone(), &failure);
            scope.spawn(move || encode_all(plan, drawn, &done, failure));
        }
        drop(done);
        let failure = &failure;
        scope.spawn(move || {
            let mut sink = sink;
            for frame in finished {
                if !failure.occurred() {
                    failure.keep(sink(frame));
                }
            }
        });
        draw_all(plan, renderer, pace.frames_in_flight, &built, &frames, failure);
        drop(frames);
    });
    failure.into_result()
}

fn encode_all(plan: &Plan, drawn: &Mutex<Receiver<Drawn>>, done: &SyncSender<Finished>, failure: &Failure) {
    loop {
        let next = drawn.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(frame) = next else { break };
        if let Some(finished) = failure.keep(encode(plan, frame)) {
            let _ = done.send(finished);
        }
    }
}

/// The first error of many threads.
#[derive(Debug, Default)]
struct Failure {
    occurred: AtomicBool,
    first: Mutex<Option<Error>>,
}

impl Failure {
    fn occurred(&self) -> bool {
        self.occurred.load(Ordering::Relaxed)
    }

    /// Keeps the error, if it is one and the first.
    fn keep<T>(&self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                self.first.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                self.occurred.store(true, Ordering::Relaxed);
                None
            }
        }
    }

    fn into_result(self) -> Result<()> {
        self.first.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}

/// How far a run has come.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Frames of this run that were there before it.
    pub found: u64,
    /// Frames that it has made.
    pub made: u64,
    /// Frames that it was asked for.
    pub wanted: u64,
    /// How often a frame was drawn again.
    pub redraws: u64,
    /// Milliseconds of work in all, by stage.
    pub times: StageTimes,
}

impl Progress {
    fn add(&mut self, frame: &Finished) {
        self.made += 1;
        self.redraws += u64::from(frame.redraws);
        for &(stage, ms) in &frame.times {
            match self.times.iter_mut().find(|(known, _)| *known == stage) {
                Some((_, sum)) => *sum += ms,
                None => self.times.push((stage, ms)),
            }
        }
    }
}

/// Makes the frames of a plan that its folder lacks, and settles the folder. `watch` is told of every frame.
///
/// # Errors
/// Those of [`make`]; [`Error::Stopped`] if it was asked to. What is finished stays, and the same call goes on with it.
pub fn run(
    plan: &Plan,
    renderer: &mut Renderer,
    journal: Journal,
    pace: Pace,
    stop: &AtomicBool,
    mut watch: impl FnMut(&Progress) + Send,
) -> Result<(Progress, journal::Settled)> {
    let own = (plan.range.start..plan.range.end()).filter(|index| plan.shard.has(*index));
    let missing: Vec<u64> = own.clone().filter(|index| !journal.done().contains(index)).collect();
    let wanted = own.count() as u64;
    let found = wanted - missing.len() as u64;
    let mut progress = Progress { found, made: 0, wanted, redraws: 0, times: StageTimes::new() };
    watch(&progress);
    let folder = journal.folder().to_owned();
    let tag = journal::tag(plan.shard);
    let mut journal = journal;
    let mut written = Instant::now();
    let result = make(plan, renderer, missing.into_iter(), pace, stop, |mut frame| {
        let start = Instant::now();
        disk::write_all_tagged(&folder, &tag, &frame.placed.files)?;
        frame.times.push(("write", milliseconds_since(start)));
        frame.line.insert("ms".to_owned(), milliseconds_json(&frame.times));
        journal.record(frame.index, &frame.line)?;
        progress.add(&frame);
        watch(&progress);
        if written.elapsed().as_secs() >= MANIFEST_SECONDS {
            journal.write_manifest("running")?;
            written = Instant::now();
        }
        Ok(())
    });
    let complete = progress.found + progress.made == wanted;
    // A disk that is full has no room for the manifest either; the error that matters is the first.
    let status = if result.is_err() {
        "error"
    } else if complete {
        "done"
    } else {
        "stopped"
    };
    let manifest = journal.write_manifest(status);
    result?;
    manifest?;
    drop(journal);
    if !complete {
        return Err(Error::Stopped { done: progress.found + progress.made, wanted, remedy: RUN_AGAIN });
    }
    Ok((progress, journal::settle(&folder)?))
}

/// Makes the frames of a plan in order and gives the bytes of each, as a tar archive without its end, to `sink`.
///
/// # Errors
/// Those of [`make`]; [`Error::Stopped`].
pub fn stream(
    plan: &Plan,
    renderer: &mut Renderer,
    pace: Pace,
    stop: &AtomicBool,
    mut sink: impl FnMut(&FrameFiles, &Progress) -> Result<()> + Send,
) -> Result<Progress> {
    let indices = (plan.range.start..plan.range.end()).filter(|index| plan.shard.has(*index));
    let wanted = indices.clone().count() as u64;
    let mut progress = Progress { found: 0, made: 0, wanted, redraws: 0, times: StageTimes::new() };
    // Frames that wait for an earlier one: as many as are in flight at most.
    let mut waiting: BTreeMap<u64, Finished> = BTreeMap::new();
    let mut order = indices.clone();
    let mut next = order.next();
    make(plan, renderer, indices, pace, stop, |frame| {
        waiting.insert(frame.index, frame);
        while let Some(frame) = next.and_then(|index| waiting.remove(&index)) {
            progress.add(&frame);
            sink(&frame.placed, &progress)?;
            next = order.next();
        }
        Ok(())
    })?;
    if progress.made < wanted {
        let remedy = "A stream cannot go on; --start makes the rest in another";
        return Err(Error::Stopped { done: progress.made, wanted, remedy });
    }
    Ok(progress)
}
