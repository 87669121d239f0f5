//! Triangles by the rules of the devices, for what this program rasterises itself.
//!
//! Corners lie in 1/256 of a texel, a texel is covered where its middle is, and of two triangles that meet there one covers it.
//! A driver that is a CPU takes several times as long for a triangle of a few texels, and takes one after the other.
//! Must not know: what is drawn.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x4, f32x8, i32x8, mask32x8};
use glam::{Vec2, Vec3};

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
    /// From texels from the middle of the first.
    #[must_use]
    #[inline(always)]
    pub fn rounded(at: Vec2) -> Self {
        Self { x: Self::part(at.x), y: Self::part(at.y) }
    }

    /// The nearest part to so many texels.
    #[inline(always)]
    pub fn part(texels: f32) -> i32 {
        floor(texels * PARTS as f32 + 0.5)
    }
}

/// Vertices whose places are reckoned at once.
pub const VERTICES: usize = 64;

/// Vectors axis by axis, as they are reckoned with at once; 0 beyond the last.
#[must_use]
#[inline(always)]
pub fn by_axis(vectors: impl Iterator<Item = Vec3>) -> [[f32; VERTICES]; 3] {
    let mut axes = [[0.0; VERTICES]; 3];
    for (i, v) in vectors.take(VERTICES).enumerate() {
        (axes[0][i], axes[1][i], axes[2][i]) = (v.x, v.y, v.z);
    }
    axes
}

/// What texels are painted with.
pub trait Paint<S: Simd> {
    /// Paints those of eight texels that are `inside` a triangle: four of a row from place `texels[0]` of a buffer on, and four
    /// of the next from `texels[1]`. `x` and `y` are how far they are from the first texel of its [`Outline`].
    fn paint(&mut self, simd: S, texels: [usize; 2], inside: mask32x8<S>, x: f32x8<S>, y: f32x8<S>);
}

/// A number that is linear over the texels: what it is at the first, that of the buffer or that of an [`Outline`], and what each
/// column and each row adds.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// At the first.
    pub first: f32,
    /// What a column adds.
    pub per_column: f32,
    /// What a row adds.
    pub per_row: f32,
}

impl Plane {
    /// At eight texels, as [`Paint::paint`] is given them.
    #[must_use]
    #[inline(always)]
    pub fn at<S: Simd>(&self, x: f32x8<S>, y: f32x8<S>) -> f32x8<S> {
        x * self.per_column + y * self.per_row + self.first
    }
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

/// First and last of some columns, and of some rows.
pub type Span = [(i32, i32); 2];

/// The texels whose middles lie between three corners, of so many columns and of some rows, if there are any.
#[must_use]
#[inline(always)]
pub fn texels_between([a, b, c]: [Place; 3], width: usize, rows: &Range<i32>) -> Option<Span> {
    let columns = middles_between(a.x, b.x, c.x, 0, width as i32);
    let rows = middles_between(a.y, b.y, c.y, rows.start, rows.end);
    (((columns.1 - columns.0) | (rows.1 - rows.0)) >= 0).then_some([columns, rows])
}

/// Triangles that are sifted at once.
pub const AT_ONCE: usize = 256;
/// How many of them are looked at at a time.
pub const LANES: usize = 8;

/// From which sides triangles are seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// From their fronts.
    Outside,
    /// From their backs too.
    Both,
}

/// Numbers of some of [`AT_ONCE`] triangles.
#[derive(Clone, Debug)]
pub struct Sifted {
    /// More than can be, to be written to and not counted.
    numbers: [u16; AT_ONCE + LANES],
    count: usize,
}

impl Sifted {
    /// All of so many.
    #[must_use]
    pub fn all(count: usize) -> Self {
        Self { numbers: std::array::from_fn(|number| number as u16), count }
    }

