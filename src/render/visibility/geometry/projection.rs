//! From offsets from the eye to positions among the samples, with clipping at the near plane and the guard band.
//!
//! Must not know: meshes, what is drawn.

use std::ops::Range;

use glam::{Mat4, UVec2, Vec2, Vec3, Vec4};

use crate::render::raster::clip::clip_polygon;
use crate::render::raster::fixed_point::{GUARD_BAND_PX, SUBPIXEL_STEPS, SubpixelPoint};
use crate::render::raster::lanes::{VERTEX_BATCH, to_soa};
use crate::render::raster::setup::Interpolant;
use crate::render::settings::RenderSettings;
use crate::scene::camera::Camera;
use crate::scene::mesh::Vertex;

/// Clip matrix and viewport, as a device applies them, with one pixel per sample.
#[derive(Clone, Debug)]
pub(super) struct Projection {
    pub(super) clip_from_offset: Mat4,
    pub(super) half_size: Vec2,
    /// The same in sub-pixel steps.
    half_steps: [i32; 2],
    /// Columns of samples.
    pub(super) width: usize,
    /// Rows of samples.
    pub(super) rows: Range<i32>,
    pub(super) near_m: f32,
    /// The guard band over half the image size: clip coordinates within it, times w, can be rounded to sub-pixel steps.
    guard_band: Vec2,
}

/// A vertex in homogeneous clip coordinates, before clipping and the perspective division.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClipVertex {
    /// x and y, rows running down.
    pub(super) xy: Vec2,
    /// Depth along the optical axis, metres.
    pub(super) w: f32,
    pub(super) normal: Vec3,
    /// Its index among the vertices of the mesh, if it is one that needs no clipping.
    pub(super) index: Option<u32>,
}

/// A projected vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScreenVertex {
    /// Among the samples.
    pub position: SubpixelPoint,
    /// The same before it was rounded, samples from the centre of the first.
    pub position_px: Vec2,
    /// Inverse depth along the optical axis, 1/m; 0 of a vertex that needs clipping and has no position: nearer than the near
    /// plane, or outside the guard band.
    pub inverse_w: f32,
    /// Its normal times that.
    pub normal_per_w: Vec3,
}

impl ScreenVertex {
    /// The attributes that are linear over the image: inverse depth, and the normal times that.
    #[must_use]
    #[inline(always)]
    pub fn attributes(&self) -> [f32; 4] {
        let [x, y, z] = self.normal_per_w.to_array();
        [self.inverse_w, x, y, z]
    }
}

impl Projection {
    pub(super) fn new(camera: &Camera, settings: &RenderSettings) -> Self {
        let size = settings.sample_size();
        let half_size = 0.5 * UVec2::from(size).as_vec2();
        Self {
            clip_from_offset: camera.clip_from_offset(settings.size),
            half_size,
            half_steps: size.map(|side| side as i32 * (SUBPIXEL_STEPS / 2)),
            width: size[0] as usize,
            rows: 0..size[1] as i32,
            near_m: camera.near_m,
            guard_band: GUARD_BAND_PX / half_size,
        }
    }

    /// Clip x, y (rows running down) and w of an offset from the eye.
    #[inline]
    pub(super) fn clip_coordinates(&self, offset: Vec3) -> (Vec2, f32) {
        let clip = self.clip_from_offset * offset.extend(1.0);
        (Vec2::new(clip.x, -clip.y), clip.w)
    }

    /// Projects up to [`VERTEX_BATCH`] vertices of a surface at `origin`, metres from the eye: the same as [`Self::project`], but
    /// all 0 for a vertex that needs clipping.
    // `inline(always)`, so that `dispatch!` compiles it for each vector width.
    #[inline(always)]
    pub(super) fn project_batch(&self, origin: Vec3, vertices: &[Vertex], projected: &mut Vec<ScreenVertex>) {
        let [x_row, y_row, _, w_row] = [0, 1, 2, 3].map(|row| self.clip_from_offset.row(row));
        let ([half_x, half_y], [half_x_steps, half_y_steps]) = (self.half_size.to_array(), self.half_steps);
        let [x, y, z] = to_soa(vertices.iter().map(|v| v.position));
        let [normal_x, normal_y, normal_z] = to_soa(vertices.iter().map(|v| v.normal));
        let mut positions = [[0; VERTEX_BATCH]; 2];
        let mut values = [[0.0; VERTEX_BATCH]; 6];
        for i in 0..VERTEX_BATCH {
            let offset = [origin.x + x[i], origin.y + y[i], origin.z + z[i]];
            let (x, y, w) = (transform(x_row, offset), -transform(y_row, offset), transform(w_row, offset));
            let is_inside =
                (w >= self.near_m) & (x.abs() <= self.guard_band.x * w) & (y.abs() <= self.guard_band.y * w);
            let inverse_w = 1.0 / w;
            let (x, y) = (x * inverse_w * half_x + half_x, y * inverse_w * half_y + half_y);
            // Beyond the guard band they may overflow, and are not used.
            let column = SubpixelPoint::steps(x - 0.5 - half_x).wrapping_add(half_x_steps);
            let row = SubpixelPoint::steps(y - 0.5 - half_y).wrapping_add(half_y_steps);
            positions[0][i] = if is_inside { column } else { 0 };
            positions[1][i] = if is_inside { row } else { 0 };
            values[0][i] = if is_inside { x - 0.5 } else { 0.0 };
            values[1][i] = if is_inside { y - 0.5 } else { 0.0 };
            values[2][i] = if is_inside { inverse_w } else { 0.0 };
            values[3][i] = if is_inside { inverse_w * normal_x[i] } else { 0.0 };
            values[4][i] = if is_inside { inverse_w * normal_y[i] } else { 0.0 };
            values[5][i] = if is_inside { inverse_w * normal_z[i] } else { 0.0 };
        }
        projected.extend((0..vertices.len().min(VERTEX_BATCH)).map(|i| ScreenVertex {
            position: SubpixelPoint { x: positions[0][i], y: positions[1][i] },
            position_px: Vec2::new(values[0][i], values[1][i]),
            inverse_w: values[2][i],
            normal_per_w: Vec3::new(values[3][i], values[4][i], values[5][i]),
        }));
    }

