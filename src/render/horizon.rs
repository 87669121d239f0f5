//! From which height the sun is seen past the ground: the map that lets the ground cast its shadows.
//!
//! For places on a grid that is aligned with the sun the map says from which height each limb of the sun is just seen
//! past all the ground between. Along a row, which runs towards the sun, the height falls from sample to sample by the
//! limb's slope, and rises to the ground where that is higher: one running maximum (the horizon map of Max 1988,
//! "Horizon mapping: shadows for bump-mapped surfaces", for a single azimuth, kept as a height so that it serves things
//! above the ground).
//!
//! A square of ground has one grid. Rings have several, each over the places within a distance that doubles from grid
//! to grid, with samples as far apart as the cells there; where a finer grid ends towards the sun it goes on from the
//! coarser.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use glam::Vec2;
use rayon::prelude::*;

use super::footprint::Footprint;
use super::shaders::HorizonLevel;
use crate::scene::noise::floor;
use crate::scene::sky::Sun;
use crate::scene::terrain::{Layout, Terrain};

/// Samples of the map per cell of a square of ground.
const SAMPLES_PER_CELL: f32 = 3.0;
/// Samples of the map per cell of rings, at the distance where a grid ends; half as many where it begins.
const SAMPLES_PER_RING_CELL: f32 = 2.0;
/// Most samples along a side of the map.
const MOST_SAMPLES: u32 = 2048;
/// Distance that the finest grid over rings serves, metres.
const FINEST_M: f32 = 5.0;
/// How far ground may stand out of what a coarser grid knows of it, steps of the grid: a grid begins so far before what is
/// asked for that this throws no shadow into it. With three times as much, pictures with the sun 2 to 17 degrees high were the
/// same to the bit; with half as much, some were not.
const DETAIL_STEPS: f32 = 9.0;
/// But no more samples than this.
const MOST_BEYOND: f32 = 512.0;
/// Beyond everything, metres.
const FARTHEST_M: f32 = 1e9;
/// Most grids. Stands in `common/frame.wgsl` too.
pub const MOST_LEVELS: usize = 12;
/// Lowest limb that is reckoned with, degrees.
const LOWEST_LIMB_DEG: f64 = 0.01;

/// The map: its grids, the finest first.
#[derive(Clone, Debug)]
pub struct HorizonMap {
    /// Horizontal unit vector towards the sun, along the rows.
    pub towards: Vec2,
    /// Place that distances are reckoned from, metres.
    pub centre: Vec2,
    /// Distance that the first grid serves, metres; the next ones twice as far each.
    pub base_m: f32,
    /// The grids.
    pub levels: Vec<HorizonLevel>,
    /// Samples in a row of [`Self::heights_m`], in which the grids stand one below the other.
    pub width: u32,
    /// Height for the lower and for the upper limb, metres.
    pub heights_m: Vec<[f32; 2]>,
    /// Of a square: places, metres, within a step of which the ground may hide any of the sun from what lies on it or above.
    pub shaded: Vec<Vec2>,
}

/// The lattice of a grid over the whole ground, aligned with the sun.
struct Frame<'a> {
    terrain: &'a Terrain,
    /// The heights of a square ground.
    square: Option<&'a Square>,
    towards: Vec2,
    across: Vec2,
    origin: Vec2,
    step_m: f32,
    samples: usize,
    /// How far each limb's ray falls in a step, metres.
    fall_m: [f32; 2],
}

/// Which samples of a grid are asked for.
struct Region {
    columns: Range<usize>,
    rows: Range<usize>,
    /// Of each row, the columns.
    spans: Vec<Range<usize>>,
}

/// One grid while it is made.
struct Grid {
    origin: Vec2,
    step_m: f32,
    size: [usize; 2],
    heights_m: Vec<[f32; 2]>,
    shaded: Vec<Vec2>,
}

