//! One bounce of sunlight from the ground, by Hapke's law.
//!
//! Lunar soil is backscattering: level ground is brightest when viewed along the sun's rays. A rock face that points away
//! from the sun sees the ground from that direction and receives several times as much from it as a face on the sunny side;
//! the rock's own shadow takes part of it away, most of it near the ground. Ground that leans receives light from the ground beside
//! it. What ground receives from higher ground depends on the place and is no part of this.
//! Must not know: how surfaces are rendered.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::photometry::{Hapke, Law, Photometry};

/// Height of the dome, half of an ellipsoid, that approximates a rock, in radii: the median ratio of exposed height to diameter is 0.49
/// in the scans of POLAR-digital.
const HEIGHT_RADII: f64 = 1.0;
/// Nodes of the fit on rocks: height above the ground, as a fraction of the rock's.
const SIDE_HEIGHTS: [f64; 3] = [0.1, 0.4, 0.9];
/// Directions of the quadrature, all below the horizon. The rings are uniform in the square root of the sine, denser near the horizon,
/// where the ground beyond a shadow is.
const RINGS: u32 = 24;
const SPOKES: u32 = 48;
/// Nodes of the fit: cosine of the normal's azimuth relative to the sun's.
const COSINES: [f64; 4] = [-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0];
/// Nodes of the fit of light from rocks: cosine of the phase angle. The opposition surge below 12 degrees is left out.
const PHASE_COSINES: [f64; 4] = [-0.75, -0.15, 0.45, 0.978];
/// Rings and spokes of the normals of a rock: those of one half of a sphere, the other half is its mirror image.
const NORMALS: [u32; 2] = [12, 48];
/// Nodes on rocks: z of the normal.
const ROCK_HEIGHTS: [f64; 4] = [-0.6, 0.0, 0.6, 0.95];
/// Nodes on the ground: sine of the normal's angle to the vertical.
const GROUND_SINES: [f64; 3] = [0.0, 0.25, 0.6];

/// Coefficients of a bivariate polynomial: rows are ascending powers of the normal's z (rocks) or sine (ground), columns
/// ascending powers of the cosine of its azimuth relative to the sun's.
pub type Polynomial<const LINES: usize> = [[f32; COSINES.len()]; LINES];

/// Fitted irradiance from bounced light; the polynomials give its square root.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bounce {
    /// On a rock face, by the z of its normal: relative to unshadowed level ground of uniform radiance with the same
    /// exitance. Ascending powers of the height above the ground, as a fraction of the rock's.
    pub on_rock: [Polynomial<4>; SIDE_HEIGHTS.len()],
    /// Radiance of a sunlit face of a rock of unit colour, relative to the sun's irradiance and to the law of Lommel and Seeliger
    /// (the cosine of incidence over the sum of those of incidence and emission), by the cosine of the phase angle. Ascending powers.
    pub rock_phase: [f32; PHASE_COSINES.len()],
    /// On ground, by the sine of its normal, from level sunlit ground around it: relative to uniform light of that radiance from all
    /// directions.
    pub on_ground: Polynomial<3>,
}

/// A direction that light comes from, and its radiance times solid angle.
type Ray = (DVec3, f64);

impl Bounce {
    /// Fits the bounced light of level ground; `sine` is that of the sun's elevation. All zero for laws other than Hapke's.
    #[must_use]
    pub fn new(photometry: &Photometry, sine: f64) -> Self {
        let Law::Hapke = photometry.law else { return Self::default() };
        let sine = sine.clamp(1e-3, 1.0);
        let sun = DVec2::new((1.0 - sine * sine).sqrt(), sine);
        let radiance_of =
            |way: DVec3| photometry.soil.radiance_factor(sine, -way.z, -way.x * sun.x - way.z * sine);
        let below: Vec<Ray> = spokes(RINGS)
            .map(|(ring, azimuth)| {
                let way = direction(-ring * ring, azimuth);
                (way, radiance_of(way) * 2.0 * ring * TAU / f64::from(RINGS * SPOKES))
            })
            .collect();
        let exitance = irradiance(&below, DVec3::NEG_Z);
        let rock = Photometry { soil: photometry.with_surge(photometry.rock_b_s0), ..*photometry };
        let at_height = |height: f64| {
            polynomial(ROCK_HEIGHTS, |out| {
                let rays = unshadowed(&below, out, height, sun);
                ROCK_HEIGHTS.map(|z| {
                    let normal = (out * (1.0 - z * z).sqrt()).extend(z);
                    let even = exitance * 0.5 * (1.0 - z);
                    (irradiance(&rays, normal) / even).sqrt()
                })
            })
        };
        let on_rock = powers_of_height(SIDE_HEIGHTS.map(at_height));
        Self { on_rock, rock_phase: rock_phase(&rock.soil), on_ground: on_ground(&below, exitance) }
    }
}

