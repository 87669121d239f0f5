// Sun occlusion by the terrain. The horizon map tells, per point of the ground, how high a point above it must be to see
// each limb of the sun past all other ground (Max 1988, "Horizon Mapping: Shadows for Bump-Mapped Surfaces"). The CPU
// computes it (src/render/shadow/horizon.rs).

// r: height from which the lower limb is visible; g: the upper limb. Metres, world.
@group(2) @binding(2) var horizon_map: texture_2d<f32>;
// Texels are gathered or sampled, not loaded: llvmpipe computes a level of detail for each lane of a load, which takes
// several times as long.
@group(2) @binding(4) var nearest: sampler;

// Whether the ground is made of rings (`Layout::Rings`), each with a grid over twice the extent of the one before.
override RINGS: bool;

// What the ground, a caster, or all of them, leave of the sun at a point.
struct Shadow {
    // Visible fraction of its disc.
    visibility: f32,
    // How far inside the shadow the point is, metres: of casters across the sun, of the ground below the shadow's edge.
    depth_m: f32,
}

// Of grids that each reach twice as far as the one before, the first that reaches `distance_m`.
fn finest_level(distance_m: f32, first_reach_m: f32, levels: u32) -> i32 {
    return clamp(i32(ceil(log2(max(distance_m, 1.0e-3) / first_reach_m))), 0, i32(levels) - 1);
}

// The shadow of the ground; its horizon counts as straight across the sun's disc.
fn shadow_of_ground(position: vec3<f32>) -> Shadow {
    var level = 0;
    if RINGS {
        level = finest_level(distance(position.xy, light.horizon_centre), light.horizon_base_m, light.horizon_levels);
    }
    let grid = frame.horizon[level];
    let offset = (position.xy - grid.origin) * (1.0 / grid.step_m);
    let sun = light.sun_horizontal;
    let limit = vec2<f32>(grid.size) - 1.001;
    // Columns run towards the sun, rows across. The clamp is relative to the grid's origin and not to its first sample, so
    // that rounding does not depend on which samples the map holds.
    let along_across = vec2(dot(offset, sun), dot(offset, vec2(-sun.y, sun.x)));
    let clamped = clamp(along_across, grid.first_sample, grid.first_sample + limit);
    let texel = floor(clamped);
    let t = clamped - texel;
    // The corner that the four texels share.
    let first_texel = vec2<f32>(vec2(grid.first_texel & 0xffffu, grid.first_texel >> 16u));
    let corner = texel - grid.first_sample + first_texel + 1.0;
    let uv = corner / vec2<f32>(textureDimensions(horizon_map));
    let limbs = vec2(
        bilinear(textureGather(0, horizon_map, nearest, uv), t),
        bilinear(textureGather(1, horizon_map, nearest, uv), t),
    );
    if position.z >= limbs.x { return Shadow(1.0, 0.0); }
    if position.z <= limbs.y { return Shadow(0.0, limbs.y - position.z); }
    // Area of the unit disc on one side of a chord.
    let u = clamp(2.0 * (position.z - limbs.y) / (limbs.x - limbs.y) - 1.0, -1.0, 1.0);
    return Shadow(0.5 + (u * sqrt(1.0 - u * u) + asin(u)) * (1.0 / 3.14159265), 0.0);
}

// Interpolates four texels in the order of `textureGather`: (0, 1), (1, 1), (1, 0), (0, 0).
fn bilinear(texels: vec4<f32>, t: vec2<f32>) -> f32 {
    return mix(mix(texels.w, texels.z, t.x), mix(texels.x, texels.y, t.x), t.y);
}
