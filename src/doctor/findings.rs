//! What the hardware of a machine and the adapters that answer say together: for each GPU whether a driver answers for it, and if
//! not, the first cause on the way from the device to the driver, with its remedy.
//!
//! Must not know: rendering.

use serde_json::{Value, json};

use super::drivers::Manifest;
use super::hardware::{Container, Hardware};
use crate::gpu::adapter::tried_and_advice;
use crate::gpu::device_files::DeviceFile;
use crate::gpu::survey::AdapterReport;
use crate::gpu::vendor::Vendor;

/// An observation about the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The observation itself.
    pub seen: String,
    /// Its meaning for rendering.
    pub means: String,
    /// What to do; empty if there is nothing to do.
    pub remedy: String,
}

impl Finding {
    fn new(seen: impl Into<String>, means: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { seen: seen.into(), means: means.into(), remedy: remedy.into() }
    }

    /// Whether there is something to do.
    #[must_use]
    pub const fn is_problem(&self) -> bool {
        !self.remedy.is_empty()
    }

    /// The record for a report.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({ "seen": self.seen, "means": self.means, "remedy": self.remedy })
    }
}

/// What the drivers of a machine answered.
#[derive(Clone, Copy, Debug, Default)]
pub struct Answers<'a> {
    /// Every adapter, best first.
    pub adapters: &'a [AdapterReport],
    /// Why the adapters could not be listed.
    pub failure: Option<&'a str>,
    /// How a process ended that had reported all of its results.
    pub crash_at_exit: Option<&'a str>,
}

/// How to get a GPU from a batch system.
const BATCH_REMEDY: &str = "ask the batch system for a GPU: `--gres=gpu:1` (Slurm)";

/// How to give a GPU to a container.
fn container_remedy(vendor: Vendor, container: Container) -> String {
    match (vendor, container) {
        (Vendor::Nvidia, Container::Apptainer) => "start it with `apptainer exec --nv ...`".to_owned(),
        (Vendor::Nvidia, Container::Kubernetes) => {
            "give the pod the resource limit `nvidia.com/gpu: 1` and the variable NVIDIA_DRIVER_CAPABILITIES=graphics,utility"
                .to_owned()
        }
        (Vendor::Nvidia, Container::Podman) => {
            "start it with `podman run --device nvidia.com/gpu=all ...` (NVIDIA Container Toolkit on the host, its CDI \
             specification generated)"
                .to_owned()
        }
        (Vendor::Nvidia, _) => {
            "start it with `docker run --gpus all -e NVIDIA_DRIVER_CAPABILITIES=graphics,utility ...` (NVIDIA Container \
             Toolkit on the host)"
                .to_owned()
        }
        (Vendor::Wsl, _) => "pass /dev/dxg and /usr/lib/wsl to it".to_owned(),
        (_, Container::Apptainer) => "start it with `apptainer exec --bind /dev/dri ...`".to_owned(),
        (_, Container::Kubernetes) => {
            format!("give the pod the device plugin of {} (it mounts /dev/dri)", vendor.name())
        }
        (_, Container::Podman) => "start it with `podman run --device /dev/dri ...`".to_owned(),
        _ => "start it with `docker run --device /dev/dri --group-add $(stat -c %g /dev/dri/renderD128) ...`".to_owned(),
    }
}

/// A GPU that no driver answers for.
struct Unanswered<'a> {
    hardware: &'a Hardware,
    vendor: Vendor,
    files: Vec<&'a DeviceFile>,
}

