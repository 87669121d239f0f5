//! The size-frequency distribution of rocks on the Moon.
//!
//! Must not know: where rocks lie.

use crate::random::Stream;

/// The coverage whose rocks are drawn: none is larger. Of those, the ones that [`Abundance`] has are there.
pub(super) const DENSEST_COVERAGE: f64 = 0.12;
/// Diameter below which the exponential law misses rocks that the Surveyors counted and a power law takes over, metres.
const TAIL_M: f64 = 0.10;
/// Exponent of that power law (Shoemaker and Morris for Surveyor I: N proportional to D^-2.11).
const TAIL_EXPONENT: f64 = 2.11;
/// Cumulative size-frequency distribution: rocks larger than a diameter (metres) per square metre.
///
/// Li and Wu 2018's law for the Moon, in the form of JPL's LuNaSynth: rocks larger than D cover a fraction k exp(-q D) of
/// the ground, q = 0.5648 + 0.01285 / k; below `TAIL_M` the Surveyors' power law.
#[must_use]
pub fn rocks_larger_than(diameter_m: f64, coverage: f64) -> f64 {
    if coverage <= 0.0 {
        return 0.0;
    }
    if diameter_m < TAIL_M {
        return in_tail(diameter_m, rocks_larger_than(TAIL_M, coverage));
    }
    let q = decay_per_m(coverage);
    // Integral of k q exp(-q x) / (pi x^2 / 4) over the logarithm of x, by Simpson's rule.
    let at = |log: f64| {
        let x = libm::exp(log);
        coverage * q * libm::exp(-q * x) * 4.0 / (std::f64::consts::PI * x)
    };
    let (low, high, steps) = (libm::log(diameter_m), libm::log(40.0), 64);
    let step = (high - low) / f64::from(steps);
    let inner: f64 =
        (1..steps).map(|i| if i % 2 == 1 { 4.0 } else { 2.0 } * at(low + step * f64::from(i))).sum();
    step / 3.0 * (at(low) + inner + at(high))
}

/// The law's q at a coverage, 1/m.
fn decay_per_m(coverage: f64) -> f64 {
    0.5648 + 0.01285 / coverage
}

/// Rocks larger than a diameter (metres) in the tail, by those larger than all of it.
fn in_tail(diameter_m: f64, larger_than_tail: f64) -> f64 {
    larger_than_tail * libm::pow(diameter_m / TAIL_M, -TAIL_EXPONENT)
}

/// Tabulated inverse of the cumulative distribution within a range of diameters.
pub(super) struct Sizes {
    logs: Vec<f64>,
    larger: Vec<f64>,
}

impl Sizes {
    const STEPS: u32 = 24;

    /// The table from `low_m` to `high_m`.
    pub(super) fn new(low_m: f64, high_m: f64, coverage: f64) -> Self {
        let logs: Vec<f64> = (0..=Self::STEPS).map(|step| Self::log_at(low_m, high_m, step)).collect();
        // One integral for all of the tail.
        let larger_than_tail = if low_m < TAIL_M { rocks_larger_than(TAIL_M, coverage) } else { 0.0 };
        let larger = |log: &f64| {
            let diameter_m = libm::exp(*log);
            if diameter_m < TAIL_M {
                in_tail(diameter_m, larger_than_tail)
            } else {
                rocks_larger_than(diameter_m, coverage)
            }
        };
        let larger = logs.iter().map(larger).collect();
        Self { logs, larger }
    }

    /// Logarithm of the diameter at a step of the table, metres.
    fn log_at(low_m: f64, high_m: f64, step: u32) -> f64 {
        libm::log(low_m) + (libm::log(high_m) - libm::log(low_m)) * f64::from(step) / f64::from(Self::STEPS)
    }

    /// Rocks of the range per square metre.
    pub(super) fn density(&self) -> f64 {
        self.larger[0] - self.larger[self.larger.len() - 1]
    }

    /// Middles of the steps of the table, metres, and their rocks per square metre.
    pub(super) fn bins(&self) -> impl Iterator<Item = (f64, f64)> {
        let middle = |logs: &[f64]| libm::exp(0.5 * (logs[0] + logs[1]));
        self.logs.windows(2).map(middle).zip(self.larger.windows(2).map(|larger| larger[0] - larger[1]))
    }

    /// Draws a diameter, metres.
    pub(super) fn draw(&self, stream: &mut Stream) -> f64 {
        let wanted = self.larger[0] - self.density() * stream.unit();
        let after = self.larger.partition_point(|larger| *larger > wanted).clamp(1, self.larger.len() - 1);
        let (high, low) = (self.larger[after - 1], self.larger[after]);
        let t = if high > low { (high - wanted) / (high - low) } else { 0.0 };
        libm::exp(self.logs[after - 1] + (self.logs[after] - self.logs[after - 1]) * t)
    }
}

