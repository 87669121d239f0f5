//! Frame throughput, case by case, with the time of each stage.
//!
//! A frame is timed from the end of the frame before it until it is read back; the median is reported. Before the first and after the last
//! of them others are on the way, so that as much is begun as is finished in the time that is measured.
//! Stages of several frames overlap, so their times need not add up to that of a frame. The time of the host is that of the program's
//! own threads on a processor, without the threads of the driver; that of the process has them all. In the cases of a dataset the
//! time of redrawn attempts is that of the frames that come of them.
//! Must not know: the command line.
//! To add a case: a variant of [`Case`] with its arm in [`run`].

mod curve;
mod measured;
mod moving;
mod pipeline;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crate::dataset;
use crate::dataset::attempt::{build_scene, scene_of_seed};
use crate::dataset::plan::{Plan, Seeds, frame_seed};
use crate::error::{Error, Result};
use crate::host_time::{self, Role};
use crate::params::Stage;
use crate::render::{Renderer, StageTimes};
use crate::scene::Scene;
pub use curve::Curve;
pub use measured::{Measured, Setup, peak_rss_bytes, quantile};
use measured::{Start, WARM_UP, stopped};
use moving::Moving;

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
            let scenes = |_: &Plan, frame, _| Ok(moving.scene_of_frame(frame));
            pipeline::in_memory(&Setup { plan, ..setup.clone() }, renderer, scenes)
        }
        Case::Scene => scenes(setup, renderer),
        Case::Frames => pipeline::in_memory(setup, renderer, scene_of_seed),
        Case::Dataset => pipeline::dataset(setup, folder, renderer),
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
        if queue.len() < frames_in_flight {
            let (scene, times) = next(submitted)?;
            let in_flight = renderer.submit(&scene, &plan.settings)?;
            queue.push_back((scene, times, in_flight));
            submitted += 1;
        } else if let Some((scene, mut times, in_flight)) = queue.pop_front() {
            measured.triangles.push(in_flight.cost.drawn_triangles as f64);
            measured.upload_bytes.push(in_flight.cost.uploaded_bytes as f64);
            measured.readback_bytes = in_flight.cost.readback_bytes;
            let (_, render_times) = renderer.finish(in_flight, &scene)?;
            times.extend(render_times);
            measured.frames_ms.push(last.elapsed().as_secs_f64() * 1e3);
            measured.stages.push(times);
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
    // Those that were on the way at the end.
    for (scene, _, in_flight) in queue {
        renderer.finish(in_flight, &scene)?;
    }
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
            let [width, height] = setup.plan.settings.size.map(u64::from);
            for side in [128, 256, 512, 768, 1024] {
                let scaled = (u64::from(side) * height / width).max(1);
                with(f64::from(side), &|setup| {
                    setup.plan.settings.size = [side, u32::try_from(scaled).unwrap_or(u32::MAX)];
                    Plan::check_size(setup.plan.settings.size)
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