    /// Those that are seen and may cover texels of so many columns and of some rows. One that spans more than a few texels may be
    /// taken for one that does and yet not do it.
    ///
    /// Most do not, and there is no telling which: here is no branch.
    #[must_use]
    #[inline(always)]
    pub fn new<S: Simd>(
        simd: S,
        triangles: &[[u32; 3]],
        place_of: impl Fn(u32) -> Place,
        sides: Sides,
        width: usize,
        rows: &Range<i32>,
    ) -> Self {
        let mut sifted = Self { numbers: [0; AT_ONCE + LANES], count: 0 };
        let mut number = 0;
        while number < triangles.len() {
            // What is not there has no area.
            let (mut x, mut y) = ([[0; LANES]; 3], [[0; LANES]; 3]);
            for (lane, triangle) in triangles[number..].iter().take(LANES).enumerate() {
                for i in 0..3 {
                    let place = place_of(triangle[i]);
                    (x[i][lane], y[i][lane]) = (place.x, place.y);
                }
            }
            let extents = Extents::new(simd, three(simd, &x), three(simd, &y), width, rows);
            let kept = extents.may_cover(sides).to_bitmask();
            for lane in 0..LANES {
                sifted.numbers[sifted.count] = (number + lane) as u16;
                sifted.count += (kept >> lane & 1) as usize;
            }
            number += LANES;
        }
        sifted
    }

    /// By rising number.
    #[must_use]
    pub fn numbers(&self) -> &[u16] {
        &self.numbers[..self.count]
    }
}

/// What [`texels_between`] and [`twice_area`] tell, of eight triangles.
struct Extents<S: Simd> {
    /// First and last of the columns.
    columns: [i32x8<S>; 2],
    /// First and last of the rows.
    rows: [i32x8<S>; 2],
    /// Whether 32 bits hold the area.
    is_small: mask32x8<S>,
    /// Of those that are small.
    twice_area: i32x8<S>,
}

impl<S: Simd> Extents<S> {
    #[inline(always)]
    fn new(simd: S, x: [i32x8<S>; 3], y: [i32x8<S>; 3], width: usize, rows: &Range<i32>) -> Self {
        let (low_x, high_x) = (x[0].min(x[1]).min(x[2]), x[0].max(x[1]).max(x[2]));
        let (low_y, high_y) = (y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2]));
        Self {
            columns: Self::middles_between(simd, low_x, high_x, 0, width as i32),
            rows: Self::middles_between(simd, low_y, high_y, rows.start, rows.end),
            is_small: (high_x - low_x).max(high_y - low_y).simd_lt(SPAN_PX * PARTS),
            twice_area: (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]),
        }
    }

    #[inline(always)]
    fn middles_between(simd: S, low: i32x8<S>, high: i32x8<S>, first: i32, end: i32) -> [i32x8<S>; 2] {
        [
            ((low + (PARTS - 1)) >> PARTS_BITS as u32).max(i32x8::splat(simd, first)),
            (high >> PARTS_BITS as u32).min(i32x8::splat(simd, end - 1)),
        ]
    }

    /// Whether they are kept by [`Sifted::new`].
    #[inline(always)]
    fn may_cover(&self, sides: Sides) -> mask32x8<S> {
        let covers = self.columns[1].simd_ge(self.columns[0]) & self.rows[1].simd_ge(self.rows[0]);
        let is_seen = match sides {
            Sides::Outside => self.twice_area.simd_lt(0),
            Sides::Both => self.twice_area.simd_lt(0) | self.twice_area.simd_gt(0),
        };
        covers & (is_seen | !self.is_small)
    }
}

impl Outline {
    /// Of a triangle that is seen from its front, in a buffer of so many columns, and rows of them; none where no middle of a
    /// texel lies between its corners.
    #[must_use]
    #[inline(always)]
    pub fn new([a, b, c]: [Place; 3], width: usize, rows: &Range<i32>) -> Option<Self> {
        let [columns, rows] = texels_between([a, b, c], width, rows)?;
        let span = |a: i32, b: i32, c: i32| a.max(b).max(c) - a.min(b).min(c);
        let is_small = span(a.x, b.x, c.x).max(span(a.y, b.y, c.y)) < SPAN_PX * PARTS;
        // They run clockwise here.
        Some(Self { edges: [Edge::new(c, b), Edge::new(a, c), Edge::new(b, a)], columns, rows, is_small })
    }

