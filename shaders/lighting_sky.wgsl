// Lighting of the sky's dome, of stars and of the sun's disc: they emit.

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    let sample = in.position.xy + light.first_sample;
    let ray = light.ray_origin + sample.x * light.ray_per_column + sample.y * light.ray_per_row;
    let radiance = emitted_radiance(light.colour, instance.disc_sine, ray);
    return lighting_output(vec4(radiance, 1.0), light.class_id, vec4(0.0), 0u, 0.0);
}
