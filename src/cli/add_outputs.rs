//! `dataset --add-outputs`: further outputs for a finished dataset.

use std::path::Path;
use std::time::Instant;

use crate::dataset::Concurrency;
use crate::dataset::add_outputs::{Added, Addition};
use crate::error::Result;
use serde_json::json;

use super::args::DeviceArgs;
use super::device as gpu_device;
use super::messages::{Messages, frames, print};
use super::process::stop_on_signals;
use super::progress::{Meter, duration};

/// Adds the outputs of a list to the dataset in a folder.
pub(super) fn run(
    folder: &Path,
    list: &str,
    device: &DeviceArgs,
    concurrency: Concurrency,
    is_json: bool,
    messages: Messages,
) -> Result<()> {
    let addition = Addition::new(folder, list)?;
    let start = Instant::now();
    let Added { made, finalized } = if addition.is_rendered() {
        addition.complete()?
    } else {
        let stop = stop_on_signals(messages)?;
        let gpu = device.open(messages)?;
        messages.note(format_args!("rendering on {}", crate::gpu::adapter::describe(&gpu.info)));
        let mut renderer = device.renderer(gpu)?;
        gpu_device::inject_fault(&renderer);
        let mut meter = Meter::new(messages, "frames");
        let result = addition.run(&mut renderer, concurrency, &stop, |found, made| {
            meter.show([found, made, addition.frames()], "");
        });
        meter.finish();
        let added = result?;
        gpu_device::store_pipelines(renderer.gpu());
        added
    };
    if is_json {
        let summary = json!({
            "out": folder.display().to_string(), "frames": finalized.manifest["n_completed"], "made": made,
            "outputs": finalized.manifest["outputs"], "status": finalized.manifest["status"],
        });
        print(&format!("{summary:#}\n"))?;
    } else {
        messages.paths(&format!("{}\n", folder.display()))?;
    }
    match made {
        0 => messages.note(format_args!("no frame was rendered: the dataset has these outputs")),
        made => messages.note(format_args!(
            "{} rendered again as before, in {}; the new outputs are added",
            frames(made),
            duration(start.elapsed().as_secs_f64())
        )),
    }
    Ok(())
}
