// Slopes of the ground and of rocks below the size of the mesh's cells, down to that of a pixel. Twins:
// `ReliefUniforms`, `ReliefView`, `LatticeUniforms` in src/render/shaders.rs; of the slopes of ground src/render/slopes.rs, which
// devices that are a CPU are given. The height function is src/scene/relief.rs.

// A square lattice over the plane, for places in metres from the centre of the ground.
struct Lattice {
    // Cosine and sine of its angle, divided by the side of a cell.
    turn: vec2<f32>,
    // Where in its cell the centre lies.
    phase: vec2<f32>,
    // The cell in which the centre lies.
    base: vec2<i32>,
    seed: u32,
    // Of noise: its amplitude, metres. Of pits: the chance of a cell to have one.
    amount: f32,
    cell_m: f32,
    // Largest diameter of a pit, metres.
    largest_m: f32,
    // Share of clods among the pits.
    clods: f32,
    // Of pits: where cells of the mesh are larger than a sixth of this many largest diameters they are left out.
    asked: f32,
}

// What of the relief a draw shows, and to whom.
struct ReliefView {
    // The eye, seen from above, metres from the centre of the ground.
    eye_from_centre: vec2<f32>,
    // Height of the eye that the mesh is made for, metres.
    eye_height_m: f32,
    // Angle that a cell of the mesh spans seen from there, radians.
    cell: f32,
    // Angle between two samples of the picture, radians.
    sample_angle: f32,
    // Share of fresh craters.
    fresh_share: f32,
    // How many waves and lattices of pits some place of the draw asks.
    waves: u32,
    pit_lattices: u32,
}

struct ReliefUniforms {
    view: ReliefView,
    // Coarse to fine.
    noise: array<Lattice, 12>,
    pits: array<Lattice, 12>,
}

// That of the draw (src/render/relief.rs).
@group(1) @binding(2) var<uniform> relief: ReliefUniforms;

// These stand in src/scene/relief.rs and src/scene/craters.rs, where they are explained.
const CELLS_LEAST: f32 = 3.0;
const JITTER_CELLS: f32 = 0.17;
const PROFILE_DEPTH: f32 = 0.114;
const RIM: f32 = 0.02513;
const CLOD_HEIGHT: f32 = 0.22;
const SECOND_HASH: u32 = 0x2c1b3c6du;

// How much of something of this size the mesh shows.
fn mesh_share(size_m: f32, cell_m: f32) -> f32 {
    return clamp(size_m / (CELLS_LEAST * cell_m) - 1.0, 0.0, 1.0);
}

// How much of it the samples of the picture can show.
fn sample_share(size_m: f32, sample_m: f32) -> f32 {
    return clamp(0.5 * size_m / sample_m - 1.0, 0.0, 1.0);
}

// Twin of `lattice_hash` in src/scene/noise.rs.
fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    var h = (u32(x) * 0x8da6b343u) ^ (u32(y) * 0xd8163841u) ^ (u32(z) * 0xcb1ab31fu) ^ seed;
    h = (h ^ (h >> 16u)) * 0x7feb352du;
    h = (h ^ (h >> 15u)) * 0x846ca68bu;
    return h ^ (h >> 16u);
}

// Rise per metre along x and y that the mesh leaves out, at a place (metres from the centre) where samples of the
// picture are `sample_m` apart on the ground.
fn relief_slope(place: vec2<f32>, sample_m: f32) -> vec2<f32> {
    let cell_m = light.relief.cell * sqrt(dot(place, place) + light.relief.eye_height_m * light.relief.eye_height_m);
    var slope = vec2(0.0);
    // Coarse to fine: past those that the mesh shows whole, to the first that samples cannot show.
    var k = 0u;
    while k < light.relief.waves && mesh_share(relief.noise[k].cell_m, cell_m) == 1.0 { k++; }
    for (; k < light.relief.waves; k++) {
        let wave = relief.noise[k];
        let shown = sample_share(wave.cell_m, sample_m);
        if shown == 0.0 { break; }
        slope += (1.0 - mesh_share(wave.cell_m, cell_m)) * shown * noise_slope(wave, place);
    }
    // The smallest pits of a lattice are half as large as its largest; a hair of room for how sizes are rounded.
    k = 0u;
    while k < light.relief.pit_lattices && mesh_share(0.499 * relief.pits[k].largest_m, cell_m) == 1.0 { k++; }
    for (; k < light.relief.pit_lattices; k++) {
        let pits = relief.pits[k];
        if sample_share(1.001 * pits.largest_m, sample_m) == 0.0 { break; }
        slope += pits_slope(pits, place, cell_m, sample_m);
    }
    return slope;
}

