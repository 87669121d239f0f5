//! The light of an image, as the sensor records it at its own resolution: point spread, mosaic, readings, demosaicing, encoding, and the
//! reduction to the image. Works on bands of rows, so that no plane of the sensor's size is ever held.
//! Must not know: a frame, a scene.

use fearless_simd::{Level, dispatch};

use super::demosaic::{REACH, demosaic_row, mirrored};
use super::encoding::{SrgbCodes, reading_of};
use super::optics::{convolve_row, psf_taps, weighted_sum};
use super::readout::Readout;
use super::resampling::{Resampling, ResamplingTable};
use crate::scene::sensor::{Mosaic, Sensor};

/// Rows of the sensor in a band, if the image has no more rows than the sensor.
const BAND_ROWS: usize = 64;

/// What a sensor makes of an image.
pub(super) struct Recorder<'a> {
    sensor: &'a Sensor,
    readout: Readout,
    codes: &'static SrgbCodes,
    taps: Vec<f32>,
    /// Light on the image plane, 1 for the full well: one channel, or three with a mosaic.
    channels: &'a [Vec<f32>],
    /// Columns and rows of the image.
    image: [usize; 2],
    /// Columns and rows of the sensor.
    size: [usize; 2],
    /// Columns of the image to those of the sensor, and back.
    enlargement: ResamplingTable,
    reduction: ResamplingTable,
}

/// Rows of the image as the sensor's columns see them, after the point spread along the row.
struct WideRows {
    first: usize,
    width: usize,
    /// Of each row, a row of the mosaic's even rows and one of its odd rows; without a mosaic one row.
    rows: Vec<f32>,
    kinds: usize,
}

impl WideRows {
    fn row(&self, row: usize, kind: usize) -> &[f32] {
        &self.rows[((row - self.first) * self.kinds + kind) * self.width..][..self.width]
    }
}

impl<'a> Recorder<'a> {
    /// For an image of this size, of whose pixels each is the mean of this many samples along its side.
    pub(super) fn new(
        sensor: &'a Sensor,
        samples_per_side: u32,
        channels: &'a [Vec<f32>],
        image: [usize; 2],
    ) -> Self {
        let [width, height] = image;
        let size = match sensor.width_px as usize {
            0 => image,
            columns => [columns, ((columns * height + width / 2) / width).max(1)],
        };
        let (readout, taps) = (Readout::new(sensor), psf_taps(sensor.psf_px, samples_per_side));
        let table = |from, to| ResamplingTable::new(Resampling { from, to });
        let (enlargement, reduction) = (table(width, size[0]), table(size[0], width));
        let codes = SrgbCodes::shared();
        Self { sensor, readout, codes, taps, channels, image, size, enlargement, reduction }
    }

    /// Rows of the image in a band.
    pub(super) fn band_rows(&self) -> usize {
        (BAND_ROWS * self.image[1] / self.size[1]).max(1)
    }

    /// Writes the pixels of rows of the image, from row `first` on: red, green and blue of each, by `code` of the encoded value, 0 to 255.
    pub(super) fn record<T: Copy>(&self, first: usize, rgb: &mut [T], code: impl Fn(f32) -> T) {
        let (width, height) = (self.size[0], self.size[1]);
        let image_width = self.image[0];
        let rows = rgb.len() / (3 * image_width);
        let reduction = Resampling { from: height, to: self.image[1] };
        let needed = reduction.overlap(first).start..reduction.overlap(first + rows - 1).end;
        let codes = self.encoded_rows(needed.clone());
        let planes = if self.sensor.mosaic == Mosaic::Bayer { 3 } else { 1 };
        let (mut sums, mut reduced) = (vec![0.0; planes * width], vec![0.0; image_width]);
        for (row, rgb) in rgb.chunks_exact_mut(3 * image_width).enumerate() {
            let overlap = reduction.overlap(first + row);
            let weights: Vec<f32> =
                overlap.clone().map(|source| reduction.weight(first + row, source)).collect();
            let of_row = |tap: usize| {
                &codes[(overlap.start + tap - needed.start) * planes * width..][..planes * width]
            };
            dispatch!(Level::new(), _simd => weighted_sum(&weights, of_row, &mut sums));
            for (plane, sums) in sums.chunks_exact(width).enumerate() {
                self.reduction.resample(sums, &mut reduced);
                let last = if planes == 1 { 3 } else { 1 };
                for (rgb, value) in rgb.chunks_exact_mut(3).zip(&reduced) {
                    rgb[plane..plane + last].fill(code(*value));
                }
            }
        }
    }

