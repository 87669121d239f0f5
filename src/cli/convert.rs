//! Datasets in other layouts: `convert`.

use std::path::PathBuf;

use clap::Args;
use regolith::Result;
use regolith::dataset::convert::Conversion;
use serde_json::json;

use super::progress::Meter;
use super::{Messages, print};

#[derive(Args, Debug)]
pub(super) struct ConvertArgs {
    /// A finished dataset of the format `folder`
    folder: PathBuf,
    /// The other format: see the list below
    #[arg(long, value_name = "NAME")]
    format: String,
    /// Output folder, made if missing; the same command goes on with what is there
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Allow starting in a folder that has other content
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ConvertArgs, messages: Messages) -> Result<()> {
    let conversion = Conversion::new(&args.folder, &args.format)?;
    let stop = super::dataset::stop_on_signals()?;
    let mut meter = Meter::new(messages, "frames");
    let result = conversion.run(&args.folder, &args.out, args.force, &stop, |found, made| {
        meter.show([found, made, conversion.frames()], "");
    });
    meter.finish();
    let finalized = result?;
    if args.json {
        let summary = json!({
            "out": args.out, "format": args.format, "frames": finalized.manifest["n_completed"],
            "status": finalized.manifest["status"],
        });
        return print(&format!("{summary:#}\n"));
    }
    print(&format!("{}\n", args.out.display()))
}
