//! Checks whether a dataset holds what it claims: every file against its hash, every mask against its recorded
//! statistics, a sample of frames against a new rendering, depth against the scene's surface.
//!
//! Must not know: the command line.
//! To add a check: a row in [`CHECKS`], and its code where the frame, the folder or the rendered frame is
//! examined.

mod context;
mod depth;
mod files;
mod images;
mod record;
mod rendering;
mod report;

use std::collections::BTreeSet;
use std::path::Path;

use rayon::prelude::*;
use serde_json::{Map, Value};

use super::log::FrameLog;
use super::plan::Plan;
use super::totals::Totals;
use crate::error::Result;
use crate::output::layout::FrameLine;
use context::Context;
pub use rendering::check_rendering;
use report::name;
pub use report::{CHECKS, Problem, Report};

/// Lines that are checked at a time.
const CHUNK: usize = 256;

/// Makes all checks that need no rendering. `watch` is called with the number of frames checked and the number of all.
///
/// # Errors
/// [`Error::Dataset`](crate::Error::Dataset) if the folder is not a dataset,
/// [`Error::CheckFailed`](crate::Error::CheckFailed) if its manifest cannot be used. All other problems are in the
/// report.
pub fn check(folder: &Path, mut watch: impl FnMut(u64, u64)) -> Result<Report> {
    let manifest = context::open(folder)?;
    let context = Context::new(folder, &manifest)?;
    let mut report = Report::default();
    check_manifest(&context, &manifest, &mut report);
    let mut summary = LogSummary { next: context.range.start, ..LogSummary::default() };
    let mut chunk = Vec::new();
    let mut check_chunk = |chunk: &mut Vec<FrameLine>, report: &mut Report| {
        let parts: Vec<Report> = chunk.par_iter().map(|line| check_frame(&context, line)).collect();
        parts.into_iter().for_each(|part| report.add(part));
        chunk.clear();
        watch(report.frames, context.range.count);
    };
    let read = FrameLog::new(folder).for_each_result(&mut |line| {
        match line {
            Ok(line) => {
                summary.add(&line, &mut report);
                chunk.push(line);
            }
            Err(error) => report.problem(name::LOG, None, error.to_string()),
        }
        if chunk.len() == CHUNK {
            check_chunk(&mut chunk, &mut report);
        }
        Ok(())
    });
    check_chunk(&mut chunk, &mut report);
    if let Err(error) = read {
        report.problem(name::LOG, None, error.to_string());
    }
    check_counts(&context, &manifest, &summary, &mut report);
    let mut known_files = summary.files;
    known_files.extend(check_index_files(&context, &manifest, &mut report));
    files::check_foreign_files(folder, &known_files, &mut report)?;
    Ok(report)
}

/// What the lines of a log amount to.
#[derive(Default)]
struct LogSummary {
    /// The index that the next line should have.
    next: u64,
    totals: Totals,
    /// Paths of the frames' files.
    files: BTreeSet<String>,
}

impl LogSummary {
    fn add(&mut self, line: &FrameLine, report: &mut Report) {
        self.totals.add(line);
        report.expect(name::LOG, Some(line.index), line.index == self.next, || {
            format!("frames.jsonl: expected frame {} here", self.next)
        });
        self.next = line.index + 1;
        self.files.extend(line.hashes().map(|(path, _)| path.to_owned()));
    }
}

/// Status and ids of the manifest.
fn check_manifest(context: &Context<'_>, manifest: &Map<String, Value>, report: &mut Report) {
    let status = manifest.get("status").and_then(Value::as_str).unwrap_or_default();
    report.expect(name::LOG, None, status == "done", || {
        format!("manifest.json: status is `{status}`; run the dataset command again, or `dataset --merge` for shards")
    });
    for (key, value) in Plan::identity_of_ids(context.label_ids) {
        report.expect(name::LABELS, None, manifest.get(&key) == Some(&value), || {
            format!("manifest.json: {key} should be {value}")
        });
    }
}

/// Counts and totals of the manifest against the lines.
fn check_counts(
    context: &Context<'_>,
    manifest: &Map<String, Value>,
    summary: &LogSummary,
    report: &mut Report,
) {
    let range = context.range;
    report.expect(name::LOG, None, summary.next == range.end(), || {
        format!(
            "frames.jsonl ends before frame {}; the manifest has frames {} to {}",
            summary.next,
            range.start,
            range.end() - 1
        )
    });
    let frames = report.frames;
    report.expect(
        name::LOG,
        None,
        manifest.get("n_completed").and_then(Value::as_u64) == Some(frames),
        || format!("manifest.json: n_completed should be {frames}, the number of lines in frames.jsonl"),
    );
    let totals = summary.totals.to_json();
    report.expect(name::LOG, None, manifest.get("totals") == Some(&totals), || {
        format!("manifest.json: totals should be those of frames.jsonl, {totals}")
    });
}

/// Checks the dataset's index files, and returns their paths.
fn check_index_files(
    context: &Context<'_>,
    manifest: &Map<String, Value>,
    report: &mut Report,
) -> Vec<String> {
    let index_files = manifest.get("index_files").and_then(Value::as_object);
    for (path, hash) in index_files.into_iter().flatten() {
        if let Some(bytes) = files::read_checked(context, path, hash.as_str(), None, report) {
            files::check_labels(context, path, &bytes, None, report);
        }
    }
    index_files.map(|files| files.keys().cloned().collect()).unwrap_or_default()
}

/// Everything that a frame's line and files show without rendering.
fn check_frame(context: &Context<'_>, line: &FrameLine) -> Report {
    let mut report = Report { frames: 1, ..Report::default() };
    record::check_record(context, line, &mut report);
    files::check_frame_files(context, line, &mut report);
    report
}
