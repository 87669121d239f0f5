// Which samples a triangle covers, in integers: positions have 8 sub-pixel bits, a sample is covered where its centre is inside, and the
// top-left rule gives the centres on a shared edge to one of the two triangles (Vulkan specification, "Rasterization").
//
// A program has the struct `Fragments`, what a triangle does to the samples that it covers, and `cover(sample, fragments)`, which does it.
//
// CPU counterpart: src/render/raster.

// Sub-pixel steps from sample to sample.
const SUBPIXEL_STEPS: i32 = 256;
// Most samples in the bounds of a triangle that one thread rasterises: as long as a workgroup takes to set up one.
const MAX_ALONE: i32 = 128;
// Most samples in the bounds of a triangle that one workgroup rasterises.
const MAX_LARGE: i32 = 32768;
// Columns and rows of samples that a workgroup tests at once: one to a thread.
const BLOCK: i32 = 8;

// Whether one thread alone rasterises a triangle, or all of some workgroups, of which each takes a slice of the rows.
override ARE_ALONE: bool;

struct Threads {
    // The number of this thread.
    thread: u32,
    slice: u32,
    slices: u32,
}

// Columns and rows of samples.
struct SampleRect {
    origin: vec2<i32>,
    end: vec2<i32>,
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

// A triangle whose edge functions fit into 32 bits. One loop over all samples of its bounds, not two: threads that run together wait for
// the longest.
fn cover_alone(edges: Edges, bounds: SampleRect, fragments: Fragments) {
    let first = bounds.origin * SUBPIXEL_STEPS;
    var at = edges.dx * (first.y - edges.from_y) - edges.dy * (first.x - edges.from_x) - edges.bias;
    let per_column = -SUBPIXEL_STEPS * edges.dy;
    let size = bounds.end - bounds.origin;
    let to_next_row = SUBPIXEL_STEPS * edges.dx - size.x * per_column;
    var sample = bounds.origin;
    for (var remaining = size.x * size.y; remaining > 0; remaining--) {
        if all(at >= vec3(0)) { cover(sample, fragments); }
        sample.x += 1;
        at += per_column;
        if sample.x == bounds.end.x {
            sample = vec2(bounds.origin.x, sample.y + 1);
            at += to_next_row;
        }
    }
}

// A triangle of any size, by all threads of some workgroups.
fn cover_together(edges: Edges, bounds: SampleRect, fragments: Fragments, threads: Threads) {
    let within = vec2<i32>(vec2(threads.thread % u32(BLOCK), threads.thread / u32(BLOCK)));
    // The edge functions over 256, from the first sample of a block to that of the thread, and to the innermost of the block.
    let to_thread = edges.dx * within.y - edges.dy * within.x;
    let to_innermost = (BLOCK - 1) * (max(edges.dx, vec3(0)) + max(-edges.dy, vec3(0)));
    let first = bounds.origin.y + BLOCK * i32(threads.slice);
    for (var y = first; y < bounds.end.y; y += BLOCK * i32(threads.slices)) {
        for (var x = bounds.origin.x; x < bounds.end.x; x += BLOCK) {
            let at = vec3(
                edge_over_256(edges, 0u, x, y),
                edge_over_256(edges, 1u, x, y),
                edge_over_256(edges, 2u, x, y),
            );
            if any(at + to_innermost < vec3(0)) { continue; }
            let sample = vec2(x, y) + within;
            if all(sample < bounds.end) && all(at + to_thread >= vec3(0)) {
                cover(sample, fragments);
            }
        }
    }
}

// An edge function with its bias at a sample, divided by 256 and rounded down: steps from sample to sample are whole then. At least as far
// from 0 as 2^30 where it is beyond.
fn edge_over_256(edges: Edges, edge: u32, column: i32, row: i32) -> i32 {
    let products = wide_difference(
        wide_product(edges.dx[edge], SUBPIXEL_STEPS * row - edges.from_y[edge]),
        wide_product(edges.dy[edge], SUBPIXEL_STEPS * column - edges.from_x[edge]),
    );
    return wide_over_256(wide_difference(products, WideInteger(0, u32(edges.bias[edge]))));
}

// The samples of the tile whose centres lie in the bounds of three points.
fn bounds_of(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, tile: SampleRect) -> SampleRect {
    let low = min(a, min(b, c));
    let high = max(a, max(b, c));
    return SampleRect(max((low + (SUBPIXEL_STEPS - 1)) >> vec2(8u), tile.origin), min((high >> vec2(8u)) + 1, tile.end));
}

// Whether 32 bits hold the edge functions.
fn is_small(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>) -> bool {
    let span = max(a, max(b, c)) - min(a, min(b, c));
    return all(span < vec2(64 * SUBPIXEL_STEPS));
}

// The winding of three points: -1 of a front face (counter-clockwise), 1 of a back face, 0 of a triangle without area.
fn winding(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>) -> i32 {
    let area = wide_difference(wide_product(b.x - a.x, c.y - a.y), wide_product(b.y - a.y, c.x - a.x));
    if area.high != 0 { return sign(area.high); }
    return i32(area.low != 0u);
}

// The queue that a triangle of these points and bounds goes to.
fn queue_of(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, bounds: SampleRect) -> u32 {
    let size = bounds.end - bounds.origin;
    if size.x * size.y > MAX_LARGE { return QUEUE_HUGE; }
    return select(QUEUE_LARGE, DONE, is_small(a, b, c) && size.x * size.y <= MAX_ALONE);
}

// Covers the samples of a front face.
fn cover_triangle(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, bounds: SampleRect, fragments: Fragments, threads: Threads) {
    let edges = edges_of(a, b, c);
    if ARE_ALONE {
        cover_alone(edges, bounds, fragments);
    } else {
        cover_together(edges, bounds, fragments, threads);
    }
}
