//! Layout of the packed frame: what the resolve pass writes and the readback unpacks.
//! Must not know: a pass.

use crate::frame::{Annotation, Annotations};

/// Invocations in a workgroup of the resolve pass, each of four pixels; `resolve.wgsl` has the same constants.
pub const WORKGROUP_SIZE: u32 = 64;

/// Where each plane of a frame lies in the packed result.
#[derive(Clone, Copy, Debug)]
pub struct Packing {
    pixels: u64,
    annotations: Annotations,
}

/// Offset of an annotation that is not rendered; `common/frame.wgsl` has the same constant.
pub const NOT_ASKED: u32 = u32::MAX;

/// Annotations in the order in which they are packed, with their words per pixel.
const PACKED: [(Annotation, u64); 6] = [
    (Annotation::Depth, 1),
    (Annotation::Normals, 3),
    (Annotation::Instances, 1),
    (Annotation::Shadow, 1),
    (Annotation::Hdr, 2),
    (Annotation::Coverage, 1),
];

impl Packing {
    /// Packing of an image of this size with these annotations.
    #[must_use]
    pub fn new([width, height]: [u32; 2], annotations: Annotations) -> Self {
        Self { pixels: u64::from(width) * u64::from(height), annotations }
    }

    /// Runs of four pixels, each packed into three words of colour and one of classes.
    #[must_use]
    pub fn quads(self) -> u64 {
        self.pixels.div_ceil(4)
    }

    /// Annotations that are packed.
    #[must_use]
    pub const fn annotations(self) -> Annotations {
        self.annotations
    }

    /// Range of the words of an annotation, `None` if it is not rendered.
    #[must_use]
    pub fn words(self, wanted: Annotation) -> Option<std::ops::Range<u64>> {
        let mut start = 4 * self.quads();
        for (annotation, words) in PACKED {
            let end = start + if self.annotations.contains(annotation) { words * self.pixels } else { 0 };
            if annotation == wanted {
                return (end > start).then_some(start..end);
            }
            start = end;
        }
        None
    }

    /// First word of an annotation, or [`NOT_ASKED`].
    #[must_use]
    pub fn start(self, annotation: Annotation) -> u32 {
        self.words(annotation).map_or(NOT_ASKED, |words| words.start as u32)
    }

    /// Size of the packed frame, bytes.
    #[must_use]
    pub fn bytes(self) -> u64 {
        let annotated = PACKED.iter().filter(|(annotation, _)| self.annotations.contains(*annotation));
        16 * self.quads() + annotated.map(|(_, words)| 4 * words * self.pixels).sum::<u64>()
    }
}
