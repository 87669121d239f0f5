// Ground and rocks: lit radiance and labels from one draw.

// Draws ground on which no shadow can fall: what faces the sun sees all of it.
override OPEN: bool;

struct Varyings {
    @builtin(position) clip: vec4<f32>,
    // Metres from the eye, world axes.
    @location(0) offset: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) @interpolate(flat, either) instance: u32,
}

@vertex
fn vs_main(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @builtin(instance_index) index: u32,
) -> Varyings {
    let instance = instances[index];
    let offset = (instance.origin - frame.eye) + instance.scale * position;
    return Varyings(frame.clip_from_offset * vec4(offset, 1.0), offset, normal, index);
}

@fragment
fn fs_main(in: Varyings) -> SceneOut {
    let instance = instances[in.instance];
    let normal = normalize(in.normal);
    let to_eye = -normalize(in.offset);
    let cos_light = max(dot(normal, frame.sun_direction), 0.0);
    var visible = 0.0;
    var direct = 0.0;
    // A surface that is turned away from the sun hides it.
    let facet = cross(dpdx(in.offset), dpdy(in.offset));
    if cos_light > 0.0 {
        visible = 1.0;
        if !OPEN {
            let facet_normal = normalize(select(-facet, facet, dot(facet, to_eye) > 0.0));
            visible = sun_visibility(frame.eye + in.offset, facet_normal, normal, pattern_turn(in.clip.xy));
        }
        let cos_eye = max(dot(normal, to_eye), 0.0);
        let lobe = rough_diffuse(instance.roughness, cos_light, cos_eye, dot(frame.sun_direction, to_eye));
        direct = visible * cos_light * lobe;
    }
    let bounced = ground_bounce(frame.ground_radiance, normal, frame.horizon_towards)
        + sky_light(frame.sky_radiance, normal);
    let radiance = instance.colour * (direct * frame.sun_irradiance + bounced / PI);
    return SceneOut(vec4(radiance, 1.0), instance.class_id, vec4(normal, 1.0), instance.instance_id, 1.0 - visible);
}

// A number in [0, 1) that differs between neighbouring samples (Jimenez 2014, "Next Generation Post Processing in
// Call of Duty: Advanced Warfare": interleaved gradient noise).
fn pattern_turn(sample_px: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(sample_px, vec2(0.06711056, 0.00583715))));
}
