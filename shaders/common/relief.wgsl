// The ground below the mesh: slopes, heights and shades of noise, craters and clods that are smaller than the mesh's cells, down to the
// size of a sample (noise here, pits in pits.wgsl, grains in grains.wgsl). The height function is src/scene/relief.rs; CPU counterpart of
// the slopes: src/render/lighting/slopes_host.rs.

// src/scene/relief.rs has the same constant and explains it.
const MIN_CELLS: f32 = 3.0;
// Of the strength of finer noise: src/scene/noise/gradient.rs.
const PATCHY_BASE: f32 = 0.427;
const PATCHY_PEAK: f32 = 1.948;
// src/scene/relief.rs explains it.
const MAX_STRENGTH: f32 = 1.2;
// src/render/lighting/detail_sums.rs, slopes_host.rs, waves_host.rs and ground_batch.rs explain these.
const MIN_CLEARANCE: f32 = 0.7;
const FAR_M: f32 = 1.0e3;
const TESTED_CELLS: f32 = 0.5;
const MIN_LOW_WAY: f32 = 2.0;
const FIRST_STEP_CELLS: f32 = 0.125;
const SHADOW_BLUR: f32 = 0.5;
const MIN_TESTED_SAMPLES: f32 = 3.0;
const MIN_WAY: f32 = 1.0e-3;

// Fraction of a feature of this size that the mesh has: 0 up to MIN_CELLS cells, 1 from twice as many on.
fn mesh_share(size_m: f32, cell_m: f32) -> f32 {
    return clamp(size_m / (MIN_CELLS * cell_m) - 1.0, 0.0, 1.0);
}

// Fraction of a feature of this size that samples can resolve: fades out between four samples and two.
fn sample_share(size_m: f32, sample_m: f32) -> f32 {
    return clamp(0.5 * size_m / sample_m - 1.0, 0.0, 1.0);
}

// Where a ray to the sun clears the ground the least: by how much, how far away that was, and up to which height the ray to the eye was
// followed there, metres.
struct Occluder {
    clearance_m: f32,
    way_m: f32,
    height_m: f32,
}

