//! Which backend rasterises: the device in render passes or in a compute pass, or the host with its CPU rasteriser. And in how many draws
//! the samples are shaded.
//!
//! The host backend exists because a software adapter runs every stage of a pipeline on the CPU anyway, and slower than the CPU
//! rasteriser does. The compute backend exists because render passes leave the rounding of positions, and with it outlines, to the
//! device: labels agree to within that rounding, those of the compute backend to the bit. So GPUs take it.
//! Must not know: a scene, a pass.

use std::fmt;
use std::str::FromStr;

use wgpu::AdapterInfo;

use crate::error::{Error, Result};
use crate::gpu::{Capabilities, Gpu, adapter};

/// The backend that is asked for (`--raster`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterMode {
    /// The host on a software adapter, compute passes on a GPU with Vulkan, render passes on any other.
    #[default]
    Auto,
    /// The device, in render passes.
    Device,
    /// The device, in compute passes.
    Compute,
    /// The host.
    Host,
}

impl RasterMode {
    const NAMES: [(&'static str, Self); 4] =
        [("auto", Self::Auto), ("device", Self::Device), ("compute", Self::Compute), ("host", Self::Host)];

    /// The names of all modes.
    #[must_use]
    pub fn names() -> [&'static str; 4] {
        Self::NAMES.map(|(name, _)| name)
    }
}

impl FromStr for RasterMode {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let found = Self::NAMES.iter().find(|(name, _)| *name == text);
        found.map(|(_, mode)| *mode).ok_or_else(|| "allowed are auto, device, compute and host".to_owned())
    }
}

impl fmt::Display for RasterMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::NAMES.iter().find(|(_, mode)| mode == self).map_or("", |(name, _)| *name);
        f.write_str(name)
    }
}

/// The backend of one stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RasterBackend {
    /// Render passes on the device.
    Device,
    /// A compute pass on the device.
    Compute,
    /// The CPU rasteriser; the device gets its result by upload.
    Host,
}

/// How lighting divides the samples into draws, or into none. Labels do not depend on it, and colours only by rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightingMode {
    /// One draw for each shading bin, with a pipeline that does no more than the bin needs: for software adapters, which take the
    /// time of branches that are not taken. The stencil selects the samples.
    Bins,
    /// One draw for all samples, each by what its instance says. Needs no stencil, but visibility that the device rasterises.
    OneDraw,
    /// The same in a compute pass, for devices that compute on more of the chip than they draw on, as NVIDIA's Hopper does.
    Compute,
}

impl LightingMode {
    const NAMES: [(&'static str, Self); 3] =
        [("bins", Self::Bins), ("one-draw", Self::OneDraw), ("compute", Self::Compute)];

    /// Draws of samples in this many shading bins.
    pub(crate) const fn draws(self, bins: usize) -> usize {
        match self {
            Self::Bins => bins,
            Self::OneDraw => 1,
            Self::Compute => 0,
        }
    }

    /// Whether each sample is shaded by what its instance says, none by its shading bin.
    #[must_use]
    pub const fn is_by_instance(self) -> bool {
        matches!(self, Self::OneDraw | Self::Compute)
    }

    /// Name for records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::NAMES[self as usize].0
    }
}

impl FromStr for LightingMode {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let found = Self::NAMES.iter().find(|(name, _)| *name == text);
        found.map(|(_, mode)| *mode).ok_or_else(|| "allowed are bins, one-draw and compute".to_owned())
    }
}

/// How a renderer rasterises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RasterOptions {
    /// Backend of the visibility stage.
    pub visibility: RasterBackend,
    /// Backend of the shadow stage.
    pub shadow: RasterBackend,
    /// The host bins visible triangles by what can shade them, so that each bin is lit by a pipeline that does no more than it
    /// needs. Changes no bit of any plane.
    pub bin_by_shadow_sources: bool,
    /// The device takes all draws of a batch in one indirect command. Changes no bit of any plane.
    pub multi_draw: bool,
    /// How samples are divided into draws of lighting. [`RasterOptions::with_lighting`] sets it.
    pub lighting: LightingMode,
    /// Most columns and rows of a texture on the device. Shadow and horizon maps are coarser where they would be larger.
    pub max_texture_px: u32,
}

