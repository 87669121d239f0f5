//! From frame indices to encoded files, on several threads.
//!
//! Must not know: the folder, which frames exist already.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Map, Value, json};

use super::attempt::{Attempt, FrameScene, RenderCost, RenderedFrame, build_scene};
use super::log_writer::record_files;
use super::plan::Plan;
use crate::error::{Error, Result};
use crate::meta::FrameRecord;
use crate::output::layout::{FrameFiles, FrameLine, Sample};
use crate::output::{self, EncodeInput};
use crate::render::{FRAMES_IN_FLIGHT, Renderer, StageTimes};

/// Scenes that may wait for the device.
const SCENE_QUEUE: usize = 1;
/// Keys of a frame's record that are the same for all frames: the manifest has them.
const MANIFEST_KEYS: [&str; 4] = ["size", "samples", "edges", "version"];

/// A frame whose files are encoded.
#[derive(Debug)]
pub struct FinishedFrame {
    /// Its number in the dataset.
    pub index: u64,
    /// Its line of `frames.jsonl`.
    pub line: FrameLine,
    /// Its files in the dataset's layout.
    pub files: FrameFiles,
    /// Milliseconds of work by stage.
    pub times: StageTimes,
    /// Number of rejected attempts.
    pub redraws: u32,
    /// What rendering it cost the device.
    pub cost: RenderCost,
}

/// How much is done at the same time. No frame depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Concurrency {
    /// Threads that build scenes, and the same number that encode.
    pub threads: usize,
    /// Frames that the device may work on at a time.
    pub frames_in_flight: usize,
}

impl Concurrency {
    /// This many threads, and [`FRAMES_IN_FLIGHT`] frames.
    #[must_use]
    pub const fn with_threads(threads: usize) -> Self {
        Self { threads, frames_in_flight: FRAMES_IN_FLIGHT }
    }
}

/// Renders these frames and passes each, encoded, to `sink`, in any order. Once `stop` is true no further frame is
/// started, and those in flight are finished.
///
/// # Errors
/// The first that occurs in rendering, encoding or `sink`.
pub fn render_frames(
    plan: &Plan,
    renderer: &mut Renderer,
    indices: impl Iterator<Item = u64> + Send,
    concurrency: Concurrency,
    stop: &AtomicBool,
    mut sink: impl FnMut(FinishedFrame) -> Result<()> + Send,
) -> Result<()> {
    let threads = concurrency.threads;
    let first_error = FirstError::default();
    let indices = Mutex::new(indices);
    let (scene_sender, scenes) = sync_channel::<(u64, Result<FrameScene>)>(SCENE_QUEUE);
    let (frame_sender, frames) = sync_channel::<RenderedFrame>(threads);
    let (finished_sender, finished) = sync_channel::<FinishedFrame>(threads);
    let frames = Mutex::new(frames);
    std::thread::scope(|scope| {
        let first_error = &first_error;
        for _ in 0..threads {
            let (sender, indices) = (scene_sender.clone(), &indices);
            let build = move || build_scenes(plan, indices, &sender, stop, first_error);
            // A pool of one: the parallel loops of a scene stay on its thread and do not delay those of the device's.
            scope.spawn(move || match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                Ok(pool) => pool.install(build),
                Err(_) => build(),
            });
        }
        drop(scene_sender);
        for _ in 0..threads {
            let (frames, sender) = (&frames, finished_sender.clone());
            scope.spawn(move || encode_frames(plan, frames, &sender, first_error));
        }
        drop(finished_sender);
        scope.spawn(move || {
            for frame in finished {
                if !first_error.occurred() {
                    first_error.check(sink(frame));
                }
            }
        });
        render_scenes(plan, renderer, concurrency.frames_in_flight, &scenes, &frame_sender, first_error);
        drop(frame_sender);
    });
    first_error.into_result()
}

/// Builds the scenes of the next indices until there are none left.
fn build_scenes(
    plan: &Plan,
    indices: &Mutex<impl Iterator<Item = u64>>,
    scenes: &SyncSender<(u64, Result<FrameScene>)>,
    stop: &AtomicBool,
    first_error: &FirstError,
) {
    while !stop.load(Ordering::Relaxed) && !first_error.occurred() {
        let next = indices.lock().unwrap_or_else(PoisonError::into_inner).next();
        let Some(index) = next else { break };
        if scenes.send((index, build_scene(plan, index, 0, Vec::new()))).is_err() {
            break;
        }
    }
}

/// Renders scenes as they arrive, several in flight, until all builders have ended.
fn render_scenes(
    plan: &Plan,
    renderer: &mut Renderer,
    frames_in_flight: usize,
    scenes: &Receiver<(u64, Result<FrameScene>)>,
    frames: &SyncSender<RenderedFrame>,
    first_error: &FirstError,
) {
    let mut in_flight: VecDeque<(u64, Attempt)> = VecDeque::new();
    loop {
        // A waiting scene is submitted before the oldest frame is waited for.
        let next = if in_flight.is_empty() {
            scenes.recv().ok()
        } else if in_flight.len() < frames_in_flight {
            scenes.try_recv().ok()
        } else {
            None
        };
        if let Some((index, scene)) = next {
            // After an error, scenes are received and dropped, so that no builder blocks on a full queue.
            if !first_error.occurred()
                && let Some(attempt) = first_error.check(Attempt::submit(plan, renderer, scene))
            {
                in_flight.push_back((index, attempt));
            }
        } else if let Some((index, attempt)) = in_flight.pop_front() {
            if !first_error.occurred()
                && let Some(rendered) = first_error.check(attempt.finish(plan, renderer, index))
            {
                let _ = frames.send(rendered);
            }
        } else {
            break;
        }
    }
}

