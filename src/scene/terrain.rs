//! The ground as a grid of vertices: the mesh, the rocks, the camera and the sun's horizon all ask it for heights.
//!
//! The nominal stage has a square of equal cells, made here from two noise layers and craters. The surface stage has
//! rings around the camera whose cells grow with the distance ([`super::rings`]), over the height function of
//! [`super::relief`].
//! Must not know: who asks.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::mesh::Vertex;
use super::noise::Fbm;
use super::relief::Relief;
use super::rings::{Rings, View};
use crate::params::{Knob, Params};
use crate::random::Streams;
use crate::reuse::Reused;

/// Octaves and first frequency (per metre) of the broad relief.
const BROAD: (u32, f32) = (5, 0.010);
/// Octaves and first frequency (per metre) of the finer relief.
const FINE: (u32, f32) = (4, 0.045);
/// Amplitude of the finer relief when that of the broad one is 3.2 m.
const FINE_PER_BROAD: f32 = 0.7 / 3.2;
/// Half the width of the square, as a fraction of the terrain's, in which crater centres lie: 383 of 460 m.
const CRATER_SPREAD: f64 = 383.0 / 460.0;

/// Lines of a square whose heights are reckoned one after the other.
const LINES: usize = 16;
/// Rows and columns of rings whose heights are reckoned together.
const TILE: (usize, usize) = (16, 32);

/// A crater of the nominal stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crater {
    /// Centre, metres.
    pub centre: Vec2,
    /// Radius from the centre to the crest of the rim, metres.
    pub radius_m: f32,
    /// Depth of the bowl below the ground around, metres.
    pub depth_m: f32,
    /// Height of the rim above the ground around, metres.
    pub rim_m: f32,
}

impl Crater {
    /// Whether it adds anything to the ground where `axis` (0 is x, 1 is y) is so many metres.
    fn reaches(&self, axis: usize, at_m: f32) -> bool {
        // It ends at 2.5 radii.
        (at_m - self.centre[axis]).abs() < 2.51 * self.radius_m
    }

    /// Height that the crater adds at a place, metres: a parabolic bowl and a Gaussian rim.
    #[must_use]
    pub fn height_at(&self, p: Vec2) -> f32 {
        let distance = p.distance(self.centre);
        let from_crest = (distance - self.radius_m) / (0.30 * self.radius_m);
        if from_crest > 5.0 {
            return 0.0; // exp(-25): below the resolution of the sum
        }
        let rim = self.rim_m * libm::expf(-from_crest * from_crest);
        let t = distance / self.radius_m;
        if t < 1.0 { rim - self.depth_m * (1.0 - t * t) } else { rim }
    }
}

/// How the ground's grid lies over the plane.
#[derive(Clone, Debug)]
pub enum Layout {
    /// Equal cells over a square that is centred on the origin.
    Square,
    /// Rings around a place.
    Rings(Rings),
}

/// The ground: a grid of vertices, two triangles a cell.
#[derive(Clone, Debug)]
pub struct Terrain {
    /// How the grid lies over the plane.
    pub layout: Layout,
    /// Centre of the ground, metres.
    pub centre: Vec2,
    /// Half the side of the square that the ground fills or, for rings, lies within; metres.
    pub half_extent_m: f32,
    /// Lowest and highest vertex, metres.
    pub z_range_m: [f32; 2],
    /// Cells along a row.
    pub columns: u32,
    /// Cells across the rows.
    pub rows: u32,
    /// `(columns + 1) x (rows + 1)` vertices, row by row. In a square the rows rise with y, and in a row the vertices with
    /// x; of rings the rows are the rings from the inside out.
    pub vertices: Reused<Vertex>,
    /// The craters of the nominal stage that were cut into it.
    pub craters: Vec<Crater>,
}

/// A cell of the ground and a place within it.
#[derive(Clone, Copy, Debug)]
pub struct CellPlace {
    /// Column of the cell.
    pub column: u32,
    /// Row of the cell.
    pub row: u32,
    /// Along the row, 0 to 1.
    pub u: f32,
    /// Across the rows, 0 to 1.
    pub v: f32,
}

