//! The caster grid: for each cell of ground, which casters and whether the horizon map can shadow a surface above it.
//!
//! A uniform grid with a list for each cell, as in tiled light culling (Real-Time Rendering, 4th ed., section 20.3), with casters
//! in place of lights. It is stored as compressed sparse rows: the offsets of the cells' lists, then the lists one after the other.
//! What the horizon map tells of the ground comes in as plain points, so that imports go from `shadow/` to `select/` and not back.
//! Must not know: how shadow and horizon map are made.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8};
use glam::Vec2;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::pool::PooledVec;
use crate::render::device::shading_bins::ShadowSources;
use crate::render::select::casters::Caster;
use crate::render::select::footprint::Footprint;
use crate::render::select::shadow_strip::{Rays, ShadowStrip};
use crate::scene::Scene;
use crate::scene::terrain::{Layout, Terrain};

/// Cells along a side of the grid over a square of ground.
const SQUARE_CELLS: u32 = 512;
/// Cells along a side of each of the nested grids over rings.
const RING_CELLS: u32 = 192;
/// Half the side of the innermost grid over rings, metres.
const INNERMOST_M: f32 = 4.0;
/// Most entries of the lists of all cells together: with their offsets they fit into the 128 MiB that every device binds.
const MAX_LISTED: usize = 32_000_000;
/// Minimum casters of a task: fewer are not worth a thread.
const MIN_CASTERS_PER_TASK: usize = 128;
/// Rows of a grid that one thread fills.
const BAND_ROWS: usize = 32;
/// Cells along a side of a block, whose range of heights decides most tests without a look at its cells: the lanes of a vector.
const BLOCK_CELLS: usize = 8;
const _: () = assert!(BAND_ROWS.is_multiple_of(BLOCK_CELLS) && RING_CELLS.is_multiple_of(BLOCK_CELLS as u32));
/// Set in the offset of a cell's list if the ground may occlude the sun from a surface above the cell. Stands in
/// `common/shadow_map.wgsl` too.
pub const TEST_HORIZON: u32 = 1 << 31;

/// Where other ground may occlude the sun, from the horizon map.
#[derive(Clone, Copy, Debug)]
pub struct ShadowedGround<'a> {
    /// Points seen from above, world, metres. Elsewhere nothing on a square ground, or above it, is shadowed by ground.
    pub points: &'a [Vec2],
    /// A point stands for all that is less than this far from it along x and y, metres.
    pub margin_m: f32,
}

/// Nested square grids over the ground around one centre, each over twice the side of the one before.
#[derive(Clone, Copy, Debug)]
pub struct CasterGrids {
    /// The common centre, world, metres.
    pub centre: Vec2,
    /// Half the side of the innermost grid, metres.
    pub half_m: f32,
    /// Cells along a side of each grid.
    pub cells: u32,
    /// Number of grids.
    pub levels: u32,
}

impl CasterGrids {
    /// The grids over a ground: a single one for a square.
    #[must_use]
    pub fn new(terrain: &Terrain) -> Self {
        let (centre, reach_m) = (terrain.centre, terrain.half_extent_m);
        match terrain.layout {
            Layout::Square => Self { centre, half_m: reach_m, cells: SQUARE_CELLS, levels: 1 },
            Layout::Rings(_) => {
                let mut levels = 1;
                while reach_m > INNERMOST_M * (1_u32 << (levels - 1)) as f32 {
                    levels += 1;
                }
                Self { centre, half_m: INNERMOST_M, cells: RING_CELLS, levels }
            }
        }
    }

