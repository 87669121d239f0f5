//! The texels of a caster's tile that lighting can sample: where its shadow lies in view. A caster beside the image has a large
//! tile, of which the image may show the edge of a shadow, or nothing.
//!
//! Bounds are conservative: convex volumes hold all ground in view that the tile is sampled for, and intervals are propagated through
//! their planes, which only ever gives too much; rocks in view are bounded by spheres.
//! Must not know: how a tile is drawn.

use std::ops::Range;

use glam::{Mat3, Vec2, Vec3, Vec4};

use crate::render::select::caster_grid::CasterGrids;
use crate::render::select::casters::Caster;
use crate::render::select::frustum::Frustum;
use crate::render::select::selection::{SelectedRock, Selection};
use crate::render::select::shadow_strip::Rays;
use crate::scene::Scene;
use crate::scene::ground_range::GroundRange;

/// Parts that a shadow is divided into along the sun's rays: bounds of a short part are tight.
const PARTS: usize = 24;
/// Rounds of propagation through all planes.
const ROUNDS: usize = 3;
/// Margin around what is sampled for rounding and bilinear filtering, texels.
const MARGIN_PX: f32 = 3.0;
/// Margin of lengths for rounding, as a fraction of them.
const MARGIN: f32 = 1e-3;
/// How far a surface in the image may lie from its mesh, metres, and as a fraction of its distance: where a triangle ends, depth is
/// interpolated a little beyond it.
const OFF_MESH_M: f32 = 0.05;
const OFF_MESH: f32 = 0.01;

/// A rectangle of texels of a tile.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct TexelRect {
    /// Its columns.
    pub(crate) columns: Range<usize>,
    /// Its rows.
    pub(crate) rows: Range<usize>,
}

impl TexelRect {
    /// All texels of a tile of this size.
    #[must_use]
    pub(crate) const fn whole(size: usize) -> Self {
        Self { columns: 0..size, rows: 0..size }
    }

    /// Whether it holds all of another one.
    #[must_use]
    pub(crate) fn contains(&self, other: &Self) -> bool {
        let within =
            |inner: &Range<usize>, outer: &Range<usize>| outer.start <= inner.start && inner.end <= outer.end;
        other.is_empty() || (within(&other.columns, &self.columns) && within(&other.rows, &self.rows))
    }

    /// Whether it has no texel.
    #[must_use]
    pub(crate) fn is_empty(&self) -> bool {
        self.columns.is_empty() || self.rows.is_empty()
    }
}

/// A box in coordinates of the sun's rays from the centre of a caster: right, up and towards the sun, metres.
#[derive(Clone, Copy, Debug)]
struct LightBox {
    low: Vec3,
    high: Vec3,
}

impl LightBox {
    fn is_empty(&self) -> bool {
        self.low.cmpgt(self.high).any()
    }

    /// Shrinks the box to what may lie on the inner side of a plane, whose normal has these coordinates too.
    fn clip(&mut self, plane: Vec4) {
        let normal = plane.truncate();
        // The greatest signed distance of each coordinate's part.
        let greatest = (normal * self.low).max(normal * self.high);
        let rest = Vec3::splat(plane.w + greatest.element_sum()) - greatest;
        for axis in 0..3 {
            // normal * coordinate + rest >= 0.
            let limit = -rest[axis] / normal[axis];
            if normal[axis] > 1e-6 {
                self.low[axis] = self.low[axis].max(limit);
            } else if normal[axis] < -1e-6 {
                self.high[axis] = self.high[axis].min(limit);
            }
        }
    }
}

/// The surfaces in view of an image, on ground with rings.
#[derive(Clone, Debug)]
pub(crate) struct SurfacesInView<'a> {
    scene: &'a Scene,
    ground: &'a GroundRange,
    frustum: &'a Frustum,
    /// Spheres around the rocks: centre, world, and radius, metres.
    rocks: Vec<(Vec3, f32)>,
}

impl<'a> SurfacesInView<'a> {
    /// Those of a selection of a scene; `None` where the ground has no rings.
    #[must_use]
    pub(crate) fn new(scene: &'a Scene, selection: &'a Selection) -> Option<Self> {
        let ground = scene.terrain.range()?;
        let visible = selection.rocks.iter().filter(|selected| selected.visible_level.is_some());
        let sphere = |selected: &SelectedRock| {
            let rock = &scene.rocks[selected.rock];
            let off_mesh_m = off_mesh_m(scene.camera.eye, rock.centre);
            (rock.centre, rock.radius_m * (1.0 + OFF_MESH) + off_mesh_m)
        };
        let rocks = visible.map(sphere).collect();
        Some(Self { scene, ground, frustum: &selection.frustum, rocks })
    }

