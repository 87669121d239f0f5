// Lighting of all surfaces in a compute pass: what lighting_one_draw.wgsl draws, for devices that compute on more of the chip than they
// draw on.

// src/render/lighting/compute.rs has the same constant.
const WORKGROUP_SIDE: u32 = 8u;

@compute @workgroup_size(WORKGROUP_SIDE, WORKGROUP_SIDE)
fn cs_main(@builtin(global_invocation_id) sample: vec3<u32>) {
    // The textures may be larger than the tile.
    if any(sample.xy >= frame.samples_per_side * frame.rendered_tile.zw) { return; }
    let position = vec2<f32>(sample.xy) + 0.5;
    light = light_from(LightVaryings(vec4(position, 0.0, 1.0)));
    if is_unwritten(position) {
        store_planes(sample.xy, clear_values());
        return;
    }
    store_planes(sample.xy, light_sample(position));
}
