//! The process that runs a command: its cores and its signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use regolith::{Error, Result};
use signal_hook::consts::signal::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::iterator::Signals;
use signal_hook::low_level;

use super::messages::Messages;

/// Exit status of a command that a signal ended, less the number of the signal; as shells report it.
const SIGNAL_STATUS: i32 = 128;

/// The signal on which the command is stopping; 0 if there was none.
static RECEIVED: AtomicI32 = AtomicI32::new(0);

/// Number of cores that the process may use.
pub(super) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A flag that is set by Ctrl-C and by the signals that ask a process to end; a second one ends it at once.
pub(super) fn stop_on_signals(messages: Messages) -> Result<Arc<AtomicBool>> {
    let failed = |error| Error::Usage(format!("cannot listen for Ctrl-C: {error}"));
    let mut wanted = vec![SIGINT, SIGTERM];
    if !ignores_hangup() {
        wanted.push(SIGHUP);
    }
    let mut signals = Signals::new(wanted).map_err(failed)?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let listen = move || {
        for signal in signals.forever() {
            if RECEIVED.swap(signal, Ordering::Relaxed) != 0 {
                low_level::exit(SIGNAL_STATUS + signal);
            }
            flag.store(true, Ordering::Relaxed);
            messages.note(format_args!("\nstopping after the frames in flight (Ctrl-C again stops at once)"));
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(listen).map_err(failed)?;
    Ok(stop)
}

/// Whether the process was started by `nohup`, to go on without its terminal.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (SIGHUP - 1) & 1 == 1)
}

/// Exit status of a command that has stopped: 130 after Ctrl-C, 143 after the signal TERM; `None` without a signal.
pub(crate) fn stopped_status() -> Option<u8> {
    match RECEIVED.load(Ordering::Relaxed) {
        0 => None,
        signal => u8::try_from(SIGNAL_STATUS + signal).ok(),
    }
}

/// Lets writes beyond the limit of the file size (`ulimit -f`) fail with an error. Without this, a signal ends the process.
pub(super) fn survive_file_size_limit() {
    // If it fails, the signal ends the process, as it does with most programs.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
}

/// Ends the process with status 1 where it is aborted, as by an allocation that fails: its message is printed by then, and the
/// process must not look as if it had crashed.
pub(super) fn fail_on_abort() {
    let always = Arc::new(AtomicBool::new(true));
    // If it fails, the signal ends the process.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, always);
}
