//! The ground as a regular square heightfield: two fBm layers and craters for the nominal stage, any function in tests.
//!
//! Must not know: who asks for heights.

use std::sync::OnceLock;

use fearless_simd::{Level, dispatch};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::mesh::Vertex;
use super::noise::Fbm;
use super::nominal_craters::{Crater, draw_craters, set_crater_heights};
use super::terrain::{Layout, Terrain, z_range_m};
use crate::params::{Knob, Params};
use crate::pool::PooledVec;
use crate::random::Streams;

/// Octaves and first frequency (per metre) of the broad relief.
const BROAD: (u32, f32) = (5, 0.010);
/// Octaves and first frequency (per metre) of the finer relief.
const FINE: (u32, f32) = (4, 0.045);
/// Amplitude of the finer relief when that of the broad one is 3.2 m.
const FINE_PER_BROAD: f32 = 0.7 / 3.2;
/// Lines whose heights one task computes.
const LINES: usize = 16;

impl Terrain {
    /// The ground of the nominal stage.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params) -> Self {
        let size_m = params.number(Knob::TerrainSizeM) as f32;
        let cells = params.count(Knob::TerrainCells);
        let craters = draw_craters(streams, params);
        let amplitude_m = params.number(Knob::TerrainAmplitudeM) as f32;
        let mut seeds = streams.stream("terrain.relief", 0);
        let layer = |(octaves, frequency), seed| Fbm { octaves, frequency, lacunarity: 2.0, seed };
        let (broad, fine) = (layer(BROAD, seeds.bits()), layer(FINE, seeds.bits()));
        Self::from_lines(size_m, cells, craters.clone(), |x, y, heights| {
            let (mut broad, mut fine) = (broad.lines(x), fine.lines(x));
            let [mut finer, mut crater_m] = [(); 2].map(|()| PooledVec::unspecified(x.len()));
            for (heights, &y) in heights.chunks_mut(x.len()).zip(y) {
                broad.set(y, heights);
                fine.set(y, &mut finer);
                set_crater_heights(&craters, x, y, &mut crater_m);
                for ((height, finer), crater_m) in heights.iter_mut().zip(&finer).zip(&crater_m) {
                    *height = amplitude_m * (*height + FINE_PER_BROAD * finer) + crater_m;
                }
            }
        })
    }

    /// A square ground of any height function (metres from metres); `craters` is stored without being applied.
    #[must_use]
    pub fn from_height(
        size_m: f32,
        cells: u32,
        craters: Vec<Crater>,
        height_m: impl Fn(Vec2) -> f32 + Sync,
    ) -> Self {
        Self::from_lines(size_m, cells, craters, |x, y, heights| {
            let points = y.iter().flat_map(|&y| x.iter().map(move |&x| Vec2::new(x, y)));
            for (height, point) in heights.iter_mut().zip(points) {
                *height = height_m(point);
            }
        })
    }

    /// The same for a function that sets the heights of several lines of points along x, from their coordinates along both
    /// axes.
    fn from_lines(
        size_m: f32,
        cells: u32,
        craters: Vec<Crater>,
        set_heights: impl Fn(&[f32], &[f32], &mut [f32]) + Sync,
    ) -> Self {
        let row_len = cells as usize + 1;
        let mut vertices: PooledVec<Vertex> = PooledVec::unspecified(row_len * row_len);
        let coordinates: Vec<f32> = (0..row_len).map(|i| (i as f32 / cells as f32 - 0.5) * size_m).collect();
        let mut heights: PooledVec<f32> = PooledVec::unspecified(row_len * row_len);
        heights
            .par_chunks_mut(LINES * row_len)
            .zip(coordinates.par_chunks(LINES))
            .for_each(|(heights, y)| set_heights(&coordinates, y, heights));
        let cell_m = size_m / cells as f32;
        vertices.par_chunks_mut(row_len).enumerate().for_each_init(
            || [(); 3].map(|()| PooledVec::unspecified(row_len)),
            |normals, (row, vertices)| {
                let heights = |row: usize| &heights[row * row_len..][..row_len];
                let [south, here, north] =
                    [row.saturating_sub(1), row, (row + 1).min(row_len - 1)].map(heights);
                let rows = if row == 0 || row + 1 == row_len { 1.0 } else { 2.0 };
                dispatch!(Level::new(), _simd => set_normals([south, here, north], cell_m, rows, normals));
                for (column, vertex) in vertices.iter_mut().enumerate() {
                    vertex.position = Vec3::new(coordinates[column], coordinates[row], here[column]);
                    vertex.normal = Vec3::from(normals.each_ref().map(|axis| axis[column]));
                }
            },
        );
        Self {
            layout: Layout::Square,
            centre: Vec2::ZERO,
            half_extent_m: 0.5 * size_m,
            z_range_m: z_range_m(&heights),
            columns: cells,
            rows: cells,
            vertices,
            heights_m: heights,
            craters,
            block_bounds: OnceLock::new(),
            range: OnceLock::new(),
        }
    }
}

/// Sets the normals of a line of vertices, one slice per axis, by central differences of the heights: its own and those
/// of the lines on both sides, which are `rows` cells apart.
#[inline(always)]
fn set_normals([south, here, north]: [&[f32]; 3], cell_m: f32, rows: f32, normals: &mut [PooledVec<f32>; 3]) {
    let [x, y, z] = normals.each_mut().map(|axis| &mut axis[..]);
    let last = here.len() - 1;
    x[0] = -((here[1] - here[0]) / cell_m);
    x[last] = -((here[last] - here[last - 1]) / cell_m);
    for (x, (west, east)) in x[1..last].iter_mut().zip(here.iter().zip(&here[2..])) {
        *x = -((east - west) / (2.0 * cell_m));
    }
    for (y, (south, north)) in y.iter_mut().zip(south.iter().zip(north)) {
        *y = -((north - south) / (rows * cell_m));
    }
    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
        let length = (*x * *x + *y * *y + 1.0).sqrt();
        *x /= length;
        *y /= length;
        *z = 1.0 / length;
    }
}
