//! The structs that Rust and WGSL share.
//!
//! Each field is documented once, in the shader. A test compares names, offsets and sizes of both sides.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec2, Vec3};

use crate::scene::crater_rays::MAX_RAY_CRATERS;

/// Name, offset and size of a field, in bytes.
pub type FieldLayout = (&'static str, usize, usize);

/// Declares a struct that WGSL knows under the same name, and its layout for the test that compares the two.
macro_rules! shader_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty,)* }) => {
        $(#[$doc])*
        #[expect(missing_docs, reason = "each field is documented once, in the shader")]
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: $kind,)* }

        impl $name {
            /// Name, offset and size of every field.
            pub const LAYOUT: &'static [FieldLayout] = &[$((
                stringify!($field), std::mem::offset_of!($name, $field), std::mem::size_of::<$kind>(),
            )),*];
        }
    };
}

shader_struct! {
    /// `FrameUniforms` in `common/frame.wgsl`.
    FrameUniforms {
        clip_from_offset: Mat4,
        ray_from_sample: [[f32; 4]; 3],
        eye: Vec3,
        exposure: f32,
        sun_direction: Vec3,
        sun_tan_half_angle: f32,
        sun_irradiance: Vec3,
        atlas_layer_height_px: f32,
        sun_right: Vec3,
        atlas_width_px: f32,
        sun_up: Vec3,
        diffuse_reflectance: f32,
        ground_radiance: Vec3,
        horizon_base_m: f32,
        sky_radiance: Vec3,
        caster_grid_cells: u32,
        bounce_on_rock: [[[f32; 4]; 4]; 3],
        bounce_on_ground: [[f32; 4]; 3],
        rock_phase: [f32; 4],
        lit_rocks: [u32; 4],
        ground_light: [f32; 4],
        sun_horizontal: Vec2,
        horizon_centre: Vec2,
        caster_grid_centre: Vec2,
        image_size_px: [u32; 2],
        render_size_px: [u32; 2],
        lens_p: Vec2,
        lens_k: [f32; 3],
        focal_samples: f32,
        caster_grid_half_m: f32,
        caster_grid_levels: u32,
        horizon_levels: u32,
        hapke_w: f32,
        hapke_b: f32,
        hapke_c: f32,
        hapke_h_s: f32,
        hapke_tan_theta_bar: f32,
        image_tile: [u32; 4],
        rendered_tile: [u32; 4],
        tile_from_clip: [f32; 4],
        guard_band: Vec2,
        near_m: f32,
        samples_per_side: u32,
        first_sample: Vec2,
        lens_steps: u32,
        zero: u32,
        plane_offsets: [[u32; 4]; 2],
        horizon: [HorizonLevel; 12],
    }
}

shader_struct! {
    /// `HorizonLevel` in `common/frame.wgsl`.
    HorizonLevel {
        origin: Vec2,
        step_m: f32,
        first_texel: u32,
        size: [u32; 2],
        first_sample: Vec2,
    }
}

shader_struct! {
    /// `Lattice` in `common/scene.wgsl`.
    LatticeUniforms {
        rotation_per_m: Vec2,
        phase: Vec2,
        base: [i32; 2],
        seed: u32,
        amount: f32,
        cell_m: f32,
        max_diameter_m: f32,
        share: f32,
        factor: f32,
    }
}

shader_struct! {
    /// `ReliefView` in `common/scene.wgsl`.
    ReliefView {
        eye_from_centre: Vec2,
        eye_height_m: f32,
        cell_angle: f32,
        sample_angle: f32,
        fresh_share: f32,
        waves: u32,
        pit_lattices: u32,
        grain_lattices: u32,
        grain_ratio: f32,
        grain_spread: f32,
        ray_contrast: f32,
    }
}

shader_struct! {
    /// `RayCrater` in `common/scene.wgsl`.
    RayCrater {
        offset: Vec2,
        radius_m: f32,
        seed: u32,
    }
}

