// The grains of the soil: ellipsoids on lattices, met by rays in closed form. src/scene/grains.rs has the same functions and
// constants and explains them; CPU counterpart of the walks: src/render/lighting/grains_host.rs.

const GRAIN_JITTER_CELLS: f32 = 0.1875;
const GRAIN_MAX_RADIUS: f32 = 0.625;
const GRAIN_MAX_HEIGHT: f32 = 0.55;
const GRAIN_MAX_STRETCH: f32 = 1.25;
const GRAIN_FRAGMENT_HEIGHTS: vec2<f32> = vec2(0.25, 0.5);
const GRAIN_CLOD_HEIGHTS: vec2<f32> = vec2(0.1, 0.3);
const GRAIN_MAX_TILT: f32 = 0.3;
const GRAIN_CLOD_SPREAD: f32 = 0.2;
const GRAIN_MAX_SLOPE: f32 = 6.0;
const GRAIN_FACETS: u32 = 4u;
const GRAIN_FACET_DISTANCES: vec2<f32> = vec2(0.6, 0.95);
const GRAIN_THIRD_KEY: u32 = 0x9e3779b9u;
// Cells of a lattice that a ray is followed through, and the largest horizontal way per metre that it rises.
const GRAIN_MAX_CELLS: u32 = 5u;
const GRAIN_MAX_EYE_WAY: f32 = 8.0;
const GRAIN_MAX_SUN_WAY: f32 = 11.0;
// Share of the ground's own slope that a grain's surface has.
const GRAIN_ROUGHNESS: f32 = 0.8;

// A grain of a lattice: an ellipsoid about a point of the ground.
struct Grain {
    // From its centre to the start of a ray, metres along the lattice's axes.
    point: vec2<f32>,
    diameter_m: f32,
    // Direction of its long axis.
    axis: vec2<f32>,
    // Inverse half axes: long, short, vertical, 1/m.
    per_axis: vec3<f32>,
    // Rise of its middle plane per metre along the long axis.
    tilt: f32,
    // Hash from which the planes that cut it are drawn.
    facet_hash: u32,
}

// The ground as a sample shows it: its normal's slope relative to the mesh, its albedo relative to the material's, and the
// fraction of the sun's disc that grains leave visible.
struct GroundDetail {
    slope: vec2<f32>,
    albedo: f32,
    sun: f32,
}

// A ray from the ground through the cells of a lattice.
struct GrainWalk {
    // Cells from the lattice's base cell.
    cell: vec2<i32>,
    // Its start in that cell, cells from its corner.
    start: vec2<f32>,
    // Where it enters the next column and the next row, as fractions of its length, and the steps from one to the next.
    next: vec2<f32>,
    step: vec2<f32>,
    sign: vec2<f32>,
    // Horizontal way per metre that it rises, metres along the lattice's axes.
    per_height: vec2<f32>,
}

// Horizontal way of a ray in a direction, per metre that it rises above a plane with this normal; at most `max_way`.
fn way_per_height(direction: vec3<f32>, normal: vec3<f32>, max_way: f32) -> vec2<f32> {
    let rise = dot(direction, normal) / max(normal.z, 0.1);
    let way = length(direction.xy);
    return direction.xy / max(rise, max(way / max_way, 1.0e-6));
}

// A vector of the ground's plane in the lattice's axes.
fn along_lattice(lattice: Lattice, v: vec2<f32>) -> vec2<f32> {
    let rotation = lattice.rotation_per_m * lattice.cell_m;
    return vec2(rotation.x * v.x + rotation.y * v.y, rotation.x * v.y - rotation.y * v.x);
}

// The inverse: a vector of the lattice's axes in the ground's plane.
fn along_ground(lattice: Lattice, v: vec2<f32>) -> vec2<f32> {
    return lattice.cell_m * slope_from_lattice(lattice, v);
}

fn grain_walk(lattice: Lattice, point: vec2<f32>, per_height: vec2<f32>) -> GrainWalk {
    var walk: GrainWalk;
    let local = to_lattice(lattice, point);
    let corner = floor(local);
    walk.cell = lattice.base + vec2<i32>(corner);
    walk.start = local - corner;
    walk.per_height = along_lattice(lattice, per_height);
    // The whole way, cells: up to the largest height of a grain.
    let way = walk.per_height * (GRAIN_MAX_HEIGHT * lattice.max_diameter_m / lattice.cell_m);
    walk.sign = select(vec2(-1.0), vec2(1.0), way > vec2(0.0));
    walk.step = 1.0 / max(abs(way), vec2(1.0e-6));
    walk.next = walk.step * select(walk.start, 1.0 - walk.start, way > vec2(0.0));
    return walk;
}

fn hash_fraction(bits: u32, mask: u32) -> f32 {
    return f32(bits & mask) / f32(mask + 1u);
}

// One round of Wellons' hash, as `second_hash` in src/scene/craters.rs.
fn second_hash(first: u32) -> u32 {
    let second = (first ^ (first >> 15u)) * SECOND_HASH;
    return second ^ (second >> 12u);
}

