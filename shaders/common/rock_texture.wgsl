// Solid texture of rocks: value noise anchored in the rock (Perlin 1985, "An Image Synthesizer", introduced solid textures).

const TEXTURE_OCTAVES: i32 = 4;
// Rise per metre of an octave.
const TEXTURE_STEEPNESS: f32 = 0.12;

// xyz: gradient of a rock's texture at a point (metres from its centre) where samples are `sample_m` apart; w: its shade, with
// a mean of 0. The octaves follow the sample spacing and fade in and out.
fn rock_texture(point: vec3<f32>, sample_m: f32, seed: u32) -> vec4<f32> {
    let finest = log2(2.0 * sample_m);
    let first = ceil(finest);
    var sum = vec4(0.0);
    for (var k = 0; k < TEXTURE_OCTAVES; k++) {
        let octave = first + f32(k);
        let size_m = exp2(octave);
        // The finest fades in, the coarsest out.
        let share = min(min(octave - finest, 1.0), f32(TEXTURE_OCTAVES) - 1.0 - (octave - finest) + 1.0);
        let noise = value_noise(point / size_m, seed + u32(i32(octave) + 64) * 0x9e3779b9u);
        sum += clamp(share, 0.0, 1.0) * vec4(TEXTURE_STEEPNESS * noise.xyz, noise.w);
    }
    return sum;
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
