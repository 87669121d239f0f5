//! The graphics device: its adapter, its capabilities, its errors, and buffers to and from it.
//!
//! Errors of the device arrive asynchronously; they are stored and returned by [`Gpu::check`], so that a lost
//! device is an [`Error`], never a panic.
//! Must not know: the Moon.

pub mod adapter;
pub mod device_files;
pub mod growing_buffer;
pub mod growing_texture;
pub mod machine;
mod memory_limits;
pub mod pipeline_cache;
mod platform;
mod processor;
pub mod readback;
#[cfg(test)]
pub(crate) mod shader_check;
pub mod staging;
pub mod survey;
pub mod upload;
pub mod vendor;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use wgpu::{AdapterInfo, Backend, DownlevelFlags, Features, Limits};

use crate::error::{Error, Result};
use pipeline_cache::PipelineCache;

/// How long one frame may take before the device counts as lost.
const FRAME_TIMEOUT: Duration = Duration::from_secs(300);

/// What a device can do beyond what every supported device can; queried once, when it is opened.
#[derive(Clone, Copy, Debug)]
pub struct Capabilities {
    /// It rasterises on the CPU (Mesa's llvmpipe, for instance).
    pub software_adapter: bool,
    /// Depth-stencil textures can be written from buffers.
    pub stencil_upload: bool,
    /// One command can issue many indirect draws, each with its own first instance.
    pub multi_draw: bool,
    /// There is a depth format of 32 bits with a stencil beside it.
    pub depth_stencil: bool,
}

/// What is requested of a device beyond what rendering cannot do without.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Requested {
    /// All that its adapter offers and rendering gains from.
    #[default]
    Offered,
    /// No optional feature, and no limit beyond [`Limits::downlevel_defaults`]: every fall-back is taken.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests of the fall-backs request it"))]
    Least,
}

/// An open device with its queue.
#[derive(Debug)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Name, kind, backend and driver of its adapter.
    pub info: AdapterInfo,
    /// Its optional capabilities.
    pub capabilities: Capabilities,
    pipeline_cache: Option<PipelineCache>,
    pending_error: Arc<Mutex<Option<Error>>>,
    waits: AtomicU64,
}

impl Gpu {
    /// Opens the adapter whose name contains `wanted` (any case; `cpu` means any software adapter), or the best one: a
    /// discrete GPU before an integrated one before a software adapter, then Vulkan before GL. GL is tried where Vulkan has no match, and
    /// on machines with a GPU that Vulkan lacks.
    ///
    /// The environment variables `WGPU_BACKEND` (`vulkan`, `gl`; on macOS `metal`, on Windows `dx12` and `vulkan`) and, without `wanted`, `WGPU_ADAPTER_NAME` are
    /// honoured.
    ///
    /// # Errors
    /// [`Error::NoAdapter`], [`Error::MemoryLimit`], [`Error::AdapterNotFound`], [`Error::AdapterUnfit`] or
    /// [`Error::Usage`].
    pub fn open(wanted: Option<&str>) -> Result<Self> {
        Self::open_with_cache(wanted, |_| None)
    }

    /// Opens an adapter like [`Self::open`], with the compiled pipelines that `load` returns for a key of
    /// [`PipelineCache`].
    ///
    /// # Errors
    /// [`Error::NoAdapter`], [`Error::MemoryLimit`], [`Error::AdapterNotFound`], [`Error::AdapterUnfit`] or
    /// [`Error::Usage`].
    pub fn open_with_cache(wanted: Option<&str>, load: impl FnOnce(&str) -> Option<Vec<u8>>) -> Result<Self> {
        let adapter = adapter::choose(wanted)?;
        Self::open_adapter(&adapter, Requested::Offered, load)
    }

    /// Opens an adapter like [`Self::open`], and requests no more of it than `requested` says.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    #[cfg(test)]
    pub(crate) fn open_with(wanted: Option<&str>, requested: Requested) -> Result<Self> {
        Self::open_adapter(&adapter::choose(wanted)?, requested, |_| None)
    }

