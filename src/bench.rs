//! Frame throughput, case by case, with the time of each stage.
//!
//! A frame is timed from the end of the frame before it until it is read back, after a warm-up; the median is reported.
//! Stages of several frames overlap, so their times need not add up to that of a frame. The time of the host is that of the program's
//! own threads on a processor, without the threads of the driver; that of the process has them all. In the cases of a dataset the
//! time of redrawn attempts is that of the frames that come of them.
//! Must not know: the command line.
//! To add a case: a variant of [`Case`] with its arm in [`run`].

mod curve;
mod moving;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use serde_json::{Map, Value, json};

use crate::dataset::attempt::{RenderCost, Scenes, build_scene, scene_of_seed};
use crate::dataset::plan::{Plan, Seeds, frame_seed};
use crate::dataset::{self, Concurrency};
use crate::error::{Error, Result};
use crate::host_time::{self, Role, RoleTimes};
use crate::output::disk;
use crate::params::Stage;
use crate::render::{FRAMES_IN_FLIGHT, Renderer, StageTimes, Staging};
use crate::scene::Scene;
pub use curve::Curve;
use moving::Moving;

/// Number of frames before the measurement starts.
const WARM_UP: u64 = 3;

/// What changes from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// One scene; camera and sun move.
    Camera,
    /// One scene; the camera moves.
    StaticSun,
    /// One scene; camera and sun move, in memory, on the threads of a dataset.
    Poses,
    /// A new scene for every frame, in memory.
    Scene,
    /// A new scene for every frame, in memory, on the threads of a dataset.
    Frames,
    /// The same, encoded and written.
    Dataset,
}

impl Case {
    /// Every case with its name and a description of what changes from frame to frame.
    pub const ALL: [(Self, &'static str, &'static str); 6] = [
        (Self::Camera, "camera", "one scene, camera and sun move"),
        (Self::StaticSun, "static-sun", "one scene, the camera moves"),
        (Self::Poses, "poses", "one scene, camera and sun move, on the threads of a dataset"),
        (Self::Scene, "scene", "a new scene for every frame, in memory"),
        (Self::Frames, "frames", "a new scene for every frame, in memory, on the threads of a dataset"),
        (Self::Dataset, "dataset", "the same, encoded and written"),
    ];

    /// Its name in `--cases` and in the JSON result.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }
}

/// The measurements of a case.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Milliseconds from the end of one frame to that of the next.
    pub frames_ms: Vec<f64>,
    /// Milliseconds from the start of the first frame to the end of the last.
    pub total_ms: f64,
    /// Mean processor time of the program's own threads for a frame, by what they do; `None` where the system does not report it.
    pub host: Option<RoleTimes>,
    /// Processor time of the whole process for a frame, a driver's threads included, milliseconds; `None` where the system does not
    /// report it.
    pub process_ms: Option<f64>,
    /// Attempts that broke a rule, in the cases on the threads of a dataset.
    pub redraws: u64,
    /// Frames that the device worked on at a time.
    pub frames_in_flight: usize,
    /// Peak resident memory of the process up to the end of the case, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Milliseconds of work by stage, of each frame.
    pub stages: Vec<StageTimes>,
    /// Triangles drawn for visibility, of each frame.
    pub triangles: Vec<f64>,
    /// Bytes uploaded to the device, of each frame.
    pub upload_bytes: Vec<f64>,
    /// Bytes read back for each frame.
    pub readback_bytes: u64,
}

/// The quantile `q` of the values, without interpolation; 0 for an empty list.
#[must_use]
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
        .get(((sorted.len() as f64 * q) as usize).min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or_default()
}

impl Measured {
    /// Frames per second over the whole case.
    #[must_use]
    pub fn frames_per_second(&self) -> f64 {
        1e3 * self.frames_ms.len() as f64 / self.total_ms.max(1e-9)
    }

    /// Mean processor time of the program's own threads for a frame, milliseconds.
    #[must_use]
    pub fn host_ms(&self) -> Option<f64> {
        self.host.map(|host| host.total())
    }

    /// A model of the throughput on a number of cores, frames per second, as far as the host limits it: no thread that exists once
    /// does more than its share of every frame, and all cores together do all of the work.
    #[must_use]
    pub fn host_frames_per_second(&self, cores: usize) -> Option<f64> {
        let host = self.host?;
        let serial_ms = host.of(Role::Device).max(host.of(Role::Writer));
        Some(1e3 / serial_ms.max(host.total() / cores as f64).max(1e-9))
    }

