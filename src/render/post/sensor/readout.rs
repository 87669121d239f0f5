//! From the light on a row of pixels to its digital readings.
//! Must not know: optics, what becomes of the readings.

use fearless_simd::{Level, dispatch};

use super::noise::{BLOCK, normal_pairs, poisson, purpose};
use crate::rounding::floor;
use crate::scene::sensor::{FILM_GAMMA, FILM_TOE, Sensor};

/// Seed of the fixed pattern, which no frame changes.
const FIXED_PATTERN_SEED: u32 = 0x5e25_0a11;

/// The numbers of a sensor that its pixels need.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readout {
    full_well_e: f32,
    dark_e: f32,
    read_noise_e: f32,
    dsnu_e: f32,
    prnu: f32,
    max_code: f32,
    grain: f32,
    noise_seed: u32,
}

impl Readout {
    pub(super) fn new(sensor: &Sensor) -> Self {
        Self {
            full_well_e: sensor.full_well_e as f32,
            dark_e: sensor.dark_e as f32,
            read_noise_e: sensor.read_noise_e as f32,
            dsnu_e: sensor.dsnu_e as f32,
            prnu: sensor.prnu as f32,
            max_code: ((1_u32 << sensor.bits) - 1) as f32,
            grain: sensor.grain as f32,
            noise_seed: sensor.noise_seed,
        }
    }

    /// Replaces the fills of row `y` (1 is the full well) by digital readings, as parts of full scale, with the mean dark signal
    /// subtracted.
    pub(super) fn read_row(&self, y: usize, row: &mut [f32]) {
        for (block, fills) in row.chunks_mut(BLOCK).enumerate() {
            let mut values = [0.0; BLOCK];
            values[..fills.len()].copy_from_slice(fills);
            dispatch!(Level::new(), _simd => self.read_block(block * BLOCK, y, &mut values));
            fills.copy_from_slice(&values[..fills.len()]);
        }
    }

    // Inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    fn read_block(&self, x: usize, y: usize, values: &mut [f32; BLOCK]) {
        if self.grain > 0.0 {
            self.add_grain(x, y, values);
        }
        let [prnu, dsnu] = normal_pairs(x, y, purpose::FIXED_PATTERN, FIXED_PATTERN_SEED);
        let mut means_e = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let signal_e = values[lane] * self.full_well_e * (1.0 + self.prnu * prnu[lane]);
            means_e[lane] = (signal_e + self.dark_e + self.dsnu_e * dsnu[lane]).max(0.0);
        }
        let [shot, read] = normal_pairs(x, y, purpose::READOUT, self.noise_seed);
        let collected_e = poisson(&means_e, &shot, x, y, self.noise_seed);
        // The converter spans the dark signal to the full well, with some room below for noise.
        let (per_e, lowest) = (self.max_code / self.full_well_e, -0.02 * self.max_code);
        for lane in 0..BLOCK {
            let electrons =
                collected_e[lane].min(self.full_well_e + self.dark_e) + self.read_noise_e * read[lane];
            let code = ((electrons - self.dark_e) * per_e).clamp(lowest, self.max_code);
            values[lane] = floor(code + 0.5) as f32 / self.max_code;
        }
    }

    /// Adds the grain of film: its density D = gamma log10(1 + E / toe) has a deviation that grows with its root (Selwyn 1935).
    #[inline(always)]
    fn add_grain(&self, x: usize, y: usize, values: &mut [f32; BLOCK]) {
        let [normal, _] = normal_pairs(x, y, purpose::GRAIN, self.noise_seed);
        for (value, z) in values.iter_mut().zip(normal) {
            let exposed = value.max(0.0) + FILM_TOE;
            let density = FILM_GAMMA * log10(exposed * (1.0 / FILM_TOE));
            let deviation = self.grain * density.max(0.0).sqrt();
            *value += exposed * (std::f32::consts::LN_10 / FILM_GAMMA) * deviation * z;
        }
    }
}

