//! The WGSL programs and the structs that they share with Rust.
//!
//! A program is a list of files that are joined as they are: WGSL has no order at module scope. The table
//! [`PROGRAMS`] is what the renderer compiles and what the tests validate.
//! To add a program: its file, a row in [`PROGRAMS`].

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec2, Vec3};

use crate::gpu::Gpu;

/// A WGSL program: the files that make it.
#[derive(Debug)]
pub struct Program {
    /// Its name: that of its first file.
    pub name: &'static str,
    /// Path below `shaders/` and text of each file.
    pub files: &'static [(&'static str, &'static str)],
}

macro_rules! program {
    ($name:literal, $($common:literal),*) => {
        Program {
            name: $name,
            files: &[
                (concat!($name, ".wgsl"), include_str!(concat!("../../../shaders/", $name, ".wgsl"))),
                $((
                    concat!("common/", $common, ".wgsl"),
                    include_str!(concat!("../../../shaders/common/", $common, ".wgsl")),
                )),*
            ],
        }
    };
}

/// Depth of the casters seen from the sun.
pub static SHADOW: Program = program!("shadow", "frame", "scene");
/// The shadow map from the two layers of that.
pub static SHADOW_MIDPOINT: Program = program!("shadow_midpoint",);
/// Which thing each sample shows.
pub static VISIBILITY: Program = program!("visibility", "frame", "scene", "octahedral");
/// Light on ground and rocks.
pub static LIGHTING_SURFACE: Program = program!(
    "lighting_surface",
    "frame",
    "scene",
    "light",
    "octahedral",
    "gbuffer",
    "planes",
    "shadow_map",
    "brdf",
    "relief"
);
/// Light of dome and stars.
pub static LIGHTING_SKY: Program = program!("lighting_sky", "frame", "scene", "light", "relief", "planes");
/// Samples to pixels.
pub static RESOLVE: Program = program!("resolve", "frame", "tone");

/// Every program.
pub static PROGRAMS: [&Program; 6] =
    [&SHADOW, &SHADOW_MIDPOINT, &VISIBILITY, &LIGHTING_SURFACE, &LIGHTING_SKY, &RESOLVE];

impl Program {
    /// The joined text.
    #[must_use]
    pub fn text(&self) -> String {
        self.files.iter().map(|(_, text)| *text).collect::<Vec<_>>().join("\n")
    }

    /// File and line (from 1) of a line (from 1) of the joined text.
    #[must_use]
    pub fn locate(&self, line: usize) -> (&'static str, usize) {
        let mut first = 1;
        for (path, text) in self.files {
            let lines = text.matches('\n').count() + 1;
            if line < first + lines {
                return (path, line + 1 - first);
            }
            first += lines;
        }
        ("", line)
    }

    /// Compiles it on a device.
    #[must_use]
    pub fn compile(&self, gpu: &Gpu) -> wgpu::ShaderModule {
        gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(self.name),
            source: wgpu::ShaderSource::Wgsl(self.text().into()),
        })
    }
}

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
    /// Twin of `FrameUniforms` in `common/frame.wgsl`, where every field is explained.
    FrameUniforms {
        clip_from_offset: Mat4,
        ray_from_sample: [[f32; 4]; 3],
        eye: Vec3,
        exposure: f32,
        sun_direction: Vec3,
        sun_tan_half_angle: f32,
        sun_irradiance: Vec3,
        atlas_layer_px: f32,
        sun_right: Vec3,
        atlas_width_px: f32,
        sun_up: Vec3,
        bounce_share: f32,
        ground_radiance: Vec3,
        horizon_base_m: f32,
        sky_radiance: Vec3,
        caster_cells: u32,
        bounce_on_rock: [[f32; 4]; 4],
        bounce_on_ground: [[f32; 4]; 3],
        bounce_in_shadow: [[f32; 4]; 3],
        horizon_towards: Vec2,
        horizon_centre: Vec2,
        caster_centre: Vec2,
        picture_size_px: [u32; 2],
        drawn_size_px: [u32; 2],
        lens_p: Vec2,
        lens_k: [f32; 3],
        focal_samples: f32,
        caster_half_m: f32,
        caster_levels: u32,
        horizon_levels: u32,
        hapke_w: f32,
        hapke_b: f32,
        hapke_c: f32,
        hapke_h_s: f32,
        hapke_tan_theta_bar: f32,
        depth_at: u32,
        normals_at: u32,
        instances_at: u32,
        hidden_at: u32,
        radiance_at: u32,
        coverage_at: u32,
        reserved: [u32; 2],
        horizon: [HorizonLevel; 12],
    }
}

shader_struct! {
    /// Twin of `HorizonLevel` in `common/frame.wgsl`, where every field is explained.
    HorizonLevel {
        origin: Vec2,
        step_m: f32,
        first_row: u32,
        size: [u32; 2],
        first: Vec2,
    }
}

shader_struct! {
    /// Twin of `Lattice` in `common/relief.wgsl`, where every field is explained.
    LatticeUniforms {
        turn: Vec2,
        phase: Vec2,
        base: [i32; 2],
        seed: u32,
        amount: f32,
        cell_m: f32,
        largest_m: f32,
        clods: f32,
        asked: f32,
    }
}

