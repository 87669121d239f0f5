//! Resampling by area: each sample is the mean of what it covers.
//! Must not know: what is resampled.

/// From a line of `from` samples to one of `to` samples of the same length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Resampling {
    pub from: usize,
    pub to: usize,
}

impl Resampling {
    /// The samples that sample `index` of the new line overlaps.
    #[inline]
    pub(super) fn overlap(self, index: usize) -> std::ops::Range<usize> {
        index * self.from / self.to..((index + 1) * self.from).div_ceil(self.to)
    }

    /// The part of sample `index` of the new line that lies in sample `source`: 1 where both lines have as many samples.
    #[inline]
    pub(super) fn weight(self, index: usize, source: usize) -> f32 {
        let start = (index * self.from).max(source * self.to);
        let end = ((index + 1) * self.from).min((source + 1) * self.to);
        (end - start) as f32 / self.from as f32
    }
}

/// A [`Resampling`] with its weights: for many rows.
#[derive(Clone, Debug)]
pub(super) struct ResamplingTable {
    /// First sample that each sample of the new line overlaps, and where its weights end in `weights`.
    spans: Vec<[u32; 2]>,
    weights: Vec<f32>,
    is_identity: bool,
}

impl ResamplingTable {
    pub(super) fn new(resampling: Resampling) -> Self {
        let (mut spans, mut weights) = (Vec::with_capacity(resampling.to), Vec::new());
        for index in 0..resampling.to {
            let overlap = resampling.overlap(index);
            weights.extend(overlap.clone().map(|source| resampling.weight(index, source)));
            spans.push([overlap.start as u32, weights.len() as u32]);
        }
        Self { spans, weights, is_identity: resampling.from == resampling.to }
    }

    /// Resamples a row.
    pub(super) fn resample(&self, row: &[f32], target: &mut [f32]) {
        if self.is_identity {
            target.copy_from_slice(row);
            return;
        }
        let mut first_weight = 0;
        for (value, &[first, end]) in target.iter_mut().zip(&self.spans) {
            let weights = &self.weights[first_weight..end as usize];
            let sources = &row[first as usize..first as usize + weights.len()];
            *value = weights.iter().zip(sources).map(|(weight, source)| weight * source).sum();
            first_weight = end as usize;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_keeps_the_mean_and_undoes_an_enlargement() {
        let row: Vec<f32> = (0..12).map(|i| libm::sinf(i as f32 * 1.3)).collect();
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        for to in [1, 5, 12, 24, 29, 60] {
            let mut resampled = vec![0.0; to];
            ResamplingTable::new(Resampling { from: 12, to }).resample(&row, &mut resampled);
            assert!((mean(&resampled) - mean(&row)).abs() < 1e-5, "{to}");
            if to % 12 == 0 {
                let mut back = vec![0.0; 12];
                ResamplingTable::new(Resampling { from: to, to: 12 }).resample(&resampled, &mut back);
                assert!(back.iter().zip(&row).all(|(a, b)| (a - b).abs() < 1e-6), "{to}");
            }
        }
    }
}