// Whether the grain of a cell with this first hash is a fragment of rock, else a clod.
fn is_fragment(lattice: Lattice, first: u32) -> bool {
    return hash_fraction(first >> 16u, 0xffffu) < lattice.share;
}

// The grain of a cell that has one, by the first two hashes of the cell.
fn grain_of(lattice: Lattice, first: u32, second: u32, point: vec2<f32>, diameter_m: f32) -> Grain {
    let third = second_hash(second ^ GRAIN_THIRD_KEY);
    let is_rock = is_fragment(lattice, first);
    let across = 2.0 * hash_fraction(third, 0xffu) - 1.0;
    let stretch = 1.0 + (GRAIN_MAX_STRETCH - 1.0) * hash_fraction(third >> 8u, 0xffu);
    let heights = select(GRAIN_CLOD_HEIGHTS, GRAIN_FRAGMENT_HEIGHTS, is_rock);
    let height = mix(heights.x, heights.y, hash_fraction(third >> 16u, 0xffu));
    let per_radius = 2.0 / diameter_m;
    return Grain(
        point,
        diameter_m,
        normalize(vec2(across, 1.0 - abs(across))),
        vec3(per_radius / stretch, per_radius * stretch, 1.0 / (height * diameter_m)),
        GRAIN_MAX_TILT * (2.0 * hash_fraction(third >> 24u, 0xffu) - 1.0),
        second_hash(third),
    );
}

// Albedo, relative to that of the soil, of the grain of a cell with these first two hashes.
fn grain_albedo(lattice: Lattice, first: u32, second: u32) -> f32 {
    let view = relief_view();
    let fourth = second_hash(second_hash(second ^ GRAIN_THIRD_KEY));
    let sum = hash_fraction(fourth, 0xffu) + hash_fraction(fourth >> 8u, 0xffu)
        + hash_fraction(fourth >> 16u, 0xffu) + hash_fraction(fourth >> 24u, 0xffu);
    let is_rock = is_fragment(lattice, first);
    let spread = view.grain_spread * select(GRAIN_CLOD_SPREAD, 1.0, is_rock);
    let ratio = select(1.0, view.grain_ratio, is_rock);
    return ratio * exp(spread * (sum - 2.0) * 1.7320508);
}

// A ray where the grain is a unit sphere: its origin, and its way per metre that it rises.
struct SphereRay {
    origin: vec3<f32>,
    way: vec3<f32>,
}

fn as_sphere(grain: Grain, per_height: vec2<f32>) -> SphereRay {
    let across = vec2(-grain.axis.y, grain.axis.x);
    let p = vec2(dot(grain.axis, grain.point), dot(across, grain.point));
    let d = vec2(dot(grain.axis, per_height), dot(across, per_height));
    return SphereRay(
        vec3(p, -grain.tilt * p.x) * grain.per_axis,
        vec3(d, 1.0 - grain.tilt * d.x) * grain.per_axis,
    );
}

// Where a ray leaves a grain: xy the slope there along the lattice's axes, z the height above the ground, 0 or less without a
// hit.
fn grain_hit(grain: Grain, per_height: vec2<f32>) -> vec3<f32> {
    let ray = as_sphere(grain, per_height);
    let a = dot(ray.way, ray.way);
    let b = dot(ray.origin, ray.way);
    let discriminant = b * b - a * (dot(ray.origin, ray.origin) - 1.0);
    let root = sqrt(max(discriminant, 0.0));
    var from_m = (-root - b) / a;
    var to_m = (root - b) / a;
    // Where the ray leaves the ellipsoid; within a facet, the facet's normal instead.
    var facet = vec3(0.0);
    var in_facet = false;
    var hash = grain.facet_hash;
    for (var k = 0u; k < GRAIN_FACETS; k++) {
        hash = second_hash(hash ^ GRAIN_THIRD_KEY);
        let plane = vec3(
            2.0 * hash_fraction(hash, 0xffu) - 1.0,
            2.0 * hash_fraction(hash >> 8u, 0xffu) - 1.0,
            hash_fraction(hash >> 16u, 0xffu) + 0.01,
        );
        let unit_plane = normalize(plane);
        let rise = dot(unit_plane, ray.way);
        let left = mix(GRAIN_FACET_DISTANCES.x, GRAIN_FACET_DISTANCES.y, hash_fraction(hash >> 24u, 0xffu))
            - dot(unit_plane, ray.origin);
        let at_m = left / select(1.0e-6, rise, abs(rise) > 1.0e-6);
        if rise < 0.0 {
            from_m = max(from_m, at_m);
        } else if at_m < to_m {
            to_m = at_m;
            facet = unit_plane;
            in_facet = true;
        }
    }
    let height_m = to_m;
    let normal = select(ray.origin + height_m * ray.way, facet, in_facet) * grain.per_axis;
    let along = vec2(normal.x - normal.z * grain.tilt, normal.y);
    let slope = along * (-1.0 / max(normal.z, length(along) / GRAIN_MAX_SLOPE));
    return vec3(
        grain.axis.x * slope.x - grain.axis.y * slope.y,
        grain.axis.y * slope.x + grain.axis.x * slope.y,
        select(0.0, height_m, discriminant > 0.0 && to_m > from_m),
    );
}

