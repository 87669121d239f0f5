// The midpoint shadow map, of the two layers that shadow.wgsl draws. common/shadow_map.wgsl samples it.
//
// CPU counterpart: src/render/shadow/host.rs.

// Depth of the front faces, with that of the back faces below. Bound as a float texture: GLSL cannot load from a depth
// texture.
@group(2) @binding(0) var layers: texture_2d<f32>;
// Height along the sun above the caster's centre, texels of its tile.
@group(2) @binding(1) var map: texture_storage_2d<r32float, write>;

// src/render/shadow/device.rs has the same workgroup size.
@compute @workgroup_size(8, 8)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(map);
    if any(id.xy >= size) { return; }
    let texel = vec2<i32>(id.xy);
    let front = textureLoad(layers, texel, 0).r;
    let back = textureLoad(layers, texel + vec2(0, i32(size.y)), 0).r;
    textureStore(map, texel, vec4(height_between(front, back)));
}