    /// Median milliseconds of each stage, in the order of execution.
    #[must_use]
    pub fn stage_ms(&self) -> StageTimes {
        let names =
            self.stages.first().map(|stages| stages.iter().map(|stage| stage.0)).into_iter().flatten();
        names
            .map(|name| {
                let of =
                    |stages: &StageTimes| stages.iter().find(|stage| stage.0 == name).map(|stage| stage.1);
                let values: Vec<f64> = self.stages.iter().filter_map(of).collect();
                (name, quantile(&values, 0.5))
            })
            .collect()
    }

    /// The entry of the case in `bench --json`.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let stages: Map<String, Value> =
            self.stage_ms().into_iter().map(|(name, ms)| (name.to_owned(), ms.into())).collect();
        json!({
            "frames": self.frames_ms.len(),
            "median_ms": quantile(&self.frames_ms, 0.5),
            "p95_ms": quantile(&self.frames_ms, 0.95),
            "frames_per_second": self.frames_per_second(),
            "process_ms": self.process_ms,
            "redraws": self.redraws,
            "frames_in_flight": self.frames_in_flight,
            "peak_rss_bytes": self.peak_rss_bytes,
            "host_ms": self.host_ms(),
            "host_thread_ms": self.host.map(|host| json!({
                "device": host.of(Role::Device),
                "writer": host.of(Role::Writer),
                "workers": host.of(Role::Worker) + host.of(Role::Pool),
            })),
            "host_frames_per_second_16_cores": self.host_frames_per_second(16),
            "stage_ms": stages,
            "triangles": quantile(&self.triangles, 0.5) as u64,
            "upload_bytes": quantile(&self.upload_bytes, 0.5) as u64,
            "readback_bytes": self.readback_bytes,
        })
    }
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Knobs, seed, size, samples and outputs; its range, splits and shard are not used.
    pub plan: Plan,
    /// Frames in flight, and the threads of the case `dataset`.
    pub concurrency: Concurrency,
    /// Number of frames after the warm-up.
    pub frames: u64,
    /// Once it is true, no further frame is measured.
    pub stop: Arc<AtomicBool>,
}

impl Setup {
    /// Frames that the device works on at a time in the cases whose scenes come from one thread.
    fn frames_in_flight(&self) -> usize {
        self.concurrency.frames_in_flight.unwrap_or(FRAMES_IN_FLIGHT)
    }
}

/// Measures a case. The case `dataset` writes into `folder`, which must be empty.
///
/// # Errors
/// Those of rendering and writing; [`Error::Stopped`].
pub fn run(case: Case, setup: &Setup, folder: &Path, renderer: &mut Renderer) -> Result<Measured> {
    host_time::start();
    let _registration = host_time::register(Role::Device);
    let _pool = rayon::broadcast(|_| host_time::register(Role::Pool));
    match case {
        Case::Camera => moving(setup, true, renderer),
        Case::StaticSun => moving(setup, false, renderer),
        Case::Poses => {
            // No other attempt would be another scene.
            let plan = Plan { seeds: Seeds::Given, ..setup.plan.clone() };
            let moving = Moving::new(&plan)?;
            let scenes = |_: &Plan, frame, _| Ok((moving.scene_of_frame(frame), Staging::WithoutMeshes));
            in_memory(&Setup { plan, ..setup.clone() }, renderer, scenes)
        }
        Case::Scene => scenes(setup, renderer),
        Case::Frames => in_memory(setup, renderer, scene_of_seed),
        Case::Dataset => dataset(setup, folder, renderer),
    }
}

const fn stopped(done: u64, wanted: u64) -> Error {
    Error::Stopped { done, wanted, remedy: "A measurement cannot be resumed; run it again" }
}

/// Starts the measurement of a case.
#[derive(Clone, Copy)]
struct Start {
    at: Instant,
    host: Option<RoleTimes>,
    process_ms: Option<f64>,
}

impl Start {
    fn now() -> Self {
        Self { at: Instant::now(), host: host_time::by_role(), process_ms: host_time::of_process_ms() }
    }

    /// Sets the times from the start to now.
    fn end(self, measured: &mut Measured) {
        measured.total_ms = self.at.elapsed().as_secs_f64() * 1e3;
        let frames = measured.frames_ms.len().max(1) as f64;
        let process_ms = host_time::of_process_ms().zip(self.process_ms);
        measured.process_ms = process_ms.map(|(end, start)| (end - start) / frames);
        measured.peak_rss_bytes = peak_rss_bytes();
        let host = host_time::by_role().zip(self.host);
        measured.host = host.map(|(end, start)| end.since(&start, measured.frames_ms.len()));
    }
}

