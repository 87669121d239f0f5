//! Draws the shapes of rocks of the surface stage: blocks, slabs, split, irregular and rounded ones, worn by age.
//!
//! Must not know: where the rock lies, what it is made of.

use std::f64::consts::TAU;

use arrayvec::ArrayVec;
use glam::Vec3;

use super::form::{Crack, Form, Fracture, Scar};
use super::shape::rotated;
use crate::pool::PooledVec;
use crate::random::Stream;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::noise::Fbm;

/// Icosphere level whose directions find how far a body extends along a normal: 42 directions.
const EXTENT_LEVEL: usize = 1;
/// Mean ratios of the axes, intermediate over longest and shortest over intermediate: of fresh impact fragments, and of worn lunar
/// particles (Tsuchiyama et al. 2022, Earth Planets Space 74, 172, who give both).
const AXIS_RATIOS: [[f64; 2]; 2] = [[0.707, 0.707], [0.758, 0.770]];
/// Deviation of these ratios, and their bounds.
const AXIS_SPREAD: f64 = 0.11;
const AXIS_BOUNDS: (f64, f64) = (0.42, 0.97);
/// Shortest over longest axis below which a block is a slab.
const SLAB_RATIO: f64 = 0.40;
/// Age, as a fraction of a rock's lifetime, from which it is rounded.
const ROUNDED_AGE: f64 = 0.80;
/// Shares of the younger rocks: those bounded by joints, and those of them that broke in two; the others are irregular.
const JOINTED_SHARE: f64 = 0.70;
const SPLIT_SHARE: f64 = 0.22;
/// Share of the jointed rocks with a ledge, and of those with an open crack.
const LEDGE_SHARE: f64 = 0.45;
const CRACK_SHARE: f64 = 0.20;
/// Wear of the edges of a fresh fracture.
const FRESH_WEAR: f32 = 0.012;
/// Deviation and bound of the tilt of a rock's shortest axis, degrees. With it rocks are 0.71 of their diameter high.
const TILT_DEG: (f64, f64) = (20.0, 45.0);
/// Least level with more than the first planes, whose triangles span only pixels.
const CHIPS_LEVEL: usize = 2;
/// What bounds a rock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Three sets of joints, roughly at right angles.
    Block,
    /// The same, thin.
    Slab,
    /// A block or slab that broke in two: one face is a fresh fracture.
    Split,
    /// Fractures in any direction.
    Irregular,
    /// Worn beyond recognition of its fractures.
    Rounded,
}

/// The outline of a body: its surface in the directions of [`EXTENT_LEVEL`].
struct Body([Vec3; Icosphere::vertex_count(EXTENT_LEVEL)]);

impl Body {
    fn of(form: &Form) -> Self {
        let mut body = Self([Vec3::ZERO; _]);
        form.for_each_position(EXTENT_LEVEL, |vertex, position| body.0[vertex] = position);
        body
    }

    /// Cuts it by a plane at a fraction of how far it extends along a normal.
    fn cut(&mut self, normal: Vec3, fraction: f64, wear: f32) -> Fracture {
        let extent = self.0.iter().map(|p| p.dot(normal)).fold(0.0, f32::max);
        let distance = extent * fraction as f32;
        for p in &mut self.0 {
            let height = p.dot(normal);
            if height > distance {
                *p *= distance / height;
            }
        }
        Fracture::new(normal, distance, wear)
    }
}

