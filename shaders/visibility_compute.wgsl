// Visibility in a compute pass: the same visibility buffer as visibility.wgsl draws, with the same samples on every device.
//
// A first pass over the triangles finds the largest inverse depth at each sample, a second the first triangle that has it there, and
// `cs_write` writes what that triangle shows (Burns and Hunt 2013, "The Visibility Buffer"). Triangles of few samples, which are most,
// have a thread each (`cs_small` in common/triangle_groups.wgsl), the others whole workgroups (`cs_queued`; as Karis et al. 2021, "Nanite:
// A Deep Dive", divides triangles between software and hardware).
//
// What labels depend on is computed without a choice that a device may make: positions are rounded to integers as the host's are
// (src/render/raster), edge functions are integers, and products, sums and reciprocals of floats are rounded once each
// (common/exact.wgsl).
//
// CPU counterpart: src/render/visibility/geometry.rs and src/render/visibility/host.rs.

// Columns and rows of samples that a workgroup writes at once.
const WORKGROUP_SIDE: u32 = 8u;
// The second pass over the triangles.
const FINDS_TRIANGLE: u32 = 1u;

// Two words for each sample of the tile: the bits of the largest inverse depth, and the complement of the number of the first
// triangle that has it. Both are 0 where there is no surface.
@group(2) @binding(4) var<storage, read_write> nearest: array<atomic<u32>>;
@group(2) @binding(5) var visibility_out: texture_storage_2d<rgba32uint, write>;

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

