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

use super::attempt::{self, FrameScene, RenderCost, RenderedFrame, build_scene};
use super::in_order::InOrder;
use super::pipeline::{Concurrency, Job, cores, milliseconds_json, record, run_job};
use super::plan::Plan;
use crate::error::{Error, Result};
use crate::output::arrays::{Array, arrays};
use crate::output::rocks_json;
use crate::params::{Knob, Params, Stage};
use crate::render::{Renderer, StageTimes};
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// A frame in memory.
#[derive(Clone, Debug)]
pub struct FrameInMemory {
    /// Its number in the dataset.
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
    pub cost: RenderCost,
}

impl FrameInMemory {
    /// The frame that was rendered by a plan.
    fn of_rendered(plan: &Plan, rendered: RenderedFrame) -> Self {
        let mut record = record(plan, &rendered);
        let RenderedFrame { source, frame, cost, .. } = rendered;
        let FrameScene { index, attempt: redraws, times, .. } = source;
        record.insert("ms".to_owned(), milliseconds_json(&times).into());
        let size = [frame.width, frame.height];
        let rocks = rocks_json(&frame);
        let arrays = arrays(frame, &plan.outputs, plan.edges);
        Self { index, size, arrays, record, rocks, times, redraws, cost }
    }
}

/// A scene from another pose, or under another sun: `set` is TOML of the knobs that differ, of the sections `camera` and `sun`. What the
/// plan draws besides stays. The nominal stage is the same geometry from every pose; the ground of the surface stage is made for the
/// camera, and is made again where the camera has moved. `eye_z_m` is the height of the camera, metres, world: heights above the ground are
/// those of the mesh, which differs a little from camera to camera.
///
/// # Errors
/// [`Error::Usage`] for a knob of another section; those of [`build_scene`].
pub fn posed(
    plan: &Plan,
    seed: u64,
    (scene, params): (&Scene, &Params),
    set: &str,
    eye_z_m: Option<f32>,
) -> Result<(Scene, Params)> {
    let mut posed = posed_by_knobs(plan, seed, (scene, params), set)?;
    if let Some(z_m) = eye_z_m {
        posed.0.camera.eye.z = z_m;
    }
    Ok(posed)
}

fn posed_by_knobs(
    plan: &Plan,
    seed: u64,
    (scene, params): (&Scene, &Params),
    set: &str,
) -> Result<(Scene, Params)> {
    let mut config = plan.config.clone();
    config.apply_toml(set, "camera and sun")?;
    config.check()?;
    let moved = config.draw(seed)?;
    let changed = |knob: &Knob| params.setting(*knob) != moved.setting(*knob);
    let is_of = |knob: &Knob, section: &str| knob.name().starts_with(section);
    let is_pose = |knob: &Knob| is_of(knob, "camera.") || is_of(knob, "sun.");
    if let Some(other) = Knob::ALL.iter().find(|knob| changed(knob) && !is_pose(knob)) {
        return Err(Error::Usage(format!(
            "{}: a scene's pose is that of camera and sun alone",
            other.name()
        )));
    }
    if !Knob::ALL.iter().any(|knob| changed(knob) && is_of(knob, "camera.")) {
        return Ok((Scene { sun: Sun::build(&moved), ..scene.clone() }, moved));
    }
    match moved.stage() {
        Stage::Nominal => {
            let camera = Camera::build(&moved, &scene.terrain)?;
            Ok((Scene { camera, sun: Sun::build(&moved), ..scene.clone() }, moved))
        }
        Stage::Surface => build_scene(&Plan { config, ..plan.clone() }, seed),
    }
}

/// Renders one frame of a scene and waits for it. Its index is the seed.
///
/// # Errors
/// Those of rendering.
pub fn render_scene(
    plan: &Plan,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    seed: u64,
    (scene, params): (Scene, Params),
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

/// Makes the frames of a plan at these indices as [`render_frames`](super::render_frames) does, and passes each to `sink`, in any order,
/// without encoding it.
///
/// # Errors
/// The first that occurs in rendering or `sink`.
pub fn render_in_memory(
    plan: &Plan,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    indices: impl Iterator<Item = u64> + Send,
    concurrency: Concurrency,
    stop: &AtomicBool,
    sink: impl FnMut(FrameInMemory) -> Result<()> + Send,
) -> Result<()> {
    let finish = |plan: &Plan, rendered| Ok(FrameInMemory::of_rendered(plan, rendered));
    run_job(Job { plan, indices, concurrency, stop, finish }, renderer, sink)
}

/// The frames of a plan at these indices, in this order, made on threads of its own: those of a dataset's pipeline, without encoding and
/// without files. An iterator; after an error it ends. Dropping it stops the threads.
#[derive(Debug)]
pub struct FrameStream {
    /// `None` once it has ended.
    frames: Option<Receiver<Result<FrameInMemory>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl FrameStream {
    /// Starts to make the frames. At most `ahead` finished ones wait to be taken, besides those that the pipeline works on. Others may use
    /// the renderer in between.
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
        let stop = Arc::new(AtomicBool::new(false));
        let (sender, frames) = sync_channel(ahead.max(1));
        let is_stopped = Arc::clone(&stop);
        let make = move || {
            let mut in_order = InOrder::new(indices.clone());
            let result = render_in_memory(&plan, &renderer, indices, concurrency, &is_stopped, |frame| {
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
    fn taken(&mut self, next: Option<Result<FrameInMemory>>) -> Option<Result<FrameInMemory>> {
        if !matches!(next, Some(Ok(_))) {
            self.frames = None;
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
