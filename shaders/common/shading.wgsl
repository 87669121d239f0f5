// Shading of ground and rocks: radiance and labels of a sample.

// What can shadow the surface, numbered as in `ShadowSources` (src/render/device/shading_bins.rs): bit 0 the ground, bit 1
// rocks. Without a source every point that faces the sun sees all of it.
override SHADOW_SOURCES: u32;
// The photometric law: a constant of common/brdf.wgsl.
override PHOTOMETRY_LAW: u32;

const SHADOWED_BY_GROUND: u32 = 1u;
const SHADOWED_BY_ROCKS: u32 = 2u;
// The detail below the mesh of a surface. `Detail` in src/render/device/shading_bins.rs has the same values.
const DETAIL_NONE: u32 = 0u;
const DETAIL_RELIEF: u32 = 1u;
const DETAIL_ROCK_TEXTURE: u32 = 2u;
const DETAIL_UPLOADED_SLOPES: u32 = 3u;

// The ground's detail below the mesh where the host computes it (src/render/lighting/slopes_host.rs): slope, rise per metre
// along x and y; factor on the albedo; fraction of the sun's disc that grains leave visible.
@group(2) @binding(5) var slopes: texture_2d<f32>;

// The material at a sample.
struct Shading {
    normal: vec3<f32>,
    albedo: vec3<f32>,
    // Fraction of the sun's disc that the detail leaves visible.
    sun: f32,
    // Amplitude of the opposition surge.
    surge_height: f32,
}

// The sun as a point sees it.
struct SunVisibility {
    // Visible fraction of its disc past the ground.
    horizon: f32,
    // Past everything.
    total: f32,
    // How far inside a shadow the point is: of rocks across the sun, of the ground below its edge. Metres.
    depth_m: f32,
}

// Least cosine between the ground's normal and the direction to the eye.
const MIN_FACING: f32 = 0.04;
// Least cosine of incidence of bounced light.
const MIN_BOUNCE_COSINE: f32 = 0.03;

// Lighting of a surface of this instance with one of the DETAIL constants, at the centre of a sample, given by its
// framebuffer position.
fn shade(surface: Surface, instance: Instance, detail: u32, position: vec2<f32>) -> LightingOutput {
    let to_eye = -unit(surface.offset);
    let shading = shade_detail(surface, instance, detail, to_eye, position);
    let normal = shading.normal;
    let cos_eye = max(dot(normal, to_eye), 0.0);
    let cos_light = max(dot(normal, light.sun_direction), 0.0);
    let sun = sun_visibility(surface, sample_position(position));
    let is_sunlit = cos_light > 0.0 && sun.total > 0.0;
    let bounced = bounced_light(surface, instance, normal, sun, detail);
    // The law is evaluated once: for the sun, or in its shadow for the direction that most of the bounced light comes from.
    var way = light.sun_direction;
    var cos_in = cos_light;
    var focus = 1.0;
    if PHOTOMETRY_LAW == HAPKE && !is_sunlit {
        way = unit(bounced.direction + vec3(0.0, 0.0, 1.0e-9));
        cos_in = max(dot(normal, way), MIN_BOUNCE_COSINE);
        // Where it comes from all around, the mean direction is short.
        focus = min(length(bounced.direction) / max(bounced.irradiance.g, 1.0e-9), 1.0);
    }
    let reflectance = reflected(
        PHOTOMETRY_LAW,
        instance.roughness,
        shading.surge_height,
        cos_in,
        cos_eye,
        focus * dot(way, to_eye),
    );
    let direct = select(0.0, sun.total * shading.sun * reflectance, is_sunlit);
    // Of bounced light, relative to light from all directions.
    var directional = 1.0;
    if PHOTOMETRY_LAW == HAPKE && !is_sunlit {
        directional = reflectance / (cos_in * PER_PI * light.diffuse_reflectance);
    }
    let indirect = sky_irradiance(light.sky_radiance, normal) + directional * bounced.irradiance;
    let radiance = shading.albedo
        * (direct * light.sun_irradiance + (PER_PI * light.diffuse_reflectance) * indirect);
    return lighting_output(
        vec4(min(radiance, vec3(MAX_STORED_RADIANCE)), 1.0),
        instance.class_id,
        vec4(normal, 1.0),
        instance.instance_id,
        // What faces away from the sun is in its own shadow.
        select(1.0, 1.0 - sun.total, cos_light > 0.0),
    );
}

