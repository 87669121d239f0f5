//! What of a scene one frame draws: blocks of ground, rocks with their level of detail, shadow casters, stars, the sun.
//!
//! Culling is conservative, and levels of detail are chosen by the error of the outline in the image (Real-Time Rendering, 4th ed.,
//! section 19.9). A function of scene and settings alone, so that an export can hold exactly what a frame draws.
//! Must not know: buffers.

use std::ops::Range;

use glam::Vec4;

use crate::render::select::casters::{self, Caster};
use crate::render::select::frustum::Frustum;
use crate::render::select::ground_blocks::block_bounds;
use crate::render::settings::{DEFAULT_TEXTURE_PX, RenderSettings};
use crate::scene::Scene;
use crate::scene::rocks::Rock;
use crate::scene::sky::Star;

/// Largest distance between the outline of a caster that is drawn and that of its finest mesh, texels of its tile.
const CASTER_ERROR_PX: f32 = 0.25;

/// What is drawn for one frame.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Blocks of ground that intersect the frustum: index in `ground_blocks` and distance from the eye, metres. All of the
    /// ground casts shadows.
    pub blocks: Vec<(usize, f32)>,
    /// Rocks that may be visible, or whose shadow may be, by rising index.
    pub rocks: Vec<SelectedRock>,
    /// Indices of the stars that may be visible.
    pub stars: Vec<usize>,
    /// The sun's disc, if it may be visible.
    pub sun: Option<Star>,
    /// Rocks whose shadow may be visible.
    pub casters: Vec<Caster>,
    /// The camera's frustum.
    pub frustum: Frustum,
}

/// A rock that is drawn in the image, in the shadow map, or in both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelectedRock {
    /// Its index in the scene.
    pub rock: usize,
    /// Lower bound of its distance from the eye, metres.
    pub nearest_m: f32,
    /// Level of the icosphere that the image shows; `None` if it is outside of the frustum.
    pub visible_level: Option<usize>,
    /// Index in [`Selection::casters`] and level of the icosphere that casts the shadow.
    pub caster: Option<(usize, usize)>,
}

impl Selection {
    /// Culls a scene and chooses levels of detail, for a device with WebGPU's default limits.
    #[must_use]
    pub fn new(scene: &Scene, settings: &RenderSettings) -> Self {
        Self::within(scene, settings, DEFAULT_TEXTURE_PX)
    }

    /// The same for a device whose textures have at most `max_texture_px` columns and rows.
    pub(crate) fn within(scene: &Scene, settings: &RenderSettings, max_texture_px: u32) -> Self {
        let camera = &scene.camera;
        let frustum = Frustum::new(&camera.clip_from_world(settings.size));
        let candidates = cull_rocks(scene, &frustum);
        let blocks: Vec<(usize, f32)> = block_bounds(&scene.terrain)
            .iter()
            .enumerate()
            .filter_map(|(block, &[low, high])| {
                let nearest_m = camera.eye.clamp(low, high).distance(camera.eye);
                frustum.intersects_box(low, high).then_some((block, nearest_m))
            })
            .collect();
        let nearest_in_view_m = nearest_visible_m(scene, &frustum, &blocks, &candidates);
        let image = (settings.size, nearest_in_view_m);
        let casters = casters::select_casters(scene, &candidates, &frustum, image, max_texture_px);
        let mut next_caster = casters.iter().enumerate().peekable();
        let rocks = candidates
            .into_iter()
            .map(|(index, rock)| {
                let nearest_m = nearest_m(scene, rock);
                let visible_level = visible_level(scene, settings, &frustum, rock);
                // A visible rock casts its shadow with the mesh that the image shows, or the shadow would not fit it.
                let caster =
                    next_caster.next_if(|(_, caster)| caster.rock == index).map(|(caster_index, caster)| {
                        let texel_m = 2.0 * caster.tile.half_extent_m / caster.tile.size_px;
                        let level =
                            visible_level.unwrap_or_else(|| coarsest_level(rock, CASTER_ERROR_PX * texel_m));
                        (caster_index, level)
                    });
                SelectedRock { rock: index, nearest_m, visible_level, caster }
            })
            .filter(|selected| selected.visible_level.is_some() || selected.caster.is_some())
            .collect();
        let is_in_view = |star: &Star| frustum.intersects_sphere(star.centre, star.radius_m);
        let sun = scene.sky.sun_disc(&scene.sun, camera.eye).filter(is_in_view);
        let stars = (0..scene.sky.stars.len())
            .filter(|&star| {
                let star = &scene.sky.stars[star];
                is_in_view(star) && !sun.is_some_and(|sun| sun.overlaps(star, camera.eye))
            })
            .collect();
        Self { blocks, rocks, stars, sun, casters, frustum }
    }

    /// The slots of its instances.
    #[must_use]
    pub const fn slots(&self) -> Slots<'_> {
        Slots { selection: self }
    }
}

/// Lower bound of the distance from the eye of all ground and rocks in view, metres; 0 on the nominal stage.
fn nearest_visible_m(
    scene: &Scene,
    frustum: &Frustum,
    blocks: &[(usize, f32)],
    rocks: &[(usize, &Rock)],
) -> f32 {
    if scene.relief.is_none() {
        return 0.0;
    }
    let visible = rocks.iter().filter(|(_, rock)| frustum.intersects_sphere(rock.centre, rock.radius_m));
    let of_rocks = visible.map(|(_, rock)| rock.centre.distance(scene.camera.eye) - rock.radius_m);
    of_rocks.chain(blocks.iter().map(|(_, nearest_m)| *nearest_m)).fold(f32::MAX, f32::min).max(0.0)
}

