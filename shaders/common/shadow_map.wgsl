// Sun occlusion by rocks. The shadow map is an atlas with one tile per caster: a midpoint shadow map
// (shadow_midpoint.wgsl; Woo 1992, "The Shadow Depth Map Revisited", Graphics Gems III). The midpoint gives each side of
// the caster a bias of half its thickness, of 4 texels at most: neither side shadows itself, and no light leaks in where
// the rock meets the ground or itself. A grid over the ground lists the casters that can reach each cell.

@group(2) @binding(1) var shadow_map: texture_2d<f32>;
// Per cell the start of its list (and after the last cell the end of the last list), then the lists: indices of tiles.
// TEST_HORIZON in a start: other ground can occlude the sun in this cell.
@group(2) @binding(3) var<storage, read> caster_grid: array<u32>;

const TEST_HORIZON: u32 = 0x80000000u;
const BLOCKER_TAPS: i32 = 8;
const FILTER_TAPS: i32 = 20;
// A filter with a smaller radius takes one tap, texels.
const MIN_FILTER_PX: f32 = 0.5;
// By how much the edge of a shadow may be steeper than one texel between light and dark.
const MAX_STEEPNESS: f32 = 8.0;

const COS_GOLDEN_ANGLE: f32 = -0.73736888;
const SIN_GOLDEN_ANGLE: f32 = 0.67549029;

// What can occlude the sun at the points of a cell.
struct GridCell {
    // Range of its casters in `caster_grid`.
    first: u32,
    end: u32,
    // Whether other ground can.
    in_horizon: bool,
}

// The receiving surface, as one caster's tile sees it. Heights are along the sun, above the caster's centre.
struct Receiver {
    // Texel position in the tile.
    texel: vec2<f32>,
    // Plane of the receiving triangle: rise along x and y, height at texel (0, 0), texels.
    plane: vec3<f32>,
}

// Index of the cell, in the finest grid that covers it, of a position (metres, world), among all cells of grids with this many a side.
fn cell_index(position: vec3<f32>, cells: i32) -> u32 {
    var level = 0;
    var half_m = light.caster_grid_half_m;
    if RINGS {
        let from_centre = abs(position.xy - light.caster_grid_centre);
        level = finest_level(max(from_centre.x, from_centre.y), half_m, light.caster_grid_levels);
        half_m *= exp2(f32(level));
    }
    let origin = light.caster_grid_centre - half_m;
    let cells_per_m = 0.5 * f32(cells) / half_m;
    // What juts out over the border of the ground has the border's cells.
    let cell = clamp(vec2<i32>(floor((position.xy - origin) * cells_per_m)), vec2(0), vec2(cells - 1));
    return u32((level * cells + cell.y) * cells + cell.x);
}

// What can occlude the sun at a position (metres, world).
fn grid_cell(position: vec3<f32>) -> GridCell {
    let index = cell_index(position, i32(light.caster_grid_cells));
    let start = caster_grid[index];
    let end = caster_grid[index + 1u] & ~TEST_HORIZON;
    return GridCell(start & ~TEST_HORIZON, end, (start & TEST_HORIZON) != 0u);
}

// Half the width of the shadow of a rock, as a fraction of half the side of its tile.
const SHADOW_RADIUS: f32 = 0.8;