    fn open_adapter(
        adapter: &wgpu::Adapter,
        requested: Requested,
        load: impl FnOnce(&str) -> Option<Vec<u8>>,
    ) -> Result<Self> {
        let info = adapter.get_info();
        let unfit = |reason: String| Error::AdapterUnfit { adapter: info.name.clone(), reason };
        let missing = adapter::missing_of(adapter);
        if !missing.is_empty() {
            let remedy = if info.backend == Backend::Gl { "use Vulkan" } else { "update its driver" };
            return Err(unfit(format!("it lacks {}; {remedy}", missing.join(", "))));
        }
        // On GL such a driver has the file too, and keeps nothing in it.
        if adapter::is_software(&info) && info.backend == Backend::Vulkan {
            memory_limits::check_memory_file()?;
        }
        let (required_features, required_limits) = requested.of(&info, adapter.features(), &adapter.limits());
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("regolith/device"),
            required_features,
            required_limits,
            memory_hints: memory_hints(&info),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| unfit(one_line(&e.to_string())))?;
        let pending_error = Arc::new(Mutex::new(None));
        let (on_error, on_loss) = (Arc::clone(&pending_error), Arc::clone(&pending_error));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let error = match error {
                wgpu::Error::OutOfMemory { .. } => Error::OutOfMemory,
                other => Error::Device(one_line(&other.to_string())),
            };
            // The first error is the cause of those that follow it.
            on_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }));
        device.set_device_lost_callback(move |reason, message| {
            let message = if message.is_empty() { format!("{reason:?}") } else { one_line(&message) };
            // A loss explains the errors around it, so it replaces them.
            *on_loss.lock().unwrap_or_else(PoisonError::into_inner) = Some(Error::DeviceLost(message));
        });
        let flags = adapter.get_downlevel_capabilities().flags;
        let capabilities = Capabilities {
            software_adapter: adapter::is_software(&info),
            stencil_upload: flags.contains(DownlevelFlags::DEPTH_TEXTURE_AND_BUFFER_COPIES),
            multi_draw: flags.contains(DownlevelFlags::INDIRECT_EXECUTION)
                && device.features().contains(Features::INDIRECT_FIRST_INSTANCE),
            depth_stencil: device.features().contains(Features::DEPTH32FLOAT_STENCIL8),
        };
        let pipeline_cache = PipelineCache::new(&device, &info, load);
        Ok(Self {
            device,
            queue,
            info,
            capabilities,
            pipeline_cache,
            pending_error,
            waits: AtomicU64::new(0),
        })
    }

    /// The cache to create pipelines with.
    #[must_use]
    pub fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.pipeline_cache.as_ref().map(PipelineCache::handle)
    }

    /// Key and data of the compiled pipelines, for the next run; `None` if nothing has been compiled since they were
    /// loaded.
    #[must_use]
    pub fn changed_pipeline_cache(&self) -> Option<(&str, Vec<u8>)> {
        let cache = self.pipeline_cache.as_ref()?;
        Some((cache.key.as_str(), cache.changed_data()?))
    }

    /// Returns the first error of the device since the last call.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::OutOfMemory`] or [`Error::Device`].
    pub fn check(&self) -> Result<()> {
        let take = || self.pending_error.lock().unwrap_or_else(PoisonError::into_inner).take();
        match take() {
            None => Ok(()),
            Some(error) => {
                // On a lost device commands fail before the loss is reported; polling delivers the report.
                let _ = catch_unwind(AssertUnwindSafe(|| self.device.poll(wgpu::PollType::Poll)));
                Err(take().unwrap_or(error))
            }
        }
    }

    /// Waits until the device has finished this submission and all before it, then checks for errors.
    ///
    /// # Errors
    /// Those of [`Self::check`]; [`Error::DeviceLost`] also when the device does not answer for minutes.
    pub fn wait(&self, submission: &wgpu::SubmissionIndex) -> Result<()> {
        self.waits.fetch_add(1, Ordering::Relaxed);
        let submission_index = Some(submission.clone());
        let poll = wgpu::PollType::Wait { submission_index, timeout: Some(FRAME_TIMEOUT) };
        let outcome = self.guard(|| self.device.poll(poll))?;
        self.check()?;
        outcome.map(|_| ()).map_err(|error| lost(&error.to_string()))
    }

    /// Number of calls of [`Self::wait`] so far: each polls the device once.
    #[must_use]
    pub fn waits(&self) -> u64 {
        self.waits.load(Ordering::Relaxed)
    }

    /// Runs `work`, in which wgpu may panic if the device is lost, and returns such a panic as an error. Any other panic goes on.
    ///
    /// # Errors
    /// Those of [`Self::check`], or [`Error::DeviceLost`] with the panic's message.
    pub fn guard<T>(&self, work: impl FnOnce() -> T) -> Result<T> {
        catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
            let message = panic.downcast_ref::<String>().cloned().unwrap_or_default();
            match self.reported() {
                Some(error) => error,
                None if WGPU_PANICS.iter().any(|start| message.starts_with(start)) => lost(&message),
                None => resume_unwind(panic),
            }
        })
    }

    /// The error of a call that fails where the device is lost, with the device's own report instead if there is one.
    pub(crate) fn failure(&self, error: &dyn std::error::Error) -> Error {
        self.reported().unwrap_or_else(|| lost(&error.to_string()))
    }

    /// The first error that the device has reported or reports when it is polled.
    fn reported(&self) -> Option<Error> {
        let _ = catch_unwind(AssertUnwindSafe(|| self.device.poll(wgpu::PollType::Poll)));
        self.check().err()
    }

    /// Creates a buffer of at least `size` bytes, zeroed.
    #[must_use]
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        // A binding must not be empty, and the size of a copy is a multiple of four bytes.
        let size = size.next_multiple_of(4).max(256);
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Creates a 2-D texture with one mip level and one sample, and its view.
    #[must_use]
    pub fn texture(
        &self,
        label: &str,
        [width, height]: [u32; 2],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> (wgpu::Texture, wgpu::TextureView) {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        });
        let view =
            texture.create_view(&wgpu::TextureViewDescriptor { label: Some(label), ..Default::default() });
        (texture, view)
    }

    /// Writes the first `size` columns and rows of a texture; `texels` are in row-major order.
    pub fn write_texels<T: bytemuck::NoUninit>(&self, texture: &wgpu::Texture, size: [u32; 2], texels: &[T]) {
        let [width, height] = size;
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(width * size_of::<T>() as u32),
            rows_per_image: None,
        };
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        self.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(texels), layout, size);
    }
}

