//! The heights of a square ground, packed for the sweep of the horizon map, and how far they may lie below the sweep's samples.
//! Must not know: the sun.

use std::sync::{Arc, Weak};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8};
use rayon::prelude::*;

use crate::scene::terrain::Terrain;

/// Points that are sampled at once: the lanes of a vector.
pub(super) const LANES: usize = 8;

/// A square ground as a heightfield: the map samples it half a million times. Kept from map to map.
#[derive(Clone, Debug, Default)]
pub(super) struct Heightfield {
    /// The terrain. A weak reference keeps the address from being used again, but not the ground.
    source: Weak<Terrain>,
    /// Cells along a side.
    cells: usize,
    cell_m: f32,
    cells_per_m: f32,
    half_m: f32,
    /// For the step of the current map.
    pub(super) chord_errors: ChordErrors,
}

impl Heightfield {
    /// Updates a heightfield, or replaces one that others use.
    pub(super) fn update_shared(shared: &mut Arc<Self>, terrain: &Arc<Terrain>, step_m: f32) {
        if !shared.serves(terrain, step_m) {
            let mut heightfield = Arc::get_mut(shared).map(std::mem::take).unwrap_or_default();
            heightfield.update(terrain, step_m);
            *shared = Arc::new(heightfield);
        }
    }

    fn serves(&self, terrain: &Arc<Terrain>, step_m: f32) -> bool {
        self.source.ptr_eq(&Arc::downgrade(terrain)) && self.chord_errors.step_m == step_m
    }

    /// Takes the size of a terrain, and bounds the chord errors for a step.
    fn update(&mut self, terrain: &Arc<Terrain>, step_m: f32) {
        if !self.source.ptr_eq(&Arc::downgrade(terrain)) {
            self.source = Arc::downgrade(terrain);
            self.cells = terrain.columns as usize;
            self.cell_m = terrain.cell_m();
            self.cells_per_m = 1.0 / terrain.cell_m();
            self.half_m = terrain.half_extent_m;
        }
        let mut chord_errors = std::mem::take(&mut self.chord_errors);
        chord_errors.update(self, &terrain.heights_m, step_m);
        self.chord_errors = chord_errors;
    }

    /// Heights of the ground at [`LANES`] points, `f32::MIN` outside of it, and the cells that hold them, each by the index of its
    /// first vertex. The same values as [`Terrain::surface_height_at`]: linear over each of the two triangles of a cell. `heights_m` are
    /// those of the terrain.
    #[inline(always)]
    pub(super) fn sample<S: Simd>(
        &self,
        simd: S,
        heights_m: &[f32],
        [x, y]: [f32x8<S>; 2],
    ) -> (f32x8<S>, i32x8<S>) {
        let last = (self.cells - 1) as f32;
        let zero = f32x8::splat(simd, 0.0);
        let (cell_x, cell_y) = ((x + self.half_m) * self.cells_per_m, (y + self.half_m) * self.cells_per_m);
        let column = cell_x.floor().max(zero).min(f32x8::splat(simd, last));
        let row = cell_y.floor().max(zero).min(f32x8::splat(simd, last));
        let (u, v) = (cell_x - column, cell_y - row);
        let row_len = self.cells as i32 + 1;
        let vertex = row.to_int::<i32x8<S>>() * row_len + column.to_int::<i32x8<S>>();
        // The diagonal runs from the first vertex to the last; the third corner lies east or north of the first.
        let is_east = u.simd_ge(v);
        let mut vertices = [0; LANES];
        vertex.store_slice(&mut vertices);
        // Of each cell, the vertices to the south and to the north.
        let mut corners_m = [[[0.0; 2]; LANES]; 2];
        for (lane, vertex) in vertices.into_iter().enumerate() {
            for (row, corners_m) in corners_m.iter_mut().enumerate() {
                let first = vertex as u32 as usize + row * (self.cells + 1);
                let pair = &heights_m[first..first + 2];
                corners_m[lane] = [pair[0], pair[1]];
            }
        }
        let [(h00, h10), (h01, h11)] = corners_m.each_ref().map(|corners_m| {
            let (first, second) = corners_m.as_flattened().split_at(LANES);
            f32x8::from_slice(simd, first).deinterleave(f32x8::from_slice(simd, second))
        });
        let h_third = is_east.select(h10, h01);
        let (near, far) = (is_east.select(u, v), is_east.select(v, u));
        let is_inside = x.abs().max(y.abs()).simd_le(self.half_m);
        let height = h00 + (h_third - h00) * near + (h11 - h_third) * far;
        (is_inside.select(height, f32x8::splat(simd, f32::MIN)), vertex)
    }
}

