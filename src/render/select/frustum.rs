//! View-frustum culling: conservative tests of bounding volumes against the camera's frustum.
//!
//! Real-Time Rendering (4th ed.), section 22.14. A test may accept a volume just outside of the frustum; it never rejects one that
//! intersects it.
//! Must not know: what the volumes bound.

use glam::{Mat4, Vec3, Vec4};

/// Five of the six planes of the view frustum: all but the far one, because the sky's dome lies in front of it.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    /// Unit normals that point inward; the signed distance of the origin, metres, in w.
    planes: [Vec4; 5],
}

impl Frustum {
    /// The frustum of a projection with reversed depth, its planes taken from the rows of the matrix (Gribb and Hartmann 2001).
    #[must_use]
    pub fn new(clip_from_world: &Mat4) -> Self {
        let row = |i| clip_from_world.row(i);
        let planes = [row(3) + row(0), row(3) - row(0), row(3) + row(1), row(3) - row(1), row(3) - row(2)];
        Self { planes: planes.map(|plane| plane / plane.truncate().length()) }
    }

    /// The planes left, right, bottom, top and near: unit normals that point inward; the signed distance of the origin in w.
    #[must_use]
    pub const fn planes(&self) -> [Vec4; 5] {
        self.planes
    }

    /// Whether no plane has all of a convex volume on its outer side. `support_m` is the signed distance from a plane to the point
    /// of the volume that lies furthest along its normal.
    pub fn intersects_convex(&self, support_m: impl Fn(Vec4) -> f32) -> bool {
        self.planes.iter().all(|&plane| support_m(plane) >= 0.0)
    }

    /// Whether a sphere may intersect the frustum.
    #[must_use]
    pub fn intersects_sphere(&self, centre: Vec3, radius_m: f32) -> bool {
        self.intersects_swept_sphere(centre, centre, radius_m)
    }

    /// Whether a sphere that moves from `start` to `end`, a capsule, may intersect the frustum.
    #[must_use]
    pub fn intersects_swept_sphere(&self, start: Vec3, end: Vec3, radius_m: f32) -> bool {
        self.intersects_convex(|plane| {
            plane.dot(start.extend(1.0)).max(plane.dot(end.extend(1.0))) + radius_m
        })
    }

    /// Whether an axis-aligned box may intersect the frustum.
    #[must_use]
    pub fn intersects_box(&self, low: Vec3, high: Vec3) -> bool {
        self.intersects_convex(|plane| {
            let corner = Vec3::select(plane.truncate().cmpge(Vec3::ZERO), high, low);
            plane.dot(corner.extend(1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;

    #[test]
    fn frustum_accepts_what_is_in_view_and_rejects_what_is_outside() {
        let camera = Camera::new(Vec3::new(0.0, -90.0, 2.0), [0.0, 0.0, 0.0], 60.0, 2000.0, 0.0);
        let frustum = Frustum::new(&camera.clip_from_world([64, 64]));
        let at = |x: f32, y: f32| Vec3::new(x, y, 2.0);
        assert!(frustum.intersects_sphere(at(0.0, 0.0), 0.1));
        assert!(!frustum.intersects_sphere(at(0.0, -100.0), 1.0));
        assert!(!frustum.intersects_sphere(at(80.0, -50.0), 1.0));
        assert!(frustum.intersects_sphere(at(24.0, -50.0), 2.0), "just outside, but its side is in view");
        assert!(frustum.intersects_swept_sphere(at(80.0, -50.0), at(0.0, -50.0), 1.0));
        assert!(frustum.intersects_box(at(-1.0, -80.0), at(1.0, -70.0)));
        assert!(!frustum.intersects_box(at(-1.0, -130.0), at(1.0, -110.0)));
    }
}
