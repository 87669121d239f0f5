//! The WGSL programs.
//!
//! A program is a list of parts that are concatenated: WGSL has no order at module scope. A part is a file below
//! `shaders/` or text that is generated from a table. [`PROGRAMS`] is what the renderer compiles and what the tests
//! validate.
//! To add a program: its file, a row in [`PROGRAMS`].

use std::borrow::Cow;

use wgpu::naga::{self, Module};

use super::specialisation::specialised;
use crate::gpu::Gpu;
use crate::render::device::light_table::{Transport, light_wgsl};
use crate::render::device::planes::storage::storage_planes_wgsl;
use crate::render::device::planes::{PlaneSet, lighting_output_wgsl, resolve_planes_wgsl};

/// A WGSL program: the parts that make it.
#[derive(Debug)]
pub struct Program {
    /// The name of its own file, without the extension.
    pub name: &'static str,
    parts: &'static [Part],
}

/// Text that programs share or own.
#[derive(Debug)]
struct Part {
    /// Path below `shaders/`; of generated text, `generated/` and the name of what it declares.
    path: &'static str,
    source: Source,
}

#[derive(Debug)]
enum Source {
    File(&'static str),
    Generated(fn(TextOptions) -> String),
}

/// What generated text depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextOptions {
    /// How light numbers reach the fragment stage.
    pub(crate) transport: Transport,
    /// What a pass of lighting writes.
    pub(crate) planes: PlaneSet,
}

impl Default for TextOptions {
    fn default() -> Self {
        Self { transport: Transport::Varyings, planes: PlaneSet::ALL }
    }
}

/// `generated/light.wgsl`: see [`crate::render::device::light_table`].
const LIGHT: Part =
    Part { path: "generated/light.wgsl", source: Source::Generated(|options| light_wgsl(options.transport)) };
/// The same where there are no varyings.
const UNIFORM_LIGHT: Part =
    Part { path: "generated/light.wgsl", source: Source::Generated(|_| light_wgsl(Transport::Uniforms)) };
/// `generated/storage_planes.wgsl`: see [`crate::render::device::planes::storage`].
const STORAGE_PLANES: Part = Part {
    path: "generated/storage_planes.wgsl",
    source: Source::Generated(|options| storage_planes_wgsl(options.planes)),
};
/// `generated/lighting_output.wgsl`: see [`crate::render::device::planes`].
const LIGHTING_OUTPUT: Part = Part {
    path: "generated/lighting_output.wgsl",
    source: Source::Generated(|options| lighting_output_wgsl(options.planes)),
};
/// `generated/resolve_planes.wgsl`: see [`crate::render::device::planes`].
const RESOLVE_PLANES: Part =
    Part { path: "generated/resolve_planes.wgsl", source: Source::Generated(|_| resolve_planes_wgsl()) };

macro_rules! file {
    ($path:expr) => {
        Part { path: $path, source: Source::File(include_str!(concat!("../../../shaders/", $path))) }
    };
}

macro_rules! program {
    ($name:literal, [$($common:literal),*], [$($generated:expr),*]) => {
        Program {
            name: $name,
            parts: &[
                file!(concat!($name, ".wgsl")),
                $(file!(concat!("common/", $common, ".wgsl")),)*
                $($generated),*
            ],
        }
    };
}

/// Lighting of ground and rocks: all that it needs but where the relief's numbers come from.
macro_rules! surface_program {
    ($name:literal, [$($own:literal),*], [$($generated:expr),*]) => {
        program!(
            $name,
            [
                "frame",
                "scene",
                "octahedral",
                "gbuffer",
                "horizon_map",
                "shadow_map",
                "brdf",
                "hapke",
                "lit_rocks",
                "ground_light",
                "indirect",
                "hash",
                "relief",
                "pits",
                "grains",
                "grain_texture",
                "crater_rays",
                "sun_disc",
                "rock_texture",
                "shading",
                $($own),*
            ],
            [$($generated),*]
        )
    };
}

/// Depth of the shadow casters seen from the sun.
pub static SHADOW: Program = program!("shadow", ["frame", "scene", "midpoint"], []);
/// The shadow map, from the two depth layers of [`SHADOW`].
pub static SHADOW_MIDPOINT: Program = program!("shadow_midpoint", ["midpoint"], []);
/// The shadow map in compute passes.
pub static SHADOW_COMPUTE: Program =
    program!("shadow_compute", ["frame", "scene", "exact", "triangle_groups", "coverage", "midpoint"], []);
/// The visibility buffer.
pub static VISIBILITY: Program =
    program!("visibility", ["frame", "scene", "octahedral", "packed_surface"], []);
