//! The grains of the soil: fragments of rock and clods from a millimetre to three centimetres across, half buried.
//!
//! Their numbers follow the Surveyors' counts of fragments: cumulative numbers with a power of -2.1 to -2.65 of the diameter
//! (Shoemaker and Morris 1970, "Physical characteristics of the lunar regolith determined from Surveyor television
//! observations", Surveyor I to VII). Grains of one octave of diameters lie on a lattice, at most one per cell, as the craters
//! do ([`super::craters`]). Each is an ellipsoid whose centre lies in the ground, so that rays meet it in closed form: it
//! stands up in views along the ground, and throws a shadow. No mesh has them; they are labelled as regolith.
//! Must not know: who asks. GPU counterpart: `shaders/common/grains.wgsl`.

use glam::{Vec2, Vec3};

use super::craters::second_hash;
use super::lattice::Lattice;
use super::noise::lattice_hash;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Largest diameter, metres: that of the smallest rocks that have meshes.
pub const LARGEST_M: f64 = 0.032;
/// Lattices, one per octave of diameters: down to a millimetre.
pub const LATTICES: u32 = 5;
/// Fragments and clods larger than a centimetre per square metre with a density of 1: between Surveyor I (39) and
/// Surveyor III (91), both on mare plains.
pub const LARGER_THAN_1_CM: f64 = 60.0;
/// Exponent of the cumulative numbers: between Surveyor I (2.11) and V (2.65).
pub const EXPONENT: f64 = 2.4;
/// Side of a cell in largest diameters of its lattice.
pub const CELL_DIAMETERS: f32 = 2.5;
/// Largest distance of a centre from the middle of its cell along an axis, cells.
pub const JITTER_CELLS: f32 = 0.25;
/// Largest half axis in the plane, diameters: no grain reaches beyond its cell.
pub const MAX_RADIUS: f32 = 0.625;
/// Largest height above the ground, diameters.
pub const MAX_HEIGHT: f32 = 0.55;
/// Largest factor by which the longer axis in the plane exceeds the geometric mean of the two (Tsuchiyama et al. 2022:
/// intermediate over long axis 0.76 in the mean).
pub const MAX_STRETCH: f32 = 1.25;
/// Range of the vertical half axis, diameters: exposed heights of 0.2 to 0.5 diameters.
pub const HEIGHTS: [f32; 2] = [0.2, 0.5];
/// Largest tilt: rise of the middle plane per metre along the long axis.
pub const MAX_TILT: f32 = 0.3;
/// Spread of a clod's albedo relative to that of a fragment of rock.
pub const CLOD_SPREAD: f32 = 0.3;
/// Steepest slope of a grain's surface: at its rim it is vertical.
pub const MAX_SLOPE: f32 = 6.0;
/// What the second hash is combined with for the third.
const THIRD_KEY: u32 = 0x9e37_79b9;

/// The grains of one octave of diameters.
#[derive(Clone, Copy, Debug)]
pub struct GrainLattice {
    /// The cells.
    pub lattice: Lattice,
    /// Largest diameter, metres; the smallest is half of it.
    pub largest_m: f32,
    /// Probability that a cell has a grain.
    pub chance: f32,
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
    /// Fraction that are fragments of rock; the others are clods of soil.
    pub fragments: f32,
    /// Median albedo of fragments, relative to the soil's.
    pub ratio: f32,
    /// Standard deviation of its logarithm.
    pub spread: f32,
}

