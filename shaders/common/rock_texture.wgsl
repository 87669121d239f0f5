// Solid texture of rocks, anchored in the rock at physical sizes (Perlin 1985, "An Image Synthesizer", introduced solid
// textures): roughness of fracture faces, vesicles and impact pits, clasts, fractures. Octaves smaller than the spacing of the
// samples fade out; the coarsest follow from the size of the rock.

// Fewest octaves of roughness and of inclusions, from the finest that the samples resolve.
const MIN_OCTAVES: f32 = 3.0;
// Diameter of a rock over the largest cells of its roughness; those of inclusions are twice as large.
const CELLS_PER_DIAMETER: f32 = 8.0;
// Slope per octave of roughness at a size of 8 mm: rock joints have a root mean square slope of 0.2 to 0.4 at 1.3 mm
// (joint roughness coefficients of 10 to 20; Tse and Cruden 1979).
const ROUGHNESS_SLOPE: f32 = 0.18;
// Amplitude per octave of mottling by grains, splashes and patina, below 1.6 cm; it falls beyond. Rocks near opposition, where
// no relief shows, vary by 0.2 to 0.3 between pixels (frames of Chang'e-3); the noise has a deviation of a third.
const MOTTLING: f32 = 0.60;
// Slope at the rim of a vesicle and of an impact pit.
const VESICLE_SLOPE: f32 = 1.1;
const PIT_SLOPE: f32 = 0.6;
// Size of the cells of the largest vesicles and of the largest clasts, log2 of metres: cells are about twice as wide as what
// they hold.
const VESICLE_OCTAVE: f32 = -4.0;
const CLAST_OCTAVE: f32 = -1.7;
// Half the width of a fracture's dark line, metres.
const FRACTURE_HALF_WIDTH_M: f32 = 0.0025;
// How far each octave moves it off its plane, cells.
const FRACTURE_WANDER: f32 = 0.2;

// A rotation.
const TEXTURE_FROM_WORLD: mat3x3<f32> = mat3x3<f32>(
    vec3(0.2719305, 0.7586299, -0.5920595),
    vec3(-0.5316958, 0.6312515, 0.5646425),
    vec3(0.8020931, 0.1612521, 0.5750169),
);

struct RockTexture {
    // Gradient of the surface's height, in world axes; its part along the normal does not count.
    gradient: vec3<f32>,
    // Factor on the albedo; its mean is about 1.
    shade: f32,
    // Depth below the surroundings, about -1 to 1; dust gathers where it is large.
    hollow: f32,
}

// Texture at a point, in metres from the centre of a rock of a diameter, where samples are `sample_m` apart.
fn rock_texture(position: vec3<f32>, sample_m: f32, seed: u32, diameter_m: f32) -> RockTexture {
    // Lattices at an angle to the world's axes, along which faces of blocks may lie.
    let point = TEXTURE_FROM_WORLD * position;
    let kinds = lattice_hash(1, 2, 3, seed);
    // Of ten rocks four are massive, three to four vesicular, and the others breccias.
    let kind = f32(kinds >> 8u) * (1.0 / 16777216.0);
    let is_breccia = kind > 0.75;
    let is_vesicular = kind > 0.4 && !is_breccia;

    var texture = RockTexture(vec3(0.0), 1.0, 0.0);
    // The next power of two above the distance between samples, and how far that is below it.
    let distance_m = 1.4 * sample_m;
    let first = floor_log2(distance_m) + 1.0;
    let fade_in = 2.0 - distance_m * power_of_two(1.0 - first);
    let largest = floor_log2(diameter_m * (1.0 / CELLS_PER_DIAMETER));
    let last = max(largest, first + MIN_OCTAVES - 1.0);
    var coarse = 0.0;
    var wander_m = 0.0;
    for (var octave = first; octave <= last; octave += 1.0) {
        // The finest fades in.
        let share = select(1.0, fade_in, octave == first);
        let noise = value_noise(point * power_of_two(-octave), octave_seed(seed, octave));
        let slope = ROUGHNESS_SLOPE * fifth_root_of_two_to(-octave - 7.0);
        let mottling = MOTTLING * min(1.0, power_of_two(-octave - 6.0));
        texture.gradient += share * slope * noise.xyz;
        texture.shade += share * mottling * noise.w;
        texture.hollow -= share * 0.35 * noise.w;
        coarse = noise.w;
        wander_m += share * power_of_two(octave) * noise.w;
    }
    for (var octave = first + 1.0; octave <= last + 1.0; octave += 1.0) {
        let share = select(1.0, fade_in, octave == first + 1.0);
        let found = inclusion(point * power_of_two(-octave), octave_seed(seed ^ 0x5bd1e995u, octave));
        if is_breccia {
            // Clasts, bright and dark, with sharp borders.
            let sized = share * clamp(CLAST_OCTAVE - octave, 0.0, 1.0);
            let is_clast = step(found.square, 1.0) * step(found.draw, 0.75);
            texture.shade *= 1.0 + sized * is_clast * select(-0.42, 0.45, found.draw < 0.4);
        } else {
            let sized = share * select(1.0, clamp(VESICLE_OCTAVE - octave, 0.0, 1.0), is_vesicular);
            let is_pit = step(found.square, 1.0) * step(found.draw, select(0.22, 0.85, is_vesicular));
            let depth = sized * is_pit * (1.0 - found.square);
            texture.gradient += sized * is_pit * select(PIT_SLOPE, VESICLE_SLOPE, is_vesicular) * found.offset;
            // The walls of a hollow shade each other.
            texture.shade *= 1.0 - 0.35 * depth;
            texture.hollow += 0.5 * depth;
        }
    }
    if !is_breccia {
        texture.shade *= 1.0 - fracture_line(point, FRACTURE_WANDER * wander_m, coarse, sample_m, diameter_m, kinds);
    }
    texture.shade = max(texture.shade, 0.25);
    texture.gradient = texture.gradient * TEXTURE_FROM_WORLD;
    return texture;
}