/// Fits the polynomial for ground that receives these rays.
fn on_ground(rays: &[Ray], exitance: f64) -> Polynomial<3> {
    polynomial(GROUND_SINES, |out| {
        GROUND_SINES.map(|tilt| {
            let normal = (out * tilt).extend((1.0 - tilt * tilt).sqrt());
            (irradiance(rays, normal) / exitance).sqrt()
        })
    })
}

/// The quadratic through polynomials at [`SIDE_HEIGHTS`], coefficient by coefficient.
fn powers_of_height(at_heights: [Polynomial<4>; SIDE_HEIGHTS.len()]) -> [Polynomial<4>; SIDE_HEIGHTS.len()] {
    let mut sum = [[[0.0; COSINES.len()]; 4]; SIDE_HEIGHTS.len()];
    for (polynomial, weights) in at_heights.iter().zip(powers(SIDE_HEIGHTS)) {
        for (power, weight) in sum.iter_mut().zip(weights) {
            for (line, own) in power.iter_mut().zip(polynomial) {
                line.iter_mut().zip(own).for_each(|(coefficient, own)| *coefficient += weight as f32 * own);
            }
        }
    }
    sum
}

/// Fits [`Bounce::rock_phase`]: means over a sphere's normals, each weighted by its projected areas.
fn rock_phase(law: &Hapke) -> [f32; PHASE_COSINES.len()] {
    let [rings, spokes] = NORMALS;
    let at_phase = |cosine: f64| {
        let to_eye = DVec3::new(cosine, (1.0 - cosine * cosine).sqrt(), 0.0);
        let (mut light, mut seeliger) = (0.0, 0.0);
        for (ring, spoke) in (0..rings).flat_map(|ring| (0..spokes).map(move |spoke| (ring, spoke))) {
            let z = (f64::from(ring) + 0.5) / f64::from(rings);
            let normal = direction(z, TAU * (f64::from(spoke) + 0.5) / f64::from(spokes));
            let (incidence, emission) = (normal.x.max(0.0), normal.dot(to_eye).max(0.0));
            let weight = incidence * emission;
            light += weight * law.radiance_factor(incidence, emission, cosine) / PI;
            seeliger += weight * incidence / (incidence + emission).max(1e-9);
        }
        light / seeliger
    };
    let mut coefficients = [0.0_f64; PHASE_COSINES.len()];
    for (cosine, basis) in PHASE_COSINES.into_iter().zip(powers(PHASE_COSINES)) {
        let value = at_phase(cosine);
        coefficients.iter_mut().zip(basis).for_each(|(coefficient, own)| *coefficient += value * own);
    }
    coefficients.map(|coefficient| coefficient as f32)
}

/// Midpoints of rings in (0, 1), each with every azimuth.
fn spokes(rings: u32) -> impl Iterator<Item = (f64, f64)> {
    let middle = |index: u32, of: u32| (f64::from(index) + 0.5) / f64::from(of);
    (0..rings).flat_map(move |ring| {
        (0..SPOKES).map(move |spoke| (middle(ring, rings), TAU * middle(spoke, SPOKES)))
    })
}

fn direction(z: f64, azimuth: f64) -> DVec3 {
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * libm::cos(azimuth), across * libm::sin(azimuth), z)
}

