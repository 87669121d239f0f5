//! Relief bands: for each band of ground, the waves and pits of its relief between the size of the mesh's cells and the distance of
//! samples.
//!
//! Each band has uniforms of its own with only these, so that no sample sums relief that it cannot show.
//! Must not know: buffers.

use std::ops::Range;

use rayon::prelude::*;

use crate::render::device::shader_structs::{LatticeUniforms, RayCrater, ReliefUniforms, ReliefView};
use crate::render::select::ground_blocks::{BLOCK_CELLS, ground_blocks};
use crate::render::select::selection::Selection;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::lattice::Lattice;
use crate::scene::relief::{MIN_CELLS, Relief};
use crate::scene::rings::Rings;
use crate::scene::terrain::Layout;

/// Safety factor for what a device may compute otherwise than the host.
const MARGIN: f32 = 1.01;
/// Safety factor for normals between vertices, which may face the eye more than those of the vertices.
const FACING_MARGIN: f32 = 1.15;
/// Minimum cosine between the normal and the direction to the eye; smaller ones are clamped. Stands in `common/shading.wgsl` too.
pub(in crate::render) const MIN_FACING: f32 = 0.04;

/// Maximum number of bands of a frame: the values of its stencil distinguish them.
const MAX_BANDS: usize = 40;

/// The relief bands of a frame: groups of rows of ground blocks that share uniforms.
#[derive(Clone, Debug)]
pub struct ReliefBands {
    /// The uniforms of each band. The first has no waves and no pits: for rocks, and for ground whose relief the mesh shows whole.
    pub bands: Vec<ReliefUniforms>,
    /// Rows of blocks in a band; `None` if there is only the first band.
    rows: Option<usize>,
    /// Blocks in a row.
    columns: usize,
}

impl ReliefBands {
    /// The bands of a selection.
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection, settings: &RenderSettings) -> Self {
        let terrain = &scene.terrain;
        let columns = terrain.columns.div_ceil(BLOCK_CELLS) as usize;
        let (Some(relief), Layout::Rings(rings)) = (&scene.relief, &terrain.layout) else {
            let bands = vec![ReliefUniforms::default()];
            return Self { bands, rows: None, columns };
        };
        let view = ReliefView {
            eye_from_centre: scene.camera.eye.truncate() - terrain.centre,
            eye_height_m: rings.view.eye_height_m,
            cell_angle: rings.view.cell as f32,
            sample_angle: settings.sample_angle(&scene.camera),
            fresh_share: relief.craters.fresh_share,
            grain_ratio: relief.grains.material.ratio,
            grain_spread: relief.grains.material.spread,
            ray_contrast: relief.crater_rays.contrast,
            ..Default::default()
        };
        let rows = (terrain.rows.div_ceil(BLOCK_CELLS) as usize).div_ceil(MAX_BANDS);
        let spans: Vec<[Range<u32>; 2]> = ground_blocks(terrain).collect();
        let bands = spans.par_chunks(rows * columns).enumerate().map(|(band, blocks)| {
            let first_block = band * rows * columns;
            let visible =
                selection.blocks.iter().filter_map(|(block, _)| blocks.get(block.checked_sub(first_block)?));
            let nearest = visible
                .map(|span| min_samples_m(scene, span))
                .fold([f32::INFINITY; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])]);
            let ring_rows = blocks[0][1].start..blocks[blocks.len() - 1][1].end;
            let samples_m = nearest.map(|distance_m| view.sample_angle * distance_m / MARGIN);
            band_uniforms(relief, view, largest_cell_m(rings, &ring_rows), samples_m)
        });
        let without = ReliefUniforms { view, ..Default::default() };
        let bands = rayon::iter::once(without).chain(bands).collect();
        Self { bands, rows: Some(rows), columns }
    }

    /// The band of a block, by its index in `ground_blocks`.
    #[must_use]
    pub fn of_block(&self, block: usize) -> usize {
        self.rows.map_or(0, |rows| 1 + block / self.columns / rows)
    }
}

