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
use std::sync::{Arc, Weak};

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, i32x8};
use glam::Vec2;
use rayon::prelude::*;

use crate::render::device::shader_structs::HorizonLevel;
use crate::render::select::caster_grid::ShadowedGround;
use crate::render::select::footprint::Footprint;
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
pub const MAX_LEVELS: usize = 12;
/// Lowest limb that is reckoned with, degrees.
const LOWEST_LIMB_DEG: f64 = 0.01;

/// Rows that are run along at once.
const LANES: usize = 8;

/// The map: its grids, the finest first. Made again and again for its memory, and for what stays as it was.
#[derive(Clone, Debug, Default)]
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
    shaded: Vec<Vec2>,
    /// Memory of grids that were made.
    spare: Vec<Vec<[f32; 2]>>,
    made_of: Option<MadeOf>,
    /// The last ground that was a square.
    square: Square,
}

/// What a map is of.
#[derive(Clone, Debug)]
struct MadeOf {
    /// Keeps the ground's address from being given to another, but not the ground.
    terrain: Weak<Terrain>,
    sun: Sun,
    /// Whether it is of all of the ground.
    is_whole: bool,
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
    first: Vec2,
    step_m: f32,
    size: [usize; 2],
    heights_m: Vec<[f32; 2]>,
    shaded: Vec<Vec2>,
}

impl HorizonMap {
    /// Becomes that of a ground and a sun over the part of it that is asked for: what is seen. Samples lie where they would in a
    /// map of the whole ground, and of a square have the values that they would have there: where a square and its sun are what
    /// they were it becomes that map, once. Tells whether it changed.
    pub fn update(&mut self, terrain: &Arc<Terrain>, sun: &Sun, footprint: &Footprint) -> bool {
        let known = self.made_of.take().filter(|known| {
            matches!(terrain.layout, Layout::Square)
                && known.terrain.ptr_eq(&Arc::downgrade(terrain))
                && known.sun == *sun
        });
        let (is_same, was_whole) = (known.is_some(), known.is_some_and(|known| known.is_whole));
        self.made_of = Some(MadeOf { terrain: Arc::downgrade(terrain), sun: *sun, is_whole: is_same });
        if was_whole {
            return false;
        }
        if is_same {
            let beyond = 2.0 * terrain.half_extent_m;
            let corners = [Vec2::ONE, Vec2::NEG_ONE, Vec2::new(1.0, -1.0), Vec2::new(-1.0, 1.0)];
            let corners = corners.into_iter().map(|corner| terrain.centre + beyond * corner);
            self.make_over(terrain, sun, &Footprint::around(corners));
        } else {
            self.make_over(terrain, sun, footprint);
        }
        true
    }

