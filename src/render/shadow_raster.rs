//! The shadow map drawn by this program: for devices that are a CPU themselves.
//!
//! Twin of `shadow.wgsl` and `middle.wgsl`, by the rules of the devices: corners in 1/256 of a texel, a texel is covered where
//! its middle is, and of two triangles that meet there one covers it. The facets of casters are smaller than four
//! texels; a driver takes several times as long for one as this does, and takes them one after the other.
//! Must not know: buffers.

use std::cell::RefCell;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x4, f32x8, i32x8};
use glam::Vec3;
use rayon::prelude::*;

use super::selection::Selection;
use super::shaders::CasterTile;
use super::shadow;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::noise::floor;

/// Height where a tile shows no caster, half extents of the tile. Stands in `middle.wgsl` too.
const NO_CASTER: f32 = -1.0e9;
/// Parts of a texel that corners are rounded to.
const PARTS: i32 = 1 << PARTS_BITS;
const PARTS_BITS: i32 = 8;
/// Texels that a triangle may span for 32 bits to hold its area, in parts.
const SPAN_PX: i32 = 64;
/// Columns and rows of texels that are drawn at once.
const WIDTH: usize = 4;
const HEIGHT: usize = 2;

thread_local! {
    /// Kept for its memory.
    static CANVAS: RefCell<Canvas> = RefCell::default();
}

/// Draws the map of a selection's casters: a row after the other, of [`shadow::atlas_px`]. What lies between the tiles stays as
/// it was.
pub fn draw(scene: &Scene, selection: &Selection, map: &mut Vec<f32>) {
    let [width, height] = shadow::atlas_px(&selection.casters).map(|side| side as usize);
    map.resize(width * height, NO_CASTER);
    let tiles: Vec<&CasterTile> = selection.casters.iter().map(|caster| &caster.tile).collect();
    let mut rows = rows_of(&tiles, map, width);
    let casting: Vec<_> = selection
        .rocks
        .iter()
        .filter_map(|selected| {
            let (caster, level) = selected.caster?;
            Some((&scene.rocks[selected.rock], tiles[caster], level, std::mem::take(&mut rows[caster])))
        })
        .collect();
    casting.into_par_iter().for_each(|(rock, tile, level, rows)| {
        let vertices = &rock.vertices[..Icosphere::vertex_count(level.min(rock.level))];
        let triangles = rock.triangles(level);
        CANVAS.with_borrow_mut(|canvas| {
            canvas.project(tile, scene, vertices);
            dispatch!(Level::new(), simd => canvas.draw(simd, triangles));
            canvas.write_middles(rows);
        });
    });
}

