//! `dataset`: makes, resumes and merges datasets.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::bench::peak_rss_bytes;
use crate::class::ClassId;
use crate::dataset::lock;
use crate::dataset::log_writer::FrameLogWriter;
use crate::dataset::manifest::{self, DatasetSpec};
use crate::dataset::merge::{Finalized, MissingFrames, finalize, finalize_frames};
use crate::dataset::plan::{self, MAX_FRAMES, Plan, Range, Seeds, Shard, frame_seed};
use crate::dataset::rules::Rules;
use crate::dataset::{self, Concurrency, Progress};
use crate::error::{Error, Result};
use crate::output;
use crate::output::layout::{self, LAYOUTS, webdataset::archive_end};
use clap::{ArgGroup, Args};
use serde_json::{Map, Value, json};

use super::add_outputs;
use super::args::{ConfigArgs, DeviceArgs, ImageArgs, output_names, whole_number};
use super::device;
use super::messages::{Messages, frames, print};
use super::process::{end_on_signals, stop_on_signals};
use super::progress::{Meter, duration};

/// Number of frames of a dry run, if the range has as many.
const DRY_FRAMES: u64 = 5;
/// The shard of a run that is none.
const DEFAULT_SHARD: &str = "0/1";
/// Missing frames that the JSON summary lists.
const MAX_LISTED: usize = 1000;

#[derive(Args, Debug)]
#[command(group(ArgGroup::new("frames").required(true).multiple(true).args(["count", "split", "merge", "add_outputs"])))]
pub(super) struct DatasetArgs {
    /// Number of frames
    #[arg(long, value_name = "N", conflicts_with = "split", value_parser = whole_number::<u64>(1, MAX_FRAMES))]
    count: Option<u64>,
    /// Splits with their numbers of frames, for example train=1500,val=200: one folder each, no scene in two of them
    #[arg(long, value_name = "LIST", conflicts_with = "start")]
    split: Option<String>,
    /// Index of the first frame
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole_number::<u64>(0, MAX_FRAMES - 1))]
    start: u64,
    /// Make only the frames i with i mod N = I, for example 0/4; shards may share a folder, or be copied into one
    #[arg(long, value_name = "I/N", default_value = DEFAULT_SHARD)]
    shard: String,
    /// Base seed; frame i depends only on it, on i and on the settings
    #[arg(long, value_name = "N", default_value_t = 42, value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: u64,
    /// Output folder, created if missing; the same command resumes an interrupted run. With --format webdataset, `-` streams one
    /// archive to standard output
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    image: ImageArgs,
    #[command(flatten)]
    device: DeviceArgs,
    #[arg(long, value_name = "LIST", help = format!("Outputs to write, separated by commas, or `all` that the format holds: {}. rgb and mask are always written, and what else the format requires; in the format folder preview is written for every 25th frame [default: rgb,mask,preview, as far as the format holds them]", output_names()))]
    outputs: Option<String>,
    /// Layout of the files; see the list below
    #[arg(long, value_name = "NAME", default_value = "folder")]
    format: String,
    /// Render nothing: merge the shards in --out into one frames.jsonl and one manifest
    #[arg(long, conflicts_with_all = [
        "count", "split", "start", "shard", "seed", "stage", "preset", "config", "set", "size", "samples", "label_ids", "edges", "outputs",
        "format", "adapter", "raster", "threads", "dry_run", "force",
    ])]
    merge: bool,
    /// Add these outputs, separated by commas, to the finished dataset in DIR: its frames are rendered again, compared with what it has, and
    /// only the new files are written; the same command resumes an interrupted run
    #[arg(long, value_name = "LIST", requires = "folder", conflicts_with_all = [
        "count", "split", "start", "shard", "seed", "out", "stage", "preset", "config", "set", "size", "samples", "label_ids", "edges",
        "outputs", "format", "merge", "dry_run", "force",
    ])]
    add_outputs: Option<String>,
    /// The dataset of --add-outputs
    #[arg(value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Render nothing: print the knobs of the first frames
    #[arg(long)]
    dry_run: bool,
    /// Threads that build scenes, plan frames, post-process and encode [default: one for each core, with a software adapter, which draws
    /// on the same cores, one for every two, which uses idle ones as well]
    #[arg(long, value_name = "N", value_parser = whole_number::<u16>(1, 256))]
    threads: Option<u16>,
    /// Write into a folder even if it has other content; a file of it whose name the dataset needs is replaced
    #[arg(long)]
    force: bool,
    /// Print the summary as JSON on stdout
    #[arg(long)]
    json: bool,
}