// Normal and albedo with the detail below the mesh.
fn shade_detail(surface: Surface, instance: Instance, detail: u32, to_eye: vec3<f32>, position: vec2<f32>) -> Shading {
    var normal = surface.normal;
    var albedo = instance.colour;
    var surge_height = instance.surge_height;
    var ground = GroundDetail(vec2(0.0), 1.0, 1.0);
    if detail == DETAIL_RELIEF { ground = detail_below_mesh(surface.offset, surface.normal, to_eye); }
    if detail == DETAIL_UPLOADED_SLOPES {
        let texel = textureLoad(slopes, vec2<i32>(position), 0);
        ground = GroundDetail(texel.xy, texel.z, texel.w);
    }
    if detail == DETAIL_RELIEF || detail == DETAIL_UPLOADED_SLOPES {
        normal = ground_normal(surface.normal, ground.slope);
        albedo *= ground.albedo;
    }
    if detail == DETAIL_ROCK_TEXTURE {
        let sample_m = light.relief_sample_angle * length(surface.offset);
        let seed = bitcast<u32>(instance.origin.x);
        let texture = rock_texture(light.eye + surface.offset - instance.origin, sample_m, seed, instance.diameter_m);
        // Dust lies where the rock is level enough, and in hollows; crests stay clean.
        let lie = surface.normal.z - instance.dust_min_normal_z + 0.20 * texture.hollow;
        let dust = 0.9 * smoothstep(-0.08, 0.08, lie);
        let is_smooth = instance.diameter_m == 0.0;
        let gradient = select((1.0 - 0.5 * dust) * texture.gradient, vec3(0.0), is_smooth);
        let tangential = gradient - surface.normal * dot(gradient, surface.normal);
        normal = unit(surface.normal - tangential);
        albedo = mix(instance.colour * select(texture.shade, 1.0, is_smooth), instance.dust, dust);
        surge_height = mix(surge_height, instance.dust_surge_height, dust);
    }
    if detail != DETAIL_NONE {
        // A slope that faces away from the eye is hidden behind a bump that the mesh lacks: turn it towards the eye.
        let min_cosine = 0.3 * max(dot(surface.normal, to_eye), 0.05);
        normal = unit(normal + max(min_cosine - dot(normal, to_eye), 0.0) * to_eye);
    }
    return Shading(normal, albedo, ground.sun, surge_height);
}

// A surface that faces away from the sun occludes it itself.
fn sun_visibility(surface: Surface, sample: vec2<f32>) -> SunVisibility {
    let position = light.eye + surface.offset;
    let faces_sun = dot(surface.normal, light.sun_direction) > 0.0;
    var of_ground = Shadow(1.0, 0.0);
    var cell = GridCell();
    if (SHADOW_SOURCES & SHADOWED_BY_ROCKS) != 0u { cell = grid_cell(position); }
    if SHADOW_SOURCES == SHADOWED_BY_GROUND
        || (SHADOW_SOURCES == (SHADOWED_BY_GROUND | SHADOWED_BY_ROCKS) && cell.in_horizon) {
        of_ground = shadow_of_ground(position);
    }
    var shadow = of_ground;
    if (SHADOW_SOURCES & SHADOWED_BY_ROCKS) != 0u && faces_sun {
        let angle = 6.2831853 * interleaved_gradient_noise(sample);
        let spoke = vec2(cos(angle), sin(angle));
        shadow = shadow_of_casters(cell, of_ground, position, surface.geometric_normal, surface.normal, spoke);
    }
    return SunVisibility(
        of_ground.visibility,
        select(0.0, shadow.visibility, faces_sun),
        shadow.depth_m,
    );
}

// Light from sunlit ground and sunlit rocks.
fn bounced_light(
    surface: Surface,
    instance: Instance,
    normal: vec3<f32>,
    sun: SunVisibility,
    detail: u32,
) -> BouncedLight {
    if PHOTOMETRY_LAW != HAPKE {
        return BouncedLight(bounce_uniform(light.ground_radiance, normal, light.sun_horizontal), vec3(0.0));
    }
    let position = light.eye + surface.offset;
    // Beside sunlight that of rocks hardly matters. It is left out where nothing casts a shadow: there it would cost llvmpipe as much as
    // where something does.
    let shade = 1.0 - sun.total;
    let is_ground = detail == DETAIL_RELIEF || detail == DETAIL_UPLOADED_SLOPES;
    var of_rocks = BouncedLight(vec3(0.0), vec3(0.0));
    if !is_ground || SHADOW_SOURCES != 0u {
        of_rocks = light_of_rocks(position, normal, surface.slot, is_ground, shade > 0.0);
    }
    var of_ground: BouncedLight;
    if is_ground {
        let left = sun.horizon * left_in_shadow(sun.depth_m, light.sun_direction.z);
        of_ground = bounce_on_ground(light.ground_radiance, position, normal, light.sun_horizontal, sun.total, left);
    } else {
        let height = (position.z - instance.ground_z) * instance.per_height;
        of_ground = bounce_on_rock(instance, light.ground_radiance, normal, height, light.sun_horizontal);
    }
    return BouncedLight(
        of_ground.irradiance + shade * of_rocks.irradiance,
        of_ground.direction + shade * of_rocks.direction,
    );
}

// What the ground's mesh leaves out.
fn detail_below_mesh(offset: vec3<f32>, mesh_normal: vec3<f32>, to_eye: vec3<f32>) -> GroundDetail {
    let facing = clamp(dot(mesh_normal, to_eye), MIN_FACING, 1.0);
    let across_m = light.relief_sample_angle * length(offset);
    // The footprint of a sample is longer in depth than across: take the geometric mean of the two.
    let sample_m = across_m * inverseSqrt(facing);
    return ground_detail(
        light.relief_eye_from_centre + offset.xy,
        sample_m,
        across_m,
        way_per_height(to_eye, mesh_normal, GRAIN_MAX_EYE_WAY),
        way_per_height(light.sun_direction, mesh_normal, GRAIN_MAX_SUN_WAY),
    );
}

// Normal of the ground: that of the mesh with a further slope.
fn ground_normal(mesh_normal: vec3<f32>, slope: vec2<f32>) -> vec3<f32> {
    return unit(vec3(mesh_normal.xy * (1.0 / max(mesh_normal.z, 0.1)) - slope, 1.0));
}