impl Form {
    /// Draws a form with the detail that an icosphere level can hold; `displacement` scales lumps and relief, `age` is a fraction
    /// of a rock's lifetime.
    pub(super) fn draw(draw: &mut Stream, age: f64, displacement: f64, level: usize) -> Self {
        let axes = draw_axes(draw, age);
        let kind = draw_kind(draw, age, axes);
        let wear = (0.025 + 0.30 * age * age) as f32;
        let mut form = Self {
            axes,
            reach: draw.uniform(1.25, 1.50) as f32,
            planes: ArrayVec::new(),
            ledge: usize::MAX,
            chips: ArrayVec::new(),
            scars: ArrayVec::new(),
            crack: None,
            lumps: (Fbm { octaves: 2, frequency: 0.9, lacunarity: 2.1, seed: draw.bits() }, 0.0),
            relief: (Fbm { octaves: 0, frequency: 2.6, lacunarity: 2.3, seed: draw.bits() }, 0.0),
            domain_offset: draw_jitter(draw, 41.0),
        };
        match kind {
            Kind::Block | Kind::Slab | Kind::Split => form.add_joints(draw, wear),
            Kind::Irregular => {
                form.reach = 1.22;
                form.add_random_planes(draw, (9, 13), (0.62, 0.92), wear);
            }
            Kind::Rounded => {
                form.reach = 1.06;
                form.add_random_planes(draw, (8, 12), (0.80, 1.0), wear);
            }
        }
        if level < CHIPS_LEVEL {
            return form;
        }
        let mut body = Body::of(&form);
        let is_jointed = matches!(kind, Kind::Block | Kind::Slab | Kind::Split);
        if is_jointed {
            // Oblique fractures, through both bodies where there is a ledge; then perhaps a steep fresh one, near the middle.
            for _ in 0..draw.uniform_int(2, 5) {
                form.chips.push(body.cut(draw_direction(draw), draw.uniform(0.66, 0.92), wear));
            }
            if kind == Kind::Split {
                let normal = direction(draw.uniform(-0.45, 0.45), draw.uniform(0.0, TAU));
                form.chips.push(body.cut(normal, draw.uniform(0.12, 0.45), FRESH_WEAR));
            }
        }
        form.centre_and_stretch(&mut body);
        let lumps = if is_jointed { draw.uniform(0.10, 0.30) } else { draw.uniform(0.25, 0.55) };
        form.lumps.1 = (displacement * lumps) as f32;
        form.relief.1 = (displacement * draw.uniform(0.16, 0.30) * (1.0 - 0.4 * age)) as f32;
        if is_jointed && draw.unit() < CRACK_SHARE {
            let normal = draw_direction(draw);
            form.crack = Some(Crack {
                normal,
                offset: draw.uniform(-0.3, 0.3) as f32 * normal.dot(axes).abs(),
                depth: draw.uniform(0.06, 0.14) as f32,
                half_width: draw.uniform(0.05, 0.08) as f32,
            });
        }
        form.add_chips(draw, &mut body, wear);
        form.add_scars(draw, age);
        form
    }

