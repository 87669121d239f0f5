//! Masks of other pipelines to the canonical ids, by the names in their label files.
//!
//! A Replicator pipeline gives ids in the order in which it met the classes, so that only the label file beside each
//! mask tells what they mean. Names are compared without case and surrounding space; what has no name of ours becomes
//! 255. A label file that names no class is an error: a mask of nothing but 255 would train nothing, in silence.
//! Must not know: scene, GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use serde_json::{Map, Value};

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::output::encode::{json, png};
use crate::output::{Artifact, LabelIds, disk};

/// What the names of masks start with.
const MASK_STEM: &str = "semantic_segmentation_";
/// What the names of label files start with.
const LABELS_STEM: &str = "semantic_segmentation_labels_";
/// Names that a Replicator pipeline gives to what carries no label.
const NO_LABEL: [&str; 2] = ["background", "unlabelled"];

/// A mask and its label file, by their path below the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    /// The mask.
    pub mask: PathBuf,
    /// The label file.
    pub labels: PathBuf,
}

impl Pair {
    /// What of the output folder's own content it becomes: names of files, or of the folder that they lie in.
    pub fn top_names(&self) -> impl Iterator<Item = &OsStr> {
        [&self.mask, &self.labels].into_iter().filter_map(|path| path.iter().next())
    }
}

/// What was made of some masks.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Remapped {
    /// How many.
    pub masks: u64,
    /// Pixels of each class, and of 255 under `unlabelled`.
    pub pixels: BTreeMap<&'static str, u64>,
    /// Names that are no class of ours; their pixels became 255.
    pub unknown_names: BTreeSet<String>,
    /// Masks that have become nothing but 255.
    pub empty_masks: Vec<PathBuf>,
}

impl Remapped {
    /// Adds what was made of others.
    pub fn add(&mut self, other: Self) {
        self.masks += other.masks;
        for (class, pixels) in other.pixels {
            *self.pixels.entry(class).or_default() += pixels;
        }
        self.unknown_names.extend(other.unknown_names);
        self.empty_masks.extend(other.empty_masks);
    }
}

fn wrong(path: &Path, message: impl Into<String>) -> Error {
    Error::Dataset { path: path.to_owned(), message: message.into() }
}

/// Every mask in a folder and the folders in it, with its label file.
///
/// # Errors
/// [`Error::Dataset`] if there is no mask, or one has no label file; [`Error::Read`].
pub fn find(folder: &Path) -> Result<Vec<Pair>> {
    let mut pairs = Vec::new();
    find_below(folder, Path::new(""), &mut pairs)?;
    if pairs.is_empty() {
        return Err(wrong(
            folder,
            format!("no mask is here: files named {MASK_STEM}0000.png are looked for"),
        ));
    }
    Ok(pairs)
}

fn find_below(folder: &Path, below: &Path, pairs: &mut Vec<Pair>) -> Result<()> {
    for name in disk::names(&folder.join(below))? {
        let path = below.join(&name);
        if folder.join(&path).is_dir() {
            find_below(folder, &path, pairs)?;
        } else if let Some(number) = name.strip_prefix(MASK_STEM).and_then(|rest| rest.strip_suffix(".png")) {
            let labels = below.join(format!("{LABELS_STEM}{number}.json"));
            if !folder.join(&labels).is_file() {
                return Err(wrong(
                    &folder.join(&path),
                    format!(
                        "its label file {LABELS_STEM}{number}.json is missing; without it no id has a meaning"
                    ),
                ));
            }
            pairs.push(Pair { mask: path, labels });
        }
    }
    Ok(())
}

/// How the pixels of a mask are named in its label file.
enum Names {
    /// By number.
    Ids(BTreeMap<u32, u8>),
    /// By colour, RGBA.
    Colours(BTreeMap<[u8; 4], u8>),
}