    fn make_over(&mut self, terrain: &Arc<Terrain>, sun: &Sun, footprint: &Footprint) {
        let azimuth = sun.azimuth_deg.to_radians();
        let towards = Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32);
        let reach_m = terrain.half_extent_m;
        let mut base_m = FARTHEST_M;
        let mut steps_m = Vec::new();
        match &terrain.layout {
            Layout::Square => {
                let side_m = 2.0 * reach_m * (towards.x.abs() + towards.y.abs());
                let step_m = (terrain.cell_m() / SAMPLES_PER_CELL).max(side_m / (MOST_SAMPLES - 2) as f32);
                self.square.become_of(terrain, step_m);
                steps_m.push(step_m);
            }
            Layout::Rings(rings) => {
                base_m = FINEST_M.max(reach_m / (1_u32 << (MAX_LEVELS - 1)) as f32);
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
        let square = matches!(terrain.layout, Layout::Square).then_some(&self.square);
        let mut grids: Vec<Grid> = Vec::new();
        for (level, &step_m) in steps_m.iter().enumerate().rev() {
            let frame = Frame::new(terrain, square, sun, towards, step_m);
            let end_m = if steps_m.len() == 1 { FARTHEST_M } else { base_m * (1_u32 << level) as f32 };
            // As many steps before what is asked for as ground that stands out by its detail throws shadows.
            let beyond = (DETAIL_STEPS * step_m / frame.fall_m[0].max(1e-6)).min(MOST_BEYOND).ceil();
            let finer_m = level.checked_sub(1).map_or(0.0, |finer| beyond * steps_m[finer]);
            // A finer grid asks for the places that it begins at.
            let asked = if level == 0 { 0.0 } else { (finer_m / step_m).ceil() + 2.0 };
            let region = frame.region(&footprint.within(terrain.centre, end_m), asked);
            let memory = self.spare.pop().unwrap_or_default();
            let grid = match grids.last() {
                None => frame.first(&region, memory),
                Some(coarser) => frame.within(&region, memory, coarser, beyond as usize),
            };
            grids.push(grid);
        }
        grids.reverse();
        (self.towards, self.centre, self.base_m) = (towards, terrain.centre, base_m);
        self.join(grids);
    }

    /// Puts the grids below each other.
    fn join(&mut self, grids: Vec<Grid>) {
        let width = grids.iter().map(|grid| grid.size[0]).max().unwrap_or(2);
        self.width = width as u32;
        self.levels.clear();
        self.heights_m.clear();
        self.shaded.clear();
        for mut grid in grids {
            self.levels.push(HorizonLevel {
                origin: grid.origin,
                step_m: grid.step_m,
                first_row: (self.heights_m.len() / width) as u32,
                size: grid.size.map(|side| side as u32),
                first: grid.first,
            });
            if self.heights_m.is_empty() && grid.size[0] == width {
                std::mem::swap(&mut self.heights_m, &mut grid.heights_m);
            } else {
                for row in grid.heights_m.chunks(grid.size[0]) {
                    self.heights_m.extend(row);
                    self.heights_m.resize(self.heights_m.len() + width - row.len(), [0.0; 2]);
                }
            }
            self.shaded.extend(grid.shaded);
            self.spare.push(grid.heights_m);
        }
    }

    /// Where ground may occlude any of the sun from a surface on a square ground or above it.
    #[must_use]
    pub fn shadowed_ground(&self) -> ShadowedGround<'_> {
        let step_m = self.levels.first().map_or(0.0, |level| level.step_m);
        ShadowedGround { points: &self.shaded, margin_m: 1.5 * step_m }
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

    /// Height of the ground at a column of some rows, which begin at `from`, and of a square its cell.
    #[inline(always)]
    fn ground_across<S: Simd>(
        &self,
        simd: S,
        from: [f32x8<S>; 2],
        rows: usize,
        column: usize,
    ) -> (f32x8<S>, i32x8<S>) {
        let along = column as f32 * self.step_m * self.towards;
        let (x, y) = (from[0] + along.x, from[1] + along.y);
        if let Some(square) = self.square {
            return square.heights_at(simd, x, y);
        }
        let (mut heights_m, mut at) = ([f32::MIN; LANES], [[0.0; LANES]; 2]);
        x.store_slice(&mut at[0]);
        y.store_slice(&mut at[1]);
        for lane in 0..rows {
            heights_m[lane] = self.ground_m(Vec2::new(at[0][lane], at[1][lane]));
        }
        (f32x8::from_slice(simd, &heights_m), i32x8::splat(simd, 0))
    }

    /// The coarsest grid: its rows begin where no ground further off is high enough to hide the sun.
    fn first(&self, region: &Region, memory: Vec<[f32; 2]>) -> Grid {
        let [lowest_m, highest_m] = self.terrain.z_range_m;
        let fall_m = self.fall_m[0].max(1e-6);
        let reach = ((highest_m - lowest_m) / fall_m).ceil().min(self.samples as f32) as usize + 2;
        let start = |_, end: usize| ((end + reach).min(self.samples), [-1.0e9_f32; 2]);
        self.scan(region, memory, start, self.square.map(|square| &square.bends))
    }

    /// A grid whose rows go on from a coarser one, so many samples before what is asked for.
    fn within(&self, region: &Region, memory: Vec<[f32; 2]>, coarser: &Grid, beyond: usize) -> Grid {
        let start = |row, end| {
            let end = end + beyond;
            let place = self.place(end, row);
            let ground_m = self.ground_m(place);
            (end, raised(coarser.limbs_at(place, self.towards), ground_m))
        };
        self.scan(region, memory, start, None)
    }

    /// Runs along every row of a region, from the column and with the heights that `start` gives for it and the end of its span.
    fn scan(
        &self,
        region: &Region,
        mut heights_m: Vec<[f32; 2]>,
        start: impl Fn(usize, usize) -> (usize, [f32; 2]) + Sync,
        bends: Option<&Bends>,
    ) -> Grid {
        let Region { columns, rows, spans } = region;
        let width = columns.len();
        heights_m.resize(width * rows.len(), [f32::MIN; 2]);
        let lines = heights_m.par_chunks_mut(LANES * width).zip(spans.par_chunks(LANES)).enumerate();
        let shaded = lines.map(|(chunk, (heights_m, spans))| {
            heights_m.fill([f32::MIN; 2]);
            let first_row = rows.start + chunk * LANES;
            let lines = Lines { first_row, first_column: columns.start, spans };
            dispatch!(Level::new(), simd => self.scan_lines(simd, &lines, heights_m, &start, bends))
        });
        let shaded = shaded.collect::<Vec<_>>().into_iter().flatten().collect();
        let first = Vec2::new(columns.start as f32, rows.start as f32);
        // What is finer than a square's samples is counted from nearby.
        let (origin, first) = if self.square.is_some() {
            (self.origin, first)
        } else {
            (self.origin + self.step_m * (first.x * self.towards + first.y * self.across), Vec2::ZERO)
        };
        Grid { origin, first, step_m: self.step_m, size: [width, rows.len()], heights_m, shaded }
    }

    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn scan_lines<S: Simd>(
        &self,
        simd: S,
        lines: &Lines<'_>,
        heights_m: &mut [[f32; 2]],
        start: &impl Fn(usize, usize) -> (usize, [f32; 2]),
        bends: Option<&Bends>,
    ) -> Vec<Vec2> {
        let Lines { first_row, first_column, spans } = *lines;
        let (rows, width) = (spans.len(), heights_m.len() / spans.len());
        // Of each row: where it begins, the column and the heights that it is run along from.
        let (mut from, mut last, mut limbs) = ([[0.0; LANES]; 2], [0.0; LANES], [[0.0; LANES]; 2]);
        let (mut first, mut end) = (usize::MAX, 0);
        for row in 0..rows {
            let begin = self.origin + (first_row + row) as f32 * self.step_m * self.across;
            (from[0][row], from[1][row]) = (begin.x, begin.y);
            if spans[row].is_empty() {
                continue;
            }
            let (begun_at, at_start) = start(first_row + row, spans[row].end);
            (last[row], limbs[0][row], limbs[1][row]) = (begun_at as f32, at_start[0], at_start[1]);
            (first, end) = (first.min(spans[row].start), end.max(begun_at));
        }
        let from = [f32x8::from_slice(simd, &from[0]), f32x8::from_slice(simd, &from[1])];
        let last = f32x8::from_slice(simd, &last);
        let (mut lower, mut upper) = (f32x8::from_slice(simd, &limbs[0]), f32x8::from_slice(simd, &limbs[1]));
        let mut shaded = Vec::new();
        let mut column = end;
        while column > first {
            column -= 1;
            let (ground, cell) = self.ground_across(simd, from, rows, column);
            let begun = last.simd_gt(column as f32);
            lower = begun.select(lower - self.fall_m[0], lower);
            upper = begun.select(upper - self.fall_m[1], upper);
            lower.store_slice(&mut limbs[0]);
            upper.store_slice(&mut limbs[1]);
            for row in 0..rows {
                if spans[row].contains(&column) {
                    heights_m[row * width + column - first_column] = [limbs[0][row], limbs[1][row]];
                }
            }
            if let Some(bends) = bends {
                let (on_ground, above) = (ground.simd_gt(f32::MIN), ground - lower);
                if (on_ground & above.simd_le(bends.largest_m)).any_true() {
                    let mut cells = [0; LANES];
                    cell.store_slice(&mut cells);
                    let bends_m = cells.map(|cell| bends.bends_m[cell as usize]);
                    let is_shaded = on_ground & above.simd_le(f32x8::from_slice(simd, &bends_m));
                    let mut left = is_shaded.to_bitmask();
                    while left != 0 {
                        let row = left.trailing_zeros() as usize;
                        left &= left - 1;
                        if spans.get(row).is_some_and(|span| span.contains(&column)) {
                            shaded.push(self.place(column, first_row + row));
                        }
                    }
                }
            }
            // As `raised`.
            let stands_out = begun & ground.simd_gt(lower);
            lower = stands_out.select(ground, lower);
            upper = stands_out.select(ground, upper);
        }
        shaded
    }
}

/// Rows that are run along at once: which, and of which columns.
struct Lines<'a> {
    first_row: usize,
    first_column: usize,
    spans: &'a [Range<usize>],
}

