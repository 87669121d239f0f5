//! Horizon heights behind the ground that hides each part of the sun's disc, kept where a finer grid begins.
//! Must not know: how they are found.

use std::ops::Range;

use super::heightfield::LANES;

/// Heights from which the lower and the upper limb of the sun are just visible, metres.
pub(super) type Limbs = [f32; 2];

/// Parts of the sun's disc, as fractions of its height from the lower limb, each with the ground that hides it up to the greatest height.
pub(super) const PARTS: [f32; 3] = [0.0, 0.5, 1.0];

/// Horizon heights behind the ground that hides each of the [`PARTS`]. The penumbra of ground far away is wide, and nearer ground in it
/// may hide more of the sun.
#[derive(Clone, Copy)]
pub(super) struct Occluders(pub(super) [Limbs; PARTS.len()]);

impl Occluders {
    /// Where nothing was computed.
    const NONE: Self = Self([[f32::MIN; 2]; PARTS.len()]);

    /// Those behind ground of a height.
    pub(super) fn raised_to_ground(self, ground_m: f32) -> Self {
        let mut raised = self.0;
        for (limbs, part) in raised.iter_mut().zip(PARTS) {
            if ground_m > limbs[0] + (limbs[1] - limbs[0]) * part {
                *limbs = [ground_m; 2];
            }
        }
        Self(raised)
    }
}

/// The occluders of a grid at the samples that a finer grid begins between: of each row a few columns.
#[derive(Default)]
pub(super) struct OccluderStrips {
    rows: Vec<Strip>,
    occluders: Vec<Occluders>,
}

/// The columns of a row, counted from the first of the grid, and where the first of them lies in the list.
#[derive(Clone, Debug, Default)]
struct Strip {
    columns: Range<usize>,
    first: usize,
}

/// The strips of rows that are swept at once.
pub(super) struct StripBatch<'a> {
    rows: &'a [Strip],
    occluders: &'a mut [Occluders],
    /// The columns that some row has.
    pub(super) columns: Range<usize>,
}

impl OccluderStrips {
    /// Strips of rows that hold the four corners of each of these cells, given by column and row.
    pub(super) fn new(rows: usize, cells: impl Iterator<Item = [usize; 2]>) -> Self {
        let mut strips = vec![Strip::default(); rows];
        for [column, row] in cells {
            for strip in &mut strips[row..row + 2] {
                let columns = &mut strip.columns;
                *columns = match columns.len() {
                    0 => column..column + 2,
                    _ => columns.start.min(column)..columns.end.max(column + 2),
                };
            }
        }
        let mut count = 0;
        for strip in &mut strips {
            strip.first = count;
            count += strip.columns.len();
        }
        Self { rows: strips, occluders: vec![Occluders::NONE; count] }
    }

    /// The strips of batches of [`LANES`] rows.
    pub(super) fn batches(&mut self) -> Vec<StripBatch<'_>> {
        let mut rest = &mut self.occluders[..];
        let mut batches = Vec::new();
        for rows in self.rows.chunks(LANES) {
            let filled =
                || rows.iter().map(|strip| &strip.columns).filter(|columns| !Range::is_empty(columns));
            let occluders = rest.split_off_mut(..filled().map(Range::len).sum()).unwrap_or_default();
            let start = filled().map(|columns| columns.start).min().unwrap_or(0);
            let end = filled().map(|columns| columns.end).max().unwrap_or(0);
            batches.push(StripBatch { rows, occluders, columns: start..end });
        }
        batches
    }

    /// The occluders at a sample, one that a cell has as its corner.
    pub(super) fn at(&self, column: usize, row: usize) -> Occluders {
        let strip = &self.rows[row];
        self.occluders[strip.first + column - strip.columns.start]
    }
}

impl StripBatch<'_> {
    /// Stores those of a column in the row of a lane, if its strip has the column.
    pub(super) fn store(&mut self, column: usize, lane: usize, occluders: Occluders) {
        let Some(strip) = self.rows.get(lane).filter(|strip| strip.columns.contains(&column)) else { return };
        let first = strip.first - self.rows[0].first;
        self.occluders[first + column - strip.columns.start] = occluders;
    }
}
