// The ground below the mesh: slopes and shades of noise, craters and clods that are smaller than the mesh's cells, down to the
// size of a sample, and grains (grains.wgsl). The height function is src/scene/relief.rs; CPU counterpart of the slopes:
// src/render/lighting/slopes_host.rs.

// src/scene/relief.rs and src/scene/craters.rs have the same constants and explain them.
const MIN_CELLS: f32 = 3.0;
const JITTER_CELLS: f32 = 0.17;
const PROFILE_DEPTH: f32 = 0.114;
const RIM: f32 = 0.02513;
const CLOD_HEIGHT: f32 = 0.22;
// Of the strength of noise: src/scene/noise/gradient.rs.
const PATCHY_BASE: f32 = 0.2;
const PATCHY_PEAK: f32 = 3.2;
// What fresh craters add to the logarithm of the albedo.
const FRESH_SHADE: f32 = 0.2;
const SECOND_HASH: u32 = 0x2c1b3c6du;

// Fraction of a feature of this size that the mesh has: 0 up to MIN_CELLS cells, 1 from twice as many on.
fn mesh_share(size_m: f32, cell_m: f32) -> f32 {
    return clamp(size_m / (MIN_CELLS * cell_m) - 1.0, 0.0, 1.0);
}

// Fraction of a feature of this size that samples can resolve: fades out between four samples and two.
fn sample_share(size_m: f32, sample_m: f32) -> f32 {
    return clamp(0.5 * size_m / sample_m - 1.0, 0.0, 1.0);
}

// What the mesh leaves out of the ground at a point (metres from the centre of the ground), where samples are `sample_m` apart
// in the geometric mean and `across_m` across the view. `eye_way` and `sun_way` are the horizontal ways of rays to the eye and
// to the sun per metre that they rise above the mesh.
fn ground_detail(
    point: vec2<f32>,
    sample_m: f32,
    across_m: f32,
    eye_way: vec2<f32>,
    sun_way: vec2<f32>,
) -> GroundDetail {
    let cell_m = light.relief_cell_angle * sqrt(dot(point, point) + light.relief_eye_height_m * light.relief_eye_height_m);
    // Slope, and logarithm of the albedo.
    var sum = vec3(0.0);
    // Coarse to fine: skip the octaves that are wholly in the mesh, stop at the first that samples cannot resolve.
    var k = 0u;
    while k < light.relief_waves && mesh_share(relief_noise(k).cell_m, cell_m) == 1.0 { k++; }
    for (; k < light.relief_waves; k++) {
        let octave = relief_noise(k);
        let resolved = sample_share(octave.cell_m, sample_m);
        if resolved == 0.0 { break; }
        sum += (1.0 - mesh_share(octave.cell_m, cell_m)) * resolved * noise_slope(octave, point);
    }
    // The smallest pits of a lattice are half as large as its largest; 0.499 and 1.001 leave room for rounding.
    k = 0u;
    while k < light.relief_pit_lattices && mesh_share(0.499 * relief_pits(k).max_diameter_m, cell_m) == 1.0 { k++; }
    for (; k < light.relief_pit_lattices; k++) {
        let pits = relief_pits(k);
        if sample_share(1.001 * pits.max_diameter_m, sample_m) == 0.0 { break; }
        sum += pits_slope(pits, point, cell_m, sample_m);
    }
    // The exponential function to second order.
    var detail = GroundDetail(sum.xy, 1.0 + sum.z * (1.0 + 0.5 * sum.z), 1.0);
    var cover = GrainCover(0.0, 0.0, 0.0);
    for (k = 0u; k < light.relief_grain_lattices; k++) {
        let grains = relief_grains(k);
        if sample_share(1.001 * grains.max_diameter_m, across_m) == 0.0 { break; }
        detail = add_grains(detail, grains, point, across_m, eye_way, sun_way, &cover);
    }
    // What hides the ground hides its shadows.
    detail.sun = mix(detail.sun, 0.0, cover.share) + cover.sun;
    return detail;
}

// Coordinates in cells of the lattice, relative to its base cell.
fn to_lattice(lattice: Lattice, point: vec2<f32>) -> vec2<f32> {
    return vec2(
        lattice.rotation_per_m.x * point.x + lattice.rotation_per_m.y * point.y,
        lattice.rotation_per_m.x * point.y - lattice.rotation_per_m.y * point.x,
    ) + lattice.phase;
}

// From a slope per cell along the lattice's axes to a slope per metre along x and y.
fn slope_from_lattice(lattice: Lattice, slope: vec2<f32>) -> vec2<f32> {
    return vec2(
        lattice.rotation_per_m.x * slope.x - lattice.rotation_per_m.y * slope.y,
        lattice.rotation_per_m.y * slope.x + lattice.rotation_per_m.x * slope.y,
    );
}

// Gradient, value and shade at a corner of a cell.
fn lattice_corner(cell: vec2<i32>, lattice: Lattice) -> vec4<f32> {
    let hash = lattice_hash(cell.x, cell.y, 0, lattice.seed);
    let value = f32((hash * 0x9e3779b1u) >> 16u) * (1.0 / 65536.0) - 0.5;
    let product = hash * 0x85ebca6bu;
    let shade = f32(product >> 16u) * (1.0 / 65536.0) - 0.5;
    // Rough in few places and smooth in most: src/scene/noise/gradient.rs.
    let draw = f32(product & 0xffffu) * (1.0 / 65536.0);
    let cube = draw * draw * draw;
    let strength = 1.0 + lattice.factor * (PATCHY_BASE - 1.0 + PATCHY_PEAK * cube * cube);
    return vec4(strength * vec3(vec2(f32(hash & 0xffffu), f32(hash >> 16u)) * (1.0 / 32768.0) - 1.0, value), shade);
}

