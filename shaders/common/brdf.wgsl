// Diffuse reflection of rough surfaces.

const PI: f32 = 3.14159265;

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
    let a = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * PI)) * roughness);
    return a * (1.0 + roughness * s_over_t) / PI;
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

// Irradiance of an even sky of radiance `sky`.
fn sky_light(sky: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return PI * sky * 0.5 * (1.0 + normal.z);
}
