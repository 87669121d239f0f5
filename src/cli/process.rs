//! The process that runs a command: its cores and its signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use regolith::{Error, Result};

use super::messages::note;

/// Number of cores that the process may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A flag that is set by Ctrl-C and by the signals that ask a process to end; a second Ctrl-C ends it at once.
pub(super) fn stop_on_signals() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(1);
        }
        note(format_args!("\nstopping after the frames in flight (Ctrl-C again stops at once)"));
    })
    .map_err(|error| Error::Usage(format!("cannot listen for Ctrl-C: {error}")))?;
    Ok(stop)
}
