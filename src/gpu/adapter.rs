//! Adapters: listing them, describing them, and choosing one.
//!
//! Must not know: how a device is opened.

use wgpu::{AdapterInfo, Backend, Backends, DeviceType, DownlevelFlags, InstanceDescriptor, InstanceFlags};

use crate::error::{Error, Result};
use crate::gpu::device_files::device_files;
use crate::gpu::machine::Machine;
use crate::gpu::memory_limits;
use crate::gpu::platform::Platform;
use crate::gpu::vendor::Vendor;

/// What of WebGPU the passes use and an adapter may lack, in words. Shaders need nothing optional: tests validate every program
/// without any capability.
const REQUIRED_FLAGS: [(DownlevelFlags, &str); 3] = [
    (DownlevelFlags::COMPUTE_SHADERS, "compute shaders"),
    (DownlevelFlags::VERTEX_STORAGE, "storage buffers in vertex shaders"),
    (DownlevelFlags::FRAGMENT_STORAGE, "storage buffers in fragment shaders"),
];

/// Versions of GL and of GL ES from which shaders are compiled with what the passes use.
const GL_VERSION: (u32, u32) = (4, 3);
/// See [`GL_VERSION`].
const GL_ES_VERSION: (u32, u32) = (3, 1);

/// What an adapter with these flags lacks, in words.
pub(super) fn missing(info: &AdapterInfo, flags: DownlevelFlags) -> Vec<String> {
    let lacking = REQUIRED_FLAGS.iter().filter(|(flag, _)| !flags.contains(*flag));
    lacking.map(|(_, name)| (*name).to_owned()).chain(missing_gl(info)).collect()
}

/// The version of GL that an adapter lacks. wgpu asks for a context of version 3.3: Mesa answers with the latest that it has, NVIDIA's driver
/// with that one, for which shaders are not compiled, whatever extensions there are.
fn missing_gl(info: &AdapterInfo) -> Option<String> {
    if info.backend != Backend::Gl {
        return None;
    }
    let is_es = info.driver_info.contains("OpenGL ES");
    let (name, needed) = if is_es { ("GL ES", GL_ES_VERSION) } else { ("GL", GL_VERSION) };
    let version = |word: &str| {
        let mut numbers = word.split('.').map_while(|number| number.parse().ok());
        Some((numbers.next()?, numbers.next()?))
    };
    let (major, minor) = info.driver_info.split_whitespace().find_map(version)?;
    let is_too_old = (major, minor) < needed;
    is_too_old.then(|| format!("{name} {}.{} (its driver opens {major}.{minor})", needed.0, needed.1))
}

/// The adapter whose description contains `wanted`, or the best one; see [`crate::gpu::Gpu::open`].
pub(super) fn choose(wanted: Option<&str>) -> Result<wgpu::Adapter> {
    memory_limits::check()?;
    let is_argument = wanted.is_some();
    let wanted = wanted.map_or_else(name_in_environment, |text| Ok(Some(text.to_owned())))?;
    let rounds = backends_allowed()?.map_or_else(|| Platform::HERE.rounds(), |allowed| vec![allowed]);
    let (mut available, mut best) = (Vec::new(), None);
    for backends in rounds {
        let adapters = enumerate(backends);
        available.extend(adapters.iter().map(|adapter| identify(&adapter.get_info())));
        let matching = adapters
            .into_iter()
            .filter(|adapter| wanted.as_deref().is_none_or(|text| matches(&adapter.get_info(), text)));
        best = best.into_iter().chain(matching).min_by_key(rank);
        if best.as_ref().is_some_and(|best| is_final(best, wanted.is_some())) {
            break;
        }
    }
    best.ok_or_else(|| match wanted {
        Some(wanted) if !available.is_empty() => not_found(wanted, is_argument, available),
        _ => no_adapter(),
    })
}

/// Whether no other backend can have a better adapter. One that rasterises on the CPU, chosen by nobody on a machine with a GPU, may be
/// worse than that GPU is through GL: so it is in Windows' subsystem for Linux.
fn is_final(best: &wgpu::Adapter, is_named: bool) -> bool {
    let info = best.get_info();
    let is_the_only_kind = || !is_software(&info) || device_files(&Machine::here()).is_empty();
    missing_of(best).is_empty() && (is_named || is_the_only_kind())
}

