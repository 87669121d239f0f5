// Bind group 0, the frame. The structs have Rust counterparts of the same name in src/render/device/shader_structs.rs.

struct FrameUniforms {
    // From metres relative to the eye (world axes) to clip space. Depth is reversed: 1 near, 0 far.
    clip_from_offset: mat4x4<f32>,
    // From (1, column, row) of a sample, its centre at a half, to the point on its ray that is one metre along the optical
    // axis, metres relative to the eye (world axes).
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
    // Height of each of the two layers of the shadow atlas, texels.
    atlas_layer_height_px: f32,
    // The plane across the sun: sun_right x sun_up = sun_direction.
    sun_right: vec3<f32>,
    atlas_width_px: f32,
    sun_up: vec3<f32>,
    // Reflected fraction of uniform light from all directions, of a surface of unit colour.
    diffuse_reflectance: f32,
    // Radiance of sunlit level ground: the source of bounced light.
    ground_radiance: vec3<f32>,
    // Reach of the first grid of the horizon map from `horizon_centre`, metres.
    horizon_base_m: f32,
    // Radiance of the sky's dome, plus that of a uniform sky as bright as earthshine.
    sky_radiance: vec3<f32>,
    // Cells along a side of each caster grid.
    caster_grid_cells: u32,
    // Polynomials of the light that sunlit ground bounces under Hapke's law (src/scene/bounce.rs).
    bounce_on_rock: array<mat4x4<f32>, 3>,
    bounce_on_ground: mat3x4<f32>,
    rock_phase: vec4<f32>,
    // Sunlit faces of rocks (common/lit_rocks.wgsl): word of the buffer of the caster grid where the lists of the cells begin; cells along a
    // side of each grid; 1 if there are any faces.
    lit_rocks: vec4<u32>,
    // The map of the light of sunlit ground (common/ground_light.wgsl): centre of its grids, metres, world; half the side of the first,
    // metres; its first row in the texture of faces.
    ground_light: vec4<f32>,
    // Horizontal unit vector towards the sun, along which the horizon map's columns run.
    sun_horizontal: vec2<f32>,
    // Centres of the horizon map's grids and of the caster grids, metres, world.
    horizon_centre: vec2<f32>,
    caster_grid_centre: vec2<f32>,
    // Columns and rows of the image.
    image_size_px: vec2<u32>,
    // Columns and rows that are rendered: more than the image has where a lens distorts it.
    render_size_px: vec2<u32>,
    // Tangential and radial coefficients of the lens.
    lens_p: vec2<f32>,
    lens_k: vec3<f32>,
    // Focal length, samples.
    focal_samples: f32,
    // Half the side of the first caster grid, metres; each further one is twice as wide.
    caster_grid_half_m: f32,
    caster_grid_levels: u32,
    // Grids of the horizon map.
    horizon_levels: u32,
    // Hapke's parameters (src/scene/photometry.rs).
    hapke_w: f32,
    hapke_b: f32,
    hapke_c: f32,
    hapke_h_s: f32,
    hapke_tan_theta_bar: f32,
    // Origin and size of the tile of the image that is resolved, pixels (src/render/select/tiles.rs).
    image_tile: vec4<u32>,
    // Origin and size of the rendered pixels that its samples are taken from: those of the G-buffer.
    rendered_tile: vec4<u32>,
    // Scale and offset from clip space to that of the tile: horizontal scale and offset, vertical scale and offset.
    tile_from_clip: vec4<f32>,
    // The guard band around the image over half its size: clip coordinates within it, times w, can be rounded to sub-pixel steps.
    guard_band: vec2<f32>,
    // Distance of the near plane, metres.
    near_m: f32,
    // Samples along a side of a pixel.
    samples_per_side: u32,
    // Column and row of the G-buffer's first sample among all rendered samples.
    first_sample: vec2<f32>,
    // Steps of the inverse of the lens (common/lens.wgsl): of Newton's method in the lower 16 bits, of the fixed-point iteration above.
    lens_steps: u32,
    // 0, which compilers do not know: loops whose length it is part of are not unrolled.
    zero: u32,
    // Offset of each packed plane in the packed frame, words, or NOT_REQUESTED (src/render/device/packing.rs).
    plane_offsets: array<vec4<u32>, 2>,
    horizon: array<HorizonLevel, 12>,
}

// A grid of the horizon map.
struct HorizonLevel {
    // Origin of the columns and rows, metres, world.
    origin: vec2<f32>,
    // Spacing of the samples, metres.
    step_m: f32,
    // Where the grid begins in the texture: the column in the lower half, the row in the upper one.
    first_texel: u32,
    // Samples along the sun's azimuth and across.
    size: vec2<u32>,
    // Column and row of the first sample.
    first_sample: vec2<f32>,
}

const NOT_REQUESTED: u32 = 0xffffffffu;

@group(0) @binding(0) var<uniform> frame: FrameUniforms;
