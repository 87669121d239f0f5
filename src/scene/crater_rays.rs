//! Rays of fresh craters: the soil that they threw out is less mature than that around them, and brighter.
//!
//! A crater that is not yet worn has a bright halo of continuous ejecta, and beyond it streaks that run outwards from it, broken and mottled
//! by the secondary impacts that laid them (Hawke et al. 2004, "The origin of lunar crater rays"). They are the logarithm of a factor on
//! the soil's albedo: a function of the position on the ground, faded to its mean where samples do not show it.
//! Here are the few craters whose rays matter most near the camera. The function has a counterpart in `shaders/common/crater_rays.wgsl`.
//! Must not know: who asks.

use glam::Vec2;

use super::craters::{CraterField, Pit, Region};
use super::noise::value_noise_2d;
use crate::params::{Knob, Params};

/// Most craters with rays.
pub const MAX_RAY_CRATERS: usize = 5;
/// Diameter from which a fresh crater has rays, metres.
const SMALLEST_M: f32 = 10.0;
/// Where rays end, and where the halo begins and has ended to fall off; distances in radii.
pub const RAYS_REACH: f32 = 16.0;
/// See [`RAYS_REACH`].
pub const HALO_REACH: f32 = 3.0;
/// Of the noise that streaks follow: cells around the crater over two pi near it, and how many more there are per radius from it.
pub const STREAK_CELLS: f32 = 7.0;
/// See [`STREAK_CELLS`].
pub const STREAK_CELLS_PER_RADIUS: f32 = 0.3;
/// Cells of the mottling per radius.
pub const MOTTLE_CELLS_PER_RADIUS: f32 = 1.6;
/// Mean of the streaks.
pub const MEAN_STREAK: f32 = 0.2;

/// A crater with rays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayCrater {
    /// Centre, metres from the centre of the ground.
    pub offset: Vec2,
    /// Radius, metres.
    pub radius_m: f32,
    /// Seed of its streaks.
    pub seed: u32,
}

/// The rays of a scene's craters.
#[derive(Clone, Debug, Default)]
pub struct CraterRays {
    /// Logarithm of the albedo of the brightest rays over that of the soil between them; 0 if there are none.
    pub contrast: f32,
    /// The craters, those first whose rays are strongest near the camera; empty without contrast.
    pub craters: Vec<RayCrater>,
}

impl CraterRays {
    /// The rays of these craters near a camera, metres from the centre of the ground.
    #[must_use]
    pub fn new(params: &Params, craters: &CraterField, camera: Vec2) -> Self {
        let contrast = params.number(Knob::RegolithRays) as f32;
        let radius_m = 0.5 * params.number(Knob::TerrainSizeM) as f32;
        if contrast <= 0.0 {
            return Self::default();
        }
        let mut fresh: Vec<Pit> = Vec::new();
        craters.fresh_around(&Region::circle(camera, radius_m), SMALLEST_M, |pit| fresh.push(pit));
        let strength = |pit: &Pit| pit.diameter_m / pit.offset.distance(camera).max(pit.diameter_m);
        fresh.sort_by(|a, b| strength(b).total_cmp(&strength(a)).then(a.key.cmp(&b.key)));
        let of_pit = |pit: &Pit| RayCrater {
            offset: pit.offset,
            radius_m: 0.5 * pit.diameter_m,
            seed: (pit.key ^ (pit.key >> 32)) as u32,
        };
        Self { contrast, craters: fresh.iter().take(MAX_RAY_CRATERS).map(of_pit).collect() }
    }
}

impl RayCrater {
    /// Brightness of the crater's rays at a point (metres from the centre of the ground), 0 to 1, where samples are this far apart,
    /// metres.
    #[must_use]
    #[inline(always)]
    pub fn brightness(&self, point: Vec2, sample_m: f32) -> f32 {
        let (x, y) = (point.x - self.offset.x, point.y - self.offset.y);
        let per_radius = 1.0 / self.radius_m;
        let distance_m = (x * x + y * y).sqrt();
        let r = distance_m * per_radius;
        let per_distance = 1.0 / (distance_m + 1e-3 * self.radius_m);
        // Around the crater the noise is sampled on a circle, which grows outwards: streaks are long along the radius.
        let cells = STREAK_CELLS + STREAK_CELLS_PER_RADIUS * r;
        let (u, v) = (x * per_distance * cells, y * per_distance * cells);
        let coarse = noise(u, v, self.seed);
        let fine = noise(2.3 * u, 2.3 * v, self.seed ^ 0x5bd1);
        let streak = ((coarse + 0.6 * fine - 0.08) * 3.2).clamp(0.0, 1.0);
        let mottle_cells = MOTTLE_CELLS_PER_RADIUS * per_radius;
        let mottle = noise(x * mottle_cells, y * mottle_cells, self.seed ^ 0xa3c7);
        // Width of a streak over twice the distance of samples: less than one is not seen.
        let shown = (distance_m / (cells * sample_m) - 1.0).clamp(0.0, 1.0);
        let streak = MEAN_STREAK + shown * (streak - MEAN_STREAK);
        let left = (1.0 - r / RAYS_REACH).clamp(0.0, 1.0);
        let rays = left * streak * (0.8 + shown * mottle);
        let halo = (HALO_REACH - r).clamp(0.0, 1.0) * (0.85 + 0.3 * shown * mottle);
        let brightest = if halo > rays { halo } else { rays };
        if brightest < 1.0 { brightest } else { 1.0 }
    }
}

/// Value noise at a point, -0.5 to 0.5.
#[inline(always)]
fn noise(x: f32, y: f32, seed: u32) -> f32 {
    value_noise_2d([x, y], seed) - 0.5
}
