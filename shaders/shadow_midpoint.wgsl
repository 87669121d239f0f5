// The midpoint shadow map: of each caster, the surface halfway between its front and its back faces as seen from the
// sun (Woo 1992, "The Shadow Depth Map Revisited", Graphics Gems III), but no more than some texels behind the front.
// common/shadow_map.wgsl samples it.
//
// CPU counterpart: src/render/shadow/host.rs.

// Depth of the front faces, with that of the back faces below. Bound as a float texture: GLSL cannot load from a depth
// texture.
@group(2) @binding(0) var layers: texture_2d<f32>;
// Height along the sun above the caster's centre, texels of its tile.
@group(2) @binding(1) var map: texture_storage_2d<r32float, write>;

// Height of texels without a caster: far below. src/render/shadow/host.rs has the same constants, and explains the second.
const NO_CASTER: f32 = -1.0e9;
const MAX_BEHIND_FRONT_PX: f32 = 4.0;
// As in shadow.wgsl.
const DEPTH_RANGE_PX: f32 = 2048.0;

// src/render/shadow/device.rs has the same workgroup size.
@compute @workgroup_size(8, 8)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(map);
    if any(id.xy >= size) { return; }
    let texel = vec2<i32>(id.xy);
    let front = textureLoad(layers, texel, 0).r;
    let back = textureLoad(layers, texel + vec2(0, i32(size.y)), 0).r;
    let depth = max(0.5 * (front + back), front - MAX_BEHIND_FRONT_PX / DEPTH_RANGE_PX);
    textureStore(map, texel, vec4(select(DEPTH_RANGE_PX * (depth - 0.5), NO_CASTER, front == 0.0)));
}
