//! Every error that a user can meet, on one page, so that all messages have the same form.
//!
//! A message says what is wrong, which value caused it, what is allowed, and what to do. What only a user of the command line can do
//! about an error that others meet, too, is in `advice`. `exit_status` is 2 for wrong usage or configuration, 130 for an interrupted
//! run, and 1 for everything else.
//! Must not know: any other module of this crate.
//! To add one: a variant with its message, and an arm in [`Error::exit_status`].

use std::path::PathBuf;

/// An error, with the value that caused it and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A knob name that is not in the table, or a rule that there is not.
    #[error("unknown {0} `{name}` in {origin}{1}; {2} lists every {0}", knob_or_rule(.name)[0], did_you_mean(.suggestion.as_deref()), knob_or_rule(.name)[1])]
    UnknownKnob {
        /// The name as written.
        name: String,
        /// Where it was written: `--set`, a file, a preset.
        origin: String,
        /// The most similar known name.
        suggestion: Option<String>,
    },
    /// A knob value, or the bound of a distribution, outside the allowed range.
    #[error("{name} = {value} in {origin} is out of range; allowed: {allowed}{}", did_you_mean(.suggestion.as_deref()))]
    KnobOutOfRange {
        /// Dotted knob name.
        name: String,
        /// The value as written.
        value: String,
        /// Where it was written: `--set`, a file, a preset.
        origin: String,
        /// The allowed range, with unit, or the words that are allowed.
        allowed: String,
        /// The most similar word that is allowed.
        suggestion: Option<String>,
    },
    /// A knob value of the wrong type or shape.
    #[error("{name} = {value} in {origin} cannot be used: expected {expected}")]
    KnobType {
        /// Dotted knob name.
        name: String,
        /// The value as written.
        value: String,
        /// Where it was written: `--set`, a file, a preset.
        origin: String,
        /// What kind of value is expected.
        expected: String,
    },
    /// Settings that are valid one by one but not together.
    #[error("these settings contradict each other: {0}")]
    Contradiction(String),
    /// A preset that does not exist.
    #[error("unknown preset `{name}`{}; the presets are: {}", did_you_mean(.suggestion.as_deref()), .available.join(", "))]
    UnknownPreset {
        /// The name as written.
        name: String,
        /// The most similar known name.
        suggestion: Option<String>,
        /// The names of all presets.
        available: Vec<String>,
    },
    /// An output that does not exist.
    #[error("{option}: unknown output `{name}`{}; there are {} and all", did_you_mean(.suggestion.as_deref()), .available.join(", "))]
    UnknownOutput {
        /// The option with the name.
        option: &'static str,
        /// The name as written.
        name: String,
        /// The most similar known name.
        suggestion: Option<String>,
        /// The names of all outputs.
        available: Vec<String>,
    },
    /// A configuration that is not valid TOML.
    #[error("{origin}, line {line}, column {column}: {message}")]
    Toml {
        /// File name, or `--set`.
        origin: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// The message of the parser.
        message: String,
    },
    /// A file that the user named on the command line and that cannot be read.
    #[error("cannot read {}: {cause}", .path.display())]
    Config {
        /// The file.
        path: PathBuf,
        /// The error of the operating system, or why it is not read.
        cause: std::io::Error,
    },
    /// Any other file that cannot be read.
    #[error("cannot read {}: {cause}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// A wrong value of a command-line option or an environment variable.
    #[error("{0}")]
    Usage(String),
    /// `--out` is a file, a device, or a link that leads nowhere.
    #[error("--out {} is a file or leads nowhere; name a folder (it is created if missing)", .0.display())]
    OutIsFile(PathBuf),
    /// `--out` has content of another origin.
    #[error("--out {} already holds {found}, which does not belong to this run; choose an empty folder, or add --force to write there anyway", .path.display())]
    OutNotEmpty {
        /// The folder.
        path: PathBuf,
        /// Name of one file or folder in it.
        found: String,
    },
    /// A file below `--out` that would be replaced by another.
    #[error("{} already exists and differs from what this run writes there; choose another --out, or add --force to replace it", .0.display())]
    OutFileExists(PathBuf),
    /// A file that could not be written; no partial file is left.
    #[error("cannot write {}: {cause}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// Standard output that cannot be written to.
    #[error("cannot write to standard output: {0}")]
    Stdout(std::io::Error),
    /// A thread that the system did not start.
    #[error(
        "cannot start a thread: {0}; raise the limit of the number of processes (`ulimit -u`, or that of the container)"
    )]
    Thread(std::io::Error),
    /// Signals, such as that of Ctrl-C, that the process cannot receive.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(std::io::Error),
    /// Fewer files can be opened than a driver needs: it would not be found.
    #[error("cannot open the files of a graphics driver: {0}; raise the limit of open files (`ulimit -n`)")]
    OpenFiles(std::io::Error),
    /// No adapter was found.
    #[error(
        "no graphics adapter was found; tried: {tried}.\n{advice} `regolith-render doctor` says what is missing."
    )]
    NoAdapter {
        /// The backends that were tried, in words.
        tried: String,
        /// What to do on this platform.
        advice: String,
    },
    /// A limit on the memory of the process (`ulimit`) under which drivers crash.
    #[error(
        "{what} of this process is limited to {} MB, and rendering needs {} MB here; raise the limit, for instance with `ulimit {option} unlimited`, or in the memory request of the batch system",
        .limit_bytes / 1_000_000, .needed_bytes.div_ceil(1_000_000)
    )]
    MemoryLimit {
        /// What is limited, in words.
        what: &'static str,
        /// The option of `ulimit`.
        option: &'static str,
        /// The limit, bytes.
        limit_bytes: u64,
        /// What rendering needs on a machine with this number of cores, bytes.
        needed_bytes: u64,
    },
    /// No adapter has the requested name.
    #[error("no adapter matches `{wanted}`{origin}; the adapters are:\n{}", .available.join("\n"))]
    AdapterNotFound {
        /// The text of `--adapter` or `WGPU_ADAPTER_NAME`.
        wanted: String,
        /// The variables of the environment that leave no other, in words; empty if none is set.
        origin: String,
        /// One line for each adapter.
        available: Vec<String>,
    },
    /// An adapter that lacks a required feature or limit.
    #[error("the adapter {adapter} cannot be used: {reason}; `regolith-render adapters` lists the others")]
    AdapterUnfit {
        /// Its name.
        adapter: String,
        /// The missing feature or limit.
        reason: String,
    },
    /// A frame beyond the limits of the device.
    #[error(
        "--size {width}x{height} with --samples {samples} is too large for {adapter}: it needs {needed}, the limit is {limit}; use a smaller --size or fewer --samples"
    )]
    SizeBeyondDevice {
        /// Image width, pixels.
        width: u32,
        /// Image height, pixels.
        height: u32,
        /// Samples per pixel.
        samples: u32,
        /// The required amount, with its unit.
        needed: String,
        /// The limit of the device, with its unit.
        limit: String,
        /// The adapter's name.
        adapter: String,
    },
    /// The device ran out of memory.
    #[error("the graphics device does not have enough memory for this frame")]
    OutOfMemory,
    /// The device was removed, reset, or stopped answering.
    #[error("the graphics device was lost while rendering ({0})")]
    DeviceLost(String),
    /// The device rejected a command: a bug in this crate or in the driver.
    #[error(
        "the graphics device rejected a command, which is a bug in regolith-render or in the driver; please report it: {0}"
    )]
    Device(String),
    /// A frame with samples that no draw wrote.
    #[error(
        "{frame}: no draw of the graphics device wrote {pixels} pixels, the first at column {column}, row {row}"
    )]
    Unlabelled {
        /// Number of pixels with such samples.
        pixels: u64,
        /// Column of the first of them, from 0.
        column: u32,
        /// Its row.
        row: u32,
        /// The frame, by its seed.
        frame: String,
    },
    /// Settings that allow no valid scene.
    #[error("no valid scene with these settings: {0}")]
    Scene(String),
    /// A dataset frame that broke a rule in every attempt.
    #[error(
        "frame {index} was drawn {attempts} times and broke a rule each time, the last time `{rule}`: {found}"
    )]
    RuleBroken {
        /// Index of the frame.
        index: u64,
        /// Number of attempts.
        attempts: u32,
        /// Name of the rule.
        rule: String,
        /// The value that broke it in the last attempt, if it is one number.
        value: Option<String>,
        /// The value found and the values allowed.
        found: String,
    },
    /// A dataset folder that was made with another configuration.
    #[error("{} holds a dataset of another configuration; choose another --out. Differences:\n{}", .path.display(), .differences.join("\n"))]
    OtherDataset {
        /// The folder.
        path: PathBuf,
        /// One line for each different setting.
        differences: Vec<String>,
    },
    /// A folder that another process is writing to.
    #[error("another run is writing {}: {holder}. Wait for it or stop it, or choose another --out", .path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
        /// What the other run is.
        holder: String,
    },
    /// A run's log that something else removed or replaced.
    #[error("{}: the log of this run is no longer there: while the run was writing, the file was removed or replaced, or its folder was removed or renamed. Put the folder back as it was, or run the same command again, and let nothing else write there meanwhile", .0.display())]
    LogLost(PathBuf),
    /// Frames of a run that are not on the disk at its end.
    #[error("{}: {missing} of the {wanted} frames of this run are not on the disk: while the run was writing, something removed or replaced their files or lines. Run the same command again, which makes them, and let nothing else write there meanwhile", .path.display())]
    FramesLost {
        /// The folder.
        path: PathBuf,
        /// Number of missing frames.
        missing: u64,
        /// Number of frames of the run.
        wanted: u64,
    },
    /// A run that was interrupted.
    #[error("stopped: {done} of {wanted} frames are finished. {remedy}")]
    Stopped {
        /// Number of finished frames.
        done: u64,
        /// Number of requested frames.
        wanted: u64,
        /// How to get the rest.
        remedy: &'static str,
    },
    /// A folder or file that is not a dataset, or not the expected part of one.
    #[error("{}: {message}", .path.display())]
    Dataset {
        /// The folder or file.
        path: PathBuf,
        /// The problem and the remedy.
        message: String,
    },
    /// A check that failed; its findings are already printed.
    #[error("{0}")]
    CheckFailed(String),
    /// Encoding failed.
    #[error("cannot encode {name}: {message}")]
    Encode {
        /// Name of the file.
        name: String,
        /// The message of the encoder.
        message: String,
    },
}