fn to_lattice(lattice: Lattice, place: vec2<f32>) -> vec2<f32> {
    return vec2(
        lattice.turn.x * place.x + lattice.turn.y * place.y,
        lattice.turn.x * place.y - lattice.turn.y * place.x,
    ) + lattice.phase;
}

// A slope per cell along the lattice's axes, as a slope per metre along x and y.
fn slope_from_lattice(lattice: Lattice, slope: vec2<f32>) -> vec2<f32> {
    return vec2(
        lattice.turn.x * slope.x - lattice.turn.y * slope.y,
        lattice.turn.y * slope.x + lattice.turn.x * slope.y,
    );
}

// Gradient and value of a corner.
fn lattice_corner(cell: vec2<i32>, seed: u32) -> vec3<f32> {
    let hash = lattice_hash(cell.x, cell.y, 0, seed);
    let value = f32((hash * 0x9e3779b1u) >> 16u) * (1.0 / 65536.0) - 0.5;
    return vec3(vec2(f32(hash & 0xffffu), f32(hash >> 16u)) * (1.0 / 32768.0) - 1.0, value);
}

// Slope of `gradient_noise_2d` (src/scene/noise.rs) on the lattice of an octave.
fn noise_slope(lattice: Lattice, place: vec2<f32>) -> vec2<f32> {
    let local = to_lattice(lattice, place);
    let corner = floor(local);
    let t = local - corner;
    let cell = lattice.base + vec2<i32>(corner);
    let g00 = lattice_corner(cell, lattice.seed);
    let g10 = lattice_corner(cell + vec2(1, 0), lattice.seed);
    let g01 = lattice_corner(cell + vec2(0, 1), lattice.seed);
    let g11 = lattice_corner(cell + vec2(1, 1), lattice.seed);
    let w = t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let rise = 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let a = dot(g00.xy, t) + g00.z;
    let b = dot(g10.xy, t - vec2(1.0, 0.0)) + g10.z;
    let c = dot(g01.xy, t - vec2(0.0, 1.0)) + g01.z;
    let d = dot(g11.xy, t - vec2(1.0, 1.0)) + g11.z;
    let gradient = mix(mix(g00.xy, g10.xy, w.x), mix(g01.xy, g11.xy, w.x), w.y)
        + rise * vec2(mix(b - a, d - c, w.y), mix(c - a, d - b, w.x));
    return lattice.amount * slope_from_lattice(lattice, gradient);
}

// Slope of the pits of a lattice. Here none reaches beyond its own cell: its centre is at most JITTER_CELLS off the middle,
// its radius at most 0.22 cells, and 1.5 radii away it has faded out.
fn pits_slope(lattice: Lattice, place: vec2<f32>, cell_m: f32, sample_m: f32) -> vec2<f32> {
    let local = to_lattice(lattice, place);
    let corner = floor(local);
    let cell = lattice.base + vec2<i32>(corner);
    let first = lattice_hash(cell.x, cell.y, 0, lattice.seed);
    var second = (first ^ (first >> 15u)) * SECOND_HASH;
    second ^= second >> 12u;
    let jitter = (vec2(f32(second & 0x3ffu), f32((second >> 10u) & 0x3ffu)) / 512.0 - 1.0) * JITTER_CELLS + 0.5;
    // One over the radius, metres.
    let per_radius = 4.0 / lattice.largest_m * sqrt(1.0 - 0.75 * f32(second >> 20u) / 4096.0);
    let diameter_m = 2.0 / per_radius;
    let offset = local - corner - jitter;
    let per_cells = inverseSqrt(max(dot(offset, offset), 1.0e-12));
    let r = lattice.cell_m * per_radius / per_cells;
    let age = f32(first >> 16u) / 65536.0;
    let steepness = select(
        crater_steepness(r, (age - lattice.clods) / (1.0 - lattice.clods)),
        -8.0 * CLOD_HEIGHT * r * max(1.0 - r * r, 0.0),
        age < lattice.clods,
    );
    let share = (1.0 - mesh_share(diameter_m, cell_m)) * sample_share(diameter_m, sample_m);
    let asked = lattice.asked * lattice.largest_m >= 2.0 * CELLS_LEAST * cell_m;
    let there = asked && f32(first & 0xffffu) / 65536.0 < lattice.amount;
    let slope = select(0.0, share * steepness, there) * per_cells * offset;
    return lattice.cell_m * slope_from_lattice(lattice, slope);
}

