// Samples to pixels, each plane by its own rule, packed tight for reading back.
//
// Colour: mean of the samples in linear light, then exposure, tone curve, sRGB, 8 bits rounded to nearest.
// Labels: the class of most samples; among classes with as many, that of the nearest sample. Among the samples of that
// class the instance likewise. Ids are never averaged.
// Depth, normal and shadow are means over the samples of that class and instance alone, so nothing bleeds across an
// outline. Depth is averaged as 1/z, which is linear on the picture: the depth of a plane at the pixel's centre.
//
// One invocation packs four pixels, in reading order: three words of RGB bytes, one word of class bytes, and for each
// annotation that is asked for its words, pixel by pixel.

@group(2) @binding(0) var radiance_samples: texture_2d<f32>;
@group(2) @binding(1) var class_samples: texture_2d<u32>;
@group(2) @binding(2) var normal_samples: texture_2d<f32>;
@group(2) @binding(3) var instance_samples: texture_2d<u32>;
@group(2) @binding(4) var hidden_samples: texture_2d<f32>;
// What the visibility pass left, of which one over the metres along the axis is read here.
@group(2) @binding(5) var visible_samples: texture_2d<u32>;
@group(2) @binding(6) var<storage, read_write> packed_words: array<u32>;
// Samples are not loaded: see common/shadow_map.wgsl.
@group(2) @binding(7) var nearest: sampler;
@group(2) @binding(8) var<storage, read> listed_workgroups: array<u32>;

// Samples along a side of a pixel: a constant, so that the loops over them unroll.
override SAMPLES_PER_SIDE: u32;
// Whether any annotation is asked for: a driver that runs on the CPU takes its time for branches that are not taken.
override HAS_ANNOTATIONS: bool;
// Whether a lens distorts the picture: the samples are then those of a wider one.
override HAS_LENS_DISTORTION: bool;

// Whether it is the pixels of some workgroups alone that are resolved: of those that are listed.
override USES_TILE_LIST: bool;

// From a sample to the next, in textures over which coordinates run from 0 to 1.
var<private> sample_step: vec2<f32>;

const GROUP_WIDTH: u32 = 64u;
const ROW_WIDTH: u32 = 1024u;

@compute @workgroup_size(64)
fn cs_main(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) invocation: u32) {
    let pixels = frame.picture_size_px.x * frame.picture_size_px.y;
    sample_step = 1.0 / vec2<f32>(SAMPLES_PER_SIDE * frame.drawn_size_px);
    let groups = (pixels + 3u) / 4u;
    var workgroup = id.y * ROW_WIDTH + id.x;
    if USES_TILE_LIST { workgroup = listed_workgroups[workgroup]; }
    let group = workgroup * GROUP_WIDTH + invocation;
    if group >= groups { return; }
    var bytes: array<vec3<u32>, 4>;
    var classes = 0u;
    for (var k = 0u; k < 4u; k++) {
        // Pixels beyond the last repeat it: they are never read.
        let pixel = min(4u * group + k, pixels - 1u);
        let corner = place_of(pixel) * SAMPLES_PER_SIDE;
        let radiance = mean_radiance(corner);
        bytes[k] = encoded(radiance);
        let class_id = class_of_most(corner);
        classes |= class_id << (8u * k);
        if HAS_ANNOTATIONS { annotate(pixel, corner, class_id, radiance); }
    }
    packed_words[3u * group] = bytes[0].x | (bytes[0].y << 8u) | (bytes[0].z << 16u) | (bytes[1].x << 24u);
    packed_words[3u * group + 1u] = bytes[1].y | (bytes[1].z << 8u) | (bytes[2].x << 16u) | (bytes[2].y << 24u);
    packed_words[3u * group + 2u] = bytes[2].z | (bytes[3].x << 8u) | (bytes[3].y << 16u) | (bytes[3].z << 24u);
    packed_words[3u * groups + group] = classes;
}

// Column and row of a pixel. A device that is a CPU divides whole numbers one by one: the row is reckoned in floating point, in
// which it may be one off.
fn place_of(pixel: u32) -> vec2<u32> {
    let width = frame.picture_size_px.x;
    var row = u32(f32(pixel) / f32(width));
    var column = i32(pixel - row * width);
    if column < 0 {
        row -= 1u;
        column += i32(width);
    } else if column >= i32(width) {
        row += 1u;
        column -= i32(width);
    }
    return vec2(u32(column), row);
}

fn mean_radiance(corner: vec2<u32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        sum += textureSampleLevel(radiance_samples, nearest, middle(sample_at(corner, i)), 0.0).rgb;
    }
    return sum / f32(SAMPLES_PER_SIDE * SAMPLES_PER_SIDE);
}

