//! The shadow map on the CPU, for software adapters.
//!
//! A tile's texels depend on nothing but the caster's mesh, the tile's size and the sun, and no image depends on where in the map
//! a tile lies. So tiles of earlier frames stay in the map, and a frame is the same whatever was rendered before it.
//!
//! CPU counterpart of `shadow.wgsl` and `shadow_midpoint.wgsl`: midpoint shadow maps (Woo 1992, "The shadow depth map revisited", in
//! Graphics Gems III).
//! Must not know: textures.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Weak};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{UVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::gpu::staging::{PAGE_BYTES, Page, PageWriter, ROW_ALIGNMENT, TextureRegion};
use crate::pool::PooledVec;
use crate::render::device::shader_structs::CasterTile;
use crate::render::raster::cull::{CULL_BATCH, CullMode, Survivors, Winding};
use crate::render::raster::fill::FragmentSink;
use crate::render::raster::fixed_point::SubpixelPoint;
use crate::render::raster::lanes::{
    BLOCK_HEIGHT, BLOCK_WIDTH, LANES, VERTEX_BATCH, load_block, store_block, to_soa,
};
use crate::render::raster::setup::{Interpolant, TriangleSetup};
use crate::render::raster::setup8::{TriangleSetup8, TriangleVertices8};
use crate::render::select::atlas::{Allocation, AtlasAllocator};
use crate::render::select::casters;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};

/// Height where a tile has no caster, half extents of the tile. `shadow_midpoint.wgsl` has the same.
const NO_CASTER: f32 = -1.0e9;
/// Rows of a band of a tile. One thread rasterises a band: few enough rows to stay in its cache, and whole pages of them.
const BAND_ROWS: usize = 256;
const _: () = assert!((BAND_ROWS * ROW_ALIGNMENT).is_multiple_of(PAGE_BYTES));
/// Columns and rows of the map at first.
const MIN_SIZE_PX: [u32; 2] = [512, 512];

thread_local! {
    /// One per thread, so that its memory is reused.
    static BAND: RefCell<ShadowBand> = RefCell::default();
}

/// Which tiles the device's shadow map holds, and where.
#[derive(Debug, Default)]
pub struct ShadowMap {
    atlas: AtlasAllocator,
    sun_direction: Vec3,
    /// By the index of the rock.
    tiles: BTreeMap<usize, Tile>,
}

/// A tile of the map: what it was rasterised from, and where it is.
#[derive(Clone, Debug)]
struct Tile {
    /// Identifies the mesh: while this exists its address goes to no other mesh, though the mesh itself may be dropped.
    mesh: Weak<PooledVec<Vertex>>,
    level: usize,
    size_px: f32,
    half_extent_m: f32,
    allocation: Allocation,
}

/// A tile that is still to be rasterised.
#[derive(Clone, Copy, Debug)]
pub struct NewTile {
    rock: usize,
    level: usize,
    tile: CasterTile,
}

impl ShadowMap {
    /// Columns and rows, which only ever grow.
    #[must_use]
    pub const fn size_px(&self) -> [u32; 2] {
        self.atlas.size()
    }

    /// Allocates the tiles of a selection's casters; returns those that are to be rasterised, the largest first. Texels between
    /// the tiles are undefined. If the map grows it loses all earlier tiles.
    pub fn allocate(&mut self, scene: &Scene, selection: &mut Selection) -> Vec<NewTile> {
        let mut of_casters: Vec<Option<NewTile>> = vec![None; selection.casters.len()];
        for selected in &selection.rocks {
            if let Some((caster, level)) = selected.caster {
                let level = level.min(scene.rocks[selected.rock].level);
                let tile = selection.casters[caster].tile;
                of_casters[caster] = Some(NewTile { rock: selected.rock, level, tile });
            }
        }
        let order = casters::largest_first(&selection.casters);
        let wanted: Vec<NewTile> = order.iter().filter_map(|&caster| of_casters[caster]).collect();
        let mut new = self.retain(scene, &wanted);
        while !new.iter().all(|tile| self.add(tile, scene)) {
            self.make_room(&wanted, new.len());
            new.clone_from(&wanted);
        }
        let origin_of = |rock: usize| UVec2::from(self.tiles[&rock].allocation.corner).as_vec2();
        for (caster, tile) in of_casters.iter().enumerate() {
            if let Some(tile) = tile {
                selection.casters[caster].tile.origin_px = origin_of(tile.rock);
            }
        }
        for tile in &mut new {
            tile.tile.origin_px = origin_of(tile.rock);
        }
        new
    }

