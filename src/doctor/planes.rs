//! The planes of a frame that are compared, as bytes that one process can pass to another, and their hashes.
//!
//! Must not know: what is right.

use serde::{Deserialize, Serialize};

use crate::frame::Frame;
use crate::output::disk::content_hash;

/// Bytes of a pixel in [`Planes::to_bytes`].
const PIXEL_BYTES: usize = 3 + 1 + 2 + 4;

/// Colour and labels of a frame, rows from top to bottom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// 8-bit sRGB, three values per pixel.
    pub rgb: Vec<u8>,
    /// Class ids.
    pub mask: Vec<u8>,
    /// Instance ids of rocks; 0 where there is none.
    pub instances: Vec<u16>,
    /// Depth along the optical axis, metres; infinite for the sky.
    pub depth_m: Vec<f32>,
}

/// Hashes of planes (XXH3, 128 bits, of little-endian values).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hashes {
    /// Of the class ids.
    pub mask: String,
    /// Of the instance ids.
    pub instances: String,
    /// Of the depth.
    pub depth: String,
    /// Of the colour.
    pub rgb: String,
}

impl From<Frame> for Planes {
    fn from(frame: Frame) -> Self {
        Self {
            size: [frame.width, frame.height],
            rgb: frame.rgb,
            mask: frame.class,
            instances: frame.instances,
            depth_m: frame.depth_m,
        }
    }
}

impl Planes {
    /// All planes, one after the other.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let ids = self.instances.iter().flat_map(|id| id.to_le_bytes());
        let depth = self.depth_m.iter().flat_map(|depth| depth.to_le_bytes());
        self.rgb.iter().chain(&self.mask).copied().chain(ids).chain(depth).collect()
    }

    /// Planes of this size from the bytes of [`Self::to_bytes`]; `None` if their number is another.
    #[must_use]
    pub fn from_bytes(size: [u32; 2], bytes: &[u8]) -> Option<Self> {
        let pixels = size[0] as usize * size[1] as usize;
        if bytes.len() != pixels * PIXEL_BYTES {
            return None;
        }
        let (rgb, bytes) = bytes.split_at(3 * pixels);
        let (mask, bytes) = bytes.split_at(pixels);
        let (ids, depth) = bytes.split_at(2 * pixels);
        Some(Self {
            size,
            rgb: rgb.to_vec(),
            mask: mask.to_vec(),
            instances: ids.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect(),
            depth_m: depth.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        })
    }

    /// The hash of each plane.
    #[must_use]
    pub fn hashes(&self) -> Hashes {
        let ids: Vec<u8> = self.instances.iter().flat_map(|id| id.to_le_bytes()).collect();
        let depth: Vec<u8> = self.depth_m.iter().flat_map(|depth| depth.to_le_bytes()).collect();
        Hashes {
            mask: content_hash(&self.mask),
            instances: content_hash(&ids),
            depth: content_hash(&depth),
            rgb: content_hash(&self.rgb),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_survive_as_bytes() {
        let planes = Planes {
            size: [2, 1],
            rgb: vec![1, 2, 3, 4, 5, 6],
            mask: vec![2, 1],
            instances: vec![0, 300],
            depth_m: vec![f32::INFINITY, 1.5],
        };
        let bytes = planes.to_bytes();
        assert_eq!(Planes::from_bytes([2, 1], &bytes), Some(planes.clone()));
        assert_eq!(Planes::from_bytes([1, 1], &bytes), None);
        let other = Planes { instances: vec![0, 301], ..planes.clone() };
        assert_ne!(other.hashes().instances, planes.hashes().instances);
        assert_eq!(other.hashes().mask, planes.hashes().mask);
    }
}
