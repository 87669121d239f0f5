//! The shadow map drawn by this program: for devices that are a CPU themselves.
//!
//! What a tile holds depends on nothing but its mesh, its size and the sun, and where it lies tells in no picture: what the device
//! has of the pictures before stays. A picture is the same whatever was drawn before it.
//!
//! Twin of `shadow.wgsl` and `shadow_midpoint.wgsl`.
//! Must not know: buffers.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Weak};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{UVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::gpu::staging::{PAGE_BYTES, Page, PageWriter, ROW_ALIGNMENT, TextureRegion};
use crate::render::device::shader_structs::CasterTile;
use crate::render::raster::{
    AT_ONCE, Corners, HEIGHT, LANES, Outline, Outlines, Paint, Place, Plane, Sides, Sifted, Turn, VERTICES,
    WIDTH, by_axis, load, store,
};
use crate::render::select::atlas::{Allocation, AtlasAllocator};
use crate::render::select::casters;
use crate::render::select::selection::Selection;
use crate::reuse::Reused;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};

/// Height where a tile shows no caster, half extents of the tile. Stands in `shadow_midpoint.wgsl` too.
const NO_CASTER: f32 = -1.0e9;
/// Rows of a band of a tile, which one thread draws: few enough to stay near to it, and whole pages of them.
const BAND_ROWS: usize = 256;
const _: () = assert!((BAND_ROWS * ROW_ALIGNMENT).is_multiple_of(PAGE_BYTES));
/// Columns and rows of the map at first.
const LEAST_PX: [u32; 2] = [512, 512];

thread_local! {
    /// Kept for its memory.
    static CANVAS: RefCell<Canvas> = RefCell::default();
}

/// Which tiles the device has, and where.
#[derive(Debug, Default)]
pub struct ShadowMap {
    atlas: AtlasAllocator,
    sun_direction: Vec3,
    /// By the rock.
    tiles: BTreeMap<usize, Tile>,
}

/// What a tile holds and where it is.
#[derive(Clone, Debug)]
struct Tile {
    /// Keeps the mesh's address from being given to another, but not the mesh.
    mesh: Weak<Reused<Vertex>>,
    level: usize,
    size_px: f32,
    half_extent_m: f32,
    allocation: Allocation,
}

/// A tile that is to be drawn.
#[derive(Clone, Copy, Debug)]
pub struct NewTile {
    rock: usize,
    level: usize,
    place: CasterTile,
}

impl ShadowMap {
    /// Columns and rows, which only ever grow.
    #[must_use]
    pub const fn size_px(&self) -> [u32; 2] {
        self.atlas.size()
    }

    /// Gives the tiles of a selection's casters their places in the map; those that are to be drawn there, the largest first. What
    /// lies between the tiles is any number. Where the map has grown it has none of the tiles from before.
    pub fn place(&mut self, scene: &Scene, selection: &mut Selection) -> Vec<NewTile> {
        let mut casting: Vec<Option<NewTile>> = vec![None; selection.casters.len()];
        for selected in &selection.rocks {
            if let Some((caster, level)) = selected.caster {
                let level = level.min(scene.rocks[selected.rock].level);
                let place = selection.casters[caster].tile;
                casting[caster] = Some(NewTile { rock: selected.rock, level, place });
            }
        }
        let order = casters::largest_first(&selection.casters);
        let wanted: Vec<NewTile> = order.iter().filter_map(|&caster| casting[caster]).collect();
        let is_same_sun =
            std::mem::replace(&mut self.sun_direction, scene.sun.direction) == scene.sun.direction;
        let before = std::mem::take(&mut self.tiles);
        for tile in &wanted {
            if let Some(known) =
                before.get(&tile.rock).filter(|known| is_same_sun && known.holds(tile, scene))
            {
                self.tiles.insert(tile.rock, known.clone());
            }
        }
        let is_kept = |tile: &&NewTile| self.tiles.contains_key(&tile.rock);
        let mut new: Vec<NewTile> = wanted.iter().filter(|tile| !is_kept(tile)).copied().collect();
        if self.tiles.is_empty() {
            self.clear(self.atlas.size());
        } else {
            for (_, tile) in before.iter().filter(|(rock, _)| !self.tiles.contains_key(rock)) {
                self.atlas.free(tile.allocation);
            }
        }
        while !new.iter().all(|tile| self.add(tile, scene)) {
            let [width, height] = self.atlas.size();
            let area_px: u32 =
                wanted.iter().map(|tile| tile.place.size_px as u32).map(|side| side * side).sum();
            let is_scattered = new.len() < wanted.len() && 2 * area_px <= width * height;
            self.clear(match (is_scattered, width > height) {
                (true, _) => [width, height],
                (false, true) => [width, 2 * height],
                (false, false) => [2 * width, height],
            });
            new.clone_from(&wanted);
        }
        let place_of = |rock: usize| UVec2::from(self.tiles[&rock].allocation.corner).as_vec2();
        for (caster, tile) in casting.iter().enumerate() {
            if let Some(tile) = tile {
                selection.casters[caster].tile.origin_px = place_of(tile.rock);
            }
        }
        for tile in &mut new {
            tile.place.origin_px = place_of(tile.rock);
        }
        new
    }

