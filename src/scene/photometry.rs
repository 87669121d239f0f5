//! Photometric functions of ground and rocks; the shader counterpart is `shaders/common/brdf.wgsl`.
//!
//! Must not know: which surface is shaded.

use glam::Vec3;

use crate::params::{Knob, Params};

/// Largest incidence and emission angle in Hapke's roughness correction, degrees: it diverges at 90.
pub const GRAZING_DEG: f64 = 89.5;

/// A photometric function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Lambertian: the radiance is the same in all directions.
    Lambert,
    /// A rough diffuse surface (Oren and Nayar 1994).
    OrenNayar,
    /// Single scattering in a semi-infinite medium of dark particles (Lommel-Seeliger).
    LommelSeeliger,
    /// Hapke's model (Hapke 2012).
    Hapke,
}

impl Law {
    /// Every law with its name in `photometry.law`. The index is the law's number in the shader.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Lambert, "lambert"),
        (Self::OrenNayar, "oren_nayar"),
        (Self::LommelSeeliger, "lommel_seeliger"),
        (Self::Hapke, "hapke"),
    ];
}

/// Parameters of Hapke's model as in the LROC WAC maps (Sato et al. 2014, doi 10.1002/2013JE004580; Hapke 2012), without
/// porosity and coherent backscatter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hapke {
    /// Single-scattering albedo.
    pub w: f64,
    /// Asymmetry parameter of both lobes of the phase function.
    pub b: f64,
    /// Weight of the backward lobe.
    pub c: f64,
    /// Amplitude of the shadow-hiding opposition effect.
    pub b_s0: f64,
    /// Angular width of the opposition effect.
    pub h_s: f64,
    /// Mean slope angle of the unresolved roughness, degrees.
    pub theta_bar_deg: f64,
}

/// The photometric functions of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photometry {
    /// The law of ground and rocks.
    pub law: Law,
    /// Hapke's parameters for the ground.
    pub soil: Hapke,
    /// Amplitude of the opposition effect on rocks.
    pub rock_b_s0: f64,
}

impl Default for Photometry {
    /// The nominal stage's: Oren-Nayar; the Hapke parameters are those of Sato et al. 2014 at 643 nm.
    fn default() -> Self {
        let soil =
            Hapke { w: 0.32357, b: 0.23955, c: 0.30452, b_s0: 1.80238, h_s: 0.07145, theta_bar_deg: 23.657 };
        Self { law: Law::OrenNayar, soil, rock_b_s0: 0.85 }
    }
}

impl Photometry {
    /// The photometric functions of these parameters.
    #[must_use]
    pub fn build(params: &Params) -> Self {
        let word = params.text(Knob::PhotometryLaw);
        let law = Law::ALL.iter().find(|(_, name)| *name == word).map_or(Law::Lambert, |(law, _)| *law);
        let number = |knob| params.number(knob);
        Self {
            law,
            soil: Hapke {
                w: number(Knob::HapkeW),
                b: number(Knob::HapkeB),
                c: number(Knob::HapkeC),
                b_s0: number(Knob::HapkeBS0),
                h_s: number(Knob::HapkeHS),
                theta_bar_deg: number(Knob::HapkeThetaBarDeg),
            },
            rock_b_s0: number(Knob::HapkeRockBS0),
        }
    }

    /// Hapke's parameters with another amplitude of the opposition effect.
    #[must_use]
    pub fn with_surge(&self, b_s0: f64) -> Hapke {
        Hapke { b_s0, ..self.soil }
    }

    /// Radiance factor at normal incidence and zero phase of a surface of unit albedo; the albedo is divided by it.
    #[must_use]
    pub fn at_normal(&self, b_s0: f64) -> f64 {
        match self.law {
            Law::Hapke => self.with_surge(b_s0).radiance_factor(1.0, 1.0, 1.0),
            Law::Lambert | Law::OrenNayar | Law::LommelSeeliger => 1.0,
        }
    }

    /// Reflectance of the ground under uniform illumination, before division by [`Self::at_normal`]; approximated by that of
    /// light whose incidence has a cosine of 0.5.
    #[must_use]
    pub fn diffuse_reflectance(&self) -> f64 {
        self.exitance(0.5) / 0.5 * self.at_normal(self.soil.b_s0)
    }

