//! Triangle meshes: the icosphere with all its levels of detail, smooth normals, the vertex.
//!
//! Must not know: what is modelled with them.

use std::collections::HashMap;
use std::sync::OnceLock;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3, Vec3A, Vec4, Vec4Swizzles};

use crate::pool::{self, PooledVec};

/// A vertex as it is hashed, uploaded and exported.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Vertex {
    /// Position, metres.
    pub position: Vec3,
    /// Unit normal, outward.
    pub normal: Vec3,
}

/// A unit icosphere: an icosahedron subdivided `levels` times.
///
/// The vertices of a level come first in every finer one, so that one vertex buffer serves all levels of detail of a
/// displaced icosphere with an index buffer per level.
#[derive(Debug)]
pub struct Icosphere {
    /// Unit vectors; level `l` uses the first `10 * 4^l + 2`.
    pub directions: Vec<Vec3>,
    /// The same as structure of arrays: one list per axis.
    pub axes: [Vec<f32>; 3],
    /// Triangles of each level, counter-clockwise seen from outside.
    pub triangles: Vec<Vec<[u32; 3]>>,
    /// For every vertex after the first twelve: the two ends of the edge that it bisects.
    parents: Vec<[u32; 2]>,
}

impl Icosphere {
    /// Finest level: 10,242 vertices, 20,480 triangles.
    pub const MAX_LEVEL: usize = 5;

