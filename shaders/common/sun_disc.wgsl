// What the sky emits: dome and stars their colour, the sun's disc less towards its limb (src/scene/sky.rs, which has the same numbers).

const LIMB_EXPONENTS: vec3<f32> = vec3(0.45568853, 0.5079091, 0.60495698);
const MIN_LIMB_COSINE: f32 = 0.05;

// Radiance of an instance in the sky along a ray, which need not be of unit length.
fn emitted_radiance(colour: vec3<f32>, disc_sine: f32, ray: vec3<f32>) -> vec3<f32> {
    if disc_sine == 0.0 { return colour; }
    let chord = ray * inverseSqrt(dot(ray, ray)) - light.sun_direction;
    let square = dot(chord, chord);
    // Square of the distance from the centre of the disc in its radii, and the cosine of the angle at which the ray leaves the sun.
    let square_radii = square * (1.0 - 0.25 * square) / (disc_sine * disc_sine);
    let cosine = max(sqrt(max(1.0 - square_radii, 0.0)), MIN_LIMB_COSINE);
    let radiance = colour * (1.0 + 0.5 * LIMB_EXPONENTS) * pow(vec3(cosine), LIMB_EXPONENTS);
    return radiance * (MAX_STORED_RADIANCE / max(MAX_STORED_RADIANCE, max(radiance.x, max(radiance.y, radiance.z))));
}
