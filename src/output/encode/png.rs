//! PNG files.
//!
//! Photographs use adaptive row filters; label maps use the "up" filter, which suits large areas of one value.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};

use super::{EncodeInput, values};
use crate::error::{Error, Result};
use crate::frame::Frame;

/// The image, 8-bit sRGB.
pub(in crate::output) fn rgb(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    let frame = input.frame;
    encode([frame.width, frame.height], &frame.rgb, ExtendedColorType::Rgb8, FilterType::Adaptive)
}

/// The semantic mask, 8-bit ids.
pub(in crate::output) fn mask(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    ids_of(input.frame, &values::mask(input))
}

/// The mask in the preview colours of its classes; unlabelled pixels are black.
pub(in crate::output) fn preview(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    colours_of(input.frame, &values::preview(input))
}

/// Instance ids, 16 bits a pixel.
pub(in crate::output) fn instances(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    ids_u16(input.frame.width, input.frame.height, &input.frame.instances)
}

/// Craters: 1 inside, 2 on the rim.
pub(in crate::output) fn craters(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    ids_of(input.frame, &input.frame.craters)
}

/// Fraction of the sun's disc that is hidden: 0 lit, 255 fully occluded.
pub(in crate::output) fn shadow(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    ids_of(input.frame, &input.frame.sun_occlusion)
}

/// The mask with craters and mountains as classes of their own.
pub(in crate::output) fn five_classes(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    ids_of(input.frame, &values::five_classes(input))
}

/// The same in colours.
pub(in crate::output) fn five_classes_preview(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    colours_of(input.frame, &values::five_classes_preview(input))
}

/// The mask in colours, with small and large rocks distinguished.
pub(in crate::output) fn rock_sizes(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    colours_of(input.frame, &values::rock_sizes(input))
}

fn ids_of(frame: &Frame, ids: &[u8]) -> Result<Vec<u8>> {
    ids_u8(frame.width, frame.height, ids)
}

fn colours_of(frame: &Frame, rgb: &[u8]) -> Result<Vec<u8>> {
    label_colours(frame.width, frame.height, rgb)
}

/// A label map, one byte a pixel.
pub(crate) fn ids_u8(width: u32, height: u32, ids: &[u8]) -> Result<Vec<u8>> {
    encode([width, height], ids, ExtendedColorType::L8, FilterType::Up)
}

/// A label map, two bytes a pixel.
pub(crate) fn ids_u16(width: u32, height: u32, ids: &[u16]) -> Result<Vec<u8>> {
    encode([width, height], bytemuck::cast_slice(ids), ExtendedColorType::L16, FilterType::Up)
}

/// A label map in colours, three bytes a pixel.
pub(crate) fn label_colours(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>> {
    encode([width, height], rgb, ExtendedColorType::Rgb8, FilterType::Up)
}

fn encode(
    [width, height]: [u32; 2],
    bytes: &[u8],
    colour_type: ExtendedColorType,
    filter: FilterType,
) -> Result<Vec<u8>> {
    let mut encoded = Vec::new();
    PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, filter)
        .write_image(bytes, width, height, colour_type)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    Ok(encoded)
}
