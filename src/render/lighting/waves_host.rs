//! Waves of noise below the size of the mesh's cells in a batch of samples, summed on the host: slopes, heights and shades where the eye
//! sees them, and where they shadow the ground.
//!
//! CPU counterpart of the loops over octaves in `ground_detail` in `shaders/common/relief.wgsl`, equal to them but for rounding. All is
//! inlined, to be compiled for each width of vectors.
//! Must not know: what else is summed.

use glam::Vec2;

use super::detail_sums::DetailSums;
use super::ground_batch::{BATCH, GroundBatch};
use crate::render::device::shader_structs::LatticeUniforms;
use crate::scene::noise::{gradient_noise_2d, gradient_noise_slope_2d, patchy_noise_2d};
use crate::scene::relief::capped_strength;

/// Distance along a ray to the sun at which a wave of noise is asked whether it shadows the ground, cells: smaller waves vary independently
/// there.
pub(crate) const TESTED_CELLS: f32 = 0.5;
/// Least horizontal way of that ray per metre that it rises at which waves are asked: steeper ones hardly meet any.
pub(crate) const MIN_LOW_WAY: f32 = 2.0;
/// Largest way, cells, by which a wave as high as its amplitude moves what the eye sees along its ray for one step of Newton's method to find
/// it; from twice as large on it takes two in full.
pub(crate) const FIRST_STEP_CELLS: f32 = 0.125;

/// Adds the slope, the height and the shade of one octave of noise where the eye sees it. `is_tested`: whether samples are so close that it
/// may need two steps, and shadow the ground if rays to the sun are low.
#[inline(always)]
pub(super) fn noise_slope(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    [is_tested, is_sun_low]: [bool; 2],
    sums: &mut DetailSums,
) {
    let mut resolved = [0.0; BATCH];
    for (i, resolved) in resolved.iter_mut().enumerate() {
        *resolved = sums.share(ground, i, wave.cell_m);
    }
    if is_tested && is_sun_low {
        let mut clearances_m = [0.0; BATCH];
        for (i, clearance_m) in clearances_m.iter_mut().enumerate() {
            *clearance_m = sun_clearance(wave, ground, sums, (i, resolved[i]));
        }
        sums.add_occluders(&clearances_m, &[TESTED_CELLS * wave.cell_m; BATCH]);
    }
    let rises_m = if is_tested { first_step(wave, ground, &resolved, sums) } else { [0.0; BATCH] };
    if wave.factor > 0.0 {
        add_slope(wave, ground, (&resolved, &rises_m), wave.factor, sums);
    } else {
        // A constant 0, for which the compiler leaves the strength of finer waves out.
        add_slope(wave, ground, (&resolved, &rises_m), 0.0, sums);
    }
}

/// How far along the ray to the eye one octave of noise is to be asked, metres of height: the first of two steps of Newton's method, where
/// one would miss. That is where the octave moves what the eye sees by a good part of a cell: its slope there is another one.
#[inline(always)]
fn first_step(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    resolved: &[f32; BATCH],
    sums: &DetailSums,
) -> [f32; BATCH] {
    let mut rises_m = [0.0; BATCH];
    let (per_wave, mut any) = (wave.amount / (FIRST_STEP_CELLS * wave.cell_m), 0_u32);
    for (i, weight) in rises_m.iter_mut().enumerate() {
        let cells = per_wave * resolved[i] * capped_strength(sums.strength[i]) / ground.per_way[0][i];
        *weight = (cells - 1.0).clamp(0.0, 1.0) * ground.tested_share(i, wave.cell_m);
        any |= if *weight > 0.0 { 1 } else { 0 };
    }
    if any == 0 {
        return rises_m;
    }
    let lattice = wave.lattice();
    for (i, rise_m) in rises_m.iter_mut().enumerate() {
        let (cell, t) = lattice.cell(lattice.local(sums.point(ground, i)));
        let [along, across, _, value, _] = gradient_noise_slope_2d(cell, t, wave.seed, 0.0);
        let share = wave.amount * resolved[i] * capped_strength(sums.strength[i]);
        let slope = share * slope_from_lattice(wave, [along, across]);
        *rise_m *= share * value / sums.clearance(ground, i, slope);
    }
    rises_m
}

