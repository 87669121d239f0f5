//! What lights the shadows of a frame, found on the host: sunlit ground as each place and each rock sees it, and sunlit rocks.
//! Must not know: a device.

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

/// The sunlit rocks of a selection; none under laws other than Hapke's, which take light from level ground alone.
pub(super) fn lit_rocks(
    scene: &Scene,
    settings: &RenderSettings,
    selection: &Selection,
    caster_grid: &[u32],
    horizon: &HorizonMap,
) -> LitRocks {
    if scene.photometry.law != Law::Hapke {
        return LitRocks::default();
    }
    let colour = 1.0 / scene.photometry.at_normal(scene.photometry.rock_b_s0) as f32;
    let limbs = |point| horizon.limbs_at(point);
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
    ground: &GroundGrids,
    horizon: &HorizonMap,
    instances: &mut [Instance],
) {
    let limbs = |points: &_| horizon.limbs_at_many(points);
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