    /// What can shadow a surface within a rectangle of the map: lowest and highest corner, world, metres.
    #[must_use]
    pub fn shadow_sources_over(&self, grid: &[u32], low: Vec2, high: Vec2) -> ShadowSources {
        let (from, to) = (low - self.centre, high - self.centre);
        // Distances along the axes (Chebyshev's) of the nearest and the furthest point of the rectangle.
        let nearest = Vec2::ZERO.clamp(from, to).abs().max_element();
        let furthest = from.abs().max(to.abs()).max_element();
        let (mut has_casters, mut tests_horizon) = (false, false);
        for level in 0..self.levels {
            let half_m = self.half_m * (1_u32 << level) as f32;
            // With a margin, here and for the cells: near a border a device may round to the other side of it than the host.
            let serves = (level == 0 || furthest * 1.001 >= 0.5 * half_m)
                && (level + 1 == self.levels || nearest <= 1.001 * half_m);
            if !serves {
                continue;
            }
            let cells_per_m = 0.5 * self.cells as f32 / half_m;
            let cell = |metres: f32, margin: f32| {
                let coordinate = (metres + half_m) * cells_per_m + margin;
                coordinate.floor().clamp(0.0, (self.cells - 1) as f32) as u32
            };
            for row in cell(from.y, -1e-3)..=cell(to.y, 1e-3) {
                for column in cell(from.x, -1e-3)..=cell(to.x, 1e-3) {
                    let cell = ((level * self.cells + row) * self.cells + column) as usize;
                    has_casters |= grid[cell] & !TEST_HORIZON != grid[cell + 1] & !TEST_HORIZON;
                    tests_horizon |= grid[cell] & TEST_HORIZON != 0;
                }
            }
        }
        match (has_casters, tests_horizon) {
            (false, false) => ShadowSources::None,
            (false, true) => ShadowSources::Ground,
            (true, false) => ShadowSources::Rocks,
            (true, true) => ShadowSources::GroundAndRocks,
        }
    }

    /// Cells of all grids together.
    #[must_use]
    pub const fn cell_count(&self) -> usize {
        (self.cells * self.cells) as usize * self.levels as usize
    }
}

/// The casters that can shade each cell of a footprint: the part of the caster grid that does not depend on the horizon map.
pub struct CasterCells {
    grids: CasterGrids,
    /// Level by level and row by row.
    bands: Vec<CasterLists>,
}

impl CasterCells {
    /// The lists of the cells that lie in a footprint.
    ///
    /// # Errors
    /// [`Error::Contradiction`] if they are longer than devices bind.
    pub fn new(scene: &Scene, casters: &[Caster], footprint: &Footprint) -> Result<Self> {
        Self::within(scene, casters, footprint, MAX_LISTED)
    }

    /// The same with a limit on the entries of all lists together.
    fn within(scene: &Scene, casters: &[Caster], footprint: &Footprint, max_listed: usize) -> Result<Self> {
        let grids = CasterGrids::new(&scene.terrain);
        let bands: Vec<_> = (0..grids.levels)
            .flat_map(|level| (0..grids.cells as usize).step_by(BAND_ROWS).map(move |row| (level, row)))
            .collect();
        let rays = Rays::new(&scene.sun);
        let rows_m = casters.par_iter().with_min_len(MIN_CASTERS_PER_TASK);
        let rows_m: Vec<[f32; 2]> = rows_m.map(|caster| ShadowStrip::rows_m(scene, &rays, caster)).collect();
        let listed = AtomicUsize::new(0);
        let lists_of = |(level, first): (u32, usize)| {
            let rows = first..(first + BAND_ROWS).min(grids.cells as usize);
            let band = GridBand::new(&scene.terrain, &grids, level, rows, footprint);
            band.caster_lists((scene, &rays), casters, &rows_m, (&listed, max_listed))
        };
        let bands = bands.into_par_iter().with_max_len(1).map(lists_of).collect();
        if listed.into_inner() > max_listed {
            return Err(Error::Contradiction(format!(
                "the shadows of the {} rocks that reach the view overlap so much that a device cannot hold their lists; \
                 choose fewer or smaller rocks (rocks.count, rocks.scale_m, rocks.large_factor, rocks.coverage) or a higher sun \
                 (sun.elevation_deg)",
                casters.len()
            )));
        }
        Ok(Self { grids, bands })
    }

    /// The caster grid as compressed sparse rows: the offset of each cell's list, level by level and row by row, the end of the last
    /// list, then the lists of indices of casters. An offset has [`TEST_HORIZON`] set where the horizon map is to be sampled too.
    #[must_use]
    pub fn grid(&self, shadowed_ground: ShadowedGround<'_>) -> PooledVec<u32> {
        join_lists(&self.grids, &self.bands, &horizon_flags(&self.grids, shadowed_ground))
    }
}