/// Reads a label file: raw id (or colour) to canonical id. Names that are no class of ours go to `unknown`.
fn read_labels(path: &Path, unknown: &mut BTreeSet<String>) -> Result<Names> {
    let bytes = disk::read(path)?;
    let content: Map<String, Value> = serde_json::from_slice(&bytes).map_err(|error| {
        wrong(path, format!("not a label file: {error}; expected is {{\"2\": {{\"class\": \"sky\"}}}}"))
    })?;
    if content.is_empty() {
        return Err(wrong(
            path,
            "it is empty: every pixel would become 255. Write the labels with the masks again",
        ));
    }
    let (mut ids, mut colours) = (BTreeMap::new(), BTreeMap::new());
    let mut known = false;
    for (key, value) in &content {
        let name =
            value.get("class").and_then(Value::as_str).or_else(|| value.as_str()).ok_or_else(|| {
                wrong(path, format!("`{key}` has no class; expected is {{\"class\": \"rock\"}}"))
            })?;
        let class = class_of(name);
        known |= class.is_some();
        if class.is_none() && !NO_LABEL.contains(&name.trim().to_lowercase().as_str()) {
            unknown.insert(name.trim().to_owned());
        }
        let id = class.unwrap_or(ClassId::UNLABELLED).0;
        if let Ok(raw) = key.trim().parse::<u32>() {
            ids.insert(raw, id);
        } else if let Some(colour) = parse_colour(key) {
            colours.insert(colour, id);
        } else {
            return Err(wrong(path, format!("`{key}` is neither an id nor a colour (r, g, b, a)")));
        }
    }
    if !known {
        let names: Vec<String> = content.values().filter_map(|v| Some(v.get("class")?.to_string())).collect();
        let ours: Vec<&str> = ClassId::ALL.iter().map(|class| class.name).collect();
        return Err(wrong(
            path,
            format!("none of its names ({}) is a class; there are {}", names.join(", "), ours.join(", ")),
        ));
    }
    match (ids.is_empty(), colours.is_empty()) {
        (false, true) => Ok(Names::Ids(ids)),
        (true, false) => Ok(Names::Colours(colours)),
        _ => Err(wrong(path, "it names some pixels by id and others by colour")),
    }
}

/// The class of a name; of names joined by commas, of the one that is a class.
fn class_of(name: &str) -> Option<ClassId> {
    let mut found = name.split(',').filter_map(|part| {
        let part = part.trim().to_lowercase();
        ClassId::ALL.iter().find(|class| class.name == part).map(|class| class.id)
    });
    let first = found.next()?;
    found.all(|other| other == first).then_some(first)
}

fn parse_colour(key: &str) -> Option<[u8; 4]> {
    let numbers: Vec<u8> = key
        .trim()
        .strip_prefix('(')?
        .strip_suffix(')')?
        .split(',')
        .map(|number| number.trim().parse().ok())
        .collect::<Option<_>>()?;
    match numbers[..] {
        [r, g, b] => Some([r, g, b, 255]),
        [r, g, b, a] => Some([r, g, b, a]),
        _ => None,
    }
}

/// Canonical ids of a mask's pixels.
fn remap_pixels(path: &Path, mask: &DynamicImage, names: &Names) -> Result<Vec<u8>> {
    let unlabelled = ClassId::UNLABELLED.0;
    match names {
        Names::Ids(ids) => {
            let raw = raw_ids(mask).ok_or_else(|| {
                wrong(path, "it is a picture of colours, but its label file names ids, not colours")
            })?;
            Ok(raw.iter().map(|id| ids.get(id).copied().unwrap_or(unlabelled)).collect())
        }
        Names::Colours(colours) => {
            let pixels = mask.to_rgba8();
            Ok(pixels.pixels().map(|pixel| colours.get(&pixel.0).copied().unwrap_or(unlabelled)).collect())
        }
    }
}

/// Ids of a mask with one channel of 8 or 16 bits, grey in several channels, or 32 bits spread over red to alpha.
fn raw_ids(mask: &DynamicImage) -> Option<Vec<u32>> {
    match mask {
        DynamicImage::ImageLuma8(image) => Some(image.iter().map(|id| u32::from(*id)).collect()),
        DynamicImage::ImageLuma16(image) => Some(image.iter().map(|id| u32::from(*id)).collect()),
        _ => {
            let pixels: Vec<[u8; 4]> = mask.to_rgba8().pixels().map(|pixel| pixel.0).collect();
            if pixels.iter().all(|[r, g, b, _]| r == g && g == b) {
                return Some(pixels.iter().map(|pixel| u32::from(pixel[0])).collect());
            }
            let spread = matches!(mask, DynamicImage::ImageRgba8(_));
            spread.then(|| pixels.into_iter().map(u32::from_le_bytes).collect())
        }
    }
}