    /// Keeps the tiles of the last frame that are still valid and frees the others; returns those that are missing.
    fn retain(&mut self, scene: &Scene, wanted: &[NewTile]) -> Vec<NewTile> {
        let is_same_sun =
            std::mem::replace(&mut self.sun_direction, scene.sun.direction) == scene.sun.direction;
        let before = std::mem::take(&mut self.tiles);
        for tile in wanted {
            if let Some(known) =
                before.get(&tile.rock).filter(|known| is_same_sun && known.holds(tile, scene))
            {
                self.tiles.insert(tile.rock, known.clone());
            }
        }
        if self.tiles.is_empty() {
            self.clear(self.atlas.size());
        } else {
            for (_, tile) in before.iter().filter(|(rock, _)| !self.tiles.contains_key(rock)) {
                self.atlas.free(tile.allocation);
            }
        }
        wanted.iter().filter(|tile| !self.tiles.contains_key(&tile.rock)).copied().collect()
    }

    /// Empties the map, which is too small or too fragmented for the wanted tiles, `new_count` of which are new; grows it unless
    /// defragmentation will do.
    fn make_room(&mut self, wanted: &[NewTile], new_count: usize) {
        let [width, height] = self.atlas.size();
        let area_px: u32 = wanted.iter().map(|tile| tile.tile.size_px as u32).map(|side| side * side).sum();
        let is_fragmented = new_count < wanted.len() && 2 * area_px <= width * height;
        self.clear(match (is_fragmented, width > height) {
            (true, _) => [width, height],
            (false, true) => [width, 2 * height],
            (false, false) => [2 * width, height],
        });
    }

    fn clear(&mut self, [width, height]: [u32; 2]) {
        self.atlas = AtlasAllocator::new([width.max(MIN_SIZE_PX[0]), height.max(MIN_SIZE_PX[1])]);
        self.tiles.clear();
    }

    /// Allocates a tile; whether there was room for it.
    fn add(&mut self, tile: &NewTile, scene: &Scene) -> bool {
        let Some(allocation) = self.atlas.allocate(tile.tile.size_px as u32) else { return false };
        let mesh = Arc::downgrade(&scene.rocks[tile.rock].vertices);
        let CasterTile { size_px, half_extent_m, .. } = tile.tile;
        self.tiles.insert(tile.rock, Tile { mesh, level: tile.level, size_px, half_extent_m, allocation });
        true
    }
}

impl Tile {
    /// Whether it holds the texels of a tile that is wanted.
    fn holds(&self, wanted: &NewTile, scene: &Scene) -> bool {
        self.mesh.ptr_eq(&Arc::downgrade(&scene.rocks[wanted.rock].vertices))
            && self.level == wanted.level
            && (self.size_px, self.half_extent_m) == (wanted.tile.size_px, wanted.tile.half_extent_m)
    }
}

impl NewTile {
    /// Pages that this many of its rows take.
    fn pages(&self, rows: usize) -> usize {
        (self.row_bytes() * rows).div_ceil(PAGE_BYTES)
    }

    fn size(&self) -> usize {
        self.tile.size_px as usize
    }

    fn row_bytes(&self) -> usize {
        (self.size() * size_of::<f32>()).next_multiple_of(ROW_ALIGNMENT)
    }
}

/// Divides tiles into parts of at most `max_bytes` in staging memory each, or of a single tile.
pub fn upload_parts(tiles: &[NewTile], max_bytes: usize) -> impl Iterator<Item = &[NewTile]> {
    let mut rest = tiles;
    std::iter::from_fn(move || {
        let mut bytes = 0;
        let count = rest.iter().take_while(|tile| {
            bytes += tile.pages(tile.size()) * PAGE_BYTES;
            bytes <= max_bytes
        });
        let (part, others) = rest.split_at(count.count().max(1).min(rest.len()));
        rest = others;
        (!part.is_empty()).then_some(part)
    })
}

