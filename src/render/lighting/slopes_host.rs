//! The ground's detail below the size of its mesh's cells, summed on the host: for software adapters, which load each number of a
//! uniform again for every sample.
//!
//! CPU counterpart of `ground_detail` in `shaders/common/relief.wgsl`, equal to it but for rounding; functions have the same names. The
//! height function itself is `src/scene/relief.rs`, the craters `src/scene/craters.rs`. Everything is written for batches of samples
//! without branches, so that the compiler vectorises it.
//! Must not know: where slopes go.

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use half::f16;
use half::slice::HalfFloatSliceExt;

use crate::render::device::shader_structs::{ReliefUniforms, ReliefView};
use crate::render::device::shading_bins::{LightingVariant, ShadingBin, ShadingBins};
use crate::render::lighting::crater_rays_host::add_crater_rays;
use crate::render::lighting::detail_sums::DetailSums;
use crate::render::lighting::grain_texture_host::GrainSurface;
use crate::render::lighting::grains_host::{GrainGround, GroundDetail, add_grain_texture, add_grains};
use crate::render::lighting::ground_batch::{
    BATCH, GroundBatch, MIN_TESTED_SAMPLES, SampleBatch, Vectors, octahedral_decode,
};
use crate::render::lighting::pits_host::add_pits;
use crate::render::lighting::relief_bands::{ReliefBands, sample_share};
use crate::render::lighting::waves_host::{MIN_LOW_WAY, noise_slope, set_strength};
use crate::render::select::full_sun::{FullSun, LANES, Points};
use crate::scene::grains::GrainMaterial;
use crate::scene::relief::mesh_share;
use crate::scene::sky::Sun;

/// In place of the index of a band: none.
const NO_BAND: u8 = u8::MAX;
/// The detail where there is no relief below the mesh: no slope, the material's albedo, no grain between the ground and the sun.
const NO_DETAIL: [f16; 4] = [f16::ZERO, f16::ZERO, f16::ONE, f16::ONE];
// What is looked up together in the horizon map is a batch.
const _: () = assert!(BATCH == LANES);
/// Least component of a normal towards the sun at which the shader is sure to take it for facing the sun.
const MIN_FACING_SUN: f32 = 1e-4;
/// Half the width of the edges of these shadows, distances between samples.
pub(crate) const SHADOW_BLUR: f32 = 0.5;

/// Sums the slopes of a frame's ground.
#[derive(Clone, Debug)]
pub struct ReliefSlopes {
    bands: Vec<ReliefUniforms>,
    /// The band of each shading bin whose ground has relief below its mesh.
    band_of_bin: [u8; 1 << ShadingBin::BITS],
    /// Positions relative to the eye at a depth of a metre: the corner of sample (0, 0), and the steps to the next column and row.
    rays: [Vec3; 3],
    /// Unit vector towards the sun, and the tangent of half the angle that its disc spans.
    sun: (Vec3, f32),
    /// Where other ground shades none, and the eye.
    full_sun: Option<(FullSun, Vec3)>,
}

/// What a row of the G-buffer holds, one value a sample.
#[derive(Clone, Copy, Debug)]
pub struct GBufferRow<'a> {
    /// Inverse depth, 1/m.
    pub inverse_depth: &'a [f32],
    /// First octahedral coordinate of the normal, in the lowest 24 bits.
    pub normal_x: &'a [u32],
    /// Second octahedral coordinate of the normal, in the lowest 24 bits.
    pub normal_y: &'a [u32],
    /// One more than the shading bin in the lowest bits; 0 where nothing is visible.
    pub visibility: &'a [u32],
}

impl ReliefSlopes {
    /// For the ground of these bands, seen along these rays.
    #[must_use]
    pub fn new(bands: &ReliefBands, bins: ShadingBins, rays: [Vec3; 3], sun: &Sun) -> Self {
        let mut band_of_bin = [NO_BAND; 1 << ShadingBin::BITS];
        for (band_of_bin, (variant, band)) in band_of_bin.iter_mut().zip(bins.all()) {
            let ReliefView { waves, pit_lattices, grain_lattices, ray_contrast, .. } = bands.bands[band].view;
            let has_detail = waves + pit_lattices + grain_lattices > 0 || ray_contrast > 0.0;
            if matches!(variant, LightingVariant::Ground { .. }) && has_detail {
                *band_of_bin = band as u8;
            }
        }
        let sun = (sun.direction, sun.tan_half_angle());
        Self { bands: bands.bands.clone(), band_of_bin, rays, sun, full_sun: None }
    }

    /// The same that finds samples in full sun too, as seen from an eye (metres, world).
    #[must_use]
    pub fn with_full_sun(self, full_sun: FullSun, eye: Vec3) -> Self {
        Self { full_sun: Some((full_sun, eye)), ..self }
    }

