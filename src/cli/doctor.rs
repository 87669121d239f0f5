//! `doctor`: whether frames rendered on this machine are right, and if not, why.
//!
//! Drivers can crash and hang. This process loads none; each step runs in another process of the same binary.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use crate::doctor::cases::Case;
use crate::doctor::examination::{Examination, Run};
use crate::doctor::hardware::{Hardware, Machine};
use crate::doctor::markdown;
use crate::doctor::planes::Planes;
use crate::doctor::worker::{Backend, Event, FrameResult, Job, Worker};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::gpu::adapter;
use crate::gpu::survey::AdapterReport;
use crate::input;
use crate::output::{Artifact, disk};
use crate::render::Renderer;
use clap::Args;
use serde_json::Value;
use signal_hook::consts::signal::SIGILL;
use signal_hook::low_level;

use super::args::adapter_text;
use super::child::{Ending, supervise};
use super::device::start_threads;
use super::messages::{Messages, print};
use super::process::stop_on_signals;
use super::progress::Meter;

/// Names of the reports.
const FILES: [&str; 2] = ["doctor.md", "doctor.json"];
/// Time without a result after which a process counts as hanging. A driver may compile for minutes.
const PATIENCE: Duration = Duration::from_secs(180);
/// Largest size of the planes of a frame, bytes.
const MAX_PLANES_BYTES: u64 = 16 * input::MIB;

#[derive(Args, Debug)]
pub(super) struct DoctorArgs {
    /// Adapter to examine: a part of its line in `regolith-render adapters`, such as its name or PCI address, or `cpu`
    #[arg(long, value_name = "TEXT", value_parser = adapter_text)]
    adapter: Option<String>,
    /// Folder for doctor.md and doctor.json, created if missing
    #[arg(long, value_name = "DIR", default_value = "doctor")]
    out: PathBuf,
    /// Write into a folder even if it has other content
    #[arg(long)]
    force: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    /// Do one step and print its results: what the processes are called with that doctor starts
    #[arg(long, value_name = "JOB", hide = true, requires = "work_folder")]
    work: Option<Job>,
    /// Folder in which a step leaves its frames
    #[arg(long, value_name = "DIR", hide = true)]
    work_folder: Option<PathBuf>,
}

impl DoctorArgs {
    /// Whether this is a process that another one examines.
    pub(super) const fn is_step(&self) -> bool {
        self.work.is_some()
    }
}

/// Examines the machine, in processes that `itself` starts: regolith-render again.
pub(super) fn run(args: &DoctorArgs, itself: &dyn Fn() -> Command, messages: Messages) -> Result<()> {
    if let (Some(job), Some(folder)) = (args.work, &args.work_folder) {
        return work(args, job, folder);
    }
    adapter::check_environment()?;
    disk::check_content(&args.out, args.force, |name| FILES.contains(&name))?;
    let folder = tempfile::tempdir().map_err(|cause| Error::Write { path: std::env::temp_dir(), cause })?;
    let stop = stop_on_signals(messages)?;
    let mut examiner = Examiner {
        args,
        itself,
        messages,
        folder: folder.path(),
        stop,
        meter: Meter::new(messages, "steps"),
        done: 0,
        wanted: Job::ALL.into_iter().filter(|job| *job != AUTO).map(Job::steps).sum(),
        examination: Examination::new(Hardware::probe(&Machine::here())),
        no_threads: None,
    };
    examiner.examine()?;
    examiner.meter.finish();
    report(args, messages, &examiner.examination)
}

/// Writes and prints the report; an error if something is wrong.
fn report(args: &DoctorArgs, messages: Messages, examination: &Examination) -> Result<()> {
    let json = format!("{:#}\n", examination.to_json());
    let contents = [markdown::report(examination), json.clone()];
    let artifacts: Vec<Artifact> = FILES
        .iter()
        .zip(contents)
        .map(|(name, content)| Artifact { name: (*name).to_owned(), bytes: content.into_bytes() })
        .collect();
    // What was found is printed even where it cannot be written.
    let written = disk::write_all(&args.out, &artifacts);
    print(&if args.json { json } else { markdown::summary(examination) })?;
    let paths: Vec<String> = written?.iter().map(|path| path.display().to_string()).collect();
    if !args.json {
        messages.paths(&format!("\n{}\n", paths.join("\n")))?;
    }
    let report = paths.first().map_or("", String::as_str);
    if examination.is_right() {
        Ok(())
    } else {
        Err(Error::CheckFailed(format!("not everything is right on this machine; {report} has the details")))
    }
}

