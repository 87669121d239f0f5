//! Where the rocks of the surface stage lie: the lunar size-frequency distribution, scattered everywhere and clustered at fresh
//! craters, or four size bands with fixed counts; debris.
//!
//! The positions are a function of the seed and of world coordinates, for each octave of diameters: the same rocks are there
//! from every camera. Only rocks that can be in view, or cast a shadow into view, are made.
//! Must not know: how a rock is shaped, how many of its triangles are drawn.

use glam::Vec2;

use super::rock::EYE_CLEARANCE_M;
use crate::params::{Knob, Params};
use crate::random::Streams;
use crate::scene::azimuth;
use crate::scene::crater_wall::CraterWall;
use crate::scene::craters::{Pit, Region};
use crate::scene::relief::Relief;
use crate::scene::rings::View;
pub use crate::scene::size_distribution::rocks_larger_than;
use crate::scene::size_distribution::{Abundance, DENSEST_COVERAGE, Sizes, poisson};
use crate::scene::track::Track;

/// Largest diameter, metres.
const LARGEST_M: f64 = 4.0;
/// Octaves of diameters: from 4 m to 3 cm.
const OCTAVES: u32 = 7;
/// Width of the cells of an octave, in its largest diameter.
const CELL_DIAMETERS: f64 = 24.0;
/// Approximate limit on the number of rocks: the smallest of them are left out where there would be more.
const MAX_ROCKS: f64 = 15_000.0;
/// Maximum number of all rocks, with those around fresh craters, on walls and of debris; of more, those that span the smallest angles are
/// left out. Instance ids have 16 bits.
const MAX_PLACEMENTS: usize = 60_000;
/// Rocks outside the viewed sector are made within this many of their diameters of it, at most [`OUTSIDE_MAX_M`] metres, and further away if
/// their shadows, which a low sun makes longer, come as near.
const OUTSIDE_DIAMETERS: f32 = 20.0;
/// See [`OUTSIDE_DIAMETERS`].
const OUTSIDE_MAX_M: f32 = 40.0;
/// Minimum diameter of a fresh crater with rocks around it, metres.
const CLUSTER_MIN_M: f32 = 2.0;
/// Fraction of the ground that these rocks cover at the rim; it falls with the cube of the distance, to 3 radii.
const CLUSTER_COVERAGE: f64 = DENSEST_COVERAGE;
/// The largest of them, in diameters of the crater.
const CLUSTER_LARGEST: f64 = 0.06;
/// Maximum number of them in an octave.
const MAX_CLUSTER_ROCKS: u32 = 4000;
/// Age of the rocks around a fresh crater, at most.
const CLUSTER_AGE: f32 = 0.3;
/// Minimum diameter of a rock with debris around it, metres.
const DEBRIS_FROM_M: f64 = 0.4;
/// Mean number of pieces of debris around a new rock of 1 m; it falls with the age and rises with the diameter.
const DEBRIS_PIECES: f64 = 16.0;
/// Range of diameters of debris, metres; at most [`DEBRIS_LARGEST`] of those of its rock.
const DEBRIS_M: [f64; 2] = [0.03, 0.10];
/// See [`DEBRIS_M`].
const DEBRIS_LARGEST: f64 = 0.12;
/// Age of debris.
const DEBRIS_AGE: f32 = 0.1;
/// Size bands: the knob of the count, the purpose of the random streams, the range of radii, and the largest distance ahead
/// of [`BANDS_FROM`], metres.
const BANDS: [(Knob, &str, [f64; 2], f64); 4] = [
    (Knob::RocksLargeCount, "rocks.band.large", [1.6, 3.4], 320.0),
    (Knob::RocksMidCount, "rocks.band.mid", [0.50, 1.40], 200.0),
    (Knob::RocksSmallCount, "rocks.band.small", [0.18, 0.50], 120.0),
    (Knob::RocksPebbleCount, "rocks.band.pebble", [0.04, 0.18], 60.0),
];
/// The default camera position, metres.
const BANDS_FROM: [f64; 2] = [0.0, -90.0];
/// Smallest distance ahead of it, metres.
const BANDS_NEAREST_M: f64 = 2.0;
/// Half the width of the strip in which they lie, as a fraction of its length.
const BANDS_HALF_WIDTH: f64 = 0.6;
/// Distinguishes the stream elements of the bands from those of cells and craters.
const BANDS_KEY: u64 = 0xb0a7_0000;
/// Largest diameter of rocks on a crater's wall, metres, and octaves of diameters.
const WALL_LARGEST_M: f64 = 8.0;
const WALL_OCTAVES: u32 = 8;
/// Most of a wall that they cover, and most of them.
const WALL_MAX_COVERAGE: f64 = DENSEST_COVERAGE;
const MAX_WALL_ROCKS: usize = 6000;
/// Diameter from which no rock lies in a track, metres.
pub const PRESSED_M: f64 = 0.06;

