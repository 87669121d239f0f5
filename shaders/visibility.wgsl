// The visibility buffer: per sample, the instance slot, the shading normal, the triangle's normal and the inverse depth
// (Burns and Hunt 2013, "The Visibility Buffer: A Cache-Friendly Approach to Deferred Shading"). Lighting is a pass of
// its own because triangles are small: a GPU shades quads of 2 x 2 samples, llvmpipe blocks of 4 x 4, once per triangle
// that touches them.
//
// CPU counterpart: src/render/visibility/host.rs.

struct VertexOutput {
    @builtin(position) position: vec4<f32>,
    // World axes, relative to the eye, metres.
    @location(0) offset: vec3<f32>,
    @location(1) normal: vec3<f32>,
    // Index among the instances.
    @location(2) @interpolate(flat) slot: u32,
}

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec2<f32>,
    @builtin(instance_index) slot: u32,
) -> VertexOutput {
    let origin = instances[slot].instance.origin;
    let offset = (origin - frame.eye) + instances[slot].instance.scale * position;
    let clip = frame.clip_from_offset * vec4(offset, 1.0);
    let in_tile = clip.xy * frame.tile_from_clip.xz + clip.w * frame.tile_from_clip.yw;
    return VertexOutput(vec4(in_tile, clip.zw), offset, octahedral_decode(normal), slot);
}

@fragment
fn fs_main(in: VertexOutput) -> @location(0) vec4<u32> {
    let across = dpdx(in.offset);
    let down = dpdy(in.offset);
    let normal_across = dpdx(in.normal);
    let normal_down = dpdy(in.normal);
    let plane_normal = cross(across, down);

    // The ray through the centre of the sample, where it is one metre along the optical axis.
    let sample = in.position.xy + frame.first_sample;
    let ray = frame.ray_from_sample[0].xyz
        + sample.x * frame.ray_from_sample[1].xyz
        + sample.y * frame.ray_from_sample[2].xyz;
    let inverse_depth = inverse_depth_on_plane(in.position.w, in.offset, plane_normal, ray);

    // From the point that was interpolated to the one on the ray, in columns and rows.
    let shift = ray / inverse_depth - in.offset;
    let steps = vec2(dot(cross(shift, down), plane_normal), dot(cross(across, shift), plane_normal))
        / dot(plane_normal, plane_normal);
    let moved_normal = in.normal + steps.x * normal_across + steps.y * normal_down;
    let shading_normal = select(in.normal, moved_normal, all(abs(steps) < vec2(1.0)));

    let towards_eye = select(-plane_normal, plane_normal, dot(plane_normal, in.offset) < 0.0);
    return packed_surface(packed_slot(in.slot), shading_normal, towards_eye, bitcast<u32>(inverse_depth));
}

// Inverse depth where a ray meets the plane through `offset`, near which the inverse depth is `interpolated`.
//
// Devices interpolate between corners that they have rounded to sub-pixel steps (Vulkan specification, "Rasterization"). So
// what they give belongs to a point of the triangle's plane that lies beside the ray: at a grazing angle a 256th of a
// pixel changes depth by a thousandth. As `offset` is that near the ray, errors of the plane's normal hardly count.
fn inverse_depth_on_plane(interpolated: f32, offset: vec3<f32>, plane_normal: vec3<f32>, ray: vec3<f32>) -> f32 {
    let beside = ray - interpolated * offset;
    let exact = interpolated + dot(beside, plane_normal) / dot(offset, plane_normal);
    // Not of a plane that is seen edge-on, within a fraction of a pixel; nor of one without area.
    return select(interpolated, exact, exact > 0.5 * interpolated && exact < 2.0 * interpolated);
}

// The sky has no normals and no inverse depth. Its slot, which is not 0, tells it from where nothing is drawn.
@fragment
fn fs_sky(in: VertexOutput) -> @location(0) vec4<u32> {
    return vec4(packed_slot(in.slot), 0u, 0u);
}
