//! What each block of ground shows of the relief below its mesh: waves and pits between the size of its cells and the
//! distance of samples.
//!
//! Each draw of ground has uniforms of its own with just those, at fixed places: a driver that runs on the CPU would
//! fetch what lies at a place that depends on the sample once for each sample.
//! Must not know: buffers.

use std::ops::Range;

use super::RenderSettings;
use super::selection::{Selection, ground_blocks};
use super::shaders::{LatticeUniforms, ReliefUniforms};
use crate::scene::Scene;
use crate::scene::craters::LATTICES;
use crate::scene::lattice::Lattice;
use crate::scene::relief::{CELLS_LEAST, Relief};
use crate::scene::rings::Rings;
use crate::scene::terrain::Layout;

/// Octaves of waves that a place shows, from the first that the mesh does not show whole.
const OCTAVES_ASKED: usize = 7;
/// Of the first lattice of each octave of pits, how much smaller than the mesh's limit its largest may be: that of three
/// octaves after the first.
const FIRST_LATTICES_ASKED: f32 = 8.0;
/// Larger than any ratio of cells and pits.
const NO_LIMIT: f32 = 1e6;
/// What is reckoned here may differ from what a device reckons by this share.
const MARGIN: f32 = 1.01;
/// Normals between vertices may face the eye more than those of vertices, by this share.
const FACING_MARGIN: f32 = 1.15;
/// The least that a facet counts as facing the eye; it stands in `surface.wgsl`.
const LEAST_FACING: f32 = 0.04;

/// Numbers of waves and of lattices of pits that a program sums up: that of a block is the first that has enough.
pub const SIZES: [[usize; 2]; 3] = [[5, 7], [6, 7], [12, 12]];

/// The relief of a block.
#[derive(Clone, Copy, Debug)]
pub struct BlockRelief {
    /// What the program is given.
    pub uniforms: ReliefUniforms,
    /// Place in [`SIZES`].
    pub size: usize,
}

impl BlockRelief {
    /// That of each of [`Selection::blocks`], or of none where the mesh shows all; and before them one without waves and
    /// pits.
    #[must_use]
    pub fn of_blocks(scene: &Scene, selection: &Selection, settings: &RenderSettings) -> Vec<Self> {
        let (Some(relief), Layout::Rings(rings)) = (&scene.relief, &scene.terrain.layout) else {
            return vec![Self { uniforms: ReliefUniforms::default(), size: 0 }];
        };
        let samples = (settings.size[0] * settings.samples_per_side) as f32;
        let common = ReliefUniforms {
            eye_from_centre: scene.camera.eye.truncate() - scene.terrain.centre,
            eye_height_m: rings.view.eye_height_m,
            cell: rings.view.cell as f32,
            sample_angle: 2.0 * scene.camera.tan_half_fov / samples,
            fresh_share: relief.craters.fresh_share,
            ..Default::default()
        };
        let spans: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
        let blocks = selection.blocks.iter().map(|&(block, nearest_m)| {
            let [columns, rows] = &spans[block];
            let facing = most_facing(scene, columns, rows);
            let sample_m = common.sample_angle * nearest_m / facing.sqrt();
            Self::of_block(relief, common, cells_m(rings, rows), sample_m / MARGIN)
        });
        std::iter::once(Self { uniforms: common, size: 0 }).chain(blocks).collect()
    }

    /// That of ground with cells of these sizes, and samples as far apart as this or more, metres.
    fn of_block(
        relief: &Relief,
        common: ReliefUniforms,
        [smallest_m, largest_m]: [f32; 2],
        sample_m: f32,
    ) -> Self {
        let mut uniforms = common;
        let is_shown = |size_m: f32| size_m > 2.0 * sample_m;
        // What is this large the mesh shows whole: everywhere, somewhere.
        let (whole_m, some_whole_m) = (2.0 * CELLS_LEAST * largest_m, 2.0 * CELLS_LEAST * smallest_m);
        let octaves = &relief.octaves;
        let whole = |size_m: f32| octaves.partition_point(|octave| octave.lattice.cell_m >= size_m);
        let end = (whole(some_whole_m) + OCTAVES_ASKED).min(octaves.len());
        let shown =
            octaves[whole(whole_m).min(end)..end].iter().take_while(|octave| is_shown(octave.lattice.cell_m));
        let mut waves = 0;
        for (slot, octave) in uniforms.noise.iter_mut().zip(shown) {
            *slot = lattice_uniforms(&octave.lattice, octave.amplitude_m);
            waves += 1;
        }
        // Of the first octave that is not whole both lattices are asked, of the next ones the first.
        let mut pits = 0;
        let lattices = relief.craters.lattices.iter().enumerate().filter_map(|(index, pits)| {
            let asked = match (index as u32 / LATTICES, index as u32 % LATTICES) {
                (0, _) => NO_LIMIT,
                (_, 0) => FIRST_LATTICES_ASKED,
                _ => 1.0,
            };
            // The smallest pits of a lattice are half as large as its largest.
            let is_asked = asked * pits.largest_m >= 2.0 * CELLS_LEAST * smallest_m;
            let is_below_mesh = 0.5 * pits.largest_m < whole_m;
            let is_there = pits.chance > 0.0;
            (is_asked && is_below_mesh && is_there && is_shown(pits.largest_m)).then_some((pits, asked))
        });
        for (slot, (lattice, asked)) in uniforms.pits.iter_mut().zip(lattices) {
            *slot = LatticeUniforms {
                largest_m: lattice.largest_m,
                clods: lattice.clods,
                asked,
                ..lattice_uniforms(&lattice.lattice, lattice.chance)
            };
            pits += 1;
        }
        let size = SIZES.iter().position(|[most_waves, most_pits]| waves <= *most_waves && pits <= *most_pits);
        Self { uniforms, size: size.unwrap_or(SIZES.len() - 1) }
    }
}

/// Size of the smallest and of the largest of the cells of these rows, metres.
fn cells_m(rings: &Rings, rows: &Range<u32>) -> [f32; 2] {
    // A chord lies inside its arc.
    let nearest_m = rings.radii_m[rows.start as usize] / MARGIN;
    [rings.cell_m(nearest_m) / MARGIN, rings.cell_m(rings.radii_m[rows.end as usize]) * MARGIN]
}

/// Cosine of the angle to the eye that no place of a block exceeds.
fn most_facing(scene: &Scene, columns: &Range<u32>, rows: &Range<u32>) -> f32 {
    let (terrain, eye) = (&scene.terrain, scene.camera.eye);
    let row_len = terrain.columns as usize + 1;
    let facing = (rows.start..=rows.end).flat_map(|row| {
        let first = row as usize * row_len;
        let vertices = &terrain.vertices[first + columns.start as usize..=first + columns.end as usize];
        vertices.iter().map(|vertex| vertex.normal.dot((eye - vertex.position).normalize()))
    });
    (FACING_MARGIN * facing.fold(0.0, f32::max)).clamp(LEAST_FACING, 1.0)
}

fn lattice_uniforms(lattice: &Lattice, amount: f32) -> LatticeUniforms {
    LatticeUniforms {
        turn: lattice.turn,
        phase: lattice.phase,
        base: lattice.base,
        seed: lattice.seed,
        amount,
        cell_m: lattice.cell_m,
        ..Default::default()
    }
}
