//! The height function of the surface stage: hills to millimetres, a crater's wall, craters, clods, tracks of rovers, fillets of soil around rocks.
//!
//! One function of position and footprint: detail below the footprint is faded out (band-limiting), so that a mesh can sample
//! it at the size of its cells. The shader adds the slopes of the detail between the cell and the pixel
//! (`shaders/common/relief.wgsl`, the GPU counterpart).
//! Must not know: who asks.

use fearless_simd::{Level, dispatch};
use glam::Vec2;

use super::crater_rays::CraterRays;
use super::crater_wall::CraterWall;
use super::craters::{CraterField, Pit, Region, is_near_ring};
use super::far_hills::FarHills;
use super::fillet::{BATCH, Fillet};
use super::grains::GrainField;
use super::lattice::Lattice;
use super::noise::{GRADIENT_NOISE_SIGMA, SHADE_SIGMA, gradient_noise_difference, patchy_noise_2d};
use super::track::Track;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Octaves of hills and of undulation.
const COARSE_OCTAVES: u32 = 5;
/// First frequency of hills and of undulation, per metre.
const HILLS: f64 = 0.004;
const UNDULATION: f64 = 0.02;
/// Standard deviation of hills and undulation relative to their knobs.
const COARSE_DEVIATION: f64 = 0.17;
/// Longest wavelength of the fine relief, metres: half the shortest of the undulation.
const FINE_LONGEST_M: f64 = 1.5625;
/// Octaves of the fine relief: down to 1.5 mm.
const FINE_OCTAVES: u32 = 11;
/// The first octave of the fine relief that sets how strong finer ones are from place to place: 39 cm. Every other one from there on does.
const FIRST_PATCHY: u32 = 2;
/// Typical strength that such an octave gives to finer ones.
const TYPICAL_STRENGTH: f64 = 0.88;
/// Most that an octave is stronger in one place than in the mean: soil that is steeper than its angle of repose slides.
pub(crate) const MAX_STRENGTH: f32 = 1.2;
/// Octaves of the soil's shade that a view shows at once, about.
const SHADED_OCTAVES: f32 = 5.0;
/// Baseline of the slope that the fine relief is made for, metres.
const SLOPE_BASELINE_M: f64 = 0.007;
/// Slope, degrees, that hills, craters and clods contribute at that baseline with their defaults.
const OTHER_SLOPE_DEG: f64 = 3.6;
/// Fraction of the remaining slope that the noise has: grains and pits have the rest.
const NOISE_SHARE: f64 = 0.9;
/// Median absolute value of a normal variable, in standard deviations.
const MEDIAN_PER_DEVIATION: f64 = 0.674_489_75;
/// A wave or a crater fades in from this many mesh cells across, and is complete at twice as many; `relief.wgsl` has the
/// same constants.
pub const MIN_CELLS: f32 = 3.0;

/// One octave of noise.
#[derive(Clone, Copy, Debug)]
pub struct Octave {
    /// Its lattice.
    pub lattice: Lattice,
    /// Amplitude of the noise, metres.
    pub amplitude_m: f32,
    /// Amplitude of the shade that goes with it, in the logarithm of the soil's albedo.
    pub shade: f32,
    /// 1 if it sets how strong all finer octaves are from place to place, else 0.
    pub patchy: f32,
}

/// The height function.
#[derive(Clone, Debug)]
pub struct Relief {
    /// In order of decreasing wavelength.
    pub octaves: Vec<Octave>,
    /// Craters and clods.
    pub craters: CraterField,
    /// Grains: in no mesh, and in none of the heights below.
    pub grains: GrainField,
    /// Tracks of rovers.
    pub tracks: Vec<Track>,
    /// Fillets of soil.
    pub fillets: Vec<Fillet>,
    /// Hills on the horizon, if there are any.
    pub far_hills: Option<FarHills>,
    /// The wall of a large old crater, if there is one.
    pub wall: Option<CraterWall>,
    /// Rays of fresh craters: the soil's albedo, no height.
    pub crater_rays: CraterRays,
}