/// Joins the lists of all bands, in order, and sets the flags of the cells' offsets.
fn join_lists(grids: &CasterGrids, bands: &[CasterLists], horizon_flags: &[u8]) -> PooledVec<u32> {
    let offset_count = grids.cell_count() + 1;
    let listed: usize = bands.iter().map(|band| band.casters.len()).sum();
    let mut grid: PooledVec<u32> = PooledVec::unspecified(offset_count + listed);
    let (mut offsets, mut lists) = grid.split_at_mut(offset_count);
    let (mut start, mut flags) = (offset_count as u32, horizon_flags);
    let mut parts = Vec::new();
    for band in bands {
        let (own_offsets, other_offsets) = offsets.split_at_mut(band.ends.len());
        let (own_lists, other_lists) = lists.split_at_mut(band.casters.len());
        let (own_flags, other_flags) = flags.split_at(band.ends.len());
        parts.push((band, start, own_offsets, own_flags, own_lists));
        start += band.casters.len() as u32;
        (offsets, lists, flags) = (other_offsets, other_lists, other_flags);
    }
    offsets[0] = start;
    parts.into_par_iter().for_each(|(band, start, offsets, flags, lists)| {
        // A list begins where the one before ends.
        if let Some((first, others)) = offsets.split_first_mut() {
            *first = start;
            for (offset, end) in others.iter_mut().zip(&band.ends) {
                *offset = start + end;
            }
        }
        for (offset, flag) in offsets.iter_mut().zip(flags) {
            *offset |= if *flag == 1 { TEST_HORIZON } else { 0 };
        }
        lists.copy_from_slice(&band.casters);
    });
    grid
}

/// Of each cell, 1 if ground may occlude the sun from a surface above it, else 0.
fn horizon_flags(grids: &CasterGrids, ground: ShadowedGround<'_>) -> PooledVec<u8> {
    // Rings have relief everywhere.
    let mut flags = PooledVec::filled(grids.cell_count(), u8::from(grids.levels > 1));
    if grids.levels == 1 {
        let side = grids.cells as usize;
        let (origin, cell_m) = (grids.centre - grids.half_m, 2.0 * grids.half_m / grids.cells as f32);
        let cell = |metres: f32, axis: usize| cell_index(metres - origin[axis], cell_m, side).min(side - 1);
        let margin = Vec2::splat(ground.margin_m);
        for point in ground.points {
            let (low, high) = (*point - margin, *point + margin);
            for row in cell(low.y, 1)..=cell(high.y, 1) {
                flags[row * side + cell(low.x, 0)..=row * side + cell(high.x, 0)].fill(1);
            }
        }
    }
    flags
}

/// Index of the column or row at a distance from the edge of a grid; `cells` for what lies beyond the other edge.
fn cell_index(metres: f32, cell_m: f32, cells: usize) -> usize {
    (metres / cell_m).clamp(0.0, cells as f32) as usize
}

/// The caster lists of some cells, one after the other.
struct CasterLists {
    /// End of the list of each cell.
    ends: PooledVec<u32>,
    /// Indices of casters.
    casters: PooledVec<u32>,
}

/// Some rows of one of the grids, while their lists are made.
struct GridBand<'a> {
    terrain: &'a Terrain,
    /// Cells along a side of the grid.
    cells: usize,
    cell_m: f32,
    /// Lowest corner of the grid, world, metres.
    origin: Vec2,
    rows: Range<usize>,
    /// Columns and rows that the next finer grid covers; their cells here are never looked up.
    finer: Range<usize>,
    /// Of each cell, a lower bound of the height of its ground, metres; NaN until it is computed.
    min_ground_m: PooledVec<f32>,
    /// Of each block, bounds of the height of its ground, metres; NaN until they are computed.
    block_range_m: Vec<[f32; 2]>,
    /// Of each row, the columns that may be looked up.
    spans: Vec<Range<usize>>,
}

impl<'a> GridBand<'a> {
    fn new(
        terrain: &'a Terrain,
        grids: &CasterGrids,
        level: u32,
        rows: Range<usize>,
        footprint: &Footprint,
    ) -> Self {
        let half_m = grids.half_m * (1_u32 << level) as f32;
        let cells = grids.cells as usize;
        let mut band = Self {
            terrain,
            cells,
            cell_m: 2.0 * half_m / grids.cells as f32,
            origin: grids.centre - half_m,
            // Without those along its border: there a device may round to the other side of it than the host.
            finer: if level == 0 { 0..0 } else { cells / 4 + 1..cells - cells / 4 - 1 },
            min_ground_m: PooledVec::filled(rows.len() * cells, f32::NAN),
            block_range_m: vec![
                [f32::NAN; 2];
                rows.len().div_ceil(BLOCK_CELLS) * cells.div_ceil(BLOCK_CELLS)
            ],
            spans: Vec::new(),
            rows: rows.clone(),
        };
        band.spans = rows.map(|row| band.span(row, footprint)).collect();
        band
    }

