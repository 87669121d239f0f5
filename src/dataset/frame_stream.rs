//! Frames in memory, in order, rendered ahead of whoever takes them.
//!
//! Must not know: files.

use std::borrow::BorrowMut;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::thread::JoinHandle;
use std::time::Duration;

use serde_json::{Map, Value};

use super::attempt::{self, BuiltScene, FrameScene, RenderedFrame, Scenes, scene_of_seed};
use super::in_order::InOrder;
use super::pipeline::{Concurrency, Job, cores, milliseconds_json, record, run_job};
use super::plan::{Plan, Seeds};
use super::pose::Pose;
use crate::error::{Error, Result};
use crate::output::arrays::{Array, arrays};
use crate::output::rocks_json;
use crate::render::{FrameCost, Renderer, StageTimes};

/// A frame in memory.
#[derive(Clone, Debug)]
pub struct FrameInMemory {
    /// Its number in the dataset, or among poses.
    pub index: u64,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// The arrays of the plan's outputs.
    pub arrays: Vec<Array>,
    /// Its record: the line that a dataset would have of it, with milliseconds by stage, and without hashes.
    pub record: Map<String, Value>,
    /// The visible rocks by instance id, as in the mapping that a dataset has; empty unless instances are among the outputs.
    pub rocks: Map<String, Value>,
    /// Milliseconds of work by stage.
    pub times: StageTimes,
    /// Number of rejected attempts.
    pub redraws: u32,
    /// What rendering it cost the device.
    pub cost: FrameCost,
}

impl FrameInMemory {
    /// The frame that was rendered by a plan.
    fn of_rendered(plan: &Plan, rendered: RenderedFrame) -> Self {
        let mut record = record(plan, &rendered);
        let RenderedFrame { source, frame, mask, cost, .. } = rendered;
        let FrameScene { index, attempt: redraws, times, .. } = source;
        record.insert("ms".to_owned(), milliseconds_json(&times).into());
        let size = [frame.width, frame.height];
        let rocks = rocks_json(&frame);
        let arrays = arrays(frame, &plan.outputs, &mask);
        Self { index, size, arrays, record, rocks, times, redraws, cost }
    }
}

/// Renders one frame of a scene and waits for it. Its index is the seed.
///
/// # Errors
/// Those of rendering.
pub fn render_scene(
    plan: &Plan,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    BuiltScene { seed, scene, params }: BuiltScene,
) -> Result<FrameInMemory> {
    let source = FrameScene {
        index: seed,
        attempt: 0,
        seed,
        params,
        scene,
        times: StageTimes::new(),
        redrawn: Vec::new(),
    };
    Ok(FrameInMemory::of_rendered(plan, attempt::render_scene(plan, renderer, source)?))
}

/// Makes frames of a plan at these indices as [`render_frames`](super::render_frames) does, and passes each to `sink`, in any order,
/// without encoding it.
///
/// # Errors
/// The first that occurs in `scenes`, in rendering or in `sink`.
pub fn render_in_memory(
    plan: &Plan,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    (indices, scenes): (impl Iterator<Item = u64> + Send, impl Scenes),
    concurrency: Concurrency,
    stop: &AtomicBool,
    sink: impl FnMut(FrameInMemory) -> Result<()> + Send,
) -> Result<()> {
    let finish = |plan: &Plan, rendered| Ok(FrameInMemory::of_rendered(plan, rendered));
    run_job(Job { plan, scenes, indices, concurrency, stop, finish }, renderer, sink)
}