    /// The shared icosphere with levels 0 to [`Self::MAX_LEVEL`].
    #[must_use]
    pub fn shared() -> &'static Self {
        static SHARED: OnceLock<Icosphere> = OnceLock::new();
        pool::made_once(&SHARED, || Self::new(Self::MAX_LEVEL))
    }

    /// Number of vertices of `level`.
    #[must_use]
    pub const fn vertex_count(level: usize) -> usize {
        10 * (1 << (2 * level)) + 2
    }

    fn new(levels: usize) -> Self {
        let phi = (1.0 + 5.0_f64.sqrt()) / 2.0;
        let mut directions: Vec<DVec3> = Vec::with_capacity(Self::vertex_count(levels));
        for (a, b) in [(1.0, phi), (-1.0, phi), (1.0, -phi), (-1.0, -phi)] {
            directions.push(unit(DVec3::new(0.0, a, b)));
            directions.push(unit(DVec3::new(a, b, 0.0)));
            directions.push(unit(DVec3::new(b, 0.0, a)));
        }
        let mut triangles = vec![icosahedron_faces(&directions)];
        let mut parents = Vec::new();
        for level in 0..levels {
            let mut midpoints: HashMap<[u32; 2], u32> = HashMap::new();
            let mut midpoint = |a: u32, b: u32| {
                let edge = [a.min(b), a.max(b)];
                *midpoints.entry(edge).or_insert_with(|| {
                    directions.push(unit(directions[a as usize] + directions[b as usize]));
                    parents.push(edge);
                    (directions.len() - 1) as u32
                })
            };
            let finer = triangles[level]
                .iter()
                .flat_map(|&[a, b, c]| {
                    let (ab, bc, ca) = (midpoint(a, b), midpoint(b, c), midpoint(c, a));
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
            triangles.push(finer);
        }
        let directions: Vec<Vec3> = directions.iter().map(|d| d.as_vec3()).collect();
        let axes = [0, 1, 2].map(|axis| directions.iter().map(|d| d[axis]).collect());
        Self { directions, axes, triangles, parents }
    }

    /// For each level, an upper bound in metres on the distance between the mesh of that level and the one of all
    /// `vertices` (which must be those of some level of this icosphere); 0 from their own level on.
    ///
    /// Two neighbouring levels differ by at most the largest distance of a vertex of the finer one from the midpoint of the
    /// edge that it bisects; over several levels these distances add up.
    #[must_use]
    pub fn level_errors_m(&self, vertices: &[Vertex]) -> [f32; Self::MAX_LEVEL + 1] {
        let positions = Positions::of(vertices);
        let mut errors = [0.0; Self::MAX_LEVEL + 1];
        let authored = (0..self.triangles.len()).find(|&l| Self::vertex_count(l) == vertices.len());
        for level in (0..authored.unwrap_or(0)).rev() {
            let (first, last) = (Self::vertex_count(level), Self::vertex_count(level + 1));
            let mut worst = 0.0;
            for (v, &[a, b]) in (first..).zip(&self.parents[first - 12..last - 12]) {
                let middle = 0.5 * (positions.at(a as usize) + positions.at(b as usize));
                let error = Vec3A::from_vec4(positions.at(v) - middle).length_squared();
                // `f32::max` is more than a comparison (NaN).
                worst = if error > worst { error } else { worst };
            }
            errors[level] = errors[level + 1] + worst.sqrt();
        }
        errors
    }

    /// Sets the normals of the vertices of a level to the area-weighted mean of the normals of their triangles.
    ///
    /// # Panics
    /// If the level has another number of vertices.
    pub fn set_smooth_normals(&self, vertices: &mut [Vertex], level: usize) {
        assert!(vertices.len() == Self::vertex_count(level), "the vertices of level {level}");
        // Most rocks are small: their sums need no memory of the pool or of the allocator.
        let (mut few, mut many) = ([Vec4::ZERO; FEW_VERTICES], None);
        let sums: &mut [Vec4] = if vertices.len() <= FEW_VERTICES {
            &mut few[..vertices.len()]
        } else {
            many.insert(PooledVec::filled(vertices.len(), Vec4::ZERO))
        };
        let positions = Positions::of(vertices);
        if level == 0 {
            for &corners in &self.triangles[0] {
                let [p, q, r] = corners.map(|corner| positions.at(corner as usize));
                corners.iter().for_each(|&corner| sums[corner as usize] += cross(q - p, r - p));
            }
        }
        // Else the four triangles of a subdivided one are summed together: a third of the loads and stores.
        let subdivided = if level > 0 { &self.triangles[level][..] } else { &[] };
        for &[[a, ..], [_, b, _], [.., c], [ab, bc, ca]] in subdivided.as_chunks::<4>().0 {
            let [a, b, c, ab, bc, ca] =
                [a as usize, b as usize, c as usize, ab as usize, bc as usize, ca as usize];
            let (p, q, r) = (positions.at(a), positions.at(b), positions.at(c));
            let (pq, qr, rp) = (positions.at(ab), positions.at(bc), positions.at(ca));
            let (first, second) = (cross(pq - p, rp - p), cross(q - pq, qr - pq));
            let (third, middle) = (cross(qr - rp, r - rp), cross(qr - pq, rp - pq));
            sums[a] += first;
            sums[b] += second;
            sums[c] += third;
            sums[ab] = sums[ab] + first + second + middle;
            sums[bc] = sums[bc] + second + third + middle;
            sums[ca] = sums[ca] + first + third + middle;
        }
        for (vertex, sum) in vertices.iter_mut().zip(&*sums) {
            let sum = Vec3A::from_vec4(*sum);
            let length = sum.length();
            vertex.normal = if length > 0.0 { (sum / length).into() } else { Vec3::Z };
        }
    }
}

/// Vertices of level 1.
const FEW_VERTICES: usize = Icosphere::vertex_count(1);

fn unit(v: DVec3) -> DVec3 {
    v / v.length()
}

/// The twenty faces: all triples of mutually nearest vertices, wound outward.
fn icosahedron_faces(directions: &[DVec3]) -> Vec<[u32; 3]> {
    let near = |a: usize, b: usize| directions[a].distance_squared(directions[b]) < 1.2;
    let mut faces = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(c, a) {
                    let (p, q, r) = (directions[a], directions[b], directions[c]);
                    let outward = (q - p).cross(r - p).dot(p) > 0.0;
                    faces.push(if outward { [a, b, c] } else { [a, c, b] }.map(|v| v as u32));
                }
            }
        }
    }
    faces
}

/// The cross product in the first three lanes; the fourth is arbitrary. glam's own uses fused multiply-add on some targets,
/// which would change bits.
#[inline(always)]
fn cross(a: Vec4, b: Vec4) -> Vec4 {
    (a.zxyw() * b - b.zxyw() * a).zxyw()
}

/// Positions of vertices as four-lane vectors: loaded with the float that follows, which is ignored.
#[derive(Clone, Copy)]
struct Positions<'a>(&'a [[f32; FLOATS]]);

/// Floats per vertex.
const FLOATS: usize = size_of::<Vertex>() / size_of::<f32>();

impl<'a> Positions<'a> {
    fn of(vertices: &'a [Vertex]) -> Self {
        Self(bytemuck::cast_slice(vertices))
    }

    #[inline(always)]
    fn at(self, vertex: usize) -> Vec4 {
        Vec4::from_slice(&self.0[vertex])
    }
}

