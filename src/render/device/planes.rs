//! The planes on the device: what a lighting draw writes per sample ([`SAMPLE_PLANES`]), and how the resolve pass turns
//! samples into the planes of a frame ([`resolve_rule`]).
//!
//! The WGSL that repeats these tables is generated from them: `struct LightingOutput` (`generated/lighting_output.wgsl`)
//! and `resolve_annotations` (`generated/resolve_planes.wgsl`).
//!
//! Devices differ in how many planes a pass can write: [`lighting_passes`] divides them.
//!
//! To add a plane of samples: a variant of [`SamplePlane`] with its row here, and its value where the
//! lighting shaders call `lighting_output`; for the plane of the frame that comes from it
//! see [`crate::frame::plane`], and here its arm in [`resolve_rule`].
//! Must not know: a pass.

pub(crate) mod storage;

use std::fmt::Write as _;

use wgpu::TextureFormat;

use crate::class::ClassId;
use crate::frame::Annotations;
use crate::frame::plane::{PLANES, Plane};

/// What lighting writes per sample. The location in `LightingOutput` and the binding in `resolve.wgsl` are the index in
/// [`SAMPLE_PLANES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SamplePlane {
    /// Linear radiance.
    Radiance,
    /// Class id.
    Class,
    /// World normal.
    Normal,
    /// Instance id.
    Instance,
    /// Fraction of the sun's disc that is occluded.
    SunOcclusion,
}

/// A row of [`SAMPLE_PLANES`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct SamplePlaneRow {
    /// The plane.
    pub plane: SamplePlane,
    /// Field of `LightingOutput`.
    pub name: &'static str,
    /// WGSL type of the field.
    wgsl: &'static str,
    /// Format of its texture.
    pub format: TextureFormat,
    /// Comment on the field.
    comment: &'static str,
}

const fn row(
    plane: SamplePlane,
    name: &'static str,
    wgsl: &'static str,
    format: TextureFormat,
    comment: &'static str,
) -> SamplePlaneRow {
    SamplePlaneRow { plane, name, wgsl, format, comment }
}

/// Every plane of samples, by location.
pub(crate) static SAMPLE_PLANES: [SamplePlaneRow; 5] = {
    use TextureFormat::{R8Uint, R8Unorm, R16Uint, Rgba16Float};
    [
        row(
            SamplePlane::Radiance,
            "radiance",
            "vec4<f32>",
            Rgba16Float,
            "Linear radiance; alpha is 1 and unused.",
        ),
        row(SamplePlane::Class, "class_id", "u32", R8Uint, "A `ClassId`."),
        row(
            SamplePlane::Normal,
            "normal",
            "vec4<f32>",
            Rgba16Float,
            "World normal, 0 for the sky; alpha is 1 and unused.",
        ),
        row(SamplePlane::Instance, "instance_id", "u32", R16Uint, "0 for what is no instance."),
        row(
            SamplePlane::SunOcclusion,
            "sun_occlusion",
            "f32",
            R8Unorm,
            "Fraction of the sun's disc that is occluded, 0 for the sky.",
        ),
    ]
};

impl SamplePlaneRow {
    /// Whether its values are unsigned integers.
    #[must_use]
    pub(crate) fn is_uint(&self) -> bool {
        self.wgsl == "u32"
    }
}

impl SamplePlane {
    /// Its row.
    #[must_use]
    pub(crate) fn row(self) -> &'static SamplePlaneRow {
        &SAMPLE_PLANES[self as usize]
    }

    /// Value of samples that no draw writes. They make a frame an error (`resolve.wgsl`), so magenta is never seen but by those
    /// who look for the cause.
    #[must_use]
    pub(crate) fn clear_value(self) -> wgpu::Color {
        match self {
            Self::Radiance => wgpu::Color { r: 1.0, g: 0.0, b: 1.0, a: 1.0 },
            Self::Class => wgpu::Color { r: ClassId::UNLABELLED.0.into(), ..wgpu::Color::TRANSPARENT },
            Self::Normal | Self::Instance | Self::SunOcclusion => wgpu::Color::TRANSPARENT,
        }
    }

    /// Whether a frame with these annotations needs it.
    #[must_use]
    pub(crate) fn is_needed(self, annotations: Annotations) -> bool {
        let needs = |rule: ResolveRule| match rule {
            ResolveRule::Quads(planes) => planes.contains(&self),
            ResolveRule::Pixel { .. } | ResolveRule::Host => false,
            ResolveRule::Instance { .. } => self == Self::Instance,
            ResolveRule::InstanceMean { sum, .. } => self == Self::Instance || sum == Sum::Plane(self),
        };
        PLANES.iter().any(|row| row.plane.is_in(annotations) && needs(resolve_rule(row.plane)))
    }
}

