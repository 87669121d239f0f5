//! Converts the masks of other pipelines to the canonical ids, by the class names in their label files.
//!
//! A Replicator pipeline numbers the classes in the order in which it meets them, so only the label file beside a mask
//! says what its ids mean. Names are compared without regard to case and surrounding space. Pixels with any other name
//! become 255. A label file without any known class is an error: a mask with nothing but 255 would be ignored in training
//! without a warning.
//! Must not know: scene, GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use rayon::prelude::*;
use serde_json::{Map, Value};

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::input::{self, MIB};
use crate::output::encode::{json, png};
use crate::output::{Artifact, LabelIds, dataset_path, disk};

/// Start of the file names of masks.
const MASK_STEM: &str = "semantic_segmentation_";
/// Start of the file names of label files.
const LABELS_STEM: &str = "semantic_segmentation_labels_";
/// Largest size of a label file: a row for each of 65536 ids.
const MAX_LABELS_BYTES: u64 = 16 * MIB;
/// Largest size of a mask.
const MAX_MASK_BYTES: u64 = 4096 * MIB;
/// Ids and colours without a name that are kept; further ones are left out.
pub const MAX_UNNAMED: usize = 1 << 16;
/// Names that a Replicator pipeline uses for unlabelled pixels.
const NO_LABEL: [&str; 2] = ["background", "unlabelled"];

/// A mask and its label file, with paths below the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    /// The mask.
    pub mask: PathBuf,
    /// The label file.
    pub labels: PathBuf,
}

impl Pair {
    /// Names that it creates directly in the output folder: those of its files, or of the folder that contains them.
    pub fn top_names(&self) -> impl Iterator<Item = &OsStr> {
        [&self.mask, &self.labels].into_iter().filter_map(|path| path.iter().next())
    }
}

/// The result of remapping some masks.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Remapped {
    /// Number of masks.
    pub masks: u64,
    /// Number of pixels by class name; those of id 255 under `unlabelled`.
    pub pixels: BTreeMap<&'static str, u64>,
    /// Names that are not a known class; their pixels became 255.
    pub unknown_names: BTreeSet<String>,
    /// Ids that occur in a mask and not in its label file; their pixels became 255. Up to [`MAX_UNNAMED`].
    pub unnamed_ids: BTreeSet<u32>,
    /// The same of RGBA colours.
    pub unnamed_colours: BTreeSet<[u8; 4]>,
    /// Masks whose pixels all became 255.
    pub empty_masks: Vec<PathBuf>,
}

impl Remapped {
    /// Adds the result of other masks.
    pub fn add(&mut self, other: Self) {
        self.masks += other.masks;
        for (class, pixels) in other.pixels {
            *self.pixels.entry(class).or_default() += pixels;
        }
        self.unknown_names.extend(other.unknown_names);
        add_up_to_max(&mut self.unnamed_ids, other.unnamed_ids);
        add_up_to_max(&mut self.unnamed_colours, other.unnamed_colours);
        self.empty_masks.extend(other.empty_masks);
    }
}

fn add_up_to_max<T: Ord>(all: &mut BTreeSet<T>, others: impl IntoIterator<Item = T>) {
    all.extend(others.into_iter().take(MAX_UNNAMED - all.len()));
}

fn wrong(path: &Path, message: impl Into<String>) -> Error {
    Error::Dataset { path: path.to_owned(), message: message.into() }
}

/// Finds every mask in a folder and its subfolders, with its label file. Links to folders are refused, not followed.
///
/// # Errors
/// [`Error::Dataset`] if there is no mask, a mask or a label file is without the other, a folder is a link, or a name is not UTF-8; [`Error::Read`].
pub fn find(folder: &Path) -> Result<Vec<Pair>> {
    if !folder.is_dir() {
        return Err(wrong(folder, "there is no such folder; name the folder of the masks"));
    }
    let mut pairs = Vec::new();
    find_below(folder, Path::new(""), &mut pairs)?;
    if pairs.is_empty() {
        return Err(wrong(
            folder,
            format!("no mask is here; the names of masks have the form {MASK_STEM}0000.png"),
        ));
    }
    Ok(pairs)
}

