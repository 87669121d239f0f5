//! The horizon map: from which height the sun is visible past the ground. The ground casts its shadows by it.
//!
//! For each point of a grid that is aligned with the sun the map holds two heights: those from which the lower and the upper limb of
//! the sun are just visible past all the ground in between. It is the horizon map of Max 1988 ("Horizon mapping: shadows for
//! bump-mapped surfaces", The Visual Computer 4) for a single azimuth, kept as heights in place of angles, so that it also serves
//! surfaces above the ground. `horizon/sweep.rs` computes it.
//!
//! A square ground has one grid. Rings have several, like a clipmap: each over the points within a distance that doubles from
//! grid to grid, with samples as far apart as the cells of the ground there. Where a finer grid ends towards the sun, its rows
//! start with the heights of the coarser one.
//! It stands in `shadow/` and uses `select/` for footprints; what `select/` needs of it, it hands over as [`ShadowedGround`].
//! Must not know: how the map is sampled (`common/horizon_map.wgsl`).

mod grid_frame;
mod heightfield;
mod image_layout;
mod occluders;
mod sweep;

use std::sync::{Arc, Mutex, PoisonError, Weak};

use glam::Vec2;

use self::heightfield::Heightfield;
use self::image_layout::{ImageLayout, ImageRows};
use self::occluders::Limbs;
use self::sweep::{HorizonGrid, SweepLattice, SweepRegion};
use crate::render::device::shader_structs::HorizonLevel;
use crate::render::select::caster_grid::ShadowedGround;
use crate::render::select::footprint::Footprint;
use crate::render::select::full_sun::{FullSun, HorizonTexels};
use crate::scene::sky::Sun;
use crate::scene::terrain::{Layout, Terrain};

/// Samples of the map per cell of a square of ground, under a sun that is not low.
const SAMPLES_PER_CELL: f32 = 3.0;
/// Samples of the map per cell of rings, at the distance where a grid ends; half as many where it begins.
const SAMPLES_PER_RING_CELL: f32 = 2.4;
/// Elevation of the sun, degrees, below which the map has more samples per cell: what grazing rays meet first is small, and may lie
/// between two samples.
const LOW_SUN_DEG: f64 = 7.5;
/// Largest factor by which it has more, along each axis: with 2 in place of 1.5 the errors of shadows are a tenth smaller.
const MAX_REFINEMENT: f64 = 1.5;
/// Maximum samples along a side of the map.
const MAX_SAMPLES: u32 = 2048;
/// Where the image would be larger, the steps of all grids grow by this factor until it is not.
const COARSENING: f32 = 1.25;
/// Distance that the finest grid over rings serves, metres.
const FINEST_M: f32 = 5.0;
/// How far ground may stand out of what a coarser grid knows of it, steps of the grid under a high sun: the sweep of a finer grid starts
/// so far towards the sun that such ground casts no shadow into it. With three times as much, images with the sun 2 to 17 degrees high
/// were the same to the bit; with half as much, some were not.
const DETAIL_STEPS: f32 = 9.0;
/// Maximum number of samples that the sweep of a finer grid starts further towards the sun, under a high sun.
const MAX_BEYOND: f32 = 512.0;
/// Further than everything, metres.
const FARTHEST_M: f32 = 1e9;
/// Maximum number of grids. Stands in `common/frame.wgsl` too.
pub const MAX_LEVELS: usize = 12;

/// Maps of squares whose memory later ones use: those of the frames that are planned or in flight. A map of rings is a fraction of the
/// work of a frame, whose other stages need its memory.
const MAX_RETIRED: usize = 1;

/// The map: its grids, the finest first. Computed in place, for its memory.
#[derive(Clone, Debug, Default)]
pub struct HorizonMap {
    /// Horizontal unit vector towards the sun, along the rows.
    pub towards: Vec2,
    /// Point that distances are measured from, world, metres.
    pub centre: Vec2,
    /// Distance that the first grid serves, metres; each next one serves twice the distance.
    pub base_m: f32,
    /// The grids.
    pub levels: Vec<HorizonLevel>,
    /// Texels in a row of [`Self::heights_m`], in which the grids are arranged.
    pub width: u32,
    /// Heights for the lower and for the upper limb, metres.
    pub heights_m: Vec<Limbs>,
    /// See [`Self::shadowed_ground`].
    shadowed: Vec<Vec2>,
    /// The heights of a square ground, which maps of the same ground share.
    heightfield: Arc<Heightfield>,
}

