//! What a person looks at first in a finished dataset: its card, a sheet of its first frames, histograms of its knobs.
//!
//! Must not know: how frames come about.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use image::imageops::{self, FilterType};
use image::{ImageFormat, Rgb, RgbImage};
use serde_json::{Map, Value};

use super::journal::{Totals, index_of};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::output::layout::{FrameLines, Layout};
use crate::output::{Artifact, LabelIds, disk};

/// Frames on the contact sheet.
const SHEET_FRAMES: usize = 12;
/// Pairs of pictures in a row of the sheet.
const SHEET_COLUMNS: u32 = 3;
/// Width of a picture on the sheet, pixels.
const SHEET_PICTURE_PX: u32 = 192;
/// Pixels between pictures.
const SHEET_GAP_PX: u32 = 8;
/// Bars of a histogram.
const BARS: usize = 24;

fn text<'a>(manifest: &'a Map<String, Value>, key: &str) -> &'a str {
    manifest.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// The data card: classes, camera, knobs, counts, licence.
#[must_use]
pub fn card(manifest: &Map<String, Value>, totals: &Totals) -> String {
    let label_ids = LabelIds::of_manifest(manifest);
    let value = |key: &str| manifest.get(key).map(ToString::to_string).unwrap_or_default();
    let mut card = String::new();
    // Writing into a string cannot fail.
    let mut line = |text: std::fmt::Arguments<'_>| {
        let _ = writeln!(card, "{text}");
    };
    line(format_args!("# Labelled pictures of the Moon\n"));
    line(format_args!(
        "{} synthetic frames of a rover's view of the lunar surface with the exact class of every pixel, made by \
         regolith-render {} from base seed {}. Picture and mask come from the same draw.\n",
        totals.frames,
        text(manifest, "version"),
        value("base_seed")
    ));
    line(format_args!("## Classes\n\n| id | class | mean share |\n|---|---|---|"));
    for (place, class) in ClassId::ALL.iter().enumerate() {
        let id = label_ids.mask_id(class.id.0);
        line(format_args!("| {id} | {} | {:.2} % |", class.name, 100.0 * totals.coverage(place)));
    }
    let ignored = label_ids.mask_id(ClassId::UNLABELLED.0);
    let of_ids = match label_ids {
        LabelIds::Canonical => {
            "The ids start at 0 with a real class: a loader that reduces zero labels would erase it."
        }
        LabelIds::Replicator => {
            "The ids are those of a Replicator pipeline; its 0, BACKGROUND, is in no mask."
        }
    };
    line(format_args!("\n{ignored} is the ignore index. {of_ids}"));
    line(format_args!(
        "\n## Frames\n\n* {} pixels, {} samples a pixel; edges: {}.\n* Format `{}`; outputs: {}.",
        value("size").replace(',', " x ").replace(['[', ']'], ""),
        value("samples"),
        text(manifest, "edges"),
        text(manifest, "format"),
        value("outputs").replace(['[', ']', '"'], "").replace(',', ", ")
    ));
    line(format_args!(
        "* Camera, sun, pose and every knob as drawn stand in `frames.jsonl`, a line a frame. Pixel (u, v) has its centre \
         at (u + 0.5, v + 0.5); world axes are metres with Z up; `world_from_camera` has x right, y down, z forward."
    ));
    let splits = manifest.get("splits").and_then(Value::as_object).filter(|splits| !splits.is_empty());
    if let Some(splits) = splits {
        line(format_args!(
            "\n## Splits\n\nThe seeds of a split's scenes are a range of their own (both ends included; modulo 2^53); what \
             is drawn again takes seeds 2^32 further on, so no scene is in two splits.\n\n\
             | split | frames | first | seeds |\n|---|---|---|---|"
        ));
        for (name, split) in splits {
            let number = |key: &str| split.get(key).map(ToString::to_string).unwrap_or_default();
            line(format_args!(
                "| {name} | {} | {} | {} |",
                number("count"),
                number("start"),
                number("seeds")
            ));
        }
    }
    let redrawn: u64 = totals.redraws.values().sum();
    line(format_args!(
        "\n## Rules\n\n{redrawn} frames were drawn again because they broke a rule of `{}`.",
        value("rules")
    ));
    for (rule, count) in &totals.redraws {
        line(format_args!("* {rule}: {count}"));
    }
    line(format_args!("\n## Knobs\n\n| knob | drawn from |\n|---|---|"));
    for (knob, from) in manifest.get("config").and_then(Value::as_object).into_iter().flatten() {
        line(format_args!("| `{knob}` | `{from}` |"));
    }
    line(format_args!(
        "\n## Licence\n\n[CC0 1.0](https://creativecommons.org/publicdomain/zero/1.0/): the pictures and labels are in the \
         public domain, to the extent that the law allows."
    ));
    card
}

