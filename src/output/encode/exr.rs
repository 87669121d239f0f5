//! OpenEXR files.

use exr::prelude::{Encoding, SpecificChannels, WritableImage as _};

use super::EncodeInput;
use crate::error::{Error, Result};

/// Linear scene radiance as half-float RGB, losslessly compressed.
pub(in crate::output) fn radiance(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    let frame = input.frame;
    let size = (frame.width as usize, frame.height as usize);
    let pixel = |at: exr::math::Vec2<usize>| {
        let first = 3 * (at.y() * size.0 + at.x());
        (frame.radiance[first], frame.radiance[first + 1], frame.radiance[first + 2])
    };
    let layer = exr::image::Layer::new(
        size,
        exr::meta::header::LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        SpecificChannels::rgb(pixel),
    );
    let mut bytes = std::io::Cursor::new(Vec::new());
    exr::image::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| Error::Encode { name: String::new(), message: error.to_string() })?;
    Ok(bytes.into_inner())
}