impl Unanswered<'_> {
    /// The first cause on the way from the device to the driver; `None` if all of its driver is there.
    fn cause(&self) -> Option<Finding> {
        None.or_else(|| self.no_device_file())
            .or_else(|| self.denied())
            .or_else(|| self.no_loader())
            .or_else(|| self.backend_excluded())
            .or_else(|| self.manifests_replaced())
            .or_else(|| self.unread_manifest())
            .or_else(|| self.no_manifest())
            .or_else(|| self.manifests_left_out())
            .or_else(|| self.no_library())
    }

    /// Whether the kernel's driver for an NVIDIA GPU is nouveau.
    fn is_on_nouveau(&self) -> bool {
        self.hardware.nvidia_kernel_driver.is_none()
            && !self.has_file_of_nvidia()
            && self.kernel_drivers().all(|driver| driver != "nvidia")
    }

    /// Names of the kernel's drivers for GPUs of this vendor.
    fn kernel_drivers(&self) -> impl Iterator<Item = &str> {
        let gpus = self.hardware.pci.iter().filter(|gpu| gpu.vendor == self.vendor);
        gpus.filter_map(|gpu| gpu.kernel_driver.as_deref())
    }

    /// Whether there is a device file of NVIDIA's own kernel driver.
    fn has_file_of_nvidia(&self) -> bool {
        self.files.iter().any(|file| file.path.starts_with("/dev/nvidia"))
    }

    /// The GPU, and where it is.
    fn device(&self) -> String {
        let paths: Vec<&str> = self.files.iter().map(|file| file.path.as_str()).collect();
        let gpus = self.hardware.pci.iter().filter(|gpu| gpu.vendor == self.vendor);
        let gpus: Vec<String> = gpus.map(|gpu| format!("{} at PCI {}", gpu.model, gpu.address)).collect();
        let location = if paths.is_empty() { gpus } else { paths.into_iter().map(str::to_owned).collect() };
        format!("{} GPU ({})", self.vendor.name(), location.join(", "))
    }

    fn no_device_file(&self) -> Option<Finding> {
        let hardware = self.hardware;
        // Beside /dev/dri NVIDIA's driver needs device files of its own.
        let is_half_passed = self.vendor == Vendor::Nvidia
            && hardware.container.is_some()
            && !self.has_file_of_nvidia()
            && self.kernel_drivers().all(|driver| driver != "nouveau");
        if !self.files.is_empty() && !is_half_passed {
            return None;
        }
        let means = if self.files.is_empty() {
            "this process has no device file for it".to_owned()
        } else {
            "this process has no device file of NVIDIA's driver for it (/dev/nvidia0)".to_owned()
        };
        let remedy = if let Some(container) = hardware.container {
            container_remedy(self.vendor, container)
        } else if hardware.variable("SLURM_JOB_ID").is_some() {
            BATCH_REMEDY.to_owned()
        } else if self.vendor == Vendor::Nvidia {
            "install NVIDIA's driver, load its kernel module (`sudo modprobe nvidia`) and let `nvidia-smi` create the device files"
                .to_owned()
        } else {
            "the kernel's driver has not taken it: boot without `nomodeset`, and install its firmware (Debian: \
             firmware-amd-graphics, firmware-intel-graphics or firmware-misc-nonfree; Ubuntu: linux-firmware)"
                .to_owned()
        };
        Some(Finding::new(self.device(), means, remedy))
    }

    fn denied(&self) -> Option<Finding> {
        if self.files.iter().any(|file| file.refusal.is_none()) {
            return None;
        }
        let refusal = self.files.first()?.refusal.as_deref().unwrap_or_default();
        // A device cgroup refuses with EPERM, the file's owner and group with EACCES.
        let is_withheld = refusal.ends_with("(os error 1)");
        let remedy = match self.hardware.container {
            Some(container) if is_withheld => container_remedy(self.vendor, container),
            _ if self.hardware.variable("SLURM_JOB_ID").is_some() => BATCH_REMEDY.to_owned(),
            Some(_) => {
                "let the container's user open it: `--group-add $(stat -c %g /dev/dri/renderD128)` (Docker), \
                        `--group-add keep-groups` (Podman)"
                    .to_owned()
            }
            None => "join the groups that may: `sudo usermod -aG render,video $USER`, then log in again"
                .to_owned(),
        };
        Some(Finding::new(
            self.device(),
            format!("the device file exists, but this user cannot open it: {refusal}"),
            remedy,
        ))
    }

    fn no_loader(&self) -> Option<Finding> {
        self.hardware.loader.is_none().then(|| {
            let means = "the Vulkan loader (libvulkan.so.1) is not installed, without which no Vulkan driver is found";
            Finding::new(self.device(), means, "`sudo apt-get install libvulkan1` (Debian, Ubuntu)")
        })
    }

    fn backend_excluded(&self) -> Option<Finding> {
        let allowed = self.hardware.variable("WGPU_BACKEND")?;
        let has_vulkan =
            allowed.to_lowercase().split(',').any(|word| ["vulkan", "vk"].contains(&word.trim()));
        (!has_vulkan).then(|| {
            let means =
                format!("WGPU_BACKEND={allowed} leaves Vulkan out, and its GL driver does not answer");
            Finding::new(self.device(), means, "unset WGPU_BACKEND")
        })
    }

    fn manifests(&self) -> Vec<&Manifest> {
        self.hardware.manifests.iter().filter(|manifest| self.is_for(manifest)).collect()
    }

    /// Whether the driver of a manifest is one for this GPU.
    fn is_for(&self, manifest: &Manifest) -> bool {
        manifest.is_of(self.vendor) && (self.is_on_nouveau() || !manifest.is_of_nouveau())
    }

    fn manifests_replaced(&self) -> Option<Finding> {
        let (name, named) = self.hardware.named_manifests.as_ref()?;
        self.manifests().is_empty().then(|| {
            let means = format!(
                "{name}={} replaces the driver manifests of the system, and names none of {}",
                named.join(":"),
                self.vendor.name()
            );
            Finding::new(self.device(), means, format!("unset {name}, or add the manifest of its driver"))
        })
    }

    fn unread_manifest(&self) -> Option<Finding> {
        let unread = self.hardware.unread_manifests.iter().find(|manifest| self.is_for(manifest))?;
        self.manifests().is_empty().then(|| {
            let means =
                format!("its driver's manifest is {}, where the Vulkan loader does not look", unread.path);
            let remedy = format!(
                "`export VK_DRIVER_FILES={0}` (loaders before 1.3.207, as Ubuntu 22.04 has: `VK_ICD_FILENAMES={0}`)",
                unread.path
            );
            Finding::new(self.device(), means, remedy)
        })
    }

    fn no_manifest(&self) -> Option<Finding> {
        if !self.manifests().is_empty() {
            return None;
        }
        let hardware = self.hardware;
        let mut means = "no Vulkan driver for it is installed here (no manifest in /etc/vulkan/icd.d or \
                         /usr/share/vulkan/icd.d)"
            .to_owned();
        let capabilities = hardware.variable("NVIDIA_DRIVER_CAPABILITIES");
        let has_graphics = capabilities
            .is_some_and(|list| list.split(',').any(|word| ["graphics", "all"].contains(&word.trim())));
        let remedy = match (self.vendor, hardware.container) {
            (Vendor::Nvidia, Some(Container::Apptainer)) => {
                "start it with `apptainer exec --nv ...`; if that is so already, add `--bind \
                 /usr/share/vulkan/icd.d/nvidia_icd.json` (or where the host has it)"
                    .to_owned()
            }
            // What a CDI specification passes does not depend on the variable.
            (Vendor::Nvidia, Some(Container::Podman)) => {
                "with `--device nvidia.com/gpu=all` Podman passes what the host's CDI specification lists: install NVIDIA's \
                 graphics libraries on the host (Ubuntu: libnvidia-gl-VERSION, Debian: nvidia-vulkan-icd), then `sudo nvidia-ctk \
                 cdi generate --output=/etc/cdi/nvidia.yaml` again"
                    .to_owned()
            }
            (Vendor::Nvidia, Some(container)) if !has_graphics => {
                means = format!(
                    "the container has the GPU without its graphics driver: NVIDIA_DRIVER_CAPABILITIES {}, and `graphics` is \
                     not among the default",
                    capabilities.map_or("is not set".to_owned(), |list| format!("is `{list}`"))
                );
                let flag = "add `-e NVIDIA_DRIVER_CAPABILITIES=graphics,utility` (or `all`) to `docker run`";
                match container {
                    Container::Kubernetes => container_remedy(Vendor::Nvidia, container),
                    _ => flag.to_owned(),
                }
            }
            (Vendor::Nvidia, Some(_)) => "add `--runtime=nvidia` to `docker run`; if it is there, the host has a driver for \
                                          computing only: install NVIDIA's graphics libraries on the host (Ubuntu: \
                                          libnvidia-gl-VERSION, Debian: nvidia-vulkan-icd), then start the container again"
                .to_owned(),
            (Vendor::Nvidia, None) if self.is_on_nouveau() => {
                "install NVIDIA's driver in place of the kernel's nouveau, or Mesa 24.1 or later: `sudo apt-get install \
                 mesa-vulkan-drivers`"
                    .to_owned()
            }
            (Vendor::Nvidia, None) => {
                let version = hardware.nvidia_kernel_driver.as_deref().and_then(version).unwrap_or("VERSION");
                let major = version.split('.').next().unwrap_or(version);
                format!(
                    "install the graphics libraries of the driver, in the version of its kernel module ({version}): Ubuntu: \
                     `sudo apt-get install libnvidia-gl-{major}` (or -{major}-server), Debian: `sudo apt-get install \
                     nvidia-vulkan-icd`"
                )
            }
            (Vendor::Wsl, _) => {
                "Debian's and Ubuntu's Mesa has no Vulkan driver for WSL. Run on Linux itself, or try Mesa's GL driver: \
                 `sudo apt-get install libegl1 libgl1-mesa-dri`, then `WGPU_BACKEND=gl GALLIUM_DRIVER=d3d12`"
                    .to_owned()
            }
            _ => "`sudo apt-get install mesa-vulkan-drivers` (Debian, Ubuntu)".to_owned(),
        };
        Some(Finding::new(self.device(), means, remedy))
    }

    fn manifests_left_out(&self) -> Option<Finding> {
        let manifests = self.manifests();
        let variable = left_out_by(self.hardware, &manifests)?;
        let means =
            format!("{variable} makes the Vulkan loader leave out its driver ({})", paths(&manifests));
        Some(Finding::new(self.device(), means, format!("correct or unset {}", name_of(&variable))))
    }

    fn no_library(&self) -> Option<Finding> {
        let manifests = self.manifests();
        let broken = manifests.first().filter(|_| manifests.iter().all(|manifest| !manifest.has_library))?;
        let means = format!("{} names the library `{}`, which is not here", broken.path, broken.library);
        let remedy = match (self.vendor, self.hardware.container) {
            (Vendor::Nvidia, Some(_)) => {
                "the container has the manifest but not the driver: start it with `--gpus all -e \
                 NVIDIA_DRIVER_CAPABILITIES=graphics,utility` (Docker) or `--nv` (Apptainer)"
            }
            (Vendor::Nvidia, None) => "install the graphics libraries of NVIDIA's driver again",
            _ => "`sudo apt-get install --reinstall mesa-vulkan-drivers` (Debian, Ubuntu)",
        };
        Some(Finding::new(self.device(), means, remedy))
    }

    fn silent_driver(&self) -> Finding {
        let means = format!("its driver is installed ({}) but reports no adapter", paths(&self.manifests()));
        let remedy = match self.vendor {
            Vendor::Nvidia if !self.is_on_nouveau() => {
                "compare the driver's versions with `nvidia-smi` (kernel module and libraries must be the same), and install what \
                 the libraries need: `sudo apt-get install libegl1 libgl1 libglx0 libxext6`; `VK_LOADER_DEBUG=error,driver \
                 regolith-render adapters` prints the loader's reason"
            }
            _ => {
                "the driver may be older than the GPU: update Mesa; `VK_LOADER_DEBUG=error,driver regolith-render adapters` \
                 prints the loader's reason"
            }
        };
        Finding::new(self.device(), means, remedy)
    }
}

