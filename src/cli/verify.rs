//! Check-up of a dataset: `verify`.

use std::path::PathBuf;

use clap::Args;
use regolith::dataset::verify::{self, CHECKS, Report};
use regolith::render::Renderer;
use regolith::{Error, Result, gpu};

use super::progress::Meter;
use super::{Messages, device, print};

/// Problems that are printed; JSON has all.
const SHOWN: usize = 40;

#[derive(Args, Debug)]
pub(super) struct VerifyArgs {
    /// The dataset's folder
    folder: PathBuf,
    /// Frames that are rendered again and compared, spread over the dataset; 0 for none, which needs no adapter
    #[arg(long, value_name = "N", default_value_t = 4)]
    rerender: u64,
    /// Use the adapter with this in its name, or `cpu`
    #[arg(long, value_name = "TEXT")]
    adapter: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &VerifyArgs, messages: Messages) -> Result<()> {
    let mut meter = Meter::new(messages, "frames");
    let report = verify::check(&args.folder, |checked, wanted| meter.show([0, checked, wanted], ""));
    meter.finish();
    let mut report = report?;
    if args.rerender > 0 && report.frames > 0 {
        let mut renderer = Renderer::new(device::open(args.adapter.as_deref())?)?;
        messages.detail(format_args!("rendering again on {}", gpu::describe(&renderer.gpu().info)));
        verify::check_rendering(&args.folder, &mut renderer, args.rerender, &mut report)?;
        device::keep_programs(renderer.gpu());
    }
    if args.json {
        print(&format!("{:#}\n", report.to_json()))?;
    } else {
        print(&table(&report, messages.quiet))?;
    }
    match report.problems.len() {
        0 => Ok(()),
        wrong => Err(Error::CheckFailed(format!("{}: {wrong} things are wrong", args.folder.display()))),
    }
}

fn table(report: &Report, quiet: bool) -> String {
    let mut text = String::new();
    if !quiet {
        text.push_str(&format!("{:<11}{:>10}{:>8}  what\n", "check", "looked at", "wrong"));
        for (name, what) in CHECKS {
            let wrong = report.problems.iter().filter(|problem| problem.check == name).count();
            let looked = report.looked_at.get(name).map_or("-".to_owned(), ToString::to_string);
            text.push_str(&format!("{name:<11}{looked:>10}{wrong:>8}  {what}\n"));
        }
        text.push_str(&format!("{} frames\n", report.frames));
    }
    for problem in report.problems.iter().take(SHOWN) {
        let frame = problem.index.map_or(String::new(), |index| format!("frame {index}: "));
        text.push_str(&format!("{}: {frame}{}\n", problem.check, problem.found));
    }
    if report.problems.len() > SHOWN {
        text.push_str(&format!("... and {} more; --json has all\n", report.problems.len() - SHOWN));
    }
    text
}
