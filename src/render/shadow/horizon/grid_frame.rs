//! Where the samples of a grid of the horizon map lie.
//! Must not know: what they hold.

use glam::Vec2;

/// Where the samples of a grid lie.
#[derive(Clone, Copy)]
pub(super) struct GridFrame {
    /// Position that samples are counted from, world, metres.
    pub(super) origin: Vec2,
    /// Column and row of its first sample, counted from `origin`.
    pub(super) first: Vec2,
    pub(super) step_m: f32,
    /// Columns and rows.
    pub(super) size: [usize; 2],
    /// Unit vector along the rows.
    pub(super) towards: Vec2,
}

impl GridFrame {
    /// The cell of four samples that a position lies in, or of those the nearest, and where in it; of a grid over rings, whose samples
    /// are counted from its first.
    pub(super) fn cell(&self, position: Vec2) -> ([usize; 2], Vec2) {
        let offset = (position - self.origin) / self.step_m;
        let limit = Vec2::new(self.size[0] as f32, self.size[1] as f32) - 1.001;
        let at = Vec2::new(offset.dot(self.towards), Vec2::new(-self.towards.y, self.towards.x).dot(offset));
        let at = at.clamp(Vec2::ZERO, limit);
        ([at.x as usize, at.y as usize], at - at.floor())
    }
}
