//! For tests: a sink that counts how often each pixel is covered, and random triangles.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::fill::FragmentSink;
use super::fixed_point::{SUBPIXEL_STEPS, SubpixelPoint};
use super::lanes::{BLOCK_HEIGHT, BLOCK_WIDTH, LANES};
use super::setup::Interpolant;
use crate::scene::noise::lattice_hash;

/// Columns and rows of the buffers of the rasteriser's own tests.
pub(in crate::render) const SIZE: usize = 48;
/// Their distance between rows.
pub(in crate::render) const STRIDE: usize = SIZE + BLOCK_WIDTH;

/// Counts the triangles that cover each pixel.
pub(in crate::render) struct CoverageCounter {
    /// Per pixel.
    pub(in crate::render) counts: Vec<u32>,
    /// The attribute of the last triangle that covered the pixel.
    pub(in crate::render) values: Vec<f32>,
    /// The attribute of the triangle that is filled.
    pub(in crate::render) attribute: Interpolant,
}

impl CoverageCounter {
    /// A buffer of this many columns and rows, and the extra ones of [`BLOCK_WIDTH`] and [`BLOCK_HEIGHT`].
    pub(in crate::render) fn new([width, height]: [usize; 2]) -> Self {
        let pixels = (width + BLOCK_WIDTH) * (height + BLOCK_HEIGHT);
        Self { counts: vec![0; pixels], values: vec![0.0; pixels], attribute: Interpolant::ZERO }
    }
}

impl<S: Simd> FragmentSink<S> for CoverageCounter {
    fn write(&mut self, _: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let value = self.attribute.at(x, y);
        for lane in (0..LANES).filter(|&lane| covered.test(lane)) {
            let pixel = offsets[lane / BLOCK_WIDTH] + lane % BLOCK_WIDTH;
            self.counts[pixel] += 1;
            self.values[pixel] = value[lane];
        }
    }
}

/// An integer from 0 to before `end`, fixed by its number and axis.
pub(super) fn random(number: i32, axis: i32, end: u32) -> i32 {
    (lattice_hash(number, axis, 0, 7) % end) as i32
}

/// A point of the buffer; every other has a pixel centre on its left and above, where edges meet centres.
pub(super) fn random_point(number: i32) -> SubpixelPoint {
    let steps = SIZE as u32 * SUBPIXEL_STEPS as u32;
    let snap = |step: i32| if number % 2 == 0 { step } else { step & !(SUBPIXEL_STEPS - 1) };
    SubpixelPoint { x: snap(random(number, 0, steps)), y: snap(random(number, 1, steps)) }
}

/// Triangles, two small ones for each that may be large.
pub(super) fn random_triangles() -> Vec<[SubpixelPoint; 3]> {
    let near = |number: i32, corner: i32| {
        let middle = random_point(number);
        let offset =
            |axis: i32| random(3 * number + corner, axis, 3 * SUBPIXEL_STEPS as u32) - SUBPIXEL_STEPS;
        SubpixelPoint { x: middle.x + offset(2), y: middle.y + offset(3) }
    };
    (0..600)
        .map(|number| {
            [0, 1, 2].map(|corner| {
                if number % 3 == 0 { random_point(3 * number + corner) } else { near(number, corner) }
            })
        })
        .collect()
}
