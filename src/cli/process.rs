//! The process that runs a command: its cores and its signals.

#[cfg(unix)]
use std::io::Write as _;
#[cfg(unix)]
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use crate::error::{Error, Result};
use crate::output::disk;
use signal_hook::consts::signal::{SIGABRT, SIGINT, SIGTERM};
#[cfg(unix)]
use signal_hook::consts::signal::{SIGHUP, SIGXFSZ};

use super::messages::Messages;

/// Exit status of a command that a signal ended, less the number of the signal; as shells report it.
const SIGNAL_STATUS: i32 = 128;

/// The signal on which the command is stopping; 0 if there was none.
static RECEIVED: AtomicI32 = AtomicI32::new(0);

/// A flag that is set by Ctrl-C and by the signals that ask a process to end; a second one ends it at once.
pub(super) fn stop_on_signals(messages: Messages) -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&stop);
    let note = move || {
        set.store(true, Ordering::Relaxed);
        messages.note(format_args!("\nstopping after the frames in flight (Ctrl-C again stops at once)"));
    };
    listen(note)?;
    Ok(stop)
}

/// Lets Ctrl-C and the signals that ask a process to end remove unfinished files before they end it.
pub(super) fn end_on_signals() -> Result<()> {
    let end = || {
        disk::remove_unfinished();
        signal_hook::low_level::exit(SIGNAL_STATUS + RECEIVED.load(Ordering::Relaxed));
    };
    listen(end)
}

/// Calls `stop` in a thread on the first signal, and exits on the second. A signal that whoever started the process lets it ignore
/// stays ignored.
#[cfg(unix)]
fn listen(stop: impl Fn() + Send + 'static) -> Result<()> {
    let ignored = ignored_signals();
    let wanted = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let mut signals = signal_hook::iterator::Signals::new(wanted).map_err(Error::Signals)?;
    let listen = move || {
        for signal in signals.forever() {
            if RECEIVED.swap(signal, Ordering::Relaxed) != 0 {
                signal_hook::low_level::exit(SIGNAL_STATUS + signal);
            }
            stop();
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(listen).map(drop).map_err(Error::Thread)
}

/// Calls `stop` in a thread on the first signal, and exits on the second. Windows tells of signals by flags alone.
#[cfg(windows)]
fn listen(stop: impl Fn() + Send + 'static) -> Result<()> {
    let is_received = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        let status = SIGNAL_STATUS + signal;
        signal_hook::flag::register_conditional_shutdown(signal, status, Arc::clone(&is_received))
            .map_err(Error::Signals)?;
        signal_hook::flag::register(signal, Arc::clone(&is_received)).map_err(Error::Signals)?;
    }
    let listen = move || {
        while !is_received.load(Ordering::Relaxed) {
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        RECEIVED.store(SIGINT, Ordering::Relaxed);
        stop();
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(listen).map(drop).map_err(Error::Thread)
}

/// The signals that the process was started to ignore, a bit for each, from signal 1 on: `nohup` sets that of HUP, a shell without job
/// control that of INT for what runs in the background. None where the system does not tell.
#[cfg(unix)]
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default()
}

/// Exit status of a command that has stopped: 130 after Ctrl-C, 143 and 129 after the signals TERM and HUP; `None` without a signal.
pub(super) fn stopped_status() -> Option<u8> {
    match RECEIVED.load(Ordering::Relaxed) {
        0 => None,
        signal => u8::try_from(SIGNAL_STATUS + signal).ok(),
    }
}

/// Lets writes beyond the limit of the file size (`ulimit -f`) fail with an error. Without this, a signal ends the process.
pub(super) fn survive_file_size_limit() {
    // If it fails, the signal ends the process, as it does with most programs.
    #[cfg(unix)]
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
}

/// What is said where the process is aborted.
#[cfg(unix)]
const ABORTED: &[u8] =
    b"error: regolith-render was aborted, by a driver or because memory ran out: what is printed above, if \
anything, says why. A smaller --size and fewer --threads take less memory; `regolith-render doctor` finds drivers that fail\n";

/// Ends the process with status 1 and a message where it is aborted, by a driver or by an allocation that fails: it must not look as if it
/// had crashed.
#[cfg(unix)]
#[expect(unsafe_code, reason = "no handler that is safe to register writes a message; see SAFETY")]
pub(super) fn fail_on_abort() {
    // A file of its own: standard error of the library has a lock, which the aborted thread may hold.
    let Ok(stderr) = std::io::stderr().as_fd().try_clone_to_owned().map(std::fs::File::from) else { return };
    let end = move || {
        let _ = (&stderr).write_all(ABORTED);
        signal_hook::low_level::exit(1);
    };
    // SAFETY: the handler calls write and _exit, which are async-signal-safe (POSIX), and nothing else: it allocates nothing, takes no lock
    // and does not panic. If it cannot be registered, the signal ends the process.
    let _ = unsafe { signal_hook::low_level::register(SIGABRT, end) };
}

/// Ends the process with status 1 where it is aborted, by a driver or by an allocation that fails.
#[cfg(windows)]
pub(super) fn fail_on_abort() {
    let always = Arc::new(AtomicBool::new(true));
    // If it fails, the signal ends the process.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, always);
}