/// The relief of ground with cells of at most `largest_m`, and samples at least `sample_m` apart, `across_m` across the view, metres: all
/// that the mesh does not show whole and samples can show. If the slots do not suffice, the finest is left out.
fn band_uniforms(
    relief: &Relief,
    view: ReliefView,
    largest_m: f32,
    [sample_m, across_m]: [f32; 2],
) -> ReliefUniforms {
    let mut uniforms = ReliefUniforms { view, ..Default::default() };
    // The sampling theorem: a wave needs two samples.
    let is_resolved = |size_m: f32| size_m > 2.0 * sample_m;
    // Everywhere in the band the mesh shows relief of this size whole.
    let whole_m = 2.0 * MIN_CELLS * largest_m;
    let octaves = relief.octaves.iter().filter(|octave| {
        let size_m = octave.lattice.cell_m;
        // What the mesh shows whole still sets the strength of finer octaves.
        (octave.patchy > 0.0 || size_m < whole_m) && is_resolved(size_m)
    });
    for (slot, octave) in uniforms.noise.iter_mut().zip(octaves) {
        *slot = LatticeUniforms {
            share: octave.shade,
            factor: octave.patchy,
            ..lattice_uniforms(&octave.lattice, octave.amplitude_m)
        };
        uniforms.view.waves += 1;
    }
    let lattices = relief.craters.lattices.iter().filter(|pits| {
        // The smallest pits of a lattice are half as large as its largest.
        0.5 * pits.largest_m < whole_m && pits.chance > 0.0 && is_resolved(pits.largest_m)
    });
    for (slot, lattice) in uniforms.pits.iter_mut().zip(lattices) {
        *slot = LatticeUniforms {
            max_diameter_m: lattice.largest_m,
            share: lattice.clods,
            ..lattice_uniforms(&lattice.lattice, lattice.chance)
        };
        uniforms.view.pit_lattices += 1;
    }
    // Grains stand up: along the view they are as long as across it.
    let grains = relief.grains.lattices.iter();
    let grains = grains.filter(|grains| grains.chance > 0.0 && grains.largest_m > 2.0 * across_m);
    for (slot, grains) in uniforms.grains.iter_mut().zip(grains) {
        *slot = LatticeUniforms {
            max_diameter_m: grains.largest_m,
            share: grains.fragments,
            factor: grains.mean_excess(&relief.grains.material),
            ..lattice_uniforms(&grains.lattice, grains.chance)
        };
        uniforms.view.grain_lattices += 1;
    }
    for (slot, crater) in uniforms.crater_rays.iter_mut().zip(&relief.crater_rays.craters) {
        *slot = RayCrater { offset: crater.offset, radius_m: crater.radius_m, seed: crater.seed };
    }
    uniforms
}

/// How much of relief of this size samples this far apart can show, 0 to 1. CPU counterpart of the function in
/// `common/relief.wgsl`.
#[inline(always)]
pub(crate) fn sample_share(size_m: f32, sample_m: f32) -> f32 {
    (0.5 * size_m / sample_m - 1.0).clamp(0.0, 1.0)
}

/// Upper bound of the size of the cells in these rows, metres.
fn largest_cell_m(rings: &Rings, rows: &Range<u32>) -> f32 {
    rings.cell_m(rings.radii_m[rows.end as usize]) * MARGIN
}

/// Lower bounds of the distance between samples on a block, metres per radian between their rays: of the geometric mean of that
/// along the view and that across it, and of the latter.
fn min_samples_m(scene: &Scene, [columns, rows]: &[Range<u32>; 2]) -> [f32; 2] {
    let (terrain, eye) = (&scene.terrain, scene.camera.eye);
    let row_len = terrain.columns as usize + 1;
    let squares = (rows.start..=rows.end).flat_map(|row| {
        let first = row as usize * row_len;
        let vertices = &terrain.vertices[first + columns.start as usize..=first + columns.end as usize];
        vertices.iter().map(|vertex| {
            let to_eye = eye - vertex.position;
            let square = to_eye.length_squared();
            let facing = (FACING_MARGIN * vertex.normal.dot(to_eye) / square.sqrt()).clamp(MIN_FACING, 1.0);
            [square / facing, square]
        })
    });
    squares.fold([f32::INFINITY; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])]).map(f32::sqrt)
}

