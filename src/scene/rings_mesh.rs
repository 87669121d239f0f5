//! The ground of the surface stage: concentric rings around the camera over the relief's height function.
//!
//! As in geometry clipmaps (Losasso and Hoppe 2004) the cells grow with the distance from the viewer, here by every ring
//! instead of by levels ([`super::rings`]).
//! Must not know: who asks for heights.

use std::ops::Range;
use std::sync::OnceLock;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::mesh::Vertex;
use super::relief::Relief;
use super::rings::{Rings, View};
use super::terrain::{Layout, Terrain, z_range_m};
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
        vertices.par_chunks_mut(TILE.0 * row_len).enumerate().for_each(|(chunk, vertices)| {
            for first in (0..row_len).step_by(TILE.1) {
                let columns = first..(first + TILE.1).min(row_len);
                set_tile_positions(relief, &rings, centre, chunk * TILE.0, columns, vertices);
            }
            // Both ends of a ring are the same point.
            for row in vertices.chunks_mut(row_len) {
                row[row_len - 1].position = row[0].position;
            }
        });
        set_normals(&mut vertices, columns as usize, rows as usize);
        Self {
            layout: Layout::Rings(rings),
            centre,
            half_extent_m: view.radius_m as f32,
            z_range_m: z_range_m(&vertices),
            columns,
            rows,
            vertices,
            craters: Vec::new(),
            block_bounds: OnceLock::new(),
        }
    }
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
    let corners = [0, tile_rows - 1].into_iter().flat_map(|row| {
        [columns.start, (columns.start + columns.end) / 2, columns.end - 1]
            .map(|column| offset(column, row).distance(middle))
    });
    let radius_m = corners.fold(0.0, f32::max);
    let finest_m = rings.view.cell_m(rings.radii_m[first_row]);
    let nearby = relief.nearby(middle, 1.01 * radius_m, finest_m);
    let rays = &rings.rays[columns.clone()];
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
