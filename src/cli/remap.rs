//! `remap`: masks of other pipelines with canonical ids.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use crate::error::{Error, Result};
use crate::output::{dataset_path, disk};
use crate::remap::{self, MAX_UNNAMED, Pair, Remapped};
use clap::Args;
use serde_json::json;

use super::messages::{Messages, print};
use super::process::stop_on_signals;
use super::progress::Meter;

/// Masks that are remapped at a time.
const CHUNK: usize = 16;
/// Ids or colours without a name that are printed; `--json` lists more.
const MAX_PRINTED: usize = 20;

#[derive(Args, Debug)]
pub(super) struct RemapArgs {
    /// Folder with semantic_segmentation_N.png and semantic_segmentation_labels_N.json, or with subfolders of them
    folder: PathBuf,
    /// Output folder, created if missing; files keep their names and subfolders
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Write into a folder even if it has other content; a file of it whose name a mask or a label file needs is replaced
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RemapArgs, messages: Messages) -> Result<()> {
    let pairs = remap::find(&args.folder)?;
    dataset_path::check_apart(&args.folder, &args.out)?;
    let own_names: BTreeSet<&OsStr> = pairs.iter().flat_map(Pair::top_names).collect();
    disk::check_content(&args.out, args.force, |name| own_names.contains(OsStr::new(name)))?;
    let stop = stop_on_signals(messages)?;
    let mut meter = Meter::new(messages, "masks");
    let mut total = Remapped::default();
    let wanted = pairs.len() as u64;
    let mut done = 0;
    for chunk in pairs.chunks(CHUNK) {
        if stop.load(Ordering::Relaxed) {
            meter.finish();
            return Err(Error::Stopped {
                done,
                wanted,
                remedy: "Run the same command again; it starts over",
            });
        }
        total.add(remap::remap(&args.folder, chunk, &args.out, args.force)?);
        done += chunk.len() as u64;
        meter.show([0, done, wanted], "");
    }
    meter.finish();
    if args.json {
        return print(&format!("{:#}\n", json!(total)));
    }
    messages.paths(&format!("{}\n", args.out.display()))?;
    summarise(args, messages, &total);
    Ok(())
}

fn summarise(args: &RemapArgs, messages: Messages, remapped: &Remapped) {
    let total: u64 = remapped.pixels.values().sum();
    let shares: Vec<String> = remapped
        .pixels
        .iter()
        .map(|(class, pixels)| format!("{class} {:.1} %", 100.0 * *pixels as f64 / total.max(1) as f64))
        .collect();
    let noun = if remapped.masks == 1 { "mask" } else { "masks" };
    let (masks, out) = (remapped.masks, args.out.display());
    messages.note(format_args!("{masks} {noun} in {out}: {}", shares.join(", ")));
    if !remapped.unknown_names.is_empty() {
        let names: Vec<&str> = remapped.unknown_names.iter().map(String::as_str).collect();
        messages.note(format_args!("names of no class, written as 255: {}", names.join(", ")));
    }
    let colour = |[r, g, b, a]: &[u8; 4]| format!("({r}, {g}, {b}, {a})");
    for (what, raw) in [
        ("ids", remapped.unnamed_ids.iter().map(u32::to_string).collect::<Vec<_>>()),
        ("colours", remapped.unnamed_colours.iter().map(colour).collect()),
    ] {
        if !raw.is_empty() {
            messages.note(format_args!("{what} without a name, written as 255: {}", abbreviated(&raw)));
        }
    }
    for mask in &remapped.empty_masks {
        messages.note(format_args!(
            "warning: {} is entirely 255 now: none of its ids has the name of a class",
            mask.display()
        ));
    }
}

/// The first of a list, and how many there are besides.
fn abbreviated(list: &[String]) -> String {
    let (first, others) = list.split_at(list.len().min(MAX_PRINTED));
    let at_least = if list.len() < MAX_UNNAMED { "" } else { "at least " };
    let more =
        if others.is_empty() { String::new() } else { format!(" and {at_least}{} more", others.len()) };
    first.join(", ") + &more
}
