//! Triangles that can be seen, picked one by one: for devices on which a triangle costs more than the picking.
//!
//! A driver that rasterises on the CPU takes as long for a triangle that faces away, or that lies between the samples, as
//! this takes for many. What is left out here could not have covered a sample, so that labels and picture are the same
//! with and without.
//! Such a driver also runs every branch of a shader: ground on which no shadow can fall, or only that of other ground, and
//! rock that is turned from the sun are told apart, to be drawn by a program without the rest.
//! Must not know: buffers.

use std::ops::Range;

use glam::{Mat4, UVec2, Vec2, Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::RenderSettings;
use super::selection::{Bounds, Frustum, SelectedRock, Selection, cell_bounds, ground_blocks};
use super::shadow::CasterGrids;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::noise::NO_FRACTIONS;
use crate::scene::rocks::Rock;

/// A triangle counts as facing both ways if it is thinner than this, samples: a device's arithmetic may differ from ours.
const EDGE_ON: f32 = 0.01;
/// A triangle counts as covering a sample if it comes as near to it as this, samples; likewise.
const MARGIN: f32 = 0.03;
/// Normals are turned from the sun if the sine of their angle to its terminator is above this, for the same reason.
const DARK: f32 = 1e-4;

/// A triangle by the places of its corners among the vertices that are kept of its mesh.
pub type Triangle = [u16; 3];

/// Vertices that are kept of a mesh, which has fewer than 2^16.
#[derive(Clone, Debug, Default)]
struct Kept {
    vertices: Vec<Vertex>,
    /// For each vertex of the mesh, its place among those, or [`Kept::NOT`].
    places: Vec<u16>,
}

impl Kept {
    const NOT: u16 = u16::MAX;

    /// None yet of a mesh of so many.
    fn restart(&mut self, count: usize) {
        self.vertices.clear();
        self.places.clear();
        self.places.resize(count, Self::NOT);
    }

    /// Keeps the corners of a triangle.
    fn keep(&mut self, triangle: [u32; 3], vertex: impl Fn(u32) -> Vertex) -> Triangle {
        triangle.map(|corner| {
            let place = &mut self.places[corner as usize];
            if *place == Self::NOT {
                *place = self.vertices.len() as u16;
                self.vertices.push(vertex(corner));
            }
            *place
        })
    }
}

/// What is drawn of a rock.
#[derive(Clone, Debug, Default)]
pub struct RockTriangles {
    /// Those that the triangles need.
    pub vertices: Vec<Vertex>,
    /// What is seen: turned from the sun all over, and the rest.
    pub seen: [Vec<Triangle>; 2],
}

/// The triangles of a selection that matter.
#[derive(Clone, Debug, Default)]
pub struct Facing {
    /// For each of [`Selection::rocks`].
    pub rocks: Vec<RockTriangles>,
    /// For each of [`Selection::blocks`].
    pub ground: Vec<BlockTriangles>,
}

/// What is drawn of a block of ground.
#[derive(Clone, Debug)]
pub struct BlockTriangles {
    /// Those that the triangles need.
    pub vertices: Vec<Vertex>,
    /// Ground on which no shadow can fall, on which only that of ground can, and the rest.
    pub by_shades: [GroundTriangles; 3],
}

/// Triangles of a block of ground.
#[derive(Clone, Debug)]
pub struct GroundTriangles {
    /// Them.
    pub triangles: Vec<Triangle>,
    /// Where they may be on the picture.
    pub bounds: Bounds,
}

impl GroundTriangles {
    const NONE: Self = Self { triangles: Vec::new(), bounds: Bounds::NOWHERE };

    fn add(&mut self, triangle: Triangle, places: [Vec2; 3]) {
        self.triangles.push(triangle);
        self.bounds = places.map(Bounds::of_place).into_iter().fold(self.bounds, Bounds::union);
    }
}

impl Facing {
    /// What matters of a selection. `caster_grid` is that of [`super::shadow::caster_grid`].
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection, settings: &RenderSettings, caster_grid: &[u32]) -> Self {
        let samples = Samples::of_picture(scene, settings);
        let rocks = selection.rocks.par_iter().map_init(Scratch::default, |scratch, selected| {
            let mut triangles = RockTriangles::default();
            triangles.choose(scene, selected, &samples, scratch);
            triangles
        });
        let rocks = rocks.collect();
        let grids = CasterGrids::new(&scene.terrain);
        let spans: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
        let ground = selection
            .blocks
            .par_iter()
            .map_init(Kept::default, |kept, &(block, _)| {
                ground_triangles(
                    scene,
                    &spans[block],
                    &selection.frustum,
                    &samples,
                    &grids,
                    caster_grid,
                    kept,
                )
            })
            .collect();
        Self { rocks, ground }
    }
}

/// Where samples lie: what turns a place into coordinates in which they stand at every whole number and a half.
#[derive(Clone, Copy, Debug)]
struct Samples {
    /// From metres from the eye to homogeneous coordinates.
    from_offset: Mat4,
    /// The last each way, twice.
    last: Vec4,
}

impl Samples {
    fn of_picture(scene: &Scene, settings: &RenderSettings) -> Self {
        let size = UVec2::from(settings.sample_size()).as_vec2();
        let from_eye = scene.camera.clip_from_world(settings.size) * Mat4::from_translation(scene.camera.eye);
        let last = size - 1.0;
        Self { from_offset: from_clip(size) * from_eye, last: last.extend(last.x).extend(last.y) }
    }