    /// Exitance of level ground of unit albedo, relative to the sun's irradiance at normal incidence; `cos_light` is the sine
    /// of the sun's elevation.
    #[must_use]
    pub fn exitance(&self, cos_light: f64) -> f64 {
        match self.law {
            // The lobe of Oren and Nayar is taken for Lambert's.
            Law::Lambert | Law::OrenNayar => cos_light,
            // The integral of 2 mu0 / (mu0 + mu) over the hemisphere, with the cosine of emission mu. It exceeds the light that falls on ground of
            // unit albedo: the law holds for dark soil.
            Law::LommelSeeliger => {
                4.0 * cos_light * (1.0 - cos_light * libm::log((1.0 + cos_light) / cos_light.max(1e-9)))
            }
            Law::Hapke => self.soil.exitance(cos_light) / self.at_normal(self.soil.b_s0),
        }
    }
}

impl Hapke {
    /// Exitance of level ground, relative to the sun's irradiance at normal incidence.
    fn exitance(&self, cos_light: f64) -> f64 {
        let (rings, spokes) = (12, 24);
        let mut sum = 0.0;
        let sin_light = (1.0 - cos_light * cos_light).max(0.0).sqrt();
        for ring in 0..rings {
            // Uniform in the squared cosine: equal weights for the exitance.
            let cos_eye = ((f64::from(ring) + 0.5) / f64::from(rings)).sqrt();
            let sin_eye = (1.0 - cos_eye * cos_eye).sqrt();
            for spoke in 0..spokes {
                let azimuth = std::f64::consts::TAU * (f64::from(spoke) + 0.5) / f64::from(spokes);
                let cos_phase = cos_light * cos_eye + sin_light * sin_eye * libm::cos(azimuth);
                sum += self.radiance_factor(cos_light, cos_eye, cos_phase);
            }
        }
        sum / f64::from(rings * spokes)
    }

    /// Radiance factor I/F (pi times the radiance over the irradiance at normal incidence) from the cosines of the incidence,
    /// emission and phase angles.
    #[must_use]
    pub fn radiance_factor(&self, cos_light: f64, cos_eye: f64, cos_phase: f64) -> f64 {
        let min_cosine = libm::cos(GRAZING_DEG.to_radians());
        if cos_light <= 0.0 || cos_eye <= 0.0 {
            return 0.0;
        }
        let (mu0, mu) = (cos_light.clamp(min_cosine, 1.0), cos_eye.clamp(min_cosine, 1.0));
        let cos_phase = cos_phase.clamp(-1.0, 1.0);
        let (effective0, effective, shadowing) = self.roughness(mu0, mu, cos_phase);
        let tan_half_phase = ((1.0 - cos_phase) / (1.0 + cos_phase).max(1e-9)).sqrt();
        let surge = 1.0 + self.b_s0 / (1.0 + tan_half_phase / self.h_s);
        self.w / 4.0 * effective0 / (effective0 + effective)
            * (self.phase(cos_phase) * surge + self.h(effective0) * self.h(effective) - 1.0)
            * shadowing
    }

    /// Phase function of the grains: double Henyey-Greenstein, with a mean of 1 over the sphere.
    #[must_use]
    pub fn phase(&self, cos_phase: f64) -> f64 {
        let (b, square) = (self.b, self.b * self.b);
        let lobe = |sign: f64| (1.0 - square) / libm::pow(1.0 + sign * 2.0 * b * cos_phase + square, 1.5);
        0.5 * (1.0 + self.c) * lobe(-1.0) + 0.5 * (1.0 - self.c) * lobe(1.0)
    }

