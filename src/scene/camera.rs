//! The rover's camera: pose, projection, and the part of the ground it views.
//!
//! Must not know: how images are rendered.

use glam::camera::rh::proj::directx::perspective;
use glam::{DVec3, Mat3, Mat4, Vec2, Vec3};

use super::azimuth;
use super::rings::View;
use super::sky::innermost_star_m;
use super::terrain::Terrain;
use crate::error::{Error, Result};
use crate::lens::Lens;
use crate::params::{Knob, Params};

/// Distance of the near plane, metres.
const NEAR_M: f32 = 0.05;
/// Minimum height of the eye above the ground mesh, metres.
const MIN_CLEARANCE_M: f32 = 2.0 * NEAR_M;

/// A pinhole camera with square pixels and the principal point in the centre of the image.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Eye, metres, world.
    pub eye: Vec3,
    /// Unit vector along the optical axis.
    pub forward: Vec3,
    /// Unit vector towards the right edge of the image.
    pub right: Vec3,
    /// Unit vector towards the top edge of the image.
    pub up: Vec3,
    /// Tangent of half the horizontal field of view.
    pub tan_half_fov: f32,
    /// Near plane, metres.
    pub near_m: f32,
    /// Far plane, metres.
    pub far_m: f32,
    /// Exposure relative to the reference, in stops.
    pub exposure_ev: f32,
    /// Distortion of its lens.
    pub lens: Lens,
}

/// Horizontal position of the camera, metres.
pub(super) fn position(params: &Params) -> Vec2 {
    Vec2::new(params.number(Knob::CameraXM) as f32, params.number(Knob::CameraYM) as f32)
}

fn lens(params: &Params) -> Lens {
    let [k1, k2, k3, p1, p2] =
        [Knob::CameraK1, Knob::CameraK2, Knob::CameraK3, Knob::CameraP1, Knob::CameraP2]
            .map(|knob| params.number(knob));
    Lens { k1, k2, k3, p1, p2 }
}

impl Camera {
    /// The camera of these parameters, on this ground.
    ///
    /// # Errors
    /// [`Error::Scene`] if the ground mesh reaches the near plane (a very low camera on very rough ground) or the camera
    /// is outside the sky dome.
    pub fn build(params: &Params, terrain: &Terrain) -> Result<Self> {
        let position = position(params);
        let height_m = params.number(Knob::CameraHeightM) as f32;
        let eye = position.extend(terrain.height_at(position) + height_m);
        let dome_m = params.number(Knob::SkyDomeRadiusM);
        if f64::from(height_m) >= innermost_star_m(dome_m) {
            return Err(Error::Scene(format!(
                "camera.height_m = {height_m} puts the camera outside the sky dome or among its stars, sky.dome_radius_m = \
                 {dome_m}; lower it, or enlarge the dome"
            )));
        }
        let clearance_m = eye.z - terrain.surface_height_at(position);
        if clearance_m < MIN_CLEARANCE_M {
            return Err(Error::Scene(format!(
                "camera.height_m = {height_m} leaves the camera {clearance_m:.3} m above the ground mesh, and \
                 the minimum is {MIN_CLEARANCE_M} m; raise it, or lower terrain.amplitude_m"
            )));
        }
        Ok(Self::above(params, eye.z))
    }

    /// The camera of these parameters with its eye at this z, metres, world.
    #[must_use]
    pub fn above(params: &Params, z_m: f32) -> Self {
        let mut camera = Self::new(
            position(params).extend(z_m),
            [Knob::CameraPitchDeg, Knob::CameraYawDeg, Knob::CameraRollDeg].map(|knob| params.number(knob)),
            params.number(Knob::CameraFovDeg),
            2.0 * params.number(Knob::SkyDomeRadiusM) as f32 + params.number(Knob::TerrainSizeM) as f32,
            params.number(Knob::CameraExposureEv) as f32,
        );
        camera.lens = lens(params);
        camera
    }

    /// A camera at `eye` that looks along +Y, then is rotated by pitch (up), yaw (clockwise from above, towards +X) and
    /// roll (clockwise), all in degrees.
    #[must_use]
    pub fn new(eye: Vec3, pitch_yaw_roll_deg: [f64; 3], fov_deg: f64, far_m: f32, exposure_ev: f32) -> Self {
        let [pitch, yaw, roll] = pitch_yaw_roll_deg.map(f64::to_radians);
        let (level, rise) = (libm::cos(pitch), libm::sin(pitch));
        let (east, north) = (libm::sin(yaw), libm::cos(yaw));
        let forward = DVec3::new(level * east, level * north, rise);
        let right = DVec3::new(north, -east, 0.0);
        let up = right.cross(forward);
        let (cos, sin) = (libm::cos(roll), libm::sin(roll));
        Self {
            eye,
            forward: forward.as_vec3(),
            right: (cos * right - sin * up).as_vec3(),
            up: (cos * up + sin * right).as_vec3(),
            tan_half_fov: libm::tan(0.5 * fov_deg.to_radians()) as f32,
            near_m: NEAR_M,
            far_m,
            exposure_ev,
            lens: Lens::default(),
        }
    }

