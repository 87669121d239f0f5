//! `bench`: frame throughput.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::bench::{self, Case, Curve, Measured, SWEEPS, Setup};
use crate::dataset::plan::Plan;
use crate::dataset::rules::Rules;
use crate::dataset::{Concurrency, cores};
use crate::error::{Error, Result};
use crate::output::{self, Artifact, disk};
use crate::params::Knob;
use crate::render::{LightingMode, Renderer};
use clap::Args;
use serde_json::{Map, Value, json};

use super::args::{ConfigArgs, DEFAULT_SEED, DeviceArgs, ImageArgs, whole_number};
use super::device;
use super::messages::{Messages, frames, print};
use super::process::stop_on_signals;

/// What a plot begins with.
const SVG: [u8; 4] = *b"<svg";

#[derive(Args, Debug)]
pub(super) struct BenchArgs {
    /// Cases to measure, separated by commas; --help lists them
    #[arg(long, value_name = "LIST", default_value = "camera,static-sun,scene,dataset", long_help = list_of_cases())]
    cases: String,
    /// Number of frames of each case, after a warm-up
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = whole_number::<u64>(1, 1_000_000))]
    frames: u64,
    /// Base seed [default: 42, or that of the record]
    #[arg(long, value_name = "N", value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    image: ImageArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Outputs to read back (and to write, in the case dataset), as for a frame
    #[arg(long, value_name = "LIST", default_value = "rgb,mask")]
    outputs: String,
    /// Threads that build scenes, plan frames, post-process and encode, in the cases poses, frames and dataset [default: one
    /// for each core, with a software adapter one for every two]
    #[arg(long, value_name = "N", value_parser = whole_number::<u16>(1, 256))]
    threads: Option<u16>,
    /// Frames that the device works on at the same time [default: 2; in the cases poses, frames and dataset of the surface stage 1, on a software
    /// adapter with one thread]
    #[arg(long, value_name = "N", value_parser = whole_number::<u8>(1, 16))]
    frames_in_flight: Option<u8>,
    /// Measure one case for several values of one setting, and plot the result: size, samples, rocks (of the nominal stage) or
    /// frames-in-flight for the first of --cases, threads for the case dataset
    #[arg(long, value_name = "NAME", value_parser = SWEEPS)]
    sweep: Option<String>,
    /// File for the plot of the sweep [default: sweep.svg]
    #[arg(
        long,
        value_name = "FILE.svg",
        requires = "sweep",
        default_value_if("sweep", clap::builder::ArgPredicate::IsPresent, "sweep.svg")
    )]
    plot: Option<PathBuf>,
    /// How lighting is divided into draws: bins (one for each kind of surface, selected by the stencil), one-draw (all at once) or
    /// compute (all in a compute pass); the last two need --raster device or compute where that is not the default [default: compute on
    /// NVIDIA's Hopper, bins with --raster device on a software adapter and with --raster host, else one-draw]
    #[arg(long, value_name = "bins|one-draw|compute")]
    lighting: Option<LightingMode>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &BenchArgs, messages: Messages) -> Result<()> {
    let cases = parse_cases(&args.cases)?;
    check_sweep(args, messages)?;
    let setup = setup(args, messages)?;
    let mut renderer = args.device.renderer(args.device.open(messages)?)?;
    if let Some(lighting) = args.lighting {
        renderer.set_raster(renderer.raster().with_lighting(lighting, renderer.gpu())?);
    }
    match &args.sweep {
        Some(name) => sweep(args, messages, name, cases[0], &setup, &mut renderer),
        None => measure(args, messages, &cases, &setup, &mut renderer),
    }?;
    device::store_pipelines(renderer.gpu());
    Ok(())
}

/// Checks, before anything is measured, that the plot replaces nothing but a plot, and notes an option that sets what is swept.
fn check_sweep(args: &BenchArgs, messages: Messages) -> Result<()> {
    let Some(name) = args.sweep.as_deref() else { return Ok(()) };
    let is_set = match name {
        "samples" => args.image.has_samples(),
        "threads" => args.threads.is_some(),
        "frames-in-flight" => args.frames_in_flight.is_some(),
        _ => false,
    };
    if is_set {
        messages.note(format_args!("--{name} is not used: --sweep {name} measures several values of it"));
    }
    let plot = args.plot.clone().unwrap_or_default();
    if plot.is_dir() || plot.file_name().is_none() {
        return Err(Error::Usage(format!("--plot {}: it is a folder; name a file in it", plot.display())));
    }
    let has_content = plot.metadata().is_ok_and(|file| file.is_file() && file.len() > 0);
    if has_content && !is_svg(&plot) {
        return Err(Error::Usage(format!(
            "--plot {}: this file exists and is no plot; name another",
            plot.display()
        )));
    }
    Ok(())
}

