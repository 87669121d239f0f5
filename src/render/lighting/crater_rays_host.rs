//! Rays of fresh craters at a batch of samples, on the host.
//!
//! CPU counterpart of `crater_rays_factor` in `shaders/common/crater_rays.wgsl`. All is inlined, to be compiled for each width of vectors.
//! Must not know: what else is summed.

use glam::Vec2;

use super::ground_batch::{BATCH, Vectors};
use crate::render::device::shader_structs::ReliefUniforms;
use crate::scene::crater_rays::{RAYS_REACH, RayCrater};

/// Multiplies the factors on the soil's albedo at points (metres from the centre of the ground), where samples are this far apart.
#[inline(always)]
pub(super) fn add_crater_rays(
    relief: &ReliefUniforms,
    point: Vectors,
    sample_m: &[f32; BATCH],
    albedo: &mut [f32; BATCH],
) {
    let mut brightest = [0.0_f32; BATCH];
    // Craters that are not there have no radius, and are reached nowhere.
    for crater in &relief.crater_rays {
        let crater = RayCrater { offset: crater.offset, radius_m: crater.radius_m, seed: crater.seed };
        let reach_m = RAYS_REACH * crater.radius_m;
        let mut reached = 0;
        for i in 0..BATCH {
            let (x, y) = (point.x[i] - crater.offset.x, point.y[i] - crater.offset.y);
            reached |= u8::from(x * x + y * y < reach_m * reach_m);
        }
        if reached == 0 {
            continue;
        }
        for i in 0..BATCH {
            let brightness = crater.brightness(Vec2::new(point.x[i], point.y[i]), sample_m[i]);
            brightest[i] = if brightness > brightest[i] { brightness } else { brightest[i] };
        }
    }
    for (albedo, brightness) in albedo.iter_mut().zip(brightest) {
        let shade = relief.view.ray_contrast * brightness;
        // The exponential function to second order.
        *albedo *= 1.0 + shade * (1.0 + 0.5 * shade);
    }
}
