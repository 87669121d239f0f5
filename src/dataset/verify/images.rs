//! A frame's images against their recorded size, classes and brightness.
//!
//! Must not know: rendering.

use serde_json::json;

use super::context::Context;
use super::report::{Report, Subject, name};
use super::store::StoredFile;
use super::templates::ExpectedFile;
use crate::class::ClassId;
use crate::frame::{Frame, RgbStatistics};
use crate::output::LabelIds;
use crate::output::edges::EdgePolicy;
use crate::output::layout::{FrameLine, Sample, coco};

/// What an image of a frame shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Rgb,
    Mask,
    Other,
}

fn role(context: &Context<'_>, line: &FrameLine, expected: &ExpectedFile) -> Role {
    let mask = context.plan.layout.image_and_mask(context.plan.split_of(line.index), line.index);
    match expected.kind {
        Some(kind) if kind.output == "rgb" => Role::Rgb,
        Some(kind) if kind.output == "mask" => Role::Mask,
        _ if mask.is_some_and(|[_, mask]| mask == expected.path) => Role::Mask,
        _ => Role::Other,
    }
}

/// Decodes a PNG file.
pub(super) fn decode_png(bytes: &[u8]) -> image::ImageResult<image::DynamicImage> {
    image::load_from_memory_with_format(bytes, image::ImageFormat::Png)
}

/// Width and height of an OpenEXR file, from its header.
pub(super) fn size_of_exr(bytes: &[u8]) -> Option<[u32; 2]> {
    let meta = exr::meta::MetaData::read_from_buffered(std::io::Cursor::new(bytes), true).ok()?;
    let size = meta.headers.first()?.layer_size;
    Some([u32::try_from(size.width()).ok()?, u32::try_from(size.height()).ok()?])
}

/// Decodes an OpenEXR file of RGB of this size: three values per pixel.
pub(super) fn decode_exr(bytes: &[u8], size: [u32; 2]) -> Option<Vec<f32>> {
    use exr::prelude::{ReadChannels as _, ReadLayers as _};
    // A damaged header may ask for any amount of memory.
    if size_of_exr(bytes) != Some(size) {
        return None;
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| (size.width(), vec![0.0_f32; 3 * size.area()]),
            |(width, values), at, (r, g, b): (f32, f32, f32)| {
                let first = 3 * (at.y() * *width + at.x());
                values[first..first + 3].copy_from_slice(&[r, g, b]);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(std::io::Cursor::new(bytes))
        .ok()?;
    Some(image.layer_data.channel_data.pixels.1)
}

/// Decodes a PNG file and checks it; the RGB image and the mask in detail.
pub(super) fn check_image(
    context: &Context<'_>,
    line: &FrameLine,
    expected: &ExpectedFile,
    stored: &StoredFile,
    report: &mut Report,
) {
    let (subject, path) = (Subject::File(line.index), &stored.path);
    report.look(name::IMAGES);
    let decoded = match decode_png(&stored.bytes) {
        Ok(decoded) => decoded,
        Err(error) => {
            return report.problem(name::IMAGES, subject, format!("{path}: it cannot be decoded ({error})"));
        }
    };
    let template = decode_png(&expected.template).map(|image| image.color()).ok();
    let (size, colour_type) = ([decoded.width(), decoded.height()], decoded.color());
    let expected_size = context.plan.settings.size;
    if size != expected_size || template.is_some_and(|template| template != colour_type) {
        let [width, height] = size;
        let found = format!(
            "{path}: it is {width} x {height} pixels of {colour_type:?}, expected are {expected_size:?} of {template:?}"
        );
        return report.problem(name::IMAGES, subject, found);
    }
    match role(context, line, expected) {
        Role::Rgb => {
            let statistics = RgbStatistics::of(decoded.as_bytes());
            report.expect(name::STATISTICS, subject, line.rgb == statistics, || {
                format!("{path}: its brightness is {}, recorded is {}", json!(statistics), json!(line.rgb))
            });
        }
        Role::Mask => check_mask(context, line, path, context.plan.label_ids, decoded.as_bytes(), report),
        Role::Other => {
            if let Some(frame) = context.plan.layout.decode_labels(&expected.path, &decoded) {
                check_mask(context, line, path, LabelIds::default(), &frame.class, report);
                check_entry(context, line, path, &frame, report);
            }
        }
    }
}

/// Checks what the layout keeps in the line against the labels that it is made from.
fn check_entry(context: &Context<'_>, line: &FrameLine, path: &str, frame: &Frame, report: &mut Report) {
    let files = context.plan.layout.frame_files(&Sample { frame, files: &[], record: line });
    let is_good = files.is_ok_and(|files| match context.plan.edges {
        EdgePolicy::Hard => files.entry == line.entry,
        EdgePolicy::Ignore(_) => coco::contains_segments(&line.entry, &files.entry),
    });
    report.expect(name::RECORDS, Subject::Line(line.index), is_good, || {
        format!("frames.jsonl: entry is not that of the labels in {path}")
    });
}

/// Checks which ids a mask has, and how many pixels of each class.
fn check_mask(
    context: &Context<'_>,
    line: &FrameLine,
    path: &str,
    label_ids: LabelIds,
    ids: &[u8],
    report: &mut Report,
) {
    let subject = Subject::File(line.index);
    let mut counts = [0_u64; 256];
    for id in ids {
        counts[usize::from(*id)] += 1;
    }
    let ignored = label_ids.mask_id(ClassId::UNLABELLED.0);
    let is_class = |id: u8| ClassId::ALL.iter().any(|class| label_ids.mask_id(class.id.0) == id);
    let is_hard = context.plan.edges == EdgePolicy::Hard;
    // Pixels that the label rule ignores; a band at the edges of classes adds to them.
    let by_rule = line.coverage_of("ignored").unwrap_or_default();
    let may_ignore = !is_hard || by_rule > 0.0;
    let unknown: Vec<u8> = (0..=u8::MAX)
        .filter(|&id| counts[usize::from(id)] > 0 && !is_class(id) && !(may_ignore && id == ignored))
        .collect();
    report.expect(name::MASKS, subject, unknown.is_empty(), || {
        format!("{path}: it has pixels of ids {unknown:?}")
    });
    let actual = counts[usize::from(ignored)] as f64 / ids.len() as f64;
    // Lines of version 0.1 have the fractions before the band alone.
    let is_exact = is_hard || !line.mask_coverage.is_empty();
    let recorded = line.mask_coverage_of("ignored").unwrap_or_default();
    let is_good = actual >= by_rule && (!is_exact || actual == recorded);
    report.expect(name::MASKS, subject, is_good, || {
        format!("{path}: {actual:.6} of it is ignored, recorded is {recorded:.6}")
    });
    for class in ClassId::ALL {
        let actual = counts[usize::from(label_ids.mask_id(class.id.0))] as f64 / ids.len() as f64;
        let recorded = line.mask_coverage_of(class.name);
        // A band of ignored pixels takes some from every class.
        let before = line.coverage_of(class.name);
        let is_good =
            before.is_some_and(|before| actual <= before) && (!is_exact || recorded == Some(actual));
        report.expect(name::MASKS, subject, is_good, || {
            let recorded =
                recorded.map_or_else(|| "no value".to_owned(), |fraction| format!("{fraction:.6}"));
            format!("{path}: {} covers {actual:.6} of it, recorded is {recorded}", class.name)
        });
    }
}
