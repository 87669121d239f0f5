// The pits of the ground below the mesh, craters and clods: their slopes, heights and shades where the ray to the eye meets them, and their
// shadows. src/render/lighting/pits_host.rs is the CPU counterpart and explains them; the pits themselves are src/scene/craters.rs.

// src/scene/craters.rs has the same constants and explains them.
const JITTER_CELLS: f32 = 0.17;
const PROFILE_DEPTH: f32 = 0.114;
const RIM: f32 = 0.02513;
const CLOD_HEIGHT: f32 = 0.22;
const SECOND_HASH: u32 = 0x2c1b3c6du;
// src/render/lighting/pits_host.rs has the same constants and explains them.
const FRESH_SHADE: f32 = 0.2;
const FRESH_FLOOR: f32 = 0.6;
const FRESH_WAVES: f32 = 0.15;
const PIT_REACH: f32 = 1.51;

// A point of the mesh (metres from the centre of the ground), and the rays from there: as the arguments of `ground_detail`.
struct PitRays {
    point: vec2<f32>,
    eye_way: vec2<f32>,
    sun_way: vec2<f32>,
    per_sun_way: f32,
    sun_lift: f32,
    cell_m: f32,
    sample_m: f32,
    across_m: f32,
}

// A pit of a lattice.
struct Pit {
    diameter_m: f32,
    // Of a crater, diameters.
    depth: f32,
    is_clod: bool,
    // How much of it the mesh leaves out and samples can show.
    share: f32,
}

// A point of a pit: its distance from the centre in radii, the slope per radius from there, and its height, metres.
struct PitPoint {
    offset: vec2<f32>,
    r: f32,
    slope_per_radius: f32,
    height_m: f32,
}

// Adds the pit of a lattice's cell to what is summed so far, and its shadow: at most one crater or clod a cell, which does not reach beyond
// its cell: its centre is at most JITTER_CELLS off the cell's, its radius at most 0.22 cells, and it has faded out at 1.5 radii.
fn add_pits(before: vec4<f32>, lattice: Lattice, rays: PitRays, occluder: ptr<function, Occluder>) -> vec4<f32> {
    if sample_share(1.001 * lattice.max_diameter_m, rays.sample_m) == 0.0 { return before; }
    let local = to_lattice(lattice, rays.point + before.w * rays.eye_way);
    let corner = floor(local);
    let cell = lattice.base + vec2<i32>(corner);
    let first = lattice_hash(cell.x, cell.y, 0, lattice.seed);
    if f32(first & 0xffffu) / 65536.0 >= lattice.amount { return before; }
    let second = second_hash(first);
    let jitter = (vec2(f32(second & 0x3ffu), f32((second >> 10u) & 0x3ffu)) / 512.0 - 1.0) * JITTER_CELLS + 0.5;
    let age = f32(first >> 16u) / 65536.0;
    var pit: Pit;
    pit.diameter_m = 0.5 * lattice.max_diameter_m * inverseSqrt(1.0 - 0.75 * f32(second >> 20u) / 4096.0);
    pit.depth = crater_depth((age - lattice.share) / (1.0 - lattice.share));
    pit.is_clod = age < lattice.share;
    let local_m = local_sample_m(rays.sample_m, before.xy, rays.eye_way);
    pit.share = (1.0 - mesh_share(pit.diameter_m, rays.cell_m)) * sample_share(pit.diameter_m, local_m);
    let radius_m = 0.5 * pit.diameter_m;
    // In radii of the pit from here on.
    let offset = (local - corner - jitter) * (lattice.cell_m / radius_m);
    if pit.share == 0.0 || dot(offset, offset) >= PIT_REACH * PIT_REACH { return before; }
    let way = along_lattice(lattice, rays.eye_way) / radius_m;
    let rise = 1.0 - dot(before.xy, rays.eye_way);
    // A clod hides the ground behind it: the ray is followed from where it passes closest to the centre, if it is inside there.
    let closest_m = clamp(-dot(offset, way) / max(dot(way, way), 1.0e-12), 0.0, CLOD_HEIGHT * pit.diameter_m);
    let closest = offset + closest_m * way;
    let is_inside = pit.is_clod
        && pit.share * pit.diameter_m * clod_height(dot(closest, closest)) > closest_m * rise;
    let start_m = select(0.0, closest_m, is_inside);
    // Two steps of Newton's method.
    let start = pit_point(pit, offset + start_m * way);
    let climb = start.slope_per_radius * dot(start.offset, way) * radius_m;
    let first_m = start_m + (start.height_m - start_m * rise) / max(rise - climb, MIN_CLEARANCE);
    let seen = pit_point(pit, offset + first_m * way);
    let slope = along_ground(lattice, seen.slope_per_radius * seen.offset);
    let is_fresh = !pit.is_clod && age - lattice.share < light.relief_fresh_share * (1.0 - lattice.share);
    let fade = clamp((1.5 - seen.r) * 2.5, 0.0, 1.0);
    let shade = select(0.0, fade * FRESH_SHADE * freshness(first, seen.offset / seen.r, seen.r) * pit.share, is_fresh);
    let risen = vec4(before.xyz, before.w + first_m);
    let sum = add_detail(risen, vec4(slope, shade, seen.height_m - first_m * rise), rays.eye_way);
    (*occluder).clearance_m += rays.sun_lift * (sum.w - before.w) * apart(*occluder, pit.diameter_m);
    // Its shadow: of a crater's crest into the crater, of a clod where the ray to the sun passes closest to its centre.
    let sun = along_lattice(lattice, rays.sun_way * rays.per_sun_way);
    let away = dot(seen.offset, sun);
    let past = away * away - seen.r * seen.r;
    let way_r = select(sqrt(max(past + 1.0, 0.0)) - away, max(-away, 0.0), pit.is_clod);
    let top = select(RIM / PROFILE_DEPTH * pit.depth, clod_height(max(-past, 0.0)), pit.is_clod);
    let way_m = way_r * radius_m;
    let rise_m = way_m * rays.per_sun_way * (1.0 - dot(before.xy, rays.sun_way));
    if fade > 0.0 && (pit.is_clod || seen.r < 1.0) && way_m > rays.across_m {
        let clearance_m = rise_m / fade - (pit.share * pit.diameter_m * top - seen.height_m);
        *occluder = nearer_occluder(*occluder, Occluder(clearance_m, way_m, sum.w));
    }
    return sum;
}