impl HorizonMap {
    /// The map of a ground and a sun over the part of it that is asked for: what is seen. Samples lie where they would in a map
    /// of the whole ground, and of a square have the values that they would have there.
    #[must_use]
    pub fn build(terrain: &Terrain, sun: &Sun, footprint: &Footprint) -> Self {
        let azimuth = sun.azimuth_deg.to_radians();
        let towards = Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32);
        let reach_m = terrain.half_extent_m;
        let mut base_m = FARTHEST_M;
        let mut steps_m = Vec::new();
        match &terrain.layout {
            Layout::Square => {
                let side_m = 2.0 * reach_m * (towards.x.abs() + towards.y.abs());
                steps_m.push((terrain.cell_m() / SAMPLES_PER_CELL).max(side_m / (MOST_SAMPLES - 2) as f32));
            }
            Layout::Rings(rings) => {
                base_m = FINEST_M.max(reach_m / (1_u32 << (MOST_LEVELS - 1)) as f32);
                let mut end_m = base_m;
                loop {
                    steps_m.push(rings.cell_m(end_m.min(reach_m)) / SAMPLES_PER_RING_CELL);
                    if end_m >= reach_m {
                        break;
                    }
                    end_m *= 2.0;
                }
            }
        }
        let square = matches!(terrain.layout, Layout::Square).then(|| Square::new(terrain));
        let mut grids: Vec<Grid> = Vec::new();
        for (level, &step_m) in steps_m.iter().enumerate().rev() {
            let frame = Frame::new(terrain, square.as_ref(), sun, towards, step_m);
            let end_m = if steps_m.len() == 1 { FARTHEST_M } else { base_m * (1_u32 << level) as f32 };
            // As many steps before what is asked for as ground that stands out by its detail throws shadows.
            let beyond = (DETAIL_STEPS * step_m / frame.fall_m[0].max(1e-6)).min(MOST_BEYOND).ceil();
            let finer_m = level.checked_sub(1).map_or(0.0, |finer| beyond * steps_m[finer]);
            // A finer grid asks for the places that it begins at.
            let asked = if level == 0 { 0.0 } else { (finer_m / step_m).ceil() + 2.0 };
            let region = frame.region(&footprint.within(terrain.centre, end_m), asked);
            let grid = match grids.last() {
                None => frame.first(&region),
                Some(coarser) => frame.within(&region, coarser, beyond as usize),
            };
            grids.push(grid);
        }
        grids.reverse();
        Self::joined(grids, towards, terrain.centre, base_m)
    }

    fn joined(grids: Vec<Grid>, towards: Vec2, centre: Vec2, base_m: f32) -> Self {
        let width = grids.iter().map(|grid| grid.size[0]).max().unwrap_or(2);
        let mut map = Self {
            towards,
            centre,
            base_m,
            levels: Vec::new(),
            width: width as u32,
            heights_m: Vec::new(),
            shaded: Vec::new(),
        };
        for grid in grids {
            map.levels.push(HorizonLevel {
                origin: grid.origin,
                step_m: grid.step_m,
                first_row: (map.heights_m.len() / width) as u32,
                size: grid.size.map(|side| side as u32),
                reserved: [0; 2],
            });
            if map.heights_m.is_empty() && grid.size[0] == width {
                map.heights_m = grid.heights_m;
            } else {
                for row in grid.heights_m.chunks(grid.size[0]) {
                    map.heights_m.extend(row);
                    map.heights_m.resize(map.heights_m.len() + width - row.len(), [0.0; 2]);
                }
            }
            map.shaded.extend(grid.shaded);
        }
        map
    }

    /// Rows of [`Self::heights_m`].
    #[must_use]
    pub fn height(&self) -> u32 {
        (self.heights_m.len() / self.width as usize) as u32
    }
}

impl<'a> Frame<'a> {
    fn new(terrain: &'a Terrain, square: Option<&'a Square>, sun: &Sun, towards: Vec2, step_m: f32) -> Self {
        let across = Vec2::new(-towards.y, towards.x);
        // The turned square that holds the ground.
        let side_m = 2.0 * terrain.half_extent_m * (towards.x.abs() + towards.y.abs());
        let samples = (side_m / step_m).ceil() as usize + 2;
        let origin = terrain.centre - 0.5 * (samples - 1) as f32 * step_m * (towards + across);
        let half_disc = 0.5 * sun.angular_diameter_deg;
        let fall_m = [-half_disc, half_disc].map(|offset| {
            let limb = (sun.elevation_deg + offset).clamp(LOWEST_LIMB_DEG, 89.9).to_radians();
            libm::tan(limb) as f32 * step_m
        });
        Self { terrain, square, towards, across, origin, step_m, samples, fall_m }
    }

