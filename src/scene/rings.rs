//! A polar grid around the camera with cells of constant angular size: the ground of the surface stage.
//!
//! The spacing of the rings is the cell size, which grows with the distance from the eye above the centre; rays divide them
//! into columns, dense over the viewed sector, sparse elsewhere. Unlike the nested levels of geometry clipmaps (Losasso and
//! Hoppe 2004) it is one regular grid: no seams to stitch, and no distance at which the level of detail steps.
//! Must not know: heights.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};
use glam::Vec2;

use super::azimuth;
use super::grid_cell::CellPoint;

/// Growth factor of the columns outside the viewed sector, and their largest width, relative to those inside.
const WIDENING: (f64, f64) = (1.12, 12.0);
/// Bins of the pseudo-angle in the lookup table of columns.
const TURN_BINS: usize = 2048;
/// Binary logarithm of the number of bins per octave of the squared radius, in the lookup table of rings.
const BINS_PER_OCTAVE_LOG2: u32 = 5;

/// Largest pseudo-angle: the last ray has 4.
const LARGEST_TURN: f32 = 3.999_999_8;
/// Points of a vector.
pub(super) const LANES: usize = 8;

/// The grid: radii of the rings and directions of the rays.
#[derive(Clone, Debug)]
pub struct Rings {
    /// The view that it is built for.
    pub view: View,
    /// Unit vector along the middle of the viewed sector.
    ahead: Vec2,
    /// Radius of each ring, metres, ascending from 0.
    pub radii_m: Vec<f32>,
    /// Direction of each ray, clockwise seen from above from straight behind to straight behind; unit.
    pub rays: Vec<Vec2>,
    /// Pseudo-angle of each ray (see [`pseudo_angle`]).
    turns: Vec<f32>,
    /// First ray at or after the start of each bin of the pseudo-angle.
    turn_bins: Vec<u32>,
    /// Lookup table of rings; the first bin starts at the first ring after the centre, and has this number among all.
    radius_bins: Vec<u32>,
    first_bin: u32,
}

/// The cells that eight points were in: points that follow them, one after another along eight rows, are often in the same ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaneCells {
    pub(super) columns: [u32; LANES],
    pub(super) rows: [u32; LANES],
    /// Pseudo-angles and squared radii that the cells begin with and end before; of no cell, none.
    turns: [[f32; LANES]; 2],
    squares_m2: [[f32; LANES]; 2],
}

impl Default for LaneCells {
    fn default() -> Self {
        let nothing = [[f32::INFINITY; LANES]; 2];
        Self { columns: [0; LANES], rows: [0; LANES], turns: nothing, squares_m2: nothing }
    }
}

/// What the grid is built for.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Height of the eye above the centre, metres.
    pub eye_height_m: f32,
    /// Azimuth of the middle of the viewed sector, radians from +Y towards +X.
    pub azimuth: f64,
    /// Half the angle of the viewed sector, radians.
    pub half_sector: f64,
    /// Angular size of a cell as seen from the eye, radians.
    pub cell: f64,
    /// Angular size of the smallest rocks that are made, radians.
    pub min_rock: f64,
    /// Radius of the outermost ring, metres.
    pub radius_m: f64,
}

impl View {
    /// Size of a cell at a distance from the centre, metres.
    #[must_use]
    pub fn cell_m(&self, distance_m: f32) -> f32 {
        self.cell as f32 * (distance_m * distance_m + self.eye_height_m * self.eye_height_m).sqrt()
    }
}

/// Diamond angle: a number in [0, 4) that increases monotonically as a direction turns clockwise from -Y. It needs no
/// transcendental function, so that it is the same on every machine.
fn pseudo_angle(p: Vec2) -> f32 {
    let sum = p.x.abs() + p.y.abs();
    if sum == 0.0 {
        return 0.0;
    }
    let (x, y) = (p.x / sum, p.y / sum);
    // From -Y over -X, +Y and +X.
    match (x < 0.0 || (x == 0.0 && y < 0.0), y < 0.0) {
        (true, true) => -x,
        (true, false) => 1.0 + y,
        (false, false) => 2.0 + x,
        (false, true) => 3.0 - y,
    }
    .min(LARGEST_TURN)
}