/// The craters, clods, tracks and fillets that can change the height in some region.
#[derive(Clone, Debug, Default)]
pub struct Nearby {
    /// Each with its distance from the centre, metres.
    pits: Vec<(f32, Pit)>,
    tracks: Vec<Track>,
    fillets: Vec<Fillet>,
}

/// Fade-in factor, 0 to 1, of a feature of this size on a mesh with cells of this size.
#[must_use]
#[inline(always)]
pub fn mesh_share(size_m: f32, cell_m: f32) -> f32 {
    (size_m / (MIN_CELLS * cell_m) - 1.0).clamp(0.0, 1.0)
}

impl Relief {
    /// The relief of these parameters, for points around `centre` (metres, world).
    #[must_use]
    pub fn new(streams: &Streams, params: &Params, centre: Vec2) -> Self {
        let number = |knob| params.number(knob);
        let mut octaves: Vec<(f64, f64, &str, u32)> = Vec::new();
        for (knob, frequency, purpose) in [
            (Knob::ReliefHillsM, HILLS, "relief.hills"),
            (Knob::ReliefUndulationM, UNDULATION, "relief.undulation"),
        ] {
            // The amplitude halves per octave; variances add.
            let sum: f64 = (0..COARSE_OCTAVES).map(|k| 1.0 / f64::from(1_u32 << (2 * k))).sum();
            let first = COARSE_DEVIATION * number(knob) / (f64::from(GRADIENT_NOISE_SIGMA) * sum.sqrt());
            octaves.extend((0..COARSE_OCTAVES).map(|k| {
                let halving = f64::from(1_u32 << k);
                (1.0 / (frequency * halving), first / halving, purpose, k)
            }));
        }
        let (hurst, median_deg) = (number(Knob::ReliefHurst), number(Knob::ReliefSlopeDeg));
        let fine = fine_octaves(hurst, median_deg);
        octaves.extend(
            (0..).zip(fine).map(|(k, (wavelength, amplitude))| (wavelength, amplitude, "relief.fine", k)),
        );
        octaves.sort_by(|a, b| b.0.total_cmp(&a.0));
        // About as many octaves are between the mesh's cells and the samples.
        let shade = number(Knob::RegolithMottling) as f32 / (SHADE_SIGMA * SHADED_OCTAVES.sqrt());
        let octaves = octaves
            .into_iter()
            .map(|(wavelength_m, amplitude_m, purpose, k)| Octave {
                lattice: Lattice::new(wavelength_m, centre, &mut streams.stream(purpose, k.into())),
                amplitude_m: amplitude_m as f32,
                shade: if purpose == "relief.fine" { shade } else { 0.0 },
                patchy: if purpose == "relief.fine" && is_patchy(k) { 1.0 } else { 0.0 },
            })
            .collect();
        let craters = CraterField::new(streams, params, centre);
        let grains = GrainField::new(streams, params, centre);
        let far_hills = FarHills::new(streams, params, centre);
        let wall = CraterWall::new(streams, params, centre);
        let crater_rays = CraterRays::new(params, &craters, Vec2::ZERO);
        Self {
            octaves,
            craters,
            grains,
            tracks: Vec::new(),
            fillets: Vec::new(),
            far_hills,
            wall,
            crater_rays,
        }
    }

    /// This relief with what counts from the camera of these parameters counted from a camera elsewhere, metres from the centre.
    #[must_use]
    pub(super) fn counted_from(mut self, params: &Params, camera: Vec2) -> Self {
        if camera != Vec2::ZERO {
            self.wall = self.wall.map(|wall| wall.moved(camera));
            self.far_hills = self.far_hills.map(|far_hills| far_hills.moved(camera));
            self.crater_rays = CraterRays::new(params, &self.craters, camera);
        }
        self
    }

    /// What can change the height within a region, at this cell size or a larger one.
    #[must_use]
    pub fn nearby(&self, region: &Region, cell_m: f32) -> Nearby {
        let mut nearby = Nearby::default();
        self.craters.around(region, MIN_CELLS * cell_m, |pit| nearby.pits.push((pit.offset.length(), pit)));
        let &Region { middle, radius_m, .. } = region;
        nearby.tracks.extend(self.tracks.iter().copied().filter(|track| track.is_near(middle, radius_m)));
        nearby.fillets.extend(self.fillets.iter().copied().filter(|fillet| {
            let reach_m = radius_m + fillet.reach_m();
            fillet.offset.distance_squared(middle) < reach_m * reach_m
        }));
        nearby
    }

