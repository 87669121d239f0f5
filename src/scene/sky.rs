//! The sun, the dome and the stars.
//!
//! Dome, stars and the sun's disc are emissive and unlit; they cast no shadows.
//! Must not know: how they are rendered.

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Radiance of the nominal stage's dome, in the units of [`Sun::irradiance`].
pub const DOME_RADIANCE: Vec3 = Vec3::new(0.010, 0.010, 0.016);
/// Radiance of a star.
pub const STAR_RADIANCE: Vec3 = Vec3::new(4.0, 4.0, 4.2);
/// Icosphere level of the dome.
pub const DOME_LEVEL: usize = 4;
/// Icosphere level of a star.
pub const STAR_LEVEL: usize = 1;
/// Icosphere level of the sun's disc.
pub const SUN_LEVEL: usize = 3;
/// Radius of the disc's mesh relative to the sun's, so that its outline, a polygon of some 45 corners, has the area of the disc.
const SUN_OUTLINE: f32 = 1.0016;
/// Distance of the disc from the dome, metres; the dome's mesh lies up to a thousandth of its radius inside its sphere.
const SUN_INSET_M: f32 = 0.5;
/// The largest half-precision number. Where a channel of the sun's disc is beyond it, the disc is stored in the same colour with that
/// channel at this value.
pub const MAX_STORED_RADIANCE: f32 = 65_504.0;
/// Limb darkening: the radiance of the disc is proportional to this power of the cosine, for wavelengths of 610, 550 and 465 nm. The law
/// and its exponent, -0.023 + 0.292 / micrometres, are those of Hestroffer and Magnan 1998 (A&A 333, 338), a fit to the measurements of
/// Neckel and Labs 1994.
pub const LIMB_EXPONENTS: [f32; 3] = [0.455_688_5, 0.507_909_1, 0.604_957];
/// Least cosine: the outline of the disc's mesh reaches a little beyond the limb.
const MIN_LIMB_COSINE: f32 = 0.05;
/// Distance of the stars from the dome, inwards, metres.
const STAR_INSET_M: f64 = 18.0;
/// Range of the stars' radii on a dome of [`STAR_DOME_M`], metres; they scale with the dome, to span the same angle.
pub const STAR_RADIUS_M: [f64; 2] = [0.5, 1.1];
/// Radius of the dome that [`STAR_RADIUS_M`] refers to, metres.
pub const STAR_DOME_M: f64 = 600.0;
/// Irradiance at normal incidence per unit of the intensity knob. At exposure 0 EV, radiance 1 is the middle of the tone
/// curve; the factor was chosen together with the tone curve on the reference frame.
pub const SUN_IRRADIANCE_PER_INTENSITY: f32 = 1.66e-3;

/// The sun as a distant disc: the only light source besides the dome's glow and earthshine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// Unit vector from the scene towards the sun.
    pub direction: Vec3,
    /// Elevation above the XY plane, degrees.
    pub elevation_deg: f64,
    /// Azimuth, clockwise from +Y towards +X, degrees.
    pub azimuth_deg: f64,
    /// Angular diameter of the disc, degrees.
    pub angular_diameter_deg: f64,
    /// Irradiance at normal incidence, linear RGB.
    pub irradiance: Vec3,
}

/// A radiance as it is stored: see [`MAX_STORED_RADIANCE`].
#[must_use]
pub fn stored_radiance(radiance: Vec3) -> Vec3 {
    radiance * (MAX_STORED_RADIANCE / radiance.max_element().max(MAX_STORED_RADIANCE))
}

impl Sun {
    /// The sun of these parameters.
    #[must_use]
    pub fn build(params: &Params) -> Self {
        let colour = params.rgb(Knob::SunColor).map(|channel| channel as f32);
        let intensity = params.number(Knob::SunIntensity) as f32;
        Self::new(
            params.number(Knob::SunElevationDeg),
            params.number(Knob::SunAzimuthDeg),
            params.number(Knob::SunAngularDiameterDeg),
            intensity * SUN_IRRADIANCE_PER_INTENSITY * Vec3::from(colour),
        )
    }