/// The planes that one pass of lighting writes, by index in [`SAMPLE_PLANES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PlaneSet([bool; SAMPLE_PLANES.len()]);

impl PlaneSet {
    /// Every plane.
    pub(crate) const ALL: Self = Self([true; SAMPLE_PLANES.len()]);

    /// Its rows, by location: the n-th has location n in the pass.
    pub(crate) fn rows(self) -> impl Iterator<Item = &'static SamplePlaneRow> {
        SAMPLE_PLANES.iter().filter(move |row| self.0[row.plane as usize])
    }

    /// Whether a pass within these limits can write all of them.
    fn fits(self, limits: &wgpu::Limits) -> bool {
        let bytes = self.rows().fold(0_u32, |bytes, row| {
            let alignment = row.format.target_component_alignment().unwrap_or(1);
            bytes.next_multiple_of(alignment) + row.format.target_pixel_byte_cost().unwrap_or(0)
        });
        self.rows().count() <= limits.max_color_attachments as usize
            && bytes <= limits.max_color_attachment_bytes_per_sample
    }
}

/// The passes that write what a frame with these annotations needs on a device with these limits: one for all planes where the
/// limits allow, else one for as many as they allow at a time. Radiance and class are written by the same draw everywhere: they
/// are first, and every device can write four planes.
#[must_use]
pub(crate) fn lighting_passes(annotations: Annotations, limits: &wgpu::Limits) -> Vec<PlaneSet> {
    if PlaneSet::ALL.fits(limits) {
        return vec![PlaneSet::ALL];
    }
    divide(annotations, |set| set.fits(limits))
}

/// The planes that a frame with these annotations needs, in as few sets that `fits` accepts as their order allows.
fn divide(annotations: Annotations, fits: impl Fn(PlaneSet) -> bool) -> Vec<PlaneSet> {
    let mut passes: Vec<PlaneSet> = Vec::new();
    for row in SAMPLE_PLANES.iter().filter(|row| row.plane.is_needed(annotations)) {
        let with_row = |mut set: PlaneSet| {
            set.0[row.plane as usize] = true;
            set
        };
        let none = PlaneSet([false; SAMPLE_PLANES.len()]);
        match passes.last_mut() {
            Some(last) if fits(with_row(*last)) => *last = with_row(*last),
            _ => passes.push(with_row(none)),
        }
    }
    passes
}

/// What a mean adds up over samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sum {
    /// A plane of samples.
    Plane(SamplePlane),
    /// A scalar WGSL expression of the index `i` of a sample, the rendered `sample`, its `class_id` and `instance_id`.
    Expression(&'static str),
}

/// How the samples of a pixel become its value in a plane, packed into 32-bit words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ResolveRule {
    /// Every frame has it. `cs_main` in `resolve.wgsl` packs it for quads of four pixels, from these planes of samples.
    Quads(&'static [SamplePlane]),
    /// A function of the pixel's `first` sample and mean `radiance`.
    Pixel {
        /// WGSL of each packed word.
        words: &'static [&'static str],
    },
    /// A function of `instance_id`: the instance of most samples among those of the pixel's class.
    Instance {
        /// WGSL of each packed word.
        words: &'static [&'static str],
    },
    /// A function of `$sum` over the samples of the pixel's class and instance on one surface, and of `samples`, their number.
    InstanceMean {
        /// What is added up.
        sum: Sum,
        /// WGSL of each packed word.
        words: &'static [&'static str],
    },
    /// Computed on the host from other planes (`render/post/`).
    Host,
}

impl ResolveRule {
    /// Expressions of the words that a pixel has beside the quads.
    #[must_use]
    pub(crate) const fn words(self) -> &'static [&'static str] {
        match self {
            Self::Pixel { words } | Self::Instance { words } | Self::InstanceMean { words, .. } => words,
            Self::Quads(_) | Self::Host => &[],
        }
    }
}

