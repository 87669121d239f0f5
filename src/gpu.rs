//! The graphics device: which adapter, what it may do, what happened to it.
//!
//! Errors of the device arrive asynchronously; they are kept and come out of [`Gpu::check`], so that a lost
//! device is an [`Error`], never a panic.
//! Must not know: the Moon.

pub mod programs;
pub mod readback;
pub mod staging;
pub mod store;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use wgpu::{
    AdapterInfo, Backend, Backends, DeviceType, DownlevelFlags, Features, InstanceDescriptor, InstanceFlags,
    Limits,
};

use crate::error::{Error, Result};
use programs::Programs;

/// Longest time that one frame may take before the device is given up.
const FRAME_TIMEOUT: Duration = Duration::from_secs(300);

/// An open device with its queue.
#[derive(Debug)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Which adapter it is.
    pub info: AdapterInfo,
    /// Whether stencils can be written to it.
    pub takes_stencils: bool,
    /// Whether it takes many draws in one command.
    pub draws_many: bool,
    /// Its compiled programs, if the backend gives them out.
    pub programs: Option<Programs>,
    trouble: Arc<Mutex<Option<Error>>>,
}

impl Gpu {
    /// Opens the adapter whose name contains `wanted` (any case; `cpu` means any CPU driver), or the best there
    /// is: a discrete GPU before an integrated one before a CPU driver, Vulkan before GL.
    ///
    /// The environment variables `WGPU_BACKEND` (`vulkan`, `gl`) and, without `wanted`, `WGPU_ADAPTER_NAME` are
    /// heeded.
    ///
    /// # Errors
    /// [`Error::NoAdapter`], [`Error::AdapterNotFound`], [`Error::AdapterUnfit`] or [`Error::Usage`].
    pub fn open(wanted: Option<&str>) -> Result<Self> {
        Self::open_with(wanted, |_| None)
    }

    /// The same, with the compiled programs that `kept` gives for a key of [`Programs`].
    ///
    /// # Errors
    /// [`Error::NoAdapter`], [`Error::AdapterNotFound`], [`Error::AdapterUnfit`] or [`Error::Usage`].
    pub fn open_with(wanted: Option<&str>, kept: impl FnOnce(&str) -> Option<Vec<u8>>) -> Result<Self> {
        let from_environment = std::env::var("WGPU_ADAPTER_NAME").ok().filter(|name| !name.is_empty());
        let wanted = wanted.map(str::to_owned).or(from_environment);
        // GL is only looked at where Vulkan has nothing: its libraries are slow to load and noisy.
        let allowed = backends_allowed()?;
        let rounds = allowed.map_or_else(|| vec![Backends::VULKAN, Backends::GL], |allowed| vec![allowed]);
        let mut seen = Vec::new();
        for backends in rounds {
            let adapters = enumerate(backends);
            seen.extend(adapters.iter().map(|adapter| describe(&adapter.get_info())));
            let best = adapters
                .into_iter()
                .filter(|adapter| wanted.as_deref().is_none_or(|text| matches(&adapter.get_info(), text)))
                .min_by_key(|adapter| rank(&adapter.get_info()));
            if let Some(adapter) = best {
                return Self::open_adapter(&adapter, kept);
            }
        }
        Err(match wanted {
            Some(wanted) if !seen.is_empty() => Error::AdapterNotFound { wanted, available: seen },
            _ => no_adapter(),
        })
    }

    fn open_adapter(adapter: &wgpu::Adapter, kept: impl FnOnce(&str) -> Option<Vec<u8>>) -> Result<Self> {
        let info = adapter.get_info();
        let unfit = |reason: String| Error::AdapterUnfit { adapter: info.name.clone(), reason };
        let offered = adapter.limits();
        let base =
            if info.backend == Backend::Gl { Limits::downlevel_defaults() } else { Limits::defaults() };
        let required_limits = Limits {
            max_texture_dimension_2d: offered.max_texture_dimension_2d,
            max_color_attachments: offered.max_color_attachments.min(8),
            max_color_attachment_bytes_per_sample: offered.max_color_attachment_bytes_per_sample.min(32),
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            ..base
        };
        let wanted = Features::TIMESTAMP_QUERY | Features::INDIRECT_FIRST_INSTANCE | Features::PIPELINE_CACHE;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("regolith/device"),
            required_features: Features::DEPTH32FLOAT_STENCIL8 | (adapter.features() & wanted),
            required_limits,
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| unfit(e.to_string()))?;
        let trouble = Arc::new(Mutex::new(None));
        let note = |error: Error, trouble: &Mutex<Option<Error>>| {
            let mut first = trouble.lock().unwrap_or_else(PoisonError::into_inner);
            first.get_or_insert(error);
        };
        let (on_error, on_loss) = (Arc::clone(&trouble), Arc::clone(&trouble));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let error = match error {
                wgpu::Error::OutOfMemory { .. } => Error::OutOfMemory,
                other => Error::Device(other.to_string().trim().to_owned()),
            };
            note(error, &on_error);
        }));
        device.set_device_lost_callback(move |reason, message| {
            let message = if message.is_empty() { format!("{reason:?}") } else { message };
            // A loss explains the errors around it, so it replaces them.
            *on_loss.lock().unwrap_or_else(PoisonError::into_inner) = Some(Error::DeviceLost(message));
        });
        let flags = adapter.get_downlevel_capabilities().flags;
        let takes_stencils = flags.contains(DownlevelFlags::DEPTH_TEXTURE_AND_BUFFER_COPIES);
        let draws_many = flags.contains(DownlevelFlags::INDIRECT_EXECUTION)
            && device.features().contains(Features::INDIRECT_FIRST_INSTANCE);
        let programs = Programs::new(&device, &info, kept);
        Ok(Self { device, queue, info, takes_stencils, draws_many, programs, trouble })
    }

    /// What pipelines are made with.
    #[must_use]
    pub fn pipeline_cache(&self) -> Option<&wgpu::PipelineCache> {
        self.programs.as_ref().map(Programs::cache)
    }

    /// The first thing that went wrong on the device since the last call.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn check(&self) -> Result<()> {
        let first = || self.trouble.lock().unwrap_or_else(PoisonError::into_inner).take();
        match first() {
            None => Ok(()),
            Some(error) => {
                // On a lost device commands fail before the loss is told: a poll brings the news.
                let _ = catch_unwind(AssertUnwindSafe(|| self.device.poll(wgpu::PollType::Poll)));
                Err(first().unwrap_or(error))
            }
        }
    }

    /// Waits until the device has done what was submitted with this index and before, and checks it.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`], also when the device does not answer for minutes.
    pub fn wait(&self, submission: &wgpu::SubmissionIndex) -> Result<()> {
        let submission_index = Some(submission.clone());
        let poll = wgpu::PollType::Wait { submission_index, timeout: Some(FRAME_TIMEOUT) };
        let outcome = self.guard(|| self.device.poll(poll))?;
        self.check()?;
        outcome.map(|_| ()).map_err(|e| Error::DeviceLost(e.to_string()))
    }

    /// Runs `work`, in which wgpu may panic if the device is lost, and gives such a panic back as an error.
    ///
    /// # Errors
    /// What [`Self::check`] says of the loss, or [`Error::DeviceLost`] with the panic's message.
    pub fn guard<T>(&self, work: impl FnOnce() -> T) -> Result<T> {
        catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
            let message = panic.downcast_ref::<String>().map_or("the driver gave up", String::as_str);
            self.check().err().unwrap_or_else(|| Error::DeviceLost(message.to_owned()))
        })
    }

    /// A buffer that is not yet written.
    #[must_use]
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        // Bindings must not be empty, and copies go by four bytes.
        let size = size.next_multiple_of(4).max(256);
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// A 2-D texture of one level and one sample, and its view.
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

    /// Writes texels, row by row, from the first on: so many columns and rows.
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

