//! From frame indices to encoded files, on several threads: workers build scenes, plan frames, post-process and encode; the thread of
//! the device does nothing but upload, submit and read back.
//!
//! Must not know: the folder, which frames exist already.

use std::borrow::BorrowMut;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, Scope};
use std::time::Instant;

use serde_json::{Map, Value, json};

use super::attempt::{
    Attempt, FrameScene, PreparedAttempt, RawAttempt, RenderedFrame, RendererInfo, Scenes, lock,
    planner_and_info, scene_of_seed,
};
use super::log_writer::record_files;
use super::plan::{Plan, Seeds};
use super::work_queue::{QueueLimits, Task, WorkQueue};
use crate::error::{Error, Result};
use crate::host_time::{self, Role};
use crate::meta::FrameRecord;
use crate::output::layout::{FrameFiles, FrameLine, Sample};
use crate::output::{self, EncodeInput};
use crate::params::Stage;
use crate::render::{FRAMES_IN_FLIGHT, FrameCost, FramePlanner, InFlight, Renderer, StageTimes};

/// Frames for each worker that may be started after the oldest unfinished one: a frame that is redrawn many times does not stop the
/// others, nor do they pile up behind it.
const AHEAD_PER_WORKER: usize = 4;
/// Cores for each worker where a software adapter draws on the same ones. A worker has about a third of a frame's work, more of small
/// images.
const CORES_PER_WORKER: usize = 2;
/// Keys of a frame's record that are the same for all frames: the manifest has them.
const MANIFEST_KEYS: [&str; 5] = ["size", "samples", "edges", "label_ids", "version"];

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
    pub cost: FrameCost,
}

/// How much is done at the same time. No frame depends on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Concurrency {
    /// Worker threads, each of which builds scenes, plans frames, post-processes and encodes; `None` for as many as suit the device.
    pub threads: Option<usize>,
    /// Frames that the device may work on at a time; `None` for as many as suit the device and the threads.
    pub frames_in_flight: Option<usize>,
}

impl Concurrency {
    /// This many threads, and as many frames as suit them.
    #[must_use]
    pub const fn with_threads(threads: usize) -> Self {
        Self { threads: Some(threads), frames_in_flight: None }
    }

    /// Worker threads: one for each core, or, where a software adapter draws on the same cores, one for every two.
    #[must_use]
    pub fn workers(self, is_software_adapter: bool) -> usize {
        self.threads.unwrap_or_else(|| {
            let cores = cores();
            if is_software_adapter { cores.div_ceil(CORES_PER_WORKER) } else { cores }
        })
    }

    /// Threads for the parallel loops of each worker, itself included: where nobody asked for a number of threads, its share of the cores. A
    /// core that the driver leaves idle then helps to build a scene.
    #[must_use]
    pub fn threads_per_worker(self, is_software_adapter: bool) -> usize {
        let share = cores() / self.workers(is_software_adapter);
        if self.threads.is_some() { 1 } else { share.max(1) }
    }

    /// Frames of a plan that the device works on at a time. On the surface stage, where a software adapter shares its cores with a single
    /// worker, one: the worker has other frames to work on while the next is prepared for it, and a second one in flight takes memory
    /// alone. Frames of the nominal stage are so short that it would wait.
    #[must_use]
    pub fn in_flight(self, is_software_adapter: bool, plan: &Plan) -> usize {
        let is_busy = is_software_adapter && self.workers(is_software_adapter) == 1;
        let is_one = is_busy && !plan.config.stages().contains(&Stage::Nominal);
        self.frames_in_flight.unwrap_or(if is_one { 1 } else { FRAMES_IN_FLIGHT })
    }

    /// Frames of a plan that are in memory at a time: one for each worker and for each frame in flight, and one that the device finds when
    /// it is done with another.
    #[must_use]
    pub fn in_memory(self, is_software_adapter: bool, plan: &Plan) -> usize {
        self.workers(is_software_adapter) + self.in_flight(is_software_adapter, plan) + 1
    }
}

/// Number of cores that the process may use.
#[must_use]
pub fn cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Which frames a pipeline makes, and how.
pub struct Job<'a, Indices, Source, Finish> {
    /// What each frame is.
    pub plan: &'a Plan,
    /// Where the scenes of frames come from.
    pub scenes: Source,
    /// The frames.
    pub indices: Indices,
    /// How much is done at the same time.
    pub concurrency: Concurrency,
    /// Once it is true no further frame is started, and those in flight are finished.
    pub stop: &'a AtomicBool,
    /// What a worker makes of a rendered frame.
    pub finish: Finish,
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
    sink: impl FnMut(FinishedFrame) -> Result<()> + Send,
) -> Result<()> {
    let job = Job { plan, scenes: scene_of_seed, indices, concurrency, stop, finish: encode };
    run_job(job, &Mutex::new(renderer), sink)
}

