//! The ground at a batch of samples: positions, sizes of cells and samples, rays to the eye and to the sun.
//!
//! Everything is written for batches without branches, so that the compiler vectorises it where it is inlined.
//! Must not know: what is summed there.

use glam::Vec3;

use super::gbuffer::MAX_NORMAL_CODE;
use super::relief_bands::MIN_FACING;
use crate::render::device::shader_structs::ReliefView;
use crate::scene::relief::MIN_CELLS;

/// Samples whose slopes are summed together: as many as the widest vectors hold, so that relief and grains that none of them needs are
/// skipped as often as possible.
pub(super) const BATCH: usize = 16;
/// Largest cells of noise, distances between samples, that neither hide nor shadow the ground; from twice as large on they do in full.
pub(crate) const MIN_TESTED_SAMPLES: f32 = 3.0;
/// Largest horizontal way of a ray to the eye per metre that it rises: lower ones are taken for one of 7 degrees.
pub(crate) const MAX_EYE_WAY: f32 = 8.0;
/// The same of a ray to the sun, for 5 degrees.
pub(crate) const MAX_SUN_WAY: f32 = 11.0;
/// Added to the length of a way before one is divided by it.
pub(crate) const MIN_WAY: f32 = 1e-3;

/// Horizontal vectors, one a sample.
#[derive(Clone, Copy)]
pub(super) struct Vectors {
    pub(super) x: [f32; BATCH],
    pub(super) y: [f32; BATCH],
}

/// Samples of a row that belong to one band.
#[derive(Clone, Copy)]
pub(super) struct SampleBatch {
    pub(super) columns: [u32; BATCH],
    pub(super) inverse_depth: [f32; BATCH],
    pub(super) normal_x: [u32; BATCH],
    pub(super) normal_y: [u32; BATCH],
}

/// The ground at the samples of a batch: positions, metres from its centre; the size of the mesh's cells and the distance of samples
/// there, metres; and the factors on a size in [`mesh_share`](crate::scene::relief::mesh_share) and
/// [`sample_share`](super::relief_bands::sample_share).
pub(super) struct GroundBatch {
    pub(super) x: [f32; BATCH],
    pub(super) y: [f32; BATCH],
    pub(super) cell_m: [f32; BATCH],
    pub(super) sample_m: [f32; BATCH],
    pub(super) per_mesh: [f32; BATCH],
    pub(super) per_sample: [f32; BATCH],
    /// Distance of samples across the view, metres.
    pub(super) across_m: [f32; BATCH],
    /// Horizontal ways of rays to the eye and to the sun per metre that they rise above the mesh.
    pub(super) ways: [Vectors; 2],
    /// One over the lengths of these ways.
    pub(super) per_way: [[f32; BATCH]; 2],
    /// By how much a ray to the sun is higher if it starts a metre higher on the ray to the eye, metres: 0 if the two are one.
    pub(super) sun_lift: [f32; BATCH],
    /// How far the ray to the eye goes towards the sun per metre that it rises, metres: 0 if it goes away.
    pub(super) towards_sun: [f32; BATCH],
}

impl SampleBatch {
    /// Fills all samples behind the first `count` with the first.
    pub(super) fn pad(&mut self, count: usize) {
        for i in count..BATCH {
            self.columns[i] = self.columns[0];
            self.inverse_depth[i] = self.inverse_depth[0];
            self.normal_x[i] = self.normal_x[0];
            self.normal_y[i] = self.normal_y[0];
        }
    }
}

impl Default for SampleBatch {
    fn default() -> Self {
        Self { columns: [0; BATCH], inverse_depth: [0.0; BATCH], normal_x: [0; BATCH], normal_y: [0; BATCH] }
    }
}

