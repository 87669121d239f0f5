//! The rocks of the surface stage: the Moon's law of sizes, a scatter everywhere and clusters at fresh craters, or four
//! bands of counted rocks; angular shapes.
//!
//! Where rocks lie is a function of the seed and of the place on the Moon, octave by octave of their diameters, so that
//! a rock is where it is from wherever it is looked at. Only those are made that can be seen, or throw a shadow that can.
//! Must not know: how many triangles of a rock are drawn.

use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

use super::{Material, Rock, Shape, rotated};
use crate::params::{Knob, Params};
use crate::random::{Stream, Streams};
use crate::reuse::Reused;
use crate::scene::craters::Pit;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::relief::{Apron, Relief};
use crate::scene::rings::View;
use crate::scene::terrain::Terrain;

/// Largest diameter, metres.
const LARGEST_M: f64 = 4.0;
/// Octaves of diameters: from 4 m to 3 cm.
const OCTAVES: u32 = 7;
/// Below this diameter the exponential law leaves out what the Surveyors counted: a power law goes on from it, metres.
const TAIL_M: f64 = 0.10;
/// Exponent of that power law (Shoemaker and Morris for Surveyor I: N proportional to D^-2.11).
const TAIL_EXPONENT: f64 = 2.11;
/// Rocks in a cell of an octave, in the mean.
const ROCKS_A_CELL: f64 = 3.0;
/// The smallest rock that is made spans this angle seen from the eye, radians...
const LEAST_ANGLE: f64 = 1.7e-3;
/// ... or as much more as keeps them to about so many.
const MOST_ROCKS: f64 = 3500.0;
/// Rocks outside the sector that is looked at are made within so many of their diameters of it, at most
/// [`OUTSIDE_MOST_M`] metres: their shadows reach into it.
const OUTSIDE_DIAMETERS: f32 = 20.0;
/// See [`OUTSIDE_DIAMETERS`].
const OUTSIDE_MOST_M: f32 = 40.0;
/// Fresh craters from this diameter on have rocks around them, metres.
const CLUSTER_LEAST_M: f32 = 2.0;
/// Share of the ground that these rocks cover at the rim; it falls with the cube of the distance, to 3 radii.
const CLUSTER_COVERAGE: f64 = 0.12;
/// The largest of them, in diameters of the crater.
const CLUSTER_LARGEST: f64 = 0.06;
/// Shapes that the smaller rocks share.
const PROTOTYPES: u64 = 16;
/// Their level: 642 vertices.
const PROTOTYPE_LEVEL: usize = 3;
/// Rocks that span more than this have a shape of their own, radians.
const OWN_SHAPE_ANGLE: f32 = 0.03;
/// Level of the mesh of a rock that spans at least this angle, radians.
const LEVELS: [(f32, usize); 4] = [(0.35, 5), (0.12, 4), (0.025, 3), (0.006, 2)];
/// Planes that cut a rock.
const PLANES: u32 = 8;
/// Where they cut it, as a fraction of its extent.
const CUTS: (f64, f64) = (0.60, 0.90);
/// Rocks from this diameter on have an apron of soil, metres.
const APRON_LEAST_M: f64 = 0.20;
/// Height of the apron, diameters.
const APRON_HEIGHTS: (f64, f64) = (0.02, 0.12);
/// Counted rocks: the knob of their number, the purpose of their streams, smallest and largest radius and how far ahead of
/// [`BANDS_FROM`] they lie, metres.
const BANDS: [(Knob, &str, [f64; 2], f64); 4] = [
    (Knob::RocksLargeCount, "rocks.band.large", [1.6, 3.4], 320.0),
    (Knob::RocksMidCount, "rocks.band.mid", [0.50, 1.40], 200.0),
    (Knob::RocksSmallCount, "rocks.band.small", [0.18, 0.50], 120.0),
    (Knob::RocksPebbleCount, "rocks.band.pebble", [0.04, 0.18], 60.0),
];
/// The camera's nominal place, from which they lie ahead, metres.
const BANDS_FROM: [f64; 2] = [0.0, -90.0];
/// The nearest of them, metres ahead of it.
const BANDS_NEAREST_M: f64 = 2.0;
/// Half the width of the strip in which they lie, as a part of its length.
const BANDS_HALF_WIDTH: f64 = 0.6;
/// Told from the cells and craters that rocks of the law have.
const BANDS_KEY: u64 = 0xb0a7_0000;
/// Bounds of the ratio of a rock's albedo to the soil's.
const RATIO_RANGE: [f64; 2] = [0.7, 2.5];

