// Samples to pixels, each plane by its own rule, packed_words tight for reading back.
//
// Colour: mean of the samples in linear light, then exposure, tone curve, sRGB, 8 bits rounded to nearest.
// Labels: the class of most samples; among classes with as many, that of the nearest sample. Ids are never
// averaged.
//
// One invocation packs four pixels, in reading order: three words of RGB bytes, one word of class bytes.

@group(2) @binding(0) var radiance_samples: texture_2d<f32>;
@group(2) @binding(1) var class_samples: texture_2d<u32>;
// Depth, bound as plain numbers: GLSL cannot load from a depth texture.
@group(2) @binding(2) var depth_samples: texture_2d<f32>;
@group(2) @binding(3) var<storage, read_write> packed_words: array<u32>;

const GROUP_WIDTH: u32 = 64u;
const ROW_WIDTH: u32 = 1024u;

@compute @workgroup_size(64)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixels = frame.picture_size_px.x * frame.picture_size_px.y;
    let groups = (pixels + 3u) / 4u;
    let group = id.y * ROW_WIDTH * GROUP_WIDTH + id.x;
    if group >= groups { return; }
    var bytes: array<vec3<u32>, 4>;
    var classes = 0u;
    for (var k = 0u; k < 4u; k++) {
        // Pixels beyond the last repeat it: they are never read.
        let pixel = min(4u * group + k, pixels - 1u);
        let corner = vec2(pixel % frame.picture_size_px.x, pixel / frame.picture_size_px.x) * frame.samples_per_side;
        bytes[k] = colour(corner);
        classes |= class_of_most(corner) << (8u * k);
    }
    packed_words[3u * group] = bytes[0].x | (bytes[0].y << 8u) | (bytes[0].z << 16u) | (bytes[1].x << 24u);
    packed_words[3u * group + 1u] = bytes[1].y | (bytes[1].z << 8u) | (bytes[2].x << 16u) | (bytes[2].y << 24u);
    packed_words[3u * group + 2u] = bytes[2].z | (bytes[3].x << 8u) | (bytes[3].y << 16u) | (bytes[3].z << 24u);
    packed_words[3u * groups + group] = classes;
}

fn colour(corner: vec2<u32>) -> vec3<u32> {
    let side = frame.samples_per_side;
    var sum = vec3(0.0);
    for (var y = 0u; y < side; y++) {
        for (var x = 0u; x < side; x++) {
            sum += textureLoad(radiance_samples, vec2<i32>(corner + vec2(x, y)), 0).rgb;
        }
    }
    let encoded = srgb_from_linear(tone(frame.exposure * sum / f32(side * side)));
    return vec3<u32>(clamp(255.0 * encoded + 0.5, vec3(0.0), vec3(255.0)));
}

fn class_at(sample_px: vec2<u32>) -> u32 {
    return textureLoad(class_samples, vec2<i32>(sample_px), 0).r;
}

fn class_of_most(corner: vec2<u32>) -> u32 {
    let side = frame.samples_per_side;
    let first = class_at(corner);
    var uniform_pixel = true;
    for (var i = 1u; i < side * side; i++) {
        uniform_pixel = uniform_pixel && class_at(corner + vec2(i % side, i / side)) == first;
    }
    if uniform_pixel { return first; }
    var best = first;
    var best_votes = 0u;
    var best_depth = 0.0;
    for (var i = 0u; i < side * side; i++) {
        let at = corner + vec2(i % side, i / side);
        let candidate = class_at(at);
        let depth = textureLoad(depth_samples, vec2<i32>(at), 0).r;
        var votes = 0u;
        for (var j = 0u; j < side * side; j++) {
            votes += u32(class_at(corner + vec2(j % side, j / side)) == candidate);
        }
        // Depth is reversed: the larger is the nearer.
        if votes > best_votes || (votes == best_votes && depth > best_depth) {
            best = candidate;
            best_votes = votes;
            best_depth = depth;
        }
    }
    return best;
}
