// The shadow map: half way between the fronts and the backs of the casters. Read by common/shadow_map.wgsl.

// Fronts above backs. Depth, bound as plain numbers: GLSL cannot load from a depth texture.
@group(2) @binding(0) var layers: texture_2d<f32>;
// Height along the sun, half extents of the tile from the caster's centre.
@group(2) @binding(1) var map: texture_storage_2d<r32float, write>;

// What stands for the height where a tile shows no caster: far below. Stands in src/render/shadow_raster.rs too.
const NO_CASTER: f32 = -1.0e9;

// The side of a group stands in src/render/shadow_pass.rs too.
@compute @workgroup_size(8, 8)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(map);
    if any(id.xy >= size) { return; }
    let at = vec2<i32>(id.xy);
    let front = textureLoad(layers, at, 0).r;
    let back = textureLoad(layers, at + vec2(0, i32(size.y)), 0).r;
    let middle = select(front + back - 1.0, NO_CASTER, front == 0.0);
    textureStore(map, at, vec4(middle));
}
