// Samples to pixels, each plane by its own rule, packed for the readback.
//
// Colour: mean of the samples in linear light; then exposure, tone curve, sRGB, 8 bits rounded to nearest.
// Labels: the class of most samples; among classes with as many samples, that of the nearest sample. Among the samples of
// that class, the instance likewise. Ids are never averaged. A pixel with a sample that no draw wrote is UNWRITTEN.
// Depth, normal, sun occlusion: means over the samples of that class and instance that lie on one surface (`Members`), so that
// nothing bleeds across an outline or a crest.
// Depth is averaged as inverse depth, which is linear in the image: the mean is the depth of a plane at the pixel's centre.
//
// An invocation packs a quad of four pixels in reading order: three words of RGB bytes and one word of class bytes. Behind
// all quads each annotation has its words, pixel by pixel (src/render/device/packing.rs). `resolve_annotations` is generated
// from the table of planes (src/render/device/planes.rs).

// The visibility buffer, of which the inverse depth is read.
@group(2) @binding(0) var visibility_buffer: texture_2d<u32>;
@group(2) @binding(1) var<storage, read_write> packed_words: array<u32>;
// Samples are sampled or gathered, not loaded: see common/horizon_map.wgsl.
@group(2) @binding(2) var nearest: sampler;
// Indices of the workgroups that have work, if USES_TILE_LIST.
@group(2) @binding(3) var<storage, read> tile_list: array<u32>;
// generated/resolve_planes.wgsl has the textures of the planes, from binding 4 on.

// A constant, so that loops over the samples of a pixel unroll.
override SAMPLES_PER_SIDE: u32;
// Whether any annotation is requested, and in generated/resolve_planes.wgsl each of them: constants, because llvmpipe takes the time
// of branches that are not taken.
override HAS_ANNOTATIONS: bool;
// Whether the 8-bit colour is requested: not where a sensor replaces it.
override HAS_RGB: bool;
// Whether the lens distorts: the samples are then those of a larger, undistorted image.
override HAS_LENS_DISTORTION: bool;
// Whether only the workgroups of `tile_list` are resolved.
override USES_TILE_LIST: bool;

// Class that samples are cleared to: `clear_value` in src/render/device/planes.rs. The host refuses a frame that has it.
const UNWRITTEN: u32 = 255u;

// Extent of a sample in texture coordinates.
var<private> sample_uv_size: vec2<f32>;

// src/render/device/packing.rs has the same constant.
const WORKGROUP_SIZE: u32 = 64u;
// Workgroups per row of the dispatch. src/render/resolve/pass.rs has the same constant.
const DISPATCH_WIDTH: u32 = 1024u;

@compute @workgroup_size(64)
fn cs_main(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) invocation: u32) {
    let pixels = frame.image_tile.z * frame.image_tile.w;
    // The textures may be larger than the tile.
    sample_uv_size = 1.0 / vec2<f32>(textureDimensions(class_id_samples));
    let quads = (pixels + 3u) / 4u;
    var workgroup = id.y * DISPATCH_WIDTH + id.x;
    if USES_TILE_LIST { workgroup = tile_list[workgroup]; }
    let quad = workgroup * WORKGROUP_SIZE + invocation;
    if quad >= quads { return; }
    // Four calls, no loop: compilers leave a loop this long as it is, with its array in memory, at 1.4 times the cost.
    let a = resolved_pixel(4u * quad, pixels);
    let b = resolved_pixel(4u * quad + 1u, pixels);
    let c = resolved_pixel(4u * quad + 2u, pixels);
    let d = resolved_pixel(4u * quad + 3u, pixels);
    if HAS_RGB {
        packed_words[3u * quad] = a.x | (a.y << 8u) | (a.z << 16u) | (b.x << 24u);
        packed_words[3u * quad + 1u] = b.y | (b.z << 8u) | (c.x << 16u) | (c.y << 24u);
        packed_words[3u * quad + 2u] = c.z | (d.x << 8u) | (d.y << 16u) | (d.z << 24u);
    }
    packed_words[3u * quads + quad] = a.w | (b.w << 8u) | (c.w << 16u) | (d.w << 24u);
}

