//! Grains of the soil in a batch of samples, summed on the host: the nearest that each ray to the eye meets, and the shadows of those
//! towards the sun.
//!
//! CPU counterpart of `add_grains` in `shaders/common/grains.wgsl`, equal to it but for rounding. Rays are followed through the cells of a
//! lattice for all samples at once, without branches; the few that come close to a grain are finished one by one.
//! Must not know: where the sums go.

use glam::Vec2;

use super::grain_texture_host::{GrainSurface, MOTTLING};
use super::ground_batch::{BATCH, Vectors};
use super::relief_bands::sample_share;
use crate::render::device::shader_structs::LatticeUniforms;

use crate::scene::craters::second_hash;
use crate::scene::grains::{
    CLOD_SPREAD, Grain, GrainMaterial, JITTER_CELLS, MAX_HEIGHT, MAX_RADIUS, grain_diameter,
};
use crate::scene::noise::lattice_hash;

/// Cells of a lattice that a ray is followed through.
pub(crate) const MAX_CELLS: u32 = 5;
/// Share of the ground's own slope that a grain's surface has.
pub(crate) const ROUGHNESS: f32 = 0.8;

/// What grains need to know of the ground at the samples of a batch.
pub(super) struct GrainGround {
    /// The first samples count, the others repeat them.
    pub(super) count: usize,
    /// Position, metres from the centre of the ground.
    pub(super) point: Vectors,
    /// Distance of samples across the view, metres.
    pub(super) across_m: [f32; BATCH],
    /// Horizontal ways of rays to the eye and to the sun per metre that they rise above the mesh.
    pub(super) ways: [Vectors; 2],
    /// Half the width of the sun's penumbra per metre of way.
    pub(super) sun_tan_half_angle: f32,
    /// What grains are made of.
    pub(super) material: GrainMaterial,
}

/// The ground's detail, one value a sample.
pub(super) struct GroundDetail {
    /// Slope relative to the mesh, rise per metre.
    pub(super) slope: Vectors,
    /// Factor on the albedo.
    pub(super) albedo: [f32; BATCH],
    /// Fraction of the sun's disc that grains leave visible.
    pub(super) sun: [f32; BATCH],
    /// The nearest grain so far that the ray to the eye met; its height is that of its point.
    pub(super) nearest: [GrainSurface; BATCH],
    /// How much of the sample grains hide of the ground.
    pub(super) cover: [f32; BATCH],
    /// That times the fraction of the sun's disc that is visible from them.
    pub(super) cover_sun: [f32; BATCH],
}

/// Rays of a batch on their way through the cells of a lattice.
struct Walks {
    column: [i32; BATCH],
    row: [i32; BATCH],
    /// The start of the ray, cells from the corner of the cell that it is in.
    start: Vectors,
    /// Where it enters the next column and the next row, as fractions of its length, and the steps from one to the next.
    next: Vectors,
    step: Vectors,
    sign: Vectors,
    sign_column: [i32; BATCH],
    sign_row: [i32; BATCH],
    /// Horizontal way per metre that it rises, metres along the lattice's axes, and the inverse of its square.
    way: Vectors,
    per_square: [f32; BATCH],
    /// The first two hashes of a cell, where the ray comes near its grain, else 0.
    near: [u8; BATCH],
    first: [u32; BATCH],
    second: [u32; BATCH],
}

/// Distance of a ray that has ended from all grains, cells.
const AWAY_CELLS: f32 = 1e3;
/// Smallest square of a way whose inverse is taken.
const MIN_SQUARE: f32 = 1e-12;

impl Walks {
    #[inline(always)]
    fn new(uniforms: &LatticeUniforms, ground: &GrainGround, ways: &Vectors) -> Self {
        let zeros = Vectors { x: [0.0; BATCH], y: [0.0; BATCH] };
        let mut walks = Self {
            column: [0; BATCH],
            row: [0; BATCH],
            start: zeros,
            next: zeros,
            step: zeros,
            sign: zeros,
            sign_column: [0; BATCH],
            sign_row: [0; BATCH],
            way: zeros,
            per_square: [0.0; BATCH],
            near: [0; BATCH],
            first: [0; BATCH],
            second: [0; BATCH],
        };
        let lattice = uniforms.lattice();
        let (cos, sin) = (lattice.turn.x * uniforms.cell_m, lattice.turn.y * uniforms.cell_m);
        let cells = MAX_HEIGHT * uniforms.max_diameter_m / uniforms.cell_m;
        for i in 0..BATCH {
            let point = Vec2::new(ground.point.x[i], ground.point.y[i]);
            let ([column, row], [u, v]) = lattice.cell(lattice.local(point));
            (walks.column[i], walks.row[i]) = (column, row);
            (walks.start.x[i], walks.start.y[i]) = (u, v);
            let x = cos * ways.x[i] + sin * ways.y[i];
            let y = cos * ways.y[i] - sin * ways.x[i];
            (walks.way.x[i], walks.way.y[i]) = (x, y);
            let square = x * x + y * y;
            walks.per_square[i] = 1.0 / if square > MIN_SQUARE { square } else { MIN_SQUARE };
            let (step_x, next_x, sign_x) = first_step(cells * x, u);
            let (step_y, next_y, sign_y) = first_step(cells * y, v);
            (walks.step.x[i], walks.step.y[i]) = (step_x, step_y);
            (walks.next.x[i], walks.next.y[i]) = (next_x, next_y);
            (walks.sign.x[i], walks.sign.y[i]) = (sign_x, sign_y);
            walks.sign_column[i] = if x > 0.0 { 1 } else { -1 };
            walks.sign_row[i] = if y > 0.0 { 1 } else { -1 };
        }
        walks
    }

