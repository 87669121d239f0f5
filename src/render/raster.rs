//! Triangles by the rules of the devices, for what this program rasterises itself.
//!
//! Corners lie in 1/256 of a texel, a texel is covered where its middle is, and of two triangles that meet there one covers it.
//! A driver that is a CPU takes several times as long for a triangle of a few texels, and takes one after the other.
//! Must not know: what is drawn.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};

use crate::scene::noise::floor;

/// Parts of a texel that corners are rounded to.
pub const PARTS: i32 = 1 << PARTS_BITS;
const PARTS_BITS: i32 = 8;
/// Furthest that a place may be from where it is counted from, either way, texels, to be rounded to parts.
pub const FURTHEST_PX: f32 = 16_384.0;
/// Texels that a triangle may span for 32 bits to hold its area, in parts.
const SPAN_PX: i32 = 64;
/// Columns and rows of texels that are painted at once: a buffer has so many more columns, and rows, than are asked for.
pub const WIDTH: usize = 4;
/// See [`WIDTH`].
pub const HEIGHT: usize = 2;

/// Where a corner is: parts of a texel from the middle of the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// To the right.
    pub x: i32,
    /// Down.
    pub y: i32,
}

impl Place {
    /// From texels, of which the first has its middle at a half.
    #[must_use]
    #[inline(always)]
    pub fn from_px(x: f32, y: f32) -> Self {
        let part = |place: f32| floor((place - 0.5) * PARTS as f32 + 0.5);
        Self { x: part(x), y: part(y) }
    }
}

/// What texels are painted with.
pub trait Paint<S: Simd> {
    /// Paints those of eight texels that are `inside` a triangle: four of a row from place `texels[0]` of a buffer on, and four
    /// of the next from `texels[1]`. `b` and `c` are proportional to the shares of the second and the third corner.
    fn paint(&mut self, simd: S, texels: [usize; 2], inside: mask32x8<S>, b: f32x8<S>, c: f32x8<S>);
}

/// The line from a corner to another: how far beside it a place is, times its length; above 0 on the triangle's side.
#[derive(Clone, Copy, Debug)]
struct Edge {
    from: Place,
    x: i32,
    y: i32,
    /// What is taken off so that 0 is on the triangle's side: 0 or 1. A place on the line belongs to the triangle below it, or
    /// to that on its right.
    owed: i32,
}

impl Edge {
    #[inline(always)]
    fn new(from: Place, to: Place) -> Self {
        let (x, y) = (to.x - from.x, to.y - from.y);
        Self { from, x, y, owed: i32::from(!(y < 0 || (y == 0 && x > 0))) }
    }

    /// The distance of the middle of a texel, without what is owed.
    #[inline(always)]
    fn distance(&self, column: i32, row: i32) -> i64 {
        let (x, y) = (column * PARTS - self.from.x, row * PARTS - self.from.y);
        i64::from(self.x) * i64::from(y) - i64::from(self.y) * i64::from(x)
    }
}

/// A triangle that may cover texels.
#[derive(Clone, Copy, Debug)]
pub struct Outline {
    /// Opposite of its corners: their shares in a place are as its distances from these.
    edges: [Edge; 3],
    /// What distances are divided by to be shares.
    per_area: f32,
    /// First and last of the columns around it.
    pub columns: (i32, i32),
    /// First and last of the rows.
    pub rows: (i32, i32),
    is_small: bool,
}

/// Which way round the corners of a triangle run as it is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Counter-clockwise.
    Front,
    /// Clockwise.
    Back,
}

impl Turn {
    /// That of three corners; none if they stand in a line.
    #[must_use]
    #[inline(always)]
    pub fn of([a, b, c]: [Place; 3]) -> Option<Self> {
        // Rows run down.
        match twice_area(a, b, c) {
            ..0 => Some(Self::Front),
            0 => None,
            1.. => Some(Self::Back),
        }
    }
}