    /// Chandrasekhar's H function in the approximation of Hapke 2002.
    #[must_use]
    pub fn h(&self, x: f64) -> f64 {
        let gamma = (1.0 - self.w).sqrt();
        let r0 = (1.0 - gamma) / (1.0 + gamma);
        1.0 / (1.0 - self.w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * libm::log((1.0 + x) / x)))
    }

    /// Effective cosines and shadowing function of a rough surface (Hapke 1984).
    fn roughness(&self, mu0: f64, mu: f64, cos_phase: f64) -> (f64, f64, f64) {
        let tan_bar = libm::tan(self.theta_bar_deg.to_radians());
        if tan_bar < 1e-4 {
            return (mu0, mu, 1.0);
        }
        let pi = std::f64::consts::PI;
        let chi = 1.0 / (1.0 + pi * tan_bar * tan_bar).sqrt();
        let (sin0, sin) = ((1.0 - mu0 * mu0).sqrt(), (1.0 - mu * mu).sqrt());
        let cos_azimuth = ((cos_phase - mu0 * mu) / (sin0 * sin).max(1e-6)).clamp(-1.0, 1.0);
        let azimuth = libm::acos(cos_azimuth);
        let half_square = 0.5 * (1.0 - cos_azimuth);
        let e1 = |cos: f64, sin: f64| libm::exp(-2.0 / pi * cos / (sin.max(1e-6) * tan_bar));
        let e2 = |cos: f64, sin: f64| {
            let cot = cos / (sin.max(1e-6) * tan_bar);
            libm::exp(-cot * cot / pi)
        };
        let (e1_light, e2_light) = (e1(mu0, sin0), e2(mu0, sin0));
        let (e1_eye, e2_eye) = (e1(mu, sin), e2(mu, sin));
        let eta_light = chi * (mu0 + sin0 * tan_bar * e2_light / (2.0 - e1_light));
        let eta_eye = chi * (mu + sin * tan_bar * e2_eye / (2.0 - e1_eye));
        let f = libm::exp(-2.0 * ((1.0 - cos_azimuth) / (1.0 + cos_azimuth).max(1e-9)).sqrt());
        let share = azimuth / pi;
        // The formulas differ by which of the two angles is larger.
        let (light_leads, below) = if mu0 <= mu {
            (true, 2.0 - e1_light - share * e1_eye)
        } else {
            (false, 2.0 - e1_eye - share * e1_light)
        };
        let (lead, other) = if light_leads { (e2_light, e2_eye) } else { (e2_eye, e2_light) };
        let own = (lead - half_square * other) / below;
        let across = (cos_azimuth * lead + half_square * other) / below;
        let (light_term, eye_term) = if light_leads { (own, across) } else { (across, own) };
        let effective0 = chi * (mu0 + sin0 * tan_bar * light_term);
        let effective = chi * (mu + sin * tan_bar * eye_term);
        let nearer = if light_leads { mu / eta_eye } else { mu0 / eta_light };
        let shadowing = effective / eta_eye * (mu0 / eta_light) * chi / (1.0 - f + f * chi * nearer);
        (effective0.max(1e-6), effective.max(1e-6), shadowing)
    }
}

