//! Every error that a person can meet, on one page, so that their tone stays even.
//!
//! A message says what is wrong, which value it was, and what to do. `exit_status` is 2 for wrong usage or
//! configuration and 1 for everything else.
//! Must not know: anything else of this crate.
//! To add one: a variant with its text here, an arm in [`Error::exit_status`] if it is a usage error.

use std::path::PathBuf;

/// What went wrong, with the value at fault and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A knob name that is not in the table.
    #[error("unknown knob `{name}` in {origin}{}; `regolith-render params` lists every knob", did_you_mean(.suggestion.as_deref()))]
    UnknownKnob {
        /// The name as given.
        name: String,
        /// Where it was given: `--set`, a file, a preset.
        origin: String,
        /// The nearest name there is.
        suggestion: Option<String>,
    },
    /// A knob value (or the bound of a distribution) outside what is allowed.
    #[error("{name} = {value} in {origin} is out of range: allowed is {allowed}")]
    KnobOutOfRange {
        /// Dotted knob name.
        name: String,
        /// The value as given.
        value: String,
        /// Where it was given.
        origin: String,
        /// The allowed range, with unit.
        allowed: String,
    },
    /// A knob value of the wrong type or shape.
    #[error("{name} = {value} in {origin} cannot be used: expected {expected}")]
    KnobType {
        /// Dotted knob name.
        name: String,
        /// The value as given.
        value: String,
        /// Where it was given.
        origin: String,
        /// What would be right.
        expected: String,
    },
    /// Values that are fine alone but cannot hold together.
    #[error("these settings contradict each other: {0}")]
    Contradiction(String),
    /// A preset that does not ship.
    #[error("unknown preset `{name}`{}; there are: {}", did_you_mean(.suggestion.as_deref()), .available.join(", "))]
    UnknownPreset {
        /// The name as given.
        name: String,
        /// The nearest name there is.
        suggestion: Option<String>,
        /// All names.
        available: Vec<String>,
    },
    /// A configuration that is not TOML.
    #[error("{origin}, line {line}, column {column}: {message}")]
    Toml {
        /// File name, or `--set`.
        origin: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser says.
        message: String,
    },
    /// A configuration file that cannot be read.
    #[error("cannot read {}: {cause}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A command-line value that no knob stands for (size, samples, outputs).
    #[error("{0}")]
    Usage(String),
    /// `--out` names a file.
    #[error("--out {} is a file; give a folder (it is made if it is missing)", .0.display())]
    OutIsFile(PathBuf),
    /// `--out` has other content.
    #[error("--out {} already holds {found}, which this run would not have written; choose an empty folder, or add --force", .path.display())]
    OutNotEmpty {
        /// The folder.
        path: PathBuf,
        /// One thing that was found there.
        found: String,
    },
    /// A file that could not be written; nothing half-written is left.
    #[error("cannot write {}: {cause}{}", .path.display(), write_remedy(.cause))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// Standard output that cannot be written to.
    #[error("cannot write to standard output: {0}")]
    Stdout(std::io::Error),
    /// No adapter at all.
    #[error(
        "no graphics adapter was found{0}.\nWithout a GPU, Mesa's CPU driver does the work: `sudo apt-get install mesa-vulkan-drivers` (Debian, Ubuntu).\nWith a GPU, install its Vulkan driver; in a container, pass the GPU through with its graphics capability."
    )]
    NoAdapter(String),
    /// Adapters, but none of the wanted name.
    #[error("no adapter matches `{wanted}`; there are:\n{}", .available.join("\n"))]
    AdapterNotFound {
        /// What was asked for.
        wanted: String,
        /// One line an adapter.
        available: Vec<String>,
    },
    /// An adapter that cannot do what is needed.
    #[error("the adapter {adapter} cannot be used: {reason}; `regolith-render adapters` lists the others")]
    AdapterUnfit {
        /// Its name.
        adapter: String,
        /// What it lacks.
        reason: String,
    },
    /// More pixels than the device can draw.
    #[error(
        "--size {width}x{height} with --samples {samples} is too large for {adapter}: it needs {needed} and the device ends at {limit}; use a smaller --size or fewer --samples"
    )]
    SizeBeyondDevice {
        /// Picture width.
        width: u32,
        /// Picture height.
        height: u32,
        /// Samples per pixel.
        samples: u32,
        /// What would be needed, with its unit.
        needed: String,
        /// What the device allows, with its unit.
        limit: String,
        /// The adapter's name.
        adapter: String,
    },
    /// The device's memory does not hold the frame.
    #[error(
        "the graphics device has not enough memory for this frame; nothing was written. Use a smaller --size or fewer --samples"
    )]
    OutOfMemory,
    /// The device went away or gave up in mid-frame.
    #[error(
        "the graphics device was lost while rendering ({0}); nothing was written. Run the same command again; if it happens again, try a smaller --size or another --adapter"
    )]
    DeviceLost(String),
    /// The device refused a command: a defect of this program or of the driver.
    #[error("the graphics device refused a command: {0}")]
    Device(String),
    /// A frame with pixels that nothing was drawn on.
    #[error(
        "{pixels} pixels of the frame carry no label (seed {seed}); the frame is not written. This is a defect: please report the seed and the settings"
    )]
    Unlabelled {
        /// How many.
        pixels: u64,
        /// The scene's seed.
        seed: u64,
    },
    /// A rule of the scene that cannot be met with these settings.
    #[error("no valid scene with these settings: {0}")]
    Scene(String),
    /// A rule for the frames of a dataset that frame after frame breaks.
    #[error(
        "frame {index} was drawn {attempts} times and broke a rule each time, the last time `{rule}`: {found}. Loosen the rule or change the knobs, and choose another --out if frames are finished here: they stay"
    )]
    RuleBroken {
        /// The frame.
        index: u64,
        /// How often it was drawn.
        attempts: u32,
        /// Name of the rule.
        rule: String,
        /// What was found and what is allowed.
        found: String,
    },
    /// A dataset folder that another configuration made.
    #[error("{} holds a dataset of another configuration; choose another --out. What differs:\n{}", .path.display(), .differences.join("\n"))]
    OtherDataset {
        /// The folder.
        path: PathBuf,
        /// One line for each setting that differs.
        differences: Vec<String>,
    },
    /// A folder that another process is writing to.
    #[error("another run is writing {}; wait for it, or stop it first", .0.display())]
    Busy(PathBuf),
    /// A run that was asked to stop.
    #[error("stopped: {done} of {wanted} frames are finished and whole. {remedy}")]
    Stopped {
        /// Frames that are there.
        done: u64,
        /// Frames that were asked for.
        wanted: u64,
        /// How to have the rest.
        remedy: &'static str,
    },
    /// Something that should be a dataset (or a part of one) and is not.
    #[error("{}: {message}", .path.display())]
    Dataset {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong, and the remedy.
        message: String,
    },
    /// A check that found something wrong; what, has been printed.
    #[error("{0}")]
    CheckFailed(String),
    /// Encoding failed.
    #[error("cannot encode {name}: {message}")]
    Encode {
        /// File name.
        name: String,
        /// What the encoder says.
        message: String,
    },
}

