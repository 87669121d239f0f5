//! A histogram: how many values are in each of many bins, and in which bin the value of a rank is.
//! Must not know: what the values are.

/// How many values are in each bin.
pub(super) struct Histogram {
    counts: Vec<u32>,
}

impl Histogram {
    /// Of values given by their bins, which are below `bins`.
    pub(super) fn new(bins: usize, values: impl Iterator<Item = usize>) -> Self {
        let mut counts = vec![0; bins];
        values.for_each(|bin| counts[bin] += 1);
        Self { counts }
    }

    /// Number of values in the bins from `first` on.
    pub(super) fn count(&self, first: usize) -> u64 {
        self.counts[first..].iter().map(|count| u64::from(*count)).sum()
    }

    /// The bin of a value in the bins from `first` on, where `rank` others of those are before it; `None` if there are no more.
    pub(super) fn bin_of_rank(&self, rank: u64, first: usize) -> Option<usize> {
        let mut before = 0;
        let bin = self.counts[first..].iter().position(|count| {
            before += u64::from(*count);
            before > rank
        })?;
        Some(first + bin)
    }
}
