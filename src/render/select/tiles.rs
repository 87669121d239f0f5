//! The tiles of an image whose G-buffer would be too large: rectangles that are visible, lit and resolved one after the other.
//!
//! All tiles of an image have the same size, so that they share textures: the last of a row or column overlaps the one before it.
//! Must not know: a device.

use crate::scene::camera::Camera;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRect {
    /// Column and row of its first pixel.
    pub origin: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

impl PixelRect {
    /// All of an image of this size.
    pub const fn whole(size: [u32; 2]) -> Self {
        Self { origin: [0, 0], size }
    }

    /// The same rectangle of samples.
    pub fn samples(self, samples_per_side: u32) -> Self {
        let scaled = |pixels: [u32; 2]| pixels.map(|side| side * samples_per_side);
        Self { origin: scaled(self.origin), size: scaled(self.size) }
    }
}

/// A tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageTile {
    /// Its pixels in the image.
    pub image: PixelRect,
    /// The pixels that its samples are taken from: of the image before distortion, if a lens distorts it, else the same.
    pub rendered: PixelRect,
}

/// The image that is divided.
#[derive(Clone, Copy, Debug)]
pub struct DividedImage<'a> {
    /// Columns and rows of the image.
    pub size: [u32; 2],
    /// Columns and rows of the image before distortion; the same without a lens.
    pub rendered_size: [u32; 2],
    /// Camera of the image before distortion.
    pub camera: &'a Camera,
}

/// Pixels beside those that the mapping of the lens names: the neighbours that the resolve pass reads, and rounding.
const MARGIN_PX: u32 = 3;
/// Pixels between the points of a tile's outline that are mapped. The outline bends by far less than a pixel between them.
const OUTLINE_STEP_PX: usize = 16;

/// Divides an image into tiles that `fits` accepts: as few columns as possible, for the host rasterises whole rows, then as few rows.
/// One tile if it accepts the whole image, `None` if it does not even accept tiles of one pixel. `fits` takes a tile of the size of
/// all others.
pub fn divide(image: &DividedImage<'_>, fits: impl Fn(ImageTile) -> bool) -> Option<Vec<ImageTile>> {
    let tiles_that_fit = |divisions: [u32; 2]| {
        // The mapping of a lens is expensive: a tile that is too large without it is refused first.
        let size = image.tile_size(divisions);
        let unmapped = PixelRect { origin: [0, 0], size };
        let may_fit = fits(ImageTile { image: unmapped, rendered: unmapped });
        may_fit.then(|| image.tiles(divisions)).filter(|tiles| fits(tiles[0]))
    };
    let [width, height] = image.size;
    for columns in 1..=width {
        let (mut too_few, mut rows) = (0, 1);
        let Some(mut tiles) =
            std::iter::successors(Some(1), |rows| (*rows < height).then(|| height.min(2 * rows))).find_map(
                |tried| {
                    (too_few, rows) = (if tried == 1 { 0 } else { rows }, tried);
                    tiles_that_fit([columns, tried])
                },
            )
        else {
            continue;
        };
        while rows - too_few > 1 {
            let middle = too_few.midpoint(rows);
            match tiles_that_fit([columns, middle]) {
                Some(fewer) => (tiles, rows) = (fewer, middle),
                None => too_few = middle,
            }
        }
        return Some(tiles);
    }
    None
}

