//! How far a run has come, for people: on stderr.

use std::fmt::Display;
use std::io::{IsTerminal as _, Write as _};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::Messages;

/// Seconds between plain lines.
const PLAIN_SECONDS: u64 = 5;

/// A line for people. One that cannot be written, because nobody reads or the disk is full, is no reason to stop.
pub(crate) fn note(text: impl Display) {
    // In one piece, so that lines of several threads do not mix.
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Seconds as people say them.
pub(super) fn duration(seconds: f64) -> String {
    let whole = seconds as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// A bar on a terminal, else a line every few seconds.
pub(super) struct Meter {
    what: &'static str,
    bar: Option<ProgressBar>,
    messages: Messages,
    start: Instant,
    shown: Instant,
}

impl Meter {
    /// Counts `what`; tells as much as is asked for.
    pub(super) fn new(messages: Messages, what: &'static str) -> Self {
        let bar = (!messages.quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            bar.set_style(style("{msg}"));
            bar.set_message("starting");
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        Self { what, bar, messages, start: Instant::now(), shown: Instant::now() }
    }

    /// Of `wanted`, `found` were there at the start and `made` have been added; `more` is said beside the speed.
    pub(super) fn show(&mut self, [found, made, wanted]: [u64; 3], more: &str) {
        let (what, rate) = (self.what, made as f64 / self.start.elapsed().as_secs_f64().max(1e-3));
        if let Some(bar) = &self.bar {
            if bar.length().is_none() {
                bar.set_style(style(&format!("{{bar:32}} {{pos}}/{{len}} {what}, {{msg}}, {{eta}} left")));
                bar.set_length(wanted);
                bar.set_position(found);
                bar.reset_eta();
            }
            bar.set_position(found + made);
            bar.set_message(format!("{rate:.2} {what}/s{more}"));
        } else if self.shown.elapsed().as_secs() >= PLAIN_SECONDS && made > 0 {
            self.shown = Instant::now();
            let left = wanted.saturating_sub(found + made) as f64 / rate.max(1e-9);
            self.messages.note(format_args!(
                "{}/{wanted} {what}, {rate:.2} {what}/s{more}, {} left",
                found + made,
                duration(left)
            ));
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_said_in_the_units_that_fit() {
        for (seconds, said) in [
            (3.24, "3.2 s"),
            (59.9, "59.9 s"),
            (61.0, "1 min 01 s"),
            (3599.0, "59 min 59 s"),
            (7320.0, "2 h 02 min"),
        ] {
            assert_eq!(duration(seconds), said);
        }
    }
}
