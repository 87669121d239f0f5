//! A star-shaped body bounded by fracture planes, with scars, a crack and relief, and its surface on an icosphere.
//!
//! The surface is a positive, bounded distance from the centre in every direction, by construction: it cannot overlap itself, and no
//! triangle faces inwards.
//! Must not know: how a rock is drawn, where it lies.

use arrayvec::ArrayVec;
use fearless_simd::{Level, dispatch};
use glam::Vec3;

use crate::scene::mesh::Icosphere;
use crate::scene::noise::Fbm;

/// Vertices per batch: few enough for the intermediate values to stay in the first-level cache.
const BATCH: usize = 128;
/// Least level with cracks: coarser triangles are wider than a crack.
const CRACK_LEVEL: usize = 4;
/// Range of a rock's radius, relative to the ellipsoid of its axes.
const RADIUS_RANGE: [f32; 2] = [0.22, 1.9];
/// Largest relative change of the radius by scars, cracks and relief.
const MAX_RELIEF: f32 = 0.30;
/// Octaves of relief per icosphere level: down to waves of about two edges.
const RELIEF_OCTAVES: [u32; Icosphere::MAX_LEVEL + 1] = [0, 0, 1, 2, 3, 4];

/// A plane that cuts a body: points `p` with `gauge . p <= 1` remain.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fracture {
    /// Outward normal over the distance from the centre.
    pub(super) gauge: Vec3,
    /// Width of the worn edge, in units of the gauge.
    pub(super) wear: f32,
}

impl Fracture {
    pub(super) fn new(normal: Vec3, distance: f32, wear: f32) -> Self {
        Self { gauge: normal / distance, wear }
    }

    /// The same plane as seen from another centre, at least `min` in front of it.
    pub(super) fn recentred(self, centre: Vec3, min: f32) -> Self {
        let length = self.gauge.length();
        let normal = self.gauge / length;
        Self::new(normal, (1.0 / length - normal.dot(centre)).max(min), self.wear)
    }
}

/// A shallow hollow that a chip left behind: a paraboloid with a sharp rim.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scar {
    /// Unit vector from the rock's centre.
    pub(super) towards: Vec3,
    /// Depth, relative to the radius.
    pub(super) depth: f32,
    /// 1 / (1 - cosine of its angular radius).
    pub(super) sharpness: f32,
}

/// An open crack: a wedge along a plane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crack {
    pub(super) normal: Vec3,
    pub(super) offset: f32,
    pub(super) depth: f32,
    pub(super) half_width: f32,
}

/// A form, in units of its longest half axis, which lies along x, the shortest along z.
#[derive(Clone, Debug)]
pub(super) struct Form {
    /// Half axes.
    pub(super) axes: Vec3,
    /// Reach of the ellipsoid that bounds the body, half axes.
    pub(super) reach: f32,
    /// The planes of the body, at most as many as can be drawn; those from `ledge` on bound a second body, joined to the first.
    pub(super) planes: ArrayVec<Fracture, 13>,
    pub(super) ledge: usize,
    /// Smaller planes that cut edges and corners off both.
    pub(super) chips: ArrayVec<Fracture, 14>,
    pub(super) scars: ArrayVec<Scar, 6>,
    pub(super) crack: Option<Crack>,
    pub(super) lumps: (Fbm, f32),
    pub(super) relief: (Fbm, f32),
    pub(super) domain_offset: Vec3,
}

impl Form {
    /// Calls `visit` with the index and the position of each vertex of an icosphere level, in order. Relief is added as far as the level can
    /// hold it.
    pub(super) fn for_each_position(&self, level: usize, mut visit: impl FnMut(usize, Vec3)) {
        let count = Icosphere::vertex_count(level);
        for first in (0..count).step_by(BATCH) {
            let end = count.min(first + BATCH);
            let directions = Icosphere::shared().axes.each_ref().map(|axis| &axis[first..end]);
            let mut batch = [Vec3::ZERO; BATCH];
            let positions = &mut batch[..end - first];
            dispatch!(Level::new(), _simd => self.set_positions(level, directions, positions));
            (first..end).zip(positions).for_each(|(vertex, position)| visit(vertex, *position));
        }
    }

