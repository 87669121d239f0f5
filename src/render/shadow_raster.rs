//! The shadow map drawn by this program: for devices that are a CPU themselves.
//!
//! Twin of `shadow.wgsl` and `middle.wgsl`.
//! Must not know: buffers.

use std::cell::RefCell;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::raster::{HEIGHT, Outline, Paint, Place, Plane, Turn, WIDTH, load, store};
use super::selection::Selection;
use super::shaders::CasterTile;
use super::shadow;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};

/// Height where a tile shows no caster, half extents of the tile. Stands in `middle.wgsl` too.
const NO_CASTER: f32 = -1.0e9;

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

/// A vertex in a tile, with its depth: 0 at the far end to 1.
#[derive(Clone, Copy, Debug)]
struct Corner {
    place: Place,
    /// The same before it is rounded, texels.
    at: Vec2,
    depth: f32,
}

/// A tile that is drawn, with memory that is kept for the next.
#[derive(Debug, Default)]
struct Canvas {
    size: usize,
    /// Texels from one row of a layer to the next.
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
        let corner = |vertex: &Vertex| {
            let p: Vec3 = half * vertex.position;
            let at = (0.5 + Vec2::new(p.dot(right), p.dot(down))) * texels - 0.5;
            Corner { place: Place::rounded(at), at, depth: 0.5 + p.dot(towards) }
        };
        self.corners.clear();
        self.corners.extend(vertices.iter().map(corner));
    }

    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn draw<S: Simd>(&mut self, simd: S, triangles: &[[u32; 3]]) {
        for triangle in triangles {
            let corners = triangle.map(|corner| self.corners[corner as usize]);
            draw_triangle(simd, corners, &mut self.layers, self.size);
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

/// Draws a triangle into the layer of what faces as it does, of a tile of so many texels each way.
#[inline(always)]
fn draw_triangle<S: Simd>(simd: S, [a, b, c]: [Corner; 3], layers: &mut [Vec<f32>; 2], size: usize) {
    let Some(turn) = Turn::of([a.place, b.place, c.place]) else { return };
    let corners = if turn == Turn::Front { [a, b, c] } else { [a, c, b] };
    let places = corners.map(|corner| corner.place);
    let Some(outline) = Outline::new(places, size, &(0..size as i32)) else { return };
    let [depth] = outline.planes(corners.map(|corner| corner.at), corners.map(|corner| [corner.depth]));
    outline.fill(simd, 0, size + WIDTH, &mut Depth { layer: &mut layers[turn as usize], depth });
}

/// Raises a layer to the depth of a triangle.
struct Depth<'a> {
    layer: &'a mut [f32],
    depth: Plane,
}

impl<S: Simd> Paint<S> for Depth<'_> {
    #[inline(always)]
    fn paint(&mut self, simd: S, texels: [usize; 2], inside: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let here = inside.select(self.depth.at(x, y), f32x8::splat(simd, 0.0));
        let there = load(simd, self.layer, texels);
        store(self.layer, texels, here.max(there));
    }
}