/// Bin of a squared radius: the exponent and the leading bits of the mantissa.
fn radius_bin(squared_m2: f32, first: u32) -> usize {
    ((squared_m2.to_bits() >> (23 - BINS_PER_OCTAVE_LOG2)).saturating_sub(first)) as usize
}

impl Rings {
    /// The grid for a view.
    #[must_use]
    pub fn new(view: &View) -> Self {
        let mut radii_m = vec![0.0_f32];
        let mut radius_m = 0.0_f64;
        while radius_m < view.radius_m {
            radius_m += f64::from(view.cell_m(radius_m as f32));
            radii_m.push(radius_m.min(view.radius_m) as f32);
        }
        let angles = angles(view);
        let rays: Vec<Vec2> = angles.iter().map(|angle| azimuth::direction(*angle)).collect();
        // The first and the last ray coincide, to the bit.
        let (first, last) = (Vec2::new(0.0, -1.0), rays.len() - 1);
        let mut rays = rays;
        (rays[0], rays[last]) = (first, first);
        let mut turns: Vec<f32> = rays.iter().map(|ray| pseudo_angle(*ray)).collect();
        (turns[0], turns[last]) = (0.0, 4.0);
        let turn_bins = (0..=TURN_BINS)
            .map(|bin| {
                let start = 4.0 * bin as f32 / TURN_BINS as f32;
                turns.partition_point(|turn| *turn <= start).saturating_sub(1) as u32
            })
            .collect();
        let first_bin = (radii_m[1] * radii_m[1]).to_bits() >> (23 - BINS_PER_OCTAVE_LOG2);
        let largest_m = radii_m[radii_m.len() - 1];
        let bins = radius_bin(largest_m * largest_m, first_bin) + 1;
        let radius_bins = (0..=bins)
            .map(|bin| {
                let start = f32::from_bits((first_bin + bin as u32) << (23 - BINS_PER_OCTAVE_LOG2));
                let below = radii_m.partition_point(|radius_m| radius_m * radius_m <= start);
                if bin == 0 { 0 } else { below.saturating_sub(1) as u32 }
            })
            .collect();
        let ahead = azimuth::direction(view.azimuth);
        let turned = |ray: &Vec2| ray.x * Vec2::new(ahead.y, -ahead.x) + ray.y * ahead;
        Self {
            view: *view,
            ahead,
            radii_m,
            rays: rays.iter().map(turned).collect(),
            turns,
            turn_bins,
            radius_bins,
            first_bin,
        }
    }

    /// Size of a cell at a distance from the centre, metres.
    #[must_use]
    pub fn cell_m(&self, distance_m: f32) -> f32 {
        self.view.cell_m(distance_m)
    }

    /// Cells along a ring.
    #[must_use]
    pub fn columns(&self) -> u32 {
        self.rays.len() as u32 - 1
    }

    /// Cells along a ray.
    #[must_use]
    pub fn rows(&self) -> u32 {
        self.radii_m.len() as u32 - 1
    }

    /// Offset from the centre of the vertex at a column and a row, metres.
    #[must_use]
    pub fn offset(&self, column: u32, row: u32) -> Vec2 {
        self.radii_m[row as usize] * self.rays[column as usize]
    }

    /// Rotates into the frame of the rays: x right, y ahead.
    fn local(&self, offset: Vec2) -> Vec2 {
        Vec2::new(offset.x * self.ahead.y - offset.y * self.ahead.x, offset.dot(self.ahead))
    }

    /// The cell that contains a point, metres from the centre; beyond the last ring, a cell inside it.
    #[must_use]
    pub fn locate(&self, offset: Vec2) -> CellPoint {
        let (turn, squared_m2) = (pseudo_angle(self.local(offset)), offset.length_squared());
        let (column, row) = (self.column_of(turn), self.row_of(squared_m2));
        let fraction = |x: f32, low: f32, high: f32| ((x - low) / (high - low)).clamp(0.0, 1.0);
        CellPoint {
            column: column as u32,
            row: row as u32,
            u: fraction(turn, self.turns[column], self.turns[column + 1]),
            v: fraction(squared_m2.sqrt(), self.radii_m[row], self.radii_m[row + 1]),
        }
    }

    /// Column and row of that cell alone.
    #[must_use]
    #[inline]
    pub fn cell(&self, offset: Vec2) -> [u32; 2] {
        let turn = pseudo_angle(self.local(offset));
        [self.column_of(turn) as u32, self.row_of(offset.length_squared()) as u32]
    }

