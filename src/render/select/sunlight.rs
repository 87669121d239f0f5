//! Where the sun shines, past the ground and past the rocks, before any shadow is drawn: what the light that sunlit surfaces give
//! others starts from.
//!
//! A rock's shadow is that of an octagon around its outline. What the horizon map tells of the ground comes in as a function, so that
//! imports go from `shadow/` to `select/` and not back.
//! Must not know: how the horizon map is made, what is done with the light.

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::render::select::caster_grid::{CasterGrids, TEST_HORIZON};
use crate::render::select::casters::Caster;
use crate::render::select::lane_math::LANES;
use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::rocks::Rock;

/// Subdivision level of a rock's mesh that stands for the rock.
pub const COARSE_LEVEL: usize = 1;
/// Unit vectors of half of the sides of an octagon, their first coordinates and their second; the others are opposite.
const OCTAGON: [Vec4; 2] = {
    const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
    [Vec4::new(1.0, DIAGONAL, 0.0, -DIAGONAL), Vec4::new(0.0, DIAGONAL, 1.0, DIAGONAL)]
};

/// Heights above a point from which the lower and the upper limb of the sun are visible past the ground, metres.
pub type LimbsAt<'a> = &'a (dyn Fn(Vec2) -> [f32; 2] + Sync);

/// The same above eight points at once: from their coordinates the heights of the lower limb, then those of the upper.
pub type LimbsAtLanes<'a> = &'a (dyn Fn(&[[f32; LANES]; 2]) -> [[f32; LANES]; 2] + Sync);

/// Fraction of the sun's disc that is visible at a height (metres, world) where these are the heights of the limbs.
fn visible_above([lower, upper]: [f32; 2], height_m: f32) -> f32 {
    ((height_m - upper) / (lower - upper).max(1e-6)).clamp(0.0, 1.0)
}

/// What decides where the sun shines.
pub struct Sunlight<'a> {
    scene: &'a Scene,
    casters: &'a [Caster],
    outlines: Vec<Outline>,
    grids: CasterGrids,
    caster_grid: &'a [u32],
    limbs: LimbsAt<'a>,
    /// The plane across the sun's rays.
    across: [Vec3; 2],
}

/// How far a caster reaches from its centre across the sun's rays, metres.
#[derive(Clone, Copy, Debug)]
struct Outline {
    /// For each pair of sides of the octagon.
    min_m: Vec4,
    max_m: Vec4,
    area_m2: f32,
}

impl Outline {
    fn new(rock: &Rock, [right, up]: [Vec3; 2]) -> Self {
        let coarse = Icosphere::vertex_count(COARSE_LEVEL);
        let count = if rock.body.is_rock() { coarse.min(rock.vertices.len()) } else { rock.vertices.len() };
        let (mut min_m, mut max_m) = (Vec4::MAX, Vec4::MIN);
        for vertex in &rock.vertices[..count] {
            let reaches_m = reaches_m(Vec2::new(vertex.position.dot(right), vertex.position.dot(up)));
            (min_m, max_m) = (min_m.min(reaches_m), max_m.max(reaches_m));
        }
        let width_m = (max_m - min_m).element_sum() / 4.0;
        Self { min_m, max_m, area_m2: 0.25 * std::f32::consts::PI * width_m * width_m }
    }

    /// Distance of a point from the outline, metres; negative inside.
    fn distance_m(&self, at: Vec2) -> f32 {
        let reaches_m = reaches_m(at);
        (self.min_m - reaches_m).max(reaches_m - self.max_m).max_element()
    }
}

/// How far a point across the sun's rays lies towards half of the sides of an octagon, metres.
fn reaches_m(at: Vec2) -> Vec4 {
    at.x * OCTAGON[0] + at.y * OCTAGON[1]
}

impl<'a> Sunlight<'a> {
    /// Of a scene with these shadow casters and their grid.
    #[must_use]
    pub fn new(scene: &'a Scene, casters: &'a [Caster], caster_grid: &'a [u32], limbs: LimbsAt<'a>) -> Self {
        let across = scene.sun.right_and_up();
        let outlines = casters.par_iter().map(|caster| Outline::new(&scene.rocks[caster.rock], across));
        let grids = CasterGrids::new(&scene.terrain);
        Self { scene, casters, outlines: outlines.collect(), grids, caster_grid, limbs, across }
    }

    /// Fraction of the sun's disc that is visible past the ground.
    #[must_use]
    pub fn past_ground(&self, point: Vec3) -> f32 {
        visible_above((self.limbs)(point.truncate()), point.z)
    }

    /// Fraction of a disc of this radius that is sunlit past all rocks but one.
    #[must_use]
    pub fn past_rocks(&self, point: Vec3, radius_m: f32, but: usize) -> f32 {
        let sun = self.scene.sun.direction;
        let [right, up] = self.across;
        let disc_m2 = std::f32::consts::PI * radius_m * radius_m;
        self.casters_at(point.truncate()).iter().fold(1.0, |sunlit, &index| {
            let (caster, outline) = (&self.casters[index as usize], &self.outlines[index as usize]);
            let offset = point - caster.tile.centre;
            if caster.rock == but || offset.dot(sun) >= 0.0 {
                return sunlit;
            }
            let distance_m = outline.distance_m(Vec2::new(offset.dot(right), offset.dot(up)));
            let covered = (0.5 - 0.5 * distance_m / radius_m).clamp(0.0, 1.0);
            sunlit * (1.0 - covered * (outline.area_m2 / disc_m2).min(1.0))
        })
    }

    /// The casters that can shade a point.
    fn casters_at(&self, point: Vec2) -> &[u32] {
        let CasterGrids { centre, half_m, cells, levels } = self.grids;
        let from_centre = (point - centre).abs().max_element();
        let mut level = 0;
        while level + 1 < levels && from_centre > half_m * (1_u32 << level) as f32 {
            level += 1;
        }
        let half_m = half_m * (1_u32 << level) as f32;
        let index = |metres: f32| {
            ((metres + half_m) * 0.5 * cells as f32 / half_m).clamp(0.0, (cells - 1) as f32) as u32
        };
        let cell = ((level * cells + index(point.y - centre.y)) * cells + index(point.x - centre.x)) as usize;
        let [start, end] = [cell, cell + 1].map(|cell| (self.caster_grid[cell] & !TEST_HORIZON) as usize);
        &self.caster_grid[start..end]
    }
}
