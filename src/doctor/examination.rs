//! The results of all workers, and the verdict over them.
//!
//! Must not know: processes, the form of the report.

use serde_json::{Map, Value, json};

use super::cases::{CASES, Case};
use super::compare::{Difference, EQUAL_DEPTH, Rule, Verdict, compare};
use super::findings::{Answers, Finding, findings};
use super::hardware::Hardware;
use super::planes::{Hashes, Planes};
use super::reference::{DEPTH_PRECISION, Reference, reference};
use super::worker::{Backend, Event, FrameResult, Job, Memory, Opened, PASSES};
use crate::error::Result;
use crate::gpu::survey::AdapterReport;
use crate::render::RasterMode;

/// The version of the form of `doctor.json`.
const FORMAT: u32 = 1;

/// A step that failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its name.
    pub step: String,
    /// The error.
    pub message: String,
}

/// What one worker reported.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its job.
    pub job: Job,
    /// The device, once it was open.
    pub opened: Option<Opened>,
    /// Why the adapter does not support the backend.
    pub unsupported: Option<String>,
    /// The frames, with their planes.
    pub frames: Vec<(FrameResult, Planes)>,
    /// Measurements by name.
    pub benches: Map<String, Value>,
    /// The steps that failed.
    pub failures: Vec<Failure>,
    /// The step that has begun and not ended.
    pub current: Option<String>,
    /// What it used; `None` if it did not get to its end.
    pub memory: Option<Memory>,
    /// How the process ended, if it did with a crash after its last result.
    pub crash_at_exit: Option<String>,
    /// What it and its driver wrote on standard error.
    pub messages: Vec<String>,
    /// Seconds from its start to its end.
    pub seconds: f64,
}

impl Run {
    /// A run that has reported nothing.
    #[must_use]
    pub fn new(job: Job) -> Self {
        Self {
            job,
            opened: None,
            unsupported: None,
            frames: Vec::new(),
            benches: Map::new(),
            failures: Vec::new(),
            current: None,
            memory: None,
            crash_at_exit: None,
            messages: Vec::new(),
            seconds: 0.0,
        }
    }

    /// Adds a failure, of the step that has begun.
    pub fn fail(&mut self, message: String) {
        let step = self.current.take().unwrap_or_else(|| "starting".to_owned());
        self.failures.push(Failure { step, message });
    }

    /// The planes of a case, and how it was rendered.
    #[must_use]
    pub fn frame(&self, case: &str, pass: usize) -> Option<&(FrameResult, Planes)> {
        self.frames.iter().find(|(frame, _)| frame.case == case && frame.pass == pass)
    }

    /// Name of the backend in reports: that of the job, or what `auto` meant.
    #[must_use]
    pub fn backend(&self) -> String {
        let is_named = matches!(self.job, Job::Render(backend) if backend != Backend::AUTO);
        let opened = self.opened.as_ref().filter(|_| !is_named);
        opened.map_or_else(|| self.job.name(), |opened| opened.raster.clone())
    }
}

/// Checks that say nothing of labels: of colour, of a second rendering, and whether there is a frame at all.
const OF_NO_LABEL: [&str; 3] = ["colour", "repeat", "frame"];

/// A check of a case on a backend.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Name of the case.
    pub case: &'static str,
    /// Name of the backend.
    pub backend: String,
    /// What it was compared with, in words.
    pub against: &'static str,
    /// The difference, or what is missing.
    pub difference: Difference,
}

/// All that is known about a machine.
#[derive(Clone, Debug)]
pub struct Examination {
    /// The machine.
    pub hardware: Hardware,
    /// Every adapter, best first.
    pub adapters: Vec<AdapterReport>,
    /// What each worker reported, in order.
    pub runs: Vec<Run>,
}

impl Examination {
    /// An examination that has only looked at the machine.
    #[must_use]
    pub const fn new(hardware: Hardware) -> Self {
        Self { hardware, adapters: Vec::new(), runs: Vec::new() }
    }

    /// Adds an event to the last run. `planes` reads the planes of a frame from its file.
    pub fn record(&mut self, event: Event, planes: impl FnOnce(&FrameResult, &Case) -> Result<Planes>) {
        let Some(run) = self.runs.last_mut() else { return };
        match event {
            Event::Adapters { adapters } => {
                self.adapters = adapters;
                run.current = None;
            }
            Event::Opened(opened) => {
                run.current = None;
                run.opened = Some(opened);
            }
            Event::Unsupported { reason } => {
                run.current = None;
                run.unsupported = Some(reason);
            }
            Event::Begins { step } => run.current = Some(step),
            Event::Frame(frame) => {
                let case = CASES.iter().find(|case| case.name == frame.case);
                match case.map(|case| planes(&frame, case)) {
                    Some(Ok(planes)) => run.frames.push((frame, planes)),
                    Some(Err(error)) => run.fail(error.to_string()),
                    None => run.fail(format!("there is no case `{}`", frame.case)),
                }
                run.current = None;
            }
            Event::Failed { step, message } => {
                run.current = None;
                run.failures.push(Failure { step, message });
            }
            Event::Bench { name, result } => {
                run.current = None;
                run.benches.insert(name, result);
            }
            Event::Done(memory) => run.memory = Some(memory),
            // It says nothing about the machine's GPUs.
            Event::NoThreads { .. } => {}
        }
    }

