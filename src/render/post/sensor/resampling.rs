//! Resampling by area: each sample is the mean of what it covers.
//! Must not know: what is resampled.

use fearless_simd::{Level, dispatch};

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
    resampling: Resampling,
}

impl ResamplingTable {
    pub(super) fn new(resampling: Resampling) -> Self {
        let (mut spans, mut weights) = (Vec::with_capacity(resampling.to), Vec::new());
        for index in 0..resampling.to {
            let overlap = resampling.overlap(index);
            weights.extend(overlap.clone().map(|source| resampling.weight(index, source)));
            spans.push([overlap.start as u32, weights.len() as u32]);
        }
        Self { spans, weights, resampling }
    }

    /// Resamples a row.
    pub(super) fn resample(&self, row: &[f32], target: &mut [f32]) {
        let Resampling { from, to } = self.resampling;
        if to == from {
            target.copy_from_slice(row);
        } else if to == 2 * from {
            double(row, target);
        } else if from == 2 * to {
            dispatch!(Level::new(), _simd => means::<2>(row, target));
        } else if from == 4 * to {
            dispatch!(Level::new(), _simd => means::<4>(row, target));
        } else {
            self.resample_any(row, target);
        }
    }

    /// The same for any numbers of samples.
    fn resample_any(&self, row: &[f32], target: &mut [f32]) {
        let mut first_weight = 0;
        for (value, &[first, end]) in target.iter_mut().zip(&self.spans) {
            let weights = &self.weights[first_weight..end as usize];
            let sources = &row[first as usize..first as usize + weights.len()];
            *value = weights.iter().zip(sources).map(|(weight, source)| weight * source).sum();
            first_weight = end as usize;
        }
    }
}

/// Each sample twice.
fn double(row: &[f32], target: &mut [f32]) {
    for (pair, source) in target.as_chunks_mut::<2>().0.iter_mut().zip(row) {
        *pair = [*source; 2];
    }
}

/// The mean of each `COUNT` samples.
#[inline(always)]
fn means<const COUNT: usize>(row: &[f32], target: &mut [f32]) {
    let weight = 1.0 / COUNT as f32;
    for (value, sources) in target.iter_mut().zip(row.as_chunks::<COUNT>().0) {
        *value = sources.iter().map(|source| weight * source).sum();
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

    #[test]
    fn integer_ratios_have_the_bits_of_any_other() {
        let row: Vec<f32> = (0..24).map(|i| libm::sinf(i as f32 * 1.3)).collect();
        for to in [6, 8, 12, 24, 48, 72, 96] {
            let table = ResamplingTable::new(Resampling { from: 24, to });
            let [mut found, mut expected] = [(); 2].map(|()| vec![0.0; to]);
            table.resample(&row, &mut found);
            table.resample_any(&row, &mut expected);
            assert_eq!(found, expected, "{to}");
        }
    }
}
