//! Every adapter with what it offers beside what is requested of it, as plain data.
//!
//! Must not know: why somebody asks.

use serde::{Deserialize, Serialize};
use wgpu::{AdapterInfo, Limits};

use super::{adapter, required_limits};
use crate::error::Result;

/// An adapter, whether or not it can be used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterReport {
    /// Its name.
    pub name: String,
    /// The kind of hardware, in words.
    pub kind: String,
    /// The API through which it is used: `vulkan` or `gl`.
    pub backend: String,
    /// Name and version of its driver.
    pub driver: String,
    /// PCI id of its maker; 0 if it does not say.
    pub vendor: u32,
    /// PCI id of its model; 0 if it does not say.
    pub device: u32,
    /// Its PCI address, such as `0000:01:00.0`; empty if it does not say.
    pub pci_address: String,
    /// Whether it rasterises on the CPU.
    pub is_software: bool,
    /// Required features that it lacks, in words; empty if it can be used.
    pub missing: Vec<String>,
    /// The limits that matter.
    pub limits: Vec<LimitReport>,
}

/// A limit of an adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LimitReport {
    /// Its name in WebGPU, in snake case.
    pub name: String,
    /// What rendering needs in some way; below it some frame or adapter is refused.
    pub needed: u64,
    /// What a device is opened with.
    pub requested: u64,
    /// What the adapter offers.
    pub offered: u64,
}

impl AdapterReport {
    /// One line for people: name, kind, backend, driver, as [`adapter::describe`] writes it.
    #[must_use]
    pub fn describe(&self) -> String {
        format!("{} ({}, {}, {})", self.name, self.kind, self.backend, self.driver)
    }

    /// The same with its PCI address, as [`adapter::identify`] writes it.
    #[must_use]
    pub fn identify(&self) -> String {
        adapter::with_pci_address(&self.describe(), &self.pci_address)
    }

    /// Whether a text of `--adapter` selects it.
    #[must_use]
    pub fn matches(&self, wanted: &str) -> bool {
        adapter::is_wanted(&self.identify(), self.is_software, wanted)
    }

    fn new(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        let missing = adapter::missing_of(adapter);
        Self {
            kind: adapter::kind(&info).to_owned(),
            backend: info.backend.to_string(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            vendor: info.vendor,
            device: info.device,
            pci_address: info.device_pci_bus_id.clone(),
            is_software: adapter::is_software(&info),
            missing,
            limits: limits(&info, &adapter.limits()),
            name: info.name,
        }
    }
}

/// Needed, requested and offered limits. WebGPU's downlevel defaults are enough, with fall-backs.
fn limits(info: &AdapterInfo, offered: &Limits) -> Vec<LimitReport> {
    let needed = Limits::downlevel_defaults();
    let requested = required_limits(info, offered);
    macro_rules! rows {
        ($($name:ident),*) => {
            vec![$(LimitReport {
                name: stringify!($name).to_owned(),
                needed: u64::from(needed.$name),
                requested: u64::from(requested.$name),
                offered: u64::from(offered.$name),
            }),*]
        };
    }
    rows!(
        max_texture_dimension_2d,
        max_texture_array_layers,
        max_buffer_size,
        max_storage_buffer_binding_size,
        max_uniform_buffer_binding_size,
        max_bind_groups,
        max_sampled_textures_per_shader_stage,
        max_storage_buffers_per_shader_stage,
        max_storage_textures_per_shader_stage,
        max_inter_stage_shader_variables,
        max_color_attachments,
        max_color_attachment_bytes_per_sample,
        max_compute_invocations_per_workgroup,
        max_compute_workgroup_storage_size,
        max_compute_workgroups_per_dimension
    )
}

/// Every adapter that a driver reports, best first; none if there is no driver.
///
/// # Errors
/// [`Error::MemoryLimit`](crate::Error::MemoryLimit); [`Error::Usage`](crate::Error::Usage) if `WGPU_BACKEND` names an unknown
/// backend.
pub fn survey() -> Result<Vec<AdapterReport>> {
    Ok(adapter::enumerate_allowed()?.iter().map(AdapterReport::new).collect())
}