impl Requested {
    /// Features and limits to request of an adapter that offers these.
    fn of(self, info: &AdapterInfo, features: Features, offered: &Limits) -> (Features, Limits) {
        let wanted = Features::TIMESTAMP_QUERY
            | Features::INDIRECT_FIRST_INSTANCE
            | Features::PIPELINE_CACHE
            | Features::DEPTH32FLOAT_STENCIL8;
        match self {
            Self::Offered => (features & wanted, required_limits(info, offered)),
            Self::Least => (Features::empty(), Limits::downlevel_defaults().or_worse_values_from(offered)),
        }
    }
}

/// The limits that are requested of an adapter that offers these. None is beyond what it offers: where that is too little, what needs
/// more says so.
fn required_limits(info: &AdapterInfo, offered: &Limits) -> Limits {
    let base = if info.backend == Backend::Gl { Limits::downlevel_defaults() } else { Limits::defaults() };
    Limits {
        max_texture_dimension_2d: offered.max_texture_dimension_2d,
        max_color_attachments: offered.max_color_attachments.min(8),
        max_storage_textures_per_shader_stage: offered.max_storage_textures_per_shader_stage.min(8),
        max_color_attachment_bytes_per_sample: offered.max_color_attachment_bytes_per_sample.min(32),
        max_buffer_size: offered.max_buffer_size,
        max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
        ..base.or_worse_values_from(offered)
    }
}

/// How device memory is allocated. That of a software adapter is memory of the process: in large blocks much of it would lie idle.
fn memory_hints(info: &AdapterInfo) -> wgpu::MemoryHints {
    if adapter::is_software(info) {
        let range = 2 << 20..8 << 20;
        wgpu::MemoryHints::Manual { suballocated_device_memory_block_size: range }
    } else {
        wgpu::MemoryHints::Performance
    }
}

/// How the messages of wgpu's panics start.
const WGPU_PANICS: [&str; 2] = ["Error in ", "wgpu error: "];

/// The error of a lost device that has not reported why, with a message of wgpu.
fn lost(message: &str) -> Error {
    Error::DeviceLost(one_line(message))
}

/// A report of wgpu in one line: its causes, without the excerpts of shader text that naga adds in frames of box characters.
fn one_line(report: &str) -> String {
    let is_excerpt = |line: &&str| line.contains(['│', '┌', '╭', '╰', '└']);
    let lines = report.lines().map(str::trim).filter(|line| !line.is_empty() && *line != "Caused by:");
    lines.filter(|line| !is_excerpt(line)).collect::<Vec<_>>().join(": ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_a_shader_is_one_line_without_its_text() {
        let gpu = Gpu::open(Some(&adapter::adapter_of_tests())).expect("a device");
        let text = "fn half_of(x: f32) -> f32 {\n    return 0.5 * y;\n}\n";
        for text in
            [text, "@fragment fn fs_main() -> @location(0) vec4<f32> {\n    return vec4(1.0) + 1u;\n}\n"]
        {
            let _ = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("wrong"),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            });
            let message = gpu.check().expect_err("an error").to_string();
            assert!(message.contains("wrong") && message.contains("shader"), "{message}");
            assert!(!message.contains("return") && !message.contains('\n'), "{message}");
        }
    }
}
