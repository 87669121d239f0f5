// Lighting of the sky's dome and of stars: they emit their colour.

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    return lighting_output(vec4(light.colour, 1.0), light.class_id, vec4(0.0), 0u, 0.0);
}