/// The rule of each plane of a frame. `unpack_plane` in `render/resolve/unpack.rs` reverses its packing.
#[must_use]
pub(crate) const fn resolve_rule(plane: Plane) -> ResolveRule {
    use ResolveRule::{Host, Instance, InstanceMean, Pixel, Quads};
    match plane {
        Plane::Rgb => Quads(&[SamplePlane::Radiance]),
        Plane::Class => Quads(&[SamplePlane::Class]),
        // The mean of the inverse depth, which is linear in the image: the depth of a plane at the pixel's centre.
        Plane::Depth => InstanceMean {
            sum: Sum::Expression("inverse_depth_of(i, sample, inverse_depth, class_id, instance_id)"),
            words: &["bitcast<u32>(mean_depth(samples, $sum))"],
        },
        Plane::Normals => InstanceMean {
            sum: Sum::Plane(SamplePlane::Normal),
            words: &[
                "bitcast<u32>(unit_or_zero($sum).x)",
                "bitcast<u32>(unit_or_zero($sum).y)",
                "bitcast<u32>(unit_or_zero($sum).z)",
            ],
        },
        Plane::Instances => Instance { words: &["instance_id"] },
        Plane::SunOcclusion => InstanceMean {
            sum: Sum::Plane(SamplePlane::SunOcclusion),
            words: &["u32(255.0 * $sum / samples + 0.5)"],
        },
        Plane::Radiance => Pixel { words: &["packed_halves(radiance.rg)", "half_bits(radiance.b)"] },
        Plane::SampleCounts => Pixel { words: &["class_counts()"] },
        Plane::Slope | Plane::Craters | Plane::Incidence | Plane::Phase | Plane::FiveClasses => Host,
    }
}

/// Elements of `plane_offsets` in `FrameUniforms`.
pub(crate) const MAX_PACKED_PLANES: usize = 8;

/// Binding of the first plane of samples in the bind group of the resolve pass: behind those that `resolve.wgsl` declares.
const FIRST_BINDING: u32 = 4;

/// Planes that have words of their own in the packed frame, in the order in which they are packed.
pub(crate) fn packed_planes() -> impl Iterator<Item = (Plane, &'static [&'static str])> {
    let words = PLANES.iter().map(|row| (row.plane, resolve_rule(row.plane).words()));
    words.filter(|(_, words)| !words.is_empty())
}

fn push(text: &mut String, line: std::fmt::Arguments<'_>) {
    text.write_fmt(line).expect("a string takes everything");
}

/// `generated/lighting_output.wgsl` for a pass that writes these planes.
#[must_use]
pub(in crate::render) fn lighting_output_wgsl(planes: PlaneSet) -> String {
    let mut text =
        "// Generated from the table in src/render/device/planes.rs.\n\nstruct LightingOutput {\n".to_owned();
    for (location, row) in planes.rows().enumerate() {
        push(&mut text, format_args!("    // {}\n", row.comment));
        push(&mut text, format_args!("    @location({location}) {}: {},\n", row.name, row.wgsl));
    }
    let list = |entries: Vec<String>| entries.join(", ");
    let parameters = SAMPLE_PLANES.iter().map(|row| format!("{}: {}", row.name, row.wgsl)).collect();
    let written = planes.rows().map(|row| row.name.to_owned()).collect();
    push(
        &mut text,
        format_args!(
            "}}\n\nfn lighting_output({}) -> LightingOutput {{\n    return LightingOutput({});\n}}\n",
            list(parameters),
            list(written)
        ),
    );
    text
}

