//! Options that several commands share.

use std::any::TypeId;
use std::path::PathBuf;

use crate::dataset::manifest::shell_word;
use crate::dataset::rules::Rules;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::output::edges::EdgePolicy;
use crate::output::{LabelIds, OUTPUTS};
use crate::params::config::Config;
use crate::params::record::FrameOrigin;
use crate::render::{RasterMode, RenderSettings, Renderer};
use clap::Args;

use super::device;
use super::messages::Messages;

/// Where the values of the knobs come from, weakest first: stage, preset, file, `--set`.
#[derive(Args, Debug)]
pub(super) struct ConfigArgs {
    /// Stage: nominal or surface [default: that of the preset or the file, else nominal]
    #[arg(long, value_name = "NAME")]
    stage: Option<String>,
    /// Named set of knobs, or several separated by commas, of which later ones win; `regolith-render --help` lists them
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// TOML file with knobs, or the record of a frame (frame_0000.json), to repeat it; `-` reads either from standard input
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One knob, for example sun.elevation_deg=12 or 'rocks.scale_m={uniform=[0.2,2]}'; repeatable, wins over all other sources
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
}

impl ConfigArgs {
    /// Whether a preset or a file is named.
    pub(super) const fn is_named(&self) -> bool {
        self.preset.is_some() || self.config.is_some()
    }

    /// The configuration, checked as a whole, and what the frame was made from whose record the file is; nothing if it is no record.
    pub(super) fn build(&self) -> Result<(Config, FrameOrigin)> {
        let mut origin = FrameOrigin::default();
        let presets = self.preset.iter().flat_map(|names| names.split(',')).map(str::trim);
        if presets.clone().any(str::is_empty) {
            return Err(Error::Usage(format!(
                "--preset '{}': a name in the list is empty; leave out its comma",
                self.preset.as_deref().unwrap_or_default()
            )));
        }
        let config = Config::layered(self.stage.as_deref(), presets, |config| {
            if let Some(path) = &self.config {
                origin = config.apply_named_file(path)?;
            }
            self.set.iter().try_for_each(|assignment| config.apply_set(assignment))
        })?;
        // A single frame is not held to the rules, but a malformed rule is an error for every command.
        Rules::from_config(&config)?;
        Ok((config, origin))
    }

    /// These options as a command line has them, in this order.
    pub(super) fn options(&self) -> String {
        let preset =
            self.preset.as_ref().map(|names| names.split(',').map(str::trim).collect::<Vec<_>>().join(","));
        let config = self.config.as_ref().map(|path| path.display().to_string());
        let named = [("--stage", self.stage.clone()), ("--preset", preset), ("--config", config)];
        let named = named.into_iter().filter_map(|(option, value)| Some((option, value?)));
        let set = self.set.iter().map(|assignment| ("--set", assignment.clone()));
        named
            .chain(set)
            .map(|(option, value)| format!("{option} {}", shell_word(&value)))
            .collect::<Vec<_>>()
            .join(" ")
    }
}

/// Seed of a scene unless an option says otherwise.
pub(super) const DEFAULT_SEED: u64 = 42;
/// Size of an image unless an option says otherwise, pixels.
pub(super) const DEFAULT_SIZE: [u32; 2] = [512; 2];
/// Samples per pixel unless an option says otherwise.
const DEFAULT_SAMPLES: u32 = 4;

/// Size, sampling and labels of the image.
#[derive(Args, Debug)]
pub(super) struct ImageArgs {
    /// Image size in pixels: WxH, or N for a square [default: 512x512, or that of the record]
    #[arg(long, value_name = "WxH", value_parser = parse_size, allow_hyphen_values = true)]
    size: Option<[u32; 2]>,
    /// Samples per pixel: 1, 4 (2 x 2) or 16 (4 x 4) [default: 4, or that of the record]
    #[arg(long, value_name = "N", value_parser = whole_number::<u32>(0, u32::MAX.into()))]
    samples: Option<u32>,
    /// Ids in the mask: canonical (0 regolith, 1 rock, 2 sky), or those of a Replicator pipeline [default: canonical, or those of
    /// the record]
    #[arg(long, value_name = "KIND", value_parser = ["canonical", "replicator"])]
    label_ids: Option<String>,
    /// Mask at class boundaries: hard, or ignore:N to write 255 (1 with --label-ids replicator) within N pixels of another class
    /// [default: hard, or that of the record]
    #[arg(long, value_name = "RULE")]
    edges: Option<String>,
}