/// The job that most often repeats another, and is then left out.
const AUTO: Job = Job::Render(Backend::AUTO);

/// An examination in progress.
struct Examiner<'a> {
    args: &'a DoctorArgs,
    itself: &'a dyn Fn() -> Command,
    messages: Messages,
    folder: &'a Path,
    stop: Arc<AtomicBool>,
    meter: Meter,
    done: u64,
    wanted: u64,
    examination: Examination,
    /// Why the last process could not start its threads.
    no_threads: Option<String>,
}

impl Examiner<'_> {
    fn examine(&mut self) -> Result<()> {
        self.run(Job::Adapters)?;
        self.check_wanted()?;
        let has_none = self.examination.adapters.is_empty() && self.examination.runs[0].failures.is_empty();
        for job in Job::ALL.into_iter().skip(1) {
            let is_left_out =
                has_none || self.examination.is_hopeless() || self.examination.is_redundant(job);
            match (is_left_out, job == AUTO) {
                (true, false) => self.wanted -= job.steps(),
                (false, true) => self.wanted += job.steps(),
                _ => {}
            }
            if !is_left_out {
                self.run(job)?;
            }
        }
        Ok(())
    }

    /// Refuses an adapter that nothing is called.
    fn check_wanted(&self) -> Result<()> {
        let argument = &self.args.adapter;
        let wanted = argument.clone().map_or_else(adapter::name_in_environment, |text| Ok(Some(text)))?;
        let Some(wanted) = wanted else { return Ok(()) };
        let adapters = &self.examination.adapters;
        if adapters.is_empty() || adapters.iter().any(|adapter| adapter.matches(&wanted)) {
            return Ok(());
        }
        let available = adapters.iter().map(AdapterReport::identify).collect();
        Err(adapter::not_found(wanted, argument.is_some(), available))
    }

    /// Does a job in another process.
    fn run(&mut self, job: Job) -> Result<()> {
        let start = Instant::now();
        self.examination.runs.push(Run::new(job));
        let expected = self.done + job.steps();
        let mut command = self.command(job);
        let stop = Arc::clone(&self.stop);
        let (ending, messages) = supervise(&mut command, PATIENCE, &stop, |line| self.receive(line))?;
        if let Some(cause) = self.no_threads.take() {
            return Err(Error::Thread(std::io::Error::other(cause)));
        }
        let run = self.current();
        run.messages = messages;
        let is_done = run.memory.is_some();
        let failure = match ending {
            Ending::Stopped => {
                let remedy = "Nothing was written; run it again";
                return Err(Error::Stopped { done: self.done, wanted: self.wanted, remedy });
            }
            Ending::Success if is_done => None,
            Ending::Success => Some("the process ended before it was done".to_owned()),
            Ending::Failure(how) if is_done => {
                run.crash_at_exit = Some(format!("crashed: {how}"));
                None
            }
            Ending::Silent if is_done => {
                run.crash_at_exit = Some(format!("did not end within {} s", PATIENCE.as_secs()));
                None
            }
            // A driver that crashes has another signal.
            Ending::Failure(how) if how.contains("SIGKILL") => Some(format!(
                "the system ended the process ({how}), most likely for want of memory: raise the limit of the container or the job"
            )),
            Ending::Failure(how) => Some(format!("the driver ended the process ({how})")),
            Ending::Silent => Some(format!(
                "no result for {} s: the driver hangs; the process was ended",
                PATIENCE.as_secs()
            )),
        };
        self.end(start, expected, failure)
    }

    fn end(&mut self, start: Instant, expected: u64, failure: Option<String>) -> Result<()> {
        let run = self.current();
        run.seconds = start.elapsed().as_secs_f64();
        failure.into_iter().for_each(|message| run.fail(message));
        self.done = expected;
        self.show("");
        Ok(())
    }

    fn current(&mut self) -> &mut Run {
        let last = self.examination.runs.len() - 1;
        &mut self.examination.runs[last]
    }

    fn command(&self, job: Job) -> Command {
        let mut command = (self.itself)();
        command.args(["doctor", "--work", &job.name(), "--work-folder"]).arg(self.folder);
        if let Some(adapter) = &self.args.adapter {
            command.args(["--adapter", adapter]);
        }
        command
    }

    /// Takes a line of a worker.
    fn receive(&mut self, line: &str) {
        // A driver may write to standard output too.
        let Ok(event) = serde_json::from_str::<Event>(line) else {
            if !line.is_empty() {
                self.messages.detail(line);
            }
            return;
        };
        let job = self.current().job.name();
        match &event {
            Event::Begins { step } => {
                let step = if *step == job { step.clone() } else { format!("{job}: {step}") };
                self.show(&format!(", {step}"));
            }
            Event::Frame(_) | Event::Bench { .. } | Event::Failed { .. } => self.done += 1,
            Event::NoThreads { cause } => self.no_threads = Some(cause.clone()),
            _ => (),
        }
        let folder = self.folder;
        self.examination.record(event, |frame, case| planes(folder, frame, case));
    }

    fn show(&mut self, more: &str) {
        self.meter.show([0, self.done.min(self.wanted), self.wanted], more);
    }
}

