// Direct reflection: the photometric laws. CPU counterpart: src/scene/photometry.rs.

const PI: f32 = 3.14159265;
// Multiplying by it is several times as fast as dividing on llvmpipe.
const PER_PI: f32 = 0.31830989;

// The laws, numbered as in `Law::ALL` (src/scene/photometry.rs).
const LAMBERT: u32 = 0u;
const OREN_NAYAR: u32 = 1u;
const LOMMEL_SEELIGER: u32 = 2u;
const HAPKE: u32 = 3u;

// Reflected radiance, per unit of irradiance of a surface that faces the sun, of a surface of unit albedo. (Under Hapke's
// law colours are divided by the law's value at normal incidence and zero phase.) The arguments are the cosines of
// incidence, emission and phase angle.
//
// Lommel-Seeliger: Seeliger 1887, "Zur Photometrie zerstreut reflectirender Substanzen"; normalised as Lambert's law is at
// normal incidence and emission.
fn reflected(law: u32, roughness: f32, surge_height: f32, cos_light: f32, cos_eye: f32, cos_phase: f32) -> f32 {
    if law == HAPKE { return PER_PI * hapke(surge_height, cos_light, cos_eye, cos_phase); }
    if law == LOMMEL_SEELIGER { return (2.0 * PER_PI) * cos_light / max(cos_light + cos_eye, 1.0e-4); }
    if law == OREN_NAYAR { return cos_light * rough_diffuse(roughness, cos_light, cos_eye, cos_phase); }
    return PER_PI * cos_light;
}

// BRDF of a rough diffuse surface of unit albedo: Oren and Nayar 1994, "Generalization of Lambert's Reflectance Model", in
// Fujii's form, normalised ("FON" in Portsmouth, Kutz and Hill 2025, "EON: A practical energy-preserving rough diffuse
// BRDF", section 2). Roughness 0 is Lambert's 1/pi.
//
// The lobe's own roughness is half of the material's: level ground at 0.96, seen against a sun 17 degrees high, is then half
// as bright as Lambert's, as under Hapke's law with lunar parameters (0.41 to 0.55).
fn rough_diffuse(material_roughness: f32, cos_light: f32, cos_eye: f32, cos_phase: f32) -> f32 {
    let roughness = 0.5 * material_roughness;
    let s = cos_phase - cos_light * cos_eye;
    let s_over_t = select(s, s / max(max(cos_light, cos_eye), 1.0e-4), s > 0.0);
    return (1.0 + roughness * s_over_t) / (PI + (0.5 * PI - 2.0 / 3.0) * roughness);
}