    fn clear(&mut self, [width, height]: [u32; 2]) {
        self.atlas = AtlasAllocator::new([width.max(LEAST_PX[0]), height.max(LEAST_PX[1])]);
        self.tiles.clear();
    }

    /// Finds a place for a tile, if the atlas has room.
    fn add(&mut self, tile: &NewTile, scene: &Scene) -> bool {
        let Some(allocation) = self.atlas.allocate(tile.place.size_px as u32) else { return false };
        let mesh = Arc::downgrade(&scene.rocks[tile.rock].vertices);
        let CasterTile { size_px, half_extent_m, .. } = tile.place;
        self.tiles.insert(tile.rock, Tile { mesh, level: tile.level, size_px, half_extent_m, allocation });
        true
    }
}

impl Tile {
    /// Whether it is what another is to hold.
    fn holds(&self, tile: &NewTile, scene: &Scene) -> bool {
        self.mesh.ptr_eq(&Arc::downgrade(&scene.rocks[tile.rock].vertices))
            && self.level == tile.level
            && (self.size_px, self.half_extent_m) == (tile.place.size_px, tile.place.half_extent_m)
    }
}

impl NewTile {
    /// Pages that so many of its rows are written to.
    fn pages(&self, rows: usize) -> usize {
        (self.row_bytes() * rows).div_ceil(PAGE_BYTES)
    }

    fn size(&self) -> usize {
        self.place.size_px as usize
    }

    fn row_bytes(&self) -> usize {
        (self.size() * size_of::<f32>()).next_multiple_of(ROW_ALIGNMENT)
    }
}

/// Where tiles are written to, one after the other, and which parts of the map they are.
#[must_use]
pub fn parts(tiles: &[NewTile]) -> (Vec<TextureRegion>, usize) {
    let mut end = 0;
    let part = |tile: &NewTile| {
        let offset_bytes = end;
        end += tile.pages(tile.size()) * PAGE_BYTES;
        let origin = tile.place.origin_px.as_uvec2().to_array();
        TextureRegion {
            offset_bytes,
            row_bytes: tile.row_bytes(),
            origin,
            size: [tile.place.size_px as u32; 2],
        }
    };
    (tiles.iter().map(part).collect(), end)
}