fn encoded(radiance: vec3<f32>) -> vec3<u32> {
    let display = srgb_from_linear(tone(frame.exposure * radiance));
    return vec3<u32>(clamp(255.0 * display + 0.5, vec3(0.0), vec3(255.0)));
}

// Sample `i` of a pixel, in reading order: where it is drawn. A lens moves it, and whatever it carries with it.
fn sample_at(corner: vec2<u32>, i: u32) -> vec2<i32> {
    let at = corner + vec2(i % SAMPLES_PER_SIDE, i / SAMPLES_PER_SIDE);
    if !HAS_LENS_DISTORTION { return vec2<i32>(at); }
    return clamp(vec2<i32>(floor(seen_at(at))), vec2(0), vec2<i32>(SAMPLES_PER_SIDE * frame.drawn_size_px) - 1);
}

// Where among the samples that are drawn a lens shows the middle of one of the picture's.
fn seen_at(at: vec2<u32>) -> vec2<f32> {
    let middle = 0.5 * f32(SAMPLES_PER_SIDE) * vec2<f32>(frame.picture_size_px);
    let point = undistorted((vec2<f32>(at) + 0.5 - middle) / frame.focal_samples);
    return point * frame.focal_samples + 0.5 * vec2<f32>(SAMPLES_PER_SIDE * frame.drawn_size_px);
}

// Steps of the inverse, as in src/lens.rs, whose `undistort` this is.
const STEPS: i32 = 24;

// The point of the pinhole's picture that a lens shows at a place of the distorted one.
fn undistorted(at: vec2<f32>) -> vec2<f32> {
    var point = at;
    for (var step = 0; step < STEPS; step++) {
        let square = dot(point, point);
        let radial = 1.0 + square * (frame.lens_k.x + square * (frame.lens_k.y + square * frame.lens_k.z));
        let shift = 2.0 * point.x * point.y * frame.lens_p
            + frame.lens_p.yx * (square + 2.0 * point * point);
        point = (at - shift) / radial;
    }
    return point;
}

fn middle(at: vec2<i32>) -> vec2<f32> {
    return (vec2<f32>(at) + 0.5) * sample_step;
}

// Whole numbers are gathered, which are the only thing that they can be but loaded: of the four the last is at the place.
fn class_at(at: vec2<i32>) -> u32 {
    return textureGather(0, class_samples, nearest, (vec2<f32>(at) + 1.0) * sample_step).w;
}

fn instance_at(at: vec2<i32>) -> u32 {
    return textureGather(0, instance_samples, nearest, (vec2<f32>(at) + 1.0) * sample_step).w;
}

// One over the metres along the axis: the larger is the nearer.
fn nearness_at(at: vec2<i32>) -> f32 {
    return bitcast<f32>(textureGather(3, visible_samples, nearest, (vec2<f32>(at) + 1.0) * sample_step).w);
}

// The nearness where a lens shows sample `i` of a pixel, which is taken from the drawn sample `at`, up to half a sample away: along
// the plane that the samples beside it of the same thing lie on. Of an edge the flatter side counts.
fn nearness_seen(corner: vec2<u32>, i: u32, at: vec2<i32>) -> f32 {
    let nearness = nearness_at(at);
    if !HAS_LENS_DISTORTION { return nearness; }
    let off = seen_at(corner + vec2(i % SAMPLES_PER_SIDE, i / SAMPLES_PER_SIDE)) - (vec2<f32>(at) + 0.5);
    let slope = vec2(slope_along(at, vec2(1, 0), nearness), slope_along(at, vec2(0, 1), nearness));
    // Towards the horizon nothing is further than twice what is known.
    return max(nearness + dot(slope, off), 0.5 * nearness);
}

// Change of the nearness from a drawn sample to the next.
fn slope_along(at: vec2<i32>, step: vec2<i32>, nearness: f32) -> f32 {
    let last = vec2<i32>(SAMPLES_PER_SIDE * frame.drawn_size_px) - 1;
    var slope = 0.0;
    var sides = 0;
    for (var side = -1; side <= 1; side += 2) {
        let beside = clamp(at + side * step, vec2(0), last);
        if any(beside != at) && class_at(beside) == class_at(at) && instance_at(beside) == instance_at(at) {
            let own = f32(side) * (nearness_at(beside) - nearness);
            slope = select(slope, own, sides == 0 || abs(own) < abs(slope));
            sides += 1;
        }
    }
    return slope;
}