/// Common logarithm of a number from 1 on, to 1e-3: a parabola between the powers of two.
#[inline(always)]
fn log10(x: f32) -> f32 {
    let bits = x.to_bits();
    let fraction = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000) - 1.0;
    let log2 = ((bits >> 23) as i32 - 127) as f32 + fraction * (1.345 - 0.345 * fraction);
    log2 * std::f32::consts::LOG10_2
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::*;
    use crate::scene::sensor::Mosaic;

    /// Mean and variance of the readings at a fill.
    fn readings(sensor: &Sensor, fill: f32) -> (f64, f64) {
        let readout = Readout::new(sensor);
        let mut values = Vec::new();
        for y in 0..200 {
            let mut row = [fill; 300];
            readout.read_row(y, &mut row);
            values.extend(row.map(f64::from));
        }
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        (mean, values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n)
    }

    /// Photon transfer (EMVA 1288, section 2.4): variance over mean is 1 for electrons, and the gain for readings.
    #[test]
    fn photon_transfer_curve_has_the_gain_as_slope_and_the_dark_noise_as_floor() {
        let sensor = Sensor { read_noise_e: 15.0, dark_e: 30.0, ..Sensor::ideal(Mosaic::Monochrome) };
        let points: Vec<(f64, f64)> =
            [0.001, 0.01, 0.1, 0.2, 0.4, 0.6].map(|fill| readings(&sensor, fill)).into();
        let n = points.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
        let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
        let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
            / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
        assert!((slope * 20_000.0 - 1.0).abs() < 0.03, "gain {}", slope * 20_000.0);
        let (dark_mean, dark_variance) = readings(&sensor, 0.0);
        let floor_e = dark_variance.sqrt() * 20_000.0;
        assert!(dark_mean.abs() < 1e-4, "{dark_mean}");
        // Read noise, shot noise of the dark signal, and quantisation noise.
        let expected = (15.0_f64.powi(2) + 30.0 + (20_000.0 / 16_383.0_f64).powi(2) / 12.0).sqrt();
        assert!((floor_e / expected - 1.0).abs() < 0.03, "{floor_e} for {expected}");
    }

    /// Readings vary as [`Sensor::noise_of`] says, fixed patterns included.
    #[test]
    fn noise_is_that_of_the_model() {
        for (dark_e, dsnu_e, full_well_e, bits, grain) in [
            (2.0, 3.0, 25_000.0, 12, 0.0),
            (20.0, 3.0, 10_000.0, 10, 0.0),
            (2000.0, 200.0, 25_000.0, 14, 0.0),
            (2.0, 3.0, 25_000.0, 14, 0.016),
        ] {
            let sensor = Sensor {
                read_noise_e: 8.0,
                dark_e,
                dsnu_e,
                prnu: 0.01,
                full_well_e,
                bits,
                grain,
                ..Sensor::ideal(Mosaic::Monochrome)
            };
            for fill in [0.002, 0.05, 0.5] {
                let (mean, variance) = readings(&sensor, fill);
                let expected = sensor.noise_of(f64::from(fill), 1.0);
                assert!((mean / f64::from(fill) - 1.0).abs() < 0.02, "{mean} for {fill}");
                assert!(
                    (variance.sqrt() / expected - 1.0).abs() < 0.04,
                    "{fill}: {} {expected}",
                    variance.sqrt()
                );
            }
        }
    }

    #[test]
    fn grain_is_strongest_where_film_is_dense() {
        let film = Sensor { full_well_e: 1e9, grain: 0.016, ..Sensor::ideal(Mosaic::Monochrome) };
        let deviations = [0.0, 0.02, 0.2, 0.8].map(|fill| readings(&film, fill).1.sqrt());
        assert!(deviations[0] < 1e-4, "{deviations:?}");
        // At E = 0.2: D = 0.73, dE = 0.22 ln(10) / 0.7 * 0.016 sqrt(D).
        assert!((deviations[2] - 0.0099).abs() < 0.0005, "{deviations:?}");
        assert!(deviations.windows(2).all(|pair| pair[0] < pair[1]), "{deviations:?}");
    }
}
