//! Commands that render nothing: `export`, `adapters`.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::export::{self, Detail, Format, Stage};
use crate::gpu;
use crate::output::{Artifact, disk};
use crate::params::Knob;
use crate::render::RenderSettings;
use crate::scene::Scene;
use clap::Args;
use serde_json::{Value, json};

use super::args::{ConfigArgs, DEFAULT_SEED, DEFAULT_SIZE, parse_size, whole_number};
use super::device::start_threads;
use super::messages::{Messages, print};
use super::process::end_on_signals;

#[derive(Args, Debug)]
pub(super) struct ExportArgs {
    /// File to write; its extension selects the format: .npz, .glb, .usda or .usdc
    file: PathBuf,
    /// Seed of the scene [default: 42, or that of the record]
    #[arg(long, value_name = "N", value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Image size in pixels, for the camera matrix and for --drawn: WxH, or N for a square [default: 512x512, or that of the record]
    #[arg(long, value_name = "WxH", value_parser = parse_size, allow_hyphen_values = true)]
    size: Option<[u32; 2]>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Export only the triangles that a frame of this size draws or that cast its shadows, at the level of detail it uses
    #[arg(long)]
    drawn: bool,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn export_stage(args: &ExportArgs, messages: Messages) -> Result<()> {
    end_on_signals()?;
    start_threads()?;
    let format = Format::from_path(&args.file)?;
    if args.file.exists() && !args.force {
        return Err(Error::Usage(format!("{} exists; add --force to replace it", args.file.display())));
    }
    let name = args.file.file_name().and_then(|name| name.to_str()).map(str::to_owned).ok_or_else(|| {
        Error::Usage(format!("{}: the name of the file should be text in UTF-8", args.file.display()))
    })?;
    let (config, origin) = args.config.build()?;
    let seed = args.seed.or(origin.seed).unwrap_or(DEFAULT_SEED);
    let params = config.draw(seed)?;
    let settings = RenderSettings::new(args.size.or(origin.size).unwrap_or(DEFAULT_SIZE), 1)?;
    let scene = Scene::build(seed, &params)?;
    let detail = if args.drawn { Detail::Drawn } else { Detail::Authored };
    let knobs = params.to_json();
    let stage = Stage { scene: &scene, seed, knobs: &knobs, settings: &settings, detail };
    let (bytes, rocks) = (export::export(&stage, format)?, stage.rock_count()?);
    let folder = args.file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let written = bytes.len();
    disk::write_all(folder, &[Artifact { name, bytes }])?;
    if args.json {
        let result = json!({
            "file": args.file.display().to_string(), "bytes": written, "seed": seed, "stage": params.text(Knob::StageName), "drawn": args.drawn,
            "rocks": rocks, "geometry_hash": scene.geometry_hash(),
        });
        return print(&format!("{result:#}\n"));
    }
    messages.detail(format_args!("{rocks} rocks, {written} bytes"));
    messages.paths(&format!("{}\n", args.file.display()))
}

pub(super) fn list_adapters(as_json: bool) -> Result<()> {
    let adapters = gpu::adapter::list_with_missing()?;
    if as_json {
        let rows: Vec<Value> = adapters
            .iter()
            .map(|(info, missing)| {
                json!({
                    "name": info.name,
                    "kind": gpu::adapter::kind(info),
                    "backend": info.backend.to_string(),
                    "driver": info.driver,
                    "driver_info": info.driver_info,
                    "pci_address": Some(&info.device_pci_bus_id).filter(|address| !address.is_empty()),
                    "missing": missing,
                })
            })
            .collect();
        return print(&format!("{:#}\n", Value::from(rows)));
    }
    let line = |(info, missing): &(_, Vec<String>)| {
        let described = gpu::adapter::identify(info);
        let lacks = format!(" (cannot be used: lacks {})", missing.join(", "));
        format!("{described}{}\n", if missing.is_empty() { "" } else { &lacks })
    };
    print(&adapters.iter().map(line).collect::<String>())
}
