// What light on samples depends on, the same for all samples of a draw. The corners of the triangle that is drawn carry it:
// a driver that runs on the CPU fetches every number of a uniform for each sample by itself.

struct Light {
    // Those of `FrameUniforms` (common/frame.wgsl).
    eye: vec3<f32>,
    sun_direction: vec3<f32>,
    sun_right: vec3<f32>,
    sun_up: vec3<f32>,
    sun_tan_half_angle: f32,
    sun_irradiance: vec3<f32>,
    bounce_share: f32,
    ground_radiance: vec3<f32>,
    sky_radiance: vec3<f32>,
    horizon_towards: vec2<f32>,
    horizon_centre: vec2<f32>,
    horizon_base_m: f32,
    caster_centre: vec2<f32>,
    caster_half_m: f32,
    caster_levels: u32,
    caster_cells: u32,
    horizon_levels: u32,
    hapke_w: f32,
    hapke_b: f32,
    hapke_c: f32,
    hapke_h_s: f32,
    hapke_tan_theta_bar: f32,
    ray_corner: vec3<f32>,
    ray_right: vec3<f32>,
    ray_down: vec3<f32>,
    relief: ReliefView,
    // Those of the `Instance` (common/scene.wgsl), where all samples of the draw show one.
    colour: vec3<f32>,
    roughness: f32,
    surge: f32,
    class_id: u32,
}

// Made by `light_from` at the start of a fragment.
var<private> light: Light;

// All of it, in as few places as a stage may hand to the next on every device.
struct LightVaryings {
    @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat) a: vec4<f32>,
    @location(1) @interpolate(flat) b: vec4<f32>,
    @location(2) @interpolate(flat) c: vec4<f32>,
    @location(3) @interpolate(flat) d: vec4<f32>,
    @location(4) @interpolate(flat) e: vec4<f32>,
    @location(5) @interpolate(flat) f: vec4<f32>,
    @location(6) @interpolate(flat) g: vec4<f32>,
    @location(7) @interpolate(flat) h: vec4<f32>,
    @location(8) @interpolate(flat) i: vec4<f32>,
    @location(9) @interpolate(flat) j: vec4<f32>,
    @location(10) @interpolate(flat) k: vec4<f32>,
    @location(11) @interpolate(flat) l: vec4<f32>,
    @location(12) @interpolate(flat) m: vec4<f32>,
    @location(13) @interpolate(flat) n: vec4<f32>,
    @location(14) @interpolate(flat) o: vec4<f32>,
}

// A triangle over all of the picture.
@vertex
fn vs_main(@builtin(vertex_index) corner: u32) -> LightVaryings {
    return LightVaryings(
        vec4(f32(4u * (corner & 1u)) - 1.0, f32(2u * (corner & 2u)) - 1.0, 0.0, 1.0),
        vec4(frame.ray_from_sample[0].xyz, frame.eye.x),
        vec4(frame.ray_from_sample[1].xyz, frame.eye.y),
        vec4(frame.ray_from_sample[2].xyz, frame.eye.z),
        vec4(frame.sun_direction, 0.0),
        vec4(frame.sun_right, f32(instance.class_id)),
        vec4(frame.sun_up, frame.sun_tan_half_angle),
        vec4(frame.sun_irradiance, frame.bounce_share),
        vec4(frame.ground_radiance, frame.caster_half_m),
        vec4(frame.sky_radiance, frame.horizon_base_m),
        vec4(frame.horizon_towards, frame.horizon_centre),
        vec4(frame.caster_centre, frame.hapke_w, frame.hapke_b),
        vec4(frame.hapke_c, frame.hapke_h_s, frame.hapke_tan_theta_bar, instance.surge),
        vec4(instance.colour, instance.roughness),
        vec4(relief.view.eye_from_centre, relief.view.eye_height_m, relief.view.cell),
        // Whole numbers below 2^24 come through as they are.
        vec4(
            relief.view.sample_angle,
            relief.view.fresh_share,
            f32(frame.horizon_levels + 16u * frame.caster_levels),
            f32(relief.view.waves + 16u * relief.view.pit_lattices + 256u * frame.caster_cells),
        ),
    );
}

fn light_from(in: LightVaryings) -> Light {
    var out: Light;
    out.ray_corner = in.a.xyz;
    out.ray_right = in.b.xyz;
    out.ray_down = in.c.xyz;
    out.eye = vec3(in.a.w, in.b.w, in.c.w);
    out.sun_direction = in.d.xyz;
    out.sun_right = in.e.xyz;
    out.sun_up = in.f.xyz;
    out.sun_tan_half_angle = in.f.w;
    out.sun_irradiance = in.g.xyz;
    out.bounce_share = in.g.w;
    out.ground_radiance = in.h.xyz;
    out.caster_half_m = in.h.w;
    out.sky_radiance = in.i.xyz;
    out.horizon_base_m = in.i.w;
    out.horizon_towards = in.j.xy;
    out.horizon_centre = in.j.zw;
    out.caster_centre = in.k.xy;
    out.hapke_w = in.k.z;
    out.hapke_b = in.k.w;
    out.hapke_c = in.l.x;
    out.hapke_h_s = in.l.y;
    out.hapke_tan_theta_bar = in.l.z;
    out.surge = in.l.w;
    out.colour = in.m.xyz;
    out.roughness = in.m.w;
    out.class_id = u32(in.e.w);
    let levels = u32(in.o.z);
    out.horizon_levels = levels & 0xfu;
    out.caster_levels = levels >> 4u;
    let counts = u32(in.o.w);
    out.relief = ReliefView(in.n.xy, in.n.z, in.n.w, in.o.x, in.o.y, counts & 0xfu, (counts >> 4u) & 0xfu);
    out.caster_cells = counts >> 8u;
    return out;
}
