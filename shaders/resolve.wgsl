// Samples to pixels, each plane by its own rule, packed for the readback.
//
// Colour: mean of the samples in linear light; then exposure, tone curve, sRGB, 8 bits rounded to nearest.
// Labels: the class of most samples; among classes with as many samples, that of the nearest sample. Among the samples of
// that class, the instance likewise. Ids are never averaged. A pixel with a sample that no draw wrote is UNWRITTEN.
// Depth, normal, sun occlusion: means over the samples of that class and instance, so that nothing bleeds across an outline.
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
// Whether any annotation is requested. A constant, because llvmpipe takes the time of branches that are not taken.
override HAS_ANNOTATIONS: bool;
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
    sample_uv_size = 1.0 / vec2<f32>(SAMPLES_PER_SIDE * frame.rendered_tile.zw);
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
    packed_words[3u * quad] = a.x | (a.y << 8u) | (a.z << 16u) | (b.x << 24u);
    packed_words[3u * quad + 1u] = b.y | (b.z << 8u) | (c.x << 16u) | (c.y << 24u);
    packed_words[3u * quad + 2u] = c.z | (d.x << 8u) | (d.y << 16u) | (d.z << 24u);
    packed_words[3u * quads + quad] = a.w | (b.w << 8u) | (c.w << 16u) | (d.w << 24u);
}

