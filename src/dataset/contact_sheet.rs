//! The contact sheet of a finished dataset: its first frames, each image beside its mask.
//!
//! Must not know: how frames are made.

use std::path::Path;

use image::imageops::{self, FilterType};
use image::{ImageFormat, Rgb, RgbImage};

use super::frame_image::decode_image;
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::output::layout::{FrameLines, Layout};
use crate::output::{Artifact, LabelIds};

/// Its file name.
pub(super) const CONTACT_SHEET_FILE: &str = "contact_sheet.png";

/// Frames on the sheet.
const FRAMES: usize = 12;
/// Frames in a row.
const COLUMNS: u32 = 3;
/// Width of an image or a mask on the sheet, pixels.
const IMAGE_PX: u32 = 192;
/// Maximum height of an image or a mask on the sheet, pixels: one more than four times as tall as wide is narrower than others.
const MAX_HEIGHT_PX: u32 = 4 * IMAGE_PX;
/// Gap between frames, pixels.
const GAP_PX: u32 = 8;

/// The sheet as [`CONTACT_SHEET_FILE`]; `None` if the layout does not store images and masks as files.
///
/// # Errors
/// [`Error::Read`], [`Error::CheckFailed`] for a file that cannot be decoded, [`Error::Encode`].
pub(super) fn png(
    folder: &Path,
    lines: &dyn FrameLines,
    layout: &dyn Layout,
    size: [u32; 2],
) -> Result<Option<Artifact>> {
    let mut first = Vec::new();
    lines.for_each(&mut |line| {
        if first.len() < FRAMES {
            first.extend(layout.image_and_mask(&line.split, line.index));
        }
        Ok(())
    })?;
    if first.is_empty() {
        return Ok(None);
    }
    let tiles = first.iter().map(|paths| tile(folder, size, paths)).collect::<Result<Vec<_>>>()?;
    let mut bytes = std::io::Cursor::new(Vec::new());
    sheet(&tiles)
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|error| Error::Encode { name: CONTACT_SHEET_FILE.to_owned(), message: error.to_string() })?;
    Ok(Some(Artifact { name: CONTACT_SHEET_FILE.to_owned(), bytes: bytes.into_inner() }))
}

/// A frame's image and coloured mask, scaled.
fn tile(folder: &Path, size: [u32; 2], [image, mask]: &[String; 2]) -> Result<[RgbImage; 2]> {
    let image = decode_image(folder, image, size)?.into_rgb8();
    let [width, height] = tile_size(image.dimensions());
    let mask = mask_colours(&decode_image(folder, mask, size)?.into_luma8());
    Ok([
        imageops::resize(&image, width, height, FilterType::Triangle),
        imageops::resize(&mask, width, height, FilterType::Nearest),
    ])
}

/// Width and height, pixels, of an image of this size on the sheet.
fn tile_size((width, height): (u32, u32)) -> [u32; 2] {
    let scaled =
        |side: u32, by: u32, over: u32| (u64::from(side) * u64::from(by) / u64::from(over)).max(1) as u32;
    let tile_height = scaled(height, IMAGE_PX, width);
    if tile_height <= MAX_HEIGHT_PX {
        [IMAGE_PX, tile_height]
    } else {
        [scaled(width, MAX_HEIGHT_PX, height), MAX_HEIGHT_PX]
    }
}

/// Tiles in rows on white.
fn sheet(tiles: &[[RgbImage; 2]]) -> RgbImage {
    let (tile_width, tile_height) = (2 * IMAGE_PX + GAP_PX, tiles[0][0].height() + GAP_PX);
    let count = tiles.len() as u32;
    let (columns, rows) = (COLUMNS.min(count), count.div_ceil(COLUMNS));
    let mut sheet =
        RgbImage::from_pixel(columns * tile_width + GAP_PX, rows * tile_height + GAP_PX, Rgb([255; 3]));
    for (i, [image, mask]) in (0..).zip(tiles) {
        let x = i64::from(i % COLUMNS * tile_width + GAP_PX);
        let y = i64::from(i / COLUMNS * tile_height + GAP_PX);
        imageops::replace(&mut sheet, image, x, y);
        imageops::replace(&mut sheet, mask, x + i64::from(IMAGE_PX), y);
    }
    sheet
}

/// A mask in the preview colours of its classes. Ids 3 and 4 occur in Replicator's numbering only.
fn mask_colours(mask: &image::GrayImage) -> RgbImage {
    let is_replicator = mask.pixels().any(|pixel| matches!(pixel.0[0], 3 | 4));
    let label_ids = if is_replicator { LabelIds::Replicator } else { LabelIds::Canonical };
    let colour = |id: u8| {
        let class = ClassId::ALL.iter().find(|class| label_ids.mask_id(class.id.0) == id);
        class.map_or([0; 3], |class| class.preview_rgb)
    };
    RgbImage::from_fn(mask.width(), mask.height(), |x, y| Rgb(colour(mask.get_pixel(x, y).0[0])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_keep_their_aspect_and_have_a_maximum_height() {
        assert_eq!(tile_size((512, 512)), [192, 192]);
        assert_eq!(tile_size((640, 480)), [192, 144]);
        assert_eq!(tile_size((100, 400)), [192, 768]);
        assert_eq!(tile_size((64, 512)), [96, 768]);
        assert_eq!(tile_size((1, 8192)), [1, 768]);
        assert_eq!(tile_size((8192, 1)), [192, 1]);
    }
}
