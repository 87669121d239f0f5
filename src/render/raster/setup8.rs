//! Triangle setup of eight triangles at once, in structures of arrays.
//!
//! CPU time for a triangle of a few pixels is mostly its setup. Gives the same bits as [`super::setup`] does one by one.
//! Must not know: what is interpolated.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};
use glam::Vec2;

use super::bounds::{Bounds8, PixelBounds};
use super::cull::Winding;
use super::edge::EdgeFunction;
use super::fill::{FragmentSink, fill_small};
use super::fixed_point::{SUBPIXEL_STEPS, SubpixelPoint};
use super::lanes::{LANES, load_f32, load_i32};
use super::setup::Interpolant;

/// Vertices of eight triangles: one array of lanes for each corner and component.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleVertices8<const N: usize> {
    /// Sub-pixel position.
    x: [[i32; LANES]; 3],
    y: [[i32; LANES]; 3],
    /// The same before it was rounded, pixels from the centre of the first pixel.
    x_px: [[f32; LANES]; 3],
    y_px: [[f32; LANES]; 3],
    /// Attributes that are linear over the image.
    attributes: [[[f32; LANES]; 3]; N],
}

impl<const N: usize> TriangleVertices8<N> {
    /// Eight degenerate triangles.
    pub(crate) const EMPTY: Self = Self {
        x: [[0; LANES]; 3],
        y: [[0; LANES]; 3],
        x_px: [[0.0; LANES]; 3],
        y_px: [[0.0; LANES]; 3],
        attributes: [[[0.0; LANES]; 3]; N],
    };

    /// Sets a corner of the triangle in a lane.
    #[inline(always)]
    pub(crate) fn set(
        &mut self,
        lane: usize,
        corner: usize,
        position: SubpixelPoint,
        position_px: Vec2,
        attributes: [f32; N],
    ) {
        (self.x[corner][lane], self.y[corner][lane]) = (position.x, position.y);
        (self.x_px[corner][lane], self.y_px[corner][lane]) = (position_px.x, position_px.y);
        for (lanes, attribute) in self.attributes.iter_mut().zip(attributes) {
            lanes[corner][lane] = attribute;
        }
    }
}

/// [`EdgeFunction`] of eight triangles.
#[derive(Clone, Copy, Debug)]
struct EdgeFunction8 {
    first: [i32; LANES],
    per_column: [i32; LANES],
    per_row: [i32; LANES],
}

impl EdgeFunction8 {
    const ZERO: Self = Self { first: [0; LANES], per_column: [0; LANES], per_row: [0; LANES] };
}

/// [`Interpolant`] of eight triangles.
#[derive(Clone, Copy, Debug)]
struct Interpolant8 {
    first: [f32; LANES],
    per_column: [f32; LANES],
    per_row: [f32; LANES],
}

impl Interpolant8 {
    const ZERO: Self = Self { first: [0.0; LANES], per_column: [0.0; LANES], per_row: [0.0; LANES] };
}

/// Eight triangles that are ready to be filled, front or back faces: [`super::setup::TriangleSetup`] in structures of arrays, with
/// `N` interpolants.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleSetup8<const N: usize> {
    edges: [EdgeFunction8; 3],
    /// First and last.
    columns: [[i32; LANES]; 2],
    rows: [[i32; LANES]; 2],
    interpolants: [Interpolant8; N],
    /// A bit per lane: a front face.
    front: u64,
    /// A bit per lane: small enough for 32-bit edge functions.
    small: u64,
}

impl<const N: usize> TriangleSetup8<N> {
    /// Sets up eight triangles that have survived culling, for a render area of `width` columns and of these rows.
    #[must_use]
    #[inline(always)]
    pub(crate) fn new<S: Simd>(
        simd: S,
        vertices: &TriangleVertices8<N>,
        width: usize,
        rows: &Range<i32>,
    ) -> Self {
        let (x, y) = (load_i32(simd, &vertices.x), load_i32(simd, &vertices.y));
        let bounds = Bounds8::new(simd, x, y, width, rows);
        let is_front = bounds.twice_area.simd_lt(0);
        let mut setup = Self {
            edges: [EdgeFunction8::ZERO; 3],
            columns: [[0; LANES]; 2],
            rows: [[0; LANES]; 2],
            interpolants: [Interpolant8::ZERO; N],
            front: is_front.to_bitmask(),
            small: bounds.is_small.to_bitmask(),
        };
        setup.set_edges(simd, &bounds, as_front(is_front, x), as_front(is_front, y));
        setup.set_interpolants(simd, &bounds, is_front, vertices);
        for i in 0..2 {
            bounds.columns[i].store_slice(&mut setup.columns[i]);
            bounds.rows[i].store_slice(&mut setup.rows[i]);
        }
        setup
    }

