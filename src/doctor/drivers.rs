//! What a Vulkan driver consists of on disk: the loader, and for each driver a manifest that names its library.
//!
//! Must not know: GPUs.

use serde_json::Value;

use crate::gpu::machine::Machine;
use crate::gpu::vendor::Vendor;

/// The Vulkan loader, which finds drivers by their manifests.
const LOADER: &str = "libvulkan.so.1";
/// Folders in which images of cloud providers and vendors' packages leave manifests that the loader does not read.
const OTHER_FOLDERS: [&str; 4] = [
    "/usr/local/nvidia/share/vulkan/icd.d",
    "/usr/local/nvidia/vulkan/icd.d",
    "/opt/amdgpu/etc/vulkan/icd.d",
    "/opt/amdgpu/share/vulkan/icd.d",
];

/// A manifest of a Vulkan driver (the loader's documentation calls it an ICD manifest).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Absolute path.
    pub path: String,
    /// The library that it names; empty if the file cannot be read.
    pub library: String,
    /// Whether the library exists.
    pub has_library: bool,
    /// The variable by which the loader leaves it out.
    pub left_out_by: Option<&'static str>,
}

impl Manifest {
    /// Whether its driver is for GPUs of this vendor.
    #[must_use]
    pub fn is_of(&self, vendor: Vendor) -> bool {
        let name = self.path.rsplit('/').next().unwrap_or_default();
        vendor.is_named_in(name) || vendor.is_named_in(&self.library)
    }

    /// Whether its driver is Mesa's for NVIDIA's GPUs, NVK, which needs the kernel driver nouveau in place of NVIDIA's.
    #[must_use]
    pub fn is_of_nouveau(&self) -> bool {
        let text = format!("{} {}", self.path, self.library);
        ["nouveau", "nvk"].iter().any(|word| text.contains(word))
    }
}

/// The path of the Vulkan loader.
pub(super) fn loader(machine: &Machine) -> Option<String> {
    find_library(machine, LOADER)
}

/// The folders in which the dynamic linker looks for libraries.
fn library_folders(machine: &Machine) -> Vec<String> {
    let mut folders: Vec<String> = machine
        .variable("LD_LIBRARY_PATH")
        .into_iter()
        .flat_map(|list| list.split(':'))
        .filter(|folder| folder.starts_with('/'))
        .map(str::to_owned)
        .collect();
    for name in machine.names("/etc/ld.so.conf.d") {
        let text = machine.text(&format!("/etc/ld.so.conf.d/{name}"));
        folders.extend(text.lines().map(str::trim).filter(|line| line.starts_with('/')).map(str::to_owned));
    }
    let triple = format!("{}-linux-gnu", std::env::consts::ARCH);
    for base in ["/usr/local/lib", "/usr/lib", "/lib"] {
        folders.extend([format!("{base}/{triple}"), format!("{base}64"), base.to_owned()]);
    }
    folders
}

/// The path of a library, by its name or path.
fn find_library(machine: &Machine, name: &str) -> Option<String> {
    if name.contains('/') {
        return machine.exists(name).then(|| name.to_owned());
    }
    let paths = library_folders(machine).into_iter().map(|folder| format!("{folder}/{name}"));
    paths.into_iter().find(|path| machine.exists(path))
}

/// The manifests that the environment names in place of those of the system: the variable and its paths.
pub(super) fn named_manifests(machine: &Machine) -> Option<(&'static str, Vec<String>)> {
    let (name, list) = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"]
        .into_iter()
        .find_map(|name| machine.variable(name).map(|list| (name, list)))?;
    Some((name, paths(list)))
}

/// The paths of a list with colons; relative ones start at the current folder.
fn paths(list: &str) -> Vec<String> {
    let folder = std::env::current_dir().unwrap_or_default();
    let absolute = |path: &str| folder.join(path).to_string_lossy().into_owned();
    list.split(':').filter(|path| !path.is_empty()).map(absolute).collect()
}

