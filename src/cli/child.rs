//! Another process of this binary, whose lines are read while it runs, and which is ended if it falls silent.

use std::io::{BufRead as _, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

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
    /// With another status or by a signal, in words; or it could not be started.
    Failure(String),
    /// It wrote no line for too long and was ended.
    Silent,
    /// The command is to stop; it was ended.
    Stopped,
}

/// Runs a command until it ends, passes each line of its standard output to `on_line`, and returns how it ended with the last
/// lines of its standard error. A process that writes no line for `patience` is ended.
pub(super) fn supervise(
    command: &mut Command,
    patience: Duration,
    stop: &Arc<AtomicBool>,
    mut on_line: impl FnMut(&str),
) -> (Ending, Vec<String>) {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => return (Ending::Failure(format!("it could not be started: {error}")), Vec::new()),
    };
    let (lines, received) = mpsc::channel();
    let stdout = child.stdout.take();
    let stderr = child.stderr.take();
    std::thread::scope(|scope| {
        scope.spawn(move || each_line(stdout, |line| drop(lines.send(line))));
        let messages = scope.spawn(move || last_lines(stderr));
        let mut heard = Instant::now();
        let cut_short = loop {
            match received.recv_timeout(INTERVAL) {
                Ok(line) => {
                    heard = Instant::now();
                    on_line(&line);
                }
                Err(RecvTimeoutError::Disconnected) => break None,
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => {
                    break Some(Ending::Stopped);
                }
                Err(RecvTimeoutError::Timeout) if heard.elapsed() > patience => break Some(Ending::Silent),
                Err(RecvTimeoutError::Timeout) => (),
            }
        };
        if cut_short.is_some() {
            // It fails if the process has just ended.
            let _ = child.kill();
        }
        let ending = ending(&mut child);
        (cut_short.unwrap_or(ending), messages.join().unwrap_or_default())
    })
}

fn ending(child: &mut Child) -> Ending {
    match child.wait() {
        Ok(status) if status.success() => Ending::Success,
        Ok(status) => Ending::Failure(status.to_string()),
        Err(error) => Ending::Failure(error.to_string()),
    }
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

    fn run(script: &str, patience: Duration) -> (Ending, Vec<String>, Vec<String>) {
        let mut lines = Vec::new();
        let mut shell = Command::new("sh");
        let never = Arc::new(AtomicBool::new(false));
        let (ending, messages) =
            supervise(shell.args(["-c", script]), patience, &never, |line| lines.push(line.to_owned()));
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
}