/// The rows of each tile in the map.
fn rows_of<'a>(tiles: &[&CasterTile], map: &'a mut [f32], width: usize) -> Vec<Vec<&'a mut [f32]>> {
    let place = |tile: usize| tiles[tile].origin_px.to_array().map(|texel| texel as usize);
    let size = |tile: usize| tiles[tile].size_px as usize;
    let mut order: Vec<usize> = (0..tiles.len()).collect();
    order.sort_by_key(|&tile| (place(tile)[1], place(tile)[0]));
    let mut rows: Vec<Vec<&mut [f32]>> =
        (0..tiles.len()).map(|tile| Vec::with_capacity(size(tile))).collect();
    let mut lines = map.chunks_exact_mut(width).enumerate();
    // Tiles stand on shelves.
    for shelf in order.chunk_by(|&a, &b| place(a)[1] == place(b)[1]) {
        let first = place(shelf[0])[1];
        let end = first + shelf.iter().map(|&tile| size(tile)).max().unwrap_or(0);
        for (line, texels) in lines.by_ref().skip_while(|(line, _)| *line < first).take(end - first) {
            let (mut rest, mut column) = (texels, 0);
            for &tile in shelf.iter().filter(|&&tile| line < first + size(tile)) {
                let (_, from_tile) = rest.split_at_mut(place(tile)[0] - column);
                let (own, behind) = from_tile.split_at_mut(size(tile));
                rows[tile].push(own);
                (rest, column) = (behind, place(tile)[0] + size(tile));
            }
        }
    }
    rows
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
        self.stride = self.size + WIDTH;
        for layer in &mut self.layers {
            layer.clear();
            layer.resize(self.stride * (self.size + HEIGHT), 0.0);
        }
        let [right, up] = scene.sun.right_and_up();
        let (right, down, towards) = (right, -up, scene.sun.direction);
        let half = 0.5 / tile.half_extent_m;
        let texels = tile.size_px;
        let part = |place: f32| floor(place * PARTS as f32 + 0.5) - PARTS / 2;
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
        for triangle in triangles {
            let corners = triangle.map(|corner| self.corners[corner as usize]);
            let Some(facet) = Facet::new(corners, self.size) else { continue };
            let layer = &mut self.layers[usize::from(!facet.is_front)];
            if facet.is_small() {
                facet.fill(simd, layer, self.stride);
            } else {
                facet.fill_wide(layer, self.stride);
            }
        }
    }

    /// Writes what is half way between the layers: half extents of the tile from the caster's centre.
    fn write_middles(&self, rows: Vec<&mut [f32]>) {
        let [fronts, backs] = self.layers.each_ref().map(|layer| layer.chunks_exact(self.stride));
        for (row, (fronts, backs)) in rows.into_iter().zip(fronts.zip(backs)) {
            for (middle, (front, back)) in row.iter_mut().zip(fronts.iter().zip(backs)) {
                *middle = if *front == 0.0 { NO_CASTER } else { front + back - 1.0 };
            }
        }
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

/// A triangle that may cover texels.
struct Facet {
    /// Whether it faces the sun.
    is_front: bool,
    /// Opposite of its corners: their shares in a place are as its distances from these.
    edges: [Edge; 3],
    /// Depth of the first corner, and by how much the others differ, for each unit of distance.
    depth: f32,
    per_b: f32,
    per_c: f32,
    /// First and last of the texels around it.
    columns: (i32, i32),
    rows: (i32, i32),
}

impl Facet {
    /// Of a triangle in a tile of `size` texels each way; none where no middle of a texel lies between its corners.
    #[inline(always)]
    fn new([a, b, c]: [Corner; 3], size: usize) -> Option<Self> {
        let columns = middles_between(a.x, b.x, c.x, size);
        let rows = middles_between(a.y, b.y, c.y, size);
        let twice_area =
            i64::from(b.x - a.x) * i64::from(c.y - a.y) - i64::from(b.y - a.y) * i64::from(c.x - a.x);
        if ((columns.1 - columns.0) | (rows.1 - rows.0)) < 0 || twice_area == 0 {
            return None;
        }
        // Rows run down: what faces the sun runs the other way round.
        let is_front = twice_area < 0;
        let (b, c) = if is_front { (c, b) } else { (b, c) };
        let per_area = 1.0 / twice_area.abs() as f32;
        Some(Self {
            is_front,
            edges: [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)],
            depth: a.depth,
            per_b: (b.depth - a.depth) * per_area,
            per_c: (c.depth - a.depth) * per_area,
            columns,
            rows,
        })
    }

    /// Whether 32 bits hold its distances.
    #[inline(always)]
    fn is_small(&self) -> bool {
        ((self.columns.1 - self.columns.0) | (self.rows.1 - self.rows.0)) < SPAN_PX
    }

    /// Draws it into a layer, if it is small.
    #[inline(always)]
    fn fill<S: Simd>(&self, simd: S, layer: &mut [f32], stride: usize) {
        let Self { edges, per_b, per_c, columns, rows, .. } = *self;
        // Four texels of a row and the four below them.
        let (lane_columns, lane_rows) = (
            i32x8::from_slice(simd, &[0, 1, 2, 3, 0, 1, 2, 3]),
            i32x8::from_slice(simd, &[0, 0, 0, 0, 1, 1, 1, 1]),
        );
        // No closures: what vectors are made of is inlined wholly.
        let mut at_row = [i32x8::splat(simd, 0); 3];
        let (mut to_right, mut down) = ([0; 3], [0; 3]);
        for (i, edge) in edges.iter().enumerate() {
            let (x, y) = (columns.0 * PARTS - edge.from.x, rows.0 * PARTS - edge.from.y);
            let first = edge.x * y - edge.y * x - edge.owed;
            at_row[i] = lane_rows * (edge.x * PARTS) - lane_columns * (edge.y * PARTS) + first;
            to_right[i] = WIDTH as i32 * edge.y * PARTS;
            down[i] = HEIGHT as i32 * edge.x * PARTS;
        }
        let depth = self.depth + edges[1].owed as f32 * per_b + edges[2].owed as f32 * per_c;
        let nowhere = f32x8::splat(simd, 0.0);
        let (mut row, end) = (rows.0 as usize, rows.1 as usize + 1);
        while row < end {
            let mut at = at_row;
            let (upper, lower) = layer[row * stride..][..HEIGHT * stride].split_at_mut(stride);
            let (mut column, end) = (columns.0 as usize, columns.1 as usize + 1);
            while column < end {
                let texels = column..column + WIDTH;
                let (upper, lower) = (&mut upper[texels.clone()], &mut lower[texels]);
                let inside = (at[0] | at[1] | at[2]).simd_ge(0);
                let here =
                    at[1].to_float::<f32x8<S>>() * per_b + at[2].to_float::<f32x8<S>>() * per_c + depth;
                let there = f32x4::from_slice(simd, upper).combine(f32x4::from_slice(simd, lower));
                let (above, below) = inside.select(here, nowhere).max(there).split();
                above.store_slice(upper);
                below.store_slice(lower);
                for i in 0..3 {
                    at[i] -= to_right[i];
                }
                column += WIDTH;
            }
            for i in 0..3 {
                at_row[i] += down[i];
            }
            row += HEIGHT;
        }
    }

    /// The same of any size.
    fn fill_wide(&self, layer: &mut [f32], stride: usize) {
        for row in self.rows.0..=self.rows.1 {
            for column in self.columns.0..=self.columns.1 {
                let distances = self.edges.map(|edge| {
                    let (x, y) = (column * PARTS - edge.from.x, row * PARTS - edge.from.y);
                    i64::from(edge.x) * i64::from(y) - i64::from(edge.y) * i64::from(x)
                });
                if distances.iter().zip(&self.edges).all(|(distance, edge)| *distance >= i64::from(edge.owed))
                {
                    let texel = &mut layer[row as usize * stride + column as usize];
                    let [_, of_b, of_c] = distances.map(|distance| distance as f32);
                    *texel = texel.max(self.depth + of_b * self.per_b + of_c * self.per_c);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::noise::lattice_hash;

    const SIZE: usize = 48;

    /// A layer with one triangle, drawn in either way.
    fn layer(corners: [Corner; 3], wide: bool) -> Vec<f32> {
        let stride = SIZE + WIDTH;
        let mut layer = vec![0.0; stride * (SIZE + HEIGHT)];
        let Some(facet) = Facet::new(corners, SIZE) else { return layer };
        if wide {
            facet.fill_wide(&mut layer, stride);
        } else {
            dispatch!(Level::new(), simd => facet.fill(simd, &mut layer, stride));
        }
        layer
    }

    fn random_corner(number: i32) -> Corner {
        let random = |axis, end: u32| (lattice_hash(number, axis, 0, 7) % end) as i32;
        let parts = SIZE as u32 * PARTS as u32;
        // Every other on a middle, where edges meet places.
        let snap = |part: i32| if number % 2 == 0 { part } else { part & !(PARTS - 1) };
        Corner {
            x: snap(random(0, parts)),
            y: snap(random(1, parts)),
            depth: random(2, 1000) as f32 / 1000.0 + 0.01,
        }
    }

    #[test]
    fn many_texels_at_once_are_those_one_by_one() {
        let mut covered = 0;
        for number in 0..400 {
            let corners = [0, 1, 2].map(|corner| random_corner(3 * number + corner));
            let (narrow, wide) = (layer(corners, false), layer(corners, true));
            for (a, b) in narrow.iter().zip(&wide) {
                assert_eq!(*a == 0.0, *b == 0.0, "triangle {number}");
                assert!((a - b).abs() < 1e-5, "triangle {number}: {a} for {b}");
                covered += u32::from(*a > 0.0);
            }
        }
        assert!(covered > 10_000, "{covered}");
    }

    #[test]
    fn triangles_around_a_corner_cover_every_texel_once() {
        for number in 0..100 {
            let place = |x: i32, y: i32| Corner { x: x * PARTS, y: y * PARTS, depth: 0.5 };
            let last = SIZE as i32 - 1;
            let Corner { x, y, .. } = random_corner(number);
            let middle = Corner { x: x.min(last * PARTS), y: y.min(last * PARTS), depth: 0.5 };
            let around = [place(0, 0), place(last, 0), place(last, last), place(0, last)];
            let mut times = vec![0; (SIZE + WIDTH) * (SIZE + HEIGHT)];
            for side in 0..4 {
                let drawn = layer([middle, around[side], around[(side + 1) % 4]], false);
                for (times, depth) in times.iter_mut().zip(drawn) {
                    assert!(depth == 0.0 || (depth - 0.5).abs() < 1e-6, "{depth}");
                    *times += u32::from(depth > 0.0);
                }
            }
            // Of the square's own border the upper and the left side are its.
            for row in 0..SIZE - 1 {
                let line = &times[row * (SIZE + WIDTH)..][..SIZE - 1];
                assert!(line.iter().all(|&times| times == 1), "corner {number}, row {row}: {line:?}");
            }
        }
    }
}
