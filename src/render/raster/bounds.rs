//! Bounding boxes of triangles in whole pixels, of one triangle and of eight at once.
//!
//! Must not know: edge functions.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{i32x8, mask32x8};

use super::fixed_point::{SUBPIXEL_BITS, SUBPIXEL_STEPS, SubpixelPoint};

/// A triangle that spans fewer pixels than this along both axes is small: 32 bits hold its area and its edge functions.
const SMALL_SPAN_PX: i32 = 64;

/// The pixels whose centres lie in the bounding box of a triangle. Never empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelBounds {
    /// First and last column.
    pub columns: (i32, i32),
    /// First and last row.
    pub rows: (i32, i32),
}

/// The pixels of a render area of `width` columns and of these rows whose centres lie in the bounding box of a triangle, if
/// there are any.
#[must_use]
#[inline(always)]
pub(crate) fn pixel_bounds(
    [a, b, c]: [SubpixelPoint; 3],
    width: usize,
    rows: &Range<i32>,
) -> Option<PixelBounds> {
    let columns = centres_between(a.x, b.x, c.x, 0, width as i32);
    let rows = centres_between(a.y, b.y, c.y, rows.start, rows.end);
    (((columns.1 - columns.0) | (rows.1 - rows.0)) >= 0).then_some(PixelBounds { columns, rows })
}

/// First and last of the pixel centres from `first` to before `end` that lie between three coordinates.
#[inline(always)]
fn centres_between(a: i32, b: i32, c: i32, first: i32, end: i32) -> (i32, i32) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (((low + SUBPIXEL_STEPS - 1) >> SUBPIXEL_BITS).max(first), (high >> SUBPIXEL_BITS).min(end - 1))
}

/// Whether 32 bits hold the area and the edge functions of a triangle.
#[must_use]
#[inline(always)]
pub(super) fn is_small([a, b, c]: [SubpixelPoint; 3]) -> bool {
    let span = |a: i32, b: i32, c: i32| a.max(b).max(c) - a.min(b).min(c);
    span(a.x, b.x, c.x).max(span(a.y, b.y, c.y)) < SMALL_SPAN_PX * SUBPIXEL_STEPS
}

/// [`PixelBounds`] (which may be empty here), smallness and area of eight triangles.
#[derive(Clone, Copy)]
pub(super) struct Bounds8<S: Simd> {
    /// First and last column.
    pub(super) columns: [i32x8<S>; 2],
    /// First and last row.
    pub(super) rows: [i32x8<S>; 2],
    /// As [`is_small`].
    pub(super) is_small: mask32x8<S>,
    /// As [`super::fixed_point::twice_area`]; only of small triangles, others overflow.
    pub(super) twice_area: i32x8<S>,
}

impl<S: Simd> Bounds8<S> {
    /// `x` and `y` have one vector per corner.
    #[inline(always)]
    pub(super) fn new(simd: S, x: [i32x8<S>; 3], y: [i32x8<S>; 3], width: usize, rows: &Range<i32>) -> Self {
        let (low_x, high_x) = (x[0].min(x[1]).min(x[2]), x[0].max(x[1]).max(x[2]));
        let (low_y, high_y) = (y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2]));
        Self {
            columns: Self::centres_between(simd, low_x, high_x, 0, width as i32),
            rows: Self::centres_between(simd, low_y, high_y, rows.start, rows.end),
            is_small: (high_x - low_x).max(high_y - low_y).simd_lt(SMALL_SPAN_PX * SUBPIXEL_STEPS),
            twice_area: (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]),
        }
    }

    #[inline(always)]
    fn centres_between(simd: S, low: i32x8<S>, high: i32x8<S>, first: i32, end: i32) -> [i32x8<S>; 2] {
        [
            ((low + (SUBPIXEL_STEPS - 1)) >> SUBPIXEL_BITS as u32).max(i32x8::splat(simd, first)),
            (high >> SUBPIXEL_BITS as u32).min(i32x8::splat(simd, end - 1)),
        ]
    }
}