/// The crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Exit status of the program: 2 for wrong usage or configuration, 1 for anything else.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::UnknownKnob { .. }
            | Self::KnobOutOfRange { .. }
            | Self::KnobType { .. }
            | Self::Contradiction(_)
            | Self::UnknownPreset { .. }
            | Self::Toml { .. }
            | Self::Read { .. }
            | Self::Usage(_)
            | Self::OutIsFile(_)
            | Self::OutNotEmpty { .. }
            | Self::SizeBeyondDevice { .. }
            | Self::AdapterNotFound { .. }
            | Self::OtherDataset { .. }
            | Self::Dataset { .. }
            | Self::Scene(_) => 2,
            Self::Write { .. }
            | Self::Stdout(_)
            | Self::NoAdapter(_)
            | Self::AdapterUnfit { .. }
            | Self::DeviceLost(_)
            | Self::Device(_)
            | Self::OutOfMemory
            | Self::Unlabelled { .. }
            | Self::RuleBroken { .. }
            | Self::Busy(_)
            | Self::Stopped { .. }
            | Self::CheckFailed(_)
            | Self::Encode { .. } => 1,
        }
    }
}

/// What to do after a run into a folder was stopped.
pub const RUN_AGAIN: &str = "Run the same command again to go on";

/// The name in `known` that is nearest to `name`, if one is near enough to be meant.
#[must_use]
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(similarity, _)| *similarity > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

fn did_you_mean(suggestion: Option<&str>) -> String {
    suggestion.map_or_else(String::new, |s| format!(" (did you mean `{s}`?)"))
}

fn write_remedy(cause: &std::io::Error) -> &'static str {
    match cause.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; free some space or give another --out, then run the same command again"
        }
        std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem => {
            "; give an --out that you may write to"
        }
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_finds_a_typo_and_leaves_nonsense_alone() {
        let known = ["sun.elevation_deg", "sun.azimuth_deg", "rocks.count"];
        assert_eq!(nearest("sun.elevaton_deg", known).as_deref(), Some("sun.elevation_deg"));
        assert_eq!(nearest("rock.count", known).as_deref(), Some("rocks.count"));
        assert_eq!(nearest("zzz", known), None);
    }
}