fn irradiance(rays: &[Ray], normal: DVec3) -> f64 {
    rays.iter().map(|(way, light)| light * normal.dot(*way).max(0.0)).sum()
}

/// Keeps the rays that hit level ground outside the shadow of a dome of radius 1. They start on its side towards `out`, at a fraction of its
/// height. The sun is above the X axis; `sun` holds the cosine and the sine of its elevation.
fn unshadowed(rays: &[Ray], out: DVec2, height: f64, sun: DVec2) -> Vec<Ray> {
    let start = (1.0 - height * height).sqrt() * out;
    let cotangents = HEIGHT_RADII * sun.x / sun.y;
    let length = (1.0 + cotangents * cotangents).sqrt();
    let is_sunlit = |(way, _): &Ray| {
        let end = start + HEIGHT_RADII * height / -way.z * DVec2::new(way.x, way.y);
        let half_chord = (1.0 - end.y * end.y).max(0.0).sqrt();
        end.x >= half_chord || -end.x >= length * half_chord
    };
    rays.iter().copied().filter(is_sunlit).collect()
}

/// The polynomial that interpolates `values` at the nodes; it is called with a horizontal direction for each of [`COSINES`].
fn polynomial<const N: usize>(nodes: [f64; N], values: impl Fn(DVec2) -> [f64; N]) -> Polynomial<N> {
    let mut coefficients = [[0.0_f64; COSINES.len()]; N];
    for (cosine, by_cosine) in COSINES.iter().zip(powers(COSINES)) {
        let out = DVec2::new(*cosine, (1.0 - cosine * cosine).sqrt());
        for (value, by_node) in values(out).iter().zip(powers(nodes)) {
            for (line, of_node) in coefficients.iter_mut().zip(by_node) {
                for (coefficient, of_cosine) in line.iter_mut().zip(by_cosine) {
                    *coefficient += value * of_node * of_cosine;
                }
            }
        }
    }
    coefficients.map(|line| line.map(|coefficient| coefficient as f32))
}

