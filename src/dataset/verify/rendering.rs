//! A sample of frames, rendered again and compared.
//!
//! Must not know: the folder's other files.

use std::path::Path;

use super::context::{self, Context};
use super::depth;
use super::report::{Report, name};
use crate::dataset::log::FrameLog;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::meta;
use crate::output::disk;
use crate::output::layout::FrameLine;
use crate::params::config::Config;
use crate::render::Renderer;
use crate::scene::Scene;

/// Tolerances for a frame that another adapter or raster backend rendered; on the same ones nothing may differ.
mod other_renderer {
    /// Largest fraction of a mask's pixels that may differ (at outlines).
    pub(super) const MASK_FRACTION: f64 = 2e-3;
    /// Largest mean difference of the 8-bit RGB values (from rounding).
    pub(super) const MEAN_RGB: f64 = 1.0;
}

/// Renders a sample of frames again, spread evenly over the dataset, compares them with what is stored, and checks their
/// depth. Adds to the report.
///
/// # Errors
/// Those of reading the manifest and the log; those of a device that no longer works.
pub fn check_rendering(
    folder: &Path,
    renderer: &mut Renderer,
    sample: u64,
    report: &mut Report,
) -> Result<()> {
    let manifest = context::open(folder)?;
    let context = Context::new(folder, &manifest)?;
    let stride = (context.range.count / sample.max(1)).max(1);
    let mut lines = Vec::new();
    FrameLog::new(folder).for_each_result(&mut |line| {
        // Lines that cannot be read are already in the report.
        let Ok(line) = line else { return Ok(()) };
        let offset = line.index.saturating_sub(context.range.start);
        if offset.is_multiple_of(stride) && (lines.len() as u64) < sample {
            lines.push(line);
        }
        Ok(())
    })?;
    for line in &lines {
        if let Err(error) = check_frame(&context, line, renderer, report) {
            match error {
                Error::DeviceLost(_) | Error::Device(_) | Error::OutOfMemory => return Err(error),
                other => report.problem(name::RENDERING, Some(line.index), other.to_string()),
            }
        }
    }
    Ok(())
}

fn check_frame(
    context: &Context<'_>,
    line: &FrameLine,
    renderer: &mut Renderer,
    report: &mut Report,
) -> Result<()> {
    let mut config = Config::new();
    config.apply_json(&line.knobs, "frames.jsonl")?;
    let scene = Scene::build(line.seed, &config.draw(line.seed)?)?;
    check_scene(context, line, &scene, report);
    let Some(paths) = context.layout.image_and_mask(&line.split, line.index) else {
        return Ok(());
    };
    let (frame, _) = renderer.render(&scene, &context.settings)?;
    // Datasets of version 0.1 do not record the raster backend.
    let is_same_renderer = line.adapter == renderer.gpu().info.name
        && line.raster.as_deref().is_none_or(|raster| raster == renderer.raster().name());
    compare_images(context, line, &frame, &paths, is_same_renderer, report);
    let depth_file = line.hashes().find(|(path, _)| path.contains("distance_to_image_plane"));
    if let Some((path, _)) = depth_file {
        depth::check_depth(context, line, path, &scene, renderer, report)?;
    }
    Ok(())
}

/// The parts of the line that only the scene knows.
fn check_scene(context: &Context<'_>, line: &FrameLine, scene: &Scene, report: &mut Report) {
    let index = Some(line.index);
    let hash = scene.geometry_hash();
    report.expect(name::RENDERING, index, line.geometry_hash == hash, || {
        format!("frames.jsonl: geometry_hash should be {hash}, recorded is {}", line.geometry_hash)
    });
    let camera = meta::camera(&scene.camera, context.settings.size);
    report.expect(name::RENDERING, index, line.camera == camera, || {
        "frames.jsonl: camera is not that of its scene".to_owned()
    });
    report.expect(name::RENDERING, index, line.moved_rocks == scene.moved_rocks(), || {
        "frames.jsonl: moved_rocks is not that of its scene".to_owned()
    });
}

/// The stored image and mask against the rendered frame. Files that cannot be read are already in the report.
fn compare_images(
    context: &Context<'_>,
    line: &FrameLine,
    frame: &Frame,
    [rgb, mask]: &[String; 2],
    is_same_renderer: bool,
    report: &mut Report,
) {
    let index = Some(line.index);
    let decode = |path: &str| {
        let bytes = disk::read(&context.folder.join(path)).ok()?;
        Some(image::load_from_memory(&bytes).ok()?.as_bytes().to_vec())
    };
    let ids: Vec<u8> = context.edges.apply(frame).iter().map(|id| context.label_ids.mask_id(*id)).collect();
    if let Some(stored) = decode(mask) {
        let differing = stored.iter().zip(&ids).filter(|(a, b)| a != b).count();
        let allowed = if is_same_renderer { 0.0 } else { other_renderer::MASK_FRACTION * ids.len() as f64 };
        let is_good = stored.len() == ids.len() && differing as f64 <= allowed;
        report.expect(name::RENDERING, index, is_good, || {
            format!("{mask}: {differing} pixels come out as another class; allowed are {allowed:.0}")
        });
    }
    if let Some(stored) = decode(rgb) {
        let mean: f64 = stored.iter().zip(&frame.rgb).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>()
            / stored.len() as f64;
        let allowed = if is_same_renderer { 0.0 } else { other_renderer::MEAN_RGB };
        let is_good = stored.len() == frame.rgb.len() && mean <= allowed;
        report.expect(name::RENDERING, index, is_good, || {
            format!("{rgb}: its values differ by {mean:.3} on average; allowed is {allowed}")
        });
    }
}
