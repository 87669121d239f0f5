//! Masks of other pipelines: `remap`.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use clap::Args;
use regolith::output::disk;
use regolith::remap::{self, Pair, Remapped};
use regolith::{Error, Result};
use serde_json::json;

use super::progress::Meter;
use super::{Messages, print};

#[derive(Args, Debug)]
pub(super) struct RemapArgs {
    /// Folder with semantic_segmentation_N.png and semantic_segmentation_labels_N.json, or folders of them
    folder: PathBuf,
    /// Output folder, made if missing: the same names in the same places, with canonical ids
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Allow writing into a folder that has other content
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RemapArgs, messages: Messages) -> Result<()> {
    let pairs = remap::find(&args.folder)?;
    let same =
        |a: &Path, b: &Path| a.canonicalize().ok().is_some_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    if same(&args.folder, &args.out) {
        return Err(Error::Usage("--out is the folder of the masks themselves; give another".to_owned()));
    }
    let ours: BTreeSet<&OsStr> = pairs.iter().flat_map(Pair::top_names).collect();
    disk::check_content(&args.out, args.force, |name| ours.contains(OsStr::new(name)))?;
    let mut meter = Meter::new(messages, "masks");
    let mut all = Remapped::default();
    for (made, pair) in (1..).zip(&pairs) {
        all.add(remap::remap(&args.folder, pair, &args.out)?);
        meter.show([0, made, pairs.len() as u64], "");
    }
    meter.finish();
    if args.json {
        return print(&format!("{:#}\n", json!(all)));
    }
    print(&format!("{}\n", args.out.display()))?;
    tell(args, messages, &all);
    Ok(())
}

fn tell(args: &RemapArgs, messages: Messages, all: &Remapped) {
    let total: u64 = all.pixels.values().sum();
    let shares: Vec<String> = all
        .pixels
        .iter()
        .map(|(class, pixels)| format!("{class} {:.1} %", 100.0 * *pixels as f64 / total.max(1) as f64))
        .collect();
    messages.note(format_args!("{} masks in {}: {}", all.masks, args.out.display(), shares.join(", ")));
    if !all.unknown_names.is_empty() {
        let names: Vec<&str> = all.unknown_names.iter().map(String::as_str).collect();
        messages.note(format_args!("names that are no class became 255: {}", names.join(", ")));
    }
    for mask in &all.empty_masks {
        messages.note(format_args!(
            "warning: {} has become nothing but 255: none of its ids is a class's",
            mask.display()
        ));
    }
}