    /// The samples around a part of the ground, and so many further towards the sun.
    fn region(&self, footprint: &Footprint, beyond: f32) -> Region {
        let footprint = footprint.mapped(|corner| {
            let offset = (corner - self.origin) / self.step_m;
            Vec2::new(offset.dot(self.towards), offset.dot(self.across))
        });
        let corners = &footprint.corners;
        let first = |at: f32| (at.floor() - 1.0).clamp(0.0, (self.samples - 2) as f32) as usize;
        let end = |at: f32| (at.ceil() + 2.0).clamp(2.0, self.samples as f32) as usize;
        let samples = |low: f32, high: f32| first(low)..end(high).max(first(low) + 2);
        let lowest = corners.iter().copied().reduce(Vec2::min).unwrap_or_default();
        let highest = corners.iter().copied().reduce(Vec2::max).unwrap_or_default();
        let rows = samples(lowest.y, highest.y);
        let spans = rows
            .clone()
            .map(|row| {
                // Over as many rows to both sides as a place between two rows, or between two of a finer grid, may ask.
                let span = footprint.span(row as f32 - 3.0, row as f32 + 3.0);
                span.map_or(0..0, |[low, high]| samples(low, high + beyond))
            })
            .collect();
        Region { columns: samples(lowest.x, highest.x + beyond), rows, spans }
    }

    fn place(&self, column: usize, row: usize) -> Vec2 {
        self.origin + row as f32 * self.step_m * self.across + column as f32 * self.step_m * self.towards
    }

    /// Height of the ground at a place, far down where there is none.
    fn ground_m(&self, place: Vec2) -> f32 {
        if self.terrain.contains(place) { self.terrain.surface_height_at(place) } else { f32::MIN }
    }

    /// Height of the ground at samples of a row.
    fn ground_along(&self, row: usize, columns: Range<usize>) -> Vec<f32> {
        let Some(square) = self.square else {
            return columns.map(|column| self.ground_m(self.place(column, row))).collect();
        };
        let mut heights_m = vec![0.0; columns.len()];
        dispatch!(Level::new(), _simd => self.heights_along(square, row, columns.start, &mut heights_m));
        heights_m
    }

    // In three turns, of which the first and the last are the same for many samples at once; see `scene/noise.rs`.
    #[inline(always)]
    fn heights_along(&self, square: &Square, row: usize, first: usize, heights_m: &mut [f32]) {
        const AT_ONCE: usize = 64;
        let start = self.origin + row as f32 * self.step_m * self.across;
        for (turn, heights_m) in heights_m.chunks_mut(AT_ONCE).enumerate() {
            let first = (first + turn * AT_ONCE) as u32;
            let mut cells = [0; AT_ONCE];
            let (mut u, mut v) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
            for (i, ((cell, u), v)) in (0..).zip(cells.iter_mut().zip(&mut u).zip(&mut v)) {
                let place = start + (first + i) as f32 * self.step_m * self.towards;
                (*cell, [*u, *v]) = square.cell_at(place);
            }
            for (height_m, ((cell, u), v)) in heights_m.iter_mut().zip(cells.iter().zip(&u).zip(&v)) {
                *height_m = square.height_in(*cell, *u, *v);
            }
        }
    }

    /// The coarsest grid: its rows begin where no ground further off is high enough to hide the sun.
    fn first(&self, region: &Region) -> Grid {
        let [lowest_m, highest_m] = self.terrain.z_range_m;
        let fall_m = self.fall_m[0].max(1e-6);
        let reach = ((highest_m - lowest_m) / fall_m).ceil().min(self.samples as f32) as usize + 2;
        let bends = self.square.map(|square| Bends::new(square, self.step_m));
        let start = |_, end: usize| ((end + reach).min(self.samples), [-1.0e9_f32; 2]);
        self.scan(region, start, bends.as_ref())
    }

    /// A grid whose rows go on from a coarser one, so many samples before what is asked for.
    fn within(&self, region: &Region, coarser: &Grid, beyond: usize) -> Grid {
        let start = |row, end| {
            let end = end + beyond;
            let place = self.place(end, row);
            let ground_m = self.ground_m(place);
            (end, raised(coarser.limbs_at(place, self.towards), ground_m))
        };
        self.scan(region, start, None)
    }