/// Every manifest that the Vulkan loader reads ("Vulkan Loader and Driver Interface", section "Driver Manifest File Usage").
pub(super) fn manifests(machine: &Machine) -> Vec<Manifest> {
    let mut files = match named_manifests(machine) {
        Some((_, named)) => named,
        None => {
            let folders = manifest_folders(machine).into_iter();
            folders.map(|folder| format!("{folder}/vulkan/icd.d")).collect()
        }
    };
    files.extend(paths(machine.variable("VK_ADD_DRIVER_FILES").unwrap_or_default()));
    manifests_at(machine, files)
}

/// Manifests where the loader does not look.
pub(super) fn unread_manifests(machine: &Machine) -> Vec<Manifest> {
    manifests_at(machine, OTHER_FOLDERS.map(str::to_owned).into())
}

/// The manifests among files and in folders.
fn manifests_at(machine: &Machine, paths: Vec<String>) -> Vec<Manifest> {
    let mut found: Vec<Manifest> = Vec::new();
    for path in paths {
        let files = if machine.path(&path).is_dir() {
            machine.names(&path).into_iter().map(|name| format!("{path}/{name}")).collect()
        } else {
            vec![path]
        };
        for file in files.into_iter().filter(|file| file.ends_with(".json")) {
            if machine.exists(&file) && !found.iter().any(|manifest| manifest.path == file) {
                found.push(manifest(machine, file));
            }
        }
    }
    found
}

fn manifest_folders(machine: &Machine) -> Vec<String> {
    let home = machine.variable("HOME").unwrap_or("/nonexistent");
    let or = |name: &str, default: &str| machine.variable(name).unwrap_or(default).to_owned();
    let lists = [
        or("XDG_CONFIG_HOME", &format!("{home}/.config")),
        or("XDG_CONFIG_DIRS", "/etc/xdg"),
        "/usr/local/etc:/etc".to_owned(),
        or("XDG_DATA_HOME", &format!("{home}/.local/share")),
        or("XDG_DATA_DIRS", "/usr/local/share:/usr/share"),
    ];
    lists
        .iter()
        .flat_map(|list| list.split(':'))
        .filter(|path| path.starts_with('/'))
        .map(str::to_owned)
        .collect()
}

fn manifest(machine: &Machine, path: String) -> Manifest {
    let content: Value = serde_json::from_str(&machine.text(&path)).unwrap_or_default();
    let library = content["ICD"]["library_path"].as_str().unwrap_or_default().to_owned();
    // A relative path with folders starts at the manifest.
    let is_relative = library.contains('/') && !library.starts_with('/');
    let beside = format!("{}/{library}", path.rsplit_once('/').map_or("", |(folder, _)| folder));
    let has_library =
        if is_relative { machine.exists(&beside) } else { find_library(machine, &library).is_some() };
    let left_out_by = left_out_by(machine, path.rsplit('/').next().unwrap_or_default());
    Manifest { has_library: has_library && !library.is_empty(), path, library, left_out_by }
}

/// The variable by which the loader leaves out a manifest of this name ("Vulkan Loader and Driver Interface", section "Driver
/// Filtering").
fn left_out_by(machine: &Machine, name: &str) -> Option<&'static str> {
    let is_among = |list: &str| list.split(',').any(|pattern| matches(name, pattern));
    let is_left_out = |(variable, leaves_out): (&'static str, bool)| {
        machine.variable(variable).filter(|list| is_among(list) == leaves_out).map(|_| variable)
    };
    [("VK_LOADER_DRIVERS_SELECT", false), ("VK_LOADER_DRIVERS_DISABLE", true)]
        .into_iter()
        .find_map(is_left_out)
}

/// Whether a name is that of a pattern, in any case; stars at the ends of the pattern stand for anything.
fn matches(name: &str, pattern: &str) -> bool {
    let (name, pattern) = (name.to_lowercase(), pattern.trim().to_lowercase());
    let text = pattern.trim_matches('*');
    match (pattern.starts_with('*'), pattern.ends_with('*')) {
        (true, true) => name.contains(text),
        (true, false) => name.ends_with(text),
        (false, true) => name.starts_with(text),
        (false, false) => name == text,
    }
}
