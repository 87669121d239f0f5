//! `convert`: a finished dataset in another format.

use std::path::PathBuf;

use crate::dataset::convert::Conversion;
use crate::error::Result;
use crate::output::dataset_path;
use clap::Args;
use serde_json::json;

use super::messages::{Messages, print};
use super::process::stop_on_signals;
use super::progress::Meter;

#[derive(Args, Debug)]
pub(super) struct ConvertArgs {
    /// A finished dataset in the format `folder`
    folder: PathBuf,
    /// The new format; see the list below
    #[arg(long, value_name = "NAME")]
    format: String,
    /// Output folder, created if missing; the same command resumes an interrupted run
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Write into a folder even if it has other content; a file of it whose name the dataset needs is replaced
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ConvertArgs, messages: Messages) -> Result<()> {
    let conversion = Conversion::new(&args.folder, &args.format)?;
    dataset_path::check_apart(&args.folder, &args.out)?;
    let stop = stop_on_signals(messages)?;
    let mut meter = Meter::new(messages, "frames");
    let result = conversion.run(&args.folder, &args.out, args.force, &stop, |found, made| {
        meter.show([found, made, conversion.frames()], "");
    });
    meter.finish();
    let finalized = result?;
    if args.json {
        let summary = json!({
            "out": args.out.display().to_string(), "format": args.format, "frames": finalized.manifest["n_completed"],
            "status": finalized.manifest["status"],
        });
        return print(&format!("{summary:#}\n"));
    }
    messages.paths(&format!("{}\n", args.out.display()))
}