    /// Perspective division and viewport transform of a vertex beyond the near plane and within the guard band.
    #[inline]
    pub(super) fn project(&self, xy: Vec2, w: f32, normal: Vec3) -> ScreenVertex {
        let inverse_w = 1.0 / w;
        let position_px = xy * inverse_w * self.half_size + self.half_size;
        // Rounded relative to the image centre, which puts the whole guard band in range.
        let SubpixelPoint { x, y } = SubpixelPoint::rounded(position_px - 0.5 - self.half_size);
        let [half_x, half_y] = self.half_steps;
        let position = SubpixelPoint { x: x + half_x, y: y + half_y };
        ScreenVertex { position, position_px: position_px - 0.5, inverse_w, normal_per_w: inverse_w * normal }
    }

    /// The interpolants of 1/w and of the normal over w for a triangle that may reach behind the eye (Olano and Greer 1997,
    /// "Triangle Scan Conversion using 2D Homogeneous Coordinates", section 3). They count from the first sample of the image.
    /// None of a triangle that is seen edge-on.
    pub(super) fn homogeneous_interpolants(&self, triangle: [ClipVertex; 3]) -> Option<[Interpolant; 4]> {
        let half = self.half_size.as_dvec2();
        let [a, b, c] = triangle.map(|v| {
            let (xy, w) = (v.xy.as_dvec2(), f64::from(v.w));
            (xy * half + w * (half - 0.5)).extend(w)
        });
        let (cofactor_a, cofactor_b, cofactor_c) = (b.cross(c), c.cross(a), a.cross(b));
        let determinant = a.dot(cofactor_a);
        let interpolant = |values: [f32; 3]| {
            let [at_a, at_b, at_c] = values.map(f64::from);
            let [per_column, per_row, first] = ((at_a * cofactor_a + at_b * cofactor_b + at_c * cofactor_c)
                / determinant)
                .as_vec3()
                .to_array();
            Interpolant { first, per_column, per_row }
        };
        let normals = triangle.map(|v| v.normal);
        let axes = [|n: Vec3| n.x, |n: Vec3| n.y, |n: Vec3| n.z];
        let [x, y, z] = axes.map(|axis| interpolant(normals.map(axis)));
        (determinant != 0.0).then_some([interpolant([1.0; 3]), x, y, z])
    }

    /// Whether a triangle lies wholly nearer than the near plane or wholly beside the image.
    pub(super) fn is_outside_frustum(&self, triangle: &[ClipVertex; 3]) -> bool {
        let side_planes: [fn(&ClipVertex) -> f32; 4] =
            [|v| v.w - v.xy.x, |v| v.w + v.xy.x, |v| v.w - v.xy.y, |v| v.w + v.xy.y];
        triangle.iter().all(|v| v.w < self.near_m)
            || side_planes.iter().any(|distance| triangle.iter().all(|v| distance(v) < 0.0))
    }

    /// The part of a triangle beyond the near plane and within the guard band: a convex polygon, or nothing.
    pub(super) fn clip_triangle(&self, triangle: [ClipVertex; 3]) -> Vec<ClipVertex> {
        let guard_band = self.guard_band;
        let distances: [&dyn Fn(&ClipVertex) -> f32; 5] = [
            &|v| v.w - self.near_m,
            &|v| guard_band.x * v.w - v.xy.x,
            &|v| guard_band.x * v.w + v.xy.x,
            &|v| guard_band.y * v.w - v.xy.y,
            &|v| guard_band.y * v.w + v.xy.y,
        ];
        let interpolate = |inner: &ClipVertex, outer: &ClipVertex, t: f32| ClipVertex {
            xy: inner.xy + t * (outer.xy - inner.xy),
            w: inner.w + t * (outer.w - inner.w),
            normal: inner.normal + t * (outer.normal - inner.normal),
            index: None,
        };
        distances
            .iter()
            .fold(triangle.to_vec(), |polygon, distance| clip_polygon(&polygon, distance, interpolate))
    }
}

/// A row of a matrix times an offset, summed in the order of the product with the whole matrix.
#[inline(always)]
fn transform(row: Vec4, [x, y, z]: [f32; 3]) -> f32 {
    row.x * x + row.y * y + row.z * z + row.w
}