/// A result with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Exit status of the command: 2 for wrong usage or configuration, 130 for a run that was interrupted by Ctrl-C, 1 for
    /// anything else.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Stopped { .. } => 130,
            Self::UnknownKnob { .. }
            | Self::KnobOutOfRange { .. }
            | Self::KnobType { .. }
            | Self::Contradiction(_)
            | Self::UnknownPreset { .. }
            | Self::UnknownOutput { .. }
            | Self::Toml { .. }
            | Self::Config { .. }
            | Self::Usage(_)
            | Self::OutIsFile(_)
            | Self::OutNotEmpty { .. }
            | Self::OutFileExists(_)
            | Self::SizeBeyondDevice { .. }
            | Self::AdapterNotFound { .. }
            | Self::OtherDataset { .. }
            | Self::Dataset { .. }
            | Self::Scene(_) => 2,
            Self::Read { .. }
            | Self::Write { .. }
            | Self::Stdout(_)
            | Self::Thread(_)
            | Self::Signals(_)
            | Self::OpenFiles(_)
            | Self::NoAdapter { .. }
            | Self::MemoryLimit { .. }
            | Self::AdapterUnfit { .. }
            | Self::DeviceLost(_)
            | Self::Device(_)
            | Self::OutOfMemory
            | Self::Unlabelled { .. }
            | Self::RuleBroken { .. }
            | Self::Busy { .. }
            | Self::LogLost(_)
            | Self::FramesLost { .. }
            | Self::CheckFailed(_)
            | Self::Encode { .. } => 1,
        }
    }
}