    /// The texels of the tile of a caster that they can sample.
    #[must_use]
    pub(crate) fn sampled_texels(&self, caster: &Caster) -> TexelRect {
        let (scene, tile) = (self.scene, &caster.tile);
        let sun = &scene.sun;
        let [right, up] = sun.right_and_up();
        let listed = listed_ground(scene, caster);
        let [low, high] = listed;
        let to_corner = (low - tile.centre.truncate()).abs().max((high - tile.centre.truncate()).abs());
        let drop_m = (tile.centre.z - scene.terrain.z_range_m[0]).abs() + 1.0;
        let shadow = Shadow {
            basis: Mat3::from_cols(right, up, sun.direction),
            centre: tile.centre,
            half_m: tile.half_extent_m,
            length_m: to_corner.length() * sun.direction.truncate().length() + drop_m * sun.direction.z.abs(),
            penumbra: sun.tan_half_angle(),
            listed,
            eye: scene.camera.eye,
        };
        let mut bounds = shadow.of_ground(self.ground, self.frustum);
        for &(centre, radius_m) in &self.rocks {
            if let Some([low, high]) = shadow.of_sphere(centre, radius_m) {
                bounds = [bounds[0].min(low), bounds[1].max(high)];
            }
        }
        texels_of(bounds, tile.half_extent_m, tile.size_px)
    }
}

/// How far surfaces at a point may lie from their meshes, metres.
fn off_mesh_m(eye: Vec3, point: Vec3) -> f32 {
    OFF_MESH_M + OFF_MESH * eye.distance(point)
}

/// Bounds of the ground, seen from above, whose cells of the caster grid may list a caster: lowest and highest corner, world, metres.
fn listed_ground(scene: &Scene, caster: &Caster) -> [Vec2; 2] {
    let grids = CasterGrids::new(&scene.terrain);
    let [low, high] = Rays::new(&scene.sun).bounds(scene, caster);
    let [from, to] = [low, high].map(|corner| corner - grids.centre);
    let furthest_m = from.abs().max(to.abs()).max_element();
    // The finest grid that covers a point reaches at most twice as far, the innermost aside.
    let cell_m = 2.0 * (2.2 * furthest_m).max(grids.half_m) / grids.cells as f32;
    let margin_m = 2.0 * cell_m;
    // The cells at the border also serve what lies beyond.
    let border_m = grids.half_m * (1_u32 << (grids.levels - 1)) as f32;
    let is_inside = |at_m: f32| at_m.abs() + margin_m < border_m;
    let bound = |corner: Vec2, from: Vec2, margin_m: f32, beyond_m: f32| {
        let axis = |axis: usize| {
            if is_inside(from[axis]) { corner[axis] + margin_m } else { grids.centre[axis] + beyond_m }
        };
        Vec2::new(axis(0), axis(1))
    };
    [bound(low, from, -margin_m, -2.0 * border_m), bound(high, to, margin_m, 2.0 * border_m)]
}

/// The shadow of a caster, in coordinates of the sun's rays from its centre.
struct Shadow {
    /// Right, up and towards the sun.
    basis: Mat3,
    /// Of the caster, world, metres.
    centre: Vec3,
    /// Half the side of the tile, metres.
    half_m: f32,
    /// From the centre of the caster to the end of the last part, metres.
    length_m: f32,
    /// Tangent of half the angle that the sun's disc spans.
    penumbra: f32,
    /// Lowest and highest corner of the ground whose cells may list the caster, world, metres.
    listed: [Vec2; 2],
    eye: Vec3,
}

impl Shadow {
    /// A plane of the world, moved outward by a margin.
    fn to_light(&self, plane: Vec4) -> Vec4 {
        let distance_m = plane.dot(self.centre.extend(1.0));
        let along_axes = self.basis.transpose() * plane.truncate();
        along_axes.extend(distance_m + MARGIN * (1.0 + distance_m.abs()))
    }

