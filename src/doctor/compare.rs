//! How two frames of a case differ, and whether they may.
//!
//! Must not know: who rendered them.

use serde_json::{Value, json};

use super::planes::Planes;

/// Largest fraction of the pixels whose class may differ between backends, each on an outline.
pub const MAX_OTHER_CLASS: f64 = 1e-3;
/// The same for instance ids, which have more outlines.
pub const MAX_OTHER_INSTANCE: f64 = 2e-3;
/// Largest relative difference of two depths that count as equal.
pub const EQUAL_DEPTH: f64 = 1e-5;
/// Largest fraction of the pixels whose depth may differ by more.
pub const MAX_OTHER_DEPTH: f64 = 1e-3;
/// The same for pixels that show a neighbouring triangle instead, as where a device rounds corners to coarser sub-pixel steps:
/// such depth deviates.
pub const MAX_NEIGHBOURING_DEPTH: f64 = 0.1;
/// Largest difference of two 8-bit colour values that count as equal.
pub const EQUAL_COLOUR: u8 = 2;
/// Largest fraction of the colour values that may differ by more.
pub const MAX_OTHER_COLOUR: f64 = 5e-4;
/// Mean difference of the 8-bit values from which on colour is wrong.
pub const WRONG_COLOUR_MEAN: f64 = 1.0;

/// Whether a plane is as it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Within the limits.
    Right,
    /// Colour beyond its limit, by less than anybody would see; depth of a neighbouring triangle in many pixels.
    Deviates,
    /// Beyond the limits.
    Wrong,
}

impl Verdict {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Deviates => "deviates",
            Self::Wrong => "wrong",
        }
    }

    const fn right_if(is_right: bool) -> Self {
        if is_right { Self::Right } else { Self::Wrong }
    }
}

/// The difference of a plane in two frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Name of the plane: `mask`, `instances`, `depth`, `colour`.
    pub plane: &'static str,
    /// Whether it is allowed.
    pub verdict: Verdict,
    /// The figures and their limits, in words.
    pub text: String,
    /// The same as JSON.
    pub figures: Value,
}

/// How strictly two frames are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Every label must be the same; else they may differ on outlines.
    pub exact_labels: bool,
    /// Largest relative difference of two depths that count as equal.
    pub equal_depth: f64,
}

/// The difference of each plane of `found` from `expected`, which has the same size.
#[must_use]
pub fn compare(found: &Planes, expected: &Planes, rule: Rule) -> [Difference; 4] {
    let width = found.size[0] as usize;
    let limit = |fraction| if rule.exact_labels { None } else { Some(fraction) };
    [
        labels("mask", &found.mask, &expected.mask, width, limit(MAX_OTHER_CLASS)),
        labels("instances", &found.instances, &expected.instances, width, limit(MAX_OTHER_INSTANCE)),
        depth(&found.depth_m, &expected.depth_m, width, rule.equal_depth),
        colour(&found.rgb, &expected.rgb),
    ]
}

/// The values at a pixel and at the eight around it.
fn around<T>(values: &[T], width: usize, pixel: usize) -> impl Iterator<Item = &T> {
    let (x, y) = (pixel % width, pixel / width);
    let rows = y.saturating_sub(1)..=(y + 1).min(values.len() / width - 1);
    rows.flat_map(move |y| &values[y * width + x.saturating_sub(1)..=y * width + (x + 1).min(width - 1)])
}

/// Pixels of another label; `limit` is the largest fraction of them, `None` if there may be none. A label that differs is on an
/// outline if it is that of a neighbour in the other frame, or if an outline passes there in the expected frame.
fn labels<T: PartialEq>(
    plane: &'static str,
    found: &[T],
    expected: &[T],
    width: usize,
    limit: Option<f64>,
) -> Difference {
    let other: Vec<usize> = (0..found.len()).filter(|&i| found[i] != expected[i]).collect();
    let has = |labels: &[T], i: usize, label: &T| around(labels, width, i).any(|other| other == label);
    let is_outline = |i: usize| around(expected, width, i).any(|other| *other != expected[i]);
    let is_inside =
        |&&i: &&usize| !has(expected, i, &found[i]) && !has(found, i, &expected[i]) && !is_outline(i);
    let inside = other.iter().filter(is_inside).count();
    let allowed = limit.map_or(0, |fraction| (fraction * found.len() as f64) as usize);
    let text = if limit.is_some() {
        format!("{} px differ (allowed {allowed}), {inside} of them off outlines (allowed 0)", other.len())
    } else {
        format!("{} px differ (allowed 0)", other.len())
    };
    Difference {
        plane,
        verdict: Verdict::right_if(other.len() <= allowed && inside == 0),
        text,
        figures: json!({ "pixels": found.len(), "differ": other.len(), "off_outlines": inside, "allowed": allowed }),
    }
}