/// Renders the scenes that `next` returns, several frames in flight. `next` gets the index of a frame and returns its scene with
/// the times that building it took.
fn measure(
    setup: &Setup,
    renderer: &mut Renderer,
    mut next: impl FnMut(u64) -> Result<(Arc<Scene>, StageTimes)>,
) -> Result<Measured> {
    let Setup { plan, frames, stop, .. } = setup;
    let frames_in_flight = setup.frames_in_flight();
    let mut measured = Measured::default();
    let mut queue = VecDeque::new();
    let (mut start, mut last) = (Start::now(), Instant::now());
    let total = WARM_UP + frames;
    let (mut submitted, mut finished) = (0, 0);
    while finished < total {
        if stop.load(Ordering::Relaxed) {
            return Err(stopped(finished, total));
        }
        if submitted < total && queue.len() < frames_in_flight {
            let (scene, times) = next(submitted)?;
            let in_flight = renderer.submit(&scene, &plan.settings)?;
            queue.push_back((scene, times, in_flight));
            submitted += 1;
        } else if let Some((scene, mut times, in_flight)) = queue.pop_front() {
            measured.triangles.push(in_flight.cost.drawn_triangles as f64);
            measured.upload_bytes.push(in_flight.cost.uploaded_bytes as f64);
            let (frame, render_times) = renderer.finish(in_flight, &scene)?;
            times.extend(render_times);
            measured.frames_ms.push(last.elapsed().as_secs_f64() * 1e3);
            measured.stages.push(times);
            measured.readback_bytes = frame.bytes();
            last = Instant::now();
            finished += 1;
            if finished == WARM_UP {
                measured = Measured::default();
                start = Start::now();
            }
        }
    }
    start.end(&mut measured);
    measured.frames_in_flight = frames_in_flight;
    Ok(measured)
}

/// One scene with a moving camera and, if `sun_moves`, a moving sun.
fn moving(setup: &Setup, sun_moves: bool, renderer: &mut Renderer) -> Result<Measured> {
    let moving = Moving::new(&setup.plan)?;
    // One copy of the scene for each frame that can be in flight, so that none is made during the measurement.
    let mut scenes: Vec<Arc<Scene>> =
        (0..=setup.frames_in_flight()).map(|_| Arc::new(moving.still.scene.clone())).collect();
    measure(setup, renderer, |frame| {
        let start = Instant::now();
        let oldest = scenes.remove(0);
        let mut scene = Arc::try_unwrap(oldest).unwrap_or_else(|shared| Scene::clone(&shared));
        moving.set_pose(&mut scene, frame, sun_moves);
        let scene = Arc::new(scene);
        scenes.push(Arc::clone(&scene));
        Ok((scene, vec![("scene", start.elapsed().as_secs_f64() * 1e3)]))
    })
}

fn scenes(setup: &Setup, renderer: &mut Renderer) -> Result<Measured> {
    let plan = &setup.plan;
    measure(setup, renderer, |frame| {
        let start = Instant::now();
        let scene = build_scene(plan, frame_seed(plan.base_seed, frame, 0))?.scene;
        Ok((Arc::new(scene), vec![("scene", start.elapsed().as_secs_f64() * 1e3)]))
    })
}

/// The measurement of a pipeline, whose frames come from several threads.
struct Pipeline {
    measured: Measured,
    start: Start,
    last: Instant,
    done: u64,
}

impl Pipeline {
    fn start(setup: &Setup, renderer: &Renderer) -> Self {
        let frames_in_flight =
            setup.concurrency.in_flight(renderer.gpu().capabilities.software_adapter, &setup.plan);
        let measured = Measured { frames_in_flight, ..Measured::default() };
        Self { measured, start: Start::now(), last: Instant::now(), done: 0 }
    }

    /// A frame is finished.
    fn add(&mut self, times: StageTimes, redraws: u32, cost: &RenderCost) {
        self.done += 1;
        if self.done <= WARM_UP {
            self.start = Start::now();
        } else {
            self.measured.frames_ms.push(self.last.elapsed().as_secs_f64() * 1e3);
            self.measured.stages.push(times);
            self.measured.redraws += u64::from(redraws);
            self.measured.triangles.push(cost.triangles as f64);
            self.measured.upload_bytes.push(cost.uploaded_bytes as f64);
            self.measured.readback_bytes = cost.readback_bytes;
        }
        self.last = Instant::now();
    }

    fn end(mut self, setup: &Setup) -> Result<Measured> {
        if setup.stop.load(Ordering::Relaxed) {
            return Err(stopped(self.done, WARM_UP + setup.frames));
        }
        self.start.end(&mut self.measured);
        Ok(self.measured)
    }
}

