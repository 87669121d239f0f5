// Triangles for compute passes that rasterise: groups of those that are drawn with the same instance, one group to a workgroup.
// src/render/visibility/triangle_groups.rs makes them.

// Triangles of a group, and threads of the workgroup that rasterises it; groups in a row of workgroups.
const GROUP_TRIANGLES: u32 = 64u;
const GROUPS_PER_ROW: u32 = 128u;
// The last word of a group: its number of triangles, and above it what they are.
const COUNT_MASK: u32 = 0x7fu;
const IS_SKY: u32 = 0x80u;
// Its indices have 16 bits.
const IS_NARROW: u32 = 0x100u;

// First index, what is added to each index, slot of the instance, and the last word.
@group(2) @binding(0) var<storage, read> groups: array<vec4<u32>>;
@group(2) @binding(1) var<storage, read> indices: array<u32>;
// Position in three words, then the normal, octahedral in two signed normalised numbers.
@group(2) @binding(2) var<storage, read> vertices: array<vec4<u32>>;

var<workgroup> shared_count: atomic<u32>;
// Triangles of the group that the workgroup shares.
var<workgroup> shared_triangles: array<u32, GROUP_TRIANGLES>;

// The three vertices of a triangle, by its number among all.
fn vertices_of(number: u32) -> array<vec4<u32>, 3> {
    let group = groups[number / GROUP_TRIANGLES];
    let first = group.x + 3u * (number % GROUP_TRIANGLES);
    let is_narrow = (group.w & IS_NARROW) != 0u;
    return array<vec4<u32>, 3>(
        vertices[group.y + index_at(first, is_narrow)],
        vertices[group.y + index_at(first + 1u, is_narrow)],
        vertices[group.y + index_at(first + 2u, is_narrow)],
    );
}

fn index_at(number: u32, is_narrow: bool) -> u32 {
    if !is_narrow { return indices[number]; }
    return (indices[number >> 1u] >> (16u * (number & 1u))) & 0xffffu;
}

// Rasterises the triangles of a workgroup's group by `rasterise_triangle`, which a program has: small ones each by a thread, and
// those that it leaves, which is what it returns, by all threads together.
fn rasterise_group(workgroup: vec3<u32>, thread: u32, pass_number: u32) {
    let group = workgroup.y * GROUPS_PER_ROW + workgroup.x;
    let first = group * GROUP_TRIANGLES;
    if thread == 0u { atomicStore(&shared_count, 0u); }
    workgroupBarrier();
    if thread < (groups[group].w & COUNT_MASK) {
        if rasterise_triangle(first + thread, pass_number, Threads(true, thread)) {
            shared_triangles[atomicAdd(&shared_count, 1u)] = thread;
        }
    }
    workgroupBarrier();
    let count = atomicLoad(&shared_count);
    for (var i = 0u; i < count; i++) {
        _ = rasterise_triangle(first + shared_triangles[i], pass_number, Threads(false, thread));
    }
}