/// A grid that is still to be computed.
struct PlannedGrid<'a> {
    lattice: SweepLattice<'a>,
    region: SweepRegion,
    /// As many steps towards the sun as ground that stands out of the coarser grid casts shadows.
    beyond: usize,
}

/// The grids of a map, the finest first, and their image. Points up to `base_m` away have the first of these steps between samples, up to
/// twice as far away the second, and so on; longer ones where the image would not fit into a texture.
fn plan_grids<'a>(
    (terrain, heightfield): (&'a Terrain, Option<&'a Heightfield>),
    (sun, towards): (&Sun, Vec2),
    (base_m, mut steps_m): (f32, Vec<f32>),
    (footprint, max_texture_px): (&Footprint, u32),
) -> (Vec<PlannedGrid<'a>>, ImageLayout) {
    loop {
        let planned = grids_of_steps((terrain, heightfield), (sun, towards), (base_m, &steps_m), footprint);
        let layout = ImageLayout::new(planned.iter().map(|grid| grid.region.image_size()));
        if layout.fits(max_texture_px) {
            return (planned, layout);
        }
        steps_m.iter_mut().for_each(|step_m| *step_m *= COARSENING);
    }
}

/// The grids with exactly these steps.
fn grids_of_steps<'a>(
    (terrain, heightfield): (&'a Terrain, Option<&'a Heightfield>),
    (sun, towards): (&Sun, Vec2),
    (base_m, steps_m): (f32, &[f32]),
    footprint: &Footprint,
) -> Vec<PlannedGrid<'a>> {
    // How far towards the sun from its footprint the sweep of the grid before begins, metres: there it samples this one.
    let mut start_m = 0.0;
    let refinement = refinement(sun);
    let plan = |(level, &step_m): (usize, &f32)| {
        let lattice = SweepLattice::new(terrain, heightfield, sun, towards, step_m);
        let end_m = if steps_m.len() == 1 { FARTHEST_M } else { base_m * (1_u32 << level) as f32 };
        let detail_m = DETAIL_STEPS * refinement * step_m;
        let beyond = (detail_m / lattice.fall_m[0].max(1e-6)).min(MAX_BEYOND * refinement).ceil();
        let margin: f32 = if level == 0 { 0.0 } else { start_m / step_m };
        let region = lattice.region(&footprint.within(terrain.centre, end_m), margin);
        start_m = step_m * (margin + SweepRegion::ROUNDED + beyond);
        PlannedGrid { lattice, region, beyond: beyond as usize }
    };
    steps_m.iter().enumerate().map(plan).collect()
}

/// The map that was computed last, for as long as neither ground nor sun change, and the memory of those before. One for any number
/// of threads.
#[derive(Debug, Default)]
pub struct HorizonCache {
    last: Mutex<LastMaps>,
}

#[derive(Debug, Default)]
struct LastMaps {
    last: Option<(Source, Arc<HorizonMap>)>,
    /// Maps that frames may still hold.
    retired: Vec<Arc<HorizonMap>>,
}

/// What a map was computed from.
#[derive(Clone, Debug)]
struct Source {
    /// A weak reference keeps the address of the ground from being used again, but not the ground.
    terrain: Weak<Terrain>,
    sun: Sun,
    /// What the map is over; `None` if it is over all of the ground.
    footprint: Option<Footprint>,
}

impl Source {
    fn is_of(&self, terrain: &Arc<Terrain>, sun: &Sun) -> bool {
        self.terrain.ptr_eq(&Arc::downgrade(terrain)) && self.sun == *sun
    }
}