    /// Sets `known` to [`Self::cell`] of eight offsets from the centre, of those in a mask. Returns the lanes in which that is another than
    /// before, as bits.
    #[inline(always)]
    pub(super) fn find_cells<S: Simd>(
        &self,
        simd: S,
        [x, y]: [f32x8<S>; 2],
        mask: mask32x8<S>,
        known: &mut LaneCells,
    ) -> u64 {
        let ahead = self.ahead;
        // As `pseudo_angle` of `local`.
        let (local_x, local_y) = (x * ahead.y - y * ahead.x, x * ahead.x + y * ahead.y);
        let sum = local_x.abs() + local_y.abs();
        let (u, v) = (local_x / sum, local_y / sum);
        let is_behind = v.simd_lt(0.0);
        let is_left = u.simd_lt(0.0) | (u.simd_eq(0.0) & is_behind);
        let left = is_behind.select(-u, v + 1.0);
        let right = is_behind.select(f32x8::splat(simd, 3.0) - v, u + 2.0);
        let turn = is_left.select(left, right).min(LARGEST_TURN);
        let turn = sum.simd_eq(0.0).select(f32x8::splat(simd, 0.0), turn);
        let square = x * x + y * y;
        let load = |values: &[f32; LANES]| f32x8::from_slice(simd, values);
        // As `column_of` and `row_of` compare.
        let [first_turn, end_turn] = [load(&known.turns[0]), load(&known.turns[1])];
        let [first_m2, end_m2] = [load(&known.squares_m2[0]), load(&known.squares_m2[1])];
        let in_column = turn.simd_ge(first_turn) & turn.simd_lt(end_turn);
        let in_row = square.simd_ge(first_m2) & square.simd_lt(end_m2);
        let moved = (mask & !(in_column & in_row)).to_bitmask();
        if moved == 0 {
            return 0;
        }
        let (mut turns, mut squares) = ([0.0; LANES], [0.0; LANES]);
        turn.store_slice(&mut turns);
        square.store_slice(&mut squares);
        let mut lanes = moved;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (column, row) = (self.column_of(turns[lane]), self.row_of(squares[lane]));
            (known.columns[lane], known.rows[lane]) = (column as u32, row as u32);
            for end in 0..2 {
                let radius_m = self.radii_m[row + end];
                known.turns[end][lane] = self.turns[column + end];
                known.squares_m2[end][lane] = radius_m * radius_m;
            }
        }
        moved
    }

    #[inline]
    fn column_of(&self, turn: f32) -> usize {
        let bin = (turn * (TURN_BINS as f32 / 4.0)) as usize;
        let mut column = self.turn_bins[bin.min(TURN_BINS)] as usize;
        // Often one further, which no branch prediction knows. The last ray has a larger pseudo-angle than any point.
        column += usize::from(self.turns.get(column + 1).is_some_and(|next| *next <= turn));
        while column + 2 < self.turns.len() && self.turns[column + 1] <= turn {
            column += 1;
        }
        while column > 0 && self.turns[column] > turn {
            column -= 1;
        }
        column
    }

    #[inline]
    fn row_of(&self, squared_m2: f32) -> usize {
        let last = self.radii_m.len() - 2;
        let bin = radius_bin(squared_m2, self.first_bin).min(self.radius_bins.len() - 1);
        let mut row = (self.radius_bins[bin] as usize).min(last);
        let next_m = self.radii_m[row + 1];
        row += usize::from((row < last) & (next_m * next_m <= squared_m2));
        while row < last && self.radii_m[row + 1] * self.radii_m[row + 1] <= squared_m2 {
            row += 1;
        }
        while row > 0 && self.radii_m[row] * self.radii_m[row] > squared_m2 {
            row -= 1;
        }
        row
    }

    /// Columns and rows of vertices whose cells cover a box (its lowest and highest corner, metres from the centre): a superset.
    #[must_use]
    pub fn vertices_over(&self, low: Vec2, high: Vec2) -> [Range<u32>; 2] {
        let corners = [low, Vec2::new(high.x, low.y), Vec2::new(low.x, high.y), high];
        let nearest = Vec2::ZERO.clamp(low, high);
        let farthest = corners.iter().fold(0.0_f32, |farthest, corner| farthest.max(corner.length_squared()));
        let first = (self.row_of(nearest.length_squared()) as u32).saturating_sub(1);
        let rows = first..(self.row_of(farthest) as u32 + 3).min(self.rows() + 1);
        // A chord lies inside its arc: one more cell on each side.
        let all = 0..self.columns() + 1;
        if nearest == Vec2::ZERO {
            return [all, rows];
        }
        let local = corners.map(|corner| self.local(corner));
        let behind = local.iter().any(|p| p.y <= 0.0);
        let across = local.iter().any(|p| p.x <= 0.0) && local.iter().any(|p| p.x >= 0.0);
        if behind && across {
            return [all, rows];
        }
        let columns = local.map(|p| self.column_of(pseudo_angle(p)) as u32);
        let (first, last) = columns.iter().fold((u32::MAX, 0), |(a, b), c| (a.min(*c), b.max(*c)));
        [first.saturating_sub(1)..(last + 3).min(self.columns() + 1), rows]
    }
}

