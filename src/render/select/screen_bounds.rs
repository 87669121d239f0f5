//! Screen-space bounds of what is drawn: the scissor rectangle of a draw.
//! Must not know: what the bounds are of.

use glam::{UVec2, Vec2, Vec3};

use crate::render::settings::RenderSettings;
use crate::scene::Scene;

/// An axis-aligned rectangle in sample coordinates that holds all that something covers on the screen. It may reach beyond the
/// image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenBounds {
    low: Vec2,
    high: Vec2,
}

impl ScreenBounds {
    /// Holds no sample; the neutral element of [`Self::union`].
    pub const EMPTY: Self = Self { low: Vec2::INFINITY, high: Vec2::NEG_INFINITY };
    /// Holds every sample.
    pub const UNBOUNDED: Self = Self { low: Vec2::NEG_INFINITY, high: Vec2::INFINITY };

    /// The bounds of a block of samples, from its first column and row to its last, inclusive.
    #[must_use]
    pub fn of_samples(columns: (i32, i32), rows: (i32, i32)) -> Self {
        let at = |column: i32, row: i32| Vec2::new(column as f32, row as f32);
        Self { low: at(columns.0, rows.0), high: at(columns.1, rows.1) }
    }

    /// Conservative bounds of the projection of a sphere in the world; unbounded if it may cross the near plane.
    #[must_use]
    pub fn of_sphere(scene: &Scene, settings: &RenderSettings, centre: Vec3, radius_m: f32) -> Self {
        let camera = &scene.camera;
        let offset = centre - camera.eye;
        let ahead_m = offset.dot(camera.forward);
        if ahead_m <= radius_m + camera.near_m {
            return Self::UNBOUNDED;
        }
        let focal = settings.focal_samples(camera);
        let middle = 0.5 * UVec2::from(settings.sample_size()).as_vec2();
        let at = Vec2::new(offset.dot(camera.right), -offset.dot(camera.up));
        let (near, far) = (focal / (ahead_m - radius_m), focal / (ahead_m + radius_m));
        let (low, high) = (at - radius_m, at + radius_m);
        Self { low: middle + (low * near).min(low * far), high: middle + (high * near).max(high * far) }
    }

    /// The smallest bounds that hold both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// The same bounds in coordinates that count from this sample.
    #[must_use]
    pub fn relative_to(self, first_sample: [u32; 2]) -> Self {
        let first = UVec2::from(first_sample).as_vec2();
        Self { low: self.low - first, high: self.high - first }
    }

    /// Left, top, width and height of the scissor rectangle for a target of this many samples, with a margin of one sample.
    #[must_use]
    pub fn scissor_rect(self, sample_size: [u32; 2]) -> [u32; 4] {
        let size = UVec2::from(sample_size);
        let [low, high] = [self.low, self.high].map(|corner| corner.clamp(Vec2::ZERO, size.as_vec2()));
        let (low, high) = ((low - 1.0).max(Vec2::ZERO).as_uvec2(), (high + 2.0).as_uvec2().min(size));
        let extent = high.saturating_sub(low);
        [low.x, low.y, extent.x, extent.y]
    }
}

impl Default for ScreenBounds {
    fn default() -> Self {
        Self::EMPTY
    }
}
