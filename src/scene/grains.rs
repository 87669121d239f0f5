//! The grains of the soil: fragments of rock and clods from a millimetre to three centimetres across, half buried.
//!
//! Their numbers follow the Surveyors' counts: cumulative numbers with a power of -2.1 to -2.65 of the diameter (Shoemaker and Morris 1970,
//! "Physical characteristics of the lunar regolith determined from Surveyor television observations"). Two fifths of them are fragments of
//! rock, more where the law of the rocks asks for more below the smallest that has a mesh. Grains of one octave of diameters lie on a lattice, at most one per cell, as the craters
//! do ([`super::craters`]). Each is an ellipsoid whose centre lies in the ground, so that rays meet it in closed form: it
//! stands up in views along the ground, and throws a shadow. No mesh has them; they are labelled as regolith.
//! Must not know: who asks. GPU counterpart: `shaders/common/grains.wgsl`.

use glam::{Vec2, Vec3};

use super::craters::second_hash;
use super::lattice::Lattice;
use super::noise::lattice_hash;
use super::size_distribution::rocks_larger_than;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Largest diameter, metres: that of the smallest rocks that have meshes.
pub const LARGEST_M: f64 = 0.032;
/// Lattices, one per octave of diameters: down to a millimetre.
pub const LATTICES: u32 = 5;
/// Grains larger than a centimetre per square metre with a density of 1: as many as Surveyor III counted (91).
pub const LARGER_THAN_1_CM: f64 = 90.0;
/// Exponent of their cumulative numbers: between Surveyor I (2.11) and V (2.65).
pub const EXPONENT: f64 = 2.4;
/// Fraction of these that are fragments of rock: basalt and anorthosite among the coarse fines of Apollo 11 (1 to 5 mm; Wood et al. 1970);
/// breccias of soil, aggregates and glass are clods.
pub const ROCK_SHARE: f64 = 0.4;
/// Side of a cell in largest diameters of its lattice.
pub const CELL_DIAMETERS: f32 = 2.0;
/// Largest distance of a centre from the middle of its cell along an axis, cells.
pub const JITTER_CELLS: f32 = 0.1875;
/// Largest half axis in the plane, diameters: no grain reaches beyond its cell.
pub const MAX_RADIUS: f32 = 0.625;
/// Largest height above the ground, diameters.
pub const MAX_HEIGHT: f32 = 0.55;
/// Largest factor by which the longer axis in the plane exceeds the geometric mean of the two (Tsuchiyama et al. 2022:
/// intermediate over long axis 0.76 in the mean).
pub const MAX_STRETCH: f32 = 1.25;
/// Range of the exposed height of fragments, diameters, around that of rocks.
pub const FRAGMENT_HEIGHTS: [f32; 2] = [0.25, 0.5];
/// The same of clods, which fall apart where they stick out.
pub const CLOD_HEIGHTS: [f32; 2] = [0.1, 0.3];
/// Largest tilt: rise of the middle plane per metre along the long axis.
pub const MAX_TILT: f32 = 0.3;
/// Spread of a clod's albedo relative to that of a fragment of rock.
pub const CLOD_SPREAD: f32 = 0.2;
/// Steepest slope of a grain's surface: at its rim it is vertical.
pub const MAX_SLOPE: f32 = 6.0;
/// Planes that cut the ellipsoid, and the range of their distances from its centre, radii.
pub const FACETS: u32 = 4;
/// See [`FACETS`].
pub const FACET_DISTANCES: [f32; 2] = [0.6, 0.95];
/// What the second hash is combined with for the third.
pub const THIRD_KEY: u32 = 0x9e37_79b9;

/// The grains of one octave of diameters.
#[derive(Clone, Copy, Debug)]
pub struct GrainLattice {
    /// The cells.
    pub lattice: Lattice,
    /// Largest diameter, metres; the smallest is half of it.
    pub largest_m: f32,
    /// Probability that a cell has a grain.
    pub chance: f32,
    /// Fraction of fragments of rock; the others are clods of soil.
    pub fragments: f32,
}

