//! Progress of a run, on stderr: a bar on a terminal, else a line every few seconds.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::messages::Messages;

/// Seconds between lines where there is no terminal.
const PLAIN_SECONDS: u64 = 5;

/// A duration in the units that suit its length.
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

/// Shows how many frames (or masks) are finished.
pub(super) struct Meter {
    unit: &'static str,
    bar: Option<ProgressBar>,
    messages: Messages,
    start: Instant,
    last_line: Instant,
}

impl Meter {
    /// A meter that counts `unit`: frames, masks.
    pub(super) fn new(messages: Messages, unit: &'static str) -> Self {
        let bar = (!messages.quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            bar.set_style(style("{msg}"));
            bar.set_message("starting");
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        Self { unit, bar, messages, start: Instant::now(), last_line: Instant::now() }
    }

    /// Updates the display: of `wanted`, `found` existed at the start and `made` are new. `more` is printed after the rate.
    pub(super) fn show(&mut self, [found, made, wanted]: [u64; 3], more: &str) {
        let (unit, rate) = (self.unit, made as f64 / self.start.elapsed().as_secs_f64().max(1e-3));
        if let Some(bar) = &self.bar {
            if bar.length().is_none() {
                bar.set_style(style(&format!("{{bar:32}} {{pos}}/{{len}} {unit}, {{msg}}, {{eta}} left")));
                bar.set_length(wanted);
                bar.set_position(found);
                bar.reset_eta();
            }
            bar.set_position(found + made);
            bar.set_message(format!("{rate:.2} {unit}/s{more}"));
        } else if self.last_line.elapsed().as_secs() >= PLAIN_SECONDS && made > 0 {
            self.last_line = Instant::now();
            let left = wanted.saturating_sub(found + made) as f64 / rate.max(1e-9);
            self.messages.note(format_args!(
                "{}/{wanted} {unit}, {rate:.2} {unit}/s{more}, {} left",
                found + made,
                duration(left)
            ));
        }
    }

    /// Removes the bar.
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
    fn durations_have_units_that_suit_their_length() {
        for (seconds, text) in [
            (3.24, "3.2 s"),
            (59.9, "59.9 s"),
            (61.0, "1 min 01 s"),
            (3599.0, "59 min 59 s"),
            (7320.0, "2 h 02 min"),
        ] {
            assert_eq!(duration(seconds), text);
        }
    }
}