/// For each cell of a heightfield, an upper bound of how far its ground lies below the chord between two samples one step apart.
///
/// Along a line the ground is piecewise linear, with kinks where it crosses edges of triangles. A kink by J (change of slope) within
/// a chord of length s takes the ground at most J s / 4 off the chord. Two axes make twice that; the kinks at the three kinds of
/// edges (two axes and the diagonal) are added up, each the largest of the cells around.
#[derive(Clone, Debug, Default)]
pub(super) struct ChordErrors {
    step_m: f32,
    /// Of each cell, by the index of its first vertex, metres.
    errors_m: Vec<f32>,
    /// The largest of all, metres.
    max_m: f32,
    /// Largest kinks along each row of vertices; kept for its memory.
    row_maxima: Vec<f32>,
}

impl ChordErrors {
    fn update(&mut self, heightfield: &Heightfield, heights_m: &[f32], step_m: f32) {
        let cells = heightfield.cells;
        let scale = 0.5 * step_m / heightfield.cell_m;
        // The maximum over two cells each way is separable: first along rows, then along columns.
        let row_maxima = &mut self.row_maxima;
        row_maxima.resize(cells * (cells + 1), 0.0);
        row_maxima.par_chunks_exact_mut(cells).enumerate().for_each(|(row, maxima)| {
            let rows = [row.saturating_sub(1), row, (row + 1).min(cells)]
                .map(|row| &heights_m[row * (cells + 1)..][..cells + 1]);
            dispatch!(Level::new(), _simd => row_kinks(rows, scale, maxima));
        });
        // No cell begins with the last row or column.
        self.errors_m.resize((cells + 1) * (cells + 1), 0.0);
        let rows = self.errors_m.par_chunks_exact_mut(cells + 1).take(cells).enumerate();
        let max_m = rows.map(|(row, errors_m)| {
            errors_m.fill(0.0);
            for row in row.saturating_sub(1)..=(row + 2).min(cells) {
                dispatch!(Level::new(), _simd => max_assign(errors_m, &row_maxima[row * cells..][..cells]));
            }
            errors_m.iter().copied().fold(0.0, f32::max)
        });
        self.max_m = max_m.reduce(|| 0.0, f32::max);
        self.step_m = step_m;
    }

    /// Bit mask of the lanes around whose sample ground may be shadowed: the sample stands above the lower limb's horizon by no more
    /// than the ground beside it may lie below its chord.
    #[inline(always)]
    pub(super) fn shadowed_lanes<S: Simd>(
        &self,
        simd: S,
        ground: f32x8<S>,
        cell: i32x8<S>,
        lower: f32x8<S>,
    ) -> u64 {
        let (on_ground, above) = (ground.simd_gt(f32::MIN), ground - lower);
        if !(on_ground & above.simd_le(self.max_m)).any_true() {
            return 0;
        }
        let mut cells = [0; LANES];
        cell.store_slice(&mut cells);
        let errors_m = cells.map(|cell| self.errors_m[cell as usize]);
        (on_ground & above.simd_le(f32x8::from_slice(simd, &errors_m))).to_bitmask()
    }
}

/// Of each cell of a row, the largest kinks at the vertices of the row up to one cell further on each side, from the heights to
/// the south, along the row and to the north.
#[inline(always)]
fn row_kinks([south, here, north]: [&[f32]; 3], scale: f32, maxima: &mut [f32]) {
    let last = maxima.len();
    // Second differences at a vertex, the changes of slope times a cell: along both axes and the diagonal.
    let kinks = |west: usize, column: usize, east: usize| {
        let middle = 2.0 * here[column];
        scale
            * ((here[west] + here[east] - middle).abs()
                + (south[column] + north[column] - middle).abs()
                + (south[west] + north[east] - middle).abs())
    };
    let mut of_vertices = vec![0.0; last + 1];
    for (column, kink) in of_vertices.iter_mut().enumerate().take(last).skip(1) {
        *kink = kinks(column - 1, column, column + 1);
    }
    (of_vertices[0], of_vertices[last]) = (kinks(0, 0, 1), kinks(last - 1, last, last));
    maxima.copy_from_slice(&of_vertices[1..]);
    max_assign(maxima, &of_vertices);
    max_assign(&mut maxima[1..], &of_vertices);
    max_assign(maxima, &of_vertices[2..]);
}

/// Sets each value to the larger of it and its counterpart in `others`, as far as the shorter list reaches.
#[inline(always)]
fn max_assign(values: &mut [f32], others: &[f32]) {
    for (value, other) in values.iter_mut().zip(others) {
        *value = if *other > *value { *other } else { *value };
    }
}
