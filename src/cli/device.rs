//! The device of a command, and its compiled pipelines on disk.

use std::path::PathBuf;

use regolith::error::Result;
use regolith::gpu::Gpu;
use regolith::input;
use regolith::output::{Artifact, disk};
use regolith::render::Renderer;

/// Largest size of the compiled pipelines of an adapter.
const MAX_CACHE_BYTES: u64 = 256 * input::MIB;

/// Opens an adapter, with the pipelines that an earlier run compiled for it.
pub(super) fn open(adapter: Option<&str>) -> Result<Gpu> {
    Gpu::open_with_cache(adapter, |key| input::read(&folder()?.join(key), MAX_CACHE_BYTES).ok())
}

/// Stores the compiled pipelines for the next run. If that fails, the next run compiles them again.
pub(super) fn store_pipelines(gpu: &Gpu) {
    if let (Some((key, bytes)), Some(folder)) = (gpu.changed_pipeline_cache(), folder()) {
        let _ = disk::write_all(&folder, &[Artifact { name: key.to_owned(), bytes }]);
    }
}

/// The cache folder (XDG Base Directory Specification); `None` if the environment names neither it nor a home.
fn folder() -> Option<PathBuf> {
    let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let caches = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")))?;
    Some(caches.join("regolith-render"))
}

/// Destroys the device if `REGOLITH_FAULT` is `device-lost`, so that tests can check how a lost GPU is handled.
pub(super) fn inject_fault(renderer: &Renderer) {
    if std::env::var("REGOLITH_FAULT").is_ok_and(|fault| fault == "device-lost") {
        renderer.gpu().device.destroy();
    }
}
