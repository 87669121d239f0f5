//! Output of the commands: results on stdout, messages on stderr.

use std::fmt::Display;
use std::io::Write as _;

use crate::error::{Error, Result};
use clap::Args;

/// How much a command says on stderr.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct Messages {
    /// Print more: adapter, milliseconds by stage
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// Print nothing but errors and what was asked for (--json, listings, tables): no messages, no paths of written files
    #[arg(short, long, global = true)]
    pub(super) quiet: bool,
}

impl Messages {
    /// Prints a line, unless `--quiet` is set.
    pub(super) fn note(self, text: impl Display) {
        if !self.quiet {
            note(text);
        }
    }

    /// Prints paths of written files on stdout, unless `--quiet` is set.
    pub(super) fn paths(self, text: &str) -> Result<()> {
        if self.quiet { Ok(()) } else { print(text) }
    }

    /// Prints a line if `--verbose` is set.
    pub(super) fn detail(self, text: impl Display) {
        if self.verbose {
            note(text);
        }
    }
}

/// A number of frames, in words.
pub(super) fn frames(count: u64) -> String {
    if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") }
}

/// Prints a line on stderr. A failure is ignored: a closed terminal or a full disk behind stderr must not end a run.
pub(super) fn note(text: impl Display) {
    // In one write, so that lines of several threads do not mix.
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Prints a result on stdout. A closed pipe (`| head`) is not an error.
pub(super) fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(cause) if cause.kind() != std::io::ErrorKind::BrokenPipe => Err(Error::Stdout(cause)),
        _ => Ok(()),
    }
}
