//! The ground as a grid of vertices: the mesh, and the heights that rocks, camera and horizon ask for.
//!
//! The nominal stage has a square of equal cells ([`super::square_grid`]), the surface stage rings around the camera
//! whose cells grow with the distance ([`super::rings_mesh`]).
//! Must not know: who asks.

use std::ops::Range;
use std::sync::OnceLock;

use glam::{Vec2, Vec3};

use super::grid_cell::CellPoint;
use super::ground_range::GroundRange;
use super::mesh::Vertex;
use super::nominal_craters::Crater;
use super::rings::Rings;
use crate::pool::PooledVec;

/// How the ground's grid lies over the plane.
#[derive(Clone, Debug)]
pub enum Layout {
    /// Equal cells over a square that is centred on the origin.
    Square,
    /// Concentric rings around the camera.
    Rings(Rings),
}

/// The ground: a grid of vertices, two triangles per cell.
#[derive(Clone, Debug)]
pub struct Terrain {
    /// How the grid lies over the plane.
    pub layout: Layout,
    /// Centre of the ground, metres.
    pub centre: Vec2,
    /// Half the side of the square, or radius of the outermost ring; metres.
    pub half_extent_m: f32,
    /// Lowest and highest vertex, metres.
    pub z_range_m: [f32; 2],
    /// Cells along a row.
    pub columns: u32,
    /// Cells across the rows.
    pub rows: u32,
    /// `(columns + 1) x (rows + 1)` vertices, row by row. In a square, y grows with the row and x along it; with rings, a
    /// row is a ring, from the innermost outwards.
    pub vertices: PooledVec<Vertex>,
    /// Their heights alone, metres: who asks for heights at many points has more of them in the processor's cache.
    pub heights_m: PooledVec<f32>,
    /// The craters of the nominal stage; empty on the surface stage.
    pub craters: Vec<Crater>,
    /// Lowest and highest corner of the bounding box of each block of cells that is culled as one, world, metres; set by the first
    /// frame.
    pub block_bounds: OnceLock<Vec<[Vec3; 2]>>,
    /// Bounds of its heights, if it has rings; set by the first frame.
    pub(crate) range: OnceLock<GroundRange>,
}

impl Terrain {
    /// Side of a cell of a square grid, metres.
    #[must_use]
    pub fn cell_m(&self) -> f32 {
        2.0 * self.half_extent_m / self.columns as f32
    }

    /// Whether there is ground at a point.
    #[must_use]
    pub fn contains(&self, p: Vec2) -> bool {
        match &self.layout {
            Layout::Square => p.abs().max_element() <= self.half_extent_m,
            Layout::Rings(_) => p.distance_squared(self.centre) <= self.half_extent_m * self.half_extent_m,
        }
    }

    /// Bounds of the heights of rings, computed once; `None` for a square.
    #[must_use]
    pub(crate) fn range(&self) -> Option<&GroundRange> {
        let Layout::Rings(_) = self.layout else { return None };
        let size = [self.columns as usize, self.rows as usize];
        let around = (self.centre, self.half_extent_m);
        Some(self.range.get_or_init(|| GroundRange::new(&self.vertices, size, around)))
    }

    /// Ground height at a point, bilinear in its cell, metres. Outside the ground: that of its border.
    #[must_use]
    pub fn height_at(&self, p: Vec2) -> f32 {
        let at = self.locate(p);
        let [h00, h10, h01, h11] = self.corners(at.column, at.row).map(|corner| corner.z);
        let along = |a: f32, b: f32| a + (b - a) * at.u;
        let (south, north) = (along(h00, h10), along(h01, h11));
        south + (north - south) * at.v
    }

    /// Height of the triangles at a point, metres. Outside the ground: that of its border.
    #[must_use]
    pub fn surface_height_at(&self, p: Vec2) -> f32 {
        match &self.layout {
            Layout::Square => {
                let at = self.locate(p);
                let [h00, h10, h01, h11] = self.corners(at.column, at.row).map(|corner| corner.z);
                let (u, v) = (at.u, at.v);
                if u >= v {
                    h00 + (h10 - h00) * u + (h11 - h10) * v
                } else {
                    h00 + (h01 - h00) * v + (h11 - h01) * u
                }
            }
            Layout::Rings(rings) => {
                let [column, row] = rings.cell(p - self.centre);
                let [sw, se, nw, ne] = self.corners(column, row);
                let diagonal = (ne - sw).truncate();
                let right = row > 0 && diagonal.perp_dot(p - sw.truncate()) < 0.0;
                plane_height(if right { [sw, se, ne] } else { [sw, ne, nw] }, p)
            }
        }
    }