/// Frames in the order that was asked for, made on threads of its own: those of a dataset's pipeline, without encoding and without files.
/// An iterator; after an error it ends. Dropping it stops the threads.
#[derive(Debug)]
pub struct FrameStream {
    /// `None` once it has ended.
    frames: Option<Receiver<Result<FrameInMemory>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl FrameStream {
    /// Starts to make the frames of a plan at these indices. At most `ahead` finished ones wait to be taken, besides those that the pipeline
    /// works on. Others may use the renderer in between.
    ///
    /// # Errors
    /// [`Error::Thread`] if the system has no thread to spare.
    pub fn start(
        plan: Plan,
        renderer: Arc<Mutex<Renderer>>,
        indices: impl Iterator<Item = u64> + Clone + Send + 'static,
        concurrency: Concurrency,
        ahead: usize,
    ) -> Result<Self> {
        Self::of_scenes(plan, renderer, (indices, scene_of_seed), concurrency, ahead)
    }

    /// Starts to make the frames of a scene from these poses, whatever rules say; the index of a frame is its number among them. For the
    /// rest as [`Self::start`].
    ///
    /// # Errors
    /// Those of [`Self::start`].
    pub fn of_poses(
        plan: Plan,
        renderer: Arc<Mutex<Renderer>>,
        (built, poses): (BuiltScene, Vec<Pose>),
        concurrency: Concurrency,
        ahead: usize,
    ) -> Result<Self> {
        let plan = Plan { seeds: Seeds::Given, ..plan };
        let indices = 0..poses.len() as u64;
        let scenes = move |plan: &Plan, index: u64, _| poses[index as usize].in_scene(&built, &plan.settings);
        Self::of_scenes(plan, renderer, (indices, scenes), concurrency, ahead)
    }

    fn of_scenes(
        plan: Plan,
        renderer: Arc<Mutex<Renderer>>,
        (indices, scenes): (impl Iterator<Item = u64> + Clone + Send + 'static, impl Scenes + Send + 'static),
        concurrency: Concurrency,
        ahead: usize,
    ) -> Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let (sender, frames) = sync_channel(ahead.max(1));
        let is_stopped = Arc::clone(&stop);
        let make = move || {
            let mut in_order = InOrder::new(indices.clone());
            let frames = (indices, scenes);
            let result = render_in_memory(&plan, &renderer, frames, concurrency, &is_stopped, |frame| {
                in_order.add(frame.index, frame);
                while let Some(frame) = in_order.take() {
                    if sender.send(Ok(frame)).is_err() {
                        is_stopped.store(true, Ordering::Relaxed);
                        return Ok(());
                    }
                }
                Ok(())
            });
            if let Err(error) = result {
                let _ = sender.send(Err(error));
            }
        };
        // A pool of its own: the parallel loops of a frame wait for no other work, and in a process that was forked the threads of the
        // common pool do not exist.
        let work = move || {
            let threads = concurrency.threads.unwrap_or_else(cores);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).use_current_thread();
            match pool.build() {
                Ok(pool) => pool.install(make),
                Err(_) => make(),
            }
        };
        let thread = std::thread::Builder::new().name("frames".to_owned()).spawn(work);
        let thread = thread.map_err(Error::Thread)?;
        Ok(Self { frames: Some(frames), stop, thread: Some(thread) })
    }

    /// The next frame as [`Iterator::next`] gives it, or [`Poll::Pending`] if it is not there within this time.
    pub fn next_within(&mut self, limit: Duration) -> Poll<Option<Result<FrameInMemory>>> {
        let Some(frames) = &self.frames else { return Poll::Ready(None) };
        match frames.recv_timeout(limit) {
            Ok(next) => Poll::Ready(self.taken(Some(next))),
            Err(RecvTimeoutError::Timeout) => Poll::Pending,
            Err(RecvTimeoutError::Disconnected) => Poll::Ready(self.taken(None)),
        }
    }

    /// What was received. An error, like the end, is the last.
    ///
    /// # Panics
    /// If the stream ended because its thread panicked, with the same payload: a panic must not look like the last frame.
    fn taken(&mut self, next: Option<Result<FrameInMemory>>) -> Option<Result<FrameInMemory>> {
        if !matches!(next, Some(Ok(_))) {
            self.frames = None;
        }
        if next.is_none()
            && let Some(thread) = self.thread.take()
            && let Err(panic) = thread.join()
        {
            std::panic::resume_unwind(panic);
        }
        next
    }
}

impl Iterator for FrameStream {
    type Item = Result<FrameInMemory>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.frames.as_ref()?.recv().ok();
        self.taken(next)
    }
}

impl Drop for FrameStream {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.frames = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    #[test]
    fn a_panic_is_no_end_of_the_frames() {
        for waits in [false, true] {
            let (sender, frames) = sync_channel(1);
            let thread = std::thread::spawn(move || {
                let _sender: std::sync::mpsc::SyncSender<Result<FrameInMemory>> = sender;
                std::panic::resume_unwind(Box::new("a rock without a shape"));
            });
            let stop = Arc::default();
            let mut stream = FrameStream { frames: Some(frames), stop, thread: Some(thread) };
            let next =
                || if waits { stream.next_within(Duration::MAX).is_ready() } else { stream.next().is_none() };
            let panic = catch_unwind(AssertUnwindSafe(next)).expect_err("no end");
            assert_eq!(panic.downcast_ref(), Some(&"a rock without a shape"));
        }
    }
}
