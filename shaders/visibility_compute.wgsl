// Visibility in a compute pass: the same visibility buffer as visibility.wgsl draws, with the same samples on every device.
//
// `cs_depth` finds the largest inverse depth at each sample, `cs_triangle` the first triangle that has it there, and `cs_write` writes
// what that triangle shows (Burns and Hunt 2013, "The Visibility Buffer"). Triangles of few samples, which are most, have a thread
// each; a workgroup shares the others (as Karis et al. 2021, "Nanite: A Deep Dive", divides triangles between software and hardware).
//
// What labels depend on is computed without a choice that a device may make: positions are rounded to integers as the host's are
// (src/render/raster), edge functions are integers, and products, sums and reciprocals of floats are rounded once each
// (common/exact.wgsl).
//
// CPU counterpart: src/render/visibility/geometry.rs and src/render/visibility/host.rs.

// Triangles of a group, and threads of the workgroup that rasterises it; src/render/visibility/compute.rs has the same constants.
const GROUP_TRIANGLES: u32 = 64u;
const GROUPS_PER_ROW: u32 = 128u;
// The last word of a group: its number of triangles, and above it what they are.
const COUNT_MASK: u32 = 0x7fu;
const IS_SKY: u32 = 0x80u;
// Its indices have 16 bits.
const IS_NARROW: u32 = 0x100u;

// Most samples in the bounds of a triangle that one thread rasterises.
const MAX_ALONE: i32 = 64;
// Columns and rows of samples that a workgroup tests at once: one to a thread.
const BLOCK: i32 = 8;
// Columns and rows of samples that a workgroup writes at once.
const WORKGROUP_SIDE: u32 = 8u;

// Triangles that are drawn with the same instance: their first index, what is added to each index, their slot, and the last word.
@group(2) @binding(0) var<storage, read> groups: array<vec4<u32>>;
@group(2) @binding(1) var<storage, read> indices: array<u32>;
// Position in three words, then the normal, octahedral in two signed normalised numbers.
@group(2) @binding(2) var<storage, read> vertices: array<vec4<u32>>;
// Two words for each sample of the tile: the bits of the largest inverse depth, and the complement of the number of the first
// triangle that has it. Both are 0 where there is no surface.
@group(2) @binding(3) var<storage, read_write> nearest: array<atomic<u32>>;
@group(2) @binding(4) var visibility_out: texture_storage_2d<rgba32uint, write>;

var<workgroup> shared_count: atomic<u32>;
// Triangles of the group that the workgroup shares.
var<workgroup> shared_triangles: array<u32, GROUP_TRIANGLES>;

// Columns and rows of samples.
struct SampleRect {
    origin: vec2<i32>,
    end: vec2<i32>,
}

fn tile_rect() -> SampleRect {
    let side = frame.samples_per_side;
    return SampleRect(
        vec2<i32>(side * frame.rendered_tile.xy),
        vec2<i32>(side * (frame.rendered_tile.xy + frame.rendered_tile.zw)),
    );
}

// A corner of a triangle.
struct Corner {
    // From the origin of its mesh, metres.
    position: vec3<f32>,
    // From the eye, metres.
    offset: vec3<f32>,
    // Clip x, y (rows running down) and w.
    clip: vec3<f32>,
    // Packed.
    normal: u32,
}

struct Triangle {
    corners: array<Corner, 3>,
    slot: u32,
    is_sky: bool,
    scale: f32,
}

fn index_at(number: u32, is_narrow: bool) -> u32 {
    if !is_narrow { return indices[number]; }
    return (indices[number >> 1u] >> (16u * (number & 1u))) & 0xffffu;
}

fn corner_at(vertex: u32, instance_origin: vec3<f32>, scale: f32) -> Corner {
    let packed = vertices[vertex];
    let position = bitcast<vec3<f32>>(packed.xyz);
    let offset = exact3(exact3(instance_origin - frame.eye) + exact3(scale * position));
    let m = frame.clip_from_offset;
    let clip = vec3(
        transform(vec4(m[0].x, m[1].x, m[2].x, m[3].x), offset),
        -transform(vec4(m[0].y, m[1].y, m[2].y, m[3].y), offset),
        transform(vec4(m[0].w, m[1].w, m[2].w, m[3].w), offset),
    );
    return Corner(position, offset, clip, packed.w);
}

// A row of a matrix times an offset.
fn transform(row: vec4<f32>, offset: vec3<f32>) -> f32 {
    let products = exact3(row.xyz * offset);
    return exact(exact(exact(products.x + products.y) + products.z) + row.w);
}