shader_struct! {
    /// `ReliefUniforms` in `common/scene.wgsl`.
    ReliefUniforms {
        view: ReliefView,
        noise: [LatticeUniforms; 12],
        pits: [LatticeUniforms; 14],
        grains: [LatticeUniforms; 5],
        crater_rays: [RayCrater; MAX_RAY_CRATERS],
    }
}

shader_struct! {
    /// `Instance` in `common/scene.wgsl`.
    Instance {
        origin: Vec3,
        scale: f32,
        colour: Vec3,
        roughness: f32,
        class_id: u32,
        instance_id: u32,
        surge_height: f32,
        tile_half_extent_m: f32,
        dust: Vec3,
        dust_min_normal_z: f32,
        tile_origin_px: Vec2,
        tile_size_px: f32,
        detail: u32,
        dust_surge_height: f32,
        diameter_m: f32,
        ground_z: f32,
        per_height: f32,
        lit_below: [f32; 4],
        lit_beside: [f32; 4],
        lit_on_top: f32,
        disc_sine: f32,
        reserved_pair: [u32; 2],
    }
}

shader_struct! {
    /// `CasterTile` in `common/scene.wgsl`.
    CasterTile {
        centre: Vec3,
        half_extent_m: f32,
        origin_px: Vec2,
        size_px: f32,
        edge_m: f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::device::bind_groups::slot_stride;
    use crate::render::device::shader_programs::{PROGRAMS, parse};

    #[test]
    fn shared_structs_agree_with_the_shaders() {
        let layouts = [
            ("FrameUniforms", FrameUniforms::LAYOUT, size_of::<FrameUniforms>()),
            ("HorizonLevel", HorizonLevel::LAYOUT, size_of::<HorizonLevel>()),
            ("Lattice", LatticeUniforms::LAYOUT, size_of::<LatticeUniforms>()),
            ("ReliefView", ReliefView::LAYOUT, size_of::<ReliefView>()),
            ("RayCrater", RayCrater::LAYOUT, size_of::<RayCrater>()),
            ("ReliefUniforms", ReliefUniforms::LAYOUT, size_of::<ReliefUniforms>()),
            ("Instance", Instance::LAYOUT, size_of::<Instance>()),
            ("CasterTile", CasterTile::LAYOUT, size_of::<CasterTile>()),
        ];
        let mut compared = 0;
        for program in PROGRAMS {
            let module = parse(program);
            for (_, kind) in module.types.iter() {
                let naga::TypeInner::Struct { members, span } = &kind.inner else { continue };
                let Some((name, layout, size)) = layouts.iter().find(|l| kind.name.as_deref() == Some(l.0))
                else {
                    continue;
                };
                let shader: Vec<(String, usize, usize)> = members
                    .iter()
                    .map(|m| {
                        let bytes = module.types[m.ty].inner.size(module.to_ctx()) as usize;
                        (m.name.clone().unwrap_or_default(), m.offset as usize, bytes)
                    })
                    .collect();
                let rust: Vec<(String, usize, usize)> =
                    layout.iter().map(|&(field, offset, bytes)| (field.to_owned(), offset, bytes)).collect();
                assert_eq!(shader, rust, "{name} in {}", program.name);
                assert_eq!(*span as usize, *size, "size of {name}");
                compared += 1;
            }
        }
        assert!(compared >= 8, "only {compared} structs were compared");
    }

    #[test]
    fn slots_in_shaders_are_as_large_as_in_buffers() {
        let slots =
            [("InstanceSlot", slot_stride::<Instance>()), ("ReliefSlot", slot_stride::<ReliefUniforms>())];
        for (name, stride) in slots {
            let mut spans: Vec<u32> = Vec::new();
            for module in PROGRAMS.iter().map(|program| parse(program)) {
                let slot = module.types.iter().find(|(_, kind)| kind.name.as_deref() == Some(name));
                spans.extend(slot.map(|(_, kind)| kind.inner.size(module.to_ctx())));
            }
            assert!(!spans.is_empty(), "no program has {name}");
            assert!(spans.iter().all(|span| *span == stride), "{name}: {spans:?} bytes, not {stride}");
        }
    }
}