/// Renders the frames of a job and passes what becomes of each to `sink`, in any order. The renderer is locked for one step of one frame
/// at a time, so that others can use it in between.
///
/// # Errors
/// The first that occurs in rendering, finishing or `sink`.
pub fn run_job<T: Send>(
    job: Job<
        '_,
        impl Iterator<Item = u64> + Send,
        impl Scenes,
        impl Fn(&Plan, RenderedFrame) -> Result<T> + Sync,
    >,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    mut sink: impl FnMut(T) -> Result<()> + Send,
) -> Result<()> {
    let Job { plan, scenes, indices, concurrency, stop, finish } = job;
    let is_software_adapter = (*lock(renderer)).borrow().gpu().capabilities.software_adapter;
    let threads = concurrency.workers(is_software_adapter);
    let threads_per_worker = concurrency.threads_per_worker(is_software_adapter);
    let frames_in_flight = concurrency.in_flight(is_software_adapter, plan);
    let first_error = FirstError::default();
    let limits = QueueLimits {
        ready: threads.max(2),
        ahead: AHEAD_PER_WORKER * threads + frames_in_flight,
        in_memory: concurrency.in_memory(is_software_adapter, plan),
    };
    let queue = WorkQueue::new(indices, limits);
    let (finished_sender, finished) = sync_channel::<T>(threads);
    let (planner, info) = planner_and_info(renderer);
    thread::scope(|scope| {
        let (queue, first_error, scenes, finish) = (&queue, &first_error, &scenes, &finish);
        let worker = Worker { plan, scenes, planner: &planner, renderer: &info, stop, first_error, finish };
        for _ in 0..threads {
            let finished = finished_sender.clone();
            let run = move || {
                let _registration = host_time::register(Role::Worker);
                let work = || worker.run(queue, &finished);
                // A pool of its own: the parallel loops of its frames do not delay those of the device's thread.
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads_per_worker);
                let pool = pool.use_current_thread().spawn_handler(|thread| {
                    let run = || {
                        let _registration = host_time::register(Role::Worker);
                        thread.run();
                    };
                    thread::Builder::new().spawn_scoped(scope, run).map(drop)
                });
                match pool.build() {
                    Ok(pool) => pool.install(work),
                    Err(_) => work(),
                }
            };
            start(scope, run, first_error, queue);
        }
        drop(finished_sender);
        let write = move || {
            let _guard = queue.close_on_panic();
            let _registration = host_time::register(Role::Writer);
            for frame in finished {
                if !first_error.occurred() && first_error.check(sink(frame)).is_none() {
                    queue.close();
                }
            }
        };
        start(scope, write, first_error, queue);
        render_prepared(renderer, frames_in_flight, queue, first_error);
    });
    first_error.into_result()
}

/// Starts a thread of a job. If the system starts none, the job ends with that error.
fn start<'scope>(
    scope: &'scope Scope<'scope, '_>,
    run: impl FnOnce() + Send + 'scope,
    first_error: &FirstError,
    queue: &FrameQueue<impl Iterator<Item = u64>>,
) {
    let started = thread::Builder::new().spawn_scoped(scope, run).map(drop).map_err(Error::Thread);
    if first_error.check(started).is_none() {
        queue.close();
    }
}

/// What the workers share.
struct Worker<'a, Source, Finish> {
    plan: &'a Plan,
    scenes: &'a Source,
    planner: &'a FramePlanner,
    renderer: &'a RendererInfo,
    stop: &'a AtomicBool,
    first_error: &'a FirstError,
    finish: &'a Finish,
}

impl<Source, Finish> Clone for Worker<'_, Source, Finish> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Source, Finish> Copy for Worker<'_, Source, Finish> {}

/// The queue of a pipeline over these indices.
type FrameQueue<Indices> = WorkQueue<Indices, Attempt, PreparedAttempt, RawAttempt>;

impl<T, Source, Finish> Worker<'_, Source, Finish>
where
    Source: Scenes,
    Finish: Fn(&Plan, RenderedFrame) -> Result<T>,
{
    /// Works until every frame is finished.
    fn run(self, queue: &FrameQueue<impl Iterator<Item = u64>>, finished: &SyncSender<T>) {
        let _guard = queue.close_on_panic();
        while let Some(task) = queue.next_task(|| self.stop.load(Ordering::Relaxed), Attempt::first) {
            let result = match task {
                Task::Prepare(attempt) => self.prepare(attempt, queue),
                Task::Finish(raw) => self.finish(raw, queue, finished),
            };
            if self.first_error.check(result).is_none() {
                queue.close();
            }
        }
    }

    fn prepare(self, attempt: Attempt, queue: &FrameQueue<impl Iterator<Item = u64>>) -> Result<()> {
        let is_redraw = attempt.is_redraw();
        queue.add_prepared(attempt.prepare(self.plan, self.planner, self.scenes)?, is_redraw);
        Ok(())
    }

    /// Post-processes and finishes a frame, or gives its next attempt back to the queue.
    fn finish(
        self,
        raw: RawAttempt,
        queue: &FrameQueue<impl Iterator<Item = u64>>,
        finished: &SyncSender<T>,
    ) -> Result<()> {
        match raw.check(self.plan, self.renderer)? {
            Ok(rendered) => {
                let index = rendered.index();
                let _ = finished.send((self.finish)(self.plan, rendered)?);
                queue.finish(index);
            }
            Err(redraw) => queue.add_redraw(redraw),
        }
        Ok(())
    }
}

