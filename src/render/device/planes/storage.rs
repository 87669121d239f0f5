//! The planes of samples as storage textures, which a compute pass writes: their formats, what one dispatch writes, and the WGSL that
//! stores them (`generated/storage_planes.wgsl`).
//! Must not know: a pass.

use wgpu::TextureFormat;

use super::{PlaneSet, SAMPLE_PLANES, SamplePlaneRow, divide, push};
use crate::frame::Annotations;

/// Format of a plane as a storage texture: every device can store to it.
pub(crate) const fn format(row: &SamplePlaneRow) -> TextureFormat {
    match row.format {
        TextureFormat::R8Uint | TextureFormat::R16Uint => TextureFormat::R32Uint,
        TextureFormat::R8Unorm => TextureFormat::R32Float,
        format => format,
    }
}

/// What each dispatch writes of the planes that a frame with these annotations needs, on a device with these limits. Radiance and class are
/// written by the same one everywhere: they are first, and every device can write four textures.
#[must_use]
pub(crate) fn dispatches(annotations: Annotations, limits: &wgpu::Limits) -> Vec<PlaneSet> {
    divide(annotations, |set| set.rows().count() <= limits.max_storage_textures_per_shader_stage as usize)
}

/// `generated/storage_planes.wgsl` for a dispatch that writes these planes.
#[must_use]
pub(in crate::render) fn storage_planes_wgsl(planes: PlaneSet) -> String {
    let mut text = "// Generated from the table in src/render/device/planes.rs.\n\n".to_owned();
    for (binding, row) in planes.rows().enumerate() {
        let format = match format(row) {
            TextureFormat::R32Uint => "r32uint",
            TextureFormat::R32Float => "r32float",
            _ => "rgba16float",
        };
        let name = row.name;
        push(
            &mut text,
            format_args!(
                "@group(3) @binding({binding}) var {name}_texels: texture_storage_2d<{format}, write>;\n"
            ),
        );
    }
    text.push_str("\nfn store_planes(at: vec2<u32>, lit: LightingOutput) {\n");
    for row in planes.rows() {
        let name = row.name;
        let texel = match row.format {
            TextureFormat::R8Uint | TextureFormat::R16Uint => format!("vec4(lit.{name}, 0u, 0u, 0u)"),
            // As a target of 8 bits rounds it.
            TextureFormat::R8Unorm => {
                format!("vec4(round(255.0 * lit.{name}) * (1.0 / 255.0), 0.0, 0.0, 0.0)")
            }
            _ => format!("lit.{name}"),
        };
        push(&mut text, format_args!("    textureStore({name}_texels, at, {texel});\n"));
    }
    text.push_str("}\n\n// Of a sample that no draw wrote.\nfn clear_values() -> LightingOutput {\n    return lighting_output(");
    let values = SAMPLE_PLANES.map(|row| {
        let clear = row.plane.clear_value();
        match row.wgsl {
            "u32" => format!("{}u", clear.r),
            "f32" => format!("{:?}", clear.r),
            _ => format!("vec4({:?}, {:?}, {:?}, {:?})", clear.r, clear.g, clear.b, clear.a),
        }
    });
    push(&mut text, format_args!("{});\n}}\n", values.join(", ")));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::plane::every_annotation;

    #[test]
    fn a_dispatch_writes_as_many_planes_as_a_device_can_store() {
        let dispatches = |annotations, max_storage_textures_per_shader_stage| {
            let limits = wgpu::Limits { max_storage_textures_per_shader_stage, ..wgpu::Limits::default() };
            let sets = dispatches(annotations, &limits);
            sets.into_iter().map(|set| set.rows().map(|row| row.name).collect::<Vec<_>>()).collect::<Vec<_>>()
        };
        assert_eq!(dispatches(Annotations::default(), 4), [["radiance", "class_id"]]);
        let every = dispatches(every_annotation(), 4);
        assert_eq!(every.iter().map(Vec::len).collect::<Vec<_>>(), [4, 1]);
        assert_eq!(dispatches(every_annotation(), 8).len(), 1);
    }
}
