//! The command line: what may be typed, and what it means.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use regolith::class::ClassId;
use regolith::export::{self, Detail, Format, Stage};
use regolith::gpu::{self, Gpu};
use regolith::meta::FrameRecord;
use regolith::output::edges::EdgePolicy;
use regolith::output::{self, Artifact, LabelIds, Source};
use regolith::params::sampler::{self, Config};
use regolith::render::{RenderSettings, Renderer, StageTimes};
use regolith::scene::Scene;
use regolith::{Error, Result};
use serde_json::{Value, json};

const LONG_ABOUT: &str = "\
Renders labelled pictures of the Moon: from one seed a cratered, boulder-strewn lunar scene under a low hard sun, \
and from one draw its picture and the exact class of every pixel (0 regolith, 1 rock, 2 sky).

Without a subcommand it renders one frame. No display is needed; any Vulkan GPU will do, EGL too, and where there is \
no GPU Mesa's CPU driver (Debian, Ubuntu: apt-get install mesa-vulkan-drivers).";

const EXAMPLES: &str = "\
Examples:
  regolith-render --seed 42 --out out                    the nominal stage
  regolith-render --preset reference --out out           a composed frame around one boulder
  regolith-render --set sun.elevation_deg=5 --set sun.azimuth_deg=0
                                                         the sun low and in front of the camera
  regolith-render --size 1920x1080 --samples 16          larger, smoother
  regolith-render params --preset train_dr > my.toml     every knob, to be edited and given with --config

Exit status: 0 done, 2 wrong usage or configuration, 1 anything else.
Environment: WGPU_BACKEND (vulkan, gl), WGPU_ADAPTER_NAME.";

/// Labelled pictures of the Moon.
#[derive(Debug, Parser)]
#[command(version, long_about = LONG_ABOUT, args_conflicts_with_subcommands = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    frame: FrameArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List every knob with its unit, default and allowed range, as TOML that --config reads
    Params(ParamsArgs),
    /// List the GPUs and CPU drivers that can be used, best first
    Adapters {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write the stage as a file for other programs, the format by its extension: .npz, .glb, .usda
    Export(ExportArgs),
    /// Print the completion script of a shell
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
}

/// Where the values of the knobs come from, weakest first: stage, preset, file, --set.
#[derive(Args, Debug)]
struct ConfigArgs {
    /// Which stage's defaults to start from
    #[arg(long, value_name = "NAME", default_value = "nominal")]
    stage: String,
    /// A named set of knobs; `--help` lists them
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Knobs from a TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One knob, for instance sun.elevation_deg=12 or 'rocks.scale_m={uniform=[0.2,2]}'; repeatable, wins over the rest
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
}

#[derive(Args, Debug)]
struct ParamsArgs {
    #[command(flatten)]
    config: ConfigArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args, Debug)]
struct ExportArgs {
    /// The file
    file: PathBuf,
    /// Seed of the scene
    #[arg(long, value_name = "N", default_value_t = 42)]
    seed: u64,
    /// Pixels of the picture, for the camera's matrix and for --drawn: WxH, or N for a square
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = parse_size)]
    size: [u32; 2],
    #[command(flatten)]
    config: ConfigArgs,
    /// Only the triangles that a frame of this size draws or lets cast shadows, at the detail that it draws them
    #[arg(long)]
    drawn: bool,
    /// Replace the file if it is there
    #[arg(long)]
    force: bool,
}

#[derive(Args, Debug)]
struct FrameArgs {
    /// Seed of the scene, 64 bits: the same seed and knobs give the same scene on every machine
    #[arg(long, value_name = "N", default_value_t = 42)]
    seed: u64,
    /// Output folder, made if missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Pixels of the picture: WxH, or N for a square
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = parse_size)]
    size: [u32; 2],
    /// Samples per pixel: 1, 4 (2 x 2) or 16 (4 x 4)
    #[arg(long, value_name = "N", default_value_t = 4)]
    samples: u32,
    #[command(flatten)]
    config: ConfigArgs,
    /// What to write: of rgb, mask, preview, depth, normals, instances, shadow, hdr, coverage, meta; or all
    #[arg(long, value_name = "LIST", default_value_t = output::default_list())]
    outputs: String,
    /// Ids in the mask: canonical (0 regolith, 1 rock, 2 sky) or those of a Replicator pipeline
    #[arg(long, value_name = "KIND", default_value = "canonical", value_parser = ["canonical", "replicator"])]
    label_ids: String,
    /// What the mask says where classes meet: hard, or ignore:N for 255 within N pixels of another class
    #[arg(long, value_name = "RULE", default_value = "hard")]
    edges: String,
    /// Use the adapter with this in its name, or `cpu`
    #[arg(long, value_name = "TEXT")]
    adapter: Option<String>,
    /// Allow writing into a folder that has other content
    #[arg(long)]
    force: bool,
    /// Print the frame's record and the paths of its files as JSON on stdout
    #[arg(long)]
    json: bool,
    /// Say more: adapter, device times
    #[arg(short, long, conflicts_with = "quiet")]
    verbose: bool,
    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// The command line, its help complete with the presets that ship.