/// The heights where ground stands at a place: what hides the lower limb from what lies beyond also tells how far the upper
/// one is hidden. (Lower ground that lies nearer would hide neither, but would cut the penumbra short.)
fn raised(limbs: [f32; 2], ground_m: f32) -> [f32; 2] {
    if ground_m > limbs[0] { [ground_m; 2] } else { limbs }
}

impl Grid {
    /// Heights for both limbs at a place, bilinear; of a grid over rings.
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

/// The heights of a square ground, close together: the map asks for half a million of them. Kept from map to map.
#[derive(Clone, Debug, Default)]
struct Square {
    /// Keeps the ground's address from being given to another, but not the ground.
    of: Weak<Terrain>,
    cells: usize,
    cell_m: f32,
    cells_per_m: f32,
    half_m: f32,
    heights_m: Vec<f32>,
    /// For the steps of a map.
    bends: Bends,
}

impl Square {
    /// Becomes that of a ground and the steps of a map, unless it is.
    fn become_of(&mut self, terrain: &Arc<Terrain>, step_m: f32) {
        let is_same = self.of.ptr_eq(&Arc::downgrade(terrain));
        if is_same && self.bends.step_m == step_m {
            return;
        }
        if !is_same {
            self.of = Arc::downgrade(terrain);
            self.cells = terrain.columns as usize;
            self.cell_m = terrain.cell_m();
            self.cells_per_m = 1.0 / terrain.cell_m();
            self.half_m = terrain.half_extent_m;
            let heights_m = terrain.vertices.par_iter().map(|vertex| vertex.position.z);
            heights_m.collect_into_vec(&mut self.heights_m);
        }
        let mut bends = std::mem::take(&mut self.bends);
        bends.become_of(self, step_m);
        self.bends = bends;
    }

