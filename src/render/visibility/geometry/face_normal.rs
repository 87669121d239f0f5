//! The normal of a triangle, packed as `visibility.wgsl` packs it.
//!
//! Must not know: where the triangle is on the image.

use glam::{BVec2, Vec2, Vec3};

use crate::rounding::floor;

/// The normal on the side of the eye, octahedral coordinates in 16 bits each, from the offsets of the corners from the eye.
#[inline]
pub(super) fn packed_face_normal([a, b, c]: [Vec3; 3]) -> u32 {
    let normal = (b - a).cross(c - a);
    let to_eye = if normal.dot(a) < 0.0 { normal } else { -normal };
    // `pack2x16snorm` of WGSL.
    let snorm16 = |x: f32| floor(0.5 + 32_767.0 * x.clamp(-1.0, 1.0)) as u32 & 0xffff;
    let [x, y] = octahedron(to_eye).into();
    snorm16(x) | (snorm16(y) << 16)
}

/// Octahedral coordinates of a direction. CPU counterpart of `octahedral_encode` in `common/octahedral.wgsl`.
#[inline]
fn octahedron(v: Vec3) -> Vec2 {
    let p = v.truncate() / v.abs().element_sum().max(1e-30);
    let folded = 1.0 - Vec2::new(p.y, p.x).abs();
    let folded = Vec2::select(p.cmpge(Vec2::ZERO), folded, -folded);
    Vec2::select(BVec2::splat(v.z >= 0.0), p, folded)
}