#[inline(always)]
fn twice_area(a: Place, b: Place, c: Place) -> i64 {
    i64::from(b.x - a.x) * i64::from(c.y - a.y) - i64::from(b.y - a.y) * i64::from(c.x - a.x)
}

/// The first and the last of the texels whose middles lie between three places.
#[inline(always)]
fn middles_between(a: i32, b: i32, c: i32, first: i32, end: i32) -> (i32, i32) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (((low + PARTS - 1) >> PARTS_BITS).max(first), (high >> PARTS_BITS).min(end - 1))
}

/// First and last column and row of the texels of a buffer whose middles lie between three corners, if there are any.
#[must_use]
#[inline(always)]
pub fn texels_between([a, b, c]: [Place; 3], [width, height]: [usize; 2]) -> Option<[(i32, i32); 2]> {
    let columns = middles_between(a.x, b.x, c.x, 0, width as i32);
    let rows = middles_between(a.y, b.y, c.y, 0, height as i32);
    (((columns.1 - columns.0) | (rows.1 - rows.0)) >= 0).then_some([columns, rows])
}

impl Outline {
    /// Of a triangle that is seen from its front, in a buffer of so many columns, and rows of them; none where no middle of a
    /// texel lies between its corners.
    #[must_use]
    #[inline(always)]
    pub fn new([a, b, c]: [Place; 3], width: usize, rows: Range<i32>) -> Option<Self> {
        let span = |a: i32, b: i32, c: i32| a.max(b).max(c) - a.min(b).min(c);
        let is_small = span(a.x, b.x, c.x).max(span(a.y, b.y, c.y)) < SPAN_PX * PARTS;
        let columns = middles_between(a.x, b.x, c.x, 0, width as i32);
        let rows = middles_between(a.y, b.y, c.y, rows.start, rows.end);
        if ((columns.1 - columns.0) | (rows.1 - rows.0)) < 0 {
            return None;
        }
        // Counter-clockwise, and rows run down: the area is below 0.
        let per_area = -1.0 / twice_area(a, b, c) as f32;
        // They run clockwise here.
        Some(Self { edges: [Edge::new(c, b), Edge::new(a, c), Edge::new(b, a)], per_area, columns, rows, is_small })
    }

    /// How a number that is linear over the triangle is made of the distances that a [`Paint`] is given: what it is at 0, and
    /// what each unit of the second corner's and of the third's adds.
    #[must_use]
    #[inline(always)]
    pub fn linear(&self, [a, b, c]: [f32; 3]) -> [f32; 3] {
        let (per_b, per_c) = ((b - a) * self.per_area, (c - a) * self.per_area);
        [a + self.edges[1].owed as f32 * per_b + self.edges[2].owed as f32 * per_c, per_b, per_c]
    }

    /// Paints it into a buffer of which row 0 is `first_row` and each takes `stride`.
    #[inline(always)]
    pub fn fill<S: Simd>(&self, simd: S, first_row: i32, stride: usize, target: &mut impl Paint<S>) {
        if self.is_small {
            self.fill_small(simd, first_row, stride, target);
        } else {
            self.fill_wide(simd, first_row, stride, target);
        }
    }