    /// Sets the heights at points (structure of arrays, metres from the centre) for a mesh with cells of this size, metres.
    /// `nearby` must cover the points.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_heights(&self, [x, y]: [&[f32]; 2], cell_m: f32, nearby: &Nearby, heights: &mut [f32]) {
        assert!(x.len() == heights.len() && y.len() == heights.len(), "one height per point");
        let points = x.chunks(BATCH).zip(y.chunks(BATCH));
        for ((x, y), heights) in points.zip(heights.chunks_mut(BATCH)) {
            dispatch!(Level::new(), _simd => self.set_in_vectors([x, y], cell_m, nearby, heights));
        }
    }

    // Must be inlined into the dispatched code to be compiled for its SIMD width.
    #[inline(always)]
    fn set_in_vectors(&self, [x, y]: [&[f32]; 2], cell_m: f32, nearby: &Nearby, heights: &mut [f32]) {
        heights.fill(0.0);
        let mut strengths = [1.0; BATCH];
        for Octave { lattice, amplitude_m, patchy, .. } in &self.octaves {
            let share = mesh_share(lattice.cell_m, cell_m);
            if share == 0.0 {
                break;
            }
            let amplitude_m = share * amplitude_m;
            for (((height, strength), x), y) in heights.iter_mut().zip(&mut strengths).zip(x).zip(y) {
                let (cell, t) = lattice.cell(lattice.local(Vec2::new(*x, *y)));
                let [value, finer] = patchy_noise_2d(cell, t, lattice.seed, *patchy);
                *height += capped_strength(*strength) * (amplitude_m * value);
                *strength *= finer;
            }
        }
        if let Some(far_hills) = &self.far_hills {
            far_hills.add_heights([x, y], |size_m| mesh_share(size_m, cell_m), heights);
        }
        if let Some(wall) = &self.wall {
            wall.add_heights([x, y], |size_m| mesh_share(size_m, cell_m), heights);
        }
        let circle = Circle::around([x, y]);
        for (distance_m, pit) in &nearby.pits {
            let reach_m = pit.reach_m();
            if !is_near_ring(*distance_m, reach_m, circle.distances_m) || !circle.is_near(pit.offset, reach_m)
            {
                continue;
            }
            let share = mesh_share(pit.diameter_m, cell_m);
            if share > 0.0 && is_any_within(reach_m, pit.offset, [x, y]) {
                for ((height, x), y) in heights.iter_mut().zip(x).zip(y) {
                    *height += share * pit.height_at(Vec2::new(*x, *y));
                }
            }
        }
        for track in &nearby.tracks {
            track.add_heights([x, y], cell_m, |size_m| mesh_share(size_m, cell_m), heights);
        }
        let mut soil = [0.0; BATCH];
        for fillet in &nearby.fillets {
            if circle.is_near(fillet.offset, fillet.reach_m())
                && is_any_within(fillet.reach_m(), fillet.offset, [x, y])
            {
                fillet.add_heights([x, y], |size_m| mesh_share(size_m, cell_m), &mut soil[..x.len()]);
            }
        }
        for (height, soil) in heights.iter_mut().zip(soil) {
            *height += soil;
        }
    }

    /// Height at a single point (metres from the centre) for a mesh with cells of this size, metres.
    #[must_use]
    pub fn height_at(&self, offset: Vec2, cell_m: f32) -> f32 {
        let mut height = [0.0];
        let nearby = self.nearby(&Region::circle(offset, 0.0), cell_m);
        self.set_heights([&[offset.x], &[offset.y]], cell_m, &nearby, &mut height);
        height[0]
    }
}

/// A circle around points, and the ring that they lie in.
struct Circle {
    centre: Vec2,
    radius_m: f32,
    /// Smallest and largest distance of a point from the origin, metres.
    distances_m: [f32; 2],
}

