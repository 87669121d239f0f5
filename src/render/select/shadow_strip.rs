//! Shadow volumes of casters over the cells of a grid, seen from above: strips along the sun's rays.
//!
//! Must not know: what is listed for a cell.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec2;

use crate::render::select::casters::Caster;
use crate::scene::Scene;
use crate::scene::sky::Sun;

/// The sun's rays over the ground.
pub(super) struct Rays {
    /// Horizontal unit vector along the rays, away from the sun.
    away: Vec2,
    /// Fall per horizontal metre of the rays that reach furthest: those from the lower limb.
    steepness: f32,
    /// How much the penumbra widens on each side, metres per metre: the tangent of half the sun's angular diameter.
    penumbra: f32,
}

impl Rays {
    pub(super) fn new(sun: &Sun) -> Self {
        let (away, penumbra) = (-sun.direction.truncate(), sun.tan_half_angle());
        if away.length() > 1e-6 {
            Self { away: away / away.length(), steepness: sun.lower_limb_slope(), penumbra }
        } else {
            Self { away: Vec2::X, steepness: 1e6, penumbra }
        }
    }

    /// Lowest and highest corner of the bounding box of the strip of a caster, metres.
    pub(super) fn bounds(&self, scene: &Scene, caster: &Caster) -> [Vec2; 2] {
        let start = caster.tile.centre.truncate();
        let end = (caster.tile.centre - caster.reach_m * scene.sun.direction).truncate();
        let widest_m = caster.tile.half_extent_m + self.penumbra * caster.reach_m;
        [start.min(end) - widest_m, start.max(end) + widest_m]
    }
}

/// The shadow volume of a caster, umbra and penumbra, over the cells of a grid: seen from above a strip along the rays that begins at
/// the caster and widens away from it.
pub(super) struct ShadowStrip<'a> {
    rays: &'a Rays,
    /// Centre of the caster, seen from above.
    pub(super) start: Vec2,
    /// Half the width at the caster, metres.
    extent_m: f32,
    /// Height of the highest point of the caster, metres.
    top_m: f32,
    /// Corners of the bounding box.
    pub(super) low: Vec2,
    pub(super) high: Vec2,
    /// Half the diagonal of a cell, metres.
    half_diagonal_m: f32,
    /// Upper bound of half its width anywhere in the box, with half the diagonal of a cell, metres.
    max_half_width_m: f32,
}

impl<'a> ShadowStrip<'a> {
    pub(super) fn new(scene: &Scene, rays: &'a Rays, caster: &Caster, cell_m: f32) -> Self {
        let rock = &scene.rocks[caster.rock];
        let (centre, extent_m) = (caster.tile.centre, caster.tile.half_extent_m);
        let half_diagonal_m = cell_m * std::f32::consts::FRAC_1_SQRT_2;
        let start = centre.truncate();
        let [low, high] = rays.bounds(scene, caster);
        let top_m = centre.z + rock.z_range_m[1];
        let mut strip =
            Self { rays, start, extent_m, top_m, low, high, half_diagonal_m, max_half_width_m: 0.0 };
        let furthest_m = (high - low).length() + 2.0 * half_diagonal_m;
        strip.max_half_width_m = 1.01 * (strip.half_width_m(furthest_m) + half_diagonal_m);
        strip
    }

    /// Lowest and highest y of the bounding box of the strip of a caster, metres.
    pub(super) fn rows_m(scene: &Scene, rays: &Rays, caster: &Caster) -> [f32; 2] {
        rays.bounds(scene, caster).map(|corner| corner.y)
    }

    /// Half the width at a distance along the rays, metres.
    fn half_width_m(&self, along_m: f32) -> f32 {
        let Rays { steepness, penumbra, .. } = *self.rays;
        self.extent_m + 2.0 * penumbra * (along_m + self.extent_m) * (1.0 + steepness.min(10.0))
    }

    /// West and east end of the part of the strip in the row of cells around a y, metres.
    pub(super) fn span_in_row(&self, north_of_start_m: f32, cell_m: f32) -> (f32, f32) {
        let (mut west_m, mut east_m) = (self.low.x, self.high.x);
        let away = self.rays.away;
        if away.y.abs() > 1e-3 {
            let (middle_m, half_m) =
                (self.start.x + north_of_start_m * away.x / away.y, self.max_half_width_m / away.y.abs());
            west_m = west_m.max(middle_m - half_m - cell_m);
            east_m = east_m.min(middle_m + half_m + cell_m);
        }
        (west_m, east_m)
    }

    /// Heights of the highest rays that the caster can have blocked, over cells whose centres are at these offsets from the start,
    /// metres; `f32::MIN` over a cell that does not touch the strip.
    #[inline(always)]
    pub(super) fn highest_rays_m<S: Simd>(&self, simd: S, x: f32x8<S>, y: f32x8<S>) -> f32x8<S> {
        let Rays { away, steepness, penumbra } = *self.rays;
        let (zero, half_m) = (f32x8::splat(simd, 0.0), self.half_diagonal_m);
        let along_m = x * away.x + y * away.y;
        let across_m = (x * away.y - y * away.x).abs();
        let nearest_m = (along_m - half_m).max(zero);
        let furthest_m = (along_m + half_m).max(zero);
        // As `half_width_m`.
        let widening = (furthest_m + self.extent_m) * (2.0 * penumbra) * (1.0 + steepness.min(10.0));
        let is_beside = across_m.simd_gt(widening + self.extent_m + half_m);
        let is_sunward = along_m.simd_lt(-(self.extent_m + half_m));
        let ray_m = f32x8::splat(simd, self.top_m) - (nearest_m - self.extent_m).max(zero) * steepness;
        (is_beside | is_sunward).select(f32x8::splat(simd, f32::MIN), ray_m)
    }
}
