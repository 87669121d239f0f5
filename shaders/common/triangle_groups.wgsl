// Triangles for compute passes that rasterise: groups of those that are drawn with the same instance. A workgroup takes a group, each
// thread one small triangle. The others go to two queues: large triangles have a workgroup each, huge ones a column of them.
// src/render/visibility/triangle_groups.rs makes the groups.
//
// A program has `rasterise_triangle(number, threads)`, which returns the queue that a triangle goes to where a thread alone does not
// rasterise it.

// Which of a program's passes over the triangles this is, from 0.
override PASS_NUMBER: u32;

// Triangles of a group, and threads of a workgroup; groups in a row of workgroups.
const GROUP_TRIANGLES: u32 = 64u;
const GROUPS_PER_ROW: u32 = 128u;
// Workgroups along the queues, and the most huge triangles.
const QUEUE_WORKGROUPS: u32 = 512u;
const MAX_HUGE: u32 = 4096u;
// Where a triangle goes.
const DONE: u32 = 0u;
const QUEUE_LARGE: u32 = 1u;
const QUEUE_HUGE: u32 = 2u;
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

// Lengths of the queues of large and of huge triangles, then the large ones, and in the last `MAX_HUGE` words the huge ones, in any order.
@group(2) @binding(3) var<storage, read_write> queues: array<atomic<u32>>;

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

// Rasterises the small triangles of a workgroup's group. The first pass queues the others.
@compute @workgroup_size(GROUP_TRIANGLES)
fn cs_small(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let group = workgroup.y * GROUPS_PER_ROW + workgroup.x;
    if thread >= (groups[group].w & COUNT_MASK) { return; }
    let number = group * GROUP_TRIANGLES + thread;
    let queue = rasterise_triangle(number, Threads(thread, 0u, 1u));
    if PASS_NUMBER > 0u || queue == DONE { return; }
    if queue == QUEUE_HUGE {
        let index = atomicAdd(&queues[1], 1u);
        if index < MAX_HUGE {
            atomicStore(&queues[first_huge() + index], number);
            return;
        }
    }
    atomicStore(&queues[2u + atomicAdd(&queues[0], 1u)], number);
}

fn first_huge() -> u32 {
    return arrayLength(&queues) - MAX_HUGE;
}

// Rasterises the queued triangles: the first row of workgroups the large ones, the others, each a slice of them, the huge ones.
@compute @workgroup_size(GROUP_TRIANGLES)
fn cs_queued(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let is_huge = workgroup.y > 0u;
    let count = select(atomicLoad(&queues[0]), min(atomicLoad(&queues[1]), MAX_HUGE), is_huge);
    let first = select(2u, first_huge(), is_huge);
    let slice = select(0u, workgroup.y - 1u, is_huge);
    let slices = select(1u, workgroups.y - 1u, is_huge);
    for (var i = workgroup.x; i < count; i += QUEUE_WORKGROUPS) {
        let number = atomicLoad(&queues[first + i]);
        _ = rasterise_triangle(number, Threads(thread, slice, slices));
    }
}