/// Remaps one mask; its files go to the same place below `out`.
///
/// # Errors
/// [`Error::Dataset`], [`Error::Read`], [`Error::Write`].
pub fn remap(folder: &Path, pair: &Pair, out: &Path) -> Result<Remapped> {
    let path = folder.join(&pair.mask);
    let mut result = Remapped { masks: 1, ..Remapped::default() };
    let names = read_labels(&folder.join(&pair.labels), &mut result.unknown_names)?;
    let mask = image::load_from_memory_with_format(&disk::read(&path)?, image::ImageFormat::Png)
        .map_err(|error| wrong(&path, format!("it cannot be decoded: {error}")))?;
    let ids = remap_pixels(&path, &mask, &names)?;
    for class in ClassId::ALL {
        let count = ids.iter().filter(|id| **id == class.id.0).count() as u64;
        result.pixels.insert(class.name, count);
    }
    let unlabelled = ids.iter().filter(|id| **id == ClassId::UNLABELLED.0).count();
    result.pixels.insert("unlabelled", unlabelled as u64);
    if unlabelled == ids.len() {
        result.empty_masks.push(pair.mask.clone());
    }
    let file = |path: &Path, bytes| Artifact { name: path.to_string_lossy().into_owned(), bytes };
    disk::write_all(
        out,
        &[
            file(&pair.mask, png::ids_u8(mask.width(), mask.height(), &ids)?),
            file(&pair.labels, json::to_bytes(&LabelIds::Canonical.labels())?),
        ],
    )?;
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};

    /// Ids of a mask of four pixels in a row under these labels.
    fn remapped(mask: impl Into<DynamicImage>, labels: &str) -> Result<Vec<u8>> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("semantic_segmentation_0003.png");
        mask.into().save(&path).expect("saved");
        std::fs::write(folder.path().join("semantic_segmentation_labels_0003.json"), labels)
            .expect("written");
        let out = folder.path().join("out");
        let pairs = find(folder.path())?;
        assert_eq!(pairs.len(), 1);
        remap(folder.path(), &pairs[0], &out)?;
        let made = image::open(out.join("semantic_segmentation_0003.png")).expect("a mask");
        assert_eq!(made.color(), image::ColorType::L8);
        let labels =
            std::fs::read_to_string(out.join("semantic_segmentation_labels_0003.json")).expect("labels");
        assert!(labels.contains("regolith"));
        Ok(made.into_bytes())
    }

    const LABELS: &str = r#"{"0": {"class": "BACKGROUND"}, "1": {"class": "UNLABELLED"}, "2": {"class": " Sky"},
        "3": {"class": "ROCK"}, "4": {"class": "regolith"}, "9": {"class": "rock"}, "7": {"class": "lander"}}"#;

    #[test]
    fn ids_of_every_width_become_canonical() {
        let grey = |ids: [u8; 4]| GrayImage::from_raw(4, 1, ids.to_vec()).expect("a mask");
        assert_eq!(remapped(grey([2, 3, 4, 9]), LABELS).expect("remapped"), [2, 1, 0, 1]);
        assert_eq!(remapped(grey([0, 1, 7, 200]), LABELS).expect("remapped"), [255; 4]);
        let wide: ImageBuffer<Luma<u16>, _> =
            ImageBuffer::from_raw(4, 1, vec![2, 3, 260, 4]).expect("a mask");
        assert_eq!(remapped(wide, LABELS).expect("remapped"), [2, 1, 255, 0]);
        let spread = RgbaImage::from_fn(4, 1, |x, _| {
            Rgba([[2, 0, 0, 0], [3, 0, 0, 0], [4, 1, 0, 0], [4, 0, 0, 0]][x as usize])
        });
        assert_eq!(remapped(spread, LABELS).expect("remapped"), [2, 1, 255, 0]);
        let shown = RgbaImage::from_fn(4, 1, |x, _| {
            Rgba([[2, 2, 2, 255], [3, 3, 3, 255], [4, 4, 4, 255], [9, 9, 9, 255]][x as usize])
        });
        assert_eq!(remapped(shown, LABELS).expect("remapped"), [2, 1, 0, 1]);
    }

    #[test]
    fn colours_are_looked_up_where_the_labels_name_them() {
        let labels = r#"{"(0, 0, 0, 0)": {"class": "BACKGROUND"}, "(140, 25, 255, 255)": {"class": "rock"},
            "(25,255,140,255)": {"class": "regolith,ground"}}"#;
        let mask = RgbaImage::from_fn(4, 1, |x, _| {
            Rgba([[0, 0, 0, 0], [140, 25, 255, 255], [25, 255, 140, 255], [1, 2, 3, 255]][x as usize])
        });
        assert_eq!(remapped(mask, labels).expect("remapped"), [255, 1, 0, 255]);
        let rgb = image::RgbImage::from_fn(4, 1, |x, _| image::Rgb([x as u8, 9, 1]));
        let message = remapped(rgb, LABELS).expect_err("ids").to_string();
        assert!(message.contains("picture of colours"), "{message}");
    }

    #[test]
    fn label_files_that_name_nothing_are_errors() {
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
}
