//! The light table: the numbers that lighting depends on and that are the same for every sample of a draw.
//!
//! A row of `LIGHT_TABLE` names each number once. The WGSL of the lighting programs that declares the numbers, hands
//! them from the vertex stage to the fragment stage and reads them there is generated from the rows: the part
//! `generated/light.wgsl` of a [`Program`](crate::render::device::shader_programs::Program).
//!
//! Fragments read them from uniforms (`Transport::Uniforms`). In versions before 25 llvmpipe, Mesa's CPU driver, loads each
//! component of a uniform again for every fragment, so that there the numbers travel as flat varyings of the full-screen triangle
//! (`Transport::Varyings`): a frame of the nominal stage takes 11 % less processor time. Version 26.1 compiles loops whose bounds
//! are varyings wrongly: they do not end.
//!
//! To add a number: a row, and `light.NAME` where a shader uses it.

use std::fmt::Write as _;

use crate::gpu::{Gpu, adapter};

/// WGSL type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LightType {
    F32,
    Vec2,
    Vec3,
    /// `u32` below 2 to the power of `bits`. Several share one varying.
    Uint {
        bits: u32,
    },
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
struct LightNumber {
    /// Field of `Light` in WGSL.
    name: &'static str,
    kind: LightType,
    /// WGSL expression of its value, of the uniforms `frame`, `instance` and `relief`, which document it.
    source: &'static str,
}

const fn row(name: &'static str, kind: LightType, source: &'static str) -> LightNumber {
    LightNumber { name, kind, source }
}

/// Every light number.
static LIGHT_TABLE: [LightNumber; 38] = {
    use LightType::{F32, Uint, Vec2, Vec3};
    [
        row("eye", Vec3, "frame.eye"),
        row("ray_origin", Vec3, "frame.ray_from_sample[0].xyz"),
        row("ray_per_column", Vec3, "frame.ray_from_sample[1].xyz"),
        row("ray_per_row", Vec3, "frame.ray_from_sample[2].xyz"),
        row("first_sample", Vec2, "frame.first_sample"),
        row("sun_direction", Vec3, "frame.sun_direction"),
        row("sun_right", Vec3, "frame.sun_right"),
        row("sun_up", Vec3, "frame.sun_up"),
        row("sun_tan_half_angle", F32, "frame.sun_tan_half_angle"),
        row("sun_irradiance", Vec3, "frame.sun_irradiance"),
        row("diffuse_reflectance", F32, "frame.diffuse_reflectance"),
        row("ground_radiance", Vec3, "frame.ground_radiance"),
        row("sky_radiance", Vec3, "frame.sky_radiance"),
        row("sun_horizontal", Vec2, "frame.sun_horizontal"),
        row("horizon_centre", Vec2, "frame.horizon_centre"),
        row("horizon_base_m", F32, "frame.horizon_base_m"),
        row("horizon_levels", Uint { bits: 4 }, "frame.horizon_levels"),
        row("caster_grid_centre", Vec2, "frame.caster_grid_centre"),
        row("caster_grid_half_m", F32, "frame.caster_grid_half_m"),
        row("caster_grid_levels", Uint { bits: 4 }, "frame.caster_grid_levels"),
        row("caster_grid_cells", Uint { bits: 16 }, "frame.caster_grid_cells"),
        row("hapke_w", F32, "frame.hapke_w"),
        row("hapke_b", F32, "frame.hapke_b"),
        row("hapke_c", F32, "frame.hapke_c"),
        row("hapke_h_s", F32, "frame.hapke_h_s"),
        row("hapke_tan_theta_bar", F32, "frame.hapke_tan_theta_bar"),
        row("colour", Vec3, "instance.colour"),
        row("roughness", F32, "instance.roughness"),
        row("surge_height", F32, "instance.surge_height"),
        row("class_id", Uint { bits: 8 }, "instance.class_id"),
        row("relief_eye_from_centre", Vec2, "relief.view.eye_from_centre"),
        row("relief_eye_height_m", F32, "relief.view.eye_height_m"),
        row("relief_cell_angle", F32, "relief.view.cell_angle"),
        row("relief_sample_angle", F32, "relief.view.sample_angle"),
        row("relief_fresh_share", F32, "relief.view.fresh_share"),
        row("relief_waves", Uint { bits: 4 }, "relief.view.waves"),
        row("relief_pit_lattices", Uint { bits: 4 }, "relief.view.pit_lattices"),
        row("relief_grain_lattices", Uint { bits: 4 }, "relief.view.grain_lattices"),
    ]
};

/// How the numbers reach the fragment stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transport {
    /// Packed into flat varyings.
    Varyings,
    /// Read from the uniforms by the fragment stage.
    Uniforms,
}

