//! The tiles of the host's shadow map: which the map holds, and where; how new ones are laid out in staging memory.
//!
//! A tile's texels depend on nothing but the caster's mesh, the tile's size and the sun, and no image depends on where in the map
//! a tile lies. So tiles of earlier frames stay in the map, and a frame is the same whatever was rendered before it.
//! Must not know: how a tile is rasterised.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use glam::{UVec2, Vec3};

use crate::gpu::staging::{PAGE_BYTES, ROW_ALIGNMENT, TextureRegion};
use crate::pool::PooledVec;
use crate::render::device::shader_structs::CasterTile;
use crate::render::select::atlas::{Allocation, AtlasAllocator};
use crate::render::select::casters;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;

/// Columns and rows of the map at first.
const MIN_SIZE_PX: [u32; 2] = [512, 512];

/// Most rows of a strip of several tiles, and most columns of it.
const MAX_STRIP_ROWS: usize = 64;
const MAX_STRIP_COLUMNS: usize = 256;

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
    /// Index of the caster.
    pub(super) rock: usize,
    /// Level of detail of its mesh.
    pub(super) level: usize,
    /// Where it lies, and its frame.
    pub(super) tile: CasterTile,
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
    /// Its columns and rows.
    pub(super) fn size(&self) -> usize {
        self.tile.size_px as usize
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
    /// Its rows, as many as the columns of a tile.
    pub(super) fn rows(&self) -> usize {
        self.tiles.first().map_or(0, NewTile::size)
    }

    /// Its columns.
    pub(super) fn columns(&self) -> usize {
        self.tiles.len() * self.rows()
    }

    /// Pages that this many of its rows take.
    pub(super) fn pages(&self, rows: usize) -> usize {
        (self.row_bytes() * rows).div_ceil(PAGE_BYTES)
    }

    /// Bytes of a row in staging memory.
    pub(super) fn row_bytes(&self) -> usize {
        (self.columns() * size_of::<f32>()).next_multiple_of(ROW_ALIGNMENT)
    }
}

/// Divides tiles into strips: a copy takes as long as hundreds of texels, and most tiles have fewer.
pub(super) fn strips(tiles: &[NewTile]) -> impl Iterator<Item = Strip<'_>> {
    let runs = tiles.chunk_by(NewTile::is_followed_by);
    runs.flat_map(|run| run.chunks((MAX_STRIP_COLUMNS / run[0].size().max(1)).max(1)))
        .map(|tiles| Strip { tiles })
}

/// Divides tiles into parts of at most `max_bytes` in staging memory each, or of a single strip.
pub fn upload_parts(tiles: &[NewTile], max_bytes: usize) -> impl Iterator<Item = &[NewTile]> {
    let mut rest = tiles;
    std::iter::from_fn(move || {
        let mut bytes = 0;
        let fitting = strips(rest).take_while(|strip| {
            bytes += strip.pages(strip.rows()) * PAGE_BYTES;
            bytes <= max_bytes
        });
        let count: usize = fitting.map(|strip| strip.tiles.len()).sum();
        let first = strips(rest).next().map_or(0, |strip| strip.tiles.len());
        let (part, others) = rest.split_at(count.max(first));
        rest = others;
        (!part.is_empty()).then_some(part)
    })
}

/// The layout of tiles in staging memory, one strip after the other: the region of the map that each is copied to, and the bytes of
/// all.
#[must_use]
pub fn upload_regions(tiles: &[NewTile]) -> (Vec<TextureRegion>, usize) {
    let mut end = 0;
    let region = |strip: Strip<'_>| {
        let offset_bytes = end;
        end += strip.pages(strip.rows()) * PAGE_BYTES;
        TextureRegion {
            offset_bytes,
            row_bytes: strip.row_bytes(),
            origin: strip.tiles[0].tile.origin_px.as_uvec2().to_array(),
            size: [strip.columns() as u32, strip.rows() as u32],
        }
    };
    (strips(tiles).map(region).collect(), end)
}
