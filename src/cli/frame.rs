//! One frame: the command without a subcommand.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use regolith::class::ClassId;
use regolith::dataset::rules::Rules;
use regolith::gpu;
use regolith::meta::FrameRecord;
use regolith::output::{self, EncodeInput, OUTPUTS, disk};
use regolith::render::{Renderer, StageTimes, select::selection};
use regolith::scene::Scene;
use regolith::{Error, Result};
use serde_json::{Value, json};

use super::{ConfigArgs, Messages, PictureArgs, device, print, whole};

#[derive(Args, Debug)]
pub(super) struct FrameArgs {
    /// Seed of the scene, 64 bits: the same seed and knobs give the same scene on every machine
    #[arg(long, value_name = "N", default_value_t = 42, value_parser = whole::<u64>(0, u64::MAX), allow_negative_numbers = true)]
    seed: u64,
    /// Output folder, made if missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    picture: PictureArgs,
    /// What to write: of rgb, mask, preview, depth, normals, instances, shadow, hdr, coverage, slope, craters, angles, five_classes, rock_sizes, meta; or all
    #[arg(long, value_name = "LIST", default_value_t = output::default_list())]
    outputs: String,
    /// Allow writing into a folder that has other content
    #[arg(long)]
    force: bool,
    /// Print the frame's record and the paths of its files as JSON on stdout
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &FrameArgs, messages: Messages) -> Result<()> {
    const INDEX: u64 = 0;
    let start = Instant::now();
    let config = args.config.build()?;
    let params = config.draw(args.seed)?;
    let outputs = output::parse_outputs(&args.outputs)?;
    let mut settings = args.picture.settings()?;
    settings.annotations = output::annotations(&outputs);
    let (label_ids, edges) = (args.picture.label_ids(), args.picture.edges()?);
    output::check_folder(&args.out, INDEX, args.force)?;

    // The device is opened while the scene is built.
    let (scene, renderer) = rayon::join(
        || {
            timed("scene", || {
                let scene = Scene::build(args.seed, &params)?;
                selection::build_rocks(&scene, &settings);
                Ok(scene)
            })
        },
        || -> Result<_> {
            let (gpu, adapter) = timed("adapter", || device::open(args.picture.adapter.as_deref()))?;
            let (renderer, pipelines) =
                timed("pipelines", || Renderer::with_raster(gpu, args.picture.raster))?;
            Ok((renderer, [adapter, pipelines]))
        },
    );
    let (scene, built) = scene?;
    let (mut renderer, opened) = renderer?;
    let mut times: StageTimes = [built].into_iter().chain(opened).collect();
    super::inject_fault(&renderer);
    let (frame, render_times) = renderer.render(&scene, &settings)?;
    times.extend(render_times);
    let unlabelled = frame.count(ClassId::UNLABELLED);
    if unlabelled > 0 {
        return Err(Error::Unlabelled { pixels: unlabelled, seed: args.seed });
    }
    let record = |times: &StageTimes| {
        let adapter = &renderer.gpu().info;
        FrameRecord {
            seed: args.seed,
            params: &params,
            scene: &scene,
            settings: &settings,
            adapter,
            raster: renderer.raster(),
            frame: &frame,
            edges,
            times,
        }
        .to_json()
    };
    // The pictures first, so that the record can tell what encoding them took.
    let (pictures, records): (Vec<_>, Vec<_>) = outputs.into_iter().partition(|output| output.name != "meta");
    let input = EncodeInput { frame: &frame, meta: &Value::Null, label_ids, edges };
    let (mut files, encoded) = timed("encode", || output::encode(&input, &pictures))?;
    times.push(encoded);
    let meta = record(&times);
    files.extend(output::encode(&EncodeInput { frame: &frame, meta: &meta, label_ids, edges }, &records)?);
    let artifacts: Vec<_> = files.into_iter().map(|file| file.into_artifact(INDEX)).collect();
    let paths = disk::write_all(&args.out, &artifacts)?;

    let shown: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    if args.json {
        print(&format!("{:#}\n", json!({ "files": shown, "frame": meta })))?;
    } else {
        print(&format!("{}\n", shown.join("\n")))?;
    }
    summarise(args, messages, &renderer, &meta, &times, start);
    if let Some(violation) = Rules::from_config(&config)?.violation(&scene, &frame) {
        messages.note(format_args!(
            "a dataset would draw this frame again: {} ({})",
            violation.found, violation.rule
        ));
    }
    let others: Vec<String> = OUTPUTS
        .iter()
        .flat_map(|output| output.file_names(INDEX))
        .filter(|name| args.out.join(name).is_file() && !paths.contains(&args.out.join(name)))
        .collect();
    if !others.is_empty() {
        messages.note(format_args!("older files beside these, of another picture: {}", others.join(", ")));
    }
    device::store_pipelines(renderer.gpu());
    Ok(())
}

/// What work comes to, and its milliseconds under a stage's name.
fn timed<T>(stage: &'static str, work: impl FnOnce() -> Result<T>) -> Result<(T, (&'static str, f64))> {
    let start = Instant::now();
    let done = work()?;
    Ok((done, (stage, start.elapsed().as_secs_f64() * 1e3)))
}

fn summarise(
    args: &FrameArgs,
    messages: Messages,
    renderer: &Renderer,
    meta: &Value,
    times: &StageTimes,
    start: Instant,
) {
    let share = |name: &str| 100.0 * meta["coverage"][name].as_f64().unwrap_or_default();
    messages.note(format_args!(
        "seed {}: regolith {:.1} %, rock {:.1} %, sky {:.1} %; RGB mean {:.1}, p99 {}, max {}; {:.2} s",
        args.seed,
        share("regolith"),
        share("rock"),
        share("sky"),
        meta["rgb"]["mean"].as_f64().unwrap_or_default(),
        meta["rgb"]["p99"],
        meta["rgb"]["max"],
        start.elapsed().as_secs_f64()
    ));
    if !meta["moved_rocks"].as_array().is_none_or(Vec::is_empty) {
        messages.note(format_args!("moved away from the camera: rocks {}", meta["moved_rocks"]));
    }
    let cost = renderer.last_cost();
    messages.detail(format_args!("adapter: {}", gpu::adapter::describe(&renderer.gpu().info)));
    messages.detail(format_args!(
        "drawn: {} triangles, {} bytes uploaded",
        cost.drawn_triangles, cost.uploaded_bytes
    ));
    let stages: Vec<String> = times.iter().map(|(name, ms)| format!("{name} {ms:.1}")).collect();
    messages.detail(format_args!("milliseconds: {}", stages.join(", ")));
}
