//! The uniforms of a frame, and those of a tile of it.
//! Must not know: a device.

use glam::UVec2;

use crate::lens::InverseSteps;
use crate::render::device::packing::Packing;
use crate::render::device::shader_structs::{FrameUniforms, HorizonLevel};
use crate::render::raster::fixed_point::GUARD_BAND_PX;
use crate::render::resolve::tone;
use crate::render::select::caster_grid::CasterGrids;
use crate::render::select::tiles::{ImageTile, PixelRect};
use crate::render::settings::RenderSettings;
use crate::render::shadow::horizon::{self, HorizonMap};
use crate::scene::Scene;
use crate::scene::bounce::Bounce;

/// The uniforms of a frame of an image of this size, which with a lens is smaller than what is rendered.
pub(super) fn frame_uniforms(
    scene: &Scene,
    settings: &RenderSettings,
    image_size: [u32; 2],
    horizon: &HorizonMap,
    bounce: &Bounce,
) -> FrameUniforms {
    let (camera, sun) = (&scene.camera, &scene.sun);
    let [sun_right, sun_up] = sun.right_and_up();
    let lens = camera.lens;
    let focal_px = camera.focal_px(settings.size[0]);
    let half_extents = image_size.map(|side| 0.5 * f64::from(side) / focal_px);
    let grids = CasterGrids::new(&scene.terrain);
    let photometry = &scene.photometry;
    let exitance = photometry.exitance(f64::from(sun.direction.z)) as f32;
    let mut levels = [HorizonLevel::default(); horizon::MAX_LEVELS];
    levels[..horizon.levels.len()].copy_from_slice(&horizon.levels);
    let uniforms = FrameUniforms {
        clip_from_offset: camera.clip_from_offset(settings.size),
        ray_from_sample: settings.rays(camera).map(|ray| ray.extend(0.0).into()),
        eye: camera.eye,
        exposure: tone::exposure(camera.exposure_ev),
        sun_direction: sun.direction,
        sun_tan_half_angle: sun.tan_half_angle(),
        sun_irradiance: sun.irradiance,
        sun_right,
        sun_up,
        diffuse_reflectance: photometry.diffuse_reflectance() as f32,
        ground_radiance: scene.regolith.albedo * sun.irradiance * exitance / std::f32::consts::PI,
        horizon_base_m: horizon.base_m,
        bounce_on_rock: bounce.on_rock,
        bounce_on_ground: bounce.on_ground,
        rock_phase: bounce.rock_phase,
        sky_radiance: scene.sky.radiance + scene.sky.earthshine,
        caster_grid_cells: grids.cells,
        sun_horizontal: horizon.towards,
        horizon_centre: horizon.centre,
        caster_grid_centre: grids.centre,
        image_size_px: image_size,
        render_size_px: settings.size,
        caster_grid_half_m: grids.half_m,
        caster_grid_levels: grids.levels,
        horizon_levels: horizon.levels.len() as u32,
        hapke_w: photometry.soil.w as f32,
        hapke_b: photometry.soil.b as f32,
        hapke_c: photometry.soil.c as f32,
        hapke_h_s: photometry.soil.h_s as f32,
        hapke_tan_theta_bar: libm::tan(photometry.soil.theta_bar_deg.to_radians()) as f32,
        lens_k: [lens.k1 as f32, lens.k2 as f32, lens.k3 as f32],
        focal_samples: settings.focal_samples(camera),
        lens_p: glam::Vec2::new(lens.p1 as f32, lens.p2 as f32),
        lens_steps: lens.inverse_steps(half_extents).map_or(0, InverseSteps::packed),
        guard_band: GUARD_BAND_PX / (0.5 * UVec2::from(settings.sample_size()).as_vec2()),
        near_m: camera.near_m,
        samples_per_side: settings.samples_per_side,
        horizon: levels,
        ..Default::default()
    };
    let [image, rendered] = [image_size, settings.size].map(PixelRect::whole);
    of_tile(&uniforms, ImageTile { image, rendered }, settings)
}

/// The uniforms for a tile of the image.
pub(crate) fn of_tile(
    uniforms: &FrameUniforms,
    ImageTile { image, rendered }: ImageTile,
    settings: &RenderSettings,
) -> FrameUniforms {
    let flat = |PixelRect { origin: [x, y], size: [width, height] }| [x, y, width, height];
    // From the normalised device coordinates of the image to those of the tile; y points up.
    let [whole, size, origin] =
        [uniforms.render_size_px, rendered.size, rendered.origin].map(|v| v.map(f64::from));
    let scale = [0, 1].map(|axis: usize| whole[axis] / size[axis]);
    let shift = [0, 1].map(|axis: usize| (whole[axis] - size[axis] - 2.0 * origin[axis]) / size[axis]);
    FrameUniforms {
        image_tile: flat(image),
        rendered_tile: flat(rendered),
        tile_from_clip: [scale[0], shift[0], scale[1], -shift[1]].map(|number| number as f32),
        first_sample: UVec2::from(rendered.samples(settings.samples_per_side).origin).as_vec2(),
        plane_offsets: Packing::new(image.size, settings.annotations).offsets(),
        ..*uniforms
    }
}