    /// Whether a job would render what another has rendered.
    #[must_use]
    pub fn is_redundant(&self, job: Job) -> bool {
        let opened = || self.runs.iter().filter_map(|run| run.opened.as_ref());
        job == Job::Render(Backend::AUTO)
            && opened().all(|auto| opened().any(|done| done.raster == auto.auto_raster))
    }

    /// The runs that rendered cases, or should have.
    pub fn render_runs(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| matches!(run.job, Job::Render(_)) && run.unsupported.is_none())
    }

    /// The host rasteriser's frame of a case, where it has one with the right labels.
    fn host_frame(&self, case: &Case, shipped: &Reference) -> Option<&Planes> {
        let host = self.render_runs().find(|run| run.job == Job::Render(Backend::HOST))?;
        let (_, planes) = host.frame(case.name, 0)?;
        let (found, expected) = (planes.hashes(), &shipped.hashes.planes);
        let is_right = found.mask == expected.mask && found.instances == expected.instances;
        is_right.then_some(planes)
    }

    /// Everything that was compared.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let mut checks = Vec::new();
        for case in &CASES {
            for run in self.render_runs() {
                checks.extend(self.check_case(case, run));
            }
        }
        checks
    }

    fn check_case(&self, case: &Case, run: &Run) -> Vec<Check> {
        let check =
            |against, difference| Check { case: case.name, backend: run.backend(), against, difference };
        let missing = |text: &str| wrong("frame", text.to_owned());
        let (Some((frame, planes)), Some((_, again))) = (run.frame(case.name, 0), run.frame(case.name, 1))
        else {
            return vec![check("", missing("it was not rendered twice"))];
        };
        let shipped = match reference(case.name) {
            Ok(shipped) => shipped,
            Err(error) => return vec![check("the reference", missing(&error.to_string()))],
        };
        let mut checks = vec![check("the second rendering", repeated(planes, again))];
        if frame.geometry != shipped.hashes.geometry {
            let text = format!("geometry {} instead of {}", frame.geometry, shipped.hashes.geometry);
            checks.push(check("the reference", wrong("geometry", text)));
        }
        let is_host = run.job == Job::Render(Backend::HOST);
        // Compute passes leave no rounding of positions to the device.
        let is_computed = matches!(run.job, Job::Render(Backend { raster: RasterMode::Compute, .. }));
        match self.host_frame(case, &shipped).filter(|_| !is_host) {
            Some(host) => {
                let rule = Rule { exact_labels: is_computed, equal_depth: EQUAL_DEPTH };
                checks.extend(
                    compare(planes, host, rule).map(|difference| check("the host rasteriser", difference)),
                );
            }
            None => {
                let rule = Rule { exact_labels: is_host || is_computed, equal_depth: DEPTH_PRECISION };
                let differences = compare(planes, &shipped.planes, rule);
                checks.extend(differences.map(|difference| check("the reference", difference)));
            }
        }
        if is_host || is_computed {
            checks
                .extend(label_hashes(planes, &shipped).map(|difference| check("the reference", difference)));
        }
        if is_computed {
            let expected = &shipped.hashes.computed_depth;
            let depth = hash("depth hash", planes.hashes().depth, expected, Verdict::Deviates);
            checks.push(check("the reference", depth));
        }
        checks
    }

    /// Hashes of the frames of a run, by case.
    #[must_use]
    pub fn hashes(run: &Run) -> Vec<(&'static str, Hashes)> {
        let hashes = |case: &Case| Some((case.name, run.frame(case.name, 0)?.1.hashes()));
        CASES.iter().filter_map(hashes).collect()
    }

    /// What the hardware and the adapters say together.
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        let listing = self.runs.iter().find(|run| run.job == Job::Adapters);
        let failure = listing.and_then(|run| run.failures.first()).map(|failure| failure.message.as_str());
        let crash_at_exit = self.runs.iter().find_map(|run| run.crash_at_exit.as_deref());
        findings(&self.hardware, &Answers { adapters: &self.adapters, failure, crash_at_exit })
    }

    /// Whether no driver gets far enough to open an adapter: the adapters could not be listed, and the render job after that failed too.
    #[must_use]
    pub fn is_hopeless(&self) -> bool {
        self.adapters.is_empty()
            && self.runs.len() > 1
            && self.runs.iter().all(|run| run.opened.is_none() && !run.failures.is_empty())
    }

    /// Whether every backend that the adapter supports renders every case, with the labels, depth and colour that it should have.
    #[must_use]
    pub fn is_right(&self) -> bool {
        let backends = self.render_runs().count();
        let has_failed = self.render_runs().any(|run| !run.failures.is_empty());
        backends > 0
            && !has_failed
            && self.checks().iter().all(|check| check.difference.verdict != Verdict::Wrong)
    }

    /// Whether labels and depth are `right` or `wrong`; `unchecked` if some were not rendered and the others are right.
    #[must_use]
    pub fn labels(&self) -> &'static str {
        let checks = self.checks();
        let is_wrong = |check: &Check| {
            check.difference.verdict == Verdict::Wrong && !OF_NO_LABEL.contains(&check.difference.plane)
        };
        if checks.iter().any(is_wrong) {
            "wrong"
        } else if checks.is_empty() || self.render_runs().any(|run| !run.failures.is_empty()) {
            "unchecked"
        } else {
            "right"
        }
    }

    /// The backends without a failure or a wrong check.
    #[must_use]
    pub fn right_backends(&self) -> Vec<String> {
        let checks = self.checks();
        let is_right = |run: &&Run| {
            let backend = run.backend();
            let mut own = checks.iter().filter(|check| check.backend == backend);
            run.failures.is_empty() && own.all(|check| check.difference.verdict != Verdict::Wrong)
        };
        self.render_runs().filter(is_right).map(Run::backend).collect()
    }

    /// The report for programs.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let checks = self.checks();
        let rows: Vec<Value> = checks
            .iter()
            .map(|check| {
                json!({
                    "case": check.case, "backend": check.backend, "against": check.against,
                    "plane": check.difference.plane, "verdict": check.difference.verdict.name(),
                    "figures": check.difference.figures, "text": check.difference.text,
                })
            })
            .collect();
        let count = |verdict| checks.iter().filter(|check| check.difference.verdict == verdict).count();
        json!({
            "format": FORMAT,
            "version": env!("CARGO_PKG_VERSION"),
            "verdict": {
                "labels": self.labels(),
                "right_backends": self.right_backends(),
                "checks": checks.len(),
                "wrong": count(Verdict::Wrong),
                "deviating": count(Verdict::Deviates),
                "failures": self.runs.iter().map(|run| run.failures.len()).sum::<usize>(),
            },
            "findings": self.findings().iter().map(Finding::to_json).collect::<Vec<_>>(),
            "machine": self.hardware.to_json(),
            "adapters": self.adapters,
            "checks": rows,
            "runs": self.runs.iter().map(run_json).collect::<Vec<_>>(),
        })
    }
}

