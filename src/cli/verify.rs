//! Check-up of a dataset: `verify`.

use std::path::PathBuf;

use clap::Args;
use regolith::dataset::verify::{self, CHECKS, Report};
use regolith::render::{RasterMode, Renderer};
use regolith::{Error, Result, gpu};

use super::progress::Meter;
use super::{Messages, device, print, whole};

/// Problems that are printed; JSON has all.
const SHOWN: usize = 40;

#[derive(Args, Debug)]
pub(super) struct VerifyArgs {
    /// The dataset's folder
    folder: PathBuf,
    /// Frames that are rendered again and compared, spread over the dataset; 0 for none, which needs no adapter
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = whole::<u64>(0, u64::MAX), allow_negative_numbers = true)]
    rerender: u64,
    /// Use the adapter with this in its name, or `cpu`
    #[arg(long, value_name = "TEXT")]
    adapter: Option<String>,
    /// Rasterise on the device or on the host: auto is the host on a software adapter, else the device
    #[arg(long, value_name = "auto|device|host", default_value_t = RasterMode::Auto)]
    raster: RasterMode,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &VerifyArgs, messages: Messages) -> Result<()> {
    let mut meter = Meter::new(messages, "frames");
    let report = verify::check(&args.folder, |checked, wanted| meter.show([0, checked, wanted], ""));
    meter.finish();
    let mut report = report?;
    let rendered = if args.rerender > 0 && report.frames > 0 {
        render_again(args, messages, &mut report)
    } else {
        Ok(())
    };
    if args.json {
        print(&format!("{:#}\n", report.to_json()))?;
    } else {
        print(&table(&report, messages.quiet))?;
    }
    match (report.problems.len(), rendered) {
        (0, Ok(())) => Ok(()),
        // What needs no adapter has been checked and told all the same.
        (_, Err(error @ Error::NoAdapter(_))) => Err(Error::CheckFailed(format!(
            "no frame could be rendered again: {error}\nWith --rerender 0 everything else is checked, and no adapter is needed."
        ))),
        (_, Err(error)) => Err(error),
        (wrong, Ok(())) => Err(Error::CheckFailed(format!(
            "{}: {wrong} {} wrong; a frame's file that is damaged can be deleted: the dataset's own command makes it again",
            args.folder.display(),
            if wrong == 1 { "thing is" } else { "things are" }
        ))),
    }
}

fn render_again(args: &VerifyArgs, messages: Messages, report: &mut Report) -> Result<()> {
    let mut renderer = Renderer::with_raster(device::open(args.adapter.as_deref())?, args.raster)?;
    messages.detail(format_args!("rendering again on {}", gpu::adapter::describe(&renderer.gpu().info)));
    verify::check_rendering(&args.folder, &mut renderer, args.rerender, report)?;
    device::store_pipelines(renderer.gpu());
    Ok(())
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