    /// Horizontal field of view, degrees.
    #[must_use]
    pub fn fov_deg(&self) -> f64 {
        2.0 * libm::atan(f64::from(self.tan_half_fov)).to_degrees()
    }

    /// Focal length in pixels for an image `width_px` wide.
    #[must_use]
    pub fn focal_px(&self, width_px: u32) -> f64 {
        0.5 * f64::from(width_px) / f64::from(self.tan_half_fov)
    }

    /// The camera with the wider field of view that an undistorted image needs to cover a distorted one of this size, and
    /// the size of that image; focal length in pixels and principal point stay. `None` if [`Lens::reach`] is.
    #[must_use]
    pub fn widened(&self, [width_px, height_px]: [u32; 2]) -> Option<(Self, [u32; 2])> {
        let half_x = f64::from(self.tan_half_fov);
        let reach = self.lens.reach([half_x, half_x * f64::from(height_px) / f64::from(width_px)])?;
        // Whole pixels on each side, plus one for rounding.
        let wide =
            |side: u32, reach: f64| side + 2 * (libm::ceil(0.5 * f64::from(side) * (reach - 1.0)) as u32 + 1);
        let size = [wide(width_px, reach[0]), wide(height_px, reach[1])];
        let tan_half_fov = (half_x * f64::from(size[0]) / f64::from(width_px)) as f32;
        Some((Self { tan_half_fov, ..*self }, size))
    }

    /// Intrinsic matrix for an image of this size, pixels; pixel (u, v) has its centre at (u + 0.5, v + 0.5).
    #[must_use]
    pub fn intrinsics(&self, [width_px, height_px]: [u32; 2]) -> [[f64; 3]; 3] {
        let focal = self.focal_px(width_px);
        let (cx, cy) = (0.5 * f64::from(width_px), 0.5 * f64::from(height_px));
        [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]
    }

    /// Rows of the pose in OpenCV axes: x right, y down, z forward.
    #[must_use]
    pub fn world_from_camera(&self) -> [[f64; 4]; 4] {
        pose(self.right, -self.up, self.forward, self.eye)
    }

    /// Rows of the pose in OpenGL and USD axes: x right, y up, z back.
    #[must_use]
    pub fn world_from_camera_gl(&self) -> [[f64; 4]; 4] {
        pose(self.right, self.up, -self.forward, self.eye)
    }

    /// World to view axes (x right, y up, z back).
    #[must_use]
    pub fn view_from_world(&self) -> Mat4 {
        self.world_from_view().inverse()
    }

    /// View axes (x right, y up, z back) to world.
    #[must_use]
    pub fn world_from_view(&self) -> Mat4 {
        Mat4::from_cols(
            self.right.extend(0.0),
            self.up.extend(0.0),
            (-self.forward).extend(0.0),
            self.eye.extend(1.0),
        )
    }

    /// World to clip space for an image of this size, with reversed z: depth 1 at the near plane, 0 at the far plane.
    #[must_use]
    pub fn clip_from_world(&self, size_px: [u32; 2]) -> Mat4 {
        self.clip_from_view(size_px) * self.view_from_world()
    }

    /// Offsets from the eye, along world axes, to clip space: a projection and a rotation. [`Self::clip_from_world`] times a translation by
    /// the eye's position would leave up to 2e-5 m of it, by rounding, where the eye is 400 m from the origin.
    #[must_use]
    pub fn clip_from_offset(&self, size_px: [u32; 2]) -> Mat4 {
        let view_from_world = Mat3::from_cols(self.right, self.up, -self.forward).transpose();
        self.clip_from_view(size_px) * Mat4::from_mat3(view_from_world)
    }

    fn clip_from_view(&self, [width_px, height_px]: [u32; 2]) -> Mat4 {
        let aspect = width_px as f32 / height_px as f32;
        let fov_y = 2.0 * libm::atanf(self.tan_half_fov / aspect);
        perspective(fov_y, aspect, self.far_m, self.near_m)
    }
}

/// Minimum eye height for the cell sizes of the ground mesh, metres.
const MIN_EYE_M: f32 = 0.5;
/// Margin of the viewed sector on each side of a square image, radians: for lens distortion and images that are a little taller. (A scene
/// does not know the image size: at the ends of a portrait image that is rolled to its side the ground is coarse.)
const SECTOR_MARGIN: f64 = 0.12;

/// Angle that the smallest rocks span, radians, from a field of view of 60 degrees on: three quarters of a pixel of an image
/// 512 wide. In a narrower field it is as much of the image.
const MIN_ROCK: f64 = 1.7e-3;
/// Tangent of half that field of view.
const MIN_ROCK_TAN_HALF_FOV: f32 = 0.577_350_26;

/// Tangent of half the field of view below which the cells of the ground shrink with it: 45 degrees. In the image they stay as small.
const CELL_TAN_HALF_FOV: f32 = 0.414_213_57;
/// The smallest factor by which they shrink.
const MIN_CELL: f32 = 0.3;

