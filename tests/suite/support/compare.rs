//! Pictures against golden ones. Every tolerance of the suite stands here.

use std::path::{Path, PathBuf};

use image::{GrayImage, RgbImage};

/// Least structural similarity (mean SSIM over the channels) of a picture with its golden.
const LEAST_SSIM: f64 = 0.998;
/// Largest mean absolute difference, 8-bit values.
const MOST_MEAN_DIFFERENCE: f64 = 0.25;
/// Pixels of a mask that may differ. Other CPUs have not yet been seen to flip one.
const MOST_MASK_DIFFERENCES: usize = 0;
/// Largest golden file, bytes: they live in the repository.
const MOST_BYTES: u64 = 96 * 1024;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Where a golden picture lies.
pub(crate) fn golden(name: &str) -> PathBuf {
    root().join("tests/golden").join(name)
}

fn updating() -> bool {
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
            "{}: {error}; REGOLITH_UPDATE_GOLDENS=1 makes golden pictures: look at them before you commit",
            path.display()
        )
    })
}

fn check_size(path: &Path) {
    let bytes = std::fs::metadata(path).expect("the golden").len();
    assert!(bytes <= MOST_BYTES, "{} has {bytes} bytes, {MOST_BYTES} are allowed", path.display());
}

/// Mean SSIM and mean absolute difference of two pictures of one size.
fn difference(expected: &RgbImage, actual: &RgbImage) -> (f64, f64) {
    let algorithm = image_compare::Algorithm::MSSIMSimple;
    let similarity =
        image_compare::rgb_similarity_structure(&algorithm, expected, actual).expect("pictures of one size");
    let sum: u64 = expected.iter().zip(actual.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    (similarity.score, sum as f64 / expected.len() as f64)
}

fn alike(ssim: f64, mean: f64) -> bool {
    ssim >= LEAST_SSIM && mean <= MOST_MEAN_DIFFERENCE
}

/// Compares a picture with the golden one at `path` by perception.
pub(crate) fn assert_picture(path: &Path, actual: &RgbImage, cap_size: bool) {
    if updating() {
        actual.save(path).expect("golden written");
    }
    let expected = open(path).into_rgb8();
    if cap_size {
        check_size(path);
    }
    assert_eq!(expected.dimensions(), actual.dimensions(), "{}", path.display());
    let (ssim, mean) = difference(&expected, actual);
    if !alike(ssim, mean) {
        let kept = failed_folder().join(path.file_name().expect("a name"));
        actual.save(&kept).expect("failure written");
        panic!(
            "{} differs: SSIM {ssim:.5} (at least {LEAST_SSIM}), mean difference {mean:.3} (at most \
             {MOST_MEAN_DIFFERENCE}); the picture that was made is {}",
            path.display(),
            kept.display()
        );
    }
}

/// Compares a mask with the golden one of this name, pixel by pixel.
pub(crate) fn assert_mask(name: &str, actual: &GrayImage) {
    let path = golden(name);
    if updating() {
        actual.save(&path).expect("golden written");
    }
    let expected = open(&path).into_luma8();
    check_size(&path);
    assert_eq!(expected.dimensions(), actual.dimensions(), "{name}");
    let different = expected.iter().zip(actual.iter()).filter(|(a, b)| a != b).count();
    if different > MOST_MASK_DIFFERENCES {
        let kept = failed_folder().join(name);
        actual.save(&kept).expect("failure written");
        panic!("{different} pixels of {name} differ; the mask that was made is {}", kept.display());
    }
}

#[test]
fn the_comparison_can_fail() {
    let picture = RgbImage::from_fn(64, 64, |x, y| image::Rgb([(3 * x + y) as u8, (x * y % 200) as u8, 90]));
    let (ssim, mean) = difference(&picture, &picture);
    assert!(alike(ssim, mean) && mean == 0.0);
    let mut brighter = picture.clone();
    brighter.iter_mut().for_each(|value| *value = value.saturating_add(1));
    let (ssim, mean) = difference(&picture, &brighter);
    assert!(!alike(ssim, mean), "one step of 255 over the whole picture passes: {ssim}, {mean}");
    let mut spotted = picture.clone();
    (20..28).for_each(|x| (20..28).for_each(|y| spotted.put_pixel(x, y, image::Rgb([255, 0, 0]))));
    let (ssim, mean) = difference(&picture, &spotted);
    assert!(!alike(ssim, mean), "a spot of 8 x 8 pixels passes: {ssim}, {mean}");
}
