//! Limits on the memory of the process (`ulimit`). Drivers crash where they reach one, so they are checked before a driver is
//! loaded.
//!
//! Must not know: adapters.

use crate::error::{Error, Result};

/// A limit of `/proc/self/limits`, and what a driver, the code it compiles and a frame of moderate size need.
struct MemoryLimit {
    /// Its line in that file, less the values.
    line: &'static str,
    /// What it limits, in words.
    what: &'static str,
    /// The option of `ulimit`.
    option: &'static str,
    /// What is needed, bytes; measured with a quarter to spare.
    base_bytes: u64,
}

const LIMITS: [MemoryLimit; 2] = [
    MemoryLimit {
        line: "Max address space",
        what: "the address space",
        option: "-v",
        base_bytes: 1_500_000_000,
    },
    MemoryLimit { line: "Max data size", what: "the data", option: "-d", base_bytes: 400_000_000 },
];

/// What the threads of each core need besides, for their stacks and arenas, bytes.
const BYTES_PER_CORE: u64 = 100_000_000;

/// Checks that the limits of this process, if there are any, leave what rendering needs.
///
/// # Errors
/// [`Error::MemoryLimit`].
pub(super) fn check() -> Result<()> {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for limit in &LIMITS {
        let needed_bytes = limit.base_bytes + BYTES_PER_CORE * cores as u64;
        if let Some(limit_bytes) = soft_limit(&limits, limit.line).filter(|bytes| *bytes < needed_bytes) {
            let (what, option) = (limit.what, limit.option);
            return Err(Error::MemoryLimit { what, option, limit_bytes, needed_bytes });
        }
    }
    Ok(())
}

/// The soft limit of a line of `/proc/self/limits`, bytes; `None` if there is none.
fn soft_limit(limits: &str, line: &str) -> Option<u64> {
    let values = limits.lines().find_map(|text| text.strip_prefix(line))?;
    values.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soft_limit_is_read() {
        let limits = |value: &str| {
            format!(
                "Limit                     Soft Limit           Hard Limit           Units     \n\
                 Max cpu time              unlimited            unlimited            seconds   \n\
                 Max data size             unlimited            unlimited            bytes     \n\
                 Max address space         {value}              unlimited            bytes     \n"
            )
        };
        let [address_space, data] = LIMITS.map(|limit| limit.line);
        assert_eq!(soft_limit(&limits("1228800000"), address_space), Some(1_228_800_000));
        assert_eq!(soft_limit(&limits("1228800000"), data), None);
        assert_eq!(soft_limit(&limits("unlimited"), address_space), None);
        assert_eq!(soft_limit("", data), None);
    }
}