    /// Three pairs of joints, roughly at right angles; perhaps a ledge.
    fn add_joints(&mut self, draw: &mut Stream, wear: f32) {
        let lean = draw_jitter(draw, 0.26);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for side in [-1.0, 1.0] {
                let own = draw_jitter(draw, 0.20);
                let normal = (side * (axis + axis.cross(lean)) + own).normalize();
                let distance = axis.dot(self.axes) * draw.uniform(0.84, 1.0) as f32;
                self.planes.push(Fracture::new(normal, distance, wear));
            }
        }
        if draw.unit() < LEDGE_SHARE {
            // A second body with the same joints: lower, narrower, and longer to one side.
            let long_side = draw.uniform_int(0, 3) as usize;
            self.ledge = self.planes.len();
            for side in 0..self.ledge {
                let factor = if side == long_side {
                    draw.uniform(1.12, 1.40)
                } else if side == 5 {
                    draw.uniform(0.35, 0.80)
                } else {
                    draw.uniform(0.75, 1.0)
                };
                let first = self.planes[side];
                self.planes.push(Fracture { gauge: first.gauge / factor as f32, ..first });
            }
        }
    }

    /// Planes of evenly spread directions, at fractions of the ellipsoid's extent.
    fn add_random_planes(&mut self, draw: &mut Stream, counts: (i64, i64), cuts: (f64, f64), wear: f32) {
        let count = draw.uniform_int(counts.0, counts.1);
        let phase = draw.uniform(0.0, TAU);
        for k in 0..count {
            // A spiral of equal areas, jittered.
            let z = 1.0 - (2 * k + 1) as f64 / count as f64;
            let angle = phase + 2.399_963 * k as f64;
            let jitter = draw_jitter(draw, 0.48);
            let normal = (direction(z, angle) + jitter).normalize_or(Vec3::Z);
            let distance = (self.axes * normal).length() * draw.uniform(cuts.0, cuts.1) as f32;
            self.planes.push(Fracture::new(normal, distance, wear));
        }
    }

    /// Moves the origin to the middle of the body and stretches it to its axes.
    fn centre_and_stretch(&mut self, body: &mut Body) {
        let (mut moment, mut weight) = (Vec3::ZERO, 0.0);
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &p in &body.0 {
            let cube = p.length() * p.length_squared();
            moment += cube * p;
            weight += cube;
            (low, high) = (low.min(p), high.max(p));
        }
        let (centre, min) = (0.75 / weight * moment, 0.3 * self.axes.z);
        let stretch = 2.0 * self.axes / (high - low);
        for plane in self.planes.iter_mut().chain(&mut self.chips) {
            *plane = plane.recentred(centre, min);
            plane.gauge /= stretch;
        }
        for p in &mut body.0 {
            *p = (*p - centre) * stretch;
        }
    }

    /// Small planes that cut edges and corners off.
    fn add_chips(&mut self, draw: &mut Stream, body: &mut Body, wear: f32) {
        for _ in 0..draw.uniform_int(4, 8) {
            self.chips.push(body.cut(draw_direction(draw), draw.uniform(0.86, 0.98), 0.6 * wear));
        }
    }

    /// Hollows that spalls left behind; shallower on worn rocks.
    fn add_scars(&mut self, draw: &mut Stream, age: f64) {
        for _ in 0..draw.uniform_int(2, 6) {
            let radius = draw.uniform(0.22, 0.60);
            self.scars.push(Scar {
                towards: draw_direction(draw),
                depth: (radius * draw.uniform(0.06, 0.22) * (1.0 - 0.5 * age)) as f32,
                sharpness: (1.0 / (1.0 - libm::cos(radius))) as f32,
            });
        }
    }
}

/// Half axes, the longest 1 and along x, the shortest along z.
fn draw_axes(draw: &mut Stream, age: f64) -> Vec3 {
    let mut ratio = |k: usize| {
        let mean = AXIS_RATIOS[0][k] + age * (AXIS_RATIOS[1][k] - AXIS_RATIOS[0][k]);
        (mean + AXIS_SPREAD * draw.normal()).clamp(AXIS_BOUNDS.0, AXIS_BOUNDS.1)
    };
    let (intermediate, shortest) = (ratio(0), ratio(1));
    Vec3::new(1.0, intermediate as f32, (intermediate * shortest) as f32)
}

fn draw_kind(draw: &mut Stream, age: f64, axes: Vec3) -> Kind {
    let (jointed, split) = (draw.unit() < JOINTED_SHARE, draw.unit() < SPLIT_SHARE);
    match (jointed, split) {
        _ if age >= ROUNDED_AGE => Kind::Rounded,
        (false, _) => Kind::Irregular,
        (true, true) => Kind::Split,
        (true, false) if f64::from(axes.z) < SLAB_RATIO => Kind::Slab,
        (true, false) => Kind::Block,
    }
}

/// Unit vector of a height and an azimuth.
fn direction(z: f64, angle: f64) -> Vec3 {
    let across = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new((across * libm::cos(angle)) as f32, (across * libm::sin(angle)) as f32, z as f32)
}

