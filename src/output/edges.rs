//! The ids of a mask near the boundaries of classes.
//!
//! Must not know: files.

use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::frame::Frame;

/// The rule for pixels near the boundaries of classes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EdgePolicy {
    /// Every pixel keeps its class, which is that of the majority of its samples.
    #[default]
    Hard,
    /// A pixel within this many columns and rows of a pixel of another class becomes unlabelled, the ignore index for
    /// training.
    Ignore(u32),
}

/// Fractions of the pixels of a mask as it is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskCoverage {
    /// Of each class, in the order of [`ClassId::ALL`].
    pub classes: [f64; ClassId::ALL.len()],
    /// Of the ignore index: rocks that a label rule ignores, and the band at the boundaries of classes.
    pub ignored: f64,
}

impl EdgePolicy {
    /// Largest width of the band, pixels.
    pub const MAX_BAND_PX: u32 = 64;

    /// The class ids of a frame under this rule.
    fn apply(self, frame: &Frame) -> Vec<u8> {
        let Self::Ignore(band_px) = self else { return frame.class.clone() };
        let (width, height, band) = (frame.width as usize, frame.height as usize, band_px as usize);
        let changes = Changes::of(&frame.class, width, height);
        let mut ids = frame.class.clone();
        for (y, row) in ids.chunks_exact_mut(width).enumerate() {
            let (top, bottom) = (y.saturating_sub(band), (y + band + 1).min(height));
            for (x, id) in row.iter_mut().enumerate() {
                let (left, right) = (x.saturating_sub(band), (x + band + 1).min(width));
                if changes.occur_in([left, top, right, bottom]) {
                    *id = ClassId::UNLABELLED.0;
                }
            }
        }
        ids
    }
}

/// The class ids of one frame's mask under an edge policy. They are computed when first asked for, and once: rules, record and files of
/// the frame share them.
#[derive(Debug, Default)]
pub struct MaskIds {
    edges: EdgePolicy,
    with_band: OnceLock<Vec<u8>>,
}

impl MaskIds {
    /// Those of a frame that is named later.
    #[must_use]
    pub const fn new(edges: EdgePolicy) -> Self {
        Self { edges, with_band: OnceLock::new() }
    }

    /// The edge policy.
    #[must_use]
    pub const fn edges(&self) -> EdgePolicy {
        self.edges
    }

    /// The ids of the frame, which is the same in every call.
    #[must_use]
    pub fn of<'a>(&'a self, frame: &'a Frame) -> &'a [u8] {
        match self.edges {
            EdgePolicy::Hard => &frame.class,
            EdgePolicy::Ignore(_) => self.with_band.get_or_init(|| self.edges.apply(frame)),
        }
    }

    /// Makes the ids the classes of the frame.
    pub fn write_to(self, frame: &mut Frame) {
        if self.edges != EdgePolicy::Hard {
            frame.class = self.with_band.into_inner().unwrap_or_else(|| self.edges.apply(frame));
        }
    }

    /// Fractions of the pixels of the frame's mask.
    #[must_use]
    pub fn coverage(&self, frame: &Frame) -> MaskCoverage {
        let ids = self.of(frame);
        let fraction =
            |class: ClassId| ids.iter().filter(|id| **id == class.0).count() as f64 / ids.len() as f64;
        MaskCoverage {
            classes: ClassId::ALL.map(|class| fraction(class.id)),
            ignored: fraction(ClassId::UNLABELLED),
        }
    }
}

/// Where neighbours in a row or a column of an image differ, as summed-area tables (Crow 1984): a rectangle is looked at in one step,
/// whatever its size.
struct Changes {
    /// Columns of the table: one more than the image has.
    stride: usize,
    /// Number of pixels above and to the left of a corner that differ from their left and from their upper neighbour.
    sums: Vec<[u32; 2]>,
}

impl Changes {
    fn of(ids: &[u8], width: usize, height: usize) -> Self {
        let stride = width + 1;
        let mut sums = vec![[0; 2]; stride * (height + 1)];
        for y in 0..height {
            let mut of_row = [0; 2];
            for x in 0..width {
                let pixel = y * width + x;
                of_row[0] += u32::from(x > 0 && ids[pixel] != ids[pixel - 1]);
                of_row[1] += u32::from(y > 0 && ids[pixel] != ids[pixel - width]);
                let above = sums[y * stride + x + 1];
                sums[(y + 1) * stride + x + 1] = [above[0] + of_row[0], above[1] + of_row[1]];
            }
        }
        Self { stride, sums }
    }

    /// Whether two pixels of a rectangle (left, top, right, bottom, the last two excluded) differ.
    fn occur_in(&self, [left, top, right, bottom]: [usize; 4]) -> bool {
        let count = |axis: usize, left: usize, top: usize| {
            let sum = |x: usize, y: usize| self.sums[y * self.stride + x][axis];
            sum(right, bottom) + sum(left, top) - sum(left, bottom) - sum(right, top)
        };
        // The first column's left neighbours and the first row's upper ones are outside.
        count(0, left + 1, top) + count(1, left, top + 1) > 0
    }
}