/// All grains of a scene.
#[derive(Clone, Debug)]
pub struct GrainField {
    /// In order of decreasing size.
    pub lattices: Vec<GrainLattice>,
    /// What they are made of.
    pub material: GrainMaterial,
}

/// What grains are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrainMaterial {
    /// Median albedo of fragments, relative to the soil's.
    pub ratio: f32,
    /// Standard deviation of its logarithm; that of clods is [`CLOD_SPREAD`] times as large.
    pub spread: f32,
}

impl GrainMaterial {
    /// Mean albedo of grains with this fraction of fragments less that of the soil between them, relative to the latter.
    fn mean_excess(&self, fragments: f32) -> f32 {
        let mean = |median: f32, spread: f32| median * libm::expf(0.5 * spread * spread);
        let clods = (1.0 - fragments) * mean(1.0, CLOD_SPREAD * self.spread);
        fragments * mean(self.ratio, self.spread) + clods - 1.0
    }
}

impl GrainField {
    /// The grains of these parameters, for points around `centre` (metres, world).
    #[must_use]
    pub fn new(streams: &Streams, params: &Params, centre: Vec2) -> Self {
        let number = |knob| params.number(knob);
        let lattices = (0..LATTICES).map(|k| {
            let largest_m = LARGEST_M / f64::from(1_u32 << k);
            let cell_m = f64::from(CELL_DIAMETERS) * largest_m;
            let in_cell =
                |larger: &dyn Fn(f64) -> f64| (larger(0.5 * largest_m) - larger(largest_m)) * cell_m * cell_m;
            let counted = in_cell(&|diameter_m| LARGER_THAN_1_CM * libm::pow(diameter_m / 0.01, -EXPONENT));
            let counted = number(Knob::GrainsDensity) * counted;
            let of_rocks = in_cell(&|diameter_m| rocks_larger_than(diameter_m, number(Knob::RocksCoverage)));
            let of_rocks = if number(Knob::GrainsDensity) > 0.0 { of_rocks } else { 0.0 };
            let fragments = of_rocks.max(ROCK_SHARE * counted);
            let all = (1.0 - ROCK_SHARE) * counted + fragments;
            GrainLattice {
                lattice: Lattice::new(cell_m, centre, &mut streams.stream("grains.lattice", k.into())),
                largest_m: largest_m as f32,
                chance: all.min(1.0) as f32,
                fragments: if all > 0.0 { (fragments / all) as f32 } else { 0.0 },
            }
        });
        let material = GrainMaterial {
            ratio: number(Knob::RocksAlbedoRatio) as f32,
            spread: number(Knob::GrainsAlbedoSpread) as f32,
        };
        Self { lattices: lattices.collect(), material }
    }

    /// Height of the highest grain at a point (metres from the centre of the ground), metres; 0 between grains.
    #[must_use]
    pub fn height_at(&self, offset: Vec2) -> f32 {
        let of_lattice = |grains: &GrainLattice| {
            let (cell, at) = grains.lattice.cell(grains.lattice.local(offset));
            let grain = grains.grain(cell)?;
            let hit = grain.hit((Vec2::from(at) - grain.centre) * grains.lattice.cell_m, Vec2::ZERO)?;
            Some(hit.height_m)
        };
        self.lattices.iter().filter_map(of_lattice).fold(0.0, f32::max)
    }
}

impl GrainLattice {
    /// Fraction of the ground that its grains cover: the diameters of an octave of N ~ D^-2 have a mean square of 2/3 ln 2 times the
    /// largest one's.
    #[must_use]
    pub fn coverage(&self) -> f32 {
        let mean_square = 2.0 / 3.0 * std::f32::consts::LN_2;
        self.chance * 0.25 * std::f32::consts::PI * mean_square / (CELL_DIAMETERS * CELL_DIAMETERS)
    }

    /// By how much its grains make the ground brighter than the soil between them, relative to the latter.
    #[must_use]
    pub fn mean_excess(&self, material: &GrainMaterial) -> f32 {
        self.coverage() * material.mean_excess(self.fragments)
    }

