//! What is told of each rock in a picture: its pixels, its box, how much of it other things hide.
//!
//! The first two are counted in the frame. The last needs what the rock would cover if it stood alone, which a small
//! rasteriser finds at the pixels' centres from the triangles that were drawn.

use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::frame::{Frame, RockLabel};
use crate::render::select::selection::{SelectedRock, Selection};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::rocks::Rock;

/// The rocks that have a pixel in the frame, by rising instance id. Scene and settings are those that were drawn, the size that
/// of the picture.
pub(crate) fn rocks(
    scene: &Scene,
    settings: &RenderSettings,
    picture_size: [u32; 2],
    frame: &Frame,
) -> Vec<RockLabel> {
    let mut seen: Vec<Option<RockLabel>> = vec![None; scene.rocks.len()];
    for (pixel, &instance) in (0..).zip(&frame.instances).filter(|(_, instance)| **instance > 0) {
        let rock = usize::from(instance) - 1;
        let label = seen[rock].get_or_insert_with(|| label(&scene.rocks[rock], scene));
        let (x, y): (u32, u32) = (pixel % frame.width, pixel / frame.width);
        let [left, top, right, bottom] = label.box_px;
        label.visible_px += 1;
        label.box_px = [left.min(x), top.min(y), right.max(x), bottom.max(y)];
    }
    let selection = Selection::new(scene, settings);
    let exposed: Vec<(usize, u32)> = selection
        .rocks
        .par_iter()
        .filter(|selected| seen[selected.rock].is_some())
        .map(|selected| (selected.rock, exposed_px(scene, settings, picture_size, selected)))
        .collect();
    for (rock, exposed_px) in exposed {
        seen[rock].iter_mut().for_each(|label| label.exposed_px = exposed_px);
    }
    seen.into_iter().flatten().collect()
}

/// What is told of a rock before its pixels are counted.
fn label(rock: &Rock, scene: &Scene) -> RockLabel {
    RockLabel {
        instance: (rock.index + 1) as u16,
        visible_px: 0,
        exposed_px: 0,
        box_px: [u32::MAX, u32::MAX, 0, 0],
        height_m: rock.centre.z + rock.z_range_m[1] - scene.terrain.surface_height_at(rock.centre.truncate()),
        diameter_m: rock.diameter_m(),
    }
}

/// Pixels whose centre sees the rock, were it alone on its ground.
fn exposed_px(
    scene: &Scene,
    settings: &RenderSettings,
    picture_size: [u32; 2],
    selected: &SelectedRock,
) -> u32 {
    let rock = &scene.rocks[selected.rock];
    let camera = &scene.camera;
    let [width, height] = picture_size;
    let focal = camera.focal_px(settings.size[0]) as f32;
    let centre_px = 0.5 * Vec2::new(width as f32, height as f32);
    // Picture coordinates and inverse depth of every vertex; nothing for one behind the near plane.
    let projected: Vec<Option<Vec3>> = rock
        .vertices
        .iter()
        .map(|vertex| {
            let offset = rock.centre + vertex.position - camera.eye;
            let depth_m = offset.dot(camera.forward);
            (depth_m > camera.near_m).then(|| {
                let across = Vec2::new(offset.dot(camera.right), -offset.dot(camera.up)) / depth_m;
                let across = if camera.lens.is_pinhole() {
                    across
                } else {
                    DVec2::from(camera.lens.distort(across.as_dvec2().to_array())).as_vec2()
                };
                (centre_px + focal * across).extend(1.0 / depth_m)
            })
        })
        .collect();
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for point in projected.iter().flatten() {
        low = low.min(point.truncate());
        high = high.max(point.truncate());
    }
    let limit = Vec2::new(width as f32, height as f32);
    let first = low.floor().clamp(Vec2::ZERO, limit).as_uvec2();
    let last = high.ceil().clamp(Vec2::ZERO, limit).as_uvec2();
    if last.x <= first.x || last.y <= first.y {
        return 0;
    }
    let columns = (last.x - first.x) as usize;
    let mut nearest = vec![0.0_f32; columns * (last.y - first.y) as usize];
    let level = selected.visible_level.unwrap_or(rock.level);
    for triangle in rock.triangles(level) {
        let [Some(a), Some(b), Some(c)] = triangle.map(|v| projected[v as usize]) else { continue };
        rasterise([a, b, c], first, last, |x, y, inverse_depth| {
            let cell = &mut nearest[(y - first.y) as usize * columns + (x - first.x) as usize];
            *cell = cell.max(inverse_depth);
        });
    }
    let mut count = 0;
    for (cell, &inverse_depth) in
        nearest.iter().enumerate().filter(|(_, inverse_depth)| **inverse_depth > 0.0)
    {
        let pixel =
            Vec2::new(first.x as f32 + (cell % columns) as f32, first.y as f32 + (cell / columns) as f32)
                + 0.5;
        let across = (pixel - centre_px) / focal;
        let across = if camera.lens.is_pinhole() {
            across
        } else {
            DVec2::from(camera.lens.undistort(across.as_dvec2().to_array())).as_vec2()
        };
        let ray = camera.forward + across.x * camera.right - across.y * camera.up;
        let place = camera.eye + ray / inverse_depth;
        count += u32::from(place.z > scene.terrain.surface_height_at(place.truncate()));
    }
    count
}

/// Calls `cover` with every pixel whose centre lies in the triangle and the inverse depth there.
fn rasterise(
    triangle: [Vec3; 3],
    first: glam::UVec2,
    last: glam::UVec2,
    mut cover: impl FnMut(u32, u32, f32),
) {
    let [a, b, c] = triangle;
    let edge = |p: Vec2, q: Vec2, at: Vec2| (q - p).perp_dot(at - p);
    let [pa, pb, pc] = triangle.map(Vec3::truncate);
    let area = edge(pa, pb, pc);
    // Counter-clockwise seen from outside is clockwise on a picture whose rows run down: faces turned away are left.
    if area >= 0.0 {
        return;
    }
    let low = pa.min(pb).min(pc).floor().max(first.as_vec2()).as_uvec2();
    let high = pa.max(pb).max(pc).ceil().min(last.as_vec2()).as_uvec2();
    for y in low.y..high.y {
        for x in low.x..high.x {
            let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let weights = [edge(pb, pc, at), edge(pc, pa, at), edge(pa, pb, at)].map(|w| w / area);
            if weights.iter().all(|weight| *weight >= 0.0) {
                cover(x, y, weights[0] * a.z + weights[1] * b.z + weights[2] * c.z);
            }
        }
    }
}
