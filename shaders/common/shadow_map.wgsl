// How much of the sun's disc is seen from a place.
//
// Two maps answer. The horizon map says for the ground how high a place must lie to see each limb of the sun
// past all the ground between. The shadow map is an atlas of the casters: of each, the middle between its front and its
// back as seen from the sun. That is what casts, so that neither side shadows itself and no light leaks in
// where it stands on the ground: a bias of half the thickness of the thing, which needs no tuning ("midpoint
// shadow maps": Woo 1992, Graphics Gems III, "The Shadow Depth Map Revisited").

@group(2) @binding(1) var shadow_map: texture_2d<f32>;
@group(2) @binding(2) var horizon_map: texture_2d<f32>;
// First the start of each cell's list (and the end of the last), then the lists: indices of tiles. A start has the
// highest bit set where the horizon map is to be asked too.
@group(2) @binding(3) var<storage, read> caster_grid: array<u32>;
// Texels of the maps are sampled, four at once where that many are asked for, and not loaded: a device that is a CPU reckons
// with a level of detail for each lane of a load, which takes several times as long.
@group(2) @binding(4) var nearest: sampler;

const COS_GOLDEN_ANGLE: f32 = -0.73736888;
const SIN_GOLDEN_ANGLE: f32 = 0.67549029;
// Whether the ground is made of rings, each with grids over twice the one before.
override RINGS: bool;

const TEST_HORIZON: u32 = 0x80000000u;
const SEARCH_TAPS: i32 = 8;
const FILTER_TAPS: i32 = 20;
// Radius of a filter that is not worth more than one tap, texels.
const NARROW_PX: f32 = 0.5;

// What a place must ask.
struct GridCell {
    // Its casters, from and up to which place in the grid.
    first: u32,
    end: u32,
    // Whether other ground may hide some of the sun.
    asks_horizon: bool,
}

// The cell of the finest grid that holds a place (metres, world).
fn grid_cell(position: vec3<f32>) -> GridCell {
    let cells = i32(light.caster_cells);
    var level = 0;
    var half_m = light.caster_half_m;
    if RINGS {
        let from_centre = abs(position.xy - light.caster_centre);
        level = finest(max(from_centre.x, from_centre.y), half_m, light.caster_levels);
        half_m *= exp2(f32(level));
    }
    let origin = light.caster_centre - half_m;
    let cells_per_m = 0.5 * f32(cells) / half_m;
    // What juts out over the border of the ground has the neighbours of its border.
    let cell = clamp(vec2<i32>(floor((position.xy - origin) * cells_per_m)), vec2(0), vec2(cells - 1));
    let index = u32((level * cells + cell.y) * cells + cell.x);
    let start = caster_grid[index];
    let end = caster_grid[index + 1u] & ~TEST_HORIZON;
    return GridCell(start & ~TEST_HORIZON, end, (start & TEST_HORIZON) != 0u);
}

// Of grids that each reach twice as far as the one before, the first that reaches so far.
fn finest(distance_m: f32, first_reach_m: f32, levels: u32) -> i32 {
    return clamp(i32(ceil(log2(max(distance_m, 1.0e-3) / first_reach_m))), 0, i32(levels) - 1);
}

// Fraction of the sun's disc seen past the casters of a cell at a place (metres, world) of a surface, from which other
// ground leaves `open`. `facet_normal` is that of its triangle, `normal` the smooth one. `turn` in [0, 1) turns the pattern
// of the taps.
fn visibility_past_casters(
    cell: GridCell,
    open: f32,
    position: vec3<f32>,
    facet_normal: vec3<f32>,
    normal: vec3<f32>,
    first_spoke: vec2<f32>,
) -> f32 {
    let facing = dot(facet_normal, light.sun_direction);
    // How the facet's plane rises along the sun per metre across it.
    let across = vec2(dot(facet_normal, light.sun_right), dot(facet_normal, light.sun_up));
    let rise = -across * (1.0 / select(min(facing, -0.15), max(facing, 0.15), facing > 0.0));
    // Where the smooth surface faces the sun and the facet hardly does, the facet lies behind the surface that it
    // stands for (the shadow terminator: Hanika 2021, "Hacking the Shadow Terminator", Ray Tracing Gems II): by up
    // to this share of its length.
    let excess = clamp(3.0 * (dot(normal, light.sun_direction) - facing), 0.0, 1.0);
    let turned = clamp(10.0 * facing, 0.0, 1.0);
    let behind = 0.5 * excess * (1.0 - turned * turned * (3.0 - 2.0 * turned));
    var visible = open;
    for (var i = cell.first; i < cell.end && visible > 0.0; i++) {
        visible *= caster_visibility(caster_grid[i], position, rise, behind, first_spoke);
    }
    return visible;
}

