// Diffuse reflection of rough surfaces.

const PI: f32 = 3.14159265;
// Divisions are many times as long as products for a driver that runs on the CPU.
const PER_PI: f32 = 0.31830989;

// Reflected radiance per unit of irradiance x cosine, of a surface of unit albedo: Fujii's form of Oren and
// Nayar's lobe, normalised ("FON" in Portsmouth, Kutz and Hill 2025, "EON: A practical energy-preserving rough
// diffuse BRDF", section 2). Roughness 0 is Lambert's 1/pi. The cosines are those of the normal with the
// directions to the light and to the eye.
//
// The lobe's own roughness is half of the material's: level ground at 0.96 that is seen against a sun 17 degrees
// high is then half as bright as Lambert's, as Hapke's model with lunar parameters gives it (0.41 to 0.55).
fn rough_diffuse(material_roughness: f32, cos_light: f32, cos_eye: f32, light_dot_eye: f32) -> f32 {
    let roughness = 0.5 * material_roughness;
    let s = light_dot_eye - cos_light * cos_eye;
    let s_over_t = select(s, s / max(max(cos_light, cos_eye), 1.0e-4), s > 0.0);
    return (1.0 + roughness * s_over_t) / (PI + (0.5 * PI - 2.0 / 3.0) * roughness);
}

// Irradiance, on a surface of this normal, of light that sunlit ground around it bounces (radiance `ground`).
//
// Level ground of even radiance L fills the share (1 - n.z) / 2 of the surface's view and gives pi L of it
// (the view factor of a tilted plane, as for tilted solar collectors: Liu and Jordan 1963). A face turned from
// the sun looks at the thing's own shadow first: of the ground that a wall as high as it is wide sees behind
// itself at a low sun, about 0.4 is lit.
fn ground_bounce(ground: vec3<f32>, normal: vec3<f32>, towards_sun: vec2<f32>) -> vec3<f32> {
    let facing = 0.5 + 0.5 * dot(normal.xy, towards_sun);
    return PI * ground * 0.5 * (1.0 - normal.z) * mix(0.4, 1.0, facing);
}

// The same where the ground reflects by Hapke's law, brightest as seen along the sun's light (src/scene/bounce.rs).
fn bounce_on_rock(ground: vec3<f32>, normal: vec3<f32>, towards_sun: vec2<f32>) -> vec3<f32> {
    let z = max(normal.z, -0.6);
    let root = dot(azimuth_powers(normal, towards_sun) * frame.bounce_on_rock, vec4(1.0, z, z * z, z * z * z));
    return PI * ground * 0.5 * (1.0 - normal.z) * root * root;
}

// Onto ground, of which the part `sunlit` of what lies around and no higher is lit; what rises above it is.
fn bounce_on_ground(ground: vec3<f32>, normal: vec3<f32>, towards_sun: vec2<f32>, sunlit: f32) -> vec3<f32> {
    let sine = sqrt(max(1.0 - normal.z * normal.z, 0.0));
    let powers = azimuth_powers(normal, towards_sun);
    let in_sun = dot(powers * frame.bounce_on_ground, vec3(1.0, sine, sine * sine));
    let in_shadow = dot(powers * frame.bounce_in_shadow, vec3(1.0, sine, sine * sine));
    return PI * ground * mix(in_shadow * in_shadow, in_sun * in_sun, sunlit);
}

// Powers 0 to 3 of the cosine of a normal's azimuth from the sun's.
fn azimuth_powers(normal: vec3<f32>, towards_sun: vec2<f32>) -> vec4<f32> {
    let across = inverseSqrt(max(1.0 - normal.z * normal.z, 1.0e-6));
    let u = clamp(dot(normal.xy, towards_sun) * across, -1.0, 1.0);
    return vec4(1.0, u, u * u, u * u * u);
}

// Irradiance of an even sky of radiance `sky`.
fn sky_light(sky: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return PI * sky * 0.5 * (1.0 + normal.z);
}

// The laws of reflection, by their place in `Law::ALL` (src/scene/photometry.rs).
const LAMBERT: u32 = 0u;
const OREN_NAYAR: u32 = 1u;
const LOMMEL_SEELIGER: u32 = 2u;
const HAPKE: u32 = 3u;

