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

// Distance from sunlit ground up to which a point receives all the light that ground near by gives in the open, metres.
const NEAR_SUNLIT_M: f32 = 0.1;
// Light on a rock over that of the first bounce from the ground by the fit: what its own facets and further bounces add, and what the law of
// reflection gives for a mean direction in place of many, in path-traced scenes.
const BEYOND_FIRST_BOUNCE: f32 = 1.25;
// Rise of the light that ground receives from higher ground.
const RISE_OF_BOUNCE: f32 = 0.15;

// Light on a rock's surface from its surroundings. Level ground reflects by Hapke's law, brightest when viewed along the sunlight. `height`
// is that of the point above the ground as a fraction of the rock's: the rock's own shadow is what its foot sees. The polynomials are
// fitted by src/scene/bounce.rs.
fn bounce_on_rock(
    instance: Instance,
    ground: vec3<f32>,
    normal: vec3<f32>,
    height: f32,
    sun_horizontal: vec2<f32>,
) -> BouncedLight {
    let z = max(normal.z, -0.6);
    let powers = azimuth_powers(normal, sun_horizontal);
    let h = clamp(height, 0.0, 1.0);
    let line = powers * frame.bounce_on_rock[0] + h * (powers * frame.bounce_on_rock[1])
        + (h * h) * (powers * frame.bounce_on_rock[2]);
    let root = dot(line, vec4(1.0, z, z * z, z * z * z));
    // Between the sides that a normal lies between, by the squares of the cosines.
    let across = vec2(dot(normal.xy, sun_horizontal), dot(normal.xy, vec2(-sun_horizontal.y, sun_horizontal.x)));
    let square = dot(across, across);
    let shares = across * across / max(square, 1.0e-6);
    let is_positive = across > vec2(0.0);
    let in_open = 0.5 * (1.0 - normal.z) * root * root;
    let below = in_open * dot(shares, select(instance.lit_below.zw, instance.lit_below.xy, is_positive));
    let on_side = dot(shares, select(instance.lit_beside.zw, instance.lit_beside.xy, is_positive));
    let beside = max(sqrt(square) * on_side + normal.z * instance.lit_on_top, 0.0);
    // Of what the face sees below, the ground on the far side from the sun is brightest.
    let way_below = unit(vec3(0.6 * normal.xy - 0.3 * sun_horizontal, -0.3 + 0.2 * normal.z));
    let way_beside = unit(vec3(normal.xy + 1.0e-9, 0.0));
    let scale = (BEYOND_FIRST_BOUNCE * PI) * ground;
    return BouncedLight((below + beside) * scale, scale.g * (below * way_below + beside * way_beside));
}

// Fraction of the light from near ground that is left this far inside the shadow of a rock, metres, under a sun with this sine of
// elevation. To sunlit ground it is about as far across the sun, and further by one over the sine along it: the geometric mean counts. The
// part of the view that higher ground fills goes with the square of its slope, and slopes fall with about the fourth root of the
// distance over which they are measured (Hurst exponent 0.77: Guo et al. 2021); nearer ground hides some of it. Rays traced from
// soil in the shadow of rocks find a power of 3/4.
fn left_in_shadow(depth_m: f32, sine: f32) -> f32 {
    let root = sqrt(NEAR_SUNLIT_M / max(depth_m * inverseSqrt(max(sine, 0.01)), NEAR_SUNLIT_M));
    return root * sqrt(root);
}

// Light on the ground from sunlit ground. That of ground near by goes by a law for all places, times what is left of it in a shadow;
// in the shade that of all other ground goes by the map. The sun's light is visible to the fraction `sunlit`. Where nothing casts a
// shadow the map is left out: there it would cost llvmpipe as much as where something does.
fn bounce_on_ground(
    ground: vec3<f32>,
    position: vec3<f32>,
    normal: vec3<f32>,
    sun_horizontal: vec2<f32>,
    sunlit: f32,
    left: f32,
) -> BouncedLight {
    let sine = sqrt(max(1.0 - normal.z * normal.z, 0.0));
    let root = dot(azimuth_powers(normal, sun_horizontal) * frame.bounce_on_ground, vec3(1.0, sine, sine * sine));
    let near = root * root * vec4(unit(vec3(-sun_horizontal, RISE_OF_BOUNCE)), 1.0);
    var relative = near;
    if SHADOW_SOURCES != 0u && sunlit < 1.0 {
        let far = light_of_ground(position, normal, sun_horizontal);
        relative = sunlit * near + (1.0 - sunlit) * (far.light + left * far.near_sunlit * near);
    }
    let irradiance = (PI * relative.w) * ground;
    return BouncedLight(irradiance, (PI * ground.g) * relative.xyz);
}

// Powers 0 to 3 of the cosine of the azimuth between a normal and the sun.
fn azimuth_powers(normal: vec3<f32>, sun_horizontal: vec2<f32>) -> vec4<f32> {
    let per_length = inverseSqrt(max(1.0 - normal.z * normal.z, 1.0e-6));
    let u = clamp(dot(normal.xy, sun_horizontal) * per_length, -1.0, 1.0);
    return powers_of(u);
}

// Powers 0 to 3.
fn powers_of(x: f32) -> vec4<f32> {
    return vec4(1.0, x, x * x, x * x * x);
}

// Irradiance from a sky of even radiance.
fn sky_irradiance(sky: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return PI * sky * 0.5 * (1.0 + normal.z);
}
