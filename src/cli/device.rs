//! The device of a command, and its compiled pipelines on disk.

use std::path::PathBuf;

use crate::error::{Error, Result};
use crate::gpu::device_files::device_files;
use crate::gpu::machine::Machine;
use crate::gpu::{Gpu, adapter};
use crate::input;
use crate::output::{Artifact, disk};
use crate::render::Renderer;

use super::messages::Messages;

/// Largest size of the compiled pipelines of an adapter.
const MAX_CACHE_BYTES: u64 = 256 * input::MIB;

/// Opens an adapter, with the pipelines that an earlier run compiled for it. Says so if it is a CPU driver that nobody asked for
/// on a machine with a GPU.
pub(super) fn open(wanted: Option<&str>, messages: Messages) -> Result<Gpu> {
    adapter::check_environment()?;
    start_threads()?;
    let gpu = Gpu::open_with_cache(wanted, |key| input::read(&folder()?.join(key), MAX_CACHE_BYTES).ok())?;
    let is_chosen =
        wanted.is_some() || std::env::var_os("WGPU_ADAPTER_NAME").is_some_and(|name| !name.is_empty());
    if gpu.capabilities.software_adapter
        && !is_chosen
        && let Some(file) = device_files(&Machine::here()).first()
    {
        messages.note(format_args!(
            "warning: rendering on the CPU ({}), although {} belongs to {} GPU: `regolith-render doctor` says what its driver \
             lacks; --adapter cpu silences this warning",
            adapter::describe(&gpu.info),
            file.path,
            file.vendor.with_article()
        ));
    }
    Ok(gpu)
}

/// Starts the threads of parallel loops. Without this the first loop does, which panics where the system has no threads to spare.
pub(super) fn start_threads() -> Result<()> {
    let started = rayon::ThreadPoolBuilder::new().build_global();
    // There may be such threads already, as an earlier command in the same process started them.
    let refusal = started.err().filter(|error| std::error::Error::source(error).is_some());
    refusal.map_or(Ok(()), |error| Err(Error::Thread(std::io::Error::other(error))))
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
