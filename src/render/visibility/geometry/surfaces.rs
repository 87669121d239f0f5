//! The surfaces of a scene as screen meshes: rocks, blocks of ground, and the spheres of the sky.
//!
//! Must not know: how triangles are clipped.

use std::ops::Range;

use glam::{Vec2, Vec3};

use super::projection::Projection;
use super::screen_mesh::ScreenMesh;
use crate::render::device::shading_bins::ShadowSources;
use crate::render::raster::cull::{CULL_BATCH, CullMode};
use crate::render::select::caster_grid::CasterGrids;
use crate::render::select::selection::SelectedRock;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::rocks::Rock;

/// A normal faces away from the sun if the sine of its angle to the terminator is above this: a margin for a device's arithmetic,
/// which may differ in the last bits.
const MIN_SINE_BEYOND_TERMINATOR: f32 = 1e-4;

/// What all meshes of a frame share.
pub(super) struct FrameContext<'a> {
    scene: &'a Scene,
    projection: Projection,
    /// Towards the sun; zero if no triangle is to be classified as facing away from it.
    to_sun: Vec3,
    /// None if everything counts as shaded by ground and rocks.
    grids: Option<CasterGrids>,
    caster_grid: &'a [u32],
}

impl<'a> FrameContext<'a> {
    /// See [`super::VisibleTriangles::find`].
    pub(super) fn new(
        scene: &'a Scene,
        settings: &RenderSettings,
        caster_grid: &'a [u32],
        by_shadow_sources: bool,
    ) -> Self {
        Self {
            scene,
            projection: Projection::new(&scene.camera, settings),
            to_sun: if by_shadow_sources { scene.sun.direction } else { Vec3::ZERO },
            grids: by_shadow_sources.then(|| CasterGrids::new(&scene.terrain)),
            caster_grid,
        }
    }

    /// What can shade a surface within a rectangle of the map.
    fn shadow_sources_over(&self, low: Vec2, high: Vec2) -> ShadowSources {
        self.grids.map_or(ShadowSources::GroundAndRocks, |grids| {
            grids.shadow_sources_over(self.caster_grid, low, high)
        })
    }

    /// What can shade a cell of the ground.
    fn shadow_sources_over_cell(&self, column: u32, row: u32) -> ShadowSources {
        let corners = self.scene.terrain.corners(column, row).map(Vec3::truncate);
        let (low, high) =
            corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        self.shadow_sources_over(low, high)
    }
}

impl ScreenMesh {
    /// Adds a rock, without the triangles that are buried below the lowest ground around it.
    pub(super) fn add_rock(&mut self, frame: &FrameContext<'_>, selected: &SelectedRock) {
        let Some(level) = selected.visible_level else { return };
        let (rock, vertices) = (&frame.scene.rocks[selected.rock], visible_vertices(frame.scene, selected));
        let origin = rock.centre - frame.scene.camera.eye;
        let buried_z_m = lowest_ground_m(frame.scene, rock) - rock.centre.z;
        let (centre, radius) = (rock.centre.truncate(), Vec2::splat(rock.radius_m));
        let lit_sources = frame.shadow_sources_over(centre - radius, centre + radius);
        self.add_vertices(&frame.projection, origin, vertices);
        let vertex = |v: u32| (origin + vertices[v as usize].position, vertices[v as usize].normal);
        for triangles in rock.triangles(level).chunks(CULL_BATCH) {
            for &index in self.cull(&frame.projection, triangles).indices() {
                let triangle = triangles[usize::from(index)];
                let corners = triangle.map(|vertex| &vertices[vertex as usize]);
                let shadow_sources = || {
                    let [a, b, c] = corners.map(|corner| corner.position.z);
                    let faces_away =
                        |corner: &&Vertex| corner.normal.dot(frame.to_sun) < -MIN_SINE_BEYOND_TERMINATOR;
                    let is_unlit = corners.iter().all(faces_away);
                    let sources = if is_unlit { ShadowSources::None } else { lit_sources };
                    (a.max(b).max(c) > buried_z_m).then_some(sources)
                };
                self.add(&frame.projection, triangle, CullMode::Back, shadow_sources, vertex);
            }
        }
    }