/// The visibility buffer in a compute pass.
pub static VISIBILITY_COMPUTE: Program = program!(
    "visibility_compute",
    ["frame", "scene", "octahedral", "packed_surface", "exact", "triangle_groups", "coverage"],
    []
);
/// Lighting of ground and rocks, one shading bin at a time.
pub static LIGHTING_SURFACE: Program =
    surface_program!("lighting_surface", ["fullscreen", "relief_of_draw"], [LIGHT, LIGHTING_OUTPUT]);
/// Lighting of the sky's dome, of stars and of the sun's disc.
pub static LIGHTING_SKY: Program =
    program!("lighting_sky", ["frame", "scene", "fullscreen", "sun_disc"], [LIGHT, LIGHTING_OUTPUT]);
/// Lighting of all surfaces in one draw.
pub static LIGHTING_ONE_DRAW: Program = surface_program!(
    "lighting_one_draw",
    ["fullscreen", "relief_of_sample", "any_surface"],
    [LIGHT, LIGHTING_OUTPUT]
);
/// Lighting of all surfaces in a compute pass.
pub static LIGHTING_COMPUTE: Program = surface_program!(
    "lighting_compute",
    ["relief_of_sample", "any_surface"],
    [UNIFORM_LIGHT, LIGHTING_OUTPUT, STORAGE_PLANES]
);
/// Samples to pixels.
pub static RESOLVE: Program =
    program!("resolve", ["frame", "exact", "lens", "tone", "half"], [RESOLVE_PLANES]);

/// Every program.
pub static PROGRAMS: [&Program; 10] = [
    &SHADOW,
    &SHADOW_MIDPOINT,
    &SHADOW_COMPUTE,
    &VISIBILITY,
    &VISIBILITY_COMPUTE,
    &LIGHTING_SURFACE,
    &LIGHTING_SKY,
    &LIGHTING_ONE_DRAW,
    &LIGHTING_COMPUTE,
    &RESOLVE,
];

impl Part {
    fn text(&self, options: TextOptions) -> Cow<'static, str> {
        match self.source {
            Source::File(text) => text.into(),
            Source::Generated(generate) => generate(options).into(),
        }
    }
}

impl Program {
    /// The text that is compiled for a software adapter: all parts, in order.
    #[must_use]
    pub fn text(&self) -> String {
        self.text_for(TextOptions::default())
    }

    /// The text that is compiled with these options.
    #[must_use]
    pub(crate) fn text_for(&self, options: TextOptions) -> String {
        self.parts.iter().map(|part| part.text(options)).collect::<Vec<_>>().join("\n")
    }

    /// Path and line (from 1) of the part that a line (from 1) of [`Self::text`] comes from.
    #[must_use]
    pub fn locate(&self, line: usize) -> (&'static str, usize) {
        let mut first = 1;
        for part in self.parts {
            let lines = part.text(TextOptions::default()).matches('\n').count() + 1;
            if line < first + lines {
                return (part.path, line + 1 - first);
            }
            first += lines;
        }
        ("", line)
    }

    /// Parses the program with these options.
    ///
    /// # Panics
    /// Where the text does not parse, with naga's message and the line of the file.
    #[must_use]
    pub(crate) fn parse(&self, options: TextOptions) -> ParsedProgram {
        let text = self.text_for(options);
        let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|error| {
            let line = error.location(&text).map_or(1, |l| l.line_number as usize);
            let (file, line) = self.locate(line);
            panic!("{file}:{line}: {}", error.emit_to_string(&text))
        });
        ParsedProgram { name: self.name, module }
    }
}

/// A program to make pipelines of.
#[derive(Debug)]
pub(crate) struct ParsedProgram {
    name: &'static str,
    module: Module,
}

impl ParsedProgram {
    /// What a device compiles for the pipeline with these entry points, where overrides have these values.
    #[must_use]
    pub(crate) fn specialise(
        &self,
        gpu: &Gpu,
        entry_points: &[&str],
        constants: &[(&str, f64)],
    ) -> wgpu::ShaderModule {
        let module = specialised(&self.module, entry_points, constants);
        gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(self.name),
            source: wgpu::ShaderSource::Naga(Cow::Owned(module)),
        })
    }
}

/// The naga module of a program, with the options of a software adapter.
#[cfg(test)]
pub(in crate::render) fn parse(program: &Program) -> Module {
    program.parse(TextOptions::default()).module
}

