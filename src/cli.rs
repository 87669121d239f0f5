//! The command line: what may be typed, and what it means.
//!
//! Here is what the subcommands share; each has its file in `cli/`.

mod bench;
mod convert;
mod dataset;
mod device;
mod frame;
pub(crate) mod progress;
mod remap;
mod stage;
mod verify;

use std::fmt::Display;
use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use regolith::dataset::rules::Rules;
use regolith::output::LabelIds;
use regolith::output::edges::EdgePolicy;
use regolith::params::sampler::{self, Config};
use regolith::render::{RasterMode, RenderSettings, Renderer};
use regolith::{Error, Result};

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
  regolith-render dataset --count 1500 --preset train_dr --out data/train
                                                         a dataset; run it again to go on after a stop
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
    frame: frame::FrameArgs,
    #[command(flatten)]
    messages: Messages,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a labelled dataset: thousands of randomised frames, checked, resumable, reproducible by number
    Dataset(Box<dataset::DatasetArgs>),
    /// Measure how fast frames come, case by case and stage by stage, as a table or as JSON
    Bench(Box<bench::BenchArgs>),
    /// Check a dataset: files, hashes, masks, statistics, a sample rendered again; exit status 1 if anything is wrong
    Verify(verify::VerifyArgs),
    /// Write a finished dataset in another format, without rendering
    Convert(convert::ConvertArgs),
    /// Turn masks of a Replicator pipeline into canonical ones, by the names in their label files
    Remap(remap::RemapArgs),
    /// List every knob with its unit, default and allowed range, as TOML that --config reads
    Params(stage::ParamsArgs),
    /// List the GPUs and CPU drivers that can be used, best first
    Adapters {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write the stage as a file for other programs, the format by its extension: .npz, .glb, .usda, .usdc
    Export(stage::ExportArgs),
    /// Print the completion script of a shell
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
}

/// Where the values of the knobs come from, weakest first: stage, preset, file, --set.
#[derive(Args, Debug)]
struct ConfigArgs {
    /// Which stage to show: nominal or surface [default: that of the preset or the file, else nominal]
    #[arg(long, value_name = "NAME")]
    stage: Option<String>,
    /// A named set of knobs, or several, separated by commas, the later over the earlier; `regolith-render --help` lists them
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Knobs from a TOML file; `-` is standard input
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One knob, for instance sun.elevation_deg=12 or 'rocks.scale_m={uniform=[0.2,2]}'; repeatable, wins over the rest
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
}

/// How much every command tells people, on stderr.
#[derive(Args, Clone, Copy, Debug)]
struct Messages {
    /// Say more: adapter, milliseconds by stage
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// Say nothing but errors
    #[arg(short, long, global = true)]
    quiet: bool,
}

impl Messages {
    /// A line for people, unless they want none.
    fn note(self, text: impl Display) {
        if !self.quiet {
            progress::note(text);
        }
    }

    /// A line for people who want more.
    fn detail(self, text: impl Display) {
        if self.verbose {
            progress::note(text);
        }
    }
}

/// What concerns the picture and its labels.
#[derive(Args, Debug)]
struct PictureArgs {
    /// Pixels of the picture: WxH, or N for a square
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = parse_size, allow_hyphen_values = true)]
    size: [u32; 2],
    /// Samples per pixel: 1, 4 (2 x 2) or 16 (4 x 4)
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = whole::<u32>(0, u32::MAX.into()), allow_negative_numbers = true)]
    samples: u32,
    /// Ids in the mask: canonical (0 regolith, 1 rock, 2 sky) or those of a Replicator pipeline
    #[arg(long, value_name = "KIND", default_value = "canonical", value_parser = ["canonical", "replicator"])]
    label_ids: String,
    /// What the mask says where classes meet: hard, or ignore:N for 255 within N pixels of another class
    #[arg(long, value_name = "RULE", default_value = "hard")]
    edges: String,
    /// Use the adapter with this in its name, or `cpu`
    #[arg(long, value_name = "TEXT")]
    adapter: Option<String>,
    /// Rasterise on the device or on the host: auto is the host on a software adapter, else the device
    #[arg(long, value_name = "auto|device|host", default_value_t = RasterMode::Auto)]
    raster: RasterMode,
}