fn class_of_most(corner: vec2<u32>) -> u32 {
    if SAMPLES_PER_SIDE == 2u && !HAS_LENS_DISTORTION {
        // All four at once, in reading order.
        let meet = vec2<f32>(corner + 1u) * sample_step;
        let classes = textureGather(0, class_samples, nearest, meet).wzxy;
        if all(classes == classes.xxxx) { return classes.x; }
        let nearness = bitcast<vec4<f32>>(textureGather(3, visible_samples, nearest, meet).wzxy);
        var best = 0u;
        var best_votes = 0u;
        var best_nearness = 0.0;
        for (var i = 0u; i < 4u; i++) {
            let votes = dot(vec4<u32>(classes == vec4(classes[i])), vec4(1u));
            if votes > best_votes || (votes == best_votes && nearness[i] > best_nearness) {
                best = classes[i];
                best_votes = votes;
                best_nearness = nearness[i];
            }
        }
        return best;
    }
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    let first = class_at(sample_at(corner, 0u));
    var uniform_pixel = true;
    for (var i = 1u; i < count; i++) {
        uniform_pixel = uniform_pixel && class_at(sample_at(corner, i)) == first;
    }
    if uniform_pixel { return first; }
    var best = first;
    var best_votes = 0u;
    var best_nearness = 0.0;
    for (var i = 0u; i < count; i++) {
        let at = sample_at(corner, i);
        let candidate = class_at(at);
        let nearness = nearness_at(at);
        var votes = 0u;
        for (var j = 0u; j < count; j++) {
            votes += u32(class_at(sample_at(corner, j)) == candidate);
        }
        if votes > best_votes || (votes == best_votes && nearness > best_nearness) {
            best = candidate;
            best_votes = votes;
            best_nearness = nearness;
        }
    }
    return best;
}

// The instance of most samples of a class, ties to the nearest.
fn instance_of_most(corner: vec2<u32>, class_id: u32) -> u32 {
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    var best = 0u;
    var best_votes = 0u;
    var best_nearness = 0.0;
    for (var i = 0u; i < count; i++) {
        let at = sample_at(corner, i);
        if class_at(at) != class_id { continue; }
        let candidate = instance_at(at);
        let nearness = nearness_at(at);
        var votes = 0u;
        for (var j = 0u; j < count; j++) {
            let other = sample_at(corner, j);
            votes += u32(class_at(other) == class_id && instance_at(other) == candidate);
        }
        if votes > best_votes || (votes == best_votes && nearness > best_nearness) {
            best = candidate;
            best_votes = votes;
            best_nearness = nearness;
        }
    }
    return best;
}

fn annotate(pixel: u32, corner: vec2<u32>, class_id: u32, radiance: vec3<f32>) {
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    if frame.radiance_at != NOT_ASKED {
        packed_words[frame.radiance_at + 2u * pixel] = pack2x16float(radiance.rg);
        packed_words[frame.radiance_at + 2u * pixel + 1u] = pack2x16float(vec2(radiance.b, 0.0));
    }
    if frame.coverage_at != NOT_ASKED {
        // How many samples each of the classes 0 to 3 has, a byte each.
        var counts = 0u;
        for (var i = 0u; i < count; i++) {
            let other = class_at(sample_at(corner, i));
            if other < 4u { counts += 1u << (8u * other); }
        }
        packed_words[frame.coverage_at + pixel] = counts;
    }
    let wanted = min(min(frame.depth_at, frame.normals_at), min(frame.instances_at, frame.hidden_at));
    if wanted == NOT_ASKED { return; }
    // Where no instances are drawn the texture holds a single 0, and every load gives it.
    let instance_id = instance_of_most(corner, class_id);
    var samples = 0.0;
    var nearness = 0.0;
    var hidden = 0.0;
    var normal = vec3(0.0);
    for (var i = 0u; i < count; i++) {
        let at = sample_at(corner, i);
        if class_at(at) != class_id || instance_at(at) != instance_id { continue; }
        samples += 1.0;
        if frame.depth_at != NOT_ASKED { nearness += nearness_seen(corner, i, at); }
        hidden += textureSampleLevel(hidden_samples, nearest, middle(at), 0.0).r;
        normal += textureSampleLevel(normal_samples, nearest, middle(at), 0.0).xyz;
    }
    if frame.depth_at != NOT_ASKED {
        let metres = samples / nearness;
        packed_words[frame.depth_at + pixel] = bitcast<u32>(metres);
    }
    if frame.normals_at != NOT_ASKED {
        let length_squared = dot(normal, normal);
        let unit = select(vec3(0.0), normal * inverseSqrt(max(length_squared, 1.0e-12)), length_squared > 1.0e-6);
        packed_words[frame.normals_at + 3u * pixel] = bitcast<u32>(unit.x);
        packed_words[frame.normals_at + 3u * pixel + 1u] = bitcast<u32>(unit.y);
        packed_words[frame.normals_at + 3u * pixel + 2u] = bitcast<u32>(unit.z);
    }
    if frame.instances_at != NOT_ASKED {
        packed_words[frame.instances_at + pixel] = instance_id;
    }
    if frame.hidden_at != NOT_ASKED {
        packed_words[frame.hidden_at + pixel] = u32(255.0 * hidden / samples + 0.5);
    }
}
