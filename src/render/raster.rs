//! A triangle rasteriser for the CPU, by the rules of the Vulkan specification, chapter "Rasterization".
//!
//! Positions have 8 sub-pixel bits, a pixel is covered where its centre is inside, and the top-left rule gives the centres on a
//! shared edge to one of the two triangles. A triangle passes through these stages, one file each:
//!
//! 1. [`clip`]: cut a polygon at the near plane and the guard band.
//! 2. [`fixed_point`]: round positions to sub-pixel steps.
//! 3. [`cull`]: drop batches of triangles that are back-facing or cover no pixel.
//! 4. [`setup`] (one triangle) or [`setup8`] (eight at once): edge functions and interpolants.
//! 5. [`fill`]: step over blocks of pixels and hand those that are covered to a [`fill::FragmentSink`].
//!
//! A software adapter takes several times as long for a triangle of a few pixels, and sets up one after the other.
//!
//! Must not know: scene, camera, GPU.

pub(super) mod bounds;
pub(super) mod clip;
#[cfg(test)]
pub(in crate::render) mod coverage;
pub(super) mod cull;
mod edge;
pub(super) mod fill;
pub(super) mod fixed_point;
pub(super) mod lanes;
pub(super) mod setup;
pub(super) mod setup8;