impl LastMaps {
    /// A map whose memory no frame uses any more.
    fn unused(&mut self) -> HorizonMap {
        let unused = self.retired.iter().position(|map| Arc::strong_count(map) == 1);
        unused.and_then(|index| Arc::into_inner(self.retired.swap_remove(index))).unwrap_or_default()
    }

    fn set(&mut self, source: Source, map: &Arc<HorizonMap>) {
        let before = self.last.replace((source, Arc::clone(map)));
        self.retired.extend(before.map(|(_, map)| map).filter(|map| map.levels.len() == 1));
        if self.retired.len() > MAX_RETIRED {
            self.retired.remove(0);
        }
    }
}

impl HorizonCache {
    /// The map of a ground and a sun over a footprint, the part that is visible: the same one as long as it serves.
    ///
    /// Samples lie where they would in a map of the whole ground, and over a square they have the same values. If a square and its
    /// sun are those of the last map, this computes the map of the whole ground, once, for all later frames.
    pub fn map(
        &self,
        terrain: &Arc<Terrain>,
        sun: &Sun,
        footprint: &Footprint,
        max_texture_px: u32,
    ) -> Arc<HorizonMap> {
        let lock = || self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let mut maps = lock();
        let is_square = matches!(terrain.layout, Layout::Square);
        let same = maps.last.as_ref().filter(|(source, _)| source.is_of(terrain, sun));
        if let Some((source, map)) = same
            && source.footprint.as_ref().is_none_or(|known| known == footprint)
        {
            return Arc::clone(map);
        }
        let is_whole = is_square && same.is_some();
        let of_ground =
            maps.last.as_ref().filter(|(source, _)| source.terrain.ptr_eq(&Arc::downgrade(terrain)));
        let heightfield = of_ground.map(|(_, map)| Arc::clone(&map.heightfield));
        let mut map = maps.unused();
        map.heightfield = heightfield.unwrap_or(map.heightfield);
        if is_whole {
            // With the lock held: the other threads wait for the same map.
            map.compute(terrain, sun, &whole(terrain), max_texture_px);
        } else {
            drop(maps);
            map.compute(terrain, sun, footprint, max_texture_px);
            maps = lock();
        }
        let footprint = (!is_whole).then(|| footprint.clone());
        let (map, source) =
            (Arc::new(map), Source { terrain: Arc::downgrade(terrain), sun: *sun, footprint });
        maps.set(source, &map);
        map
    }
}

/// A footprint that holds all of the ground.
fn whole(terrain: &Terrain) -> Footprint {
    let beyond = 2.0 * terrain.half_extent_m;
    let corners = [Vec2::ONE, Vec2::NEG_ONE, Vec2::new(1.0, -1.0), Vec2::new(-1.0, 1.0)];
    Footprint::hull(corners.into_iter().map(|corner| terrain.centre + beyond * corner))
}