// Fraction of the disc that stands above the ground's horizon. The horizon is taken as straight across the disc.
fn horizon_visibility(position: vec3<f32>) -> f32 {
    var level = 0;
    if RINGS {
        level = finest(distance(position.xy, light.horizon_centre), light.horizon_base_m, light.horizon_levels);
    }
    let grid = frame.horizon[level];
    let offset = (position.xy - grid.origin) * (1.0 / grid.step_m);
    let towards = light.horizon_towards;
    let limit = vec2<f32>(grid.size) - 1.001;
    // Columns run towards the sun, rows across. Where between samples a place lies must not depend, by a rounding, on which of
    // them the map begins with.
    let counted = vec2(dot(offset, towards), dot(offset, vec2(-towards.y, towards.x)));
    let at = clamp(counted, grid.first, grid.first + limit);
    let corner = floor(at);
    let t = at - corner;
    // Where the four meet.
    let texel = corner - grid.first + vec2(1.0, 1.0 + f32(grid.first_row));
    let meet = texel / vec2<f32>(textureDimensions(horizon_map));
    let limbs = vec2(
        bilinear(textureGather(0, horizon_map, nearest, meet), t),
        bilinear(textureGather(1, horizon_map, nearest, meet), t),
    );
    // Heights from which the lower and the upper limb are just seen.
    if position.z >= limbs.x { return 1.0; }
    if position.z <= limbs.y { return 0.0; }
    let u = clamp(2.0 * (position.z - limbs.y) / (limbs.x - limbs.y) - 1.0, -1.0, 1.0);
    // Area of a unit disc beyond a chord.
    return 0.5 + (u * sqrt(1.0 - u * u) + asin(u)) * (1.0 / 3.14159265);
}

// Between four texels as they are gathered: from the one at (0, 1) around by (1, 1) and (1, 0) to (0, 0).
fn bilinear(texels: vec4<f32>, t: vec2<f32>) -> f32 {
    return mix(mix(texels.w, texels.z, t.x), mix(texels.x, texels.y, t.x), t.y);
}