fn is_svg(path: &Path) -> bool {
    let mut start = [0; SVG.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == SVG
}

fn list_of_cases() -> String {
    let line = |(_, name, what): &(Case, &str, &str)| format!("\n  {name:<10}  {what}");
    "Cases to measure, separated by commas:".to_owned() + &Case::ALL.iter().map(line).collect::<String>()
}

fn parse_cases(list: &str) -> Result<Vec<Case>> {
    let mut cases = Vec::new();
    for word in list.split(',').map(str::trim) {
        let known = Case::ALL.iter().find(|row| row.1 == word);
        let &(case, ..) = known.ok_or_else(|| {
            let names: Vec<&str> = Case::ALL.iter().map(|row| row.1).collect();
            Error::Usage(format!("--cases: unknown case `{word}`; the cases are {}", names.join(", ")))
        })?;
        // One that is named twice is measured once.
        if !cases.contains(&case) {
            cases.push(case);
        }
    }
    Ok(cases)
}

fn setup(args: &BenchArgs, messages: Messages) -> Result<Setup> {
    let (config, origin) = args.config.build()?;
    let outputs = output::parse_outputs(&args.outputs)?;
    // What is measured of a preset or of a file is the dataset that it makes, redraws included.
    let rules =
        if args.config.is_named() { Rules::from_config(&config)? } else { Rules::accepting_any_image() };
    let image = args.image.or(&origin);
    let seed = args.seed.or(origin.seed).unwrap_or(DEFAULT_SEED);
    let plan = Plan {
        edges: image.edges()?,
        label_ids: image.label_ids(),
        ..Plan::in_memory(config, rules, seed, image.settings()?, outputs)
    };
    let concurrency = Concurrency {
        threads: args.threads.map(usize::from),
        frames_in_flight: args.frames_in_flight.map(usize::from),
    };
    Ok(Setup { plan, concurrency, frames: args.frames, stop: stop_on_signals(messages)? })
}

/// Measures one case; what `dataset` writes goes into a temporary folder.
fn measure_one(case: Case, setup: &Setup, renderer: &mut Renderer) -> Result<Measured> {
    if case != Case::Dataset {
        return bench::run(case, setup, Path::new(""), renderer);
    }
    let folder = tempfile::tempdir().map_err(|cause| Error::Write { path: std::env::temp_dir(), cause })?;
    bench::run(case, setup, folder.path(), renderer)
}

/// Measures the cases. If one fails, those before it are printed, and then its error.
fn measure(
    args: &BenchArgs,
    messages: Messages,
    cases: &[Case],
    setup: &Setup,
    renderer: &mut Renderer,
) -> Result<()> {
    let mut results = Vec::new();
    for &case in cases {
        messages.note(format_args!("{}: {} ...", case.name(), frames(setup.frames)));
        match measure_one(case, setup, renderer) {
            Ok(measured) => results.push((case, measured)),
            Err(error) if results.is_empty() => return Err(error),
            Err(error) => {
                print_results(args, &results, setup, renderer)?;
                return Err(error);
            }
        }
    }
    print_results(args, &results, setup, renderer)
}

/// What is measured with what, for programs.
fn setup_json(setup: &Setup, renderer: &Renderer) -> Map<String, Value> {
    let (info, settings) = (&renderer.gpu().info, &setup.plan.settings);
    let rows = [
        (
            "adapter",
            json!({ "name": info.name, "backend": info.backend.to_string(), "driver": format!("{} {}", info.driver, info.driver_info) }),
        ),
        ("raster", json!(renderer.raster().name())),
        ("lighting", json!(renderer.raster().lighting.name())),
        ("version", json!(env!("CARGO_PKG_VERSION"))),
        ("cores", json!(cores())),
        ("size", json!(settings.size)),
        ("samples", json!(settings.samples_per_side.pow(2))),
        ("stage", setup.plan.config.distribution(Knob::StageName).to_json(false)),
    ];
    rows.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn print_results(
    args: &BenchArgs,
    results: &[(Case, Measured)],
    setup: &Setup,
    renderer: &Renderer,
) -> Result<()> {
    let (info, settings) = (&renderer.gpu().info, &setup.plan.settings);
    if args.json {
        let cases: Map<String, Value> =
            results.iter().map(|(case, measured)| (case.name().to_owned(), measured.to_json())).collect();
        let mut result = setup_json(setup, renderer);
        result.insert("cases".to_owned(), cases.into());
        result.insert("peak_rss_bytes".to_owned(), json!(bench::peak_rss_bytes()));
        return print(&format!("{:#}\n", Value::from(result)));
    }
    let mut text = format!(
        "{}\n{} x {} pixels, {} samples per pixel, {} cores\n\n{:<12}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}{:>12}  stages, median ms\n",
        crate::gpu::adapter::describe(info),
        settings.size[0],
        settings.size[1],
        settings.samples_per_side.pow(2),
        cores(),
        "case",
        "frames/s",
        "median ms",
        "p95 ms",
        "host ms",
        "CPU ms",
        "peak MB",
        "triangles",
        "upload MB"
    );
    for (case, measured) in results {
        let stages: Vec<String> =
            measured.stage_ms().iter().map(|(name, ms)| format!("{name} {ms:.1}")).collect();
        text.push_str(&format!(
            "{:<12}{:>10.2}{:>10.1}{:>10.1}{:>10}{:>10}{:>10}{:>12}{:>12.2}  {}\n",
            case.name(),
            measured.frames_per_second(),
            bench::quantile(&measured.frames_ms, 0.5),
            bench::quantile(&measured.frames_ms, 0.95),
            number(measured.host_ms(), 1),
            number(measured.process_ms, 1),
            number(measured.peak_rss_bytes.map(|bytes| bytes as f64 / 1e6), 0),
            bench::quantile(&measured.triangles, 0.5),
            bench::quantile(&measured.upload_bytes, 0.5) / 1e6,
            stages.join(", ")
        ));
    }
    if let Some(bytes) = bench::peak_rss_bytes() {
        text.push_str(&format!("\npeak resident memory {:.0} MB\n", bytes as f64 / 1e6));
    }
    print(&text)
}

/// A number to this many digits, or a dash where the system does not report it.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

fn sweep(
    args: &BenchArgs,
    messages: Messages,
    name: &str,
    case: Case,
    setup: &Setup,
    renderer: &mut Renderer,
) -> Result<()> {
    let case = if name == "threads" { Case::Dataset } else { case };
    let path = args.plot.clone().unwrap_or_default();
    let plot = path.file_name().unwrap_or_default();
    let (axis, setups) = bench::sweep(name, setup)?;
    let (mut points, mut failure) = (Vec::new(), None);
    for (value, setup) in &setups {
        match measure_one(case, setup, renderer) {
            Ok(measured) => points.push((*value, bench::quantile(&measured.frames_ms, 0.5))),
            Err(error) if points.is_empty() => return Err(error),
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
        messages.note(format_args!("{axis} {value}: {:.1} ms", points[points.len() - 1].1));
    }
    let curve = Curve { axis, points };
    print_curve(args, &curve, case, (setup, renderer, &path))?;
    let name = plot.to_string_lossy().into_owned();
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    disk::write_all(folder, &[Artifact { name, bytes: curve.to_svg().into_bytes() }])?;
    if !args.json {
        messages.paths(&format!("{}\n", path.display()))?;
    }
    failure.map_or(Ok(()), Err)
}

/// Prints the points of a sweep, before the plot is written: they took their time. If a value failed, those before it.
fn print_curve(
    args: &BenchArgs,
    curve: &Curve,
    case: Case,
    (setup, renderer, plot): (&Setup, &Renderer, &Path),
) -> Result<()> {
    if args.json {
        let points: Vec<Value> =
            curve.points.iter().map(|(value, ms)| json!({ "value": value, "median_ms": ms })).collect();
        let mut result = setup_json(setup, renderer);
        // What a sweep varies is in its points.
        match args.sweep.as_deref() {
            Some("size") => drop(result.shift_remove("size")),
            Some("samples") => drop(result.shift_remove("samples")),
            _ => {}
        }
        for (name, value) in [
            ("sweep", json!(curve.axis)),
            ("case", json!(case.name())),
            ("points", json!(points)),
            ("plot", json!(plot.display().to_string())),
        ] {
            result.insert(name.to_owned(), value);
        }
        return print(&format!("{:#}\n", Value::from(result)));
    }
    let mut text = format!("{:<20}{:>12}   case {}\n", curve.axis, "median ms", case.name());
    for (value, ms) in &curve.points {
        text.push_str(&format!("{value:<20}{ms:>12.1}\n"));
    }
    print(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_that_is_named_twice_is_measured_once() {
        assert_eq!(parse_cases("scene, camera,scene").expect("cases"), [Case::Scene, Case::Camera]);
        assert!(parse_cases("scene,").is_err());
    }
}