    /// Finds the rays that come near the grain of the cell that they are in: within `blur` distances of samples of its largest radius. Returns
    /// whether any does.
    #[inline(always)]
    fn find_near(&mut self, uniforms: &LatticeUniforms, across_m: &[f32; BATCH], blur: f32) -> bool {
        // Most cells have no grain.
        let mut exist = 0_u32;
        for i in 0..BATCH {
            self.first[i] = lattice_hash(self.column[i], self.row[i], 0, uniforms.seed);
            exist |= if has_grain(uniforms, self.first[i]) { 1 } else { 0 };
        }
        if exist == 0 {
            return false;
        }
        let mut any = 0;
        for (i, across_m) in across_m.iter().enumerate() {
            let first = self.first[i];
            let second = second_hash(first);
            let jitter =
                |bits: u32| ((bits & 0x3ff) as i32 as f32 * (1.0 / 512.0) - 1.0) * JITTER_CELLS + 0.5;
            let x = (self.start.x[i] - jitter(second)) * uniforms.cell_m;
            let y = (self.start.y[i] - jitter(second >> 10)) * uniforms.cell_m;
            let diameter_m = grain_diameter(second, uniforms.max_diameter_m);
            let (way_x, way_y) = (self.way.x[i], self.way.y[i]);
            let along = -(x * way_x + y * way_y) * self.per_square[i];
            // `clamp` would not vectorise: it asserts.
            let along = if along > 0.0 { along } else { 0.0 };
            let top = MAX_HEIGHT * diameter_m;
            let along = if along < top { along } else { top };
            let (x, y) = (x + along * way_x, y + along * way_y);
            let reach = MAX_RADIUS * diameter_m + blur * across_m;
            let is_near =
                has_grain(uniforms, first) & (x * x + y * y < reach * reach) & (diameter_m > 2.0 * across_m);
            let near = if is_near { 1 } else { 0 };
            self.near[i] = near;
            any |= near;
            self.second[i] = second;
        }
        any > 0
    }