    /// Whether it finds samples in full sun.
    #[must_use]
    pub const fn finds_full_sun(&self) -> bool {
        self.full_sun.is_some()
    }

    /// Writes the detail at a row of samples: slope, rise per metre along x and y; factor on the albedo; fraction of the sun's disc that
    /// grains leave visible. Sets to 1 the flags of samples that see all of the sun past other ground, where these are found.
    pub fn set_row(
        &self,
        row: usize,
        gbuffer: &GBufferRow<'_>,
        (slopes, in_full_sun): (&mut [[f16; 4]], &mut [u8]),
    ) {
        slopes.fill(NO_DETAIL);
        in_full_sun.fill(0);
        let mut flush = |band: u8, batch: &mut SampleBatch, count: usize| {
            if count > 0 {
                batch.pad(count);
                self.set_batch(row, band, (&*batch, count), slopes);
                self.set_in_full_sun(row, (&*batch, count), in_full_sun);
            }
        };
        let mut batch = SampleBatch::default();
        let (mut batch_band, mut count) = (NO_BAND, 0);
        for (column, visibility) in gbuffer.visibility.iter().enumerate() {
            let bin = (visibility & u32::from(ShadingBin::MAX)).wrapping_sub(1);
            let band = self.band_of_bin.get(bin as usize).copied().unwrap_or(NO_BAND);
            if band == NO_BAND {
                continue;
            }
            if count == BATCH || band != batch_band {
                flush(batch_band, &mut batch, count);
                (batch_band, count) = (band, 0);
            }
            batch.columns[count] = column as u32;
            batch.inverse_depth[count] = gbuffer.inverse_depth[column];
            batch.normal_x[count] = gbuffer.normal_x[column];
            batch.normal_y[count] = gbuffer.normal_y[column];
            count += 1;
        }
        flush(batch_band, &mut batch, count);
    }

    /// Finds which of the first `count` samples of a batch are in full sun.
    fn set_in_full_sun(&self, row: usize, (batch, count): (&SampleBatch, usize), in_full_sun: &mut [u8]) {
        let Some((full_sun, eye)) = &self.full_sun else { return };
        let ([corner, right, down], (sun, _)) = (self.rays, self.sun);
        let row_start = corner + (row as f32 + 0.5) * down;
        let mut flags = [0; BATCH];
        dispatch!(Level::new(), _simd => {
            let zeros = [0.0; BATCH];
            let mut points = Points { x: zeros, y: zeros, z: zeros };
            for i in 0..BATCH {
                let (column, depth_m) = (batch.columns[i] as i32 as f32 + 0.5, 1.0 / batch.inverse_depth[i]);
                points.x[i] = eye.x + (row_start.x + column * right.x) * depth_m;
                points.y[i] = eye.y + (row_start.y + column * right.y) * depth_m;
                points.z[i] = eye.z + (row_start.z + column * right.z) * depth_m;
            }
            full_sun.find(&points, &mut flags);
            for ((flag, x), y) in flags.iter_mut().zip(&batch.normal_x).zip(&batch.normal_y) {
                // What faces away from the sun shades itself.
                let [x, y, z] = octahedral_decode(*x, *y);
                *flag &= if x * sun.x + y * sun.y + z * sun.z > MIN_FACING_SUN { 1 } else { 0 };
            }
        });
        for (column, flag) in batch.columns[..count].iter().zip(flags) {
            in_full_sun[*column as usize] = flag;
        }
    }

    /// Writes the detail at the first `count` samples of a batch.
    fn set_batch(
        &self,
        row: usize,
        band: u8,
        (batch, count): (&SampleBatch, usize),
        slopes: &mut [[f16; 4]],
    ) {
        let relief = &self.bands[usize::from(band)];
        let mut detail = [[0.0_f32; 4]; BATCH];
        dispatch!(Level::new(), _simd => {
            ground_detail(relief, (self.rays, self.sun), row, (batch, count), &mut detail);
        });
        let mut halves = [NO_DETAIL; BATCH];
        halves.as_flattened_mut().convert_from_f32_slice(detail.as_flattened());
        for (column, halves) in batch.columns[..count].iter().zip(&halves) {
            slopes[*column as usize] = *halves;
        }
    }
}

// From here on all is inlined, to be compiled for each width of vectors.

