//! One scene whose camera and sun move from frame to frame.
//!
//! Must not know: how a frame is measured.

use crate::dataset::attempt::{BuiltScene, build_scene};
use crate::dataset::plan::Plan;
use crate::error::Result;
use crate::params::Knob;
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
        scene.camera = Camera::new(moved_eye, angles, number(Knob::CameraFovDeg), far_m, exposure_ev);
        if sun_moves {
            let azimuth_deg = (sun.azimuth_deg + 30.0 * libm::sin(turn)).rem_euclid(360.0);
            scene.sun = Sun::new(sun.elevation_deg, azimuth_deg, sun.angular_diameter_deg, sun.irradiance);
        }
    }

    /// The scene with camera and sun moved, for any thread.
    pub(super) fn scene_of_frame(&self, frame: u64) -> BuiltScene {
        let mut moved = self.still.clone();
        self.set_pose(&mut moved.scene, frame, true);
        moved
    }
}