/// The layout of tiles in staging memory, one after the other: the region of the map that each is copied to, and the bytes of
/// all.
#[must_use]
pub fn upload_regions(tiles: &[NewTile]) -> (Vec<TextureRegion>, usize) {
    let mut end = 0;
    let region = |tile: &NewTile| {
        let offset_bytes = end;
        end += tile.pages(tile.size()) * PAGE_BYTES;
        let origin = tile.tile.origin_px.as_uvec2().to_array();
        TextureRegion {
            offset_bytes,
            row_bytes: tile.row_bytes(),
            origin,
            size: [tile.tile.size_px as u32; 2],
        }
    };
    (tiles.iter().map(region).collect(), end)
}

/// Rasterises tiles into staging memory, laid out as by [`upload_regions`].
pub fn rasterise(scene: &Scene, tiles: &[NewTile], pages: &mut dyn Iterator<Item = Page<'_>>) {
    let mut bands: Vec<(&NewTile, Range<usize>, Vec<Page<'_>>)> = Vec::new();
    for tile in tiles {
        for first in (0..tile.size()).step_by(BAND_ROWS) {
            let rows = first..tile.size().min(first + BAND_ROWS);
            let pages = pages.take(tile.pages(rows.len())).collect();
            bands.push((tile, rows, pages));
        }
    }
    // One band at a time per thread: their costs differ widely.
    bands.into_par_iter().with_max_len(1).for_each(|(tile, rows, pages)| {
        let rock = &scene.rocks[tile.rock];
        let vertices = &rock.vertices[..Icosphere::vertex_count(tile.level)];
        BAND.with_borrow_mut(|band| {
            band.clear(tile.size(), rows);
            dispatch!(Level::new(), simd => {
                band.project(&tile.tile, scene, vertices);
                band.rasterise(simd, rock.triangles(tile.level));
            });
            band.write_midpoints(tile.row_bytes(), PageWriter::new(pages));
        });
    });
}

/// A vertex of a caster in its tile.
#[derive(Clone, Copy, Debug)]
struct ShadowVertex {
    position: SubpixelPoint,
    /// The same before it is rounded, texels from the centre of the first.
    position_px: Vec2,
    /// Reversed: 0 at the far end of the tile's box, 1 at the end nearest to the sun.
    depth: f32,
}

/// A band of rows of a tile.
#[derive(Debug, Default)]
struct ShadowBand {
    /// Columns of the tile.
    size: usize,
    /// Rows of the band.
    rows: Range<usize>,
    /// Texels from one row of a layer to the next.
    stride: usize,
    /// Greatest depth of the faces towards the sun ([`Winding::Front`]), and of those away from it; 0 where there is none.
    layers: [Vec<f32>; 2],
    vertices: Vec<ShadowVertex>,
    /// A row as it is written.
    midpoint_row: Vec<f32>,
}

impl ShadowBand {
    /// Clears it for these rows of a tile of `size` columns.
    fn clear(&mut self, size: usize, rows: Range<usize>) {
        self.size = size;
        self.stride = size + BLOCK_WIDTH;
        for layer in &mut self.layers {
            layer.clear();
            layer.resize(self.stride * (rows.len() + BLOCK_HEIGHT), 0.0);
        }
        self.rows = rows;
        self.vertices.clear();
    }

    /// Projects a caster's vertices onto its tile: an orthographic view from the sun.
    #[inline(always)]
    fn project(&mut self, tile: &CasterTile, scene: &Scene, vertices: &[Vertex]) {
        let [right, up] = scene.sun.right_and_up();
        let (right, down, to_sun) = (right, -up, scene.sun.direction);
        let half = 0.5 / tile.half_extent_m;
        let size_px = tile.size_px;
        for vertices in vertices.chunks(VERTEX_BATCH) {
            let [x, y, z] = to_soa(vertices.iter().map(|vertex| vertex.position));
            let (mut position_px, mut depth) = ([[0.0; VERTEX_BATCH]; 2], [0.0; VERTEX_BATCH]);
            let mut position = [[0; VERTEX_BATCH]; 2];
            for i in 0..VERTEX_BATCH {
                let p = [half * x[i], half * y[i], half * z[i]];
                position_px[0][i] = (0.5 + dot(p, right)) * size_px - 0.5;
                position_px[1][i] = (0.5 + dot(p, down)) * size_px - 0.5;
                position[0][i] = SubpixelPoint::steps(position_px[0][i]);
                position[1][i] = SubpixelPoint::steps(position_px[1][i]);
                depth[i] = 0.5 + dot(p, to_sun);
            }
            self.vertices.extend((0..vertices.len()).map(|i| ShadowVertex {
                position: SubpixelPoint { x: position[0][i], y: position[1][i] },
                position_px: Vec2::new(position_px[0][i], position_px[1][i]),
                depth: depth[i],
            }));
        }
    }

    // `inline(always)` all the way down to the fill loop, so that `dispatch!` compiles it for each vector width.
    #[inline(always)]
    fn rasterise<S: Simd>(&mut self, simd: S, triangles: &[[u32; 3]]) {
        let Self { size, rows, layers, vertices, .. } = self;
        let rows = rows.start as i32..rows.end as i32;
        let position_of = |vertex: u32| vertices[vertex as usize].position;
        for triangles in triangles.chunks(CULL_BATCH) {
            let survivors = Survivors::cull(simd, triangles, position_of, CullMode::None, *size, &rows);
            for eight in survivors.indices().chunks(LANES) {
                let mut vertices8 = TriangleVertices8::EMPTY;
                for (lane, &index) in eight.iter().enumerate() {
                    for (corner, &vertex) in triangles[usize::from(index)].iter().enumerate() {
                        let ShadowVertex { position, position_px, depth } = vertices[vertex as usize];
                        vertices8.set(lane, corner, position, position_px, [depth]);
                    }
                }
                let setup8 = TriangleSetup8::new(simd, &vertices8, *size, &rows);
                for (lane, &index) in eight.iter().enumerate() {
                    if setup8.is_small(lane) {
                        let [depth] = setup8.interpolants(lane);
                        let layer = &mut layers[setup8.winding(lane) as usize];
                        let mut writer = DepthWriter { layer, depth };
                        setup8.fill(simd, lane, rows.start, *size + BLOCK_WIDTH, &mut writer);
                    } else {
                        let corners = triangles[usize::from(index)].map(|vertex| vertices[vertex as usize]);
                        rasterise_large(simd, corners, layers, *size, &rows);
                    }
                }
            }
        }
    }

    /// Writes the depths midway between the layers, half extents of the tile from the caster's centre, `row_bytes` from one row to
    /// the next.
    fn write_midpoints(&mut self, row_bytes: usize, mut writer: PageWriter<'_>) {
        let Self { size, rows, stride, layers, midpoint_row, .. } = self;
        let [fronts, backs] = layers.each_ref().map(|layer| layer.chunks_exact(*stride));
        midpoint_row.resize(*size, 0.0);
        for (fronts, backs) in fronts.zip(backs).take(rows.len()) {
            for (midpoint, (front, back)) in midpoint_row.iter_mut().zip(fronts.iter().zip(backs)) {
                *midpoint = if *front == 0.0 { NO_CASTER } else { front + back - 1.0 };
            }
            writer.write_row(bytemuck::cast_slice(midpoint_row), row_bytes);
        }
    }
}

/// Dot product, in this order of sums.
#[inline(always)]
fn dot([x, y, z]: [f32; 3], axis: Vec3) -> f32 {
    x * axis.x + y * axis.y + z * axis.z
}

/// Rasterises a triangle of any size into the layer of its winding, into these rows of a tile of `size` columns.
#[inline(always)]
fn rasterise_large<S: Simd>(
    simd: S,
    [a, b, c]: [ShadowVertex; 3],
    layers: &mut [Vec<f32>; 2],
    size: usize,
    rows: &Range<i32>,
) {
    let Some(winding) = Winding::of([a.position, b.position, c.position]) else { return };
    let corners = if winding == Winding::Front { [a, b, c] } else { [a, c, b] };
    let Some(setup) = TriangleSetup::new(corners.map(|corner| corner.position), size, rows) else { return };
    let [depth] =
        setup.interpolants(corners.map(|corner| corner.position_px), corners.map(|corner| [corner.depth]));
    let mut writer = DepthWriter { layer: &mut layers[winding as usize], depth };
    setup.fill(simd, rows.start, size + BLOCK_WIDTH, &mut writer);
}

/// Raises a layer to the depth of a triangle.
struct DepthWriter<'a> {
    layer: &'a mut [f32],
    depth: Interpolant,
}