/// Lagrange basis: for each node the polynomial that is 1 there and 0 at the others, coefficients in ascending powers.
fn powers<const N: usize>(nodes: [f64; N]) -> [[f64; N]; N] {
    nodes.map(|node| {
        let mut product = [0.0; N];
        product[0] = 1.0;
        for other in nodes.into_iter().filter(|other| *other != node) {
            for power in (0..N).rev() {
                let lower = if power > 0 { product[power - 1] } else { 0.0 };
                product[power] = (lower - other * product[power]) / (node - other);
            }
        }
        product
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Value of [`Bounce::on_rock`] before it is squared; the height is clamped, as in the shader.
    fn evaluate(on_rock: &[Polynomial<4>; SIDE_HEIGHTS.len()], cosine: f64, z: f64, height: f64) -> f64 {
        let horner = |values: &mut dyn DoubleEndedIterator<Item = f64>, x: f64| {
            values.rfold(0.0, |sum, c| sum * x + c)
        };
        let of_line = |line: &[f32; COSINES.len()]| horner(&mut line.iter().map(|c| f64::from(*c)), cosine);
        let of_power = |power: &Polynomial<4>| horner(&mut power.iter().map(of_line), z);
        horner(&mut on_rock.iter().map(of_power), height.clamp(0.0, 1.0))
    }

    fn at<const N: usize>(polynomial: &Polynomial<N>, cosine: f64, height_or_sine: f64) -> f64 {
        let value = |line: &[f32]| line.iter().rev().fold(0.0, |sum, c| sum * cosine + f64::from(*c));
        let root = polynomial.iter().rev().fold(0.0, |sum, line| sum * height_or_sine + value(line));
        root * root
    }

    fn square(x: f64) -> f64 {
        x * x
    }

    fn soil_and_rock_alike() -> Photometry {
        let soil = Photometry::default().soil;
        Photometry { law: Law::Hapke, soil, rock_b_s0: soil.b_s0 }
    }

    /// Integrals over 800 x 480 directions by the plugin `hapke` of eradiate-mitsuba 0.5.0, with the dome's shadow by its closest approach to
    /// rays towards the sun, 10, 20 and 40 degrees high.
    #[test]
    fn rock_faces_agree_with_an_integral_over_the_ground() {
        for (elevation_deg, azimuth_deg, height, expected) in [
            (10.0, 180.0, 0.0, 0.893),
            (10.0, 135.0, 0.6, 1.731),
            (10.0, 60.0, 0.3, 0.720),
            (10.0, 0.0, 0.0, 0.536),
            (20.0, 180.0, -0.3, 0.705),
            (20.0, 180.0, 0.6, 1.433),
            (20.0, 90.0, 0.0, 0.987),
            (20.0, 30.0, 0.0, 0.615),
            (40.0, 180.0, 0.0, 0.956),
            (40.0, 112.0, 0.3, 1.123),
            (40.0, 0.0, 0.6, 0.644),
        ] {
            let sine = libm::sin(f64::to_radians(elevation_deg));
            let bounce = Bounce::new(&soil_and_rock_alike(), sine);
            let cosine = libm::cos(f64::to_radians(azimuth_deg));
            let at_height = |side: f64| square(evaluate(&bounce.on_rock, cosine, height, side));
            let found = 0.5 * (at_height(0.25) + at_height(0.75));
            assert!(
                (found / expected - 1.0).abs() < 0.12,
                "sun {elevation_deg}, face at {azimuth_deg}, {height}: {found}, not {expected}"
            );
        }
    }

    /// Level ground lies in its own plane; what leans sees as much of it to all sides by the law of Lambert.
    #[test]
    fn ground_is_lit_by_level_ground_as_it_leans() {
        let on_ground = Bounce::new(&soil_and_rock_alike(), 0.3).on_ground;
        assert!(at(&on_ground, 0.0, 0.0) < 1e-6);
        let sine = 0.25;
        let mean = COSINES.map(|cosine| at(&on_ground, cosine, sine)).iter().sum::<f64>() / 4.0;
        let even = 0.5 * (1.0 - (1.0 - sine * sine).sqrt());
        assert!((0.5..2.5).contains(&(mean / even)), "{mean}, even light {even}");
        let [away, towards] = [-1.0, 1.0].map(|cosine| at(&on_ground, cosine, sine));
        assert!(away > 1.5 * towards, "soil is brightest seen along the sunlight: {away} {towards}");
    }

    /// The shadow at its foot takes away the light near the ground of a face away from the sun, not that of a sunny one.
    #[test]
    fn unlit_faces_are_darker_near_the_ground() {
        for elevation_deg in [5.0, 17.0, 35.0] {
            let sine = libm::sin(f64::to_radians(elevation_deg));
            let on_rock = Bounce::new(&soil_and_rock_alike(), sine).on_rock;
            let at = |cosine: f64, height: f64| square(evaluate(&on_rock, cosine, 0.0, height));
            assert!(
                at(-1.0, 0.1) < 0.6 * at(-1.0, 0.8),
                "{elevation_deg}: {} {}",
                at(-1.0, 0.1),
                at(-1.0, 0.8)
            );
            let sunny = at(1.0, 0.1) / at(1.0, 0.8);
            assert!((0.95..1.15).contains(&sunny), "{elevation_deg}: {sunny}");
        }
    }

    /// Means over 20,000 normals of a sphere by the plugin `hapke` of eradiate-mitsuba 0.5.0.
    #[test]
    fn sunlit_faces_are_brightest_along_the_sunlight() {
        let photometry = Photometry { law: Law::Hapke, ..Photometry::default() };
        let phase = Bounce::new(&photometry, 0.3).rock_phase;
        for (cosine, expected) in
            [(-0.75, 0.0093), (-0.45, 0.0161), (0.15, 0.0257), (0.7, 0.0384), (0.9, 0.0483), (0.978, 0.0581)]
        {
            let found = phase.iter().rev().fold(0.0, |sum, c| sum * cosine + f64::from(*c));
            assert!((found / expected - 1.0).abs() < 0.1, "{cosine}: {found}, not {expected}");
        }
    }
}
