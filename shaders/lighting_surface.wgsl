// Ground and rocks: lit radiance and labels of the samples that show them, from one draw.

// What can shade what is drawn (by its place in `Shades`, src/render/shadow.rs): nothing, so that what faces the sun sees
// all of it; other ground; rocks; both.
override SHADOW_SOURCES: u32;
// The law of reflection.
override PHOTOMETRY_LAW: u32;
// What detail below the mesh there is: none, that of the ground, that of rocks, that of the ground whose slopes are given.
override DETAIL_MODE: u32;
// Whether it is one of many, so that each sample must look up which.
override PER_SAMPLE_INSTANCE: bool;

const SHADOWED_BY_GROUND: u32 = 1u;
const SHADOWED_BY_ROCKS: u32 = 2u;
const DETAIL_RELIEF: u32 = 1u;
const DETAIL_ROCK_TEXTURE: u32 = 2u;
const DETAIL_UPLOADED_SLOPES: u32 = 3u;

// Of ground below its mesh, where a device is given them (src/render/slopes.rs): rise per metre along x and y.
@group(2) @binding(5) var slopes: texture_2d<f32>;

@fragment
fn fs_main(in: LightVaryings) -> LightingOutput {
    light = light_from(in);
    let surface = surface_at(in.clip.xy);
    var thing = Instance();
    thing.colour = light.colour;
    thing.roughness = light.roughness;
    thing.surge = light.surge;
    thing.class_id = light.class_id;
    if PER_SAMPLE_INSTANCE { thing = instances[surface.slot].instance; }
    let smooth_normal = surface.normal;
    let to_eye = -unit(surface.offset);
    var normal = smooth_normal;
    var albedo = thing.colour;
    if DETAIL_MODE == DETAIL_RELIEF {
        normal = ground_normal(smooth_normal, slope_below_mesh(surface.offset, smooth_normal, to_eye));
    }
    if DETAIL_MODE == DETAIL_UPLOADED_SLOPES {
        normal = ground_normal(smooth_normal, textureLoad(slopes, vec2<i32>(in.clip.xy), 0).xy);
    }
    if DETAIL_MODE == DETAIL_ROCK_TEXTURE {
        let sample_m = light.relief.sample_angle * length(surface.offset);
        let seed = bitcast<u32>(thing.origin.x);
        let texture = solid_texture(light.eye + surface.offset - thing.origin, sample_m, seed);
        let across = texture.xyz - smooth_normal * dot(texture.xyz, smooth_normal);
        normal = unit(smooth_normal - across);
        // Soil lies where the rock is level enough, with an edge that its texture frays.
        let dusty = smoothstep(-0.08, 0.08, smooth_normal.z - thing.dust_above + 0.12 * texture.w);
        albedo = mix(thing.colour * (1.0 + 0.30 * texture.w), thing.dust, dusty);
    }
    if DETAIL_MODE != 0u {
        // A slope that looks away lies behind a bump that is not drawn: what is seen there is turned to the eye.
        let least = 0.3 * max(dot(smooth_normal, to_eye), 0.05);
        normal = unit(normal + max(least - dot(normal, to_eye), 0.0) * to_eye);
    }
    let cos_eye = max(dot(normal, to_eye), 0.0);
    let cos_light = max(dot(normal, light.sun_direction), 0.0);
    let place = light.eye + surface.offset;
    // A surface that is turned away from the sun hides it.
    let faces_sun = dot(smooth_normal, light.sun_direction) > 0.0;
    // How much of the sun's disc other ground leaves.
    var open = 1.0;
    var cell = GridCell();
    if (SHADOW_SOURCES & SHADOWED_BY_ROCKS) != 0u { cell = grid_cell(place); }
    if SHADOW_SOURCES == SHADOWED_BY_GROUND || (SHADOW_SOURCES == (SHADOWED_BY_GROUND | SHADOWED_BY_ROCKS) && cell.asks_horizon) {
        open = horizon_visibility(place);
    }
    var visible = select(0.0, open, faces_sun);
    if (SHADOW_SOURCES & SHADOWED_BY_ROCKS) != 0u && faces_sun {
        let turn = 6.2831853 * pattern_turn(in.clip.xy);
        let spoke = vec2(cos(turn), sin(turn));
        visible = visibility_past_casters(cell, open, place, surface.facet_normal, smooth_normal, spoke);
    }
    var direct = 0.0;
    if cos_light > 0.0 {
        let cos_phase = dot(light.sun_direction, to_eye);
        direct = visible * reflected(PHOTOMETRY_LAW, thing.roughness, thing.surge, cos_light, cos_eye, cos_phase);
    }
    var bounced = sky_light(light.sky_radiance, normal);
    if PHOTOMETRY_LAW == HAPKE {
        if DETAIL_MODE == DETAIL_RELIEF || DETAIL_MODE == DETAIL_UPLOADED_SLOPES {
            // What lies in the shadow of ground has the same shadow around it.
            bounced += bounce_on_ground(light.ground_radiance, normal, light.horizon_towards, open);
        } else {
            bounced += bounce_on_rock(light.ground_radiance, normal, light.horizon_towards);
        }
    } else {
        bounced += ground_bounce(light.ground_radiance, normal, light.horizon_towards);
    }
    let radiance = albedo * (direct * light.sun_irradiance + (PER_PI * light.bounce_share) * bounced);
    return LightingOutput(vec4(radiance, 1.0), thing.class_id, vec4(normal, 1.0), thing.instance_id, 1.0 - visible);
}

// Rise per metre along x and y of the relief that the ground's mesh leaves out.
fn slope_below_mesh(offset: vec3<f32>, smooth_normal: vec3<f32>, to_eye: vec3<f32>) -> vec2<f32> {
    let facing = clamp(dot(smooth_normal, to_eye), 0.04, 1.0);
    // Samples lie further apart in depth than across: the mean of the two, in the logarithm.
    let sample_m = light.relief.sample_angle * length(offset) * inverseSqrt(facing);
    return relief_slope(light.relief.eye_from_centre + offset.xy, sample_m);
}

// The normal of the ground with it.
fn ground_normal(smooth_normal: vec3<f32>, slope: vec2<f32>) -> vec3<f32> {
    return unit(vec3(smooth_normal.xy * (1.0 / max(smooth_normal.z, 0.1)) - slope, 1.0));
}

// A number in [0, 1) that differs between neighbouring samples (Jimenez 2014, "Next Generation Post Processing in
// Call of Duty: Advanced Warfare": interleaved gradient noise).
fn pattern_turn(sample_px: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(sample_px, vec2(0.06711056, 0.00583715))));
}
