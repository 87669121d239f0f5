//! Rocks that lie scattered over the ground, by the lunar size-frequency distribution: a Poisson process in square cells, each with a
//! random stream of its own, thinned to the coverage. Only rocks that can be in view, or cast a shadow into view, are made.
//! Must not know: where the rocks of the stage lie, how a rock is shaped.

use glam::Vec2;

use crate::params::{Knob, Params};
use crate::random::Streams;
use crate::scene::azimuth;
use crate::scene::rings::View;
use crate::scene::size_distribution::{Abundance, DENSEST_COVERAGE, Sizes};

/// Smallest diameter, metres: what is smaller is part of the soil.
pub(super) const SMALLEST_M: f64 = 0.03125;
/// Width of the cells of an octave, in its largest diameter.
const CELL_DIAMETERS: f64 = 24.0;
/// Rocks outside the viewed sector are made within this many of their diameters of it, at most [`OUTSIDE_MAX_M`] metres, and further away if
/// their shadows, which a low sun makes longer, come as near.
const OUTSIDE_DIAMETERS: f32 = 20.0;
/// See [`OUTSIDE_DIAMETERS`].
const OUTSIDE_MAX_M: f32 = 40.0;
/// Largest height above the ground, diameters: higher, rounded rocks look like eggs that stand on end.
const MAX_HEIGHT: f32 = 0.75;

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

impl Placement {
    pub(super) const fn new(position: Vec2, diameter_m: f64, key: u64) -> Self {
        Self { position, diameter_m, age: age_of(key), key }
    }

    /// Largest height above the ground, metres.
    #[must_use]
    pub const fn max_height_m(&self) -> f32 {
        MAX_HEIGHT * self.diameter_m as f32
    }
}

/// The element of the `k`-th rock of a cell or crater (Steele, Lea and Flood 2014: the finaliser of SplitMix64).
pub(super) const fn rock_key(of: u64, octave: u32, k: u32) -> u64 {
    let mut z = of ^ ((octave as u64) << 56) ^ ((k as u64) << 40);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number in 0 to 1 from an element.
pub(super) const fn age_of(key: u64) -> f32 {
    (key >> 40) as f32 / (1_u64 << 24) as f32
}

/// Culling by angular size and viewed sector.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewCulling<'a> {
    pub(super) view: &'a View,
    pub(super) centre: Vec2,
    ahead: Vec2,
    pub(super) min_angle: f64,
    /// From a rock to the end of its shadow on level ground, diameters.
    shadow: Vec2,
}

/// Distance from the viewed sector within which all rocks of a diameter are made, metres.
fn outside_m(diameter_m: f64) -> f32 {
    (OUTSIDE_DIAMETERS * diameter_m as f32).min(OUTSIDE_MAX_M)
}

impl<'a> ViewCulling<'a> {
    pub(super) fn new(params: &Params, view: &'a View, centre: Vec2, min_angle: f64) -> Self {
        let [elevation, azimuth] =
            [Knob::SunElevationDeg, Knob::SunAzimuthDeg].map(|knob| params.number(knob).to_radians());
        let cotangent = libm::cos(elevation) / libm::sin(elevation);
        let shadow = -(f64::from(MAX_HEIGHT) * cotangent) as f32 * azimuth::direction(azimuth);
        Self { view, centre, ahead: azimuth::direction(view.azimuth), min_angle, shadow }
    }

    /// Distance from the viewed sector within which any rock of up to a diameter is made, metres.
    pub(super) fn max_outside_m(&self, diameter_m: f64) -> f32 {
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
    pub(super) fn distance_m(&self, point: Vec2) -> f32 {
        distance_m(self.view, self.centre, point)
    }

    /// Whether a circle overlaps the viewed sector.
    pub(super) fn reaches(&self, point: Vec2, radius_m: f32) -> bool {
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
    pub(super) fn keeps(&self, position: Vec2, diameter_m: f64) -> bool {
        diameter_m >= self.min_angle * f64::from(self.distance_m(position))
            && (self.reaches(position, outside_m(diameter_m)) || self.shadow_reaches(position, diameter_m))
    }
}

/// Distance of level ground at a point from the eye, which stands above `centre`, metres.
pub(super) fn distance_m(view: &View, centre: Vec2, point: Vec2) -> f32 {
    (point.distance_squared(centre) + view.eye_height_m * view.eye_height_m).sqrt()
}

/// Rocks of which the largest is at most twice as large as the smallest.
pub(super) struct Octave<'a> {
    /// The purpose of its random streams.
    purpose: &'a str,
    /// Its number in the keys of its rocks.
    number: u32,
    /// Diameters, metres.
    low_m: f64,
    high_m: f64,
}

impl<'a> Octave<'a> {
    pub(super) const fn new(purpose: &'a str, number: u32, high_m: f64) -> Self {
        Self { purpose, number, low_m: (0.5 * high_m).max(SMALLEST_M), high_m }
    }
}

/// Ground on which rocks lie scattered.
pub(super) struct Patch<'a> {
    /// A circle around it, metres, world.
    pub(super) middle: Vec2,
    pub(super) radius_m: f32,
    /// The fraction of it that they cover at most.
    pub(super) coverage: f64,
    /// Its largest share in a circle: its middle and radius, metres, world.
    pub(super) max_share: &'a dyn Fn(Vec2, f32) -> f64,
    /// Their number at a point, as a fraction of that by the coverage.
    pub(super) share: &'a dyn Fn(Vec2) -> f64,
    /// Distinguishes it from others of the same purpose.
    pub(super) key: u64,
}