/// Paths of manifests, for a message.
fn paths(manifests: &[&Manifest]) -> String {
    manifests.iter().map(|manifest| manifest.path.as_str()).collect::<Vec<_>>().join(", ")
}

/// The variable by which the Vulkan loader leaves out all of these manifests, with its value; `None` if it reads one.
fn left_out_by(hardware: &Hardware, manifests: &[&Manifest]) -> Option<String> {
    let variables: Option<Vec<&str>> = manifests.iter().map(|manifest| manifest.left_out_by).collect();
    let name = *variables?.first()?;
    Some(format!("{name}={}", hardware.variable(name).unwrap_or_default()))
}

/// The name in `NAME=VALUE`.
fn name_of(variable: &str) -> &str {
    variable.split('=').next().unwrap_or_default()
}

/// How to find the driver that fails.
fn one_by_one(hardware: &Hardware) -> String {
    let manifests: Vec<&Manifest> = hardware.manifests.iter().collect();
    if manifests.is_empty() {
        return "try one API alone, and keep to the one that works: `WGPU_BACKEND=vulkan regolith-render adapters`, then \
                `WGPU_BACKEND=gl`"
            .to_owned();
    }
    format!(
        "try the drivers one by one, and leave out or update the one that fails: `VK_DRIVER_FILES=FILE WGPU_BACKEND=vulkan \
         regolith-render adapters`, where FILE is each of {} (loaders before 1.3.207: VK_ICD_FILENAMES)",
        paths(&manifests)
    )
}