// Fraction of the disc not hidden by one caster: the mean height of what hides the disc gives the width of the
// penumbra (Fernando 2005, "Percentage-Closer Soft Shadows"), here in metres and with no light size to choose.
// Heights are compared above the plane of the receiving facet, which so never hides the sun from itself.
fn caster_visibility(
    caster: u32,
    position: vec3<f32>,
    rise: vec2<f32>,
    behind: f32,
    first_spoke: vec2<f32>,
) -> f32 {
    let ball = tiles[caster][0];
    let offset = position - ball.xyz;
    let half_extent_m = ball.w;
    let across = vec2(dot(offset, light.sun_right), dot(offset, light.sun_up));
    let along = dot(offset, light.sun_direction);
    let reach = half_extent_m - along;
    if reach <= 0.0 { return 1.0; }
    let search_m = light.sun_tan_half_angle * reach;
    if any(abs(across) > vec2(half_extent_m + search_m)) { return 1.0; }
    let place = tiles[caster][1];
    let tile = CasterTile(ball.xyz, half_extent_m, place.xy, place.z, place.w);
    let map_texel = 1.0 / vec2<f32>(textureDimensions(shadow_map));
    let m_per_texel = 2.0 * half_extent_m / tile.size_px;
    let texels_per_m = 1.0 / m_per_texel;
    let at = vec2(across.x, -across.y) * texels_per_m + vec2(0.5 * tile.size_px);
    let search_px = search_m * texels_per_m;
    // The facet's plane over the tile: height at texel (0, 0) and rise per texel.
    let slope = vec2(rise.x, -rise.y) * m_per_texel;
    let plane = vec3(slope, along + behind * tile.facet_m - dot(slope, at));

    // The filter is no wider than the search: where that is too narrow to matter there is no need for it. Both are loops,
    // and have no shorter way beside them, because a driver that runs on the CPU takes its time for every way.
    let search_taps = select(0, SEARCH_TAPS, search_px >= NARROW_PX);
    var blockers = 0.0;
    var height_m = 0.0;
    var spoke = first_spoke;
    for (var i = 0; i < search_taps; i++) {
        let tap = at + search_px * sqrt((f32(i) + 0.5) / f32(SEARCH_TAPS)) * spoke;
        spoke = next_spoke(spoke);
        let above = height_above(tile, floor(tap), plane, map_texel);
        if above > 0.0 {
            blockers += 1.0;
            height_m += above;
        }
    }
    if search_px > 1.0 {
        if blockers == 0.0 { return 1.0; }
        if blockers == f32(SEARCH_TAPS) { return 0.0; }
    }
    let filter_px = light.sun_tan_half_angle * height_m / max(blockers, 1.0) * texels_per_m;
    let wide = filter_px >= NARROW_PX;
    let taps = select(1, FILTER_TAPS, wide);
    let radius_px = select(0.0, filter_px, wide);
    var hidden_sum = 0.0;
    spoke = first_spoke;
    for (var i = 0; i < taps; i++) {
        let tap = at + radius_px * sqrt((f32(i) + 0.5) / f32(FILTER_TAPS)) * spoke;
        hidden_sum += hidden(tile, tap, plane, map_texel);
        spoke = next_spoke(spoke);
    }
    return 1.0 - hidden_sum / f32(taps);
}

// The next of the directions in which points lie that are spread evenly over a disc, a golden angle on (Vogel 1979, "A better way
// to construct the sunflower head").
fn next_spoke(spoke: vec2<f32>) -> vec2<f32> {
    return vec2(
        COS_GOLDEN_ANGLE * spoke.x - SIN_GOLDEN_ANGLE * spoke.y,
        SIN_GOLDEN_ANGLE * spoke.x + COS_GOLDEN_ANGLE * spoke.y,
    );
}

// Share of the four texels around a place (in texels of the tile) in which the caster stands above the plane.
fn hidden(tile: CasterTile, at: vec2<f32>, plane: vec3<f32>, map_texel: vec2<f32>) -> f32 {
    let corner = floor(at - 0.5);
    let middles = textureGather(0, shadow_map, nearest, (tile.origin_px + corner + 1.0) * map_texel);
    let columns = corner.x + vec4(0.0, 1.0, 1.0, 0.0);
    let rows = corner.y + vec4(1.0, 1.0, 0.0, 0.0);
    let in_tile = (min(columns, rows) >= vec4(0.0)) & (max(columns, rows) < vec4(tile.size_px));
    let heights = middles * tile.half_extent_m - (plane.z + plane.x * (columns + 0.5) + plane.y * (rows + 0.5));
    return bilinear(select(vec4(0.0), vec4(1.0), in_tile & (heights > vec4(0.0))), at - 0.5 - corner);
}

// Height of the middle of the caster above a plane at a texel of the tile, metres along the sun; far below it where the caster
// is not.
fn height_above(tile: CasterTile, texel: vec2<f32>, plane: vec3<f32>, map_texel: vec2<f32>) -> f32 {
    let middle = textureSampleLevel(shadow_map, nearest, (tile.origin_px + texel + 0.5) * map_texel, 0.0).r;
    let in_tile = all(texel >= vec2(0.0)) && all(texel < vec2(tile.size_px));
    let height = middle * tile.half_extent_m - plane.z - dot(plane.xy, texel + 0.5);
    return select(-1.0e9, height, in_tile);
}