/// Every adapter that can be used, best first; at least one.
///
/// # Errors
/// [`Error::NoAdapter`], [`Error::Usage`] for a `WGPU_BACKEND` that there is not.
pub fn adapters() -> Result<Vec<AdapterInfo>> {
    let backends = backends_allowed()?.unwrap_or(Backends::VULKAN | Backends::GL);
    let mut infos: Vec<AdapterInfo> = enumerate(backends).iter().map(wgpu::Adapter::get_info).collect();
    infos.sort_by_key(rank);
    if infos.is_empty() { Err(no_adapter()) } else { Ok(infos) }
}

/// The backends that `WGPU_BACKEND` allows, if it says anything.
fn backends_allowed() -> Result<Option<Backends>> {
    let named = std::env::var("WGPU_BACKEND").unwrap_or_default();
    let words = named.split(',').map(|word| word.trim().to_lowercase()).filter(|word| !word.is_empty());
    words
        .map(|word| match word.as_str() {
            "vulkan" | "vk" => Ok(Backends::VULKAN),
            "gl" | "gles" | "opengl" => Ok(Backends::GL),
            _ => Err(Error::Usage(format!(
                "WGPU_BACKEND={named}: unknown backend `{word}`; there are vulkan and gl"
            ))),
        })
        .try_fold(None, |allowed, backend| Ok(Some(allowed.unwrap_or(Backends::empty()) | backend?)))
}

fn no_adapter() -> Error {
    let named = std::env::var("WGPU_BACKEND").unwrap_or_default();
    let limit = if named.is_empty() { String::new() } else { format!(" (WGPU_BACKEND allows only {named})") };
    Error::NoAdapter(limit)
}

/// One line about an adapter: name, kind, backend, driver.
#[must_use]
pub fn describe(info: &AdapterInfo) -> String {
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ");
    format!("{} ({}, {}, {})", info.name, kind(info), info.backend, driver.trim())
}

/// What sort of hardware an adapter is.
#[must_use]
pub const fn kind(info: &AdapterInfo) -> &'static str {
    match info.device_type {
        DeviceType::DiscreteGpu => "discrete GPU",
        DeviceType::IntegratedGpu => "integrated GPU",
        DeviceType::VirtualGpu => "virtual GPU",
        DeviceType::Cpu => "CPU driver",
        DeviceType::Other => "other",
    }
}

fn enumerate(backends: Backends) -> Vec<wgpu::Adapter> {
    let mut descriptor = InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
    // Indirect draws are this program's own: checking them would cost a compute pass.
    descriptor.flags = descriptor.flags.difference(InstanceFlags::VALIDATION_INDIRECT_CALL).with_env();
    pollster::block_on(wgpu::Instance::new(descriptor).enumerate_adapters(backends))
}

fn matches(info: &AdapterInfo, wanted: &str) -> bool {
    let wanted = wanted.to_lowercase();
    (wanted == "cpu" && is_cpu(info)) || describe(info).to_lowercase().contains(&wanted)
}

/// Whether an adapter rasterises on the CPU. GL does not say that llvmpipe does, so its name has to.
#[must_use]
pub fn is_cpu(info: &AdapterInfo) -> bool {
    info.device_type == DeviceType::Cpu || info.name.contains("llvmpipe") || info.name.contains("softpipe")
}

fn rank(info: &AdapterInfo) -> (u8, bool) {
    let kind = match info.device_type {
        _ if is_cpu(info) => 4,
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other | DeviceType::Cpu => 3,
    };
    (kind, info.backend == Backend::Gl)
}
