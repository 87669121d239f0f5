//! The processor, as far as compiled code and rounding depend on it.
//!
//! Must not know: adapters.

use std::sync::LazyLock;

/// Keys of `/proc/cpuinfo` that describe a processor: those of x86, then those of Arm.
const KEYS: [&str; 10] = [
    "vendor_id",
    "cpu family",
    "model",
    "model name",
    "stepping",
    "CPU implementer",
    "CPU architecture",
    "CPU variant",
    "CPU part",
    "CPU revision",
];

/// Model and instruction sets of the processor that this process runs on.
pub(super) fn description() -> &'static str {
    static DESCRIPTION: LazyLock<String> = LazyLock::new(|| {
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        format!("{}\n{}\n{}", std::env::consts::ARCH, model(&cpuinfo), instruction_sets())
    });
    &DESCRIPTION
}

/// The lines of `/proc/cpuinfo` that describe its first processor.
fn model(cpuinfo: &str) -> String {
    let first = cpuinfo.split("\n\n").next().unwrap_or_default();
    let describes = |line: &&str| line.split_once(':').is_some_and(|(key, _)| KEYS.contains(&key.trim()));
    first.lines().filter(describes).collect::<Vec<_>>().join("\n")
}

/// The instruction sets that compilers choose by, asked of the processor itself: an emulator or a virtual machine may hide some.
#[cfg(target_arch = "x86_64")]
fn instruction_sets() -> String {
    macro_rules! detected {
        ($($name:tt),*) => {
            [$((is_x86_feature_detected!($name), $name)),*]
        };
    }
    let all = detected!(
        "sse3",
        "ssse3",
        "sse4.1",
        "sse4.2",
        "popcnt",
        "lzcnt",
        "bmi1",
        "bmi2",
        "avx",
        "f16c",
        "fma",
        "avx2",
        "avx512f",
        "avx512bw",
        "avx512cd",
        "avx512dq",
        "avx512vl",
        "avx512vbmi",
        "avx512bf16",
        "avx512fp16"
    );
    all.iter().filter(|(is_detected, _)| *is_detected).map(|(_, name)| *name).collect::<Vec<_>>().join(" ")
}

/// The instruction sets as the kernel lists them.
#[cfg(not(target_arch = "x86_64"))]
fn instruction_sets() -> String {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = cpuinfo.lines().find(|line| line.starts_with("Features") || line.starts_with("isa"));
    line.unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_described_without_what_changes() {
        let cpuinfo = "processor\t: 0\nvendor_id\t: AuthenticAMD\nmodel\t\t: 17\ncpu MHz\t: 2596.1\n\n\
            processor\t: 1\nvendor_id\t: AuthenticAMD\n";
        assert_eq!(model(cpuinfo), "vendor_id\t: AuthenticAMD\nmodel\t\t: 17");
        assert_eq!(model(""), "");
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn this_processor_has_a_description() {
        assert!(description().starts_with("x86_64\n"));
        assert_eq!(instruction_sets().contains("avx2"), is_x86_feature_detected!("avx2"));
    }
}