    /// Runs along every row of a region, from the column and with the heights that `start` gives for it and the end of its span.
    fn scan(
        &self,
        Region { columns, rows, spans }: &Region,
        start: impl Fn(usize, usize) -> (usize, [f32; 2]) + Sync,
        bends: Option<&Bends>,
    ) -> Grid {
        let mut heights_m = vec![[f32::MIN; 2]; columns.len() * rows.len()];
        let lines = heights_m.par_chunks_mut(columns.len()).zip(rows.clone()).zip(spans);
        let shaded = lines.map(|((heights, row), span)| {
            let mut shaded = Vec::new();
            if span.is_empty() {
                return shaded;
            }
            let (last, mut limbs) = start(row, span.end);
            let ground_m = self.ground_along(row, span.start..last);
            for (column, ground_m) in (span.start..last).zip(ground_m).rev() {
                limbs = [limbs[0] - self.fall_m[0], limbs[1] - self.fall_m[1]];
                if span.contains(&column) {
                    heights[column - columns.start] = limbs;
                    if let Some(bends) = bends
                        && ground_m > f32::MIN
                        && ground_m - limbs[0] <= bends.largest_m
                        && ground_m - limbs[0] <= bends.at(self.place(column, row))
                    {
                        shaded.push(self.place(column, row));
                    }
                }
                limbs = raised(limbs, ground_m);
            }
            shaded
        });
        let shaded = shaded.collect::<Vec<_>>().into_iter().flatten().collect();
        let size = [columns.len(), rows.len()];
        let offset = columns.start as f32 * self.towards + rows.start as f32 * self.across;
        Grid { origin: self.origin + self.step_m * offset, step_m: self.step_m, size, heights_m, shaded }
    }
}

/// The heights where ground stands at a place: what hides the lower limb from what lies beyond also tells how far the upper
/// one is hidden. (Lower ground that lies nearer would hide neither, but would cut the penumbra short.)
fn raised(limbs: [f32; 2], ground_m: f32) -> [f32; 2] {
    if ground_m > limbs[0] { [ground_m; 2] } else { limbs }
}

impl Grid {
    /// Heights for both limbs at a place, bilinear.
    fn limbs_at(&self, place: Vec2, towards: Vec2) -> [f32; 2] {
        let offset = (place - self.origin) / self.step_m;
        let limit = Vec2::new(self.size[0] as f32, self.size[1] as f32) - 1.001;
        let at = Vec2::new(offset.dot(towards), Vec2::new(-towards.y, towards.x).dot(offset));
        let at = at.clamp(Vec2::ZERO, limit);
        let (corner, t) = (at.floor(), at - at.floor());
        let height = |dx: usize, dy: usize| {
            self.heights_m[(corner.y as usize + dy) * self.size[0] + corner.x as usize + dx]
        };
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        [0, 1].map(|limb| {
            let row = |dy| mix(height(0, dy)[limb], height(1, dy)[limb], t.x);
            mix(row(0), row(1), t.y)
        })
    }
}

/// The heights of a square ground, close together: the map asks for half a million of them.
struct Square {
    cells: usize,
    cell_m: f32,
    cells_per_m: f32,
    half_m: f32,
    heights_m: Vec<f32>,
}

impl Square {
    fn new(terrain: &Terrain) -> Self {
        Self {
            cells: terrain.columns as usize,
            cell_m: terrain.cell_m(),
            cells_per_m: 1.0 / terrain.cell_m(),
            half_m: terrain.half_extent_m,
            heights_m: terrain.vertices.iter().map(|vertex| vertex.position.z).collect(),
        }
    }

    fn height(&self, column: usize, row: usize) -> f32 {
        self.heights_m[row * (self.cells + 1) + column]
    }

    /// The first vertex of the cell under a place, [`Self::OUTSIDE`] where there is none, and where in it the place lies.
    #[inline(always)]
    fn cell_at(&self, place: Vec2) -> (u32, [f32; 2]) {
        let last = self.cells as i32 - 1;
        let at = (place + self.half_m) * self.cells_per_m;
        let (column, row) = (floor(at.x).clamp(0, last), floor(at.y).clamp(0, last));
        let inside = place.x.abs().max(place.y.abs()) <= self.half_m;
        let vertex = (row * (last + 2) + column) as u32;
        (if inside { vertex } else { Self::OUTSIDE }, [at.x - column as f32, at.y - row as f32])
    }

    const OUTSIDE: u32 = u32::MAX;