shader_struct! {
    /// Twin of `ReliefView` in `common/relief.wgsl`, where every field is explained.
    ReliefView {
        eye_from_centre: Vec2,
        eye_height_m: f32,
        cell: f32,
        sample_angle: f32,
        fresh_share: f32,
        waves: u32,
        pit_lattices: u32,
    }
}

shader_struct! {
    /// Twin of `ReliefUniforms` in `common/relief.wgsl`, where every field is explained.
    ReliefUniforms {
        view: ReliefView,
        noise: [LatticeUniforms; 12],
        pits: [LatticeUniforms; 12],
    }
}

shader_struct! {
    /// Twin of `Instance` in `common/scene.wgsl`, where every field is explained.
    Instance {
        origin: Vec3,
        scale: f32,
        colour: Vec3,
        roughness: f32,
        class_id: u32,
        instance_id: u32,
        surge: f32,
        tile_half_extent_m: f32,
        dust: Vec3,
        dust_above: f32,
        tile_origin_px: Vec2,
        tile_size_px: f32,
        reserved: u32,
    }
}

shader_struct! {
    /// Twin of `CasterTile` in `common/scene.wgsl`, where every field is explained.
    CasterTile {
        centre: Vec3,
        half_extent_m: f32,
        origin_px: Vec2,
        size_px: f32,
        facet_m: f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    fn parse(program: &Program) -> naga::Module {
        let text = program.text();
        naga::front::wgsl::parse_str(&text).unwrap_or_else(|error| {
            let line = error.location(&text).map_or(1, |l| l.line_number as usize);
            let (file, line) = program.locate(line);
            panic!("{file}:{line}: {}", error.emit_to_string(&text))
        })
    }

    #[test]
    fn every_program_is_valid() {
        for program in PROGRAMS {
            let module = parse(program);
            assert!(!module.entry_points.is_empty(), "{} has no entry point", program.name);
            // All checks, and no optional capability but the packing of half floats, which Vulkan and GL both have.
            let capabilities = Capabilities::SHADER_FLOAT16_IN_FLOAT32;
            let result = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
            if let Err(error) = result {
                panic!("{}: {}", program.name, error.emit_to_string(&program.text()));
            }
        }
    }

    #[test]
    fn every_file_on_disk_is_part_of_a_program() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
        let mut found = 0;
        for folder in [root.clone(), root.join("common")] {
            for entry in std::fs::read_dir(folder).expect("the shader folder") {
                let path = entry.expect("an entry").path();
                if path.extension().is_some_and(|e| e == "wgsl") {
                    let name =
                        path.strip_prefix(&root).expect("below the root").to_string_lossy().into_owned();
                    assert!(
                        PROGRAMS.iter().any(|p| p.files.iter().any(|(file, _)| *file == name)),
                        "{name} is in no program"
                    );
                    found += 1;
                }
            }
        }
        assert!(found >= 10, "only {found} files");
    }

    #[test]
    fn shared_structs_agree_with_the_shaders() {
        let layouts = [
            ("FrameUniforms", FrameUniforms::LAYOUT, size_of::<FrameUniforms>()),
            ("HorizonLevel", HorizonLevel::LAYOUT, size_of::<HorizonLevel>()),
            ("Lattice", LatticeUniforms::LAYOUT, size_of::<LatticeUniforms>()),
            ("ReliefView", ReliefView::LAYOUT, size_of::<ReliefView>()),
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
    fn programs_that_light_write_every_plane_and_none_knows_a_class() {
        for program in [&LIGHTING_SURFACE, &LIGHTING_SKY] {
            let module = parse(program);
            let entry = module.entry_points.iter().find(|e| e.name == "fs_main").expect("fs_main");
            let result = entry.function.result.as_ref().expect("a result").ty;
            assert_eq!(module.types[result].name.as_deref(), Some("LightingOutput"), "{}", program.name);
        }
        for program in PROGRAMS {
            let text = program.text().to_lowercase();
            for class in crate::class::ClassId::ALL {
                for form in ["const class_", &format!("const {}", class.name)] {
                    assert!(!text.contains(form), "{} names a class", program.name);
                }
            }
            for (_, variable) in parse(program).global_variables.iter() {
                if let Some(binding) = &variable.binding {
                    let expected = match variable.name.as_deref().unwrap_or_default() {
                        "frame" => 0,
                        "instance" | "instances" | "tiles" | "relief" => 1,
                        _ => 2,
                    };
                    assert_eq!(binding.group, expected, "groups are 0 frame, 1 scene, 2 pass");
                }
            }
        }
    }

    #[test]
    fn a_line_of_the_joined_text_is_found_in_its_file() {
        let text = LIGHTING_SURFACE.text();
        let line = text.lines().position(|l| l.contains("fn grid_cell")).expect("the function") + 1;
        let (file, line) = LIGHTING_SURFACE.locate(line);
        assert_eq!(file, "common/shadow_map.wgsl");
        let own = LIGHTING_SURFACE.files.iter().find(|f| f.0 == file).expect("the file").1;
        assert!(own.lines().nth(line - 1).is_some_and(|l| l.contains("fn grid_cell")));
    }
}