/// Renders attempts as they are prepared, several in flight, until every frame is finished.
fn render_prepared(
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    frames_in_flight: usize,
    queue: &FrameQueue<impl Iterator<Item = u64>>,
    first_error: &FirstError,
) {
    let _guard = queue.close_on_panic();
    let mut in_flight: VecDeque<(FrameScene, InFlight)> = VecDeque::new();
    (*lock(renderer)).borrow_mut().expect_in_flight(frames_in_flight);
    loop {
        // What is prepared is submitted before the oldest frame is waited for.
        let next =
            if in_flight.len() < frames_in_flight { queue.next_prepared(in_flight.is_empty()) } else { None };
        let result = if let Some(PreparedAttempt { source, packet }) = next {
            let submitted = (*lock(renderer)).borrow_mut().submit_packet(&source.scene, packet);
            submitted.map(|submitted| in_flight.push_back((source, submitted)))
        } else if let Some((source, submitted)) = in_flight.pop_front() {
            let cost = submitted.cost;
            let raw = (*lock(renderer)).borrow_mut().read_back(submitted);
            let raw = raw.map_err(|error| error.of_seed(source.seed));
            raw.map(|raw| queue.add_raw(RawAttempt { source, raw, cost }))
        } else {
            break;
        };
        if first_error.check(result).is_none() || first_error.occurred() {
            queue.close();
            break;
        }
    }
    (*lock(renderer)).borrow_mut().expect_in_flight(FRAMES_IN_FLIGHT);
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
    let mask = std::mem::take(&mut rendered.mask);
    let frame = &mut rendered.frame;
    let input = EncodeInput { frame, meta: &meta, label_ids: plan.label_ids, mask: &mask };
    let encoded = output::encode(&input, &plan.outputs)?;
    mask.write_to(frame);
    let sample = Sample { frame, files: &encoded, record: &line };
    let files = plan.layout.frame_files(&sample)?;
    record_files(&mut line, &files);
    Ok(EncodedFrame { line, files })
}

/// The frame's metadata as for a single frame, without times, and with its position if it is that of a dataset.
pub(super) fn record(plan: &Plan, rendered: &RenderedFrame) -> Map<String, Value> {
    let source = &rendered.source;
    let record = FrameRecord {
        seed: source.seed,
        params: &source.params,
        scene: &source.scene,
        settings: &plan.settings,
        adapter: &rendered.adapter,
        raster: rendered.raster,
        frame: &rendered.frame,
        mask: &rendered.mask,
        label_ids: plan.label_ids,
        times: &Vec::new(),
    };
    let mut meta = Map::new();
    if plan.seeds == Seeds::OfBase {
        meta.insert("index".to_owned(), source.index.into());
        let split = plan.split_of(source.index);
        if !split.is_empty() {
            meta.insert("split".to_owned(), split.into());
        }
        meta.insert("attempt".to_owned(), source.attempt.into());
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::rules::Rules;
    use crate::params::config::Config;
    use crate::render::RenderSettings;

    #[test]
    fn one_frame_is_in_flight_where_one_worker_shares_cores_with_a_driver() {
        let in_flight = |preset: &str, threads: usize, is_software: bool, frames_in_flight: Option<usize>| {
            let mut config = Config::new();
            config.apply_preset(preset).expect("a preset");
            let settings = RenderSettings::new([64, 64], 4).expect("settings");
            let plan = Plan::in_memory(config, Rules::accepting_any_image(), 1, settings, Vec::new());
            Concurrency { threads: Some(threads), frames_in_flight }.in_flight(is_software, &plan)
        };
        assert_eq!(in_flight("surface_train_full", 1, true, None), 1);
        assert_eq!(in_flight("surface_train_full", 2, true, None), FRAMES_IN_FLIGHT);
        assert_eq!(in_flight("surface_train_full", 1, false, None), FRAMES_IN_FLIGHT);
        assert_eq!(in_flight("train_dr", 1, true, None), FRAMES_IN_FLIGHT);
        assert_eq!(in_flight("surface_train_full", 1, true, Some(3)), 3);
    }

    #[test]
    fn a_driver_on_the_cores_leaves_half_of_them_to_workers() {
        let cores = std::thread::available_parallelism().expect("a number of cores").get();
        let default = Concurrency::default();
        assert_eq!([default.workers(false), default.workers(true)], [cores, cores.div_ceil(2)]);
        assert_eq!(Concurrency::with_threads(5).workers(true), 5);
        assert_eq!(
            [true, false].map(|is_software| default.threads_per_worker(is_software)),
            [cores / cores.div_ceil(2), 1]
        );
        assert_eq!(Concurrency::with_threads(1).threads_per_worker(true), 1);
    }
}
