//! The GPUs of the machine as the operating system shows them, and what a driver for them needs: device files, the Vulkan
//! loader, driver manifests and libraries, the container.
//!
//! Nothing here loads a driver, so nothing here can crash in one.
//! Must not know: adapters.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::drivers::{self, Manifest};
use crate::gpu::device_files::{DeviceFile, device_files};
pub use crate::gpu::machine::Machine;
use crate::gpu::vendor::{Vendor, pci_id};

/// Environment variables that concern drivers, GPUs and the batch system. A report has no others: some hold secrets.
const VARIABLES: [&str; 11] = [
    "CUDA_VISIBLE_DEVICES",
    "HIP_VISIBLE_DEVICES",
    "KUBERNETES_SERVICE_HOST",
    "LD_LIBRARY_PATH",
    "NVIDIA_DRIVER_CAPABILITIES",
    "NVIDIA_VISIBLE_DEVICES",
    "ROCR_VISIBLE_DEVICES",
    "SLURM_GPUS",
    "SLURM_GPUS_ON_NODE",
    "SLURM_JOB_GPUS",
    "SLURM_JOB_ID",
];
/// Start of the names of such variables besides.
const VARIABLE_PREFIXES: [&str; 7] = ["EGL_", "GALLIUM_", "LIBGL_", "MESA_", "VK_", "WGPU_", "__EGL_"];
/// PCI class of display controllers, the upper 8 of 24 bits.
const DISPLAY_CLASS: &str = "0x03";

/// Where a GPU is on the PCI bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PciGpu {
    /// Who made it.
    pub vendor: Vendor,
    /// Bus address, such as `0000:01:00.0`.
    pub address: String,
    /// PCI id of the model, such as `0x2684`.
    pub model: String,
    /// Name of its kernel driver; `None` if no driver has taken it.
    pub kernel_driver: Option<String>,
}

/// What surrounds the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// Docker, or another engine that is used like it.
    Docker,
    /// Podman.
    Podman,
    /// Kubernetes.
    Kubernetes,
    /// Apptainer or Singularity.
    Apptainer,
    /// Another kind.
    Other,
}

impl Container {
    /// Its name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Docker => "Docker",
            Self::Podman => "Podman",
            Self::Kubernetes => "Kubernetes",
            Self::Apptainer => "Apptainer",
            Self::Other => "of another kind",
        }
    }
}

fn pci_gpus(machine: &Machine) -> Vec<PciGpu> {
    let gpu = |address: String| {
        let folder = format!("/sys/bus/pci/devices/{address}");
        let vendor = pci_id(&machine.text(&format!("{folder}/vendor"))).and_then(Vendor::of_pci)?;
        machine.text(&format!("{folder}/class")).starts_with(DISPLAY_CLASS).then(|| PciGpu {
            vendor,
            model: machine.text(&format!("{folder}/device")),
            kernel_driver: machine.link(&format!("{folder}/driver")),
            address,
        })
    };
    machine.names("/sys/bus/pci/devices").into_iter().filter_map(gpu).collect()
}

fn container(machine: &Machine) -> Option<Container> {
    let control_groups = machine.text("/proc/1/cgroup");
    if machine.variable("APPTAINER_CONTAINER").or(machine.variable("SINGULARITY_CONTAINER")).is_some() {
        Some(Container::Apptainer)
    } else if machine.variable("KUBERNETES_SERVICE_HOST").is_some() || control_groups.contains("kubepods") {
        Some(Container::Kubernetes)
    } else if machine.exists("/run/.containerenv") || machine.variable("container") == Some("podman") {
        Some(Container::Podman)
    } else if machine.exists("/.dockerenv") || control_groups.contains("docker") {
        Some(Container::Docker)
    } else {
        let is_other = machine.variable("container").is_some()
            || ["containerd", "lxc", "libpod"].iter().any(|word| control_groups.contains(word));
        is_other.then_some(Container::Other)
    }
}

