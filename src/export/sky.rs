//! Dome and stars for other programs, whose light has to come through: around the sun the dome has a hole.
//!
//! Must not know: formats.

use glam::Vec3;

use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::sky::{DOME_LEVEL, Star};

/// Half the angle of the dome's hole around the sun, degrees.
pub(super) const HOLE_DEG: f64 = 34.0;

/// The sky of a scene without what lies in the hole.
pub(super) struct Sky<'a> {
    /// Unit vectors from the dome's centre to its vertices.
    pub(super) directions: Vec<Vec3>,
    /// Its triangles, turned inside out: their front faces the scene.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The stars with their numbers.
    pub(super) stars: Vec<(usize, &'a Star)>,
    /// Numbers of those that were left out.
    pub(super) left_out: Vec<usize>,
}

impl<'a> Sky<'a> {
    /// The sky of a scene.
    pub(super) fn of(scene: &'a Scene) -> Self {
        let edge = libm::cos(HOLE_DEG.to_radians()) as f32;
        let in_hole = |direction: Vec3| direction.dot(scene.sun.direction) > edge;
        let sphere = Icosphere::shared();
        // Only the directions that a triangle uses, numbered anew.
        let mut number_of = vec![None; Icosphere::vertex_count(DOME_LEVEL)];
        let mut directions: Vec<Vec3> = Vec::new();
        let mut number = |v: u32| {
            *number_of[v as usize].get_or_insert_with(|| {
                directions.push(sphere.directions[v as usize]);
                directions.len() as u32 - 1
            })
        };
        let triangles = sphere.triangles[DOME_LEVEL]
            .iter()
            .filter(|t| !t.iter().any(|v| in_hole(sphere.directions[*v as usize])))
            .map(|&[a, b, c]| [a, c, b].map(&mut number))
            .collect();
        let (hidden, stars): (Vec<_>, Vec<_>) = (scene.sky.stars.iter().enumerate())
            .partition(|(_, star)| in_hole((star.centre - scene.sky.centre).normalize()));
        Self { directions, triangles, stars, left_out: hidden.into_iter().map(|(index, _)| index).collect() }
    }
}
