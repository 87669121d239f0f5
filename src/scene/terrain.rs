//! The ground of the nominal stage: a regular grid of heights from two noise layers and craters.
//!
//! [`Terrain`] is the one source of the ground's height: the mesh, the rocks, the camera and the sun's horizon
//! all ask it.
//! Must not know: who asks.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::mesh::Vertex;
use super::noise::Fbm;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Octaves and first frequency (per metre) of the broad relief.
const BROAD: (u32, f32) = (5, 0.010);
/// Octaves and first frequency (per metre) of the finer relief.
const FINE: (u32, f32) = (4, 0.045);
/// Amplitude of the finer relief when that of the broad one is 3.2 m.
const FINE_PER_BROAD: f32 = 0.7 / 3.2;
/// Half the width of the square, as a fraction of the terrain's, in which crater centres lie: 383 of 460 m.
const CRATER_SPREAD: f64 = 383.0 / 460.0;

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

/// A square of ground, centred on the origin, split into equal cells of two triangles each.
#[derive(Clone, Debug)]
pub struct Terrain {
    /// Side of the square, metres.
    pub size_m: f32,
    /// Cells along a side.
    pub cells: u32,
    /// `(cells + 1)^2` vertices, rows of rising y, in a row rising x.
    pub vertices: Vec<Vertex>,
    /// The craters that were cut into it.
    pub craters: Vec<Crater>,
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
        Self::from_height(size_m, cells, craters.clone(), |p| {
            amplitude_m * (broad.at_2d(p.into()) + FINE_PER_BROAD * fine.at_2d(p.into()))
                + craters.iter().map(|crater| crater.height_at(p)).sum::<f32>()
        })
    }

    /// A ground of any height function (metres from metres); `craters` is kept as a record.
    #[must_use]
    pub fn from_height(
        size_m: f32,
        cells: u32,
        craters: Vec<Crater>,
        height_m: impl Fn(Vec2) -> f32 + Sync,
    ) -> Self {
        let row_len = cells as usize + 1;
        let mut vertices = vec![Vertex { position: Vec3::ZERO, normal: Vec3::Z }; row_len * row_len];
        let coordinate = |i: usize| (i as f32 / cells as f32 - 0.5) * size_m;
        vertices.par_chunks_mut(row_len).enumerate().for_each(|(row, vertices)| {
            for (column, vertex) in vertices.iter_mut().enumerate() {
                let p = Vec2::new(coordinate(column), coordinate(row));
                vertex.position = p.extend(height_m(p));
            }
        });
        let heights: Vec<f32> = vertices.iter().map(|v| v.position.z).collect();
        let cell_m = size_m / cells as f32;
        vertices.par_chunks_mut(row_len).enumerate().for_each(|(row, vertices)| {
            let height = |column: usize, row: usize| heights[row * row_len + column];
            let last = row_len - 1;
            let slope = |low: f32, high: f32, steps: usize| (high - low) / (steps as f32 * cell_m);
            let (south, north) = (row.saturating_sub(1), (row + 1).min(last));
            for (column, vertex) in vertices.iter_mut().enumerate() {
                let (west, east) = (column.saturating_sub(1), (column + 1).min(last));
                let gradient = Vec2::new(
                    slope(height(west, row), height(east, row), east - west),
                    slope(height(column, south), height(column, north), north - south),
                );
                let normal = Vec3::new(-gradient.x, -gradient.y, 1.0);
                vertex.normal = normal / normal.length();
            }
        });
        Self { size_m, cells, vertices, craters }
    }

    /// Side of a cell, metres.
    #[must_use]
    pub fn cell_m(&self) -> f32 {
        self.size_m / self.cells as f32
    }

    /// Ground height at a place, bilinear in its cell, metres. Outside the terrain: that of its border.
    #[must_use]
    pub fn height_at(&self, p: Vec2) -> f32 {
        let (h, u, v) = self.cell_at(p);
        let along = |a: f32, b: f32| a + (b - a) * u;
        let (south, north) = (along(h[0], h[1]), along(h[2], h[3]));
        south + (north - south) * v
    }

    /// Height of the drawn triangles at a place, metres. Outside the terrain: that of its border.
    #[must_use]
    pub fn surface_height_at(&self, p: Vec2) -> f32 {
        let ([h00, h10, h01, h11], u, v) = self.cell_at(p);
        if u >= v { h00 + (h10 - h00) * u + (h11 - h10) * v } else { h00 + (h01 - h00) * v + (h11 - h01) * u }
    }

    /// The two triangles of each cell of a block of cells, counter-clockwise seen from above; the cell's
    /// south-west and north-east corners share the diagonal.
    pub fn block_triangles(
        &self,
        columns: std::ops::Range<u32>,
        rows: std::ops::Range<u32>,
    ) -> impl Iterator<Item = [u32; 3]> {
        let row_len = self.cells + 1;
        rows.flat_map(move |row| {
            columns.clone().flat_map(move |column| {
                let (sw, se) = (row * row_len + column, row * row_len + column + 1);
                let (nw, ne) = (sw + row_len, se + row_len);
                [[sw, se, ne], [sw, ne, nw]]
            })
        })
    }

    /// Heights of the corners (south-west, south-east, north-west, north-east) of the cell under a place, and
    /// the place within it.
    fn cell_at(&self, p: Vec2) -> ([f32; 4], f32, f32) {
        let locate = |x: f32| {
            let t = ((x / self.size_m + 0.5) * self.cells as f32).clamp(0.0, self.cells as f32);
            let cell = (t as u32).min(self.cells - 1);
            (cell as usize, t - cell as f32)
        };
        let ((column, u), (row, v)) = (locate(p.x), locate(p.y));
        let row_len = self.cells as usize + 1;
        let height = |dx: usize, dy: usize| self.vertices[(row + dy) * row_len + column + dx].position.z;
        ([height(0, 0), height(1, 0), height(0, 1), height(1, 1)], u, v)
    }
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
