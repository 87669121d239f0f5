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

    /// Resamples a row.
    pub(super) fn resample(self, row: &[f32], target: &mut [f32]) {
        if self.from == self.to {
            target.copy_from_slice(row);
            return;
        }
        for (index, value) in target.iter_mut().enumerate() {
            *value = self.overlap(index).map(|source| self.weight(index, source) * row[source]).sum();
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
            Resampling { from: 12, to }.resample(&row, &mut resampled);
            assert!((mean(&resampled) - mean(&row)).abs() < 1e-5, "{to}");
            if to % 12 == 0 {
                let mut back = vec![0.0; 12];
                Resampling { from: to, to: 12 }.resample(&resampled, &mut back);
                assert!(back.iter().zip(&row).all(|(a, b)| (a - b).abs() < 1e-6), "{to}");
            }
        }
    }
}
