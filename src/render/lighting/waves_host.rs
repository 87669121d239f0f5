//! Waves of noise below the size of the mesh's cells in a batch of samples, summed on the host: slopes, heights and shades, and where they
//! hide or shadow the ground.
//!
//! CPU counterpart of the loops over octaves in `ground_detail` in `shaders/common/relief.wgsl`, equal to them but for rounding. All is
//! inlined, to be compiled for each width of vectors.
//! Must not know: what else is summed.

use glam::Vec2;

use super::detail_sums::{DetailSums, FAR_M};
use super::ground_batch::{BATCH, GroundBatch};
use crate::render::device::shader_structs::LatticeUniforms;
use crate::scene::noise::{MAX_GRADIENT_NOISE, gradient_noise_2d, gradient_noise_slope_2d, patchy_noise_2d};
use crate::scene::relief::capped_strength;

/// Distance along a ray at which a wave of noise is asked whether it hides or shadows the ground, cells: smaller waves vary independently
/// there.
pub(crate) const TESTED_CELLS: f32 = 0.5;
/// Least horizontal way of a ray per metre that it rises at which waves are asked: steeper ones hardly meet any.
pub(crate) const MIN_LOW_WAY: f32 = 2.0;

/// Adds the slope, the height and the shade of one octave of noise; where it hides the ground from the eye, at the wave that does. `is_low`:
/// whether rays to the eye and to the sun are so low, and samples so close, that it may hide or shadow the ground.
#[inline(always)]
pub(super) fn noise_slope(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    is_low: [bool; 2],
    sums: &mut DetailSums,
) {
    let mut resolved = [0.0; BATCH];
    for (i, resolved) in resolved.iter_mut().enumerate() {
        *resolved = sums.share(ground, i, wave.cell_m);
    }
    // How far the ray to the eye is above the larger waves where this wave hides the ground below it.
    let mut above_m = [0.0; BATCH];
    if is_low[0] && may_hide_ground(wave, ground, &resolved, sums) {
        for (i, above_m) in above_m.iter_mut().enumerate() {
            let (rise_m, clearance_m) = clearance(wave, ground, sums, (i, resolved[i]), 0);
            let way = Vec2::new(rise_m * ground.ways[0].x[i], rise_m * ground.ways[0].y[i]);
            let is_hidden = clearance_m < 0.0;
            let rise_m = if is_hidden { rise_m } else { 0.0 };
            sums.height_m[i] += rise_m;
            sums.sun_clearance_m[i] += ground.sun_lift[i] * rise_m;
            let slope_m = sums.waves.x[i] * way.x + sums.waves.y[i] * way.y;
            *above_m = if is_hidden { rise_m - slope_m } else { 0.0 };
        }
    }
    if is_low[1] {
        for i in 0..BATCH {
            let (_, clearance_m) = clearance(wave, ground, sums, (i, resolved[i]), 1);
            let clearance_m = clearance_m + above_m[i];
            let nearest_m = sums.sun_clearance_m[i];
            sums.sun_clearance_m[i] = if clearance_m < nearest_m { clearance_m } else { nearest_m };
        }
    }
    if wave.factor > 0.0 {
        add_slope(wave, ground, (&resolved, &above_m), wave.factor, sums);
    } else {
        // A constant 0, for which the compiler leaves the strength of finer waves out.
        add_slope(wave, ground, (&resolved, &above_m), 0.0, sums);
    }
}

/// Whether this wave may hide the ground from the eye at any sample: whether at its greatest possible height a ray to the eye would meet
/// it. Most waves are lower than that, and their noise need not be known.
#[inline(always)]
fn may_hide_ground(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    resolved: &[f32; BATCH],
    sums: &DetailSums,
) -> bool {
    let max_height_m = MAX_GRADIENT_NOISE * wave.amount;
    let mut any = 0_u32;
    for (i, resolved) in resolved.iter().enumerate() {
        let (rise_m, way) = risen_ray(wave, ground, i, 0);
        let slope_m = sums.waves.x[i] * way.x + sums.waves.y[i] * way.y;
        let height_m = max_height_m * resolved * capped_strength(sums.strength[i]);
        let tested = ground.tested_share(i, wave.cell_m);
        let above_m = rise_m / tested;
        // A little room for rounding.
        let may_hide =
            (above_m - slope_m - height_m < 1e-5 * above_m) & is_ray_tested(ground, i, 0, *resolved, tested);
        any |= if may_hide { 1 } else { 0 };
    }
    any != 0
}