pub(super) fn lattice_uniforms(lattice: &Lattice, amount: f32) -> LatticeUniforms {
    LatticeUniforms {
        rotation_per_m: lattice.turn,
        phase: lattice.phase,
        base: lattice.base,
        seed: lattice.seed,
        amount,
        cell_m: lattice.cell_m,
        ..Default::default()
    }
}

impl LatticeUniforms {
    /// The lattice that these uniforms hold; the inverse of [`lattice_uniforms`].
    #[inline(always)]
    pub(crate) const fn lattice(&self) -> Lattice {
        let &Self { rotation_per_m: turn, phase, base, seed, cell_m, .. } = self;
        Lattice { cell_m, turn, base, phase, seed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::scene::relief::mesh_share;

    #[test]
    fn a_band_holds_all_relief_that_its_vertices_need() {
        let mut config = Config::new();
        config.set_stage("surface").expect("a stage");
        let (mut waves, mut pits) = (0, 0);
        for (seed, size) in [(3, [512, 512]), (11, [160, 90])] {
            let scene = Scene::build(seed, &config.draw(seed).expect("drawn")).expect("built");
            let settings = RenderSettings::new(size, 4).expect("settings");
            let selection = Selection::new(&scene, &settings);
            let bands = ReliefBands::new(&scene, &selection, &settings);
            let spans: Vec<_> = ground_blocks(&scene.terrain).collect();
            let relief = scene.relief.as_ref().expect("a relief");
            let sample_angle = bands.bands[0].view.sample_angle;
            let row_len = scene.terrain.columns as usize + 1;
            for &(block, _) in &selection.blocks {
                let band = &bands.bands[bands.of_block(block)];
                let has = |list: &[LatticeUniforms], lattice: &Lattice| {
                    list.iter().any(|slot| slot.seed == lattice.seed && slot.cell_m == lattice.cell_m)
                };
                let [columns, rows] = spans[block].clone();
                let vertices =
                    rows.flat_map(|row| columns.clone().step_by(7).map(move |column| (row, column)));
                for (row, column) in vertices {
                    let vertex = scene.terrain.vertices[row as usize * row_len + column as usize];
                    let to_eye = scene.camera.eye - vertex.position;
                    let facing = vertex.normal.dot(to_eye.normalize()).clamp(MIN_FACING, 1.0);
                    let sample_m = sample_angle * to_eye.length() / facing.sqrt();
                    let offset = vertex.position.truncate() - scene.terrain.centre;
                    let Layout::Rings(rings) = &scene.terrain.layout else { unreachable!() };
                    let cell_m = rings.cell_m(offset.length());
                    let first = relief
                        .octaves
                        .partition_point(|octave| octave.lattice.cell_m >= 2.0 * MIN_CELLS * cell_m);
                    for octave in relief.octaves.iter().skip(first) {
                        let size_m = octave.lattice.cell_m;
                        if mesh_share(size_m, cell_m) < 1.0 && sample_share(size_m, sample_m) > 0.0 {
                            waves += 1;
                            assert!(has(&band.noise, &octave.lattice), "a wave of {size_m} m");
                        }
                    }
                    let lattices = &relief.craters.lattices;
                    let whole =
                        lattices.partition_point(|pits| 0.5 * pits.largest_m >= 2.0 * MIN_CELLS * cell_m);
                    for index in [whole, whole + 1, whole + 2, whole + 4, whole + 6] {
                        let Some(wanted) = lattices.get(index) else { continue };
                        if sample_share(wanted.largest_m, sample_m) > 0.0 {
                            pits += 1;
                            assert!(has(&band.pits, &wanted.lattice), "pits of {} m", wanted.largest_m);
                        }
                    }
                }
            }
        }
        assert!(waves > 50_000 && pits > 50_000, "{waves} waves, {pits} pits");
    }
}
