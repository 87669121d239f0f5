//! What a picture of a size shows of a scene: its camera, and whether that can be drawn without a wrong label.
//!
//! Must not know: buffers.

use glam::Vec3;

use crate::error::{Error, Result};
use crate::render::raster::clip::clip_polygon;
use crate::scene::Scene;
use crate::scene::camera::Camera;

/// The camera and the size of the picture that is drawn, after a check of what the scene alone cannot, which knows no picture's size: that the lens can be taken back all over the picture, and
/// that nothing which the picture shows lies before the near plane, where it would be cut away and what lies behind it be
/// labelled.
///
/// # Errors
/// [`Error::Scene`].
pub fn checked(scene: &Scene, size: [u32; 2]) -> Result<(Camera, [u32; 2])> {
    let (camera, drawn) = drawn(&scene.camera, size)?;
    if is_cut(scene, &camera, drawn) {
        return Err(Error::Scene(format!(
            "in a picture of {} x {} pixels with a field of view of {:.1} degrees things would be seen that lie less than {} m \
             along the axis from the lens, and are not drawn; use a smaller camera.fov_deg, a larger camera.height_m, or a \
             --size that is less tall",
            size[0],
            size[1],
            scene.camera.fov_deg(),
            camera.near_m
        )));
    }
    Ok((camera, drawn))
}

/// The camera and the size of the picture that is drawn for one of this size: what a lens brings onto it is taken from a wider
/// one without the lens.
///
/// # Errors
/// [`Error::Scene`] for a lens that folds the picture over, whose inverse does not settle ([`crate::lens::Lens::reach`]), or that
/// reaches too far to be drawn.
pub fn drawn(camera: &Camera, size: [u32; 2]) -> Result<(Camera, [u32; 2])> {
    if camera.lens.is_pinhole() {
        return Ok((*camera, size));
    }
    camera.widened(size).ok_or_else(|| {
        let lens = camera.lens;
        Error::Scene(format!(
            "camera.k1 = {}, k2 = {}, k3 = {}, p1 = {}, p2 = {} bend a picture of {} x {} pixels with a field of view of {:.1} \
             degrees more than can be taken back: it would be folded over, or nearly, or reach far beside it; use smaller ones, a \
             smaller camera.fov_deg, or a --size that is less tall",
            lens.k1,
            lens.k2,
            lens.k3,
            lens.p1,
            lens.p2,
            size[0],
            size[1],
            camera.fov_deg()
        ))
    })
}

/// Whether anything that a picture would show lies before the near plane.
fn is_cut(scene: &Scene, camera: &Camera, [width_px, height_px]: [u32; 2]) -> bool {
    let tan_x = camera.tan_half_fov;
    let tan_y = tan_x * height_px as f32 / width_px as f32;
    // Nothing before the near plane is further away and in the picture.
    let reach_m = 1.001 * camera.near_m * (1.0 + tan_x * tan_x + tan_y * tan_y).sqrt();
    // What is seen is on the inner side of four planes through the eye.
    let sides = [
        tan_x * camera.forward - camera.right,
        tan_x * camera.forward + camera.right,
        tan_y * camera.forward - camera.up,
        tan_y * camera.forward + camera.up,
    ];
    let is_cut = |triangle: [Vec3; 3]| {
        let is_beyond = triangle.iter().all(|corner| corner.dot(camera.forward) >= camera.near_m);
        if is_beyond || sides.iter().any(|side| triangle.iter().all(|corner| corner.dot(*side) < 0.0)) {
            return false;
        }
        let between = |a: &Vec3, b: &Vec3, t: f32| *a + t * (*b - *a);
        let seen = sides.iter().fold(triangle.to_vec(), |polygon, side| {
            clip_polygon(&polygon, |corner| corner.dot(*side), between)
        });
        seen.iter().any(|corner| corner.dot(camera.forward) < camera.near_m)
    };
    let (eye, around) = (camera.eye, Vec3::splat(reach_m));
    let [low, high] = [eye - around, eye + around].map(Vec3::truncate);
    let ground = scene.terrain.triangles_over(low, high);
    let rocks = scene.rocks.build_where(|rock| rock.may_lie_within(reach_m, eye));
    ground.map(|triangle| triangle.map(|corner| corner - eye)).any(is_cut)
        || rocks.iter().any(|(_, rock)| {
            let triangles = rock.triangles(rock.level).iter();
            triangles.map(|t| t.map(|v| rock.centre + rock.vertices[v as usize].position - eye)).any(is_cut)
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::sampler::Config;

    fn shown(size: [u32; 2], set: &[&str]) -> Result<(Camera, [u32; 2])> {
        let mut config = Config::new();
        for assignment in set {
            config.apply_set(assignment).expect("a setting");
        }
        checked(&Scene::build(3, &config.draw(3).expect("values")).expect("a scene"), size)
    }

    #[test]
    fn what_would_be_cut_by_the_near_plane_is_refused() {
        for (size, set) in [
            ([16, 2000], &[][..]),
            ([100, 300], &["camera.fov_deg=130", "camera.height_m=0.2"]),
            ([200, 200], &["camera.fov_deg=150", "camera.height_m=0.2", "camera.roll_deg=45"]),
        ] {
            let error = shown(size, set).expect_err("too near").to_string();
            assert!(error.contains("camera.height_m") && error.contains("0.05 m"), "{error}");
        }
        for (size, set) in [
            ([16, 1000], &[][..]),
            ([512, 512], &["camera.height_m=0.2"]),
            ([2000, 16], &["camera.fov_deg=150"]),
            ([512, 512], &["stage.name=surface", "camera.height_m=0.3", "camera.pitch_deg=-60"]),
        ] {
            shown(size, set).unwrap_or_else(|error| panic!("{size:?} {set:?}: {error}"));
        }
    }

    #[test]
    fn a_lens_is_checked_for_the_picture_that_it_is_in() {
        for (size, set) in
            [([64, 160], "camera.k1=-0.1"), ([64, 512], "camera.k1=0.3"), ([64, 64], "camera.k1=-0.6")]
        {
            let error = shown(size, &[set]).expect_err("a lens that bends too much").to_string();
            assert!(error.contains("camera.k1") && error.contains("--size"), "{error}");
        }
        shown([160, 64], &["camera.k1=-0.1"]).expect("a lens that does not");
    }
}