impl Transport {
    /// That of a device.
    #[must_use]
    pub(crate) fn of(gpu: &Gpu) -> Self {
        let is_slow = gpu.capabilities.software_adapter
            && adapter::mesa_version(&gpu.info).is_some_and(|major| major < FIRST_FAST_MESA);
        Self::choose(is_slow, gpu.device.limits().max_inter_stage_shader_variables)
    }

    /// Varyings where uniforms are slow, if all of them can pass from stage to stage.
    fn choose(is_slow: bool, max_varyings: u32) -> Self {
        if is_slow && pack().1.len() <= max_varyings as usize { Self::Varyings } else { Self::Uniforms }
    }
}

/// The first major version of Mesa whose CPU driver reads uniforms as fast as varyings.
const FIRST_FAST_MESA: u32 = 25;

/// Bits of a whole number that an `f32` holds exactly.
const EXACT_BITS: u32 = 24;

/// Where a number lies among the varyings, each a `vec4<f32>`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    varying: usize,
    /// Its first component.
    component: usize,
    /// First bit within the component, of a `Uint`.
    shift: u32,
}

impl LightType {
    const fn wgsl(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Vec2 => "vec2<f32>",
            Self::Vec3 => "vec3<f32>",
            Self::Uint { .. } => "u32",
        }
    }

    const fn components(self) -> usize {
        match self {
            Self::F32 | Self::Uint { .. } => 1,
            Self::Vec2 => 2,
            Self::Vec3 => 3,
        }
    }
}

/// First-fit packing, wide numbers first. Returns the slot of each row, and the components in use of each varying.
fn pack() -> (Vec<Slot>, Vec<usize>) {
    let mut used: Vec<usize> = Vec::new();
    let mut allocate = |components: usize| {
        let varying = used.iter().position(|used| used + components <= 4).unwrap_or(used.len());
        if varying == used.len() {
            used.push(0);
        }
        let slot = Slot { varying, component: used[varying], shift: 0 };
        used[varying] += components;
        slot
    };
    let mut slots: Vec<Option<Slot>> = vec![None; LIGHT_TABLE.len()];
    for components in [3, 2, 1] {
        for (slot, row) in slots.iter_mut().zip(&LIGHT_TABLE) {
            if row.kind.components() == components && !matches!(row.kind, LightType::Uint { .. }) {
                *slot = Some(allocate(components));
            }
        }
    }
    // Components that hold whole numbers, with their bits in use.
    let mut words: Vec<(Slot, u32)> = Vec::new();
    for (slot, row) in slots.iter_mut().zip(&LIGHT_TABLE) {
        let LightType::Uint { bits } = row.kind else { continue };
        let word = words.iter().position(|(_, used)| used + bits <= EXACT_BITS).unwrap_or_else(|| {
            words.push((allocate(1), 0));
            words.len() - 1
        });
        let (word, used) = &mut words[word];
        *slot = Some(Slot { shift: *used, ..*word });
        *used += bits;
    }
    (slots.into_iter().flatten().collect(), used)
}

/// The WGSL that the table stands for: `Light`, `LightVaryings`, `light_varyings` and `light_from`.
#[must_use]
pub(in crate::render) fn light_wgsl(transport: Transport) -> String {
    let mut text =
        "// Generated from the table in src/render/device/light_table.rs.\n\nstruct Light {\n".to_owned();
    for row in &LIGHT_TABLE {
        push(&mut text, format_args!("    {}: {},\n", row.name, row.kind.wgsl()));
    }
    text.push_str("}\n\n// The light numbers of the draw. An entry point sets it first.\nvar<private> light: Light;\n\nstruct LightVaryings {\n    @builtin(position) position: vec4<f32>,\n");
    let (slots, used) = match transport {
        Transport::Varyings => pack(),
        Transport::Uniforms => (Vec::new(), Vec::new()),
    };
    for varying in 0..used.len() {
        push(&mut text, format_args!("    @location({varying}) @interpolate(flat) v{varying}: vec4<f32>,\n"));
    }
    text.push_str("}\n\nfn light_varyings(position: vec4<f32>) -> LightVaryings {\n    return LightVaryings(\n        position,\n");
    for (varying, &used) in used.iter().enumerate() {
        push(&mut text, format_args!("        vec4({}),\n", packed_expression(&slots, varying, used)));
    }
    text.push_str("    );\n}\n\nfn light_from(in: LightVaryings) -> Light {\n    return Light(\n");
    for (i, row) in LIGHT_TABLE.iter().enumerate() {
        let value = match slots.get(i) {
            Some(slot) => unpacked_expression(row.kind, *slot),
            None => row.source.to_owned(),
        };
        push(&mut text, format_args!("        {value},\n"));
    }
    text.push_str("    );\n}\n");
    text
}

fn push(text: &mut String, line: std::fmt::Arguments<'_>) {
    text.write_fmt(line).expect("a string takes everything");
}