impl GroundBatch {
    #[inline(always)]
    pub(super) fn new(
        view: &ReliefView,
        [corner, right, down]: [Vec3; 3],
        sun: Vec3,
        row: usize,
        batch: &SampleBatch,
    ) -> Self {
        let zeros = [0.0; BATCH];
        let mut ground = Self {
            x: zeros,
            y: zeros,
            cell_m: zeros,
            sample_m: zeros,
            per_mesh: zeros,
            per_sample: zeros,
            across_m: zeros,
            ways: [Vectors { x: zeros, y: zeros }; 2],
            per_way: [zeros; 2],
            sun_lift: zeros,
            towards_sun: zeros,
        };
        let sun_way = (sun.x * sun.x + sun.y * sun.y).sqrt();
        let row_start = corner + (row as f32 + 0.5) * down;
        for i in 0..BATCH {
            let (column, depth_m) = (batch.columns[i] as i32 as f32 + 0.5, 1.0 / batch.inverse_depth[i]);
            let x = (row_start.x + column * right.x) * depth_m;
            let y = (row_start.y + column * right.y) * depth_m;
            let z = (row_start.z + column * right.z) * depth_m;
            let [n_x, n_y, n_z] = octahedral_decode(batch.normal_x[i], batch.normal_y[i]);
            let (square, n_square) = (x * x + y * y + z * z, n_x * n_x + n_y * n_y + n_z * n_z);
            let facing = -(n_x * x + n_y * y + n_z * z) / (square * n_square).sqrt();
            // Samples lie further apart along the view than across it: the geometric mean of the two.
            let sample_m = view.sample_angle * (square / facing.clamp(MIN_FACING, 1.0)).sqrt();
            let distance = square.sqrt();
            ground.across_m[i] = view.sample_angle * distance;
            let n_len = n_square.sqrt();
            let per_up = 1.0 / if n_z > 0.1 * n_len { n_z } else { 0.1 * n_len };
            let (eye_x, eye_y) = (-x / distance, -y / distance);
            let eye_way = (eye_x * eye_x + eye_y * eye_y).sqrt();
            let per_rise = per_rise(facing * n_len * per_up, eye_way, MAX_EYE_WAY);
            ground.ways[0].x[i] = eye_x * per_rise;
            ground.ways[0].y[i] = eye_y * per_rise;
            ground.per_way[0][i] = 1.0 / (eye_way * per_rise + MIN_WAY);
            let sun_rise = (n_x * sun.x + n_y * sun.y + n_z * sun.z) * per_up;
            let per_rise = self::per_rise(sun_rise, sun_way, MAX_SUN_WAY);
            ground.ways[1].x[i] = sun.x * per_rise;
            ground.ways[1].y[i] = sun.y * per_rise;
            ground.per_way[1][i] = 1.0 / (sun_way * per_rise + MIN_WAY);
            let along = ground.ways[0].x[i] * ground.ways[1].x[i] + ground.ways[0].y[i] * ground.ways[1].y[i];
            let towards_sun = along * ground.per_way[1][i];
            ground.sun_lift[i] = 1.0 - towards_sun * ground.per_way[1][i];
            ground.towards_sun[i] = if towards_sun > 0.0 { towards_sun } else { 0.0 };
            let (x, y) = (view.eye_from_centre.x + x, view.eye_from_centre.y + y);
            let height = view.eye_height_m;
            ground.x[i] = x;
            ground.y[i] = y;
            let cell_m = view.cell_angle * (x * x + y * y + height * height).sqrt();
            ground.cell_m[i] = cell_m;
            ground.sample_m[i] = sample_m;
            ground.per_mesh[i] = 1.0 / (MIN_CELLS * cell_m);
            ground.per_sample[i] = 0.5 / sample_m;
        }
        ground
    }

    /// How much of relief of this size the mesh leaves out and samples can show, 0 to 1: the product of one less
    /// [`mesh_share`](crate::scene::relief::mesh_share) and [`sample_share`](super::relief_bands::sample_share) of samples that are closer by a
    /// factor.
    #[inline(always)]
    pub(super) fn share(&self, i: usize, size_m: f32, closer: f32) -> f32 {
        let left_out = 1.0 - (size_m * self.per_mesh[i] - 1.0).clamp(0.0, 1.0);
        left_out * (size_m * closer * self.per_sample[i] - 1.0).clamp(0.0, 1.0)
    }

    /// Share of waves of this size that may hide or shadow the ground, 0 to 1: none if samples would not show where.
    #[inline(always)]
    pub(super) fn tested_share(&self, i: usize, size_m: f32) -> f32 {
        (size_m * self.per_sample[i] * (2.0 / MIN_TESTED_SAMPLES) - 1.0).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
impl GroundBatch {
    /// Level ground at samples that follow each other towards the eye, whose rays have this way and lie so far apart across the view. The
    /// sun stands behind it, half a right angle high.
    pub(super) fn towards_eye(start: glam::Vec2, way: f32, across_m: f32, cell_m: f32) -> Self {
        let sample_m = across_m * (1.0 + way * way).sqrt().sqrt();
        let step_m = sample_m * sample_m / across_m;
        Self {
            x: [start.x; BATCH],
            y: std::array::from_fn(|i| start.y + step_m * i as f32),
            cell_m: [cell_m; BATCH],
            sample_m: [sample_m; BATCH],
            per_mesh: [1.0 / (MIN_CELLS * cell_m); BATCH],
            per_sample: [0.5 / sample_m; BATCH],
            across_m: [across_m; BATCH],
            ways: [way, 1.0].map(|way| Vectors { x: [0.0; BATCH], y: [way; BATCH] }),
            per_way: [[1.0 / way; BATCH], [1.0; BATCH]],
            sun_lift: [1.0 - way; BATCH],
            towards_sun: [way; BATCH],
        }
    }
}

/// One over how much a ray rises above the ground, `rise`, or over the least at which the horizontal part of the ray, `way`, is
/// `max_way` times as long.
#[inline(always)]
fn per_rise(rise: f32, way: f32, max_way: f32) -> f32 {
    let lowest = way / max_way;
    let lowest = if lowest > 1e-6 { lowest } else { 1e-6 };
    1.0 / if rise > lowest { rise } else { lowest }
}

/// A vector along the normal with these octahedral coordinates. CPU counterpart of the function in `common/octahedral.wgsl`, which
/// also normalises it.
#[inline(always)]
pub(super) fn octahedral_decode(code_x: u32, code_y: u32) -> [f32; 3] {
    const PER_CODE: f32 = 2.0 / MAX_NORMAL_CODE as f32;
    let p = (code_x & MAX_NORMAL_CODE) as i32 as f32 * PER_CODE - 1.0;
    let q = (code_y & MAX_NORMAL_CODE) as i32 as f32 * PER_CODE - 1.0;
    let z = 1.0 - p.abs() - q.abs();
    // The lower half of the octahedron is folded over the corners of the square.
    let fold = if z < 0.0 { -z } else { 0.0 };
    let x = if p >= 0.0 { p - fold } else { p + fold };
    let y = if q >= 0.0 { q - fold } else { q + fold };
    [x, y, z]
}
