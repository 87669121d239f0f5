//! Another process of this binary, whose lines are read while it runs, and which is ended if it falls silent.

use std::io::{BufRead as _, BufReader, ErrorKind, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
#[cfg(unix)]
use signal_hook::consts::signal::{SIGHUP, SIGINT, SIGTERM};

/// Time between two looks at the flag that stops the command.
const INTERVAL: Duration = Duration::from_millis(100);
/// Lines of standard error that are kept, the last ones.
const MAX_MESSAGES: usize = 40;
/// Longest kept part of such a line, characters.
const MAX_MESSAGE_CHARS: usize = 400;

/// How a child process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    /// With status 0.
    Success,
    /// With another status or by a signal, in words.
    Failure(String),
    /// It wrote no line for too long and was ended.
    Silent,
    /// The command is to stop, and it was ended; or a signal that asks a process to end has ended it.
    Stopped,
}

/// Runs a command until it ends, passes each line of its standard output to `on_line`, and returns how it ended with the last
/// lines of its standard error. A process that writes no line for `patience` is ended.
///
/// # Errors
/// [`Error::Thread`] if the system starts no more processes or threads; [`Error::Read`] if the program cannot be started.
pub(super) fn supervise(
    command: &mut Command,
    patience: Duration,
    stop: &AtomicBool,
    mut on_line: impl FnMut(&str),
) -> Result<(Ending, Vec<String>)> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|cause| not_started(command, cause))?;
    let (lines, received) = mpsc::channel();
    let stdout = child.stdout.take();
    let stderr = child.stderr.take();
    std::thread::scope(|scope| {
        let thread = || std::thread::Builder::new();
        let readers = thread()
            .spawn_scoped(scope, move || each_line(stdout, |line| drop(lines.send(line))))
            .and_then(|_| thread().spawn_scoped(scope, move || last_lines(stderr)));
        let cut_short = match &readers {
            Ok(_) => listen(&received, patience, stop, &mut on_line),
            // Nobody would read what it writes.
            Err(_) => Some(Ending::Stopped),
        };
        if cut_short.is_some() {
            // It fails if the process has just ended.
            let _ = child.kill();
        }
        let ending = ending(&mut child);
        let messages = readers.map_err(Error::Thread)?;
        // A terminal sends Ctrl-C to both processes.
        let is_stopped = stop.load(Ordering::Relaxed);
        let ending = if is_stopped { Ending::Stopped } else { cut_short.unwrap_or(ending) };
        Ok((ending, messages.join().unwrap_or_default()))
    })
}

/// Passes lines on until there are no more; returns why it ended before that, if it did.
fn listen(
    lines: &mpsc::Receiver<String>,
    patience: Duration,
    stop: &AtomicBool,
    on_line: &mut impl FnMut(&str),
) -> Option<Ending> {
    let mut heard = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        match lines.recv_timeout(INTERVAL) {
            Ok(line) => {
                heard = Instant::now();
                on_line(&line);
            }
            Err(RecvTimeoutError::Disconnected) => return None,
            Err(RecvTimeoutError::Timeout) if heard.elapsed() > patience => return Some(Ending::Silent),
            Err(RecvTimeoutError::Timeout) => (),
        }
    }
    Some(Ending::Stopped)
}

fn not_started(command: &Command, cause: std::io::Error) -> Error {
    match cause.kind() {
        ErrorKind::WouldBlock => Error::Thread(cause),
        _ => Error::Read { path: command.get_program().into(), cause },
    }
}

fn ending(child: &mut Child) -> Ending {
    match child.wait() {
        Ok(status) if status.success() => Ending::Success,
        Ok(status) if is_asked_to_end(status) => Ending::Stopped,
        Ok(status) => Ending::Failure(status.to_string()),
        Err(error) => Ending::Failure(error.to_string()),
    }
}

/// Whether a process was ended by a signal that asks for it, which no driver sends.
#[cfg(unix)]
fn is_asked_to_end(status: ExitStatus) -> bool {
    use std::os::unix::process::ExitStatusExt as _;
    status.signal().is_some_and(|signal| [SIGINT, SIGTERM, SIGHUP].contains(&signal))
}

#[cfg(windows)]
fn is_asked_to_end(_: ExitStatus) -> bool {
    false
}

/// Calls `on_line` with every line of a stream until it ends. Drivers may write anything, so bytes that are no UTF-8 are replaced.
fn each_line(stream: Option<impl Read>, mut on_line: impl FnMut(String)) {
    let Some(stream) = stream else { return };
    let lines = BufReader::new(stream).split(b'\n').map_while(Result::ok);
    lines.for_each(|line| on_line(String::from_utf8_lossy(&line).into_owned()));
}

fn last_lines(stream: Option<impl Read>) -> Vec<String> {
    let mut kept = std::collections::VecDeque::new();
    each_line(stream, |line| {
        let line: String = line.trim_end().chars().take(MAX_MESSAGE_CHARS).collect();
        if !line.is_empty() {
            kept.push_back(line);
        }
        if kept.len() > MAX_MESSAGES {
            kept.pop_front();
        }
    });
    kept.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs a script of the shell; the command is to stop once it has written a line `stop`.
    fn run(script: &str, patience: Duration) -> (Ending, Vec<String>, Vec<String>) {
        let mut lines = Vec::new();
        let mut shell = Command::new("sh");
        let stop = AtomicBool::new(false);
        let receive = |line: &str| {
            stop.fetch_or(line == "stop", Ordering::Relaxed);
            lines.push(line.to_owned());
        };
        let (ending, messages) =
            supervise(shell.args(["-c", script]), patience, &stop, receive).expect("a shell");
        (ending, messages, lines)
    }

    #[test]
    fn lines_messages_and_status_of_a_process_are_read() {
        let long = Duration::from_secs(60);
        let (ending, messages, lines) = run("echo one; echo two; echo warning >&2", long);
        assert_eq!((ending, lines), (Ending::Success, vec!["one".to_owned(), "two".to_owned()]));
        assert_eq!(messages, ["warning"]);
        let (ending, ..) = run("exit 3", long);
        assert!(matches!(&ending, Ending::Failure(status) if status.contains('3')), "{ending:?}");
        let (ending, _, lines) = run("echo one; kill -ILL $$", long);
        assert!(matches!(&ending, Ending::Failure(status) if status.contains("signal")), "{ending:?}");
        assert_eq!(lines, ["one"]);
    }

    #[test]
    fn a_silent_process_is_ended() {
        let (ending, _, lines) = run("echo one; exec sleep 100", Duration::from_millis(300));
        assert_eq!((ending, lines), (Ending::Silent, vec!["one".to_owned()]));
    }

    #[test]
    fn a_process_that_ends_while_the_command_is_to_stop_has_not_crashed() {
        let long = Duration::from_secs(60);
        for script in ["echo stop", "echo stop; kill -SEGV $$", "echo stop; exec sleep 100", "kill -TERM $$"]
        {
            assert_eq!(run(script, long).0, Ending::Stopped, "{script}");
        }
    }

    #[test]
    fn a_program_that_is_not_there_is_an_error() {
        let never = AtomicBool::new(false);
        let mut command = Command::new("/nonexistent/program");
        let error = supervise(&mut command, Duration::from_secs(60), &never, |_| ()).expect_err("no program");
        assert!(error.to_string().contains("/nonexistent/program") && error.exit_status() == 1, "{error}");
    }
}