    /// Heights of its vertices in a row.
    fn row(&self, row: usize) -> &[f32] {
        &self.heights_m[row * (self.cells + 1)..][..self.cells + 1]
    }

    /// [`Terrain::surface_height_at`] places, or far down outside, and their cells, by the first vertex of each.
    #[inline(always)]
    fn heights_at<S: Simd>(&self, simd: S, x: f32x8<S>, y: f32x8<S>) -> (f32x8<S>, i32x8<S>) {
        let last = (self.cells - 1) as f32;
        let zero = f32x8::splat(simd, 0.0);
        let (at_x, at_y) = ((x + self.half_m) * self.cells_per_m, (y + self.half_m) * self.cells_per_m);
        let column = at_x.floor().max(zero).min(f32x8::splat(simd, last));
        let row = at_y.floor().max(zero).min(f32x8::splat(simd, last));
        let (u, v) = (at_x - column, at_y - row);
        let row_len = self.cells as i32 + 1;
        let vertex = row.to_int::<i32x8<S>>() * row_len + column.to_int::<i32x8<S>>();
        let is_east = u.simd_ge(v);
        let corner = vertex + is_east.select(i32x8::splat(simd, 1), i32x8::splat(simd, row_len));
        let (mut of_vertex, mut of_corner) = ([0; LANES], [0; LANES]);
        vertex.store_slice(&mut of_vertex);
        corner.store_slice(&mut of_corner);
        let mut heights_m = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let (vertex, corner) = (of_vertex[lane] as usize, of_corner[lane] as usize);
            heights_m[0][lane] = self.heights_m[vertex];
            heights_m[1][lane] = self.heights_m[corner];
            heights_m[2][lane] = self.heights_m[vertex + self.cells + 2];
        }
        let h00 = f32x8::from_slice(simd, &heights_m[0]);
        let corner = f32x8::from_slice(simd, &heights_m[1]);
        let h11 = f32x8::from_slice(simd, &heights_m[2]);
        let (near, far) = (is_east.select(u, v), is_east.select(v, u));
        let is_inside = x.abs().max(y.abs()).simd_le(self.half_m);
        let height = h00 + (corner - h00) * near + (h11 - corner) * far;
        (is_inside.select(height, f32x8::splat(simd, f32::MIN)), vertex)
    }
}

