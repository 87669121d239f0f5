//! The boulders: how they are shaped, how deep they sit, and where those of the nominal stage lie ([`lunar`] has those of
//! the surface stage).
//!
//! Every rock is a function of (seed, its number) and of the ground under it, so that rocks can be built in any
//! order and on any number of threads, or not at all ([`on_demand`]), and one rock more leaves all others as they are.
//! Must not know: how many triangles of it are drawn.

pub mod lunar;
pub mod on_demand;

use std::sync::Arc;

use bytemuck::bytes_of;
use fearless_simd::{Level, dispatch};
use glam::{Mat3, Vec2, Vec3};

use super::mesh::{Icosphere, Vertex, distance_to_triangle};
use super::noise::Fbm;
use super::terrain::Terrain;
use crate::params::{Knob, Params};
use crate::random::{Stream, Streams};
use crate::reuse::Reused;
use on_demand::{Rocks, Whereabouts};

/// Materials in the pool of a scene.
const MATERIALS: u64 = 12;
/// Colour of a rock relative to its base grey, linear RGB.
const TINT: [f64; 3] = [1.035, 1.00, 0.955];
/// Largest deviation of a channel from the tinted grey.
const CHANNEL_JITTER: f64 = 0.006;
/// Smallest and largest reflectance of a channel.
const ALBEDO_RANGE: [f64; 2] = [0.02, 0.55];
/// Half the width of the strip in which near rocks lie, metres.
const NEAR_HALF_WIDTH_M: f64 = 55.0;
/// Half the width of the strip in which far rocks lie, metres.
const FAR_HALF_WIDTH_M: f64 = 95.0;
/// Range of y in which far rocks lie, metres.
const FAR_Y_M: [f64; 2] = [-78.0, 230.0];
/// The first near rocks, this many, lie in the wedge that a camera at its nominal place certainly sees.
const NEAR_IN_VIEW: u64 = 3;
/// Apex (y, metres; x is 0) of that wedge and the tangent of its half angle (24 degrees): within the view of
/// every field of view from 48 degrees up.
const WEDGE: (f64, f64) = (-90.0, 0.445);
/// Smallest distance between a rock's surface and the eye, metres.
pub const EYE_CLEARANCE_M: f32 = 0.5;
/// A rock's lowest point lies at least this fraction of its vertical extent under the ground there.
const LEAST_BURIAL: f32 = 0.02;
/// The `dust_above` of a rock without dust.
pub const NO_DUST: f32 = 2.0;
/// Vertices whose displacement is reckoned together: few enough for what comes in between to stay in the nearest cache.
const AT_A_TIME: usize = 512;
/// Level of the mesh that tells a rock that is not built from others.
const SAMPLE_LEVEL: usize = 1;
/// Bounds of the distance of the surface from the centre of the undisplaced unit sphere.
const RADIUS_RANGE: [f32; 2] = [0.50, 1.85];

/// How a surface reflects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse reflectance, linear RGB.
    pub albedo: Vec3,
    /// Roughness of the diffuse lobe, 0 (Lambert) to 1.
    pub roughness: f32,
}

/// One boulder.
#[derive(Clone, Debug)]
pub struct Rock {
    /// Its number from 0; its instance id is one more.
    pub index: u32,
    /// Origin of its vertices in the world, metres.
    pub centre: Vec3,
    /// Displaced icosphere of level [`Self::level`], metres from the centre, world axes. Copies of a rock share it.
    pub vertices: Arc<Reused<Vertex>>,
    /// Level of the authored icosphere.
    pub level: usize,
    /// Per level, how far a surface drawn at that level may lie off the authored one, metres.
    pub level_errors_m: Vec<f32>,
    /// Greatest distance of a vertex from the centre, metres.
    pub radius_m: f32,
    /// Lowest and highest vertex, metres from the centre.
    pub z_range_m: [f32; 2],
    /// Of the nominal stage: radius of the undisplaced sphere before its axes were scaled; else half the diameter. Metres.
    pub base_scale_m: f32,
    /// How it reflects.
    pub material: Material,
    /// Soil lies where the z of its normal is above this.
    pub dust_above: f32,
    /// It was moved because it came too near to the eye.
    pub moved: bool,
}