/// The planes of a frame of another process.
fn planes(folder: &Path, frame: &FrameResult, case: &Case) -> Result<Planes> {
    let path = folder.join(&frame.file);
    let bytes = input::read(&path, MAX_PLANES_BYTES)?;
    let cause = || std::io::Error::other("it has another size than the frame");
    Planes::from_bytes(case.size, &bytes).ok_or_else(|| Error::Read { path, cause: cause() })
}

/// Does a job in this process, and prints each result as a line of JSON.
fn work(args: &DoctorArgs, job: Job, folder: &Path) -> Result<()> {
    let faults = std::env::var("REGOLITH_FAULT").unwrap_or_default();
    let crash_if = |fault: &str| {
        if faults_of(&faults, job).any(|found| found == fault) {
            drop(low_level::raise(SIGILL));
        }
    };
    crash_if("crash-at-start");
    if faults_of(&faults, job).any(|fault| fault == "noise") {
        print("a driver's text without an end")?;
    }
    let mut frames = 0;
    let mut tamper = |renderer: &Renderer, frame: &mut Frame| {
        frames += 1;
        inject_faults(&faults, job, frames, renderer, frame);
    };
    let mut failure = None;
    let mut emit = |event: Event| {
        let line = serde_json::to_value(event).unwrap_or(Value::Null);
        // A driver may have written a line without its end.
        failure = print(&format!("\n{line}\n")).err().or(failure.take());
    };
    match start_threads() {
        Err(Error::Thread(cause)) => emit(Event::NoThreads { cause: cause.to_string() }),
        _ => {
            Worker { adapter: args.adapter.as_deref(), folder, emit: &mut emit, tamper: &mut tamper }.run(job)
        }
    }
    crash_if("crash-at-exit");
    failure.map_or(Ok(()), Err)
}

/// The faults of a job in `REGOLITH_FAULT` (`FAULT:JOB`, or several separated by commas), so that tests can check that they are noticed.
fn faults_of(faults: &str, job: Job) -> impl Iterator<Item = &str> {
    let faults = faults.split(',').filter_map(|fault| fault.split_once(':'));
    faults.filter(move |(_, name)| *name == job.name()).map(|(fault, _)| fault)
}

/// Damages the second frame of a backend.
fn inject_faults(faults: &str, job: Job, frames: u32, renderer: &Renderer, frame: &mut Frame) {
    if frames == 2 {
        faults_of(faults, job).for_each(|fault| inject_fault(fault, renderer, frame));
    }
}

fn inject_fault(fault: &str, renderer: &Renderer, frame: &mut Frame) {
    match fault {
        "device-lost" => renderer.gpu().device.destroy(),
        "driver-crash" => drop(low_level::raise(SIGILL)),
        "wrong-label" => frame.class[0] ^= 1,
        "wrong-id" => frame.instances[0] += 1,
        "wrong-depth" => frame.depth_m.iter_mut().for_each(|depth| *depth *= 1.001),
        "wrong-colour" => frame.rgb.iter_mut().for_each(|value| *value = value.saturating_add(9)),
        _ => (),
    }
}
