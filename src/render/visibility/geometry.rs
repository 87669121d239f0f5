//! The triangles that may be visible, projected onto the samples of an image: the input of [`crate::render::visibility::host`].
//!
//! A software adapter runs both sides of every branch of a shader. So triangles are classified by what can shade them: ground
//! that no shadow reaches or only that of other ground, rock that faces away from the sun. Each class is a shading bin, lit by a
//! pipeline without the rest.
//!
//! `surfaces` walks the ground, the rocks and the sky, `projection` brings their vertices onto the samples, and
//! `screen_mesh` culls and clips their triangles.
//! Must not know: textures and buffers.

mod face_normal;
mod projection;
mod screen_mesh;
mod surfaces;

use std::collections::BTreeMap;
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

pub use projection::ScreenVertex;
pub use screen_mesh::{ScreenMesh, ScreenTriangle};

use crate::render::device::shading_bins::{ShadingBin, ShadingBins, ShadowSources};
use crate::render::lighting::relief_bands::ReliefBands;
use crate::render::lighting::slopes_host::ReliefSlopes;
use crate::render::select::full_sun::FullSun;
use crate::render::select::ground_blocks::ground_blocks;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::{Selection, Slots, front_to_back};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::sky::{DOME_LEVEL, STAR_LEVEL, SUN_LEVEL};
use screen_mesh::SHADOW_SOURCES;
use surfaces::{FrameContext, visible_vertices};

/// What a mesh is made from, by its index in the selection.
#[derive(Clone, Copy, Debug)]
enum Source {
    Rock(usize),
    Block(usize),
    Stars,
    Sun,
    Dome,
}

/// Meshes that a thread takes at a time: few, for their costs differ widely.
const MAX_MESHES_PER_TASK: usize = 4;

/// Memory that meshes may keep beyond twice what the frame needs, bytes.
const MAX_SPARE_BYTES: usize = 8 << 20;

/// The last meshes are those of the sky: stars, sun and dome.
const SKY_MESHES: usize = 3;

/// The meshes of a frame in drawing order.
#[derive(Debug, Default)]
pub struct VisibleTriangles {
    meshes: Vec<ScreenMesh>,
    /// Meshes of earlier frames, kept for their memory, by their capacity for vertices: the meshes of another scene come in another
    /// order.
    spare: BTreeMap<usize, Vec<ScreenMesh>>,
    bins: ShadingBins,
    /// None if the ground has no relief below the size of its cells.
    slopes: Option<ReliefSlopes>,
}

impl VisibleTriangles {
    /// The relief below the size of the ground's cells, if there is any.
    #[must_use]
    pub const fn slopes(&self) -> Option<&ReliefSlopes> {
        self.slopes.as_ref()
    }

    /// Finds the triangles of a selection. `caster_grid` is that of [`crate::render::select::caster_grid`]. Unless
    /// `by_shadow_sources`, everything is classified as shaded by ground and rocks.
    pub fn find(
        &mut self,
        scene: &Scene,
        selection: &Selection,
        settings: &RenderSettings,
        caster_grid: &[u32],
        bands: &ReliefBands,
        by_shadow_sources: bool,
    ) {
        let bins = ShadingBins::new(bands.bands.len());
        self.bins = bins;
        let rays = settings.rays(&scene.camera);
        self.slopes = scene.relief.as_ref().map(|_| ReliefSlopes::new(bands, bins, rays, &scene.sun));
        let frame = FrameContext::new(scene, settings, caster_grid, by_shadow_sources);
        let sources = in_drawing_order(selection);
        let block_ranges: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
        self.take_meshes(sources.iter().map(|source| match *source {
            Source::Rock(index) => visible_vertices(scene, &selection.rocks[index]).len(),
            Source::Block(index) => {
                let [columns, rows] = &block_ranges[selection.blocks[index].0];
                (columns.len() + 1) * (rows.len() + 1)
            }
            Source::Stars => selection.stars.len() * Icosphere::vertex_count(STAR_LEVEL),
            Source::Sun => Icosphere::vertex_count(SUN_LEVEL),
            Source::Dome => Icosphere::vertex_count(DOME_LEVEL),
        }));
        let meshes = self.meshes.par_iter_mut().zip(sources).with_max_len(MAX_MESHES_PER_TASK);
        meshes.for_each(|(mesh, source)| match source {
            Source::Rock(index) => {
                mesh.restart(Slots::rock(index), ShadowSources::ALL.map(ShadingBins::rocks));
                mesh.add_rock(&frame, &selection.rocks[index]);
            }
            Source::Block(index) => {
                let (block, _) = selection.blocks[index];
                let band = bands.of_block(block);
                let bins = ShadowSources::ALL.map(|sources| ShadingBins::ground(band, sources));
                mesh.restart(Slots::GROUND, bins);
                mesh.add_ground_block(&frame, &block_ranges[block]);
            }
            Source::Stars => {
                mesh.restart(0, [bins.stars(); SHADOW_SOURCES]);
                for &star in &selection.stars {
                    let star = &scene.sky.stars[star];
                    mesh.add_sphere(&frame, STAR_LEVEL, star.centre, star.radius_m);
                }
            }
            Source::Sun => {
                mesh.restart(0, [bins.sun(); SHADOW_SOURCES]);
                if let Some(sun) = &selection.sun {
                    mesh.add_sphere(&frame, SUN_LEVEL, sun.centre, sun.radius_m);
                }
            }
            Source::Dome => {
                mesh.restart(0, [bins.dome(); SHADOW_SOURCES]);
                mesh.add_sphere(&frame, DOME_LEVEL, scene.sky.centre, scene.sky.radius_m);
            }
        });
        self.free_excess();
    }

