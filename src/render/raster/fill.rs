//! The fill loop: which pixels of a triangle's bounds are covered.
//!
//! Small triangles step their edge functions over blocks of pixels; large ones, whose edge functions exceed 32 bits, get a span
//! of columns per row.
//! Must not know: what is done with a covered pixel.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};

use super::bounds::PixelBounds;
use super::edge::{Edge, EdgeFunction};
use super::fixed_point::SUBPIXEL_STEPS;
use super::lanes::{BLOCK_HEIGHT, BLOCK_WIDTH, block_offsets};

/// Takes the pixels that a triangle covers: depth test and output.
pub trait FragmentSink<S: Simd> {
    /// Takes the `covered` pixels of a block (see [`super::lanes`]) at these offsets in the buffer. `x` and `y` are columns and
    /// rows from the first pixel of the triangle's bounds, as [`super::setup::Interpolant::at`] takes them.
    fn write(&mut self, simd: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>);
}

/// Fills a small triangle into a buffer whose row 0 is `first_row` and whose rows are `stride` apart: a pixel is covered where no
/// edge function is negative.
#[inline(always)]
pub(super) fn fill_small<S: Simd>(
    simd: S,
    edges: [EdgeFunction; 3],
    PixelBounds { columns, rows }: PixelBounds,
    (first_row, stride): (i32, usize),
    sink: &mut impl FragmentSink<S>,
) {
    let (lane_columns, lane_rows) = block_offsets(simd);
    let (lane_x, mut y) = (lane_columns.to_float::<f32x8<S>>(), lane_rows.to_float::<f32x8<S>>());
    // Loops instead of closures: a closure that returns a vector is not always inlined, and then not compiled for its width.
    let mut at_row = [i32x8::splat(simd, 0); 3];
    let (mut to_right, mut down) = ([0; 3], [0; 3]);
    for (i, EdgeFunction { first, per_column, per_row }) in edges.into_iter().enumerate() {
        at_row[i] = lane_rows * per_row + lane_columns * per_column + first;
        to_right[i] = BLOCK_WIDTH as i32 * per_column;
        down[i] = BLOCK_HEIGHT as i32 * per_row;
    }
    let (mut row, end) = (rows.0, rows.1 + 1);
    while row < end {
        let mut at = at_row;
        let mut x = lane_x;
        let upper = (row - first_row) as usize * stride;
        let (mut column, end) = (columns.0 as usize, columns.1 as usize + 1);
        while column < end {
            let offsets = [upper + column, upper + stride + column];
            let covered = (at[0] | at[1] | at[2]).simd_ge(0);
            sink.write(simd, offsets, covered, x, y);
            for i in 0..3 {
                at[i] += to_right[i];
            }
            x += BLOCK_WIDTH as f32;
            column += BLOCK_WIDTH;
        }
        for i in 0..3 {
            at_row[i] += down[i];
        }
        y += BLOCK_HEIGHT as f32;
        row += BLOCK_HEIGHT as i32;
    }
}

/// As [`fill_small`], for a triangle of any size.
#[inline(always)]
pub(super) fn fill_large<S: Simd>(
    simd: S,
    edges: &[Edge; 3],
    bounds: PixelBounds,
    (first_row, stride): (i32, usize),
    sink: &mut impl FragmentSink<S>,
) {
    let PixelBounds { columns, rows } = bounds;
    let (lane_columns, lane_rows) = block_offsets(simd);
    let mut row = rows.0;
    while row <= rows.1 {
        // A row below the last is in the same block, but outside the bounds.
        let spans = [
            covered_span(edges, columns, row),
            if row < rows.1 { covered_span(edges, columns, row + 1) } else { (i32::MAX, i32::MIN) },
        ];
        let (first, last) = (spans[0].0.min(spans[1].0), spans[0].1.max(spans[1].1));
        let upper = (row - first_row) as usize * stride;
        let is_lower = lane_rows.simd_gt(0);
        let low = is_lower.select(i32x8::splat(simd, spans[1].0), i32x8::splat(simd, spans[0].0));
        let high = is_lower.select(i32x8::splat(simd, spans[1].1), i32x8::splat(simd, spans[0].1));
        let y = (lane_rows + (row - rows.0)).to_float::<f32x8<S>>();
        let mut column = first;
        while column <= last {
            let pixel_columns = lane_columns + column;
            let covered = pixel_columns.simd_ge(low) & pixel_columns.simd_le(high);
            let offsets = [upper + column as usize, upper + stride + column as usize];
            sink.write(simd, offsets, covered, (pixel_columns - columns.0).to_float(), y);
            column += BLOCK_WIDTH as i32;
        }
        row += BLOCK_HEIGHT as i32;
    }
}