fn corner_of(packed: vec4<u32>, instance_origin: vec3<f32>, scale: f32) -> Corner {
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
    let packed = vertices_of(number);
    let origin = instances[group.z].instance.origin;
    let scale = instances[group.z].instance.scale;
    return Triangle(
        array<Corner, 3>(
            corner_of(packed[0], origin, scale),
            corner_of(packed[1], origin, scale),
            corner_of(packed[2], origin, scale),
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
    let half_steps = (SUBPIXEL_STEPS / 2) * vec2<i32>(frame.samples_per_side * frame.render_size_px);
    let half_size = 0.5 * vec2<f32>(frame.samples_per_side * frame.render_size_px);
    let scaled = exact2(exact2(clip.xy * reciprocal(clip.z)) * half_size);
    // Rounded relative to the centre of the image, which puts the whole guard band in range.
    let from_centre = exact2(exact2(exact2(scaled + half_size) - 0.5) - half_size);
    return vec2<i32>(floor(exact2(f32(SUBPIXEL_STEPS) * from_centre) + 0.5)) + half_steps;
}

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

// From the first corner of a triangle to another, metres.
fn to_corner(t: Triangle, corner: u32) -> vec3<f32> {
    return exact3(t.scale * exact3(t.corners[corner].position - t.corners[0].position));
}

// Twice the area of a triangle along its normal, m2.
fn area_normal(t: Triangle) -> vec3<f32> {
    let to_b = to_corner(t, 1u);
    let to_c = to_corner(t, 2u);
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

// What a triangle does to the samples that it covers.
struct Fragments {
    plane: DepthPlane,
    tile: SampleRect,
    number: u32,
}

// The first pass keeps the largest inverse depth, the second the first triangle that has it.
fn cover(sample: vec2<i32>, fragments: Fragments) {
    let at = sample - fragments.tile.origin;
    let word = 2u * u32(at.y * (fragments.tile.end.x - fragments.tile.origin.x) + at.x);
    let depth = bitcast<u32>(inverse_depth(fragments.plane, sample));
    let found = atomicLoad(&nearest[word]);
    if PASS_NUMBER == FINDS_TRIANGLE {
        if found == depth { atomicMax(&nearest[word + 1u], ~fragments.number); }
    } else if found < depth {
        atomicMax(&nearest[word], depth);
    }
}

// Rasterises a triangle or a piece of one. Returns the queue that it goes to.
fn rasterise_piece(
    positions: array<vec2<i32>, 3>,
    t: Triangle,
    is_whole: bool,
    number: u32,
    threads: Threads,
) -> u32 {
    let a = positions[0];
    var b = positions[1];
    var c = positions[2];
    let tile = tile_rect();
    let bounds = bounds_of(a, b, c, tile);
    if any(bounds.end <= bounds.origin) { return DONE; }
    let facing = winding(a, b, c);
    // The sky's spheres are seen from inside too.
    if facing == 0 || (facing > 0 && !t.is_sky) { return DONE; }
    if ARE_ALONE {
        let queue = queue_of(a, b, c, bounds);
        if queue != DONE { return queue; }
    }
    if facing > 0 {
        b = positions[2];
        c = positions[1];
    }
    let last = vec2<i32>(frame.samples_per_side * frame.render_size_px) - 1;
    let plane = depth_plane(t, clamp(a >> vec2(8u), vec2(0), last), is_whole);
    cover_triangle(a, b, c, bounds, Fragments(plane, tile, number), threads);
    return DONE;
}

// Rasterises a triangle. Returns the queue that it goes to.
fn rasterise_triangle(number: u32, threads: Threads) -> u32 {
    let t = triangle_at(number);
    let a = t.corners[0].clip;
    let b = t.corners[1].clip;
    let c = t.corners[2].clip;
    let is_whole = is_projectable(a) && is_projectable(b) && is_projectable(c);
    if !is_whole {
        // Wholly nearer than the near plane, or wholly beside the image.
        let w = vec3(a.z, b.z, c.z);
        let x = vec3(a.x, b.x, c.x);
        let y = vec3(a.y, b.y, c.y);
        if all(w < vec3(frame.near_m)) || all(w < x) || all(w < -x) || all(w < y) || all(w < -y) { return DONE; }
    }
    if ARE_ALONE {
        // The bounds of a triangle that is clipped are not known yet.
        if !is_whole { return QUEUE_HUGE; }
        let positions = array<vec2<i32>, 3>(screen_position(a), screen_position(b), screen_position(c));
        return rasterise_piece(positions, t, is_whole, number, threads);
    }
    var polygon = Polygon(array<vec3<f32>, 8>(a, b, c, a, a, a, a, a), 3u);
    if !is_whole {
        for (var plane = 0u; plane < CLIP_PLANES; plane++) { polygon = clip_polygon(polygon, plane); }
    }
    // A fan around the first corner.
    let centre = screen_position(pop(&polygon));
    var corner = screen_position(pop(&polygon));
    while polygon.count > 0u {
        let next = screen_position(pop(&polygon));
        _ = rasterise_piece(array<vec2<i32>, 3>(centre, corner, next), t, is_whole, number, threads);
        corner = next;
    }
    return DONE;
}

// A convex polygon in clip x, y and w. A stack whose first corner is on top, and whose places are never chosen by a variable, so that it
// stays in registers.
struct Polygon {
    corners: array<vec3<f32>, 8>,
    count: u32,
}

fn push(polygon: ptr<function, Polygon>, corner: vec3<f32>) {
    (*polygon).corners[7] = (*polygon).corners[6];
    (*polygon).corners[6] = (*polygon).corners[5];
    (*polygon).corners[5] = (*polygon).corners[4];
    (*polygon).corners[4] = (*polygon).corners[3];
    (*polygon).corners[3] = (*polygon).corners[2];
    (*polygon).corners[2] = (*polygon).corners[1];
    (*polygon).corners[1] = (*polygon).corners[0];
    (*polygon).corners[0] = corner;
    (*polygon).count += 1u;
}

// Of an empty polygon, whatever lies there.
fn pop(polygon: ptr<function, Polygon>) -> vec3<f32> {
    let corner = (*polygon).corners[0];
    (*polygon).corners[0] = (*polygon).corners[1];
    (*polygon).corners[1] = (*polygon).corners[2];
    (*polygon).corners[2] = (*polygon).corners[3];
    (*polygon).corners[3] = (*polygon).corners[4];
    (*polygon).corners[4] = (*polygon).corners[5];
    (*polygon).corners[5] = (*polygon).corners[6];
    (*polygon).corners[6] = (*polygon).corners[7];
    (*polygon).count -= min((*polygon).count, 1u);
    return corner;
}

// The near plane, then the guard band on four sides. Each adds one corner at most.
const CLIP_PLANES: u32 = 5u;

fn distance_to_plane(clip: vec3<f32>, plane: u32) -> f32 {
    if plane == 0u { return exact(clip.z - frame.near_m); }
    let is_across = plane < 3u;
    let coordinate = select(clip.y, clip.x, is_across);
    let along = select(coordinate, -coordinate, plane % 2u == 1u);
    return exact(exact(select(frame.guard_band.y, frame.guard_band.x, is_across) * clip.z) + along);
}

// The part of a polygon on the inner side of a plane (Sutherland and Hodgman 1974). An edge that two triangles share is cut at the
// same point in both: always from its inner corner to its outer one.
fn clip_polygon(polygon: Polygon, plane: u32) -> Polygon {
    var remaining = polygon;
    // The last corner on top.
    var reversed = Polygon(polygon.corners, 0u);
    let first = polygon.corners[0];
    while remaining.count > 0u {
        let a = pop(&remaining);
        let b = select(first, remaining.corners[0], remaining.count > 0u);
        let at_a = distance_to_plane(a, plane);
        let at_b = distance_to_plane(b, plane);
        let is_a_inner = at_a >= 0.0;
        if is_a_inner { push(&reversed, a); }
        if is_a_inner != (at_b >= 0.0) {
            let inner = select(b, a, is_a_inner);
            let outer = select(a, b, is_a_inner);
            let at_inner = select(at_b, at_a, is_a_inner);
            let whole = exact(abs(at_a) + abs(at_b));
            let part = select(0.0, exact(at_inner * reciprocal(max(whole, 1.0e-30))), whole > 1.0e-30);
            push(&reversed, exact3(inner + exact3(part * exact3(outer - inner))));
        }
    }
    var clipped = Polygon(reversed.corners, 0u);
    while reversed.count > 0u { push(&clipped, pop(&reversed)); }
    return clipped;
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
    let to_b = to_corner(t, 1u);
    let to_c = to_corner(t, 2u);
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