impl DividedImage<'_> {
    fn tile_size(&self, divisions: [u32; 2]) -> [u32; 2] {
        [0, 1].map(|axis: usize| self.size[axis].div_ceil(divisions[axis]))
    }

    /// At most this many columns and rows of tiles.
    fn tiles(&self, divisions: [u32; 2]) -> Vec<ImageTile> {
        let size = self.tile_size(divisions);
        let origins = |axis: usize| {
            let last = self.size[axis] - size[axis];
            (0..self.size[axis].div_ceil(size[axis])).map(move |tile| last.min(tile * size[axis]))
        };
        let origins = origins(1).flat_map(|row| origins(0).map(move |column| [column, row]));
        let images: Vec<PixelRect> = origins.map(|origin| PixelRect { origin, size }).collect();
        let rendered: Vec<PixelRect> = images.iter().map(|rect| self.rendered(*rect)).collect();
        let largest = |axis: usize| rendered.iter().map(|rect| rect.size[axis]).max().unwrap_or(1);
        let rendered_size = [largest(0), largest(1)];
        let rendered = rendered.into_iter().map(|rect| PixelRect {
            origin: [0, 1].map(|axis| rect.origin[axis].min(self.rendered_size[axis] - rendered_size[axis])),
            size: rendered_size,
        });
        images.into_iter().zip(rendered).map(|(image, rendered)| ImageTile { image, rendered }).collect()
    }

    /// The pixels that the samples of a rectangle are taken from.
    fn rendered(&self, rect: PixelRect) -> PixelRect {
        if self.size == self.rendered_size {
            return rect;
        }
        // The mapping is continuous and has an inverse: what lies inside the outline is mapped to the inside of its image.
        let [width, height] = rect.size;
        let along = |length: u32| (0..length).step_by(OUTLINE_STEP_PX).chain([length]);
        let sides = along(width).flat_map(|x| [[x, 0], [x, height]]);
        let outline = sides.chain(along(height).flat_map(|y| [[0, y], [width, y]]));
        let points = outline.map(|[x, y]| self.undistorted([rect.origin[0] + x, rect.origin[1] + y]));
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points {
            low = [0, 1].map(|axis| low[axis].min(point[axis]));
            high = [0, 1].map(|axis| high[axis].max(point[axis]));
        }
        let origin = low.map(|least| (least.floor().max(0.0) as u32).saturating_sub(MARGIN_PX));
        let end = [0, 1]
            .map(|axis: usize| (high[axis].ceil().max(0.0) as u32 + MARGIN_PX).min(self.rendered_size[axis]));
        let origin = [0, 1].map(|axis: usize| origin[axis].min(end[axis] - 1));
        PixelRect { origin, size: [0, 1].map(|axis: usize| end[axis] - origin[axis]) }
    }

    /// Where the corner of a pixel of the image lies in the image before distortion, pixels.
    fn undistorted(&self, corner: [u32; 2]) -> [f64; 2] {
        let focal = self.camera.focal_px(self.rendered_size[0]);
        let point =
            [0, 1].map(|axis: usize| (f64::from(corner[axis]) - 0.5 * f64::from(self.size[axis])) / focal);
        let point = self.camera.lens.undistort(point);
        [0, 1].map(|axis: usize| point[axis] * focal + 0.5 * f64::from(self.rendered_size[axis]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Lens;
    use glam::Vec3;

    fn camera(lens: Lens) -> Camera {
        Camera { lens, ..Camera::new(Vec3::ZERO, [0.0; 3], 60.0, 2000.0, 0.0) }
    }

    #[test]
    fn tiles_cover_the_image_and_have_one_size() {
        let camera = camera(Lens::default());
        for (size, side, tiles_expected) in [
            ([100, 70], 200, 1),
            ([100, 70], 40, 6),
            ([9, 500], 64, 8),
            ([7, 5], 1, 35),
            ([1, 1], 1, 1),
            ([50, 7], 3, 51),
        ] {
            let image = DividedImage { size, rendered_size: size, camera: &camera };
            let fits = |tile: ImageTile| tile.rendered.size.iter().all(|length| *length <= side);
            let tiles = divide(&image, fits).expect("tiles");
            assert_eq!(tiles.len(), tiles_expected, "{size:?} by {side}");
            let mut covered = vec![false; (size[0] * size[1]) as usize];
            for tile in &tiles {
                assert!(fits(*tile) && tile.image.size == tiles[0].image.size && tile.rendered == tile.image);
                let PixelRect { origin: [x, y], size: [width, height] } = tile.image;
                for row in y..y + height {
                    covered[(row * size[0] + x) as usize..(row * size[0] + x + width) as usize].fill(true);
                }
            }
            assert!(covered.iter().all(|covered| *covered), "{size:?} by {side}");
        }
        let image = DividedImage { size: [4, 4], rendered_size: [4, 4], camera: &camera };
        assert!(divide(&image, |_| false).is_none());
    }

    #[test]
    fn a_lens_takes_samples_from_within_the_rendered_part_of_a_tile() {
        for lens in [Lens { k1: -0.2, p1: 0.01, ..Lens::default() }, Lens { k1: 0.15, ..Lens::default() }] {
            let size = [120, 90];
            let (camera, rendered_size) = camera(lens).widened(size).expect("a lens");
            let image = DividedImage { size, rendered_size, camera: &camera };
            let tiles =
                divide(&image, |tile| tile.image.size[0] <= 40 && tile.image.size[1] <= 30).expect("tiles");
            assert_eq!(tiles.len(), 9);
            for ImageTile { image: tile, rendered } in tiles {
                for (axis, end) in rendered_size.into_iter().enumerate() {
                    assert!(rendered.origin[axis] + rendered.size[axis] <= end, "{rendered:?}");
                }
                for row in 0..=tile.size[1] {
                    for column in 0..=tile.size[0] {
                        let [x, y] = image.undistorted([tile.origin[0] + column, tile.origin[1] + row]);
                        for (axis, at) in [x, y].into_iter().enumerate() {
                            // With a neighbour on each side, but at the border of the image.
                            let at = at.clamp(1.0, f64::from(rendered_size[axis]) - 1.0);
                            let first = f64::from(rendered.origin[axis]);
                            let end = f64::from(rendered.origin[axis] + rendered.size[axis]);
                            assert!(at >= first + 1.0 && at <= end - 1.0, "{at} of {rendered:?}");
                        }
                    }
                }
            }
        }
    }
}