impl GrainMaterial {
    /// Mean albedo of grains less that of the soil between them, relative to the latter.
    #[must_use]
    pub fn mean_excess(&self) -> f32 {
        let mean = |median: f32, spread: f32| median * libm::expf(0.5 * spread * spread);
        let clods = (1.0 - self.fragments) * mean(1.0, CLOD_SPREAD * self.spread);
        self.fragments * mean(self.ratio, self.spread) + clods - 1.0
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
            let larger = |diameter_m: f64| LARGER_THAN_1_CM * libm::pow(diameter_m / 0.01, -EXPONENT);
            let per_cell = (larger(0.5 * largest_m) - larger(largest_m)) * cell_m * cell_m;
            GrainLattice {
                lattice: Lattice::new(cell_m, centre, &mut streams.stream("grains.lattice", k.into())),
                largest_m: largest_m as f32,
                chance: (number(Knob::GrainsDensity) * per_cell).min(1.0) as f32,
            }
        });
        let material = GrainMaterial {
            fragments: number(Knob::GrainsFragments) as f32,
            ratio: number(Knob::RocksAlbedoRatio) as f32,
            spread: number(Knob::RocksAlbedoSpread) as f32,
        };
        Self { lattices: lattices.collect(), material }
    }

    /// Height of the highest grain at a point (metres from the centre of the ground), metres; 0 between grains.
    #[must_use]
    pub fn height_at(&self, offset: Vec2) -> f32 {
        let of_lattice = |grains: &GrainLattice| {
            let (cell, at) = grains.lattice.cell(grains.lattice.local(offset));
            let grain = Grain::of_cell(cell, &grains.lattice, grains.largest_m, grains.chance)?;
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
    /// Uniform in [0, 1): fragments of rock first, then clods.
    pub kind: f32,
    /// Its albedo, standard deviations from the median.
    pub brightness: f32,
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
    /// The grain of a cell, if it has one.
    #[must_use]
    pub fn of_cell([x, y]: [i32; 2], lattice: &Lattice, largest_m: f32, chance: f32) -> Option<Self> {
        let first = lattice_hash(x, y, 0, lattice.seed);
        let exists = fraction(first, 0xffff) < chance;
        exists.then(|| Self::from_hashes([first, second_hash(first)], largest_m))
    }

    /// The grain of a cell that has one, by the first two hashes of the cell.
    #[must_use]
    #[inline(always)]
    pub fn from_hashes([first, second]: [u32; 2], largest_m: f32) -> Self {
        let third = second_hash(second ^ THIRD_KEY);
        let fourth = second_hash(third);
        let jitter = |bits: u32| (2.0 * fraction(bits, 0x3ff) - 1.0) * JITTER_CELLS + 0.5;
        let diameter_m = grain_diameter(second, largest_m);
        // On a square that stands on its corner: nearly uniform in angle.
        let across = 2.0 * fraction(third, 0xff) - 1.0;
        let stretch = 1.0 + (MAX_STRETCH - 1.0) * fraction(third >> 8, 0xff);
        let height = HEIGHTS[0] + (HEIGHTS[1] - HEIGHTS[0]) * fraction(third >> 16, 0xff);
        let per_radius = 2.0 / diameter_m;
        // The sum of four uniform numbers has a deviation of 1 / sqrt(3).
        let sum: f32 = [0, 8, 16, 24].into_iter().map(|shift| fraction(fourth >> shift, 0xff)).sum();
        Self {
            centre: Vec2::new(jitter(second), jitter(second >> 10)),
            diameter_m,
            axis: Vec2::new(across, 1.0 - across.abs()).normalize(),
            per_axis: Vec3::new(per_radius / stretch, per_radius * stretch, 1.0 / (height * diameter_m)),
            tilt: MAX_TILT * (2.0 * fraction(third >> 24, 0xff) - 1.0),
            kind: fraction(first >> 16, 0xffff),
            brightness: (sum - 2.0) * 1.732_050_8,
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
        let height_m = (discriminant.sqrt() - b) / a;
        let normal = (origin + height_m * way) * self.per_axis;
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
        let (ratio, spread) = if self.kind < material.fragments {
            (material.ratio, material.spread)
        } else {
            (1.0, CLOD_SPREAD * material.spread)
        };
        ratio * libm::expf(spread * self.brightness)
    }
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
