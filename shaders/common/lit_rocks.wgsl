// Sunlit faces of rocks as sources of light (src/render/select/lit_rocks.rs). The buffer of the caster grid holds, after the grid's own
// lists, for each cell the start of its list, then the lists of indices of faces. The faces are in a texture, as llvmpipe loads each number
// of a buffer lane by lane.

// Of each face: its middle (metres, world) and the slot of its rock; the sum of the normals of its sunlit parts times their areas
// (square metres); its colour times the irradiance of the sun.
@group(2) @binding(6) var lit_faces: texture_2d<f32>;

// Distance that a face lights, in square roots of its area. src/render/select/lit_rocks.rs has the same.
const REACH: f32 = 14.0;
// Texels of a face, and faces in a row.
const FACE_TEXELS: u32 = 3u;
const FACES_PER_ROW: u32 = 64u;
// Fraction of a face that relief and other rocks leave visible at its own level, and the slope up to it at which half of the rest is
// visible. Rays traced from soil in shadow find 0.5, 0.5, 0.6, 0.8, 0.9 at slopes of 0, 0.04, 0.08, 0.15, 0.25.
const MIN_VISIBLE: f32 = 0.45;
const HIDING_SLOPE: f32 = 0.1;
// The fraction that is visible from the faces of other rocks.
const VISIBLE_FROM_ROCKS: f32 = 0.9;
// Light on the ground over that of the listed faces: what further bounces and parts of rocks that a face leaves out add in path-traced
// scenes.
const BEYOND_FACES: f32 = 1.4;

// Light from around a point.
struct BouncedLight {
    irradiance: vec3<f32>,
    // Sum of the directions that it comes from, each times its irradiance (green).
    direction: vec3<f32>,
}

// Light that rocks, all but the one in a slot of the instances, reflect to the ground or to a rock at a position (metres, world). None
// where `is_wanted` is false.
fn light_of_rocks(
    position: vec3<f32>,
    normal: vec3<f32>,
    slot: u32,
    is_ground: bool,
    is_wanted: bool,
) -> BouncedLight {
    var sum = BouncedLight(vec3(0.0), vec3(0.0));
    let buffer = frame.lit_rocks;
    let index = buffer.x + cell_index(position, i32(buffer.y));
    let first = buffer.x + caster_grid[index];
    let end = select(first, buffer.x + caster_grid[index + 1u], is_wanted && buffer.z != 0u);
    let texel_uv = 1.0 / vec2<f32>(textureDimensions(lit_faces));
    for (var i = first; i < end; i++) {
        let face = caster_grid[i];
        let middle = face_texel(face, 0u, texel_uv);
        let offset = middle.xyz - position;
        let area_vector = face_texel(face, 1u, texel_uv).xyz;
        let is_own = u32(middle.w) == slot;
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
        let visible = select(VISIBLE_FROM_ROCKS, from_ground * BEYOND_FACES, is_ground);
        let fade = select(visible * max(1.0 - reach * reach, 0.0), 0.0, is_own);
        let cosine = max(dot(way, normal), 0.0);
        let irradiance = face_texel(face, 2u, texel_uv).rgb * (fade * reflectance * solid_angle * cosine);
        sum.irradiance += irradiance;
        sum.direction += irradiance.g * way;
    }
    return sum;
}

// Sampled, as llvmpipe computes a level of detail for every lane of a `textureLoad`.
fn face_texel(face: u32, texel: u32, texel_uv: vec2<f32>) -> vec4<f32> {
    let column = FACE_TEXELS * (face % FACES_PER_ROW) + texel;
    let position = vec2(f32(column), f32(face / FACES_PER_ROW)) + 0.5;
    return textureSampleLevel(lit_faces, nearest, position * texel_uv, 0.0);
}
