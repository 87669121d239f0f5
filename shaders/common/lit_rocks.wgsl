// Sunlit rocks as sources of light. The buffer of the caster grid holds them after the grid's own lists
// (src/render/select/lit_rocks.rs): for each cell the start of its list, the lists of indices, the rocks.

// Distance that a rock lights, in geometric means of its height and its radius. src/render/select/lit_rocks.rs has the same.
const REACH: f32 = 12.0;
const LIT_ROCK_WORDS: u32 = 9u;
// Fraction of its bounding rectangle that a rock fills.
const FILLED: f32 = 0.7;
// Slope at which relief and other rocks hide half of a rock from the ground, and from another rock.
const HIDING_SLOPE: vec2<f32> = vec2(0.1, 0.03);

// Light from around a point.
struct BouncedLight {
    irradiance: vec3<f32>,
    // Sum of the directions that it comes from, each times its irradiance (green).
    direction: vec3<f32>,
}

// Light that rocks, all but the one in a slot of the instances, reflect to a surface at a position (metres, world). Each is an
// upright wall across the line of sight, its radiance that of the side that is seen from there. None where `is_wanted` is false.
fn light_of_rocks(position: vec3<f32>, normal: vec3<f32>, slot: u32, is_wanted: bool) -> BouncedLight {
    var sum = BouncedLight(vec3(0.0), vec3(0.0));
    let buffer = frame.lit_rocks;
    let of_rock = frame.bounce_of_rock;
    let hiding_slope = select(HIDING_SLOPE.y, HIDING_SLOPE.x, slot == 0u);
    let index = buffer.x + cell_index(position, i32(buffer.z));
    let first = buffer.x + caster_grid[index];
    let end = select(first, buffer.x + caster_grid[index + 1u], is_wanted && buffer.w != 0u);
    for (var i = first; i < end; i++) {
        let word = buffer.y + LIT_ROCK_WORDS * caster_grid[i];
        let foot = vec3_at(word) - position;
        let height = bitcast<f32>(caster_grid[word + 3u]);
        let radius = bitcast<f32>(caster_grid[word + 7u]);
        let square = dot(foot.xy, foot.xy);
        let per_distance = inverseSqrt(max(square, 1.0e-6));
        let way = foot.xy * per_distance;
        let reach = square / (REACH * REACH * height * radius);
        // To the wall, between the rock's centre and its side.
        let distance = max(square * per_distance - 0.5 * radius, 0.2 * radius);
        let rise = max(foot.z + height, 0.0);
        let unhidden = rise / (rise + hiding_slope * distance);
        let fade = select(unhidden * max(1.0 - reach * reach, 0.0), 0.0, caster_grid[word + 8u] == slot);
        let of_wall = wall(distance, radius, foot.z, foot.z + height);
        let u = clamp(-dot(way, light.sun_horizontal), -1.0, 1.0);
        let root = dot(of_rock, vec4(1.0, u, u * u, u * u * u));
        let towards = vec3(of_wall.x * way, of_wall.y);
        let radiance = vec3_at(word + 4u) * (fade * root * root);
        let irradiance = radiance * max(dot(towards, normal), 0.0);
        sum.irradiance += irradiance;
        sum.direction += irradiance.g * unit(towards);
    }
    return sum;
}

// Vector irradiance, along the line of sight and upwards, of a wall of radiance 1 at a distance that reaches `half_width` to each
// side, from `bottom` to `top` relative to the point: the integral of the directions over its solid angle.
fn wall(distance: f32, half_width: f32, bottom: f32, top: f32) -> vec2<f32> {
    let tangent = half_width / distance;
    let heights = vec2(top, bottom) / distance;
    let cosines = inverseSqrt(1.0 + heights * heights);
    let sines = heights * cosines;
    let angles = vec2(arc_tangent(heights.x), arc_tangent(heights.y)) + sines * cosines;
    let along = tangent * inverseSqrt(1.0 + tangent * tangent) * (angles.x - angles.y);
    let up = arc_tangent(tangent) * (sines.x * sines.x - sines.y * sines.y);
    return FILLED * vec2(along, up);
}

// The arc tangent within 1e-5 (Abramowitz and Stegun 1964, formula 4.4.47). Drivers compute their own with or without fused operations.
fn arc_tangent(x: f32) -> f32 {
    let size = abs(x);
    let is_steep = size > 1.0;
    let t = select(size, 1.0 / max(size, 1.0e-6), is_steep);
    let square = t * t;
    let angle = t * (0.9998660 + square * (-0.3302995 + square * (0.1801410 + square * (-0.0851330 + square * 0.0208351))));
    let unsigned = select(angle, 1.57079633 - angle, is_steep);
    return select(unsigned, -unsigned, x < 0.0);
}

fn vec3_at(word: u32) -> vec3<f32> {
    return vec3(
        bitcast<f32>(caster_grid[word]),
        bitcast<f32>(caster_grid[word + 1u]),
        bitcast<f32>(caster_grid[word + 2u]),
    );
}