fn triangle_at(number: u32) -> Triangle {
    let group = groups[number / GROUP_TRIANGLES];
    let first = group.x + 3u * (number % GROUP_TRIANGLES);
    let is_narrow = (group.w & IS_NARROW) != 0u;
    let origin = instances[group.z].instance.origin;
    let scale = instances[group.z].instance.scale;
    return Triangle(
        array<Corner, 3>(
            corner_at(group.y + index_at(first, is_narrow), origin, scale),
            corner_at(group.y + index_at(first + 1u, is_narrow), origin, scale),
            corner_at(group.y + index_at(first + 2u, is_narrow), origin, scale),
        ),
        group.z,
        (group.w & IS_SKY) != 0u,
        scale,
    );
}

// Whether a corner lies beyond the near plane and within the guard band: its position can be rounded to sub-pixel steps.
fn is_projectable(clip: vec3<f32>) -> bool {
    let guard_band = exact2(frame.guard_band * clip.z);
    return clip.z >= frame.near_m && all(abs(clip.xy) <= guard_band);
}

// Position among the samples in sub-pixel steps from the centre of the first.
fn screen_position(clip: vec3<f32>) -> vec2<i32> {
    let half_steps = 128 * vec2<i32>(frame.samples_per_side * frame.render_size_px);
    let half_size = 0.5 * vec2<f32>(frame.samples_per_side * frame.render_size_px);
    let scaled = exact2(exact2(clip.xy * reciprocal(clip.z)) * half_size);
    // Rounded relative to the centre of the image, which puts the whole guard band in range.
    let from_centre = exact2(exact2(exact2(scaled + half_size) - 0.5) - half_size);
    return vec2<i32>(floor(exact2(SUBPIXEL_STEPS * from_centre) + 0.5)) + half_steps;
}

const SUBPIXEL_STEPS: f32 = 256.0;

// The inverse depth of a triangle's plane over the samples.
struct DepthPlane {
    origin: vec2<i32>,
    at_origin: f32,
    per_step: vec2<f32>,
    // Bounds of the inverse depth of what is visible of the triangle. A plane that is seen edge-on has any between them.
    least: f32,
    most: f32,
}

fn ray_at(sample: vec2<i32>) -> vec3<f32> {
    let centre = vec2<f32>(sample) + 0.5;
    let across = exact3(centre.x * frame.ray_from_sample[1].xyz);
    let down = exact3(centre.y * frame.ray_from_sample[2].xyz);
    return exact3(exact3(frame.ray_from_sample[0].xyz + across) + down);
}

// Twice the area of a triangle along its normal, m2.
fn area_normal(t: Triangle) -> vec3<f32> {
    let a = t.corners[0].position;
    let to_b = exact3(t.scale * exact3(t.corners[1].position - a));
    let to_c = exact3(t.scale * exact3(t.corners[2].position - a));
    return exact3(exact3(to_b.yzx * to_c.zxy) - exact3(to_b.zxy * to_c.yzx));
}

// From the sample of these coordinates on, which should be near the triangle. `is_whole`: all corners are projectable.
fn depth_plane(t: Triangle, origin: vec2<i32>, is_whole: bool) -> DepthPlane {
    let normal = area_normal(t);
    let a = t.corners[0].offset;
    let w = vec3(t.corners[0].clip.z, t.corners[1].clip.z, t.corners[2].clip.z);
    let farthest = max(w.x, max(w.y, w.z));
    let nearest_w = min(w.x, min(w.y, w.z));
    let height = exact_dot(a, normal);
    var plane = DepthPlane(
        origin,
        0.0,
        vec2(0.0),
        reciprocal(max(farthest, frame.near_m)),
        reciprocal(max(nearest_w, frame.near_m)),
    );
    if abs(height) < 1.0e-30 {
        plane.at_origin = plane.most;
        return plane;
    }
    let per_height = reciprocal(height);
    plane.per_step = exact2(
        vec2(exact_dot(frame.ray_from_sample[1].xyz, normal), exact_dot(frame.ray_from_sample[2].xyz, normal))
            * per_height,
    );
    let ray = ray_at(origin);
    if is_whole {
        // The ray passes close by the corner: errors of the normal hardly count.
        let inverse_w = reciprocal(w.x);
        let beside = exact3(ray - exact3(inverse_w * a));
        plane.at_origin = exact(inverse_w + exact(exact_dot(beside, normal) * per_height));
    } else {
        plane.at_origin = exact(exact_dot(ray, normal) * per_height);
    }
    return plane;
}