/// All rocks of these settings on this ground, none of them near the eye; each is built when it is first asked for.
#[must_use]
pub fn plan(streams: &Streams, params: &Params, terrain: &Arc<Terrain>, eye: Vec3) -> Rocks {
    let materials = draw_materials(streams, params);
    let near_count = u64::from(params.count(Knob::RocksNearCount));
    let count = params.count(Knob::RocksCount) as usize;
    let bed = Arc::new(Bed {
        terrain: Arc::clone(terrain),
        eye,
        embedding: params.number(Knob::RocksEmbedding) as f32,
    });
    // Of a range of `usize` the list is made in one piece.
    let plans = (0..count).map(|k| {
        let k = k as u64;
        let placed =
            if k < near_count { place_near(streams, params, k) } else { place_far(streams, params, k) };
        let material =
            materials[streams.stream("rocks.material", k).uniform_int(0, MATERIALS as i64 - 1) as usize];
        Plan::draw(streams, params, &bed, k, placed, material)
    });
    let rocks = Rocks::planned(plans);
    // One that lies elsewhere than planned is not where it would be looked for.
    rocks.that_may(|rock| rock.may_lie_within(EYE_CLEARANCE_M, eye));
    rocks
}

/// Where a rock lies and how large it is before it is shaped.
#[derive(Clone, Copy, Debug)]
struct Placed {
    place: Vec2,
    base_scale_m: f64,
    /// The lowest and the highest place that rocks of its kind are drawn from.
    band: [Vec2; 2],
}

/// The place of a rock that would lie beyond the border of the ground, drawn again from what of its band there is ground; along
/// each axis for itself. Others stay.
fn onto_ground(place: Vec2, band: [Vec2; 2], most_m: f32, again: impl Fn() -> Stream) -> Vec2 {
    let most_m = most_m.max(0.0);
    if place.abs().max_element() <= most_m {
        return place;
    }
    let mut draw = again();
    let along = |axis: usize, draw: &mut Stream| {
        let [low, high] = band.map(|end| end[axis].clamp(-most_m, most_m));
        let anew = draw.uniform(low.into(), high.into()) as f32;
        if place[axis].abs() <= most_m { place[axis] } else { anew }
    };
    Vec2::new(along(0, &mut draw), along(1, &mut draw))
}

fn place_near(streams: &Streams, params: &Params, k: u64) -> Placed {
    let hero_scale_m = params.number(Knob::RocksHeroScaleM);
    if k == 0 && hero_scale_m > 0.0 {
        let place = [Knob::RocksHeroXM, Knob::RocksHeroYM].map(|knob| params.number(knob) as f32);
        let place = Vec2::from(place);
        return Placed { place, base_scale_m: hero_scale_m, band: [place; 2] };
    }
    let y = params.sample(Knob::RocksNearYM, &mut streams.stream(Knob::RocksNearYM.name(), k));
    let mut draw = streams.stream("rocks.near_place", k);
    let (apex_y, tan_half_angle) = WEDGE;
    let half_width_m = tan_half_angle * (y - apex_y);
    let x = if k < NEAR_IN_VIEW && half_width_m > 0.0 {
        // One rock in each third of the wedge's width.
        let third = 2.0 * (k as f64 + draw.unit()) / NEAR_IN_VIEW as f64 - 1.0;
        third * half_width_m.min(NEAR_HALF_WIDTH_M)
    } else {
        draw.uniform(-NEAR_HALF_WIDTH_M, NEAR_HALF_WIDTH_M)
    };
    let scale = params.sample(Knob::RocksNearScaleM, &mut streams.stream(Knob::RocksNearScaleM.name(), k));
    let (half_width_m, y) = (NEAR_HALF_WIDTH_M as f32, y as f32);
    let band = [Vec2::new(-half_width_m, y), Vec2::new(half_width_m, y)];
    Placed { place: Vec2::new(x as f32, y), base_scale_m: scale, band }
}

