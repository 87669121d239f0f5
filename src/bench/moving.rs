//! One scene whose camera and sun move from frame to frame.
//!
//! Must not know: how a frame is measured.

use crate::dataset::attempt::{BuiltScene, build_scene};
use crate::dataset::plan::Plan;
use crate::error::Result;
use crate::params::Knob;
use crate::render::Staging;
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// Number of frames after which camera and sun are back where they started.
const PERIOD: u64 = 40;

/// A scene, and how camera and sun move in it.
pub(super) struct Moving {
    /// At the start.
    pub(super) still: BuiltScene,
}

impl Moving {
    /// The scene of a plan's base seed.
    pub(super) fn new(plan: &Plan) -> Result<Self> {
        Ok(Self { still: build_scene(plan, plan.base_seed)? })
    }

    /// Moves the camera of a clone of the scene and, if `sun_moves`, its sun to where they are at a frame.
    pub(super) fn set_pose(&self, scene: &mut Scene, frame: u64, sun_moves: bool) {
        let BuiltScene { scene: still, params, .. } = &self.still;
        let (eye, sun) = (still.camera.eye, still.sun);
        let number = |knob| params.number(knob);
        let turn = std::f64::consts::TAU * (frame % PERIOD) as f64 / PERIOD as f64;
        let mut moved_eye = eye;
        moved_eye.x += 2.0 * libm::sin(turn) as f32;
        moved_eye.z +=
            scene.terrain.height_at(moved_eye.truncate()) - scene.terrain.height_at(eye.truncate());
        let angles = [
            number(Knob::CameraPitchDeg) + libm::cos(turn),
            number(Knob::CameraYawDeg) + 8.0 * libm::sin(turn),
            number(Knob::CameraRollDeg),
        ];
        let (far_m, exposure_ev) = (scene.camera.far_m, scene.camera.exposure_ev);
        let camera = Camera::new(moved_eye, angles, number(Knob::CameraFovDeg), far_m, exposure_ev);
        let camera = Camera { lens: still.camera.lens, ..camera };
        if still.has_rover() {
            *scene = scene.clone().seen_by(params, camera);
        } else {
            scene.camera = camera;
        }
        if sun_moves {
            let azimuth_deg = (sun.azimuth_deg + 30.0 * libm::sin(turn)).rem_euclid(360.0);
            scene.sun = Sun::new(sun.elevation_deg, azimuth_deg, sun.angular_diameter_deg, sun.irradiance);
        }
    }

    /// The scene with camera and sun moved, for any thread.
    pub(super) fn scene_of_frame(&self, frame: u64) -> (BuiltScene, Staging) {
        let mut moved = self.still.clone();
        self.set_pose(&mut moved.scene, frame, true);
        let staging = Staging::for_moved_camera(&moved.scene);
        (moved, staging)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::rules::Rules;
    use crate::params::config::Config;
    use crate::render::RenderSettings;

    #[test]
    fn a_moving_camera_keeps_its_lens_and_its_rover() {
        let mut config = Config::new();
        for assignment in ["camera.k1=-0.05", "rover.kind=rover"] {
            config.apply_set(assignment).expect("a setting");
        }
        let settings = RenderSettings::new([64, 48], 1).expect("settings");
        let plan = Plan::in_memory(config, Rules::accepting_any_image(), 7, settings, Vec::new());
        let moving = Moving::new(&plan).expect("a scene");
        let still = &moving.still.scene;
        let (moved, staging) = moving.scene_of_frame(PERIOD / 4);
        assert_eq!(moved.scene.camera.lens, still.camera.lens);
        assert!(moved.scene.camera.lens.k1 < 0.0 && staging == Staging::Whole);
        let part = |scene: &Scene| (scene.rocks[scene.rocks.count()].centre - scene.camera.eye).truncate();
        // It tilts with the ground below it.
        assert!(part(&moved.scene).distance(part(still)) < 0.5);
        assert!(moved.scene.camera.eye.distance(still.camera.eye) > 1.0);
    }
}
