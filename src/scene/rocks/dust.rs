//! Dust on rocks: how level a surface must be to hold it.
//!
//! Must not know: what dust looks like.

use arrayvec::ArrayVec;
use glam::Vec2;

use super::rock::NO_DUST;
use crate::scene::mesh::{Icosphere, Vertex};

/// Level of the icosphere on whose vertices the share of the surface with dust is measured.
const LEVEL: usize = 2;

/// The z that the normal exceeds on a share of the upward-facing surface above the ground, on which vertices lie about evenly. The ground is
/// a plane: its height at the origin, metres, and its rise per metre along x and y.
pub(super) fn dust_above(vertices: &[Vertex], (ground_m, slope): (f32, Vec2), share: f64) -> f32 {
    const COUNT: usize = Icosphere::vertex_count(LEVEL);
    let coarse = &vertices[..vertices.len().min(COUNT)];
    let is_exposed = |vertex: &&Vertex| {
        vertex.normal.z > 0.0 && vertex.position.z > ground_m + slope.dot(vertex.position.truncate())
    };
    let mut upward: ArrayVec<f32, COUNT> =
        coarse.iter().filter(is_exposed).map(|vertex| vertex.normal.z).collect();
    if upward.is_empty() {
        return NO_DUST;
    }
    let rank = ((1.0 - share) * (upward.len() - 1) as f64) as usize;
    *upward.select_nth_unstable_by(rank, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// A block whose top is level: dust covers a share of the top, not all of it; and no more than a share of a ball. What is in the ground
    /// does not count.
    #[test]
    fn dust_covers_its_share_of_any_shape() {
        let of = |z: &dyn Fn(usize) -> f32| -> Vec<Vertex> {
            let position = |k| Vec3::new(0.0, 1.0, if k % 2 == 0 { 0.6 } else { 0.4 });
            let vertex = |k| Vertex { position: position(k), normal: Vec3::new(1.0, 0.0, z(k)) };
            (0..162).map(vertex).collect()
        };
        let block = of(&|k| if k < 81 { 0.95 + 0.0005 * k as f32 } else { -0.5 });
        let ball = of(&|k| 1.0 - (2 * k) as f32 / 161.0);
        let buried = of(&|k| if k % 2 == 0 { 0.5 + 0.001 * k as f32 } else { 1.0 });
        for (vertices, ground_m) in [(block, -1.0), (ball, -1.0), (buried, 0.3)] {
            for share in [0.1, 0.35, 0.6] {
                let ground = (ground_m, Vec2::new(0.0, 0.2));
                let above = dust_above(&vertices, ground, share);
                let exposed = |vertex: &&Vertex| vertex.normal.z > 0.0 && vertex.position.z > ground_m + 0.2;
                let upward = vertices.iter().filter(exposed).count();
                let dusty = vertices.iter().filter(exposed).filter(|vertex| vertex.normal.z > above).count();
                let found = dusty as f64 / upward as f64;
                assert!((found - share).abs() < 0.03, "{found} for {share}");
            }
        }
    }
}