/// Adds one octave of noise where the ray to the eye has risen by `rises_m` more: its slope, its height and its shade.
#[inline(always)]
fn add_slope(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    (resolved, rises_m): (&[f32; BATCH], &[f32; BATCH]),
    patchy: f32,
    sums: &mut DetailSums,
) {
    let lattice = wave.lattice();
    for i in 0..BATCH {
        // What the ray has risen, less what the larger relief has below it.
        let above_m = rises_m[i] * sums.rise(ground, i);
        sums.move_up(ground, (i, wave.cell_m), rises_m[i]);
        let ([column, row], t) = lattice.cell(lattice.local(sums.point(ground, i)));
        let [along, across, shade, value, strength] =
            gradient_noise_slope_2d([column, row], t, wave.seed, patchy);
        let share = wave.amount * resolved[i] * capped_strength(sums.strength[i]);
        if patchy != 0.0 {
            sums.strength[i] *= strength;
        }
        let slope = share * slope_from_lattice(wave, [along, across]);
        sums.waves.x[i] += slope.x;
        sums.waves.y[i] += slope.y;
        let height_m = share * value - above_m;
        sums.add(ground, (i, wave.cell_m), slope, height_m, wave.share * resolved[i] * shade);
    }
}

/// From a slope per cell along the lattice's axes to a slope per metre along x and y.
#[inline(always)]
pub(super) fn slope_from_lattice(lattice: &LatticeUniforms, [along, across]: [f32; 2]) -> Vec2 {
    Vec2::new(
        lattice.rotation_per_m.x * along - lattice.rotation_per_m.y * across,
        lattice.rotation_per_m.y * along + lattice.rotation_per_m.x * across,
    )
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

/// How far above the ground a ray to the sun is where it has risen a little, metres. The ground's height there is that of this wave, above
/// that of the larger ones by their slope. High rays are far above, as are all where samples do not show the wave; where they barely do, the
/// ray is higher by one over the share of the wave that is tested.
#[inline(always)]
fn sun_clearance(
    wave: &LatticeUniforms,
    ground: &GroundBatch,
    sums: &DetailSums,
    (i, resolved): (usize, f32),
) -> f32 {
    let lattice = wave.lattice();
    let per_way = ground.per_way[1][i];
    let rise_m = TESTED_CELLS * wave.cell_m * per_way;
    let way = Vec2::new(rise_m * ground.ways[1].x[i], rise_m * ground.ways[1].y[i]);
    let (cell, t) = lattice.cell(lattice.local(sums.point(ground, i) + way));
    let height_m =
        wave.amount * resolved * capped_strength(sums.strength[i]) * gradient_noise_2d(cell, t, wave.seed);
    let tested = ground.tested_share(i, wave.cell_m);
    let is_tested = (per_way < 1.0 / MIN_LOW_WAY) & (resolved > 0.0) & (tested > 0.0);
    let clearance_m = rise_m / tested - (sums.waves.x[i] * way.x + sums.waves.y[i] * way.y + height_m);
    if is_tested { clearance_m } else { f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::random::Streams;
    use crate::render::lighting::ground_batch::MIN_TESTED_SAMPLES;
    use crate::render::lighting::relief_bands::{lattice_uniforms, sample_share};
    use crate::scene::relief::{Relief, mesh_share};

    /// A surface that hides itself from the eye shows its points in their order: of samples that follow each other towards the eye, the next
    /// one sees ground that is nearer. A step that misses turns this round, and stretches what it shows; with one step a wave 1.5 % do at the
    /// highest of these eyes.
    #[test]
    fn the_ground_that_samples_see_comes_nearer_with_their_rays() {
        let mut config = Config::new();
        config.set_stage("surface").expect("a stage");
        let params = config.draw(5).expect("drawn");
        let relief = Relief::new(&Streams::new(5), &params, Vec2::ZERO);
        for (way, across_m, cell_m, max_share) in
            [(2.5, 2.7e-3, 0.05, 0.002), (4.0, 6e-3, 0.08, 0.002), (4.0, 7e-4, 0.04, 0.03)]
        {
            let (mut backwards, mut all) = (0, 0);
            for k in 0..400_u16 {
                let start = Vec2::new(0.37 * f32::from(k), 0.61 * f32::from(k % 29));
                let ground = GroundBatch::towards_eye(start, way, across_m, cell_m);
                let mut sums = DetailSums::new();
                for octave in &relief.octaves {
                    let wave = LatticeUniforms {
                        factor: octave.patchy,
                        ..lattice_uniforms(&octave.lattice, octave.amplitude_m)
                    };
                    if mesh_share(wave.cell_m, cell_m) == 1.0 {
                        set_strength(&wave, &ground, &mut sums);
                    } else if sample_share(wave.cell_m, ground.sample_m[0]) > 0.0 {
                        let is_tested = wave.cell_m > MIN_TESTED_SAMPLES * ground.sample_m[0];
                        noise_slope(&wave, &ground, [is_tested, false], &mut sums);
                    }
                }
                let seen: [f32; BATCH] = std::array::from_fn(|i| sums.point(&ground, i).y);
                backwards += seen.windows(2).filter(|pair| pair[1] < pair[0]).count();
                all += BATCH - 1;
            }
            let share = backwards as f64 / all as f64;
            assert!(share < max_share, "way {way}, {across_m} m: {share:.4} of {all} pairs of samples");
        }
    }
}