impl Error {
    /// The same, with the seed of the frame that it is about, if it is about one.
    #[must_use]
    pub fn of_seed(self, seed: u64) -> Self {
        match self {
            Self::Unlabelled { pixels, column, row, .. } => {
                Self::Unlabelled { pixels, column, row, frame: format!("seed {seed}") }
            }
            other => other,
        }
    }
}

impl Error {
    /// What follows the message on the command line: what became of the files of the command, and a remedy in words of its options.
    #[must_use]
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Read { cause, .. } | Self::Config { cause, .. } | Self::Signals(cause)
                if are_too_many_open(cause) =>
            {
                MORE_OPEN_FILES
            }
            Self::Write { cause, .. } => write_remedy(cause),
            Self::OutOfMemory => {
                "; nothing of this frame is written, and finished frames stay. Use a smaller --size or fewer --samples"
            }
            Self::DeviceLost(_) => {
                "; nothing of this frame is written, and finished frames stay. Run the same command again; if it happens again, try a \
                 smaller --size or another --adapter"
            }
            Self::Unlabelled { .. } => {
                "; the frame is not written. Run the same command again; if it happens again, add `--raster host` or choose another \
                 --adapter, and please report the settings: it is a bug in the driver or in regolith-render"
            }
            Self::RuleBroken { .. } => {
                ". Loosen the rule or change the knobs; the frames already finished in this folder stay, so choose another --out \
                 with the new settings"
            }
            _ => "",
        }
    }
}

