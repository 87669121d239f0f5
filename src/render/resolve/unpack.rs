//! The planes of a frame, from the words that the resolve pass packed.
//! Must not know: a device.

use crate::class::ClassId;
use crate::frame::Frame;
use crate::frame::plane::Plane;
use crate::render::device::packing::Packing;
use crate::render::resolve::tile_list::TileList;

/// The frame of this size that `bytes` packs. The tiles that were not resolved take the values of the one that stands for them.
#[must_use]
pub(super) fn unpack(bytes: &[u8], [width, height]: [u32; 2], packing: Packing, tiles: &TileList) -> Frame {
    let pixels = width as usize * height as usize;
    let first_class = 12 * packing.quads() as usize;
    let mut frame = Frame {
        width,
        height,
        rgb: bytes[..3 * pixels].to_vec(),
        class: bytes[first_class..first_class + pixels].to_vec(),
        ..Frame::default()
    };
    tiles.spread(&mut frame.rgb, 3);
    tiles.spread(&mut frame.class, 1);
    for (plane, range) in packing.planes() {
        let words = bytes[4 * range.start as usize..4 * range.end as usize].chunks_exact(4);
        let words = words.map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
        unpack_plane(&mut frame, plane, words, tiles);
    }
    frame
}

/// The reverse of the `words` of the plane's rule (`render/device/planes.rs`).
fn unpack_plane(frame: &mut Frame, plane: Plane, mut words: impl Iterator<Item = u32>, tiles: &TileList) {
    let half = |bits: u32| half::f16::from_bits(bits as u16);
    match plane {
        Plane::Depth => {
            let depth = |(word, class): (u32, &u8)| {
                if *class == ClassId::SKY.0 { f32::INFINITY } else { f32::from_bits(word) }
            };
            frame.depth_m = spread(words.zip(&frame.class).map(depth).collect(), 1, tiles);
        }
        Plane::Normals => frame.normals = spread(words.map(f32::from_bits).collect(), 3, tiles),
        Plane::Instances => frame.instances = spread(words.map(|word| word as u16).collect(), 1, tiles),
        Plane::SunOcclusion => frame.sun_occlusion = spread(words.map(|word| word as u8).collect(), 1, tiles),
        Plane::Radiance => {
            // Red and green share a word, blue has one with an empty half.
            let mut halves = Vec::with_capacity(3 * frame.class.len());
            while let (Some(red_green), Some(blue)) = (words.next(), words.next()) {
                halves.extend([half(red_green), half(red_green >> 16), half(blue)]);
            }
            frame.radiance = spread(halves, 3, tiles);
        }
        Plane::SampleCounts => {
            let counts = words.map(|word| [word as u8, (word >> 8) as u8, (word >> 16) as u8]);
            frame.sample_counts = spread(counts.collect(), 1, tiles);
        }
        Plane::Rgb | Plane::Class => unreachable!("packed for quads, not by plane"),
        Plane::Slope | Plane::Craters | Plane::Incidence | Plane::Phase | Plane::FiveClasses => {
            unreachable!("computed on the host, never packed")
        }
    }
}

fn spread<T: Copy>(mut values: Vec<T>, values_per_pixel: usize, tiles: &TileList) -> Vec<T> {
    tiles.spread(&mut values, values_per_pixel);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::plane::{PLANES, every_annotation};

    #[test]
    fn every_requested_plane_that_is_packed_has_its_values_per_pixel() {
        let annotations = every_annotation();
        let size = [7, 3];
        let packing = Packing::new(size, annotations);
        let bytes = vec![0; packing.bytes() as usize];
        let frame = unpack(&bytes, size, packing, &TileList::new(size, None));
        let packed: Vec<Plane> = packing.planes().map(|(plane, _)| plane).collect();
        assert_eq!(packed.len(), 6);
        for row in &PLANES {
            let is_unpacked = packed.contains(&row.plane) || row.annotation.is_none();
            let expected = if is_unpacked { 21 * row.channels } else { 0 };
            assert_eq!(frame.plane(row.plane).len(), expected, "{}", row.name);
        }
    }
}
