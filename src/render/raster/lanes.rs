//! Structures of arrays for SIMD, and the blocks of pixels that eight lanes stand for.
//!
//! A block is [`BLOCK_WIDTH`] x [`BLOCK_HEIGHT`] pixels: lanes 0 to 3 are four pixels of a row, lanes 4 to 7 those below. In a
//! buffer it is two offsets, of lane 0 and of lane 4.
//! Must not know: triangles.

use fearless_simd::prelude::*;
use fearless_simd::{f32x4, f32x8, i32x8, u32x4, u32x8};
use glam::Vec3;

/// Triangles that are set up at once, and pixels that are filled at once: the lanes of a 256-bit vector of 32-bit numbers.
pub(crate) const LANES: usize = 8;
/// Columns of a block of pixels. The last block of a row may reach past the render area, so a buffer has as many extra columns.
pub(crate) const BLOCK_WIDTH: usize = 4;
/// Rows of a block of pixels. A buffer has as many extra rows, see [`BLOCK_WIDTH`].
pub(crate) const BLOCK_HEIGHT: usize = LANES / BLOCK_WIDTH;
/// Vertices that are transformed at once.
pub(crate) const VERTEX_BATCH: usize = 64;

/// Up to [`VERTEX_BATCH`] vectors as three arrays, one per axis; 0 past the last.
#[must_use]
#[inline(always)]
pub(crate) fn to_soa(vectors: impl Iterator<Item = Vec3>) -> [[f32; VERTEX_BATCH]; 3] {
    let mut axes = [[0.0; VERTEX_BATCH]; 3];
    for (i, v) in vectors.take(VERTEX_BATCH).enumerate() {
        (axes[0][i], axes[1][i], axes[2][i]) = (v.x, v.y, v.z);
    }
    axes
}

/// Integers of three corners, eight triangles each, as vectors.
#[inline(always)]
pub(super) fn load_i32<S: Simd>(simd: S, [a, b, c]: &[[i32; LANES]; 3]) -> [i32x8<S>; 3] {
    [i32x8::from_slice(simd, a), i32x8::from_slice(simd, b), i32x8::from_slice(simd, c)]
}

/// Floats of three corners, eight triangles each, as vectors.
#[inline(always)]
pub(super) fn load_f32<S: Simd>(simd: S, [a, b, c]: &[[f32; LANES]; 3]) -> [f32x8<S>; 3] {
    [f32x8::from_slice(simd, a), f32x8::from_slice(simd, b), f32x8::from_slice(simd, c)]
}

/// Columns and rows of the pixels of a block, counted from its first.
#[inline(always)]
pub(super) fn block_offsets<S: Simd>(simd: S) -> (i32x8<S>, i32x8<S>) {
    (i32x8::from_slice(simd, &[0, 1, 2, 3, 0, 1, 2, 3]), i32x8::from_slice(simd, &[0, 0, 0, 0, 1, 1, 1, 1]))
}

/// Reads a block of floats.
#[must_use]
#[inline(always)]
pub(crate) fn load_block<S: Simd>(simd: S, buffer: &[f32], [upper, lower]: [usize; 2]) -> f32x8<S> {
    let [upper, lower] = [upper, lower].map(|at| &buffer[at..at + BLOCK_WIDTH]);
    f32x4::from_slice(simd, upper).combine(f32x4::from_slice(simd, lower))
}

/// Writes a block of floats.
#[inline(always)]
pub(crate) fn store_block<S: Simd>(buffer: &mut [f32], [upper, lower]: [usize; 2], values: f32x8<S>) {
    let (upper_values, lower_values) = values.split();
    upper_values.store_slice(&mut buffer[upper..upper + BLOCK_WIDTH]);
    lower_values.store_slice(&mut buffer[lower..lower + BLOCK_WIDTH]);
}

/// Reads a block of words.
#[must_use]
#[inline(always)]
pub(crate) fn load_block_u32<S: Simd>(simd: S, buffer: &[u32], [upper, lower]: [usize; 2]) -> u32x8<S> {
    u32x4::from_slice(simd, &buffer[upper..upper + BLOCK_WIDTH])
        .combine(u32x4::from_slice(simd, &buffer[lower..lower + BLOCK_WIDTH]))
}

/// Writes a block of words.
#[inline(always)]
pub(crate) fn store_block_u32<S: Simd>(buffer: &mut [u32], [upper, lower]: [usize; 2], values: u32x8<S>) {
    let (upper_values, lower_values) = values.split();
    upper_values.store_slice(&mut buffer[upper..upper + BLOCK_WIDTH]);
    lower_values.store_slice(&mut buffer[lower..lower + BLOCK_WIDTH]);
}
