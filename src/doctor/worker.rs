//! What a worker process does: it lists the adapters, renders the cases with one backend, or measures frame times, and reports
//! each result as it is found, so that a driver that ends the process takes no earlier result with it.
//!
//! Must not know: processes, how events are transported.

use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::cases::{CASES, Case};
use super::planes::Planes;
use crate::bench::{self, Setup, peak_rss_bytes};
use crate::dataset::Concurrency;
use crate::dataset::plan::Plan;
use crate::dataset::rules::Rules;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::gpu::survey::{AdapterReport, survey};
use crate::output::{self, Artifact, disk};
use crate::params::config::Config;
use crate::render::{LightingMode, RasterMode, RasterOptions, RenderSettings, Renderer};

/// Times that each case is rendered.
pub const PASSES: usize = 2;
/// Frames of each measurement.
const BENCH_FRAMES: u64 = 6;
/// Size of measured frames, pixels.
const BENCH_SIZE: [u32; 2] = [256, 256];
/// Stages and what changes from frame to frame: the measurements.
const BENCHES: [(&str, bench::Case); 6] = [
    ("nominal", bench::Case::Camera),
    ("nominal", bench::Case::StaticSun),
    ("nominal", bench::Case::Scene),
    ("nominal", bench::Case::Dataset),
    ("surface", bench::Case::Camera),
    ("surface", bench::Case::Scene),
];

/// A way to render: who rasterises, and how lighting is divided into draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backend {
    /// Who rasterises.
    pub raster: RasterMode,
    /// How lighting is divided; `None` for what the adapter is best at.
    pub lighting: Option<LightingMode>,
}

impl Backend {
    /// What `--raster auto` means on the adapter.
    pub const AUTO: Self = Self { raster: RasterMode::Auto, lighting: None };
    /// The host, which has one lighting only.
    pub const HOST: Self = Self { raster: RasterMode::Host, lighting: None };
    /// The device in render passes, as GPUs without Vulkan run it.
    pub const ONE_DRAW: Self = Self { raster: RasterMode::Device, lighting: Some(LightingMode::OneDraw) };
    /// The device in compute passes, lit by a draw, as GPUs with Vulkan run it.
    pub const COMPUTE: Self = Self { raster: RasterMode::Compute, lighting: Some(LightingMode::OneDraw) };
    /// The same, lit in a compute pass, as NVIDIA's Hopper runs it.
    pub const COMPUTE_LIT: Self = Self { raster: RasterMode::Compute, lighting: Some(LightingMode::Compute) };
    /// The device in render passes, as software adapters run it.
    pub const BINS: Self = Self { raster: RasterMode::Device, lighting: Some(LightingMode::Bins) };
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.lighting {
            Some(lighting) => write!(f, "{}-{}", self.raster, lighting.name()),
            None => self.raster.fmt(f),
        }
    }
}

/// What a worker is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Job {
    /// List the adapters.
    Adapters,
    /// Render every case, each twice.
    Render(Backend),
    /// Measure frame times.
    Bench,
}

impl Job {
    /// Every job, in order.
    pub const ALL: [Self; 8] = [
        Self::Adapters,
        Self::Render(Backend::HOST),
        Self::Render(Backend::BINS),
        Self::Render(Backend::ONE_DRAW),
        Self::Render(Backend::COMPUTE),
        Self::Render(Backend::COMPUTE_LIT),
        Self::Render(Backend::AUTO),
        Self::Bench,
    ];

    /// Its name on the command line and in reports.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Adapters => "adapters".to_owned(),
            Self::Render(backend) => backend.to_string(),
            Self::Bench => "bench".to_owned(),
        }
    }

    /// Number of results that it reports if nothing fails.
    #[must_use]
    pub const fn steps(self) -> u64 {
        match self {
            Self::Adapters => 1,
            Self::Render(_) => (CASES.len() * PASSES) as u64,
            Self::Bench => BENCHES.len() as u64,
        }
    }
}

