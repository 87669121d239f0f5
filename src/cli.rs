//! The command line: the commands, their help, and the call that each stands for. The binary and the Python package run the same.
//!
//! Each command has its file in `cli/`; options that several share are in `args`.

mod add_outputs;
mod args;
mod bench;
mod child;
mod convert;
mod dataset;
mod device;
mod doctor;
mod frame;
mod knobs;
mod messages;
mod panics;
mod process;
mod progress;
mod remap;
mod stage;
mod verify;

use std::ffi::OsString;
use std::io::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::{Error, Result};
use crate::params::{KNOBS, presets};
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use args::pass_negative_numbers;
use messages::{Messages, note, print};
use process::stopped_status;

const LONG_ABOUT: &str = "\
Renders labelled images of the Moon: a seed gives a cratered, boulder-strewn scene under a low sun, and one draw gives \
its image and the exact class of every pixel (0 regolith, 1 rock, 2 sky).

Without a subcommand it renders one frame. It needs no display. Any Vulkan or EGL driver will do; without a GPU, Mesa's \
CPU driver (Debian, Ubuntu: apt-get install mesa-vulkan-drivers).";

const EXAMPLES: &str = "\
Examples:
  regolith-render --seed 42 --out out                    a frame of the nominal stage
  regolith-render --preset reference --out out           a composed frame around one boulder
  regolith-render --set sun.elevation_deg=5 --set sun.azimuth_deg=0
                                                         a low sun in front of the camera
  regolith-render --size 1920x1080 --samples 16          larger, with smoother edges
  regolith-render dataset --count 1500 --preset train_dr --out data/train
                                                         a dataset; run it again to resume after a stop
  regolith-render params --preset train_dr > my.toml     every knob, to be edited and passed to --config
  regolith-render --config out/frame_0000.json           the frame of a record again, byte for byte

Exit status: 0 success, 2 wrong usage or configuration, 130, 143 and 129 stopped by Ctrl-C, the signal TERM or HUP, 1 any other error.
Environment: WGPU_BACKEND (vulkan, gl), WGPU_ADAPTER_NAME.
`regolith-render doctor` says why a GPU is not used, and whether the labels of this machine are right.";

/// Labelled images of the Moon.
#[derive(Debug, Parser)]
#[command(version, long_about = LONG_ABOUT, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    frame: frame::FrameArgs,
    #[command(flatten)]
    messages: Messages,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a labelled dataset: randomised frames, checked, resumable, each reproducible from its index
    Dataset(Box<dataset::DatasetArgs>),
    /// Measure frame throughput by case and stage, as a table or as JSON
    ///
    /// The column "host ms" (host_ms in JSON) is the processor time of the program's own threads for a frame, where the system reports
    /// it (Linux does): without that of a driver's threads, with that of its calls. "CPU ms" (process_ms) is that of the whole process,
    /// "peak MB" (peak_rss_bytes) its peak resident memory so far. With --preset or --config a dataset's rules apply in the cases frames
    /// and dataset, and what it redraws is part of the time of their frames.
    Bench(Box<bench::BenchArgs>),
    /// Check a dataset: files, hashes, masks, statistics, some frames rendered again; exit status 1 if a check fails
    Verify(verify::VerifyArgs),
    /// Write a finished dataset in another format, without rendering
    Convert(convert::ConvertArgs),
    /// Convert masks of a Replicator pipeline to canonical ids, by the names in their label files
    Remap(remap::RemapArgs),
    /// List every knob with its unit, default and allowed range, as TOML for --config; or those of a section, or one
    Params(knobs::ParamsArgs),
    /// List the presets with a line each, or print one
    Presets(knobs::PresetsArgs),
    /// List the usable GPUs and CPU drivers, best first
    Adapters {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Examine this machine: GPUs, drivers, containers; render test frames with every backend and compare them; exit status 1 if
    /// labels are not right
    Doctor(doctor::DoctorArgs),
    /// Export the stage for other software, in the format of the file's extension: .npz, .glb, .usda or .usdc
    Export(stage::ExportArgs),
    /// Print the completion script for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// The command line, with presets and dataset formats in its help.
fn command() -> clap::Command {
    let formats = dataset::formats_help();
    pass_negative_numbers(Cli::command())
        .after_long_help(format!(
            "Presets (`regolith-render presets NAME` prints one):\n{}\nKnobs (`regolith-render params SECTION` lists those of a \
             section):\n{}\n{EXAMPLES}",
            knobs::presets_help(),
            knobs::groups_help()
        ))
        .mut_subcommand("dataset", |dataset| dataset.after_help(formats.clone()))
        .mut_subcommand("convert", |convert| convert.after_help(formats))
}

/// The command line with the values that a shell can complete; some of these options take others too, such as lists.
fn with_completions(command: clap::Command) -> clap::Command {
    let values = |option: &str| -> Vec<&'static str> {
        match option {
            "preset" | "name" => presets::presets().iter().map(|(name, _)| *name).collect(),
            "format" => crate::output::layout::LAYOUTS.iter().map(|row| row.name).collect(),
            "outputs" => crate::output::OUTPUTS.iter().map(|output| output.name).chain(["all"]).collect(),
            "adapter" => vec!["cpu", "nvidia", "amd", "intel", "apple", "llvmpipe"],
            "stage" => crate::params::Stage::ALL.iter().map(|(_, name)| *name).collect(),
            "raster" => crate::render::RasterMode::names().to_vec(),
            "edges" => vec!["hard", "ignore:1", "ignore:2"],
            "knob" => {
                let mut sections: Vec<&str> = KNOBS.iter().map(crate::params::KnobInfo::section).collect();
                sections.dedup();
                sections.into_iter().chain(KNOBS.iter().map(|info| info.name)).collect()
            }
            _ => Vec::new(),
        }
    };
    let complete = move |arg: clap::Arg| {
        let values = values(arg.get_id().as_str());
        if values.is_empty() { arg } else { arg.default_value(None).value_parser(values) }
    };
    command.mut_args(complete).mut_subcommands(with_completions)
}