// What the mesh leaves out of the ground at a point (metres from the centre of the ground), where samples are `sample_m` apart
// in the geometric mean and `across_m` across the view. `eye_way` and `sun_way` are the horizontal ways of rays to the eye and
// to the sun per metre that they rise above the mesh.
// Long because: where one octave is seen and what it shadows, the next begins with.
fn ground_detail(
    point: vec2<f32>,
    sample_m: f32,
    across_m: f32,
    eye_way: vec2<f32>,
    sun_way: vec2<f32>,
) -> GroundDetail {
    let cell_m = light.relief_cell_angle * sqrt(dot(point, point) + light.relief_eye_height_m * light.relief_eye_height_m);
    // Slope, logarithm of the albedo, and height above the mesh. What the eye sees lies on its ray at that height.
    var sum = vec4(0.0);
    // The slope of the noise alone.
    var waves = vec2(0.0);
    var occluder = Occluder(FAR_M, FAR_M, 0.0);
    let per_eye_way = 1.0 / (length(eye_way) + MIN_WAY);
    let per_sun_way = 1.0 / (length(sun_way) + MIN_WAY);
    // By how much a ray to the sun is higher if it starts higher on the ray to the eye: not at all if the two are one.
    let towards_sun = dot(eye_way, sun_way) * per_sun_way;
    let sun_lift = 1.0 - towards_sun * per_sun_way;
    let rays = PitRays(point, eye_way, sun_way, per_sun_way, sun_lift, cell_m, sample_m, across_m);
    // Coarse to fine, pits and noise by their size: skip what is wholly in the mesh, stop at the first that samples cannot resolve.
    var pit = 0u;
    // The smallest pits of a lattice are half as large as its largest; 0.499 leaves room for rounding.
    while pit < light.relief_pit_lattices && mesh_share(0.499 * relief_pits(pit).max_diameter_m, cell_m) == 1.0 { pit++; }
    // How strong the next finer octaves are here, before the cap.
    var strength = 1.0;
    for (var k = 0u; k <= light.relief_waves; k++) {
        for (; has_larger_pits(pit, k); pit++) { sum = add_pits(sum, relief_pits(pit), rays, &occluder); }
        if k == light.relief_waves { break; }
        let octave = relief_noise(k);
        if sample_share(octave.cell_m, sample_m) == 0.0 { break; }
        let resolved = sample_share(octave.cell_m, local_sample_m(sample_m, sum.xy, eye_way));
        let shown = (1.0 - mesh_share(octave.cell_m, cell_m)) * resolved;
        let share = min(strength, MAX_STRENGTH) * shown;
        let start_m = sum.w;
        // The first of two steps of Newton's method, where one would miss.
        var rise_m = 0.0;
        // How far samples are close enough for an octave that may shadow the ground and need two steps.
        let tested = select(0.0, clamp(octave.cell_m / (MIN_TESTED_SAMPLES * sample_m) - 1.0, 0.0, 1.0), share > 0.0);
        if tested > 0.0 {
            if per_sun_way < 1.0 / MIN_LOW_WAY {
                let way_m = TESTED_CELLS * octave.cell_m;
                let sun_rise_m = way_m * per_sun_way;
                let way = sun_rise_m * sun_way;
                let height_m = dot(waves, way) + share * noise_height(octave, point + sum.w * eye_way + way);
                occluder = nearer_occluder(occluder, Occluder(sun_rise_m / tested - height_m, way_m, sum.w));
            }
            let cells = share * octave.amount / (FIRST_STEP_CELLS * octave.cell_m * per_eye_way);
            if cells > 1.0 {
                let first = share * noise_slope(octave, point + sum.w * eye_way).detail;
                rise_m = min(cells - 1.0, 1.0) * tested * first.w / clearance(sum.xy + first.xy, eye_way);
            }
        }
        // What the ray has risen, less what the larger relief has below it.
        let above_m = rise_m * (1.0 - dot(sum.xy, eye_way));
        sum.w += rise_m;
        let noise = noise_slope(octave, point + sum.w * eye_way);
        strength *= noise.strength;
        var wave = vec4(share, share, shown, share) * noise.detail;
        wave.w -= above_m;
        sum = add_detail(sum, wave, eye_way);
        occluder.clearance_m += sun_lift * (sum.w - start_m) * apart(occluder, octave.cell_m);
        waves += wave.xy;
    }
    // Finer detail has moved the point on, perhaps up to its occluder.
    let hidden = clamp(0.5 - 0.5 * occluder.clearance_m / (SHADOW_BLUR * across_m * per_sun_way), 0.0, 1.0);
    let moved_m = max(towards_sun, 0.0) * (sum.w - occluder.height_m);
    let sun = 1.0 - hidden * clamp(1.0 - moved_m / occluder.way_m, 0.0, 1.0);
    // The exponential function to second order.
    var detail = GroundDetail(sum.xy, 1.0 + sum.z * (1.0 + 0.5 * sum.z), sun);
    var cover = GrainCover(0.0, 0.0, GrainSurface(vec3(0.0), 0.0, 0u, 0.0));
    for (var k = 0u; k < light.relief_grain_lattices; k++) {
        let grains = relief_grains(k);
        if sample_share(1.001 * grains.max_diameter_m, across_m) == 0.0 { break; }
        detail = add_grains(detail, grains, point + sum.w * eye_way, across_m, eye_way, sun_way, &cover);
    }
    detail = add_grain_texture(detail, cover.nearest, across_m);
    // What hides the ground hides its shadows.
    detail.sun = mix(detail.sun, 0.0, cover.share) + cover.sun;
    detail.albedo *= crater_rays_factor(point + sum.w * eye_way, sample_m);
    return detail;
}

// Whether the lattice of pits `pit` is to be added before octave `k` of the noise; after the last octave come all that are left.
fn has_larger_pits(pit: u32, k: u32) -> bool {
    if pit >= light.relief_pit_lattices { return false; }
    return k >= light.relief_waves || relief_pits(pit).max_diameter_m > relief_noise(k).cell_m;
}

fn nearer_occluder(one: Occluder, other: Occluder) -> Occluder {
    if other.clearance_m < one.clearance_m { return other; }
    return one;
}

// How much of the height of detail of this size is not shared by the occluder: src/render/lighting/detail_sums.rs explains it.
fn apart(occluder: Occluder, size_m: f32) -> f32 {
    return min(2.0 * occluder.way_m / size_m, 1.0);
}

