//! Tests of remapping.

use super::*;
use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};

/// Canonical ids of a mask of four pixels in a row under these labels.
fn remapped(mask: impl Into<DynamicImage>, labels: &str) -> Result<Vec<u8>> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    mask.into().write_to(&mut bytes, image::ImageFormat::Png).expect("encoded");
    remapped_png(&bytes.into_inner(), labels)
}

/// The same of a PNG file.
fn remapped_png(png: &[u8], labels: &str) -> Result<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("semantic_segmentation_0003.png"), png).expect("written");
    std::fs::write(folder.path().join("semantic_segmentation_labels_0003.json"), labels).expect("written");
    let out = folder.path().join("out");
    let pairs = find(folder.path())?;
    assert_eq!(pairs.len(), 1);
    remap(folder.path(), &pairs, &out, false)?;
    let made = image::open(out.join("semantic_segmentation_0003.png")).expect("a mask");
    assert_eq!(made.color(), image::ColorType::L8);
    let labels = std::fs::read_to_string(out.join("semantic_segmentation_labels_0003.json")).expect("labels");
    assert!(labels.contains("regolith"));
    Ok(made.into_bytes())
}

const LABELS: &str = r#"{"0": {"class": "BACKGROUND"}, "1": {"class": "UNLABELLED"}, "2": {"class": " Sky"},
    "3": {"class": "ROCK"}, "4": {"class": "regolith"}, "9": {"class": "rock"}, "7": {"class": "lander"}}"#;

#[test]
fn ids_of_every_bit_depth_become_canonical() {
    let grey = |ids: [u8; 4]| GrayImage::from_raw(4, 1, ids.to_vec()).expect("a mask");
    assert_eq!(remapped(grey([2, 3, 4, 9]), LABELS).expect("remapped"), [2, 1, 0, 1]);
    assert_eq!(remapped(grey([0, 1, 7, 200]), LABELS).expect("remapped"), [255; 4]);
    let wide: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(4, 1, vec![2, 3, 260, 4]).expect("a mask");
    assert_eq!(remapped(wide, LABELS).expect("remapped"), [2, 1, 255, 0]);
    let spread = RgbaImage::from_fn(4, 1, |x, _| {
        Rgba([[2, 0, 0, 0], [3, 0, 0, 0], [4, 1, 0, 0], [4, 0, 0, 0]][x as usize])
    });
    assert_eq!(remapped(spread, LABELS).expect("remapped"), [2, 1, 255, 0]);
    let equal_channels = RgbaImage::from_fn(4, 1, |x, _| {
        Rgba([[2, 2, 2, 255], [3, 3, 3, 255], [4, 4, 4, 255], [9, 9, 9, 255]][x as usize])
    });
    assert_eq!(remapped(equal_channels, LABELS).expect("remapped"), [2, 1, 0, 1]);
}

#[test]
fn ids_of_16_bits_are_not_scaled_in_images_of_several_channels() {
    let labels = r#"{"2": {"class": "sky"}, "3": {"class": "rock"}, "300": {"class": "regolith"}}"#;
    let ids = [2_u16, 3, 300, 9];
    let expected = [2, 1, 0, 255];
    let rgb: ImageBuffer<image::Rgb<u16>, _> =
        ImageBuffer::from_fn(4, 1, |x, _| image::Rgb([ids[x as usize]; 3]));
    assert_eq!(remapped(rgb, labels).expect("remapped"), expected);
    let rgba: ImageBuffer<Rgba<u16>, _> = ImageBuffer::from_fn(4, 1, |x, _| {
        let id = ids[x as usize];
        Rgba([id, id, id, u16::MAX])
    });
    assert_eq!(remapped(rgba, labels).expect("remapped"), expected);
    let grey_alpha: ImageBuffer<image::LumaA<u16>, _> =
        ImageBuffer::from_fn(4, 1, |x, _| image::LumaA([ids[x as usize], u16::MAX]));
    assert_eq!(remapped(grey_alpha, labels).expect("remapped"), expected);
    let colours: ImageBuffer<image::Rgb<u16>, _> =
        ImageBuffer::from_fn(4, 1, |x, _| image::Rgb([x as u16, 2, 2]));
    let message = remapped(colours, labels).expect_err("colours").to_string();
    assert!(message.contains("colour image"), "{message}");
}

#[test]
fn ids_of_fewer_than_8_bits_are_not_scaled_and_palettes_are_refused() {
    // Four pixels in a row; written with Python's zlib.
    assert_eq!(remapped_png(&GREY_4_BITS, LABELS).expect("remapped"), [2, 1, 0, 1]);
    assert_eq!(remapped_png(&GREY_2_BITS, LABELS).expect("remapped"), [2, 1, 255, 255]);
    let message = remapped_png(&PALETTE_8_BITS, LABELS).expect_err("a palette").to_string();
    assert!(message.contains("it has a palette"), "{message}");
    let colours = r#"{"(2, 2, 2, 255)": {"class": "sky"}, "(3, 3, 3, 255)": {"class": "rock"}}"#;
    assert_eq!(remapped_png(&PALETTE_8_BITS, colours).expect("remapped"), [2, 1, 255, 255]);
}