fn command() -> clap::Command {
    let presets: String = sampler::presets()
        .iter()
        .map(|(name, _)| format!("  {name:<15} {}\n", sampler::preset_description(name).unwrap_or_default()))
        .collect();
    Cli::command().after_long_help(format!("Presets:\n{presets}\n{EXAMPLES}"))
}

/// Parses the command line and does what it says.
pub(crate) fn run() -> Result<()> {
    let cli = Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    match cli.command {
        None => render_frame(&cli.frame),
        Some(Command::Params(args)) => list_params(&args),
        Some(Command::Adapters { json }) => list_adapters(json),
        Some(Command::Export(args)) => export_stage(&args),
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut command(), "regolith-render", &mut script);
            print(&String::from_utf8_lossy(&script))
        }
    }
}

impl ConfigArgs {
    fn build(&self) -> Result<Config> {
        let mut config = Config::new();
        config.set_stage(&self.stage)?;
        if let Some(preset) = &self.preset {
            config.apply_preset(preset)?;
        }
        if let Some(path) = &self.config {
            config.apply_file(path)?;
        }
        for assignment in &self.set {
            config.apply_set(assignment)?;
        }
        config.check()?;
        Ok(config)
    }
}

fn render_frame(args: &FrameArgs) -> Result<()> {
    const INDEX: u64 = 0;
    let start = Instant::now();
    let params = args.config.build()?.draw(args.seed)?;
    let outputs = output::parse_outputs(&args.outputs)?;
    let mut settings = RenderSettings::new(args.size, args.samples)?;
    settings.annotations = output::annotations(&outputs);
    let edges: EdgePolicy = args.edges.parse()?;
    output::check_folder(&args.out, INDEX, args.force)?;
    let label_ids = if args.label_ids == "replicator" { LabelIds::Replicator } else { LabelIds::Canonical };

    let mut times: StageTimes = Vec::new();
    let mut last = Instant::now();
    let mut stage = |times: &mut StageTimes, name| {
        let now = Instant::now();
        times.push((name, (now - last).as_secs_f64() * 1e3));
        last = now;
    };
    let scene = Scene::build(args.seed, &params)?;
    stage(&mut times, "scene");
    let gpu = Gpu::open(args.adapter.as_deref())?;
    stage(&mut times, "adapter");
    let mut renderer = Renderer::new(gpu)?;
    stage(&mut times, "pipelines");
    if std::env::var("REGOLITH_FAULT").is_ok_and(|fault| fault == "device-lost") {
        // What happens to a user whose GPU is pulled away, on demand: for tests of this program and of scripts.
        renderer.gpu().device.destroy();
    }
    let (frame, render_times) = renderer.render(&scene, &settings)?;
    // The renderer tells its own stages apart.
    stage(&mut StageTimes::new(), "render");
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
            frame: &frame,
            edges,
            times,
        }
        .to_json()
    };
    // The pictures first, so that the record can tell what encoding them took.
    let (pictures, records): (Vec<_>, Vec<_>) = outputs.into_iter().partition(|output| output.name != "meta");
    let mut artifacts =
        output::encode(&Source { frame: &frame, meta: &Value::Null, label_ids, edges }, &pictures, INDEX)?;
    stage(&mut times, "encode");
    let meta = record(&times);
    artifacts.extend(output::encode(
        &Source { frame: &frame, meta: &meta, label_ids, edges },
        &records,
        INDEX,
    )?);
    let paths = output::write_all(&args.out, &artifacts)?;

    let shown: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    if args.json {
        print(&format!("{:#}\n", json!({ "files": shown, "frame": meta })))?;
    } else {
        print(&format!("{}\n", shown.join("\n")))?;
    }
    if !args.quiet {
        summarise(args, &renderer, &meta, &times, start);
    }
    Ok(())
}