/// Arguments of the `vec4` of a varying.
fn packed_expression(slots: &[Slot], varying: usize, used: usize) -> String {
    let mut arguments: Vec<String> = Vec::new();
    for component in 0..used {
        let here = || {
            LIGHT_TABLE
                .iter()
                .zip(slots)
                .filter(|(_, slot)| (slot.varying, slot.component) == (varying, component))
        };
        let fields: Vec<String> =
            here().map(|(row, slot)| format!("({} << {}u)", row.source, slot.shift)).collect();
        match here().next() {
            Some((row, _)) if matches!(row.kind, LightType::Uint { .. }) => {
                arguments.push(format!("f32({})", fields.join(" | ")));
            }
            Some((row, _)) => arguments.push(row.source.to_owned()),
            None => {} // a further component of a vector
        }
    }
    arguments.extend((used..4).map(|_| "0.0".to_owned()));
    arguments.join(", ")
}

/// The value of a number, of the varyings `in`.
fn unpacked_expression(kind: LightType, slot: Slot) -> String {
    let components = &"xyzw"[slot.component..slot.component + kind.components()];
    let value = format!("in.v{}.{components}", slot.varying);
    match kind {
        LightType::Uint { bits } => {
            format!("(u32({value}) >> {}u) & {:#x}u", slot.shift, (1_u32 << bits) - 1)
        }
        _ => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::device::shader_programs::{
        LIGHTING_ONE_DRAW, LIGHTING_SKY, LIGHTING_SURFACE, TextOptions, parse,
    };

    /// Inter-stage variables of WebGPU's default limits: 16, of which the position takes none.
    const MAX_VARYINGS: usize = 15;

    #[test]
    fn no_two_numbers_share_bits_of_a_varying() {
        let (slots, used) = pack();
        assert_eq!(slots.len(), LIGHT_TABLE.len());
        assert!(used.len() <= MAX_VARYINGS && used.iter().all(|used| *used <= 4), "{used:?}");
        // Bits of each component: all 32 of a float, some of a word of whole numbers.
        let mut taken = vec![[0_u32; 4]; used.len()];
        for (row, slot) in LIGHT_TABLE.iter().zip(&slots) {
            for component in slot.component..slot.component + row.kind.components() {
                let bits = match row.kind {
                    LightType::Uint { bits } => {
                        assert!(slot.shift + bits <= EXACT_BITS, "{}", row.name);
                        ((1 << bits) - 1) << slot.shift
                    }
                    _ => u32::MAX,
                };
                let taken = &mut taken[slot.varying][component];
                assert_eq!(*taken & bits, 0, "{} overlaps another number", row.name);
                *taken |= bits;
            }
        }
    }

    #[test]
    fn the_struct_has_a_field_per_row_and_shaders_read_each() {
        let text = LIGHTING_SURFACE.text();
        for program in [&LIGHTING_SURFACE, &LIGHTING_SKY, &LIGHTING_ONE_DRAW] {
            let module = parse(program);
            let (_, light) =
                module.types.iter().find(|(_, kind)| kind.name.as_deref() == Some("Light")).expect("Light");
            let naga::TypeInner::Struct { members, .. } = &light.inner else { panic!("{light:?}") };
            let fields: Vec<_> = members.iter().filter_map(|member| member.name.as_deref()).collect();
            assert_eq!(fields, LIGHT_TABLE.map(|row| row.name), "{}", program.name);
        }
        for row in &LIGHT_TABLE {
            let uses = text.matches(&format!("light.{}", row.name)).count();
            assert!(uses > 0, "no shader reads `light.{}`: remove its row", row.name);
        }
    }

    #[test]
    fn both_transports_are_valid() {
        for program in [&LIGHTING_SURFACE, &LIGHTING_SKY, &LIGHTING_ONE_DRAW] {
            for transport in [Transport::Varyings, Transport::Uniforms] {
                let text = program.text_for(TextOptions { transport, ..TextOptions::default() });
                assert_eq!(text == program.text(), transport == TextOptions::default().transport);
                let module = naga::front::wgsl::parse_str(&text)
                    .unwrap_or_else(|error| panic!("{transport:?}: {}", error.emit_to_string(&text)));
                let capabilities = naga::valid::Capabilities::empty();
                naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
                    .validate(&module)
                    .unwrap_or_else(|error| panic!("{transport:?}: {}", error.emit_to_string(&text)));
            }
        }
    }

    #[test]
    fn varyings_are_for_drivers_with_slow_uniforms_and_enough_varyings() {
        let needed = pack().1.len() as u32;
        assert_eq!(Transport::choose(true, needed), Transport::Varyings);
        assert_eq!(Transport::choose(true, needed - 1), Transport::Uniforms);
        assert_eq!(Transport::choose(false, needed), Transport::Uniforms);
    }
}
