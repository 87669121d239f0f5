//! Labels of the rocks in a frame: visible and exposed pixels, bounding box, size.
//!
//! Pixels and boxes are counted in the frame; [`super::amodal`] counts the pixels of each rock without its occluders.
//! Must not know: how rocks were drawn.

use rayon::prelude::*;

use super::amodal::AmodalView;
use crate::frame::{Frame, LabelReason, RockLabel};
use crate::render::select::frustum::Frustum;
use crate::render::select::selection::visible_level;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::rocks::Rock;

/// Labels of the rocks that have a pixel in the frame, in ascending order of instance id. `scene` and `drawn` are those that were
/// drawn, which with a lens have a wider field of view than the image.
pub(crate) fn rocks(
    scene: &Scene,
    drawn: &RenderSettings,
    image_size: [u32; 2],
    frame: &Frame,
) -> Vec<RockLabel> {
    let mut labels: Vec<Option<RockLabel>> = vec![None; scene.rocks.len()];
    for (pixel, &instance) in (0..).zip(&frame.instances).filter(|(_, instance)| **instance > 0) {
        let rock = usize::from(instance) - 1;
        let label = labels[rock].get_or_insert_with(|| empty_label(&scene.rocks[rock], scene));
        let (x, y): (u32, u32) = (pixel % frame.width, pixel / frame.width);
        let [left, top, right, bottom] = label.box_px;
        label.visible_px += 1;
        label.box_px = [left.min(x), top.min(y), right.max(x), bottom.max(y)];
    }
    let view = AmodalView::new(scene, drawn, image_size);
    let frustum = Frustum::new(&scene.camera.clip_from_world(drawn.size));
    labels.par_iter_mut().enumerate().for_each(|(rock, label)| {
        if let Some(label) = label {
            let level = visible_level(scene, drawn, &frustum, &scene.rocks[rock]);
            label.exposed_px = view.exposed_px(rock, level);
        }
    });
    labels.into_iter().flatten().collect()
}

/// The label of a rock before its pixels are counted.
fn empty_label(rock: &Rock, scene: &Scene) -> RockLabel {
    RockLabel {
        instance: (rock.index + 1) as u16,
        visible_px: 0,
        exposed_px: 0,
        box_px: [u32::MAX, u32::MAX, 0, 0],
        height_m: rock.centre.z + rock.z_range_m[1] - scene.terrain.surface_height_at(rock.centre.truncate()),
        diameter_m: rock.diameter_m(),
        reason: LabelReason::Rock,
    }
}
