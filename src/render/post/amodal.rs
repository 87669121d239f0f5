//! Amodal masks of rocks: the pixels that a rock would have if nothing else occluded it.
//!
//! Each rock is rasterised alone, one sample at each pixel centre, from the triangles that the image shows.
//! Must not know: the frame's labels.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{DVec2, UVec2, Vec2, Vec3};

use crate::render::raster::clip::clip_polygon;
use crate::render::raster::cull::Winding;
use crate::render::raster::fill::FragmentSink;
use crate::render::raster::fixed_point::{GUARD_BAND_PX, SUBPIXEL_STEPS, SubpixelPoint};
use crate::render::raster::lanes::{BLOCK_HEIGHT, BLOCK_WIDTH, load_block, store_block};
use crate::render::raster::setup::{Interpolant, TriangleSetup};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::mesh::Icosphere;

/// The view of a frame that its amodal masks share.
pub(super) struct AmodalView<'a> {
    scene: &'a Scene,
    /// Columns and rows of the image.
    size: [u32; 2],
    focal_px: f32,
    /// The principal point: the middle of the image.
    centre_px: Vec2,
    /// Largest magnitudes of x/z and y/z that are projected, in camera axes: the guard band of a pinhole, or what a lens is
    /// known to be invertible for.
    max_slope: Vec2,
}

/// A vertex in the image.
#[derive(Clone, Copy, Debug)]
struct ImageVertex {
    /// From the corner of the image.
    position_px: Vec2,
    /// The same, rounded, from the centre of the first pixel.
    position: SubpixelPoint,
    /// Along the optical axis, 1/m.
    inverse_depth: f32,
}

impl<'a> AmodalView<'a> {
    /// Scene and settings are those that were drawn; with a lens their field of view is wider than that of the image.
    pub(super) fn new(scene: &'a Scene, drawn: &RenderSettings, image_size: [u32; 2]) -> Self {
        let camera = &scene.camera;
        let focal_px = camera.focal_px(drawn.size[0]) as f32;
        let max_slope = if camera.lens.is_pinhole() {
            Vec2::splat(GUARD_BAND_PX / focal_px)
        } else {
            0.5 * UVec2::from(drawn.size).as_vec2() / focal_px
        };
        let centre_px = 0.5 * UVec2::from(image_size).as_vec2();
        Self { scene, size: image_size, focal_px, centre_px, max_slope }
    }

    /// The number of pixels whose centre shows the rock at an index above the ground, were it alone, by the level that the image shows
    /// of it.
    pub(super) fn exposed_px(&self, rock: usize, visible_level: Option<usize>) -> u32 {
        let rock = &self.scene.rocks[rock];
        let level = visible_level.unwrap_or(rock.level).min(rock.level);
        let camera = &self.scene.camera;
        let vertices: Vec<Vec3> = rock.vertices[..Icosphere::vertex_count(level)]
            .iter()
            .map(|vertex| to_camera(camera, rock.centre + vertex.position - camera.eye))
            .collect();
        let projected: Vec<Option<ImageVertex>> =
            vertices.iter().map(|&vertex| self.is_inside(vertex).then(|| self.project(vertex))).collect();
        let Some(mut mask) = AmodalMask::around(&projected, self.size) else { return 0 };
        dispatch!(Level::new(), simd => {
            for triangle in rock.triangles(level) {
                if let [Some(a), Some(b), Some(c)] = triangle.map(|v| projected[v as usize]) {
                    mask.add(simd, [a, b, c]);
                } else {
                    let polygon = self.clip_triangle(triangle.map(|v| vertices[v as usize]));
                    let polygon: Vec<ImageVertex> = polygon.into_iter().map(|v| self.project(v)).collect();
                    for i in 2..polygon.len() {
                        mask.add(simd, [polygon[0], polygon[i - 1], polygon[i]]);
                    }
                }
            }
        });
        self.count_above_ground(&mask)
    }

    /// Signed distances of a point in camera axes from the near plane and from the sides of the view; not negative inside.
    fn clip_distances(&self) -> [impl Fn(&Vec3) -> f32; 5] {
        let (near_m, slope) = (self.scene.camera.near_m, self.max_slope);
        let planes = [
            (Vec3::Z, near_m),
            (Vec3::new(-1.0, 0.0, slope.x), 0.0),
            (Vec3::new(1.0, 0.0, slope.x), 0.0),
            (Vec3::new(0.0, -1.0, slope.y), 0.0),
            (Vec3::new(0.0, 1.0, slope.y), 0.0),
        ];
        planes.map(|(normal, offset_m)| move |point: &Vec3| normal.dot(*point) - offset_m)
    }

    /// Whether a point in camera axes can be projected.
    fn is_inside(&self, point: Vec3) -> bool {
        self.clip_distances().iter().all(|distance| distance(&point) >= 0.0)
    }

