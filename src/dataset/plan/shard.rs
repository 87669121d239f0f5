//! The frames of a run among all frames of a dataset.
//!
//! Must not know: how frames are made, files.

use std::str::FromStr;

use crate::error::{Error, Result};

/// The frames i with i mod `of` = `number`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, from 0.
    pub number: u64,
    /// Number of shards.
    pub of: u64,
}

impl Shard {
    /// The one shard that has all frames.
    pub const WHOLE: Self = Self { number: 0, of: 1 };

    /// Whether a frame belongs to the shard.
    #[must_use]
    pub const fn contains(self, index: u64) -> bool {
        index % self.of == self.number
    }

    /// The first frame from `start` on that belongs to the shard.
    #[must_use]
    pub const fn first_from(self, start: u64) -> u64 {
        let remainder = start % self.of;
        let distance = if self.number >= remainder {
            self.number - remainder
        } else {
            self.of - (remainder - self.number)
        };
        start.saturating_add(distance)
    }

    /// Number of frames of a range that belong to the shard.
    #[must_use]
    pub fn count_in(self, range: &std::ops::Range<u64>) -> u64 {
        let before = |end: u64| end.saturating_sub(self.number).div_ceil(self.of);
        before(range.end).saturating_sub(before(range.start))
    }

    /// The tag of its temporary files, by which shards that share a folder know their own.
    #[must_use]
    pub fn tag(self) -> String {
        format!("{}of{}", self.number, self.of)
    }

    /// Whether a tag is that of some shard.
    #[must_use]
    pub fn has_tag(tag: &str) -> bool {
        let numbers = tag.split_once("of");
        numbers.is_some_and(|(i, n)| i.parse::<u64>().is_ok() && n.parse::<u64>().is_ok())
    }
}

impl FromStr for Shard {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        numbers.filter(|(number, of)| number < of).map(|(number, of)| Self { number, of }).ok_or_else(|| {
            Error::Usage(format!("--shard {text}: the form is I/N with I from 0 to N - 1, as in 0/4"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_partition_the_frames() {
        let shards: Vec<Shard> = (0..3).map(|i| format!("{i}/3").parse().expect("a shard")).collect();
        for index in 0..30 {
            assert_eq!(shards.iter().filter(|shard| shard.contains(index)).count(), 1);
        }
        for (start, end) in [(0, 0), (0, 1), (1, 2), (2, 9), (5, 30), (7, 7)] {
            for shard in &shards {
                let expected = (start..end).filter(|index| shard.contains(*index)).count();
                assert_eq!(shard.count_in(&(start..end)), expected as u64, "{shard:?} of {start}..{end}");
                let first = (start..).find(|index| shard.contains(*index));
                assert_eq!(Some(shard.first_from(start)), first, "{shard:?} from {start}");
            }
        }
        for wrong in ["3/3", "1", "-1/2", "a/b", "0/0", ""] {
            let message = wrong.parse::<Shard>().expect_err(wrong).to_string();
            assert!(message.contains("I/N"), "{message}");
        }
    }
}