fn place_far(streams: &Streams, params: &Params, k: u64) -> Placed {
    let mut draw = streams.stream("rocks.far_place", k);
    let x = draw.uniform(-FAR_HALF_WIDTH_M, FAR_HALF_WIDTH_M);
    let y = draw.uniform(FAR_Y_M[0], FAR_Y_M[1]);
    let mut scale = params.sample(Knob::RocksScaleM, &mut streams.stream(Knob::RocksScaleM.name(), k));
    if draw.unit() < params.number(Knob::RocksLargeShare) {
        scale *= params.sample(Knob::RocksLargeFactor, &mut streams.stream(Knob::RocksLargeFactor.name(), k));
    }
    let band = [[-FAR_HALF_WIDTH_M, FAR_Y_M[0]], [FAR_HALF_WIDTH_M, FAR_Y_M[1]]];
    let band = band.map(|end| Vec2::from(end.map(|metres| metres as f32)));
    Placed { place: Vec2::new(x as f32, y as f32), base_scale_m: scale, band }
}

fn draw_materials(streams: &Streams, params: &Params) -> Vec<Material> {
    (0..MATERIALS)
        .map(|k| {
            let grey = params.sample(Knob::RocksAlbedo, &mut streams.stream(Knob::RocksAlbedo.name(), k));
            let roughness =
                params.sample(Knob::RocksRoughness, &mut streams.stream(Knob::RocksRoughness.name(), k));
            let mut jitter = streams.stream("rocks.channel_jitter", k);
            let albedo = TINT.map(|tint| {
                let channel = grey * tint + jitter.uniform(-CHANNEL_JITTER, CHANNEL_JITTER);
                channel.clamp(ALBEDO_RANGE[0], ALBEDO_RANGE[1]) as f32
            });
            Material { albedo: albedo.into(), roughness: roughness as f32 }
        })
        .collect()
}