/// Why there is no adapter at all.
fn no_adapter(hardware: &Hardware, failure: Option<&str>) -> Finding {
    let seen = "no adapter";
    if let Some(failure) = failure {
        return Finding::new(
            seen,
            format!("the adapters could not be listed: {failure}"),
            one_by_one(hardware),
        );
    }
    let manifests: Vec<&Manifest> = hardware.manifests.iter().collect();
    if let Some(variable) = left_out_by(hardware, &manifests) {
        let means =
            format!("{variable} makes the Vulkan loader leave out every driver ({})", paths(&manifests));
        return Finding::new(seen, means, format!("correct or unset {}", name_of(&variable)));
    }
    let backends = hardware.variable("WGPU_BACKEND").unwrap_or_default();
    let (tried, advice) = tried_and_advice(backends);
    let means = format!("no driver answers, so that nothing can be rendered; tried: {tried}");
    let unset = if backends.is_empty() { "" } else { "unset WGPU_BACKEND, or: " };
    Finding::new(seen, means, format!("{unset}{}", advice.replace('\n', " ").trim_end_matches('.')))
}

/// The version in NVIDIA's line about its kernel driver: the first word of digits and points.
fn version(line: &str) -> Option<&str> {
    let is_version =
        |word: &&str| word.contains('.') && word.bytes().all(|c| c.is_ascii_digit() || c == b'.');
    line.split_whitespace().find(is_version)
}