    /// A sun at these angles, degrees.
    #[must_use]
    pub fn new(elevation_deg: f64, azimuth_deg: f64, angular_diameter_deg: f64, irradiance: Vec3) -> Self {
        let (elevation, azimuth) = (elevation_deg.to_radians(), azimuth_deg.to_radians());
        let across = libm::cos(elevation);
        let direction =
            DVec3::new(across * libm::sin(azimuth), across * libm::cos(azimuth), libm::sin(elevation));
        Self { direction: direction.as_vec3(), elevation_deg, azimuth_deg, angular_diameter_deg, irradiance }
    }

    /// Orthonormal basis of the plane perpendicular to the sun's rays; `right` is horizontal, `right x up` is the direction.
    #[must_use]
    pub fn right_and_up(&self) -> [Vec3; 2] {
        let level = Vec3::new(-self.direction.y, self.direction.x, 0.0);
        let right = if level.length() > 1e-3 { level / level.length() } else { Vec3::X };
        let up = self.direction.cross(right);
        let up = up / up.length();
        [up.cross(self.direction), up]
    }

    /// Solid angle of the disc, steradians.
    #[must_use]
    pub fn solid_angle(&self) -> f64 {
        let half_sine = libm::sin(0.25 * self.angular_diameter_deg.to_radians());
        4.0 * std::f64::consts::PI * half_sine * half_sine
    }

    /// Mean radiance of the disc: irradiance over solid angle.
    #[must_use]
    pub fn disc_radiance(&self) -> Vec3 {
        self.irradiance / self.solid_angle().max(1e-12) as f32
    }

    /// Sine of half the angular diameter.
    #[must_use]
    pub fn disc_sine(&self) -> f32 {
        libm::sin(0.5 * self.angular_diameter_deg.to_radians()) as f32
    }

    /// Radiance of the disc where its light leaves the sun at an angle with this cosine to the surface's normal: 1 in the centre, 0 at the
    /// limb. Its mean over the disc is [`Self::disc_radiance`].
    #[must_use]
    pub fn radiance_at(&self, cosine: f32) -> Vec3 {
        let cosine = cosine.max(MIN_LIMB_COSINE);
        let darkening = LIMB_EXPONENTS.map(|exponent| (1.0 + 0.5 * exponent) * libm::powf(cosine, exponent));
        self.disc_radiance() * Vec3::from(darkening)
    }

    /// Cosine of that angle where a ray (a unit vector) meets the disc; 0 beside it.
    #[must_use]
    pub fn cosine_along(&self, ray: Vec3) -> f32 {
        let square = ray.distance_squared(self.direction);
        let sine = self.disc_sine();
        (1.0 - square * (1.0 - 0.25 * square) / (sine * sine)).max(0.0).sqrt()
    }

    /// Tangent of half the angular diameter.
    #[must_use]
    pub fn tan_half_angle(&self) -> f32 {
        libm::tan(0.5 * self.angular_diameter_deg.to_radians()) as f32
    }

    /// Fall per horizontal metre of the rays from the lower limb, which fall least; above zero even where that limb has set.
    #[must_use]
    pub fn lower_limb_slope(&self) -> f32 {
        let (level, tangent) = (self.direction.truncate().length(), self.tan_half_angle());
        // The tangent of the difference of elevation and half the diameter.
        let rise = (self.direction.z - tangent * level).max(1e-4);
        rise / (level + tangent * self.direction.z)
    }
}

/// A star: a small sphere inside the dome.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Star {
    /// Centre, metres, world.
    pub centre: Vec3,
    /// Radius, metres.
    pub radius_m: f32,
}

impl Star {
    /// Whether a part of `other` is in front of it or behind it, seen from `eye`.
    #[must_use]
    pub fn overlaps(&self, other: &Self, eye: Vec3) -> bool {
        let [(to_self, half_angle), (to_other, other_half_angle)] = [self, other].map(|star| {
            let offset = star.centre - eye;
            (offset / offset.length(), star.radius_m / offset.length())
        });
        to_self.distance(to_other) < 1.01 * (half_angle + other_half_angle)
    }
}

