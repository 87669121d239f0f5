//! One frame: the command without a subcommand.

use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::dataset::rules::Rules;
use crate::error::Result;
use crate::frame::Frame;
use crate::gpu;
use crate::meta::FrameRecord;
use crate::output::edges::MaskIds;
use crate::output::{self, EncodeInput, LabelIds, OUTPUTS, Output, disk};
use crate::params::Params;
use crate::render::{RenderSettings, Renderer, StageTimes, select::selection};
use crate::scene::Scene;
use clap::Args;
use serde_json::{Value, json};

use super::args::{ConfigArgs, DEFAULT_SEED, DeviceArgs, ImageArgs, output_names, whole_number};
use super::device;
use super::messages::{Messages, print};
use super::process::end_on_signals;

/// Index of a single frame in its file names.
const INDEX: u64 = 0;

#[derive(Args, Debug)]
pub(super) struct FrameArgs {
    /// Seed of the scene, 64 bits; the same seed and knobs give the same scene on every machine [default: 42, or that of the record]
    #[arg(long, value_name = "N", value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Output folder, created if missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    image: ImageArgs,
    #[command(flatten)]
    device: DeviceArgs,
    #[arg(long, value_name = "LIST", default_value_t = output::default_list(), help = format!("Outputs to write, separated by commas, or `all`: {}", output_names()))]
    outputs: String,
    /// Write into a folder even if it has other content
    #[arg(long)]
    force: bool,
    /// Print the frame's record and the paths of its files as JSON
    #[arg(long)]
    json: bool,
}

/// A rendered frame and what it was made from.
struct Rendered {
    seed: u64,
    params: Params,
    scene: Scene,
    settings: RenderSettings,
    renderer: Renderer,
    frame: Frame,
    times: StageTimes,
}

pub(super) fn run(args: &FrameArgs, messages: Messages) -> Result<()> {
    end_on_signals()?;
    let start = Instant::now();
    let (config, origin) = args.config.build()?;
    let seed = args.seed.or(origin.seed).unwrap_or(DEFAULT_SEED);
    let params = config.draw(seed)?;
    let outputs = output::parse_outputs(&args.outputs)?;
    let image = args.image.or(&origin);
    let mut settings = image.settings()?;
    settings.annotations = output::annotations(&outputs);
    let mask = MaskIds::new(image.edges()?);
    output::check_folder(&args.out, INDEX, args.force)?;
    if let Some(version) = origin.version.filter(|version| version != env!("CARGO_PKG_VERSION")) {
        messages.note(format_args!(
            "the record is of version {version}, whose scenes may differ from this one's"
        ));
    }

    let mut rendered = render(args, messages, seed, params, settings)?;
    let (meta, paths) = write(args, messages, (image.label_ids(), &mask), &mut rendered, outputs)?;
    summarise(messages, &rendered, &meta, start);
    let rules = Rules::from_config(&config)?;
    if let Some(violation) = rules.violation(&rendered.scene, &rendered.frame, &mask) {
        messages.note(format_args!(
            "a dataset would redraw this frame: {} ({})",
            violation.found, violation.rule
        ));
    }
    let older = older_files(&args.out, &paths);
    if !older.is_empty() {
        messages.note(format_args!("files of an earlier run in this folder: {}", older.join(", ")));
    }
    device::store_pipelines(rendered.renderer.gpu());
    Ok(())
}

/// Renders the frame. The device is opened while the scene is built.
fn render(
    args: &FrameArgs,
    messages: Messages,
    seed: u64,
    params: Params,
    settings: RenderSettings,
) -> Result<Rendered> {
    // Before any thread is started.
    gpu::adapter::check_environment()?;
    device::start_threads()?;
    let (scene, renderer) = rayon::join(
        || {
            timed("scene", || {
                let scene = Scene::build(seed, &params)?;
                selection::build_rocks(&scene, &settings);
                Ok(scene)
            })
        },
        || -> Result<_> {
            let (gpu, adapter) = timed("adapter", || args.device.open(messages))?;
            let (renderer, pipelines) = timed("pipelines", || args.device.renderer(gpu))?;
            Ok((renderer, [adapter, pipelines]))
        },
    );
    let (scene, built) = scene?;
    let (mut renderer, opened) = renderer?;
    let mut times: StageTimes = [built].into_iter().chain(opened).collect();
    device::inject_fault(&renderer);
    let rendered = renderer.render(&scene, &settings);
    let (frame, render_times) = rendered.map_err(|error| error.of_seed(seed))?;
    times.extend(render_times);
    Ok(Rendered { seed, params, scene, settings, renderer, frame, times })
}