// Drivers compute log2 and exp2 with or without fused operations; these are exact, or the same everywhere. Exponents are whole numbers.

// Logarithm of a positive number, rounded down.
fn floor_log2(x: f32) -> f32 {
    return f32(i32(bitcast<u32>(x) >> 23u) - 127);
}

fn power_of_two(exponent: f32) -> f32 {
    return bitcast<f32>(u32(clamp(i32(exponent), -60, 60) + 127) << 23u);
}

// 2 to the power of a fifth of the exponent. Slopes of fracture surfaces fall with size by their Hurst exponent less 1, which is -0.2
// (Bouchaud 1997, "Scaling properties of cracks": 0.8).
fn fifth_root_of_two_to(exponent: f32) -> f32 {
    let whole = floor((exponent + 0.5) * 0.2);
    let rest = exponent - 5.0 * whole;
    var root = 1.0;
    if rest > 0.5 { root = 1.1486984; }
    if rest > 1.5 { root = 1.3195079; }
    if rest > 2.5 { root = 1.5157166; }
    if rest > 3.5 { root = 1.7411011; }
    return root * power_of_two(whole);
}

fn octave_seed(seed: u32, octave: f32) -> u32 {
    return seed + u32(i32(octave) + 64) * 0x9e3779b9u;
}

// A ball in each cell of a lattice, which lies within the cell.
struct Inclusion {
    // Position relative to its centre, in units of its radius, and the square of its length.
    offset: vec3<f32>,
    square: f32,
    // Uniform in 0 to 1.
    draw: f32,
}

fn inclusion(p: vec3<f32>, seed: u32) -> Inclusion {
    let corner = floor(p);
    let cell = vec3<i32>(corner);
    let hash = lattice_hash(cell.x, cell.y, cell.z, seed);
    let bits = vec4<f32>((vec4(hash) >> vec4(0u, 7u, 14u, 21u)) & vec4(127u)) * (1.0 / 127.0);
    let radius = 0.18 + 0.16 * bits.w;
    let centre = radius + (1.0 - 2.0 * radius) * bits.xyz;
    let offset = (p - corner - centre) * (1.0 / radius);
    return Inclusion(offset, dot(offset, offset), f32((hash * 0x9e3779b9u) >> 8u) * (1.0 / 16777216.0));
}

// Darkening by the fractures of a family of parallel planes; they wander off these, and end where the coarsest noise says.
fn fracture_line(point: vec3<f32>, wander_m: f32, coarse: f32, sample_m: f32, diameter_m: f32, kinds: u32) -> f32 {
    let bits = vec4<f32>((vec4(kinds * 0x9e3779b9u) >> vec4(0u, 8u, 16u, 24u)) & vec4(255u)) * (1.0 / 255.0);
    let across = unit(bits.xyz - 0.5 + vec3(0.001));
    let spacing_m = 0.06 + diameter_m * (0.25 + 0.30 * bits.w);
    let along = dot(across, point) + wander_m;
    let distance_m = spacing_m * abs(fract(along / spacing_m + bits.x) - 0.5);
    let covered = clamp((FRACTURE_HALF_WIDTH_M + 0.5 * sample_m - distance_m) / sample_m, 0.0, 1.0);
    let thinned = min(1.0, 2.0 * FRACTURE_HALF_WIDTH_M / sample_m);
    return 0.75 * covered * thinned * smoothstep(-0.3, 0.1, coarse);
}

// xyz: gradient, w: value, in [-1, 1] with a mean of 0, of value noise: trilinear with cubic weights.
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