    /// From now on samples of ground that see all of the sun past other ground are in the bins of ground that no other ground can shade.
    pub fn bin_by_full_sun(&mut self, full_sun: &FullSun, eye: Vec3) {
        self.slopes = self.slopes.take().map(|slopes| slopes.with_full_sun(full_sun.clone(), eye));
    }

    /// The bins that samples of a mesh may be in, and the bounds of these.
    pub fn bins_and_bounds(&self, mesh: &ScreenMesh) -> impl Iterator<Item = (ShadingBin, ScreenBounds)> {
        let by_full_sun = self.slopes.as_ref().is_some_and(ReliefSlopes::finds_full_sun);
        let bounds = mesh.bounds;
        let in_full_sun = (by_full_sun && mesh.slot == Slots::GROUND).then(|| {
            let pairs = [
                (ShadowSources::None, ShadowSources::Ground),
                (ShadowSources::Rocks, ShadowSources::GroundAndRocks),
            ];
            pairs.map(|(without, with)| (mesh.bins[without as usize], bounds[with as usize]))
        });
        mesh.bins.into_iter().zip(bounds).chain(in_full_sun.into_iter().flatten())
    }

    /// Takes meshes with capacity for these numbers of vertices in place of those of the last frame.
    fn take_meshes(&mut self, vertex_counts: impl Iterator<Item = usize>) {
        for mesh in self.meshes.drain(..) {
            self.spare.entry(mesh.vertex_capacity()).or_default().push(mesh);
        }
        self.meshes.extend(vertex_counts.map(|capacity| {
            let spare = self.spare.get_mut(&capacity).and_then(Vec::pop);
            spare.unwrap_or_else(|| ScreenMesh::with_capacity(capacity))
        }));
    }

    /// Frees memory where much more is kept than the frame needs.
    fn free_excess(&mut self) {
        let needed: usize = self.meshes.iter().map(ScreenMesh::needed_bytes).sum();
        let max_bytes = 2 * needed + MAX_SPARE_BYTES;
        if self.kept_bytes() <= max_bytes {
            return;
        }
        self.spare.clear();
        if self.kept_bytes() > max_bytes {
            self.meshes.par_iter_mut().for_each(ScreenMesh::free_excess);
        }
    }

    /// Bytes that are allocated for meshes.
    fn kept_bytes(&self) -> usize {
        self.meshes.iter().chain(self.spare.values().flatten()).map(ScreenMesh::kept_bytes).sum()
    }

    /// The shading bins of the frame.
    #[must_use]
    pub const fn bins(&self) -> ShadingBins {
        self.bins
    }

    /// Rows of samples that may show ground or rocks; all others show the sky.
    #[must_use]
    pub fn surface_rows(&self) -> Range<u32> {
        let surfaces = &self.meshes[..self.meshes.len().saturating_sub(SKY_MESHES)];
        let first = surfaces.iter().map(|mesh| mesh.rows[0]).min().unwrap_or(u16::MAX);
        let last = surfaces.iter().map(|mesh| mesh.rows[1]).max().unwrap_or(0);
        if first <= last { first.into()..u32::from(last) + 1 } else { 0..0 }
    }

    /// The meshes in drawing order.
    #[must_use]
    pub fn meshes(&self) -> &[ScreenMesh] {
        &self.meshes
    }
}

/// Rocks from near to far, ground from near to far, sky: what is drawn early occludes what is drawn late.
fn in_drawing_order(selection: &Selection) -> Vec<Source> {
    let rocks = selection.rocks.iter().enumerate().filter(|(_, rock)| rock.visible_level.is_some());
    let rocks = front_to_back(rocks.map(|(index, rock)| (rock.nearest_m, index)));
    let blocks = selection.blocks.iter().enumerate();
    let blocks = front_to_back(blocks.map(|(index, &(_, nearest_m))| (nearest_m, index)));
    (rocks.iter().map(|&(_, index)| Source::Rock(index)))
        .chain(blocks.iter().map(|&(_, index)| Source::Block(index)))
        .chain([Source::Stars, Source::Sun, Source::Dome])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_keep_memory_for_their_size_and_no_more() {
        let mut triangles = VisibleTriangles::default();
        let capacities = [12, 2562, 12, 42];
        triangles.take_meshes(capacities.into_iter());
        triangles.meshes[1].triangles.reserve(1 << 20);
        let large = triangles.meshes[1].triangles.as_ptr();
        triangles.take_meshes([42, 12, 2562].into_iter());
        assert_eq!(
            triangles.meshes.iter().map(ScreenMesh::vertex_capacity).collect::<Vec<_>>(),
            [42, 12, 2562]
        );
        assert_eq!(triangles.meshes[2].triangles.as_ptr(), large, "the memory of the mesh of this size");
        assert!(triangles.kept_bytes() > 2 * MAX_SPARE_BYTES);
        triangles.take_meshes([12].into_iter());
        triangles.meshes[0].triangles.reserve(100);
        triangles.free_excess();
        assert!(triangles.kept_bytes() <= MAX_SPARE_BYTES, "{} bytes", triangles.kept_bytes());
        assert!(triangles.meshes[0].triangles.capacity() >= 100, "a little is kept");
        triangles.meshes[0].triangles.reserve(1 << 20);
        triangles.free_excess();
        assert!(triangles.kept_bytes() <= MAX_SPARE_BYTES, "{} bytes", triangles.kept_bytes());
    }
}