    /// Numbers that are linear over the triangle, from those at its corners and where these are, texels from the middle of the
    /// first, before they are rounded: what is far away and seen at a grazing angle differs much over a part of a texel.
    #[must_use]
    #[inline(always)]
    pub fn planes<const N: usize>(&self, [a, b, c]: [Vec2; 3], values: [[f32; N]; 3]) -> [Plane; N] {
        let (to_b, to_c) = (b - a, c - a);
        let twice_area = to_b.perp_dot(to_c);
        // What is too thin to run the same way before its corners are rounded has no slope to speak of.
        let per_area = if twice_area < 0.0 { 1.0 / twice_area } else { 0.0 };
        let (x, y) = (self.columns.0 as f32 - a.x, self.rows.0 as f32 - a.y);
        let mut planes = [Plane { first: 0.0, per_column: 0.0, per_row: 0.0 }; N];
        let [of_a, of_b, of_c] = values;
        for (i, plane) in planes.iter_mut().enumerate() {
            let (more_b, more_c) = (of_b[i] - of_a[i], of_c[i] - of_a[i]);
            let per_column = (more_b * to_c.y - more_c * to_b.y) * per_area;
            let per_row = (more_c * to_b.x - more_b * to_c.x) * per_area;
            *plane = Plane { first: of_a[i] + x * per_column + y * per_row, per_column, per_row };
        }
        planes
    }

    /// A number that is known from the first texel of the buffer on.
    #[must_use]
    #[inline(always)]
    pub fn from_here(&self, plane: Plane) -> Plane {
        let (column, row) = (self.columns.0 as f32, self.rows.0 as f32);
        Plane { first: plane.first + column * plane.per_column + row * plane.per_row, ..plane }
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
        let (columns, rows) = (self.columns, self.rows);
        let steps = self.edges.map(|edge| {
            let (x, y) = (columns.0 * PARTS - edge.from.x, rows.0 * PARTS - edge.from.y);
            let first = edge.x * y - edge.y * x - edge.owed;
            [first, -edge.y * PARTS, edge.x * PARTS]
        });
        fill_blocks(simd, steps, [columns, rows], (first_row, stride), target);
    }

