// The visible surface at a sample, unpacked from the visibility buffer (visibility.wgsl).

@group(2) @binding(0) var visibility_buffer: texture_2d<u32>;

struct Surface {
    // World axes, relative to the eye, metres.
    offset: vec3<f32>,
    // Shading normal, interpolated from the vertices.
    normal: vec3<f32>,
    // Normal of the triangle, on the eye's side.
    geometric_normal: vec3<f32>,
    // Index among the instances.
    slot: u32,
}

// The surface at the centre of a sample, given by its framebuffer position.
fn surface_at(position: vec2<f32>) -> Surface {
    let packed = textureLoad(visibility_buffer, vec2<i32>(position), 0);
    return Surface(
        ray_through(position) * (1.0 / bitcast<f32>(packed.w)),
        octahedral_decode(vec2<f32>(packed.xy & vec2(0xffffffu)) * (2.0 / MAX_NORMAL_CODE) - 1.0),
        octahedral_decode(unpack_snorm(packed.z)),
        (packed.x >> 24u) | ((packed.y >> 24u) << 8u),
    );
}

// The ray through the centre of a sample, where it is one metre along the optical axis, by the sample's framebuffer position.
fn ray_through(position: vec2<f32>) -> vec3<f32> {
    let sample = sample_position(position);
    return light.ray_origin + sample.x * light.ray_per_column + sample.y * light.ray_per_row;
}

// Position among all samples of the image of a framebuffer position, which counts from the first sample of the tile.
fn sample_position(position: vec2<f32>) -> vec2<f32> {
    return position + light.first_sample;
}

// `unpack2x16snorm` of what `pack2x16snorm` packed, without a division.
fn unpack_snorm(packed: u32) -> vec2<f32> {
    let halves = bitcast<vec2<i32>>(vec2(packed << 16u, packed)) >> vec2(16u);
    return vec2<f32>(halves) * (1.0 / 32767.0);
}
