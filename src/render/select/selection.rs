//! What of a scene is drawn for one picture: blocks of ground, rocks with their level of detail, casters, stars.
//!
//! A function of scene and settings alone, so that an export can hold exactly what a frame draws.
//! Must not know: buffers.

use std::ops::Range;

use glam::{Mat4, UVec2, Vec2, Vec3, Vec4};

use crate::render::select::casters::{self, Caster};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::rocks::Rock;
use crate::scene::terrain::Terrain;

/// Largest distance of a caster's drawn outline from the authored one, texels of its tile.
const CASTER_ERROR_PX: f32 = 0.25;
/// Cells along a side of a block of ground that is culled as one.
pub const BLOCK_CELLS: u32 = 30;

/// What is drawn for one picture.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Blocks of ground that may be seen, by their place in [`ground_blocks`], with their distance in metres. All of
    /// the ground casts shadows.
    pub blocks: Vec<(usize, f32)>,
    /// Rocks that may be seen, or whose shadow may, by rising index.
    pub rocks: Vec<SelectedRock>,
    /// Indices of the stars that may be seen.
    pub stars: Vec<usize>,
    /// Rocks whose shadow may be seen.
    pub casters: Vec<Caster>,
    /// What the camera sees.
    pub frustum: Frustum,
}

/// A rock that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelectedRock {
    /// Its index in the scene.
    pub rock: usize,
    /// Distance of the nearest it can be to the eye, metres.
    pub nearest_m: f32,
    /// Level of the icosphere that it is seen at.
    pub seen_level: Option<usize>,
    /// Index in [`Selection::casters`] and level that it casts its shadow with.
    pub caster: Option<(usize, usize)>,
}

impl Selection {
    /// What these settings draw of a scene.
    #[must_use]
    pub fn new(scene: &Scene, settings: &RenderSettings) -> Self {
        let camera = &scene.camera;
        let frustum = Frustum::new(&camera.clip_from_world(settings.size));
        let pixel_angle = 1.0 / camera.focal_px(settings.size[0]) as f32;
        let near = rocks_within(scene, &frustum);
        let casters = casters::casters(scene, &near, &frustum, settings.size);
        let blocks = ground_blocks(&scene.terrain)
            .enumerate()
            .filter_map(|(block, [columns, rows])| {
                let (low, high) = block_bounds(scene, &columns, &rows);
                let nearest_m = camera.eye.clamp(low, high).distance(camera.eye);
                frustum.may_see_box(low, high).then_some((block, nearest_m))
            })
            .collect();
        let mut next_caster = casters.iter().enumerate().peekable();
        let rocks = near
            .into_iter()
            .map(|(index, rock)| {
                let nearest_m = (rock.centre.distance(camera.eye) - rock.radius_m).max(0.0);
                let seen = frustum.may_see_ball(rock.centre, rock.radius_m);
                let outline_error_m = settings.outline_error_px * pixel_angle * nearest_m;
                let seen_level = seen.then(|| coarsest_level(rock, outline_error_m));
                // What is seen casts as it is seen, or its shadow would not fit it.
                let caster =
                    next_caster.next_if(|(_, caster)| caster.rock == index).map(|(place, caster)| {
                        let texel_m = 2.0 * caster.tile.half_extent_m / caster.tile.size_px;
                        (place, seen_level.unwrap_or_else(|| coarsest_level(rock, CASTER_ERROR_PX * texel_m)))
                    });
                SelectedRock { rock: index, nearest_m, seen_level, caster }
            })
            .filter(|selected| selected.seen_level.is_some() || selected.caster.is_some())
            .collect();
        let stars = (0..scene.sky.stars.len())
            .filter(|&star| {
                frustum.may_see_ball(scene.sky.stars[star].centre, scene.sky.stars[star].radius_m)
            })
            .collect();
        Self { blocks, rocks, stars, casters, frustum }
    }

    /// Where its instances stand.
    #[must_use]
    pub const fn slots(&self) -> Slots<'_> {
        Slots { selection: self }
    }
}

/// Builds the rocks that a picture of the scene may show, which else waits for them.
pub fn build_rocks(scene: &Scene, settings: &RenderSettings) {
    rocks_within(scene, &Frustum::new(&scene.camera.clip_from_world(settings.size)));
}

/// The rocks that may be seen, or whose shadow may, by their index in the scene, and some more.
fn rocks_within<'a>(scene: &'a Scene, frustum: &Frustum) -> Vec<(usize, &'a Rock)> {
    scene.rocks.that_may(|rock| {
        let [low, high] = rock.centres;
        let (reach_m, width_m) = casters::reach_m(scene, high.z + rock.radius_m, rock.radius_m);
        let shadow = -reach_m * scene.sun.direction;
        let corners = [low, high, low + shadow, high + shadow].map(|corner| corner.extend(1.0));
        let furthest_m =
            |plane: Vec4| corners.map(|corner| plane.dot(corner)).into_iter().fold(f32::MIN, f32::max);
        frustum.may_see(|plane| furthest_m(plane) + width_m)
    })
}