impl Terrain {
    /// The ground of these settings.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params) -> Self {
        let size_m = params.number(Knob::TerrainSizeM) as f32;
        let cells = params.count(Knob::TerrainCells);
        let craters = draw_craters(streams, params);
        let amplitude_m = params.number(Knob::TerrainAmplitudeM) as f32;
        let mut seeds = streams.stream("terrain.relief", 0);
        let layer = |(octaves, frequency), seed| Fbm { octaves, frequency, lacunarity: 2.0, seed };
        let (broad, fine) = (layer(BROAD, seeds.bits()), layer(FINE, seeds.bits()));
        Self::from_lines(size_m, cells, craters.clone(), |x, y, heights| {
            let (mut broad, mut fine) = (broad.lines(x), fine.lines(x));
            let [mut finer, mut sunk_m] = [(); 2].map(|()| Reused::of_any(x.len()));
            for (heights, &y) in heights.chunks_mut(x.len()).zip(y) {
                broad.set(y, heights);
                fine.set(y, &mut finer);
                sink(&craters, x, y, &mut sunk_m);
                for ((height, finer), sunk_m) in heights.iter_mut().zip(&finer).zip(&sunk_m) {
                    *height = amplitude_m * (*height + FINE_PER_BROAD * finer) + sunk_m;
                }
            }
        })
    }

    /// Rings around `centre` over a relief.
    #[must_use]
    pub fn rings(relief: &Relief, view: &View, centre: Vec2) -> Self {
        let rings = Rings::new(view);
        let (columns, rows) = (rings.columns(), rings.rows());
        let row_len = columns as usize + 1;
        let mut vertices: Reused<Vertex> = Reused::of_any(row_len * (rows as usize + 1));
        vertices.par_chunks_mut(TILE.0 * row_len).enumerate().for_each(|(chunk, vertices)| {
            let first_row = chunk * TILE.0;
            let tile_rows = vertices.len() / row_len;
            for first_column in (0..row_len).step_by(TILE.1) {
                let columns = first_column..(first_column + TILE.1).min(row_len);
                let offset =
                    |column: usize, row: usize| rings.offset(column as u32, (first_row + row) as u32);
                // A circle that holds the tile.
                let middle = offset((columns.start + columns.end) / 2, tile_rows / 2);
                let corners = [0, tile_rows - 1].into_iter().flat_map(|row| {
                    [columns.start, (columns.start + columns.end) / 2, columns.end - 1]
                        .map(|column| offset(column, row).distance(middle))
                });
                let radius_m = corners.fold(0.0, f32::max);
                let finest_m = view.cell_m(rings.radii_m[first_row]);
                let nearby = relief.nearby(middle, 1.01 * radius_m, finest_m);
                let rays = &rings.rays[columns.clone()];
                let (mut x, mut y, mut heights) = ([0.0; TILE.1], [0.0; TILE.1], [0.0; TILE.1]);
                for (row, vertices) in vertices.chunks_exact_mut(row_len).enumerate() {
                    let radius_m = rings.radii_m[first_row + row];
                    for ((x, y), ray) in x.iter_mut().zip(&mut y).zip(rays) {
                        (*x, *y) = (radius_m * ray.x, radius_m * ray.y);
                    }
                    let places = [&x[..rays.len()], &y[..rays.len()]];
                    relief.set_heights(places, view.cell_m(radius_m), &nearby, &mut heights[..rays.len()]);
                    let found = x.iter().zip(&y).zip(&heights);
                    for (vertex, ((x, y), height)) in vertices[columns.clone()].iter_mut().zip(found) {
                        vertex.position = (centre + Vec2::new(*x, *y)).extend(*height);
                    }
                }
            }
            // Both ends of a ring are the same place.
            for row in vertices.chunks_mut(row_len) {
                row[row_len - 1].position = row[0].position;
            }
        });
        let mut positions: Reused<Vec3> = Reused::of_any(vertices.len());
        for (position, vertex) in positions.iter_mut().zip(&vertices) {
            *position = vertex.position;
        }
        let last_row = rows as usize;
        vertices.par_chunks_mut(row_len).enumerate().for_each(|(row, vertices)| {
            // In the middle the rings are one place: its slope is that of the ring around.
            let (inner, outer) = (row.saturating_sub(1), (row.max(1) + 1).min(last_row));
            for (column, vertex) in vertices.iter_mut().enumerate() {
                let at = |column: usize, row: usize| positions[row * row_len + column];
                let west = if column == 0 { columns as usize - 1 } else { column - 1 };
                let east = if column == columns as usize { 1 } else { column + 1 };
                let ring = row.max(1);
                let normal = (at(east, ring) - at(west, ring)).cross(at(column, outer) - at(column, inner));
                vertex.normal = normal / normal.length();
            }
            if row == 0 {
                let sum: Vec3 = vertices.iter().map(|vertex| vertex.normal).sum();
                vertices.iter_mut().for_each(|vertex| vertex.normal = sum / sum.length());
            }
        });
        Self {
            layout: Layout::Rings(rings),
            centre,
            half_extent_m: view.radius_m as f32,
            z_range_m: z_range_m(&vertices),
            columns,
            rows,
            vertices,
            craters: Vec::new(),
        }
    }

    /// A ground of any height function (metres from metres); `craters` is kept as a record.
    #[must_use]
    pub fn from_height(
        size_m: f32,
        cells: u32,
        craters: Vec<Crater>,
        height_m: impl Fn(Vec2) -> f32 + Sync,
    ) -> Self {
        Self::from_lines(size_m, cells, craters, |x, y, heights| {
            let places = y.iter().flat_map(|&y| x.iter().map(move |&x| Vec2::new(x, y)));
            for (height, place) in heights.iter_mut().zip(places) {
                *height = height_m(place);
            }
        })
    }

    /// The same of a function that sets the heights of some lines of places along x, from their coordinates along both axes.
    fn from_lines(
        size_m: f32,
        cells: u32,
        craters: Vec<Crater>,
        set_heights: impl Fn(&[f32], &[f32], &mut [f32]) + Sync,
    ) -> Self {
        let row_len = cells as usize + 1;
        let mut vertices: Reused<Vertex> = Reused::of_any(row_len * row_len);
        let coordinates: Vec<f32> = (0..row_len).map(|i| (i as f32 / cells as f32 - 0.5) * size_m).collect();
        let mut heights: Reused<f32> = Reused::of_any(row_len * row_len);
        heights
            .par_chunks_mut(LINES * row_len)
            .zip(coordinates.par_chunks(LINES))
            .for_each(|(heights, y)| set_heights(&coordinates, y, heights));
        let cell_m = size_m / cells as f32;
        vertices.par_chunks_mut(row_len).enumerate().for_each_init(
            || [(); 3].map(|()| Reused::of_any(row_len)),
            |normals, (row, vertices)| {
                let heights = |row: usize| &heights[row * row_len..][..row_len];
                let [south, here, north] =
                    [row.saturating_sub(1), row, (row + 1).min(row_len - 1)].map(heights);
                let rows = if row == 0 || row + 1 == row_len { 1.0 } else { 2.0 };
                dispatch!(Level::new(), _simd => set_normals([south, here, north], cell_m, rows, normals));
                for (column, vertex) in vertices.iter_mut().enumerate() {
                    vertex.position = Vec3::new(coordinates[column], coordinates[row], here[column]);
                    vertex.normal = Vec3::from(normals.each_ref().map(|axis| axis[column]));
                }
            },
        );
        Self {
            layout: Layout::Square,
            centre: Vec2::ZERO,
            half_extent_m: 0.5 * size_m,
            z_range_m: z_range_m(&vertices),
            columns: cells,
            rows: cells,
            vertices,
            craters,
        }
    }

    /// Side of a cell of a square, metres.
    #[must_use]
    pub fn cell_m(&self) -> f32 {
        2.0 * self.half_extent_m / self.columns as f32
    }

    /// Whether there is ground at a place.
    #[must_use]
    pub fn contains(&self, p: Vec2) -> bool {
        match &self.layout {
            Layout::Square => p.abs().max_element() <= self.half_extent_m,
            Layout::Rings(_) => p.distance_squared(self.centre) <= self.half_extent_m * self.half_extent_m,
        }
    }

    /// Ground height at a place, bilinear in its cell, metres. Outside the ground: that of its border.
    #[must_use]
    pub fn height_at(&self, p: Vec2) -> f32 {
        let at = self.locate(p);
        let [h00, h10, h01, h11] = self.corners(at.column, at.row).map(|corner| corner.z);
        let along = |a: f32, b: f32| a + (b - a) * at.u;
        let (south, north) = (along(h00, h10), along(h01, h11));
        south + (north - south) * at.v
    }

    /// Height of the drawn triangles at a place, metres. Outside the ground: that of its border.
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

    /// Where the vertex at a column and a row of the grid lies.
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

    /// The cell under a place; outside the ground, the nearest on its border.
    #[must_use]
    pub fn locate(&self, p: Vec2) -> CellPlace {
        match &self.layout {
            Layout::Square => {
                let size_m = 2.0 * self.half_extent_m;
                let locate = |x: f32| {
                    let t = ((x / size_m + 0.5) * self.columns as f32).clamp(0.0, self.columns as f32);
                    let cell = (t as u32).min(self.columns - 1);
                    (cell, t - cell as f32)
                };
                let ((column, u), (row, v)) = (locate(p.x), locate(p.y));
                CellPlace { column, row, u, v }
            }
            Layout::Rings(rings) => rings.locate(p - self.centre),
        }
    }

    /// The columns and rows whose vertices belong to all ground over a box (its lowest and highest corner), and some more.
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

    /// The triangles over a box (its lowest and highest corner), and some more, by the places of their corners.
    pub fn triangles_over(&self, low: Vec2, high: Vec2) -> impl Iterator<Item = [Vec3; 3]> {
        let [columns, rows] =
            self.vertices_over(low, high).map(|vertices| vertices.start..vertices.end.saturating_sub(1));
        self.block_triangles(columns, rows)
            .map(|triangle| triangle.map(|vertex| self.vertices[vertex as usize].position))
    }

    /// A height that the ground over a box (its lowest and highest corner) does not fall below, metres. Without ground
    /// there, infinity.
    #[must_use]
    pub fn lowest_over(&self, low: Vec2, high: Vec2) -> f32 {
        let [columns, rows] = self.vertices_over(low, high);
        let mut lowest = f32::INFINITY;
        for row in rows {
            let first = (row * (self.columns + 1)) as usize;
            for vertex in &self.vertices[first + columns.start as usize..first + columns.end as usize] {
                // `f32::min` asks for more than a comparison.
                lowest = if vertex.position.z < lowest { vertex.position.z } else { lowest };
            }
        }
        lowest
    }
}