/// `generated/resolve_planes.wgsl`.
#[must_use]
pub(in crate::render) fn resolve_planes_wgsl() -> String {
    let mut text = "// Generated from the tables in src/render/device/planes.rs.\n\n".to_owned();
    for (binding, row) in (FIRST_BINDING..).zip(&SAMPLE_PLANES) {
        let kind = if row.is_uint() { "u32" } else { "f32" };
        let name = row.name;
        push(
            &mut text,
            format_args!("@group(2) @binding({binding}) var {name}_samples: texture_2d<{kind}>;\n"),
        );
    }
    text.push_str("\n// Whether each plane is requested.\n");
    for (plane, _) in packed_planes() {
        push(&mut text, format_args!("override {}: bool;\n", request_override(plane)));
    }
    text.push_str(
        "\nfn resolve_annotations(pixel: u32, first: vec2<u32>, class_id: u32, radiance: vec3<f32>) {\n",
    );
    let mut pixel = String::new();
    let (mut sums, mut additions, mut instance, mut means) =
        (String::new(), String::new(), String::new(), String::new());
    // Overrides of the planes that depend on the instance, and of those that are means over its samples.
    let (mut of_instance, mut of_means) = (Vec::new(), Vec::new());
    for (index, (plane, words)) in packed_planes().enumerate() {
        let (name, component) = (plane.row().name, ["x", "y", "z", "w"][index % 4]);
        push(
            &mut text,
            format_args!("    let {name}_at = frame.plane_offsets[{}].{component};\n", index / 4),
        );
        match resolve_rule(plane) {
            ResolveRule::Pixel { .. } => push_words(&mut pixel, plane, words),
            ResolveRule::Instance { .. } => {
                of_instance.push(request_override(plane));
                push_words(&mut instance, plane, words);
            }
            ResolveRule::InstanceMean { sum, .. } => {
                of_instance.push(request_override(plane));
                of_means.push(request_override(plane));
                push_sum(&mut sums, &mut additions, plane, sum);
                let words: Vec<String> =
                    words.iter().map(|word| word.replace("$sum", &format!("{name}_sum"))).collect();
                push_words(&mut means, plane, &words);
            }
            ResolveRule::Quads(_) | ResolveRule::Host => {}
        }
    }
    text.push_str(&pixel);
    push(&mut text, format_args!("    if !({}) {{ return; }}\n", of_instance.join(" || ")));
    text.push_str("    // Without instances the texture holds a single 0, which every gather returns.\n");
    text.push_str("    find_instances(first);\n    let instance_id = majority_instance(first, class_id);\n");
    text.push_str(&instance);
    push(&mut text, format_args!("    if !({}) {{ return; }}\n", of_means.join(" || ")));
    for part in ["    var samples = 0.0;\n", &sums, MEMBERS, &additions, "    }\n", &means, "}\n"] {
        text.push_str(part);
    }
    text
}