    /// Coordinates of a place; none for one that is not before the eye.
    fn place(&self, offset: Vec3) -> Vec2 {
        let at = self.from_offset * offset.extend(1.0);
        if at.w > 1e-6 { at.xy() / at.w } else { Vec2::NAN }
    }

    /// Whether a triangle may show: it may face the eye and cover a sample. From the extents of its corners.
    fn may_show(&self, [a, b, c]: [Vec4; 3]) -> bool {
        let least = a.min(b).min(c);
        let span = -(least.zw() + least.xy());
        let (ab, ac) = (b.xy() - a.xy(), c.xy() - a.xy());
        // Rows run down: above 0 is what runs the wrong way round. What may be anywhere is no number here.
        let turned_away = ab.perp_dot(ac) > EDGE_ON * (span.x + span.y);
        // Whether there is a whole number between the two, each way.
        let low = (least - (0.5 + MARGIN)).max(Vec4::ZERO);
        let high = (-least.zwzw() - (0.5 - MARGIN)).min(self.last);
        let nearest = (high + NO_FRACTIONS) - NO_FRACTIONS;
        let last = nearest - Vec4::select(nearest.cmpgt(high), Vec4::ONE, Vec4::ZERO);
        !turned_away && last.cmpge(low).bitmask() & 0b11 == 0b11
    }
}

/// From clip space to samples, rows running down.
fn from_clip(size: Vec2) -> Mat4 {
    let half = 0.5 * size;
    let (x, y) = (Vec4::X * half.x, Vec4::Y * -half.y);
    Mat4::from_cols(x, y, Vec4::Z, Vec4::new(half.x, half.y, 0.0, 1.0))
}

/// The coordinates of a corner and their opposites: the least of three corners' tell their extent both ways. A place that is
/// not before the eye may be anywhere.
fn extent(place: Vec2) -> Vec4 {
    if place.is_nan() { Vec4::NEG_INFINITY } else { place.extend(-place.x).extend(-place.y) }
}

/// What is kept from rock to rock, for its memory.
#[derive(Default)]
struct Scratch {
    /// Of each vertex.
    extents: Vec<Vec4>,
    kept: Kept,
}

impl RockTriangles {
    fn choose(&mut self, scene: &Scene, selected: &SelectedRock, samples: &Samples, scratch: &mut Scratch) {
        let Some(level) = selected.seen_level else { return };
        let rock = &scene.rocks[selected.rock];
        let sun = scene.sun.direction;
        let eye = scene.camera.eye - rock.centre;
        // Whatever lies below the lowest ground around the rock is under the ground.
        let buried_m = lowest_ground_m(scene, rock) - rock.centre.z;
        let vertices = &rock.vertices[..Icosphere::vertex_count(level.min(rock.level))];
        let Scratch { extents, kept } = scratch;
        extents.clear();
        extents.extend(vertices.iter().map(|vertex| extent(samples.place(vertex.position - eye))));
        kept.restart(vertices.len());
        for &triangle in rock.triangles(level) {
            let corners = triangle.map(|vertex| vertices[vertex as usize]);
            let [a, b, c] = corners.map(|corner| corner.position);
            let may_show = samples.may_show(triangle.map(|vertex| extents[vertex as usize]));
            if may_show && a.z.max(b.z).max(c.z) > buried_m {
                let dark = corners.iter().all(|corner| corner.normal.dot(sun) < -DARK);
                let triangle = kept.keep(triangle, |vertex| vertices[vertex as usize]);
                self.seen[usize::from(!dark)].push(triangle);
            }
        }
        self.vertices = kept.vertices.clone();
    }
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
    samples: &Samples,
    grids: &CasterGrids,
    caster_grid: &[u32],
    kept: &mut Kept,
) -> BlockTriangles {
    let (terrain, eye) = (&scene.terrain, scene.camera.eye);
    let mut by_shades = [GroundTriangles::NONE; 3];
    // Vertices by their place in the block.
    let (row_len, block_row_len) = (terrain.columns + 1, columns.len() as u32 + 1);
    let first = rows.start * row_len + columns.start;
    let in_block = |vertex: u32| (vertex - first) / row_len * block_row_len + (vertex - first) % row_len;
    let in_terrain = |vertex: u32| first + vertex / block_row_len * row_len + vertex % block_row_len;
    kept.restart((block_row_len as usize) * (rows.len() + 1));
    for row in rows.clone() {
        for column in columns.clone() {
            let (low, high) = cell_bounds(scene, column, row);
            if !frustum.may_see_box(low, high) {
                continue;
            }
            let mut shades = None;
            for triangle in terrain.block_triangles(column..column + 1, row..row + 1) {
                let places =
                    triangle.map(|vertex| samples.place(terrain.vertices[vertex as usize].position - eye));
                if samples.may_show(places.map(extent)) {
                    let shades = *shades.get_or_insert_with(|| {
                        grids.shades_over(caster_grid, low.truncate(), high.truncate())
                    });
                    let triangle = kept
                        .keep(triangle.map(in_block), |vertex| terrain.vertices[in_terrain(vertex) as usize]);
                    by_shades[shades as usize].add(triangle, places);
                }
            }
        }
    }
    BlockTriangles { vertices: kept.vertices.clone(), by_shades }
}