/// Largest height above the ground, diameters: higher, rounded rocks look like eggs that stand on end.
const MAX_HEIGHT: f32 = 0.75;
/// Longest horizontal extent of a rock from its centre, mean diameters.
const LONGEST_RADIUS: f32 = 0.7;
/// How much further from the eye than [`EYE_CLEARANCE_M`] rocks are on level ground, metres: other ground may rise.
const EYE_MARGIN_M: f32 = 0.1;

/// Position and size of a rock before it is shaped.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Position, metres, world.
    pub position: Vec2,
    /// Mean of its extents along x and y, metres.
    pub diameter_m: f64,
    /// Time since it came to lie here, 0 to 1: its lifetime.
    pub age: f32,
    /// The element of its random streams.
    pub(super) key: u64,
}

/// Culling by angular size and viewed sector.
#[derive(Clone, Copy, Debug)]
struct ViewCulling<'a> {
    view: &'a View,
    centre: Vec2,
    ahead: Vec2,
    min_angle: f64,
    /// From a rock to the end of its shadow on level ground, diameters.
    shadow: Vec2,
}

/// Distance from the viewed sector within which all rocks of a diameter are made, metres.
fn outside_m(diameter_m: f64) -> f32 {
    (OUTSIDE_DIAMETERS * diameter_m as f32).min(OUTSIDE_MAX_M)
}

impl<'a> ViewCulling<'a> {
    fn new(params: &Params, view: &'a View, centre: Vec2, min_angle: f64) -> Self {
        let [elevation, azimuth] =
            [Knob::SunElevationDeg, Knob::SunAzimuthDeg].map(|knob| params.number(knob).to_radians());
        let cotangent = libm::cos(elevation) / libm::sin(elevation);
        let shadow = -(f64::from(MAX_HEIGHT) * cotangent) as f32 * azimuth::direction(azimuth);
        Self { view, centre, ahead: azimuth::direction(view.azimuth), min_angle, shadow }
    }

    /// Distance from the viewed sector within which any rock of up to a diameter is made, metres.
    fn max_outside_m(&self, diameter_m: f64) -> f32 {
        outside_m(diameter_m).max(diameter_m as f32 * self.shadow.length())
    }

    /// Whether the shadow of a rock comes as near to the viewed sector as the rock itself may lie.
    fn shadow_reaches(&self, position: Vec2, diameter_m: f64) -> bool {
        let (near_m, shadow) = (outside_m(diameter_m), diameter_m as f32 * self.shadow);
        let length_m = shadow.length();
        // Circles along the shadow, each beginning where the one before ends.
        let circles = ((0.5 * (length_m / near_m - 1.0)).ceil()).max(0.0) as u32;
        (1..=circles).any(|k| {
            let along = (2.0 * k as f32 * near_m / length_m).min(1.0);
            self.reaches(position + along * shadow, near_m)
        })
    }

    /// Distance from the eye to a point of the ground, metres.
    fn distance_m(&self, point: Vec2) -> f32 {
        distance_m(self.view, self.centre, point)
    }