impl Patch<'_> {
    /// All of the ground.
    pub(super) fn whole(coverage: f64) -> Self {
        let (max_share, share) = (&|_: Vec2, _: f32| 1.0, &|_: Vec2| 1.0);
        Self { middle: Vec2::ZERO, radius_m: f32::INFINITY, coverage, max_share, share, key: 0 }
    }
}

/// Adds the rocks of an octave on a patch.
pub(super) fn scatter(
    streams: &Streams,
    octave: &Octave<'_>,
    patch: &Patch<'_>,
    culling: &ViewCulling<'_>,
    placements: &mut Vec<Placement>,
) {
    let &Octave { low_m, high_m, .. } = octave;
    let (sizes, abundance) = (Sizes::new(low_m, high_m, DENSEST_COVERAGE), Abundance::new(patch.coverage));
    let reach_m = (high_m / culling.min_angle).min(culling.view.radius_m) as f32;
    let cell_m = CELL_DIAMETERS * high_m;
    let (densest, max_abundance) = (sizes.density() * cell_m * cell_m, abundance.largest_from(low_m));
    let (radius_m, outside_m) = (0.75 * cell_m as f32, culling.max_outside_m(high_m));
    // Those that overlap both the circle that rocks are seen in and that of the patch.
    let low = (culling.centre - reach_m).max(patch.middle - patch.radius_m);
    let high = (culling.centre + reach_m).min(patch.middle + patch.radius_m);
    let cell_of = |metres: f32| (f64::from(metres) / cell_m).floor() as i32;
    for row in cell_of(low.y)..=cell_of(high.y) {
        for column in cell_of(low.x)..=cell_of(high.x) {
            let corner = Vec2::new((f64::from(column) * cell_m) as f32, (f64::from(row) * cell_m) as f32);
            let middle = corner + 0.5 * cell_m as f32;
            if middle.distance(culling.centre) > reach_m + radius_m
                || !culling.reaches(middle, radius_m + outside_m)
            {
                continue;
            }
            let max_level = max_abundance * (patch.max_share)(middle, radius_m);
            if max_level <= 0.0 {
                continue;
            }
            let cell = patch.key ^ (u64::from(column as u32) << 32 | u64::from(row as u32));
            let mut draw = streams.stream(octave.purpose, cell);
            // Rocks in the order of their levels, which are as far apart as the events of a Poisson process.
            let mut level = draw.exponential() / densest;
            for k in 0.. {
                if level >= max_level {
                    break;
                }
                let within = Vec2::new((draw.unit() * cell_m) as f32, (draw.unit() * cell_m) as f32);
                let (position, diameter_m) = (corner + within, sizes.draw(&mut draw));
                if level <= abundance.at(diameter_m) * (patch.share)(position)
                    && culling.keeps(position, diameter_m)
                {
                    let key = rock_key(cell, octave.number, k);
                    placements.push(Placement::new(position, diameter_m, key));
                }
                level += draw.exponential() / densest;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::size_distribution::rocks_larger_than;

    /// Rocks whose density falls with the cube of the distance from the rim of a crater, as those around a fresh one do.
    #[test]
    fn a_patch_has_as_many_rocks_as_the_law_and_its_share_say() {
        const RIM_M: f32 = 6.0;
        let view = View {
            eye_height_m: 2.0,
            azimuth: 0.0,
            half_sector: std::f64::consts::PI,
            cell: 0.01,
            min_rock: 1e-4,
            radius_m: 100.0,
        };
        let params = Params::draw_default(1);
        let culling = ViewCulling::new(&params, &view, Vec2::ZERO, view.min_rock);
        let middle = Vec2::new(20.0, -10.0);
        let share = |point: Vec2| {
            let radii = f64::from(point.distance(middle) / RIM_M);
            if (1.0..=3.0).contains(&radii) { 1.0 / (radii * radii * radii) } else { 0.0 }
        };
        let max_share = |point: Vec2, within_m: f32| {
            let radii = f64::from((point.distance(middle) - within_m).max(RIM_M) / RIM_M);
            if radii > 3.0 { 0.0 } else { 1.0 / (radii * radii * radii) }
        };
        // Integral of the share over the ground.
        let area_m2 = std::f64::consts::TAU * f64::from(RIM_M * RIM_M) * (1.0 - 1.0 / 3.0);
        let mut before = Vec::new();
        for coverage in [0.01, 0.1] {
            let patch = Patch {
                middle,
                radius_m: 3.0 * RIM_M,
                coverage,
                max_share: &max_share,
                share: &share,
                key: 0x5eed << 40,
            };
            let mut rocks = Vec::new();
            for seed in 0..20 {
                scatter(
                    &Streams::new(seed),
                    &Octave::new("rocks.cell.a", 0, 0.05),
                    &patch,
                    &culling,
                    &mut rocks,
                );
            }
            assert!(rocks.iter().all(|rock| (SMALLEST_M..=0.05).contains(&rock.diameter_m)));
            let per_m2 = rocks_larger_than(SMALLEST_M, coverage) - rocks_larger_than(0.05, coverage);
            let inner =
                rocks.iter().filter(|rock| rock.position.distance(middle) < 1.5 * RIM_M).count() as f64;
            let (count, expected) = (rocks.len() as f64, 20.0 * per_m2 * area_m2);
            assert!((count - expected).abs() < 4.0 * expected.sqrt(), "{count} rocks, {expected} expected");
            // Within half a radius of the rim lies half of them: 1 - 1 / 1.5 of 1 - 1 / 3.
            assert!((inner - 0.5 * count).abs() < 4.0 * (0.25 * count).sqrt(), "{inner} of {count}");
            let keys: std::collections::BTreeSet<u64> = rocks.iter().map(|rock| rock.key).collect();
            assert!(before.iter().all(|key| keys.contains(key)), "rocks of a lower coverage are there too");
            before = keys.into_iter().collect();
        }
    }
}
