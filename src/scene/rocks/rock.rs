//! A rock: its mesh, its material, and how it lies on the ground.
//!
//! Must not know: how it was shaped, how many of its triangles are drawn.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::pool::PooledVec;
use crate::scene::mesh::{Icosphere, Vertex, distance_to_triangle};
use crate::scene::terrain::Terrain;

/// Minimum distance between a rock's surface and the eye, metres.
pub const EYE_CLEARANCE_M: f32 = 0.5;
/// Minimum depth of a rock's lowest point below the ground there, as a fraction of the rock's height.
const MIN_BURIAL: f32 = 0.02;
/// The `dust_above` of a rock without dust.
pub const NO_DUST: f32 = 2.0;

/// Diffuse material of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse reflectance, linear RGB.
    pub albedo: Vec3,
    /// Roughness of the diffuse lobe, 0 (Lambert) to 1.
    pub roughness: f32,
}

/// What a body that lies or stands on the ground is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Body {
    /// A rock.
    #[default]
    Rock,
    /// A part of the rover.
    Hardware {
        /// Whether the camera sees it; it casts its shadow either way.
        is_visible: bool,
    },
}

impl Body {
    /// Whether it is a rock.
    #[must_use]
    pub const fn is_rock(self) -> bool {
        matches!(self, Self::Rock)
    }

    /// Whether the camera sees it.
    #[must_use]
    pub const fn is_visible(self) -> bool {
        matches!(self, Self::Rock | Self::Hardware { is_visible: true })
    }
}

/// One rock, or a part of the rover.
#[derive(Clone, Debug)]
pub struct Rock {
    /// Index from 0; its instance id is one more.
    pub index: u32,
    /// Origin of its vertices in the world, metres.
    pub centre: Vec3,
    /// Displaced icosphere of level [`Self::level`]: metres from the centre, world axes. Clones of a rock share it.
    pub vertices: Arc<PooledVec<Vertex>>,
    /// Subdivision level of the icosphere, as authored.
    pub level: usize,
    /// Per level, upper bound on the distance between the mesh of that level and the authored one, metres.
    pub level_errors_m: [f32; Icosphere::MAX_LEVEL + 1],
    /// Greatest distance of a vertex from the centre, metres.
    pub radius_m: f32,
    /// Lowest and highest vertex, metres from the centre.
    pub z_range_m: [f32; 2],
    /// Nominal stage: radius of the sphere before displacement and axis scaling; surface stage: half the diameter. Metres.
    pub base_scale_m: f32,
    /// Its material.
    pub material: Material,
    /// The surface is covered by soil where the z of its normal is above this.
    pub dust_above: f32,
    /// Whether it was moved because it overlapped the camera.
    pub moved: bool,
    /// What it is.
    pub body: Body,
}

impl Rock {
    /// A rock with its centre at the origin.
    pub(in crate::scene) fn of_vertices(
        index: u32,
        vertices: PooledVec<Vertex>,
        level: usize,
        material: Material,
    ) -> Self {
        let mut rock = Self::unburied(index, vertices, level, material);
        rock.level_errors_m = Icosphere::shared().level_errors_m(&rock.vertices);
        rock
    }

    /// The same for a rock whose vertices burial will still move: the errors of its levels are measured then.
    pub(super) fn unburied(
        index: u32,
        vertices: PooledVec<Vertex>,
        level: usize,
        material: Material,
    ) -> Self {
        let mut rock = Self {
            index,
            centre: Vec3::ZERO,
            level_errors_m: [0.0; Icosphere::MAX_LEVEL + 1],
            vertices: Arc::new(vertices),
            level,
            radius_m: 0.0,
            z_range_m: [0.0; 2],
            base_scale_m: 0.0,
            material,
            dust_above: NO_DUST,
            moved: false,
            body: Body::Rock,
        };
        rock.measure_extent();
        rock.base_scale_m = rock.radius_m;
        rock
    }

    /// Sets what is measured on the vertices: extents and errors of the levels.
    pub(super) fn measure(&mut self) {
        self.measure_extent();
        self.level_errors_m = Icosphere::shared().level_errors_m(&self.vertices);
    }