    // Must be inlined into the dispatched code to be compiled for its SIMD width.
    #[inline(always)]
    fn set_positions(&self, level: usize, directions: [&[f32]; 3], positions: &mut [Vec3]) {
        let n = positions.len();
        let (mut x, mut y, mut z) = ([0.0; BATCH], [0.0; BATCH], [0.0; BATCH]);
        let (mut radii, mut changes) = ([0.0; BATCH], [0.0; BATCH]);
        // Directions are spread over the ellipsoid of the axes, so that triangles of a slab are no thinner than those of a ball.
        for i in 0..n {
            let p = [
                directions[0][i] * self.axes.x,
                directions[1][i] * self.axes.y,
                directions[2][i] * self.axes.z,
            ];
            radii[i] = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            let per_length = 1.0 / radii[i];
            (x[i], y[i], z[i]) = (p[0] * per_length, p[1] * per_length, p[2] * per_length);
        }
        let v = [&x[..n], &y[..n], &z[..n]];
        let mut gauges = [0.0; BATCH];
        for (gauge, ellipsoid) in gauges[..n].iter_mut().zip(&radii) {
            *gauge = 1.0 / (ellipsoid * self.reach);
        }
        let mut body = gauges;
        let ledge = self.ledge.min(self.planes.len());
        raise(&mut body[..n], v, &self.planes[..ledge]);
        if ledge < self.planes.len() {
            let mut second = gauges;
            raise(&mut second[..n], v, &self.planes[ledge..]);
            for (body, second) in body[..n].iter_mut().zip(&second) {
                *body = -smooth_max(-*body, -*second, 0.04);
            }
        }
        raise(&mut body[..n], v, &self.chips);
        for i in 0..n {
            radii[i] = clamp(1.0 / body[i], RADIUS_RANGE[0] * radii[i], RADIUS_RANGE[1] * radii[i]);
        }
        self.add_relief(level, v, &radii[..n], &mut changes[..n]);
        for (radius, change) in radii[..n].iter_mut().zip(&changes) {
            *radius *= 1.0 + clamp(*change, -MAX_RELIEF, MAX_RELIEF);
        }
        for (i, position) in positions.iter_mut().enumerate() {
            *position = Vec3::new(radii[i] * x[i], radii[i] * y[i], radii[i] * z[i]);
        }
    }

    /// Adds the relative changes of the radius by scars, lumps, relief and crack.
    #[inline(always)]
    fn add_relief(&self, level: usize, [x, y, z]: [&[f32]; 3], radii: &[f32], changes: &mut [f32]) {
        let n = radii.len();
        for Scar { towards, depth, sharpness } in &self.scars {
            for (i, change) in changes.iter_mut().enumerate() {
                let cosine = towards.x * x[i] + towards.y * y[i] + towards.z * z[i];
                *change -= depth * positive(1.0 - sharpness * (1.0 - cosine));
            }
        }
        let octaves = RELIEF_OCTAVES[level];
        if octaves == 0 {
            return;
        }
        let mut points = [[0.0; BATCH]; 3];
        for i in 0..n {
            points[0][i] = radii[i] * x[i] + self.domain_offset.x;
            points[1][i] = radii[i] * y[i] + self.domain_offset.y;
            points[2][i] = radii[i] * z[i] + self.domain_offset.z;
        }
        let mut sums = [0.0; BATCH];
        for ((fbm, amount), octaves) in [(self.lumps, octaves.min(2)), (self.relief, octaves)] {
            let [px, py, pz] = &points;
            Fbm { octaves, ..fbm }.set_at_many_3d([&px[..n], &py[..n], &pz[..n]], &mut sums[..n]);
            // Octaves halve in amplitude, and their sum is in [-1, 1] for any number of them.
            let amount = amount * (2.0 - 2.0 / (1_u32 << octaves) as f32);
            for (change, sum) in changes.iter_mut().zip(&sums) {
                *change += amount * sum;
            }
        }
        if let Some(Crack { normal, offset, depth, half_width }) = self.crack.filter(|_| level >= CRACK_LEVEL)
        {
            for (i, change) in changes.iter_mut().enumerate() {
                let across = radii[i] * (normal.x * x[i] + normal.y * y[i] + normal.z * z[i]) - offset;
                *change -= depth * positive(1.0 - across.abs() / half_width);
            }
        }
    }
}

/// Cuts a body, given as the inverse of its radius in each direction, by planes.
#[inline(always)]
fn raise(inverse_radii: &mut [f32], [x, y, z]: [&[f32]; 3], planes: &[Fracture]) {
    for Fracture { gauge, wear } in planes {
        for (i, inverse) in inverse_radii.iter_mut().enumerate() {
            let along = gauge.x * x[i] + gauge.y * y[i] + gauge.z * z[i];
            *inverse = smooth_max(*inverse, along, *wear);
        }
    }
}

/// The larger of two numbers, rounded off where they differ by less than `width` (the quadratic form of Quilez, "Smooth minimum").
/// It is convex and does not decrease in either: a body that planes cut is as convex with worn edges as with sharp ones.
#[inline(always)]
fn smooth_max(a: f32, b: f32, width: f32) -> f32 {
    let overlap = positive(width - (a - b).abs());
    (if a > b { a } else { b }) + overlap * overlap * (0.25 / width)
}

#[inline(always)]
fn positive(x: f32) -> f32 {
    if x > 0.0 { x } else { 0.0 }
}

#[inline(always)]
fn clamp(x: f32, low: f32, high: f32) -> f32 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}
