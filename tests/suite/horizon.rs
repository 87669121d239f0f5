//! The map of the ground's horizon: that of what an image shows is that of more ground.

use glam::Vec2;
use regolith::render::select::footprint::Footprint;
use regolith::render::select::selection::Selection;
use regolith::render::shadow::horizon::HorizonMap;
use regolith::render::{DEFAULT_TEXTURE_PX, RenderSettings};

use crate::support::scene;

/// Largest difference of two heights, metres: grids hand heights on at other places, between other samples.
const TOLERANCE_M: f32 = 0.05;

/// Ground far beyond what is in view shadows it, and a map reaches it through grids that each know little more than the view.
#[test]
fn ground_out_of_view_casts_its_shadow_into_view() {
    let (mut compared, mut shadowed) = (0, 0);
    for seed in 1..=12_u64 {
        for elevation_deg in [2, 5, 8] {
            let sun = [
                format!("sun.elevation_deg={elevation_deg}"),
                format!("sun.azimuth_deg={}", (67 * seed) % 360),
            ];
            let scene = scene(seed, &["stage.name=surface", &sun[0], &sun[1]]);
            let settings = RenderSettings::new([256; 2], 1).expect("settings");
            let in_view = Footprint::new(&scene, &Selection::new(&scene, &settings));
            let centre = scene.terrain.centre;
            let around = [Vec2::ONE, Vec2::new(-1.0, 1.0), Vec2::NEG_ONE, Vec2::new(1.0, -1.0)]
                .map(|corner| centre + 150.0 * corner);
            let [of_view, of_more] = [in_view, Footprint::hull(around.into_iter())].map(|footprint| {
                let mut map = HorizonMap::default();
                map.compute(&scene.terrain, &scene.sun, &footprint, DEFAULT_TEXTURE_PX);
                map
            });
            for step in 0..400 {
                // Fans out over the middle of the view.
                let (ahead_m, across) = (2.0 * 1.009_f32.powi(step), 0.4 * (step % 7 - 3) as f32 / 3.0);
                let forward = scene.camera.forward.truncate().normalize();
                let point = centre + ahead_m * (forward + across * forward.perp());
                let ground_m = scene.terrain.surface_height_at(point);
                let [limbs, expected] =
                    [&of_view, &of_more].map(|map| map.limbs_at(point).map(|limb| limb.max(ground_m)));
                let difference_m =
                    (0..2).map(|limb| (limbs[limb] - expected[limb]).abs()).fold(0.0, f32::max);
                assert!(
                    difference_m < TOLERANCE_M,
                    "seed {seed}, sun {elevation_deg} deg high, {ahead_m} m ahead: {limbs:?} m for {expected:?}"
                );
                compared += 1;
                shadowed += usize::from(expected[1] > ground_m);
            }
        }
    }
    assert!(3 * shadowed > compared, "{shadowed} of {compared} points are in shadow");
}
