// Dome and stars: unlit, their colour is their radiance.

struct Varyings {
    @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat, either) instance: u32,
}

@vertex
fn vs_main(@location(0) position: vec3<f32>, @builtin(instance_index) index: u32) -> Varyings {
    let instance = instances[index];
    let offset = (instance.origin - frame.eye) + instance.scale * position;
    return Varyings(frame.clip_from_offset * vec4(offset, 1.0), index);
}

@fragment
fn fs_main(in: Varyings) -> SceneOut {
    let instance = instances[in.instance];
    return SceneOut(vec4(instance.colour, 1.0), instance.class_id, vec4(0.0), 0u, 0.0);
}