    /// The same of any size.
    #[inline(always)]
    fn fill_wide<S: Simd>(&self, simd: S, first_row: i32, stride: usize, target: &mut impl Paint<S>) {
        let (lane_columns, lane_rows) = lanes(simd);
        let mut row = self.rows.0;
        while row <= self.rows.1 {
            // What is below the last row is painted with it, but not of this triangle's band.
            let spans =
                [self.span(row), if row < self.rows.1 { self.span(row + 1) } else { (i32::MAX, i32::MIN) }];
            let (first, last) = (spans[0].0.min(spans[1].0), spans[0].1.max(spans[1].1));
            let upper = (row - first_row) as usize * stride;
            let is_lower = lane_rows.simd_gt(0);
            let low = is_lower.select(i32x8::splat(simd, spans[1].0), i32x8::splat(simd, spans[0].0));
            let high = is_lower.select(i32x8::splat(simd, spans[1].1), i32x8::splat(simd, spans[0].1));
            let y = (lane_rows + (row - self.rows.0)).to_float::<f32x8<S>>();
            let mut column = first;
            while column <= last {
                let columns = lane_columns + column;
                let inside = columns.simd_ge(low) & columns.simd_le(high);
                let texels = [upper + column as usize, upper + stride + column as usize];
                target.paint(simd, texels, inside, (columns - self.columns.0).to_float(), y);
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

/// Paints the texels of a span, of a buffer of which row 0 is `first_row` and each takes `stride`, that are on the triangle's side
/// of its edges. Of these: the distance at the first texel, and what each column and each row adds.
#[inline(always)]
fn fill_blocks<S: Simd>(
    simd: S,
    edges: [[i32; 3]; 3],
    [columns, rows]: Span,
    (first_row, stride): (i32, usize),
    target: &mut impl Paint<S>,
) {
    // Four texels of a row and the four below them.
    let (lane_columns, lane_rows) = lanes(simd);
    let (lane_x, mut y) = (lane_columns.to_float::<f32x8<S>>(), lane_rows.to_float::<f32x8<S>>());
    // No closures: what vectors are made of is inlined wholly.
    let mut at_row = [i32x8::splat(simd, 0); 3];
    let (mut to_right, mut down) = ([0; 3], [0; 3]);
    for (i, [first, per_column, per_row]) in edges.into_iter().enumerate() {
        at_row[i] = lane_rows * per_row + lane_columns * per_column + first;
        to_right[i] = WIDTH as i32 * per_column;
        down[i] = HEIGHT as i32 * per_row;
    }
    let (mut row, end) = (rows.0, rows.1 + 1);
    while row < end {
        let mut at = at_row;
        let mut x = lane_x;
        let upper = (row - first_row) as usize * stride;
        let (mut column, end) = (columns.0 as usize, columns.1 as usize + 1);
        while column < end {
            let texels = [upper + column, upper + stride + column];
            let inside = (at[0] | at[1] | at[2]).simd_ge(0);
            target.paint(simd, texels, inside, x, y);
            for i in 0..3 {
                at[i] += to_right[i];
            }
            x += WIDTH as f32;
            column += WIDTH;
        }
        for i in 0..3 {
            at_row[i] += down[i];
        }
        y += HEIGHT as f32;
        row += HEIGHT as i32;
    }
}

/// Corners of eight triangles: each number of all of them together.
#[derive(Clone, Copy, Debug)]
pub struct Corners<const N: usize> {
    /// Their places.
    pub x: [[i32; LANES]; 3],
    /// See `x`.
    pub y: [[i32; LANES]; 3],
    /// The same before they are rounded, texels from the middle of the first.
    pub at_x: [[f32; LANES]; 3],
    /// See `at_x`.
    pub at_y: [[f32; LANES]; 3],
    /// Numbers that are linear over the triangle.
    pub values: [[[f32; LANES]; 3]; N],
}

impl<const N: usize> Corners<N> {
    /// None yet.
    #[must_use]
    #[inline(always)]
    pub const fn none() -> Self {
        let (places, numbers) = ([[0; LANES]; 3], [[0.0; LANES]; 3]);
        Self { x: places, y: places, at_x: numbers, at_y: numbers, values: [numbers; N] }
    }

    /// Sets a corner of one of them.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, corner: usize, place: Place, at: Vec2, values: [f32; N]) {
        (self.x[corner][lane], self.y[corner][lane]) = (place.x, place.y);
        (self.at_x[corner][lane], self.at_y[corner][lane]) = (at.x, at.y);
        for (of_all, value) in self.values.iter_mut().zip(values) {
            of_all[corner][lane] = value;
        }
    }
}

/// Eight triangles that are seen from either side, set up together: what [`Outline`] is one by one.
#[derive(Clone, Copy, Debug)]
pub struct Outlines<const N: usize> {
    edges: [[[i32; LANES]; 3]; 3],
    columns: [[i32; LANES]; 2],
    rows: [[i32; LANES]; 2],
    planes: [[[f32; LANES]; 3]; N],
    fronts: u64,
    small: u64,
}

impl<const N: usize> Outlines<N> {
    /// Of triangles that have an area and a span, in a buffer of so many columns, and rows of them.
    #[must_use]
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, corners: &Corners<N>, width: usize, rows: &Range<i32>) -> Self {
        let Corners { x, y, at_x, at_y, values } = corners;
        let (x, y) = (three(simd, x), three(simd, y));
        let Extents { columns, rows, is_small, twice_area } = Extents::new(simd, x, y, width, rows);
        let is_front = twice_area.simd_lt(0);
        let ([ax, bx, cx], [ay, by, cy]) = (x, y);
        // Counter-clockwise.
        let (bx, cx) = (is_front.select(bx, cx), is_front.select(cx, bx));
        let (by, cy) = (is_front.select(by, cy), is_front.select(cy, by));
        let mut made = Self {
            edges: [[[0; LANES]; 3]; 3],
            columns: [[0; LANES]; 2],
            rows: [[0; LANES]; 2],
            planes: [[[0.0; LANES]; 3]; N],
            fronts: is_front.to_bitmask(),
            small: is_small.to_bitmask(),
        };
        let ends = [[cx, cy, bx, by], [ax, ay, cx, cy], [bx, by, ax, ay]];
        let (one, none) = (i32x8::splat(simd, 1), i32x8::splat(simd, 0));
        for (edge, [from_x, from_y, to_x, to_y]) in made.edges.iter_mut().zip(ends) {
            let (along_x, along_y) = (to_x - from_x, to_y - from_y);
            let (x, y) = (columns[0] * PARTS - from_x, rows[0] * PARTS - from_y);
            let is_owned = along_y.simd_lt(0) | (along_y.simd_eq(0) & along_x.simd_gt(0));
            (along_x * y - along_y * x - is_owned.select(none, one)).store_slice(&mut edge[0]);
            (along_y * -PARTS).store_slice(&mut edge[1]);
            (along_x * PARTS).store_slice(&mut edge[2]);
        }
        // As `Outline::planes`.
        let ([ax, bx, cx], [ay, by, cy]) = (three_floats(simd, at_x), three_floats(simd, at_y));
        let (bx, cx) = (is_front.select(bx, cx), is_front.select(cx, bx));
        let (by, cy) = (is_front.select(by, cy), is_front.select(cy, by));
        let (to_bx, to_by, to_cx, to_cy) = (bx - ax, by - ay, cx - ax, cy - ay);
        let twice_area = to_bx * to_cy - to_by * to_cx;
        let (one, zero) = (f32x8::splat(simd, 1.0), f32x8::splat(simd, 0.0));
        let per_area = twice_area.simd_lt(0.0).select(one / twice_area, zero);
        let (x, y) = (columns[0].to_float::<f32x8<S>>() - ax, rows[0].to_float::<f32x8<S>>() - ay);
        for (plane, values) in made.planes.iter_mut().zip(values) {
            let [of_a, of_b, of_c] = three_floats(simd, values);
            let (of_b, of_c) = (is_front.select(of_b, of_c), is_front.select(of_c, of_b));
            let (more_b, more_c) = (of_b - of_a, of_c - of_a);
            let per_column = (more_b * to_cy - more_c * to_by) * per_area;
            let per_row = (more_c * to_bx - more_b * to_cx) * per_area;
            (of_a + x * per_column + y * per_row).store_slice(&mut plane[0]);
            per_column.store_slice(&mut plane[1]);
            per_row.store_slice(&mut plane[2]);
        }
        for i in 0..2 {
            columns[i].store_slice(&mut made.columns[i]);
            rows[i].store_slice(&mut made.rows[i]);
        }
        made
    }

    /// Whether one of them is small enough for this.
    #[must_use]
    #[inline(always)]
    pub fn is_small(&self, lane: usize) -> bool {
        self.small >> lane & 1 != 0
    }

    /// The side of it that is seen.
    #[must_use]
    #[inline(always)]
    pub fn turn(&self, lane: usize) -> Turn {
        if self.fronts >> lane & 1 == 0 { Turn::Back } else { Turn::Front }
    }

    /// The numbers that are linear over it.
    #[must_use]
    #[inline(always)]
    pub fn planes(&self, lane: usize) -> [Plane; N] {
        let mut planes = [Plane { first: 0.0, per_column: 0.0, per_row: 0.0 }; N];
        for (plane, of_all) in planes.iter_mut().zip(&self.planes) {
            *plane = Plane { first: of_all[0][lane], per_column: of_all[1][lane], per_row: of_all[2][lane] };
        }
        planes
    }

    /// Paints one of them, as [`Outline::fill`] does.
    #[inline(always)]
    pub fn fill<S: Simd>(
        &self,
        simd: S,
        lane: usize,
        first_row: i32,
        stride: usize,
        target: &mut impl Paint<S>,
    ) {
        let mut edges = [[0; 3]; 3];
        for (edge, of_all) in edges.iter_mut().zip(&self.edges) {
            *edge = [of_all[0][lane], of_all[1][lane], of_all[2][lane]];
        }
        let columns = (self.columns[0][lane], self.columns[1][lane]);
        let rows = (self.rows[0][lane], self.rows[1][lane]);
        fill_blocks(simd, edges, [columns, rows], (first_row, stride), target);
    }
}

#[inline(always)]
fn three<S: Simd>(simd: S, [a, b, c]: &[[i32; LANES]; 3]) -> [i32x8<S>; 3] {
    [i32x8::from_slice(simd, a), i32x8::from_slice(simd, b), i32x8::from_slice(simd, c)]
}

#[inline(always)]
fn three_floats<S: Simd>(simd: S, [a, b, c]: &[[f32; LANES]; 3]) -> [f32x8<S>; 3] {
    [f32x8::from_slice(simd, a), f32x8::from_slice(simd, b), f32x8::from_slice(simd, c)]
}

/// The eight texels of a plane that a [`Paint`] is given.
#[inline(always)]
pub fn load<S: Simd>(simd: S, plane: &[f32], [upper, lower]: [usize; 2]) -> f32x8<S> {
    let [upper, lower] = [upper, lower].map(|at| &plane[at..at + WIDTH]);
    f32x4::from_slice(simd, upper).combine(f32x4::from_slice(simd, lower))
}

/// Writes them.
#[inline(always)]
pub fn store<S: Simd>(plane: &mut [f32], [upper, lower]: [usize; 2], values: f32x8<S>) {
    let (above, below) = values.split();
    above.store_slice(&mut plane[upper..upper + WIDTH]);
    below.store_slice(&mut plane[lower..lower + WIDTH]);
}

/// Columns and rows of eight texels.
#[inline(always)]
fn lanes<S: Simd>(simd: S) -> (i32x8<S>, i32x8<S>) {
    (i32x8::from_slice(simd, &[0, 1, 2, 3, 0, 1, 2, 3]), i32x8::from_slice(simd, &[0, 0, 0, 0, 1, 1, 1, 1]))
}

/// Counts what is painted.
/// What of a convex polygon lies where a distance is not below 0 (Sutherland and Hodgman 1974, "Reentrant polygon clipping").
///
/// An edge that two polygons share is cut alike: `between` is given the end that stays, the one that goes, and how far it is
/// from the first to the second.
#[must_use]
pub fn cut<T: Copy>(
    polygon: &[T],
    distance: impl Fn(&T) -> f32,
    between: impl Fn(&T, &T, f32) -> T,
) -> Vec<T> {
    let mut left = Vec::with_capacity(polygon.len() + 1);
    for (i, from) in polygon.iter().enumerate() {
        let to = &polygon[(i + 1) % polygon.len()];
        let (of_from, of_to) = (distance(from), distance(to));
        if of_from >= 0.0 {
            left.push(*from);
        }
        if (of_from >= 0.0) != (of_to >= 0.0) {
            left.push(if of_from >= 0.0 {
                between(from, to, of_from / (of_from - of_to))
            } else {
                between(to, from, of_to / (of_to - of_from))
            });
        }
    }
    left
}

#[cfg(test)]
pub(super) struct Counted {
    /// How often each texel was.
    pub(super) times: Vec<u32>,
    /// With what it was last.
    pub(super) values: Vec<f32>,
    /// What it is painted with.
    pub(super) value: Plane,
}

#[cfg(test)]
impl Counted {
    /// A buffer of this many columns and rows that nothing was painted into.
    pub(super) fn new([width, height]: [usize; 2]) -> Self {
        let texels = (width + WIDTH) * (height + HEIGHT);
        let value = Plane { first: 0.0, per_column: 0.0, per_row: 0.0 };
        Self { times: vec![0; texels], values: vec![0.0; texels], value }
    }
}

#[cfg(test)]
impl<S: Simd> Paint<S> for Counted {
    fn paint(&mut self, _: S, texels: [usize; 2], inside: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let value = self.value.at(x, y);
        for lane in (0..WIDTH * HEIGHT).filter(|&lane| inside.test(lane)) {
            let texel = texels[lane / WIDTH] + lane % WIDTH;
            self.times[texel] += 1;
            self.values[texel] = value[lane];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::noise::lattice_hash;
    use fearless_simd::{Level, dispatch};

    const SIZE: usize = 48;

    const STRIDE: usize = SIZE + WIDTH;

    /// Paints triangles with values at their corners, whichever way round they run, each way of filling.
    fn painted(triangles: &[([Place; 3], [f32; 3])], rows: Range<i32>, wide: bool) -> Counted {
        let mut sheet = Counted::new([SIZE, SIZE]);
        for &([a, b, c], [at_a, at_b, at_c]) in triangles {
            let (places, values) = match Turn::of([a, b, c]) {
                Some(Turn::Front) => ([a, b, c], [at_a, at_b, at_c]),
                Some(Turn::Back) => ([a, c, b], [at_a, at_c, at_b]),
                None => continue,
            };
            let Some(outline) = Outline::new(places, SIZE, &rows) else { continue };
            let at = places.map(|p| Vec2::new(p.x as f32, p.y as f32) / PARTS as f32);
            [sheet.value] = outline.planes(at, values.map(|value| [value]));
            let sheet = &mut sheet;
            if wide {
                dispatch!(Level::new(), simd => outline.fill_wide(simd, rows.start, STRIDE, sheet));
            } else {
                dispatch!(Level::new(), simd => outline.fill_small(simd, rows.start, STRIDE, sheet));
            }
        }
        sheet
    }

    const ALL: Range<i32> = 0..SIZE as i32;

    fn random(number: i32, axis: i32, end: u32) -> i32 {
        (lattice_hash(number, axis, 0, 7) % end) as i32
    }

    fn random_place(number: i32) -> Place {
        let parts = SIZE as u32 * PARTS as u32;
        // Every other on a middle, where edges meet places.
        let snap = |part: i32| if number % 2 == 0 { part } else { part & !(PARTS - 1) };
        Place { x: snap(random(number, 0, parts)), y: snap(random(number, 1, parts)) }
    }

    #[test]
    fn a_triangle_covers_the_texels_whose_middles_are_in_it_and_its_values_are_linear() {
        let mut covered = 0;
        for number in 0..400 {
            let [a, b, c] = [0, 1, 2].map(|corner| random_place(3 * number + corner));
            // A plane over the texels.
            let value = |x: f64, y: f64| 3.0 + 0.25 * x - 0.5 * y;
            let values = [a, b, c]
                .map(|p| value(f64::from(p.x) / f64::from(PARTS), f64::from(p.y) / f64::from(PARTS)) as f32);
            for wide in [false, true] {
                let sheet = painted(&[([a, b, c], values)], ALL, wide);
                for row in 0..SIZE {
                    for column in 0..SIZE {
                        let at = Place { x: column as i32 * PARTS, y: row as i32 * PARTS };
                        let sides =
                            [(a, b), (b, c), (c, a)].map(|(from, to)| twice_area(from, to, at).signum());
                        let texel = row * STRIDE + column;
                        match (sides.contains(&1), sides.contains(&-1)) {
                            (true, true) => assert_eq!(sheet.times[texel], 0, "triangle {number}: {at:?}"),
                            _ if sides.contains(&0) => {}
                            _ => {
                                assert_eq!(sheet.times[texel], 1, "triangle {number}: {at:?}");
                                let expected = value(column as f64, row as f64);
                                let found = f64::from(sheet.values[texel]);
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
    fn triangles_around_a_corner_cover_every_texel_once() {
        let place = |x: i32, y: i32| Place { x: x * PARTS, y: y * PARTS };
        let last = SIZE as i32 - 1;
        let around = [place(0, 0), place(last, 0), place(last, last), place(0, last)];
        for number in 0..100 {
            let Place { x, y } = random_place(number);
            let middle = Place { x: x.min(last * PARTS), y: y.min(last * PARTS) };
            let fan = [0, 1, 2, 3].map(|side| ([middle, around[side], around[(side + 1) % 4]], [0.0; 3]));
            for wide in [false, true] {
                let sheet = painted(&fan, ALL, wide);
                // Of the square's own border the upper and the left side are its.
                for row in 0..SIZE - 1 {
                    let line = &sheet.times[row * STRIDE..][..SIZE - 1];
                    assert!(line.iter().all(|&times| times == 1), "corner {number}, row {row}: {line:?}");
                }
            }
        }
    }

    #[test]
    fn bands_of_rows_cover_what_the_whole_does() {
        for number in 0..100 {
            let places = [0, 1, 2].map(|corner| random_place(3 * number + corner));
            let triangle = [(places, [1.0; 3])];
            for wide in [false, true] {
                let whole = painted(&triangle, ALL, wide);
                for first in (0..SIZE).step_by(8) {
                    let band = painted(&triangle, first as i32..first as i32 + 8, wide);
                    let rows =
                        |sheet: &Counted, first: usize| sheet.times[first * STRIDE..][..8 * STRIDE].to_vec();
                    assert_eq!(rows(&band, 0), rows(&whole, first), "triangle {number}, row {first}");
                }
            }
        }
    }
    /// Three corners, with three places that stand close together and three that may stand anywhere.
    fn triangles() -> Vec<[Place; 3]> {
        let near = |number: i32, corner: i32| {
            let middle = random_place(number);
            let beside = |axis: i32| random(3 * number + corner, axis, 3 * PARTS as u32) - PARTS;
            Place { x: middle.x + beside(2), y: middle.y + beside(3) }
        };
        (0..600)
            .map(|number| {
                [0, 1, 2].map(|corner| {
                    if number % 3 == 0 { random_place(3 * number + corner) } else { near(number, corner) }
                })
            })
            .collect()
    }

    #[test]
    fn what_is_sifted_out_covers_no_texel_or_is_turned_away() {
        let triangles = triangles();
        let places = triangles.as_flattened();
        let corners: Vec<[u32; 3]> =
            (0..triangles.len() as u32).map(|number| [3 * number, 3 * number + 1, 3 * number + 2]).collect();
        let rows = 9..33;
        for sides in [Sides::Outside, Sides::Both] {
            let (mut kept, mut dropped) = (0, 0);
            for (chunk, triangles) in triangles.chunks(AT_ONCE).zip(corners.chunks(AT_ONCE)) {
                let place_of = |corner: u32| places[corner as usize];
                let sifted = dispatch!(Level::new(), simd => Sifted::new(simd, triangles, place_of, sides, SIZE, &rows));
                for (number, &triangle) in chunk.iter().enumerate() {
                    let turn = Turn::of(triangle);
                    let is_seen = turn == Some(Turn::Front) || (turn.is_some() && sides == Sides::Both);
                    let is_drawn = is_seen && texels_between(triangle, SIZE, &rows).is_some();
                    assert_eq!(sifted.numbers().contains(&(number as u16)), is_drawn, "{triangle:?}");
                    (kept, dropped) = (kept + u32::from(is_drawn), dropped + u32::from(!is_drawn));
                }
            }
            assert!(kept > 50 && dropped > 50, "{kept} and {dropped}");
        }
    }

    #[test]
    fn eight_triangles_are_painted_as_one_by_one() {
        let rows = 9..33;
        let drawn = |triangle: &[Place; 3]| {
            Turn::of(*triangle).is_some() && texels_between(*triangle, SIZE, &rows).is_some()
        };
        let triangles: Vec<[Place; 3]> = triangles().into_iter().filter(drawn).collect();
        let value = |corner: usize| 0.3 + 0.7 * corner as f32;
        // Not quite where they are rounded to.
        let unrounded = |place: Place| Vec2::new(place.x as f32 + 0.3, place.y as f32 - 0.2) / PARTS as f32;
        let mut painted = 0;
        for eight in triangles.chunks(LANES) {
            let mut corners = Corners::none();
            for (lane, triangle) in eight.iter().enumerate() {
                for (i, &place) in triangle.iter().enumerate() {
                    corners.set(lane, i, place, unrounded(place), [value(i), -value(i)]);
                }
            }
            dispatch!(Level::new(), simd => {
                let outlines = Outlines::new(simd, &corners, SIZE, &rows);
                for (lane, &[a, b, c]) in eight.iter().enumerate() {
                    assert!(outlines.is_small(lane));
                    let turn = outlines.turn(lane);
                    assert_eq!(Some(turn), Turn::of([a, b, c]));
                    let [second, third] = if turn == Turn::Front { [1, 2] } else { [2, 1] };
                    let order = [0, second, third];
                    let places = order.map(|i| [a, b, c][i]);
                    let outline = Outline::new(places, SIZE, &rows).expect("it covers texels");
                    let planes = outline.planes(places.map(unrounded), order.map(|i| [value(i), -value(i)]));
                    for (one, of_eight) in planes.into_iter().zip(outlines.planes(lane)) {
                        let (mut alone, mut together) = (Counted::new([SIZE, SIZE]), Counted::new([SIZE, SIZE]));
                        (alone.value, together.value) = (one, of_eight);
                        outline.fill(simd, rows.start, STRIDE, &mut alone);
                        outlines.fill(simd, lane, rows.start, STRIDE, &mut together);
                        assert!(alone.times == together.times && alone.values == together.values);
                        painted += alone.times.iter().sum::<u32>();
                    }
                }
            });
        }
        assert!(painted > 1000, "{painted}");
    }
}