/// Where the instances of a picture stand: ground, rocks, stars, dome.
#[derive(Clone, Copy, Debug)]
pub struct Slots<'a> {
    selection: &'a Selection,
}

impl<'a> Slots<'a> {
    /// What they are of.
    #[must_use]
    pub const fn selection(self) -> &'a Selection {
        self.selection
    }

    /// Of the ground.
    pub const GROUND: u32 = 0;

    /// Of the rock at a place in [`Selection::rocks`].
    #[must_use]
    pub const fn rock(place: usize) -> u32 {
        place as u32 + 1
    }

    /// Of the stars.
    #[must_use]
    pub fn stars(self) -> Range<u32> {
        let first = Self::rock(self.selection.rocks.len());
        first..first + self.selection.stars.len() as u32
    }

    /// Of the dome, the last.
    #[must_use]
    pub fn dome(self) -> Range<u32> {
        let dome = self.stars().end;
        dome..dome + 1
    }
}

/// Things by rising distance.
pub fn near_to_far<T>(things: impl Iterator<Item = (f32, T)>) -> Vec<(f32, T)> {
    let mut list: Vec<_> = things.collect();
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}

/// Columns and rows of the ground's cells in each block.
pub fn ground_blocks(terrain: &Terrain) -> impl Iterator<Item = [Range<u32>; 2]> + use<> {
    let spans = |cells: u32| {
        (0..cells).step_by(BLOCK_CELLS as usize).map(move |first| first..(first + BLOCK_CELLS).min(cells))
    };
    let (columns, rows) = (terrain.columns, terrain.rows);
    spans(rows).flat_map(move |rows| spans(columns).map(move |columns| [columns, rows.clone()]))
}

/// The coarsest level of a rock's mesh that stays this close to the authored one.
fn coarsest_level(rock: &Rock, allowed_m: f32) -> usize {
    rock.level_errors_m.iter().position(|&error_m| error_m <= allowed_m).unwrap_or(rock.level)
}

/// Lowest and highest corner of the box around a block of the ground.
fn block_bounds(scene: &Scene, columns: &Range<u32>, rows: &Range<u32>) -> (Vec3, Vec3) {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let row_len = scene.terrain.columns as usize + 1;
    for row in rows.start..=rows.end {
        let first = row as usize * row_len;
        for vertex in &scene.terrain.vertices[first + columns.start as usize..=first + columns.end as usize] {
            low = low.min(vertex.position);
            high = high.max(vertex.position);
        }
    }
    (low, high)
}

/// A rectangle of the picture outside of which something is not seen, samples; it may reach beyond the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    low: Vec2,
    high: Vec2,
}

impl Bounds {
    /// Of nothing.
    pub const NOWHERE: Self = Self { low: Vec2::INFINITY, high: Vec2::NEG_INFINITY };
    /// Of what may be anywhere.
    pub const ANYWHERE: Self = Self { low: Vec2::NEG_INFINITY, high: Vec2::INFINITY };

    /// Of samples from a column and a row to others, with them.
    #[must_use]
    pub fn of_samples(columns: (i32, i32), rows: (i32, i32)) -> Self {
        let at = |column: i32, row: i32| Vec2::new(column as f32, row as f32);
        Self { low: at(columns.0, rows.0), high: at(columns.1, rows.1) }
    }

    /// Of a ball in the world.
    #[must_use]
    pub fn of_ball(scene: &Scene, settings: &RenderSettings, centre: Vec3, radius_m: f32) -> Self {
        let camera = &scene.camera;
        let offset = centre - camera.eye;
        let ahead_m = offset.dot(camera.forward);
        if ahead_m <= radius_m + camera.near_m {
            return Self::ANYWHERE;
        }
        let focal = settings.focal_samples(camera);
        let middle = 0.5 * UVec2::from(settings.sample_size()).as_vec2();
        let at = Vec2::new(offset.dot(camera.right), -offset.dot(camera.up));
        let (near, far) = (focal / (ahead_m - radius_m), focal / (ahead_m + radius_m));
        let (low, high) = (at - radius_m, at + radius_m);
        Self { low: middle + (low * near).min(low * far), high: middle + (high * near).max(high * far) }
    }