/// Level of the icosphere for a rock of this base radius.
const fn authored_level(base_scale_m: f64) -> usize {
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

/// What rocks are laid on.
#[derive(Debug)]
struct Bed {
    terrain: Arc<Terrain>,
    eye: Vec3,
    /// Fraction of their height that is under the ground.
    embedding: f32,
}

/// A rock that is yet to be built.
#[derive(Clone, Debug)]
struct Plan {
    index: u32,
    shape: Shape,
    mesh_from_unit: Mat3,
    level: usize,
    base_scale_m: f32,
    material: Material,
    bed: Arc<Bed>,
    place: Vec2,
    /// Where it lies, unless too near to the eye.
    whereabouts: Whereabouts,
}

impl Plan {
    fn draw(
        streams: &Streams,
        params: &Params,
        bed: &Arc<Bed>,
        k: u64,
        placed: Placed,
        material: Material,
    ) -> Self {
        let Placed { place, base_scale_m, band } = placed;
        let shape =
            Shape::draw(&mut streams.stream("rocks.shape", k), params.number(Knob::RocksDisplacement));
        let mesh_from_unit = draw_scale_and_rotation(&mut streams.stream("rocks.pose", k), base_scale_m);
        let axes = [mesh_from_unit.x_axis, mesh_from_unit.y_axis, mesh_from_unit.z_axis];
        let radius_m = 1.001 * shape.most() * axes.map(Vec3::length).into_iter().fold(0.0, f32::max);
        let place = onto_ground(place, band, bed.terrain.half_extent_m - radius_m, || {
            streams.stream("rocks.place_on_ground", k)
        });
        // Its lowest and highest point are at most so far from its centre; see [`Rock::settle`].
        let [lowest_ground_m, _] = bed.terrain.z_range_m;
        let (low_m, high_m) =
            (lowest_ground_m - 1.1 * radius_m, bed.terrain.surface_height_at(place) + radius_m);
        let whereabouts = Whereabouts { centres: [place.extend(low_m), place.extend(high_m)], radius_m };
        Self {
            index: k as u32,
            shape,
            mesh_from_unit,
            level: authored_level(base_scale_m),
            base_scale_m: base_scale_m as f32,
            material,
            bed: Arc::clone(bed),
            place,
            whereabouts,
        }
    }

    fn build(&self) -> Rock {
        let mut vertices = self.vertices(self.level);
        Icosphere::shared().set_smooth_normals(&mut vertices, self.level);
        let mut rock = Rock::of_vertices(self.index, vertices, self.level, self.material);
        rock.base_scale_m = self.base_scale_m;
        rock.place(&self.bed.terrain, self.bed.eye, self.place, self.bed.embedding);
        rock
    }

    /// Those of a level, which those of a finer one begin with. Their normals are yet to be set.
    fn vertices(&self, level: usize) -> Reused<Vertex> {
        let sphere = Icosphere::shared();
        let mut vertices: Reused<Vertex> = Reused::of_any(Icosphere::vertex_count(level));
        for ((vertex, &u), radius) in
            vertices.iter_mut().zip(&sphere.directions).zip(&self.shape.radii(level))
        {
            vertex.position = self.mesh_from_unit * (radius * u);
        }
        vertices
    }

    /// Gives the bytes of what it is made from; `built` is the rock itself, if it was built.
    fn write_to(&self, built: Option<&Rock>, mut write: impl FnMut(&[u8])) {
        write(bytes_of(&self.place));
        write(bytes_of(&[self.base_scale_m, self.bed.embedding]));
        let mut write_positions = |vertices: &[Vertex]| {
            for vertex in &vertices[..Icosphere::vertex_count(SAMPLE_LEVEL)] {
                write(bytes_of(&vertex.position));
            }
        };
        match built {
            Some(rock) => write_positions(&rock.vertices),
            None => write_positions(&self.vertices(SAMPLE_LEVEL)),
        }
    }
}

impl Rock {
    /// A rock that lies nowhere yet.
    fn of_vertices(index: u32, vertices: Reused<Vertex>, level: usize, material: Material) -> Self {
        // `f32::min` asks for more than a comparison.
        let (mut z_range_m, mut square) = ([f32::MAX, f32::MIN], 0.0);
        for Vertex { position, .. } in &vertices {
            z_range_m[0] = if position.z < z_range_m[0] { position.z } else { z_range_m[0] };
            z_range_m[1] = if position.z > z_range_m[1] { position.z } else { z_range_m[1] };
            let here = position.length_squared();
            square = if here > square { here } else { square };
        }
        let radius_m = square.sqrt();
        Self {
            index,
            centre: Vec3::ZERO,
            level_errors_m: Icosphere::shared().level_errors_m(&vertices),
            vertices: Arc::new(vertices),
            level,
            radius_m,
            z_range_m,
            base_scale_m: radius_m,
            material,
            dust_above: NO_DUST,
            moved: false,
        }
    }

    /// Lays the rock on a place, and clear of the eye.
    fn place(&mut self, terrain: &Terrain, eye: Vec3, place: Vec2, embedding: f32) {
        let lowest = self.vertices.iter().map(|v| v.position).find(|place| place.z == self.z_range_m[0]);
        let lowest = lowest.unwrap_or_default();
        self.settle(terrain, place, embedding, lowest);
        if self.distance_to(eye, EYE_CLEARANCE_M) < EYE_CLEARANCE_M {
            // Straight away from the eye until the whole ball around the rock is clear of it; where that is beyond
            // the border of the ground, to the opposite side of the eye or to one beside it.
            let offset = place - eye.truncate();
            let away = if offset.length() > 0.0 { offset / offset.length() } else { Vec2::Y };
            let clear_m = 1.01 * (self.radius_m + EYE_CLEARANCE_M);
            let positions =
                [away, -away, away.perp(), -away.perp()].map(|side| eye.truncate() + clear_m * side);
            let max_m = terrain.half_extent_m - self.radius_m;
            let on_ground = positions.into_iter().find(|position| position.abs().max_element() <= max_m);
            self.settle(terrain, on_ground.unwrap_or(positions[0]), embedding, lowest);
            self.moved = true;
        }
    }

    /// Its triangles at a level not finer than the authored one.
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

    /// Puts the rock on a place, with `embedding` of its height under the ground there, and deeper if its lowest
    /// point would not be under the ground.
    fn settle(&mut self, terrain: &Terrain, place: Vec2, embedding: f32, lowest: Vec3) {
        let [bottom_m, top_m] = self.z_range_m;
        let extent_m = top_m - bottom_m;
        let z = terrain.surface_height_at(place) - (bottom_m + embedding * extent_m);
        let ground_m = terrain.surface_height_at(place + lowest.truncate());
        self.centre = place.extend(z.min(ground_m - bottom_m - LEAST_BURIAL * extent_m));
    }

    /// Distance from a point to the rock, metres, 0 inside it; exact only where it is below `limit_m`.
    #[must_use]
    pub fn distance_to(&self, point: Vec3, limit_m: f32) -> f32 {
        let local = point - self.centre;
        if local.length() > self.radius_m + limit_m {
            return f32::INFINITY;
        }
        // The surface is star-shaped around the centre, so the point is inside if the face that its direction
        // pierces lies beyond it.
        let inside = self.corners().any(|[a, b, c]| {
            let pierced =
                a.cross(b).dot(local) >= 0.0 && b.cross(c).dot(local) >= 0.0 && c.cross(a).dot(local) >= 0.0;
            pierced && (b - a).cross(c - a).dot(local - a) <= 0.0
        });
        if inside { 0.0 } else { self.distance_to_surface(point) }
    }

    /// Distance from a point, inside or outside, to the rock's surface, metres.
    #[must_use]
    pub fn distance_to_surface(&self, point: Vec3) -> f32 {
        let local = point - self.centre;
        self.corners().map(|corners| distance_to_triangle(local, corners)).fold(f32::INFINITY, f32::min)
    }

    /// Corners of every authored triangle, metres from the centre.
    fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.triangles(self.level).iter().map(|t| t.map(|v| self.vertices[v as usize].position))
    }
}