impl FromStr for Job {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let found = Self::ALL.into_iter().find(|job| job.name() == text);
        found.ok_or_else(|| format!("the jobs are {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// A result of a worker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// Every adapter, best first.
    Adapters {
        /// The adapters.
        adapters: Vec<AdapterReport>,
    },
    /// The adapter is open.
    Opened(Opened),
    /// The backend cannot be used on this adapter, which is no fault.
    Unsupported {
        /// Why.
        reason: String,
    },
    /// A step begins.
    Begins {
        /// Its name.
        step: String,
    },
    /// A frame was rendered.
    Frame(FrameResult),
    /// A step failed; the next one follows.
    Failed {
        /// Its name.
        step: String,
        /// The error.
        message: String,
    },
    /// A measurement, as in `bench --json`.
    Bench {
        /// Stage and case.
        name: String,
        /// The figures.
        result: Value,
    },
    /// The system starts no threads for it.
    NoThreads {
        /// The error of the operating system.
        cause: String,
    },
    /// All steps are done.
    Done(Memory),
}

/// A device, as it was opened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Opened {
    /// Name, kind, API and driver of its adapter.
    pub adapter: String,
    /// Whether it rasterises on the CPU.
    pub is_software: bool,
    /// Who rasterises: `device`, `host` or `mixed`.
    pub raster: String,
    /// How lighting is divided into draws: `bins`, `one-draw` or `compute`.
    pub lighting: String,
    /// Who would rasterise without `--raster`.
    pub auto_raster: String,
    /// Optional capabilities, by name.
    pub capabilities: Map<String, Value>,
}

/// A frame whose planes lie in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameResult {
    /// Name of the case.
    pub case: String,
    /// 0, then 1.
    pub pass: usize,
    /// Name of the file with [`Planes::to_bytes`], in the folder of the job.
    pub file: String,
    /// Hash of the scene's geometry.
    pub geometry: String,
    /// Milliseconds until the frame was in memory, as the host saw it.
    pub host_ms: f64,
    /// Milliseconds of work by stage.
    pub stage_ms: Map<String, Value>,
}

/// What a worker used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Memory {
    /// Peak resident memory of the process, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Memory of the device that is in use, bytes.
    pub device_used_bytes: Option<u64>,
    /// Memory of the device that is allocated, bytes.
    pub device_reserved_bytes: Option<u64>,
}

/// Is called with every frame before it is reported; tests damage frames and devices with it.
pub type Tamper<'a> = &'a mut dyn FnMut(&Renderer, &mut Frame);

/// A worker.
pub struct Worker<'a> {
    /// Text of `--adapter`.
    pub adapter: Option<&'a str>,
    /// Folder for the planes of frames, and for what the measurements write.
    pub folder: &'a Path,
    /// Where results go.
    pub emit: &'a mut dyn FnMut(Event),
    /// See [`Tamper`].
    pub tamper: Tamper<'a>,
}

impl fmt::Debug for Worker<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Worker").field("adapter", &self.adapter).finish_non_exhaustive()
    }
}