/// For each cell of a terrain, how far its ground may lie below the straight course between places a step apart.
///
/// Along a line the ground is straight but for kinks where it crosses the triangles' edges; a kink by J (change of
/// slope) within a step of length s takes it at most J s / 4 off the straight line. Two axes make twice that; the three
/// kinds of edges are added up over the cells around.
#[derive(Clone, Debug, Default)]
struct Bends {
    step_m: f32,
    /// Of each cell, by its first vertex.
    bends_m: Vec<f32>,
    /// The largest of all.
    largest_m: f32,
    /// The largest along each row; for its memory.
    along: Vec<f32>,
}

impl Bends {
    fn become_of(&mut self, square: &Square, step_m: f32) {
        let cells = square.cells;
        let scale = 0.5 * step_m / square.cell_m;
        // Largest over two cells each way: first along rows, then along columns.
        let along = &mut self.along;
        along.resize(cells * (cells + 1), 0.0);
        along.par_chunks_exact_mut(cells).enumerate().for_each(|(row, along)| {
            let rows = [row.saturating_sub(1), row, (row + 1).min(cells)].map(|row| square.row(row));
            dispatch!(Level::new(), _simd => Self::along_row(rows, scale, along));
        });
        // No cell begins with the last row or column.
        self.bends_m.resize((cells + 1) * (cells + 1), 0.0);
        let rows = self.bends_m.par_chunks_exact_mut(cells + 1).take(cells).enumerate();
        let largest_m = rows.map(|(row, bends_m)| {
            bends_m.fill(0.0);
            for row in row.saturating_sub(1)..=(row + 2).min(cells) {
                dispatch!(Level::new(), _simd => raise(bends_m, &along[row * cells..][..cells]));
            }
            bends_m.iter().copied().fold(0.0, f32::max)
        });
        self.largest_m = largest_m.reduce(|| 0.0, f32::max);
        self.step_m = step_m;
    }

