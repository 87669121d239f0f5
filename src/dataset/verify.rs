//! Checks whether a dataset holds what it claims.
//!
//! Everything that must be there is derived from the manifest: the paths of all files, every key of every line, the manifest's
//! own keys, the files that index the dataset. Files are compared with their hashes, masks and images with their recorded
//! statistics, the lines with the manifest's digest, and a sample of frames with a new rendering of all their outputs. Memory does
//! not grow with the number of frames.
//!
//! Must not know: the command line.
//! To add a check: a row in [`CHECKS`], and its code where the frame, the folder or the rendered frame is
//! examined.

mod command;
mod context;
mod depth;
mod differences;
mod files;
mod images;
mod index;
mod inventory;
mod record;
mod rendering;
mod report;
mod store;
mod templates;
mod tolerance;

use std::path::Path;

use rayon::prelude::*;

use super::log::FrameLog;
use crate::error::Result;
use crate::output::dataset_path;
use crate::output::layout::FrameLine;
use context::{Context, Version};
use index::{LogSummary, check_index};
use inventory::Inventory;
pub use rendering::check_rendering;
use report::name;
pub use report::{CHECKS, Problem, Report, Subject};
use store::Archives;
use templates::ExpectedFrame;

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
    check_version(&context, &mut report);
    let mut summary = LogSummary::new(&context);
    let mut inventory = Inventory::default();
    let mut chunk: Vec<(u64, FrameLine)> = Vec::new();
    let mut check_chunk = |chunk: &mut Vec<(u64, FrameLine)>, report: &mut Report| -> Result<()> {
        for (part, files) in check_frames(&context, chunk)? {
            report.add(part);
            inventory.merge(files);
        }
        chunk.clear();
        watch(report.frames, context.plan.range.count);
        Ok(())
    };
    let mut number = 0;
    let read = FrameLog::new(folder, context.gate.clone()).for_each_result(&mut |line| {
        number += 1;
        match line {
            Ok(line) => {
                if summary.add(&context, &line, number, &mut report) {
                    chunk.push((number, line));
                }
            }
            Err(error) => {
                summary.is_readable = false;
                report.problem(name::LOG, Subject::Dataset, error.to_string());
            }
        }
        if chunk.len() == CHUNK { check_chunk(&mut chunk, &mut report) } else { Ok(()) }
    });
    check_chunk(&mut chunk, &mut report)?;
    if let Err(error) = read {
        summary.is_readable = false;
        report.problem(name::LOG, Subject::Dataset, error.to_string());
    }
    if is_finished(&context, &mut report) && context.version != Version::Other {
        let mut paths = check_index(&context, &summary, &mut report)?;
        paths.extend(["manifest.json", "frames.jsonl"].map(str::to_owned));
        paths.iter().for_each(|path| inventory.add(&context, path));
        inventory.check(&context, summary.span(context.plan.range), &paths, &mut report)?;
        if summary.is_readable {
            check_form(&context, &mut report)?;
        }
    }
    Ok(report)
}

/// Checks the files and the lines of frames.
fn check_frames(context: &Context<'_>, chunk: &[(u64, FrameLine)]) -> Result<Vec<(Report, Inventory)>> {
    let expected: Vec<ExpectedFrame> = chunk
        .par_iter()
        .map(|(_, line)| ExpectedFrame::new(&context.plan, &context.templates, line))
        .collect::<Result<_>>()?;
    let bundles = expected.iter().filter_map(|frame| frame.bundle.as_deref());
    let archives = Archives::open(context.folder, bundles);
    let results = chunk.par_iter().zip(&expected).map(|((number, line), frame)| {
        let mut report = Report::of_frame();
        record::check_record(context, line, *number, frame, &mut report);
        files::check_frame_files(context, &archives, line, frame, &mut report);
        let mut inventory = Inventory::default();
        inventory.add_frame(context, frame);
        (report, inventory)
    });
    Ok(results.collect())
}

/// Whether the scenes of the dataset's version can be made here.
fn check_version(context: &Context<'_>, report: &mut Report) {
    let own = env!("CARGO_PKG_VERSION");
    report.expect(name::LOG, Subject::Dataset, context.version != Version::Other, || {
        let recorded = context.manifest.get("version").cloned().unwrap_or_default();
        format!(
            "manifest.json: version is {recorded}; this is version {own}, which makes other scenes from the same seeds. Files \
             and hashes were checked; records, index files and frames can only be checked by the version that made them"
        )
    });
}

/// Whether the dataset is complete; only then all files are there.
fn is_finished(context: &Context<'_>, report: &mut Report) -> bool {
    let status = context.manifest.get("status").cloned().unwrap_or_default();
    let is_finished = status == "done";
    report.expect(name::LOG, Subject::Dataset, is_finished, || {
        format!("manifest.json: status is {status}; run the dataset command again, or `dataset --merge` for shards")
    });
    is_finished
}

/// Checks that `frames.jsonl` has the text of its lines and no more: surplus keys that a reader skips, spaces, an end without
/// newline.
fn check_form(context: &Context<'_>, report: &mut Report) -> Result<()> {
    let log = FrameLog::new(context.folder, context.gate.clone());
    let mut length = 0;
    let mut hasher = twox_hash::XxHash3_128::new();
    log.for_each_result(&mut |line| {
        let text = serde_json::to_string(&line?).unwrap_or_default() + "\n";
        length += text.len();
        hasher.write(text.as_bytes());
        Ok(())
    })?;
    let expected = format!("{:032x}", hasher.finish_128());
    let (_, actual) = dataset_path::hash(context.folder, "frames.jsonl")?;
    report.expect(name::LOG, Subject::Dataset, actual == expected, || {
        let line = log.first_other_line().map_or(String::new(), |line| format!(", line {line}"));
        format!(
            "frames.jsonl{line}: it has keys that do not belong there, another order of keys, or spaces; its text should have \
             {length} bytes"
        )
    });
    Ok(())
}