    /// Whether a circle overlaps the viewed sector.
    fn reaches(&self, point: Vec2, radius_m: f32) -> bool {
        let offset = point - self.centre;
        if offset.length() <= radius_m || self.view.half_sector >= std::f64::consts::PI {
            return true;
        }
        let along = offset.dot(self.ahead);
        let across = offset.perp_dot(self.ahead).abs();
        let (sin, cos) = (libm::sin(self.view.half_sector) as f32, libm::cos(self.view.half_sector) as f32);
        // Signed distance to the ray that bounds the sector, positive outside.
        let outside_m = across * cos - along * sin;
        outside_m <= radius_m && (along >= -radius_m || cos < 0.0)
    }

    /// Whether a rock is needed for its own pixels or for its shadow.
    fn keeps(&self, position: Vec2, diameter_m: f64) -> bool {
        diameter_m >= self.min_angle * f64::from(self.distance_m(position))
            && (self.reaches(position, outside_m(diameter_m)) || self.shadow_reaches(position, diameter_m))
    }
}

/// The element of the `k`-th rock of a cell or crater (Steele, Lea and Flood 2014: the finaliser of SplitMix64).
const fn rock_key(of: u64, octave: u32, k: u32) -> u64 {
    let mut z = of ^ ((octave as u64) << 56) ^ ((k as u64) << 40);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number in 0 to 1 from an element.
const fn age_of(key: u64) -> f32 {
    (key >> 40) as f32 / (1_u64 << 24) as f32
}

impl Placement {
    const fn new(position: Vec2, diameter_m: f64, key: u64) -> Self {
        Self { position, diameter_m, age: age_of(key), key }
    }

    /// Largest height above the ground, metres.
    #[must_use]
    pub const fn max_height_m(&self) -> f32 {
        MAX_HEIGHT * self.diameter_m as f32
    }
}

/// Positions and sizes of all rocks, the largest octave or band first.
#[must_use]
pub fn placements(
    streams: &Streams,
    params: &Params,
    relief: &Relief,
    view: &View,
    centre: Vec2,
) -> (Vec<Placement>, u32) {
    let mut placements = draw_placements(streams, params, relief, view, centre);
    keep_largest(&mut placements, MAX_PLACEMENTS, |rock| {
        rock.diameter_m / f64::from(distance_m(view, centre, rock.position))
    });
    // No rocks beyond the border of the ground.
    placements.retain(|rock| f64::from(rock.position.distance(centre)) + rock.diameter_m <= view.radius_m);
    // Wheels go around rocks, but for those that they press into the soil.
    placements.retain(|rock| {
        let radius_m = 0.5 * rock.diameter_m as f32;
        let runs_over = |track: &Track| track.runs_over(rock.position - centre, radius_m);
        rock.diameter_m < PRESSED_M || !relief.tracks.iter().any(runs_over)
    });
    // None where the camera is. A rock that is moved away from it later leaves its fillet behind.
    let eye_m = params.number(Knob::CameraHeightM) as f32;
    let count = placements.len();
    placements.retain(|rock| {
        let beside_m = rock.position.distance(centre) - LONGEST_RADIUS * rock.diameter_m as f32;
        Vec2::new(beside_m, eye_m - rock.max_height_m()).max(Vec2::ZERO).length()
            > EYE_CLEARANCE_M + EYE_MARGIN_M
    });
    let left_out = (count - placements.len()) as u32;
    (placements, left_out)
}

fn draw_placements(
    streams: &Streams,
    params: &Params,
    relief: &Relief,
    view: &View,
    centre: Vec2,
) -> Vec<Placement> {
    if params.text(Knob::RocksLaw) == "bands" {
        return draw_bands(streams, params);
    }
    let coverage = params.number(Knob::RocksCoverage);
    if coverage <= 0.0 {
        return Vec::new();
    }
    let octaves: Vec<Sizes> = (0..OCTAVES)
        .map(|octave| {
            let high_m = LARGEST_M / f64::from(1_u32 << octave);
            Sizes::new(0.5 * high_m, high_m, coverage)
        })
        .collect();
    let min_angle = min_angle(view, &octaves);
    let culling = ViewCulling::new(params, view, centre, min_angle);
    let mut placements = Vec::new();
    for octave in 0..OCTAVES {
        let high_m = LARGEST_M / f64::from(1_u32 << octave);
        let purpose = format!("rocks.cell.{}", ["a", "b", "c", "d", "e", "f", "g"][octave as usize]);
        scatter(streams, (&purpose, octave), (high_m, coverage), &culling, |_, _| true, &mut placements);
    }
    if let Some(wall) = &relief.wall {
        let extra = (params.number(Knob::WallRocks) - 1.0) * coverage;
        wall_rocks(streams, wall, extra.min(WALL_MAX_COVERAGE), &culling, &mut placements);
    }
    let farthest_m = (LARGEST_M / min_angle).min(view.radius_m) as f32;
    relief.craters.fresh_around(&Region::circle(Vec2::ZERO, farthest_m), CLUSTER_MIN_M, |pit| {
        cluster(streams, &pit, coverage, &culling, &mut placements);
    });
    debris(streams, &culling, &mut placements);
    placements
}

/// Adds the pieces that were crushed from larger rocks, around their feet: the more the fresher the rock.
fn debris(streams: &Streams, culling: &ViewCulling<'_>, placements: &mut Vec<Placement>) {
    let sources = placements.len();
    for source in 0..sources {
        let rock = placements[source];
        let largest_m = (DEBRIS_LARGEST * rock.diameter_m).min(DEBRIS_M[1]);
        // The largest piece decides whether any can be in view.
        if rock.diameter_m < DEBRIS_FROM_M || !culling.keeps(rock.position, largest_m) {
            continue;
        }
        let youth = f64::from(1.0 - rock.age);
        let mut draw = streams.stream("rocks.debris", rock.key);
        for k in 0..poisson((DEBRIS_PIECES * rock.diameter_m * youth * youth).min(30.0), &mut draw) {
            // Inverse transform sampling of D^-2 between the bounds.
            let ratio = DEBRIS_M[0] / largest_m;
            let diameter_m = DEBRIS_M[0] / (1.0 - draw.unit() * (1.0 - ratio * ratio)).sqrt();
            // Most lie close to the rock.
            let distance = 1.05 + 0.35 * draw.exponential();
            let angle = draw.uniform(0.0, std::f64::consts::TAU);
            let direction = azimuth::direction(angle);
            let position = rock.position + (0.5 * rock.diameter_m * distance) as f32 * direction;
            if culling.keeps(position, diameter_m) {
                let key = rock_key(rock.key, 63, k);
                placements.push(Placement { age: DEBRIS_AGE, ..Placement::new(position, diameter_m, key) });
            }
        }
    }
}

/// Minimum angle that a rock spans as seen from the eye, radians: that of the view, or a larger one that [`MAX_ROCKS`] exceed.
fn min_angle(view: &View, octaves: &[Sizes]) -> f64 {
    let exceeding = |angle: f64| -> f64 {
        let area_m2 = |diameter_m: f64| {
            let within_m = (diameter_m / angle).min(view.radius_m);
            view.half_sector * within_m * within_m
        };
        let rocks = octaves.iter().flat_map(Sizes::bins);
        rocks.map(|(diameter_m, per_m2)| per_m2 * area_m2(diameter_m)).sum()
    };
    let (mut low, mut high) = (view.min_rock, 64.0 * view.min_rock);
    if exceeding(low) <= MAX_ROCKS {
        return low;
    }
    for _ in 0..24 {
        let middle = (low * high).sqrt();
        if exceeding(middle) > MAX_ROCKS { low = middle } else { high = middle }
    }
    high
}

/// The rocks of the bands, each from a random stream of its own; not culled.
fn draw_bands(streams: &Streams, params: &Params) -> Vec<Placement> {
    let of_band = |(band, (knob, purpose, radii_m, ahead_m)): (u32, (Knob, &'static str, [f64; 2], f64))| {
        (0..params.count(knob)).map(move |k| {
            let mut draw = streams.stream(purpose, k.into());
            let half_width_m = BANDS_HALF_WIDTH * ahead_m;
            let x = BANDS_FROM[0] + draw.uniform(-half_width_m, half_width_m);
            let y = BANDS_FROM[1] + draw.uniform(BANDS_NEAREST_M, ahead_m);
            let diameter_m = 2.0 * draw.uniform(radii_m[0], radii_m[1]);
            Placement::new(Vec2::new(x as f32, y as f32), diameter_m, rock_key(BANDS_KEY, band, k))
        })
    };
    (0..).zip(BANDS).flat_map(of_band).collect()
}

/// Adds the rocks of a crater's wall that the plain does not have, where they cover this fraction of it at most.
fn wall_rocks(
    streams: &Streams,
    wall: &CraterWall,
    coverage: f64,
    culling: &ViewCulling<'_>,
    placements: &mut Vec<Placement>,
) {
    if coverage <= 0.0 {
        return;
    }
    let centre = culling.centre;
    let mut rocks = Vec::new();
    for octave in 0..WALL_OCTAVES {
        let high_m = WALL_LARGEST_M / f64::from(1_u32 << octave);
        let purpose = format!("wall.rocks.{octave}");
        let is_near = |middle: Vec2, radius_m: f32| wall.reaches(middle - centre, radius_m);
        scatter(streams, (&purpose, 16 + octave), (high_m, coverage), culling, is_near, &mut rocks);
    }
    // Of the key, as the age is, but of bits of their own.
    rocks.retain(|rock| wall.rock_share(rock.position - centre) > age_of(rock.key.rotate_left(24)));
    let angle = |rock: &Placement| rock.diameter_m / f64::from(culling.distance_m(rock.position));
    keep_largest(&mut rocks, MAX_WALL_ROCKS, angle);
    placements.append(&mut rocks);
}

/// Distance of level ground at a point from the eye, which stands above `centre`, metres.
fn distance_m(view: &View, centre: Vec2, point: Vec2) -> f32 {
    (point.distance_squared(centre) + view.eye_height_m * view.eye_height_m).sqrt()
}

/// Keeps at most `max` rocks, those that span the largest angles.
fn keep_largest(rocks: &mut Vec<Placement>, max: usize, angle: impl Fn(&Placement) -> f64) {
    if rocks.len() > max {
        let mut angles: Vec<f64> = rocks.iter().map(&angle).collect();
        let (_, least, _) = angles.select_nth_unstable_by(max, |a, b| b.total_cmp(a));
        let least = *least;
        rocks.retain(|rock| angle(rock) > least);
    }
}

/// The rocks of an octave, up to `high_m` in diameter, that lie scattered at a coverage in the cells (their middle, and a radius around
/// them, metres) that are wanted.
fn scatter(
    streams: &Streams,
    (purpose, octave): (&str, u32),
    (high_m, coverage): (f64, f64),
    culling: &ViewCulling<'_>,
    is_wanted: impl Fn(Vec2, f32) -> bool,
    placements: &mut Vec<Placement>,
) {
    let (sizes, abundance) = (Sizes::new(0.5 * high_m, high_m, DENSEST_COVERAGE), Abundance::new(coverage));
    let reach_m = (high_m / culling.min_angle).min(culling.view.radius_m);
    let cell_m = CELL_DIAMETERS * high_m;
    let (densest, max_level) = (sizes.density() * cell_m * cell_m, abundance.largest_from(0.5 * high_m));
    let cell_of = |metres: f64| (metres / cell_m).floor() as i32;
    let (x, y) = (f64::from(culling.centre.x), f64::from(culling.centre.y));
    for row in cell_of(y - reach_m)..=cell_of(y + reach_m) {
        for column in cell_of(x - reach_m)..=cell_of(x + reach_m) {
            let corner = Vec2::new((f64::from(column) * cell_m) as f32, (f64::from(row) * cell_m) as f32);
            let middle = corner + 0.5 * cell_m as f32;
            let radius_m = 0.75 * cell_m as f32;
            let outside_m = culling.max_outside_m(high_m);
            if middle.distance(culling.centre) > reach_m as f32 + radius_m
                || !culling.reaches(middle, radius_m + outside_m)
                || !is_wanted(middle, radius_m)
            {
                continue;
            }
            let cell = u64::from(column as u32) << 32 | u64::from(row as u32);
            let mut draw = streams.stream(purpose, cell);
            // Rocks in the order of their levels, which are as far apart as the events of a Poisson process.
            let mut level = 0.0;
            for k in 0.. {
                level += draw.exponential() / densest;
                if level > max_level {
                    break;
                }
                let within = Vec2::new((draw.unit() * cell_m) as f32, (draw.unit() * cell_m) as f32);
                let (position, diameter_m) = (corner + within, sizes.draw(&mut draw));
                if level <= abundance.at(diameter_m) && culling.keeps(position, diameter_m) {
                    placements.push(Placement::new(position, diameter_m, rock_key(cell, octave, k)));
                }
            }
        }
    }
}

/// The ejected rocks around a fresh crater.
fn cluster(
    streams: &Streams,
    pit: &Pit,
    coverage: f64,
    culling: &ViewCulling<'_>,
    placements: &mut Vec<Placement>,
) {
    let centre = culling.centre + pit.offset;
    let radius_m = 0.5 * f64::from(pit.diameter_m);
    let largest_m = CLUSTER_LARGEST * f64::from(pit.diameter_m);
    let outside_m = culling.max_outside_m(largest_m);
    if !culling.reaches(centre, 3.0 * radius_m as f32 + outside_m) {
        return;
    }
    let nearest_m =
        f64::from((culling.distance_m(centre) - 3.0 * radius_m as f32).max(culling.view.eye_height_m));
    // Scales with the overall rock coverage.
    let abundance = Abundance::new(CLUSTER_COVERAGE * (coverage / 0.008).min(1.0));
    // Integral of (r / R)^-3 over the ring from 1 to 3 radii.
    let area_m2 = std::f64::consts::TAU * radius_m * radius_m * (1.0 - 1.0 / 3.0);
    for octave in 0..OCTAVES {
        let high_m = largest_m / f64::from(1_u32 << octave);
        if high_m < culling.min_angle * nearest_m || high_m < LARGEST_M / f64::from(1_u32 << OCTAVES) {
            break;
        }
        let mut draw = streams.stream("rocks.cluster", pit.key ^ (u64::from(octave) << 20));
        let densest = Sizes::density_between(0.5 * high_m, high_m, CLUSTER_COVERAGE) * area_m2;
        let max_level = abundance.largest_from(0.5 * high_m);
        let mut level = draw.exponential() / densest;
        if level > max_level {
            continue;
        }
        let sizes = Sizes::new(0.5 * high_m, high_m, CLUSTER_COVERAGE);
        for k in 0..MAX_CLUSTER_ROCKS {
            let distance_m = radius_m / (1.0 - draw.unit() * (2.0 / 3.0));
            let angle = draw.uniform(0.0, std::f64::consts::TAU);
            let offset = azimuth::direction(angle) * distance_m as f32;
            let (position, diameter_m) = (centre + offset, sizes.draw(&mut draw));
            if level <= abundance.at(diameter_m) && culling.keeps(position, diameter_m) {
                let key = rock_key(pit.key, octave + 32, k);
                let age = CLUSTER_AGE * age_of(key);
                placements.push(Placement { age, ..Placement::new(position, diameter_m, key) });
            }
            level += draw.exponential() / densest;
            if level > max_level {
                break;
            }
        }
    }
}