// sRGB bytes and class of a pixel, whose annotations are packed. Beyond the last pixel, in the last quad, the last one again: the
// readback ignores it.
fn resolved_pixel(index: u32, pixels: u32) -> vec4<u32> {
    let pixel = min(index, pixels - 1u);
    let first = column_and_row(pixel) * SAMPLES_PER_SIDE;
    if HAS_LENS_DISTORTION { find_sources(first); }
    let radiance = mean_radiance(first);
    find_classes(first);
    let class_id = majority_class(first);
    if HAS_ANNOTATIONS { resolve_annotations(pixel, first, class_id, radiance); }
    var rgb = vec3(0u);
    if HAS_RGB { rgb = srgb_bytes(radiance); }
    return vec4(rgb, class_id);
}

// Column and row of a pixel in the tile. llvmpipe divides integers lane by lane, so the row is computed in floating point, where it can
// be one off.
fn column_and_row(pixel: u32) -> vec2<u32> {
    let width = frame.image_tile.z;
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

// A pixel is given by `first`, the column and row of its first sample in the tile of the distorted image. The rendered samples
// that it takes its values from count from the first of the G-buffer.

fn mean_radiance(first: vec2<u32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        sum += textureSampleLevel(radiance_samples, nearest, centre_uv(rendered_sample(first, i)), 0.0).rgb;
    }
    return sum / f32(SAMPLES_PER_SIDE * SAMPLES_PER_SIDE);
}

fn srgb_bytes(radiance: vec3<f32>) -> vec3<u32> {
    let display = srgb_from_linear(tone(frame.exposure * radiance));
    return vec3<u32>(clamp(255.0 * display + 0.5, vec3(0.0), vec3(255.0)));
}

// The rendered sample that sample `i` of a pixel takes its values from, samples in reading order.
fn rendered_sample(first: vec2<u32>, i: u32) -> vec2<i32> {
    if HAS_LENS_DISTORTION { return source_samples[i]; }
    return vec2<i32>(first + vec2(i % SAMPLES_PER_SIDE, i / SAMPLES_PER_SIDE));
}

// The first sample of the G-buffer among all rendered samples.
fn first_rendered() -> vec2<i32> {
    return vec2<i32>(SAMPLES_PER_SIDE * frame.rendered_tile.xy);
}

// Where the samples of a pixel come from under distortion: the positions of their centres among all rendered samples, and the
// samples of the G-buffer that these lie in. Found once a pixel, for all planes.
var<private> source_positions: array<vec2<f32>, 16>;
var<private> source_samples: array<vec2<i32>, 16>;

fn in_focal_lengths(samples: vec2<f32>) -> vec2<f32> {
    return vec2(quotient(samples.x, frame.focal_samples), quotient(samples.y, frame.focal_samples));
}

fn find_sources(first: vec2<u32>) {
    let corner = first + SAMPLES_PER_SIDE * frame.image_tile.xy;
    let principal_point = 0.5 * f32(SAMPLES_PER_SIDE) * vec2<f32>(frame.image_size_px);
    let distorted = in_focal_lengths(exact2(vec2<f32>(corner) + 0.5) - principal_point);
    let displacement = undistortion(distorted);
    let jacobian = distortion_at(exact2(distorted + displacement)).jacobian;
    let margin = 0.5 * f32(SAMPLES_PER_SIDE) * vec2<f32>(frame.render_size_px - frame.image_size_px);
    let last = vec2<i32>(SAMPLES_PER_SIDE * frame.render_size_px) - 1;
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let sample = vec2(i % SAMPLES_PER_SIDE, i / SAMPLES_PER_SIDE);
        // From the first sample along the tangent, which is off by the square of a pixel, and one step from there.
        let offset = in_focal_lengths(vec2<f32>(sample));
        let along_tangent = exact2(exact2(displacement + inverse_of(jacobian, offset)) - offset);
        let of_sample = newton_step(exact2(distorted + offset), along_tangent);
        source_positions[i] = exact2(vec2<f32>(corner + sample) + (0.5 + margin)) + exact2(frame.focal_samples * of_sample);
        source_samples[i] = clamp(vec2<i32>(floor(source_positions[i])), vec2(0), last) - first_rendered();
    }
}