impl fmt::Display for EdgePolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hard => write!(f, "hard"),
            Self::Ignore(band_px) => write!(f, "ignore:{band_px}"),
        }
    }
}

impl FromStr for EdgePolicy {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let band = text.strip_prefix("ignore:").and_then(|band| band.parse().ok());
        match (text, band) {
            ("hard", _) => Ok(Self::Hard),
            (_, Some(band_px @ 1..=Self::MAX_BAND_PX)) => Ok(Self::Ignore(band_px)),
            _ => Err(Error::Usage(format!(
                "--edges {text}: allowed are hard, and ignore:N with N from 1 to {} pixels",
                Self::MAX_BAND_PX
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_of_every_width_are_ignored_on_both_sides() {
        let class: Vec<u8> = (0..64).map(|i| if i % 8 < 4 { 0 } else { 1 }).collect();
        let frame = Frame { width: 8, height: 8, class: class.clone(), ..Frame::default() };
        assert_eq!(EdgePolicy::Hard.apply(&frame), class);
        for (band, row) in
            [(1, [0, 0, 0, 255, 255, 1, 1, 1]), (2, [0, 0, 255, 255, 255, 255, 1, 1]), (4, [255; 8])]
        {
            let ids = EdgePolicy::Ignore(band).apply(&frame);
            assert!(ids.chunks_exact(8).all(|line| line == row), "band {band}: {ids:?}");
        }
    }

    #[test]
    fn a_band_is_where_the_square_around_a_pixel_has_two_classes() {
        let (width, height) = (23_usize, 17);
        for seed in 0..20_usize {
            // Patches of three classes and of what is ignored already.
            let class_at = |x: usize, y: usize| [0, 1, 2, 255][(x / (3 + seed % 5) + y / 7 * seed) % 4];
            let class: Vec<u8> = (0..width * height).map(|i| class_at(i % width, i / width)).collect();
            let frame = Frame { width: 23, height: 17, class: class.clone(), ..Frame::default() };
            for band in [1, 2, 5, 64] {
                let expected = |i: usize| {
                    let near = |j: &usize| {
                        (i % width).abs_diff(j % width).max((i / width).abs_diff(j / width)) <= band
                    };
                    let is_uniform = (0..class.len()).filter(near).all(|j| class[j] == class[i]);
                    if is_uniform { class[i] } else { 255 }
                };
                let expected: Vec<u8> = (0..class.len()).map(expected).collect();
                assert_eq!(EdgePolicy::Ignore(band as u32).apply(&frame), expected, "{seed}, {band}");
            }
        }
    }

    #[test]
    fn a_single_pixel_clears_the_square_around_it() {
        let mut class = vec![2; 49];
        class[3 * 7 + 3] = 1;
        let frame = Frame { width: 7, height: 7, class, ..Frame::default() };
        let ids = EdgePolicy::Ignore(2).apply(&frame);
        let ignored = ids.iter().filter(|id| **id == 255).count();
        assert_eq!(ignored, 25);
        assert_eq!(ids[0], 2);
        let of_pixels = |classes: [f64; 3], ignored: f64| MaskCoverage {
            classes: classes.map(|pixels| pixels / 49.0),
            ignored: ignored / 49.0,
        };
        let coverage = |edges| MaskIds::new(edges).coverage(&frame);
        assert_eq!(coverage(EdgePolicy::Hard), of_pixels([0.0, 1.0, 48.0], 0.0));
        assert_eq!(coverage(EdgePolicy::Ignore(2)), of_pixels([0.0, 0.0, 24.0], 25.0));
    }

    #[test]
    fn a_band_is_computed_once() {
        let class: Vec<u8> = (0..64).map(|i| u8::from(i % 8 > 3)).collect();
        let mut frame = Frame { width: 8, height: 8, class: class.clone(), ..Frame::default() };
        for edges in [EdgePolicy::Hard, EdgePolicy::Ignore(1)] {
            let mask = MaskIds::new(edges);
            let first = mask.of(&frame);
            assert!(std::ptr::eq(first, mask.of(&frame)) && first == edges.apply(&frame), "{edges}");
            let expected = first.to_vec();
            mask.write_to(&mut frame);
            assert_eq!(frame.class, expected, "{edges}");
        }
        frame.class = class;
        let expected = EdgePolicy::Ignore(1).apply(&frame);
        MaskIds::new(EdgePolicy::Ignore(1)).write_to(&mut frame);
        assert_eq!(frame.class, expected, "also if it was not asked for before");
    }

    #[test]
    fn invalid_policies_are_refused() {
        for text in ["hard", "ignore:1", "ignore:64"] {
            assert_eq!(text.parse::<EdgePolicy>().expect(text).to_string(), text);
        }
        for text in ["soft", "ignore", "ignore:0", "ignore:65", "ignore:-1"] {
            assert!(text.parse::<EdgePolicy>().expect_err(text).to_string().contains("ignore:N"));
        }
    }
}
