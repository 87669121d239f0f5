//! The shadow map drawn by this program: for devices that are a CPU themselves.
//!
//! Twin of `shadow.wgsl` and `middle.wgsl`, by the rules of the devices: corners in 1/256 of a texel, a texel is covered where
//! its middle is, and of two triangles that meet there one covers it. The facets of casters are smaller than four
//! texels; a driver takes several times as long for one as this does, and takes them one after the other.
//! Must not know: buffers.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x4, i32x4};
use glam::Vec3;
use rayon::prelude::*;

use super::selection::Selection;
use super::shaders::CasterTile;
use super::shadow;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};

/// Height where a tile shows no caster, half extents of the tile. Stands in `middle.wgsl` too.
const NO_CASTER: f32 = -1.0e9;
/// Parts of a texel that corners are rounded to.
const PARTS: i32 = 1 << PARTS_BITS;
const PARTS_BITS: i32 = 8;
/// Texels that a triangle may span for 32 bits to hold its area, in parts.
const SPAN_PX: i32 = 64;
/// Texels that are drawn at once.
const LANES: usize = 4;

/// Draws the map of a selection's casters: a row after the other, of [`shadow::atlas_px`]. What lies between the tiles stays as
/// it was.
pub fn draw(scene: &Scene, selection: &Selection, map: &mut Vec<f32>) {
    let [width, height] = shadow::atlas_px(&selection.casters).map(|side| side as usize);
    map.resize(width * height, NO_CASTER);
    let casting: Vec<_> = selection.rocks.iter().filter_map(|rock| Some((rock.rock, rock.caster?))).collect();
    let tiles: Vec<_> = casting
        .par_iter()
        .map_init(Canvas::default, |canvas, &(rock, (caster, level))| {
            let rock = &scene.rocks[rock];
            let tile = &selection.casters[caster].tile;
            let vertices = &rock.vertices[..Icosphere::vertex_count(level.min(rock.level))];
            canvas.project(tile, scene, vertices);
            let triangles = rock.triangles(level);
            dispatch!(Level::new(), simd => canvas.draw(simd, triangles));
            (tile, canvas.middles())
        })
        .collect();
    for (tile, middles) in tiles {
        let [column, row] = tile.origin_px.to_array().map(|texel| texel as usize);
        let size = tile.size_px as usize;
        for (line, texels) in (row..).zip(middles.chunks_exact(size)) {
            map[line * width + column..][..size].copy_from_slice(texels);
        }
    }
}

/// A vertex in a tile: parts of a texel from the middle of the first, depth from 0 at the far end to 1.
#[derive(Clone, Copy, Debug)]
struct Corner {
    x: i32,
    y: i32,
    depth: f32,
}

/// A tile that is drawn, with memory that is kept for the next.
#[derive(Debug, Default)]
struct Canvas {
    size: usize,
    /// Texels from one row of a layer to the next: some more than there are columns.
    stride: usize,
    /// Greatest depth of what faces the sun, and of what faces away; 0 where there is none.
    layers: [Vec<f32>; 2],
    corners: Vec<Corner>,
}

impl Canvas {
    /// Clears the layers and finds the places of a caster's vertices.
    fn project(&mut self, tile: &CasterTile, scene: &Scene, vertices: &[Vertex]) {
        self.size = tile.size_px as usize;
        self.stride = self.size + LANES;
        for layer in &mut self.layers {
            layer.clear();
            layer.resize(self.stride * self.size, 0.0);
        }
        let [right, up] = scene.sun.right_and_up();
        let (right, down, towards) = (right, -up, scene.sun.direction);
        let half = 0.5 / tile.half_extent_m;
        let texels = tile.size_px;
        // Never below 0, so that dropping the fraction rounds down.
        let part = |place: f32| (place * PARTS as f32 + 0.5) as i32 - PARTS / 2;
        let corner = |vertex: &Vertex| {
            let p: Vec3 = half * vertex.position;
            Corner {
                x: part((0.5 + p.dot(right)) * texels),
                y: part((0.5 + p.dot(down)) * texels),
                depth: 0.5 + p.dot(towards),
            }
        };
        self.corners.clear();
        self.corners.extend(vertices.iter().map(corner));
    }

    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn draw<S: Simd>(&mut self, simd: S, triangles: &[[u32; 3]]) {
        let [fronts, backs] = &mut self.layers;
        for triangle in triangles {
            let [a, b, c] = triangle.map(|corner| self.corners[corner as usize]);
            // The middles of texels between the lowest and the highest corner.
            let columns = middles_between(a.x, b.x, c.x, self.size);
            let rows = middles_between(a.y, b.y, c.y, self.size);
            if columns.0 > columns.1 || rows.0 > rows.1 {
                continue;
            }
            let spans = columns.1 - columns.0 <= SPAN_PX && rows.1 - rows.0 <= SPAN_PX;
            let twice_area = i64::from(b.x - a.x) * i64::from(c.y - a.y)
                - i64::from(b.y - a.y) * i64::from(c.x - a.x);
            // Rows run down: what faces the sun runs the other way round.
            let (layer, triangle) = match twice_area {
                0 => continue,
                ..0 => (&mut *fronts, [a, c, b]),
                _ => (&mut *backs, [a, b, c]),
            };
            let twice_area = twice_area.abs() as f32;
            if spans {
                fill(simd, layer, self.stride, triangle, twice_area, columns, rows);
            } else {
                fill_wide(layer, self.stride, triangle, twice_area, columns, rows);
            }
        }
    }

