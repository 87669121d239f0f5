//! Depth and stencil: formats and the depth test that the drawing passes share.
//! Must not know: a pass.
//!
//! Depth is reversed everywhere: cleared to 0, the far end, and the greater value wins.

use wgpu::TextureFormat;

/// Format of the two depth layers that the device makes the shadow map of.
pub(crate) const SHADOW_LAYERS_FORMAT: TextureFormat = TextureFormat::Depth32Float;
/// Format of depth and stencil of the samples where the device rasterises them. The stencil holds shading bins.
pub(crate) const DEPTH_STENCIL_FORMAT: TextureFormat = TextureFormat::Depth32FloatStencil8;
/// Format of depth of the samples where the device rasterises them and lighting needs no stencil.
pub(crate) const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;
/// Format of the stencil of the samples where it is uploaded: no depth test is made there.
pub(crate) const STENCIL_FORMAT: TextureFormat = TextureFormat::Stencil8;

/// Depth state of passes that rasterise surfaces: the nearer wins, of two at the same depth the first. The stencil, where the
/// format has one, takes the pass's reference.
#[must_use]
pub(crate) fn depth_state(format: TextureFormat) -> wgpu::DepthStencilState {
    let replace = wgpu::StencilFaceState { pass_op: wgpu::StencilOperation::Replace, ..Default::default() };
    wgpu::DepthStencilState {
        format,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Greater),
        stencil: if format.has_stencil_aspect() {
            wgpu::StencilState { front: replace, back: replace, read_mask: !0, write_mask: !0 }
        } else {
            wgpu::StencilState::default()
        },
        bias: wgpu::DepthBiasState::default(),
    }
}