/// The first frames, the picture beside its mask in colours; nothing if they do not lie there as files.
///
/// # Errors
/// [`Error::Read`], [`Error::Encode`].
pub fn contact_sheet(folder: &Path, lines: &dyn FrameLines, layout: &dyn Layout) -> Result<Option<Artifact>> {
    let mut first = Vec::new();
    lines.for_each(&mut |line| {
        if first.len() < SHEET_FRAMES
            && let Some(index) = index_of(&line)
        {
            let split = line.get("split").and_then(Value::as_str).unwrap_or_default();
            first.extend(layout.image_and_mask(split, index));
        }
        Ok(())
    })?;
    if first.is_empty() {
        return Ok(None);
    }
    let failed = |error: image::ImageError| Error::Encode {
        name: "contact_sheet.png".to_owned(),
        message: error.to_string(),
    };
    let mut pairs = Vec::new();
    for [picture, mask] in first {
        let open = |path: &str| {
            let path = folder.join(path);
            image::load_from_memory(&disk::read(&path)?).map_err(|error| {
                Error::CheckFailed(format!(
                    "{}: it cannot be decoded ({error}); delete it, and the dataset's own command makes it again",
                    path.display()
                ))
            })
        };
        let picture = open(&picture)?.into_rgb8();
        let height = (picture.height() * SHEET_PICTURE_PX / picture.width()).max(1);
        let colours = mask_colours(&open(&mask)?.into_luma8());
        pairs.push([
            imageops::resize(&picture, SHEET_PICTURE_PX, height, FilterType::Triangle),
            imageops::resize(&colours, SHEET_PICTURE_PX, height, FilterType::Nearest),
        ]);
    }
    let (tile_width, tile_height) =
        (2 * SHEET_PICTURE_PX + SHEET_GAP_PX, pairs[0][0].height() + SHEET_GAP_PX);
    let (columns, rows) =
        (SHEET_COLUMNS.min(pairs.len() as u32), (pairs.len() as u32).div_ceil(SHEET_COLUMNS));
    let mut sheet = RgbImage::from_pixel(
        columns * tile_width + SHEET_GAP_PX,
        rows * tile_height + SHEET_GAP_PX,
        Rgb([255; 3]),
    );
    for (place, [picture, mask]) in (0..).zip(&pairs) {
        let x = i64::from(place % SHEET_COLUMNS * tile_width + SHEET_GAP_PX);
        let y = i64::from(place / SHEET_COLUMNS * tile_height + SHEET_GAP_PX);
        imageops::replace(&mut sheet, picture, x, y);
        imageops::replace(&mut sheet, mask, x + i64::from(SHEET_PICTURE_PX), y);
    }
    let mut bytes = std::io::Cursor::new(Vec::new());
    sheet.write_to(&mut bytes, ImageFormat::Png).map_err(failed)?;
    Ok(Some(Artifact { name: "contact_sheet.png".to_owned(), bytes: bytes.into_inner() }))
}

/// A mask of either kind of ids in the colours of its classes.
fn mask_colours(mask: &image::GrayImage) -> RgbImage {
    let replicator = mask.pixels().any(|pixel| matches!(pixel.0[0], 3 | 4));
    let label_ids = if replicator { LabelIds::Replicator } else { LabelIds::Canonical };
    let colour = |id: u8| {
        let class = ClassId::ALL.iter().find(|class| label_ids.mask_id(class.id.0) == id);
        class.map_or([0; 3], |class| class.preview_rgb)
    };
    RgbImage::from_fn(mask.width(), mask.height(), |x, y| Rgb(colour(mask.get_pixel(x, y).0[0])))
}

