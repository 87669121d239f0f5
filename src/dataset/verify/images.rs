//! A frame's images against their recorded size, classes and brightness.
//!
//! Must not know: rendering.

use serde_json::json;

use super::context::Context;
use super::report::{Report, name};
use crate::class::ClassId;
use crate::frame::RgbStatistics;
use crate::output::edges::EdgePolicy;
use crate::output::layout::FrameLine;

/// Decodes a PNG file and checks it; the RGB image and the mask in detail.
pub(super) fn check_image(
    context: &Context<'_>,
    line: &FrameLine,
    path: &str,
    bytes: &[u8],
    report: &mut Report,
) {
    let index = Some(line.index);
    let [rgb, mask] = context.layout.image_and_mask(&line.split, line.index).unwrap_or_default();
    let decoded = match image::load_from_memory_with_format(bytes, image::ImageFormat::Png) {
        Ok(decoded) => decoded,
        Err(error) => {
            report.look(name::IMAGES);
            return report.problem(name::IMAGES, index, format!("{path}: it cannot be decoded ({error})"));
        }
    };
    let (size, colour_type) = ([decoded.width(), decoded.height()], decoded.color());
    let expected_type = if path == rgb {
        Some(image::ColorType::Rgb8)
    } else if path == mask {
        Some(image::ColorType::L8)
    } else {
        None
    };
    let is_good = size == context.settings.size
        && expected_type.is_none_or(|expected_type| expected_type == colour_type);
    report.expect(name::IMAGES, index, is_good, || {
        let expected = context.settings.size;
        format!("{path}: it is {} x {} pixels of {colour_type:?}, not {expected:?}", size[0], size[1])
    });
    if !is_good {
        return;
    }
    if path == mask {
        check_mask(context, line, path, decoded.as_bytes(), report);
    } else if path == rgb {
        let statistics = RgbStatistics::of(decoded.as_bytes());
        report.expect(name::STATISTICS, index, line.rgb == statistics, || {
            format!("{path}: its brightness is {}, recorded is {}", json!(statistics), json!(line.rgb))
        });
    }
}

/// Checks which ids a mask has, and how many pixels of each class.
fn check_mask(context: &Context<'_>, line: &FrameLine, path: &str, ids: &[u8], report: &mut Report) {
    let index = Some(line.index);
    let mut counts = [0_u64; 256];
    for id in ids {
        counts[usize::from(*id)] += 1;
    }
    let ignored = context.label_ids.mask_id(ClassId::UNLABELLED.0);
    let is_class = |id: u8| ClassId::ALL.iter().any(|class| context.label_ids.mask_id(class.id.0) == id);
    let is_hard = context.edges == EdgePolicy::Hard;
    let unknown: Vec<u8> = (0..=u8::MAX)
        .filter(|&id| counts[usize::from(id)] > 0 && !is_class(id) && (is_hard || id != ignored))
        .collect();
    report.expect(name::MASKS, index, unknown.is_empty(), || {
        format!("{path}: it has pixels of ids {unknown:?}")
    });
    for class in ClassId::ALL {
        let actual = counts[usize::from(context.label_ids.mask_id(class.id.0))] as f64 / ids.len() as f64;
        let recorded = line.coverage_of(class.name);
        // A band of ignored pixels takes some from every class.
        let is_good =
            recorded.is_some_and(|recorded| if is_hard { actual == recorded } else { actual <= recorded });
        report.expect(name::MASKS, index, is_good, || {
            let recorded =
                recorded.map_or_else(|| "no value".to_owned(), |fraction| format!("{fraction:.6}"));
            format!("{path}: {} covers {actual:.6} of it, recorded is {recorded}", class.name)
        });
    }
}
