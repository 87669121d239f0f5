//! The tiles of the host's shadow map: which the map holds, and where; how new ones are laid out in staging memory.
//!
//! A tile's texels depend on nothing but the caster's mesh, the tile's size and the sun, and no image depends on where in the map
//! a tile lies. So tiles of earlier frames stay in the map, and a frame is the same whatever was rendered before it.
//!
//! Of a large tile on the surface stage the map has only the texels that the image can sample. On the nominal stage, whose rocks stay
//! where they are while the camera moves, it has whole tiles, which later images sample elsewhere.
//! Must not know: how a tile is rasterised.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Weak};

use glam::{UVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::gpu::staging::{PAGE_BYTES, ROW_ALIGNMENT, TextureRegion};
use crate::pool::PooledVec;
use crate::render::device::shader_structs::CasterTile;
use crate::render::select::atlas::{Allocation, AtlasAllocator};
use crate::render::select::sampled_texels::{SurfacesInView, TexelRect};
use crate::render::select::selection::{SelectedRock, Selection};
use crate::scene::Scene;
use crate::scene::mesh::Vertex;

/// Columns and rows of the map at first.
const MIN_SIZE_PX: [u32; 2] = [512, 512];

/// Most rows of a strip of several tiles, and most columns of it.
const MAX_STRIP_ROWS: usize = 64;
const MAX_STRIP_COLUMNS: usize = 256;
/// Rows of a band of a tile. One thread rasterises a band: few enough rows to stay in its cache.
pub(super) const BAND_ROWS: usize = 256;
/// The map is enlarged in both directions until it is so wide, texels, then by rows: a frame needs some 30 MB.
const MAX_WIDTH_PX: u32 = 4096;
/// Rows by which it is enlarged then.
const ROWS_STEP_PX: u32 = 128;

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
    /// Its texels in the map.
    texels: TexelRect,
    allocation: Allocation,
}

/// A tile that is still to be rasterised.
#[derive(Clone, Debug)]
pub struct NewTile {
    /// Index of the caster.
    pub(super) rock: usize,
    /// Level of detail of its mesh.
    pub(super) level: usize,
    /// Where it lies, and its frame.
    pub(super) tile: CasterTile,
    /// The texels that are rasterised.
    pub(super) texels: TexelRect,
}

impl ShadowMap {
    /// Columns and rows, which only ever grow.
    #[must_use]
    pub const fn size_px(&self) -> [u32; 2] {
        self.atlas.size()
    }