/// Linear RGB of an albedo with this mean and these channel ratios, darker if its largest channel would be above 1.
#[must_use]
pub fn tinted(mean: f64, red_over_green: f64, blue_over_green: f64) -> Vec3 {
    let of_mean = 3.0 * mean / (1.0 + red_over_green + blue_over_green);
    let green = of_mean.min(1.0 / red_over_green.max(blue_over_green).max(1.0));
    Vec3::new((green * red_over_green) as f32, green as f32, (green * blue_over_green) as f32)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may be computed with std's functions")]
mod tests {
    use super::*;

    const WAC: Hapke =
        Hapke { w: 0.32357, b: 0.23955, c: 0.30452, b_s0: 1.80238, h_s: 0.07145, theta_bar_deg: 23.657 };

    fn at(hapke: &Hapke, light_deg: f64, eye_deg: f64, azimuth_deg: f64) -> f64 {
        let (i, e, psi) = (light_deg.to_radians(), eye_deg.to_radians(), azimuth_deg.to_radians());
        let cos_phase = i.cos() * e.cos() + i.sin() * e.sin() * psi.cos();
        hapke.radiance_factor(i.cos(), e.cos(), cos_phase)
    }

    /// Computed with an independent implementation, which agrees with the `hapke` plugin of eradiate-mitsuba 0.5.0 to five
    /// digits. The two values at emission 0 are published with fewer.
    #[test]
    fn radiance_factors_match_independent_values() {
        for (i, e, psi, surge, expected) in [
            (30.0, 10.0, 0.0, 1.80238, 0.09489),
            (30.0, 60.0, 0.0, 1.80238, 0.10358),
            (73.0, 80.0, 0.0, 1.80238, 0.14561),
            (73.0, 80.0, 90.0, 1.80238, 0.02389),
            (73.0, 80.0, 180.0, 1.80238, 0.01130),
            (73.0, 45.0, 120.0, 1.80238, 0.01937),
            (10.0, 70.0, 40.0, 1.80238, 0.07594),
            (30.0, 0.0, 0.0, 1.80238, 0.0812),
            (60.0, 0.0, 0.0, 1.80238, 0.0373),
            (30.0, 10.0, 0.0, 1.0, 0.08196),
            (30.0, 60.0, 0.0, 1.0, 0.09234),
            (73.0, 80.0, 0.0, 1.0, 0.11572),
            (73.0, 80.0, 90.0, 1.0, 0.02289),
            (73.0, 80.0, 180.0, 1.0, 0.01117),
            (73.0, 45.0, 120.0, 1.0, 0.01869),
            (10.0, 70.0, 40.0, 1.0, 0.07144),
        ] {
            let found = at(&Hapke { b_s0: surge, ..WAC }, i, e, psi);
            assert!((found / expected - 1.0).abs() < 2e-3, "({i}, {e}, {psi}): {found}, not {expected}");
        }
    }

    #[test]
    fn reflection_is_reciprocal_on_both_branches() {
        for (i, e, psi) in [(20.0, 70.0, 30.0), (70.0, 20.0, 30.0), (55.0, 56.0, 140.0), (85.0, 10.0, 90.0)] {
            let (there, back) = (at(&WAC, i, e, psi), at(&WAC, e, i, psi));
            let cos = |angle: f64| angle.to_radians().cos();
            assert!((there / cos(i) / (back / cos(e)) - 1.0).abs() < 1e-6, "({i}, {e}, {psi})");
        }
    }

    #[test]
    fn phase_function_has_mean_one_and_h_its_limit() {
        let n = 20_000;
        for (b, c) in [(0.24, 0.30), (0.2, -0.1), (0.3, 0.45)] {
            let hapke = Hapke { b, c, ..WAC };
            let sum: f64 = (0..n).map(|k| hapke.phase(2.0 * (f64::from(k) + 0.5) / f64::from(n) - 1.0)).sum();
            assert!((sum / f64::from(n) - 1.0).abs() < 1e-6, "b {b}, c {c}");
        }
        assert!((Hapke { w: 1.0, ..WAC }.h(1.0) / 2.9078 - 1.0).abs() < 0.01);
    }

    #[test]
    fn level_ground_has_the_contrast_of_a_panorama() {
        // Sun 17 degrees high, viewing 10 degrees down: 13 times brighter away from the sun than towards it.
        let around: Vec<f64> = (0..=36).map(|k| at(&WAC, 73.0, 80.0, f64::from(k) * 5.0)).collect();
        let (low, high) =
            around.iter().fold((f64::MAX, 0.0_f64), |(low, high), v| (low.min(*v), high.max(*v)));
        assert!((high / low / 13.0 - 1.0).abs() < 0.15, "{}", high / low);
    }

    #[test]
    fn no_law_reflects_more_light_than_it_receives() {
        for (law, _) in Law::ALL {
            let photometry = Photometry { law, soil: WAC, rock_b_s0: 0.8 };
            // Lommel and Seeliger's law is one of dark soil.
            let albedo = if law == Law::LommelSeeliger { 0.3 } else { 1.0 };
            for sine in [0.1, 0.3, 0.8, 1.0] {
                let exitance = albedo * photometry.exitance(sine);
                assert!(exitance > 0.0 && exitance <= 1.3 * sine, "{law:?} at {sine}: {exitance}");
            }
        }
    }

    /// The radiance of `reflected` in `common/brdf.wgsl`, summed over directions of equal projected solid angle.
    #[test]
    fn lommel_and_seeligers_exitance_is_the_sum_of_its_radiance() {
        let photometry = Photometry { law: Law::LommelSeeliger, soil: WAC, rock_b_s0: 0.8 };
        for sine in [0.0, 0.05, 0.29, 0.7, 1.0] {
            let radiance = |k: u32| 2.0 * sine / (sine + ((f64::from(k) + 0.5) / 1e5).sqrt());
            let expected = (0..100_000).map(radiance).sum::<f64>() / 1e5;
            let exitance = photometry.exitance(sine);
            assert!((exitance - expected).abs() < 1e-4, "{exitance}, not {expected}, at {sine}");
        }
    }
}