fn inverse_depth(plane: DepthPlane, sample: vec2<i32>) -> f32 {
    let products = exact2(vec2<f32>(sample - plane.origin) * plane.per_step);
    let value = exact(exact(plane.at_origin + products.x) + products.y);
    return min(max(value, plane.least), plane.most);
}

// Edge functions (Pineda 1988): twice the area that an edge forms with a point, positive on the triangle's side. One component for each
// edge. The bias is 0 of a top or a left edge, 1 of any other (the top-left rule).
struct Edges {
    from_x: vec3<i32>,
    from_y: vec3<i32>,
    dx: vec3<i32>,
    dy: vec3<i32>,
    bias: vec3<i32>,
}

// Of a front face: corners in counter-clockwise order, with rows running down.
fn edges_of(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>) -> Edges {
    let from_x = vec3(c.x, a.x, b.x);
    let from_y = vec3(c.y, a.y, b.y);
    let dx = vec3(b.x, c.x, a.x) - from_x;
    let dy = vec3(b.y, c.y, a.y) - from_y;
    let is_top_left = (dy < vec3(0)) | ((dy == vec3(0)) & (dx > vec3(0)));
    return Edges(from_x, from_y, dx, dy, select(vec3(1), vec3(0), is_top_left));
}

// A sample that a triangle covers: the first pass keeps the largest inverse depth, the second the first triangle that has it.
fn offer(sample: vec2<i32>, tile: SampleRect, plane: DepthPlane, number: u32, finds_triangle: bool) {
    let at = sample - tile.origin;
    let word = 2u * u32(at.y * (tile.end.x - tile.origin.x) + at.x);
    let depth = bitcast<u32>(inverse_depth(plane, sample));
    let found = atomicLoad(&nearest[word]);
    if finds_triangle {
        if found == depth { atomicMax(&nearest[word + 1u], ~number); }
    } else if found < depth {
        atomicMax(&nearest[word], depth);
    }
}

// A triangle whose edge functions fit into 32 bits.
fn cover_alone(edges: Edges, bounds: SampleRect, tile: SampleRect, plane: DepthPlane, number: u32, finds_triangle: bool) {
    let first = bounds.origin * 256;
    var at_row = edges.dx * (first.y - edges.from_y) - edges.dy * (first.x - edges.from_x) - edges.bias;
    for (var y = bounds.origin.y; y < bounds.end.y; y++) {
        var at = at_row;
        for (var x = bounds.origin.x; x < bounds.end.x; x++) {
            if all(at >= vec3(0)) { offer(vec2(x, y), tile, plane, number, finds_triangle); }
            at -= 256 * edges.dy;
        }
        at_row += 256 * edges.dx;
    }
}

// A triangle of any size, by all threads of the workgroup.
fn cover_together(edges: Edges, bounds: SampleRect, tile: SampleRect, plane: DepthPlane, number: u32, finds_triangle: bool, thread: u32) {
    let within = vec2<i32>(vec2(thread % u32(BLOCK), thread / u32(BLOCK)));
    // The edge functions over 256, from the first sample of a block to that of the thread, and to the innermost of the block.
    let to_thread = edges.dx * within.y - edges.dy * within.x;
    let to_innermost = (BLOCK - 1) * (max(edges.dx, vec3(0)) + max(-edges.dy, vec3(0)));
    for (var y = bounds.origin.y; y < bounds.end.y; y += BLOCK) {
        for (var x = bounds.origin.x; x < bounds.end.x; x += BLOCK) {
            let at = vec3(
                edge_over_256(edges, 0u, x, y),
                edge_over_256(edges, 1u, x, y),
                edge_over_256(edges, 2u, x, y),
            );
            if any(at + to_innermost < vec3(0)) { continue; }
            let sample = vec2(x, y) + within;
            if all(sample < bounds.end) && all(at + to_thread >= vec3(0)) {
                offer(sample, tile, plane, number, finds_triangle);
            }
        }
    }
}

// An edge function with its bias at a sample, divided by 256 and rounded down: steps from sample to sample are whole then. At least as far
// from 0 as 2^30 where it is beyond.
fn edge_over_256(edges: Edges, edge: u32, column: i32, row: i32) -> i32 {
    let products = wide_difference(
        wide_product(edges.dx[edge], 256 * row - edges.from_y[edge]),
        wide_product(edges.dy[edge], 256 * column - edges.from_x[edge]),
    );
    return wide_over_256(wide_difference(products, WideInteger(0, u32(edges.bias[edge]))));
}

