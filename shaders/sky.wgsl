// Dome and stars: unlit, their colour is their radiance.

@vertex
fn vs_main(@location(0) position: vec3<f32>) -> @builtin(position) vec4<f32> {
    let offset = (instance.origin - frame.eye) + instance.scale * position;
    return frame.clip_from_offset * vec4(offset, 1.0);
}

@fragment
fn fs_main() -> SceneOut {
    return SceneOut(vec4(instance.colour, 1.0), instance.class_id, vec4(0.0), 0u, 0.0);
}
