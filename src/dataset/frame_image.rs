//! The images of a dataset, decoded again.
//!
//! Must not know: how frames are made.

use std::path::Path;

use image::{DynamicImage, ImageFormat};

use crate::error::{Error, Result};
use crate::output::dataset_path;

/// Decodes a PNG file of a frame, which must have the size of the dataset's images.
///
/// # Errors
/// [`Error::CheckFailed`].
pub(super) fn decode(path: &Path, bytes: &[u8], size: [u32; 2]) -> Result<DynamicImage> {
    let refused = |why: String| {
        Error::CheckFailed(format!(
            "{}: it cannot be decoded ({why}); delete it and run the dataset's command, which makes it again",
            path.display()
        ))
    };
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), ImageFormat::Png);
    let [width, height] = size;
    let mut limits = image::Limits::default();
    // Before anything is allocated; a larger image is refused, and a smaller one below.
    (limits.max_image_width, limits.max_image_height) = (Some(width), Some(height));
    limits.max_alloc = Some(dataset_path::max_frame_file_bytes(size));
    reader.limits(limits);
    let image = reader.decode().map_err(|error| refused(error.to_string()))?;
    if [image.width(), image.height()] != size {
        let found =
            format!("it has {} x {} pixels instead of {width} x {height}", image.width(), image.height());
        return Err(refused(found));
    }
    Ok(image)
}

/// Reads and decodes the PNG file at `path` below a dataset's folder.
///
/// # Errors
/// [`Error::Read`], and those of [`decode`].
pub(super) fn decode_image(folder: &Path, path: &str, size: [u32; 2]) -> Result<DynamicImage> {
    let bytes = dataset_path::read(folder, path, dataset_path::max_frame_file_bytes(size))?;
    decode(&folder.join(path), &bytes, size)
}