/// What the mesh leaves out and samples can show, at the first `count` samples of a batch.
#[inline(always)]
fn ground_detail(
    relief: &ReliefUniforms,
    (rays, sun): ([Vec3; 3], (Vec3, f32)),
    row: usize,
    (batch, count): (&SampleBatch, usize),
    result: &mut [[f32; 4]; BATCH],
) {
    let view = &relief.view;
    let ground = GroundBatch::new(view, rays, sun.0, row, batch);
    let zeros = [0.0; BATCH];
    let mut sums = DetailSums::new();
    let nearest_across_m = add_relief(relief, &ground, &mut sums);
    let (mut x, mut y, mut sun_on_ground) = (zeros, zeros, zeros);
    for i in 0..BATCH {
        let point = sums.point(&ground, i);
        (x[i], y[i]) = (point.x, point.y);
        let blur_m = SHADOW_BLUR * ground.across_m[i] * ground.per_way[1][i];
        sun_on_ground[i] = 1.0 - sums.sun_hidden(&ground, i, blur_m);
    }
    let mut detail = GroundDetail {
        slope: Vectors { x: sums.x, y: sums.y },
        // The exponential function to second order.
        albedo: sums.shade.map(|shade| 1.0 + shade * (1.0 + 0.5 * shade)),
        sun: sun_on_ground,
        nearest: [GrainSurface::NONE; BATCH],
        cover: [0.0; BATCH],
        cover_sun: [0.0; BATCH],
    };
    let material = GrainMaterial { ratio: view.grain_ratio, spread: view.grain_spread };
    let grain_ground = GrainGround {
        count,
        point: Vectors { x, y },
        across_m: ground.across_m,
        ways: ground.ways,
        sun_tan_half_angle: sun.1,
        material,
    };
    for grains in &relief.grains[..view.grain_lattices as usize] {
        if sample_share(1.001 * grains.max_diameter_m, nearest_across_m) > 0.0 {
            add_grains(grains, &grain_ground, &mut detail);
        }
    }
    add_grain_texture(&grain_ground, &mut detail);
    if view.ray_contrast > 0.0 {
        add_crater_rays(relief, Vectors { x, y }, &ground.sample_m, &mut detail.albedo);
    }
    for (i, result) in result.iter_mut().enumerate() {
        // What hides the ground hides its shadows.
        let sun = detail.sun[i] * (1.0 - detail.cover[i]) + detail.cover_sun[i];
        *result = [detail.slope.x[i], detail.slope.y[i], detail.albedo[i], sun];
    }
}

/// Adds pits and noise, from coarse to fine. Returns the smallest distance of samples across the view, metres.
#[inline(always)]
fn add_relief(relief: &ReliefUniforms, ground: &GroundBatch, sums: &mut DetailSums) -> f32 {
    let view = &relief.view;
    // Floats that are not negative sort as their bits do.
    let (mut nearest, mut nearest_across) = (u32::MAX, u32::MAX);
    let mut largest_cell = 0;
    for (cell_m, sample_m) in ground.cell_m.iter().zip(&ground.sample_m) {
        largest_cell = largest_cell.max(cell_m.to_bits());
        nearest = nearest.min(sample_m.to_bits());
    }
    for across_m in &ground.across_m {
        nearest_across = nearest_across.min(across_m.to_bits());
    }
    let [largest_cell_m, nearest_m] = [largest_cell, nearest].map(f32::from_bits);
    let mut smallest_per_way = u32::MAX;
    for per_way in &ground.per_way[1] {
        smallest_per_way = smallest_per_way.min(per_way.to_bits());
    }
    let is_sun_low = f32::from_bits(smallest_per_way) < 1.0 / MIN_LOW_WAY;
    let (all_pits, waves) =
        (&relief.pits[..view.pit_lattices as usize], &relief.noise[..view.waves as usize]);
    let mut next_pits = 0;
    for k in 0..=waves.len() {
        // One call, for which it is inlined: larger pits before this wave, the others after the last.
        let wave_m = if k < waves.len() { waves[k].cell_m } else { 0.0 };
        while next_pits < all_pits.len() && all_pits[next_pits].max_diameter_m > wave_m {
            let pits = &all_pits[next_pits];
            next_pits += 1;
            // The smallest pits of a lattice are half as large as its largest; a little room for how sizes are rounded.
            let is_resolved = sample_share(1.001 * pits.max_diameter_m, nearest_m) > 0.0;
            let is_below_mesh = mesh_share(0.499 * pits.max_diameter_m, largest_cell_m) < 1.0;
            if is_resolved && is_below_mesh {
                add_pits(pits, view.fresh_share, ground, sums);
            }
        }
        let Some(wave) = waves.get(k) else { break };
        if mesh_share(wave.cell_m, largest_cell_m) == 1.0 {
            set_strength(wave, ground, sums);
        } else if sample_share(wave.cell_m, nearest_m) > 0.0 {
            let is_tested = wave.cell_m > MIN_TESTED_SAMPLES * nearest_m;
            noise_slope(wave, ground, [is_tested, is_sun_low], sums);
        }
    }
    f32::from_bits(nearest_across)
}