// Reflected radiance, per unit of irradiance of a surface that faces the sun, of a surface of unit albedo (of Hapke's law:
// of a colour that is divided by what the law gives at normal incidence and zero phase). From the cosines of incidence,
// emission and phase.
fn reflected(law: u32, roughness: f32, surge: f32, cos_light: f32, cos_eye: f32, cos_phase: f32) -> f32 {
    if law == HAPKE { return PER_PI * hapke(surge, cos_light, cos_eye, cos_phase); }
    if law == LOMMEL_SEELIGER { return (2.0 * PER_PI) * cos_light / max(cos_light + cos_eye, 1.0e-4); }
    if law == OREN_NAYAR { return cos_light * rough_diffuse(roughness, cos_light, cos_eye, cos_phase); }
    return PER_PI * cos_light;
}

// Largest angle from the normal that Hapke's shadowing is reckoned at: its terms run away at 90 degrees.
const LEAST_COSINE: f32 = 0.0087265355;

// Hapke's radiance factor (`Hapke::radiance_factor` in src/scene/photometry.rs, where the sources stand).
fn hapke(surge_height: f32, cos_light: f32, cos_eye: f32, cos_phase: f32) -> f32 {
    let mu0 = clamp(cos_light, LEAST_COSINE, 1.0);
    let mu = clamp(cos_eye, LEAST_COSINE, 1.0);
    let g = clamp(cos_phase, -1.0, 1.0);
    // Roughness.
    let tan_bar = max(light.hapke_tan_theta_bar, 1.0e-4);
    let chi = inverseSqrt(1.0 + PI * tan_bar * tan_bar);
    let sin0 = sqrt(1.0 - mu0 * mu0);
    let sin1 = sqrt(1.0 - mu * mu);
    let cos_azimuth = clamp((g - mu0 * mu) / max(sin0 * sin1, 1.0e-6), -1.0, 1.0);
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
    // The larger of the two angles leads.
    let light_leads = mu0 <= mu;
    let below = 2.0 - select(e1_eye, e1_light, light_leads) - share * select(e1_light, e1_eye, light_leads);
    let lead = select(e2_eye, e2_light, light_leads);
    let other = select(e2_light, e2_eye, light_leads);
    let per_below = 1.0 / below;
    let own = (lead - half_square * other) * per_below;
    let across = (cos_azimuth * lead + half_square * other) * per_below;
    let effective0 = max(chi * (mu0 + sin0 * tan_bar * select(across, own, light_leads)), 1.0e-6);
    let effective = max(chi * (mu + sin1 * tan_bar * select(own, across, light_leads)), 1.0e-6);
    let per_eta_eye = 1.0 / eta_eye;
    let lit_share = mu0 / eta_light;
    let nearer = select(lit_share, mu * per_eta_eye, light_leads);
    let shadowing = effective * per_eta_eye * lit_share * chi / (1.0 - f + f * chi * nearer);
    // Grains.
    let b = light.hapke_b;
    let square = b * b;
    let back_root = inverseSqrt(1.0 - 2.0 * b * g + square);
    let forth_root = inverseSqrt(1.0 + 2.0 * b * g + square);
    let back = (1.0 - square) * back_root * back_root * back_root;
    let forth = (1.0 - square) * forth_root * forth_root * forth_root;
    let phase = 0.5 * (1.0 + light.hapke_c) * back + 0.5 * (1.0 - light.hapke_c) * forth;
    let tan_half_phase = sqrt((1.0 - g) / max(1.0 + g, 1.0e-9));
    let surge = 1.0 + surge_height / (1.0 + tan_half_phase / light.hapke_h_s);
    return 0.25 * light.hapke_w * effective0 / (effective0 + effective)
        * (phase * surge + chandrasekhar(effective0) * chandrasekhar(effective) - 1.0) * shadowing;
}

fn chandrasekhar(x: f32) -> f32 {
    let gamma = sqrt(1.0 - light.hapke_w);
    let r0 = (1.0 - gamma) / (1.0 + gamma);
    return 1.0 / (1.0 - light.hapke_w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * log(1.0 + 1.0 / x)));
}
