//! Dome and stars for other programs. The dome has a hole around the sun, through which the sun's light reaches the
//! scene.
//!
//! Must not know: formats.

use glam::Vec3;

use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::sky::{DOME_LEVEL, Star};

/// Half-angle of the hole in the dome around the sun, degrees.
pub(super) const HOLE_DEG: f64 = 34.0;

/// The sky of a scene, with the hole.
pub(super) struct Sky<'a> {
    /// Unit vectors from the dome's centre to its vertices.
    pub(super) directions: Vec<Vec3>,
    /// Triangles of the dome with inward-facing front faces.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The stars outside the hole with their indices.
    pub(super) stars: Vec<(usize, &'a Star)>,
    /// Indices of the stars in the hole, which are left out.
    pub(super) left_out: Vec<usize>,
}

impl<'a> Sky<'a> {
    /// The sky of a scene.
    pub(super) fn of(scene: &'a Scene) -> Self {
        let edge = libm::cos(HOLE_DEG.to_radians()) as f32;
        let in_hole = |direction: Vec3| direction.dot(scene.sun.direction) > edge;
        let sphere = Icosphere::shared();
        // Only the vertices that a triangle uses, with new indices.
        let mut new_index = vec![None; Icosphere::vertex_count(DOME_LEVEL)];
        let mut directions: Vec<Vec3> = Vec::new();
        let mut reindex = |v: u32| {
            *new_index[v as usize].get_or_insert_with(|| {
                directions.push(sphere.directions[v as usize]);
                directions.len() as u32 - 1
            })
        };
        let triangles = sphere.triangles[DOME_LEVEL]
            .iter()
            .filter(|t| !t.iter().any(|v| in_hole(sphere.directions[*v as usize])))
            .map(|&[a, b, c]| [a, c, b].map(&mut reindex))
            .collect();
        let (left_out, stars): (Vec<_>, Vec<_>) = (scene.sky.stars.iter().enumerate())
            .partition(|(_, star)| in_hole((star.centre - scene.sky.centre).normalize()));
        Self {
            directions,
            triangles,
            stars,
            left_out: left_out.into_iter().map(|(index, _)| index).collect(),
        }
    }
}
