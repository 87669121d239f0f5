// Dome and stars: unlit, their colour is their radiance.

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    return LightingOutput(vec4(light.colour, 1.0), light.class_id, vec4(0.0), 0u, 0.0);
}