fn find_below(folder: &Path, below: &Path, pairs: &mut Vec<Pair>) -> Result<()> {
    for os_name in disk::os_names(&folder.join(below))? {
        let path = below.join(&os_name);
        let Some(name) = os_name.to_str() else {
            if folder.join(&path).is_dir() || os_name.as_encoded_bytes().starts_with(MASK_STEM.as_bytes()) {
                return Err(wrong(
                    &folder.join(&path),
                    "its name is not UTF-8, and the names of masks, label files and folders must be; rename it",
                ));
            }
            continue;
        };
        if folder.join(&path).is_dir() {
            if folder.join(&path).is_symlink() {
                return Err(wrong(
                    &folder.join(&path),
                    "it is a symbolic link to a folder, which is not followed; remove it, or run remap for the folder that it \
                     leads to",
                ));
            }
            find_below(folder, &path, pairs)?;
        } else if let Some(number) = name.strip_prefix(MASK_STEM).and_then(|rest| rest.strip_suffix(".png")) {
            let labels = below.join(format!("{LABELS_STEM}{number}.json"));
            if !folder.join(&labels).is_file() {
                return Err(wrong(
                    &folder.join(&path),
                    format!(
                        "its label file {LABELS_STEM}{number}.json is missing, and only that says what the ids mean; copy it here"
                    ),
                ));
            }
            pairs.push(Pair { mask: path, labels });
        } else if let Some(number) =
            name.strip_prefix(LABELS_STEM).and_then(|rest| rest.strip_suffix(".json"))
            && !folder.join(below).join(format!("{MASK_STEM}{number}.png")).is_file()
        {
            return Err(wrong(
                &folder.join(&path),
                format!("its mask {MASK_STEM}{number}.png is missing; copy it here, or remove this file"),
            ));
        }
    }
    Ok(())
}

/// The entries of a label file.
enum Labels {
    /// Canonical id by raw id.
    Ids(BTreeMap<u32, u8>),
    /// Canonical id by RGBA colour.
    Colours(BTreeMap<[u8; 4], u8>),
}

/// The name in an entry of a label file, of either form.
fn name_of(entry: &Value) -> Option<&str> {
    entry.get("class").and_then(Value::as_str).or_else(|| entry.as_str())
}

/// Reads a label file. Adds names that are not a known class to `unknown`.
fn read_labels(path: &Path, unknown: &mut BTreeSet<String>) -> Result<Labels> {
    let bytes = input::read(path, MAX_LABELS_BYTES)?;
    let content: Map<String, Value> = input::json::parse(&bytes).map_err(|error| {
        wrong(path, format!("not a label file: {error}; the form is {{\"2\": {{\"class\": \"sky\"}}}}"))
    })?;
    if content.is_empty() {
        return Err(wrong(
            path,
            "it is empty, so every pixel would become 255; write the labels together with the masks again",
        ));
    }
    let (mut ids, mut colours) = (BTreeMap::new(), BTreeMap::new());
    let mut known = false;
    for (key, value) in &content {
        let name = name_of(value).ok_or_else(|| {
            wrong(path, format!("`{key}` has no class; the form is {{\"class\": \"rock\"}}"))
        })?;
        let class = class_of(name);
        known |= class.is_some();
        if class.is_none() && !NO_LABEL.contains(&name.trim().to_lowercase().as_str()) {
            unknown.insert(name.trim().to_owned());
        }
        let id = class.unwrap_or(ClassId::UNLABELLED).0;
        let refuse_twice = |is_known: bool| {
            let refused = || Err(wrong(path, format!("`{key}` occurs twice, in another spelling")));
            if is_known { refused() } else { Ok(()) }
        };
        if let Ok(raw) = key.trim().parse::<u32>() {
            refuse_twice(ids.insert(raw, id).is_some())?;
        } else if let Some(colour) = parse_colour(key) {
            refuse_twice(colours.insert(colour, id).is_some())?;
        } else {
            return Err(wrong(path, format!("`{key}` is neither an id nor a colour (r, g, b, a)")));
        }
    }
    if !known {
        let names: Vec<&str> = content.values().filter_map(name_of).collect();
        let ours: Vec<&str> = ClassId::ALL.iter().map(|class| class.name).collect();
        return Err(wrong(
            path,
            format!(
                "none of its names ({}) is a class; the classes are {}",
                names.join(", "),
                ours.join(", ")
            ),
        ));
    }
    match (ids.is_empty(), colours.is_empty()) {
        (false, true) => Ok(Labels::Ids(ids)),
        (true, false) => Ok(Labels::Colours(colours)),
        _ => Err(wrong(path, "some of its keys are ids and others colours; use one kind")),
    }
}