/// Axis scales, tilt and heading: unit sphere to metres in world axes.
fn draw_scale_and_rotation(draw: &mut Stream, base_scale_m: f64) -> Mat3 {
    let (sx, sy, sz) = (draw.uniform(0.78, 1.34), draw.uniform(0.78, 1.34), draw.uniform(0.50, 0.92));
    rotated(draw, [sx, sy, sz].map(|s| (s * base_scale_m) as f32))
}

/// A scale along the axes, then a random heading and a small tilt.
fn rotated(draw: &mut Stream, scale: [f32; 3]) -> Mat3 {
    let heading = draw.uniform(0.0, std::f64::consts::TAU);
    let tilt = (20.0_f64.to_radians() * draw.normal()).clamp(-1.5, 1.5);
    let tilt_axis = draw.uniform(0.0, std::f64::consts::TAU);
    let about_z = |angle: f64| {
        let (sin, cos) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
        Mat3::from_cols(Vec3::new(cos, sin, 0.0), Vec3::new(-sin, cos, 0.0), Vec3::Z)
    };
    let (sin, cos) = (libm::sin(tilt) as f32, libm::cos(tilt) as f32);
    let about_x = Mat3::from_cols(Vec3::X, Vec3::new(0.0, cos, sin), Vec3::new(0.0, -sin, cos));
    about_z(tilt_axis) * about_x * about_z(heading) * Mat3::from_diagonal(scale.into())
}

/// The four displacement terms of a boulder over the unit sphere.
#[derive(Clone, Debug)]
struct Shape {
    amplitude: f32,
    domain_scale: Vec3,
    domain_offset: Vec3,
    lumps: (Fbm, f32),
    ridges: (Fbm, f32),
    bumps: (Fbm, f32),
    grain: (Fbm, f32),
}

impl Shape {
    fn draw(draw: &mut Stream, amplitude: f64) -> Self {
        let mut uniform = |low, high| draw.uniform(low, high) as f32;
        let domain_scale = Vec3::from([(); 3].map(|()| uniform(0.70, 1.55)));
        let domain_offset = Vec3::from([(); 3].map(|()| uniform(-41.0, 41.0)));
        let f = uniform(1.05, 1.75);
        let weights =
            [(0.90, 1.15), (0.26, 0.42), (0.12, 0.19), (0.05, 0.09)].map(|(low, high)| uniform(low, high));
        let mut term = |octaves, frequency, lacunarity, weight| {
            (Fbm { octaves, frequency, lacunarity, seed: draw.bits() }, weight)
        };
        Self {
            amplitude: amplitude as f32,
            domain_scale,
            domain_offset,
            lumps: term(4, 0.85 * f, 2.05, weights[0]),
            ridges: term(4, f, 2.2, weights[1]),
            bumps: term(3, 1.7 * f, 2.3, weights[2]),
            grain: term(2, 2.7 * f, 2.5, weights[3]),
        }
    }

    /// A bound on the distance of the surface from the centre, relative to the undisplaced sphere.
    fn most(&self) -> f32 {
        let weights = self.lumps.1 + self.ridges.1 + self.bumps.1 + self.grain.1;
        (1.0 + self.amplitude * weights).min(RADIUS_RANGE[1])
    }

