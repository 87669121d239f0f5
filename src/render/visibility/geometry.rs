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

use std::ops::Range;

use rayon::prelude::*;

pub use projection::ScreenVertex;
pub use screen_mesh::{ScreenMesh, ScreenTriangle};

use crate::render::device::shading_bins::{ShadingBins, ShadowSources};
use crate::render::lighting::relief_bands::ReliefBands;
use crate::render::lighting::slopes_host::ReliefSlopes;
use crate::render::select::ground_blocks::ground_blocks;
use crate::render::select::selection::{Selection, Slots, front_to_back};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::sky::{DOME_LEVEL, STAR_LEVEL, SUN_LEVEL};
use screen_mesh::SHADOW_SOURCES;
use surfaces::FrameContext;

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

/// The meshes of a frame in drawing order. Kept between frames for their memory.
#[derive(Debug, Default)]
pub struct VisibleTriangles {
    meshes: Vec<ScreenMesh>,
    mesh_count: usize,
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

    /// Finds the triangles of a selection. `caster_grid` is that of [`crate::render::select::caster_grid::caster_grid`]. Unless
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
        self.mesh_count = sources.len();
        if self.meshes.len() < self.mesh_count {
            self.meshes.resize_with(self.mesh_count, ScreenMesh::default);
        }
        let block_ranges: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
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

    /// Frees memory where much more is kept than the frame needs. The meshes of another scene come in another order, so that
    /// without an end each would grow to the size of the largest.
    fn free_excess(&mut self) {
        let needed: usize = self.meshes().iter().map(ScreenMesh::needed_bytes).sum();
        let kept: usize = self.meshes.iter().map(ScreenMesh::kept_bytes).sum();
        if kept > 2 * needed + MAX_SPARE_BYTES {
            self.meshes.truncate(self.mesh_count);
            self.meshes.par_iter_mut().for_each(ScreenMesh::free_excess);
        }
    }

    /// The shading bins of the frame.
    #[must_use]
    pub const fn bins(&self) -> ShadingBins {
        self.bins
    }

    /// Rows of samples that may show ground or rocks; all others show the sky.
    #[must_use]
    pub fn surface_rows(&self) -> Range<u32> {
        let surfaces = &self.meshes()[..self.mesh_count.saturating_sub(SKY_MESHES)];
        let first = surfaces.iter().map(|mesh| mesh.rows[0]).min().unwrap_or(u16::MAX);
        let last = surfaces.iter().map(|mesh| mesh.rows[1]).max().unwrap_or(0);
        if first <= last { first.into()..u32::from(last) + 1 } else { 0..0 }
    }

    /// The meshes in drawing order.
    #[must_use]
    pub fn meshes(&self) -> &[ScreenMesh] {
        &self.meshes[..self.mesh_count]
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
    fn meshes_do_not_keep_the_memory_of_larger_ones() {
        let mut triangles = VisibleTriangles::default();
        triangles.meshes.resize_with(100, ScreenMesh::default);
        triangles.mesh_count = 10;
        for mesh in &mut triangles.meshes {
            mesh.triangles.reserve(1 << 16);
        }
        let kept = |triangles: &VisibleTriangles| -> usize {
            triangles.meshes.iter().map(ScreenMesh::kept_bytes).sum()
        };
        assert!(kept(&triangles) > 10 * MAX_SPARE_BYTES);
        triangles.free_excess();
        assert!(kept(&triangles) <= MAX_SPARE_BYTES, "{} bytes", kept(&triangles));
        triangles.meshes[0].triangles.reserve(100);
        triangles.free_excess();
        assert!(triangles.meshes[0].triangles.capacity() >= 100, "a little is kept");
    }
}