// Texture coordinates of the centre of a rendered sample.
fn centre_uv(sample: vec2<i32>) -> vec2<f32> {
    return (vec2<f32>(sample) + 0.5) * sample_uv_size;
}

// Integer textures cannot be sampled, but gathered: at the sample's far corner, of whose four texels it is the last.
fn class_at(sample: vec2<i32>) -> u32 {
    return textureGather(0, class_id_samples, nearest, (vec2<f32>(sample) + 1.0) * sample_uv_size).w;
}

fn instance_at(sample: vec2<i32>) -> u32 {
    return textureGather(0, instance_id_samples, nearest, (vec2<f32>(sample) + 1.0) * sample_uv_size).w;
}

fn inverse_depth_at(sample: vec2<i32>) -> f32 {
    return bitcast<f32>(textureGather(3, visibility_buffer, nearest, (vec2<f32>(sample) + 1.0) * sample_uv_size).w);
}

// Class and instance of each sample of a pixel, fetched once for all planes.
var<private> sample_classes: array<u32, 16>;
var<private> sample_instances: array<u32, 16>;

fn find_classes(first: vec2<u32>) {
    if SAMPLES_PER_SIDE == 2u && !HAS_LENS_DISTORTION {
        // One gather, swizzled to reading order.
        let classes = textureGather(0, class_id_samples, nearest, vec2<f32>(first + 1u) * sample_uv_size).wzxy;
        for (var i = 0u; i < 4u; i++) { sample_classes[i] = classes[i]; }
        return;
    }
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        sample_classes[i] = class_at(rendered_sample(first, i));
    }
}

fn find_instances(first: vec2<u32>) {
    if SAMPLES_PER_SIDE == 2u && !HAS_LENS_DISTORTION {
        let instances = textureGather(0, instance_id_samples, nearest, vec2<f32>(first + 1u) * sample_uv_size).wzxy;
        for (var i = 0u; i < 4u; i++) { sample_instances[i] = instances[i]; }
        return;
    }
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        sample_instances[i] = instance_at(rendered_sample(first, i));
    }
}

// A sample is on the surface of another if its inverse depth is this fraction of what a level plane through the other has there, or more.
const SAME_SURFACE: f32 = 0.8;

// Which samples of an object means are over. Where it hides a part of itself that is further away, as a crest of the ground does, it has
// two surfaces in the pixel: the one with more samples counts, the nearer one if both have as many.
struct Members {
    class_id: u32,
    instance_id: u32,
    // Of the nearest sample: its inverse depth, and how far its ray falls in a metre along the optical axis.
    inverse_depth: f32,
    fall: f32,
    // Whether the nearer surface counts.
    is_front: bool,
}

fn members_of(first: vec2<u32>, class_id: u32, instance_id: u32) -> Members {
    var members = Members(class_id, instance_id, 0.0, 0.0, true);
    if SAMPLES_PER_SIDE == 1u { return members; }
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let sample = rendered_sample(first, i);
        let inverse_depth = inverse_depth_at(sample);
        if is_of_object(i, members) && inverse_depth > members.inverse_depth {
            members.inverse_depth = inverse_depth;
            members.fall = fall_of(sample);
        }
    }
    // Samples in front less those behind.
    var balance = 0;
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let sample = rendered_sample(first, i);
        let side = select(-1, 1, is_in_front(sample, inverse_depth_at(sample), members));
        balance += select(0, side, is_of_object(i, members));
    }
    members.is_front = balance >= 0;
    return members;
}

fn is_of_object(i: u32, members: Members) -> bool {
    return sample_classes[i] == members.class_id && sample_instances[i] == members.instance_id;
}

// Whether means are over sample `i`, which is this rendered sample.
fn is_member(i: u32, sample: vec2<i32>, inverse_depth: f32, members: Members) -> bool {
    if SAMPLES_PER_SIDE == 1u { return true; }
    return is_of_object(i, members) && is_in_front(sample, inverse_depth, members) == members.is_front;
}