    /// Columns of a row that a footprint touches, and one to each side. The first and the last row also serve what juts out over
    /// the border of the ground.
    fn span(&self, row: usize, footprint: &Footprint) -> Range<usize> {
        let edge_m = |row: usize| self.origin.y + row as f32 * self.cell_m;
        let south_m = if row == 0 { f32::MIN } else { edge_m(row - 1) };
        let north_m = if row + 1 == self.cells { f32::MAX } else { edge_m(row + 2) };
        footprint.span(south_m, north_m).map_or(0..0, |[low, high]| {
            let last = self.cell_index(high + self.cell_m, 0).min(self.cells - 1);
            self.cell_index(low - self.cell_m, 0).min(last)..last + 1
        })
    }

    /// Column (axis 0) or row (axis 1) of a coordinate, which may lie outside.
    fn cell_index(&self, metres: f32, axis: usize) -> usize {
        cell_index(metres - self.origin[axis], self.cell_m, self.cells)
    }

    /// The lists of the cells, the casters of each in rising order: a counting sort by cell. `rows_m` has lowest and highest y of the
    /// shadow of each caster. Counts what it lists, and leaves off once all bands together have more than the limit.
    fn caster_lists(
        mut self,
        (scene, rays): (&Scene, &Rays),
        casters: &[Caster],
        rows_m: &[[f32; 2]],
        (listed, max_listed): (&AtomicUsize, usize),
    ) -> CasterLists {
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        let edge_m = |row: usize| self.origin.y + row as f32 * self.cell_m;
        // With a margin for the rounding of rows; the first and the last also serve what lies beyond the border.
        let south_m = if self.rows.start == 0 { f32::MIN } else { edge_m(self.rows.start) - self.cell_m };
        let north_m =
            if self.rows.end == self.cells { f32::MAX } else { edge_m(self.rows.end) + self.cell_m };
        let is_unused = self.spans.iter().all(Range::is_empty);
        for (index, [low_m, high_m]) in (0..).zip(if is_unused { &[] } else { rows_m }) {
            if *high_m < south_m || *low_m > north_m {
                continue;
            }
            let strip = ShadowStrip::new(scene, rays, &casters[index as usize], self.cell_m);
            let before = pairs.len();
            dispatch!(Level::new(), simd => {
                self.for_cells_shadowed_by(simd, &strip, |cell| pairs.push((cell as u32, index)));
            });
            let added = pairs.len() - before;
            if listed.fetch_add(added, Ordering::Relaxed) + added > max_listed {
                break;
            }
        }
        let mut ends = PooledVec::filled(self.rows.len() * self.cells, 0);
        let mut casters: PooledVec<u32> = PooledVec::unspecified(pairs.len());
        if pairs.is_empty() {
            return CasterLists { ends, casters };
        }
        for &(cell, _) in &pairs {
            ends[cell as usize] += 1;
        }
        // Counts become starts (a prefix sum), and starts become ends as the lists are filled.
        let mut start = 0;
        for end in &mut ends {
            let count = std::mem::replace(end, start);
            start += count;
        }
        for (cell, index) in pairs {
            let end = &mut ends[cell as usize];
            casters[*end as usize] = index;
            *end += 1;
        }
        CasterLists { ends, casters }
    }

    /// Calls `visit` with every cell of the band, by its index from the first, in which the shadow of a caster can touch the ground
    /// or what stands on it.
    #[inline(always)]
    fn for_cells_shadowed_by<S: Simd>(
        &mut self,
        simd: S,
        strip: &ShadowStrip<'_>,
        mut visit: impl FnMut(usize),
    ) {
        let rows = self.cell_index(strip.low.y, 1).max(self.rows.start)
            ..(self.cell_index(strip.high.y, 1) + 1).min(self.rows.end);
        let lanes = f32x8::from_slice(simd, &[0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5]);
        for row in rows {
            let span = self.spans[row - self.rows.start].clone();
            let y = (row as f32 + 0.5) * self.cell_m + self.origin.y - strip.start.y;
            let (west_m, east_m) = strip.span_in_row(y, self.cell_m);
            let columns =
                self.cell_index(west_m, 0).max(span.start)..(self.cell_index(east_m, 0) + 1).min(span.end);
            let finer = if self.finer.contains(&row) { self.finer.clone() } else { 0..0 };
            // By blocks of columns.
            for first in (columns.start / BLOCK_CELLS * BLOCK_CELLS..columns.end).step_by(BLOCK_CELLS) {
                let x = (lanes + first as f32) * self.cell_m + self.origin.x - strip.start.x;
                let mut rays_m = [0.0; BLOCK_CELLS];
                strip.highest_rays_m(simd, x, f32x8::splat(simd, y)).store_slice(&mut rays_m);
                for (column, ray_m) in (first..).zip(rays_m) {
                    let is_looked_up = columns.contains(&column) && !finer.contains(&column);
                    // Unless even the highest ray that the caster can have blocked runs below the ground here.
                    if is_looked_up && ray_m > f32::MIN && self.reaches_ground(column, row, ray_m) {
                        visit((row - self.rows.start) * self.cells + column);
                    }
                }
            }
        }
    }