/// Whether a depth lies in the range of those around a pixel, to within `equal`.
fn is_in_range(depth: f32, expected: &[f32], width: usize, pixel: usize, equal: f64) -> bool {
    let near = around(expected, width, pixel).copied().fold(f32::INFINITY, f32::min);
    let far = around(expected, width, pixel).copied().fold(0.0, f32::max);
    let [depth, near, far] = [depth, near, far].map(f64::from);
    depth >= near * (1.0 - equal) && depth <= far * (1.0 + equal)
}

fn depth(found: &[f32], expected: &[f32], width: usize, equal: f64) -> Difference {
    let relative = |(a, b): (&f32, &f32)| {
        let (a, b) = (f64::from(*a), f64::from(*b));
        if a == b { 0.0 } else { (a / b - 1.0).abs() }
    };
    let errors: Vec<f64> = found.iter().zip(expected).map(relative).collect();
    // NaN (one of two is the sky's infinity, or itself no number) counts as a difference.
    let is_beyond = |&i: &usize| errors[i].is_nan() || errors[i] > equal;
    let beyond: Vec<usize> = (0..errors.len()).filter(is_beyond).collect();
    let outside = beyond.iter().filter(|&&i| !is_in_range(found[i], expected, width, i, equal)).count();
    let allowed = (MAX_OTHER_DEPTH * errors.len() as f64) as usize;
    let allowed_neighbouring = (MAX_NEIGHBOURING_DEPTH * errors.len() as f64) as usize;
    let verdict = if beyond.len() <= allowed {
        Verdict::Right
    } else if outside <= allowed && beyond.len() <= allowed_neighbouring {
        Verdict::Deviates
    } else {
        Verdict::Wrong
    };
    let mut sorted = errors;
    sorted.sort_by(f64::total_cmp);
    let quantile = sorted[sorted.len().saturating_sub(1 + allowed)];
    Difference {
        plane: "depth",
        verdict,
        text: format!(
            "{} px differ by more than {equal:.1e} (allowed {allowed}; wrong from {allowed_neighbouring}), {outside} of them \
             beyond the depths around them (wrong from {allowed}); 99.9 % are within {quantile:.1e}",
            beyond.len()
        ),
        figures: json!({
            "pixels": sorted.len(), "differ": beyond.len(), "allowed": allowed, "beyond_neighbours": outside,
            "tolerance": equal, "within_999": quantile,
        }),
    }
}

