// What each sample shows: which thing, and how its surface lies there. Light falls on it in the next pass.
//
// Not in the same draw, because triangles are small: a device shades 2 x 2 samples at a time, a driver that runs on the
// CPU 4 x 4, as often as triangles touch them. Twin, for such a driver: src/render/visibility_raster.rs.

struct Varyings {
    @builtin(position) clip: vec4<f32>,
    // Metres from the eye, world axes.
    @location(0) offset: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) @interpolate(flat) slot: u32,
}

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec2<f32>,
    @builtin(instance_index) slot: u32,
) -> Varyings {
    let origin = instances[slot].instance.origin;
    let offset = (origin - frame.eye) + instances[slot].instance.scale * position;
    return Varyings(frame.clip_from_offset * vec4(offset, 1.0), offset, octahedral_decode(normal), slot);
}

// Read by `surface_at` in common/gbuffer.wgsl.
@fragment
fn fs_main(in: Varyings) -> @location(0) vec4<u32> {
    let facet = cross(dpdx(in.offset), dpdy(in.offset));
    let to_eye = select(-facet, facet, dot(facet, in.offset) < 0.0);
    // The normal in 24 bits each way, beside the two bytes of the slot; one over the metres along the axis.
    let normal = vec2<u32>((0.5 + 0.5 * octahedral_encode(in.normal)) * 16777215.0 + 0.5);
    let slot = vec2(in.slot & 0xffu, in.slot >> 8u);
    return vec4(normal | (slot << vec2(24u)), pack2x16snorm(octahedral_encode(to_eye)), bitcast<u32>(in.clip.w));
}

// Nothing of the sky is read.
@fragment
fn fs_sky() -> @location(0) vec4<u32> {
    return vec4(0u);
}