    /// The part of a triangle that can be projected: a convex polygon, or nothing.
    fn clip_triangle(&self, triangle: [Vec3; 3]) -> Vec<Vec3> {
        let interpolate = |inner: &Vec3, outer: &Vec3, t: f32| *inner + t * (*outer - *inner);
        self.clip_distances()
            .iter()
            .fold(triangle.to_vec(), |polygon, distance| clip_polygon(&polygon, distance, interpolate))
    }

    /// Projects a point in camera axes, through the lens.
    fn project(&self, point: Vec3) -> ImageVertex {
        let lens = &self.scene.camera.lens;
        let slope = point.truncate() / point.z;
        let slope = if lens.is_pinhole() {
            slope
        } else {
            DVec2::from(lens.distort(slope.as_dvec2().to_array())).as_vec2()
        };
        let from_centre_px = self.focal_px * slope;
        // Rounded relative to the image centre, which puts the whole guard band in range.
        let SubpixelPoint { x, y } = SubpixelPoint::rounded(from_centre_px);
        // From there to the centre of the first pixel.
        let [right, down] = self.size.map(|side| (side as i32 - 1) * (SUBPIXEL_STEPS / 2));
        ImageVertex {
            position_px: self.centre_px + from_centre_px,
            position: SubpixelPoint { x: x + right, y: y + down },
            inverse_depth: 1.0 / point.z,
        }
    }

    /// The pixels of a mask whose point on the rock lies above the ground.
    fn count_above_ground(&self, mask: &AmodalMask) -> u32 {
        let camera = &self.scene.camera;
        let mut count = 0;
        for (row, inverse_depths) in mask.rows().enumerate() {
            for (column, &inverse_depth) in inverse_depths.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                let pixel = mask.origin.as_vec2() + Vec2::new(column as f32, row as f32) + 0.5;
                let slope = (pixel - self.centre_px) / self.focal_px;
                let slope = if camera.lens.is_pinhole() {
                    slope
                } else {
                    DVec2::from(camera.lens.undistort(slope.as_dvec2().to_array())).as_vec2()
                };
                let ray = camera.forward + slope.x * camera.right - slope.y * camera.up;
                let point = camera.eye + ray / inverse_depth;
                count += u32::from(point.z > self.scene.terrain.surface_height_at(point.truncate()));
            }
        }
        count
    }
}

/// An offset from the eye in camera axes: x right, y down, z forward.
fn to_camera(camera: &Camera, offset: Vec3) -> Vec3 {
    Vec3::new(offset.dot(camera.right), -offset.dot(camera.up), offset.dot(camera.forward))
}

/// The inverse depth of the nearest front face at each pixel of a rectangle of the image.
struct AmodalMask {
    /// First column and row of the rectangle.
    origin: UVec2,
    /// Columns and rows of the rectangle.
    size: [usize; 2],
    /// Pixels from one row to the next, and 1/m; 0 where no face is.
    stride: usize,
    inverse_depth: Vec<f32>,
}

impl AmodalMask {
    /// An empty mask around projected vertices, or of the whole image if some need clipping; none if it has no pixels.
    fn around(projected: &[Option<ImageVertex>], image_size: [u32; 2]) -> Option<Self> {
        let limit = UVec2::from(image_size).as_vec2();
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for vertex in projected {
            let (first, last) = vertex.map_or((Vec2::ZERO, limit), |v| (v.position_px, v.position_px));
            (low, high) = (low.min(first), high.max(last));
        }
        let origin = low.floor().clamp(Vec2::ZERO, limit).as_uvec2();
        let end = high.ceil().clamp(Vec2::ZERO, limit).as_uvec2();
        if end.x <= origin.x || end.y <= origin.y {
            return None;
        }
        let size = (end - origin).to_array().map(|side| side as usize);
        let stride = size[0] + BLOCK_WIDTH;
        Some(Self { origin, size, stride, inverse_depth: vec![0.0; stride * (size[1] + BLOCK_HEIGHT)] })
    }

    /// Adds a triangle, unless it is a back face.
    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, triangle: [ImageVertex; 3]) {
        let origin = self.origin.as_ivec2() * SUBPIXEL_STEPS;
        let positions =
            triangle.map(|v| SubpixelPoint { x: v.position.x - origin.x, y: v.position.y - origin.y });
        if Winding::of(positions) != Some(Winding::Front) {
            return;
        }
        let [columns, rows] = self.size;
        let Some(setup) = TriangleSetup::new(positions, columns, &(0..rows as i32)) else { return };
        let first_centre_px = self.origin.as_vec2() + 0.5;
        let positions_px = triangle.map(|v| v.position_px - first_centre_px);
        let [a, b, c] = triangle.map(|v| v.inverse_depth);
        let [inverse_depth] = setup.interpolants(positions_px, [[a], [b], [c]]);
        let range = [a.min(b).min(c), a.max(b).max(c)];
        let mut nearest = NearestDepth { buffer: &mut self.inverse_depth, inverse_depth, range };
        setup.fill(simd, 0, self.stride, &mut nearest);
    }

    fn rows(&self) -> impl Iterator<Item = &[f32]> {
        let [columns, rows] = self.size;
        self.inverse_depth.chunks_exact(self.stride).take(rows).map(move |row| &row[..columns])
    }
}