    /// The grain of a cell, if it has one.
    #[must_use]
    pub fn grain(&self, [x, y]: [i32; 2]) -> Option<Grain> {
        let first = lattice_hash(x, y, 0, self.lattice.seed);
        let exists = fraction(first, 0xffff) < self.chance;
        exists.then(|| Grain::from_hashes([first, second_hash(first)], self.largest_m, self.fragments))
    }
}

/// A grain: an ellipsoid about a point of the ground. Lengths are metres along the axes of its lattice and above the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grain {
    /// Centre, cells from the corner of its cell.
    pub centre: Vec2,
    /// Geometric mean of its axes in the plane, metres.
    pub diameter_m: f32,
    /// Direction of its long axis.
    pub axis: Vec2,
    /// Inverse half axes: long, short, vertical, 1/m.
    pub per_axis: Vec3,
    /// Rise of its middle plane per metre along the long axis.
    pub tilt: f32,
    /// Whether it is a fragment of rock, else a clod.
    pub is_fragment: bool,
    /// Its albedo, standard deviations from the median.
    pub brightness: f32,
    /// Hash from which its facets are drawn.
    facet_hash: u32,
}

/// Where a ray leaves a grain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrainHit {
    /// Height above the ground, metres.
    pub height_m: f32,
    /// Slope of its surface, rise per metre along the axes of its lattice.
    pub slope: Vec2,
}

impl Grain {
    /// The grain of a cell that has one, by the first two hashes of the cell; a fraction are fragments of rock.
    #[must_use]
    #[inline(always)]
    pub fn from_hashes([first, second]: [u32; 2], largest_m: f32, fragments: f32) -> Self {
        let third = second_hash(second ^ THIRD_KEY);
        let fourth = second_hash(third);
        let jitter = |bits: u32| (2.0 * fraction(bits, 0x3ff) - 1.0) * JITTER_CELLS + 0.5;
        let diameter_m = grain_diameter(second, largest_m);
        // On a square that stands on its corner: nearly uniform in angle.
        let across = 2.0 * fraction(third, 0xff) - 1.0;
        let stretch = 1.0 + (MAX_STRETCH - 1.0) * fraction(third >> 8, 0xff);
        let is_fragment = fraction(first >> 16, 0xffff) < fragments;
        let [low, high] = if is_fragment { FRAGMENT_HEIGHTS } else { CLOD_HEIGHTS };
        let height = low + (high - low) * fraction(third >> 16, 0xff);
        let per_radius = 2.0 / diameter_m;
        // The sum of four uniform numbers has a deviation of 1 / sqrt(3).
        let sum: f32 = [0, 8, 16, 24].into_iter().map(|shift| fraction(fourth >> shift, 0xff)).sum();
        Self {
            centre: Vec2::new(jitter(second), jitter(second >> 10)),
            diameter_m,
            axis: Vec2::new(across, 1.0 - across.abs()).normalize(),
            per_axis: Vec3::new(per_radius / stretch, per_radius * stretch, 1.0 / (height * diameter_m)),
            tilt: MAX_TILT * (2.0 * fraction(third >> 24, 0xff) - 1.0),
            is_fragment,
            brightness: (sum - 2.0) * 1.732_050_8,
            facet_hash: fourth,
        }
    }

    /// From the ground's axes to those in which the grain is a unit sphere: a point, metres from its centre, and a direction that rises
    /// by a metre, given by its horizontal part.
    #[inline(always)]
    fn as_sphere(&self, point: Vec2, per_height: Vec2) -> (Vec3, Vec3) {
        let turned = |v: Vec2| Vec2::new(self.axis.dot(v), self.axis.perp_dot(v));
        let (p, d) = (turned(point), turned(per_height));
        let origin = Vec3::new(p.x, p.y, -self.tilt * p.x) * self.per_axis;
        (origin, Vec3::new(d.x, d.y, 1.0 - self.tilt * d.x) * self.per_axis)
    }