    /// Distance of the surface from the centre in each direction of a level, relative to the undisplaced sphere.
    fn radii(&self, level: usize) -> Reused<f32> {
        let mut radii: Reused<f32> = Reused::of_any(Icosphere::vertex_count(level));
        for (chunk, radii) in radii.chunks_mut(AT_A_TIME).enumerate() {
            let first = chunk * AT_A_TIME;
            let axes = Icosphere::shared().axes.each_ref().map(|axis| &axis[first..first + radii.len()]);
            dispatch!(Level::new(), _simd => self.set_radii(axes, radii));
        }
        radii
    }

    // Inlined wholly, to be compiled for each width of vectors.
    #[inline(always)]
    fn set_radii(&self, axes: [&[f32]; 3], radii: &mut [f32]) {
        let mut sums = [[0.0; AT_A_TIME]; 4];
        let terms = [(&self.lumps.0, 1.0), (&self.ridges.0, 1.7), (&self.bumps.0, 3.0), (&self.grain.0, 7.0)];
        for ((fbm, zoom), sums) in terms.into_iter().zip(&mut sums) {
            let mut places = [[0.0; AT_A_TIME]; 3];
            for axis in 0..3 {
                let (scale, offset) = (self.domain_scale[axis], self.domain_offset[axis]);
                for (place, u) in places[axis].iter_mut().zip(axes[axis]) {
                    *place = zoom * (scale * u + offset);
                }
            }
            let [x, y, z] = &places;
            let len = radii.len();
            fbm.set_at_many_3d([&x[..len], &y[..len], &z[..len]], &mut sums[..len]);
        }
        let [lumps, ridges, bumps, grain] = &sums;
        let terms = lumps.iter().zip(ridges).zip(bumps).zip(grain);
        for (radius, (((lump, ridge), bump), grain)) in radii.iter_mut().zip(terms) {
            let crease = 1.0 - ridge.abs();
            let sum = self.lumps.1 * lump
                + self.ridges.1 * (2.0 * crease * crease - 1.0)
                + self.bumps.1 * bump
                + self.grain.1 * grain;
            *radius = (1.0 + self.amplitude * sum).clamp(RADIUS_RANGE[0], RADIUS_RANGE[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat() -> Arc<Terrain> {
        Arc::new(Terrain::from_height(920.0, 30, Vec::new(), |_| 0.0))
    }

    #[test]
    fn no_rock_floats_even_on_a_steep_slope() {
        let slope = Arc::new(Terrain::from_height(920.0, 300, Vec::new(), |p| 0.6 * p.x + 0.3 * p.y));
        let params = Params::draw_default(5);
        for rock in &plan(&Streams::new(5), &params, &slope, Vec3::new(0.0, -90.0, 500.0)) {
            let lowest =
                rock.vertices.iter().map(|v| v.position + rock.centre).min_by(|a, b| a.z.total_cmp(&b.z));
            let lowest = lowest.expect("a rock has vertices");
            assert!(lowest.z < slope.surface_height_at(lowest.truncate()), "rock {}", rock.index);
        }
    }

    #[test]
    fn embedding_is_the_buried_fraction_of_the_height_on_flat_ground() {
        let params = Params::draw_default(8);
        for rock in &plan(&Streams::new(8), &params, &flat(), Vec3::new(0.0, -90.0, 500.0)) {
            let [bottom, top] = rock.z_range_m.map(|z| z + rock.centre.z);
            assert!((-bottom / (top - bottom) - 0.30).abs() < 1e-3, "rock {}", rock.index);
        }
    }

    #[test]
    fn a_rock_over_the_eye_is_moved_clear_of_it_and_no_other() {
        let params = Params::draw_default(11);
        let streams = Streams::new(11);
        let before = plan(&streams, &params, &flat(), Vec3::new(0.0, -90.0, 500.0));
        let eye = before[4].centre + Vec3::new(0.05, 0.02, 0.1);
        assert_eq!(before[4].distance_to(eye, 0.5), 0.0);
        let after = plan(&streams, &params, &flat(), eye);
        assert!(after[4].moved && after[4].distance_to(eye, 1.0) >= EYE_CLEARANCE_M);
        for (a, b) in before.iter().zip(&after) {
            let too_near = a.distance_to(eye, 0.5) < EYE_CLEARANCE_M;
            assert_eq!(b.moved, too_near);
            assert_eq!(a.centre == b.centre, !too_near);
            assert_eq!(a.vertices, b.vertices);
        }
    }

    #[test]
    fn one_rock_more_leaves_the_others_as_they_were() {
        let mut config = crate::params::sampler::Config::new();
        let mut rocks = |count: &str| {
            config.apply_set(&format!("rocks.count={count}")).expect("a count");
            let params = config.draw(21).expect("drawn");
            plan(&Streams::new(21), &params, &flat(), Vec3::new(0.0, -90.0, 2.0))
        };
        let (few, more) = (rocks("30"), rocks("31"));
        assert_eq!((few.len(), more.len()), (30, 31));
        for (a, b) in few.iter().zip(&more) {
            assert!(a.centre == b.centre && a.vertices == b.vertices && a.material == b.material);
        }
    }

    #[test]
    fn a_rock_lies_where_it_was_looked_for_before_it_was_built() {
        let slope = Arc::new(Terrain::from_height(920.0, 300, Vec::new(), |p| 0.6 * p.x + 0.3 * p.y));
        for displacement in ["0", "0.34", "0.8"] {
            let mut config = crate::params::sampler::Config::new();
            config.apply_set(&format!("rocks.displacement={displacement}")).expect("a displacement");
            let params = config.draw(6).expect("drawn");
            let rocks = plan(&Streams::new(6), &params, &slope, Vec3::new(0.0, -90.0, 500.0));
            assert_eq!(rocks.built().count(), 0);
            let mut looked_for = Vec::new();
            let none = rocks.that_may(|rock| {
                looked_for.push(*rock);
                false
            });
            assert!(none.is_empty() && rocks.built().count() == 0);
            for (rock, Whereabouts { centres: [low, high], radius_m }) in rocks.iter().zip(looked_for) {
                assert_eq!(rock.centre.truncate(), low.truncate(), "rock {}", rock.index);
                assert!((low.z..=high.z).contains(&rock.centre.z), "rock {}: {}", rock.index, rock.centre);
                assert!((rock.radius_m..2.5 * rock.radius_m).contains(&radius_m), "rock {}", rock.index);
            }
        }
    }

    #[test]
    fn a_rock_is_told_from_others_alike_before_and_after_it_was_built() {
        let told = |rocks: &Rocks| {
            let mut bytes = Vec::new();
            rocks.write_to(|more| bytes.extend_from_slice(more));
            bytes
        };
        let of = |seed, embedding: &str| {
            let mut config = crate::params::sampler::Config::new();
            config.apply_set(&format!("rocks.embedding={embedding}")).expect("an embedding");
            plan(&Streams::new(seed), &config.draw(9).expect("drawn"), &flat(), Vec3::new(0.0, -90.0, 2.0))
        };
        let rocks = of(9, "0.3");
        let before = told(&rocks);
        assert!(told(&of(10, "0.3")) != before && told(&of(9, "0.31")) != before);
        let mut changed = rocks.clone();
        assert_eq!(rocks.iter().count(), rocks.built().count());
        assert!(told(&rocks) == before);
        changed[3].centre.z += 0.01;
        assert!(told(&changed) != before && told(&rocks) == before);
    }

    #[test]
    fn faces_point_outward_and_shapes_are_those_of_boulders() {
        let params = Params::draw_default(2);
        let rocks = plan(&Streams::new(2), &params, &flat(), Vec3::new(0.0, -90.0, 2.0));
        for rock in &rocks {
            let outward = rock.triangles(rock.level).iter().filter(|t| {
                let [a, b, c] = t.map(|v| rock.vertices[v as usize].position);
                (b - a).cross(c - a).dot(a) > 0.0
            });
            assert_eq!(
                outward.count(),
                20 << (2 * rock.level),
                "a star-shaped surface has no face turned inward"
            );
            assert_eq!(rock.level, authored_level(f64::from(rock.base_scale_m)));
            let flatness = (rock.z_range_m[1] - rock.z_range_m[0]) / (2.0 * rock.radius_m);
            assert!((0.2..1.0).contains(&flatness), "rock {}: {flatness}", rock.index);
        }
        let roughness: Vec<f32> = rocks.iter().map(|r| r.material.roughness).collect();
        assert!(roughness.iter().all(|r| (0.85..0.97).contains(r)));
    }
}
