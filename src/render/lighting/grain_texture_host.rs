//! Solid texture of the soil's grains: the roughness and mottling of rocks, in octaves that follow from the size of the grain.
//!
//! Without it a fragment of three centimetres would be smooth and of one shade beside a rock of four, and a label could be told by that.
//! CPU counterpart of `add_grain_texture` in `shaders/common/grain_texture.wgsl`, equal to it but for rounding.
//! Must not know: how rays meet grains.

use glam::{IVec3, Vec2, Vec3, Vec4};

use crate::render::lighting::relief_bands::sample_share;
use crate::scene::grains::{MAX_SLOPE, THIRD_KEY};
use crate::scene::noise::lattice_hash;

/// Octaves of roughness and of mottling: as many as a rock has at least, from the finest that its samples resolve.
pub(crate) const OCTAVES: u32 = 3;
/// Diameter of a grain over the largest cells of its texture.
pub(crate) const CELLS_PER_DIAMETER: f32 = 4.0;
/// Slope per octave: `common/rock_texture.wgsl` has its source.
pub(crate) const ROUGHNESS_SLOPE: f32 = 0.18;
/// Amplitude of the mottling per octave, likewise.
pub(crate) const MOTTLING: f32 = 0.6;
/// Least factor on the albedo.
pub(crate) const MIN_SHADE: f32 = 0.25;

/// What the eye sees of a grain.
#[derive(Clone, Copy, Debug)]
pub(super) struct GrainSurface {
    /// Relative to the grain's centre and the ground there, metres.
    pub(super) point: Vec3,
    /// Diameter, metres.
    pub(super) diameter_m: f32,
    /// What sets its texture apart.
    pub(super) seed: u32,
    /// Amplitude of its mottling per octave.
    pub(super) mottling: f32,
}

impl GrainSurface {
    /// No grain.
    pub(super) const NONE: Self = Self { point: Vec3::ZERO, diameter_m: 0.0, seed: 0, mottling: 0.0 };

    /// The slope of its rough surface in place of `slope`, rise per metre, and a factor on its albedo, where samples are `across_m` apart
    /// across the view. `None` if they are too far apart to show any of it.
    pub(super) fn textured(&self, slope: Vec2, across_m: f32) -> Option<(Vec2, f32)> {
        let mut cell_m = self.diameter_m / CELLS_PER_DIAMETER;
        if sample_share(cell_m, across_m) == 0.0 {
            return None;
        }
        let (mut gradient, mut shade) = (Vec3::ZERO, 1.0);
        for k in 0..OCTAVES {
            let share = sample_share(cell_m, across_m);
            if share == 0.0 {
                break;
            }
            let noise = value_noise(self.point / cell_m, self.seed.wrapping_add(k.wrapping_mul(THIRD_KEY)));
            gradient += share * ROUGHNESS_SLOPE * noise.truncate();
            shade += share * self.mottling * noise.w;
            cell_m *= 0.5;
        }
        let normal = (-slope).extend(1.0).normalize();
        let rough = normal - gradient + normal * normal.dot(gradient);
        let flat = rough.truncate();
        Some((-flat / rough.z.max(flat.length() / MAX_SLOPE), shade.max(MIN_SHADE)))
    }
}

/// Gradient and value, in [-1, 1] with a mean of 0, of value noise: trilinear with cubic weights.
fn value_noise(p: Vec3, seed: u32) -> Vec4 {
    let corner = p.floor();
    let t = p - corner;
    let cell = corner.as_ivec3();
    let w = t * t * (3.0 - 2.0 * t);
    let rise = 6.0 * t * (1.0 - t);
    let value = |x: i32, y: i32, z: i32| lattice_value(cell + IVec3::new(x, y, z), seed);
    let low = [value(0, 0, 0), value(1, 0, 0), value(0, 1, 0), value(1, 1, 0)];
    let high = [value(0, 0, 1), value(1, 0, 1), value(0, 1, 1), value(1, 1, 1)];
    let mix = |a: f32, b: f32, share: f32| a + share * (b - a);
    let z: [f32; 4] = std::array::from_fn(|i| mix(low[i], high[i], w.z));
    let dz: [f32; 4] = std::array::from_fn(|i| high[i] - low[i]);
    Vec4::new(
        rise.x * mix(z[1] - z[0], z[3] - z[2], w.y),
        rise.y * mix(z[2] - z[0], z[3] - z[1], w.x),
        rise.z * mix(mix(dz[0], dz[1], w.x), mix(dz[2], dz[3], w.x), w.y),
        mix(mix(z[0], z[1], w.x), mix(z[2], z[3], w.x), w.y),
    )
}

fn lattice_value(cell: IVec3, seed: u32) -> f32 {
    (lattice_hash(cell.x, cell.y, cell.z, seed) >> 8) as f32 * (2.0 / 16_777_216.0) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::grains::LARGEST_M;

    /// Points within grains of the largest size, each of its own.
    fn points() -> impl Iterator<Item = GrainSurface> {
        (0..4000_u32).map(|seed| {
            let hash = lattice_hash(seed as i32, 1, 2, 3);
            let part = |shift: u32| 0.01 * ((hash >> shift & 0xff) as f32 / 255.0 - 0.5);
            let point = Vec3::new(part(0), part(8), part(16));
            GrainSurface { point, diameter_m: LARGEST_M as f32, seed, mottling: MOTTLING }
        })
    }

    #[test]
    fn the_gradient_is_that_of_the_value() {
        for grain in points().take(300) {
            let p = grain.point / 0.002;
            let noise = value_noise(p, grain.seed);
            for (axis, found) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().zip(noise.truncate().to_array()) {
                let [up, down] = [5e-3, -5e-3].map(|step| value_noise(p + step * axis, grain.seed).w);
                assert!((100.0 * (up - down) - found).abs() < 5e-3, "{found} along {axis} at {p}");
            }
        }
    }

    #[test]
    fn grains_are_as_rough_and_mottled_as_rocks_and_no_brighter() {
        let (mut squares, mut shades, mut shade_squares, mut n) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        for grain in points() {
            let (slope, shade) = grain.textured(Vec2::ZERO, 1e-4).expect("close enough");
            squares += 0.5 * f64::from(slope.length_squared());
            shades += f64::from(shade);
            shade_squares += f64::from(shade * shade);
            n += 1.0;
        }
        let (slope, mean) = ((squares / n).sqrt(), shades / n);
        let spread = (shade_squares / n - mean * mean).sqrt();
        // Rock joints have a root mean square slope of 0.2 to 0.4 at 1.3 mm (Tse and Cruden 1979).
        assert!((0.2..0.4).contains(&slope), "a slope of {slope}");
        assert!((mean - 1.0).abs() < 0.02, "a mean of {mean}");
        assert!((0.2..0.4).contains(&spread), "a spread of {spread}");
    }

    #[test]
    fn texture_fades_out_where_samples_do_not_resolve_it() {
        let largest_cell_m = LARGEST_M as f32 / CELLS_PER_DIAMETER;
        for grain in points().take(300) {
            assert!(grain.textured(Vec2::X, 0.5 * largest_cell_m).is_none());
            let (slope, shade) = grain.textured(Vec2::X, 0.499 * largest_cell_m).expect("hardly any");
            assert!(slope.distance(Vec2::X) < 0.01 && (shade - 1.0).abs() < 0.01, "{slope}, {shade}");
        }
        assert!(GrainSurface::NONE.textured(Vec2::ZERO, 1e-3).is_none());
    }
}
