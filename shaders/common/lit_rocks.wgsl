// Sunlit faces of rocks as sources of light. The buffer of the caster grid holds them after the grid's own lists
// (src/render/select/lit_rocks.rs): for each cell the start of its list, the lists of indices of faces, the faces.

// Distance that a face lights, in square roots of its area. src/render/select/lit_rocks.rs has the same.
const REACH: f32 = 14.0;
const FACE_WORDS: u32 = 10u;
// Fraction of a face that relief and other rocks leave visible at its own level, and the slope up to it at which half of the rest is
// visible. Rays traced from soil in shadow find 0.5, 0.5, 0.6, 0.8, 0.9 at slopes of 0, 0.04, 0.08, 0.15, 0.25.
const MIN_VISIBLE: f32 = 0.45;
const HIDING_SLOPE: f32 = 0.1;
// The fraction that is visible from the faces of other rocks.
const VISIBLE_FROM_ROCKS: f32 = 0.9;
// Light of all rocks over that of the listed faces: what smaller and more distant ones, rocks outside the view and further bounces add in
// path-traced scenes.
const BEYOND_FACES: f32 = 1.5;

// Light from around a point.
struct BouncedLight {
    irradiance: vec3<f32>,
    // Sum of the directions that it comes from, each times its irradiance (green).
    direction: vec3<f32>,
}

// Light that rocks, all but the one in a slot of the instances, reflect to a surface at a position (metres, world). None where
// `is_wanted` is false.
fn light_of_rocks(position: vec3<f32>, normal: vec3<f32>, slot: u32, is_wanted: bool) -> BouncedLight {
    var sum = BouncedLight(vec3(0.0), vec3(0.0));
    let buffer = frame.lit_rocks;
    let index = buffer.x + cell_index(position, i32(buffer.z));
    let first = buffer.x + caster_grid[index];
    let end = select(first, buffer.x + caster_grid[index + 1u], is_wanted && buffer.w != 0u);
    for (var i = first; i < end; i++) {
        let word = buffer.y + FACE_WORDS * caster_grid[i];
        let offset = vec3_at(word) - position;
        let area_vector = vec3_at(word + 3u);
        let is_own = caster_grid[word + 9u] == slot;
        let area = length(area_vector);
        let square = max(dot(offset, offset), 1.0e-6);
        let per_distance = inverseSqrt(square);
        let way = offset * per_distance;
        // Projected areas, towards the point and towards the sun.
        let towards_point = max(-dot(area_vector, way), 0.0);
        let towards_sun = dot(area_vector, light.sun_direction);
        let solid_angle = towards_point / (square + area * PER_PI);
        // Some laws are so dark in forward directions that the polynomial is below zero there.
        let phase = max(dot(frame.rock_phase, powers_of(-dot(way, light.sun_direction))), 0.0);
        let reflectance = phase * towards_sun / (towards_sun + towards_point);
        let reach = square / (REACH * REACH * area);
        let slope = max(way.z, 0.0);
        let from_ground = mix(MIN_VISIBLE, 1.0, slope * slope / (slope * slope + HIDING_SLOPE * HIDING_SLOPE));
        let visible = select(VISIBLE_FROM_ROCKS, from_ground, slot == 0u);
        let fade = select(visible * max(1.0 - reach * reach, 0.0), 0.0, is_own);
        let cosine = max(dot(way, normal), 0.0);
        let irradiance = vec3_at(word + 6u) * (BEYOND_FACES * fade * reflectance * solid_angle * cosine);
        sum.irradiance += irradiance;
        sum.direction += irradiance.g * way;
    }
    return sum;
}

fn vec3_at(word: u32) -> vec3<f32> {
    return vec3(
        bitcast<f32>(caster_grid[word]),
        bitcast<f32>(caster_grid[word + 1u]),
        bitcast<f32>(caster_grid[word + 2u]),
    );
}
