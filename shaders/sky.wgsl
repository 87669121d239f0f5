// Dome and stars: unlit, their colour is their radiance.

@fragment
fn fs_main(@builtin(position) sample: vec4<f32>) -> SceneOut {
    let slot = textureLoad(visible_map, vec2<i32>(sample.xy), 0).w;
    let thing = instances[slot].thing;
    return SceneOut(vec4(thing.colour, 1.0), thing.class_id, vec4(0.0), 0u, 0.0);
}
