// A texel of the visibility buffer. `surface_at` in common/gbuffer.wgsl unpacks it:
//   x, y  24 bits each: the shading normal, octahedral; above them the low and the high byte of the slot
//   z     the triangle's normal, octahedral, two signed 16-bit numbers
//   w     inverse depth, 1/m, as the bits of a float
// Normals are any vectors of their directions; `slot` has its two bytes where they belong.
fn packed_surface(slot: vec2<u32>, shading_normal: vec3<f32>, towards_eye: vec3<f32>, inverse_depth: u32) -> vec4<u32> {
    // Of 1 the half that is added would round the largest code up to one that has a bit more, which is the slot's.
    let code = min((0.5 + 0.5 * octahedral_encode(shading_normal)) * MAX_NORMAL_CODE + 0.5, vec2(MAX_NORMAL_CODE));
    return vec4(vec2<u32>(code) | slot, pack2x16snorm(octahedral_encode(towards_eye)), inverse_depth);
}

// The two bytes of a slot where the visibility buffer has them.
fn packed_slot(slot: u32) -> vec2<u32> {
    return vec2(slot & 0xffu, slot >> 8u) << vec2(24u);
}
