//! What of a picture the resolve pass works on.
//!
//! Pixels of which all samples show the sky's dome have one value in each plane. Where this program knows them, one part of
//! them is resolved, and its values stand for all.
//! Must not know: what the planes are.

/// Pixels of a workgroup, in reading order: four for each of its invocations.
const PIXELS: usize = 4 * crate::render::device::packing::WORKGROUP_SIZE as usize;

/// What the samples of a picture show.
#[derive(Clone, Copy, Debug)]
pub struct SkyStencil<'a> {
    /// A value a sample, a row after the other.
    pub stencil: &'a [u8],
    /// That of those that show the dome.
    pub dome: u8,
    /// Samples along a side of a pixel.
    pub samples_per_side: usize,
}

/// Workgroups by their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TileList {
    /// Those whose pixels are resolved.
    pub resolved: Vec<u32>,
    /// Those of the dome alone: the first is resolved, and the others have its values.
    blank: Vec<u32>,
}

impl TileList {
    /// For a picture of this size.
    #[must_use]
    pub fn new([width, height]: [u32; 2], shown: Option<SkyStencil<'_>>) -> Self {
        let (width, pixels) = (width as usize, width as usize * height as usize);
        let Some(SkyStencil { stencil, dome, samples_per_side: side }) = shown else {
            return Self { resolved: (0..pixels.div_ceil(PIXELS) as u32).collect(), blank: Vec::new() };
        };
        let blank_row = vec![dome; side * width.min(PIXELS)];
        let is_blank = |number: usize| {
            let end = pixels.min((number + 1) * PIXELS);
            let mut first = number * PIXELS;
            while first < end {
                let (row, column) = (first / width, first % width);
                let count = (end - first).min(width - column);
                let mut rows = stencil[side * side * row * width..].chunks_exact(side * width).take(side);
                if !rows.all(|samples| samples[side * column..][..side * count] == blank_row[..side * count])
                {
                    return false;
                }
                first += count;
            }
            true
        };
        let mut work = Self::default();
        for number in 0..pixels.div_ceil(PIXELS) {
            let is_blank = is_blank(number);
            if !is_blank || work.blank.is_empty() {
                work.resolved.push(number as u32);
            }
            if is_blank {
                work.blank.push(number as u32);
            }
        }
        work
    }

    /// Gives the pixels that were not resolved their values in a plane.
    pub fn spread<T: Copy>(&self, plane: &mut [T], values_per_pixel: usize) {
        let [first, others @ ..] = self.blank.as_slice() else { return };
        if plane.is_empty() {
            return;
        }
        let values = PIXELS * values_per_pixel;
        let end = plane.len().min((*first as usize + 1) * values);
        let resolved = plane[*first as usize * values..end].to_vec();
        for number in others {
            let alike = &mut plane[*number as usize * values..];
            // The last workgroup may not be full.
            let count = alike.len().min(resolved.len());
            alike[..count].copy_from_slice(&resolved[..count]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shows_the_dome_alone_is_resolved_once_and_spread() {
        const DOME: u8 = 9;
        // Rows that do not end with workgroups, and a last workgroup that is not full.
        for (size, side) in [([300, 40], 1), ([300, 40], 2), ([64, 33], 4), ([512, 20], 2)] {
            let [width, height] = size.map(|pixels| pixels as usize);
            let mut stencil = vec![DOME; side * width * side * height];
            let things = [(17, 3), (width - 1, 11), (40, 12)];
            for (column, row) in things {
                // The last sample of the pixel.
                stencil[(side * row + side - 1) * side * width + side * column + side - 1] = 1;
            }
            let work = TileList::new(
                size,
                Some(SkyStencil { stencil: &stencil, dome: DOME, samples_per_side: side }),
            );
            let with_things: Vec<u32> =
                things.iter().map(|(column, row)| ((row * width + column) / PIXELS) as u32).collect();
            let all = (width * height).div_ceil(PIXELS) as u32;
            let first_blank = (0..all).find(|number| !with_things.contains(number)).unwrap();
            let expected = |number: &u32| *number == first_blank || with_things.contains(number);
            assert_eq!(work.resolved, (0..all).filter(expected).collect::<Vec<_>>(), "{size:?}");
            let whole = |pixel: usize| {
                let is_thing = things.iter().any(|(column, row)| row * width + column == pixel);
                if is_thing { [pixel as u32, 1] } else { [7, 8] }
            };
            let whole: Vec<u32> = (0..width * height).flat_map(whole).collect();
            let mut plane = vec![0; whole.len()];
            for number in &work.resolved {
                let range =
                    2 * PIXELS * *number as usize..whole.len().min(2 * PIXELS * (*number as usize + 1));
                plane[range.clone()].copy_from_slice(&whole[range]);
            }
            assert_ne!(plane, whole);
            work.spread(&mut plane, 2);
            assert_eq!(plane, whole, "{size:?}");
            assert_eq!(TileList::new(size, None).resolved, (0..all).collect::<Vec<_>>());
        }
    }
}