    /// Adds a block of ground: these columns and rows of cells.
    pub(super) fn add_ground_block(&mut self, frame: &FrameContext<'_>, [columns, rows]: &[Range<u32>; 2]) {
        let (terrain, eye) = (&frame.scene.terrain, frame.scene.camera.eye);
        // Vertices per row, of the terrain and of the block. The mesh holds the block's vertices alone.
        let (row_len, block_row_len) = (terrain.columns + 1, columns.len() as u32 + 1);
        for row in rows.start..=rows.end {
            let first = (row * row_len + columns.start) as usize;
            let vertices = &terrain.vertices[first..first + block_row_len as usize];
            self.add_vertices(&frame.projection, -eye, vertices);
        }
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for row in rows.clone() {
            // First vertex of the row of cells: in the terrain, and in the block.
            let (terrain_first, block_first) =
                (row * row_len + columns.start, (row - rows.start) * block_row_len);
            let to_block = |vertex: u32| {
                let skipped = if vertex >= terrain_first + row_len { row_len - block_row_len } else { 0 };
                block_first + (vertex - terrain_first - skipped)
            };
            let vertex = |index: u32| {
                let is_next_row = index >= block_first + block_row_len;
                let skipped = if is_next_row { row_len - block_row_len } else { 0 };
                let vertex = &terrain.vertices[(terrain_first + (index - block_first) + skipped) as usize];
                (vertex.position - eye, vertex.normal)
            };
            triangles.clear();
            triangles.extend(
                terrain
                    .block_triangles(columns.clone(), row..row + 1)
                    .map(|[a, b, c]| [to_block(a), to_block(b), to_block(c)]),
            );
            let per_cell = triangles.len() / columns.len();
            // Triangles of a cell follow one another and share its answer.
            let mut last_cell = None;
            for &index in self.cull(&frame.projection, &triangles).indices() {
                let column = columns.start + (usize::from(index) / per_cell) as u32;
                let shadow_sources = || match last_cell {
                    Some((cell, sources)) if cell == column => Some(sources),
                    _ => {
                        let sources = frame.shadow_sources_over_cell(column, row);
                        last_cell = Some((column, sources));
                        Some(sources)
                    }
                };
                let triangle = triangles[usize::from(index)];
                self.add(&frame.projection, triangle, CullMode::Back, shadow_sources, vertex);
            }
        }
    }

    /// Adds a sphere of the sky, which is drawn from inside too.
    pub(super) fn add_sphere(&mut self, frame: &FrameContext<'_>, level: usize, centre: Vec3, radius_m: f32) {
        let sphere = Icosphere::shared();
        let first = self.vertices.len() as u32;
        let origin = centre - frame.scene.camera.eye;
        let directions = &sphere.directions[..Icosphere::vertex_count(level)];
        let vertices: Vec<Vertex> =
            directions.iter().map(|&d| Vertex { position: radius_m * d, normal: d }).collect();
        self.add_vertices(&frame.projection, origin, &vertices);
        for triangle in &sphere.triangles[level] {
            let triangle = triangle.map(|vertex| first + vertex);
            let vertex = |index: u32| {
                let Vertex { position, normal } = vertices[(index - first) as usize];
                (origin + position, normal)
            };
            let shadow_sources = || Some(ShadowSources::None);
            self.add(&frame.projection, triangle, CullMode::None, shadow_sources, vertex);
        }
    }
}

/// The vertices of a rock as far as the camera sees it.
pub(super) fn visible_vertices<'a>(scene: &'a Scene, selected: &SelectedRock) -> &'a [Vertex] {
    let rock = &scene.rocks[selected.rock];
    let count = |level: usize| Icosphere::vertex_count(level.min(rock.level));
    &rock.vertices[..selected.visible_level.map_or(0, count)]
}

/// A height that the ground around a rock does not fall below.
fn lowest_ground_m(scene: &Scene, rock: &Rock) -> f32 {
    let terrain = &scene.terrain;
    let (centre, radius) = (rock.centre.truncate(), Vec2::splat(rock.radius_m));
    let (low, high) = (centre - radius, centre + radius);
    let corners = [low, high, Vec2::new(low.x, high.y), Vec2::new(high.x, low.y)];
    if !corners.iter().all(|corner| terrain.contains(*corner)) {
        // No ground buries a rock beyond the border of the terrain.
        return f32::NEG_INFINITY;
    }
    terrain.lowest_over(low, high)
}
