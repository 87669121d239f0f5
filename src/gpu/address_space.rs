//! The limit on the address space of the process (`ulimit -v`). Drivers crash where they reach it, so it is checked before one is
//! loaded.
//!
//! Must not know: adapters.

use crate::error::{Error, Result};

/// Address space of a driver, the code it compiles and a frame of moderate size, bytes; measured with a quarter to spare.
const BASE_BYTES: u64 = 1_500_000_000;
/// Further address space for the threads of each core, whose stacks and arenas reserve more than they use, bytes.
const BYTES_PER_CORE: u64 = 100_000_000;

/// Checks that the limit of this process, if there is one, leaves what rendering needs.
///
/// # Errors
/// [`Error::AddressSpace`].
pub(super) fn check() -> Result<()> {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    match limit(&limits) {
        Some(limit_bytes) if limit_bytes < needed_bytes(cores) => {
            Err(Error::AddressSpace { limit_bytes, needed_bytes: needed_bytes(cores) })
        }
        _ => Ok(()),
    }
}

const fn needed_bytes(cores: usize) -> u64 {
    BASE_BYTES + BYTES_PER_CORE * cores as u64
}

/// The soft limit in the text of `/proc/self/limits`, bytes; `None` if there is none.
fn limit(limits: &str) -> Option<u64> {
    let values = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
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
                 Max address space         {value}              unlimited            bytes     \n"
            )
        };
        assert_eq!(limit(&limits("1228800000")), Some(1_228_800_000));
        assert_eq!(limit(&limits("unlimited")), None);
        assert_eq!(limit(""), None);
    }
}
