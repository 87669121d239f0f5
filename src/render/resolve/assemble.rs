//! Tiles of an image, put together.
//! Must not know: a device.

use crate::frame::Frame;

/// Copies the planes of a tile into those of the image; `origin` is the column and row of its first pixel there. Planes that the
/// image does not have yet are added.
pub(crate) fn place(image: &mut Frame, tile: &Frame, origin: [u32; 2]) {
    let [left, top] = origin.map(|pixels| pixels as usize);
    let place = Placement { width: image.width as usize, height: image.height as usize, left, top };
    let columns = tile.width as usize;
    place.copy(&mut image.rgb, &tile.rgb, 3 * columns, 3);
    place.copy(&mut image.class, &tile.class, columns, 1);
    place.copy(&mut image.depth_m, &tile.depth_m, columns, 1);
    place.copy(&mut image.normals, &tile.normals, 3 * columns, 3);
    place.copy(&mut image.instances, &tile.instances, columns, 1);
    place.copy(&mut image.sun_occlusion, &tile.sun_occlusion, columns, 1);
    place.copy(&mut image.radiance, &tile.radiance, 3 * columns, 3);
    place.copy(&mut image.sample_counts, &tile.sample_counts, columns, 1);
}

/// Where in the image a tile lies, pixels.
struct Placement {
    width: usize,
    height: usize,
    left: usize,
    top: usize,
}

impl Placement {
    /// Copies a plane with rows of `row_len` values, this many to a pixel.
    fn copy<T: Copy + Default>(&self, image: &mut Vec<T>, tile: &[T], row_len: usize, per_pixel: usize) {
        if tile.is_empty() {
            return;
        }
        let image_row_len = self.width * per_pixel;
        image.resize(image_row_len * self.height, T::default());
        let rows = image.chunks_exact_mut(image_row_len).skip(self.top);
        for (row, values) in rows.zip(tile.chunks_exact(row_len)) {
            row[self.left * per_pixel..][..row_len].copy_from_slice(values);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_that_overlap_make_the_image() {
        let value = |column: u32, row: u32| (10 * row + column) as u8;
        let part = |[left, top]: [u32; 2], [width, height]: [u32; 2]| {
            let pixels =
                (top..top + height).flat_map(|row| (left..left + width).map(move |column| (column, row)));
            let class: Vec<u8> = pixels.map(|(column, row)| value(column, row)).collect();
            let rgb = class.iter().flat_map(|id| [*id, *id + 1, *id + 2]).collect();
            Frame { width, height, class, rgb, ..Frame::default() }
        };
        let whole = part([0, 0], [5, 4]);
        let mut image = Frame { width: 5, height: 4, ..Frame::default() };
        for origin in [[0, 0], [2, 0], [0, 2], [2, 2], [0, 1], [2, 1]] {
            place(&mut image, &part(origin, [3, 2]), origin);
        }
        assert!(image == whole && image.depth_m.is_empty());
    }
}
