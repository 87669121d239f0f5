//! The ground of the surface stage: concentric rings around the camera over the relief's height function.
//!
//! As in geometry clipmaps (Losasso and Hoppe 2004) the cells grow with the distance from the viewer, here by every ring
//! instead of by levels ([`super::rings`]).
//! Must not know: who asks for heights.

use std::ops::Range;
use std::sync::OnceLock;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::craters::Region;
use super::mesh::Vertex;
use super::relief::Relief;
use super::rings::{LANES, LaneCells, Rings, View};
use super::terrain::{Layout, MIN_AREA_M2, Terrain, z_range_m};
use crate::pool::PooledVec;

/// Rows and columns of a tile, whose vertices share one search for nearby craters and fillets.
const TILE: (usize, usize) = (16, 32);

impl Terrain {
    /// Rings around `centre` (metres, world) over a relief.
    #[must_use]
    pub fn rings(relief: &Relief, view: &View, centre: Vec2) -> Self {
        let rings = Rings::new(view);
        let (columns, rows) = (rings.columns(), rings.rows());
        let row_len = columns as usize + 1;
        let mut vertices: PooledVec<Vertex> = PooledVec::unspecified(row_len * (rows as usize + 1));
        let mut heights_m: PooledVec<f32> = PooledVec::unspecified(vertices.len());
        let tiles = vertices.par_chunks_mut(TILE.0 * row_len).zip(heights_m.par_chunks_mut(TILE.0 * row_len));
        tiles.enumerate().for_each(|(chunk, (vertices, heights_m))| {
            for first in (0..row_len).step_by(TILE.1) {
                let columns = first..(first + TILE.1).min(row_len);
                set_tile_positions(relief, &rings, centre, chunk * TILE.0, columns, vertices);
            }
            // Both ends of a ring are the same point.
            for row in vertices.chunks_mut(row_len) {
                row[row_len - 1].position = row[0].position;
            }
            for (height_m, vertex) in heights_m.iter_mut().zip(vertices) {
                *height_m = vertex.position.z;
            }
        });
        set_normals(&mut vertices, columns as usize, rows as usize);
        Self {
            layout: Layout::Rings(rings),
            centre,
            half_extent_m: view.radius_m as f32,
            z_range_m: z_range_m(&heights_m),
            columns,
            rows,
            vertices,
            heights_m,
            craters: Vec::new(),
            block_bounds: OnceLock::new(),
            range: OnceLock::new(),
        }
    }
}

/// The cells of a ground with rings that eight points were in, with their corners.
#[derive(Debug, Default)]
pub(crate) struct CornersOfLanes {
    cells: LaneCells,
    /// South-west, south-east, north-west and north-east: x, y and z of each lane.
    corners: [[[f32; LANES]; 3]; 4],
    /// 1 where a cell is a single triangle, around the centre.
    is_fan: [f32; LANES],
}

