//! A run: the frames that a folder lacks, or a stream of frames in order.
//!
//! Must not know: how a frame is rendered or encoded.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use super::in_order::InOrder;
use super::log_writer::FrameLogWriter;
use super::merge::{Finalized, finalize_run};
use super::pipeline::{Concurrency, FinishedFrame, milliseconds_json, milliseconds_since, render_frames};
use super::plan::Plan;
use crate::error::{Error, RUN_AGAIN, Result};
use crate::output::layout::FrameFiles;
use crate::render::{Renderer, StageTimes};

/// Seconds between two updates of the manifest.
const MANIFEST_SECONDS: u64 = 5;

/// How far a run has come.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Frames of this run that existed before it.
    pub found: u64,
    /// Frames that it has made.
    pub made: u64,
    /// Frames in all.
    pub wanted: u64,
    /// Rejected attempts.
    pub redraws: u64,
    /// Milliseconds of work by stage, summed over the frames made.
    pub times: StageTimes,
}

impl Progress {
    const fn new(found: u64, wanted: u64) -> Self {
        Self { found, made: 0, wanted, redraws: 0, times: StageTimes::new() }
    }

    fn add(&mut self, frame: &FinishedFrame) {
        self.made += 1;
        self.redraws += u64::from(frame.redraws);
        for &(stage, ms) in &frame.times {
            match self.times.iter_mut().find(|(known, _)| *known == stage) {
                Some((_, sum)) => *sum += ms,
                None => self.times.push((stage, ms)),
            }
        }
    }
}

/// Makes the frames of a plan that its folder lacks, then completes the folder. `watch` is called after every frame.
///
/// # Errors
/// Those of [`render_frames`]; [`Error::Stopped`] if `stop` became true; [`Error::LogLost`] and [`Error::FramesLost`] if the
/// frames were not left alone. Finished frames stay, and the same call resumes the run.
pub fn run(
    plan: &Plan,
    renderer: &mut Renderer,
    mut log: FrameLogWriter,
    concurrency: Concurrency,
    stop: &AtomicBool,
    mut watch: impl FnMut(&Progress) + Send,
) -> Result<(Progress, Finalized)> {
    // Not a list of the missing frames: a plan has up to 2^32.
    let finished = log.finished().clone();
    let of_plan = finished.range(plan.range.start..plan.range.end());
    let found = of_plan.filter(|index| plan.shard.contains(**index)).count() as u64;
    let missing = plan.own_indices().filter(|index| !finished.contains(index));
    let wanted = plan.own_count();
    let mut progress = Progress::new(found, wanted);
    watch(&progress);
    let folder = log.folder().to_owned();
    let mut manifest_written = Instant::now();
    let result = render_frames(plan, renderer, missing, concurrency, stop, |mut frame| {
        let start = Instant::now();
        log.write_files(&frame.files)?;
        frame.times.push(("write", milliseconds_since(start)));
        frame.line.ms = milliseconds_json(&frame.times);
        log.append(&frame.line)?;
        progress.add(&frame);
        watch(&progress);
        if manifest_written.elapsed().as_secs() >= MANIFEST_SECONDS {
            log.write_manifest("running")?;
            manifest_written = Instant::now();
        }
        Ok(())
    });
    let is_complete = progress.found + progress.made == wanted;
    let status = if result.is_err() {
        "error"
    } else if is_complete {
        "done"
    } else {
        "stopped"
    };
    // A full disk has no room for the manifest either: the first error is the one to report.
    let manifest = log.write_manifest(status);
    result?;
    manifest?;
    if !is_complete {
        return Err(Error::Stopped { done: progress.found + progress.made, wanted, remedy: RUN_AGAIN });
    }
    Ok((progress, finalize_run(&folder, log.close(), plan.range, plan.shard)?))
}

/// Makes the frames of a plan and passes the files of each to `sink`, in ascending order of index.
///
/// # Errors
/// Those of [`render_frames`]; [`Error::Stopped`] if `stop` became true.
pub fn stream(
    plan: &Plan,
    renderer: &mut Renderer,
    concurrency: Concurrency,
    stop: &AtomicBool,
    mut sink: impl FnMut(&FrameFiles, &Progress) -> Result<()> + Send,
) -> Result<Progress> {
    let indices = plan.own_indices();
    let wanted = plan.own_count();
    let mut progress = Progress::new(0, wanted);
    let mut in_order = InOrder::new(indices.clone());
    render_frames(plan, renderer, indices, concurrency, stop, |frame| {
        in_order.add(frame.index, frame);
        while let Some(frame) = in_order.take() {
            progress.add(&frame);
            sink(&frame.files, &progress)?;
        }
        Ok(())
    })?;
    if progress.made < wanted {
        let remedy = "A stream cannot be resumed; --start makes the remaining frames in another";
        return Err(Error::Stopped { done: progress.made, wanted, remedy });
    }
    Ok(progress)
}
