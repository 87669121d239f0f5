//! Tests of constants that shaders and Rust both have.

use super::shader_programs::{
    LIGHTING_COMPUTE, LIGHTING_SURFACE, Program, RESOLVE, SHADOW, SHADOW_COMPUTE, SHADOW_MIDPOINT,
    VISIBILITY_COMPUTE, parse,
};

#[test]
fn constants_that_rust_has_too_are_equal() {
    use crate::render::device::packing::{NOT_REQUESTED, WORKGROUP_SIZE};
    use crate::render::device::shading_bins::ShadowSources;
    use crate::render::lighting::compute::WORKGROUP_SIDE;
    use crate::render::lighting::detail_sums::{FAR_M, MIN_CLEARANCE};
    use crate::render::lighting::grain_texture_host as grain_texture;
    use crate::render::lighting::grains_host::{MAX_CELLS, ROUGHNESS};
    use crate::render::lighting::ground_batch::{MAX_EYE_WAY, MAX_SUN_WAY, MIN_TESTED_SAMPLES, MIN_WAY};
    use crate::render::lighting::pits_host::{FRESH_FLOOR, FRESH_SHADE, FRESH_WAVES, PIT_REACH};
    use crate::render::lighting::slopes_host::SHADOW_BLUR;
    use crate::render::lighting::waves_host::{FIRST_STEP_CELLS, MIN_LOW_WAY, TESTED_CELLS};
    use crate::render::select::caster_grid::TEST_HORIZON;
    use crate::render::select::lit_rocks::{FACE_TEXELS, FACES_PER_ROW, REACH};
    use crate::render::select::nested_grids;
    use crate::scene::craters::{CLOD_HEIGHT, JITTER_CELLS, PROFILE_DEPTH, RIM};
    use crate::scene::grains;
    use crate::scene::noise::{PATCHY_BASE, PATCHY_PEAK};
    use crate::scene::photometry::Law;
    use crate::scene::relief::{MAX_STRENGTH, MIN_CELLS};
    let constants = [
        (&LIGHTING_SURFACE, "GRAIN_JITTER_CELLS", f64::from(grains::JITTER_CELLS)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_RADIUS", f64::from(grains::MAX_RADIUS)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_HEIGHT", f64::from(grains::MAX_HEIGHT)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_STRETCH", f64::from(grains::MAX_STRETCH)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_TILT", f64::from(grains::MAX_TILT)),
        (&LIGHTING_SURFACE, "GRAIN_CLOD_SPREAD", f64::from(grains::CLOD_SPREAD)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_SLOPE", f64::from(grains::MAX_SLOPE)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_CELLS", f64::from(MAX_CELLS)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_EYE_WAY", f64::from(MAX_EYE_WAY)),
        (&LIGHTING_SURFACE, "GRAIN_MAX_SUN_WAY", f64::from(MAX_SUN_WAY)),
        (&LIGHTING_SURFACE, "GRAIN_ROUGHNESS", f64::from(ROUGHNESS)),
        (&LIGHTING_SURFACE, "GRAIN_TEXTURE_OCTAVES", f64::from(grain_texture::OCTAVES)),
        (&LIGHTING_SURFACE, "GRAIN_CELLS_PER_DIAMETER", f64::from(grain_texture::CELLS_PER_DIAMETER)),
        (&LIGHTING_SURFACE, "GRAIN_MIN_SHADE", f64::from(grain_texture::MIN_SHADE)),
        (&LIGHTING_SURFACE, "ROUGHNESS_SLOPE", f64::from(grain_texture::ROUGHNESS_SLOPE)),
        (&LIGHTING_SURFACE, "MOTTLING", f64::from(grain_texture::MOTTLING)),
        (&RESOLVE, "WORKGROUP_SIZE", f64::from(WORKGROUP_SIZE)),
        (&RESOLVE, "NOT_REQUESTED", f64::from(NOT_REQUESTED)),
        (&LIGHTING_COMPUTE, "WORKGROUP_SIDE", f64::from(WORKGROUP_SIDE)),
        (&LIGHTING_SURFACE, "TEST_HORIZON", f64::from(TEST_HORIZON)),
        (&LIGHTING_SURFACE, "SHADOWED_BY_GROUND", f64::from(ShadowSources::Ground as u32)),
        (&LIGHTING_SURFACE, "SHADOWED_BY_ROCKS", f64::from(ShadowSources::Rocks as u32)),
        (&LIGHTING_SURFACE, "FACE_TEXELS", FACE_TEXELS as f64),
        (&LIGHTING_SURFACE, "FACES_PER_ROW", FACES_PER_ROW as f64),
        (&LIGHTING_SURFACE, "REACH", f64::from(REACH)),
        (&LIGHTING_SURFACE, "GROUND_LIGHT_CELLS", nested_grids::CELLS as f64),
        (&LIGHTING_SURFACE, "GROUND_LIGHT_LEVELS", nested_grids::LEVELS as f64),
        (&LIGHTING_SURFACE, "PATCHY_BASE", f64::from(PATCHY_BASE)),
        (&LIGHTING_SURFACE, "PATCHY_PEAK", f64::from(PATCHY_PEAK)),
        (&LIGHTING_SURFACE, "MAX_STRENGTH", f64::from(MAX_STRENGTH)),
        (&LIGHTING_SURFACE, "MIN_CELLS", f64::from(MIN_CELLS)),
        (&LIGHTING_SURFACE, "FRESH_SHADE", f64::from(FRESH_SHADE)),
        (&LIGHTING_SURFACE, "FRESH_FLOOR", f64::from(FRESH_FLOOR)),
        (&LIGHTING_SURFACE, "FRESH_WAVES", f64::from(FRESH_WAVES)),
        (&LIGHTING_SURFACE, "PIT_REACH", f64::from(PIT_REACH)),
        (&LIGHTING_SURFACE, "MIN_CLEARANCE", f64::from(MIN_CLEARANCE)),
        (&LIGHTING_SURFACE, "FAR_M", f64::from(FAR_M)),
        (&LIGHTING_SURFACE, "MIN_TESTED_SAMPLES", f64::from(MIN_TESTED_SAMPLES)),
        (&LIGHTING_SURFACE, "MIN_WAY", f64::from(MIN_WAY)),
        (&LIGHTING_SURFACE, "MIN_LOW_WAY", f64::from(MIN_LOW_WAY)),
        (&LIGHTING_SURFACE, "FIRST_STEP_CELLS", f64::from(FIRST_STEP_CELLS)),
        (&LIGHTING_SURFACE, "SHADOW_BLUR", f64::from(SHADOW_BLUR)),
        (&LIGHTING_SURFACE, "TESTED_CELLS", f64::from(TESTED_CELLS)),
        (&LIGHTING_SURFACE, "JITTER_CELLS", f64::from(JITTER_CELLS)),
        (&LIGHTING_SURFACE, "PROFILE_DEPTH", f64::from(PROFILE_DEPTH)),
        (&LIGHTING_SURFACE, "RIM", f64::from(RIM)),
        (&LIGHTING_SURFACE, "CLOD_HEIGHT", f64::from(CLOD_HEIGHT)),
        (&LIGHTING_SURFACE, "LAMBERT", f64::from(Law::Lambert as u32)),
        (&LIGHTING_SURFACE, "OREN_NAYAR", f64::from(Law::OrenNayar as u32)),
        (&LIGHTING_SURFACE, "LOMMEL_SEELIGER", f64::from(Law::LommelSeeliger as u32)),
        (&LIGHTING_SURFACE, "HAPKE", f64::from(Law::Hapke as u32)),
    ];
    for (program, name, expected) in constants {
        assert_eq!(constant(program, name), expected, "{name} in {}", program.name);
    }
}

#[test]
fn constants_of_the_ground_that_rust_has_too_are_equal() {
    use crate::render::lighting::gbuffer::MAX_NORMAL_CODE;
    use crate::render::lighting::relief_bands::MIN_FACING;
    use crate::scene::crater_rays::{
        HALO_REACH, MEAN_STREAK, MOTTLE_CELLS_PER_RADIUS, RAYS_REACH, STREAK_CELLS, STREAK_CELLS_PER_RADIUS,
    };
    use crate::scene::craters::SECOND_HASH;
    for (name, expected) in [
        ("MAX_NORMAL_CODE", f64::from(MAX_NORMAL_CODE)),
        ("MIN_FACING", f64::from(MIN_FACING)),
        ("RAYS_REACH", f64::from(RAYS_REACH)),
        ("HALO_REACH", f64::from(HALO_REACH)),
        ("STREAK_CELLS", f64::from(STREAK_CELLS)),
        ("STREAK_CELLS_PER_RADIUS", f64::from(STREAK_CELLS_PER_RADIUS)),
        ("MOTTLE_CELLS_PER_RADIUS", f64::from(MOTTLE_CELLS_PER_RADIUS)),
        ("MEAN_STREAK", f64::from(MEAN_STREAK)),
        ("SECOND_HASH", f64::from(SECOND_HASH)),
    ] {
        assert_eq!(constant(&LIGHTING_SURFACE, name), expected, "{name}");
    }
}

#[test]
fn constants_of_the_shadow_map_that_rust_has_too_are_equal() {
    use crate::render::select::casters::DEPTH_RANGE_PX;
    use crate::render::shadow::host::{MAX_BEHIND_FRONT_PX, NO_CASTER};
    for (program, name, expected) in [
        (&SHADOW, "DEPTH_RANGE_PX", DEPTH_RANGE_PX),
        (&SHADOW_MIDPOINT, "DEPTH_RANGE_PX", DEPTH_RANGE_PX),
        (&SHADOW_MIDPOINT, "MAX_BEHIND_FRONT_PX", MAX_BEHIND_FRONT_PX),
        (&SHADOW_MIDPOINT, "NO_CASTER", NO_CASTER),
    ] {
        assert_eq!(constant(program, name), f64::from(expected), "{name} in {}", program.name);
    }
}

#[test]
fn constants_of_compute_passes_that_rust_has_too_are_equal() {
    use crate::render::shadow::compute as shadow;
    use crate::render::visibility::{compute as visibility, triangle_groups as groups};
    for (program, name, expected) in [
        (&VISIBILITY_COMPUTE, "WORKGROUP_SIDE", visibility::WORKGROUP_SIDE),
        (&SHADOW_COMPUTE, "WORKGROUP_SIDE", shadow::WORKGROUP_SIDE),
        (&SHADOW_COMPUTE, "GROUP_TRIANGLES", groups::GROUP_TRIANGLES),
        (&SHADOW_COMPUTE, "GROUPS_PER_ROW", groups::GROUPS_PER_ROW),
        (&SHADOW_COMPUTE, "QUEUE_WORKGROUPS", groups::QUEUE_WORKGROUPS),
        (&SHADOW_COMPUTE, "MAX_HUGE", groups::MAX_HUGE),
        (&SHADOW_COMPUTE, "IS_NARROW", groups::IS_NARROW),
        (&VISIBILITY_COMPUTE, "IS_SKY", groups::IS_SKY),
    ] {
        assert_eq!(constant(program, name), f64::from(expected), "{name} in {}", program.name);
    }
    let steps = crate::render::raster::fixed_point::SUBPIXEL_STEPS;
    assert_eq!(constant(&VISIBILITY_COMPUTE, "SUBPIXEL_STEPS"), f64::from(steps));
}

/// The value of a constant of a program.
fn constant(program: &Program, name: &str) -> f64 {
    let module = parse(program);
    let constant = module.constants.iter().find(|(_, constant)| constant.name.as_deref() == Some(name));
    let (_, constant) = constant.unwrap_or_else(|| panic!("{name} in {}", program.name));
    match module.global_expressions[constant.init] {
        naga::Expression::Literal(naga::Literal::U32(value)) => f64::from(value),
        naga::Expression::Literal(naga::Literal::I32(value)) => f64::from(value),
        naga::Expression::Literal(naga::Literal::F32(value)) => f64::from(value),
        ref other => panic!("{name}: {other:?}"),
    }
}
