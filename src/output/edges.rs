//! The ids of a mask near the boundaries of classes.
//!
//! Must not know: files.

use std::fmt;
use std::str::FromStr;

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

impl EdgePolicy {
    /// Largest width of the band, pixels.
    pub const MAX_BAND_PX: u32 = 64;

    /// The class ids of a frame under this rule.
    #[must_use]
    pub fn apply(self, frame: &Frame) -> Vec<u8> {
        let Self::Ignore(band_px) = self else { return frame.class.clone() };
        let (width, height, band) = (frame.width as usize, frame.height as usize, band_px as usize);
        // The filter is separable: smallest and largest id within the band along rows, then along columns.
        let min_max_along =
            |lines: &[[u8; 2]], count: usize, step: usize, starts: &dyn Fn(usize) -> usize| {
                let mut result = lines.to_vec();
                for line in 0..lines.len() / count {
                    let at = |i: usize| starts(line) + i * step;
                    for i in 0..count {
                        let near = i.saturating_sub(band)..(i + band + 1).min(count);
                        result[at(i)] = near
                            .map(|j| lines[at(j)])
                            .fold([u8::MAX, 0], |[low, high], [a, b]| [low.min(a), high.max(b)]);
                    }
                }
                result
            };
        let ids: Vec<[u8; 2]> = frame.class.iter().map(|&id| [id, id]).collect();
        let rows = min_max_along(&ids, width, 1, &|line| line * width);
        let both = min_max_along(&rows, height, width, &|line| line);
        let final_id =
            |(id, [low, high]): (&u8, [u8; 2])| if low == high { *id } else { ClassId::UNLABELLED.0 };
        frame.class.iter().zip(both).map(final_id).collect()
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
    fn a_single_pixel_clears_the_square_around_it() {
        let mut class = vec![2; 49];
        class[3 * 7 + 3] = 1;
        let frame = Frame { width: 7, height: 7, class, ..Frame::default() };
        let ids = EdgePolicy::Ignore(2).apply(&frame);
        let ignored = ids.iter().filter(|id| **id == 255).count();
        assert_eq!(ignored, 25);
        assert_eq!(ids[0], 2);
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