/// Dome and stars.
#[derive(Clone, Debug)]
pub struct Sky {
    /// Centre of the dome, metres, world: the ground under the camera.
    pub centre: Vec3,
    /// Radius of the dome, metres.
    pub radius_m: f32,
    /// The stars.
    pub stars: Vec<Star>,
    /// Radiance of the dome, in the units of [`Sun::irradiance`].
    pub radiance: Vec3,
    /// Radiance of a star.
    pub star_radiance: Vec3,
    /// Radiance of a uniform sky with the irradiance of the Earth; only lights surfaces, not visible itself.
    pub earthshine: Vec3,
}

/// Distance from the dome's centre within which there is no star, metres.
#[must_use]
pub fn innermost_star_m(dome_radius_m: f64) -> f64 {
    dome_radius_m - STAR_INSET_M - STAR_RADIUS_M[1] * (dome_radius_m / STAR_DOME_M)
}

impl Sky {
    /// The sky of these parameters around a point of the ground.
    #[must_use]
    pub fn build(streams: &Streams, params: &Params, centre: Vec3) -> Self {
        let radius_m = params.number(Knob::SkyDomeRadiusM);
        let stars = (0..u64::from(params.count(Knob::SkyStarCount)))
            .map(|k| {
                let mut draw = streams.stream("sky.star", k);
                let (x, y, z) = (draw.normal(), draw.normal(), draw.normal());
                let towards = DVec3::new(x, 0.85 * y.abs() + 0.15, 0.90 * z.abs() + 0.10);
                let offset = (radius_m - STAR_INSET_M) / towards.length() * towards;
                let [low, high] = STAR_RADIUS_M.map(|star_m| star_m * (radius_m / STAR_DOME_M));
                Star { centre: centre + offset.as_vec3(), radius_m: draw.uniform(low, high) as f32 }
            })
            .collect();
        Self {
            centre,
            radius_m: radius_m as f32,
            stars,
            radiance: DOME_RADIANCE * params.number(Knob::SkyGlow) as f32,
            star_radiance: STAR_RADIANCE * params.number(Knob::SkyStarGain) as f32,
            // A uniform sky of radiance L has an irradiance of pi L on level ground.
            earthshine: Sun::build(params).irradiance * params.number(Knob::SkyEarthshine) as f32
                / std::f32::consts::PI,
        }
    }
}

impl Sky {
    /// # Errors
    /// [`Error::Scene`] for an eye that the dome and its stars do not surround.
    pub(crate) fn check_around(&self, eye: Vec3) -> Result<()> {
        let distance_m = eye.distance(self.centre);
        if f64::from(distance_m) < innermost_star_m(self.radius_m.into()) {
            return Ok(());
        }
        Err(Error::Scene(format!(
            "the camera is {distance_m:.0} m from the middle of the scene's sky dome, outside it or among its stars: \
             sky.dome_radius_m = {}; a scene with a larger dome has room for it",
            self.radius_m
        )))
    }