/// Rocks larger than a diameter (metres) a square metre: Li and Wu 2018's law for the Moon, in the form that JPL's LuNaSynth
/// has: a share k exp(-q D) of the ground lies under rocks of more than D, q = 0.5648 + 0.01285 / k; below
/// [`TAIL_M`] the power law of the Surveyors.
#[must_use]
pub fn rocks_larger_than(diameter_m: f64, coverage: f64) -> f64 {
    if coverage <= 0.0 {
        return 0.0;
    }
    if diameter_m < TAIL_M {
        return rocks_larger_than(TAIL_M, coverage) * libm::pow(diameter_m / TAIL_M, -TAIL_EXPONENT);
    }
    let q = 0.5648 + 0.01285 / coverage;
    // Integral of k q exp(-q x) / (pi x^2 / 4) over the logarithm of x, by Simpson's rule.
    let at = |log: f64| {
        let x = libm::exp(log);
        coverage * q * libm::exp(-q * x) * 4.0 / (std::f64::consts::PI * x)
    };
    let (low, high, steps) = (libm::log(diameter_m), libm::log(40.0), 64);
    let step = (high - low) / f64::from(steps);
    let inner: f64 =
        (1..steps).map(|i| if i % 2 == 1 { 4.0 } else { 2.0 } * at(low + step * f64::from(i))).sum();
    step / 3.0 * (at(low) + inner + at(high))
}

/// A rock to be.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// Where it lies, metres, world.
    pub place: Vec2,
    /// Mean of its extents seen from above, metres.
    pub diameter_m: f64,
    /// The element of its streams.
    key: u64,
}

/// Which rocks are worth making.
#[derive(Clone, Copy, Debug)]
struct Sight<'a> {
    view: &'a View,
    centre: Vec2,
    ahead: Vec2,
    least_angle: f64,
}

impl Sight<'_> {
    /// Distance from the eye to a place on the ground, metres.
    fn distance_m(&self, place: Vec2) -> f32 {
        let height_m = self.view.eye_height_m;
        (place.distance_squared(self.centre) + height_m * height_m).sqrt()
    }

    /// Whether a circle reaches into the sector that is looked at.
    fn reaches(&self, place: Vec2, radius_m: f32) -> bool {
        let offset = place - self.centre;
        if offset.length() <= radius_m || self.view.half_sector >= std::f64::consts::PI {
            return true;
        }
        let along = offset.dot(self.ahead);
        let across = offset.perp_dot(self.ahead).abs();
        let (sin, cos) = (libm::sin(self.view.half_sector) as f32, libm::cos(self.view.half_sector) as f32);
        // Distance to the ray that bounds the sector, outside of it.
        let outside_m = across * cos - along * sin;
        outside_m <= radius_m && (along >= -radius_m || cos < 0.0)
    }

    fn wants(&self, place: Vec2, diameter_m: f64) -> bool {
        let outside_m = (OUTSIDE_DIAMETERS * diameter_m as f32).min(OUTSIDE_MOST_M);
        diameter_m >= self.least_angle * f64::from(self.distance_m(place)) && self.reaches(place, outside_m)
    }
}

/// Inverse of the law within a range of diameters.
struct Sizes {
    logs: Vec<f64>,
    larger: Vec<f64>,
}

impl Sizes {
    const STEPS: u32 = 24;

    fn new(low_m: f64, high_m: f64, coverage: f64) -> Self {
        let logs: Vec<f64> = (0..=Self::STEPS)
            .map(|i| {
                libm::log(low_m)
                    + (libm::log(high_m) - libm::log(low_m)) * f64::from(i) / f64::from(Self::STEPS)
            })
            .collect();
        let larger = logs.iter().map(|log| rocks_larger_than(libm::exp(*log), coverage)).collect();
        Self { logs, larger }
    }

    /// Rocks of the range a square metre.
    fn density(&self) -> f64 {
        self.larger[0] - self.larger[self.larger.len() - 1]
    }

    fn draw(&self, stream: &mut Stream) -> f64 {
        let wanted = self.larger[0] - self.density() * stream.unit();
        let after = self.larger.partition_point(|larger| *larger > wanted).clamp(1, self.larger.len() - 1);
        let (high, low) = (self.larger[after - 1], self.larger[after]);
        let t = if high > low { (high - wanted) / (high - low) } else { 0.0 };
        libm::exp(self.logs[after - 1] + (self.logs[after] - self.logs[after - 1]) * t)
    }
}