/// Whether an adapter is a GPU of this vendor.
fn is_of(adapter: &AdapterReport, vendor: Vendor) -> bool {
    let names_it = vendor.is_named_in(&adapter.name) || vendor.is_named_in(&adapter.driver);
    !adapter.is_software && (Vendor::of_pci(adapter.vendor) == Some(vendor) || names_it)
}

/// The findings of a machine, those with a remedy first.
#[must_use]
pub fn findings(hardware: &Hardware, answers: &Answers<'_>) -> Vec<Finding> {
    let adapters = answers.adapters;
    let mut found = Vec::new();
    for vendor in Vendor::ALL {
        let files: Vec<&DeviceFile> =
            hardware.device_files.iter().filter(|file| file.vendor == vendor).collect();
        if files.is_empty() && hardware.pci.iter().all(|gpu| gpu.vendor != vendor) {
            continue;
        }
        let gpu = Unanswered { hardware, vendor, files };
        match adapters.iter().find(|adapter| is_of(adapter, vendor)) {
            // Where no adapter could be listed, nobody knows whether this driver would answer.
            None if answers.failure.is_some() => found.extend(gpu.cause()),
            None => found.push(gpu.cause().unwrap_or_else(|| gpu.silent_driver())),
            Some(adapter) if adapter.missing.is_empty() => {
                let means =
                    format!("its driver answers: {} ({}, {})", adapter.name, adapter.backend, adapter.driver);
                found.push(Finding::new(gpu.device(), means, ""));
            }
            Some(adapter) => {
                let means = format!(
                    "its driver answers ({}) but lacks {}",
                    adapter.driver,
                    adapter.missing.join(", ")
                );
                found.push(Finding::new(gpu.device(), means, "update its driver"));
            }
        }
    }
    let has_gpu = !hardware.device_files.is_empty() || !hardware.pci.is_empty();
    if !has_gpu && adapters.iter().all(|adapter| adapter.is_software) {
        let means = if adapters.is_empty() { "rendering takes a CPU driver" } else { "the CPU renders" };
        let seen = "no GPU: no device file, and none of NVIDIA, AMD or Intel on the PCI bus";
        found.push(Finding::new(seen, means, ""));
    }
    if adapters.is_empty() {
        found.push(no_adapter(hardware, answers.failure));
    }
    if let Some(how) = answers.crash_at_exit {
        let means = "the results are complete, but a driver fails when a process ends: commands end with another status, or not at all";
        found.push(Finding::new(format!("a process that was done {how}"), means, one_by_one(hardware)));
    }
    found.extend(variables(hardware));
    found.sort_by_key(|finding| !finding.is_problem());
    found
}

/// Variables that users expect to select a GPU, and others that matter.
fn variables(hardware: &Hardware) -> Vec<Finding> {
    let mut found = Vec::new();
    if let Some(list) = hardware.variable("CUDA_VISIBLE_DEVICES") {
        let means = "it selects GPUs for CUDA only; Vulkan sees all. `--adapter TEXT` selects one, also by the PCI address that \
                     `regolith-render adapters` prints";
        found.push(Finding::new(format!("CUDA_VISIBLE_DEVICES={list}"), means, ""));
    }
    if hardware.has_kfd && hardware.device_files.iter().all(|file| file.vendor != Vendor::Amd) {
        let remedy = "pass /dev/dri as well as /dev/kfd";
        found.push(Finding::new(
            "/dev/kfd without /dev/dri",
            "an AMD GPU can compute (ROCm) but not render",
            remedy,
        ));
    }
    if let Some((name, named)) = &hardware.named_manifests {
        let gone: Vec<&str> = named
            .iter()
            .filter(|path| {
                hardware.manifests.iter().all(|manifest| !manifest.path.starts_with(path.as_str()))
            })
            .map(String::as_str)
            .collect();
        if !gone.is_empty() {
            let seen = format!("{name}={}", named.join(":"));
            let means = format!("{} is not a driver manifest", gone.join(", "));
            found.push(Finding::new(seen, means, format!("correct or unset {name}")));
        }
    }
    found
}