/// The numbers of a line that differ from frame to frame: knobs, shares of the classes, brightness.
fn numbers(line: &Map<String, Value>) -> impl Iterator<Item = (String, f64)> {
    let section = |prefix: &'static str, name: &str| {
        let entries = line.get(name).and_then(Value::as_object).into_iter().flatten();
        entries.filter_map(move |(key, value)| Some((format!("{prefix}{key}"), value.as_f64()?)))
    };
    section("", "knobs").chain(section("share of ", "coverage")).chain(section("RGB ", "rgb"))
}

/// Histograms of every knob that varies, of the classes' shares and of the brightness.
///
/// # Errors
/// Those of reading.
pub fn histograms(lines: &dyn FrameLines) -> Result<Artifact> {
    let mut ranges: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    let mut order: Vec<String> = Vec::new();
    lines.for_each(&mut |line| {
        for (name, value) in numbers(&line) {
            let range = ranges.entry(name.clone()).or_insert_with(|| {
                order.push(name);
                [value; 2]
            });
            *range = [range[0].min(value), range[1].max(value)];
        }
        Ok(())
    })?;
    order.retain(|name| ranges[name][0] < ranges[name][1]);
    let mut counts: BTreeMap<String, [u64; BARS]> = BTreeMap::new();
    lines.for_each(&mut |line| {
        for (name, value) in numbers(&line) {
            let [low, high] = ranges[&name];
            if low < high {
                let bar = ((value - low) / (high - low) * BARS as f64) as usize;
                counts.entry(name).or_default()[bar.min(BARS - 1)] += 1;
            }
        }
        Ok(())
    })?;
    let charts = order.iter().map(|name| (name.as_str(), ranges[name], &counts[name]));
    Ok(Artifact { name: "histograms.svg".to_owned(), bytes: charts_svg(charts.collect()).into_bytes() })
}

/// Bar charts in rows of four, each with its name and its ends.
fn charts_svg(charts: Vec<(&str, [f64; 2], &[u64; BARS])>) -> String {
    const COLUMNS: usize = 4;
    const WIDTH: usize = 240;
    const HEIGHT: usize = 130;
    const CHART_HEIGHT: f64 = 80.0;
    const BAR_WIDTH: usize = 9;
    let rows = charts.len().div_ceil(COLUMNS).max(1);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        COLUMNS * WIDTH,
        rows * HEIGHT
    );
    for (place, (name, [low, high], counts)) in charts.into_iter().enumerate() {
        let (x, y) = (place % COLUMNS * WIDTH + 12, place / COLUMNS * HEIGHT + 16);
        let _ =
            writeln!(svg, "<g transform=\"translate({x} {y})\">\n<text font-weight=\"bold\">{name}</text>");
        let most = counts.iter().copied().max().unwrap_or(1).max(1);
        for (bar, count) in counts.iter().enumerate() {
            let height = CHART_HEIGHT * *count as f64 / most as f64;
            let _ = writeln!(
                svg,
                "<rect x=\"{}\" y=\"{:.1}\" width=\"{}\" height=\"{height:.1}\" fill=\"#44628c\"/>",
                bar * BAR_WIDTH,
                8.0 + CHART_HEIGHT - height,
                BAR_WIDTH - 1
            );
        }
        let _ = writeln!(
            svg,
            "<text y=\"102\">{}</text><text x=\"{}\" y=\"102\" text-anchor=\"end\">{}</text>\n</g>",
            short(low),
            BARS * BAR_WIDTH,
            short(high)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// A number with four digits or so.
fn short(value: f64) -> String {
    let digits = if value.abs() >= 100.0 {
        0
    } else if value.abs() >= 1.0 {
        2
    } else {
        4
    };
    format!("{value:.digits$}")
}