/// Keeps the nearest depth at each pixel.
struct NearestDepth<'a> {
    buffer: &'a mut [f32],
    inverse_depth: Interpolant,
    /// Smallest and largest inverse depth of the vertices. A pixel centre that is inside only after positions were rounded is
    /// extrapolated to, far off if the triangle is a sliver.
    range: [f32; 2],
}

impl<S: Simd> FragmentSink<S> for NearestDepth<'_> {
    #[inline(always)]
    fn write(&mut self, simd: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let [farthest, nearest] = self.range.map(|inverse_depth| f32x8::splat(simd, inverse_depth));
        let inverse_depth = self.inverse_depth.at(x, y).max(farthest).min(nearest);
        let inverse_depth = covered.select(inverse_depth, f32x8::splat(simd, 0.0));
        let previous = load_block(simd, self.buffer, offsets);
        store_block(self.buffer, offsets, inverse_depth.max(previous));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;

    const SIZE: [u32; 2] = [96, 80];

    /// The nearest front face of a rock on a ray, beyond the near plane: inverse depth along the optical axis.
    fn cast_ray(camera: &Camera, ray: Vec3, triangles: &[[Vec3; 3]]) -> Option<f32> {
        let hit = |[a, b, c]: &[Vec3; 3]| {
            let normal = (b - a).cross(c - a);
            let (facing, distance) = (normal.dot(ray), normal.dot(*a));
            let is_inside =
                [(a, b), (b, c), (c, a)].iter().all(|(p, q)| p.cross(**q).dot(ray) * facing >= 0.0);
            let depth_m = distance / facing;
            (facing < 0.0 && is_inside && depth_m >= camera.near_m).then_some(1.0 / depth_m)
        };
        triangles.iter().filter_map(hit).max_by(f32::total_cmp)
    }

    /// Exposed pixels of a rock by ray casting, and the number of its triangles with corners on both sides of the near plane.
    fn by_ray_casting(scene: &Scene, index: usize, level: usize) -> (u32, usize) {
        let (rock, camera) = (&scene.rocks[index], &scene.camera);
        let corner = |v: u32| rock.centre + rock.vertices[v as usize].position - camera.eye;
        let triangles: Vec<[Vec3; 3]> = rock.triangles(level).iter().map(|t| t.map(corner)).collect();
        let is_near = |p: &Vec3| p.dot(camera.forward) < camera.near_m;
        let crossing = triangles.iter().filter(|t| t.iter().any(is_near) && !t.iter().all(is_near)).count();
        let focal_px = camera.focal_px(SIZE[0]) as f32;
        let mut count = 0;
        for row in 0..SIZE[1] {
            for column in 0..SIZE[0] {
                let pixel = Vec2::new(column as f32, row as f32) + 0.5;
                let slope = (pixel - 0.5 * UVec2::from(SIZE).as_vec2()) / focal_px;
                let ray = camera.forward + slope.x * camera.right - slope.y * camera.up;
                if let Some(inverse_depth) = cast_ray(camera, ray, &triangles) {
                    let point = camera.eye + ray / inverse_depth;
                    count += u32::from(point.z > scene.terrain.surface_height_at(point.truncate()));
                }
            }
        }
        (count, crossing)
    }

    #[test]
    fn exposed_pixels_agree_with_ray_casting_even_across_the_near_plane() {
        let mut scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new(SIZE, 1).expect("settings");
        let radius_m = |index: &usize| scene.rocks[*index].radius_m;
        let rocks = 0..scene.rocks.len();
        let index = rocks.max_by(|a, b| radius_m(a).total_cmp(&radius_m(b))).expect("a rock");
        let (centre, radius_m) = (scene.rocks[index].centre, radius_m(&index));
        let (mut total, mut crossings, mut wrong) = (0, 0, Vec::new());
        for level in [0, 1, 3] {
            for (beside, yaw_deg) in [(4.0, 90.0), (1.05, 60.0), (1.02, 20.0), (1.01, -10.0), (1.0, 120.0)] {
                let eye = centre + radius_m * Vec3::new(-beside, -0.1, 0.35);
                scene.camera = Camera::new(eye, [-5.0, yaw_deg, 10.0], 110.0, 2000.0, 0.0);
                let found = AmodalView::new(&scene, &settings, SIZE).exposed_px(index, Some(level));
                let (expected, crossing) = by_ray_casting(&scene, index, level);
                if found.abs_diff(expected) > 2 {
                    wrong.push((level, beside, yaw_deg, found, expected));
                }
                (total, crossings) = (total + expected, crossings + crossing);
            }
        }
        assert!(wrong.is_empty(), "level, radii beside, yaw, exposed pixels, by ray casting: {wrong:?}");
        assert!(total > 5000 && crossings > 50, "{total} pixels, {crossings} triangles cross the near plane");
    }
}