/// What an adapter lacks, in words; empty if it can be used.
pub(super) fn missing_of(adapter: &wgpu::Adapter) -> Vec<String> {
    missing(&adapter.get_info(), adapter.get_downlevel_capabilities().flags)
}

/// The name or part of a name in `WGPU_ADAPTER_NAME`.
///
/// # Errors
/// [`Error::Usage`] if it is not UTF-8.
pub fn name_in_environment() -> Result<Option<String>> {
    variable("WGPU_ADAPTER_NAME")
}

/// The value of a variable; `None` if it is not set or empty.
fn variable(name: &str) -> Result<Option<String>> {
    let Some(value) = std::env::var_os(name).filter(|value| !value.is_empty()) else { return Ok(None) };
    let value = value.into_string().map_err(|value| {
        Error::Usage(format!("{name}={}: the value should be text in UTF-8", value.display()))
    })?;
    Ok(Some(value))
}

/// Every adapter, best first, and what each lacks; at least one.
///
/// # Errors
/// [`Error::NoAdapter`]; [`Error::MemoryLimit`]; [`Error::Usage`] if `WGPU_BACKEND` names an unknown backend.
pub fn list_with_missing() -> Result<Vec<(AdapterInfo, Vec<String>)>> {
    let adapters = enumerate_allowed()?;
    let rows = adapters.iter().map(|adapter| (adapter.get_info(), missing_of(adapter)));
    if adapters.is_empty() { Err(no_adapter()) } else { Ok(rows.collect()) }
}

/// Every adapter, best first, at least one; those that cannot be used are the last.
///
/// # Errors
/// Those of [`list_with_missing`].
pub fn list() -> Result<Vec<AdapterInfo>> {
    Ok(list_with_missing()?.into_iter().map(|(info, _)| info).collect())
}

/// Checks what can be wrong before a driver is loaded: the limits of the process, and `WGPU_BACKEND`.
///
/// # Errors
/// [`Error::MemoryLimit`] or [`Error::Usage`].
pub fn check_environment() -> Result<()> {
    memory_limits::check()?;
    backends_allowed().map(drop)
}

/// Every adapter of the allowed backends, best first.
pub(super) fn enumerate_allowed() -> Result<Vec<wgpu::Adapter>> {
    memory_limits::check()?;
    let mut adapters =
        enumerate(backends_allowed()?.unwrap_or_else(|| Platform::HERE.rounds().into_iter().collect()));
    adapters.sort_by_key(rank);
    Ok(adapters)
}

/// The backends that `WGPU_BACKEND` allows; `None` if it is not set.
fn backends_allowed() -> Result<Option<Backends>> {
    variable("WGPU_BACKEND")?.map_or(Ok(None), |names| backends_named(&names))
}

/// The backends in a list with commas; `None` if there is none.
fn backends_named(names: &str) -> Result<Option<Backends>> {
    let words = names.split(',').map(|word| word.trim().to_lowercase()).filter(|word| !word.is_empty());
    words
        .map(|word| {
            Platform::HERE.backend(&word).ok_or_else(|| {
                let known = Platform::HERE.backend_names();
                Error::Usage(format!("WGPU_BACKEND={names}: unknown backend `{word}`; {known}"))
            })
        })
        .try_fold(None, |allowed, backend| Ok(Some(allowed.unwrap_or(Backends::empty()) | backend?)))
}

/// The error of a name that none of these adapters has. It `is_argument`, or is that of the environment.
pub(crate) fn not_found(wanted: String, is_argument: bool, available: Vec<String>) -> Error {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let backends = variable("WGPU_BACKEND").map(|value| format!("WGPU_BACKEND={value}"));
    let name = (!is_argument).then(|| format!("WGPU_ADAPTER_NAME={wanted}"));
    let set: Vec<String> = backends.into_iter().chain(name).collect();
    let origin =
        if set.is_empty() { String::new() } else { format!(" (the environment has {})", set.join(" and ")) };
    Error::AdapterNotFound { wanted, origin, available }
}

fn no_adapter() -> Error {
    if let Err(error) = memory_limits::check_open_files() {
        return error;
    }
    let (tried, advice) = tried_and_advice(&std::env::var("WGPU_BACKEND").unwrap_or_default());
    Error::NoAdapter { tried, advice }
}

