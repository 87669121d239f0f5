// The shadow map: half way between the fronts and the backs of the casters. Read by `caster_middle` in common/shadow_map.wgsl.

// Fronts above backs. Depth, bound as plain numbers: GLSL cannot load from a depth texture.
@group(2) @binding(0) var layers: texture_2d<f32>;

// What stands for the height where a tile shows no caster: far below. Stands in src/render/shadow_raster.rs too.
const NO_CASTER: f32 = -1.0e9;

// A triangle over all of the map.
@vertex
fn vs_main(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(4u * (corner & 1u)) - 1.0, f32(2u * (corner & 2u)) - 1.0, 0.0, 1.0);
}

// Height along the sun, half extents of the tile from the caster's centre.
@fragment
fn fs_main(@builtin(position) clip: vec4<f32>) -> @location(0) f32 {
    let at = vec2<i32>(clip.xy);
    let front = textureLoad(layers, at, 0).r;
    let back = textureLoad(layers, at + vec2(0, i32(frame.atlas_layer_px)), 0).r;
    return select(front + back - 1.0, NO_CASTER, front == 0.0);
}