    /// Half way between the layers, half extents of the tile from the caster's centre.
    fn middles(&self) -> Vec<f32> {
        let [fronts, backs] = &self.layers;
        let mut middles = Vec::with_capacity(self.size * self.size);
        for (fronts, backs) in fronts.chunks_exact(self.stride).zip(backs.chunks_exact(self.stride)) {
            let both = fronts[..self.size].iter().zip(&backs[..self.size]);
            middles.extend(both.map(|(front, back)| if *front == 0.0 { NO_CASTER } else { front + back - 1.0 }));
        }
        middles
    }
}

/// The first and the last of `size` texels whose middles lie between three places.
#[inline(always)]
fn middles_between(a: i32, b: i32, c: i32, size: usize) -> (i32, i32) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (((low + PARTS - 1) >> PARTS_BITS).max(0), (high >> PARTS_BITS).min(size as i32 - 1))
}

/// The line from a corner to another: how far beside it a place is, times its length; above 0 on the triangle's side.
#[derive(Clone, Copy)]
struct Edge {
    from: Corner,
    x: i32,
    y: i32,
    /// What is taken off so that 0 is on the triangle's side: 0 or 1. A place on the line belongs to the triangle below it, or
    /// to that on its right.
    owed: i32,
}

impl Edge {
    #[inline(always)]
    fn new(from: Corner, to: Corner) -> Self {
        let (x, y) = (to.x - from.x, to.y - from.y);
        Self { from, x, y, owed: i32::from(!(y < 0 || (y == 0 && x > 0))) }
    }
}

/// Draws a small triangle into a layer.
#[inline(always)]
fn fill<S: Simd>(
    simd: S,
    layer: &mut [f32],
    stride: usize,
    [a, b, c]: [Corner; 3],
    twice_area: f32,
    columns: (i32, i32),
    rows: (i32, i32),
) {
    // Opposite of a, b, c: their shares in a place are as its distances from these.
    let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
    let mut at_row = edges.map(|edge| {
        let (x, y) = (columns.0 * PARTS - edge.from.x, rows.0 * PARTS - edge.from.y);
        let first = edge.x * y - edge.y * x - edge.owed;
        let step = edge.y * PARTS;
        i32x4::from_slice(simd, &[first, first - step, first - 2 * step, first - 3 * step])
    });
    let to_right = edges.map(|edge| i32x4::splat(simd, LANES as i32 * edge.y * PARTS));
    let down = edges.map(|edge| i32x4::splat(simd, edge.x * PARTS));
    let (per_b, per_c) = ((b.depth - a.depth) / twice_area, (c.depth - a.depth) / twice_area);
    let depth = a.depth + edges[1].owed as f32 * per_b + edges[2].owed as f32 * per_c;
    let [depth, per_b, per_c] = [depth, per_b, per_c].map(|number| f32x4::splat(simd, number));
    let (zero, nowhere) = (i32x4::splat(simd, 0), f32x4::splat(simd, 0.0));
    for row in rows.0..=rows.1 {
        let mut at = at_row;
        let line = &mut layer[row as usize * stride..][..stride];
        let mut column = columns.0 as usize;
        while column as i32 <= columns.1 {
            let inside = (at[0] | at[1] | at[2]).simd_ge(zero);
            let here = depth + at[1].to_float::<f32x4<S>>() * per_b + at[2].to_float::<f32x4<S>>() * per_c;
            let texels = &mut line[column..column + LANES];
            let deepest = inside.select(here, nowhere).max(f32x4::from_slice(simd, texels));
            deepest.store_slice(texels);
            column += LANES;
            for (at, step) in at.iter_mut().zip(to_right) {
                *at -= step;
            }
        }
        for (at, step) in at_row.iter_mut().zip(down) {
            *at += step;
        }
    }
}

/// The same for a triangle of any size.
fn fill_wide(
    layer: &mut [f32],
    stride: usize,
    [a, b, c]: [Corner; 3],
    twice_area: f32,
    columns: (i32, i32),
    rows: (i32, i32),
) {
    let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
    let (per_b, per_c) = ((b.depth - a.depth) / twice_area, (c.depth - a.depth) / twice_area);
    for row in rows.0..=rows.1 {
        for column in columns.0..=columns.1 {
            let [from_a, from_b, from_c] = edges.map(|edge| {
                let (x, y) = (column * PARTS - edge.from.x, row * PARTS - edge.from.y);
                i64::from(edge.x) * i64::from(y) - i64::from(edge.y) * i64::from(x)
            });
            let inside = |distance: i64, edge: &Edge| distance >= i64::from(edge.owed);
            if inside(from_a, &edges[0]) && inside(from_b, &edges[1]) && inside(from_c, &edges[2]) {
                let texel = &mut layer[row as usize * stride + column as usize];
                *texel = texel.max(a.depth + from_b as f32 * per_b + from_c as f32 * per_c);
            }
        }
    }
}