/// Where no adapter is found and `WGPU_BACKEND` has this value: the backends that were tried, and what to do.
pub(crate) fn tried_and_advice(backend_variable: &str) -> (String, String) {
    let allowed = backends_named(backend_variable).ok().flatten();
    let names = Platform::HERE.names_of(allowed.unwrap_or(Backends::all())).join(", ");
    let tried = if allowed.is_some() { format!("{names} (WGPU_BACKEND allows no other)") } else { names };
    (tried, Platform::HERE.advice(allowed))
}

/// One line for people: name, kind, backend, driver.
#[must_use]
pub fn describe(info: &AdapterInfo) -> String {
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ");
    format!("{} ({}, {}, {})", info.name, kind(info), info.backend, driver.trim())
}

/// The same, with its PCI address where the driver says it: GPUs of one model differ in nothing else.
#[must_use]
pub fn identify(info: &AdapterInfo) -> String {
    with_pci_address(&describe(info), &info.device_pci_bus_id)
}

/// The description of an adapter with its PCI address, if there is one.
pub(super) fn with_pci_address(description: &str, address: &str) -> String {
    if address.is_empty() { description.to_owned() } else { format!("{description}, PCI {address}") }
}

/// The kind of hardware, in words.
#[must_use]
pub const fn kind(info: &AdapterInfo) -> &'static str {
    match info.device_type {
        DeviceType::DiscreteGpu => "discrete GPU",
        DeviceType::IntegratedGpu => "integrated GPU",
        DeviceType::VirtualGpu => "virtual GPU",
        DeviceType::Cpu => "CPU driver",
        DeviceType::Other => "other",
    }
}

fn enumerate(backends: Backends) -> Vec<wgpu::Adapter> {
    let mut descriptor = InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
    // The renderer writes its indirect draws itself; validating them would cost a compute pass.
    descriptor.flags = descriptor.flags.difference(InstanceFlags::VALIDATION_INDIRECT_CALL).with_env();
    pollster::block_on(wgpu::Instance::new(descriptor).enumerate_adapters(backends))
}

fn matches(info: &AdapterInfo, wanted: &str) -> bool {
    is_wanted(&identify(info), is_software(info), wanted)
}

/// Whether a text of `--adapter` selects the adapter with this description.
pub(super) fn is_wanted(description: &str, is_software: bool, wanted: &str) -> bool {
    let wanted = wanted.to_lowercase();
    (wanted == "cpu" && is_software) || description.to_lowercase().contains(&wanted)
}

/// Words in the names of renderers on the CPU: Mesa's two, and SwiftShader.
const SOFTWARE: [&str; 3] = ["llvmpipe", "softpipe", "swiftshader"];

/// Whether an adapter rasterises on the CPU. GL reports llvmpipe as another kind of device, so the name counts too.
#[must_use]
pub fn is_software(info: &AdapterInfo) -> bool {
    let name = info.name.to_lowercase();
    info.device_type == DeviceType::Cpu || SOFTWARE.iter().any(|word| name.contains(word))
}

/// Major version of Mesa, where it is the driver.
pub(crate) fn mesa_version(info: &AdapterInfo) -> Option<u32> {
    let (_, version) = info.driver_info.split_once("Mesa ")?;
    version.split('.').next()?.parse().ok()
}

/// NVIDIA's devices of the Hopper generation.
const HOPPER: [&str; 5] = ["H20", "H100", "H200", "H800", "GH200"];

/// Whether it is one of NVIDIA's Hopper generation, which runs vertex and fragment shaders on 2 of its 66 TPCs (pairs of streaming
/// multiprocessors) and compute shaders on all (NVIDIA H100 Tensor Core GPU Architecture, 2022).
pub(crate) fn is_hopper(info: &AdapterInfo) -> bool {
    Vendor::of_pci(info.vendor) == Some(Vendor::Nvidia)
        && info.name.split(|c: char| !c.is_alphanumeric()).any(|word| HOPPER.contains(&word))
}

/// Sort key: better adapters first, those that cannot be used last.
fn rank(adapter: &wgpu::Adapter) -> (bool, u8, bool) {
    rank_of(&adapter.get_info(), missing_of(adapter).is_empty())
}