/// The view that the rings of the surface stage are built for.
#[must_use]
pub fn ground_view(params: &Params) -> View {
    let angles = [Knob::CameraPitchDeg, Knob::CameraYawDeg, Knob::CameraRollDeg].map(|k| params.number(k));
    let camera = Camera::new(Vec3::ZERO, angles, params.number(Knob::CameraFovDeg), 1.0, 0.0);
    let azimuth = angles[1].to_radians();
    let ahead = azimuth::direction(azimuth);
    // The largest azimuth along the image border; a full circle if the border passes below the eye.
    let mut half_sector = 0.0_f64;
    for (across, up) in (-4..=4).flat_map(|i| [(i, -4), (i, 4), (-4, i), (4, i)]) {
        let [across, up] = [across, up].map(|quarter: i32| quarter as f32 / 4.0 * camera.tan_half_fov);
        let ray = (camera.forward + across * camera.right + up * camera.up).truncate();
        let angle = libm::atan2(f64::from(ray.perp_dot(ahead)).abs(), f64::from(ray.dot(ahead)));
        half_sector = half_sector.max(angle);
    }
    let cells = (camera.tan_half_fov / CELL_TAN_HALF_FOV).clamp(MIN_CELL, 1.0);
    View {
        eye_height_m: (params.number(Knob::CameraHeightM) as f32).max(MIN_EYE_M),
        azimuth,
        half_sector: (half_sector + SECTOR_MARGIN).min(std::f64::consts::PI),
        min_rock: MIN_ROCK * f64::from((camera.tan_half_fov / MIN_ROCK_TAN_HALF_FOV).min(1.0)),
        cell: 1e-3 * params.number(Knob::TerrainCellMrad) * f64::from(cells),
        radius_m: 0.5 * params.number(Knob::TerrainSizeM),
    }
}

/// Rows of a rigid transform from its axes and its origin.
fn pose(x: Vec3, y: Vec3, z: Vec3, origin: Vec3) -> [[f64; 4]; 4] {
    let row = |i: usize| [x[i], y[i], z[i], origin[i]].map(f64::from);
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(pitch: f64, yaw: f64, roll: f64) -> Camera {
        Camera::new(Vec3::new(1.0, 2.0, 3.0), [pitch, yaw, roll], 61.9275, 2000.0, 0.0)
    }

    #[test]
    fn axes_follow_pitch_yaw_and_roll() {
        let plain = camera(0.0, 0.0, 0.0);
        assert!(plain.forward.distance(Vec3::Y) < 1e-6 && plain.right.distance(Vec3::X) < 1e-6);
        assert!(camera(-90.0, 0.0, 0.0).forward.distance(-Vec3::Z) < 1e-6);
        assert!(camera(0.0, 90.0, 0.0).forward.distance(Vec3::X) < 1e-6);
        assert!(camera(0.0, 0.0, 90.0).up.distance(Vec3::X) < 1e-6, "clockwise roll tips up to the right");
        let any = camera(-12.0, 77.0, 5.0);
        assert!(any.right.cross(any.up).distance(-any.forward) < 1e-6);
    }

    #[test]
    fn offsets_are_projected_alike_wherever_the_eye_is() {
        let near = camera(-12.0, 77.0, 5.0);
        let far = Camera { eye: Vec3::new(-443.6, 317.2, 1.7), ..near };
        assert_eq!(near.clip_from_offset([320, 240]), far.clip_from_offset([320, 240]));
        let origin = far.clip_from_offset([320, 240]) * Vec3::ZERO.extend(1.0);
        assert_eq!((origin.x, origin.y, origin.w), (0.0, 0.0, 0.0), "the eye");
        for offset in [Vec3::new(5.0, 1.0, -1.2), Vec3::new(40.0, 20.0, 3.0)] {
            let clip = near.clip_from_offset([320, 240]) * offset.extend(1.0);
            let by_world = near.clip_from_world([320, 240]) * (near.eye + offset).extend(1.0);
            assert!(clip.abs_diff_eq(by_world, 1e-5 * offset.length()), "{clip} {by_world}");
        }
    }

    #[test]
    fn projection_is_the_pinhole_of_24_mm_and_20_mm() {
        let camera = camera(0.0, 0.0, 0.0);
        assert!((camera.focal_px(512) - 512.0 * 20.0 / 24.0).abs() < 0.01);
        let clip_from_world = camera.clip_from_world([512, 512]);
        let project = |view: Vec3| {
            let clip = clip_from_world * (camera.world_from_view() * view.extend(1.0));
            clip.truncate() / clip.w
        };
        let edge = project(Vec3::new(6.0, 0.0, -10.0));
        assert!((edge.x - 1.0).abs() < 1e-5 && edge.y.abs() < 1e-5);
        assert!((project(Vec3::new(0.0, 0.0, -camera.near_m)).z - 1.0).abs() < 1e-5);
        assert!(project(Vec3::new(0.0, 0.0, -camera.far_m)).z.abs() < 1e-6);
        let wide = camera.clip_from_world([1024, 512]) * Vec3::new(7.0, 12.0, 3.0).extend(1.0);
        assert!((wide.x / wide.w - 1.0).abs() < 1e-5, "the field of view is the horizontal one");
    }
}
