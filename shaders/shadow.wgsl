// Depth of the shadow casters seen from the sun, each in its tile of the atlas. There is no fragment stage.
//
// CPU counterpart: src/render/shadow/host.rs.

// 0 for the layer of front faces, 1 for the layer of back faces below it.
override ATLAS_LAYER: f32;

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @builtin(instance_index) slot: u32,
) -> @builtin(position) vec4<f32> {
    let p = instances[slot].instance.scale * position / instances[slot].instance.tile_half_extent_m;
    let across = vec2(dot(p, frame.sun_right), -dot(p, frame.sun_up));
    let in_tile = (0.5 + 0.5 * across) * instances[slot].instance.tile_size_px;
    let texel = instances[slot].instance.tile_origin_px + in_tile + vec2(0.0, ATLAS_LAYER * frame.atlas_layer_height_px);
    let uv = texel / vec2(frame.atlas_width_px, 2.0 * frame.atlas_layer_height_px);
    let height_px = 0.5 * instances[slot].instance.tile_size_px * dot(p, frame.sun_direction);
    return vec4(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y, 0.5 + height_px / DEPTH_RANGE_PX, 1.0);
}