impl PictureArgs {
    fn settings(&self) -> Result<RenderSettings> {
        RenderSettings::new(self.size, self.samples)
    }

    fn label_ids(&self) -> LabelIds {
        LabelIds::from_name(&self.label_ids).unwrap_or_default()
    }

    fn edges(&self) -> Result<EdgePolicy> {
        self.edges.parse()
    }
}

/// The command line, its help complete with the presets that ship.
fn command() -> clap::Command {
    let presets: String = sampler::presets()
        .iter()
        .map(|(name, _)| format!("  {name:<22} {}\n", sampler::preset_description(name).unwrap_or_default()))
        .collect();
    let formats = dataset::formats_help();
    Cli::command()
        .after_long_help(format!("Presets:\n{presets}\n{EXAMPLES}"))
        .mut_subcommand("dataset", |dataset| dataset.after_help(formats.clone()))
        .mut_subcommand("convert", |convert| convert.after_help(formats))
}

/// Parses the command line and does what it says.
pub(crate) fn run() -> Result<()> {
    let cli = Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    match cli.command {
        None => frame::run(&cli.frame, cli.messages),
        Some(Command::Dataset(args)) => dataset::run(&args, cli.messages),
        Some(Command::Bench(args)) => bench::run(&args, cli.messages),
        Some(Command::Verify(args)) => verify::run(&args, cli.messages),
        Some(Command::Convert(args)) => convert::run(&args, cli.messages),
        Some(Command::Remap(args)) => remap::run(&args, cli.messages),
        Some(Command::Params(args)) => stage::list_params(&args),
        Some(Command::Adapters { json }) => stage::list_adapters(json),
        Some(Command::Export(args)) => stage::export_stage(&args, cli.messages),
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
        if let Some(stage) = &self.stage {
            config.set_stage(stage)?;
        }
        for preset in self.preset.iter().flat_map(|names| names.split(',')) {
            config.apply_preset(preset.trim())?;
        }
        if let Some(path) = &self.config {
            config.apply_file(path)?;
        }
        for assignment in &self.set {
            config.apply_set(assignment)?;
        }
        if let Some(stage) = &self.stage {
            config.check_stage(stage)?;
        }
        config.check()?;
        // A frame alone has no rules to keep, but a wrong one is wrong everywhere.
        Rules::from_config(&config)?;
        Ok(config)
    }
}

/// What happens to a user whose GPU is pulled away, on demand: for tests of this program and of scripts.
fn inject_fault(renderer: &Renderer) {
    if std::env::var("REGOLITH_FAULT").is_ok_and(|fault| fault == "device-lost") {
        renderer.gpu().device.destroy();
    }
}

/// Prints a result; a reader that has gone away (`| head`) is no error.
fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(cause) if cause.kind() != std::io::ErrorKind::BrokenPipe => Err(Error::Stdout(cause)),
        _ => Ok(()),
    }
}

fn parse_size(text: &str) -> std::result::Result<[u32; 2], String> {
    let (width, height) = text.split_once(['x', 'X']).unwrap_or((text, text));
    let side = |part: &str| part.trim().parse().map_err(|_| "the form is WxH or N, pixels".to_owned());
    Ok([side(width)?, side(height)?])
}

/// Reads a whole number between two, both included. (What clap has for it names them for some types only.)
fn whole<T: TryFrom<u64>>(
    least: u64,
    most: u64,
) -> impl Fn(&str) -> std::result::Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.trim().parse().ok().filter(|number| (least..=most).contains(number));
        let refused = || format!("it should be a whole number from {least} to {most}");
        number.and_then(|number| T::try_from(number).ok()).ok_or_else(refused)
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
    fn every_command_takes_the_options_for_messages() {
        let mut command = command();
        command.build();
        for command in [&command].into_iter().chain(command.get_subcommands()) {
            for name in ["verbose", "quiet"] {
                let takes = command.get_arguments().any(|option| option.get_id() == name);
                assert!(takes || command.get_name() == "help", "{}: --{name}", command.get_name());
            }
        }
    }

    #[test]
    fn the_help_names_every_preset_and_output() {
        let help = command().render_long_help().to_string();
        for (name, _) in sampler::presets() {
            assert!(help.contains(name), "preset {name}");
        }
        for output in &regolith::output::OUTPUTS {
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