/// Encodes frames as they arrive.
fn encode_frames(
    plan: &Plan,
    frames: &Mutex<Receiver<RenderedFrame>>,
    finished: &SyncSender<FinishedFrame>,
    first_error: &FirstError,
) {
    loop {
        let next = frames.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(frame) = next else { break };
        if let Some(frame) = first_error.check(encode(plan, frame)) {
            let _ = finished.send(frame);
        }
    }
}

/// Encodes a frame and lays out its files.
fn encode(plan: &Plan, mut rendered: RenderedFrame) -> Result<FinishedFrame> {
    let start = Instant::now();
    let EncodedFrame { mut line, files } = encode_frame(plan, &mut rendered)?;
    let RenderedFrame { source, cost, .. } = rendered;
    let mut times = source.times;
    times.push(("encode", milliseconds_since(start)));
    line.ms = milliseconds_json(&times);
    Ok(FinishedFrame { index: source.index, line, files, times, redraws: source.attempt, cost })
}

/// What a rendered frame is in a dataset.
pub(super) struct EncodedFrame {
    /// Its line of `frames.jsonl`, without times.
    pub(super) line: FrameLine,
    /// Its files in the dataset's layout.
    pub(super) files: FrameFiles,
}

/// The line and the files of a rendered frame; its classes are then those under the edge policy.
pub(super) fn encode_frame(plan: &Plan, rendered: &mut RenderedFrame) -> Result<EncodedFrame> {
    let meta = record(plan, rendered);
    let mut line = frame_line(meta.clone(), &rendered.adapter)?;
    let meta = Value::Object(meta);
    let frame = &mut rendered.frame;
    let input = EncodeInput { frame, meta: &meta, label_ids: plan.label_ids, edges: plan.edges };
    let encoded = output::encode(&input, &plan.outputs)?;
    frame.class = plan.edges.apply(frame);
    let sample = Sample { frame, files: &encoded, record: &line };
    let files = plan.layout.frame_files(&sample)?;
    record_files(&mut line, &files);
    Ok(EncodedFrame { line, files })
}

/// The frame's metadata as for a single frame, without times, and with its position in the dataset.
fn record(plan: &Plan, rendered: &RenderedFrame) -> Map<String, Value> {
    let source = &rendered.source;
    let record = FrameRecord {
        seed: source.seed,
        params: &source.params,
        scene: &source.scene,
        settings: &plan.settings,
        adapter: &rendered.adapter,
        raster: rendered.raster,
        frame: &rendered.frame,
        edges: plan.edges,
        times: &Vec::new(),
    };
    let mut meta = Map::new();
    meta.insert("index".to_owned(), source.index.into());
    let split = plan.split_of(source.index);
    if !split.is_empty() {
        meta.insert("split".to_owned(), split.into());
    }
    meta.insert("attempt".to_owned(), source.attempt.into());
    if !source.redrawn.is_empty() {
        meta.insert("redrawn".to_owned(), json!(source.redrawn));
    }
    if let Value::Object(record) = record.to_json() {
        meta.extend(record.into_iter().filter(|(key, _)| key != "ms"));
    }
    meta
}

/// The frame's line of `frames.jsonl`, still without files and times.
fn frame_line(mut meta: Map<String, Value>, adapter: &wgpu::AdapterInfo) -> Result<FrameLine> {
    meta.retain(|key, _| !MANIFEST_KEYS.contains(&key.as_str()));
    meta.insert("adapter".to_owned(), adapter.name.clone().into());
    serde_json::from_value(meta.into()).map_err(|error| Error::Encode {
        name: "a line of frames.jsonl".to_owned(),
        message: error.to_string(),
    })
}

pub(super) fn milliseconds_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// Milliseconds by stage, to three decimals.
pub(super) fn milliseconds_json(times: &StageTimes) -> Map<String, Value> {
    times.iter().map(|&(stage, ms)| (stage.to_owned(), json!((ms * 1e3).round() / 1e3))).collect()
}

/// The first error of several threads.
#[derive(Debug, Default)]
struct FirstError {
    occurred: AtomicBool,
    error: Mutex<Option<Error>>,
}

impl FirstError {
    fn occurred(&self) -> bool {
        self.occurred.load(Ordering::Relaxed)
    }

    /// The value, or `None` after recording the error if it is the first.
    fn check<T>(&self, result: Result<T>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                self.error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                self.occurred.store(true, Ordering::Relaxed);
                None
            }
        }
    }

    fn into_result(self) -> Result<()> {
        self.error.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}
