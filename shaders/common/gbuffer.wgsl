// What the samples show, as the visibility pass left it. Programs that include this draw it as one triangle over all of the
// picture; the stencil says which samples are theirs.

@group(2) @binding(0) var visible_map: texture_2d<u32>;

struct Surface {
    // Metres from the eye, world axes.
    offset: vec3<f32>,
    // The smooth one, and that of the triangle, towards the eye.
    normal: vec3<f32>,
    facet_normal: vec3<f32>,
    // Place among the instances.
    slot: u32,
}

// At the middle of a sample.
fn surface_at(sample: vec2<f32>) -> Surface {
    let at = vec2<i32>(sample);
    let packed = textureLoad(visible_map, at, 0);
    let ray = light.ray_corner + sample.x * light.ray_right + sample.y * light.ray_down;
    return Surface(
        ray * (1.0 / bitcast<f32>(packed.w)),
        octahedral_decode(vec2<f32>(packed.xy & vec2(0xffffffu)) * (2.0 / 16777215.0) - 1.0),
        octahedral_decode(signed_halves(packed.z)),
        (packed.x >> 24u) | ((packed.y >> 24u) << 8u),
    );
}

// As `unpack2x16snorm`, of what `pack2x16snorm` packs, without a division.
fn signed_halves(packed: u32) -> vec2<f32> {
    let halves = bitcast<vec2<i32>>(vec2(packed << 16u, packed)) >> vec2(16u);
    return vec2<f32>(halves) * (1.0 / 32767.0);
}
