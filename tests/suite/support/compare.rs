//! Comparison of images with golden images, and the tolerances for it.

use std::path::{Path, PathBuf};

use image::{GrayImage, RgbImage};
use regolith::render::RasterBackend;

use super::renderer;

/// Smallest structural similarity (mean SSIM over the channels) of an image with its golden image.
const MIN_SSIM: f64 = 0.998;
/// Largest mean absolute difference, 8-bit values.
const MAX_MEAN_DIFFERENCE: f64 = 0.25;
/// Fraction of the mask's pixels that may differ where the device rasterises in render passes. Else no driver is known to flip one.
const MAX_DEVICE_MASK_DIFFERENCES: f64 = 1e-3;
/// Largest size of a golden file, bytes, as they are part of the repository.
const MAX_BYTES: u64 = 96 * 1024;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Path of a golden image.
pub(crate) fn golden(name: &str) -> PathBuf {
    root().join("tests/golden").join(name)
}

/// Whether references are written instead of compared.
pub(crate) fn updating() -> bool {
    std::env::var_os("REGOLITH_UPDATE_GOLDENS").is_some()
}

fn failed_folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("golden-failures");
    std::fs::create_dir_all(&folder).expect("a folder for failures");
    folder
}

fn open(path: &Path) -> image::DynamicImage {
    image::open(path).unwrap_or_else(|error| {
        panic!(
            "{}: {error}; REGOLITH_UPDATE_GOLDENS=1 writes golden images: look at them before you commit",
            path.display()
        )
    })
}

fn check_size(path: &Path) {
    let bytes = std::fs::metadata(path).expect("the golden").len();
    assert!(bytes <= MAX_BYTES, "{} has {bytes} bytes, {MAX_BYTES} are allowed", path.display());
}

/// Largest difference of 8-bit values that nobody sees: in a black sky, where SSIM has nothing else to compare, one step of
/// another driver's rounding lowers it.
const MAX_ROUNDING: u8 = 2;

/// Mean SSIM, mean and largest absolute difference of two images of equal size.
fn difference(expected: &RgbImage, actual: &RgbImage) -> (f64, f64, u8) {
    let algorithm = image_compare::Algorithm::MSSIMSimple;
    let similarity =
        image_compare::rgb_similarity_structure(&algorithm, expected, actual).expect("images of equal size");
    let sum: u64 = expected.iter().zip(actual.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    let largest = expected.iter().zip(actual.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    (similarity.score, sum as f64 / expected.len() as f64, largest.unwrap_or_default())
}

fn is_similar((ssim, mean, largest): (f64, f64, u8)) -> bool {
    mean <= MAX_MEAN_DIFFERENCE && (ssim >= MIN_SSIM || largest <= MAX_ROUNDING)
}

/// Compares an image with the golden image at `path`, by SSIM and mean difference.
pub(crate) fn assert_image(path: &Path, actual: &RgbImage, cap_size: bool) {
    if updating() {
        actual.save(path).expect("golden written");
    }
    let expected = open(path).into_rgb8();
    if cap_size {
        check_size(path);
    }
    assert_eq!(expected.dimensions(), actual.dimensions(), "{}", path.display());
    let found = difference(&expected, actual);
    if !is_similar(found) {
        let (ssim, mean, largest) = found;
        let saved = failed_folder().join(path.file_name().expect("a name"));
        actual.save(&saved).expect("failure written");
        panic!(
            "{} differs: SSIM {ssim:.5} (at least {MIN_SSIM}), mean difference {mean:.3} (at most \
             {MAX_MEAN_DIFFERENCE}), largest {largest}; the new image is {}",
            path.display(),
            saved.display()
        );
    }
}

/// Compares a mask with the golden mask of this name, pixel by pixel.
pub(crate) fn assert_mask(name: &str, actual: &GrayImage) {
    let path = golden(name);
    if updating() {
        actual.save(&path).expect("golden written");
    }
    let expected = open(&path).into_luma8();
    check_size(&path);
    assert_eq!(expected.dimensions(), actual.dimensions(), "{name}");
    let different = expected.iter().zip(actual.iter()).filter(|(a, b)| a != b).count();
    let is_exact = renderer().raster().visibility != RasterBackend::Device;
    let allowed = if is_exact { 0.0 } else { MAX_DEVICE_MASK_DIFFERENCES * expected.len() as f64 };
    if different as f64 > allowed {
        let saved = failed_folder().join(name);
        actual.save(&saved).expect("failure written");
        panic!("{different} pixels of {name} differ; the new mask is {}", saved.display());
    }
}

#[test]
fn the_comparison_can_fail() {
    let original = RgbImage::from_fn(64, 64, |x, y| image::Rgb([(3 * x + y) as u8, (x * y % 200) as u8, 90]));
    let same = difference(&original, &original);
    assert!(is_similar(same) && same.1 == 0.0);
    let mut brighter = original.clone();
    brighter.iter_mut().for_each(|value| *value = value.saturating_add(1));
    let found = difference(&original, &brighter);
    assert!(!is_similar(found), "one step of 255 over the whole image passes: {found:?}");
    let mut spotted = original.clone();
    (20..28).for_each(|x| (20..28).for_each(|y| spotted.put_pixel(x, y, image::Rgb([255, 0, 0]))));
    let found = difference(&original, &spotted);
    assert!(!is_similar(found), "a spot of 8 x 8 pixels passes: {found:?}");
}