    /// Edge functions of front faces, as [`super::edge::Edge::stepping_from`].
    #[inline(always)]
    fn set_edges<S: Simd>(
        &mut self,
        simd: S,
        bounds: &Bounds8<S>,
        [ax, bx, cx]: [i32x8<S>; 3],
        [ay, by, cy]: [i32x8<S>; 3],
    ) {
        let ends = [[cx, cy, bx, by], [ax, ay, cx, cy], [bx, by, ax, ay]];
        let (one, zero) = (i32x8::splat(simd, 1), i32x8::splat(simd, 0));
        for (edge, [from_x, from_y, to_x, to_y]) in self.edges.iter_mut().zip(ends) {
            let (dx, dy) = (to_x - from_x, to_y - from_y);
            let x = bounds.columns[0] * SUBPIXEL_STEPS - from_x;
            let y = bounds.rows[0] * SUBPIXEL_STEPS - from_y;
            let is_top_left = dy.simd_lt(0) | (dy.simd_eq(0) & dx.simd_gt(0));
            let top_left_bias = is_top_left.select(zero, one);
            (dx * y - dy * x - top_left_bias).store_slice(&mut edge.first);
            (dy * -SUBPIXEL_STEPS).store_slice(&mut edge.per_column);
            (dx * SUBPIXEL_STEPS).store_slice(&mut edge.per_row);
        }
    }

    /// Interpolants of front faces, as [`super::setup::TriangleSetup::interpolants`].
    #[inline(always)]
    fn set_interpolants<S: Simd>(
        &mut self,
        simd: S,
        bounds: &Bounds8<S>,
        is_front: mask32x8<S>,
        vertices: &TriangleVertices8<N>,
    ) {
        let [ax, bx, cx] = as_front(is_front, load_f32(simd, &vertices.x_px));
        let [ay, by, cy] = as_front(is_front, load_f32(simd, &vertices.y_px));
        let (to_bx, to_by, to_cx, to_cy) = (bx - ax, by - ay, cx - ax, cy - ay);
        let twice_area = to_bx * to_cy - to_by * to_cx;
        let (one, zero) = (f32x8::splat(simd, 1.0), f32x8::splat(simd, 0.0));
        let inverse_area = twice_area.simd_lt(0.0).select(one / twice_area, zero);
        let x = bounds.columns[0].to_float::<f32x8<S>>() - ax;
        let y = bounds.rows[0].to_float::<f32x8<S>>() - ay;
        for (interpolant, attribute) in self.interpolants.iter_mut().zip(&vertices.attributes) {
            let [at_a, at_b, at_c] = as_front(is_front, load_f32(simd, attribute));
            let (to_b_value, to_c_value) = (at_b - at_a, at_c - at_a);
            let per_column = (to_b_value * to_cy - to_c_value * to_by) * inverse_area;
            let per_row = (to_c_value * to_bx - to_b_value * to_cx) * inverse_area;
            (at_a + x * per_column + y * per_row).store_slice(&mut interpolant.first);
            per_column.store_slice(&mut interpolant.per_column);
            per_row.store_slice(&mut interpolant.per_row);
        }
    }

    /// Whether the triangle in a lane is small enough for [`Self::fill`]; the others need [`super::setup::TriangleSetup`].
    #[must_use]
    #[inline(always)]
    pub(crate) fn is_small(&self, lane: usize) -> bool {
        self.small >> lane & 1 != 0
    }

    /// The winding of the triangle in a lane, if it is small.
    #[must_use]
    #[inline(always)]
    pub(crate) fn winding(&self, lane: usize) -> Winding {
        if self.front >> lane & 1 == 0 { Winding::Back } else { Winding::Front }
    }

