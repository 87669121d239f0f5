// Hapke's law of reflection, with the parameters of the LROC WAC maps (Sato et al. 2014, "Resolved Hapke parameter maps of
// the Moon"). CPU counterpart: `Hapke` in src/scene/photometry.rs.

// Least cosine of incidence and emission that the roughness terms take, half a degree from grazing: they diverge at 90
// degrees.
const MIN_COSINE: f32 = 0.0087265355;

struct HapkeRoughness {
    // Effective cosines of incidence and emission.
    mu0: f32,
    mu: f32,
    shadowing: f32,
}

// Radiance factor: pi times the radiance over the irradiance of a surface that faces the sun (Hapke 2012, "Theory of
// Reflectance and Emittance Spectroscopy", 2nd ed.), without porosity and coherent backscatter.
fn hapke(surge_height: f32, cos_light: f32, cos_eye: f32, cos_phase: f32) -> f32 {
    let mu0 = clamp(cos_light, MIN_COSINE, 1.0);
    let mu = clamp(cos_eye, MIN_COSINE, 1.0);
    let g = clamp(cos_phase, -1.0, 1.0);
    let rough = hapke_roughness(mu0, mu, g);
    // Shadow-hiding opposition surge.
    let tan_half_phase = sqrt((1.0 - g) / max(1.0 + g, 1.0e-9));
    let surge = 1.0 + surge_height / (1.0 + tan_half_phase / light.hapke_h_s);
    return 0.25 * light.hapke_w * rough.mu0 / (rough.mu0 + rough.mu)
        * (grain_phase(g) * surge + chandrasekhar(rough.mu0) * chandrasekhar(rough.mu) - 1.0) * rough.shadowing;
}

// Macroscopic roughness (Hapke 1984, "Bidirectional Reflectance Spectroscopy 3. Correction for Macroscopic Roughness").
fn hapke_roughness(mu0: f32, mu: f32, cos_phase: f32) -> HapkeRoughness {
    let tan_bar = max(light.hapke_tan_theta_bar, 1.0e-4);
    let chi = inverseSqrt(1.0 + PI * tan_bar * tan_bar);
    let sin0 = sqrt(1.0 - mu0 * mu0);
    let sin1 = sqrt(1.0 - mu * mu);
    let cos_azimuth = clamp((cos_phase - mu0 * mu) / max(sin0 * sin1, 1.0e-6), -1.0, 1.0);
    let half_square = 0.5 * (1.0 - cos_azimuth);
    let cot0 = mu0 / (max(sin0, 1.0e-6) * tan_bar);
    let cot1 = mu / (max(sin1, 1.0e-6) * tan_bar);
    let e1_light = exp((-2.0 * PER_PI) * cot0);
    let e2_light = exp(-PER_PI * cot0 * cot0);
    let e1_eye = exp((-2.0 * PER_PI) * cot1);
    let e2_eye = exp(-PER_PI * cot1 * cot1);
    let eta_light = chi * (mu0 + sin0 * tan_bar * e2_light / (2.0 - e1_light));
    let eta_eye = chi * (mu + sin1 * tan_bar * e2_eye / (2.0 - e1_eye));
    let f = exp(-2.0 * sqrt((1.0 - cos_azimuth) / max(1.0 + cos_azimuth, 1.0e-9)));
    let share = PER_PI * acos(cos_azimuth);
    // Two cases: incidence below emission, and above.
    let light_is_steeper = mu0 <= mu;
    let below =
        2.0 - select(e1_eye, e1_light, light_is_steeper) - share * select(e1_light, e1_eye, light_is_steeper);
    let lead = select(e2_eye, e2_light, light_is_steeper);
    let other = select(e2_light, e2_eye, light_is_steeper);
    let per_below = 1.0 / below;
    let own = (lead - half_square * other) * per_below;
    let across = (cos_azimuth * lead + half_square * other) * per_below;
    let effective0 = max(chi * (mu0 + sin0 * tan_bar * select(across, own, light_is_steeper)), 1.0e-6);
    let effective = max(chi * (mu + sin1 * tan_bar * select(own, across, light_is_steeper)), 1.0e-6);
    let per_eta_eye = 1.0 / eta_eye;
    let lit_share = mu0 / eta_light;
    let nearer = select(lit_share, mu * per_eta_eye, light_is_steeper);
    let shadowing = effective * per_eta_eye * lit_share * chi / (1.0 - f + f * chi * nearer);
    return HapkeRoughness(effective0, effective, shadowing);
}

// Phase function of the grains, with a mean of 1 over the sphere: two lobes of Henyey and Greenstein 1941, "Diffuse
// Radiation in the Galaxy".
fn grain_phase(cos_phase: f32) -> f32 {
    let b = light.hapke_b;
    let square = b * b;
    let back_root = inverseSqrt(1.0 - 2.0 * b * cos_phase + square);
    let forth_root = inverseSqrt(1.0 + 2.0 * b * cos_phase + square);
    let back = (1.0 - square) * back_root * back_root * back_root;
    let forth = (1.0 - square) * forth_root * forth_root * forth_root;
    return 0.5 * (1.0 + light.hapke_c) * back + 0.5 * (1.0 - light.hapke_c) * forth;
}

// Chandrasekhar's H function, approximated (Hapke 2002, "Bidirectional Reflectance Spectroscopy 5").
fn chandrasekhar(x: f32) -> f32 {
    let gamma = sqrt(1.0 - light.hapke_w);
    let r0 = (1.0 - gamma) / (1.0 + gamma);
    return 1.0 / (1.0 - light.hapke_w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * log(1.0 + 1.0 / x)));
}