fn colour(found: &[u8], expected: &[u8]) -> Difference {
    let steps = || found.iter().zip(expected).map(|(a, b)| a.abs_diff(*b));
    let beyond = steps().filter(|step| *step > EQUAL_COLOUR).count();
    let mean = steps().map(f64::from).sum::<f64>() / found.len() as f64;
    let max = steps().max().unwrap_or_default();
    let allowed = (MAX_OTHER_COLOUR * found.len() as f64) as usize;
    let verdict = if mean > WRONG_COLOUR_MEAN {
        Verdict::Wrong
    } else if beyond > allowed {
        Verdict::Deviates
    } else {
        Verdict::Right
    };
    Difference {
        plane: "colour",
        verdict,
        text: format!(
            "{beyond} values differ by more than {EQUAL_COLOUR} steps of 255 (allowed {allowed}); mean {mean:.4} (wrong from \
             {WRONG_COLOUR_MEAN}), largest {max}"
        ),
        figures: json!({ "values": found.len(), "differ": beyond, "allowed": allowed, "mean": mean, "largest": max }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 x 40 pixels: ground below, sky above from row 20 up.
    fn planes() -> Planes {
        let is_sky = |i: usize| i / 40 < 20;
        Planes {
            size: [40, 40],
            rgb: (0..4800).map(|i| (i % 251) as u8).collect(),
            mask: (0..1600).map(|i| if is_sky(i) { 2 } else { 0 }).collect(),
            instances: vec![0; 1600],
            depth_m: (0..1600).map(|i| if is_sky(i) { f32::INFINITY } else { 3.0 + i as f32 }).collect(),
        }
    }

    const OUTLINES: Rule = Rule { exact_labels: false, equal_depth: EQUAL_DEPTH };
    const EXACT: Rule = Rule { exact_labels: true, equal_depth: EQUAL_DEPTH };

    fn verdicts(found: &Planes, rule: Rule) -> [Verdict; 4] {
        compare(found, &planes(), rule).map(|difference| difference.verdict)
    }

    #[test]
    fn equal_frames_are_right() {
        assert_eq!(verdicts(&planes(), EXACT), [Verdict::Right; 4]);
    }

    #[test]
    fn a_class_may_differ_on_an_outline_only_and_rarely() {
        let with = |pixels: &[usize], class: u8| {
            let mut found = planes();
            pixels.iter().for_each(|&pixel| found.mask[pixel] = class);
            found
        };
        let on_outline = with(&[20 * 40 + 7], 2);
        assert_eq!(verdicts(&on_outline, OUTLINES)[0], Verdict::Right);
        assert_eq!(verdicts(&on_outline, EXACT)[0], Verdict::Wrong);
        let many = with(&[807, 809], 2);
        assert_eq!(verdicts(&many, OUTLINES)[0], Verdict::Wrong, "2 of 1600 is more than 0.1 %");
        // A rock of one pixel can fall between samples, but a patch cannot.
        assert_eq!(verdicts(&with(&[1207], 1), OUTLINES)[0], Verdict::Right);
        let patch = [1206, 1207, 1208, 1246, 1247, 1248, 1286, 1287, 1288];
        let difference = &compare(&with(&patch, 1), &planes(), OUTLINES)[0];
        assert_eq!((difference.verdict, &difference.figures["off_outlines"]), (Verdict::Wrong, &json!(1)));
    }

    #[test]
    fn instances_and_depth_are_compared() {
        let mut found = planes();
        found.instances[1207] = 9;
        assert_eq!(verdicts(&found, EXACT)[1], Verdict::Wrong);
        let scaled = |factor: f32| {
            let mut found = planes();
            found.depth_m.iter_mut().for_each(|depth| *depth *= factor);
            verdicts(&found, OUTLINES)[2]
        };
        assert_eq!(scaled(1.0 + 4e-6), Verdict::Right);
        assert_eq!(scaled(1.0 + 4e-5), Verdict::Wrong);
        // The depth of the next row in 5 % of the pixels is that of another triangle; in all of them it is wrong.
        let moved = |rows: usize| {
            let mut found = planes();
            let pixels = 25 * 40..(25 + rows) * 40;
            pixels.for_each(|i| found.depth_m[i] = 3.0 + (i + 1) as f32);
            verdicts(&found, OUTLINES)[2]
        };
        assert_eq!([moved(2), moved(10)], [Verdict::Deviates, Verdict::Wrong]);
        let mut found = planes();
        (1000..1003).for_each(|i| found.depth_m[i] *= 1.5);
        assert_eq!(verdicts(&found, OUTLINES)[2], Verdict::Wrong, "beyond all depths around");
        let mut found = planes();
        (0..3).for_each(|i| found.depth_m[i] = f32::NAN);
        assert_eq!(verdicts(&found, OUTLINES)[2], Verdict::Wrong, "no number is right");
    }

    #[test]
    fn colour_deviates_before_it_is_wrong() {
        let with = |count: usize, step: u8| {
            let mut found = planes();
            found.rgb.iter_mut().take(count).for_each(|value| *value = value.saturating_add(step));
            verdicts(&found, OUTLINES)[3]
        };
        assert_eq!(
            [with(4800, 1), with(2, 40), with(30, 40), with(4800, 4)],
            [Verdict::Right, Verdict::Right, Verdict::Deviates, Verdict::Wrong]
        );
    }
}