impl Terrain {
    /// [`Self::surface_height_at`] of eight points, of those in a mask; anything elsewhere. `known` has what the points before found, on
    /// this ground.
    #[inline(always)]
    pub(crate) fn surface_heights_at<S: Simd>(
        &self,
        simd: S,
        [x, y]: [f32x8<S>; 2],
        mask: mask32x8<S>,
        known: &mut CornersOfLanes,
    ) -> f32x8<S> {
        if let Layout::Rings(rings) = &self.layout {
            return self.ring_heights(simd, rings, [x, y], mask, known);
        }
        let (mut points, mut heights_m) = ([[0.0; LANES]; 2], [0.0; LANES]);
        x.store_slice(&mut points[0]);
        y.store_slice(&mut points[1]);
        let lanes = mask.to_bitmask();
        for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
            heights_m[lane] = self.surface_height_at(Vec2::new(points[0][lane], points[1][lane]));
        }
        f32x8::from_slice(simd, &heights_m)
    }

    /// [`Self::surface_height_at`] of eight points of a ground with these rings, to the bit, of those in a mask; anything elsewhere. `known`
    /// has what the points before found, on this ground.
    // Inlined into `dispatch!`, so that it is compiled for each SIMD level.
    #[inline(always)]
    pub(crate) fn ring_heights<S: Simd>(
        &self,
        simd: S,
        rings: &Rings,
        [x, y]: [f32x8<S>; 2],
        mask: mask32x8<S>,
        known: &mut CornersOfLanes,
    ) -> f32x8<S> {
        let CornersOfLanes { cells, corners, is_fan } = known;
        let offset = [x - self.centre.x, y - self.centre.y];
        let mut lanes = rings.find_cells(simd, offset, mask, cells);
        let row_len = self.columns as usize + 1;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (row, column) = (cells.rows[lane] as usize, cells.columns[lane] as usize);
            let (radii_m, rays) = (&rings.radii_m[row..row + 2], &rings.rays[column..column + 2]);
            let [south, north] =
                [row, row + 1].map(|row| &self.heights_m[row * row_len + column..row * row_len + column + 2]);
            for (end, heights_m) in [south, north].into_iter().enumerate() {
                for side in 0..2 {
                    let corner = &mut corners[2 * end + side];
                    corner[0][lane] = self.centre.x + radii_m[end] * rays[side].x;
                    corner[1][lane] = self.centre.y + radii_m[end] * rays[side].y;
                    corner[2][lane] = heights_m[side];
                }
            }
            is_fan[lane] = if row == 0 { 1.0 } else { 0.0 };
        }
        // Written out: a closure that returns a vector is not always inlined.
        let [sw, se, nw, ne] = &*corners;
        let (a_x, a_y, a_z) = load(simd, sw);
        let (se_x, se_y, se_z) = load(simd, se);
        let (nw_x, nw_y, nw_z) = load(simd, nw);
        let (ne_x, ne_y, ne_z) = load(simd, ne);
        let (p_x, p_y) = (x - a_x, y - a_y);
        let is_right = ((ne_x - a_x) * p_y - (ne_y - a_y) * p_x).simd_lt(0.0)
            & f32x8::from_slice(simd, &*is_fan).simd_eq(0.0);
        // As `plane_height`, with the corners of the triangle relative to the first.
        let (b_x, b_y) = (is_right.select(se_x, ne_x) - a_x, is_right.select(se_y, ne_y) - a_y);
        let (c_x, c_y) = (is_right.select(ne_x, nw_x) - a_x, is_right.select(ne_y, nw_y) - a_y);
        let (b_z, c_z) = (is_right.select(se_z, ne_z) - a_z, is_right.select(ne_z, nw_z) - a_z);
        let area = b_x * c_y - b_y * c_x;
        let height = a_z + ((p_x * c_y - p_y * c_x) * b_z + (b_x * p_y - b_y * p_x) * c_z) / area;
        area.abs().simd_lt(MIN_AREA_M2).select(a_z, height)
    }
}

/// Coordinates of eight points.
#[inline(always)]
fn load<S: Simd>(simd: S, [x, y, z]: &[[f32; LANES]; 3]) -> (f32x8<S>, f32x8<S>, f32x8<S>) {
    (f32x8::from_slice(simd, x), f32x8::from_slice(simd, y), f32x8::from_slice(simd, z))
}

/// Sets the positions of a tile: of these columns in the rings from `first_row` on, whose vertices are given row by row.
fn set_tile_positions(
    relief: &Relief,
    rings: &Rings,
    centre: Vec2,
    first_row: usize,
    columns: Range<usize>,
    vertices: &mut [Vertex],
) {
    let row_len = rings.rays.len();
    let tile_rows = vertices.len() / row_len;
    let offset = |column: usize, row: usize| rings.offset(column as u32, (first_row + row) as u32);
    // A circle around the tile.
    let middle = offset((columns.start + columns.end) / 2, tile_rows / 2);
    let ends = [0, tile_rows - 1].into_iter();
    let from_middle_m =
        ends.flat_map(|row| columns.clone().map(move |column| offset(column, row).distance(middle)));
    let radius_m = from_middle_m.fold(0.0, f32::max);
    let finest_m = rings.view.cell_m(rings.radii_m[first_row]);
    let distances_m = [first_row, first_row + tile_rows - 1].map(|row| rings.radii_m[row]);
    let rays = &rings.rays[columns.clone()];
    let sides = sides_of_sector(rays);
    let nearby = relief.nearby(&Region { middle, radius_m: 1.01 * radius_m, distances_m, sides }, finest_m);
    let (mut x, mut y, mut heights) = ([0.0; TILE.1], [0.0; TILE.1], [0.0; TILE.1]);
    for (row, vertices) in vertices.chunks_exact_mut(row_len).enumerate() {
        let radius_m = rings.radii_m[first_row + row];
        for ((x, y), ray) in x.iter_mut().zip(&mut y).zip(rays) {
            (*x, *y) = (radius_m * ray.x, radius_m * ray.y);
        }
        let offsets = [&x[..rays.len()], &y[..rays.len()]];
        relief.set_heights(offsets, rings.view.cell_m(radius_m), &nearby, &mut heights[..rays.len()]);
        let points = x.iter().zip(&y).zip(&heights);
        for (vertex, ((x, y), height)) in vertices[columns.clone()].iter_mut().zip(points) {
            vertex.position = (centre + Vec2::new(*x, *y)).extend(*height);
        }
    }
}