    /// Where a ray from the ground at `point` (metres from the centre of the grain) leaves it; `per_height` is its horizontal way per metre
    /// that it rises. Seen along the ray from above, that is the visible surface.
    #[must_use]
    #[inline(always)]
    pub fn hit(&self, point: Vec2, per_height: Vec2) -> Option<GrainHit> {
        let (origin, way) = self.as_sphere(point, per_height);
        let (a, b, c) = (way.dot(way), origin.dot(way), origin.dot(origin) - 1.0);
        let discriminant = b * b - a * c;
        if discriminant <= 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        let (mut from_m, mut to_m) = ((-root - b) / a, (root - b) / a);
        // Where the ray leaves the ellipsoid; within a facet, the facet's normal instead.
        let mut facet = None;
        let mut hash = self.facet_hash;
        for _ in 0..FACETS {
            hash = second_hash(hash ^ THIRD_KEY);
            let (normal, distance) = facet_of(hash);
            let (rise, left) = (normal.dot(way), distance - normal.dot(origin));
            let at_m = left / if rise.abs() > 1e-6 { rise } else { 1e-6 };
            if rise < 0.0 {
                from_m = from_m.max(at_m);
            } else if at_m < to_m {
                (to_m, facet) = (at_m, Some(normal));
            }
        }
        if to_m <= from_m {
            return None;
        }
        let height_m = to_m;
        let normal = facet.unwrap_or(origin + height_m * way) * self.per_axis;
        // In the axes of the grain: the gradient of the ellipsoid's function, its vertical part first bounded from below.
        let along = Vec2::new(normal.x - normal.z * self.tilt, normal.y);
        let up = normal.z.max(along.length() / MAX_SLOPE);
        let slope = -along / up;
        let slope = Vec2::new(
            self.axis.x * slope.x - self.axis.y * slope.y,
            self.axis.y * slope.x + self.axis.x * slope.y,
        );
        (height_m > 0.0).then_some(GrainHit { height_m, slope })
    }