/// The list of formats for the help.
pub(super) fn formats_help() -> String {
    let rows = LAYOUTS.iter().map(|row| format!("  {:<15} {}\n", row.name, row.summary));
    format!("Formats:\n{}", rows.collect::<String>())
}

pub(super) fn run(args: &DatasetArgs, messages: Messages) -> Result<()> {
    // Not by `requires`, which does not hold beside an option that --add-outputs excludes.
    if let (Some(folder), None) = (&args.folder, &args.add_outputs) {
        return Err(Error::Usage(format!(
            "{}: only --add-outputs takes a folder without an option; frames are written to --out {0}",
            folder.display()
        )));
    }
    if args.merge {
        return merge(args, messages);
    }
    let concurrency = Concurrency { threads: args.threads.map(usize::from), frames_in_flight: None };
    if let (Some(list), Some(folder)) = (&args.add_outputs, &args.folder) {
        return add_outputs::run(folder, list, &args.device, concurrency, args.json, messages);
    }
    let plan = plan(args)?;
    if args.dry_run {
        return dry_run(args, &plan);
    }
    let stop = stop_on_signals(messages)?;
    if args.out.as_os_str() == "-" {
        return stream(args, messages, &plan, concurrency, &stop);
    }
    let spec = DatasetSpec::of_plan(&plan);
    let finished = lock::check_folder(&args.out, &spec, args.force)?;
    if plan.own_indices().all(|index| finished.contains(&index)) {
        if !lock::is_recorded(&args.out, plan.range)? {
            // The manifest was lost, and --force confirms that the frames belong to this run; or the range has grown, by frames of other
            // shards alone.
            FrameLogWriter::open(&args.out, &spec, args.force)?.write_manifest("done")?;
        }
        let finalized = finalize_frames(&args.out, plan.range, plan.shard)?;
        report(args, messages, None, &finalized, 0.0)?;
        return check_complete(args, &plan, &finalized);
    }
    let start = Instant::now();
    // Before the folder is created, so that nothing is left behind on a machine without an adapter.
    let gpu = args.device.open(messages)?;
    let log = FrameLogWriter::open(&args.out, &spec, args.force)?;
    messages.note(format_args!("rendering on {}", crate::gpu::adapter::describe(&gpu.info)));
    let mut renderer = args.device.renderer(gpu)?;
    device::inject_fault(&renderer);
    let mut meter = Meter::new(messages, "frames");
    let result =
        dataset::run(&plan, &mut renderer, log, concurrency, &stop, |progress| show(&mut meter, progress));
    meter.finish();
    let (progress, finalized) = result?;
    device::store_pipelines(renderer.gpu());
    report(args, messages, Some(&progress), &finalized, start.elapsed().as_secs_f64())?;
    check_complete(args, &plan, &finalized)
}

/// Whether the folder has every frame, after a run that is no shard: it may lack frames of a larger run that was interrupted.
fn check_complete(args: &DatasetArgs, plan: &Plan, finalized: &Finalized) -> Result<()> {
    let missing = &finalized.missing;
    if missing.is_empty() || plan.shard != Shard::WHOLE {
        return Ok(());
    }
    let range = manifest::range_of(&finalized.manifest);
    Err(Error::CheckFailed(format!(
        "{} was begun with frames {} to {}, of which {} {} missing: {}. Those of this run are there; run the command with the larger --count \
         again, which makes the others",
        args.out.display(),
        range.start,
        range.end() - 1,
        missing.count(),
        if missing.count() == 1 { "is" } else { "are" },
        abbreviated(missing)
    )))
}

