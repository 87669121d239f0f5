// What every pass of a frame shares. Twin: `FrameUniforms` in src/render/shaders.rs.

struct FrameUniforms {
    // From metres relative to the eye (world axes) to clip space; depth is reversed: 1 near, 0 far.
    clip_from_offset: mat4x4<f32>,
    // From (1, column, row) of a sample, its middle at a half, to the place a metre along the axis that it shows, metres
    // relative to the eye (world axes).
    ray_from_sample: mat3x4<f32>,
    eye: vec3<f32>,
    // Factor on radiance before the tone curve.
    exposure: f32,
    // Unit vector towards the sun.
    sun_direction: vec3<f32>,
    // Tangent of half the angle that the sun's disc spans.
    sun_tan_half_angle: f32,
    // Irradiance on a surface that faces the sun.
    sun_irradiance: vec3<f32>,
    // Height of one of the two layers of the shadow atlas.
    atlas_layer_px: f32,
    // The plane across the sun: sun_right x sun_up = sun_direction.
    sun_right: vec3<f32>,
    atlas_width_px: f32,
    sun_up: vec3<f32>,
    // How much of even light from all around a surface of unit colour reflects.
    bounce_share: f32,
    // Radiance of sunlit level ground, for the light that it bounces.
    ground_radiance: vec3<f32>,
    // Distance from horizon_centre that the first grid of the horizon map serves, metres.
    horizon_base_m: f32,
    // Radiance of the sky's dome, and of an even sky that gives the Earth's light.
    sky_radiance: vec3<f32>,
    // Cells along a side of each caster grid.
    caster_cells: u32,
    // Polynomials for the light that sunlit ground bounces under Hapke's law (src/scene/bounce.rs).
    bounce_on_rock: mat4x4<f32>,
    bounce_on_ground: mat3x4<f32>,
    bounce_in_shadow: mat3x4<f32>,
    // Horizontal unit vector towards the sun: the direction of the horizon map's columns.
    horizon_towards: vec2<f32>,
    // Centres of the horizon map's grids and of the caster grids, metres, world.
    horizon_centre: vec2<f32>,
    caster_centre: vec2<f32>,
    // Pixels of the picture.
    picture_size_px: vec2<u32>,
    // Pixels of what is drawn: more than the picture where a lens distorts it.
    drawn_size_px: vec2<u32>,
    // Tangential and radial coefficients of the lens.
    lens_p: vec2<f32>,
    lens_k: vec3<f32>,
    // Focal length, samples.
    focal_samples: f32,
    // Half the side of the first caster grid, metres; each further one is twice as wide.
    caster_half_m: f32,
    caster_levels: u32,
    // Grids of the horizon map.
    horizon_levels: u32,
    // Hapke's parameters (src/scene/photometry.rs).
    hapke_w: f32,
    hapke_b: f32,
    hapke_c: f32,
    hapke_h_s: f32,
    hapke_tan_theta_bar: f32,
    // Where each annotation starts in the packed result, words; NOT_ASKED where nobody wants it.
    depth_at: u32,
    normals_at: u32,
    instances_at: u32,
    hidden_at: u32,
    radiance_at: u32,
    coverage_at: u32,
    reserved: vec2<u32>,
    horizon: array<HorizonLevel, 12>,
}

// A grid of the horizon map.
struct HorizonLevel {
    // World place that samples are counted from, metres.
    origin: vec2<f32>,
    // Distance between two samples, metres.
    step_m: f32,
    // Its first row in the texture.
    first_row: u32,
    // Samples along and across.
    size: vec2<u32>,
    // Column and row of the first of them.
    first: vec2<f32>,
}

const NOT_ASKED: u32 = 0xffffffffu;

@group(0) @binding(0) var<uniform> frame: FrameUniforms;
