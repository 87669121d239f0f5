//! Edge functions: which side of an edge a pixel centre is on.
//!
//! Must not know: triangles, interpolants.

use super::fixed_point::{SUBPIXEL_STEPS, SubpixelPoint};

/// An edge function in the form that the fill loop steps: value at the first pixel of a triangle's bounds and the increments
/// per column and per row. Not negative on the inner side, top-left bias included.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeFunction {
    pub(super) first: i32,
    pub(super) per_column: i32,
    pub(super) per_row: i32,
}

/// A directed edge. Its edge function (Pineda 1988, "A parallel algorithm for polygon rasterization") is twice the area of the
/// triangle that it forms with a point: positive on the triangle's side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) from: SubpixelPoint,
    pub(super) dx: i32,
    pub(super) dy: i32,
    /// 0 of a top or a left edge, 1 of any other. Taken off the edge function, it makes the inner side that where the function
    /// is not negative: a centre on an edge belongs to the triangle below it, or to that on its right (the top-left rule).
    pub(super) top_left_bias: i32,
}

impl Edge {
    #[inline(always)]
    pub(super) fn new(from: SubpixelPoint, to: SubpixelPoint) -> Self {
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        Self { from, dx, dy, top_left_bias: i32::from(!(dy < 0 || (dy == 0 && dx > 0))) }
    }

    /// The edge function at the centre of a pixel, without the bias.
    #[inline(always)]
    pub(super) fn at_pixel(&self, column: i32, row: i32) -> i64 {
        let (x, y) = (column * SUBPIXEL_STEPS - self.from.x, row * SUBPIXEL_STEPS - self.from.y);
        i64::from(self.dx) * i64::from(y) - i64::from(self.dy) * i64::from(x)
    }

    /// The edge function of a small triangle from a pixel on.
    #[inline(always)]
    pub(super) fn stepping_from(&self, column: i32, row: i32) -> EdgeFunction {
        let (x, y) = (column * SUBPIXEL_STEPS - self.from.x, row * SUBPIXEL_STEPS - self.from.y);
        EdgeFunction {
            first: self.dx * y - self.dy * x - self.top_left_bias,
            per_column: -self.dy * SUBPIXEL_STEPS,
            per_row: self.dx * SUBPIXEL_STEPS,
        }
    }
}