/// How many rocks of a diameter there are at a coverage, as a fraction of those at [`DENSEST_COVERAGE`].
///
/// Each rock of the densest field has a level, uniform between 0 and 1, and is there where the level is below the abundance of its
/// diameter (thinning of a Poisson process: Lewis and Shedler 1979). Abundances rise with the coverage, so that another coverage adds
/// rocks or takes them away, and moves none.
pub(super) struct Abundance {
    /// Of the tail.
    tail: f64,
    /// Above it: a factor, and the decay over that of the densest field, 1/m.
    factor: f64,
    decay_per_m: f64,
}

impl Abundance {
    /// The abundance at a coverage above 0.
    pub(super) fn new(coverage: f64) -> Self {
        let [q, densest_q] = [coverage, DENSEST_COVERAGE].map(decay_per_m);
        Self {
            tail: rocks_larger_than(TAIL_M, coverage) / rocks_larger_than(TAIL_M, DENSEST_COVERAGE),
            factor: coverage * q / (DENSEST_COVERAGE * densest_q),
            decay_per_m: q - densest_q,
        }
    }

    /// Of rocks of a diameter, metres.
    pub(super) fn at(&self, diameter_m: f64) -> f64 {
        if diameter_m < TAIL_M { self.tail } else { self.factor * libm::exp(-self.decay_per_m * diameter_m) }
    }

    /// The largest of any diameter from `low_m`: it falls with the diameter, but for a step up at the end of the tail.
    pub(super) fn largest_from(&self, low_m: f64) -> f64 {
        self.at(low_m).max(self.at(low_m.max(TAIL_M)))
    }
}

/// Draws from the Poisson distribution with this mean (Knuth's multiplication method; the means here are small).
pub(super) fn poisson(mean: f64, stream: &mut Stream) -> u32 {
    let limit = libm::exp(-mean);
    let (mut count, mut product) = (0, stream.unit());
    while product > limit && count < 10_000 {
        count += 1;
        product *= stream.unit();
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_holds_the_law_to_the_bit_above_and_in_the_tail() {
        for (low_m, high_m, coverage) in
            [(0.02, 0.04, 0.01), (0.07, 0.14, 0.05), (0.5, 1.0, 0.1), (0.02, 0.04, 0.0)]
        {
            let sizes = Sizes::new(low_m, high_m, coverage);
            for (log, larger) in sizes.logs.iter().zip(&sizes.larger) {
                assert_eq!(larger.to_bits(), rocks_larger_than(libm::exp(*log), coverage).to_bits());
            }
        }
    }

    #[test]
    fn an_abundance_is_the_ratio_of_the_laws_and_rises_with_the_coverage() {
        let between = |middle_m: f64, coverage| {
            let [low_m, high_m] = [0.999, 1.001].map(|factor| factor * middle_m);
            rocks_larger_than(low_m, coverage) - rocks_larger_than(high_m, coverage)
        };
        for diameter_m in [0.03, 0.07, 0.12, 0.3, 1.1, 3.7] {
            let mut before = 0.0;
            for coverage in [0.002, 0.008, 0.0088, 0.03, 0.1, DENSEST_COVERAGE] {
                let found = Abundance::new(coverage).at(diameter_m);
                let expected = between(diameter_m, coverage) / between(diameter_m, DENSEST_COVERAGE);
                assert!(
                    // As exact as the integral of the law is for large rocks at a low coverage.
                    (found / expected - 1.0).abs() < 5e-3,
                    "{found} of the rocks of {diameter_m} m at {coverage}, {expected} by the law"
                );
                assert!(found > before && found <= 1.0 + 1e-12, "{found} after {before} at {coverage}");
                before = found;
            }
        }
    }

    #[test]
    fn no_abundance_of_a_range_is_above_its_largest() {
        for coverage in [0.002, 0.03, DENSEST_COVERAGE] {
            let abundance = Abundance::new(coverage);
            for low_m in [0.03, 0.0625, 0.09, 0.1, 0.125, 2.0] {
                let largest = abundance.largest_from(low_m);
                for step in 0..=100 {
                    let diameter_m = low_m * (1.0 + 0.01 * f64::from(step));
                    assert!(abundance.at(diameter_m) <= largest, "of {diameter_m} m, from {low_m} m");
                }
            }
        }
    }
}