// The samples of the tile whose centres lie in the bounds of three points.
fn bounds_of(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, tile: SampleRect) -> SampleRect {
    let low = min(a, min(b, c));
    let high = max(a, max(b, c));
    return SampleRect(max((low + 255) >> vec2(8u), tile.origin), min((high >> vec2(8u)) + 1, tile.end));
}

// Twice the signed area's sign: -1 of a front face.
fn orientation(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>) -> i32 {
    let area = wide_difference(wide_product(b.x - a.x, c.y - a.y), wide_product(b.y - a.y, c.x - a.x));
    if area.high != 0 { return sign(area.high); }
    return i32(area.low != 0u);
}

// Whether 32 bits hold the edge functions.
fn is_small(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>) -> bool {
    let span = max(a, max(b, c)) - min(a, min(b, c));
    return all(span < vec2(64 * 256));
}

// Rasterises a triangle or a piece of one. Returns whether it is left to the workgroup: a thread that is `alone` takes only small ones.
fn rasterise_piece(
    positions: array<vec2<i32>, 3>,
    t: Triangle,
    number: u32,
    tile: SampleRect,
    finds_triangle: bool,
    is_whole: bool,
    alone: bool,
    thread: u32,
) -> bool {
    let a = positions[0];
    var b = positions[1];
    var c = positions[2];
    let bounds = bounds_of(a, b, c, tile);
    let size = bounds.end - bounds.origin;
    if any(size <= vec2(0)) { return false; }
    let facing = orientation(a, b, c);
    if facing == 0 || (facing > 0 && !t.is_sky) { return false; }
    // The sky's spheres are seen from inside too.
    if facing > 0 { b = positions[2]; c = positions[1]; }
    let is_alone = is_small(a, b, c) && size.x * size.y <= MAX_ALONE;
    if alone && !is_alone { return true; }
    let origin = clamp(a >> vec2(8u), vec2(0), vec2<i32>(frame.samples_per_side * frame.render_size_px) - 1);
    let plane = depth_plane(t, origin, is_whole);
    let edges = edges_of(a, b, c);
    if alone {
        cover_alone(edges, bounds, tile, plane, number, finds_triangle);
    } else {
        cover_together(edges, bounds, tile, plane, number, finds_triangle, thread);
    }
    return false;
}

// Rasterises a triangle; what it returns is that of `rasterise_piece`.
fn rasterise_triangle(number: u32, tile: SampleRect, finds_triangle: bool, alone: bool, thread: u32) -> bool {
    let t = triangle_at(number);
    let a = t.corners[0].clip;
    let b = t.corners[1].clip;
    let c = t.corners[2].clip;
    if is_projectable(a) && is_projectable(b) && is_projectable(c) {
        let positions = array<vec2<i32>, 3>(screen_position(a), screen_position(b), screen_position(c));
        return rasterise_piece(positions, t, number, tile, finds_triangle, true, alone, thread);
    }
    // Wholly nearer than the near plane, or wholly beside the image.
    let w = vec3(a.z, b.z, c.z);
    let x = vec3(a.x, b.x, c.x);
    let y = vec3(a.y, b.y, c.y);
    if all(w < vec3(frame.near_m)) || all(w < x) || all(w < -x) || all(w < y) || all(w < -y) { return false; }
    if alone { return true; }
    var polygon = Polygon(array<vec3<f32>, 8>(a, b, c, a, a, a, a, a), 3u);
    for (var plane = 0u; plane < CLIP_PLANES; plane++) {
        polygon = clip_polygon(polygon, plane);
    }
    for (var i = 2u; i < polygon.count; i++) {
        let positions = array<vec2<i32>, 3>(
            screen_position(polygon.corners[0]),
            screen_position(polygon.corners[i - 1u]),
            screen_position(polygon.corners[i]),
        );
        _ = rasterise_piece(positions, t, number, tile, finds_triangle, false, false, thread);
    }
    return false;
}

// A convex polygon in clip x, y and w.
struct Polygon {
    corners: array<vec3<f32>, 8>,
    count: u32,
}

// The near plane, then the guard band on four sides. Each adds one corner at most.
const CLIP_PLANES: u32 = 5u;

fn distance_to_plane(clip: vec3<f32>, plane: u32) -> f32 {
    if plane == 0u { return exact(clip.z - frame.near_m); }
    let axis = (plane - 1u) / 2u;
    let along = select(clip[axis], -clip[axis], plane % 2u == 1u);
    return exact(exact(frame.guard_band[axis] * clip.z) + along);
}