/// The loop over the samples that a mean is over, up to what it adds.
const MEMBERS: &str = "    let members = members_of(first, class_id, instance_id);
    for (var i = 0u; i < SAMPLES_PER_SIDE * SAMPLES_PER_SIDE; i++) {
        let sample = rendered_sample(first, i);
        let inverse_depth = inverse_depth_at(sample);
        if !is_member(i, sample, inverse_depth, members) { continue; }
        samples += 1.0;
";

/// The constant of `generated/resolve_planes.wgsl` that says whether a packed plane is requested.
#[must_use]
pub(in crate::render) fn request_override(plane: Plane) -> String {
    format!("HAS_{}", plane.row().name.to_uppercase())
}

/// Stores the words of a plane, if it is requested.
fn push_words<T: AsRef<str>>(text: &mut String, plane: Plane, words: &[T]) {
    let name = plane.row().name;
    push(text, format_args!("    if {} {{\n", request_override(plane)));
    let stride = if words.len() == 1 { String::new() } else { format!("{}u * ", words.len()) };
    for (k, word) in words.iter().enumerate() {
        let further = if k == 0 { String::new() } else { format!(" + {k}u") };
        let word = word.as_ref();
        push(text, format_args!("        packed_words[{name}_at + {stride}pixel{further}] = {word};\n"));
    }
    text.push_str("    }\n");
}

/// Declares the sum of a plane and adds a sample to it, if the plane is requested.
fn push_sum(declarations: &mut String, additions: &mut String, plane: Plane, sum: Sum) {
    let name = plane.row().name;
    let (zero, value) = match sum {
        Sum::Expression(expression) => ("0.0", expression.to_owned()),
        Sum::Plane(plane) => {
            let row = plane.row();
            let (zero, components) = if row.wgsl == "f32" { ("0.0", "r") } else { ("vec3(0.0)", "rgb") };
            let samples = format!("{}_samples", row.name);
            let texel =
                format!("textureSampleLevel({samples}, nearest, centre_uv(sample), 0.0).{components}");
            (zero, texel)
        }
    };
    push(declarations, format_args!("    var {name}_sum = {zero};\n"));
    push(additions, format_args!("        if {} {{ {name}_sum += {value}; }}\n", request_override(plane)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Annotation;
    use crate::frame::plane::every_annotation;
    use crate::render::device::shader_programs::{
        LIGHTING_ONE_DRAW, LIGHTING_SKY, LIGHTING_SURFACE, RESOLVE, parse,
    };

    #[test]
    fn passes_write_every_needed_plane_once_and_colour_with_class() {
        let every = every_annotation();
        let defaults = wgpu::Limits::downlevel_defaults();
        let sixteen_bytes = wgpu::Limits { max_color_attachment_bytes_per_sample: 16, ..defaults.clone() };
        for annotations in [Annotations::default(), every] {
            assert_eq!(lighting_passes(annotations, &wgpu::Limits::defaults()), [PlaneSet::ALL]);
            for (limits, passes_of_every) in [(&defaults, 2), (&sixteen_bytes, 2)] {
                let passes = lighting_passes(annotations, limits);
                assert_eq!(passes.len(), if annotations == every { passes_of_every } else { 1 });
                assert!(passes.iter().all(|pass| pass.fits(limits)), "{passes:?}");
                assert!(
                    passes[0].0[SamplePlane::Radiance as usize] && passes[0].0[SamplePlane::Class as usize]
                );
                for row in &SAMPLE_PLANES {
                    let writers = passes.iter().filter(|pass| pass.0[row.plane as usize]).count();
                    assert_eq!(writers, usize::from(row.plane.is_needed(annotations)), "{}", row.name);
                }
            }
        }
    }

    #[test]
    fn rows_stand_in_the_order_of_the_enum_and_types_fit_formats() {
        for (index, row) in SAMPLE_PLANES.iter().enumerate() {
            assert_eq!(row.plane as usize, index, "{}", row.name);
            let is_uint = row.format.sample_type(None, None) == Some(wgpu::TextureSampleType::Uint);
            assert_eq!(row.is_uint(), is_uint, "{}", row.name);
            assert_eq!(row.wgsl == "vec4<f32>", row.format.components() == 4, "{}", row.name);
        }
        assert!(packed_planes().count() <= MAX_PACKED_PLANES);
    }

    #[test]
    fn an_annotation_needs_the_samples_that_it_is_resolved_from() {
        let needed = |annotations: &[Annotation]| {
            let annotations = annotations.iter().copied().collect();
            SAMPLE_PLANES.map(|row| row.plane.is_needed(annotations))
        };
        assert_eq!(needed(&[]), [true, true, false, false, false]);
        assert_eq!(needed(&[Annotation::Hdr, Annotation::Coverage]), [true, true, false, false, false]);
        assert_eq!(needed(&[Annotation::Depth]), [true, true, false, true, false]);
        assert_eq!(needed(&[Annotation::Instances]), [true, true, false, true, false]);
        assert_eq!(needed(&[Annotation::Normals]), [true, true, true, true, false]);
        assert_eq!(needed(&[Annotation::Shadow]), [true, true, false, true, true]);
    }

    /// Every fragment entry point of lighting writes every plane, and the resolve pass reads every one.
    #[test]
    fn no_plane_of_samples_is_left_out_by_a_program() {
        for program in [&LIGHTING_SURFACE, &LIGHTING_SKY, &LIGHTING_ONE_DRAW] {
            let module = parse(program);
            let entries = module.entry_points.iter().filter(|e| e.stage == naga::ShaderStage::Fragment);
            for entry in entries {
                let result = entry.function.result.as_ref().expect("a result").ty;
                assert_eq!(module.types[result].name.as_deref(), Some("LightingOutput"), "{}", program.name);
                let naga::TypeInner::Struct { members, .. } = &module.types[result].inner else {
                    panic!("a struct")
                };
                let written: Vec<_> = members
                    .iter()
                    .map(|member| match member.binding {
                        Some(naga::Binding::Location { location, .. }) => (location, member.name.as_deref()),
                        _ => panic!("a location"),
                    })
                    .collect();
                let rows: Vec<_> =
                    (0..).zip(&SAMPLE_PLANES).map(|(location, row)| (location, Some(row.name))).collect();
                assert_eq!(written, rows, "{}", program.name);
            }
        }
        let module = parse(&RESOLVE);
        for row in &SAMPLE_PLANES {
            let name = format!("{}_samples", row.name);
            let texture =
                module.global_variables.iter().find(|(_, variable)| variable.name.as_deref() == Some(&name));
            let (texture, _) = texture.unwrap_or_else(|| panic!("{name} is not declared"));
            let is_read = module.functions.iter().any(|(_, function)| {
                let mut expressions = function.expressions.iter();
                expressions.any(|(_, e)| matches!(e, naga::Expression::GlobalVariable(g) if *g == texture))
            });
            assert!(is_read, "{name} is not read");
        }
    }
}
