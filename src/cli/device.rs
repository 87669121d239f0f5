//! The device of a command, and its compiled programs on disk.

use std::path::PathBuf;

use regolith::error::Result;
use regolith::gpu::Gpu;
use regolith::output::{Artifact, disk};

/// Opens an adapter, with the programs that an earlier run compiled for it.
pub(super) fn open(adapter: Option<&str>) -> Result<Gpu> {
    Gpu::open_with(adapter, |key| disk::read(&folder()?.join(key)).ok())
}

/// Keeps what was compiled, for the next run. Where it cannot be kept, that run compiles it again.
pub(super) fn keep_programs(gpu: &Gpu) {
    let new = gpu.programs.as_ref().and_then(|programs| Some((&programs.key, programs.to_keep()?)));
    if let (Some((key, bytes)), Some(folder)) = (new, folder()) {
        let _ = disk::write_all(&folder, &[Artifact { name: key.clone(), bytes }]);
    }
}

/// Where caches go (XDG Base Directory Specification): none if the system has no place for them.
fn folder() -> Option<PathBuf> {
    let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let caches = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")))?;
    Some(caches.join("regolith-render"))
}