fn plan(args: &DatasetArgs) -> Result<Plan> {
    let (config, origin) = args.config.build()?;
    let (format, layout) = layout::find(&args.format)?;
    let outputs = Plan::outputs(args.outputs.as_deref(), format, layout)?;
    let image = args.image.or(&origin);
    let mut settings = image.settings()?;
    Plan::check_size(settings.size)?;
    settings.annotations = output::annotations(&outputs);
    let splits = args.split.as_deref().map_or(Ok(Vec::new()), plan::parse_splits)?;
    layout.check_splits(&splits.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>())?;
    let count = args.count.unwrap_or_else(|| splits.iter().map(|(_, count)| count).sum());
    if count == 0 || args.start.checked_add(count).is_none_or(|end| end > MAX_FRAMES) {
        return Err(Error::Usage(format!(
            "--start {} with {count} frames: a dataset has at least one frame, and none after index {}",
            args.start,
            MAX_FRAMES - 1
        )));
    }
    // A layout with ids of its own takes none from a record.
    let requested = if layout.has_fixed_ids() { &args.image } else { &image };
    let options = [Some(args.config.options()).filter(|options| !options.is_empty()), args.device.options()];
    Ok(Plan {
        options: options.into_iter().flatten().collect::<Vec<_>>().join(" "),
        rules: Rules::from_config(&config)?,
        config,
        base_seed: args.seed,
        seeds: Seeds::OfBase,
        settings,
        outputs,
        edges: image.edges()?,
        label_ids: Plan::label_ids(requested.label_ids(), format, layout)?,
        format,
        layout,
        range: Range { start: args.start, count },
        splits,
        shard: args.shard.parse()?,
    })
}

/// Writes a WebDataset as one archive to standard output, in the order of the frames.
fn stream(
    args: &DatasetArgs,
    messages: Messages,
    plan: &Plan,
    concurrency: Concurrency,
    stop: &AtomicBool,
) -> Result<()> {
    if plan.format != "webdataset" || !plan.splits.is_empty() {
        return Err(Error::Usage(
            "--out - streams one archive: it needs --format webdataset and no --split".to_owned(),
        ));
    }
    if args.json {
        return Err(Error::Usage(
            "--json: with --out - standard output has the archive; leave one of them out".to_owned(),
        ));
    }
    let gpu = args.device.open(messages)?;
    let mut renderer = args.device.renderer(gpu)?;
    device::inject_fault(&renderer);
    let mut meter = Meter::new(messages, "frames");
    let (start, closed, mut streamed) = (Instant::now(), AtomicBool::new(false), 0);
    let write = |bytes: &[u8]| {
        let mut stdout = std::io::stdout().lock();
        match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
            Err(cause) if cause.kind() == std::io::ErrorKind::BrokenPipe => {
                // The reader closed the pipe: no further frame is of use.
                closed.store(true, Ordering::Relaxed);
                stop.store(true, Ordering::Relaxed);
                Ok(())
            }
            result => result.map_err(Error::Stdout),
        }
    };
    let result = dataset::stream(plan, &mut renderer, concurrency, stop, |frame, progress| {
        show(&mut meter, progress);
        frame.artifacts.iter().try_for_each(|file| write(&file.bytes))?;
        streamed += u64::from(!closed.load(Ordering::Relaxed));
        Ok(())
    });
    meter.finish();
    if closed.load(Ordering::Relaxed) {
        return Err(Error::CheckFailed(format!(
            "stopped: whoever read the archive has closed it after {streamed} of {} frames; it is not complete. A stream cannot be \
             resumed; --start makes the remaining frames in another",
            plan.own_count()
        )));
    }
    let progress = result?;
    write(&archive_end())?;
    device::store_pipelines(renderer.gpu());
    messages.note(format_args!(
        "{} streamed in {}",
        frames(progress.made),
        duration(start.elapsed().as_secs_f64())
    ));
    Ok(())
}