    /// The interpolants of the triangle in a lane.
    #[must_use]
    #[inline(always)]
    pub(crate) fn interpolants(&self, lane: usize) -> [Interpolant; N] {
        let mut interpolants = [Interpolant::ZERO; N];
        for (interpolant, lanes) in interpolants.iter_mut().zip(&self.interpolants) {
            *interpolant = Interpolant {
                first: lanes.first[lane],
                per_column: lanes.per_column[lane],
                per_row: lanes.per_row[lane],
            };
        }
        interpolants
    }

    /// Fills the triangle in a lane, as [`super::setup::TriangleSetup::fill`] does.
    #[inline(always)]
    pub(crate) fn fill<S: Simd>(
        &self,
        simd: S,
        lane: usize,
        first_row: i32,
        stride: usize,
        sink: &mut impl FragmentSink<S>,
    ) {
        let mut edges = [EdgeFunction { first: 0, per_column: 0, per_row: 0 }; 3];
        for (edge, lanes) in edges.iter_mut().zip(&self.edges) {
            *edge = EdgeFunction {
                first: lanes.first[lane],
                per_column: lanes.per_column[lane],
                per_row: lanes.per_row[lane],
            };
        }
        let columns = (self.columns[0][lane], self.columns[1][lane]);
        let rows = (self.rows[0][lane], self.rows[1][lane]);
        fill_small(simd, edges, PixelBounds { columns, rows }, (first_row, stride), sink);
    }
}

/// The corners of front faces as they are; of back faces with the last two swapped, which makes them front faces.
#[inline(always)]
fn as_front<S: Simd, V: SimdBase<S>>(is_front: mask32x8<S>, [a, b, c]: [V; 3]) -> [V; 3]
where
    mask32x8<S>: Select<V>,
{
    [a, is_front.select(b, c), is_front.select(c, b)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::raster::bounds::pixel_bounds;
    use crate::render::raster::coverage::{CoverageCounter, SIZE, STRIDE, random_triangles};
    use crate::render::raster::setup::TriangleSetup;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn eight_triangles_are_filled_as_one_by_one() {
        let rows = 9..33;
        let is_drawn = |triangle: &[SubpixelPoint; 3]| {
            Winding::of(*triangle).is_some() && pixel_bounds(*triangle, SIZE, &rows).is_some()
        };
        let triangles: Vec<[SubpixelPoint; 3]> = random_triangles().into_iter().filter(is_drawn).collect();
        let attribute = |corner: usize| 0.3 + 0.7 * corner as f32;
        // Not quite where it is rounded to.
        let unrounded =
            |p: SubpixelPoint| Vec2::new(p.x as f32 + 0.3, p.y as f32 - 0.2) / SUBPIXEL_STEPS as f32;
        let mut covered = 0;
        for eight in triangles.chunks(LANES) {
            let mut vertices = TriangleVertices8::EMPTY;
            for (lane, triangle) in eight.iter().enumerate() {
                for (i, &position) in triangle.iter().enumerate() {
                    vertices.set(lane, i, position, unrounded(position), [attribute(i), -attribute(i)]);
                }
            }
            dispatch!(Level::new(), simd => {
                let setups = TriangleSetup8::new(simd, &vertices, SIZE, &rows);
                for (lane, &[a, b, c]) in eight.iter().enumerate() {
                    assert!(setups.is_small(lane));
                    let winding = setups.winding(lane);
                    assert_eq!(Some(winding), Winding::of([a, b, c]));
                    let [second, third] = if winding == Winding::Front { [1, 2] } else { [2, 1] };
                    let order = [0, second, third];
                    let positions = order.map(|i| [a, b, c][i]);
                    let setup = TriangleSetup::new(positions, SIZE, &rows).expect("it has bounds");
                    let interpolants =
                        setup.interpolants(positions.map(unrounded), order.map(|i| [attribute(i), -attribute(i)]));
                    for (single, of_eight) in interpolants.into_iter().zip(setups.interpolants(lane)) {
                        let (mut alone, mut together) =
                            (CoverageCounter::new([SIZE, SIZE]), CoverageCounter::new([SIZE, SIZE]));
                        (alone.attribute, together.attribute) = (single, of_eight);
                        setup.fill(simd, rows.start, STRIDE, &mut alone);
                        setups.fill(simd, lane, rows.start, STRIDE, &mut together);
                        assert!(alone.counts == together.counts && alone.values == together.values);
                        covered += alone.counts.iter().sum::<u32>();
                    }
                }
            });
        }
        assert!(covered > 1000, "{covered}");
    }
}
