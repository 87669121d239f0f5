// The shadow map in compute passes: what shadow.wgsl draws and shadow_midpoint.wgsl makes of it, the same on every device.
//
// `cs_small` and, for large triangles, `cs_queued` (common/triangle_groups.wgsl) find the largest depth of each caster's front and back faces
// at each texel of its tile, `cs_map` the map halfway between. As in visibility_compute.wgsl positions are rounded to integers and floats
// are rounded once an operation.
//
// CPU counterpart: src/render/shadow/host.rs.

// src/render/shadow/compute.rs has the same constant.
const WORKGROUP_SIDE: u32 = 8u;

// Bits of the largest depth of the faces towards the sun and of those away from it, by texel of the map; 0 where there is none.
@group(2) @binding(4) var<storage, read_write> fronts: array<atomic<u32>>;
@group(2) @binding(5) var<storage, read_write> backs: array<atomic<u32>>;
@group(2) @binding(6) var map_out: texture_storage_2d<r32float, write>;

// What a triangle does to the texels that it covers: its depth is linear over them.
struct Fragments {
    // Of its tile in the map.
    tile_origin: vec2<i32>,
    map_width: i32,
    is_back: bool,
    // A texel near the triangle, the depth there, and how it grows from texel to texel.
    texel: vec2<i32>,
    depth: f32,
    per_step: vec2<f32>,
    // Bounds of its depth. A triangle that is seen edge-on has any between them.
    least: f32,
    most: f32,
}

fn cover(texel: vec2<i32>, fragments: Fragments) {
    let steps = exact2(vec2<f32>(texel - fragments.texel) * fragments.per_step);
    let depth = exact(exact(fragments.depth + steps.x) + steps.y);
    let bits = bitcast<u32>(min(max(depth, fragments.least), fragments.most));
    let at = fragments.tile_origin + texel;
    let index = u32(at.y * fragments.map_width + at.x);
    if fragments.is_back {
        if atomicLoad(&backs[index]) < bits { atomicMax(&backs[index], bits); }
    } else if atomicLoad(&fronts[index]) < bits {
        atomicMax(&fronts[index], bits);
    }
}

// A corner of a triangle in its tile.
struct Corner {
    // Column and row from the centre of the first texel, before they are rounded.
    position: vec2<f32>,
    // 1 is nearest to the sun, 0.5 at the caster's centre.
    depth: f32,
}

fn corner_of(packed: vec4<u32>, scale: f32, per_m: f32, size_px: f32) -> Corner {
    let p = exact3(per_m * exact3(scale * bitcast<vec3<f32>>(packed.xyz)));
    let across = vec2(exact_dot(p, frame.sun_right), exact_dot(p, -frame.sun_up));
    let position = exact2(exact2(exact2(0.5 + across) * size_px) - 0.5);
    let depth_range = size_px * (1.0 / DEPTH_RANGE_PX);
    return Corner(position, exact(0.5 + exact(exact_dot(p, frame.sun_direction) * depth_range)));
}

fn rounded(position: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(floor(exact2(f32(SUBPIXEL_STEPS) * position) + 0.5));
}

// Rasterises a triangle. Returns the queue that it goes to.
fn rasterise_triangle(number: u32, threads: Threads) -> u32 {
    let packed = vertices_of(number);
    let slot = groups[number / GROUP_TRIANGLES].z;
    let size_px = instances[slot].instance.tile_size_px;
    let per_m = 0.5 * reciprocal(instances[slot].instance.tile_half_extent_m);
    let scale = instances[slot].instance.scale;
    let a = corner_of(packed[0], scale, per_m, size_px);
    var b = corner_of(packed[1], scale, per_m, size_px);
    var c = corner_of(packed[2], scale, per_m, size_px);
    let facing = winding(rounded(a.position), rounded(b.position), rounded(c.position));
    if facing == 0 { return DONE; }
    if facing > 0 {
        let before = b;
        b = c;
        c = before;
    }
    let positions = array<vec2<i32>, 3>(rounded(a.position), rounded(b.position), rounded(c.position));
    let tile = SampleRect(vec2(0), vec2(i32(size_px)));
    let bounds = bounds_of(positions[0], positions[1], positions[2], tile);
    if any(bounds.end <= bounds.origin) { return DONE; }
    if ARE_ALONE {
        let queue = queue_of(positions[0], positions[1], positions[2], bounds);
        if queue != DONE { return queue; }
    }
    var fragments = Fragments(
        vec2<i32>(instances[slot].instance.tile_origin_px),
        i32(frame.atlas_width_px),
        facing > 0,
        positions[0] >> vec2(8u),
        a.depth,
        vec2(0.0),
        min(a.depth, min(b.depth, c.depth)),
        max(a.depth, max(b.depth, c.depth)),
    );
    let to_b = exact2(b.position - a.position);
    let to_c = exact2(c.position - a.position);
    let area = exact(exact(to_b.x * to_c.y) - exact(to_b.y * to_c.x));
    // One that is a front face only after its corners were rounded has no meaningful slope.
    if area < -1.0e-20 {
        let per_area = reciprocal(area);
        let depth_b = exact(b.depth - a.depth);
        let depth_c = exact(c.depth - a.depth);
        let per_column = exact(exact(depth_b * to_c.y) - exact(depth_c * to_b.y));
        let per_row = exact(exact(depth_c * to_b.x) - exact(depth_b * to_c.x));
        fragments.per_step = exact2(vec2(per_column, per_row) * per_area);
        let from_a = exact2(vec2<f32>(fragments.texel) - a.position);
        let steps = exact2(from_a * fragments.per_step);
        fragments.depth = exact(exact(a.depth + steps.x) + steps.y);
    }
    cover_triangle(positions[0], positions[1], positions[2], bounds, fragments, threads);
    return DONE;
}

@compute @workgroup_size(WORKGROUP_SIDE, WORKGROUP_SIDE)
fn cs_map(@builtin(global_invocation_id) invocation: vec3<u32>) {
    let size = textureDimensions(map_out);
    if any(invocation.xy >= size) { return; }
    let index = invocation.y * size.x + invocation.x;
    let front = bitcast<f32>(atomicLoad(&fronts[index]));
    let back = bitcast<f32>(atomicLoad(&backs[index]));
    textureStore(map_out, invocation.xy, vec4(height_between(front, back)));
}
