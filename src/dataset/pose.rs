//! Poses: a scene that is built once, seen by other cameras and under other suns.
//!
//! Must not know: threads, files.

use super::attempt::BuiltScene;
use super::plan::Plan;
use super::rules::{Rules, Violation};
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
        // The sun stays where it is, also if its azimuth counts from the camera's.
        let azimuth_deg = of.params.number(Knob::SunAzimuthDeg);
        config.apply_toml(&format!("sun.azimuth_deg = {azimuth_deg:?}"), "the scene")?;
        config.apply_toml(set, "camera and sun")?;
        config.check()?;
        let mut params = config.draw(of.seed)?;
        let is_kept = |knob| params.number(knob) == of.params.number(knob);
        if is_kept(Knob::SunAzimuthDeg) && is_kept(Knob::CameraYawDeg) {
            // As it was drawn: computed, it may be a turn less.
            params.take_over(Knob::SunRelativeAzimuthDeg, &of.params);
        }
        let changed = |knob: &Knob| of.params.setting(*knob) != params.setting(*knob);
        let is_of = |knob: &Knob, section: &str| knob.name().starts_with(section);
        let is_pose = |knob: &Knob| is_of(knob, "camera.") || is_of(knob, "sun.");
        if let Some(other) = Knob::ALL.iter().find(|knob| changed(knob) && !is_pose(knob)) {
            return Err(Error::Usage(format!(
                "{}: a scene's pose is that of camera and sun alone",
                other.name()
            )));
        }
        let is_at_other_z = eye_z_m.is_some_and(|z_m| z_m != of.scene.camera.eye.z);
        let moves_camera =
            is_at_other_z || Knob::ALL.iter().any(|knob| changed(knob) && is_of(knob, "camera."));
        Ok(Self { params, moves_camera, eye_z_m })
    }

    /// The scene from this pose. The nominal stage is the same geometry from every pose; the ground of the surface stage is made for the
    /// camera, and is made again where the camera has moved. Returns what of it is to be staged as well.
    ///
    /// # Errors
    /// Those of [`Scene::build`], and [`Error::Scene`] for a camera below the ground, inside a rock or outside the sky dome.
    pub fn in_scene(&self, of: &BuiltScene, settings: &RenderSettings) -> Result<(BuiltScene, Staging)> {
        let (seed, params) = (of.seed, self.params.clone());
        if !self.moves_camera {
            let scene = Scene { sun: Sun::build(&params), ..of.scene.clone() };
            return Ok((BuiltScene { seed, scene, params }, Staging::WithoutMeshes));
        }
        let is_made_again = params.stage() == Stage::Surface;
        let BuiltScene { scene, params, .. } = if is_made_again {
            of.for_pose(params, settings)?
        } else {
            let camera = Camera::build(&params, &of.scene.terrain)?;
            BuiltScene { seed, scene: Scene { sun: Sun::build(&params), camera, ..of.scene.clone() }, params }
        };
        let mut camera = scene.camera;
        camera.eye.z = self.eye_z_m.unwrap_or(camera.eye.z);
        let scene = scene.seen_by(&params, camera);
        scene.sky.check_around(camera.eye)?;
        let staging = if is_made_again { Staging::Whole } else { Staging::for_moved_camera(&scene) };
        match Rules::violation_of_scene(&scene) {
            Some(Violation { found, .. }) => Err(Error::Scene(found)),
            None => Ok((BuiltScene { seed, scene, params }, staging)),
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "test points may use std's functions")]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::dataset::rules::Rules;
    use crate::params::config::Config;

    fn plan(set: &[&str]) -> Plan {
        let mut config = Config::new();
        set.iter().for_each(|assignment| config.apply_set(assignment).expect("a setting"));
        let settings = RenderSettings::new([64, 48], 1).expect("settings");
        Plan::in_memory(config, Rules::default(), 7, settings, Vec::new())
    }

    fn built(plan: &Plan) -> BuiltScene {
        BuiltScene::new(7, plan.config.draw(7).expect("drawn"), &plan.settings).expect("a scene")
    }

    #[test]
    fn a_camera_takes_its_rover_along() {
        let plan = plan(&["rover.kind=rover"]);
        let of = built(&plan);
        let parts = |scene: &Scene| {
            let parts = (scene.rocks.count()..scene.rocks.len()).map(|index| scene.rocks[index].centre);
            parts.collect::<Vec<_>>()
        };
        let moved = Pose::new(&plan, &of, "camera.x_m = 20\ncamera.y_m = -30", None).expect("a pose");
        let (seen, staging) = moved.in_scene(&of, &plan.settings).expect("a scene");
        assert!(parts(&seen.scene).len() > 5 && parts(&seen.scene) != parts(&of.scene));
        assert_eq!(staging, Staging::Whole);
        let fresh = Scene::build(7, &seen.params).expect("a scene");
        assert_eq!(parts(&seen.scene), parts(&fresh));
        assert_eq!(seen.scene.rocks.len(), of.scene.rocks.len());
        let sun = Pose::new(&plan, &of, "sun.elevation_deg = 30", None).expect("a pose");
        let (lit, staging) = sun.in_scene(&of, &plan.settings).expect("a scene");
        assert_eq!((parts(&lit.scene), staging), (parts(&of.scene), Staging::WithoutMeshes));
    }

    /// What counts from the camera counts from that of the scene.
    #[test]
    fn sun_wall_and_tracks_stay_where_they_are() {
        let plan = plan(&[
            "stage.name=surface",
            "sun.relative_azimuth_deg=70",
            "wall.height_m=60",
            "wall.distance_m=400",
            "tracks.count=2",
            "tracks.own=yes",
            "rover.kind=rover",
        ]);
        let of = built(&plan);
        let set = "camera.yaw_deg = 90\ncamera.x_m = 3\ncamera.y_m = -85";
        let (seen, _) = Pose::new(&plan, &of, set, None)
            .and_then(|pose| pose.in_scene(&of, &plan.settings))
            .expect("a scene");
        assert_eq!(seen.scene.sun, of.scene.sun);
        let tracks = |scene: &Scene| -> Vec<Vec2> {
            let relief = scene.relief.as_ref().expect("relief");
            relief.tracks.iter().map(|track| scene.terrain.centre + track.offset).collect()
        };
        let (before, after) = (tracks(&of.scene), tracks(&seen.scene));
        assert!(before.len() == 3 && before.iter().zip(&after).all(|(a, b)| a.distance(*b) < 1e-3));
        let heights = |scene: &Scene| {
            let around = (0..12).map(|i| {
                let (sin, cos) = (f64::from(i) / 12.0 * std::f64::consts::TAU).sin_cos();
                Vec2::new(450.0 * sin as f32, 450.0 * cos as f32)
            });
            around.map(|point| scene.terrain.height_at(point)).collect::<Vec<f32>>()
        };
        let (before, after) = (heights(&of.scene), heights(&seen.scene));
        assert!(before.iter().fold(0.0_f32, |a, b| a.max(*b)) > 40.0, "no wall: {before:?}");
        for (a, b) in before.iter().zip(&after) {
            // Cells of the mesh are wide where the camera does not look.
            assert!((a - b).abs() < 6.0, "{before:?} {after:?}");
        }
    }

    #[test]
    fn a_pose_that_moves_nothing_has_the_parameters_of_the_scene() {
        for sun in ["sun.relative_azimuth_deg=270", "sun.azimuth_deg=300"] {
            let plan = plan(&["stage.name=surface", sun, "camera.yaw_deg=15"]);
            let of = built(&plan);
            let pose = |set| Pose::new(&plan, &of, set, None).expect("a pose").params;
            assert_eq!(pose(""), of.params);
            assert_eq!(pose("camera.yaw_deg = 25").number(Knob::SunRelativeAzimuthDeg), {
                let relative = of.params.number(Knob::SunRelativeAzimuthDeg) - 10.0;
                if relative > 180.0 { relative - 360.0 } else { relative }
            });
        }
    }

    #[test]
    fn a_camera_below_the_ground_or_inside_a_rock_is_refused() {
        let plan = plan(&[]);
        let of = built(&plan);
        let rock = of.scene.rocks.iter().max_by(|a, b| a.radius_m.total_cmp(&b.radius_m)).expect("a rock");
        let at = format!("camera.x_m = {}\ncamera.y_m = {}", rock.centre.x, rock.centre.y);
        let refused = |z_m| {
            let pose = Pose::new(&plan, &of, &at, Some(z_m)).expect("a pose");
            pose.in_scene(&of, &plan.settings).map(|_| ()).map_err(|error| error.to_string())
        };
        assert!(refused(rock.centre.z).expect_err("inside").contains("inside rock"));
        assert!(refused(-100.0).expect_err("below").contains("above the ground"));
        refused(rock.centre.z + 2.0 * rock.radius_m).expect("above the rock");
    }

    /// Hills surround the camera of the scene, and it is near that one that craters have rays.
    #[test]
    fn hills_and_rays_stay_where_they_are() {
        let plan =
            plan(&["stage.name=surface", "relief.far_hills_m=300", "regolith.rays=0.5", "rocks.coverage=0"]);
        let of = built(&plan);
        let pose = Pose::new(&plan, &of, "camera.x_m = 170\ncamera.y_m = 60", None).expect("a pose");
        let (seen, _) = pose.in_scene(&of, &plan.settings).expect("a scene");
        let heights = |BuiltScene { scene, .. }: &BuiltScene| {
            let relief = scene.relief.as_ref().expect("relief");
            let around = (0..24).map(|k| {
                let (sin, cos) = (f64::from(k) / 24.0 * std::f64::consts::TAU).sin_cos();
                Vec2::new(800.0 * sin as f32, 800.0 * cos as f32)
            });
            around.map(|point| relief.height_at(point - scene.terrain.centre, 2.0)).collect::<Vec<f32>>()
        };
        let (before, after) = (heights(&of), heights(&seen));
        assert!(before.iter().any(|height_m| *height_m > 60.0), "no hills: {before:?}");
        for (a, b) in before.iter().zip(&after) {
            assert!((a - b).abs() < 0.05, "{before:?} {after:?}");
        }
        let rays = |BuiltScene { scene, .. }: &BuiltScene| {
            let craters = &scene.relief.as_ref().expect("relief").crater_rays.craters;
            craters
                .iter()
                .map(|crater| (crater.seed, scene.terrain.centre + crater.offset))
                .collect::<Vec<_>>()
        };
        let (before, after) = (rays(&of), rays(&seen));
        assert!(before.len() == after.len() && before.len() > 2, "{before:?} {after:?}");
        for (a, b) in before.iter().zip(&after) {
            assert!(a.0 == b.0 && a.1.distance(b.1) < 1e-3, "{before:?} {after:?}");
        }
    }

    /// On both stages, the head of the rover is where the camera is.
    #[test]
    fn a_rover_is_as_high_as_its_camera() {
        for stage in ["stage.name=nominal", "stage.name=surface"] {
            let plan = plan(&[stage, "rover.kind=rover"]);
            let of = built(&plan);
            let at = "camera.x_m = 3\ncamera.y_m = -85";
            let head_m = |z_m: Option<f32>| {
                let pose = Pose::new(&plan, &of, at, z_m).expect("a pose");
                let scene = pose.in_scene(&of, &plan.settings).expect("a scene").0.scene;
                let parts = (scene.rocks.count()..scene.rocks.len()).map(|index| &scene.rocks[index]);
                let tops_m = parts.map(|part| part.centre.z + part.z_range_m[1]);
                (scene.camera.eye.z, tops_m.fold(f32::MIN, f32::max))
            };
            let (eye_m, top_m) = head_m(None);
            let (higher_m, higher_top_m) = head_m(Some(eye_m + 0.75));
            assert_eq!(higher_m, eye_m + 0.75);
            let rise_m = (higher_top_m - higher_m) - (top_m - eye_m);
            assert!(rise_m.abs() < 1e-4, "{stage}: the head stays {rise_m} m behind");
        }
    }

    #[test]
    fn a_camera_that_only_sinks_or_leaves_the_dome_is_refused() {
        let plan = plan(&["sky.dome_radius_m=300"]);
        let of = built(&plan);
        let refused = |set: &str, z_m| {
            let pose = Pose::new(&plan, &of, set, z_m).expect("a pose");
            pose.in_scene(&of, &plan.settings).map(|_| ()).map_err(|error| error.to_string())
        };
        assert!(refused("", Some(-100.0)).expect_err("below").contains("above the ground"));
        let outside = refused("camera.y_m = 300", None).expect_err("outside");
        assert!(outside.contains("390 m") && outside.contains("sky.dome_radius_m = 300"), "{outside}");
        assert!(refused("", Some(310.0)).expect_err("above").contains("sky.dome_radius_m"));
        refused("camera.y_m = 150", None).expect("inside");
    }
}
