// The visibility buffer: per sample, the instance slot, the shading normal, the triangle's normal and the inverse depth
// (Burns and Hunt 2013, "The Visibility Buffer: A Cache-Friendly Approach to Deferred Shading"). Lighting is a pass of
// its own because triangles are small: a GPU shades quads of 2 x 2 samples, llvmpipe blocks of 4 x 4, once per triangle
// that touches them.
//
// CPU counterpart: src/render/visibility/host.rs.

struct VertexOutput {
    @builtin(position) position: vec4<f32>,
    // World axes, relative to the eye, metres.
    @location(0) offset: vec3<f32>,
    @location(1) normal: vec3<f32>,
    // Index among the instances.
    @location(2) @interpolate(flat) slot: u32,
}

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec2<f32>,
    @builtin(instance_index) slot: u32,
) -> VertexOutput {
    let origin = instances[slot].instance.origin;
    let offset = (origin - frame.eye) + instances[slot].instance.scale * position;
    return VertexOutput(frame.clip_from_offset * vec4(offset, 1.0), offset, octahedral_decode(normal), slot);
}

// `surface_at` in common/gbuffer.wgsl unpacks it:
//   x, y  24 bits each: the shading normal, octahedral; above them the low and the high byte of the slot
//   z     the triangle's normal, octahedral, two signed 16-bit numbers
//   w     inverse depth, 1/m, as the bits of a float
@fragment
fn fs_main(in: VertexOutput) -> @location(0) vec4<u32> {
    let geometric_normal = cross(dpdx(in.offset), dpdy(in.offset));
    let towards_eye = select(-geometric_normal, geometric_normal, dot(geometric_normal, in.offset) < 0.0);
    let normal = vec2<u32>((0.5 + 0.5 * octahedral_encode(in.normal)) * 16777215.0 + 0.5);
    let slot = vec2(in.slot & 0xffu, in.slot >> 8u);
    let packed_geometric = pack2x16snorm(octahedral_encode(towards_eye));
    return vec4(normal | (slot << vec2(24u)), packed_geometric, bitcast<u32>(in.position.w));
}

// The sky has no normals and no inverse depth. Its slot, which is not 0, tells it from where nothing is drawn.
@fragment
fn fs_sky(in: VertexOutput) -> @location(0) vec4<u32> {
    let slot = vec2(in.slot & 0xffu, in.slot >> 8u);
    return vec4(slot << vec2(24u), 0u, 0u);
}