    /// The two triangles of each cell of a block of cells, counter-clockwise seen from above; the cell's
    /// south-west and north-east corners share the diagonal.
    pub fn block_triangles(&self, columns: Range<u32>, rows: Range<u32>) -> impl Iterator<Item = [u32; 3]> {
        let row_len = self.columns + 1;
        let is_rings = matches!(self.layout, Layout::Rings(_));
        rows.flat_map(move |row| {
            columns.clone().flat_map(move |column| {
                let (sw, se) = (row * row_len + column, row * row_len + column + 1);
                let (nw, ne) = (sw + row_len, se + row_len);
                // The innermost row of rings is a fan: its cells are single triangles.
                let fan = is_rings && row == 0;
                [[sw, se, ne], [sw, ne, nw]].into_iter().skip(usize::from(fan))
            })
        })
    }

    /// Every triangle of the ground.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.block_triangles(0..self.columns, 0..self.rows)
    }

    /// Position of the vertex at a column and a row of the grid.
    #[must_use]
    pub fn position(&self, column: u32, row: u32) -> Vec3 {
        self.vertices[(row * (self.columns + 1) + column) as usize].position
    }

    /// Corners of a cell: south-west, south-east, north-west, north-east.
    #[must_use]
    pub fn corners(&self, column: u32, row: u32) -> [Vec3; 4] {
        let at = |dx, dy| self.position(column + dx, row + dy);
        [at(0, 0), at(1, 0), at(0, 1), at(1, 1)]
    }

    /// The cell that contains a point; outside the ground, the nearest on its border.
    #[must_use]
    pub fn locate(&self, p: Vec2) -> CellPoint {
        match &self.layout {
            Layout::Square => {
                let size_m = 2.0 * self.half_extent_m;
                let locate = |x: f32| {
                    let t = ((x / size_m + 0.5) * self.columns as f32).clamp(0.0, self.columns as f32);
                    let cell = (t as u32).min(self.columns - 1);
                    (cell, t - cell as f32)
                };
                let ((column, u), (row, v)) = (locate(p.x), locate(p.y));
                CellPoint { column, row, u, v }
            }
            Layout::Rings(rings) => rings.locate(p - self.centre),
        }
    }

    /// Columns and rows of vertices whose cells cover a box (its lowest and highest corner, metres): a superset.
    fn vertices_over(&self, low: Vec2, high: Vec2) -> [Range<u32>; 2] {
        match &self.layout {
            Layout::Square => {
                let margin = 1e-3;
                let span = |low: f32, high: f32| {
                    let cell = |x: f32| (x + self.half_extent_m) / self.cell_m();
                    let first = (cell(low) - margin).floor().clamp(0.0, self.columns as f32);
                    let last = (cell(high) + margin).ceil().clamp(0.0, self.columns as f32);
                    first as u32..last as u32 + 1
                };
                [span(low.x, high.x), span(low.y, high.y)]
            }
            Layout::Rings(rings) => rings.vertices_over(low - self.centre, high - self.centre),
        }
    }

    /// The corner positions of the triangles that cover a box (its lowest and highest corner, metres): a superset.
    pub fn triangles_over(&self, low: Vec2, high: Vec2) -> impl Iterator<Item = [Vec3; 3]> {
        let [columns, rows] =
            self.vertices_over(low, high).map(|vertices| vertices.start..vertices.end.saturating_sub(1));
        self.block_triangles(columns, rows)
            .map(|triangle| triangle.map(|vertex| self.vertices[vertex as usize].position))
    }

    /// Lower bound on the height of the ground over a box (its lowest and highest corner), metres; infinity where there is
    /// no ground.
    #[must_use]
    pub fn lowest_over(&self, low: Vec2, high: Vec2) -> f32 {
        let [columns, rows] = self.vertices_over(low, high);
        let mut lowest = f32::INFINITY;
        for row in rows {
            let first = (row * (self.columns + 1)) as usize;
            for &height_m in &self.heights_m[first + columns.start as usize..first + columns.end as usize] {
                // `f32::min` is more than a comparison (NaN).
                lowest = if height_m < lowest { height_m } else { lowest };
            }
        }
        lowest
    }

    /// Lower and upper bound on the height of the ground over a box, metres: no narrower than [`Self::lowest_over`] any box within.
    #[must_use]
    pub fn z_range_over(&self, low: Vec2, high: Vec2) -> [f32; 2] {
        let [columns, rows] = self.vertices_over(low, high);
        let mut range = [f32::INFINITY, f32::NEG_INFINITY];
        for row in rows {
            let first = (row * (self.columns + 1)) as usize;
            let [lowest, highest] =
                z_range_m(&self.heights_m[first + columns.start as usize..first + columns.end as usize]);
            range = [range[0].min(lowest), range[1].max(highest)];
        }
        range
    }
}