/// First and last of these columns that a triangle covers in a row; the last before the first if it covers none.
#[inline(always)]
fn covered_span(edges: &[Edge; 3], columns: (i32, i32), row: i32) -> (i32, i32) {
    let (mut first, mut last) = columns;
    for edge in edges {
        // The edge function in column 0, and how much each column takes off.
        let start = edge.at_pixel(0, row) - i64::from(edge.top_left_bias);
        let decrement = i64::from(edge.dy) * i64::from(SUBPIXEL_STEPS);
        let within_i32 = |column: i64| column.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        match decrement {
            1.. => last = last.min(within_i32(start.div_euclid(decrement))),
            0 if start < 0 => last = i32::MIN,
            0 => {}
            ..0 => first = first.max(within_i32(-start.div_euclid(-decrement))),
        }
    }
    (first, last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::raster::coverage::{CoverageCounter, SIZE, STRIDE, random_point};
    use crate::render::raster::cull::Winding;
    use crate::render::raster::fixed_point::{SubpixelPoint, twice_area};
    use crate::render::raster::setup::TriangleSetup;
    use fearless_simd::{Level, dispatch};
    use glam::Vec2;
    use std::ops::Range;

    /// Fills triangles with an attribute at their corners, front and back faces, by the loop for large or for small ones.
    fn filled(
        triangles: &[([SubpixelPoint; 3], [f32; 3])],
        rows: Range<i32>,
        as_large: bool,
    ) -> CoverageCounter {
        let mut counter = CoverageCounter::new([SIZE, SIZE]);
        for &([a, b, c], [at_a, at_b, at_c]) in triangles {
            let (positions, values) = match Winding::of([a, b, c]) {
                Some(Winding::Front) => ([a, b, c], [at_a, at_b, at_c]),
                Some(Winding::Back) => ([a, c, b], [at_a, at_c, at_b]),
                None => continue,
            };
            let Some(setup) = TriangleSetup::new(positions, SIZE, &rows) else { continue };
            let positions_px = positions.map(|p| Vec2::new(p.x as f32, p.y as f32) / SUBPIXEL_STEPS as f32);
            [counter.attribute] = setup.interpolants(positions_px, values.map(|value| [value]));
            let counter = &mut counter;
            if as_large {
                dispatch!(Level::new(), simd => setup.fill_large(simd, rows.start, STRIDE, counter));
            } else {
                dispatch!(Level::new(), simd => setup.fill_small(simd, rows.start, STRIDE, counter));
            }
        }
        counter
    }

    const ALL: Range<i32> = 0..SIZE as i32;

    #[test]
    fn a_triangle_covers_the_pixels_whose_centres_are_inside_and_its_attribute_is_linear() {
        let mut covered = 0;
        for number in 0..400 {
            let [a, b, c] = [0, 1, 2].map(|corner| random_point(3 * number + corner));
            // A plane over the pixels.
            let value = |x: f64, y: f64| 3.0 + 0.25 * x - 0.5 * y;
            let steps = f64::from(SUBPIXEL_STEPS);
            let values = [a, b, c].map(|p| value(f64::from(p.x) / steps, f64::from(p.y) / steps) as f32);
            for as_large in [false, true] {
                let counter = filled(&[([a, b, c], values)], ALL, as_large);
                for row in 0..SIZE {
                    for column in 0..SIZE {
                        let at = SubpixelPoint {
                            x: column as i32 * SUBPIXEL_STEPS,
                            y: row as i32 * SUBPIXEL_STEPS,
                        };
                        let sides =
                            [(a, b), (b, c), (c, a)].map(|(from, to)| twice_area(from, to, at).signum());
                        let pixel = row * STRIDE + column;
                        match (sides.contains(&1), sides.contains(&-1)) {
                            (true, true) => {
                                assert_eq!(counter.counts[pixel], 0, "triangle {number}: {at:?}");
                            }
                            _ if sides.contains(&0) => {}
                            _ => {
                                assert_eq!(counter.counts[pixel], 1, "triangle {number}: {at:?}");
                                let expected = value(column as f64, row as f64);
                                let found = f64::from(counter.values[pixel]);
                                assert!((found - expected).abs() < 1e-3, "{number}: {found} for {expected}");
                                covered += 1;
                            }
                        }
                    }
                }
            }
        }
        assert!(covered > 20_000, "{covered}");
    }

    #[test]
    fn triangles_around_a_vertex_cover_every_pixel_once() {
        let pixel_centre = |x: i32, y: i32| SubpixelPoint { x: x * SUBPIXEL_STEPS, y: y * SUBPIXEL_STEPS };
        let last = SIZE as i32 - 1;
        let around =
            [pixel_centre(0, 0), pixel_centre(last, 0), pixel_centre(last, last), pixel_centre(0, last)];
        for number in 0..100 {
            let SubpixelPoint { x, y } = random_point(number);
            let middle = SubpixelPoint { x: x.min(last * SUBPIXEL_STEPS), y: y.min(last * SUBPIXEL_STEPS) };
            let fan = [0, 1, 2, 3].map(|side| ([middle, around[side], around[(side + 1) % 4]], [0.0; 3]));
            for as_large in [false, true] {
                let counter = filled(&fan, ALL, as_large);
                // Of the square's own border, the top and the left side belong to it.
                for row in 0..SIZE - 1 {
                    let line = &counter.counts[row * STRIDE..][..SIZE - 1];
                    assert!(line.iter().all(|&count| count == 1), "vertex {number}, row {row}: {line:?}");
                }
            }
        }
    }

    #[test]
    fn bands_of_rows_cover_what_the_whole_does() {
        for number in 0..100 {
            let positions = [0, 1, 2].map(|corner| random_point(3 * number + corner));
            let triangle = [(positions, [1.0; 3])];
            for as_large in [false, true] {
                let whole = filled(&triangle, ALL, as_large);
                for first in (0..SIZE).step_by(8) {
                    let band = filled(&triangle, first as i32..first as i32 + 8, as_large);
                    let rows = |counter: &CoverageCounter, first: usize| {
                        counter.counts[first * STRIDE..][..8 * STRIDE].to_vec()
                    };
                    assert_eq!(rows(&band, 0), rows(&whole, first), "triangle {number}, row {first}");
                }
            }
        }
    }
}