/// The class of a name, or of the one part of a comma-separated name that is a class.
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
        .map(|number| number.trim().parse::<u8>().ok())
        .collect::<Option<_>>()?;
    match numbers[..] {
        [r, g, b] => Some([r, g, b, 255]),
        [r, g, b, a] => Some([r, g, b, a]),
        _ => None,
    }
}

/// How the pixels of a PNG file are stored. The decoder scales those of fewer than 8 bits and replaces indices of a palette.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PixelFormat {
    /// Bits of each channel.
    bits: u8,
    /// Whether pixels are indices of a palette.
    has_palette: bool,
}

impl PixelFormat {
    /// The format in the header of a decoded PNG file: behind signature, length and type of the first chunk and the size.
    fn of(png: &[u8]) -> Self {
        let byte = |offset: usize| png.get(offset).copied().unwrap_or_default();
        Self { bits: byte(24), has_palette: byte(25) == 3 }
    }

    /// What the decoder multiplies grey values by, so that the largest becomes 255.
    fn grey_scale(self) -> u32 {
        match self.bits {
            bits @ (1 | 2 | 4) => 255 / ((1 << bits) - 1),
            _ => 1,
        }
    }
}

/// The canonical id of each pixel. Ids and colours without a name are added to `result`.
fn remap_pixels(
    path: &Path,
    mask: &DynamicImage,
    format: PixelFormat,
    labels: &Labels,
    result: &mut Remapped,
) -> Result<Vec<u8>> {
    match labels {
        Labels::Ids(_) if format.has_palette => Err(wrong(
            path,
            "it has a palette, so its pixels are colours, but its label file has ids; write the ids as a greyscale image",
        )),
        Labels::Ids(ids) => {
            let raw = raw_ids(mask, format.grey_scale()).ok_or_else(|| {
                wrong(path, "it is a colour image, but its label file has ids, not colours; use a mask of raw ids, or the labels of the colours")
            })?;
            Ok(canonical(raw.into_iter(), ids, &mut result.unnamed_ids))
        }
        Labels::Colours(colours) => {
            let raw = mask.to_rgba8();
            Ok(canonical(raw.pixels().map(|pixel| pixel.0), colours, &mut result.unnamed_colours))
        }
    }
}

fn canonical<T: Ord + Copy>(
    raw: impl Iterator<Item = T>,
    named: &BTreeMap<T, u8>,
    unnamed: &mut BTreeSet<T>,
) -> Vec<u8> {
    let mut without_name = |raw: T| {
        add_up_to_max(unnamed, [raw]);
        ClassId::UNLABELLED.0
    };
    raw.map(|raw| named.get(&raw).copied().unwrap_or_else(|| without_name(raw))).collect()
}

/// The raw ids of a mask: one channel of up to 16 bits, several equal channels, or 32-bit ids spread over R, G, B and A of 8 bits.
/// `None` for a colour image. Values of one channel of 8 bits are divided by `grey_scale`.
fn raw_ids(mask: &DynamicImage, grey_scale: u32) -> Option<Vec<u32>> {
    match mask {
        DynamicImage::ImageLuma8(image) => {
            Some(image.iter().map(|grey| u32::from(*grey) / grey_scale).collect())
        }
        DynamicImage::ImageLumaA8(image) => {
            Some(image.pixels().map(|pixel| u32::from(pixel[0]) / grey_scale).collect())
        }
        DynamicImage::ImageLuma16(image) => Some(image.iter().map(|grey| u32::from(*grey)).collect()),
        DynamicImage::ImageLumaA16(image) => Some(image.pixels().map(|pixel| u32::from(pixel[0])).collect()),
        DynamicImage::ImageRgb16(image) => equal_channels(image.pixels().map(|pixel| pixel.0)),
        DynamicImage::ImageRgba16(image) => {
            equal_channels(image.pixels().map(|pixel| pixel.0).map(|[r, g, b, _]| [r, g, b]))
        }
        DynamicImage::ImageRgb8(image) => equal_channels(image.pixels().map(|pixel| pixel.0)),
        DynamicImage::ImageRgba8(image) => {
            let pixels = || image.pixels().map(|pixel| pixel.0);
            equal_channels(pixels().map(|[r, g, b, _]| [r, g, b]))
                .or_else(|| Some(pixels().map(u32::from_le_bytes).collect()))
        }
        _ => None,
    }
}

