//! Where ground sees all of the sun past other ground, by the horizon map as `common/horizon_map.wgsl` reads it. There a CPU driver need
//! not look it up again, nor what lights shadows: branches that no sample takes cost it as much as those that all take.
//! Must not know: how the map is made.

use std::fmt::Debug;
use std::sync::Arc;

use glam::Vec2;

use crate::render::device::shader_structs::HorizonLevel;

/// Points that are looked at together.
pub const LANES: usize = 16;

/// The texels of a horizon map.
pub trait HorizonTexels: Debug + Send + Sync {
    /// Heights above which the lower and the upper limb of the sun are visible, metres, world; row by row.
    fn limbs_m(&self) -> &[[f32; 2]];
}

/// A horizon map, to look it up on the host.
#[derive(Clone, Debug)]
pub struct FullSun {
    /// Horizontal unit vector towards the sun.
    pub towards: Vec2,
    /// Point that distances are measured from, world, metres.
    pub centre: Vec2,
    /// Distance that the first grid serves, metres; each next one serves twice the distance.
    pub base_m: f32,
    /// The grids, the finest first.
    pub levels: Vec<HorizonLevel>,
    /// Texels in a row.
    pub width: usize,
    /// The texels.
    pub texels: Arc<dyn HorizonTexels>,
}

/// Points, metres, world.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    /// Their x.
    pub x: [f32; LANES],
    /// Their y.
    pub y: [f32; LANES],
    /// Their height.
    pub z: [f32; LANES],
}

impl FullSun {
    /// Sets to 1 the flags of points that see all of the sun past the ground, so far above the limb that no rounding of the shader tells
    /// otherwise. Of points in more than one grid none counts as such.
    // `inline(always)`: to be compiled for each width of vectors.
    #[inline(always)]
    pub fn find(&self, points: &Points, flags: &mut [u8; LANES]) {
        *flags = [0; LANES];
        let (mut nearest, mut furthest) = (f32::MAX, 0.0_f32);
        for i in 0..LANES {
            let (x, y) = (points.x[i] - self.centre.x, points.y[i] - self.centre.y);
            let square = x * x + y * y;
            nearest = if square < nearest { square } else { nearest };
            furthest = if square > furthest { square } else { furthest };
        }
        let reach_m = |level: usize| self.base_m * (1_u32 << level) as f32;
        let is_within =
            |level: usize| level + 1 == self.levels.len() || furthest.sqrt() < 0.999 * reach_m(level);
        let Some(level) = (0..self.levels.len()).find(|level| is_within(*level)) else { return };
        if level > 0 && nearest.sqrt() < 1.001 * reach_m(level - 1) {
            return;
        }
        let grid = &self.levels[level];
        let [columns, rows] = grid.size.map(|size| size as f32 - 1.001);
        let [first_column, first_row] = [grid.first_texel & 0xffff, grid.first_texel >> 16];
        let (per_step, sun, first) = (1.0 / grid.step_m, self.towards, grid.first_sample);
        let (mut corners, mut t) = ([0_u32; LANES], [[0.0; LANES]; 2]);
        for i in 0..LANES {
            let (x, y) = ((points.x[i] - grid.origin.x) * per_step, (points.y[i] - grid.origin.y) * per_step);
            let along = within(x * sun.x + y * sun.y - first.x, columns);
            let across = within(y * sun.x - x * sun.y - first.y, rows);
            // Neither is below zero.
            let (column, row) = (along as i32, across as i32);
            (t[0][i], t[1][i]) = (along - column as f32, across - row as f32);
            corners[i] = (first_row + row as u32) * self.width as u32 + first_column + column as u32;
        }
        let texels = self.texels.limbs_m();
        let mut lower = [[0.0; LANES]; 4];
        for (i, corner) in corners.into_iter().enumerate() {
            let corner = corner as usize;
            let (Some([[low, _], [low_next, _]]), Some([[high, _], [high_next, _]])) = (
                texels.get(corner..).and_then(|texels| texels.first_chunk()),
                texels.get(corner + self.width..).and_then(|texels| texels.first_chunk()),
            ) else {
                return;
            };
            (lower[0][i], lower[1][i], lower[2][i], lower[3][i]) = (*low, *low_next, *high, *high_next);
        }
        // Coordinates are rounded to parts of a step, positions to parts of their distance.
        let margin_m = 1e-5 + 2e-3 * grid.step_m + 2e-6 * (furthest.sqrt() + self.centre.abs().max_element());
        for i in 0..LANES {
            let (u, v) = (t[0][i], t[1][i]);
            let low = lower[0][i] + u * (lower[1][i] - lower[0][i]);
            let high = lower[2][i] + u * (lower[3][i] - lower[2][i]);
            let limb_m = low + v * (high - low);
            flags[i] = if points.z[i] > limb_m + margin_m { 1 } else { 0 };
        }
    }
}

/// From 0 to an end. `clamp` would not vectorise: it asserts.
#[inline(always)]
fn within(x: f32, end: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < end { x } else { end }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two grids of texels: those of the first rise towards the sun, those of the second lie at a height.
    #[derive(Debug)]
    struct Rising(Vec<[f32; 2]>);

    impl HorizonTexels for Rising {
        fn limbs_m(&self) -> &[[f32; 2]] {
            &self.0
        }
    }

    const COLUMNS: u32 = 64;
    const ROWS: u32 = 40;
    const RISE_M: f32 = 0.01;

    fn full_sun() -> FullSun {
        let rising = (0..COLUMNS * ROWS).map(|index| [RISE_M * (index % COLUMNS) as f32, 0.0]);
        let level = (0..COLUMNS * ROWS).map(|_| [2.0, 1.0]);
        let grid = |first_row: u32, step_m: f32| HorizonLevel {
            origin: Vec2::ZERO,
            step_m,
            first_texel: first_row << 16,
            size: [COLUMNS, ROWS],
            first_sample: Vec2::new(-32.0, -20.0),
        };
        FullSun {
            towards: Vec2::Y,
            centre: Vec2::ZERO,
            base_m: 3.0,
            levels: vec![grid(0, 0.1), grid(ROWS, 0.3)],
            width: COLUMNS as usize,
            texels: Arc::new(Rising(rising.chain(level).collect())),
        }
    }

    fn flags(points: &Points) -> [u8; LANES] {
        let mut flags = [0; LANES];
        full_sun().find(points, &mut flags);
        flags
    }

    #[test]
    fn points_above_the_limb_between_texels_are_in_full_sun() {
        // Columns run towards the sun, which is y.
        for y in [-1.234, 0.0, 0.567, 1.9] {
            let limb_m = RISE_M * (y / 0.1 + 32.0);
            let z = std::array::from_fn(|i| limb_m + 1e-3 * (i as f32 - 7.5));
            let found = flags(&Points { x: [0.333; LANES], y: [y; LANES], z });
            assert_eq!(found, std::array::from_fn(|i| u8::from(i > 7)), "y {y} m");
        }
    }

    #[test]
    fn points_of_the_second_grid_have_its_limb_and_those_of_two_grids_none() {
        let z = std::array::from_fn(|i| 1.0 + 0.2 * i as f32);
        let at = |x: [f32; LANES]| flags(&Points { x, y: [0.0; LANES], z });
        assert_eq!(at([4.0; LANES]), std::array::from_fn(|i| u8::from(i > 5)));
        assert_eq!(at([2.9; LANES]), [1; LANES]);
        assert_eq!(at(std::array::from_fn(|i| if i == 3 { 2.9 } else { 4.0 })), [0; LANES]);
        assert_eq!(at([3.0; LANES]), [0; LANES], "on the border between them");
    }
}