impl HorizonMap {
    /// Computes the map over a footprint: sweeps all grids, from the coarsest to the finest. Their image has at most
    /// `max_texture_px` columns and rows.
    pub fn compute(&mut self, terrain: &Arc<Terrain>, sun: &Sun, footprint: &Footprint, max_texture_px: u32) {
        let azimuth = sun.azimuth_deg.to_radians();
        let towards = Vec2::new(libm::sin(azimuth) as f32, libm::cos(azimuth) as f32);
        let (base_m, steps_m) = level_steps_m(terrain, sun, towards);
        let is_square = matches!(terrain.layout, Layout::Square);
        if is_square {
            Heightfield::update_shared(&mut self.heightfield, terrain, steps_m[0]);
        }
        let heightfield = is_square.then_some(&*self.heightfield);
        let (planned, layout) = plan_grids(
            (terrain, heightfield),
            (sun, towards),
            (base_m, steps_m),
            (footprint, max_texture_px),
        );
        let size @ [width, _] = layout.size();
        let texels: usize = size.into_iter().product();
        if is_square {
            self.heights_m.reserve_exact(texels.saturating_sub(self.heights_m.len()));
            self.heights_m.resize(texels, [f32::MIN; 2]);
        } else {
            self.heights_m = vec![[0.0; 2]; texels];
        }
        let mut grids: Vec<HorizonGrid> = Vec::new();
        for (level, PlannedGrid { lattice, region, beyond }) in planned.iter().enumerate().rev() {
            let [column, first_row] = layout.corners[level];
            let [_, rows] = region.image_size();
            let texels = &mut self.heights_m[first_row * width..(first_row + rows) * width];
            let finer = level.checked_sub(1).map(|finer| &planned[finer]);
            let finer = finer.map(|finer| (&finer.lattice, &finer.region, finer.beyond));
            let output = (ImageRows { texels, width, column }, lattice.strips(region, finer));
            let grid = match grids.last() {
                None => lattice.sweep_coarsest(region, output),
                Some(coarser) => lattice.sweep_finer(region, output, coarser, *beyond),
            };
            grids.push(grid);
        }
        grids.reverse();
        (self.towards, self.centre, self.base_m) = (towards, terrain.centre, base_m);
        self.width = width as u32;
        self.levels.clear();
        self.levels.extend(grids.iter().zip(&layout.corners).map(|(grid, [column, row])| HorizonLevel {
            origin: grid.frame.origin,
            step_m: grid.frame.step_m,
            first_texel: (column | row << 16) as u32,
            size: [grid.image_columns as u32, grid.frame.size[1] as u32],
            first_sample: grid.frame.first,
        }));
        self.shadowed.clear();
        self.shadowed.extend(grids.into_iter().flat_map(|grid| grid.shadowed));
    }

    /// Where ground may occlude any of the sun from a surface on a square ground or above it.
    #[must_use]
    pub fn shadowed_ground(&self) -> ShadowedGround<'_> {
        let step_m = self.levels.first().map_or(0.0, |level| level.step_m);
        ShadowedGround { points: &self.shadowed, margin_m: 1.5 * step_m }
    }

    /// Heights above a point from which the lower and the upper limb of the sun are visible past the ground, at the nearest sample,
    /// metres.
    #[must_use]
    pub fn limbs_at(&self, point: Vec2) -> Limbs {
        let [[lower], [upper]] = self.limbs_at_many(&[[point.x], [point.y]]);
        [lower, upper]
    }

    /// The same above several points, which are given as two lists of coordinates: the lower limb, then the upper.
    #[must_use]
    pub fn limbs_at_many<const COUNT: usize>(&self, [x, y]: &[[f32; COUNT]; 2]) -> [[f32; COUNT]; 2] {
        let mut levels = [0; COUNT];
        for coarser in 1..self.levels.len() {
            let reach_m = self.base_m * (1_u32 << (coarser - 1)) as f32;
            for (level, (x, y)) in levels.iter_mut().zip(x.iter().zip(y)) {
                let (x, y) = (x - self.centre.x, y - self.centre.y);
                *level += usize::from(x * x + y * y > reach_m * reach_m);
            }
        }
        let mut limbs = [[0.0; COUNT]; 2];
        for (i, level) in levels.into_iter().enumerate() {
            [limbs[0][i], limbs[1][i]] =
                self.heights_m[self.texel(&self.levels[level], Vec2::new(x[i], y[i]))];
        }
        limbs
    }

    /// Index of the texel of the sample of a grid that is nearest to a point.
    #[inline]
    fn texel(&self, grid: &HorizonLevel, point: Vec2) -> usize {
        let offset = (point - grid.origin) / grid.step_m;
        let sample = Vec2::new(offset.dot(self.towards), offset.dot(self.towards.perp())) - grid.first_sample;
        // Truncated: rounding is a call where the processor is not known.
        let index = |at: f32, size: u32| ((at + 0.5).max(0.0) as u32).min(size - 1);
        let (column, row) = (index(sample.x, grid.size[0]), index(sample.y, grid.size[1]));
        let [first_column, first_row] = [grid.first_texel & 0xffff, grid.first_texel >> 16];
        ((first_row + row) * self.width + first_column + column) as usize
    }

    /// The map over rings, to find where they see all of the sun. Of a square the caster grid tells that ([`Self::shadowed_ground`]).
    #[must_use]
    pub fn full_sun(self: &Arc<Self>) -> Option<FullSun> {
        (self.levels.len() > 1).then(|| FullSun {
            towards: self.towards,
            centre: self.centre,
            base_m: self.base_m,
            levels: self.levels.clone(),
            width: self.width as usize,
            texels: Arc::clone(self) as Arc<dyn HorizonTexels>,
        })
    }

    /// Bytes of a texel.
    pub const TEXEL_BYTES: usize = size_of::<Limbs>();

    /// Rows of [`Self::heights_m`].
    #[must_use]
    pub fn height(&self) -> u32 {
        (self.heights_m.len() / self.width as usize) as u32
    }
}