/// Smallest distance between a point and a triangle (Ericson 2005, Real-Time Collision Detection, 5.1.5).
#[must_use]
pub fn distance_to_triangle(point: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
    let to_segment = |p: Vec3, q: Vec3| {
        let pq = q - p;
        let t = ((point - p).dot(pq) / pq.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        point.distance(p + t * pq)
    };
    let edges = to_segment(a, b).min(to_segment(b, c)).min(to_segment(c, a));
    let normal = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(p, q)| (q - p).cross(point - p).dot(normal) >= 0.0);
    let area = normal.length();
    if inside && area > 0.0 { edges.min(((point - a).dot(normal) / area).abs()) } else { edges }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn icosphere_has_the_known_counts_and_is_a_closed_unit_sphere() {
        let sphere = Icosphere::shared();
        for (level, triangles) in sphere.triangles.iter().enumerate() {
            assert_eq!(triangles.len(), 20 << (2 * level));
            let used = triangles.iter().flatten().max().map(|v| *v as usize + 1);
            assert_eq!(used, Some(Icosphere::vertex_count(level)));
            let mut edges = HashMap::new();
            let mut volume = 0.0;
            for &[a, b, c] in triangles {
                for edge in [(a, b), (b, c), (c, a)] {
                    assert!(edges.insert(edge, ()).is_none(), "edge {edge:?} runs twice the same way");
                }
                let [p, q, r] = [a, b, c].map(|v| sphere.directions[v as usize].as_dvec3());
                volume += p.dot(q.cross(r)) / 6.0;
            }
            assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "open at level {level}");
            let ball = 4.0 / 3.0 * std::f64::consts::PI;
            assert!(volume < ball && volume > ball * [0.6, 0.87, 0.966, 0.991, 0.997, 0.999][level]);
        }
        assert_eq!(sphere.directions.len(), 10_242);
        assert!(sphere.directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-6));
    }

    #[test]
    fn icosahedron_volume_is_the_closed_form() {
        // Regular icosahedron of circumradius 1: edge 1 / sin(72 deg), volume 5 (3 + sqrt 5) / 12 edge^3.
        let sphere = Icosphere::shared();
        let volume: f64 = sphere.triangles[0]
            .iter()
            .map(|t| {
                let [p, q, r] = t.map(|v| sphere.directions[v as usize].as_dvec3());
                p.dot(q.cross(r)) / 6.0
            })
            .sum();
        assert!((volume - 2.536_150_710).abs() < 1e-6, "{volume}");
    }

    #[test]
    fn smooth_normals_of_a_sphere_are_its_directions() {
        let sphere = Icosphere::shared();
        let mut vertices: Vec<Vertex> = sphere.directions[..Icosphere::vertex_count(4)]
            .iter()
            .map(|&d| Vertex { position: 3.0 * d, normal: Vec3::ZERO })
            .collect();
        sphere.set_smooth_normals(&mut vertices, 4);
        assert!(vertices.iter().all(|v| v.normal.dot(v.position / 3.0) > 0.9995));
    }

    #[test]
    fn level_errors_bound_the_true_distance() {
        let sphere = Icosphere::shared();
        let vertices: Vec<Vertex> = sphere.directions[..Icosphere::vertex_count(3)]
            .iter()
            .map(|&d| Vertex { position: d, normal: d })
            .collect();
        let errors = sphere.level_errors_m(&vertices);
        assert_eq!(errors[3..], [0.0; 3]);
        // Depth of the face centres below the unit sphere.
        let sag = |level: usize| {
            sphere.triangles[level].iter().fold(0.0_f32, |worst, t| {
                let centre = t.iter().map(|&v| vertices[v as usize].position).sum::<Vec3>() / 3.0;
                worst.max(1.0 - centre.length())
            })
        };
        for level in 0..3 {
            let distance = sag(level) - sag(3);
            assert!(errors[level] >= distance && errors[level] < 1.5 * distance, "{errors:?}, {distance}");
        }
    }

    #[test]
    fn distance_to_triangle_meets_face_edge_and_corner() {
        let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
        for (point, expected) in [
            (Vec3::new(0.2, 0.2, 3.0), 3.0),
            (Vec3::new(0.5, -2.0, 0.0), 2.0),
            (Vec3::new(-3.0, -4.0, 0.0), 5.0),
            (Vec3::new(1.0, 1.0, 0.0), 0.5_f32.sqrt()),
        ] {
            assert!((distance_to_triangle(point, triangle) - expected).abs() < 1e-6);
        }
    }
}
