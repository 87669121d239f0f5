// Lighting of ground and rocks, one shading bin a draw: what the samples of a bin have in common is a constant.

// The detail below the mesh: one of the DETAIL constants of common/shading.wgsl.
override DETAIL_MODE: u32;
// Whether the samples of the draw show several instances. Each then looks up its own.
override PER_SAMPLE_INSTANCE: bool;

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    let position = in.position.xy;
    let surface = surface_at(position);
    var instance = Instance();
    instance.colour = light.colour;
    instance.roughness = light.roughness;
    instance.surge_height = light.surge_height;
    instance.class_id = light.class_id;
    if PER_SAMPLE_INSTANCE { instance = instances[surface.slot].instance; }
    return shade(surface, instance, DETAIL_MODE, position);
}