/// Adds one octave of noise at the wave that the eye sees: its slope, its height and its shade.
#[inline(always)]
fn add_slope(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    (resolved, above_m): (&[f32; BATCH], &[f32; BATCH]),
    patchy: f32,
    sums: &mut DetailSums,
) {
    let lattice = wave.lattice();
    for i in 0..BATCH {
        let ([column, row], t) = lattice.cell(lattice.local(sums.point(ground, i)));
        let [along, across, shade, value, strength] =
            gradient_noise_slope_2d([column, row], t, wave.seed, patchy);
        let share = wave.amount * resolved[i] * capped_strength(sums.strength[i]);
        if patchy != 0.0 {
            sums.strength[i] *= strength;
        }
        let slope = Vec2::new(
            share * (wave.rotation_per_m.x * along - wave.rotation_per_m.y * across),
            share * (wave.rotation_per_m.y * along + wave.rotation_per_m.x * across),
        );
        sums.waves.x[i] += slope.x;
        sums.waves.y[i] += slope.y;
        sums.add(ground, i, slope, share * value - above_m[i], wave.share * resolved[i] * shade);
    }
}

/// Sets the strength of finer waves where this one is wholly in the mesh.
#[inline(always)]
pub(super) fn set_strength(wave: &LatticeUniforms, ground: &GroundBatch, sums: &mut DetailSums) {
    if wave.factor > 0.0 {
        let lattice = wave.lattice();
        for i in 0..BATCH {
            let ([column, row], t) = lattice.cell(lattice.local(sums.point(ground, i)));
            let [_, strength] = patchy_noise_2d([column, row], t, wave.seed, wave.factor);
            sums.strength[i] *= strength;
        }
    }
}

/// Where a ray to the eye (0) or to the sun (1) has risen a little: by how much, and how far it is then above the ground, metres. That is the
/// height of this wave, above that of the larger ones by their slope. High rays are far above, as are all where samples do not show it; where
/// they barely do, the ray is higher by one over the share of the wave that is tested.
#[inline(always)]
fn clearance(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    sums: &DetailSums,
    (i, resolved): (usize, f32),
    ray: usize,
) -> (f32, f32) {
    let lattice = wave.lattice();
    let (rise_m, way) = risen_ray(wave, ground, i, ray);
    let ([column, row], t) = lattice.cell(lattice.local(sums.point(ground, i) + way));
    let value = gradient_noise_2d([column, row], t, wave.seed);
    let height_m = wave.amount * resolved * capped_strength(sums.strength[i]) * value;
    let tested = ground.tested_share(i, wave.cell_m);
    let is_tested = is_ray_tested(ground, i, ray, resolved, tested);
    let clearance_m = rise_m / tested - (sums.waves.x[i] * way.x + sums.waves.y[i] * way.y + height_m);
    (rise_m, if is_tested { clearance_m } else { FAR_M })
}

/// By how much a ray to the eye (0) or to the sun (1) has risen where it is asked whether it clears the wave, metres, and its horizontal way
/// to there.
#[inline(always)]
fn risen_ray(wave: &LatticeUniforms, ground: &GroundBatch, i: usize, ray: usize) -> (f32, Vec2) {
    let rise_m = TESTED_CELLS * wave.cell_m * ground.per_way[ray][i];
    (rise_m, Vec2::new(rise_m * ground.ways[ray].x[i], rise_m * ground.ways[ray].y[i]))
}

/// Whether a ray is so low, and samples show a wave so well, that it may hide or shadow the ground.
#[inline(always)]
fn is_ray_tested(ground: &GroundBatch, i: usize, ray: usize, resolved: f32, tested: f32) -> bool {
    (ground.per_way[ray][i] < 1.0 / MIN_LOW_WAY) & (resolved > 0.0) & (tested > 0.0)
}