    /// Of both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Left, top, width and height of what it covers, and a sample around, of a picture of this many samples.
    #[must_use]
    pub fn within(self, sample_size: [u32; 2]) -> [u32; 4] {
        let size = UVec2::from(sample_size);
        let [low, high] = [self.low, self.high].map(|place| place.clamp(Vec2::ZERO, size.as_vec2()));
        let (low, high) = ((low - 1.0).max(Vec2::ZERO).as_uvec2(), (high + 2.0).as_uvec2().min(size));
        let extent = high.saturating_sub(low);
        [low.x, low.y, extent.x, extent.y]
    }
}

impl Default for Bounds {
    fn default() -> Self {
        Self::NOWHERE
    }
}

/// The six planes that bound what the camera sees. Tests may say yes for a thing just outside, never no for one
/// inside.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    /// Normals inward, unit; distance in w.
    planes: [Vec4; 5],
}

impl Frustum {
    /// The frustum of a reversed-depth projection, without its far plane (the sky's dome lies before it).
    #[must_use]
    pub fn new(clip_from_world: &Mat4) -> Self {
        let row = |i| clip_from_world.row(i);
        let planes = [row(3) + row(0), row(3) - row(0), row(3) + row(1), row(3) - row(1), row(3) - row(2)];
        Self { planes: planes.map(|plane| plane / plane.truncate().length()) }
    }

    /// The planes, except the far one: normals inward, unit; distance in w.
    #[must_use]
    pub const fn planes(&self) -> [Vec4; 5] {
        self.planes
    }

    fn may_see(&self, furthest_inside: impl Fn(Vec4) -> f32) -> bool {
        self.planes.iter().all(|&plane| furthest_inside(plane) >= 0.0)
    }

    /// Whether a ball may be seen.
    #[must_use]
    pub fn may_see_ball(&self, centre: Vec3, radius_m: f32) -> bool {
        self.may_see_swept_ball(centre, centre, radius_m)
    }

    /// Whether a ball that moves from `start` to `end` may be seen anywhere on its way.
    #[must_use]
    pub fn may_see_swept_ball(&self, start: Vec3, end: Vec3, radius_m: f32) -> bool {
        self.may_see(|plane| plane.dot(start.extend(1.0)).max(plane.dot(end.extend(1.0))) + radius_m)
    }

    /// Whether a box may be seen.
    #[must_use]
    pub fn may_see_box(&self, low: Vec3, high: Vec3) -> bool {
        self.may_see(|plane| {
            let corner = Vec3::select(plane.truncate().cmpge(Vec3::ZERO), high, low);
            plane.dot(corner.extend(1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Params;
    use crate::scene::camera::Camera;

    #[test]
    fn only_rocks_that_may_show_are_built_and_all_of_them_are_selected() {
        let settings = RenderSettings::new([512, 512], 4).expect("settings");
        let (mut all, mut built, mut drawn) = (0, 0, 0);
        for seed in 0..8 {
            let [scene, whole] =
                [(); 2].map(|()| Scene::build(seed, &Params::draw_default(seed)).expect("a scene"));
            build_rocks(&scene, &settings);
            all += whole.rocks.iter().count();
            built += scene.rocks.built().count();
            let [selection, of_whole] = [&scene, &whole].map(|scene| Selection::new(scene, &settings));
            drawn += selection.rocks.len();
            assert_eq!(selection.rocks, of_whole.rocks, "seed {seed}");
            assert!(scene.rocks.built().count() < whole.rocks.len(), "seed {seed}");
        }
        // What a rock is looked for by is larger than it.
        assert!(
            drawn <= built && (built as f64) < 1.03 * drawn as f64 && built < all,
            "{drawn} {built} {all}"
        );
    }

    #[test]
    fn frustum_sees_what_is_before_the_lens_and_nothing_behind_it() {
        let camera = Camera::new(Vec3::new(0.0, -90.0, 2.0), [0.0, 0.0, 0.0], 60.0, 2000.0, 0.0);
        let frustum = Frustum::new(&camera.clip_from_world([64, 64]));
        let at = |x: f32, y: f32| Vec3::new(x, y, 2.0);
        assert!(frustum.may_see_ball(at(0.0, 0.0), 0.1));
        assert!(!frustum.may_see_ball(at(0.0, -100.0), 1.0));
        assert!(!frustum.may_see_ball(at(80.0, -50.0), 1.0));
        assert!(frustum.may_see_ball(at(24.0, -50.0), 2.0), "just outside, but its side is in view");
        assert!(frustum.may_see_swept_ball(at(80.0, -50.0), at(0.0, -50.0), 1.0));
        assert!(frustum.may_see_box(at(-1.0, -80.0), at(1.0, -70.0)));
        assert!(!frustum.may_see_box(at(-1.0, -130.0), at(1.0, -110.0)));
    }
}
