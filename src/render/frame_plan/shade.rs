//! What lights the shadows of a frame, found on the host: sunlit ground as each place and each rock sees it, and sunlit rocks.
//! Must not know: a device.

use glam::{Vec2, Vec3};

use crate::render::device::shader_structs::Instance;
use crate::render::select::footprint::Footprint;
use crate::render::select::ground_grids::GroundGrids;
use crate::render::select::ground_light::GroundLight;
use crate::render::select::lit_rocks::LitRocks;
use crate::render::select::rock_light::LightOnRock;
use crate::render::select::selection::{Selection, Slots};
use crate::render::settings::RenderSettings;
use crate::render::shadow::horizon::HorizonMap;
use crate::scene::Scene;
use crate::scene::bounce::Bounce;
use crate::scene::photometry::Law;

/// The ground that lights what is in shadow, and the map of its light; none under laws other than Hapke's, which take light from level
/// ground alone.
pub(super) fn ground_light(
    scene: &Scene,
    settings: &RenderSettings,
    selection: &Selection,
    footprint: &Footprint,
    bounce: &Bounce,
) -> (Option<GroundGrids>, GroundLight) {
    if scene.photometry.law != Law::Hapke {
        return (None, GroundLight::default());
    }
    let ground = GroundGrids::new(scene, selection, bounce, pixel_angle(scene, settings));
    let map = GroundLight::new(&ground, footprint);
    (Some(ground), map)
}

/// From where the sun is visible around what is in view. Over the footprint the horizon map has it. Beyond, the map holds ground that was
/// swept for other frames, or none, so that there the cells of the grids tell: a frame depends on no other.
pub(super) struct LimbLookup<'a> {
    horizon: &'a HorizonMap,
    /// Of the footprint.
    sides: Vec<Vec3>,
    ground: &'a GroundGrids,
}

impl<'a> LimbLookup<'a> {
    pub(super) fn new(horizon: &'a HorizonMap, footprint: &Footprint, ground: &'a GroundGrids) -> Self {
        Self { horizon, sides: footprint.sides(), ground }
    }

    /// Heights above points from which the lower and the upper limb are visible, as [`HorizonMap::limbs_at_many`] has them.
    fn at<const COUNT: usize>(&self, points: &[[f32; COUNT]; 2]) -> [[f32; COUNT]; 2] {
        let mut limbs = self.horizon.limbs_at_many(points);
        let mut inside = [if self.sides.is_empty() { f32::MIN } else { f32::MAX }; COUNT];
        for side in &self.sides {
            for (inside, (x, y)) in inside.iter_mut().zip(points[0].iter().zip(&points[1])) {
                *inside = inside.min(side.x * x + side.y * y + side.z);
            }
        }
        for (i, _) in inside.iter().enumerate().filter(|(_, inside)| **inside < 0.0) {
            let index = self.ground.grids.index_at(Vec2::new(points[0][i], points[1][i]));
            [limbs[0][i], limbs[1][i]] = self.ground.cells[index].limbs_m;
        }
        limbs
    }
}

/// The sunlit rocks of a selection.
pub(super) fn lit_rocks(
    scene: &Scene,
    settings: &RenderSettings,
    selection: &Selection,
    caster_grid: &[u32],
    limbs: &LimbLookup<'_>,
) -> LitRocks {
    let colour = 1.0 / scene.photometry.at_normal(scene.photometry.rock_b_s0) as f32;
    let limbs = |point: Vec2| limbs.at(&[[point.x], [point.y]]).map(|[limb]| limb);
    LitRocks::new(scene, selection, caster_grid, &limbs, (colour, pixel_angle(scene, settings)))
}

/// Angle of a pixel in the middle of the image, radians.
fn pixel_angle(scene: &Scene, settings: &RenderSettings) -> f32 {
    1.0 / scene.camera.focal_px(settings.size[0]) as f32
}

/// Sets what the light on rocks depends on: the ground around each.
pub(super) fn set_surroundings(
    scene: &Scene,
    selection: &Selection,
    limbs: &LimbLookup<'_>,
    instances: &mut [Instance],
) {
    let ground = limbs.ground;
    let limbs = |points: &_| limbs.at(points);
    let on_rocks = LightOnRock::on_selection(scene, selection, ground, &limbs);
    let rocks = instances[Slots::rock(0) as usize..].iter_mut();
    for ((instance, exposed), light) in rocks.zip(&ground.exposed).zip(on_rocks) {
        instance.ground_z = exposed.foot.z;
        instance.per_height = 1.0 / exposed.height_m;
        instance.lit_below = light.below;
        instance.lit_beside = light.beside;
        instance.lit_on_top = light.beside_on_top;
    }
}