// Whether a sample is on the surface of the nearest one. Inverse depths on a level plane are as the falls of the rays: towards the horizon
// the next row of samples is any distance further away.
fn is_in_front(sample: vec2<i32>, inverse_depth: f32, members: Members) -> bool {
    let own = abs(members.fall);
    let least = select(own, clamp(fall_of(sample), 0.0, own), members.fall > 0.0);
    return exact(inverse_depth * own) >= exact(exact(SAME_SURFACE * members.inverse_depth) * least);
}

fn fall_of(sample: vec2<i32>) -> f32 {
    let centre = vec2<f32>(sample + first_rendered()) + 0.5;
    let steps = exact2(centre * vec2(frame.ray_from_sample[1].z, frame.ray_from_sample[2].z));
    return -exact(exact(frame.ray_from_sample[0].z + steps.x) + steps.y);
}

// Inverse depth at sample `i` of a pixel, which shows this class and instance, by that of the rendered `sample`. Under distortion its
// position is up to half a sample off that: extrapolated along the plane through the neighbours of the same object. At an edge the
// flatter side counts.
fn inverse_depth_of(i: u32, sample: vec2<i32>, inverse_depth: f32, class_id: u32, instance_id: u32) -> f32 {
    if !HAS_LENS_DISTORTION { return inverse_depth; }
    let offset = exact2(source_positions[i] - exact2(vec2<f32>(sample + first_rendered()) + 0.5));
    let slope = vec2(
        inverse_depth_step(sample, vec2(1, 0), inverse_depth, class_id, instance_id),
        inverse_depth_step(sample, vec2(0, 1), inverse_depth, class_id, instance_id),
    );
    // At most twice as far away, towards the horizon.
    return max(exact(inverse_depth + exact_dot2(slope, offset)), 0.5 * inverse_depth);
}

// Depth, by the sum of this many inverse depths; infinite where it is 0, in the sky. The same on every device.
fn mean_depth(samples: f32, sum: f32) -> f32 {
    if sum == 0.0 { return samples / sum; }
    return quotient(samples, sum);
}

// Change of the inverse depth from a rendered sample to the next one along `step`.
fn inverse_depth_step(
    sample: vec2<i32>,
    step: vec2<i32>,
    inverse_depth: f32,
    class_id: u32,
    instance_id: u32,
) -> f32 {
    let first = -first_rendered();
    let last = vec2<i32>(SAMPLES_PER_SIDE * frame.render_size_px) - 1 + first;
    var slope = 0.0;
    var neighbours = 0;
    for (var side = -1; side <= 1; side += 2) {
        let neighbour = clamp(sample + side * step, first, last);
        if any(neighbour != sample) && class_at(neighbour) == class_id && instance_at(neighbour) == instance_id {
            let change = f32(side) * (inverse_depth_at(neighbour) - inverse_depth);
            slope = select(slope, change, neighbours == 0 || abs(change) < abs(slope));
            neighbours += 1;
        }
    }
    return slope;
}

fn majority_class(first: vec2<u32>) -> u32 {
    if SAMPLES_PER_SIDE == 2u { return majority_class_of_four(first); }
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    var is_uniform = true;
    for (var i = 1u; i < count; i++) { is_uniform = is_uniform && sample_classes[i] == sample_classes[0]; }
    if is_uniform { return sample_classes[0]; }
    var best = sample_classes[0];
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < count; i++) {
        let candidate = sample_classes[i];
        if candidate == UNWRITTEN { return UNWRITTEN; }
        let inverse_depth = inverse_depth_at(rendered_sample(first, i));
        var votes = 0u;
        for (var j = 0u; j < count; j++) { votes += u32(sample_classes[j] == candidate); }
        if votes > best_votes || (votes == best_votes && inverse_depth > best_inverse_depth) {
            best = candidate;
            best_votes = votes;
            best_inverse_depth = inverse_depth;
        }
    }
    return best;
}