// The part of a polygon on the inner side of a plane (Sutherland and Hodgman 1974). An edge that two triangles share is cut at the
// same point in both: always from its inner corner to its outer one.
fn clip_polygon(polygon: Polygon, plane: u32) -> Polygon {
    var corners = polygon.corners;
    var clipped = Polygon(polygon.corners, 0u);
    for (var i = 0u; i < polygon.count; i++) {
        let a = corners[i];
        let b = corners[select(i + 1u, 0u, i + 1u == polygon.count)];
        let at_a = distance_to_plane(a, plane);
        let at_b = distance_to_plane(b, plane);
        if at_a >= 0.0 {
            clipped.corners[clipped.count] = a;
            clipped.count += 1u;
        }
        if (at_a >= 0.0) != (at_b >= 0.0) {
            let is_a_inner = at_a >= 0.0;
            let inner = select(b, a, is_a_inner);
            let outer = select(a, b, is_a_inner);
            let at_inner = select(at_b, at_a, is_a_inner);
            let whole = exact(abs(at_a) + abs(at_b));
            let part = select(0.0, exact(at_inner * reciprocal(max(whole, 1.0e-30))), whole > 1.0e-30);
            clipped.corners[clipped.count] = exact3(inner + exact3(part * exact3(outer - inner)));
            clipped.count += 1u;
        }
    }
    return clipped;
}

fn rasterise(workgroup: vec3<u32>, thread: u32, finds_triangle: bool) {
    let group = workgroup.y * GROUPS_PER_ROW + workgroup.x;
    let first = group * GROUP_TRIANGLES;
    let tile = tile_rect();
    if thread == 0u { atomicStore(&shared_count, 0u); }
    workgroupBarrier();
    if thread < (groups[group].w & COUNT_MASK) {
        if rasterise_triangle(first + thread, tile, finds_triangle, true, thread) {
            shared_triangles[atomicAdd(&shared_count, 1u)] = thread;
        }
    }
    workgroupBarrier();
    let count = atomicLoad(&shared_count);
    for (var i = 0u; i < count; i++) {
        _ = rasterise_triangle(first + shared_triangles[i], tile, finds_triangle, false, thread);
    }
}

@compute @workgroup_size(GROUP_TRIANGLES)
fn cs_depth(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    rasterise(workgroup, thread, false);
}

@compute @workgroup_size(GROUP_TRIANGLES)
fn cs_triangle(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    rasterise(workgroup, thread, true);
}

// Writes the visibility buffer.
@compute @workgroup_size(WORKGROUP_SIDE, WORKGROUP_SIDE)
fn cs_write(@builtin(global_invocation_id) invocation: vec3<u32>) {
    let at = invocation.xy;
    let size = frame.samples_per_side * frame.rendered_tile.zw;
    // The texture may be larger than the tile.
    if any(at >= size) { return; }
    let word = 2u * (at.y * size.x + at.x);
    let depth = atomicLoad(&nearest[word]);
    let complement = atomicLoad(&nearest[word + 1u]);
    if complement == 0u {
        textureStore(visibility_out, at, vec4(0u));
        return;
    }
    let t = triangle_at(~complement);
    let slot = packed_slot(t.slot);
    // The sky has no normals and no inverse depth. Its slot, which is not 0, tells it from where nothing is drawn.
    if t.is_sky {
        textureStore(visibility_out, at, vec4(slot, 0u, 0u));
        return;
    }
    let normal = area_normal(t);
    let a = t.corners[0];
    let ray = ray_at(vec2<i32>(at) + tile_rect().origin);
    let from_a = ray * reciprocal(bitcast<f32>(depth)) - a.offset;
    let to_b = t.scale * (t.corners[1].position - a.position);
    let to_c = t.scale * (t.corners[2].position - a.position);
    // Parts of the corners b and c. A sample lies beside the triangle by at most a sub-pixel step.
    let per_area = 1.0 / max(dot(normal, normal), 1.0e-30);
    let parts = per_area * vec2(dot(cross(from_a, to_c), normal), dot(cross(to_b, from_a), normal));
    let within = max(parts, vec2(0.0));
    let of_b_and_c = within / max(within.x + within.y, 1.0);
    let shading_normal = (1.0 - of_b_and_c.x - of_b_and_c.y) * corner_normal(a)
        + of_b_and_c.x * corner_normal(t.corners[1])
        + of_b_and_c.y * corner_normal(t.corners[2]);
    let towards_eye = select(normal, -normal, dot(normal, a.offset) > 0.0);
    textureStore(visibility_out, at, packed_surface(slot, shading_normal, towards_eye, depth));
}

fn corner_normal(corner: Corner) -> vec3<f32> {
    return octahedral_decode(unpack2x16snorm(corner.normal));
}