impl HorizonTexels for HorizonMap {
    fn limbs_m(&self) -> &[Limbs] {
        &self.heights_m
    }
}

/// Factor by which the map has more samples per cell, along each axis, than under a high sun.
fn refinement(sun: &Sun) -> f32 {
    (LOW_SUN_DEG / sun.elevation_deg.max(1.0)).clamp(1.0, MAX_REFINEMENT) as f32
}

/// The distance that the finest grid serves, and the step between the samples of each grid, the finest first, metres.
fn level_steps_m(terrain: &Terrain, sun: &Sun, towards: Vec2) -> (f32, Vec<f32>) {
    let refinement = refinement(sun);
    match &terrain.layout {
        Layout::Square => {
            let side_m = sweep::side_m(terrain, towards);
            let step_m =
                (terrain.cell_m() / (SAMPLES_PER_CELL * refinement)).max(side_m / (MAX_SAMPLES - 2) as f32);
            (FARTHEST_M, vec![step_m])
        }
        Layout::Rings(rings) => {
            let reach_m = terrain.half_extent_m;
            let base_m = FINEST_M.max(reach_m / (1_u32 << (MAX_LEVELS - 1)) as f32);
            let (mut steps_m, mut end_m) = (Vec::new(), base_m);
            loop {
                steps_m.push(rings.cell_m(end_m.min(reach_m)) / (SAMPLES_PER_RING_CELL * refinement));
                if end_m >= reach_m {
                    break;
                }
                end_m *= 2.0;
            }
            (base_m, steps_m)
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]
mod tests {
    use super::*;
    use crate::render::settings::DEFAULT_TEXTURE_PX;
    use glam::Vec3;

    #[test]
    fn horizon_behind_a_ridge_falls_with_the_elevation_of_each_limb() {
        // A ridge 4 m high along x = 0; the sun stands in the east (azimuth 90).
        let terrain = Terrain::from_height(200.0, 200, Vec::new(), |p| (4.0 - p.x.abs()).max(0.0));
        let sun = Sun::new(17.0, 90.0, 0.53, Vec3::ONE);
        let corners =
            [Vec2::splat(-100.0), Vec2::splat(100.0), Vec2::new(-100.0, 100.0), Vec2::new(100.0, -100.0)];
        let mut map = HorizonMap::default();
        map.compute(&Arc::new(terrain), &sun, &Footprint::hull(corners.into_iter()), DEFAULT_TEXTURE_PX);
        let level = map.levels[0];
        // Beyond 13 m the shadow of the ridge has reached the ground.
        for x in [-5.0_f32, -8.0, -12.0] {
            let column = ((x - level.origin.x) / level.step_m).round();
            let row = (level.size[1] / 2) as usize;
            let at = level.origin.x + column * level.step_m;
            let [lower, upper] =
                map.heights_m[row * map.width as usize + (column - level.first_sample.x) as usize];
            for (height, limb_deg) in [(lower, 17.0 - 0.265), (upper, 17.0 + 0.265)] {
                let expected = 4.0 + at * f64::to_radians(limb_deg).tan() as f32;
                assert!((height - expected).abs() < 0.15, "x = {at}: {height} m for {expected} m");
            }
        }
    }

    #[test]
    fn map_of_the_whole_ground_has_the_values_of_a_part() {
        let height =
            |p: Vec2| 3.0 * (0.05 * p.x).sin() * (0.04 * p.y).cos() + 0.4 * (0.9 * p.x + 0.3 * p.y).sin();
        let terrain = Arc::new(Terrain::from_height(100.0, 100, Vec::new(), height));
        let sun = Sun::new(8.0, 230.0, 0.53, Vec3::ONE);
        let part = |x: f32| {
            let corners = [(0.0, 0.0), (20.0, 5.0), (15.0, 30.0)];
            Footprint::hull(corners.into_iter().map(move |(dx, y)| Vec2::new(x + dx, y)))
        };
        let cache = HorizonCache::default();
        let of_part = cache.map(&terrain, &sun, &part(0.0), DEFAULT_TEXTURE_PX);
        let map = cache.map(&terrain, &sun, &part(-3.0), DEFAULT_TEXTURE_PX);
        assert!(!Arc::ptr_eq(&map, &of_part), "now the whole ground");
        assert!(
            Arc::ptr_eq(&map, &cache.map(&terrain, &sun, &part(9.0), DEFAULT_TEXTURE_PX)),
            "the map is already whole"
        );
        assert!(Arc::ptr_eq(&map.heightfield, &of_part.heightfield), "the ground is read once");
        let (part_level, level) = (of_part.levels[0], map.levels[0]);
        assert_eq!((level.origin, level.step_m), (part_level.origin, part_level.step_m));
        let mut compared = 0;
        for (i, expected) in of_part.heights_m.iter().enumerate().filter(|(_, limbs)| limbs[0] > f32::MIN) {
            let at = [i % of_part.width as usize, i / of_part.width as usize];
            let first = part_level.first_sample - level.first_sample;
            let (column, row) = (at[0] + first.x as usize, at[1] + first.y as usize);
            let whole = map.heights_m[row * map.width as usize + column];
            // Where nothing stands between a sample and the sun both are far below, at what the rows begin with.
            assert!(whole == *expected || whole[0].max(expected[0]) < -1e8, "{whole:?} for {expected:?}");
            compared += 1;
        }
        assert!(compared > 1000, "{compared}");
        let low_sun = Sun::new(5.0, 230.0, 0.53, Vec3::ONE);
        let of_low_sun = cache.map(&terrain, &low_sun, &part(0.0), DEFAULT_TEXTURE_PX);
        assert!(of_low_sun.levels[0].size[0] < level.size[0], "a part again");
        let other = cache.map(&Arc::new(Terrain::clone(&terrain)), &low_sun, &part(0.0), DEFAULT_TEXTURE_PX);
        assert!(!Arc::ptr_eq(&other, &of_low_sun), "another ground");
        assert!(other.heights_m == of_low_sun.heights_m);
    }

    #[test]
    fn the_image_of_fine_ground_fits_into_a_texture() {
        let mut config = crate::params::config::Config::default();
        config.apply_set("stage.name=surface").expect("a knob");
        config.apply_set("terrain.cell_mrad=2").expect("a knob");
        let scene = crate::scene::Scene::build(3, &config.draw(3).expect("knobs")).expect("a scene");
        let (terrain, towards) = (&*scene.terrain, Vec2::Y);
        let (base_m, steps_m) = level_steps_m(terrain, &scene.sun, towards);
        let footprint = whole(terrain);
        let too_large =
            grids_of_steps((terrain, None), (&scene.sun, towards), (base_m, &steps_m), &footprint);
        let layout = ImageLayout::new(too_large.iter().map(|grid| grid.region.image_size()));
        assert!(!layout.fits(DEFAULT_TEXTURE_PX));
        for max_texture_px in [DEFAULT_TEXTURE_PX, 2048] {
            let (grids, layout) = plan_grids(
                (terrain, None),
                (&scene.sun, towards),
                (base_m, steps_m.clone()),
                (&footprint, max_texture_px),
            );
            assert!(layout.fits(max_texture_px) && grids.len() == too_large.len());
        }
    }
}
