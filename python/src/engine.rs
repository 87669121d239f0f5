//! Settings, the renderer on its device, and streams of frames.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::Poll;
use std::time::Duration;

use pyo3::prelude::*;
use regolith::dataset::attempt::build_scene;
use regolith::dataset::frame_stream::render_scene;
use regolith::dataset::plan::{MAX_FRAMES, Plan, Seeds};
use regolith::dataset::rules::Rules;
use regolith::dataset::{Concurrency, FrameStream, cores};
use regolith::error::nearest;
use regolith::gpu::Gpu;
use regolith::gpu::adapter;
use regolith::output;
use regolith::output::edges::EdgePolicy;
use regolith::params::config::Config;
use regolith::render::{RasterMode, RenderSettings, Renderer};

use crate::convert::{self, PyFrame};
use crate::ending::{self, Stream};
use crate::errors::{DeviceError, raised, refused};
use crate::scene::Scene;

/// Where a setting of a call comes from, in messages.
const SET: &str = "set";
/// The same of a call that follows: it wins over the first.
const SET_OF_CALL: &str = "set of this call";
/// How long a wait for a frame goes on before Python may handle signals: Ctrl-C ends it.
const SIGNALS_EVERY: Duration = Duration::from_millis(50);

/// The text of a file of knobs.
#[pyfunction]
pub(crate) fn config_text(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    raised(py, Config::read_file(&path))
}

/// Everything that decides what frames are, checked. Opens no device.
#[pyclass(frozen)]
pub(crate) struct Settings {
    plan: Plan,
    raster: RasterMode,
}

#[allow(clippy::too_many_arguments, reason = "they are keywords in Python")]
#[pymethods]
impl Settings {
    #[new]
    fn new(
        py: Python<'_>,
        stage: Option<&str>,
        presets: Vec<String>,
        config: Option<(String, String)>,
        set: &str,
        size: [u32; 2],
        outputs: &str,
        samples: u32,
        edges: &str,
        raster: &str,
    ) -> PyResult<Self> {
        let raster = raster.parse().map_err(|_: String| {
            let names = RasterMode::names();
            refused(py, "raster", raster, &names.join(", "), nearest(raster, names))
        })?;
        let edges = edges.parse().map_err(|_: regolith::Error| {
            let allowed = format!("hard, and ignore:N with N from 1 to {} pixels", EdgePolicy::MAX_BAND_PX);
            refused(py, "edges", edges, &allowed, nearest(edges, ["hard"]))
        })?;
        let plan = || -> regolith::Result<Plan> {
            let knobs = Config::layered(stage, presets.iter().map(String::as_str), |knobs| {
                if let Some((text, path)) = &config {
                    knobs.apply_toml(text, path)?;
                }
                knobs.apply_toml(set, SET)
            })?;
            let rules = Rules::from_config(&knobs)?;
            let image = RenderSettings::new(size, samples)?;
            let outputs = output::parse_outputs(outputs)?;
            Ok(Plan { edges, ..Plan::in_memory(knobs, rules, 0, image, outputs) })
        };
        Ok(Self { plan: raised(py, plan())?, raster })
    }

    /// Names of the arrays of a frame, with channels and NumPy type of each.
    fn arrays(&self) -> Vec<(&'static str, usize, &'static str)> {
        output::arrays::described(&self.plan.outputs)
    }
}

impl Settings {
    /// The plan with further knobs, as TOML.
    fn with(&self, py: Python<'_>, set: &str) -> PyResult<Plan> {
        let mut plan = self.plan.clone();
        if !set.is_empty() {
            raised(py, plan.config.apply_toml(set, SET_OF_CALL).and_then(|()| plan.config.check()))?;
        }
        Ok(plan)
    }
}

/// A renderer with its device and threads. It belongs to the process that opened it.
#[pyclass(frozen)]
pub(crate) struct Engine {
    open: Option<Open>,
    process: u32,
    threads: Option<usize>,
    adapter: String,
}

struct Open {
    renderer: Arc<Mutex<Renderer>>,
    /// The parallel loops of frames run here: the common pool of a process has no threads in its forked children. One call works on it at
    /// a time: a thread of the pool that waits for a part of a loop takes up other work meanwhile, and would wait for itself if that
    /// needed the renderer, too.
    pool: Mutex<rayon::ThreadPool>,
}

