// Solid texture of the soil's grains: the roughness and mottling of rocks (rock_texture.wgsl), in octaves that follow from the
// size of the grain. CPU counterpart: src/render/lighting/grain_texture_host.rs, which explains the constants.

const GRAIN_TEXTURE_OCTAVES: u32 = 3u;
const GRAIN_CELLS_PER_DIAMETER: f32 = 4.0;
const GRAIN_MIN_SHADE: f32 = 0.25;

// What the eye sees of a grain: the point relative to its centre and the ground there, metres; what sets its texture apart, and
// how strong its mottling is.
struct GrainSurface {
    point: vec3<f32>,
    diameter_m: f32,
    seed: u32,
    mottling: f32,
}

// Adds the texture of a grain that fills a sample; samples are `across_m` apart across the view.
fn add_grain_texture(before: GroundDetail, grain: GrainSurface, across_m: f32) -> GroundDetail {
    var detail = before;
    var cell_m = grain.diameter_m / GRAIN_CELLS_PER_DIAMETER;
    var gradient = vec3(0.0);
    var shade = 1.0;
    for (var k = 0u; k < GRAIN_TEXTURE_OCTAVES; k++) {
        let share = sample_share(cell_m, across_m);
        if share == 0.0 { break; }
        let noise = value_noise(grain.point / cell_m, grain.seed + k * GRAIN_THIRD_KEY);
        gradient += share * ROUGHNESS_SLOPE * noise.xyz;
        shade += share * grain.mottling * noise.w;
        cell_m *= 0.5;
    }
    let normal = unit(vec3(-detail.slope, 1.0));
    let rough = normal - gradient + normal * dot(normal, gradient);
    let slope = -rough.xy / max(rough.z, length(rough.xy) / GRAIN_MAX_SLOPE);
    detail.slope = select(detail.slope, slope, sample_share(grain.diameter_m / GRAIN_CELLS_PER_DIAMETER, across_m) > 0.0);
    detail.albedo *= max(shade, GRAIN_MIN_SHADE);
    return detail;
}
