//! Where the rocks of the surface stage lie: the lunar size-frequency distribution, scattered everywhere and clustered at fresh
//! craters, or four size bands with fixed counts; debris.
//!
//! The positions are a function of the seed and of world coordinates, for each octave of diameters: the same rocks are there
//! from every camera.
//! Must not know: how a rock is shaped, how many of its triangles are drawn.

use glam::Vec2;

use super::rock::EYE_CLEARANCE_M;
pub use super::scatter::Placement;
use super::scatter::{Octave, Patch, SMALLEST_M, ViewCulling, age_of, distance_m, rock_key, scatter};
use crate::params::{Knob, Params};
use crate::random::Streams;
use crate::scene::azimuth;
use crate::scene::crater_wall::CraterWall;
use crate::scene::craters::{self, Pit, Region};
use crate::scene::relief::Relief;
use crate::scene::rings::View;
pub use crate::scene::size_distribution::rocks_larger_than;
use crate::scene::size_distribution::{DENSEST_COVERAGE, Sizes, poisson};
use crate::scene::track::Track;

/// Largest diameter, metres.
const LARGEST_M: f64 = 4.0;
/// Octaves of diameters: from 4 m to [`SMALLEST_M`].
const OCTAVES: u32 = 7;
/// Smallest fraction of the ground that rocks cover; there are none below it.
const MIN_COVERAGE: f64 = 1e-9;
/// Approximate limit on the number of rocks: the smallest of them are left out where there would be more.
const MAX_ROCKS: f64 = 15_000.0;
/// Maximum number of all rocks, with those around fresh craters, on walls and of debris; of more, those that span the smallest angles are
/// left out. Instance ids have 16 bits.
const MAX_PLACEMENTS: usize = 60_000;
/// Minimum diameter of a fresh crater with rocks around it, metres.
const CLUSTER_MIN_M: f32 = 2.0;
/// Fraction of the ground that these rocks cover at the rim; it falls with the cube of the distance, to 3 radii.
const CLUSTER_COVERAGE: f64 = DENSEST_COVERAGE;
/// The largest of them, in diameters of the crater.
const CLUSTER_LARGEST: f64 = 0.06;
/// Radius up to which they lie, in radii of the crater.
const CLUSTER_RADII: f32 = 3.0;
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

/// Longest horizontal extent of a rock from its centre, mean diameters.
const LONGEST_RADIUS: f32 = 0.7;
/// How much further from the eye than [`EYE_CLEARANCE_M`] rocks are on level ground, metres: other ground may rise.
const EYE_MARGIN_M: f32 = 0.1;

/// Positions and sizes of all rocks, the largest octave or band first.
#[must_use]
pub fn placements(
    streams: &Streams,
    params: &Params,
    relief: &Relief,
    view: &View,
    centre: Vec2,
) -> (Vec<Placement>, u32) {
    let site = Site { relief, view, centre, eye_m: params.number(Knob::CameraHeightM) as f32 };
    let (mut placements, culling) = draw_placements(streams, params, relief, view, centre);
    let mut left_out = site.clear(&mut placements);
    if let Some(culling) = culling {
        let mut pieces = debris(streams, &culling, &placements);
        left_out += site.clear(&mut pieces);
        placements.append(&mut pieces);
    }
    keep_largest(&mut placements, MAX_PLACEMENTS, |rock| {
        rock.diameter_m / f64::from(distance_m(view, centre, rock.position))
    });
    (placements, left_out)
}

/// Where rocks may lie.
struct Site<'a> {
    relief: &'a Relief,
    view: &'a View,
    /// Of the ground, metres, world.
    centre: Vec2,
    /// Height of the eye above it, metres.
    eye_m: f32,
}

impl Site<'_> {
    /// Removes the rocks that may not lie where they do; returns how many of them are where the camera is.
    fn clear(&self, rocks: &mut Vec<Placement>) -> u32 {
        rocks.retain(|rock| self.holds(rock));
        let count = rocks.len();
        rocks.retain(|rock| self.is_apart_from_eye(rock));
        (count - rocks.len()) as u32
    }

    /// No rocks lie beyond the border of the ground. Wheels go around rocks, but for those that they press into the soil.
    fn holds(&self, rock: &Placement) -> bool {
        let radius_m = 0.5 * rock.diameter_m as f32;
        let runs_over = |track: &Track| track.runs_over(rock.position - self.centre, radius_m);
        f64::from(rock.position.distance(self.centre)) + rock.diameter_m <= self.view.radius_m
            && (rock.diameter_m < PRESSED_M || !self.relief.tracks.iter().any(runs_over))
    }

    /// None lie where the camera is. A rock that is moved away from it later leaves its fillet behind.
    fn is_apart_from_eye(&self, rock: &Placement) -> bool {
        let beside_m = rock.position.distance(self.centre) - LONGEST_RADIUS * rock.diameter_m as f32;
        Vec2::new(beside_m, self.eye_m - rock.max_height_m()).max(Vec2::ZERO).length()
            > EYE_CLEARANCE_M + EYE_MARGIN_M
    }
}

