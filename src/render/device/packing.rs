//! Layout of the packed frame: what the resolve pass writes and the readback unpacks.
//! Must not know: a pass.

use std::ops::Range;

use crate::frame::Annotations;
use crate::frame::plane::Plane;
use crate::render::device::planes::{MAX_PACKED_PLANES, packed_planes};

/// Invocations in a workgroup of the resolve pass, each of four pixels; `resolve.wgsl` has the same constants.
pub(crate) const WORKGROUP_SIZE: u32 = 64;

/// Where each plane of a frame lies in the packed result.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packing {
    pixels: u64,
    annotations: Annotations,
}

/// Offset of a plane that is not requested; `common/frame.wgsl` has the same constant.
pub(crate) const NOT_REQUESTED: u32 = u32::MAX;

impl Packing {
    /// Packing of an image of this size with these annotations.
    #[must_use]
    pub(crate) fn new([width, height]: [u32; 2], annotations: Annotations) -> Self {
        Self { pixels: u64::from(width) * u64::from(height), annotations }
    }

    /// Runs of four pixels, each packed into three words of colour and one of classes.
    #[must_use]
    pub(crate) fn quads(self) -> u64 {
        self.pixels.div_ceil(4)
    }

    /// Annotations that are packed.
    #[must_use]
    pub(crate) const fn annotations(self) -> Annotations {
        self.annotations
    }

    /// The planes that are packed behind the quads, with the range of their words.
    pub(crate) fn planes(self) -> impl Iterator<Item = (Plane, Range<u64>)> {
        let mut end = 4 * self.quads();
        packed_planes().filter(move |(plane, _)| plane.is_in(self.annotations)).map(move |(plane, words)| {
            let start = end;
            end += words.len() as u64 * self.pixels;
            (plane, start..end)
        })
    }

    /// First word of each of [`packed_planes`], or [`NOT_REQUESTED`]: `plane_offsets` of the frame's uniforms.
    #[must_use]
    pub(crate) fn offsets(self) -> [[u32; 4]; MAX_PACKED_PLANES / 4] {
        let mut offsets = [[NOT_REQUESTED; 4]; MAX_PACKED_PLANES / 4];
        for (offset, (plane, _)) in offsets.as_flattened_mut().iter_mut().zip(packed_planes()) {
            if let Some((_, words)) = self.planes().find(|(packed, _)| *packed == plane) {
                *offset = words.start as u32;
            }
        }
        offsets
    }

    /// Size of the packed frame, bytes.
    #[must_use]
    pub(crate) fn bytes(self) -> u64 {
        4 * self.planes().last().map_or(4 * self.quads(), |(_, words)| words.end)
    }
}
