//! The tiles of an image that the resolve pass has to work on.
//!
//! Pixels whose samples are all in the sky's dome have one value in each plane. Where the host knows the stencil, one tile of them
//! is resolved, and its values are copied to the others.
//! Must not know: what the planes are.

use std::ops::Range;

use crate::render::device::packing::WORKGROUP_SIZE;

/// Pixels of a tile, in reading order: one workgroup resolves it, four pixels in each invocation.
const TILE_PIXELS: usize = 4 * WORKGROUP_SIZE as usize;

/// The stencil of an image, where samples that no surface covers have the value of the dome.
#[derive(Clone, Copy, Debug)]
pub(super) struct SkyStencil<'a> {
    /// Values of the samples, row by row.
    pub stencil: &'a [u8],
    /// Value of the dome.
    pub dome: u8,
    /// Samples along a side of a pixel.
    pub samples_per_side: usize,
}

/// Tiles, by index.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct TileList {
    /// Tiles that are resolved.
    pub resolved: Vec<u32>,
    /// Tiles of the dome alone: the last is among those that are resolved, and the others get its values. The last, because it is
    /// near the horizon: lighting leaves out the rows that are not resolved.
    empty: Vec<u32>,
}

impl TileList {
    /// Lists the tiles of an image of this size: all of them without a stencil.
    #[must_use]
    pub(super) fn new([width, height]: [u32; 2], sky: Option<SkyStencil<'_>>) -> Self {
        let (width, pixels) = (width as usize, width as usize * height as usize);
        let Some(SkyStencil { stencil, dome, samples_per_side: side }) = sky else {
            return Self { resolved: (0..pixels.div_ceil(TILE_PIXELS) as u32).collect(), empty: Vec::new() };
        };
        let empty_row = vec![dome; side * width.min(TILE_PIXELS)];
        let is_empty = |tile: usize| {
            let end = pixels.min((tile + 1) * TILE_PIXELS);
            let mut first = tile * TILE_PIXELS;
            while first < end {
                let (row, column) = (first / width, first % width);
                let count = (end - first).min(width - column);
                let mut rows = stencil[side * side * row * width..].chunks_exact(side * width).take(side);
                if !rows.all(|samples| samples[side * column..][..side * count] == empty_row[..side * count])
                {
                    return false;
                }
                first += count;
            }
            true
        };
        let mut list = Self::default();
        for tile in 0..pixels.div_ceil(TILE_PIXELS) {
            let tiles = if is_empty(tile) { &mut list.empty } else { &mut list.resolved };
            tiles.push(tile as u32);
        }
        // The last tile of the image may be cut off, and then has too few values for the others.
        if let [.., other, last] = &mut list.empty[..]
            && (*last as usize + 1) * TILE_PIXELS > pixels
        {
            std::mem::swap(other, last);
        }
        if let Some(last) = list.empty.last() {
            list.resolved.insert(list.resolved.partition_point(|tile| tile < last), *last);
        }
        list
    }

    /// The rows of pixels of an image of this width that the resolved tiles lie in.
    #[must_use]
    pub(super) fn resolved_rows(&self, width: u32) -> Range<u32> {
        let row = |tile: u32, pixel: usize| (tile as usize * TILE_PIXELS + pixel) as u32 / width;
        match self.resolved[..] {
            [first, .., last] => row(first, 0)..row(last, TILE_PIXELS - 1) + 1,
            [tile] => row(tile, 0)..row(tile, TILE_PIXELS - 1) + 1,
            [] => 0..0,
        }
    }

    /// Fills the empty tiles of a plane that were not resolved.
    pub(super) fn spread<T: Copy>(&self, plane: &mut [T], values_per_pixel: usize) {
        let [others @ .., resolved] = self.empty.as_slice() else { return };
        if plane.is_empty() {
            return;
        }
        let tile_len = TILE_PIXELS * values_per_pixel;
        let end = plane.len().min((*resolved as usize + 1) * tile_len);
        let resolved = plane[*resolved as usize * tile_len..end].to_vec();
        for tile in others {
            let values_of_tile = &mut plane[*tile as usize * tile_len..];
            // The last tile may be cut off by the end of the image.
            let count = values_of_tile.len().min(resolved.len());
            values_of_tile[..count].copy_from_slice(&resolved[..count]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_empty_tile_is_resolved_and_spread_to_the_others() {
        const DOME: u8 = 9;
        // Rows that do not end at the end of a tile, and a last tile that is cut off.
        for (size, side) in [([300, 40], 1), ([300, 40], 2), ([64, 33], 4), ([512, 20], 2)] {
            let [width, height] = size.map(|pixels| pixels as usize);
            let mut stencil = vec![DOME; side * width * side * height];
            let rock_pixels = [(17, 3), (width - 1, 11), (40, 12)];
            for (column, row) in rock_pixels {
                // The last sample of the pixel.
                stencil[(side * row + side - 1) * side * width + side * column + side - 1] = 1;
            }
            let list = TileList::new(
                size,
                Some(SkyStencil { stencil: &stencil, dome: DOME, samples_per_side: side }),
            );
            let with_rocks: Vec<u32> = rock_pixels
                .iter()
                .map(|(column, row)| ((row * width + column) / TILE_PIXELS) as u32)
                .collect();
            let all = (width * height).div_ceil(TILE_PIXELS) as u32;
            let is_whole = |tile: &u32| (*tile as usize + 1) * TILE_PIXELS <= width * height;
            let is_dome = |tile: &u32| !with_rocks.contains(tile) && is_whole(tile);
            let last_dome = (0..all).rev().find(is_dome).unwrap();
            let expected = |tile: &u32| *tile == last_dome || with_rocks.contains(tile);
            assert_eq!(list.resolved, (0..all).filter(expected).collect::<Vec<_>>(), "{size:?}");
            let whole = |pixel: usize| {
                let is_rock = rock_pixels.iter().any(|(column, row)| row * width + column == pixel);
                if is_rock { [pixel as u32, 1] } else { [7, 8] }
            };
            let whole: Vec<u32> = (0..width * height).flat_map(whole).collect();
            let mut plane = vec![0; whole.len()];
            for tile in &list.resolved {
                let range =
                    2 * TILE_PIXELS * *tile as usize..whole.len().min(2 * TILE_PIXELS * (*tile as usize + 1));
                plane[range.clone()].copy_from_slice(&whole[range]);
            }
            assert_ne!(plane, whole);
            list.spread(&mut plane, 2);
            assert_eq!(plane, whole, "{size:?}");
            assert_eq!(TileList::new(size, None).resolved, (0..all).collect::<Vec<_>>());
        }
    }
}
