//! The files through which drivers reach GPUs: whether a machine has a GPU, without loading a driver.
//!
//! Must not know: adapters.

use crate::gpu::machine::Machine;
use crate::gpu::vendor::{Vendor, pci_id};

/// A file through which drivers reach a GPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceFile {
    /// Who made the GPU.
    pub vendor: Vendor,
    /// Absolute path, such as `/dev/nvidia0`.
    pub path: String,
    /// Why it cannot be opened; `None` if it can.
    pub refusal: Option<String>,
}

/// The device files of GPUs; those of other display adapters (of virtual machines, of server management) are left out.
#[must_use]
pub fn device_files(machine: &Machine) -> Vec<DeviceFile> {
    let mut found = Vec::new();
    let mut add = |vendor, path: String| {
        let refusal = machine.refusal(&path);
        found.push(DeviceFile { vendor, path, refusal });
    };
    for name in machine.names("/dev") {
        let number = name.strip_prefix("nvidia").unwrap_or_default();
        if !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()) {
            add(Vendor::Nvidia, format!("/dev/{name}"));
        }
    }
    for name in machine.names("/dev/dri").into_iter().filter(|name| name.starts_with("renderD")) {
        let id = machine.text(&format!("/sys/class/drm/{name}/device/vendor"));
        if let Some(vendor) = pci_id(&id).and_then(Vendor::of_pci) {
            add(vendor, format!("/dev/dri/{name}"));
        }
    }
    if machine.exists("/dev/dxg") {
        add(Vendor::Wsl, "/dev/dxg".to_owned());
    }
    found
}