fn majority_class_of_four(first: vec2<u32>) -> u32 {
    let classes = vec4(sample_classes[0], sample_classes[1], sample_classes[2], sample_classes[3]);
    if all(classes == classes.xxxx) { return classes.x; }
    if any(classes == vec4(UNWRITTEN)) { return UNWRITTEN; }
    return majority_of_four(classes, vec4(true), inverse_depths_of_four(first));
}

// Of those of four ids that count, the one that most samples have; among ids with as many samples, that of the nearest one.
fn majority_of_four(ids: vec4<u32>, counts: vec4<bool>, inverse_depths: vec4<f32>) -> u32 {
    var best = 0u;
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let votes = dot(vec4<u32>(counts & (ids == vec4(ids[i]))), vec4(1u));
        let is_better = votes > best_votes || (votes == best_votes && inverse_depths[i] > best_inverse_depth);
        if counts[i] && is_better {
            best = ids[i];
            best_votes = votes;
            best_inverse_depth = inverse_depths[i];
        }
    }
    return best;
}

// Inverse depths of four samples, in reading order. Called for pixels that need them alone: llvmpipe runs a loop of no constant length
// on only while a pixel of a block needs it, and the rest once for all.
fn inverse_depths_of_four(first: vec2<u32>) -> vec4<f32> {
    if !HAS_LENS_DISTORTION {
        return bitcast<vec4<f32>>(textureGather(3, visibility_buffer, nearest, vec2<f32>(first + 1u) * sample_uv_size).wzxy);
    }
    var inverse_depths = vec4(0.0);
    var next = source_samples[0];
    var second = source_samples[1];
    var third = source_samples[2];
    // 4, which no compiler knows.
    let count = 4u + frame.zero;
    for (var i = 0u; i < count; i++) {
        inverse_depths = vec4(inverse_depths.yzw, inverse_depth_at(next));
        next = second;
        second = third;
        third = source_samples[3];
    }
    return inverse_depths;
}

// Among the samples of a class.
fn majority_instance(first: vec2<u32>, class_id: u32) -> u32 {
    if SAMPLES_PER_SIDE == 1u { return sample_instances[0]; }
    if SAMPLES_PER_SIDE == 2u { return majority_instance_of_four(first, class_id); }
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    var best = 0u;
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < count; i++) {
        if sample_classes[i] != class_id { continue; }
        let candidate = sample_instances[i];
        let inverse_depth = inverse_depth_at(rendered_sample(first, i));
        var votes = 0u;
        for (var j = 0u; j < count; j++) {
            votes += u32(sample_classes[j] == class_id && sample_instances[j] == candidate);
        }
        if votes > best_votes || (votes == best_votes && inverse_depth > best_inverse_depth) {
            best = candidate;
            best_votes = votes;
            best_inverse_depth = inverse_depth;
        }
    }
    return best;
}

fn majority_instance_of_four(first: vec2<u32>, class_id: u32) -> u32 {
    let classes = vec4(sample_classes[0], sample_classes[1], sample_classes[2], sample_classes[3]);
    let instances = vec4(sample_instances[0], sample_instances[1], sample_instances[2], sample_instances[3]);
    let is_of_class = classes == vec4(class_id);
    // That of a sample of the class, if it has one at all.
    var candidate = instances.w;
    candidate = select(candidate, instances.z, is_of_class.z);
    candidate = select(candidate, instances.y, is_of_class.y);
    candidate = select(candidate, instances.x, is_of_class.x);
    if !any(is_of_class) { return 0u; }
    if !any(is_of_class & (instances != vec4(candidate))) { return candidate; }
    return majority_of_four(instances, is_of_class, inverse_depths_of_four(first));
}

// Samples of each of the classes 0 to 3, one byte each.
fn class_counts() -> u32 {
    var counts = 0u;
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        if sample_classes[i] < 4u { counts += 1u << (8u * sample_classes[i]); }
    }
    return counts;
}

fn unit_or_zero(v: vec3<f32>) -> vec3<f32> {
    let length_squared = dot(v, v);
    return select(vec3(0.0), v * inverseSqrt(max(length_squared, 1.0e-12)), length_squared > 1.0e-6);
}