/// What a machine has, as far as GPUs are concerned.
#[derive(Clone, Debug)]
pub struct Hardware {
    /// GPUs on the PCI bus. A container sees those of its host, whether or not it may use them.
    pub pci: Vec<PciGpu>,
    /// Device files of GPUs.
    pub device_files: Vec<DeviceFile>,
    /// The first line of NVIDIA's kernel driver about itself.
    pub nvidia_kernel_driver: Option<String>,
    /// AMD's device file for compute, which rendering does not need.
    pub has_kfd: bool,
    /// The kind of the container that the process runs in.
    pub container: Option<Container>,
    /// Path of the Vulkan loader.
    pub loader: Option<String>,
    /// Every manifest that the loader reads.
    pub manifests: Vec<Manifest>,
    /// Manifests in other folders.
    pub unread_manifests: Vec<Manifest>,
    /// The variable that replaces the manifests of the system, and the files that it names.
    pub named_manifests: Option<(&'static str, Vec<String>)>,
    /// Variables that concern drivers, GPUs and the batch system.
    pub variables: BTreeMap<String, String>,
    /// System, kernel and processor, by name.
    pub system: BTreeMap<&'static str, String>,
}

impl Hardware {
    /// Looks at a machine. What cannot be read counts as absent.
    #[must_use]
    pub fn probe(machine: &Machine) -> Self {
        let has_prefix = |name: &str| VARIABLE_PREFIXES.iter().any(|prefix| name.starts_with(prefix));
        let is_relevant = |name: &str| VARIABLES.contains(&name) || has_prefix(name);
        let kernel_driver = machine.text("/proc/driver/nvidia/version");
        Self {
            pci: pci_gpus(machine),
            device_files: device_files(machine),
            nvidia_kernel_driver: kernel_driver.lines().next().map(str::to_owned),
            has_kfd: machine.exists("/dev/kfd"),
            container: container(machine),
            loader: drivers::loader(machine),
            manifests: drivers::manifests(machine),
            unread_manifests: drivers::unread_manifests(machine),
            named_manifests: drivers::named_manifests(machine),
            variables: machine
                .variables()
                .iter()
                .filter(|(name, _)| is_relevant(name))
                .map(|(name, value)| (name.clone(), value.clone()))
                .collect(),
            system: system(machine),
        }
    }

    /// The value of a variable, unless it is empty.
    #[must_use]
    pub fn variable(&self, name: &str) -> Option<&str> {
        self.variables.get(name).map(String::as_str).filter(|value| !value.is_empty())
    }

    /// The record for a report.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let pci = self.pci.iter().map(|gpu| {
            json!({ "vendor": gpu.vendor.name(), "address": gpu.address, "model": gpu.model, "kernel_driver": gpu.kernel_driver })
        });
        let files = self.device_files.iter().map(
            |file| json!({ "vendor": file.vendor.name(), "path": file.path, "cannot_be_opened": file.refusal }),
        );
        let manifests = self.manifests.iter().map(
            |manifest| json!({ "path": manifest.path, "library": manifest.library, "has_library": manifest.has_library }),
        );
        json!({
            "system": self.system,
            "container": self.container.map(Container::name),
            "pci_gpus": pci.collect::<Vec<_>>(),
            "device_files": files.collect::<Vec<_>>(),
            "nvidia_kernel_driver": self.nvidia_kernel_driver,
            "kfd": self.has_kfd,
            "vulkan_loader": self.loader,
            "vulkan_manifests": manifests.collect::<Vec<_>>(),
            "environment": self.variables,
        })
    }
}

/// System, kernel, processor, cores and memory.
fn system(machine: &Machine) -> BTreeMap<&'static str, String> {
    let field = |path: &str, key: &str, separator: char| {
        let text = machine.text(path);
        let mut fields = text.lines().filter_map(|line| line.split_once(separator));
        let value =
            fields.find(|(name, _)| name.trim() == key).map(|(_, value)| value.trim().trim_matches('"'));
        value.unwrap_or_default().to_owned()
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    BTreeMap::from([
        ("architecture", std::env::consts::ARCH.to_owned()),
        ("cores", cores.to_string()),
        ("kernel", machine.text("/proc/sys/kernel/osrelease")),
        ("memory", field("/proc/meminfo", "MemTotal", ':')),
        ("operating_system", field("/etc/os-release", "PRETTY_NAME", '=')),
        ("processor", field("/proc/cpuinfo", "model name", ':')),
    ])
}