// The shadow of the casters of a cell, and of the ground, at a position (metres, world); `of_ground` is that of the ground alone. `spoke` is
// a unit vector that rotates the filter taps.
fn shadow_of_casters(
    cell: GridCell,
    of_ground: Shadow,
    position: vec3<f32>,
    geometric_normal: vec3<f32>,
    normal: vec3<f32>,
    spoke: vec2<f32>,
) -> Shadow {
    let facing = dot(geometric_normal, light.sun_direction);
    // Rise of the triangle's plane along the sun, per metre across it.
    let across = vec2(dot(geometric_normal, light.sun_right), dot(geometric_normal, light.sun_up));
    let rise = -across * (1.0 / select(min(facing, -0.15), max(facing, 0.15), facing > 0.0));
    // Shadow terminator (Hanika 2021, "Hacking the Shadow Terminator", Ray Tracing Gems II): where the shading normal faces
    // the sun and the triangle hardly does, the triangle lies behind the smooth surface, by up to this share of its edge.
    let excess = clamp(3.0 * (dot(normal, light.sun_direction) - facing), 0.0, 1.0);
    let t = clamp(10.0 * facing, 0.0, 1.0);
    let terminator_bias = 0.5 * excess * (1.0 - t * t * (3.0 - 2.0 * t));
    var shadow = of_ground;
    for (var i = cell.first; i < cell.end && shadow.visibility > 0.0; i++) {
        let own = caster_visibility(caster_grid[i], position, rise, terminator_bias, spoke);
        shadow.visibility *= own.visibility;
        shadow.depth_m = max(shadow.depth_m, own.depth_m);
    }
    return shadow;
}

// The shadow of one caster. The mean height of the blockers gives the width of the penumbra
// (Fernando 2005, "Percentage-Closer Soft Shadows"), from the angle that the sun's disc spans. Heights are
// relative to the plane of the receiving triangle, which therefore never occludes itself.
fn caster_visibility(
    caster: u32,
    position: vec3<f32>,
    rise: vec2<f32>,
    terminator_bias: f32,
    spoke: vec2<f32>,
) -> Shadow {
    let sphere = tiles[caster][0];
    let offset = position - sphere.xyz;
    let half_extent_m = sphere.w;
    let across = vec2(dot(offset, light.sun_right), dot(offset, light.sun_up));
    let along = dot(offset, light.sun_direction);
    let max_blocker_m = half_extent_m - along;
    if max_blocker_m <= 0.0 { return Shadow(1.0, 0.0); }
    let search_m = light.sun_tan_half_angle * max_blocker_m;
    if any(abs(across) > vec2(half_extent_m + search_m)) { return Shadow(1.0, 0.0); }
    let depth_m = max(SHADOW_RADIUS * half_extent_m - length(across), 0.0);
    let rectangle = tiles[caster][1];
    let tile = CasterTile(sphere.xyz, half_extent_m, rectangle.xy, rectangle.z, rectangle.w);
    let texel_uv = 1.0 / vec2<f32>(textureDimensions(shadow_map));
    let texels_per_m = 0.5 * tile.size_px / half_extent_m;
    let texel = vec2(across.x, -across.y) * texels_per_m + vec2(0.5 * tile.size_px);
    let search_px = search_m * texels_per_m;
    let slope = vec2(rise.x, -rise.y);
    let plane = vec3(slope, (along + terminator_bias * tile.edge_m) * texels_per_m - dot(slope, texel));
    let receiver = Receiver(texel, plane);

    // The filter is never wider than the search, which is left out where it is too narrow to matter. Both are loops without
    // a shorter path beside them, because llvmpipe takes the time of every path.
    let search_taps = select(0, BLOCKER_TAPS, search_px >= MIN_FILTER_PX);
    let blockers = blocker_search(tile, receiver, search_taps, search_px, spoke, texel_uv);
    if search_px > 1.0 {
        if blockers.x == 0.0 { return Shadow(1.0, 0.0); }
        if blockers.x == f32(BLOCKER_TAPS) { return Shadow(0.0, depth_m); }
    }
    let filter_px = light.sun_tan_half_angle * blockers.y / max(blockers.x, 1.0);
    let occlusion = filtered_occlusion(tile, receiver, filter_px, spoke, texel_uv);
    return Shadow(1.0 - occlusion, occlusion * depth_m);
}