// Slope of one octave of gradient noise with quintic weights (Perlin 2002, "Improving Noise"): the derivative of
// `gradient_noise_2d` in src/scene/noise/gradient.rs. z: what the octave adds to the logarithm of the soil's albedo, blended
// with the same weights.
fn noise_slope(lattice: Lattice, point: vec2<f32>) -> vec3<f32> {
    let local = to_lattice(lattice, point);
    let corner = floor(local);
    let t = local - corner;
    let cell = lattice.base + vec2<i32>(corner);
    let g00 = lattice_corner(cell, lattice);
    let g10 = lattice_corner(cell + vec2(1, 0), lattice);
    let g01 = lattice_corner(cell + vec2(0, 1), lattice);
    let g11 = lattice_corner(cell + vec2(1, 1), lattice);
    let w = t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let rise = 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let a = dot(g00.xy, t) + g00.z;
    let b = dot(g10.xy, t - vec2(1.0, 0.0)) + g10.z;
    let c = dot(g01.xy, t - vec2(0.0, 1.0)) + g01.z;
    let d = dot(g11.xy, t - vec2(1.0, 1.0)) + g11.z;
    let gradient = mix(mix(g00.xy, g10.xy, w.x), mix(g01.xy, g11.xy, w.x), w.y)
        + rise * vec2(mix(b - a, d - c, w.y), mix(c - a, d - b, w.x));
    let shade = mix(mix(g00.w, g10.w, w.x), mix(g01.w, g11.w, w.x), w.y);
    return vec3(lattice.amount * slope_from_lattice(lattice, gradient), lattice.share * shade);
}

// Slope of the pits (craters and clods) of a lattice. None reaches beyond its own cell: its centre is at most JITTER_CELLS
// off the cell's, its radius at most 0.22 cells, and it has faded out at 1.5 radii. z: what fresh craters, whose soil is less
// mature, add to the logarithm of the albedo.
fn pits_slope(lattice: Lattice, point: vec2<f32>, cell_m: f32, sample_m: f32) -> vec3<f32> {
    let local = to_lattice(lattice, point);
    let corner = floor(local);
    let cell = lattice.base + vec2<i32>(corner);
    let first = lattice_hash(cell.x, cell.y, 0, lattice.seed);
    let second = second_hash(first);
    let jitter = (vec2(f32(second & 0x3ffu), f32((second >> 10u) & 0x3ffu)) / 512.0 - 1.0) * JITTER_CELLS + 0.5;
    // Inverse radius, 1/m.
    let per_radius = 4.0 / lattice.max_diameter_m * sqrt(1.0 - 0.75 * f32(second >> 20u) / 4096.0);
    let diameter_m = 2.0 / per_radius;
    let offset = local - corner - jitter;
    let per_cells = inverseSqrt(max(dot(offset, offset), 1.0e-12));
    let r = lattice.cell_m * per_radius / per_cells;
    let age = f32(first >> 16u) / 65536.0;
    let steepness = select(
        crater_steepness(r, (age - lattice.share) / (1.0 - lattice.share)),
        -8.0 * CLOD_HEIGHT * r * max(1.0 - r * r, 0.0),
        age < lattice.share,
    );
    let share = (1.0 - mesh_share(diameter_m, cell_m)) * sample_share(diameter_m, sample_m);
    let is_in_range = lattice.factor * lattice.max_diameter_m >= 2.0 * MIN_CELLS * cell_m;
    let exists = is_in_range && f32(first & 0xffffu) / 65536.0 < lattice.amount;
    let slope = select(0.0, share * steepness, exists) * per_cells * offset;
    let is_fresh = exists && age >= lattice.share && age - lattice.share < light.relief_fresh_share * (1.0 - lattice.share);
    let shade = select(0.0, FRESH_SHADE * share * clamp((1.5 - r) * 2.5, 0.0, 1.0), is_fresh);
    return vec3(lattice.cell_m * slope_from_lattice(lattice, slope), shade);
}

// Rise per metre away from the centre of a crater of an age in [0, 1), at a distance `r` in radii. Depths are in diameters.
// src/scene/craters.rs has the profile (a fit to that of Yang et al. 2021) and the depths (Stopar et al. 2017, Wu et al. 2021);
// src/render/lighting/slopes_host.rs derives the numbers.
fn crater_steepness(r: f32, age: f32) -> f32 {
    let fresh_share = light.relief_fresh_share;
    let wear = (age - fresh_share) / (1.0 - fresh_share);
    let fresh = 0.15 - 0.04 / max(fresh_share, 1.0e-6) * age;
    // A worn crater's depth falls from 0.12 to 0.02 with age, evenly in the logarithm.
    let depth = select(min(0.12 * exp2(-2.5849625 * wear), 0.1099), fresh, age < fresh_share);
    // Inside the crest the derivative of the profile's polynomial; outside that of the ejecta's power law, faded out before
    // the next cell.
    let bowl = 0.0513832 + r * (-0.1504748 + r * (2.9375904 + r * (-5.661628 + r * 2.871354)));
    let square = r * r;
    let ejecta = -3.1906 * RIM / (square * square) * clamp((1.5 - r) * 2.5, 0.0, 1.0);
    return 2.0 / PROFILE_DEPTH * depth * select(ejecta, bowl, r < 1.0);
}