/// The remedy after an interrupted run into a folder.
pub const RUN_AGAIN: &str = "Run the same command again to continue";

/// The name in `known` that is most similar to `name`, if it is similar enough to be a typo: one that a letter more, less, changed or
/// swapped with its neighbour makes the same, else by Jaro-Winkler.
#[must_use]
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    known
        .into_iter()
        .map(|candidate| {
            let is_near = strsim::osa_distance(name, candidate) <= 1;
            (if is_near { 1.0 } else { strsim::jaro_winkler(name, candidate) }, candidate)
        })
        .filter(|(similarity, _)| *similarity > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

/// What a name of the form of a knob stands for, and what lists all of its kind.
fn knob_or_rule(name: &str) -> [&'static str; 2] {
    if name.starts_with("rules.") {
        ["rule", "`regolith-render params rules`"]
    } else {
        ["knob", "`regolith-render params`"]
    }
}

fn did_you_mean(suggestion: Option<&str>) -> String {
    suggestion.map_or_else(String::new, |s| format!(" (did you mean `{s}`?)"))
}

/// The remedy where the process, or the system, has too many open files.
const MORE_OPEN_FILES: &str = "; raise the limit of open files (`ulimit -n`)";

/// Whether a file could not be opened because too many are open: the numbers of EMFILE and ENFILE on Linux and macOS.
fn are_too_many_open(cause: &std::io::Error) -> bool {
    cfg!(unix) && matches!(cause.raw_os_error(), Some(23 | 24))
}

fn write_remedy(cause: &std::io::Error) -> &'static str {
    match cause.kind() {
        _ if are_too_many_open(cause) => MORE_OPEN_FILES,
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; free some space, or write to another disk, then run the same command again"
        }
        std::io::ErrorKind::FileTooLarge => {
            "; a limit of the file size forbids it: raise that of the process (`ulimit -f`) or write to another file \
             system, then run the same command again"
        }
        std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem => {
            "; write to a folder where you have permission"
        }
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_corrects_a_typo_and_rejects_an_unrelated_name() {
        let known = ["sun.elevation_deg", "sun.azimuth_deg", "rocks.count"];
        assert_eq!(nearest("sun.elevaton_deg", known).as_deref(), Some("sun.elevation_deg"));
        assert_eq!(nearest("rock.count", known).as_deref(), Some("rocks.count"));
        assert_eq!(nearest("snu", ["sensor", "sun"]).as_deref(), Some("sun"));
        assert_eq!(nearest("zzz", known), None);
    }

    #[test]
    fn too_many_open_files_are_named_with_their_remedy() {
        let cause = || std::io::Error::from_raw_os_error(24);
        for error in [
            Error::Signals(cause()),
            Error::OpenFiles(cause()),
            Error::Read { path: "a".into(), cause: cause() },
            Error::Write { path: "a".into(), cause: cause() },
        ] {
            let text = format!("{error}{}", error.advice());
            assert!(text.contains("ulimit -n") && error.exit_status() == 1, "{text}");
        }
    }
}