impl<S: Simd> FragmentSink<S> for DepthWriter<'_> {
    #[inline(always)]
    fn write(&mut self, simd: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let depth = covered.select(self.depth.at(x, y), f32x8::splat(simd, 0.0));
        let previous = load_block(simd, self.layer, offsets);
        store_block(self.layer, offsets, depth.max(previous));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;
    use crate::render::settings::RenderSettings;
    use crate::scene::sky::Sun;

    /// The shadow map of a device.
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
            let (regions, bytes) = upload_regions(tiles);
            let mut staged = vec![[0_u8; PAGE_BYTES]; bytes / PAGE_BYTES];
            rasterise(scene, tiles, &mut staged.iter_mut().map(Page::from_mut));
            let staged: Vec<f32> = bytemuck::pod_collect_to_vec(staged.as_flattened());
            for region in regions {
                let rows = staged[region.offset_bytes / size_of::<f32>()..]
                    .chunks(region.row_bytes / size_of::<f32>());
                let ([column, first], [width, height]) =
                    (region.origin.map(|at| at as usize), region.size.map(|side| side as usize));
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
    fn tiles_do_not_depend_on_earlier_frames() {
        let mut scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([256, 256], 1).expect("settings");
        let (mut map, mut device) = (ShadowMap::default(), Device::default());
        let mut drawn = Vec::new();
        let still = scene.clone();
        for change in 0..40 {
            match change {
                // Nothing changes; then the sun; then the mesh of a rock; then the camera, again and again.
                0 | 1 => {}
                2 => scene.sun = Sun { direction: Vec3::new(0.3, 0.9, 0.31).normalize(), ..scene.sun },
                3 => Arc::make_mut(&mut scene.rocks[0].vertices).reverse(),
                _ => scene.camera.eye.x += 0.5,
            }
            let mut selection = Selection::new(&scene, &settings);
            let mut alone = selection.clone();
            let new = map.allocate(&scene, &mut selection);
            device.copy(&scene, &map, &new);
            let (mut fresh, mut of_fresh) = (ShadowMap::default(), Device::default());
            let all = fresh.allocate(&scene, &mut alone);
            of_fresh.copy(&scene, &fresh, &all);
            assert_eq!(device.tiles(&selection), of_fresh.tiles(&alone), "change {change}");
            drawn.push((new.len(), all.len()));
        }
        let [first, again, sun, rock, moved @ ..] = &drawn[..] else { panic!("forty frames") };
        assert_eq!(first.0, first.1);
        assert_eq!(again.0, 0);
        assert_eq!(sun.0, sun.1);
        assert_eq!(rock.0, 1);
        let (some, all) = moved.iter().fold((0, 0), |sum, few| (sum.0 + few.0, sum.1 + few.1));
        assert!(0 < some && 2 * some < all, "{moved:?}");
        assert!(Arc::ptr_eq(&still.rocks[1].vertices, &scene.rocks[1].vertices), "copies share meshes");
    }

    #[test]
    fn the_map_grows_no_further_than_it_must() {
        let scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([512, 512], 1).expect("settings");
        let mut selection = Selection::new(&scene, &settings);
        let mut map = ShadowMap::default();
        let new = map.allocate(&scene, &mut selection);
        let area: f32 = new.iter().map(|tile| tile.tile.size_px * tile.tile.size_px).sum();
        let [width, height] = map.size_px();
        assert!(
            area < (width * height) as f32 && (width * height) as f32 <= 4.0 * area,
            "{width} x {height}"
        );
        // A smaller image has smaller tiles, and the map stays.
        let settings = RenderSettings::new([64, 64], 1).expect("settings");
        map.allocate(&scene, &mut Selection::new(&scene, &settings));
        assert_eq!(map.size_px(), [width, height]);
    }
}