impl Worker<'_> {
    /// Does a job. Errors are reported like results.
    pub fn run(&mut self, job: Job) {
        let memory = match job {
            Job::Adapters => self.adapters(),
            Job::Render(backend) => self.render(backend),
            Job::Bench => self.bench(),
        };
        (self.emit)(Event::Done(memory));
    }

    fn begin(&mut self, step: &str) {
        (self.emit)(Event::Begins { step: step.to_owned() });
    }

    fn fail(&mut self, step: &str, error: &Error) {
        (self.emit)(Event::Failed { step: step.to_owned(), message: error.to_string() });
    }

    fn adapters(&mut self) -> Memory {
        self.begin("adapters");
        match survey() {
            Ok(adapters) => (self.emit)(Event::Adapters { adapters }),
            Err(error) => self.fail("adapters", &error),
        }
        Memory::default()
    }

    /// A renderer on a fresh device, without pipelines of earlier runs, which could be at fault.
    fn open(&mut self, backend: Backend) -> Option<Renderer> {
        self.begin("opening the adapter");
        let gpu = Gpu::open(self.adapter).map_err(|error| self.fail("opening the adapter", &error)).ok()?;
        let adapter = crate::gpu::adapter::describe(&gpu.info);
        let capabilities = gpu.capabilities;
        let has = |feature| gpu.device.features().contains(feature);
        let timestamps = has(wgpu::Features::TIMESTAMP_QUERY);
        let by_name = [
            ("stencil_upload", capabilities.stencil_upload),
            ("depth_stencil", capabilities.depth_stencil),
            ("multi_draw", capabilities.multi_draw),
            ("timestamps", timestamps),
            ("pipeline_cache", gpu.pipeline_cache().is_some()),
        ];
        match renderer(gpu, backend) {
            Ok(renderer) => {
                (self.emit)(Event::Opened(Opened {
                    adapter,
                    is_software: capabilities.software_adapter,
                    raster: renderer.raster().name().to_owned(),
                    lighting: renderer.raster().lighting.name().to_owned(),
                    auto_raster: auto_raster(&renderer),
                    capabilities: by_name
                        .map(|(name, has)| (name.to_owned(), has.into()))
                        .into_iter()
                        .collect(),
                }));
                Some(renderer)
            }
            Err(Error::Usage(reason)) => {
                (self.emit)(Event::Unsupported { reason });
                None
            }
            Err(error) => {
                self.fail("creating the renderer", &error);
                None
            }
        }
    }

    /// Renders all cases, then all again in the opposite order, so that what one frame leaves behind would show in another.
    fn render(&mut self, backend: Backend) -> Memory {
        let Some(mut renderer) = self.open(backend) else { return Memory::default() };
        let order = CASES.iter().map(|case| (0, case)).chain(CASES.iter().rev().map(|case| (1, case)));
        for (pass, case) in order {
            let step = format!("{} ({})", case.name, pass + 1);
            self.begin(&step);
            match self.frame(&mut renderer, backend, case, pass) {
                Ok(frame) => (self.emit)(Event::Frame(frame)),
                Err(error) => {
                    self.fail(&step, &error);
                    // A lost device takes no other frame with it.
                    match self.open(backend) {
                        Some(fresh) => renderer = fresh,
                        None => return memory(&renderer),
                    }
                }
            }
        }
        memory(&renderer)
    }

    fn frame(
        &mut self,
        renderer: &mut Renderer,
        backend: Backend,
        case: &Case,
        pass: usize,
    ) -> Result<FrameResult> {
        let scene = case.scene()?;
        let start = Instant::now();
        let (mut frame, times) = renderer.render(&scene, &case.settings()?)?;
        let host_ms = start.elapsed().as_secs_f64() * 1e3;
        (self.tamper)(renderer, &mut frame);
        let name = format!("{backend}_{}_{pass}.planes", case.name);
        let bytes = Planes::from(frame).to_bytes();
        disk::write_all(self.folder, &[Artifact { name: name.clone(), bytes }])?;
        Ok(FrameResult {
            case: case.name.to_owned(),
            pass,
            file: name,
            geometry: scene.geometry_hash(),
            host_ms,
            stage_ms: times.into_iter().map(|(stage, ms)| (stage.to_owned(), ms.into())).collect(),
        })
    }

    fn bench(&mut self) -> Memory {
        let Some(mut renderer) = self.open(Backend::AUTO) else { return Memory::default() };
        for (number, (stage, case)) in BENCHES.into_iter().enumerate() {
            let name = format!("{stage}, {}", case.name());
            self.begin(&name);
            let folder = self.folder.join(format!("bench_{number}"));
            let measured = bench_setup(stage).and_then(|setup| {
                disk::FileWriter::new(&folder, "bench").create_folder()?;
                bench::run(case, &setup, &folder, &mut renderer)
            });
            match measured {
                Ok(measured) => (self.emit)(Event::Bench { name, result: measured.to_json() }),
                Err(error) => {
                    self.fail(&name, &error);
                    match self.open(Backend::AUTO) {
                        Some(fresh) => renderer = fresh,
                        None => return memory(&renderer),
                    }
                }
            }
        }
        memory(&renderer)
    }
}

fn renderer(gpu: Gpu, backend: Backend) -> Result<Renderer> {
    let mut renderer = Renderer::with_raster(gpu, backend.raster)?;
    if let Some(lighting) = backend.lighting {
        renderer.set_raster(renderer.raster().with_lighting(lighting, renderer.gpu())?);
    }
    Ok(renderer)
}

/// Who rasterises without `--raster` on the device of a renderer.
fn auto_raster(renderer: &Renderer) -> String {
    let options = RasterOptions::new(RasterMode::Auto, renderer.gpu());
    options.map_or_else(|error| error.to_string(), |options| options.name().to_owned())
}

fn memory(renderer: &Renderer) -> Memory {
    let device = renderer.gpu().device.generate_allocator_report();
    Memory {
        peak_rss_bytes: peak_rss_bytes(),
        device_used_bytes: device.as_ref().map(|report| report.total_allocated_bytes),
        device_reserved_bytes: device.as_ref().map(|report| report.total_reserved_bytes),
    }
}

/// A short measurement with the defaults of `bench`.
fn bench_setup(stage: &str) -> Result<Setup> {
    let mut config = Config::new();
    config.set_stage(stage)?;
    let outputs = output::parse_outputs("rgb,mask")?;
    let settings = RenderSettings::new(BENCH_SIZE, 4)?;
    let rules = Rules::accepting_any_image();
    let plan = Plan::in_memory(config, rules, 42, settings, outputs);
    Ok(Setup {
        plan,
        concurrency: Concurrency::default(),
        frames: BENCH_FRAMES,
        stop: Arc::new(AtomicBool::new(false)),
    })
}
