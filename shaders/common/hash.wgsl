// Integer hashes and noise from them.

// Hash of a cell of a 3-D lattice. CPU counterpart: `lattice_hash` in src/scene/noise/hash.rs. The mixing is the 32-bit
// finalizer "lowbias32" (Wellons 2018, "Prospecting for Hash Functions").
fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    var h = (u32(x) * 0x8da6b343u) ^ (u32(y) * 0xd8163841u) ^ (u32(z) * 0xcb1ab31fu) ^ seed;
    h = (h ^ (h >> 16u)) * 0x7feb352du;
    h = (h ^ (h >> 15u)) * 0x846ca68bu;
    return h ^ (h >> 16u);
}

// Interleaved gradient noise: a number in [0, 1) that differs between neighbouring samples (Jimenez 2014, "Next
// Generation Post Processing in Call of Duty: Advanced Warfare").
fn interleaved_gradient_noise(sample_px: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(sample_px, vec2(0.06711056, 0.00583715))));
}