/// Frames of these scenes, in memory, on the threads of a dataset.
fn in_memory(setup: &Setup, renderer: &mut Renderer, scenes: impl Scenes) -> Result<Measured> {
    let mut pipeline = Pipeline::start(setup, renderer);
    let Setup { plan, concurrency, frames, stop } = setup;
    let of_frames = (0..WARM_UP + frames, scenes);
    dataset::render_in_memory(plan, &Mutex::new(renderer), of_frames, *concurrency, stop, |frame| {
        pipeline.add(frame.times, frame.redraws, &frame.cost);
        Ok(())
    })?;
    pipeline.end(setup)
}

fn dataset(setup: &Setup, folder: &Path, renderer: &mut Renderer) -> Result<Measured> {
    let mut pipeline = Pipeline::start(setup, renderer);
    let mut files = disk::FileWriter::new(folder, "bench");
    let indices = 0..WARM_UP + setup.frames;
    dataset::render_frames(&setup.plan, renderer, indices, setup.concurrency, &setup.stop, |frame| {
        files.write_all(&frame.files.artifacts)?;
        if files.is_sync_due() {
            files.sync_folders()?;
        }
        pipeline.add(frame.times, frame.redraws, &frame.cost);
        Ok(())
    })?;
    pipeline.end(setup)
}

/// Peak resident memory of this process, bytes; `None` where the system does not report it.
#[must_use]
pub fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(1024 * line.split_whitespace().nth(1)?.parse::<u64>().ok()?)
}

/// The settings that a sweep can vary, in the order of the help.
pub const SWEEPS: [&str; 5] = ["size", "samples", "rocks", "threads", "frames-in-flight"];

/// The setups of a sweep: the setting with its unit, and each of its values with the setup for it.
///
/// # Errors
/// Those of the settings.
pub fn sweep(name: &str, setup: &Setup) -> Result<(&'static str, Vec<(f64, Setup)>)> {
    let mut setups = Vec::new();
    let mut with = |value: f64, change: &dyn Fn(&mut Setup) -> Result<()>| {
        let mut setup = setup.clone();
        change(&mut setup)?;
        setups.push((value, setup));
        Ok::<(), Error>(())
    };
    let axis = match name {
        "size" => {
            let [width, height] = setup.plan.settings.size;
            for side in [128, 256, 512, 768, 1024] {
                with(f64::from(side), &|setup| {
                    setup.plan.settings.size = [side, (side * height / width).max(1)];
                    Ok(())
                })?;
            }
            "width, pixels"
        }
        "samples" => {
            for samples in [1_u32, 4, 16] {
                with(f64::from(samples), &|setup| {
                    setup.plan.settings.samples_per_side = samples.isqrt();
                    Ok(())
                })?;
            }
            "samples per pixel"
        }
        "rocks" => {
            if setup.plan.config.stages() != [Stage::Nominal] {
                return Err(Error::Usage(
                    "--sweep rocks: only the stage nominal has a number of rocks (rocks.count)".to_owned(),
                ));
            }
            for count in [0, 50, 100, 200, 400, 800] {
                with(f64::from(count), &|setup| {
                    setup.plan.config.apply_set(&format!("rocks.count={count}"))
                })?;
            }
            "rocks"
        }
        "frames-in-flight" => {
            for frames in 1..=4_usize {
                with(frames as f64, &|setup| {
                    setup.concurrency.frames_in_flight = Some(frames);
                    Ok(())
                })?;
            }
            "frames in flight"
        }
        _ => {
            let cores = dataset::cores();
            for threads in (0..).map(|power| 1_usize << power).take_while(|threads| *threads <= 2 * cores) {
                with(threads as f64, &|setup| {
                    setup.concurrency.threads = Some(threads);
                    Ok(())
                })?;
            }
            "worker threads"
        }
    };
    Ok((axis, setups))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_of_the_host_is_limited_by_its_serial_threads_or_by_its_cores() {
        assert_eq!(Measured::default().host_frames_per_second(16), None);
        let measured = |device, worker, writer| Measured {
            host: Some(RoleTimes::new(device, worker, writer)),
            ..Measured::default()
        };
        for (times, cores, expected) in
            [((1.0, 30.0, 0.5), 16, 508.0), ((1.0, 30.0, 0.5), 64, 1000.0), ((1.0, 30.0, 4.0), 64, 250.0)]
        {
            let found = measured(times.0, times.1, times.2).host_frames_per_second(cores).expect("a model");
            assert!((found - expected).abs() < 1.0, "{found}, not {expected}");
        }
    }
}