fn rank_of(info: &AdapterInfo, is_usable: bool) -> (bool, u8, bool) {
    let kind = match info.device_type {
        _ if is_software(info) => 4,
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other | DeviceType::Cpu => 3,
    };
    (!is_usable, kind, info.backend == Backend::Gl)
}

/// The adapter of unit tests: a part of its name, from `REGOLITH_TEST_ADAPTER`; else `cpu`.
#[cfg(test)]
pub(crate) fn adapter_of_tests() -> String {
    let named = std::env::var("REGOLITH_TEST_ADAPTER").ok().filter(|name| !name.is_empty());
    named.unwrap_or_else(|| "cpu".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_adapter_lacks_is_named() {
        let all = DownlevelFlags::all();
        let vulkan = AdapterInfo::new(DeviceType::DiscreteGpu, Backend::Vulkan);
        assert_eq!(missing(&vulkan, all), [""; 0]);
        assert_eq!(missing(&vulkan, all - DownlevelFlags::SHADER_F16_IN_F32), [""; 0]);
        assert_eq!(missing(&vulkan, all - DownlevelFlags::COMPUTE_SHADERS), ["compute shaders"]);
        for (driver, lacks) in [
            ("3.3.0 NVIDIA 580.159.04", &["GL 4.3 (its driver opens 3.3)"][..]),
            ("4.5 (Core Profile) Mesa 22.3.6", &[]),
            ("OpenGL ES 3.2 Mesa 25.0.7", &[]),
            ("OpenGL ES 3.0 of some phone", &["GL ES 3.1 (its driver opens 3.0)"]),
            ("of no version", &[]),
        ] {
            let blank = AdapterInfo::new(DeviceType::Other, Backend::Gl);
            let info = AdapterInfo { driver_info: driver.to_owned(), ..blank };
            assert_eq!(missing(&info, all), lacks, "{driver}");
        }
    }

    /// Each row, from the best to the worst: kind, backend, name, whether it can be used.
    #[test]
    fn adapters_are_ranked_by_use_then_kind_then_backend() {
        let rows = [
            (DeviceType::DiscreteGpu, Backend::Vulkan, "a", true),
            (DeviceType::DiscreteGpu, Backend::Gl, "a", true),
            (DeviceType::IntegratedGpu, Backend::Vulkan, "b", true),
            (DeviceType::Other, Backend::Gl, "D3D12 (some GPU)", true),
            (DeviceType::Cpu, Backend::Vulkan, "llvmpipe", true),
            (DeviceType::Other, Backend::Gl, "LLVMpipe", true),
            (DeviceType::DiscreteGpu, Backend::Vulkan, "too old", false),
        ];
        let ranks = rows.map(|(kind, backend, name, is_usable)| {
            rank_of(&AdapterInfo { name: name.to_owned(), ..AdapterInfo::new(kind, backend) }, is_usable)
        });
        assert!(ranks.windows(2).all(|pair| pair[0] < pair[1]), "{ranks:?}");
    }

    #[test]
    fn devices_of_the_hopper_generation_are_known_by_name() {
        for (vendor, name, expected) in [
            (0x10de, "NVIDIA H200", true),
            (0x10de, "NVIDIA H100 80GB HBM3", true),
            (0x10de, "NVIDIA GH200 480GB", true),
            (0x10de, "NVIDIA A100-SXM4-40GB", false),
            (0x10de, "NVIDIA GeForce RTX 4090", false),
            (0x8086, "H100", false),
        ] {
            let blank = AdapterInfo::new(DeviceType::DiscreteGpu, Backend::Vulkan);
            let info = AdapterInfo { vendor, name: name.to_owned(), ..blank };
            assert_eq!(is_hopper(&info), expected, "{name}");
        }
    }

    #[test]
    fn the_version_of_mesa_is_read() {
        for (driver_info, version) in [
            ("Mesa 22.3.6 (LLVM 15.0.6)", Some(22)),
            ("Mesa 25.0.7-2+deb13u1 (LLVM 19.1.7)", Some(25)),
            ("4.5 (Core Profile) Mesa 26.1.6-1", Some(26)),
            ("580.95.05", None),
            ("", None),
        ] {
            let blank = AdapterInfo::new(DeviceType::Cpu, Backend::Vulkan);
            let info = AdapterInfo { driver_info: driver_info.to_owned(), ..blank };
            assert_eq!(mesa_version(&info), version, "{driver_info}");
        }
    }
}