/// The value of each pixel if its channels are equal in all of them.
fn equal_channels<T: Copy + PartialEq + Into<u32>>(pixels: impl Iterator<Item = [T; 3]>) -> Option<Vec<u32>> {
    pixels.map(|[r, g, b]| (r == g && g == b).then(|| r.into())).collect()
}

/// Remaps some masks at the same time. Their files get the same paths below `out`. Files that are there stay as they are unless `force` is
/// set. After an error those of the masks before it are written.
///
/// # Errors
/// [`Error::Dataset`], [`Error::OutFileExists`] for a file with other content unless `force`, [`Error::Read`], [`Error::Write`].
pub fn remap(folder: &Path, pairs: &[Pair], out: &Path, force: bool) -> Result<Remapped> {
    let remapped: Vec<Result<(Remapped, [Artifact; 2])>> = pairs
        .par_iter()
        .map(|pair| {
            let (result, files) = remap_one(folder, pair)?;
            if !force {
                files.iter().try_for_each(|file| check_replaces_nothing(out, file))?;
            }
            Ok((result, files))
        })
        .collect();
    let (mut total, mut files, mut failed) = (Remapped::default(), Vec::new(), Ok(()));
    for mask in remapped {
        match mask {
            Ok((result, of_mask)) => {
                total.add(result);
                files.extend(of_mask);
            }
            Err(error) => {
                failed = Err(error);
                break;
            }
        }
    }
    if !files.is_empty() {
        disk::write_all(out, &files)?;
    }
    failed.map(|()| total)
}

/// The files of a mask, and what is in them.
fn remap_one(folder: &Path, pair: &Pair) -> Result<(Remapped, [Artifact; 2])> {
    let path = folder.join(&pair.mask);
    let mut result = Remapped { masks: 1, ..Remapped::default() };
    let labels = read_labels(&folder.join(&pair.labels), &mut result.unknown_names)?;
    let bytes = input::read(&path, MAX_MASK_BYTES)?;
    let mask = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png)
        .map_err(|error| wrong(&path, format!("it cannot be decoded: {error}")))?;
    let ids = remap_pixels(&path, &mask, PixelFormat::of(&bytes), &labels, &mut result)?;
    let count = |class: ClassId| ids.iter().filter(|id| **id == class.0).count();
    result.pixels = ClassId::ALL.map(|class| (class.name, count(class.id) as u64)).into();
    let unlabelled = count(ClassId::UNLABELLED);
    result.pixels.insert("unlabelled", unlabelled as u64);
    if unlabelled == ids.len() {
        result.empty_masks.push(pair.mask.clone());
    }
    let file = |path: &Path, bytes| Artifact { name: path.to_string_lossy().into_owned(), bytes };
    let files = [
        file(&pair.mask, png::ids_u8(mask.width(), mask.height(), &ids)?),
        file(&pair.labels, json::to_bytes(&LabelIds::Canonical.labels())?),
    ];
    Ok((result, files))
}

/// Refuses to write a file where there is one already, unless that is the same, as an earlier run leaves it.
fn check_replaces_nothing(out: &Path, file: &Artifact) -> Result<()> {
    let path = dataset_path::for_writing(out, &file.name)?;
    if path.symlink_metadata().is_err() || path.is_dir() {
        return Ok(());
    }
    let hash = disk::content_hash(&file.bytes);
    let is_same = dataset_path::hash(out, &file.name).is_ok_and(|(_, existing)| existing == hash);
    if is_same { Ok(()) } else { Err(Error::OutFileExists(path)) }
}

#[cfg(test)]
mod tests;
