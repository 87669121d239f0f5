//! Poses: a scene that is built once, seen by other cameras and under other suns.
//!
//! Must not know: threads, files.

use super::attempt::BuiltScene;
use super::plan::Plan;
use crate::error::{Error, Result};
use crate::params::{Knob, Params, Stage};
use crate::render::{RenderSettings, Staging};
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// A pose of the camera, and a sun.
#[derive(Clone, Debug)]
pub struct Pose {
    params: Params,
    moves_camera: bool,
    eye_z_m: Option<f32>,
}

impl Pose {
    /// A pose in a scene of a plan: `set` is TOML of the knobs that differ, of the sections `camera` and `sun`; what the plan draws besides
    /// stays. `eye_z_m` is the height of the camera, metres, world: heights above the ground are those of the mesh, which differs a
    /// little from camera to camera.
    ///
    /// # Errors
    /// [`Error::Usage`] for a knob of another section; those of [`Config::apply_toml`](crate::params::config::Config::apply_toml),
    /// [`Config::check`](crate::params::config::Config::check) and [`Config::draw`](crate::params::config::Config::draw).
    pub fn new(plan: &Plan, of: &BuiltScene, set: &str, eye_z_m: Option<f32>) -> Result<Self> {
        let mut config = plan.config.clone();
        config.apply_toml(set, "camera and sun")?;
        config.check()?;
        let params = config.draw(of.seed)?;
        let changed = |knob: &Knob| of.params.setting(*knob) != params.setting(*knob);
        let is_of = |knob: &Knob, section: &str| knob.name().starts_with(section);
        let is_pose = |knob: &Knob| is_of(knob, "camera.") || is_of(knob, "sun.");
        if let Some(other) = Knob::ALL.iter().find(|knob| changed(knob) && !is_pose(knob)) {
            return Err(Error::Usage(format!(
                "{}: a scene's pose is that of camera and sun alone",
                other.name()
            )));
        }
        let moves_camera = Knob::ALL.iter().any(|knob| changed(knob) && is_of(knob, "camera."));
        Ok(Self { params, moves_camera, eye_z_m })
    }

    /// The scene from this pose. The nominal stage is the same geometry from every pose; the ground of the surface stage is made for the
    /// camera, and is made again where the camera has moved. Returns what of it is to be staged as well.
    ///
    /// # Errors
    /// Those of [`Scene::build`].
    pub fn in_scene(&self, of: &BuiltScene, settings: &RenderSettings) -> Result<(BuiltScene, Staging)> {
        let params = self.params.clone();
        let (mut built, staging) = if self.moves_camera && params.stage() == Stage::Surface {
            (BuiltScene::new(of.seed, params, settings)?, Staging::Whole)
        } else {
            let mut scene = Scene { sun: Sun::build(&params), ..of.scene.clone() };
            if self.moves_camera {
                scene.camera = Camera::build(&params, &scene.terrain)?;
            }
            (BuiltScene { seed: of.seed, scene, params }, Staging::WithoutMeshes)
        };
        if let Some(z_m) = self.eye_z_m {
            built.scene.camera.eye.z = z_m;
        }
        Ok((built, staging))
    }
}
