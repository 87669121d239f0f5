//! The data card (`README.md`) of a finished dataset: classes, frames, splits, rules, knobs, licence.
//!
//! Must not know: how frames are made.

use std::fmt::Write as _;

use serde_json::{Map, Value};

use super::totals::Totals;
use crate::class::ClassId;
use crate::output::LabelIds;
use crate::output::layout::interface::AnnotationIds;

/// Smallest fraction that is not 0 in percent with two decimals.
const MIN_SHOWN: f64 = 5e-5;

fn text<'a>(manifest: &'a Map<String, Value>, key: &str) -> &'a str {
    manifest.get(key).and_then(Value::as_str).unwrap_or_default()
}

fn json(manifest: &Map<String, Value>, key: &str) -> String {
    manifest.get(key).map(ToString::to_string).unwrap_or_default()
}

/// The data card in Markdown, of a dataset with masks or with annotations that have these ids.
pub(super) fn markdown(
    manifest: &Map<String, Value>,
    totals: &Totals,
    annotated: Option<&AnnotationIds>,
) -> String {
    let mut card = format!(
        "# Labelled images of the Moon\n\n\
         {} of the lunar surface as a rover sees it, with the exact class of every pixel. Rendered by \
         regolith-render {} from base seed {}. The image and its mask are rendered together, so they match exactly.\n",
        if totals.frames == 1 {
            "1 synthetic frame".to_owned()
        } else {
            format!("{} synthetic frames", totals.frames)
        },
        text(manifest, "version"),
        json(manifest, "base_seed")
    );
    card += &classes(manifest, totals, annotated);
    card += &format!(
        "\n## Frames\n\n* Size: {} pixels. Samples per pixel: {}. Mask edges: {}.\n* Format: `{}`. Outputs: {}.\n\
         * `frames.jsonl` has one line per frame with its camera, sun and the value of every knob. Pixel (u, v) has its \
         centre at (u + 0.5, v + 0.5). World coordinates are in metres with Z up; `world_from_camera` uses OpenCV axes (x \
         right, y down, z forward).\n",
        json(manifest, "size").replace(',', " x ").replace(['[', ']'], ""),
        json(manifest, "samples"),
        text(manifest, "edges"),
        text(manifest, "format"),
        json(manifest, "outputs").replace(['[', ']', '"'], "").replace(',', ", ")
    );
    card += &splits(manifest);
    card += &rejected_attempts(manifest, totals);
    card += "\n## Knobs\n\n| knob | value or distribution |\n|---|---|\n";
    for (knob, distribution) in manifest.get("config").and_then(Value::as_object).into_iter().flatten() {
        // Writing into a string cannot fail.
        let _ = writeln!(card, "| `{knob}` | `{distribution}` |");
    }
    card += "\n## Licence\n\nregolith-render claims no rights in the images and labels. Whoever publishes them chooses their licence.\n";
    card
}

/// Ids, names and mean pixel fractions of the classes.
fn classes(manifest: &Map<String, Value>, totals: &Totals, annotated: Option<&AnnotationIds>) -> String {
    let (label_ids, weights) = (LabelIds::of_manifest(manifest), totals.class_weights());
    let mut section =
        "\n## Classes\n\n| id | class | mean share of pixels | weight in a loss |\n|---|---|---|---|\n"
            .to_owned();
    for (i, class) in ClassId::ALL.iter().enumerate() {
        let id = match annotated.map(|ids| ids.of_class[i]) {
            None => label_ids.mask_id(class.id.0).to_string(),
            Some(id) => id.map_or_else(|| "not annotated".to_owned(), |id| id.to_string()),
        };
        let percent = 100.0 * totals.mask_coverage(i);
        let _ = writeln!(section, "| {id} | {} | {percent:.2} % | {:.3} |", class.name, weights[i]);
    }
    let ignore_index = label_ids.mask_id(ClassId::UNLABELLED.0);
    let note = match label_ids {
        LabelIds::Canonical => {
            "Id 0 is a real class (regolith): leave options that \"reduce zero labels\" off, or it is erased."
        }
        LabelIds::Replicator => {
            "The ids are those of a Replicator pipeline; its id 0, BACKGROUND, occurs in no mask."
        }
    };
    let (by_rule, band) = (totals.ignored(), totals.mask_ignored() - totals.ignored());
    let parts = [
        (
            by_rule,
            "rocks that are too small or cannot be seen (`label.too_small`, `label.unseen`) and a visible rover",
        ),
        (band, "the band along the boundaries of classes (`--edges`)"),
    ];
    let parts = parts.iter().filter(|(share, _)| *share >= MIN_SHOWN);
    let parts: Vec<String> =
        parts.map(|(share, what)| format!("{what}, {:.2} % of the pixels", 100.0 * share)).collect();
    let _ = match (annotated, parts.as_slice()) {
        (Some(ids), []) => writeln!(section, "\n{} No pixel is to be ignored.", ids.note),
        (Some(ids), parts) => writeln!(section, "\n{} To be ignored are {}.", ids.note, parts.join(", and ")),
        (None, []) => {
            writeln!(section, "\n{ignore_index} is the ignore index. {note} No pixel carries {ignore_index}.")
        }
        (None, parts) => {
            let what = parts.join(", and for ");
            writeln!(
                section,
                "\n{ignore_index} is the ignore index. {note} {ignore_index} stands for {what}."
            )
        }
    };
    section
}

/// The splits and their seeds; empty for a dataset without splits.
fn splits(manifest: &Map<String, Value>) -> String {
    let splits = manifest.get("splits").and_then(Value::as_object).filter(|splits| !splits.is_empty());
    let Some(splits) = splits else { return String::new() };
    let mut section = "\n## Splits\n\n\
        No scene occurs in two splits: each split has its own range of scene seeds (inclusive, modulo 2^53), and a frame \
        that is rendered again takes a seed 2^32 further on.\n\n\
        | split | frames | first frame | seeds |\n|---|---|---|---|\n"
        .to_owned();
    for (name, split) in splits {
        let number = |key: &str| split.get(key).map(ToString::to_string).unwrap_or_default();
        let _ =
            writeln!(section, "| {name} | {} | {} | {} |", number("count"), number("start"), number("seeds"));
    }
    section
}

/// How often frames were rendered again, by rule.
fn rejected_attempts(manifest: &Map<String, Value>, totals: &Totals) -> String {
    let redraws: u64 = totals.redraws.values().sum();
    let mut section = format!(
        "\n## Rules\n\nA frame that breaks a rule is rendered again from another seed. This happened {redraws} times. The \
         rules: `{}`.\n",
        json(manifest, "rules")
    );
    for (rule, count) in &totals.redraws {
        let _ = writeln!(section, "* {rule}: {count}");
    }
    section
}