#[cfg(test)]
mod tests {
    use super::*;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    #[test]
    fn every_program_is_valid() {
        for program in PROGRAMS {
            let module = parse(program);
            assert!(!module.entry_points.is_empty(), "{} has no entry point", program.name);
            // All checks, and no optional capability: what an adapter may lack is written out.
            let result = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
            if let Err(error) = result {
                panic!("{}: {}", program.name, error.emit_to_string(&program.text()));
            }
        }
    }

    /// Direct3D and Metal, which no test renders on: at least their shaders can be written.
    #[test]
    fn every_program_translates_to_hlsl_and_msl() {
        use naga::back::{PipelineConstants, hlsl, msl, pipeline_constants::process_overrides};
        for program in PROGRAMS {
            let module = parse(program);
            let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
                .validate(&module)
                .unwrap_or_else(|error| panic!("{}: {error}", program.name));
            let overrides = module.overrides.iter().filter_map(|(_, constant)| constant.name.clone());
            let constants: PipelineConstants = overrides.map(|name| (name, 1.0)).collect();
            let (module, info) = process_overrides(&module, &info, None, &constants)
                .unwrap_or_else(|error| panic!("{}: {error}", program.name));
            let (options, pipeline) = (hlsl::Options::default(), hlsl::PipelineOptions::default());
            let mut text = String::new();
            hlsl::Writer::new(&mut text, &options, &pipeline)
                .write(&module, &info, None)
                .unwrap_or_else(|error| panic!("{} as HLSL: {error}", program.name));
            // Metal 2.1: macOS 10.14.
            let options = msl::Options { lang_version: (2, 1), ..Default::default() };
            let pipeline = msl::PipelineOptions::default();
            let translation = msl::Writer::new(String::new())
                .write(&module, &info, &options, &pipeline)
                .unwrap_or_else(|error| panic!("{} as MSL: {error}", program.name));
            for entry_point in translation.entry_point_names {
                entry_point.unwrap_or_else(|error| panic!("{} as MSL: {error}", program.name));
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
                        PROGRAMS.iter().any(|p| p.parts.iter().any(|part| part.path == name)),
                        "{name} is in no program"
                    );
                    found += 1;
                }
            }
        }
        assert!(found >= 10, "only {found} files");
    }

    #[test]
    fn no_program_names_a_class() {
        for program in PROGRAMS {
            let text = program.text().to_lowercase();
            for class in crate::class::ClassId::ALL {
                for form in ["const class_", &format!("const {}", class.name)] {
                    assert!(!text.contains(form), "{} names a class", program.name);
                }
            }
        }
    }

    #[test]
    fn bind_groups_are_the_frame_the_scene_and_the_pass() {
        for program in PROGRAMS {
            for (_, variable) in parse(program).global_variables.iter() {
                let Some(binding) = &variable.binding else { continue };
                let name = variable.name.as_deref().unwrap_or_default();
                let expected = match name {
                    "frame" => 0,
                    "instance" | "instances" | "tiles" | "relief" | "reliefs" => 1,
                    _ if name.ends_with("_texels") => 3,
                    _ => 2,
                };
                assert_eq!(binding.group, expected, "`{name}` in {}", program.name);
            }
        }
    }

    /// GLSL cannot load from depth textures.
    #[test]
    fn no_program_binds_a_depth_texture() {
        for program in PROGRAMS {
            let module = parse(program);
            for (_, variable) in module.global_variables.iter() {
                let kind = &module.types[variable.ty].inner;
                let class = match kind {
                    naga::TypeInner::Image { class, .. } => Some(class),
                    _ => None,
                };
                assert!(!matches!(class, Some(naga::ImageClass::Depth { .. })), "{}", program.name);
            }
        }
    }

    #[test]
    fn a_line_of_the_joined_text_is_found_in_its_file() {
        let text = LIGHTING_SURFACE.text();
        let line = text.lines().position(|l| l.contains("fn grid_cell")).expect("the function") + 1;
        let (file, line) = LIGHTING_SURFACE.locate(line);
        assert_eq!(file, "common/shadow_map.wgsl");
        let own = LIGHTING_SURFACE.parts.iter().find(|part| part.path == file).expect("the file");
        let own = own.text(TextOptions::default());
        assert!(own.lines().nth(line - 1).is_some_and(|l| l.contains("fn grid_cell")));
    }

    /// `cargo test --lib write_joined_text -- --ignored` writes what is compiled to `target/shaders/`, to be read.
    #[test]
    #[ignore = "writes files for people"]
    fn write_joined_text() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/shaders");
        std::fs::create_dir_all(&folder).expect("a folder");
        for program in PROGRAMS {
            std::fs::write(folder.join(format!("{}.wgsl", program.name)), program.text()).expect("a file");
        }
    }
}
