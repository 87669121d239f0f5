//! Settings of a render: a leaf that every stage may read.
//! Must not know: a scene, a device.

use glam::Vec3;

use crate::error::{Error, Result};
use crate::frame::Annotations;
use crate::scene::camera::Camera;

/// What is rendered of a scene: size, samples, annotations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Samples along a side of a pixel: 1, 2 or 4.
    pub samples_per_side: u32,
    /// Most that the outline of a rock's level of detail may differ from that of its authored mesh, pixels; 0 draws every triangle.
    pub outline_error_px: f32,
    /// Planes to render besides colour and class.
    pub annotations: Annotations,
}

/// Columns and rows that a texture has with WebGPU's default limits: the image of a horizon map and the layers of a shadow map have no more.
pub const DEFAULT_TEXTURE_PX: u32 = 8192;

/// The specification of the scene allows less than a quarter of a pixel.
const OUTLINE_ERROR_PX: f32 = 0.24;

impl RenderSettings {
    /// Settings from a number of samples per pixel.
    ///
    /// # Errors
    /// [`Error::Usage`] unless `samples` is 1, 4 or 16 and both sides are at least a pixel.
    pub fn new(size: [u32; 2], samples: u32) -> Result<Self> {
        let (samples_per_side, outline_error_px) = (samples.isqrt(), OUTLINE_ERROR_PX);
        let settings = Self { size, samples_per_side, outline_error_px, annotations: Annotations::default() };
        settings.check(samples).map(|()| settings)
    }

    /// Checks size and samples, of which there are this many in a pixel: the fields are public.
    pub(super) fn check(&self, samples: u32) -> Result<()> {
        let [width, height] = self.size;
        if width == 0 || height == 0 {
            return Err(Error::Usage(format!(
                "--size {width}x{height}: an image has at least one pixel each way"
            )));
        }
        if !matches!((self.samples_per_side, samples), (1, 1) | (2, 4) | (4, 16)) {
            return Err(Error::Usage(format!(
                "--samples {samples}: allowed are 1, 4 (2 x 2) and 16 (4 x 4)"
            )));
        }
        Ok(())
    }

    /// Samples of a pixel.
    pub(super) const fn samples(&self) -> u32 {
        self.samples_per_side.saturating_pow(2)
    }

    /// Columns and rows of samples; at most [`u32::MAX`], which is beyond every device.
    #[must_use]
    pub fn sample_size(&self) -> [u32; 2] {
        self.size.map(|side| side.saturating_mul(self.samples_per_side))
    }

    /// Tangent of the angle between two neighbouring samples at the centre of the image.
    pub(super) fn sample_angle(&self, camera: &Camera) -> f32 {
        2.0 * camera.tan_half_fov / self.sample_size()[0] as f32
    }

    /// Offsets from the eye to the points where view rays cross the plane one metre along the optical axis, metres: that of the
    /// outer corner of sample (0, 0), then the step from one column to the next, then that from one row to the next.
    pub(super) fn rays(&self, camera: &Camera) -> [Vec3; 3] {
        let aspect = self.size[0] as f32 / self.size[1] as f32;
        let sample = self.sample_angle(camera);
        let corner = camera.forward - camera.tan_half_fov * (camera.right - camera.up / aspect);
        [corner, sample * camera.right, -sample * camera.up]
    }

    /// Focal length, samples.
    pub(super) fn focal_samples(&self, camera: &Camera) -> f32 {
        (camera.focal_px(self.size[0]) * f64::from(self.samples_per_side)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_samples_are_checked_in_whatever_way_they_are_set() {
        let good = RenderSettings::new([8, 8], 4).expect("settings");
        assert!(good.check(good.samples()).is_ok());
        for (size, samples_per_side) in
            [([0, 8], 2), ([8, 0], 2), ([8, 8], 0), ([8, 8], 3), ([8, 8], u32::MAX)]
        {
            let wrong = RenderSettings { size, samples_per_side, ..good };
            assert!(matches!(wrong.check(wrong.samples()), Err(Error::Usage(_))), "{wrong:?}");
        }
        assert!(RenderSettings::new([8, 8], 5).is_err() && RenderSettings::new([8, 8], 17).is_err());
    }

    #[test]
    fn the_samples_of_an_enormous_image_do_not_wrap() {
        let settings = RenderSettings::new([1_073_741_825, 1], 16).expect("settings");
        assert_eq!(settings.sample_size(), [u32::MAX, 4]);
    }
}
