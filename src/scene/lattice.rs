//! A rotated square lattice on the plane, for noise and craters.
//!
//! Points are given in metres from a centre near which precision matters (the camera); the lattice itself is anchored in the
//! world, so that a world position is in the same cell from every camera.
//! Must not know: what is drawn on it.

use glam::{DVec2, Vec2};

use crate::random::Stream;
use crate::rounding::floor_and_fraction;

/// A rotated, scaled and shifted lattice.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    /// Side of a cell, metres.
    pub cell_m: f32,
    /// Cosine and sine of its angle, divided by the side of a cell.
    pub turn: Vec2,
    /// The cell in which the centre lies.
    pub base: [i32; 2],
    /// Position of the centre in that cell, in cells.
    pub phase: Vec2,
    /// Seed of the hashes of its cells.
    pub seed: u32,
}

impl Lattice {
    /// A lattice with cells of this side; angle, shift and seed are drawn from a stream. For points around `centre`.
    #[must_use]
    pub fn new(cell_m: f64, centre: Vec2, stream: &mut Stream) -> Self {
        let angle = stream.uniform(0.0, std::f64::consts::TAU);
        let (cos, sin) = (libm::cos(angle) / cell_m, libm::sin(angle) / cell_m);
        let shift = DVec2::new(stream.uniform(0.0, 1024.0), stream.uniform(0.0, 1024.0));
        let centre = centre.as_dvec2();
        let at = DVec2::new(cos * centre.x + sin * centre.y, cos * centre.y - sin * centre.x) + shift;
        let base = at.floor();
        Self {
            cell_m: cell_m as f32,
            turn: Vec2::new(cos as f32, sin as f32),
            base: [base.x as i32, base.y as i32],
            phase: (at - base).as_vec2(),
            seed: stream.bits(),
        }
    }

    /// Converts metres from the centre to cells from [`Self::base`].
    #[must_use]
    #[inline(always)]
    pub fn local(&self, offset: Vec2) -> Vec2 {
        Vec2::new(
            self.turn.x * offset.x + self.turn.y * offset.y + self.phase.x,
            self.turn.x * offset.y - self.turn.y * offset.x + self.phase.y,
        )
    }

    /// Converts cells from [`Self::base`] to metres from the centre.
    #[must_use]
    pub fn offset(&self, local: Vec2) -> Vec2 {
        let (p, square) = (local - self.phase, self.cell_m * self.cell_m);
        Vec2::new(self.turn.x * p.x - self.turn.y * p.y, self.turn.y * p.x + self.turn.x * p.y) * square
    }

    /// The cell that contains a point (in cells from [`Self::base`]), and the fractions within it.
    #[must_use]
    #[inline(always)]
    pub fn cell(&self, local: Vec2) -> ([i32; 2], [f32; 2]) {
        let ((x, u), (y, v)) = (floor_and_fraction(local.x), floor_and_fraction(local.y));
        ([self.base[0].wrapping_add(x), self.base[1].wrapping_add(y)], [u, v])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Streams;

    #[test]
    fn a_point_is_in_the_same_cell_from_any_centre() {
        let lattice = |centre| Lattice::new(0.7, centre, &mut Streams::new(3).stream("test", 0));
        let (a, b) = (lattice(Vec2::ZERO), lattice(Vec2::new(40.0, -90.0)));
        for i in 0..200_u16 {
            let p = Vec2::new(f32::from(i) * 0.31, f32::from(i) * -0.73);
            let (in_a, t_a) = a.cell(a.local(p));
            let (in_b, t_b) = b.cell(b.local(p - Vec2::new(40.0, -90.0)));
            let near_edge = t_a.iter().any(|t| *t < 1e-3 || *t > 0.999);
            assert!(near_edge || (in_a == in_b && (t_a[0] - t_b[0]).abs() < 1e-3), "{p}");
            assert!(a.offset(a.local(p)).distance(p) < 1e-4);
        }
    }
}