/// A whole number with this mean (Knuth's method; the means here are small).
fn poisson(mean: f64, stream: &mut Stream) -> u32 {
    let limit = libm::exp(-mean);
    let (mut count, mut product) = (0, stream.unit());
    while product > limit && count < 10_000 {
        count += 1;
        product *= stream.unit();
    }
    count
}

/// The element of the `k`-th rock of a cell or crater (Steele, Lea and Flood 2014: the finaliser of SplitMix64).
const fn rock_key(of: u64, octave: u32, k: u32) -> u64 {
    let mut z = of ^ ((octave as u64) << 56) ^ ((k as u64) << 40);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Where rocks lie, the largest octave or band first.
#[must_use]
pub fn place(streams: &Streams, params: &Params, relief: &Relief, view: &View, centre: Vec2) -> Vec<Placed> {
    let mut placed = drawn(streams, params, relief, view, centre);
    // Beyond the border of the ground there is nothing to lie on.
    placed.retain(|rock| f64::from(rock.place.distance(centre)) + rock.diameter_m <= view.radius_m);
    placed
}

fn drawn(streams: &Streams, params: &Params, relief: &Relief, view: &View, centre: Vec2) -> Vec<Placed> {
    if params.text(Knob::RocksLaw) == "bands" {
        return counted(streams, params);
    }
    let coverage = params.number(Knob::RocksCoverage);
    if coverage <= 0.0 {
        return Vec::new();
    }
    // Rocks that span more than an angle a, all around: 4 k / a^2 for the exponential law.
    let sector = (view.half_sector / std::f64::consts::PI).min(1.0);
    let least_angle = LEAST_ANGLE.max((4.0 * coverage * sector / MOST_ROCKS).sqrt());
    let ahead = Vec2::new(libm::sin(view.azimuth) as f32, libm::cos(view.azimuth) as f32);
    let sight = Sight { view, centre, ahead, least_angle };
    let mut placed = Vec::new();
    for octave in 0..OCTAVES {
        let high_m = LARGEST_M / f64::from(1_u32 << octave);
        scatter(streams, octave, &Sizes::new(0.5 * high_m, high_m, coverage), high_m, &sight, &mut placed);
    }
    let furthest_m = (LARGEST_M / least_angle).min(view.radius_m) as f32;
    relief.craters.around(Vec2::ZERO, furthest_m, CLUSTER_LEAST_M, |pit| {
        if pit.is_fresh() {
            cluster(streams, &pit, coverage, &sight, &mut placed);
        }
    });
    placed
}

/// The rocks of the bands: as many as are asked for, each from a stream of its own, whether they are seen or not.
fn counted(streams: &Streams, params: &Params) -> Vec<Placed> {
    let of_band = |(band, (knob, purpose, radii_m, ahead_m)): (u32, (Knob, &'static str, [f64; 2], f64))| {
        (0..params.count(knob)).map(move |k| {
            let mut draw = streams.stream(purpose, k.into());
            let half_width_m = BANDS_HALF_WIDTH * ahead_m;
            let x = BANDS_FROM[0] + draw.uniform(-half_width_m, half_width_m);
            let y = BANDS_FROM[1] + draw.uniform(BANDS_NEAREST_M, ahead_m);
            let diameter_m = 2.0 * draw.uniform(radii_m[0], radii_m[1]);
            Placed { place: Vec2::new(x as f32, y as f32), diameter_m, key: rock_key(BANDS_KEY, band, k) }
        })
    };
    (0..).zip(BANDS).flat_map(of_band).collect()
}

/// The rocks of an octave that lie anywhere.
fn scatter(
    streams: &Streams,
    octave: u32,
    sizes: &Sizes,
    high_m: f64,
    sight: &Sight<'_>,
    placed: &mut Vec<Placed>,
) {
    let density = sizes.density();
    let reach_m = (high_m / sight.least_angle).min(sight.view.radius_m);
    // Where hardly a rock of the octave is to be expected a cell is as large as the ground.
    let cell_m = (ROCKS_A_CELL / density.max(1e-9)).sqrt().min(sight.view.radius_m);
    let mean = density * cell_m * cell_m;
    let purpose = ["a", "b", "c", "d", "e", "f", "g"][octave as usize];
    let purpose = format!("rocks.cell.{purpose}");
    let cell_of = |metres: f64| (metres / cell_m).floor() as i32;
    let (x, y) = (f64::from(sight.centre.x), f64::from(sight.centre.y));
    for row in cell_of(y - reach_m)..=cell_of(y + reach_m) {
        for column in cell_of(x - reach_m)..=cell_of(x + reach_m) {
            let corner = Vec2::new((f64::from(column) * cell_m) as f32, (f64::from(row) * cell_m) as f32);
            let middle = corner + 0.5 * cell_m as f32;
            let radius_m = 0.75 * cell_m as f32;
            let outside_m = (OUTSIDE_DIAMETERS * high_m as f32).min(OUTSIDE_MOST_M);
            if middle.distance(sight.centre) > reach_m as f32 + radius_m
                || !sight.reaches(middle, radius_m + outside_m)
            {
                continue;
            }
            let cell = u64::from(column as u32) << 32 | u64::from(row as u32);
            let mut draw = streams.stream(&purpose, cell);
            for k in 0..poisson(mean, &mut draw) {
                let within = Vec2::new((draw.unit() * cell_m) as f32, (draw.unit() * cell_m) as f32);
                let (place, diameter_m) = (corner + within, sizes.draw(&mut draw));
                if sight.wants(place, diameter_m) {
                    placed.push(Placed { place, diameter_m, key: rock_key(cell, octave, k) });
                }
            }
        }
    }
}

/// The rocks that a fresh crater threw out.
fn cluster(streams: &Streams, pit: &Pit, coverage: f64, sight: &Sight<'_>, placed: &mut Vec<Placed>) {
    let centre = sight.centre + pit.offset;
    let radius_m = 0.5 * f64::from(pit.diameter_m);
    let largest_m = CLUSTER_LARGEST * f64::from(pit.diameter_m);
    let outside_m = (OUTSIDE_DIAMETERS * largest_m as f32).min(OUTSIDE_MOST_M);
    if !sight.reaches(centre, 3.0 * radius_m as f32 + outside_m) {
        return;
    }
    let nearest_m =
        f64::from((sight.distance_m(centre) - 3.0 * radius_m as f32).max(sight.view.eye_height_m));
    // Around a crater there are more rocks where there are more everywhere.
    let rim = CLUSTER_COVERAGE * (coverage / 0.008).min(1.0);
    let mut high_m = largest_m;
    for octave in 0..OCTAVES {
        if high_m < sight.least_angle * nearest_m || high_m < LARGEST_M / f64::from(1_u32 << OCTAVES) {
            break;
        }
        let sizes = Sizes::new(0.5 * high_m, high_m, rim);
        // Integral of (r / R)^-3 over the ring from 1 to 3 radii.
        let area_m2 = std::f64::consts::TAU * radius_m * radius_m * (1.0 - 1.0 / 3.0);
        let mut draw = streams.stream("rocks.cluster", pit.key ^ (u64::from(octave) << 20));
        let mut left = sizes.density() * area_m2;
        let mut count = 0;
        while left > 0.0 {
            count += poisson(left.min(20.0), &mut draw);
            left -= 20.0;
        }
        for k in 0..count.min(4000) {
            let distance_m = radius_m / (1.0 - draw.unit() * (2.0 / 3.0));
            let angle = draw.uniform(0.0, std::f64::consts::TAU);
            let offset = Vec2::new(libm::sin(angle) as f32, libm::cos(angle) as f32) * distance_m as f32;
            let (place, diameter_m) = (centre + offset, sizes.draw(&mut draw));
            if sight.wants(place, diameter_m) {
                placed.push(Placed { place, diameter_m, key: rock_key(pit.key, octave + 32, k) });
            }
        }
        high_m *= 0.5;
    }
}

/// The aprons of soil of these rocks, metres from `centre`.
#[must_use]
pub fn aprons(streams: &Streams, placed: &[Placed], centre: Vec2) -> Vec<Apron> {
    placed
        .iter()
        .filter(|rock| rock.diameter_m >= APRON_LEAST_M)
        .map(|rock| {
            let share = streams.stream("rocks.apron", rock.key).uniform(APRON_HEIGHTS.0, APRON_HEIGHTS.1);
            Apron {
                offset: rock.place - centre,
                radius_m: 0.5 * rock.diameter_m as f32,
                height_m: (share * rock.diameter_m) as f32,
            }
        })
        .collect()
}

/// Makes the rocks.
#[must_use]
pub fn build(
    streams: &Streams,
    params: &Params,
    terrain: &Terrain,
    eye: Vec3,
    soil: &Material,
    placed: &[Placed],
) -> Vec<Rock> {
    let prototypes: Vec<Reused<Vec3>> = (0..PROTOTYPES)
        .into_par_iter()
        .map(|k| form(&mut streams.stream("rocks.prototype", k), params, PROTOTYPE_LEVEL))
        .collect();
    let build = |(index, placed): (usize, &Placed)| {
        let draw = |purpose: &str| streams.stream(purpose, placed.key);
        let diameter_m = placed.diameter_m as f32;
        let ground = placed.place.extend(eye.z);
        let angle = diameter_m / ground.distance(eye).max(0.5);
        let level = LEVELS.iter().find(|(least, _)| angle >= *least).map_or(1, |(_, level)| *level);
        let own = (angle >= OWN_SHAPE_ANGLE || level > PROTOTYPE_LEVEL)
            .then(|| form(&mut draw("rocks.shape"), params, level));
        let mut pose = draw("rocks.pose");
        let prototype = pose.uniform_int(0, PROTOTYPES as i64 - 1) as usize;
        let count = Icosphere::vertex_count(level);
        let form = own.as_deref().unwrap_or_else(|| &prototypes[prototype][..count]);
        let vertices = posed(&mut pose, form, level, diameter_m);
        let ratio = albedo_ratio(params, &mut draw("rocks.albedo"));
        let tint = Vec3::new(0.985, 1.0, 1.03);
        let albedo = (soil.albedo * ratio as f32 * tint).min(Vec3::ONE);
        let roughness = params.sample(Knob::RocksRoughness, &mut draw("rocks.roughness")) as f32;
        let mut rock = Rock::of_vertices(index as u32, vertices, level, Material { albedo, roughness });
        rock.base_scale_m = 0.5 * diameter_m;
        // Upward faces of a ball are spread evenly over z.
        rock.dust_above = 1.0 - params.sample(Knob::RocksDust, &mut draw("rocks.dust")) as f32;
        let exposed = params.sample(Knob::RocksExposed, &mut draw("rocks.exposed")) as f32;
        rock.place(terrain, eye, placed.place, 1.0 - exposed);
        rock
    };
    placed.par_iter().enumerate().map(build).collect()
}

/// Ratio of a rock's albedo to the soil's.
fn albedo_ratio(params: &Params, draw: &mut Stream) -> f64 {
    let (median, spread) = (params.number(Knob::RocksAlbedoRatio), params.number(Knob::RocksAlbedoSpread));
    let ratio = median * libm::exp(spread * draw.normal());
    ratio.clamp(RATIO_RANGE[0].min(median), RATIO_RANGE[1].max(median))
}

/// A rough form about the size of the unit sphere, cut by planes.
fn form(draw: &mut Stream, params: &Params, level: usize) -> Reused<Vec3> {
    let shape = Shape::draw(draw, params.number(Knob::RocksDisplacement));
    let directions = &Icosphere::shared().directions;
    let mut positions: Reused<Vec3> = Reused::of_any(Icosphere::vertex_count(level));
    for ((position, &u), radius) in positions.iter_mut().zip(directions).zip(&shape.radii(level)) {
        *position = radius * u;
    }
    // Extents come from the first vertices, so that a plane cuts a form of any level alike.
    let coarse = Icosphere::vertex_count(level.min(2));
    for _ in 0..PLANES {
        let z = draw.uniform(-1.0, 1.0);
        let (angle, across) = (draw.uniform(0.0, std::f64::consts::TAU), (1.0 - z * z).sqrt());
        let normal =
            Vec3::new((across * libm::cos(angle)) as f32, (across * libm::sin(angle)) as f32, z as f32);
        let extent = positions[..coarse].iter().map(|p| p.dot(normal)).fold(0.0, f32::max);
        let cut = extent * draw.uniform(CUTS.0, CUTS.1) as f32;
        for p in &mut positions {
            let height = p.dot(normal);
            if height > cut {
                *p *= cut / height;
            }
        }
    }
    positions
}

/// A form scaled along its axes, turned, and as wide as it should be.
fn posed(draw: &mut Stream, form: &[Vec3], level: usize, diameter_m: f32) -> Reused<Vertex> {
    let scale = [draw.uniform(0.85, 1.18), draw.uniform(0.85, 1.18), draw.uniform(0.55, 0.95)];
    let world_from_form: Mat3 = rotated(draw, scale.map(|s| s as f32));
    let mut vertices: Reused<Vertex> = Reused::of_any(form.len());
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for (vertex, &p) in vertices.iter_mut().zip(form) {
        vertex.position = world_from_form * p;
        low = low.min(vertex.position);
        high = high.max(vertex.position);
    }
    let factor = 2.0 * diameter_m / ((high.x - low.x) + (high.y - low.y));
    for vertex in &mut vertices {
        vertex.position *= factor;
    }
    Icosphere::shared().set_smooth_normals(&mut vertices, level);
    vertices
}