/// Storage buffers of a compute pass that rasterises.
const COMPUTE_STORAGE_BUFFERS: u32 = 7;

impl RasterOptions {
    /// Options of a mode on a device.
    ///
    /// # Errors
    /// [`Error::Usage`] for [`RasterMode::Host`] on a device that cannot copy to stencil textures.
    pub fn new(mode: RasterMode, gpu: &Gpu) -> Result<Self> {
        let (shadow, visibility) = match mode {
            RasterMode::Auto => Self::automatic(&gpu.info, gpu.capabilities, Self::can_compute(gpu)),
            RasterMode::Device => (RasterBackend::Device, RasterBackend::Device),
            RasterMode::Compute if !Self::can_compute(gpu) => {
                return Err(Error::Usage(format!(
                    "--raster compute: {} ({}) has no {COMPUTE_STORAGE_BUFFERS} storage buffers for a compute pass; \
                     use --raster auto or device",
                    gpu.info.name, gpu.info.backend,
                )));
            }
            RasterMode::Compute => (RasterBackend::Compute, RasterBackend::Compute),
            RasterMode::Host if !gpu.capabilities.stencil_upload => {
                return Err(Error::Usage(format!(
                    "--raster host: {} ({}) cannot copy to stencil textures; use --raster auto or device",
                    gpu.info.name, gpu.info.backend,
                )));
            }
            RasterMode::Host => (RasterBackend::Host, RasterBackend::Host),
        };
        let lighting = match visibility {
            RasterBackend::Host => LightingMode::Bins,
            RasterBackend::Device if Self::gains_from_bins(gpu) => LightingMode::Bins,
            RasterBackend::Device | RasterBackend::Compute
                if adapter::is_hopper(&gpu.info) && Self::can_store_planes(gpu) =>
            {
                LightingMode::Compute
            }
            RasterBackend::Device | RasterBackend::Compute => LightingMode::OneDraw,
        };
        let multi_draw = gpu.capabilities.multi_draw;
        let limits = gpu.device.limits();
        // Where a compute pass makes the shadow map, which has at most half as many rows as columns, a buffer of its size is bound.
        let max_in_buffer_px = match shadow {
            RasterBackend::Compute => (limits.max_storage_buffer_binding_size / 2).isqrt() as u32,
            RasterBackend::Device | RasterBackend::Host => u32::MAX,
        };
        let max_texture_px = limits.max_texture_dimension_2d.min(max_in_buffer_px);
        Ok(Self { visibility, shadow, bin_by_shadow_sources: true, multi_draw, lighting, max_texture_px })
    }

    /// The backends of the shadow stage and of the visibility stage where none is asked for.
    fn automatic(
        info: &AdapterInfo,
        capabilities: Capabilities,
        can_compute: bool,
    ) -> (RasterBackend, RasterBackend) {
        if capabilities.software_adapter {
            let is_uploaded = capabilities.stencil_upload;
            let visibility = if is_uploaded { RasterBackend::Host } else { RasterBackend::Device };
            return (RasterBackend::Host, visibility);
        }
        // Translated to other languages than Vulkan's, the shaders have been compiled, and never run.
        if can_compute && info.backend == wgpu::Backend::Vulkan {
            return (RasterBackend::Compute, RasterBackend::Compute);
        }
        (RasterBackend::Device, RasterBackend::Device)
    }

    /// Whether the device can rasterise in a compute pass.
    fn can_compute(gpu: &Gpu) -> bool {
        gpu.device.limits().max_storage_buffers_per_shader_stage >= COMPUTE_STORAGE_BUFFERS
    }

    /// Whether the device can light in a compute pass.
    fn can_store_planes(gpu: &Gpu) -> bool {
        gpu.device.limits().max_storage_textures_per_shader_stage >= 4
    }