    /// The rays that come near a grain, of the first `count`.
    #[inline(always)]
    fn near_below(&self, count: usize) -> impl Iterator<Item = usize> {
        let bits = |(k, bytes): (usize, &[u8; 8])| {
            // Eight flags in as many bits: each byte is moved to its place in the highest one.
            let byte = u64::from_le_bytes(*bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56;
            byte << (8 * k)
        };
        let mut bits = self.near.as_chunks().0.iter().enumerate().map(bits).fold(0, |a, b| a | b);
        std::iter::from_fn(move || {
            let i = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            (i < count).then_some(i)
        })
    }

    /// Moves all rays into their next cells. Returns whether any ray gets there; one that has ended stays away from all grains.
    #[inline(always)]
    fn advance(&mut self) -> bool {
        let mut ended = u32::MAX;
        for i in 0..BATCH {
            let (next_x, next_y) = (self.next.x[i], self.next.y[i]);
            let to_column = if next_x < next_y { u32::MAX } else { 0 };
            let first = if next_x < next_y { next_x } else { next_y };
            let has_ended = if first >= 1.0 { u32::MAX } else { 0 };
            ended &= has_ended;
            // Bits of floats, or none: selections in the form that vectorises.
            let kept = |value: f32, mask: u32| f32::from_bits(value.to_bits() & mask);
            self.column[i] = self.column[i].wrapping_add(self.sign_column[i] & to_column as i32);
            self.row[i] = self.row[i].wrapping_add(self.sign_row[i] & !to_column as i32);
            // Far from anything where the ray has ended.
            let away = kept(AWAY_CELLS, has_ended);
            self.start.x[i] += away - kept(self.sign.x[i], to_column);
            self.start.y[i] += away - kept(self.sign.y[i], !to_column);
            self.next.x[i] = next_x + kept(self.step.x[i], to_column);
            self.next.y[i] = next_y + kept(self.step.y[i], !to_column);
        }
        ended == 0
    }

    /// The grain that ray `i` is near, and the start of the ray, metres from the centre of the grain along the lattice's axes.
    #[inline(always)]
    fn grain(&self, i: usize, uniforms: &LatticeUniforms) -> (Grain, Vec2, Vec2) {
        let grain =
            Grain::from_hashes([self.first[i], self.second[i]], uniforms.max_diameter_m, uniforms.share);
        let point = (Vec2::new(self.start.x[i], self.start.y[i]) - grain.centre) * uniforms.cell_m;
        (grain, point, Vec2::new(self.way.x[i], self.way.y[i]))
    }
}

/// Step from line to line of the lattice along an axis, where the first is met, and the direction; `way` is the length of the ray along
/// the axis and `start` its start in the cell, in cells.
#[inline(always)]
fn first_step(way: f32, start: f32) -> (f32, f32, f32) {
    let length = way.abs();
    let step = 1.0 / if length > 1e-6 { length } else { 1e-6 };
    if way > 0.0 { (step, step * (1.0 - start), 1.0) } else { (step, step * start, -1.0) }
}

/// Whether a cell with this first hash has a grain.
#[inline(always)]
fn has_grain(uniforms: &LatticeUniforms, first: u32) -> bool {
    ((first & 0xffff) as i32 as f32) < 65_536.0 * uniforms.amount
}

/// Adds the grains of a lattice.
#[inline(always)]
pub(super) fn add_grains(uniforms: &LatticeUniforms, ground: &GrainGround, detail: &mut GroundDetail) {
    // The material's albedo is the mean of soil and grains: where grains are seen, the soil between them is darker.
    for (albedo, across_m) in detail.albedo.iter_mut().zip(&ground.across_m) {
        *albedo /= 1.0 + uniforms.factor * sample_share(0.7 * uniforms.max_diameter_m, *across_m);
    }
    // The shadows of larger grains fall on grains too.
    let sun_on_grains = detail.sun;
    let [eye, sun] = &ground.ways;
    let mut walks = Walks::new(uniforms, ground, sun);
    for _ in 0..MAX_CELLS {
        if walks.find_near(uniforms, &ground.across_m, 1.0) {
            for i in walks.near_below(ground.count) {
                let across_m = ground.across_m[i];
                let (grain, point, way) = walks.grain(i, uniforms);
                let occlusion = grain.occlusion(point, way, ground.sun_tan_half_angle, 0.25 * across_m);
                detail.sun[i] *= 1.0 - sample_share(grain.diameter_m, across_m) * occlusion;
            }
        }
        if !walks.advance() {
            break;
        }
    }
    let mut walks = Walks::new(uniforms, ground, eye);
    for _ in 0..MAX_CELLS {
        if walks.find_near(uniforms, &ground.across_m, 0.0) {
            for i in walks.near_below(ground.count) {
                let (grain, point, way) = walks.grain(i, uniforms);
                if let Some(hit) =
                    grain.hit(point, way).filter(|hit| hit.height_m > detail.nearest[i].point.z)
                {
                    let share = sample_share(grain.diameter_m, ground.across_m[i]);
                    let (cos, sin) = (
                        uniforms.rotation_per_m.x * uniforms.cell_m,
                        uniforms.rotation_per_m.y * uniforms.cell_m,
                    );
                    let turned = |v: Vec2| Vec2::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y);
                    let slope = turned(hit.slope);
                    let mix = |value: &mut f32, other: f32| *value += share * (other - *value);
                    let rough = ROUGHNESS * Vec2::new(detail.slope.x[i], detail.slope.y[i]);
                    mix(&mut detail.slope.x[i], slope.x + rough.x);
                    mix(&mut detail.slope.y[i], slope.y + rough.y);
                    mix(&mut detail.albedo[i], grain.albedo(&ground.material));
                    mix(&mut detail.cover[i], 1.0);
                    mix(&mut detail.cover_sun[i], sun_on_grains[i]);
                    detail.nearest[i] = GrainSurface {
                        point: turned(point + hit.height_m * way).extend(hit.height_m),
                        diameter_m: grain.diameter_m,
                        seed: walks.second[i],
                        mottling: MOTTLING * if grain.is_fragment { 1.0 } else { CLOD_SPREAD },
                    };
                }
            }
        }
        if !walks.advance() {
            break;
        }
    }
}

/// Adds the texture of the nearest grains.
#[inline(always)]
pub(super) fn add_grain_texture(ground: &GrainGround, detail: &mut GroundDetail) {
    for i in 0..ground.count {
        let slope = Vec2::new(detail.slope.x[i], detail.slope.y[i]);
        if let Some((slope, shade)) = detail.nearest[i].textured(slope, ground.across_m[i]) {
            (detail.slope.x[i], detail.slope.y[i]) = (slope.x, slope.y);
            detail.albedo[i] *= shade;
        }
    }
}
