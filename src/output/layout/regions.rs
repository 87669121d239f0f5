//! Which annotation each pixel of a frame belongs to, and the region of each.
//!
//! Must not know: formats.

use std::collections::BTreeMap;

use crate::class::ClassId;
use crate::frame::{Frame, LabelReason};

/// The annotation of the rocks that the label rule ignores: above all instance ids.
pub(super) const CROWD: u32 = u16::MAX as u32;

/// The annotation that each pixel belongs to: an instance id, [`CROWD`] where the label rule ignores a rock, or 0. It follows from the
/// instances and their reasons, not from the class: an edge policy takes pixels from the mask, and leaves every rock whole.
pub(super) fn annotated_rocks(frame: &Frame) -> Vec<u32> {
    let mut reasons = vec![None; usize::from(u16::MAX) + 1];
    for rock in &frame.rocks {
        reasons[usize::from(rock.instance)] = Some(rock.reason);
    }
    let annotation = |(class, instance): (&u8, &u16)| match reasons[usize::from(*instance)] {
        Some(LabelReason::Rock) => u32::from(*instance),
        Some(_) => CROWD,
        // Mappings of earlier versions lack the rocks that are ignored.
        None if ClassId(*class) == ClassId::ROCK => u32::from(*instance),
        None => 0,
    };
    frame.class.iter().zip(&frame.instances).map(annotation).collect()
}

/// A region's bounds and size, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Region {
    /// Smallest and largest column and row: left, top, right, bottom, all inclusive.
    pub(super) bounds: [u32; 4],
    /// Number of pixels.
    pub(super) area: u64,
}

impl Region {
    /// Left, top, width, height, pixels.
    pub(super) fn bbox(&self) -> [f64; 4] {
        let [left, top, right, bottom] = self.bounds;
        [left, top, right - left + 1, bottom - top + 1].map(f64::from)
    }
}

/// The region of each id, in ascending order of id; id 0 is skipped.
pub(super) fn regions(frame: &Frame, id_at: impl Fn(usize) -> u32) -> BTreeMap<u32, Region> {
    let mut regions = BTreeMap::new();
    for pixel in 0..frame.class.len() {
        let id = id_at(pixel);
        if id > 0 {
            let (x, y) = (pixel as u32 % frame.width, pixel as u32 / frame.width);
            let region = regions.entry(id).or_insert(Region { bounds: [x, y, x, y], area: 0 });
            let [left, top, right, bottom] = region.bounds;
            region.bounds = [left.min(x), top.min(y), right.max(x), bottom.max(y)];
            region.area += 1;
        }
    }
    regions
}
