//! The camera of an image, and whether the near plane would cut a surface that the image shows.
//!
//! Must not know: buffers.

use glam::Vec3;

use crate::error::{Error, Result};
use crate::render::raster::clip::clip_polygon;
use crate::scene::Scene;
use crate::scene::camera::Camera;

/// The camera and the size that an image is drawn with (see [`drawn`]), after the checks that need the image size: that its lens is
/// invertible all over the image, and that no visible surface is nearer than the near plane. It would be clipped, and the surface
/// behind it labelled.
///
/// # Errors
/// [`Error::Scene`].
pub fn checked(scene: &Scene, size: [u32; 2]) -> Result<(Camera, [u32; 2])> {
    let (camera, drawn_size) = drawn(&scene.camera, size)?;
    if near_plane_cuts_view(scene, &camera, drawn_size) {
        return Err(Error::Scene(format!(
            "an image of {} x {} pixels with a field of view of {:.1} degrees would show surfaces less than {} m from the camera \
             along its axis, which the near plane cuts away; use a smaller camera.fov_deg, a larger camera.height_m, or a \
             --size that is less tall",
            size[0],
            size[1],
            scene.camera.fov_deg(),
            camera.near_m
        )));
    }
    Ok((camera, drawn_size))
}

/// The camera and the size that an image of this size is drawn with: without a lens as they are, with one the wider pinhole image
/// that the distorted one is sampled from.
///
/// # Errors
/// [`Error::Scene`] for a lens that folds the image over, whose inverse does not converge ([`crate::lens::Lens::reach`]), or that
/// needs too wide an image.
pub fn drawn(camera: &Camera, size: [u32; 2]) -> Result<(Camera, [u32; 2])> {
    if camera.lens.is_pinhole() {
        return Ok((*camera, size));
    }
    camera.widened(size).ok_or_else(|| {
        let lens = camera.lens;
        Error::Scene(format!(
            "camera.k1 = {}, k2 = {}, k3 = {}, p1 = {}, p2 = {} distort an image of {} x {} pixels with a field of view of {:.1} \
             degrees more than can be inverted: it would be folded over, or nearly, or need an image far wider; use smaller ones, \
             a smaller camera.fov_deg, or a --size that is less tall",
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

/// Whether any surface in the view is nearer than the near plane.
fn near_plane_cuts_view(scene: &Scene, camera: &Camera, [width_px, height_px]: [u32; 2]) -> bool {
    let tan_x = camera.tan_half_fov;
    let tan_y = tan_x * height_px as f32 / width_px as f32;
    // The corners of the near rectangle are its furthest points from the eye.
    let reach_m = 1.001 * camera.near_m * (1.0 + tan_x * tan_x + tan_y * tan_y).sqrt();
    // Inward normals of the side planes of the frustum, which pass through the eye.
    let side_planes = [
        tan_x * camera.forward - camera.right,
        tan_x * camera.forward + camera.right,
        tan_y * camera.forward - camera.up,
        tan_y * camera.forward + camera.up,
    ];
    let is_cut = |triangle: [Vec3; 3]| {
        let is_beyond = triangle.iter().all(|corner| corner.dot(camera.forward) >= camera.near_m);
        if is_beyond || side_planes.iter().any(|side| triangle.iter().all(|corner| corner.dot(*side) < 0.0)) {
            return false;
        }
        let interpolate = |inner: &Vec3, outer: &Vec3, t: f32| *inner + t * (*outer - *inner);
        let visible_part = side_planes.iter().fold(triangle.to_vec(), |polygon, side| {
            clip_polygon(&polygon, |corner| corner.dot(*side), interpolate)
        });
        visible_part.iter().any(|corner| corner.dot(camera.forward) < camera.near_m)
    };
    let (eye, reach) = (camera.eye, Vec3::splat(reach_m));
    let [low, high] = [eye - reach, eye + reach].map(Vec3::truncate);
    let ground = scene.terrain.triangles_over(low, high);
    let rocks = scene.rocks.build_where(|rock| rock.may_lie_within(reach_m, eye));
    ground.map(|triangle| triangle.map(|corner| corner - eye)).any(is_cut)
        || rocks.iter().filter(|(_, rock)| rock.body.is_visible()).any(|(_, rock)| {
            let triangles = rock.triangles(rock.level).iter();
            triangles.map(|t| t.map(|v| rock.centre + rock.vertices[v as usize].position - eye)).any(is_cut)
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;

    fn view_of(size: [u32; 2], set: &[&str]) -> Result<(Camera, [u32; 2])> {
        let mut config = Config::new();
        for assignment in set {
            config.apply_set(assignment).expect("a setting");
        }
        checked(&Scene::build(3, &config.draw(3).expect("values")).expect("a scene"), size)
    }

    #[test]
    fn a_view_that_the_near_plane_cuts_is_refused() {
        for (size, set) in [
            ([16, 2000], &[][..]),
            ([100, 300], &["camera.fov_deg=130", "camera.height_m=0.2"]),
            ([200, 200], &["camera.fov_deg=150", "camera.height_m=0.2", "camera.roll_deg=45"]),
        ] {
            let error = view_of(size, set).expect_err("too near").to_string();
            assert!(error.contains("camera.height_m") && error.contains("0.05 m"), "{error}");
        }
        for (size, set) in [
            ([16, 1000], &[][..]),
            ([512, 512], &["camera.height_m=0.2"]),
            ([2000, 16], &["camera.fov_deg=150"]),
            ([512, 512], &["stage.name=surface", "camera.height_m=0.3", "camera.pitch_deg=-60"]),
        ] {
            view_of(size, set).unwrap_or_else(|error| panic!("{size:?} {set:?}: {error}"));
        }
    }

    #[test]
    fn a_lens_is_checked_for_the_size_of_the_image() {
        for (size, set) in
            [([64, 160], "camera.k1=-0.1"), ([64, 512], "camera.k1=0.3"), ([64, 64], "camera.k1=-0.6")]
        {
            let error = view_of(size, &[set]).expect_err("a lens that distorts too much").to_string();
            assert!(error.contains("camera.k1") && error.contains("--size"), "{error}");
        }
        view_of([160, 64], &["camera.k1=-0.1"]).expect("a lens that is invertible");
    }
}