impl ImageArgs {
    /// The same, with what a record says where no option does.
    pub(super) fn or(&self, origin: &FrameOrigin) -> Self {
        Self {
            size: self.size.or(origin.size),
            samples: self.samples.or(origin.samples),
            label_ids: self.label_ids.clone().or_else(|| origin.label_ids.clone()),
            edges: self.edges.clone().or_else(|| origin.edges.clone()),
        }
    }

    /// Whether a number of samples is set.
    pub(super) const fn has_samples(&self) -> bool {
        self.samples.is_some()
    }

    pub(super) fn settings(&self) -> Result<RenderSettings> {
        RenderSettings::new(self.size.unwrap_or(DEFAULT_SIZE), self.samples.unwrap_or(DEFAULT_SAMPLES))
    }

    pub(super) fn label_ids(&self) -> LabelIds {
        self.label_ids.as_deref().and_then(LabelIds::from_name).unwrap_or_default()
    }

    pub(super) fn edges(&self) -> Result<EdgePolicy> {
        self.edges.as_deref().map_or(Ok(EdgePolicy::Hard), str::parse)
    }
}

/// The value of `--adapter`; an empty one, as of a variable that is not set, would select any.
pub(super) fn adapter_text(text: &str) -> std::result::Result<String, String> {
    let is_blank = text.trim().is_empty();
    if is_blank {
        Err("name a part of its line in `regolith-render adapters`, or `cpu`".to_owned())
    } else {
        Ok(text.to_owned())
    }
}

/// What renders: the adapter and the rasteriser.
#[derive(Args, Debug)]
pub(super) struct DeviceArgs {
    /// Adapter to use: a part of its line in `regolith-render adapters`, such as its name or PCI address, or `cpu`
    #[arg(long, value_name = "TEXT", value_parser = adapter_text)]
    adapter: Option<String>,
    /// Where to rasterise: device (in render passes), compute (on the device too, in a compute pass: labels and depth have the same bits
    /// on every device), host, or auto (the host on a software adapter, compute on a GPU with Vulkan, else device)
    #[arg(long, value_name = "auto|device|compute|host", default_value_t = RasterMode::Auto)]
    raster: RasterMode,
}

impl DeviceArgs {
    /// Opens the adapter.
    pub(super) fn open(&self, messages: Messages) -> Result<Gpu> {
        device::open(self.adapter.as_deref(), messages)
    }

    /// The option that has an effect on the bytes of frames as a command line has it; nothing by default.
    pub(super) fn options(&self) -> Option<String> {
        (self.raster != RasterMode::Auto).then(|| format!("--raster {}", self.raster))
    }

    /// A renderer on an open device.
    pub(super) fn renderer(&self, gpu: Gpu) -> Result<Renderer> {
        Renderer::with_raster(gpu, self.raster)
    }
}

/// The names of all outputs, for the help.
pub(super) fn output_names() -> String {
    OUTPUTS.each_ref().map(|output| output.name).join(", ")
}

/// Reads `WxH`, or `N` for a square.
pub(super) fn parse_size(text: &str) -> std::result::Result<[u32; 2], String> {
    let (width, height) = text.split_once(['x', 'X']).unwrap_or((text, text));
    let side = |part: &str| part.trim().parse().map_err(|_| "the form is WxH or N, pixels".to_owned());
    Ok([side(width)?, side(height)?])
}

/// A parser of whole numbers from `min` to `max`, both included. (The range parsers of clap name the range in their message
/// for some types only.)
pub(super) fn whole_number<T: TryFrom<u64>>(
    min: u64,
    max: u64,
) -> impl Fn(&str) -> std::result::Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.trim().parse().ok().filter(|number| (min..=max).contains(number));
        let refused = || format!("it should be a whole number from {min} to {max}");
        number.and_then(|number| T::try_from(number).ok()).ok_or_else(refused)
    }
}

/// Lets `-5` reach the parser of every option that takes a whole number, in all commands: its message names the range, while
/// clap would take `-5` for an unknown option.
pub(super) fn pass_negative_numbers(command: clap::Command) -> clap::Command {
    let numbers = [TypeId::of::<u8>(), TypeId::of::<u16>(), TypeId::of::<u32>(), TypeId::of::<u64>()];
    let takes_number =
        move |arg: &clap::Arg| numbers.iter().any(|id| arg.get_value_parser().type_id() == *id);
    command
        .mut_args(|arg| if takes_number(&arg) { arg.allow_negative_numbers(true) } else { arg })
        .mut_subcommands(pass_negative_numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_one_number_or_two() {
        assert_eq!(parse_size("640x480"), Ok([640, 480]));
        assert_eq!(parse_size("256"), Ok([256, 256]));
        assert!(parse_size("0x").is_err() && parse_size("-5").is_err() && parse_size("big").is_err());
    }
}