    /// Fraction of the sun's disc that the grain occludes at a point of the ground (metres from its centre); `per_height` is the horizontal
    /// way of a ray to the sun per metre that it rises, `per_way` half the width of the penumbra per metre of that way, and `blur_m`
    /// is added to it.
    #[must_use]
    #[inline(always)]
    pub fn occlusion(&self, point: Vec2, per_height: Vec2, per_way: f32, blur_m: f32) -> f32 {
        let (origin, way) = self.as_sphere(point, per_height);
        let (a, b) = (way.dot(way), origin.dot(way));
        // Where the ray comes closest to the centre: its height, and its distance in radii.
        let height_m = -b / a;
        let distance = (origin.dot(origin) + b * height_m).max(0.0).sqrt();
        let half_m = per_way * height_m * (1.0 + per_height.length()) + blur_m;
        let inside_m = (1.0 - distance) * 0.4 * self.diameter_m;
        if height_m > 0.0 { (0.5 + 0.5 * inside_m / half_m).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Its albedo relative to that of the soil.
    #[must_use]
    #[inline(always)]
    pub fn albedo(&self, material: &GrainMaterial) -> f32 {
        let (ratio, spread) = if self.is_fragment {
            (material.ratio, material.spread)
        } else {
            (1.0, CLOD_SPREAD * material.spread)
        };
        ratio * libm::expf(spread * self.brightness)
    }
}

/// The plane of a facet, where the grain is a unit sphere: its unit normal, upwards or level, and its distance from the centre.
#[inline(always)]
fn facet_of(hash: u32) -> (Vec3, f32) {
    let across = |bits: u32| 2.0 * fraction(bits, 0xff) - 1.0;
    // Off zero by a little, so that it has a direction.
    let normal = Vec3::new(across(hash), across(hash >> 8), fraction(hash >> 16, 0xff) + 0.01);
    let [near, far] = FACET_DISTANCES;
    (normal.normalize(), near + (far - near) * fraction(hash >> 24, 0xff))
}

/// Some low bits of a hash as a number in [0, 1); `mask` is one less than a power of two.
#[inline(always)]
fn fraction(bits: u32, mask: u32) -> f32 {
    (bits & mask) as i32 as f32 / (mask + 1) as i32 as f32
}

/// Diameter, metres, of the grain with this second hash: inverse transform sampling of D^-2 within the octave.
#[inline(always)]
#[must_use]
pub fn grain_diameter(second: u32, largest_m: f32) -> f32 {
    0.5 * largest_m / (1.0 - 0.75 / 4096.0 * (second >> 20) as i32 as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;

    fn field(set: &[&str]) -> GrainField {
        let mut config = Config::new();
        config.set_stage("surface").expect("a stage");
        for assignment in set {
            config.apply_set(assignment).expect("a knob");
        }
        GrainField::new(&Streams::new(5), &config.draw(5).expect("drawn"), Vec2::ZERO)
    }

    /// Some grains of a lattice.
    fn grains(lattice: &GrainLattice) -> impl Iterator<Item = Grain> {
        (0..900).filter_map(|k| lattice.grain([k % 30, k / 30]))
    }

    #[test]
    fn a_hit_lies_on_its_ellipsoid_with_the_slope_of_the_height_there() {
        let field = field(&[]);
        let (mut hits, mut off) = (0, 0);
        for grain in grains(&field.lattices[0]) {
            let r = 0.5 * grain.diameter_m;
            for k in 0..16_u8 {
                let [u, v] = [k % 4, k / 4].map(|i| 0.5 * f32::from(i) - 0.75);
                let (point, per_height) = (r * Vec2::new(u, v), Vec2::new(3.0 * v, 2.0 - u));
                let Some(hit) = grain.hit(point, per_height) else { continue };
                let (origin, way) = grain.as_sphere(point, per_height);
                // On the ellipsoid, or on a facet inside it.
                let radius = (origin + hit.height_m * way).length();
                assert!((0.59..1.001).contains(&radius), "{radius}: {grain:?}");
                assert!(hit.height_m <= MAX_HEIGHT * grain.diameter_m, "{hit:?} of {grain:?}");
                // Straight above that point, if it is no overhang, the surface has the same height and slope, but at the edges
                // of facets.
                let above = point + hit.height_m * per_height;
                let height = |offset: Vec2| grain.hit(above + offset, Vec2::ZERO).map(|hit| hit.height_m);
                let step = 0.003 * grain.diameter_m;
                let around = [Vec2::X, -Vec2::X, Vec2::Y, -Vec2::Y].map(|way| height(step * way));
                let (Some(top), [Some(a), Some(b), Some(c), Some(d)]) = (height(Vec2::ZERO), around) else {
                    continue;
                };
                if (top - hit.height_m).abs() > 1e-3 * grain.diameter_m || hit.slope.length() > 2.0 {
                    continue;
                }
                hits += 1;
                let found = Vec2::new(a - b, c - d) / (2.0 * step);
                off += u32::from(found.distance(hit.slope) > 0.05);
            }
        }
        assert!(hits > 100 && 10 * off < hits, "{off} of {hits} hits have another slope");
    }

    #[test]
    fn no_grain_reaches_beyond_its_cell() {
        let field = field(&["grains.density=2.5", "rocks.coverage=0.1"]);
        for lattice in &field.lattices {
            for grain in grains(lattice) {
                for k in 0..40_u8 {
                    let t = f32::from(k) / 40.0;
                    for edge in [Vec2::new(t, 0.0), Vec2::new(t, 1.0), Vec2::new(0.0, t), Vec2::new(1.0, t)] {
                        let point = (edge - grain.centre) * lattice.lattice.cell_m;
                        assert_eq!(grain.hit(point, Vec2::ZERO), None, "{grain:?}");
                    }
                }
            }
        }
    }

    /// The shadow of an ellipsoid with a half axis a towards the sun and a height h ends sqrt(a^2 + (h / tan(elevation))^2) from its centre.
    #[test]
    fn shadows_are_as_long_as_the_height_over_the_tangent_of_the_elevation() {
        let lattice = &field(&[]).lattices[0];
        for grain in grains(lattice).take(40) {
            let grain = Grain { tilt: 0.0, ..grain };
            for elevation_deg in [8.0_f32, 20.0, 45.0] {
                let way = 1.0 / libm::tanf(elevation_deg.to_radians());
                let at = |distance: f32| grain.occlusion(-distance * grain.axis, way * grain.axis, 0.0, 1e-6);
                let (mut inside, mut outside) = (0.5 * grain.diameter_m, 12.0 * grain.diameter_m);
                for _ in 0..40 {
                    let middle = 0.5 * (inside + outside);
                    *(if at(middle) > 0.5 { &mut inside } else { &mut outside }) = middle;
                }
                let half = Vec3::ONE / grain.per_axis;
                let expected = libm::hypotf(half.x, way * half.z);
                assert!((inside / expected - 1.0).abs() < 1e-3, "{inside} m, not {expected} m");
                assert_eq!(at(-expected), 0.0, "a shadow towards the sun");
                // The penumbra's edges move apart by the way times the angle of the disc.
                let half_width = 0.004_65;
                let penumbra = grain.occlusion(-expected * grain.axis, way * grain.axis, half_width, 1e-6);
                assert!((penumbra - 0.5).abs() < 0.01, "half shadow at the edge, not {penumbra}");
            }
        }
    }

    #[test]
    fn numbers_follow_the_stated_laws() {
        let counted = |set: &[&str]| {
            let field = field(set);
            let mut numbers = [0.0_f64; 2];
            for lattice in &field.lattices[..2] {
                let side = 300;
                let area =
                    f64::from(side * side) * f64::from(lattice.lattice.cell_m * lattice.lattice.cell_m);
                for k in 0..side * side {
                    let grain = lattice.grain([k % side, k / side]).filter(|grain| grain.diameter_m > 0.01);
                    if let Some(grain) = grain {
                        numbers[usize::from(grain.is_fragment)] += 1.0 / area;
                    }
                }
            }
            numbers
        };
        let [clods, fragments] = counted(&["rocks.coverage=0.1"]);
        let larger = |diameter_m: f64| LARGER_THAN_1_CM * libm::pow(diameter_m / 0.01, -EXPONENT);
        let expected = (1.0 - ROCK_SHARE) * (larger(0.01) - larger(LARGEST_M));
        // Within an octave the numbers fall with D^-2 instead.
        assert!((clods / expected - 1.0).abs() < 0.15, "{clods} clods, not {expected}");
        let expected = rocks_larger_than(0.01, 0.1) - rocks_larger_than(LARGEST_M, 0.1);
        assert!((fragments / expected - 1.0).abs() < 0.15, "{fragments} fragments, not {expected}");
        // Where there are few rocks, two fifths of the grains are fragments all the same.
        let [clods, fragments] = counted(&["rocks.coverage=0.002"]);
        let share = fragments / (clods + fragments);
        assert!((share - ROCK_SHARE).abs() < 0.02, "a fraction of {share} are fragments");
        assert_eq!(counted(&["grains.density=0"]), [0.0; 2]);
    }

    #[test]
    fn grains_leave_the_mean_albedo_as_it_is() {
        let field = field(&["rocks.coverage=0.08", "grains.albedo_spread=0.7"]);
        for lattice in &field.lattices {
            let (mut covered, mut albedo, mut points) = (0.0_f64, 0.0_f64, 0.0_f64);
            for grain in (0..90_000).filter_map(|k| lattice.grain([k % 300, k / 300])) {
                let across = grain.diameter_m / lattice.lattice.cell_m;
                let area = 0.25 * std::f32::consts::PI * across * across;
                covered += f64::from(area);
                albedo += f64::from(area * grain.albedo(&field.material));
            }
            points += 90_000.0;
            let (covered, albedo) = (covered / points, albedo / points);
            let coverage = f64::from(lattice.coverage());
            assert!((covered / coverage - 1.0).abs() < 0.03, "{covered} covered, not {coverage}");
            let soil = 1.0 / (1.0 + f64::from(lattice.mean_excess(&field.material)));
            let mean = (1.0 - covered) * soil + albedo;
            assert!((mean - 1.0).abs() < 3e-3, "mean albedo {mean}");
        }
    }
}
