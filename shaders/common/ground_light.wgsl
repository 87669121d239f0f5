// Light of sunlit ground on ground in shadow: a map of what each place sees (src/render/select/ground_light.rs). Its grids lie side by side
// in rows of the texture of the faces of rocks: first the roots of the irradiance, below them from where it comes.

// Cells along a side of each grid, and grids. src/render/select/nested_grids.rs has the same.
const GROUND_LIGHT_CELLS: f32 = 48.0;
const GROUND_LIGHT_LEVELS: u32 = 4u;
// Largest slope of a normal for which the map holds.
const MAX_LIT_SLOPE: f32 = 0.7;

// Light from sunlit ground, but for that within a cell.
struct GroundLight {
    // Relative to uniform light of the radiance of level sunlit ground: the sum of its directions, each times its irradiance, and the
    // irradiance.
    light: vec4<f32>,
    // The sunlit fraction of the ground within a cell, if no rock shadows it.
    near_sunlit: f32,
}

// Light on the ground at a position (metres, world).
fn light_of_ground(position: vec3<f32>, normal: vec3<f32>, sun_horizontal: vec2<f32>) -> GroundLight {
    let map = frame.ground_light;
    let offset = position.xy - map.xy;
    let level = f32(finest_level(max(abs(offset.x), abs(offset.y)), map.z, GROUND_LIGHT_LEVELS));
    let cells = (offset * (exp2(-level) / map.z) + 1.0) * (0.5 * GROUND_LIGHT_CELLS) - 0.5;
    let clamped = clamp(cells, vec2(0.0), vec2(GROUND_LIGHT_CELLS - 1.001));
    let cell = floor(clamped);
    let t = clamped - cell;
    let texel_uv = 1.0 / vec2<f32>(textureDimensions(lit_faces));
    let first = vec2(level * GROUND_LIGHT_CELLS, map.w) + cell + 0.5;
    let roots = interpolated_texel(first, t, texel_uv);
    let below = interpolated_texel(first + vec2(0.0, GROUND_LIGHT_CELLS), t, texel_uv);
    let lean = normal.xy / max(normal.z, 0.3);
    let slope = lean * min(MAX_LIT_SLOPE * inverseSqrt(max(dot(lean, lean), 1.0e-9)), 1.0);
    let left = vec2(-sun_horizontal.y, sun_horizontal.x);
    let root = max(dot(roots.xyz, vec3(1.0, dot(slope, sun_horizontal), dot(slope, left))), 0.0);
    let on_normal = root * root;
    // What a normal receives beyond the place's own comes from where it leans.
    let as_own = min(roots.w * roots.w, on_normal);
    let directions = as_own * below.xyz + (on_normal - as_own) * unit(vec3(lean + 1.0e-9, 0.0));
    return GroundLight(max(normal.z, 0.0) * vec4(directions, on_normal), below.w);
}

// Four texels of the map, the first at this position, interpolated. Sampled: gathering them channel by channel takes llvmpipe twice as long.
fn interpolated_texel(first: vec2<f32>, t: vec2<f32>, texel_uv: vec2<f32>) -> vec4<f32> {
    let low = first * texel_uv;
    let high = (first + 1.0) * texel_uv;
    let south_west = textureSampleLevel(lit_faces, nearest, low, 0.0);
    let south_east = textureSampleLevel(lit_faces, nearest, vec2(high.x, low.y), 0.0);
    let north_west = textureSampleLevel(lit_faces, nearest, vec2(low.x, high.y), 0.0);
    let north_east = textureSampleLevel(lit_faces, nearest, high, 0.0);
    return mix(mix(south_west, south_east, t.x), mix(north_west, north_east, t.x), t.y);
}
