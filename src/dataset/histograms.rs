//! Histograms of a finished dataset as SVG: every knob that varies, class coverage, brightness.
//!
//! Must not know: how frames are made.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;

use crate::error::Result;
use crate::output::Artifact;
use crate::output::layout::{FrameLine, FrameLines};

/// Their file name.
pub(super) const HISTOGRAMS_FILE: &str = "histograms.svg";

/// Bins of a histogram.
const BINS: usize = 24;

/// A quantity's name, range and counts per bin.
struct Histogram {
    name: String,
    range: [f64; 2],
    counts: [u64; BINS],
}

impl Histogram {
    fn add(&mut self, value: f64) {
        let [low, high] = self.range;
        let bin = ((value - low) / (high - low) * BINS as f64) as usize;
        self.counts[bin.min(BINS - 1)] += 1;
    }
}

/// The histograms as [`HISTOGRAMS_FILE`]. Reads the lines twice: for the ranges, then for the counts.
///
/// # Errors
/// Those of reading.
pub(super) fn svg(lines: &dyn FrameLines) -> Result<Artifact> {
    let mut ranges: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    let mut order: Vec<String> = Vec::new();
    lines.for_each(&mut |line| {
        for (name, value) in quantities(&line) {
            let range = ranges.entry(name.clone()).or_insert_with(|| {
                order.push(name);
                [value; 2]
            });
            *range = [range[0].min(value), range[1].max(value)];
        }
        Ok(())
    })?;
    order.retain(|name| ranges[name][0] < ranges[name][1]);
    let index_of: BTreeMap<&str, usize> =
        order.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
    let mut histograms: Vec<Histogram> = order
        .iter()
        .map(|name| Histogram { name: name.clone(), range: ranges[name], counts: [0; BINS] })
        .collect();
    lines.for_each(&mut |line| {
        for (name, value) in quantities(&line) {
            if let Some(&index) = index_of.get(name.as_str()) {
                histograms[index].add(value);
            }
        }
        Ok(())
    })?;
    Ok(Artifact { name: HISTOGRAMS_FILE.to_owned(), bytes: draw(&histograms).into_bytes() })
}

/// The numbers of a line that differ from frame to frame, with their names.
fn quantities(line: &FrameLine) -> Vec<(String, f64)> {
    let number =
        |prefix: &str, (key, value): (&String, &Value)| Some((format!("{prefix}{key}"), value.as_f64()?));
    let knobs = line.knobs.iter().filter_map(|entry| number("", entry));
    let coverage = line.coverage.iter().filter_map(|entry| number("share of ", entry));
    let rgb = [("mean", line.rgb.mean), ("p99", line.rgb.p99.into()), ("max", line.rgb.max.into())];
    let rgb = rgb.map(|(name, value): (&str, f64)| (format!("RGB {name}"), value));
    knobs.chain(coverage).chain(rgb).collect()
}

/// Bar charts in rows of four, each with its name above and its range below.
fn draw(histograms: &[Histogram]) -> String {
    const COLUMNS: usize = 4;
    const WIDTH: usize = 240;
    const HEIGHT: usize = 130;
    let rows = histograms.len().div_ceil(COLUMNS).max(1);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        COLUMNS * WIDTH,
        rows * HEIGHT
    );
    for (i, histogram) in histograms.iter().enumerate() {
        // Writing into a string cannot fail.
        let _ = draw_chart(&mut svg, [i % COLUMNS * WIDTH + 12, i / COLUMNS * HEIGHT + 16], histogram);
    }
    svg.push_str("</svg>\n");
    svg
}

/// One chart with its top left corner at `x`, `y`.
fn draw_chart(svg: &mut String, [x, y]: [usize; 2], histogram: &Histogram) -> std::fmt::Result {
    const CHART_HEIGHT: f64 = 80.0;
    const BAR_WIDTH: usize = 9;
    let Histogram { name, range: [low, high], counts } = histogram;
    // The name may be a key of somebody else's line: as text of XML it cannot become an element.
    let name = name.replace('&', "&amp;").replace('<', "&lt;");
    writeln!(svg, "<g transform=\"translate({x} {y})\">\n<text font-weight=\"bold\">{name}</text>")?;
    let max = counts.iter().copied().max().unwrap_or(1).max(1);
    for (bar, count) in counts.iter().enumerate() {
        let height = CHART_HEIGHT * *count as f64 / max as f64;
        writeln!(
            svg,
            "<rect x=\"{}\" y=\"{:.1}\" width=\"{}\" height=\"{height:.1}\" fill=\"#44628c\"/>",
            bar * BAR_WIDTH,
            8.0 + CHART_HEIGHT - height,
            BAR_WIDTH - 1
        )?;
    }
    writeln!(
        svg,
        "<text y=\"102\">{}</text><text x=\"{}\" y=\"102\" text-anchor=\"end\">{}</text>\n</g>",
        short(*low),
        BINS * BAR_WIDTH,
        short(*high)
    )
}

/// A number with about four significant digits.
fn short(value: f64) -> String {
    let digits = if value.abs() >= 100.0 {
        0
    } else if value.abs() >= 1.0 {
        2
    } else {
        4
    };
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_never_becomes_an_element() {
        let name = "<script>&</script>".to_owned();
        let svg = draw(&[Histogram { name, range: [0.0, 1.0], counts: [1; BINS] }]);
        assert!(svg.contains(">&lt;script>&amp;&lt;/script></text>"), "{svg}");
    }
}