/// Draws tiles to where [`parts`] says.
pub fn draw(scene: &Scene, tiles: &[NewTile], pages: &mut dyn Iterator<Item = Page<'_>>) {
    let mut bands: Vec<(&NewTile, Range<usize>, Vec<Page<'_>>)> = Vec::new();
    for tile in tiles {
        for first in (0..tile.size()).step_by(BAND_ROWS) {
            let rows = first..tile.size().min(first + BAND_ROWS);
            let pages = pages.take(tile.pages(rows.len())).collect();
            bands.push((tile, rows, pages));
        }
    }
    // They take very different times.
    bands.into_par_iter().with_max_len(1).for_each(|(tile, rows, pages)| {
        let rock = &scene.rocks[tile.rock];
        let vertices = &rock.vertices[..Icosphere::vertex_count(tile.level)];
        CANVAS.with_borrow_mut(|canvas| {
            canvas.restart(tile.size(), rows);
            dispatch!(Level::new(), simd => {
                canvas.project(&tile.place, scene, vertices);
                canvas.draw(simd, rock.triangles(tile.level));
            });
            canvas.write_middles(tile.row_bytes(), PageWriter::new(pages));
        });
    });
}

/// A vertex in a tile, with its depth: 0 at the far end to 1.
#[derive(Clone, Copy, Debug)]
struct Corner {
    place: Place,
    /// The same before it is rounded, texels.
    at: Vec2,
    depth: f32,
}

/// A band of a tile that is drawn, with memory that is kept for the next.
#[derive(Debug, Default)]
struct Canvas {
    /// Columns of the tile.
    size: usize,
    /// Rows of the band.
    rows: Range<usize>,
    /// Texels from one row of a layer to the next.
    stride: usize,
    /// Greatest depth of what faces the sun, and of what faces away; 0 where there is none.
    layers: [Vec<f32>; 2],
    corners: Vec<Corner>,
    /// A row as it is written.
    line: Vec<f32>,
}

impl Canvas {
    /// Clears the layers for some rows of a tile.
    fn restart(&mut self, size: usize, rows: Range<usize>) {
        self.size = size;
        self.stride = size + WIDTH;
        for layer in &mut self.layers {
            layer.clear();
            layer.resize(self.stride * (rows.len() + HEIGHT), 0.0);
        }
        self.rows = rows;
        self.corners.clear();
    }

    /// Finds the places of a caster's vertices in its tile.
    #[inline(always)]
    fn project(&mut self, tile: &CasterTile, scene: &Scene, vertices: &[Vertex]) {
        let [right, up] = scene.sun.right_and_up();
        let (right, down, towards) = (right, -up, scene.sun.direction);
        let half = 0.5 / tile.half_extent_m;
        let texels = tile.size_px;
        for vertices in vertices.chunks(VERTICES) {
            let [x, y, z] = by_axis(vertices.iter().map(|vertex| vertex.position));
            let (mut at, mut depth) = ([[0.0; VERTICES]; 2], [0.0; VERTICES]);
            let mut parts = [[0; VERTICES]; 2];
            for i in 0..VERTICES {
                let p = [half * x[i], half * y[i], half * z[i]];
                at[0][i] = (0.5 + along(p, right)) * texels - 0.5;
                at[1][i] = (0.5 + along(p, down)) * texels - 0.5;
                parts[0][i] = Place::part(at[0][i]);
                parts[1][i] = Place::part(at[1][i]);
                depth[i] = 0.5 + along(p, towards);
            }
            self.corners.extend((0..vertices.len()).map(|i| Corner {
                place: Place { x: parts[0][i], y: parts[1][i] },
                at: Vec2::new(at[0][i], at[1][i]),
                depth: depth[i],
            }));
        }
    }

    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn draw<S: Simd>(&mut self, simd: S, triangles: &[[u32; 3]]) {
        let Self { size, rows, layers, corners, .. } = self;
        let rows = rows.start as i32..rows.end as i32;
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
                        outlines.fill(simd, lane, rows.start, *size + WIDTH, &mut Depth { layer, depth });
                    } else {
                        let corners = triangles[usize::from(number)].map(|corner| corners[corner as usize]);
                        draw_triangle(simd, corners, layers, *size, &rows);
                    }
                }
            }
        }
    }

    /// Writes what is half way between the layers, half extents of the tile from the caster's centre, so many bytes from one row to
    /// the next.
    fn write_middles(&mut self, row_bytes: usize, mut to: PageWriter<'_>) {
        let Self { size, rows, stride, layers, line, .. } = self;
        let [fronts, backs] = layers.each_ref().map(|layer| layer.chunks_exact(*stride));
        line.resize(*size, 0.0);
        for (fronts, backs) in fronts.zip(backs).take(rows.len()) {
            for (middle, (front, back)) in line.iter_mut().zip(fronts.iter().zip(backs)) {
                *middle = if *front == 0.0 { NO_CASTER } else { front + back - 1.0 };
            }
            to.write_row(bytemuck::cast_slice(line), row_bytes);
        }
    }
}

/// How far a place is along an axis.
#[inline(always)]
fn along([x, y, z]: [f32; 3], axis: Vec3) -> f32 {
    x * axis.x + y * axis.y + z * axis.z
}