/// Prints the knobs of the first frames.
fn dry_run(args: &DatasetArgs, plan: &Plan) -> Result<()> {
    let mut rows = Vec::new();
    for index in plan.own_indices().take(DRY_FRAMES as usize) {
        let seed = frame_seed(plan.base_seed, index, 0);
        rows.push((index, seed, plan.config.draw(seed)?.to_json()));
    }
    if args.json {
        let rows: Vec<Value> = rows
            .into_iter()
            .map(|(index, seed, knobs)| {
                json!({ "index": index, "split": plan.split_of(index), "seed": seed, "knobs": knobs })
            })
            .collect();
        return print(&format!("{:#}\n", Value::from(rows)));
    }
    if rows.is_empty() {
        return print(&format!("--shard {} has no frame of this range\n", args.shard));
    }
    let mut text = format!("{:<26}", "frame");
    for (index, ..) in &rows {
        text.push_str(&format!("{index:>18}"));
    }
    text.push_str(&format!("\n{:<26}", "seed"));
    for (_, seed, _) in &rows {
        text.push_str(&format!("{seed:>18}"));
    }
    // Frames of different stages have different knobs.
    let mut knobs: Vec<&String> = Vec::new();
    for (_, _, row) in &rows {
        let further: Vec<&String> = row.keys().filter(|knob| !knobs.contains(knob)).collect();
        knobs.extend(further);
    }
    for knob in knobs {
        let values: Vec<Option<&Value>> = rows.iter().map(|row| row.2.get(knob)).collect();
        let formatted = |value: Option<&Value>| match value.map(|value| (value, value.as_f64())) {
            None => "-".to_owned(),
            Some((value, None)) => value.to_string(),
            Some((_, Some(number))) if number.fract() == 0.0 => number.to_string(),
            Some((_, Some(number))) => format!("{number:.4}"),
        };
        text.push_str(&format!("\n{knob:<26}"));
        if values.iter().all(|value| *value == values[0]) {
            text.push_str(&format!("  {} in all", formatted(values[0])));
        } else {
            for value in values {
                text.push_str(&format!("{:>18}", formatted(value)));
            }
        }
    }
    print(&format!("{text}\n"))
}

/// Merges the shards of the folder without rendering.
fn merge(args: &DatasetArgs, messages: Messages) -> Result<()> {
    end_on_signals()?;
    let finalized = finalize(&args.out)?;
    report(args, messages, None, &finalized, 0.0)?;
    let missing = &finalized.missing;
    if missing.is_empty() {
        return Ok(());
    }
    Err(Error::CheckFailed(format!(
        "{} {} missing from {}: {}. Make them with their --shard, or copy the other shards into the folder",
        missing.count(),
        if missing.count() == 1 { "frame is" } else { "frames are" },
        args.out.display(),
        abbreviated(missing)
    )))
}

/// The first few missing frames.
fn abbreviated(missing: &MissingFrames) -> String {
    let first: Vec<String> = missing.indices().take(8).map(|index| index.to_string()).collect();
    format!("{}{}", first.join(", "), if missing.count() > 8 { ", ..." } else { "" })
}