// Number of taps whose texel occludes the receiver, and the sum of their heights above its plane, texels.
fn blocker_search(
    tile: CasterTile,
    receiver: Receiver,
    taps: i32,
    radius_px: f32,
    first_spoke: vec2<f32>,
    texel_uv: vec2<f32>,
) -> vec2<f32> {
    var blockers = 0.0;
    var height_px = 0.0;
    var spoke = first_spoke;
    for (var i = 0; i < taps; i++) {
        let tap = receiver.texel + radius_px * sqrt((f32(i) + 0.5) / f32(BLOCKER_TAPS)) * spoke;
        spoke = next_spoke(spoke);
        let above = height_above(tile, floor(tap), receiver.plane, texel_uv);
        if above > 0.0 {
            blockers += 1.0;
            height_px += above;
        }
    }
    return vec2(blockers, height_px);
}

// Percentage-closer filtering over a disc (Reeves et al. 1987, "Rendering Antialiased Shadows with Depth Maps").
// A penumbra is twice as wide as the filter's radius, and the weights of four texels rise over one texel: where it is narrower, as in
// the shadow of a crease of the rock itself, the edge between dark and lit texels is made as steep as the penumbra is.
fn filtered_occlusion(
    tile: CasterTile,
    receiver: Receiver,
    filter_px: f32,
    first_spoke: vec2<f32>,
    texel_uv: vec2<f32>,
) -> f32 {
    let is_wide = filter_px >= MIN_FILTER_PX;
    let taps = select(1, FILTER_TAPS, is_wide);
    let radius_px = select(0.0, filter_px, is_wide);
    var sum = 0.0;
    var spoke = first_spoke;
    for (var i = 0; i < taps; i++) {
        let tap = receiver.texel + radius_px * sqrt((f32(i) + 0.5) / f32(FILTER_TAPS)) * spoke;
        sum += occlusion_at(tile, tap, receiver.plane, texel_uv);
        spoke = next_spoke(spoke);
    }
    let steepness = clamp(0.5 / max(filter_px, 1.0e-3), 1.0, MAX_STEEPNESS);
    return clamp(0.5 + steepness * (sum / f32(taps) - 0.5), 0.0, 1.0);
}

// Rotates by the golden angle: points on such spokes, at radii of square roots, cover a disc evenly (Vogel 1979, "A better
// way to construct the sunflower head").
fn next_spoke(spoke: vec2<f32>) -> vec2<f32> {
    return vec2(
        COS_GOLDEN_ANGLE * spoke.x - SIN_GOLDEN_ANGLE * spoke.y,
        SIN_GOLDEN_ANGLE * spoke.x + COS_GOLDEN_ANGLE * spoke.y,
    );
}

// Bilinear weight of those of the four texels around a position in the tile at which the caster is above the plane.
fn occlusion_at(tile: CasterTile, texel: vec2<f32>, plane: vec3<f32>, texel_uv: vec2<f32>) -> f32 {
    let corner = floor(texel - 0.5);
    let in_map = textureGather(0, shadow_map, nearest, (tile.origin_px + corner + 1.0) * texel_uv);
    // In the order of `textureGather`.
    let columns = corner.x + vec4(0.0, 1.0, 1.0, 0.0);
    let rows = corner.y + vec4(1.0, 1.0, 0.0, 0.0);
    let in_tile = (min(columns, rows) >= vec4(0.0)) & (max(columns, rows) < vec4(tile.size_px));
    let heights = in_map - (plane.z + plane.x * (columns + 0.5) + plane.y * (rows + 0.5));
    return bilinear(select(vec4(0.0), vec4(1.0), in_tile & (heights > vec4(0.0))), texel - 0.5 - corner);
}

// Height of the map above the plane at a texel of the tile, texels; far below outside the tile.
fn height_above(tile: CasterTile, texel: vec2<f32>, plane: vec3<f32>, texel_uv: vec2<f32>) -> f32 {
    let in_map = textureSampleLevel(shadow_map, nearest, (tile.origin_px + texel + 0.5) * texel_uv, 0.0).r;
    let in_tile = all(texel >= vec2(0.0)) && all(texel < vec2(tile.size_px));
    let height = in_map - plane.z - dot(plane.xy, texel + 0.5);
    return select(-1.0e9, height, in_tile);
}