    /// Allocates the tiles of a selection's casters; returns those that are to be rasterised, the highest first. Texels between
    /// the tiles are undefined, as is the origin of a tile that no surface in view samples. If the map grows it loses all earlier tiles;
    /// it has at most `max_texture_px` columns and rows, in half of which the selection's tiles fit.
    pub fn allocate(
        &mut self,
        scene: &Scene,
        selection: &mut Selection,
        max_texture_px: u32,
    ) -> Vec<NewTile> {
        let of_casters = tiles_of_casters(scene, selection);
        let mut wanted: Vec<NewTile> = of_casters.iter().map(|(_, tile)| tile.clone()).collect();
        wanted.sort_by_key(|tile| std::cmp::Reverse(tile.size_px()[1]));
        let mut new = self.retain(scene, &wanted);
        while !new.iter().all(|tile| self.add(tile, scene)) {
            self.make_room(&wanted, new.len(), max_texture_px);
            new.clone_from(&wanted);
        }
        for (caster, tile) in &of_casters {
            selection.casters[*caster].tile.origin_px = self.tiles[&tile.rock].origin_px();
        }
        for tile in &mut new {
            tile.tile.origin_px = self.tiles[&tile.rock].origin_px();
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
        wanted.iter().filter(|tile| !self.tiles.contains_key(&tile.rock)).cloned().collect()
    }

    /// Empties the map, which is too small or too fragmented for the wanted tiles, `new_count` of which are new; grows it unless
    /// defragmentation will do.
    fn make_room(&mut self, wanted: &[NewTile], new_count: usize, max_texture_px: u32) {
        let [width, height] = self.atlas.size();
        let area_px: u32 = wanted.iter().map(|tile| tile.size_px().iter().product::<u32>()).sum();
        let is_full_size = height + ROWS_STEP_PX > max_texture_px;
        let is_fragmented = new_count < wanted.len() && (is_full_size || 2 * area_px <= width * height);
        let is_widest = 2 * width > MAX_WIDTH_PX.min(max_texture_px);
        self.clear(match (is_fragmented, width > height) {
            (true, _) => [width, height],
            (false, _) if is_widest && 2 * height >= width => [width, height + ROWS_STEP_PX],
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
        let Some(allocation) = self.atlas.allocate(tile.size_px()) else { return false };
        let mesh = Arc::downgrade(&scene.rocks[tile.rock].vertices);
        let CasterTile { size_px, half_extent_m, .. } = tile.tile;
        let (level, texels) = (tile.level, tile.texels.clone());
        self.tiles.insert(tile.rock, Tile { mesh, level, size_px, half_extent_m, texels, allocation });
        true
    }
}

/// The tiles of a selection's casters of which the map has texels, each with the index of its caster.
fn tiles_of_casters(scene: &Scene, selection: &Selection) -> Vec<(usize, NewTile)> {
    let surfaces = SurfacesInView::new(scene, selection);
    let tile_of = |selected: &SelectedRock| {
        let (index, level) = selected.caster?;
        let (rock, caster) = (&scene.rocks[selected.rock], &selection.casters[index]);
        let size = caster.tile.size_px as usize;
        let texels = match &surfaces {
            Some(surfaces) if size > MAX_STRIP_ROWS => surfaces.sampled_texels(caster),
            _ => TexelRect::whole(size),
        };
        let tile = NewTile { rock: selected.rock, level: level.min(rock.level), tile: caster.tile, texels };
        (!tile.texels.is_empty()).then_some((index, tile))
    };
    selection.rocks.par_iter().filter_map(tile_of).collect()
}

impl Tile {
    /// Whether it holds the texels of a tile that is wanted.
    fn holds(&self, wanted: &NewTile, scene: &Scene) -> bool {
        self.mesh.ptr_eq(&Arc::downgrade(&scene.rocks[wanted.rock].vertices))
            && self.level == wanted.level
            && (self.size_px, self.half_extent_m) == (wanted.tile.size_px, wanted.tile.half_extent_m)
            && self.texels.contains(&wanted.texels)
    }

    /// Where in the map its first texel lies, or would if the map had it.
    fn origin_px(&self) -> Vec2 {
        let first = [self.texels.columns.start, self.texels.rows.start].map(|texel| texel as f32);
        UVec2::from(self.allocation.corner).as_vec2() - Vec2::from(first)
    }
}

impl NewTile {
    /// Columns and rows of the whole tile.
    pub(super) fn size(&self) -> usize {
        self.tile.size_px as usize
    }

    /// Columns and rows that are rasterised.
    fn size_px(&self) -> [u32; 2] {
        [&self.texels.columns, &self.texels.rows].map(|texels| texels.len() as u32)
    }

    /// Column and row of the first texel that is rasterised, in the map.
    fn corner_px(&self) -> [u32; 2] {
        let first = [self.texels.columns.start, self.texels.rows.start].map(|texel| texel as f32);
        (self.tile.origin_px + Vec2::from(first)).as_uvec2().to_array()
    }

    /// Whether it may be uploaded with a tile to the right of it.
    fn is_followed_by(&self, right: &Self) -> bool {
        let (size_px, to_right) = (self.tile.size_px, right.tile.origin_px - self.tile.origin_px);
        self.size() <= MAX_STRIP_ROWS
            && right.tile.size_px == size_px
            && to_right.to_array() == [size_px, 0.0]
    }
}

/// Tiles that are uploaded as one: of equal size, from left to right in the map.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strip<'a> {
    pub(super) tiles: &'a [NewTile],
}

impl Strip<'_> {
    /// Its columns.
    pub(super) fn columns(&self) -> usize {
        self.tiles.iter().map(|tile| tile.texels.columns.len()).sum()
    }

    /// Bytes of a row in staging memory.
    pub(super) fn row_bytes(&self) -> usize {
        (self.columns() * size_of::<f32>()).next_multiple_of(ROW_ALIGNMENT)
    }
}

/// Rows of a strip that one thread rasterises.
#[derive(Clone, Debug)]
pub struct Band<'a> {
    pub(super) strip: Strip<'a>,
    pub(super) rows: BandRows,
}