// Rise per metre away from the centre of a crater of an age in [0, 1), at a distance in radii.
fn crater_steepness(r: f32, age: f32) -> f32 {
    let fresh_share = light.relief.fresh_share;
    let wear = (age - fresh_share) / (1.0 - fresh_share);
    let fresh = 0.15 - 0.04 / max(fresh_share, 1.0e-6) * age;
    // 0.12 to 0.02 evenly in the logarithm.
    let depth = select(min(0.12 * exp2(-2.5849625 * wear), 0.1099), fresh, age < fresh_share);
    // The derivative of the polynomial inside the crest, of the ejecta's power law outside, faded out where the next
    // cells begin.
    let bowl = 0.0513832 + r * (-0.1504748 + r * (2.9375904 + r * (-5.661628 + r * 2.871354)));
    let square = r * r;
    let ejecta = -3.1906 * RIM / (square * square) * clamp((1.5 - r) * 2.5, 0.0, 1.0);
    return 2.0 / PROFILE_DEPTH * depth * select(ejecta, bowl, r < 1.0);
}

// Octaves of a rock's texture, and the rise per metre of each.
const TEXTURE_OCTAVES: i32 = 4;
const TEXTURE_STEEPNESS: f32 = 0.12;

// Slope of the texture of a rock at a place (metres from its centre) with samples this far apart, and in w its shade, mean 0.
// Octaves are anchored in the rock; they come and go smoothly with the distance.
fn solid_texture(place: vec3<f32>, sample_m: f32, seed: u32) -> vec4<f32> {
    let finest = log2(2.0 * sample_m);
    let first = ceil(finest);
    var sum = vec4(0.0);
    for (var k = 0; k < TEXTURE_OCTAVES; k++) {
        let octave = first + f32(k);
        let size_m = exp2(octave);
        // The finest fades in, the coarsest out.
        let share = min(min(octave - finest, 1.0), f32(TEXTURE_OCTAVES) - 1.0 - (octave - finest) + 1.0);
        let noise = value_noise(place / size_m, seed + u32(i32(octave) + 64) * 0x9e3779b9u);
        sum += clamp(share, 0.0, 1.0) * vec4(TEXTURE_STEEPNESS * noise.xyz, noise.w);
    }
    return sum;
}

// Gradient and value (mean 0, up to 1 either way) of value noise, trilinear with cubic weights.
fn value_noise(p: vec3<f32>, seed: u32) -> vec4<f32> {
    let corner = floor(p);
    let t = p - corner;
    let cell = vec3<i32>(corner);
    let w = t * t * (3.0 - 2.0 * t);
    let rise = 6.0 * t * (1.0 - t);
    let low = vec4(
        lattice_value(cell, seed),
        lattice_value(cell + vec3(1, 0, 0), seed),
        lattice_value(cell + vec3(0, 1, 0), seed),
        lattice_value(cell + vec3(1, 1, 0), seed),
    );
    let high = vec4(
        lattice_value(cell + vec3(0, 0, 1), seed),
        lattice_value(cell + vec3(1, 0, 1), seed),
        lattice_value(cell + vec3(0, 1, 1), seed),
        lattice_value(cell + vec3(1, 1, 1), seed),
    );
    let z = mix(low, high, w.z);
    let y = mix(z.xy, z.zw, w.y);
    let dz = high - low;
    return vec4(
        rise.x * mix(z.y - z.x, z.w - z.z, w.y),
        rise.y * mix(z.z - z.x, z.w - z.y, w.x),
        rise.z * mix(mix(dz.x, dz.y, w.x), mix(dz.z, dz.w, w.x), w.y),
        mix(y.x, y.y, w.x),
    );
}

fn lattice_value(cell: vec3<i32>, seed: u32) -> f32 {
    return f32(lattice_hash(cell.x, cell.y, cell.z, seed) >> 8u) * (2.0 / 16777216.0) - 1.0;
}
