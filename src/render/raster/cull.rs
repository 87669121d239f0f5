//! Culling: back faces, and triangles whose bounds hold no pixel centre.
//!
//! Must not know: what is drawn.

use std::ops::Range;

use fearless_simd::mask32x8;
use fearless_simd::prelude::*;

use super::bounds::Bounds8;
use super::fixed_point::{SubpixelPoint, twice_area};
use super::lanes::{LANES, load_i32};

/// Orientation of a triangle's vertices in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Winding {
    /// Counter-clockwise: a front face.
    Front,
    /// Clockwise: a back face.
    Back,
}

impl Winding {
    /// The winding of three vertices; none of a degenerate triangle.
    #[must_use]
    #[inline(always)]
    pub(crate) fn of([a, b, c]: [SubpixelPoint; 3]) -> Option<Self> {
        match twice_area(a, b, c) {
            ..0 => Some(Self::Front),
            0 => None,
            1.. => Some(Self::Back),
        }
    }
}

/// Which faces are dropped, as `cull_mode` of WebGPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CullMode {
    /// Back faces.
    Back,
    /// No faces.
    None,
}

/// Triangles that are culled at once.
pub(crate) const CULL_BATCH: usize = 256;

/// Indices of the triangles of a batch that survive culling.
#[derive(Clone, Debug)]
pub(crate) struct Survivors {
    /// With room for the last eight to be written before they are counted.
    indices: [u16; CULL_BATCH + LANES],
    count: usize,
}

impl Survivors {
    /// All triangles of a batch, for one that cannot be culled yet.
    #[must_use]
    pub(crate) fn all(count: usize) -> Self {
        Self { indices: std::array::from_fn(|index| index as u16), count }
    }

    /// Culls up to [`CULL_BATCH`] triangles, given by their vertices, for a render area of `width` columns and of these rows. A
    /// large triangle may survive and yet cover nothing or face away.
    ///
    /// Most triangles are dropped, in no order that a branch predictor learns: the indices are written without branches.
    #[must_use]
    #[inline(always)]
    pub(crate) fn cull<S: Simd>(
        simd: S,
        triangles: &[[u32; 3]],
        position_of: impl Fn(u32) -> SubpixelPoint,
        cull_mode: CullMode,
        width: usize,
        rows: &Range<i32>,
    ) -> Self {
        let mut survivors = Self { indices: [0; CULL_BATCH + LANES], count: 0 };
        let mut index = 0;
        while index < triangles.len() {
            // A lane without a triangle has no area, and is culled.
            let (mut x, mut y) = ([[0; LANES]; 3], [[0; LANES]; 3]);
            for (lane, triangle) in triangles[index..].iter().take(LANES).enumerate() {
                for corner in 0..3 {
                    let position = position_of(triangle[corner]);
                    (x[corner][lane], y[corner][lane]) = (position.x, position.y);
                }
            }
            let bounds = Bounds8::new(simd, load_i32(simd, &x), load_i32(simd, &y), width, rows);
            let survives = survives(&bounds, cull_mode).to_bitmask();
            for lane in 0..LANES {
                survivors.indices[survivors.count] = (index + lane) as u16;
                survivors.count += (survives >> lane & 1) as usize;
            }
            index += LANES;
        }
        survivors
    }

    /// In ascending order.
    #[must_use]
    pub(crate) fn indices(&self) -> &[u16] {
        &self.indices[..self.count]
    }
}

/// Which of eight triangles survive culling: bounds that hold a pixel centre, and a side that is drawn. Large triangles count as
/// facing the camera, for their area is not known here.
#[inline(always)]
fn survives<S: Simd>(bounds: &Bounds8<S>, cull_mode: CullMode) -> mask32x8<S> {
    let has_pixels = bounds.columns[1].simd_ge(bounds.columns[0]) & bounds.rows[1].simd_ge(bounds.rows[0]);
    let is_facing = match cull_mode {
        CullMode::Back => bounds.twice_area.simd_lt(0),
        CullMode::None => bounds.twice_area.simd_lt(0) | bounds.twice_area.simd_gt(0),
    };
    has_pixels & (is_facing | !bounds.is_small)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::raster::bounds::pixel_bounds;
    use crate::render::raster::coverage::{SIZE, random_triangles};
    use fearless_simd::{Level, dispatch};

    #[test]
    fn culled_triangles_cover_no_pixel_or_are_back_facing() {
        let triangles = random_triangles();
        let positions = triangles.as_flattened();
        let corners: Vec<[u32; 3]> =
            (0..triangles.len() as u32).map(|number| [3 * number, 3 * number + 1, 3 * number + 2]).collect();
        let rows = 9..33;
        for cull_mode in [CullMode::Back, CullMode::None] {
            let (mut drawn, mut culled) = (0, 0);
            for (batch, triangles) in triangles.chunks(CULL_BATCH).zip(corners.chunks(CULL_BATCH)) {
                let position_of = |corner: u32| positions[corner as usize];
                let survivors = dispatch!(Level::new(), simd => {
                    Survivors::cull(simd, triangles, position_of, cull_mode, SIZE, &rows)
                });
                for (index, &triangle) in batch.iter().enumerate() {
                    let winding = Winding::of(triangle);
                    let is_facing =
                        winding == Some(Winding::Front) || (winding.is_some() && cull_mode == CullMode::None);
                    let is_drawn = is_facing && pixel_bounds(triangle, SIZE, &rows).is_some();
                    assert_eq!(survivors.indices().contains(&(index as u16)), is_drawn, "{triangle:?}");
                    (drawn, culled) = (drawn + u32::from(is_drawn), culled + u32::from(!is_drawn));
                }
            }
            assert!(drawn > 50 && culled > 50, "{drawn} and {culled}");
        }
    }
}
