//! Triangles that can be seen, picked one by one: for devices on which a triangle costs more than the picking.
//!
//! A driver that rasterises on the CPU takes as long for a triangle that faces away as this takes for fifty. What is
//! left out here could not have covered a sample, so that labels and picture are the same with and without.
//! Such a driver also runs every branch of a shader: ground on which no shadow can fall, or only that of other ground, is
//! told apart, to be drawn by a program without the rest.
//! Must not know: buffers.

use std::ops::Range;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::selection::{Frustum, Selection, ground_blocks};
use super::shadow::CasterGrids;
use crate::scene::Scene;
use crate::scene::rocks::Rock;

/// A triangle counts as facing both ways if the sine of its tilt is below this: a device's arithmetic may differ from
/// ours.
const EDGE_ON: f32 = 1e-3;

/// The triangles of a rock that matter, as lists of vertex indices.
#[derive(Clone, Debug, Default)]
pub struct RockTriangles {
    /// Towards the eye and not under the ground.
    pub seen: Vec<[u32; 3]>,
    /// Towards the sun.
    pub fronts: Vec<[u32; 3]>,
    /// Away from the sun.
    pub backs: Vec<[u32; 3]>,
}

/// The triangles of a selection that matter.
#[derive(Clone, Debug, Default)]
pub struct Facing {
    /// For each of [`Selection::rocks`].
    pub rocks: Vec<RockTriangles>,
    /// For each of [`Selection::blocks`]: ground on which no shadow can fall, on which only that of ground can, and the
    /// rest.
    pub ground: Vec<[Vec<[u32; 3]>; 3]>,
}

impl Facing {
    /// What matters of a selection. `caster_grid` is that of [`super::shadow::caster_grid`].
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection, frustum: &Frustum, caster_grid: &[u32]) -> Self {
        let rocks = selection
            .rocks
            .par_iter()
            .map(|selected| {
                let rock = &scene.rocks[selected.rock];
                let seen = selected.seen_level.map_or(Vec::new(), |level| seen_triangles(scene, rock, level));
                let (fronts, backs) = selected
                    .caster
                    .map_or_else(Default::default, |(_, level)| by_side(rock, level, scene.sun.direction));
                RockTriangles { seen, fronts, backs }
            })
            .collect();
        let grids = CasterGrids::new(&scene.terrain);
        let spans: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
        let ground = selection
            .blocks
            .par_iter()
            .map(|&(block, _)| ground_triangles(scene, &spans[block], frustum, &grids, caster_grid))
            .collect();
        Self { rocks, ground }
    }
}

/// The normal of a triangle, as long as twice its area, and its corners.
fn normal(rock: &Rock, triangle: &[u32; 3]) -> (Vec3, [Vec3; 3]) {
    let corners = triangle.map(|vertex| rock.vertices[vertex as usize].position);
    let [a, b, c] = corners;
    ((b - a).cross(c - a), corners)
}

fn seen_triangles(scene: &Scene, rock: &Rock, level: usize) -> Vec<[u32; 3]> {
    let eye = scene.camera.eye - rock.centre;
    // Whatever lies below the lowest ground around the rock is under the ground.
    let buried_m = lowest_ground_m(scene, rock) - rock.centre.z;
    let triangles = rock.triangles(level).iter().filter(|triangle| {
        let (_, [a, b, c]) = normal(rock, triangle);
        may_face([a, b, c], eye - a) && a.z.max(b.z).max(c.z) > buried_m
    });
    triangles.copied().collect()
}

fn by_side(rock: &Rock, level: usize, sun: Vec3) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
    let triangles = rock.triangles(level);
    let (mut fronts, mut backs) =
        (Vec::with_capacity(triangles.len() * 3 / 5), Vec::with_capacity(triangles.len() * 3 / 5));
    for triangle in triangles {
        let (normal, _) = normal(rock, triangle);
        let facing = normal.dot(sun);
        let edge_on = facing * facing < EDGE_ON * EDGE_ON * normal.length_squared();
        if facing > 0.0 || edge_on {
            fronts.push(*triangle);
        }
        if facing < 0.0 || edge_on {
            backs.push(*triangle);
        }
    }
    (fronts, backs)
}

/// A height that the ground around a rock does not fall below.
fn lowest_ground_m(scene: &Scene, rock: &Rock) -> f32 {
    let terrain = &scene.terrain;
    let (centre, radius) = (rock.centre.truncate(), Vec2::splat(rock.radius_m));
    let (low, high) = (centre - radius, centre + radius);
    let corners = [low, high, Vec2::new(low.x, high.y), Vec2::new(high.x, low.y)];
    if !corners.iter().all(|corner| terrain.contains(*corner)) {
        // Beyond its border there is no ground to be under.
        return f32::NEG_INFINITY;
    }
    terrain.lowest_over(low, high)
}

/// The triangles of a block that may be seen, by what can shade them: nothing, other ground, rocks.
fn ground_triangles(
    scene: &Scene,
    [columns, rows]: &[Range<u32>; 2],
    frustum: &Frustum,
    grids: &CasterGrids,
    caster_grid: &[u32],
) -> [Vec<[u32; 3]>; 3] {
    let terrain = &scene.terrain;
    let mut lists = [Vec::new(), Vec::new(), Vec::new()];
    for row in rows.clone() {
        for column in columns.clone() {
            let corners = terrain.corners(column, row);
            let (low, high) =
                corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.min(*p), high.max(*p)));
            if frustum.may_see_box(low, high) {
                let shades = grids.shades_over(caster_grid, low.truncate(), high.truncate());
                let triangles = terrain.block_triangles(column..column + 1, row..row + 1);
                lists[shades as usize].extend(triangles.filter(|triangle| {
                    let corners = triangle.map(|vertex| terrain.vertices[vertex as usize].position);
                    may_face(corners, scene.camera.eye - corners[0])
                }));
            }
        }
    }
    lists
}

/// Whether a triangle may face in the direction from its first corner.
fn may_face([a, b, c]: [Vec3; 3], towards: Vec3) -> bool {
    let normal = (b - a).cross(c - a);
    let facing = normal.dot(towards);
    facing > 0.0 || facing * facing < EDGE_ON * EDGE_ON * normal.length_squared() * towards.length_squared()
}
