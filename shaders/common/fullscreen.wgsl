// The vertex stage of the lighting passes: one triangle over the whole target. The stencil test selects the samples of
// the draw's shading bin.

@vertex
fn vs_main(@builtin(vertex_index) vertex: u32) -> LightVaryings {
    return light_varyings(vec4(f32(4u * (vertex & 1u)) - 1.0, f32(2u * (vertex & 2u)) - 1.0, 0.0, 1.0));
}
