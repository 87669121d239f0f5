//! `verify`: checks of a dataset.

use std::path::PathBuf;

use crate::dataset::verify::{self, CHECKS, Report};
use crate::error::{Error, Result};
use crate::gpu;
use clap::Args;

use super::args::DeviceArgs;
use super::device;
use super::messages::{Messages, frames, print};
use super::process::end_on_signals;
use super::progress::Meter;

/// Number of problems in the table; `--json` lists all.
const MAX_PRINTED: usize = 40;

#[derive(Args, Debug)]
pub(super) struct VerifyArgs {
    /// Folder of the dataset
    folder: PathBuf,
    /// Number of frames, spread over the dataset, to render again and compare in every output, or `all`; 0 needs no adapter
    #[arg(long, value_name = "N", default_value = "4", value_parser = frames_to_render)]
    rerender: u64,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A number of frames; `all` is more than any dataset has.
fn frames_to_render(text: &str) -> std::result::Result<u64, String> {
    let number = || text.parse().map_err(|_| "allowed are whole numbers and `all`".to_owned());
    if text == "all" { Ok(u64::MAX) } else { number() }
}

pub(super) fn run(args: &VerifyArgs, messages: Messages) -> Result<()> {
    end_on_signals()?;
    let mut meter = Meter::new(messages, "frames");
    let report = verify::check(&args.folder, |checked, wanted| meter.show([0, checked, wanted], ""));
    meter.finish();
    let mut report = report?;
    let rerendered = if args.rerender > 0 && report.frames > 0 {
        render_again(args, messages, &mut report)
    } else {
        Ok(())
    };
    if args.json {
        print(&format!("{:#}\n", report.to_json()))?;
    } else {
        print(&table(&report, messages.quiet))?;
    }
    match (report.count(), rerendered) {
        (0, Ok(())) => Ok(()),
        // The checks that need no adapter have run, and their results are printed.
        (_, Err(error @ Error::NoAdapter { .. })) => Err(Error::CheckFailed(format!(
            "no frame could be rendered again: {error}\nWith --rerender 0 all other checks run, without an adapter."
        ))),
        (_, Err(error)) => Err(error),
        (count, Ok(())) => Err(Error::CheckFailed(format!(
            "{}: {count} {}{}",
            args.folder.display(),
            if count == 1 { "problem" } else { "problems" },
            if report.is_frame_file_damaged() {
                "; delete a damaged file of a frame, and the command that made the dataset makes it again"
            } else {
                ""
            }
        ))),
    }
}

fn render_again(args: &VerifyArgs, messages: Messages, report: &mut Report) -> Result<()> {
    let mut renderer = args.device.renderer(args.device.open(messages)?)?;
    messages.detail(format_args!("rendering again on {}", gpu::adapter::describe(&renderer.gpu().info)));
    verify::check_rendering(&args.folder, &mut renderer, args.rerender, report)?;
    device::store_pipelines(renderer.gpu());
    Ok(())
}

fn table(report: &Report, quiet: bool) -> String {
    let mut text = String::new();
    if !quiet {
        text.push_str(&format!("{:<11}{:>10}{:>10}  what is checked\n", "check", "checked", "problems"));
        for (name, what) in CHECKS {
            let problems = report.wrong_in(name);
            let checked = report.looked_at.get(name).map_or("-".to_owned(), ToString::to_string);
            text.push_str(&format!("{name:<11}{checked:>10}{problems:>10}  {what}\n"));
        }
        text.push_str(&format!("{}\n", frames(report.frames)));
    }
    for problem in report.problems.iter().take(MAX_PRINTED) {
        let frame = problem.subject.index().map_or(String::new(), |index| format!("frame {index}: "));
        text.push_str(&format!("{}: {frame}{}\n", problem.check, problem.found));
    }
    let more = report.count().saturating_sub(MAX_PRINTED as u64);
    if more > 0 {
        text.push_str(&format!("... and {more} more; --json lists them\n"));
    }
    text
}