/// Prints the summary of a finished run; without `run`, of a folder in which nothing had to be rendered.
fn report(
    args: &DatasetArgs,
    messages: Messages,
    run: Option<&Progress>,
    finalized: &Finalized,
    seconds: f64,
) -> Result<()> {
    let manifest = &finalized.manifest;
    let ms: Map<String, Value> = run
        .map(|run| {
            run.times
                .iter()
                .map(|(name, ms)| ((*name).to_owned(), json!(ms / run.made.max(1) as f64)))
                .collect()
        })
        .unwrap_or_default();
    if args.json {
        let summary = json!({
            "out": args.out.display().to_string(),
            "frames": manifest["n_completed"],
            "made": run.map_or(0, |run| run.made),
            "redraws": run.map_or(0, |run| run.redraws),
            "n_missing": finalized.missing.count(),
            "missing": finalized.missing.indices().take(MAX_LISTED).collect::<Vec<_>>(),
            "seconds": seconds,
            "ms_per_frame": ms,
            "peak_rss_bytes": peak_rss_bytes(),
            "status": manifest["status"],
            "totals": manifest["totals"],
        });
        print(&format!("{summary:#}\n"))?;
    } else {
        messages.paths(&format!("{}\n", args.out.display()))?;
    }
    match run {
        Some(run) => messages.note(format_args!(
            "{} made ({} existed), {} redrawn, in {}: {:.2} frames/s",
            frames(run.made),
            run.found,
            run.redraws,
            duration(seconds),
            run.made as f64 / seconds
        )),
        None => messages.note(format_args!("no frame was rendered; {} exist", manifest["n_completed"])),
    }
    let brightness = manifest["totals"]["rgb_mean"].as_f64().unwrap_or_default();
    messages.note(format_args!(
        "mean coverage: {}; mean brightness {brightness:.1} of 255",
        mask_shares(manifest).join(", ")
    ));
    let stages: Vec<String> =
        ms.iter().map(|(name, ms)| format!("{name} {:.1}", ms.as_f64().unwrap_or(0.0))).collect();
    if !stages.is_empty() {
        messages.detail(format_args!("milliseconds of work per frame: {}", stages.join(", ")));
    }
    if finalized.missing.is_empty() {
        let sheet = if args.out.join("contact_sheet.png").is_file() { "contact_sheet.png, " } else { "" };
        messages.note(format_args!(
            "complete: {} in {}; see {sheet}histograms.svg, README.md",
            frames(manifest["n_completed"].as_u64().unwrap_or_default()),
            args.out.display()
        ));
    } else if args.shard != DEFAULT_SHARD {
        let count = finalized.missing.count();
        messages.note(format_args!(
            "{count} {} still missing: {}; once they are copied here, `regolith-render dataset --merge --out {}` completes the folder",
            if count == 1 { "frame of another shard is" } else { "frames of other shards are" },
            abbreviated(&finalized.missing),
            args.out.display()
        ));
    }
    if let Some(bytes) = peak_rss_bytes() {
        messages.detail(format_args!("peak memory {:.0} MB", bytes as f64 / 1e6));
    }
    Ok(())
}

/// What each class takes of the masks as they are written, and what is ignored in them, if anything is.
fn mask_shares(manifest: &Map<String, Value>) -> Vec<String> {
    let number = |value: &Value| value.as_f64().unwrap_or_default();
    let all = number(&manifest["n_completed"]) * number(&manifest["size"][0]) * number(&manifest["size"][1]);
    let pixels =
        ClassId::ALL.map(|class| (class.name, number(&manifest["totals"]["class_pixels"][class.name])));
    let ignored = all - pixels.iter().map(|(_, pixels)| pixels).sum::<f64>();
    let ignored = Some(("ignored", ignored)).filter(|(_, pixels)| *pixels > 0.0);
    let share = |(name, pixels): (&str, f64)| format!("{name} {:.1} %", 100.0 * pixels / all.max(1.0));
    pixels.into_iter().chain(ignored).map(share).collect()
}

/// Shows the progress of a run.
fn show(meter: &mut Meter, progress: &Progress) {
    let redrawn =
        if progress.redraws > 0 { format!(", {} redrawn", progress.redraws) } else { String::new() };
    meter.show([progress.found, progress.made, progress.wanted], &redrawn);
}
