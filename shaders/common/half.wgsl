// Halves (IEEE 754 binary16), in integer arithmetic: `pack2x16float` is optional (CPU drivers lack it on processors without
// half instructions), and WGSL leaves its rounding open.

// The bits of the half nearest to `value`, ties to even; beyond the largest one infinity; a NaN stays one.
fn half_bits(value: f32) -> u32 {
    let bits = bitcast<u32>(value);
    let sign = (bits >> 16u) & 0x8000u;
    let magnitude = bits & 0x7fffffffu;
    // Of numbers that are normal halves, 13 bits of the significand are rounded off and the exponent's bias is 112 less.
    let is_odd = (magnitude >> 13u) & 1u;
    let normal = (magnitude + 0xfffu + is_odd - 0x38000000u) >> 13u;
    // Smaller ones become multiples of 2^-24, by a longer shift of the significand with its leading one.
    let shift = clamp(126u - min(magnitude >> 23u, 112u), 14u, 25u);
    let significand = (magnitude & 0x7fffffu) | 0x800000u;
    let subnormal = (significand + (1u << (shift - 1u)) - 1u + ((significand >> shift) & 1u)) >> shift;
    let finite = select(normal, subnormal, magnitude < 0x38800000u);
    // From half a step beyond the largest half on.
    let rounded = select(finite, 0x7c00u, magnitude >= 0x477ff000u);
    return sign | select(rounded, 0x7e00u, magnitude > 0x7f800000u);
}

// Two halves in a word, the first in the lower bits.
fn packed_halves(values: vec2<f32>) -> u32 {
    return half_bits(values.x) | (half_bits(values.y) << 16u);
}
