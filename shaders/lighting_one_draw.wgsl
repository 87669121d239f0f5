// Lighting of all surfaces in one draw. It needs no stencil. Where a device takes the time of branches that are not taken, as CPU
// drivers do, draws of one shading bin each are faster (lighting_surface.wgsl).

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    let position = in.position.xy;
    // The planes keep their clear values.
    if is_unwritten(position) { discard; }
    return light_sample(position);
}
