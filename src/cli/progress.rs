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

/// Progress of a run at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Estimate {
    /// Frames made per second of this run.
    rate: f64,
    /// Seconds until all are made; infinite before the first.
    seconds_left: f64,
}

impl Estimate {
    /// After `seconds`: of `wanted`, `found` existed at the start, which says nothing about the rate, and `made` are new.
    fn new([found, made, wanted]: [u64; 3], seconds: f64) -> Self {
        let rate = made as f64 / seconds.max(1e-3);
        let left = wanted.saturating_sub(found + made);
        Self { rate, seconds_left: if left == 0 { 0.0 } else { left as f64 / rate } }
    }

    fn time_left(self) -> String {
        if self.seconds_left.is_finite() {
            format!("{} left", duration(self.seconds_left))
        } else {
            "time left unknown".to_owned()
        }
    }
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
        let unit = self.unit;
        let estimate = Estimate::new([found, made, wanted], self.start.elapsed().as_secs_f64());
        let message = format!("{:.2} {unit}/s{more}, {}", estimate.rate, estimate.time_left());
        if let Some(bar) = &self.bar {
            if bar.length().is_none() {
                bar.set_style(style(&format!("{{bar:32}} {{pos}}/{{len}} {unit}, {{msg}}")));
                bar.set_length(wanted);
            }
            bar.set_position(found + made);
            bar.set_message(message);
        } else if self.last_line.elapsed().as_secs() >= PLAIN_SECONDS && made > 0 {
            self.last_line = Instant::now();
            self.messages.note(format_args!("{}/{wanted} {unit}, {message}", found + made));
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
    fn frames_that_existed_do_not_shorten_the_estimate() {
        // 60 of 200 existed; 10 more took 5 s, so that the other 130 take 65 s.
        let estimate = Estimate::new([60, 10, 200], 5.0);
        assert_eq!(estimate, Estimate { rate: 2.0, seconds_left: 65.0 });
        assert_eq!(estimate.time_left(), "1 min 05 s left");
        assert_eq!(Estimate::new([0, 10, 140], 5.0), estimate, "as if none had existed");
        assert_eq!(Estimate::new([60, 0, 200], 5.0).time_left(), "time left unknown");
        assert_eq!(Estimate::new([60, 140, 200], 70.0).time_left(), "0.0 s left");
    }

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
