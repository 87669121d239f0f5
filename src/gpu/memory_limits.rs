//! Limits on the memory of the process and on its open files (`ulimit`). Drivers crash where they reach one of memory, so these are checked
//! before a driver is loaded, or, where they matter to one driver alone, before it opens a device.
//!
//! Must not know: adapters.

use std::path::PathBuf;

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

/// The limit on the size of files, where a driver keeps the memory of its devices in one. What frames of any size need of it: see
/// `render::tiling`.
const FILE_SIZE: MemoryLimit = MemoryLimit {
    line: "Max file size",
    what: "the size of files, in one of which this driver keeps its memory,",
    option: "-f",
    base_bytes: 1_000_000_000,
};
/// How the name of that file starts: Mesa's CPU driver (25.0) has an anonymous one (memfd).
const MEMORY_FILE: &str = "/memfd:allocation fd";

/// What the threads of each core need besides, for their stacks and arenas, bytes.
const BYTES_PER_CORE: u64 = 100_000_000;

/// Checks that the limits of this process, if there are any, leave what rendering needs.
///
/// # Errors
/// [`Error::MemoryLimit`].
pub(super) fn check() -> Result<()> {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    LIMITS.iter().try_for_each(|limit| limit.check(&limits, BYTES_PER_CORE * cores as u64))
}

/// Checks that the limit on the size of files, if there is one, leaves what rendering needs, if a driver that is loaded keeps the memory
/// of its devices in a file.
///
/// # Errors
/// [`Error::MemoryLimit`].
pub(super) fn check_memory_file() -> Result<()> {
    let open_files = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    if !is_memory_file_among(open_files.filter_map(|file| std::fs::read_link(file.path()).ok())) {
        return Ok(());
    }
    FILE_SIZE.check(&std::fs::read_to_string("/proc/self/limits").unwrap_or_default(), 0)
}

/// Files that a driver opens, with its libraries and devices; Mesa's CPU driver opens four.
#[cfg(unix)]
const DRIVER_FILES: usize = 16;

/// Checks that this process can open as many files as a driver needs. One that cannot open its own is not found.
///
/// # Errors
/// [`Error::OpenFiles`].
pub(super) fn check_open_files() -> Result<()> {
    #[cfg(unix)]
    (0..DRIVER_FILES)
        .map(|_| std::fs::File::open("/dev/null"))
        .collect::<std::io::Result<Vec<_>>>()
        .map_err(Error::OpenFiles)?;
    Ok(())
}

fn is_memory_file_among(mut paths: impl Iterator<Item = PathBuf>) -> bool {
    paths.any(|path| path.to_string_lossy().starts_with(MEMORY_FILE))
}

impl MemoryLimit {
    /// Checks that the soft limit in the text of `/proc/self/limits` leaves what is needed, with `more_bytes` besides.
    fn check(&self, limits: &str, more_bytes: u64) -> Result<()> {
        let needed_bytes = self.base_bytes + more_bytes;
        match soft_limit(limits, self.line) {
            Some(limit_bytes) if limit_bytes < needed_bytes => {
                Err(Error::MemoryLimit { what: self.what, option: self.option, limit_bytes, needed_bytes })
            }
            _ => Ok(()),
        }
    }
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

    #[test]
    fn a_file_of_device_memory_is_known_by_its_name() {
        let is_there = |names: &[&str]| is_memory_file_among(names.iter().map(PathBuf::from));
        assert!(is_there(&["/dev/null", "/memfd:allocation fd (deleted)"]));
        assert!(!is_there(&["/dev/null", "/memfd:xshmfence (deleted)", "/home/allocation fd"]));
        let limited = "Max file size             4096                 unlimited            bytes     \n";
        let message = FILE_SIZE.check(limited, 0).expect_err("4 KiB").to_string();
        assert!(
            message.contains("the size of files") && message.contains("ulimit -f unlimited"),
            "{message}"
        );
        assert!(FILE_SIZE.check(&limited.replace("4096     ", "unlimited"), 0).is_ok());
    }
}