/// Sets how far craters sink (or raise) the places of a line along x.
fn sink(craters: &[Crater], x: &[f32], y: f32, sunk_m: &mut [f32]) {
    let mut near = craters.iter().filter(|crater| crater.reaches(1, y)).peekable();
    // What an empty sum comes to, to the bit.
    sunk_m.fill(if near.peek().is_none() { -0.0 } else { 0.0 });
    for crater in near {
        let first = x.partition_point(|&x| x < crater.centre.x && !crater.reaches(0, x));
        for (sunk_m, &x) in sunk_m[first..].iter_mut().zip(&x[first..]) {
            if !crater.reaches(0, x) {
                break;
            }
            *sunk_m += crater.height_at(Vec2::new(x, y));
        }
    }
}

/// Sets the normals of a line of vertices, axis by axis, from its heights and those of the lines beside it, which are `rows` cells
/// apart.
#[inline(always)]
fn set_normals([south, here, north]: [&[f32]; 3], cell_m: f32, rows: f32, normals: &mut [Reused<f32>; 3]) {
    let [x, y, z] = normals.each_mut().map(|axis| &mut axis[..]);
    let last = here.len() - 1;
    x[0] = -((here[1] - here[0]) / cell_m);
    x[last] = -((here[last] - here[last - 1]) / cell_m);
    for (x, (west, east)) in x[1..last].iter_mut().zip(here.iter().zip(&here[2..])) {
        *x = -((east - west) / (2.0 * cell_m));
    }
    for (y, (south, north)) in y.iter_mut().zip(south.iter().zip(north)) {
        *y = -((north - south) / (rows * cell_m));
    }
    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
        let length = (*x * *x + *y * *y + 1.0).sqrt();
        *x /= length;
        *y /= length;
        *z = 1.0 / length;
    }
}

