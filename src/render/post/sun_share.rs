//! How much of the sun's disc the camera sees past terrain and rocks.
//! Must not know: images.

use glam::{Vec2, Vec3};

use crate::render::select::ground_blocks::{block_bounds, ground_blocks};
use crate::scene::Scene;

/// Points of the disc that are tested: a share is exact to about a thousandth.
const POINTS: u32 = 1024;
/// The golden angle, radians.
const GOLDEN_ANGLE: f32 = 2.399_963_2;
/// Least distance of an occluder along the ray, metres.
const MIN_ALONG_M: f32 = 0.05;

/// The disc as the eye sees it: its axes, and points on it in tangents of angles from its centre, with what is not hidden yet.
struct Disc {
    eye: Vec3,
    /// Right, up, towards the sun.
    axes: [Vec3; 3],
    tan_half_angle: f32,
    points: Vec<Vec2>,
}

impl Disc {
    /// Whether a sphere may hide a part of it.
    fn may_be_hidden_by(&self, centre: Vec3, radius_m: f32) -> bool {
        let offset = centre - self.eye;
        let along = offset.dot(self.axes[2]);
        let across = (offset - along * self.axes[2]).length();
        along > -radius_m && across < radius_m + self.tan_half_angle * (along + radius_m)
    }

    /// Removes the points that a triangle hides.
    fn hide_behind(&mut self, corners: [Vec3; 3]) {
        let [right, up, towards] = self.axes;
        let along = corners.map(|corner| (corner - self.eye).dot(towards));
        if along.iter().any(|along| *along < MIN_ALONG_M) {
            return;
        }
        let mut at = [Vec2::ZERO; 3];
        for ((at, corner), along) in at.iter_mut().zip(corners).zip(along) {
            let offset = corner - self.eye;
            *at = Vec2::new(offset.dot(right), offset.dot(up)) / along;
        }
        let [a, b, c] = at;
        let radius = Vec2::splat(self.tan_half_angle);
        if a.min(b).min(c).cmpgt(radius).any() || a.max(b).max(c).cmplt(-radius).any() {
            return;
        }
        let side = |from: Vec2, to: Vec2, point: Vec2| (to - from).perp_dot(point - from);
        self.points.retain(|&point| {
            let sides = [side(a, b, point), side(b, c, point), side(c, a, point)];
            !(sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0))
        });
    }
}

/// The share of the sun's disc that no terrain and no rock hides from the camera, 0 to 1.
#[must_use]
pub(super) fn visible_share(scene: &Scene) -> f64 {
    let [right, up] = scene.sun.right_and_up();
    let tan_half_angle = scene.sun.tan_half_angle();
    let point = |index: u32| {
        let radius = tan_half_angle * ((index as f32 + 0.5) / POINTS as f32).sqrt();
        let angle = GOLDEN_ANGLE * index as f32;
        radius * Vec2::new(libm::cosf(angle), libm::sinf(angle))
    };
    let points = (0..POINTS).map(point).collect();
    let axes = [right, up, scene.sun.direction];
    let mut disc = Disc { eye: scene.camera.eye, axes, tan_half_angle, points };
    let terrain = &scene.terrain;
    for ([columns, rows], &[low, high]) in ground_blocks(terrain).zip(block_bounds(terrain)) {
        if disc.may_be_hidden_by(0.5 * (low + high), 0.5 * low.distance(high)) {
            for triangle in terrain.block_triangles(columns, rows) {
                disc.hide_behind(triangle.map(|vertex| terrain.vertices[vertex as usize].position));
            }
        }
    }
    let rocks = scene.rocks.build_where(|rock| {
        let [low, high] = rock.centres;
        disc.may_be_hidden_by(0.5 * (low + high), rock.radius_m + 0.5 * low.distance(high))
    });
    for (_, rock) in rocks.iter().filter(|(_, rock)| rock.body.is_visible()) {
        for triangle in rock.triangles(rock.level) {
            disc.hide_behind(triangle.map(|vertex| rock.centre + rock.vertices[vertex as usize].position));
        }
    }
    disc.points.len() as f64 / f64::from(POINTS)
}