    /// [`Terrain::surface_height_at`] a place of a cell, or far down outside.
    #[inline(always)]
    fn height_in(&self, vertex: u32, u: f32, v: f32) -> f32 {
        if vertex == Self::OUTSIDE {
            return f32::MIN;
        }
        let south = &self.heights_m[vertex as usize..][..self.cells + 3];
        let (h00, h11) = (south[0], south[self.cells + 2]);
        let (corner, near, far) = if u >= v { (south[1], u, v) } else { (south[self.cells + 1], v, u) };
        h00 + (corner - h00) * near + (h11 - corner) * far
    }
}

/// For each cell of a terrain, how far its ground may lie below the straight course between places a step apart.
///
/// Along a line the ground is straight but for kinks where it crosses the triangles' edges; a kink by J (change of
/// slope) within a step of length s takes it at most J s / 4 off the straight line. Two axes make twice that; the three
/// kinds of edges are added up over the cells around.
struct Bends {
    cells: usize,
    cell_m: f32,
    half_m: f32,
    bends_m: Vec<f32>,
    /// The largest of all.
    largest_m: f32,
}

impl Bends {
    fn new(square: &Square, step_m: f32) -> Self {
        let (cells, row_len) = (square.cells, square.cells + 1);
        let last = row_len - 1;
        let height = |column: usize, row: usize| square.height(column, row);
        // Changes of slope at a vertex, times a cell: along both axes and the diagonal.
        let kinks_at = |column: usize, row: usize| {
            let (west, east) = (column.saturating_sub(1), (column + 1).min(last));
            let (south, north) = (row.saturating_sub(1), (row + 1).min(last));
            let middle = 2.0 * height(column, row);
            (height(west, row) + height(east, row) - middle).abs()
                + (height(column, south) + height(column, north) - middle).abs()
                + (height(west, south) + height(east, north) - middle).abs()
        };
        // Largest over two cells each way: first along rows, then along columns.
        let wide = |at: usize, end: usize| at.saturating_sub(1)..=(at + 2).min(end);
        let scale = 0.5 * step_m / square.cell_m;
        let rows: Vec<Vec<f32>> = (0..row_len)
            .into_par_iter()
            .map(|row| {
                let kinks: Vec<f32> = (0..row_len).map(|column| scale * kinks_at(column, row)).collect();
                (0..cells).map(|column| wide(column, last).map(|c| kinks[c]).fold(0.0, f32::max)).collect()
            })
            .collect();
        let bends_m: Vec<f32> = (0..cells * cells)
            .into_par_iter()
            .map(|cell| wide(cell / cells, last).map(|row| rows[row][cell % cells]).fold(0.0, f32::max))
            .collect();
        let largest_m = bends_m.iter().copied().fold(0.0, f32::max);
        Self { cells, cell_m: square.cell_m, half_m: square.half_m, bends_m, largest_m }
    }

    fn at(&self, place: Vec2) -> f32 {
        let cell = |metres: f32| (((metres + self.half_m) / self.cell_m) as usize).min(self.cells - 1);
        self.bends_m[cell(place.y) * self.cells + cell(place.x)]
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "what is expected may be reckoned with std's functions")]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn horizon_of_a_ridge_falls_with_the_slope_of_each_limb() {
        // A ridge 4 m high along x = 0; the sun stands in the east (azimuth 90).
        let terrain = Terrain::from_height(200.0, 200, Vec::new(), |p| (4.0 - p.x.abs()).max(0.0));
        let sun = Sun::new(17.0, 90.0, 0.53, Vec3::ONE);
        let corners =
            [Vec2::splat(-100.0), Vec2::splat(100.0), Vec2::new(-100.0, 100.0), Vec2::new(100.0, -100.0)];
        let map = HorizonMap::build(&terrain, &sun, &Footprint::around(corners.into_iter()));
        let level = map.levels[0];
        // Beyond 13 m the shadow of the ridge has met the ground.
        for x in [-5.0_f32, -8.0, -12.0] {
            let column = ((x - level.origin.x) / level.step_m).round();
            let row = (level.size[1] / 2) as usize;
            let at = level.origin.x + column * level.step_m;
            let [lower, upper] = map.heights_m[row * map.width as usize + column as usize];
            for (height, limb_deg) in [(lower, 17.0 - 0.265), (upper, 17.0 + 0.265)] {
                let expected = 4.0 + at * f64::to_radians(limb_deg).tan() as f32;
                assert!((height - expected).abs() < 0.15, "x = {at}: {height} m for {expected} m");
            }
        }
    }
}