#[pymethods]
impl Engine {
    #[new]
    fn new(
        py: Python<'_>,
        settings: &Settings,
        adapter: Option<String>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let raster = settings.raster;
        let _working = ending::working(py);
        let open = py.detach(|| -> regolith::Result<(Open, String)> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or_else(cores)).build();
            let pool = pool.map_err(|error| regolith::Error::Thread(std::io::Error::other(error)))?;
            let (renderer, name) = pool.install(|| {
                let gpu = Gpu::open(adapter.as_deref())?;
                let name = adapter::describe(&gpu.info);
                Ok::<_, regolith::Error>((Renderer::with_raster(gpu, raster)?, name))
            })?;
            Ok((Open { renderer: Arc::new(Mutex::new(renderer)), pool: Mutex::new(pool) }, name))
        });
        let (open, adapter) = raised(py, open)?;
        Ok(Self { open: Some(open), process: std::process::id(), threads, adapter })
    }

    /// The adapter, in one line.
    #[getter]
    fn adapter(&self) -> &str {
        &self.adapter
    }

    /// The frame of a seed.
    fn render<'py>(
        &self,
        py: Python<'py>,
        settings: &Settings,
        seed: u64,
        set: &str,
    ) -> PyResult<PyFrame<'py>> {
        let plan = Plan { seeds: Seeds::Given, ..settings.with(py, set)? };
        let frame = self.on_pool(py, |renderer| render_scene(&plan, renderer, build_scene(&plan, seed)?));
        convert::frame(py, frame?)
    }

    /// The scene of a seed.
    fn scene(&self, py: Python<'_>, settings: &Settings, seed: u64, set: &str) -> PyResult<Scene> {
        let plan = Plan { seeds: Seeds::Given, ..settings.with(py, set)? };
        let built = self.on_pool(py, |_| build_scene(&plan, seed))?;
        Ok(Scene::new(plan, built))
    }

    /// The frames of these seeds.
    fn frames_of_seeds(
        &self,
        py: Python<'_>,
        settings: &Settings,
        seeds: Vec<u64>,
        prefetch: usize,
    ) -> PyResult<Frames> {
        let plan = Plan { seeds: Seeds::Given, ..settings.plan.clone() };
        self.stream(py, |renderer, concurrency| {
            FrameStream::start(plan, renderer, seeds.into_iter(), concurrency, prefetch)
        })
    }

    /// Frames of a dataset below `end`, without end if it is `None`: `run` in a row from `first`, `first + step`, ..., without the first
    /// `skip` of them all.
    fn frames_of_dataset(
        &self,
        py: Python<'_>,
        settings: &Settings,
        base_seed: u64,
        indices: (u64, u64, Option<u64>),
        runs: (u64, usize),
        prefetch: usize,
    ) -> PyResult<Frames> {
        let ((first, step, end), (run, skip)) = (indices, runs);
        let plan = Plan { base_seed, ..settings.plan.clone() };
        let end = end.unwrap_or(MAX_FRAMES);
        let starts = (first..end).step_by(usize::try_from(step.max(1))?);
        let indices = starts.flat_map(move |start| start..start.saturating_add(run).min(end)).skip(skip);
        self.stream(py, |renderer, concurrency| {
            FrameStream::start(plan, renderer, indices, concurrency, prefetch)
        })
    }
}

impl Engine {
    /// What is open, if this is the process that opened it.
    fn open(&self) -> PyResult<&Open> {
        self.open.as_ref().filter(|_| self.process == std::process::id()).ok_or_else(|| {
            DeviceError::new_err(
                "this renderer belongs to the process that this one was forked from; open another one here",
            )
        })
    }

    /// Runs `work` on the threads of the renderer, without Python's lock, after what other calls run there.
    pub(crate) fn on_pool<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Mutex<Renderer>) -> regolith::Result<T> + Send,
    ) -> PyResult<T> {
        let open = self.open()?;
        let _working = ending::working(py);
        let pool = || open.pool.lock().unwrap_or_else(PoisonError::into_inner);
        raised(py, py.detach(|| pool().install(|| work(&open.renderer))))
    }

    /// The frames of a stream that `start` starts.
    pub(crate) fn stream(
        &self,
        py: Python<'_>,
        start: impl FnOnce(Arc<Mutex<Renderer>>, Concurrency) -> regolith::Result<FrameStream>,
    ) -> PyResult<Frames> {
        let renderer = Arc::clone(&self.open()?.renderer);
        let concurrency = Concurrency { threads: self.threads, frames_in_flight: None };
        let _working = ending::working(py);
        let stream = raised(py, start(renderer, concurrency))?;
        Ok(Frames { stream: ending::shared(py, stream), process: std::process::id() })
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        if self.process != std::process::id() {
            // The device and the threads are those of another process.
            std::mem::forget(self.open.take());
        }
    }
}

/// Frames in order, rendered ahead.
#[pyclass(frozen)]
pub(crate) struct Frames {
    stream: Arc<Stream>,
    process: u32,
}

#[pymethods]
impl Frames {
    /// The next frame; `None` after the last one.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<PyFrame<'py>>> {
        if self.process != std::process::id() {
            return Err(DeviceError::new_err(
                "these frames are rendered by the process that this one was forked from; ask for them here again",
            ));
        }
        loop {
            let next = py.detach(|| {
                let mut stream = ending::open(&self.stream);
                stream.as_mut().map_or(Poll::Ready(None), |stream| stream.next_within(SIGNALS_EVERY))
            });
            match next {
                Poll::Ready(next) => {
                    return next.map(|frame| convert::frame(py, raised(py, frame)?)).transpose();
                }
                Poll::Pending => py.check_signals()?,
            }
        }
    }

    /// Stops rendering.
    fn close(&self, py: Python<'_>) {
        if self.process == std::process::id() {
            py.detach(|| ending::close(&self.stream));
        }
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        if self.process == std::process::id() {
            // Its threads need no lock of Python's.
            Python::attach(|py| py.detach(|| ending::close(&self.stream)));
        } else {
            // Never dropped: its threads are those of another process, which may have locked it.
            std::mem::forget(Arc::clone(&self.stream));
        }
    }
}
