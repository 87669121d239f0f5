//! A rock of the nominal stage that is not built yet, and the bounds that culling needs of it.
//!
//! Must not know: which rocks are needed.

use std::sync::Arc;

use bytemuck::bytes_of;
use glam::{Mat3, Vec2, Vec3};

use super::rock::{Material, Rock};
use super::shape::{Shape, draw_scale_and_rotation};
use crate::params::{Knob, Params};
use crate::pool::PooledVec;
use crate::random::{Stream, Streams};
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::terrain::Terrain;

/// Level of the mesh that identifies a rock in the geometry hash.
const HASHED_LEVEL: usize = 1;

/// Bounds of a rock that is not built yet: a ball whose centre lies on a vertical segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RockBounds {
    /// Lowest and highest possible centre, metres.
    pub centres: [Vec3; 2],
    /// Upper bound on the distance of a vertex from the centre, metres.
    pub radius_m: f32,
}

impl RockBounds {
    /// Whether the rock may be within `limit_m` of a point.
    #[must_use]
    pub fn may_lie_within(&self, limit_m: f32, point: Vec3) -> bool {
        let [low, high] = self.centres;
        let nearest = low.with_z(point.z.clamp(low.z, high.z));
        nearest.distance(point) <= self.radius_m + limit_m
    }
}

/// Position and size of a rock before it is shaped.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) position: Vec2,
    pub(super) base_scale_m: f64,
    /// Lowest and highest corner of the box that its position was drawn from.
    pub(super) band: [Vec2; 2],
}

/// Redraws, axis by axis, a position beyond `max_m` from the origin, from the part of its band that is within; others stay.
fn onto_ground(position: Vec2, band: [Vec2; 2], max_m: f32, stream: impl Fn() -> Stream) -> Vec2 {
    let max_m = max_m.max(0.0);
    if position.abs().max_element() <= max_m {
        return position;
    }
    let mut draw = stream();
    let along = |axis: usize, draw: &mut Stream| {
        let [low, high] = band.map(|end| end[axis].clamp(-max_m, max_m));
        let redrawn = draw.uniform(low.into(), high.into()) as f32;
        if position[axis].abs() <= max_m { position[axis] } else { redrawn }
    };
    Vec2::new(along(0, &mut draw), along(1, &mut draw))
}

/// Icosphere level for a rock of this base radius.
pub(super) const fn authored_level(base_scale_m: f64) -> usize {
    if base_scale_m >= 1.8 {
        5
    } else if base_scale_m >= 0.9 {
        4
    } else if base_scale_m >= 0.45 {
        3
    } else {
        2
    }
}

/// What all rocks of a scene are placed with.
#[derive(Debug)]
pub(super) struct Site {
    pub(super) terrain: Arc<Terrain>,
    pub(super) eye: Vec3,
    /// Fraction of their height that is below the ground.
    pub(super) embedding: f32,
}

/// How to build a rock of the nominal stage.
#[derive(Clone, Debug)]
pub(super) struct RockPlan {
    index: u32,
    shape: Shape,
    mesh_from_unit: Mat3,
    level: usize,
    base_scale_m: f32,
    material: Material,
    site: Arc<Site>,
    position: Vec2,
    /// Its bounds, unless it has to move clear of the eye.
    pub(super) bounds: RockBounds,
}

impl RockPlan {
    /// Draws the shape and the pose of rock `k`.
    pub(super) fn draw(
        streams: &Streams,
        params: &Params,
        site: &Arc<Site>,
        k: u64,
        placement: Placement,
        material: Material,
    ) -> Self {
        let Placement { position, base_scale_m, band } = placement;
        let shape =
            Shape::draw(&mut streams.stream("rocks.shape", k), params.number(Knob::RocksDisplacement));
        let mesh_from_unit = draw_scale_and_rotation(&mut streams.stream("rocks.pose", k), base_scale_m);
        let axes = [mesh_from_unit.x_axis, mesh_from_unit.y_axis, mesh_from_unit.z_axis];
        let radius_m = 1.001 * shape.max_radius() * axes.map(Vec3::length).into_iter().fold(0.0, f32::max);
        let position = onto_ground(position, band, site.terrain.half_extent_m - radius_m, || {
            streams.stream("rocks.place_on_ground", k)
        });
        // `Rock::set_centre` puts the centre between these heights.
        let [lowest_ground_m, _] = site.terrain.z_range_m;
        let (low_m, high_m) =
            (lowest_ground_m - 1.1 * radius_m, site.terrain.surface_height_at(position) + radius_m);
        let bounds = RockBounds { centres: [position.extend(low_m), position.extend(high_m)], radius_m };
        Self {
            index: k as u32,
            shape,
            mesh_from_unit,
            level: authored_level(base_scale_m),
            base_scale_m: base_scale_m as f32,
            material,
            site: Arc::clone(site),
            position,
            bounds,
        }
    }

    /// Builds the rock.
    pub(super) fn build(&self) -> Rock {
        let mut vertices = self.vertices(self.level);
        Icosphere::shared().set_smooth_normals(&mut vertices, self.level);
        let mut rock = Rock::of_vertices(self.index, vertices, self.level, self.material);
        rock.base_scale_m = self.base_scale_m;
        rock.put_on_ground(&self.site.terrain, self.site.eye, self.position, self.site.embedding);
        rock
    }

    /// Vertices of a level without their normals; a finer level begins with the same vertices.
    fn vertices(&self, level: usize) -> PooledVec<Vertex> {
        let sphere = Icosphere::shared();
        let mut vertices: PooledVec<Vertex> = PooledVec::recurring(Icosphere::vertex_count(level));
        for ((vertex, &u), radius) in
            vertices.iter_mut().zip(&sphere.directions).zip(&self.shape.radii(level))
        {
            vertex.position = self.mesh_from_unit * (radius * u);
        }
        vertices
    }

    /// Writes the bytes that identify the rock; the same whether it was `built` or not.
    pub(super) fn write_to(&self, built: Option<&Rock>, mut write: impl FnMut(&[u8])) {
        write(bytes_of(&self.position));
        write(bytes_of(&[self.base_scale_m, self.site.embedding]));
        let mut write_positions = |vertices: &[Vertex]| {
            for vertex in &vertices[..Icosphere::vertex_count(HASHED_LEVEL)] {
                write(bytes_of(&vertex.position));
            }
        };
        match built {
            Some(rock) => write_positions(&rock.vertices),
            None => write_positions(&self.vertices(HASHED_LEVEL)),
        }
    }
}