impl Circle {
    /// The circle around the bounding box of points (structure of arrays).
    #[inline(always)]
    fn around([x, y]: [&[f32]; 2]) -> Self {
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        let mut squares = [f32::MAX, 0.0];
        for (x, y) in x.iter().zip(y) {
            let square = x * x + y * y;
            squares[0] = if square < squares[0] { square } else { squares[0] };
            squares[1] = if square > squares[1] { square } else { squares[1] };
            // `f32::min` is more than a comparison (NaN).
            low = [if *x < low[0] { *x } else { low[0] }, if *y < low[1] { *y } else { low[1] }];
            high = [if *x > high[0] { *x } else { high[0] }, if *y > high[1] { *y } else { high[1] }];
        }
        let (low, high) = (Vec2::from(low), Vec2::from(high));
        let (centre, radius_m) = (0.5 * (low + high), 0.5 * low.distance(high));
        Self { centre, radius_m, distances_m: squares.map(f32::sqrt) }
    }

    /// Whether any of the points may be within a distance of another one: wherever [`is_any_within`] says so, and in few other cases.
    #[inline(always)]
    fn is_near(&self, point: Vec2, reach_m: f32) -> bool {
        let within_m = 1.001 * self.radius_m + 1.01 * reach_m;
        self.centre.distance_squared(point) < within_m * within_m
    }
}

/// Whether any of these points is within a distance of `centre` (conservative by 1 %).
#[inline(always)]
fn is_any_within(reach_m: f32, centre: Vec2, [x, y]: [&[f32]; 2]) -> bool {
    // Non-negative floats are ordered like their bits.
    let mut min_bits = u32::MAX;
    for (x, y) in x.iter().zip(y) {
        min_bits = min_bits.min(Vec2::new(*x, *y).distance_squared(centre).to_bits());
    }
    f32::from_bits(min_bits) < 1.01 * reach_m * reach_m
}

/// Whether octave `k` of the fine relief sets how strong all finer ones are: soil has smooth patches of fines and patches of clods, of all
/// sizes, as terrain that is a cascade of strengths that multiply (Schertzer and Lovejoy 1987).
const fn is_patchy(k: u32) -> bool {
    k >= FIRST_PATCHY && (k - FIRST_PATCHY).is_multiple_of(2)
}

/// The strength of an octave where coarser ones have set a product of strengths.
#[must_use]
#[inline(always)]
pub fn capped_strength(product: f32) -> f32 {
    // `f32::min` is more than a comparison (NaN).
    if product < MAX_STRENGTH { product } else { MAX_STRENGTH }
}

/// Wavelength and amplitude, metres, of each octave of the fine relief: a power law with this Hurst exponent, scaled to a
/// median slope over a 7 mm baseline.
fn fine_octaves(hurst: f64, median_deg: f64) -> Vec<(f64, f64)> {
    let unit: Vec<(f64, f64)> = (0..FINE_OCTAVES)
        .map(|k| {
            let scale = 1.0 / f64::from(1_u32 << k);
            (FINE_LONGEST_M * scale, libm::pow(scale, hurst))
        })
        .collect();
    let difference: f64 = unit
        .iter()
        .map(|(wavelength, amplitude)| {
            let difference = amplitude * gradient_noise_difference(SLOPE_BASELINE_M / wavelength);
            difference * difference
        })
        .sum();
    let tangent = |degrees: f64| libm::tan(degrees.to_radians());
    let square = |x: f64| x * x;
    let rest = (square(tangent(median_deg)) - square(tangent(OTHER_SLOPE_DEG))).max(0.0).sqrt();
    let wanted_m = SLOPE_BASELINE_M * NOISE_SHARE * rest / MEDIAN_PER_DEVIATION;
    let scale = wanted_m / difference.sqrt();
    // The typical ground has these amplitudes; rougher ground has more, and smoother less.
    let typical = (0..FINE_OCTAVES).scan(1.0, |strength, k| {
        let here = *strength;
        *strength *= if is_patchy(k) { TYPICAL_STRENGTH } else { 1.0 };
        Some(here)
    });
    unit.into_iter()
        .zip(typical)
        .map(|((wavelength, amplitude), strength)| (wavelength, scale * amplitude / strength))
        .collect()
}