/// Runs the command of a command line, whose first word is the name of the program, and returns its exit status. `itself` starts
/// regolith-render again, for commands that work in processes of their own.
///
/// A lost device is a panic inside wgpu; the library catches it and returns an error. Any other panic is a bug of regolith-render and is
/// reported as one, without a backtrace.
pub fn main(words: impl IntoIterator<Item = OsString>, itself: &dyn Fn() -> std::process::Command) -> u8 {
    std::panic::set_hook(Box::new(panics::remember));
    match catch_unwind(AssertUnwindSafe(|| run(words, itself))) {
        Ok(Ok(())) => 0,
        Ok(Err(Ending::Status(status))) => status,
        Ok(Err(Ending::Error(error))) => {
            note(format_args!("error: {error}{}", error.advice()));
            let stopped = matches!(error, Error::Stopped { .. }).then(stopped_status).flatten();
            stopped.unwrap_or_else(|| error.exit_status())
        }
        Err(panic) => {
            let text = panics::message(&*panic);
            note(format_args!(
                "error: this is a bug in regolith-render; please report it together with the command you ran: {text}"
            ));
            1
        }
    }
}

/// Why a command line was not carried out.
enum Ending {
    /// An error of the command.
    Error(Error),
    /// Help, the version or a wrong word was printed.
    Status(u8),
}

impl From<Error> for Ending {
    fn from(error: Error) -> Self {
        Self::Error(error)
    }
}

/// Parses the command line and runs the command.
fn run(
    words: impl IntoIterator<Item = OsString>,
    itself: &dyn Fn() -> std::process::Command,
) -> std::result::Result<(), Ending> {
    process::survive_file_size_limit();
    let parsed = command().try_get_matches_from(words).and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = parsed.map_err(|error| print_usage(&error))?;
    // A process that `doctor` examines shows the signal.
    if !matches!(&cli.command, Some(Command::Doctor(args)) if args.is_step()) {
        process::fail_on_abort();
    }
    Ok(run_command(cli, itself)?)
}

/// Prints help or the version, which are results on stdout, or what is wrong with a command line, on stderr.
fn print_usage(error: &clap::Error) -> Ending {
    match error.print().and_then(|()| std::io::stdout().flush()) {
        // A closed pipe is no error.
        Err(cause) if !error.use_stderr() && cause.kind() != std::io::ErrorKind::BrokenPipe => {
            Ending::Error(Error::Stdout(cause))
        }
        _ => Ending::Status(error.exit_code() as u8),
    }
}

fn run_command(cli: Cli, itself: &dyn Fn() -> std::process::Command) -> Result<()> {
    match cli.command {
        None => frame::run(&cli.frame, cli.messages),
        Some(Command::Dataset(args)) => dataset::run(&args, cli.messages),
        Some(Command::Bench(args)) => bench::run(&args, cli.messages),
        Some(Command::Verify(args)) => verify::run(&args, cli.messages),
        Some(Command::Convert(args)) => convert::run(&args, cli.messages),
        Some(Command::Remap(args)) => remap::run(&args, cli.messages),
        Some(Command::Params(args)) => knobs::list_params(&args),
        Some(Command::Presets(args)) => knobs::list_presets(&args),
        Some(Command::Adapters { json }) => stage::list_adapters(json),
        Some(Command::Doctor(args)) => doctor::run(&args, itself, cli.messages),
        Some(Command::Export(args)) => stage::export_stage(&args, cli.messages),
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut with_completions(command()), "regolith-render", &mut script);
            // The generator takes the hyphen of the program's name for a level of subcommands in the labels of the branches.
            let script =
                String::from_utf8_lossy(&script).replace("regolith__subcmd__render", "regolith__render");
            print(&script)
        }
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
    fn every_command_has_verbose_and_quiet() {
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
        for (name, _) in presets::presets() {
            assert!(help.contains(name), "preset {name}");
        }
        for output in &crate::output::OUTPUTS {
            assert!(help.contains(output.name), "output {}", output.name);
        }
    }
}
