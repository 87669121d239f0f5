//! The shadow map drawn by this program: for devices that are a CPU themselves.
//!
//! What a tile holds depends on nothing but its mesh, its size and the sun: where the picture before had such a one it is copied.
//! A picture is the same whatever was drawn before it.
//!
//! Twin of `shadow.wgsl` and `middle.wgsl`.
//! Must not know: buffers.

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, Weak};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::raster::{
    AT_ONCE, Corners, HEIGHT, LANES, Outline, Outlines, Paint, Place, Plane, Sides, Sifted, Turn, WIDTH,
    load, store,
};
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

/// The map of the picture that was drawn last, and that of the one before, whose memory the next is drawn in.
#[derive(Debug, Default)]
pub struct ShadowMap {
    last: Sheet,
    spare: Sheet,
}

/// A map, and of what each of its tiles is.
#[derive(Debug, Default)]
struct Sheet {
    width: usize,
    texels: Vec<f32>,
    sun_direction: Vec3,
    /// By the address of the mesh.
    tiles: HashMap<usize, Tile>,
}

/// What a tile holds and where it is.
#[derive(Clone, Debug)]
struct Tile {
    /// Keeps the mesh's address from being given to another, but not the mesh.
    mesh: Weak<Vec<Vertex>>,
    level: usize,
    place: CasterTile,
}

impl ShadowMap {
    /// A row after the other, of [`shadow::atlas_px`].
    #[must_use]
    pub fn texels(&self) -> &[f32] {
        &self.last.texels
    }

    /// Draws the map of a selection's casters. What lies between the tiles is any number.
    pub fn draw(&mut self, scene: &Scene, selection: &Selection) {
        let Self { last, spare } = self;
        std::mem::swap(last, spare);
        let (map, before) = (last, &*spare);
        let [width, height] = shadow::atlas_px(&selection.casters).map(|side| side as usize);
        (map.width, map.sun_direction) = (width, scene.sun.direction);
        map.texels.resize(width * height, NO_CASTER);
        map.tiles.clear();
        let tiles: Vec<&CasterTile> = selection.casters.iter().map(|caster| &caster.tile).collect();
        let mut rows = rows_of(&tiles, &mut map.texels, width);
        let casting: Vec<_> = selection
            .rocks
            .iter()
            .filter_map(|selected| {
                let (caster, level) = selected.caster?;
                let rock = &scene.rocks[selected.rock];
                let tile = Tile {
                    mesh: Arc::downgrade(&rock.vertices),
                    level: level.min(rock.level),
                    place: *tiles[caster],
                };
                map.tiles.insert(tile.mesh.as_ptr().addr(), tile.clone());
                Some((rock, tile, std::mem::take(&mut rows[caster])))
            })
            .collect();
        // Tiles and their meshes are of very different sizes.
        casting.into_par_iter().with_max_len(1).for_each(|(rock, tile, rows)| {
            if let Some(alike) = before.alike(&tile, scene) {
                for (row, drawn) in rows.into_iter().zip(before.rows(alike)) {
                    row.copy_from_slice(drawn);
                }
                return;
            }
            let vertices = &rock.vertices[..Icosphere::vertex_count(tile.level)];
            CANVAS.with_borrow_mut(|canvas| {
                canvas.project(&tile.place, scene, vertices);
                dispatch!(Level::new(), simd => canvas.draw(simd, rock.triangles(tile.level)));
                canvas.write_middles(rows);
            });
        });
    }
}

impl Sheet {
    /// The tile that holds the same as another is to, if there is one.
    fn alike(&self, tile: &Tile, scene: &Scene) -> Option<&CasterTile> {
        let known = self.tiles.get(&tile.mesh.as_ptr().addr())?;
        let (old, new) = (&known.place, &tile.place);
        let is_alike = self.sun_direction == scene.sun.direction
            && known.level == tile.level
            && (old.size_px, old.half_extent_m) == (new.size_px, new.half_extent_m);
        is_alike.then_some(old)
    }

    /// The rows of a tile.
    fn rows(&self, tile: &CasterTile) -> impl Iterator<Item = &[f32]> {
        let [column, row] = tile.origin_px.to_array().map(|texel| texel as usize);
        let size = tile.size_px as usize;
        (row..row + size).map(move |row| &self.texels[row * self.width + column..][..size])
    }
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
        let Self { size, layers, corners, .. } = self;
        let rows = 0..*size as i32;
        let place_of = |corner: u32| corners[corner as usize].place;
        for triangles in triangles.chunks(AT_ONCE) {
            let sifted = Sifted::new(simd, triangles, place_of, Sides::Both, *size, &rows);
            for eight in sifted.numbers().chunks(LANES) {
                let mut of_eight = Corners::none();
                for (lane, &number) in eight.iter().enumerate() {
                    for (i, &corner) in triangles[usize::from(number)].iter().enumerate() {
                        let Corner { place, at, depth } = corners[corner as usize];
                        of_eight.set(lane, i, place, at, [depth]);
                    }
                }
                let outlines = Outlines::new(simd, &of_eight, *size, &rows);
                for (lane, &number) in eight.iter().enumerate() {
                    if outlines.is_small(lane) {
                        let [depth] = outlines.planes(lane);
                        let layer = &mut layers[outlines.turn(lane) as usize];
                        outlines.fill(simd, lane, 0, *size + WIDTH, &mut Depth { layer, depth });
                    } else {
                        let corners = triangles[usize::from(number)].map(|corner| corners[corner as usize]);
                        draw_triangle(simd, corners, layers, *size);
                    }
                }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;
    use crate::render::RenderSettings;
    use crate::scene::sky::Sun;

    /// The texels of each caster's tile.
    fn tiles(map: &ShadowMap, selection: &Selection) -> Vec<Vec<f32>> {
        let rows = |tile: &CasterTile| map.last.rows(tile).flatten().copied().collect();
        selection.casters.iter().map(|caster| rows(&caster.tile)).collect()
    }

    #[test]
    fn tiles_are_the_same_whatever_was_drawn_before() {
        let mut scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([256, 256], 1).expect("settings");
        let mut map = ShadowMap::default();
        let mut copied = Vec::new();
        let still = scene.clone();
        for change in 0..5 {
            match change {
                // Nothing moves; then the camera; then the sun; then a rock takes another's place.
                0 | 1 => {}
                2 => scene.camera.eye.x += 0.5,
                3 => scene.sun = Sun { direction: Vec3::new(0.3, 0.9, 0.31).normalize(), ..scene.sun },
                _ => {
                    scene.rocks[0].vertices =
                        Arc::new(scene.rocks[0].vertices.iter().rev().copied().collect())
                }
            }
            let selection = Selection::new(&scene, &settings);
            map.draw(&scene, &selection);
            let mut fresh = ShadowMap::default();
            fresh.draw(&scene, &selection);
            assert_eq!(tiles(&map, &selection), tiles(&fresh, &selection), "change {change}");
            let before = |tile: &&Tile| map.spare.alike(tile, &scene).is_some();
            copied.push((map.last.tiles.values().filter(before).count(), map.last.tiles.len()));
        }
        let [first, again, camera, sun, rock] = copied[..] else { panic!("five pictures") };
        assert_eq!(first.0, 0);
        assert_eq!(again.0, again.1);
        assert!(camera.0 > camera.1 / 2 && camera.0 < camera.1, "{camera:?}");
        assert_eq!(sun.0, 0);
        assert_eq!(rock.0, rock.1 - 1);
        assert!(Arc::ptr_eq(&still.rocks[1].vertices, &scene.rocks[1].vertices), "copies share meshes");
    }
}