// How fresh the soil of a fresh crater is in a direction from its centre, at a distance of `r` radii.
fn freshness(first: u32, way: vec2<f32>, r: f32) -> f32 {
    let square = way * way;
    // Cosines and sines of two and three times the angle.
    let waves = vec4(
        2.0 * square.x - 1.0,
        2.0 * way.x * way.y,
        way.x * (4.0 * square.x - 3.0),
        way.y * (3.0 - 4.0 * square.y),
    );
    let bits = vec4<f32>((vec4(first) >> vec4(16u, 18u, 20u, 22u)) & vec4(15u));
    let reach = r * (1.0 + FRESH_WAVES * dot(bits * (2.0 / 15.0) - 1.0, waves));
    return select(1.0 / (reach * reach * reach), mix(FRESH_FLOOR, 1.0, reach * reach), reach < 1.0);
}

fn pit_point(pit: Pit, offset: vec2<f32>) -> PitPoint {
    let r = sqrt(max(dot(offset, offset), 1.0e-12));
    let profile = select(crater_profile(r, pit.depth), vec2(clod_steepness(r), clod_height(r * r)), pit.is_clod);
    return PitPoint(offset, r, pit.share * profile.x / r, pit.share * pit.diameter_m * profile.y);
}

// Height of a clod, diameters, at a distance whose square this is, radii.
fn clod_height(square: f32) -> f32 {
    let rise = max(1.0 - square, 0.0);
    return CLOD_HEIGHT * rise * rise;
}

fn clod_steepness(r: f32) -> f32 {
    return -8.0 * CLOD_HEIGHT * r * max(1.0 - r * r, 0.0);
}

// Depth of a crater of an age in [0, 1), diameters (Stopar et al. 2017, Wu et al. 2021).
fn crater_depth(age: f32) -> f32 {
    let fresh_share = light.relief_fresh_share;
    let wear = (age - fresh_share) / (1.0 - fresh_share);
    let fresh = 0.15 - 0.04 / max(fresh_share, 1.0e-6) * age;
    // A worn crater's depth falls from 0.12 to 0.02 with age, evenly in the logarithm.
    return select(min(0.12 * exp2(-2.5849625 * wear), 0.1099), fresh, age < fresh_share);
}

// Rise per metre away from the centre of a crater of a depth, and height, at a distance `r` in radii. Depths and heights are in diameters.
// The profile is a fit to that of Yang et al. 2021; src/render/lighting/pits_host.rs derives the numbers.
fn crater_profile(r: f32, depth: f32) -> vec2<f32> {
    // Inside the crest the derivative of the profile's polynomial; outside that of the ejecta's power law, faded out before
    // the next cell.
    let bowl = 0.0513832 + r * (-0.1504748 + r * (2.9375904 + r * (-5.661628 + r * 2.871354)));
    let square = r * r;
    let fade = clamp((1.5 - r) * 2.5, 0.0, 1.0);
    let ejecta = -3.1906 * RIM / (square * square) * fade;
    let p = -0.1142066 + r * (-0.0628234 + r * (-0.1380608 + r * (0.8411362 - 0.5742708 * r)));
    let height = select(RIM / (square * r) * fade, RIM + (1.0 - r) * p, r < 1.0);
    return depth / PROFILE_DEPTH * vec2(2.0 * select(ejecta, bowl, r < 1.0), height);
}