    fn measure_extent(&mut self) {
        // `f32::min` is more than a comparison (NaN).
        let (mut z_range_m, mut square) = ([f32::MAX, f32::MIN], 0.0);
        for Vertex { position, .. } in self.vertices.iter() {
            z_range_m[0] = if position.z < z_range_m[0] { position.z } else { z_range_m[0] };
            z_range_m[1] = if position.z > z_range_m[1] { position.z } else { z_range_m[1] };
            let length_squared = position.length_squared();
            square = if length_squared > square { length_squared } else { square };
        }
        (self.radius_m, self.z_range_m) = (square.sqrt(), z_range_m);
    }

    /// Puts the rock on the ground at a position, with a fraction `embedding` of its height buried, and clear of the eye.
    pub(super) fn put_on_ground(&mut self, terrain: &Terrain, eye: Vec3, position: Vec2, embedding: f32) {
        let lowest = self.vertices.iter().map(|v| v.position).find(|point| point.z == self.z_range_m[0]);
        let lowest = lowest.unwrap_or_default();
        self.set_centre(terrain, position, embedding, lowest);
        if self.distance_to(eye, EYE_CLEARANCE_M) < EYE_CLEARANCE_M {
            // Straight away from the eye until the whole ball around the rock is clear of it; where that is beyond
            // the border of the ground, to the opposite side of the eye or to one beside it.
            let offset = position - eye.truncate();
            let away = if offset.length() > 0.0 { offset / offset.length() } else { Vec2::Y };
            let clear_m = 1.01 * (self.radius_m + EYE_CLEARANCE_M);
            let positions =
                [away, -away, away.perp(), -away.perp()].map(|side| eye.truncate() + clear_m * side);
            let max_m = terrain.half_extent_m - self.radius_m;
            let is_on_ground = |at: &Vec2| (*at - terrain.centre).abs().max_element() <= max_m;
            let on_ground = positions.into_iter().find(is_on_ground);
            self.set_centre(terrain, on_ground.unwrap_or(positions[0]), embedding, lowest);
            self.moved = true;
        }
    }

    /// Its triangles at a level; at most the authored one.
    #[must_use]
    pub fn triangles(&self, level: usize) -> &'static [[u32; 3]] {
        &Icosphere::shared().triangles[level.min(self.level)]
    }

    /// Mean of its extents along x and y, metres.
    #[must_use]
    pub fn diameter_m(&self) -> f32 {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for vertex in self.vertices.iter() {
            (low, high) = (low.min(vertex.position), high.max(vertex.position));
        }
        0.5 * ((high.x - low.x) + (high.y - low.y))
    }

    /// Sets the centre so that the fraction `embedding` of the height is below the ground at a position, and lower if its
    /// lowest point would not be below the ground.
    fn set_centre(&mut self, terrain: &Terrain, position: Vec2, embedding: f32, lowest: Vec3) {
        let [bottom_m, top_m] = self.z_range_m;
        let extent_m = top_m - bottom_m;
        let z = terrain.surface_height_at(position) - (bottom_m + embedding * extent_m);
        let ground_m = terrain.surface_height_at(position + lowest.truncate());
        self.centre = position.extend(z.min(ground_m - bottom_m - MIN_BURIAL * extent_m));
    }

    /// Distance from a point to the rock, metres: 0 inside, exact below `limit_m`, possibly infinite above.
    #[must_use]
    pub fn distance_to(&self, point: Vec3, limit_m: f32) -> f32 {
        let local = point - self.centre;
        if local.length() > self.radius_m + limit_m {
            return f32::INFINITY;
        }
        // The surface is star-shaped around the centre: a point is inside if it lies below the face that its direction
        // from the centre intersects.
        let inside = self.corners().any(|[a, b, c]| {
            let pierced =
                a.cross(b).dot(local) >= 0.0 && b.cross(c).dot(local) >= 0.0 && c.cross(a).dot(local) >= 0.0;
            pierced && (b - a).cross(c - a).dot(local - a) <= 0.0
        });
        if inside { 0.0 } else { self.distance_to_surface(point) }
    }

    /// Unsigned distance from a point to the rock's surface, metres.
    #[must_use]
    pub fn distance_to_surface(&self, point: Vec3) -> f32 {
        let local = point - self.centre;
        self.corners().map(|corners| distance_to_triangle(local, corners)).fold(f32::INFINITY, f32::min)
    }

    /// Corners of each authored triangle, metres from the centre.
    fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.triangles(self.level).iter().map(|t| t.map(|v| self.vertices[v as usize].position))
    }
}
