// Indirect light: irradiance from the sky and from sunlit ground around the point. `ground` and `sky` are radiances,
// `sun_horizontal` the horizontal unit vector towards the sun.

// Irradiance from level sunlit ground. Ground of even radiance L fills the share (1 - n.z) / 2 of the surface's view and
// gives pi L of it (the view factor of a tilted plane: Liu and Jordan 1963, "The long-term average performance of flat-plate
// solar-energy collectors"). A face on the far side from the sun looks at its rock's own shadow first: of the ground that a
// wall as high as it is wide sees behind itself under a low sun, about 0.4 is lit.
fn bounce_uniform(ground: vec3<f32>, normal: vec3<f32>, sun_horizontal: vec2<f32>) -> vec3<f32> {
    let facing = 0.5 + 0.5 * dot(normal.xy, sun_horizontal);
    return PI * ground * 0.5 * (1.0 - normal.z) * mix(0.4, 1.0, facing);
}

// Irradiance of a rock's surface from ground that reflects by Hapke's law, brightest when viewed along the sunlight. The
// polynomials are fitted by src/scene/bounce.rs.
fn bounce_on_rock(ground: vec3<f32>, normal: vec3<f32>, sun_horizontal: vec2<f32>) -> vec3<f32> {
    let z = max(normal.z, -0.6);
    let powers = azimuth_powers(normal, sun_horizontal);
    let root = dot(powers * frame.bounce_on_rock, vec4(1.0, z, z * z, z * z * z));
    return PI * ground * 0.5 * (1.0 - normal.z) * root * root;
}

// Irradiance of the ground from such ground that stands higher. Of what lies around no higher than the point, the fraction
// `sunlit` is lit.
fn bounce_on_ground(ground: vec3<f32>, normal: vec3<f32>, sun_horizontal: vec2<f32>, sunlit: f32) -> vec3<f32> {
    let sine = sqrt(max(1.0 - normal.z * normal.z, 0.0));
    let powers = azimuth_powers(normal, sun_horizontal);
    let in_sun = dot(powers * frame.bounce_on_ground, vec3(1.0, sine, sine * sine));
    let in_shadow = dot(powers * frame.bounce_in_shadow, vec3(1.0, sine, sine * sine));
    return PI * ground * mix(in_shadow * in_shadow, in_sun * in_sun, sunlit);
}

// Powers 0 to 3 of the cosine of the azimuth between a normal and the sun.
fn azimuth_powers(normal: vec3<f32>, sun_horizontal: vec2<f32>) -> vec4<f32> {
    let per_length = inverseSqrt(max(1.0 - normal.z * normal.z, 1.0e-6));
    let u = clamp(dot(normal.xy, sun_horizontal) * per_length, -1.0, 1.0);
    return vec4(1.0, u, u * u, u * u * u);
}

// Irradiance from a sky of even radiance.
fn sky_irradiance(sky: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return PI * sky * 0.5 * (1.0 + normal.z);
}