fn run_json(run: &Run) -> Value {
    let frames: Vec<Value> = run
        .frames
        .iter()
        .map(|(frame, planes)| {
            json!({
                "case": frame.case, "pass": frame.pass, "geometry": frame.geometry, "hashes": planes.hashes(),
                "host_ms": frame.host_ms, "stage_ms": frame.stage_ms,
            })
        })
        .collect();
    let failures: Vec<Value> = run
        .failures
        .iter()
        .map(|failure| json!({ "step": failure.step, "message": failure.message }))
        .collect();
    json!({
        "job": run.job.name(), "backend": run.backend(), "device": run.opened, "unsupported": run.unsupported,
        "seconds": run.seconds, "frames": frames, "bench": run.benches, "failures": failures,
        "memory": run.memory, "crash_at_exit": run.crash_at_exit, "messages": run.messages,
    })
}

fn wrong(plane: &'static str, text: String) -> Difference {
    Difference { plane, verdict: Verdict::Wrong, text, figures: Value::Null }
}

/// Whether both renderings have the same bytes.
fn repeated(first: &Planes, second: &Planes) -> Difference {
    let (a, b) = (first.to_bytes(), second.to_bytes());
    let differ = a.iter().zip(&b).filter(|(a, b)| a != b).count() + a.len().abs_diff(b.len());
    Difference {
        plane: "repeat",
        verdict: if differ == 0 { Verdict::Right } else { Verdict::Wrong },
        text: format!("{differ} of {} bytes differ (allowed 0) in {PASSES} renderings", a.len()),
        figures: json!({ "bytes": a.len(), "differ": differ, "allowed": 0 }),
    }
}

/// Whether masks and ids have the shipped hashes.
fn label_hashes(planes: &Planes, shipped: &Reference) -> [Difference; 2] {
    let (found, expected) = (planes.hashes(), &shipped.hashes.planes);
    [("mask hash", found.mask, &expected.mask), ("instances hash", found.instances, &expected.instances)]
        .map(|(plane, found, expected)| hash(plane, found, expected, Verdict::Wrong))
}

/// Whether a hash is the expected one, else this verdict.
fn hash(plane: &'static str, found: String, expected: &str, otherwise: Verdict) -> Difference {
    let is_same = found == expected;
    Difference {
        plane,
        verdict: if is_same { Verdict::Right } else { otherwise },
        text: if is_same { found.clone() } else { format!("{found} instead of {expected}") },
        figures: json!({ "found": found, "expected": expected }),
    }
}