// Adds detail at the point where the ray to the eye has the height that is summed so far. The height at which it leaves the ground
// is found by a step of Newton's method.
fn add_detail(sum: vec4<f32>, detail: vec4<f32>, eye_way: vec2<f32>) -> vec4<f32> {
    let slopes = sum.xyz + detail.xyz;
    return vec4(slopes, sum.w + detail.w / clearance(slopes.xy, eye_way));
}

// How much less the ground rises along the ray to the eye than the ray, relative to the ray.
fn clearance(slope: vec2<f32>, eye_way: vec2<f32>) -> f32 {
    return max(1.0 - dot(slope, eye_way), MIN_CLEARANCE);
}

// Distance of samples on a slope of the mesh: further where it faces away from the eye.
fn local_sample_m(sample_m: f32, slope: vec2<f32>, eye_way: vec2<f32>) -> f32 {
    return sample_m * inverseSqrt(min(clearance(slope, eye_way), 1.0));
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

// Gradient, value and shade at a corner of a cell, and the strength of finer noise.
struct LatticeCorner {
    gradient: vec2<f32>,
    value: f32,
    shade: f32,
    strength: f32,
}

fn lattice_corner(cell: vec2<i32>, lattice: Lattice) -> LatticeCorner {
    let hash = lattice_hash(cell.x, cell.y, 0, lattice.seed);
    let gradient = vec2(f32(hash & 0xffffu), f32(hash >> 16u)) * (1.0 / 32768.0) - 1.0;
    let value = f32((hash * 0x9e3779b1u) >> 16u) * (1.0 / 65536.0) - 0.5;
    let product = hash * 0x85ebca6bu;
    let shade = f32(product >> 16u) * (1.0 / 65536.0) - 0.5;
    // Rough in some places and smooth in others: src/scene/noise/gradient.rs.
    let draw = f32(product & 0xffffu) * (1.0 / 65536.0);
    let strength = 1.0 + lattice.factor * (PATCHY_BASE - 1.0 + PATCHY_PEAK * draw * draw * draw);
    return LatticeCorner(gradient, value, shade, strength);
}

// One octave of noise at a point. Detail: its slope; what it adds to the logarithm of the soil's albedo, blended with the same weights; its
// height. Strength: that of finer octaves.
struct NoiseOctave {
    detail: vec4<f32>,
    strength: f32,
}

// One octave of gradient noise with quintic weights (Perlin 2002, "Improving Noise"): its slope is the derivative of
// `gradient_noise_2d` in src/scene/noise/gradient.rs.
fn noise_slope(lattice: Lattice, point: vec2<f32>) -> NoiseOctave {
    let local = to_lattice(lattice, point);
    let corner = floor(local);
    let t = local - corner;
    let cell = lattice.base + vec2<i32>(corner);
    let g00 = lattice_corner(cell, lattice);
    let g10 = lattice_corner(cell + vec2(1, 0), lattice);
    let g01 = lattice_corner(cell + vec2(0, 1), lattice);
    let g11 = lattice_corner(cell + vec2(1, 1), lattice);
    let w = quintic(t);
    let rise = 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let a = dot(g00.gradient, t) + g00.value;
    let b = dot(g10.gradient, t - vec2(1.0, 0.0)) + g10.value;
    let c = dot(g01.gradient, t - vec2(0.0, 1.0)) + g01.value;
    let d = dot(g11.gradient, t - vec2(1.0, 1.0)) + g11.value;
    let gradient = mix(mix(g00.gradient, g10.gradient, w.x), mix(g01.gradient, g11.gradient, w.x), w.y)
        + rise * vec2(mix(b - a, d - c, w.y), mix(c - a, d - b, w.x));
    let shade = mix(mix(g00.shade, g10.shade, w.x), mix(g01.shade, g11.shade, w.x), w.y);
    let strength = mix(mix(g00.strength, g10.strength, w.x), mix(g01.strength, g11.strength, w.x), w.y);
    let height_m = lattice.amount * mix(mix(a, b, w.x), mix(c, d, w.x), w.y);
    return NoiseOctave(
        vec4(lattice.amount * slope_from_lattice(lattice, gradient), lattice.share * shade, height_m),
        strength,
    );
}

// Height of one octave of noise.
fn noise_height(lattice: Lattice, point: vec2<f32>) -> f32 {
    return noise_slope(lattice, point).detail.w;
}

fn quintic(t: vec2<f32>) -> vec2<f32> {
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0);
}
