// Triangles for compute passes that rasterise: groups of those that are drawn with the same instance. A workgroup takes a group, each
// thread one small triangle. The others are left in two lists: large triangles have a workgroup each, huge ones a column of them.
// src/render/visibility/triangle_groups.rs makes the groups.
//
// A program has `rasterise_triangle(number, pass_number, threads)`, which returns how a thread alone leaves a triangle.

// Triangles of a group, and threads of a workgroup; groups in a row of workgroups.
const GROUP_TRIANGLES: u32 = 64u;
const GROUPS_PER_ROW: u32 = 128u;
// Workgroups along the lists of triangles that are left, and the most huge ones.
const LEFT_WORKGROUPS: u32 = 512u;
const MAX_HUGE: u32 = 4096u;
// How a triangle is left.
const DONE: u32 = 0u;
const LEFT_LARGE: u32 = 1u;
const LEFT_HUGE: u32 = 2u;
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

// Numbers of large and of huge triangles, then the large ones, and in the last `MAX_HUGE` words the huge ones, in any order.
@group(2) @binding(3) var<storage, read_write> left_triangles: array<atomic<u32>>;

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

// Rasterises the small triangles of a workgroup's group. The first pass lists the others.
fn rasterise_group(workgroup: vec3<u32>, thread: u32, pass_number: u32) {
    let group = workgroup.y * GROUPS_PER_ROW + workgroup.x;
    if thread >= (groups[group].w & COUNT_MASK) { return; }
    let number = group * GROUP_TRIANGLES + thread;
    let left = rasterise_triangle(number, pass_number, Threads(true, thread, 0u, 1u));
    if pass_number > 0u || left == DONE { return; }
    if left == LEFT_HUGE {
        let index = atomicAdd(&left_triangles[1], 1u);
        if index < MAX_HUGE {
            atomicStore(&left_triangles[first_huge() + index], number);
            return;
        }
    }
    atomicStore(&left_triangles[2u + atomicAdd(&left_triangles[0], 1u)], number);
}

fn first_huge() -> u32 {
    return arrayLength(&left_triangles) - MAX_HUGE;
}

// Rasterises the triangles that were left: the first row of workgroups the large ones, the others, each a slice of them, the huge ones.
fn rasterise_left(workgroup: vec3<u32>, workgroups: vec3<u32>, thread: u32, pass_number: u32) {
    let is_huge = workgroup.y > 0u;
    let count = select(atomicLoad(&left_triangles[0]), min(atomicLoad(&left_triangles[1]), MAX_HUGE), is_huge);
    let first = select(2u, first_huge(), is_huge);
    let slice = select(0u, workgroup.y - 1u, is_huge);
    let slices = select(1u, workgroups.y - 1u, is_huge);
    for (var i = workgroup.x; i < count; i += LEFT_WORKGROUPS) {
        let number = atomicLoad(&left_triangles[first + i]);
        _ = rasterise_triangle(number, pass_number, Threads(false, thread, slice, slices));
    }
}
