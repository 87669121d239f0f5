//! What differs between operating systems: the backends that are compiled in, and what to install where no adapter is found.
//!
//! Linux is tested. On macOS and Windows the code is compiled, and nothing more is known.
//! Must not know: adapters.

use wgpu::Backends;

/// An operating system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Platform {
    /// Linux, and whatever else is neither of the others.
    Linux,
    MacOs,
    Windows,
}

/// A backend: what `WGPU_BACKEND` calls it, first by its own name.
type BackendNames = (Backends, &'static [&'static str]);

const VULKAN: BackendNames = (Backends::VULKAN, &["vulkan", "vk"]);
const GL: BackendNames = (Backends::GL, &["gl", "gles", "opengl"]);
const METAL: BackendNames = (Backends::METAL, &["metal", "mtl"]);
const DX12: BackendNames = (Backends::DX12, &["dx12", "d3d12"]);

impl Platform {
    /// The one that `regolith-render` is compiled for.
    pub(super) const HERE: Self = if cfg!(target_os = "macos") {
        Self::MacOs
    } else if cfg!(windows) {
        Self::Windows
    } else {
        Self::Linux
    };

    /// Its backends, in the order in which they are tried. `Cargo.toml` compiles the same.
    const fn backends(self) -> &'static [BackendNames] {
        match self {
            // GL is tried only where Vulkan has no match: its libraries are slow to load and print warnings.
            Self::Linux => &[VULKAN, GL],
            Self::MacOs => &[METAL],
            Self::Windows => &[DX12, VULKAN],
        }
    }

    /// Groups of backends: a group is tried where the one before it has no match.
    pub(super) fn rounds(self) -> Vec<Backends> {
        let each = self.backends().iter().map(|(backend, _)| *backend);
        match self {
            Self::Windows => vec![each.fold(Backends::empty(), |all, backend| all | backend)],
            Self::Linux | Self::MacOs => each.collect(),
        }
    }

    /// The backend that `WGPU_BACKEND` names.
    pub(super) fn backend(self, name: &str) -> Option<Backends> {
        self.backends().iter().find(|(_, names)| names.contains(&name)).map(|(backend, _)| *backend)
    }

    /// The names of those of its backends that are among these.
    pub(super) fn names_of(self, backends: Backends) -> Vec<&'static str> {
        let among = self.backends().iter().filter(|(backend, _)| backends.contains(*backend));
        among.map(|(_, names)| names[0]).collect()
    }

    /// The names of its backends, in words.
    pub(super) fn backend_names(self) -> String {
        let names = self.names_of(Backends::all());
        match names.as_slice() {
            [name] => format!("the backend is {name}"),
            [others @ .., last] => format!("the backends are {} and {last}", others.join(", ")),
            [] => String::new(),
        }
    }

    /// What to do where no adapter is found and these backends are allowed, if only some are.
    pub(super) fn advice(self, allowed: Option<Backends>) -> String {
        match self {
            Self::Linux => {
                let (packages, api) = if allowed == Some(Backends::GL) {
                    ("libegl1 libgl1-mesa-dri", "EGL")
                } else {
                    ("mesa-vulkan-drivers", "Vulkan")
                };
                format!(
                    "On a machine without a GPU, install Mesa's CPU driver: `sudo apt-get install {packages}` (Debian, Ubuntu).\n\
                     On a machine with a GPU, install its {api} driver; in a container, pass the GPU through with its graphics \
                     capability."
                )
            }
            Self::MacOs => "Metal is part of macOS; a virtual machine must be given a GPU with Metal.".to_owned(),
            Self::Windows => "Install the driver of the GPU from its vendor; without a GPU, Windows has a software adapter for \
                              Direct3D 12 (WARP) from Windows 10 on."
                .to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Platform; 3] = [Platform::Linux, Platform::MacOs, Platform::Windows];

    #[test]
    fn every_backend_of_a_platform_is_tried_and_has_a_name() {
        for platform in ALL {
            let tried = platform.rounds().into_iter().fold(Backends::empty(), |all, round| all | round);
            let named =
                platform.backends().iter().map(|(_, names)| platform.backend(names[0]).expect("named"));
            assert_eq!(named.fold(Backends::empty(), |all, backend| all | backend), tried, "{platform:?}");
            assert_eq!(platform.backend("glide"), None);
        }
        assert_eq!(Platform::Linux.backend("metal"), None);
        assert_eq!(Platform::Linux.backend_names(), "the backends are vulkan and gl");
        assert_eq!(Platform::MacOs.backend_names(), "the backend is metal");
    }

    #[test]
    fn advice_fits_the_platform() {
        let linux = Platform::Linux.advice(None);
        assert!(linux.contains("apt-get install mesa-vulkan-drivers"), "{linux}");
        assert!(Platform::Linux.advice(Some(Backends::GL)).contains("libegl1"));
        for platform in [Platform::MacOs, Platform::Windows] {
            let advice = platform.advice(None);
            assert!(!advice.contains("apt-get") && !advice.contains("Mesa"), "{advice}");
        }
    }
}