    /// Where each part begins, metres from the centre of the caster towards the sun: short ones near the caster.
    fn start_m(&self, part: usize) -> f32 {
        let share = part as f32 / PARTS as f32;
        self.half_m - (self.length_m + self.half_m) * share * share
    }

    /// Radius of what a surface this far from the centre along the rays may sample, metres.
    fn search_m(&self, along_m: f32) -> f32 {
        (1.0 + MARGIN) * self.penumbra * (self.half_m - along_m)
    }

    /// Bounds of what the ground in a frustum samples, metres to the right and up.
    fn of_ground(&self, ground: &GroundRange, frustum: &Frustum) -> [Vec2; 2] {
        let [low, high] = self.listed;
        let listed = [
            Vec4::new(1.0, 0.0, 0.0, -low.x),
            Vec4::new(-1.0, 0.0, 0.0, high.x),
            Vec4::new(0.0, 1.0, 0.0, -low.y),
            Vec4::new(0.0, -1.0, 0.0, high.y),
        ];
        let planes = frustum.planes().map(|plane| self.to_light(plane)).into_iter();
        let planes: Vec<Vec4> = planes.chain(listed.map(|plane| self.to_light(plane))).collect();
        let (mut low, mut high) = (Vec2::MAX, Vec2::MIN);
        for part in 0..PARTS {
            let [start_m, end_m] = [part, part + 1].map(|part| self.start_m(part));
            let search_m = self.search_m(end_m);
            let reach_m = (1.0 + MARGIN) * self.half_m + search_m;
            let mut volume = LightBox {
                low: Vec3::new(-reach_m, -reach_m, end_m),
                high: Vec3::new(reach_m, reach_m, start_m),
            };
            for _ in 0..ROUNDS {
                planes.iter().for_each(|plane| volume.clip(*plane));
                if volume.is_empty() {
                    break;
                }
                self.around_ground(ground, &volume).into_iter().for_each(|plane| volume.clip(plane));
            }
            if !volume.is_empty() {
                low = low.min(volume.low.truncate() - search_m);
                high = high.max(volume.high.truncate() + search_m);
            }
        }
        [low, high]
    }

    /// Planes below and above all ground in a box.
    fn around_ground(&self, ground: &GroundRange, volume: &LightBox) -> [Vec4; 2] {
        let (mut low, mut high) = (self.centre, self.centre);
        for axis in 0..3 {
            let ends = [volume.low[axis], volume.high[axis]].map(|at_m| at_m * self.basis.col(axis));
            (low, high) = (low + ends[0].min(ends[1]), high + ends[0].max(ends[1]));
        }
        let [at_low_m, at_high_m] = [low, high].map(|point| off_mesh_m(self.eye, point));
        let off_mesh_m = at_low_m.max(at_high_m) + OFF_MESH * low.distance(high);
        // Where there is no ground the planes leave nothing; finite, for the sums.
        let [lowest_m, highest_m] =
            ground.under(low.truncate(), high.truncate()).map(|height_m| height_m.clamp(-1e6, 1e6));
        let below = Vec4::new(0.0, 0.0, 1.0, off_mesh_m - lowest_m);
        let above = Vec4::new(0.0, 0.0, -1.0, off_mesh_m + highest_m);
        [self.to_light(below), self.to_light(above)]
    }

    /// Bounds of what surfaces in a sphere sample, metres to the right and up, if they are in the shadow's volume.
    fn of_sphere(&self, centre: Vec3, radius_m: f32) -> Option<[Vec2; 2]> {
        let [low, high] = self.listed;
        let is_listed = (centre.truncate() + radius_m).cmpge(low).all()
            && (centre.truncate() - radius_m).cmple(high).all();
        if !is_listed {
            return None;
        }
        let at = self.basis.transpose() * (centre - self.centre);
        let search_m = self.search_m(at.z - radius_m);
        let reach_m = self.half_m + search_m + radius_m;
        let is_shadowed = at.z - radius_m < self.half_m && at.truncate().abs().max_element() < reach_m;
        let sampled_m = radius_m + search_m;
        is_shadowed.then(|| [at.truncate() - sampled_m, at.truncate() + sampled_m])
    }
}