/// A greyscale PNG file of 4 bits: 2, 3, 4, 9.
#[rustfmt::skip]
const GREY_4_BITS: [u8; 68] = [
    137, 80, 78, 71, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 0, 4, 0, 0, 0, 1,
    4, 0, 0, 0, 0, 25, 167, 189, 16, 0, 0, 0, 11, 73, 68, 65, 84, 120, 156, 99, 80, 246, 4, 0,
    0, 146, 0, 109, 146, 60, 151, 186, 0, 0, 0, 0, 73, 69, 78, 68, 174, 66, 96, 130,
];
/// A greyscale PNG file of 2 bits: 2, 3, 0, 1.
#[rustfmt::skip]
const GREY_2_BITS: [u8; 67] = [
    137, 80, 78, 71, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 0, 4, 0, 0, 0, 1,
    2, 0, 0, 0, 0, 150, 231, 72, 176, 0, 0, 0, 10, 73, 68, 65, 84, 120, 156, 99, 216, 8, 0, 0,
    179, 0, 178, 33, 146, 81, 202, 0, 0, 0, 0, 73, 69, 78, 68, 174, 66, 96, 130,
];
/// A PNG file with a palette of greys: indices 2, 3, 4, 0.
#[rustfmt::skip]
const PALETTE_8_BITS: [u8; 97] = [
    137, 80, 78, 71, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 0, 4, 0, 0, 0, 1,
    8, 3, 0, 0, 0, 206, 226, 255, 255, 0, 0, 0, 15, 80, 76, 84, 69, 0, 0, 0, 1, 1, 1, 2,
    2, 2, 3, 3, 3, 4, 4, 4, 182, 34, 47, 159, 0, 0, 0, 13, 73, 68, 65, 84, 120, 156, 99, 96,
    98, 102, 97, 0, 0, 0, 30, 0, 10, 108, 185, 250, 236, 0, 0, 0, 0, 73, 69, 78, 68, 174, 66, 96,
    130,
];

#[test]
fn colours_are_mapped_if_the_labels_are_colours() {
    let labels = r#"{"(0, 0, 0, 0)": {"class": "BACKGROUND"}, "(140, 25, 255, 255)": {"class": "rock"},
        "(25,255,140,255)": {"class": "regolith,ground"}}"#;
    let mask = RgbaImage::from_fn(4, 1, |x, _| {
        Rgba([[0, 0, 0, 0], [140, 25, 255, 255], [25, 255, 140, 255], [1, 2, 3, 255]][x as usize])
    });
    assert_eq!(remapped(mask, labels).expect("remapped"), [255, 1, 0, 255]);
    let rgb = image::RgbImage::from_fn(4, 1, |x, _| image::Rgb([x as u8, 9, 1]));
    let message = remapped(rgb, LABELS).expect_err("ids").to_string();
    assert!(message.contains("colour image"), "{message}");
}

#[test]
fn invalid_label_files_are_errors() {
    for (labels, said) in [
        ("{}", "it is empty"),
        ("", "not a label file"),
        ("[1]", "not a label file"),
        (r#"{"0": {"class": "BACKGROUND"}}"#, "none of its names"),
        (r#"{"3": {"class": "lander"}}"#, "lander"),
        (r#"{"rock": {"class": "rock"}}"#, "neither an id nor a colour"),
        (r#"{"3": 5}"#, "has no class"),
    ] {
        let message = remapped(GrayImage::new(4, 1), labels).expect_err(labels).to_string();
        assert!(message.contains(said), "{labels}: {message}");
    }
    let folder = tempfile::tempdir().expect("a folder");
    assert!(find(folder.path()).expect_err("nothing").to_string().contains("no mask is here"));
    GrayImage::new(4, 1).save(folder.path().join("semantic_segmentation_0000.png")).expect("saved");
    let message = find(folder.path()).expect_err("no labels").to_string();
    assert!(message.contains("semantic_segmentation_labels_0000.json is missing"), "{message}");
}

#[test]
fn masks_before_a_wrong_one_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    for (number, labels) in [LABELS, LABELS, "{}", LABELS].into_iter().enumerate() {
        let path = |stem: &str, extension| folder.path().join(format!("{stem}{number:04}.{extension}"));
        GrayImage::new(4, 1).save(path(MASK_STEM, "png")).expect("saved");
        std::fs::write(path(LABELS_STEM, "json"), labels).expect("written");
    }
    let pairs = find(folder.path()).expect("found");
    let message = remap(folder.path(), &pairs, &out, false).expect_err("no labels").to_string();
    assert!(message.contains("labels_0002.json") && message.contains("it is empty"), "{message}");
    let mut written = disk::names(&out).expect("read");
    written.retain(|name| name.ends_with(".png"));
    assert_eq!(written, ["semantic_segmentation_0000.png", "semantic_segmentation_0001.png"]);
    let whole = [&pairs[..2], &pairs[3..]].concat();
    let total = remap(folder.path(), &whole, &out, false).expect("the same files may be there");
    assert_eq!((total.masks, total.pixels.values().sum::<u64>()), (3, 12));
}