// sRGB bytes and class of a pixel, whose annotations are packed. Beyond the last pixel, in the last quad, the last one again: the
// readback ignores it.
fn resolved_pixel(index: u32, pixels: u32) -> vec4<u32> {
    let pixel = min(index, pixels - 1u);
    let first = column_and_row(pixel) * SAMPLES_PER_SIDE;
    if HAS_LENS_DISTORTION { find_sources(first); }
    let radiance = mean_radiance(first);
    let class_id = majority_class(first);
    if HAS_ANNOTATIONS { resolve_annotations(pixel, first, class_id, radiance); }
    return vec4(srgb_bytes(radiance), class_id);
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

fn find_sources(first: vec2<u32>) {
    let corner = first + SAMPLES_PER_SIDE * frame.image_tile.xy;
    let principal_point = 0.5 * f32(SAMPLES_PER_SIDE) * vec2<f32>(frame.image_size_px);
    let distorted = (vec2<f32>(corner) + 0.5 - principal_point) / frame.focal_samples;
    let displacement = undistortion(distorted);
    let jacobian = distortion_at(distorted + displacement).jacobian;
    let margin = 0.5 * f32(SAMPLES_PER_SIDE) * vec2<f32>(frame.render_size_px - frame.image_size_px);
    let last = vec2<i32>(SAMPLES_PER_SIDE * frame.render_size_px) - 1;
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let sample = vec2(i % SAMPLES_PER_SIDE, i / SAMPLES_PER_SIDE);
        // From the first sample along the tangent, which is off by the square of a pixel, and one step from there.
        let offset = vec2<f32>(sample) / frame.focal_samples;
        let along_tangent = displacement + inverse_of(jacobian, offset) - offset;
        let of_sample = newton_step(distorted + offset, along_tangent);
        source_positions[i] = vec2<f32>(corner + sample) + (0.5 + margin) + frame.focal_samples * of_sample;
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

// Inverse depth at sample `i` of a pixel. Under distortion its position is up to half a sample off the rendered `sample`:
// extrapolated along the plane through the neighbours of the same object. At an edge the flatter side counts.
fn inverse_depth_of(first: vec2<u32>, i: u32, sample: vec2<i32>) -> f32 {
    let inverse_depth = inverse_depth_at(sample);
    if !HAS_LENS_DISTORTION { return inverse_depth; }
    let offset = source_positions[i] - (vec2<f32>(sample + first_rendered()) + 0.5);
    let slope = vec2(
        inverse_depth_step(sample, vec2(1, 0), inverse_depth),
        inverse_depth_step(sample, vec2(0, 1), inverse_depth),
    );
    // At most twice as far away, towards the horizon.
    return max(inverse_depth + dot(slope, offset), 0.5 * inverse_depth);
}

// Change of the inverse depth from a rendered sample to the next one along `step`.
fn inverse_depth_step(sample: vec2<i32>, step: vec2<i32>, inverse_depth: f32) -> f32 {
    let first = -first_rendered();
    let last = vec2<i32>(SAMPLES_PER_SIDE * frame.render_size_px) - 1 + first;
    var slope = 0.0;
    var neighbours = 0;
    for (var side = -1; side <= 1; side += 2) {
        let neighbour = clamp(sample + side * step, first, last);
        if any(neighbour != sample)
            && class_at(neighbour) == class_at(sample)
            && instance_at(neighbour) == instance_at(sample) {
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
    let first_class = class_at(rendered_sample(first, 0u));
    var is_uniform = true;
    for (var i = 1u; i < count; i++) {
        is_uniform = is_uniform && class_at(rendered_sample(first, i)) == first_class;
    }
    if is_uniform { return first_class; }
    var best = first_class;
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < count; i++) {
        let sample = rendered_sample(first, i);
        let candidate = class_at(sample);
        if candidate == UNWRITTEN { return UNWRITTEN; }
        let inverse_depth = inverse_depth_at(sample);
        var votes = 0u;
        for (var j = 0u; j < count; j++) {
            votes += u32(class_at(rendered_sample(first, j)) == candidate);
        }
        if votes > best_votes || (votes == best_votes && inverse_depth > best_inverse_depth) {
            best = candidate;
            best_votes = votes;
            best_inverse_depth = inverse_depth;
        }
    }
    return best;
}

// Of 2 x 2 samples, which without distortion one gather reads.
fn majority_class_of_four(first: vec2<u32>) -> u32 {
    let corner = vec2<f32>(first + 1u) * sample_uv_size;
    var classes: vec4<u32>;
    if HAS_LENS_DISTORTION {
        classes = vec4(
            class_at(source_samples[0]),
            class_at(source_samples[1]),
            class_at(source_samples[2]),
            class_at(source_samples[3]),
        );
    } else {
        // Swizzled to reading order.
        classes = textureGather(0, class_id_samples, nearest, corner).wzxy;
    }
    if all(classes == classes.xxxx) { return classes.x; }
    if any(classes == vec4(UNWRITTEN)) { return UNWRITTEN; }
    var inverse_depths: vec4<f32>;
    if HAS_LENS_DISTORTION {
        inverse_depths = vec4(
            inverse_depth_at(source_samples[0]),
            inverse_depth_at(source_samples[1]),
            inverse_depth_at(source_samples[2]),
            inverse_depth_at(source_samples[3]),
        );
    } else {
        inverse_depths = bitcast<vec4<f32>>(textureGather(3, visibility_buffer, nearest, corner).wzxy);
    }
    var best = 0u;
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let votes = dot(vec4<u32>(classes == vec4(classes[i])), vec4(1u));
        if votes > best_votes || (votes == best_votes && inverse_depths[i] > best_inverse_depth) {
            best = classes[i];
            best_votes = votes;
            best_inverse_depth = inverse_depths[i];
        }
    }
    return best;
}

// Among the samples of a class.
fn majority_instance(first: vec2<u32>, class_id: u32) -> u32 {
    let count = SAMPLES_PER_SIDE * SAMPLES_PER_SIDE;
    var best = 0u;
    var best_votes = 0u;
    var best_inverse_depth = 0.0;
    for (var i = 0u; i < count; i++) {
        let sample = rendered_sample(first, i);
        if class_at(sample) != class_id { continue; }
        let candidate = instance_at(sample);
        let inverse_depth = inverse_depth_at(sample);
        var votes = 0u;
        for (var j = 0u; j < count; j++) {
            let other = rendered_sample(first, j);
            votes += u32(class_at(other) == class_id && instance_at(other) == candidate);
        }
        if votes > best_votes || (votes == best_votes && inverse_depth > best_inverse_depth) {
            best = candidate;
            best_votes = votes;
            best_inverse_depth = inverse_depth;
        }
    }
    return best;
}

// Samples of each of the classes 0 to 3, one byte each.
fn class_counts(first: vec2<u32>) -> u32 {
    var counts = 0u;
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let other = class_at(rendered_sample(first, i));
        if other < 4u { counts += 1u << (8u * other); }
    }
    return counts;
}

fn unit_or_zero(v: vec3<f32>) -> vec3<f32> {
    let length_squared = dot(v, v);
    return select(vec3(0.0), v * inverseSqrt(max(length_squared, 1.0e-12)), length_squared > 1.0e-6);
}