/// A vector in a cube around 0 with sides of twice `reach`.
fn draw_jitter(draw: &mut Stream, reach: f64) -> Vec3 {
    Vec3::from([(); 3].map(|()| draw.uniform(-reach, reach) as f32))
}

/// A unit vector, evenly distributed.
fn draw_direction(draw: &mut Stream) -> Vec3 {
    direction(draw.uniform(-1.0, 1.0), draw.uniform(0.0, TAU))
}

/// A form at a heading and tilt, scaled to its diameter: the mean of its extents along x and y.
pub(super) fn posed(draw: &mut Stream, form: &Form, level: usize, diameter_m: f32) -> PooledVec<Vertex> {
    let world_from_form = rotated(draw, [1.0; 3], TILT_DEG);
    let mut vertices: PooledVec<Vertex> = PooledVec::recurring(Icosphere::vertex_count(level));
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    form.for_each_position(level, |vertex, p| {
        let position = world_from_form * p;
        vertices[vertex].position = position;
        low = low.min(position);
        high = high.max(position);
    });
    let factor = 2.0 * diameter_m / ((high.x - low.x) + (high.y - low.y));
    for vertex in &mut vertices {
        vertex.position *= factor;
    }
    Icosphere::shared().set_smooth_normals(&mut vertices, level);
    vertices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Streams;

    fn positions(form: &Form, level: usize) -> Vec<Vec3> {
        let mut positions = Vec::new();
        form.for_each_position(level, |_, position| positions.push(position));
        positions
    }

    /// Shares of the kinds that the constants above promise; slabs are the thin ones among the jointed rocks.
    #[test]
    fn kinds_have_their_shares() {
        let mut counts = [0.0; 5];
        let n = 4000;
        for k in 0..n {
            let draw = &mut Streams::new(3).stream("test.kind", k);
            let age = draw.unit();
            let axes = draw_axes(draw, age);
            counts[draw_kind(draw, age, axes) as usize] += 1.0 / n as f64;
        }
        let young = ROUNDED_AGE;
        let split = young * JOINTED_SHARE * SPLIT_SHARE;
        let irregular = young * (1.0 - JOINTED_SHARE);
        let [block, slab, ..] = counts;
        for (share, expected) in [
            (counts[Kind::Split as usize], split),
            (counts[Kind::Irregular as usize], irregular),
            (counts[Kind::Rounded as usize], 1.0 - young),
            (block + slab, young * JOINTED_SHARE - split),
        ] {
            assert!((share - expected).abs() < 0.02, "{share} for {expected}: {counts:?}");
        }
        assert!((0.03..=0.12).contains(&slab), "{slab} of the rocks are slabs");
    }

    /// Ratios of the axes: impact fragments have I/L = S/I = 0.707 and S/L = 0.50 in the mean, lunar particles, worn by the
    /// bombardment, 0.758, 0.770 and 0.58 (Tsuchiyama et al. 2022). Rocks of all ages lie between the two.
    #[test]
    fn forms_have_the_measured_axis_ratios() {
        let (mut sums, mut slabs, mut equant) = ([0.0; 3], 0, 0);
        let n = 600;
        for k in 0..n {
            let draw = &mut Streams::new(1).stream("test.form", k);
            let age = draw.unit();
            let positions = positions(&Form::draw(draw, age, 0.3, 3), 3);
            let (low, high) =
                positions.iter().fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(*p), high.max(*p)));
            let mut axes = (high - low).to_array();
            axes.sort_by(f32::total_cmp);
            let [s, i, l] = axes.map(f64::from);
            for (sum, ratio) in sums.iter_mut().zip([i / l, s / i, s / l]) {
                *sum += ratio / n as f64;
            }
            slabs += u32::from(s / l < 0.42);
            equant += u32::from(s / l > 0.7);
        }
        for (mean, [low, high]) in sums.into_iter().zip([[0.707, 0.758], [0.707, 0.770], [0.500, 0.581]]) {
            assert!(0.98 * low < mean && mean < 1.02 * high, "{mean} outside {low} to {high}: {sums:?}");
        }
        assert!(slabs > 30 && equant > 30, "{slabs} slabs, {equant} equant of {n}");
    }

    /// No shapes of melted wax: the surface is star-shaped, no triangle faces inwards, the nearest vertex is not far below the
    /// furthest, and the radius changes slowly with direction.
    #[test]
    fn forms_are_star_shaped_with_bounded_slopes() {
        for level in 1..=4 {
            let (mut steep, mut all) = (0, 0);
            for k in 0..120 {
                let streams = Streams::new(level as u64);
                let draw = &mut streams.stream("test.form", k);
                let age = draw.unit();
                let form = Form::draw(draw, age, 0.44, level);
                let vertices = posed(&mut streams.stream("test.pose", k), &form, level, 1.0);
                let lengths = || vertices.iter().map(|vertex| vertex.position.length());
                let (low, high) = (lengths().fold(f32::MAX, f32::min), lengths().fold(0.0, f32::max));
                assert!(low > 0.11 * high, "form {k} of level {level}: from {low} to {high}");
                for t in &Icosphere::shared().triangles[level] {
                    let [a, b, c] = t.map(|v| vertices[v as usize].position);
                    assert!((b - a).cross(c - a).dot(a) > 0.0, "form {k}: a triangle faces inwards");
                    for (p, q) in [(a, b), (b, c), (c, a)] {
                        let slope = libm::logf(p.length() / q.length()).abs() / p.angle_between(q);
                        assert!(slope < 10.0, "form {k} of level {level}: the radius rises by {slope}");
                        steep += u32::from(slope > 2.5);
                        all += 1;
                    }
                }
                let is_outward = |vertex: &Vertex| vertex.normal.dot(vertex.position) > 0.0;
                assert!(vertices.iter().all(is_outward), "form {k}: a normal points inwards");
            }
            assert!(100 * steep < all, "level {level}: {steep} of {all} edges are steep");
        }
    }

    /// Worn edges leave a body convex: without scars, relief and ledge, nothing lies in front of the plane of a triangle. Triangles
    /// across a sharp edge cut into the body: a few may.
    #[test]
    fn bodies_of_planes_are_convex_however_worn() {
        const LEVEL: usize = Icosphere::MAX_LEVEL;
        for k in 0..30 {
            let draw = &mut Streams::new(5).stream("test.form", k);
            let age = draw.unit();
            let mut form = Form::draw(draw, age, 0.0, LEVEL);
            form.scars.clear();
            form.crack = None;
            form.planes.truncate(form.ledge);
            let positions = positions(&form, LEVEL);
            let triangles = Icosphere::shared().triangles[LEVEL].iter().step_by(7);
            let is_concave = |t: &&[u32; 3]| {
                let [a, b, c] = t.map(|v| positions[v as usize]);
                let normal = (b - a).cross(c - a).normalize();
                positions.iter().step_by(17).any(|p| normal.dot(*p - a) > 0.01)
            };
            let (all, concave) = (triangles.clone().count(), triangles.filter(is_concave).count());
            assert!(12 * concave < all, "form {k}: {concave} of {all} triangles");
        }
    }

    /// The same form at two levels: vertices of the coarse one lie close to those of the fine one, which has finer relief.
    #[test]
    fn a_finer_level_changes_a_form_only_by_its_relief() {
        for k in 0..20 {
            let form = |level| {
                let draw = &mut Streams::new(9).stream("test.form", k);
                Form::draw(draw, 0.4, 0.3, level)
            };
            let (coarse, fine) = (positions(&form(3), 3), positions(&form(5), 5));
            for (a, b) in coarse.iter().zip(&fine) {
                assert!(a.distance(*b) < 0.16 * a.length(), "form {k}: {a} and {b}");
            }
        }
    }
}
