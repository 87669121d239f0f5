//! Makers of GPUs, and how to recognise them.
//!
//! Must not know: where a name comes from.

/// Makers of GPUs, as far as they are recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Vendor {
    /// NVIDIA.
    Nvidia,
    /// AMD.
    Amd,
    /// Intel.
    Intel,
    /// Any GPU of a Windows host, as its Linux subsystem shows it.
    Wsl,
}

impl Vendor {
    /// Every vendor.
    pub const ALL: [Self; 4] = [Self::Nvidia, Self::Amd, Self::Intel, Self::Wsl];

    /// Its name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nvidia => "NVIDIA",
            Self::Amd => "AMD",
            Self::Intel => "Intel",
            Self::Wsl => "Windows (WSL)",
        }
    }

    /// Its name with an article.
    #[must_use]
    pub const fn with_article(self) -> &'static str {
        match self {
            Self::Nvidia => "an NVIDIA",
            Self::Amd => "an AMD",
            Self::Intel => "an Intel",
            Self::Wsl => "a Windows",
        }
    }

    /// The vendor with this PCI id.
    #[must_use]
    pub const fn of_pci(id: u32) -> Option<Self> {
        match id {
            0x10de => Some(Self::Nvidia),
            0x1002 => Some(Self::Amd),
            0x8086 => Some(Self::Intel),
            _ => None,
        }
    }

    /// Whether a text of a driver (name of an adapter, manifest or library) is of this vendor.
    #[must_use]
    pub fn is_named_in(self, text: &str) -> bool {
        let text = text.to_lowercase();
        let words: &[&str] = match self {
            Self::Nvidia => &["nvidia", "geforce", "nouveau", "nvk"],
            Self::Amd => &["amd", "radeon", "radv"],
            Self::Intel => &["intel"],
            Self::Wsl => &["dzn", "d3d12", "direct3d12"],
        };
        words.iter().any(|word| text.contains(word))
    }
}

/// A PCI id in the form of `/sys`, `0x10de`.
pub(crate) fn pci_id(text: &str) -> Option<u32> {
    u32::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok()
}