    /// Largest kinks around each cell of a row, from the heights to its south, along it and to its north.
    #[inline(always)]
    fn along_row([south, here, north]: [&[f32]; 3], scale: f32, along: &mut [f32]) {
        let last = along.len();
        // Changes of slope at a vertex, times a cell: along both axes and the diagonal.
        let kinks = |west: usize, column: usize, east: usize| {
            let middle = 2.0 * here[column];
            scale
                * ((here[west] + here[east] - middle).abs()
                    + (south[column] + north[column] - middle).abs()
                    + (south[west] + north[east] - middle).abs())
        };
        let mut of_row = vec![0.0; last + 1];
        for (column, kink) in of_row.iter_mut().enumerate().take(last).skip(1) {
            *kink = kinks(column - 1, column, column + 1);
        }
        (of_row[0], of_row[last]) = (kinks(0, 0, 1), kinks(last - 1, last, last));
        along.copy_from_slice(&of_row[1..]);
        raise(along, &of_row);
        raise(&mut along[1..], &of_row);
        raise(along, &of_row[2..]);
    }
}

/// Raises numbers to those of a row; what is longer stays.
#[inline(always)]
fn raise(numbers: &mut [f32], row: &[f32]) {
    for (number, other) in numbers.iter_mut().zip(row) {
        *number = if *other > *number { *other } else { *number };
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
        let mut map = HorizonMap::default();
        map.update(&Arc::new(terrain), &sun, &Footprint::around(corners.into_iter()));
        let level = map.levels[0];
        // Beyond 13 m the shadow of the ridge has met the ground.
        for x in [-5.0_f32, -8.0, -12.0] {
            let column = ((x - level.origin.x) / level.step_m).round();
            let row = (level.size[1] / 2) as usize;
            let at = level.origin.x + column * level.step_m;
            let [lower, upper] = map.heights_m[row * map.width as usize + (column - level.first.x) as usize];
            for (height, limb_deg) in [(lower, 17.0 - 0.265), (upper, 17.0 + 0.265)] {
                let expected = 4.0 + at * f64::to_radians(limb_deg).tan() as f32;
                assert!((height - expected).abs() < 0.15, "x = {at}: {height} m for {expected} m");
            }
        }
    }

    #[test]
    fn the_map_of_all_of_the_ground_has_the_values_of_its_parts() {
        let height =
            |p: Vec2| 3.0 * (0.05 * p.x).sin() * (0.04 * p.y).cos() + 0.4 * (0.9 * p.x + 0.3 * p.y).sin();
        let terrain = Arc::new(Terrain::from_height(100.0, 100, Vec::new(), height));
        let sun = Sun::new(8.0, 230.0, 0.53, Vec3::ONE);
        let part = |x: f32| {
            let corners = [(0.0, 0.0), (20.0, 5.0), (15.0, 30.0)];
            Footprint::around(corners.into_iter().map(move |(dx, y)| Vec2::new(x + dx, y)))
        };
        let mut map = HorizonMap::default();
        assert!(map.update(&terrain, &sun, &part(0.0)));
        let of_part = map.clone();
        assert!(map.update(&terrain, &sun, &part(-3.0)), "all of it");
        assert!(!map.update(&terrain, &sun, &part(9.0)), "which it has");
        let (part_level, level) = (of_part.levels[0], map.levels[0]);
        assert_eq!((level.origin, level.step_m), (part_level.origin, part_level.step_m));
        let mut compared = 0;
        for (i, known) in of_part.heights_m.iter().enumerate().filter(|(_, known)| known[0] > f32::MIN) {
            let at = [i % of_part.width as usize, i / of_part.width as usize];
            let first = part_level.first - level.first;
            let (column, row) = (at[0] + first.x as usize, at[1] + first.y as usize);
            let whole = map.heights_m[row * map.width as usize + column];
            // Where nothing stands between a place and the sun both are far down, at what the rows begin with.
            assert!(whole == *known || whole[0].max(known[0]) < -1e8, "{whole:?} for {known:?}");
            compared += 1;
        }
        assert!(compared > 1000, "{compared}");
        let low_sun = Sun::new(5.0, 230.0, 0.53, Vec3::ONE);
        assert!(map.update(&terrain, &low_sun, &part(0.0)), "another sun");
        assert!(map.update(&Arc::new(Terrain::clone(&terrain)), &low_sun, &part(0.0)), "another ground");
        assert!(map.levels[0].size[0] < level.size[0], "a part again");
    }
}