/// Encodes and writes the outputs and prints their paths; returns the record of the frame, and the paths.
fn write(
    args: &FrameArgs,
    messages: Messages,
    (label_ids, mask): (LabelIds, &MaskIds),
    rendered: &mut Rendered,
    outputs: Vec<&'static Output>,
) -> Result<(Value, Vec<PathBuf>)> {
    // The record is encoded last, as it contains the time that encoding the others took.
    let (images, records): (Vec<_>, Vec<_>) = outputs.into_iter().partition(|output| output.name != "meta");
    let Rendered { seed, params, scene, settings, renderer, frame, times } = rendered;
    let input = EncodeInput { frame, meta: &Value::Null, label_ids, mask };
    let (mut files, encoded) = timed("encode", || output::encode(&input, &images))?;
    times.push(encoded);
    let record = FrameRecord {
        seed: *seed,
        params,
        scene,
        settings,
        adapter: &renderer.gpu().info,
        raster: renderer.raster(),
        frame,
        mask,
        label_ids,
        times,
    };
    let meta = record.to_json();
    files.extend(output::encode(&EncodeInput { frame, meta: &meta, label_ids, mask }, &records)?);
    let artifacts: Vec<_> = files.into_iter().map(|file| file.into_artifact(INDEX)).collect();
    let paths = disk::write_all(&args.out, &artifacts)?;

    let names: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    if args.json {
        print(&format!("{:#}\n", json!({ "files": names, "frame": meta })))?;
    } else {
        messages.paths(&format!("{}\n", names.join("\n")))?;
    }
    Ok((meta, paths))
}

/// Runs `work` and returns its result, with its milliseconds under the name of the stage.
fn timed<T>(stage: &'static str, work: impl FnOnce() -> Result<T>) -> Result<(T, (&'static str, f64))> {
    let start = Instant::now();
    let result = work()?;
    Ok((result, (stage, start.elapsed().as_secs_f64() * 1e3)))
}

/// Names of files in the folder that an earlier run wrote and this one did not replace.
fn older_files(folder: &Path, written: &[PathBuf]) -> Vec<String> {
    let names = OUTPUTS.iter().flat_map(|output| output.file_names(INDEX));
    names.filter(|name| folder.join(name).is_file() && !written.contains(&folder.join(name))).collect()
}

fn summarise(messages: Messages, rendered: &Rendered, meta: &Value, start: Instant) {
    let percent = |name: &str| 100.0 * meta["coverage"][name].as_f64().unwrap_or_default();
    messages.note(format_args!(
        "seed {}: regolith {:.1} %, rock {:.1} %, sky {:.1} %; RGB mean {:.1}, p99 {}, max {}; {:.2} s",
        rendered.seed,
        percent("regolith"),
        percent("rock"),
        percent("sky"),
        meta["rgb"]["mean"].as_f64().unwrap_or_default(),
        meta["rgb"]["p99"],
        meta["rgb"]["max"],
        start.elapsed().as_secs_f64()
    ));
    if !meta["moved_rocks"].as_array().is_none_or(Vec::is_empty) {
        messages.note(format_args!("rocks moved away from the camera: {}", meta["moved_rocks"]));
    }
    if meta["left_out_rocks"] != 0 {
        messages.note(format_args!("rocks left out where the camera stands: {}", meta["left_out_rocks"]));
    }
    let Rendered { renderer, times, .. } = rendered;
    let cost = renderer.last_cost();
    messages.detail(format_args!("adapter: {}", gpu::adapter::describe(&renderer.gpu().info)));
    messages.detail(format_args!(
        "drawn: {} triangles, {} bytes uploaded",
        cost.drawn_triangles, cost.uploaded_bytes
    ));
    let stages: Vec<String> = times.iter().map(|(name, ms)| format!("{name} {ms:.1}")).collect();
    messages.detail(format_args!("milliseconds: {}", stages.join(", ")));
}