#[expect(clippy::print_stderr, reason = "messages to people go to stderr")]
fn summarise(args: &FrameArgs, renderer: &Renderer, meta: &Value, times: &StageTimes, start: Instant) {
    let share = |name: &str| 100.0 * meta["coverage"][name].as_f64().unwrap_or_default();
    eprintln!(
        "seed {}: regolith {:.1} %, rock {:.1} %, sky {:.1} %; RGB mean {:.1}, p99 {}, max {}; {:.2} s",
        args.seed,
        share("regolith"),
        share("rock"),
        share("sky"),
        meta["rgb"]["mean"].as_f64().unwrap_or_default(),
        meta["rgb"]["p99"],
        meta["rgb"]["max"],
        start.elapsed().as_secs_f64()
    );
    if !meta["moved_rocks"].as_array().is_none_or(Vec::is_empty) {
        eprintln!("moved away from the camera: rocks {}", meta["moved_rocks"]);
    }
    if args.verbose {
        let scene = renderer.gpu_scene();
        eprintln!("adapter: {}", gpu::describe(&renderer.gpu().info));
        eprintln!("drawn: {} triangles, {} bytes uploaded", scene.drawn_triangles(), scene.uploaded_bytes);
        let stages: Vec<String> = times.iter().map(|(name, ms)| format!("{name} {ms:.1}")).collect();
        eprintln!("milliseconds: {}", stages.join(", "));
    }
}

fn export_stage(args: &ExportArgs) -> Result<()> {
    let format = Format::from_path(&args.file)?;
    if args.file.exists() && !args.force {
        return Err(Error::Usage(format!("{} exists; add --force to replace it", args.file.display())));
    }
    let params = args.config.build()?.draw(args.seed)?;
    let settings = RenderSettings::new(args.size, 1)?;
    let scene = Scene::build(args.seed, &params)?;
    let detail = if args.drawn { Detail::Drawn } else { Detail::Authored };
    let knobs = params.to_json();
    let stage = Stage { scene: &scene, seed: args.seed, knobs: &knobs, settings: &settings, detail };
    let bytes = export::export(&stage, format)?;
    let name = args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = args.file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    output::write_all(folder, &[Artifact { name, bytes }])?;
    print(&format!("{}\n", args.file.display()))
}

fn list_params(args: &ParamsArgs) -> Result<()> {
    let config = args.config.build()?;
    if args.json { print(&format!("{:#}\n", config.to_json())) } else { print(&config.to_toml()) }
}

fn list_adapters(as_json: bool) -> Result<()> {
    let infos = gpu::adapters();
    if infos.is_empty() {
        return Err(Error::NoAdapter(String::new()));
    }
    if as_json {
        let rows: Vec<Value> = infos
            .iter()
            .map(|info| {
                json!({
                    "name": info.name,
                    "kind": gpu::kind(info),
                    "backend": info.backend.to_string(),
                    "driver": info.driver,
                    "driver_info": info.driver_info,
                })
            })
            .collect();
        return print(&format!("{:#}\n", Value::from(rows)));
    }
    print(&infos.iter().map(|info| format!("{}\n", gpu::describe(info))).collect::<String>())
}

/// Prints a result; a reader that has gone away (`| head`) is no error.
fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(cause) if cause.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::Write { path: Path::new("standard output").to_owned(), cause })
        }
        _ => Ok(()),
    }
}

fn parse_size(text: &str) -> std::result::Result<[u32; 2], String> {
    let side =
        |part: &str| part.trim().parse::<u32>().map_err(|_| format!("`{part}` is not a number of pixels"));
    match text.split_once(['x', 'X']) {
        Some((width, height)) => Ok([side(width)?, side(height)?]),
        None => side(text).map(|n| [n, n]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent_and_every_option_has_help() {
        command().help_expected(true).debug_assert();
    }

    #[test]
    fn the_help_names_every_preset_and_output() {
        let help = command().render_long_help().to_string();
        for (name, _) in sampler::presets() {
            assert!(help.contains(name), "preset {name}");
        }
        for output in &output::OUTPUTS {
            assert!(help.contains(output.name), "output {}", output.name);
        }
    }

    #[test]
    fn sizes_are_one_number_or_two() {
        assert_eq!(parse_size("640x480"), Ok([640, 480]));
        assert_eq!(parse_size("256"), Ok([256, 256]));
        assert!(parse_size("0x").is_err() && parse_size("-5").is_err() && parse_size("big").is_err());
    }
}