/// Draws a triangle into the layer of what faces as it does, of some rows of a tile of so many columns.
#[inline(always)]
fn draw_triangle<S: Simd>(
    simd: S,
    [a, b, c]: [Corner; 3],
    layers: &mut [Vec<f32>; 2],
    size: usize,
    rows: &Range<i32>,
) {
    let Some(turn) = Turn::of([a.place, b.place, c.place]) else { return };
    let corners = if turn == Turn::Front { [a, b, c] } else { [a, c, b] };
    let places = corners.map(|corner| corner.place);
    let Some(outline) = Outline::new(places, size, rows) else { return };
    let [depth] = outline.planes(corners.map(|corner| corner.at), corners.map(|corner| [corner.depth]));
    outline.fill(simd, rows.start, size + WIDTH, &mut Depth { layer: &mut layers[turn as usize], depth });
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
    use crate::render::settings::RenderSettings;
    use crate::scene::sky::Sun;

    /// What a device would have.
    #[derive(Default)]
    struct Device {
        size_px: [u32; 2],
        texels: Vec<f32>,
    }

    impl Device {
        fn copy(&mut self, scene: &Scene, map: &ShadowMap, tiles: &[NewTile]) {
            if self.size_px != map.size_px() {
                self.size_px = map.size_px();
                self.texels = vec![f32::NAN; (self.size_px[0] * self.size_px[1]) as usize];
            }
            let (parts, bytes) = parts(tiles);
            let mut staged = vec![[0_u8; PAGE_BYTES]; bytes / PAGE_BYTES];
            draw(scene, tiles, &mut staged.iter_mut().map(Page::from_mut));
            let staged: Vec<f32> = bytemuck::pod_collect_to_vec(staged.as_flattened());
            for part in parts {
                let rows =
                    staged[part.offset_bytes / size_of::<f32>()..].chunks(part.row_bytes / size_of::<f32>());
                let ([column, first], [width, height]) =
                    (part.origin.map(|at| at as usize), part.size.map(|side| side as usize));
                for (row, texels) in (first..first + height).zip(rows) {
                    let start = row * self.size_px[0] as usize + column;
                    self.texels[start..start + width].copy_from_slice(&texels[..width]);
                }
            }
        }

        /// The texels of each caster's tile.
        fn tiles(&self, selection: &Selection) -> Vec<Vec<f32>> {
            let tile = |caster: &casters::Caster| {
                let [column, first] = caster.tile.origin_px.to_array().map(|at| at as usize);
                let size = caster.tile.size_px as usize;
                let row = |row: usize| &self.texels[row * self.size_px[0] as usize + column..][..size];
                (first..first + size).flat_map(row).copied().collect()
            };
            selection.casters.iter().map(tile).collect()
        }
    }

    #[test]
    fn tiles_are_the_same_whatever_was_drawn_before() {
        let mut scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([256, 256], 1).expect("settings");
        let (mut map, mut device) = (ShadowMap::default(), Device::default());
        let mut drawn = Vec::new();
        let still = scene.clone();
        for change in 0..40 {
            match change {
                // Nothing moves; then the sun; then a rock takes another's place; then the camera, again and again.
                0 | 1 => {}
                2 => scene.sun = Sun { direction: Vec3::new(0.3, 0.9, 0.31).normalize(), ..scene.sun },
                3 => Arc::make_mut(&mut scene.rocks[0].vertices).reverse(),
                _ => scene.camera.eye.x += 0.5,
            }
            let mut selection = Selection::new(&scene, &settings);
            let mut alone = selection.clone();
            let new = map.place(&scene, &mut selection);
            device.copy(&scene, &map, &new);
            let (mut fresh, mut of_fresh) = (ShadowMap::default(), Device::default());
            let all = fresh.place(&scene, &mut alone);
            of_fresh.copy(&scene, &fresh, &all);
            assert_eq!(device.tiles(&selection), of_fresh.tiles(&alone), "change {change}");
            drawn.push((new.len(), all.len()));
        }
        let [first, again, sun, rock, moved @ ..] = &drawn[..] else { panic!("forty pictures") };
        assert_eq!(first.0, first.1);
        assert_eq!(again.0, 0);
        assert_eq!(sun.0, sun.1);
        assert_eq!(rock.0, 1);
        let (some, all) = moved.iter().fold((0, 0), |sum, few| (sum.0 + few.0, sum.1 + few.1));
        assert!(0 < some && 2 * some < all, "{moved:?}");
        assert!(Arc::ptr_eq(&still.rocks[1].vertices, &scene.rocks[1].vertices), "copies share meshes");
    }

    #[test]
    fn a_map_grows_as_far_as_it_must() {
        let scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([512, 512], 1).expect("settings");
        let mut selection = Selection::new(&scene, &settings);
        let mut map = ShadowMap::default();
        let new = map.place(&scene, &mut selection);
        let area: f32 = new.iter().map(|tile| tile.place.size_px * tile.place.size_px).sum();
        let [width, height] = map.size_px();
        assert!(
            area < (width * height) as f32 && (width * height) as f32 <= 4.0 * area,
            "{width} x {height}"
        );
        // A smaller picture has smaller tiles, and the map stays.
        let settings = RenderSettings::new([64, 64], 1).expect("settings");
        map.place(&scene, &mut Selection::new(&scene, &settings));
        assert_eq!(map.size_px(), [width, height]);
    }
}
