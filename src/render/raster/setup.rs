//! Triangle setup: edge functions, pixel bounds and interpolants of one triangle.
//!
//! Must not know: what is interpolated.

use std::ops::Range;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec2;

use super::bounds::{PixelBounds, is_small, pixel_bounds};
use super::edge::Edge;
use super::fill::{FragmentSink, fill_large, fill_small};
use super::fixed_point::SubpixelPoint;

/// The plane equation of an attribute that is linear over the image: value at the first pixel (of the buffer, or of a
/// triangle's bounds) and the increments per column and per row.
#[derive(Clone, Copy, Debug)]
pub struct Interpolant {
    /// At the first pixel.
    pub first: f32,
    /// Added by each column.
    pub per_column: f32,
    /// Added by each row.
    pub per_row: f32,
}

impl Interpolant {
    /// 0 everywhere.
    pub const ZERO: Self = Self { first: 0.0, per_column: 0.0, per_row: 0.0 };

    /// At a block of pixels, `x` columns and `y` rows from the first.
    #[must_use]
    #[inline(always)]
    pub fn at<S: Simd>(&self, x: f32x8<S>, y: f32x8<S>) -> f32x8<S> {
        x * self.per_column + y * self.per_row + self.first
    }
}

/// A triangle that is ready to be filled.
#[derive(Clone, Copy, Debug)]
pub struct TriangleSetup {
    /// Opposite of its corners: the barycentric coordinates of a point are in the ratio of these edge functions.
    edges: [Edge; 3],
    /// The pixels that it may cover.
    pub bounds: PixelBounds,
    is_small: bool,
}

impl TriangleSetup {
    /// Sets up a front face (see [`super::cull::Winding`]) for a render area of `width` columns and of these rows; none if its
    /// bounds hold no pixel centre.
    #[must_use]
    #[inline(always)]
    pub fn new([a, b, c]: [SubpixelPoint; 3], width: usize, rows: &Range<i32>) -> Option<Self> {
        let bounds = pixel_bounds([a, b, c], width, rows)?;
        let is_small = is_small([a, b, c]);
        // Rows run down: edges in reverse order have the triangle on their positive side.
        Some(Self { edges: [Edge::new(c, b), Edge::new(a, c), Edge::new(b, a)], bounds, is_small })
    }

    /// Interpolants of attributes that are linear over the triangle, from the first pixel of its bounds on. `positions_px` are
    /// those of its corners before they were rounded, pixels from the centre of the first pixel of the buffer: an attribute of
    /// a surface at a grazing angle differs much over a sub-pixel step.
    #[must_use]
    #[inline(always)]
    pub fn interpolants<const N: usize>(
        &self,
        [a, b, c]: [Vec2; 3],
        attributes: [[f32; N]; 3],
    ) -> [Interpolant; N] {
        let (to_b, to_c) = (b - a, c - a);
        let twice_area = to_b.perp_dot(to_c);
        // A sliver that is a front face only after its corners were rounded has no meaningful slope.
        let inverse_area = if twice_area < 0.0 { 1.0 / twice_area } else { 0.0 };
        let PixelBounds { columns, rows } = self.bounds;
        let (x, y) = (columns.0 as f32 - a.x, rows.0 as f32 - a.y);
        let mut interpolants = [Interpolant::ZERO; N];
        let [at_a, at_b, at_c] = attributes;
        for (i, interpolant) in interpolants.iter_mut().enumerate() {
            let (to_b_value, to_c_value) = (at_b[i] - at_a[i], at_c[i] - at_a[i]);
            let per_column = (to_b_value * to_c.y - to_c_value * to_b.y) * inverse_area;
            let per_row = (to_c_value * to_b.x - to_b_value * to_c.x) * inverse_area;
            *interpolant = Interpolant { first: at_a[i] + x * per_column + y * per_row, per_column, per_row };
        }
        interpolants
    }

    /// An interpolant that counts from the first pixel of the buffer, from the first pixel of the bounds on.
    #[must_use]
    #[inline(always)]
    pub fn rebase(&self, interpolant: Interpolant) -> Interpolant {
        let (column, row) = (self.bounds.columns.0 as f32, self.bounds.rows.0 as f32);
        let first = interpolant.first + column * interpolant.per_column + row * interpolant.per_row;
        Interpolant { first, ..interpolant }
    }

    /// Fills it into a buffer whose row 0 is `first_row` and whose rows are `stride` apart.
    #[inline(always)]
    pub fn fill<S: Simd>(&self, simd: S, first_row: i32, stride: usize, sink: &mut impl FragmentSink<S>) {
        if self.is_small {
            self.fill_small(simd, first_row, stride, sink);
        } else {
            self.fill_large(simd, first_row, stride, sink);
        }
    }

    #[inline(always)]
    pub(super) fn fill_small<S: Simd>(
        &self,
        simd: S,
        first_row: i32,
        stride: usize,
        sink: &mut impl FragmentSink<S>,
    ) {
        let (column, row) = (self.bounds.columns.0, self.bounds.rows.0);
        let edges = self.edges.map(|edge| edge.stepping_from(column, row));
        fill_small(simd, edges, self.bounds, (first_row, stride), sink);
    }

    #[inline(always)]
    pub(super) fn fill_large<S: Simd>(
        &self,
        simd: S,
        first_row: i32,
        stride: usize,
        sink: &mut impl FragmentSink<S>,
    ) {
        fill_large(simd, &self.edges, self.bounds, (first_row, stride), sink);
    }
}