/// Angles of the rays, radians from straight ahead, clockwise, from -pi to pi.
fn angles(view: &View) -> Vec<f64> {
    let pi = std::f64::consts::PI;
    let half = view.half_sector.min(pi);
    let inner = (half / view.cell).ceil().max(1.0);
    let mut side: Vec<f64> = (0..=inner as usize).map(|i| half * i as f64 / inner).collect();
    if half < pi {
        let mut outer = Vec::new();
        let (mut angle, mut step) = (half, view.cell);
        while angle < pi {
            step = (step * WIDENING.0).min(WIDENING.1 * view.cell);
            angle += step;
            outer.push(angle);
        }
        let stretch = (pi - half) / (angle - half);
        side.extend(outer.iter().map(|angle| half + (angle - half) * stretch));
    }
    side.iter().skip(1).rev().map(|angle| -angle).chain(side.iter().copied()).collect()
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may be computed with std's functions")]
mod tests {
    use super::*;

    fn rings() -> Rings {
        Rings::new(&View {
            eye_height_m: 2.0,
            azimuth: 0.7,
            half_sector: 0.6,
            cell: 0.02,
            min_rock: 2e-3,
            radius_m: 300.0,
        })
    }

    #[test]
    fn cells_have_a_constant_angular_size() {
        let rings = rings();
        for pair in rings.radii_m[..rings.radii_m.len() - 1].windows(2) {
            let expected = 0.02 * (pair[0] * pair[0] + 4.0).sqrt();
            assert!((pair[1] - pair[0] - expected).abs() < 1e-3 * expected + 1e-4);
        }
        let ahead = Vec2::new(0.7_f32.sin(), 0.7_f32.cos());
        for pair in rings.rays.windows(2).filter(|pair| pair.iter().all(|ray| ray.dot(ahead) > 0.6_f32.cos()))
        {
            assert!((pair[0].angle_to(pair[1]) + 0.02).abs() < 1e-3, "clockwise, a cell apart");
        }
        assert_eq!(rings.rays[0], rings.rays[rings.rays.len() - 1]);
        assert!((rings.rays[0] + ahead).length() < 1e-6);
    }

    #[test]
    fn points_are_located_in_their_cells() {
        let rings = rings();
        for i in 0..4000_u16 {
            let (angle, radius) = (f32::from(i) * 0.37, 299.0 * (f32::from(i) / 4000.0).powi(3) + 1e-4);
            let p = radius * Vec2::new(angle.sin(), angle.cos());
            let at = rings.locate(p);
            let (low, high) = (rings.radii_m[at.row as usize], rings.radii_m[at.row as usize + 1]);
            assert!(radius >= low * 0.999 && radius <= high * 1.001, "{radius} in {low} to {high}");
            let (left, right) = (rings.rays[at.column as usize], rings.rays[at.column as usize + 1]);
            assert!(
                left.perp_dot(p) <= 1e-3 * radius && p.perp_dot(right) <= 1e-3 * radius,
                "{p} {left} {right}"
            );
            let box_m = Vec2::splat(0.1 * radius + 0.01);
            let [columns, rows] = rings.vertices_over(p - box_m, p + box_m);
            assert!(columns.contains(&at.column) && columns.contains(&(at.column + 1)));
            assert!(rows.contains(&at.row) && rows.contains(&(at.row + 1)));
        }
        assert_eq!(rings.locate(Vec2::new(1e4, 0.0)).row, rings.rows() - 1);
    }
}