/// The lowest and the highest of some heights, metres.
pub(super) fn z_range_m(heights_m: &[f32]) -> [f32; 2] {
    // `f32::min` is more than a comparison (NaN), and a single range would be one dependency chain over all heights.
    let wider = |[low, high]: [f32; 2], [from, to]: [f32; 2]| {
        [if from < low { from } else { low }, if to > high { to } else { high }]
    };
    let mut ranges = [[f32::MAX, f32::MIN]; 8];
    for heights_m in heights_m.chunks(ranges.len()) {
        for (range, height_m) in ranges.iter_mut().zip(heights_m) {
            *range = wider(*range, [*height_m; 2]);
        }
    }
    ranges.into_iter().fold([f32::MAX, f32::MIN], wider)
}

/// Twice the least area of a triangle, seen from above, whose plane is computed, m^2.
pub(super) const MIN_AREA_M2: f32 = 1e-12;

/// Height of the plane through three points at a point of the plane below.
fn plane_height([a, b, c]: [Vec3; 3], p: Vec2) -> f32 {
    let (ab, ac, ap) = ((b - a).truncate(), (c - a).truncate(), p - a.truncate());
    let area = ab.perp_dot(ac);
    if area.abs() < MIN_AREA_M2 {
        return a.z;
    }
    a.z + (ap.perp_dot(ac) * (b.z - a.z) + ab.perp_dot(ap) * (c.z - a.z)) / area
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may be computed with std's functions")]
mod tests {
    use super::*;

    #[test]
    fn heights_agree_at_vertices_and_on_a_tilted_plane() {
        let plane = |p: Vec2| 0.1 * p.x - 0.3 * p.y + 2.0;
        let terrain = Terrain::from_height(100.0, 20, Vec::new(), plane);
        for vertex in &terrain.vertices {
            let p = vertex.position.truncate();
            assert!((terrain.height_at(p) - vertex.position.z).abs() < 1e-4);
            assert!((terrain.surface_height_at(p) - vertex.position.z).abs() < 1e-4);
            let expected = Vec3::new(-0.1, 0.3, 1.0) / Vec3::new(-0.1, 0.3, 1.0).length();
            assert!(vertex.normal.distance(expected) < 1e-4);
        }
        for p in [Vec2::new(1.3, -7.7), Vec2::new(-49.9, 49.9), Vec2::new(12.0, 0.1)] {
            assert!((terrain.height_at(p) - plane(p)).abs() < 1e-4);
            assert!((terrain.surface_height_at(p) - plane(p)).abs() < 1e-4);
        }
    }

    #[test]
    fn surface_height_lies_on_the_triangles() {
        let terrain = Terrain::from_height(40.0, 8, Vec::new(), |p| (p.x * 0.7).sin() * (p.y * 0.9).cos());
        let triangles: Vec<[u32; 3]> = terrain.block_triangles(0..8, 0..8).collect();
        assert_eq!(triangles.len(), 128);
        for triangle in triangles {
            let [a, b, c] = triangle.map(|v| terrain.vertices[v as usize].position);
            assert!((b - a).cross(c - a).z > 0.0);
            for (s, t) in [(0.2, 0.3), (0.6, 0.1), (0.1, 0.8)] {
                let p = a + s * (b - a) + t * (c - a);
                assert!((terrain.surface_height_at(p.truncate()) - p.z).abs() < 1e-4);
            }
        }
    }
}
