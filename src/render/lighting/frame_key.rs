//! What the pipelines of lighting are compiled for.
//! Must not know: a pass.

use wgpu::TextureFormat;

use crate::frame::Annotations;
use crate::render::device::shading_bins::{Detail, LightingVariant, ShadowSources};
use crate::render::lighting::gbuffer::GBuffer;
use crate::scene::Scene;
use crate::scene::photometry::Law;
use crate::scene::terrain::Layout;

/// What all pipelines of a frame have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameKey {
    /// Annotations that are rendered.
    pub(super) annotations: Annotations,
    /// Law of reflection.
    pub(super) law: Law,
    /// The ground's mesh is made of rings.
    pub(super) has_rings: bool,
    /// Ground and rocks have detail below their meshes.
    pub(super) has_detail: bool,
    /// The G-buffer has the slopes of that detail.
    pub(super) has_slopes: bool,
    /// Format of the stencil that selects samples. Without one, each sample says what it is.
    pub(super) stencil_format: Option<TextureFormat>,
    /// A compute pass lights the samples.
    pub(super) is_computed: bool,
}

impl FrameKey {
    /// For a scene in this G-buffer.
    pub(crate) fn new(scene: &Scene, gbuffer: &GBuffer) -> Self {
        Self {
            annotations: gbuffer.annotations,
            law: scene.photometry.law,
            has_rings: matches!(scene.terrain.layout, Layout::Rings(_)),
            has_detail: scene.relief.is_some(),
            has_slopes: gbuffer.layout.has_slopes,
            stencil_format: gbuffer.layout.stencil_format(),
            is_computed: gbuffer.layout.is_computed,
        }
    }
}

/// The constants that a pipeline is specialised for.
pub(super) fn constants(key: FrameKey, variant: LightingVariant) -> Vec<(&'static str, f64)> {
    let shading = |sources: ShadowSources| {
        vec![
            ("SHADOW_SOURCES", f64::from(sources as u32)),
            ("RINGS", f64::from(u8::from(key.has_rings))),
            ("PHOTOMETRY_LAW", f64::from(key.law as u32)),
        ]
    };
    let surface = |sources, detail: Detail, per_sample_instance: bool| {
        let detail = if key.has_detail { detail } else { Detail::None };
        let own = [
            ("DETAIL_MODE", f64::from(detail as u32)),
            ("PER_SAMPLE_INSTANCE", f64::from(u8::from(per_sample_instance))),
        ];
        [shading(sources), own.to_vec()].concat()
    };
    match variant {
        LightingVariant::Ground { sources } => {
            let detail = if key.has_slopes { Detail::UploadedSlopes } else { Detail::Relief };
            surface(sources, detail, false)
        }
        LightingVariant::Rocks { sources } => surface(sources, Detail::RockTexture, true),
        LightingVariant::Sky => Vec::new(),
        LightingVariant::Any => shading(ShadowSources::GroundAndRocks),
    }
}