    /// Whether a ray at this height does not run below [`Self::min_ground_m`] of a cell.
    fn reaches_ground(&mut self, column: usize, row: usize, ray_m: f32) -> bool {
        let [lowest_m, highest_m] = self.block_range_m(column, row);
        ray_m >= highest_m || (ray_m >= lowest_m && ray_m >= self.min_ground_m(column, row))
    }

    /// Bounds of the height of the ground in the block of a cell, metres.
    fn block_range_m(&mut self, column: usize, row: usize) -> [f32; 2] {
        let block = [column / BLOCK_CELLS, (row - self.rows.start) / BLOCK_CELLS];
        let known = &mut self.block_range_m[block[1] * self.cells.div_ceil(BLOCK_CELLS) + block[0]];
        if known[0].is_nan() {
            let corner = Vec2::new(block[0] as f32, block[1] as f32) * BLOCK_CELLS as f32;
            let low = (corner + Vec2::new(0.0, self.rows.start as f32)) * self.cell_m + self.origin;
            // With a margin for the rounding of the cells' corners.
            let margin_m = 0.01 * self.cell_m;
            let high = low + BLOCK_CELLS as f32 * self.cell_m + margin_m;
            *known = self.terrain.z_range_over(low - margin_m, high);
        }
        *known
    }

    /// A lower bound of the height of the ground in a cell, metres.
    fn min_ground_m(&mut self, column: usize, row: usize) -> f32 {
        let known = &mut self.min_ground_m[(row - self.rows.start) * self.cells + column];
        if known.is_nan() {
            let low = Vec2::new(column as f32, row as f32) * self.cell_m + self.origin;
            *known = self.terrain.lowest_over(low, low + self.cell_m);
        }
        *known
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::render::select::selection::Selection;
    use crate::render::settings::{DEFAULT_TEXTURE_PX, RenderSettings};

    #[test]
    fn lists_beyond_the_limit_are_an_error_that_names_the_knobs() {
        let scene = Scene::build(3, &crate::params::Params::draw_default(3)).expect("a scene");
        let settings = RenderSettings::new([64; 2], 1).expect("settings");
        let selection = Selection::within(&scene, &settings, DEFAULT_TEXTURE_PX);
        let footprint = Footprint::new(&scene, &selection);
        let within = |max_listed| CasterCells::within(&scene, &selection.casters, &footprint, max_listed);
        let listed: usize =
            within(MAX_LISTED).expect("lists").bands.iter().map(|band| band.casters.len()).sum();
        assert!(listed > 100 && within(listed).is_ok());
        let error = within(listed - 1).err().expect("an error");
        assert!(error.to_string().contains("rocks.count") && error.exit_status() == 2, "{error}");
    }

    #[test]
    fn heights_of_blocks_decide_as_those_of_cells_do() {
        for set in ["stage.name=nominal", "stage.name=surface"] {
            let mut config = Config::default();
            config.apply_set(set).expect("a knob");
            let scene = Scene::build(3, &config.draw(3).expect("knobs")).expect("a scene");
            let grids = CasterGrids::new(&scene.terrain);
            for level in 0..grids.levels {
                let cells = grids.cells as usize;
                let rows = cells / 2 - BAND_ROWS..cells / 2;
                let footprint = Footprint::default();
                let mut band = GridBand::new(&scene.terrain, &grids, level, rows.clone(), &footprint);
                for (row, column) in rows.flat_map(|row| (0..cells).map(move |column| (row, column))) {
                    let lowest_m = band.min_ground_m(column, row);
                    let [below_m, above_m] = band.block_range_m(column, row);
                    assert!(
                        below_m <= lowest_m && lowest_m <= above_m,
                        "{set}, level {level}: {column}, {row}"
                    );
                    assert!(band.reaches_ground(column, row, lowest_m));
                    assert!(!band.reaches_ground(column, row, lowest_m.next_down()));
                }
            }
        }
    }
}