/// Builds the rocks that a frame of the scene may need. Rocks are otherwise built on demand, when a frame is drawn.
pub fn build_rocks(scene: &Scene, settings: &RenderSettings) {
    cull_rocks(scene, &Frustum::new(&scene.camera.clip_from_world(settings.size)));
}

/// The rocks that may be visible, or whose shadow may be, with their index in the scene. The test bounds a rock that is not built
/// yet, so it accepts a few more than are drawn.
fn cull_rocks<'a>(scene: &'a Scene, frustum: &Frustum) -> Vec<(usize, &'a Rock)> {
    scene.rocks.build_where(|rock| {
        let [low, high] = rock.centres;
        let (reach_m, width_m) = casters::shadow_extent_m(scene, high.z + rock.radius_m, rock.radius_m);
        let shadow = -reach_m * scene.sun.direction;
        let corners = [low, high, low + shadow, high + shadow].map(|corner| corner.extend(1.0));
        let furthest_m =
            |plane: Vec4| corners.map(|corner| plane.dot(corner)).into_iter().fold(f32::MIN, f32::max);
        frustum.intersects_convex(|plane| furthest_m(plane) + width_m)
    })
}

/// Indices of the instances of a frame in the instance buffer, in this order: ground, rocks, stars, sun, dome, ground by
/// relief band.
#[derive(Clone, Copy, Debug)]
pub struct Slots<'a> {
    selection: &'a Selection,
}

impl<'a> Slots<'a> {
    /// The selection whose instances these are.
    #[must_use]
    pub const fn selection(self) -> &'a Selection {
        self.selection
    }

    /// Slot of the ground, the first.
    pub const GROUND: u32 = 0;

    /// Slot of the rock at an index in [`Selection::rocks`].
    #[must_use]
    pub const fn rock(index: usize) -> u32 {
        index as u32 + 1
    }

    /// Slots of the stars.
    #[must_use]
    pub fn stars(self) -> Range<u32> {
        let first = Self::rock(self.selection.rocks.len());
        first..first + self.selection.stars.len() as u32
    }

    /// Slot of the sun's disc, if it may be visible.
    #[must_use]
    pub fn sun(self) -> Range<u32> {
        let sun = self.stars().end;
        sun..sun + u32::from(self.selection.sun.is_some())
    }

    /// Slot of the sky's dome.
    #[must_use]
    pub fn dome(self) -> Range<u32> {
        let dome = self.sun().end;
        dome..dome + 1
    }

    /// Slot of the ground of a relief band, where samples look up their relief by their instance.
    #[must_use]
    pub fn ground_of_band(self, band: usize) -> u32 {
        self.dome().end + band as u32
    }
}

/// Sorts items by rising distance, so that the depth test rejects most hidden fragments before they are shaded.
pub fn front_to_back<T>(items: impl Iterator<Item = (f32, T)>) -> Vec<(f32, T)> {
    let mut list: Vec<_> = items.collect();
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}

/// The level of the icosphere that an image shows of a rock; `None` if it is outside of the image's frustum.
#[must_use]
pub(crate) fn visible_level(
    scene: &Scene,
    settings: &RenderSettings,
    frustum: &Frustum,
    rock: &Rock,
) -> Option<usize> {
    let is_visible = rock.body.is_visible() && frustum.intersects_sphere(rock.centre, rock.radius_m);
    let pixel_angle = 1.0 / scene.camera.focal_px(settings.size[0]) as f32;
    is_visible.then(|| coarsest_level(rock, settings.outline_error_px * pixel_angle * nearest_m(scene, rock)))
}

/// Lower bound of the distance of a rock from the eye, metres.
fn nearest_m(scene: &Scene, rock: &Rock) -> f32 {
    (rock.centre.distance(scene.camera.eye) - rock.radius_m).max(0.0)
}

/// The coarsest level of detail whose outline is within an error of that of the finest mesh, metres.
fn coarsest_level(rock: &Rock, max_error_m: f32) -> usize {
    rock.level_errors_m.iter().position(|&error_m| error_m <= max_error_m).unwrap_or(rock.level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;

    #[test]
    fn only_candidate_rocks_are_built_and_the_selection_does_not_miss_any() {
        let settings = RenderSettings::new([512, 512], 4).expect("settings");
        let (mut all, mut built, mut drawn) = (0, 0, 0);
        for seed in 0..8 {
            let [scene, whole] =
                [(); 2].map(|()| Scene::build(seed, &Params::draw_default(seed)).expect("a scene"));
            build_rocks(&scene, &settings);
            all += whole.rocks.iter().count();
            built += scene.rocks.built().count();
            let [selection, selection_of_whole] =
                [&scene, &whole].map(|scene| Selection::new(scene, &settings));
            drawn += selection.rocks.len();
            assert_eq!(selection.rocks, selection_of_whole.rocks, "seed {seed}");
            assert!(scene.rocks.built().count() < whole.rocks.len(), "seed {seed}");
        }
        // The bounds of a rock that is not built are larger than it.
        assert!(
            drawn <= built && (built as f64) < 1.03 * drawn as f64 && built < all,
            "{drawn} {built} {all}"
        );
    }
}