/// The rows of a band.
#[derive(Clone, Debug, Default)]
pub(super) struct BandRows {
    /// The first row of the tile that is rasterised, a multiple of [`BAND_ROWS`]: numbers are rounded relative to it.
    pub(super) first: usize,
    /// Those that the map has.
    pub(super) written: Range<usize>,
}

impl BandRows {
    /// The bands that hold these rows of a tile.
    fn of_tile(rows: &Range<usize>) -> impl Iterator<Item = Self> + use<> {
        let Range { start, end } = *rows;
        let firsts = (start / BAND_ROWS * BAND_ROWS..end).step_by(BAND_ROWS);
        firsts.map(move |first| Self { first, written: start.max(first)..end.min(first + BAND_ROWS) })
    }

    /// Rows from the first to the last that the map has.
    pub(super) const fn len(&self) -> usize {
        self.written.end - self.first
    }
}

impl Band<'_> {
    /// Pages that it takes in staging memory.
    pub(super) fn pages(&self) -> usize {
        (self.strip.row_bytes() * self.rows.written.len()).div_ceil(PAGE_BYTES)
    }

    /// Its texels in the map, and where they are in staging memory.
    fn region(&self, offset_bytes: usize) -> TextureRegion {
        let tile = &self.strip.tiles[0];
        let [column, row] = tile.corner_px();
        TextureRegion {
            offset_bytes,
            row_bytes: self.strip.row_bytes(),
            origin: [column, row + (self.rows.written.start - tile.texels.rows.start) as u32],
            size: [self.strip.columns(), self.rows.written.len()].map(|texels| texels as u32),
        }
    }
}

/// Divides tiles into strips: a copy takes as long as hundreds of texels, and most tiles have fewer.
fn strips(tiles: &[NewTile]) -> impl Iterator<Item = Strip<'_>> {
    let runs = tiles.chunk_by(NewTile::is_followed_by);
    runs.flat_map(|run| run.chunks((MAX_STRIP_COLUMNS / run[0].size().max(1)).max(1)))
        .map(|tiles| Strip { tiles })
}

/// Divides tiles into bands.
#[must_use]
pub fn bands(tiles: &[NewTile]) -> Vec<Band<'_>> {
    let bands = strips(tiles).flat_map(|strip| {
        BandRows::of_tile(&strip.tiles[0].texels.rows).map(move |rows| Band { strip, rows })
    });
    bands.collect()
}

/// Divides bands into parts of at most `max_bytes` in staging memory each, or of a single band.
pub fn upload_parts<'a, 'b>(bands: &'b [Band<'a>], max_bytes: usize) -> impl Iterator<Item = &'b [Band<'a>]> {
    let mut rest = bands;
    std::iter::from_fn(move || {
        let mut bytes = 0;
        let fitting = rest.iter().take_while(|band| {
            bytes += band.pages() * PAGE_BYTES;
            bytes <= max_bytes
        });
        let count = fitting.count().max(1).min(rest.len());
        let (part, others) = rest.split_at(count);
        rest = others;
        (!part.is_empty()).then_some(part)
    })
}

/// The layout of bands in staging memory, one after the other: the region of the map that each is copied to, and the bytes of all.
#[must_use]
pub fn upload_regions(bands: &[Band<'_>]) -> (Vec<TextureRegion>, usize) {
    let mut end = 0;
    let region = |band: &Band<'_>| {
        let offset_bytes = end;
        end += band.pages() * PAGE_BYTES;
        band.region(offset_bytes)
    };
    (bands.iter().map(region).collect(), end)
}