/// Outward normals of the first and the last of rays that follow one another clockwise; zero if they span more than half a turn.
fn sides_of_sector(rays: &[Vec2]) -> [Vec2; 2] {
    let sides = [rays[0].perp(), -rays[rays.len() - 1].perp()];
    let is_inside = |ray: &Vec2| sides.iter().all(|side| side.dot(*ray) < 1e-6);
    if rays.iter().all(is_inside) { sides } else { [Vec2::ZERO; 2] }
}

/// Sets all normals by central differences along rings and rays.
fn set_normals(vertices: &mut [Vertex], columns: usize, last_row: usize) {
    let row_len = columns + 1;
    let mut positions: PooledVec<Vec3> = PooledVec::unspecified(vertices.len());
    for (position, vertex) in positions.iter_mut().zip(vertices.iter()) {
        *position = vertex.position;
    }
    vertices.par_chunks_mut(row_len).enumerate().for_each(|(row, vertices)| {
        // The innermost ring is a single point: it takes the slope of the next ring.
        let (inner, outer) = (row.saturating_sub(1), (row.max(1) + 1).min(last_row));
        for (column, vertex) in vertices.iter_mut().enumerate() {
            let at = |column: usize, row: usize| positions[row * row_len + column];
            let west = if column == 0 { columns - 1 } else { column - 1 };
            let east = if column == columns { 1 } else { column + 1 };
            let ring = row.max(1);
            let normal = (at(east, ring) - at(west, ring)).cross(at(column, outer) - at(column, inner));
            vertex.normal = normal / normal.length();
        }
        if row == 0 {
            let sum: Vec3 = vertices.iter().map(|vertex| vertex.normal).sum();
            vertices.iter_mut().for_each(|vertex| vertex.normal = sum / sum.length());
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::scene::Scene;
    use fearless_simd::{Level, dispatch};

    fn scene(set: &[&str]) -> Scene {
        let mut config = Config::new();
        config.set_stage("surface").expect("a stage");
        set.iter().for_each(|set| config.apply_set(set).expect("a knob"));
        Scene::build(3, &config.draw(3).expect("drawn")).expect("built")
    }

    /// What is near a tile holds all that is near one of its vertices, also where its columns are most of a turn.
    #[test]
    fn heights_of_a_tile_are_those_of_its_vertices() {
        for set in [&[][..], &["terrain.cell_mrad=30"], &["camera.fov_deg=8", "rocks.coverage=0.03"]] {
            let scene = scene(set);
            let (terrain, relief) = (&scene.terrain, scene.relief.as_ref().expect("a relief"));
            let Layout::Rings(rings) = &terrain.layout else { unreachable!() };
            let (columns, rows) = (rings.columns(), rings.rows());
            for at in (0..columns * (rows + 1)).step_by((columns * rows / 7000) as usize | 1) {
                let (column, row) = (at % columns, at / columns);
                let cell_m = rings.view.cell_m(rings.radii_m[row as usize]);
                let expected = relief.height_at(rings.offset(column, row), cell_m);
                let height = terrain.vertices[(row * (columns + 1) + column) as usize].position.z;
                assert_eq!(height.to_bits(), expected.to_bits(), "{set:?}, column {column}, row {row}");
            }
        }
    }

    #[test]
    fn eight_heights_are_those_of_their_points() {
        let scene = scene(&[]);
        let terrain = &scene.terrain;
        let Layout::Rings(rings) = &terrain.layout else { unreachable!() };
        let point = |k: u16| {
            let (angle, part) = (2.399_963_f32 * f32::from(k), f32::from(k) / 4000.0);
            let direction = Vec2::new(libm::sinf(angle), libm::cosf(angle));
            terrain.centre + 0.999 * terrain.half_extent_m * part * part * part * direction
        };
        // Scattered points, and others that follow one another within cells and from cell to cell.
        let scattered =
            (0..4000).step_by(LANES).map(|first| std::array::from_fn(|lane| point(first + lane as u16)));
        let rows = (0..2000).map(|step: u16| {
            let along = 0.004 * f32::from(step) - 4.0;
            std::array::from_fn(|lane| {
                terrain.centre + Vec2::new(along, 0.3 * lane as f32 - 0.9 + 0.4 * along)
            })
        });
        let mut known = CornersOfLanes::default();
        for points in scattered.chain(rows) {
            let points: [Vec2; LANES] = points;
            let (x, y) = (points.map(|p| p.x), points.map(|p| p.y));
            let mut heights = [0.0; LANES];
            dispatch!(Level::new(), simd => {
                let points = [f32x8::from_slice(simd, &x), f32x8::from_slice(simd, &y)];
                let all = points[0].simd_eq(points[0]);
                terrain.ring_heights(simd, rings, points, all, &mut known).store_slice(&mut heights);
            });
            let expected = points.map(|p| terrain.surface_height_at(p));
            assert_eq!(heights.map(f32::to_bits), expected.map(f32::to_bits), "{points:?}");
        }
    }
}