// Fraction of the sun's disc that a grain occludes.
fn grain_occlusion(grain: Grain, per_height: vec2<f32>, per_way: f32, blur_m: f32) -> f32 {
    let ray = as_sphere(grain, per_height);
    let a = dot(ray.way, ray.way);
    let b = dot(ray.origin, ray.way);
    let height_m = -b / a;
    let distance = sqrt(max(dot(ray.origin, ray.origin) + b * height_m, 0.0));
    let half_m = per_way * height_m * (1.0 + length(per_height)) + blur_m;
    let inside_m = (1.0 - distance) * 0.4 * grain.diameter_m;
    return select(0.0, clamp(0.5 + 0.5 * inside_m / half_m, 0.0, 1.0), height_m > 0.0);
}

// How a ray to the eye met the grains so far: how much of the sample they hide of the ground, that times the fraction of the sun's
// disc that is visible from them, and the nearest, whose height is that of its point.
struct GrainCover {
    share: f32,
    sun: f32,
    nearest: GrainSurface,
}

// Adds the grains of a lattice to the ground at a point: the nearest that a ray to the eye meets, and the shadows of those
// towards the sun. Samples are `across_m` apart across the view.
fn add_grains(
    before: GroundDetail,
    lattice: Lattice,
    point: vec2<f32>,
    across_m: f32,
    eye_way: vec2<f32>,
    sun_way: vec2<f32>,
    cover: ptr<function, GrainCover>,
) -> GroundDetail {
    var detail = before;
    // The shadows of larger grains fall on grains too.
    let sun_on_grains = before.sun;
    // The material's albedo is the mean of soil and grains: where grains are seen, the soil between them is darker.
    detail.albedo /= 1.0 + lattice.factor * sample_share(0.7 * lattice.max_diameter_m, across_m);
    for (var ray = 0; ray < 2; ray++) {
        let is_sun = ray == 0;
        var walk = grain_walk(lattice, point, select(eye_way, sun_way, is_sun));
        var corner = vec2(0.0);
        for (var k = 0u; k < GRAIN_MAX_CELLS; k++) {
            let first = lattice_hash(walk.cell.x, walk.cell.y, 0, lattice.seed);
            if hash_fraction(first, 0xffffu) < lattice.amount {
                let second = second_hash(first);
                let jitter = vec2(hash_fraction(second, 0x3ffu), hash_fraction(second >> 10u, 0x3ffu));
                let centre = corner + (2.0 * jitter - 1.0) * GRAIN_JITTER_CELLS + 0.5;
                let from_centre = (walk.start - centre) * lattice.cell_m;
                let diameter_m = 0.5 * lattice.max_diameter_m * inverseSqrt(1.0 - 0.75 * f32(second >> 20u) / 4096.0);
                let share = sample_share(diameter_m, across_m);
                // Closest approach to the centre below the grain's largest height.
                let along = clamp(
                    -dot(from_centre, walk.per_height) / max(dot(walk.per_height, walk.per_height), 1.0e-12),
                    0.0,
                    GRAIN_MAX_HEIGHT * diameter_m,
                );
                let closest = from_centre + along * walk.per_height;
                let reach = GRAIN_MAX_RADIUS * diameter_m + select(0.0, across_m, is_sun);
                if share > 0.0 && dot(closest, closest) < reach * reach {
                    let grain = grain_of(lattice, first, second, from_centre, diameter_m);
                    if is_sun {
                        let per_way = light.sun_tan_half_angle;
                        detail.sun *= 1.0 - share * grain_occlusion(grain, walk.per_height, per_way, 0.25 * across_m);
                    } else {
                        let hit = grain_hit(grain, walk.per_height);
                        if hit.z > (*cover).nearest.point.z {
                            let place = along_ground(lattice, from_centre + hit.z * walk.per_height);
                            let mottling = MOTTLING * select(GRAIN_CLOD_SPREAD, 1.0, is_fragment(lattice, first));
                            *cover = GrainCover(
                                mix((*cover).share, 1.0, share),
                                mix((*cover).sun, sun_on_grains, share),
                                GrainSurface(vec3(place, hit.z), diameter_m, second, mottling),
                            );
                            let slope = along_ground(lattice, hit.xy);
                            detail.slope = mix(detail.slope, slope + GRAIN_ROUGHNESS * detail.slope, share);
                            detail.albedo = mix(detail.albedo, grain_albedo(lattice, first, second), share);
                        }
                    }
                }
            }
            // On to the next cell.
            let to_column = walk.next.x < walk.next.y;
            if min(walk.next.x, walk.next.y) >= 1.0 { break; }
            let move_by = select(vec2(0.0, walk.sign.y), vec2(walk.sign.x, 0.0), to_column);
            corner += move_by;
            walk.cell += vec2<i32>(move_by);
            walk.next += select(vec2(0.0, walk.step.y), vec2(walk.step.x, 0.0), to_column);
        }
    }
    return detail;
}