    /// The light of an encoded value, 1 for white: at most 1, the full well.
    pub(super) fn light_of(&self, encoded: f32) -> f32 {
        reading_of(encoded, self.sensor.black_level as f32).min(1.0)
    }

    /// The encoded values, 0 to 255, of rows of the sensor: of each row its channels, one after another.
    fn encoded_rows(&self, rows: std::ops::Range<usize>) -> Vec<f32> {
        let [width, height] = self.size;
        let black = self.sensor.black_level as f32;
        if self.sensor.mosaic == Mosaic::Monochrome {
            let mut readings = self.readings(rows);
            self.codes.encode(&mut readings, black);
            return readings;
        }
        let with_neighbours = rows.start.saturating_sub(REACH)..(rows.end + REACH).min(height);
        let readings = self.readings(with_neighbours.clone());
        let stride = width + 2 * REACH;
        let mut padded = Vec::with_capacity(stride * with_neighbours.len());
        for row in readings.chunks_exact(width) {
            let column = |x: usize| row[mirrored(x as isize - REACH as isize, width)];
            padded.extend((0..REACH).map(column));
            padded.extend(row);
            padded.extend((REACH + width..stride).map(column));
        }
        let mut encoded = vec![0.0; 3 * width * rows.len()];
        for (y, channels) in rows.zip(encoded.chunks_exact_mut(3 * width)) {
            let row_of = |offset: isize| {
                let row = mirrored(y as isize + offset, height).max(with_neighbours.start);
                &padded[(row - with_neighbours.start).min(with_neighbours.len() - 1) * stride..][..stride]
            };
            let around = [-2, -1, 0, 1, 2].map(row_of);
            let (red, others) = channels.split_at_mut(width);
            let (green, blue) = others.split_at_mut(width);
            dispatch!(Level::new(), _simd => demosaic_row(around, y % 2 == 1, [red, green, blue]));
            self.codes.encode(channels, black);
        }
        encoded
    }

    /// The readings of rows of the sensor.
    fn readings(&self, rows: std::ops::Range<usize>) -> Vec<f32> {
        let [width, height] = self.size;
        let reach = self.taps.len() / 2;
        let spread = rows.start.saturating_sub(reach)..(rows.end + reach).min(height);
        let lines = Resampling { from: self.image[1], to: height };
        let wide = self.wide_rows(lines.overlap(spread.start).start..lines.overlap(spread.end - 1).end);
        let mut readings = vec![0.0; width * rows.len()];
        for (y, row) in rows.zip(readings.chunks_exact_mut(width)) {
            // The point spread along the column, and the rows of the image that the rows of the sensor around lie in.
            let mut sources: Vec<(usize, f32)> = Vec::new();
            for (tap, weight) in self.taps.iter().enumerate() {
                let line = (y + tap).saturating_sub(reach).min(height - 1);
                for source in lines.overlap(line) {
                    let weight = weight * lines.weight(line, source);
                    match sources.last_mut() {
                        Some((last, sum)) if *last == source => *sum += weight,
                        _ => sources.push((source, weight)),
                    }
                }
            }
            let weights: Vec<f32> = sources.iter().map(|(_, weight)| *weight).collect();
            let of_source = |tap: usize| wide.row(sources[tap].0, y % wide.kinds);
            dispatch!(Level::new(), _simd => weighted_sum(&weights, of_source, row));
            self.readout.read_row(y, row);
        }
        readings
    }

    fn wide_rows(&self, rows: std::ops::Range<usize>) -> WideRows {
        let width = self.size[0];
        let kinds = if self.channels.len() == 1 { 1 } else { 2 };
        let mut wide =
            WideRows { first: rows.start, width, rows: vec![0.0; kinds * width * rows.len()], kinds };
        let (mut enlarged, mut spread) = (vec![0.0; width], vec![0.0; width * self.channels.len()]);
        let mut padded = Vec::with_capacity(width + self.taps.len());
        for (row, target) in rows.zip(wide.rows.chunks_exact_mut(kinds * width)) {
            for (channel, spread) in self.channels.iter().zip(spread.chunks_exact_mut(width)) {
                self.enlargement.resample(&channel[row * self.image[0]..][..self.image[0]], &mut enlarged);
                convolve_row(&self.taps, &enlarged, &mut padded, spread);
            }
            if kinds == 1 {
                target.copy_from_slice(&spread);
                continue;
            }
            let (red, others) = spread.split_at(width);
            let (green, blue) = others.split_at(width);
            let (even, odd) = target.split_at_mut(width);
            for x in 0..width {
                even[x] = if x & 1 == 0 { red[x] } else { green[x] };
                odd[x] = if x & 1 == 0 { green[x] } else { blue[x] };
            }
        }
        wide
    }
}