    /// Whether the device can draw shading bins where it rasterises visibility itself, and is faster with them.
    const fn gains_from_bins(gpu: &Gpu) -> bool {
        gpu.capabilities.software_adapter && gpu.capabilities.depth_stencil
    }

    /// The same with this lighting.
    ///
    /// # Errors
    /// [`Error::Usage`] for what the device or the backend of the visibility stage does not support.
    pub fn with_lighting(self, lighting: LightingMode, gpu: &Gpu) -> Result<Self> {
        let refused = match (lighting, self.visibility) {
            (LightingMode::OneDraw | LightingMode::Compute, RasterBackend::Host) => {
                Some("the host rasterises; use --raster device")
            }
            (LightingMode::Compute, _) if !Self::can_store_planes(gpu) => {
                Some("the device cannot store to four textures at once; use one-draw")
            }
            (LightingMode::Bins, RasterBackend::Compute) => {
                Some("a compute pass that rasterises fills no bins; use one-draw or compute")
            }
            (LightingMode::Bins, RasterBackend::Device) if !gpu.capabilities.depth_stencil => {
                Some("the device has no depth of 32 bits with a stencil; use one-draw")
            }
            _ => None,
        };
        refused.map_or(Ok(Self { lighting, ..self }), |reason| {
            Err(Error::Usage(format!("--lighting {}: {reason}", lighting.name())))
        })
    }

    /// Whether the host rasterises anything.
    #[must_use]
    pub const fn uses_host(&self) -> bool {
        matches!(self.visibility, RasterBackend::Host) || matches!(self.shadow, RasterBackend::Host)
    }

    /// Whether a device has no influence on the labels.
    #[must_use]
    pub const fn has_exact_labels(&self) -> bool {
        matches!(self.visibility, RasterBackend::Compute)
    }

    /// Every name for records.
    pub const NAMES: [&'static str; 4] = ["device", "compute", "host", "mixed"];

    /// Name for records: `device`, `compute` or `host`; `mixed` where the device rasterises visibility and the host shadows, or the other
    /// way round.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match (self.visibility, self.shadow) {
            (RasterBackend::Device, RasterBackend::Device) => "device",
            (RasterBackend::Compute, RasterBackend::Compute) => "compute",
            (RasterBackend::Host, RasterBackend::Host) => "host",
            _ => "mixed",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wgpu::{Backend, DeviceType};

    #[test]
    fn gpus_with_vulkan_rasterise_in_compute_passes_unless_asked_otherwise() {
        let automatic = |backend, software_adapter, stencil_upload, can_compute| {
            let kind = if software_adapter { DeviceType::Cpu } else { DeviceType::DiscreteGpu };
            let info = AdapterInfo::new(kind, backend);
            let (multi_draw, depth_stencil) = (true, true);
            let capabilities = Capabilities { software_adapter, stencil_upload, multi_draw, depth_stencil };
            RasterOptions::automatic(&info, capabilities, can_compute)
        };
        use RasterBackend::{Compute, Device, Host};
        assert_eq!(automatic(Backend::Vulkan, false, true, true), (Compute, Compute));
        assert_eq!(
            automatic(Backend::Vulkan, false, true, false),
            (Device, Device),
            "too few storage buffers"
        );
        for backend in [Backend::Gl, Backend::Metal, Backend::Dx12] {
            assert_eq!(automatic(backend, false, true, true), (Device, Device), "{backend}");
        }
        assert_eq!(automatic(Backend::Vulkan, true, true, true), (Host, Host));
        assert_eq!(automatic(Backend::Gl, true, false, false), (Host, Device));
    }

    #[test]
    fn modes_are_read_as_they_are_written() {
        for (name, mode) in RasterMode::NAMES {
            assert_eq!(name.parse(), Ok(mode));
            assert_eq!(mode.to_string(), name);
        }
        assert!("cpu".parse::<RasterMode>().is_err());
        for (name, mode) in LightingMode::NAMES {
            assert_eq!((name.parse(), mode.name()), (Ok(mode), name));
        }
        assert!("draws".parse::<LightingMode>().is_err());
    }
}