fn z_range_m(vertices: &[Vertex]) -> [f32; 2] {
    // `f32::min` asks for more than a comparison, and one range would have each vertex wait for the one before.
    let wider = |[low, high]: [f32; 2], [from, to]: [f32; 2]| {
        [if from < low { from } else { low }, if to > high { to } else { high }]
    };
    let mut ranges = [[f32::MAX, f32::MIN]; 8];
    for vertices in vertices.chunks(ranges.len()) {
        for (range, vertex) in ranges.iter_mut().zip(vertices) {
            *range = wider(*range, [vertex.position.z; 2]);
        }
    }
    ranges.into_iter().fold([f32::MAX, f32::MIN], wider)
}

/// Height of the plane through three points at a place.
fn plane_height([a, b, c]: [Vec3; 3], p: Vec2) -> f32 {
    let (ab, ac, ap) = ((b - a).truncate(), (c - a).truncate(), p - a.truncate());
    let area = ab.perp_dot(ac);
    if area.abs() < 1e-12 {
        return a.z;
    }
    a.z + (ap.perp_dot(ac) * (b.z - a.z) + ab.perp_dot(ap) * (c.z - a.z)) / area
}

fn draw_craters(streams: &Streams, params: &Params) -> Vec<Crater> {
    let spread_m = 0.5 * params.number(Knob::TerrainSizeM) * CRATER_SPREAD;
    let count = params.count(Knob::CratersCount);
    (0..u64::from(count))
        .map(|k| {
            let draw = |knob: Knob| params.sample(knob, &mut streams.stream(knob.name(), k)) as f32;
            let mut place = streams.stream("craters.place", k);
            let depth_m = draw(Knob::CratersDepthM);
            Crater {
                centre: Vec2::new(
                    place.uniform(-spread_m, spread_m) as f32,
                    place.uniform(-spread_m, spread_m) as f32,
                ),
                radius_m: draw(Knob::CratersRadiusM),
                depth_m,
                rim_m: depth_m * draw(Knob::CratersRimRatio),
            }
        })
        .collect()
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "what is expected may be reckoned with std's functions")]
mod tests {
    use super::*;

    #[test]
    fn crater_profile_is_the_stated_one() {
        let crater = Crater { centre: Vec2::new(3.0, 4.0), radius_m: 10.0, depth_m: 2.0, rim_m: 0.5 };
        let at = |d: f32| crater.height_at(Vec2::new(3.0 + d, 4.0));
        let rim = |d: f32| 0.5 * (-((d - 10.0) / 3.0).powi(2)).exp();
        for (distance, bowl) in [(0.0, -2.0), (5.0, -1.5), (10.0, 0.0), (14.0, 0.0), (30.0, 0.0)] {
            assert!((at(distance) - bowl - rim(distance)).abs() < 1e-5, "{distance} m: {}", at(distance));
        }
    }

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