/// All rocks but for debris, and the culling of what has debris.
fn draw_placements<'a>(
    streams: &Streams,
    params: &Params,
    relief: &Relief,
    view: &'a View,
    centre: Vec2,
) -> (Vec<Placement>, Option<ViewCulling<'a>>) {
    if params.text(Knob::RocksLaw) == "bands" {
        return (draw_bands(streams, params), None);
    }
    let coverage = params.number(Knob::RocksCoverage);
    if coverage < MIN_COVERAGE {
        return (Vec::new(), None);
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
        let (octave, plain) = (Octave::new(&purpose, octave, high_m), Patch::whole(coverage));
        scatter(streams, &octave, &plain, &culling, &mut placements);
    }
    if let Some(wall) = &relief.wall {
        let extra = (params.number(Knob::WallRocks) - 1.0) * coverage;
        wall_rocks(streams, wall, extra.min(WALL_MAX_COVERAGE), &culling, &mut placements);
    }
    let farthest_m = (LARGEST_M / min_angle).min(view.radius_m) as f32;
    // Rocks lie further from a crater than it changes the ground.
    let beyond_m = 0.5 * craters::LARGEST_M as f32 * (CLUSTER_RADII - craters::REACH_RADII);
    let region = Region::circle(Vec2::ZERO, farthest_m + beyond_m);
    relief.craters.fresh_around(&region, CLUSTER_MIN_M, |pit| {
        cluster(streams, &pit, coverage, &culling, &mut placements);
    });
    (placements, Some(culling))
}

/// The pieces that were crushed from larger rocks, around their feet: the more the fresher the rock.
fn debris(streams: &Streams, culling: &ViewCulling<'_>, rocks: &[Placement]) -> Vec<Placement> {
    let mut pieces = Vec::new();
    for rock in rocks {
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
                pieces.push(Placement { age: DEBRIS_AGE, ..Placement::new(position, diameter_m, key) });
            }
        }
    }
    pieces
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
    if coverage < MIN_COVERAGE {
        return;
    }
    let centre = culling.centre;
    let is_near = |middle: Vec2, radius_m: f32| f64::from(u8::from(wall.reaches(middle - centre, radius_m)));
    let patch = Patch { max_share: &is_near, ..Patch::whole(coverage) };
    let mut rocks = Vec::new();
    for octave in 0..WALL_OCTAVES {
        let high_m = WALL_LARGEST_M / f64::from(1_u32 << octave);
        let purpose = format!("wall.rocks.{octave}");
        scatter(streams, &Octave::new(&purpose, 16 + octave, high_m), &patch, culling, &mut rocks);
    }
    // Of the key, as the age is, but of bits of their own.
    rocks.retain(|rock| wall.rock_share(rock.position - centre) > age_of(rock.key.rotate_left(24)));
    let angle = |rock: &Placement| rock.diameter_m / f64::from(culling.distance_m(rock.position));
    keep_largest(&mut rocks, MAX_WALL_ROCKS, angle);
    placements.append(&mut rocks);
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

/// The ejected rocks around a fresh crater.
fn cluster(
    streams: &Streams,
    pit: &Pit,
    coverage: f64,
    culling: &ViewCulling<'_>,
    placements: &mut Vec<Placement>,
) {
    let middle = culling.centre + pit.offset;
    let rim_m = 0.5 * pit.diameter_m;
    let largest_m = CLUSTER_LARGEST * f64::from(pit.diameter_m);
    let radius_m = CLUSTER_RADII * rim_m;
    if !culling.reaches(middle, radius_m + culling.max_outside_m(largest_m)) {
        return;
    }
    let nearest_m = (culling.distance_m(middle) - radius_m).max(culling.view.eye_height_m);
    let share_at = |distance_m: f32| {
        let radii = f64::from(distance_m / rim_m);
        if radii > f64::from(CLUSTER_RADII) { 0.0 } else { 1.0 / (radii * radii * radii) }
    };
    let max_share = |point: Vec2, within_m: f32| share_at((point.distance(middle) - within_m).max(rim_m));
    let share = |point: Vec2| {
        let distance_m = point.distance(middle);
        if distance_m < rim_m { 0.0 } else { share_at(distance_m) }
    };
    // Scales with the overall rock coverage.
    let coverage = CLUSTER_COVERAGE * (coverage / 0.008).min(1.0);
    let patch = Patch { middle, radius_m, coverage, max_share: &max_share, share: &share, key: pit.key };
    for octave in 0..OCTAVES {
        let high_m = largest_m / f64::from(1_u32 << octave);
        if high_m < culling.min_angle * f64::from(nearest_m) || high_m <= SMALLEST_M {
            break;
        }
        let purpose = format!("rocks.cluster.{octave}");
        let before = placements.len();
        scatter(streams, &Octave::new(&purpose, 32 + octave, high_m), &patch, culling, placements);
        placements[before..].iter_mut().for_each(|rock| rock.age *= CLUSTER_AGE);
    }
}