    #[inline(always)]
    fn fill_small<S: Simd>(&self, simd: S, first_row: i32, stride: usize, target: &mut impl Paint<S>) {
        let Self { edges, columns, rows, .. } = *self;
        // Four texels of a row and the four below them.
        let (lane_columns, lane_rows) = lanes(simd);
        // No closures: what vectors are made of is inlined wholly.
        let mut at_row = [i32x8::splat(simd, 0); 3];
        let (mut to_right, mut down) = ([0; 3], [0; 3]);
        for (i, edge) in edges.iter().enumerate() {
            let (x, y) = (columns.0 * PARTS - edge.from.x, rows.0 * PARTS - edge.from.y);
            let first = edge.x * y - edge.y * x - edge.owed;
            at_row[i] = lane_rows * (edge.x * PARTS) - lane_columns * (edge.y * PARTS) + first;
            to_right[i] = WIDTH as i32 * edge.y * PARTS;
            down[i] = HEIGHT as i32 * edge.x * PARTS;
        }
        let (mut row, end) = (rows.0, rows.1 + 1);
        while row < end {
            let mut at = at_row;
            let upper = (row - first_row) as usize * stride;
            let (mut column, end) = (columns.0 as usize, columns.1 as usize + 1);
            while column < end {
                let texels = [upper + column, upper + stride + column];
                let inside = (at[0] | at[1] | at[2]).simd_ge(0);
                target.paint(simd, texels, inside, at[1].to_float(), at[2].to_float());
                for i in 0..3 {
                    at[i] -= to_right[i];
                }
                column += WIDTH;
            }
            for i in 0..3 {
                at_row[i] += down[i];
            }
            row += HEIGHT as i32;
        }
    }

    /// The same of any size.
    #[inline(always)]
    fn fill_wide<S: Simd>(&self, simd: S, first_row: i32, stride: usize, target: &mut impl Paint<S>) {
        let (lane_columns, lane_rows) = lanes(simd);
        let [_, b, c] = &self.edges;
        let mut row = self.rows.0;
        while row <= self.rows.1 {
            // What is below the last row is painted with it, but not of this triangle's band.
            let spans = [self.span(row), if row < self.rows.1 { self.span(row + 1) } else { (i32::MAX, i32::MIN) }];
            let (first, last) = (spans[0].0.min(spans[1].0), spans[0].1.max(spans[1].1));
            let upper = (row - first_row) as usize * stride;
            let is_lower = lane_rows.simd_gt(0);
            let low = is_lower.select(i32x8::splat(simd, spans[1].0), i32x8::splat(simd, spans[0].0));
            let high = is_lower.select(i32x8::splat(simd, spans[1].1), i32x8::splat(simd, spans[0].1));
            let (from_column, from_row) = (lane_columns.to_float::<f32x8<S>>(), lane_rows.to_float::<f32x8<S>>());
            let mut column = first;
            while column <= last {
                let columns = lane_columns + column;
                let inside = columns.simd_ge(low) & columns.simd_le(high);
                let texels = [upper + column as usize, upper + stride + column as usize];
                let per_part = PARTS as f32;
                let at_b = (b.distance(column, row) - i64::from(b.owed)) as f32
                    + from_row * (b.x as f32 * per_part)
                    - from_column * (b.y as f32 * per_part);
                let at_c = (c.distance(column, row) - i64::from(c.owed)) as f32
                    + from_row * (c.x as f32 * per_part)
                    - from_column * (c.y as f32 * per_part);
                target.paint(simd, texels, inside, at_b, at_c);
                column += WIDTH as i32;
            }
            row += HEIGHT as i32;
        }
    }

    /// First and last column of a row that it covers; the last before the first where it covers none.
    #[inline(always)]
    fn span(&self, row: i32) -> (i32, i32) {
        let (mut first, mut last) = self.columns;
        for edge in &self.edges {
            // The distance in column 0, and how it falls with each column.
            let start = edge.distance(0, row) - i64::from(edge.owed);
            let fall = i64::from(edge.y) * i64::from(PARTS);
            let within = |column: i64| column.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
            match fall {
                1.. => last = last.min(within(start.div_euclid(fall))),
                0 if start < 0 => last = i32::MIN,
                0 => {}
                ..0 => first = first.max(within(-start.div_euclid(-fall))),
            }
        }
        (first, last)
    }
}

/// Columns and rows of eight texels.
#[inline(always)]
fn lanes<S: Simd>(simd: S) -> (i32x8<S>, i32x8<S>) {
    (
        i32x8::from_slice(simd, &[0, 1, 2, 3, 0, 1, 2, 3]),
        i32x8::from_slice(simd, &[0, 0, 0, 0, 1, 1, 1, 1]),
    )
}