    /// The sun's disc as it is drawn for a camera at `eye`: a sphere in front of the dome that spans the sun's angle, behind
    /// everything else. `None` for a sun without extent or light.
    #[must_use]
    pub fn sun_disc(&self, sun: &Sun, eye: Vec3) -> Option<Star> {
        let sine = sun.disc_sine();
        if sine <= 0.0 || sun.irradiance.max_element() <= 0.0 {
            return None;
        }
        // Along the ray towards the sun to a sphere inside the dome.
        let inside_m = self.radius_m * (1.0 - 1.1e-3 - sine) - SUN_INSET_M;
        let from_centre = eye - self.centre;
        let along = from_centre.dot(sun.direction);
        let distance_m =
            (along * along + inside_m * inside_m - from_centre.length_squared()).max(0.0).sqrt() - along;
        let radius_m = SUN_OUTLINE * sine * distance_m;
        (distance_m > 0.0).then(|| Star { centre: eye + distance_m * sun.direction, radius_m })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_azimuth_is_a_compass_angle() {
        let towards = |elevation, azimuth| Sun::new(elevation, azimuth, 0.53, Vec3::ONE).direction;
        assert!(towards(0.0, 0.0).distance(Vec3::Y) < 1e-6);
        assert!(towards(0.0, 90.0).distance(Vec3::X) < 1e-6);
        assert!(towards(90.0, 33.0).distance(Vec3::Z) < 1e-6);
        let nominal = towards(17.0, 120.0);
        assert!(nominal.x > 0.0 && nominal.y < 0.0, "behind the camera, to the right");
        assert!((nominal.z - 0.292_371_7).abs() < 1e-6);
        for sun in [Sun::new(17.0, 120.0, 0.53, Vec3::ONE), Sun::new(90.0, 0.0, 0.53, Vec3::ONE)] {
            let [right, up] = sun.right_and_up();
            assert!(right.cross(up).distance(sun.direction) < 1e-5 && right.z.abs() < 1e-5);
        }
        let penumbra_per_metre = 2.0 * Sun::new(17.0, 0.0, 0.53, Vec3::ONE).tan_half_angle();
        assert!((penumbra_per_metre - 0.00925).abs() < 1e-5);
    }

    #[test]
    fn rays_from_the_lower_limb_fall_by_its_elevation() {
        for (elevation_deg, diameter_deg) in
            [(3.0_f64, 0.53), (17.0, 0.53), (45.0, 5.0), (85.0, 5.0), (87.5, 5.0)]
        {
            let slope = f64::from(Sun::new(elevation_deg, 40.0, diameter_deg, Vec3::ONE).lower_limb_slope());
            let expected = libm::tan((elevation_deg - 0.5 * diameter_deg).to_radians());
            assert!(
                (slope / expected - 1.0).abs() < 1e-5,
                "{elevation_deg}, {diameter_deg}: {slope}, not {expected}"
            );
        }
        assert!(Sun::new(1.0, 40.0, 5.0, Vec3::ONE).lower_limb_slope() > 0.0);
    }

    /// The mean over the disc is the irradiance over the solid angle, in each channel; at 60 degrees the green is that of Neckel and
    /// Labs 1994 at 550 nm, 0.70 of the centre's, and the limb is redder than the centre.
    #[test]
    fn limb_darkening_keeps_the_irradiance() {
        let sun = Sun::new(17.0, 120.0, 0.53, Vec3::ONE);
        let rings = 20_000_u16;
        let sum: Vec3 =
            (0..rings).map(|k| sun.radiance_at((1.0 - (f32::from(k) + 0.5) / f32::from(rings)).sqrt())).sum();
        let mean = sum / f32::from(rings) / sun.disc_radiance();
        assert!((mean - 1.0).abs().max_element() < 1e-3, "{mean}");
        let relative = |cosine: f32| sun.radiance_at(cosine) / sun.radiance_at(1.0);
        assert!((relative(0.5).y - 0.70).abs() < 0.01, "{}", relative(0.5));
        assert!(relative(0.2).x > relative(0.2).y && relative(0.2).y > relative(0.2).z);
        for (tilt, cosine) in [(0.0, 1.0), (0.5, 0.75_f32.sqrt()), (0.999, 0.0447), (1.2, 0.0)] {
            let [right, _] = sun.right_and_up();
            let sine = tilt * sun.disc_sine();
            let ray = (1.0 - sine * sine).sqrt() * sun.direction + sine * right;
            assert!((sun.cosine_along(ray) - cosine).abs() < 2e-3, "{tilt}: {}", sun.cosine_along(ray));
        }
    }

    #[test]
    fn stars_lie_inside_the_dome_above_the_horizon_in_front() {
        let params = Params::draw_default(3);
        let centre = Vec3::new(1.0, -90.0, 0.5);
        let sky = Sky::build(&Streams::new(3), &params, centre);
        assert_eq!(sky.stars.len(), 220);
        for star in &sky.stars {
            let offset = star.centre - centre;
            assert!((offset.length() - 582.0).abs() < 0.01);
            assert!(offset.y > 0.0 && offset.z > 0.0);
            assert!((0.5..1.1).contains(&star.radius_m));
        }
    }
}