/// The texels between two points of the plane across the sun's rays, metres to the right and up from the centre of the tile.
fn texels_of([low, high]: [Vec2; 2], half_m: f32, size_px: f32) -> TexelRect {
    if low.cmpgt(high).any() {
        return TexelRect::default();
    }
    let texel = |metres: f32| 0.5 * size_px * (1.0 + metres / half_m);
    let range = |first: f32, last: f32| {
        let within = |texel: f32| texel.clamp(0.0, size_px) as usize;
        within(texel(first) - MARGIN_PX)..within(texel(last) + MARGIN_PX + 1.0)
    };
    // Rows run down.
    TexelRect { columns: range(low.x, high.x), rows: range(-high.y, -low.y) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::render::settings::RenderSettings;

    /// The texels around a point that the taps of its filter lie on, if the tile is sampled for it at all.
    fn taps(scene: &Scene, caster: &Caster, point: Vec3) -> Option<TexelRect> {
        let (sun, tile) = (&scene.sun, &caster.tile);
        let [right, up] = sun.right_and_up();
        let offset = point - tile.centre;
        let across = Vec2::new(offset.dot(right), offset.dot(up));
        let search_m = sun.tan_half_angle() * (tile.half_extent_m - offset.dot(sun.direction));
        let is_sampled = search_m > 0.0 && across.abs().max_element() <= tile.half_extent_m + search_m;
        let texel =
            Vec2::new(across.x, -across.y) * (0.5 * tile.size_px / tile.half_extent_m) + 0.5 * tile.size_px;
        let radius_px = search_m * 0.5 * tile.size_px / tile.half_extent_m;
        let range = |at: f32| {
            let clamped = |texel: f32| texel.clamp(0.0, tile.size_px) as usize;
            clamped((at - radius_px - 0.5).floor())..clamped((at + radius_px + 0.5).floor() + 1.0)
        };
        is_sampled.then(|| TexelRect { columns: range(texel.x), rows: range(texel.y) })
    }

    #[test]
    fn what_is_in_view_samples_no_other_texels() {
        let mut config = Config::new();
        config.apply_preset("surface_train_full").expect("a preset");
        let settings = RenderSettings::new([256, 256], 4).expect("settings");
        let (mut sampled, mut whole, mut taken) = (0, 0, 0);
        for seed in 0..6 {
            let scene = Scene::build(seed, &config.draw(seed).expect("drawn")).expect("built");
            let selection = Selection::new(&scene, &settings);
            let surfaces = SurfacesInView::new(&scene, &selection).expect("rings");
            let is_in_view = |point: &Vec3| selection.frustum.intersects_sphere(*point, 0.0);
            let of_ground = scene.terrain.vertices.iter().map(|vertex| vertex.position);
            let visible = selection.rocks.iter().filter(|selected| selected.visible_level.is_some());
            let of_rocks = visible.flat_map(|selected| {
                let rock = &scene.rocks[selected.rock];
                rock.vertices.iter().map(|vertex| rock.centre + vertex.position)
            });
            let points: Vec<Vec3> = of_ground.chain(of_rocks).filter(is_in_view).collect();
            for caster in selection.casters.iter().filter(|caster| caster.tile.size_px > 64.0) {
                let [low, high] = Rays::new(&scene.sun).bounds(&scene, caster);
                let texels = surfaces.sampled_texels(caster);
                whole += (caster.tile.size_px as usize).pow(2);
                taken += texels.columns.len() * texels.rows.len();
                let is_listed = |p: &&Vec3| p.truncate().cmpge(low).all() && p.truncate().cmple(high).all();
                for point in points.iter().filter(is_listed) {
                    if let Some(taps) = taps(&scene, caster, *point) {
                        assert!(texels.contains(&taps), "seed {seed}, {caster:?}: {taps:?} in {texels:?}");
                        sampled += usize::from(!taps.is_empty());
                    }
                }
            }
        }
        assert!(sampled > 1000, "{sampled} points");
        assert!(2 * taken < whole, "{taken} of {whole} texels");
    }

    #[test]
    fn a_rectangle_contains_its_parts_and_what_is_empty() {
        let rect = |columns, rows| TexelRect { columns, rows };
        assert!(TexelRect::whole(9).contains(&rect(0..9, 3..4)));
        assert!(!rect(1..9, 0..9).contains(&rect(0..2, 3..4)));
        assert!(rect(1..2, 1..2).contains(&TexelRect::default()));
        assert!(rect(4..4, 0..9).is_empty() && !TexelRect::whole(1).is_empty());
    }
}
