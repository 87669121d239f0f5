//! Times of the stages: timestamps that the device takes at the start and end of each pass.
//! Must not know: what a pass draws.

use wgpu::{BufferUsages, Features};

use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::readback::ReadbackBuffer;

/// Milliseconds of one frame's work, by stage, in order. The device measures `shadow`, `visibility`, `lighting` and `resolve` where
/// it has timestamps, and these are left out where it has none; `shadow` and `visibility` are measured by the host where the host
/// rasterises them. `gpu` is all the time from submission to the end of the last pass, with that of frames that were submitted
/// before.
pub type StageTimes = Vec<(&'static str, f64)>;

/// A duration in milliseconds.
pub(crate) fn milliseconds(duration: std::time::Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Adds the times of a tile to those of others.
pub(crate) fn add_times(sum: &mut StageTimes, times: impl IntoIterator<Item = (&'static str, f64)>) {
    for (stage, ms) in times {
        match sum.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, of_stage)) => *of_stage += ms,
            None => sum.push((stage, ms)),
        }
    }
}

/// The stages that the device can time, in their order.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Pass {
    Shadow,
    Visibility,
    Lighting,
    Resolve,
}

impl Pass {
    const COUNT: usize = 4;

    /// Name of its stage.
    const fn name(self) -> &'static str {
        match self {
            Self::Shadow => "shadow",
            Self::Visibility => "visibility",
            Self::Lighting => "lighting",
            Self::Resolve => "resolve",
        }
    }
}

const QUERIES: u32 = 2 * Pass::COUNT as u32;
/// Offset from the timestamps of one pass to those of the next, which WebGPU aligns.
const PASS_BYTES: u64 = wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT;
/// Size of the buffer that queries are resolved to.
const BYTES: u64 = PASS_BYTES * Pass::COUNT as u64;

/// Timestamps at the start and end of every pass.
#[derive(Debug)]
pub(crate) struct Timer {
    queries: wgpu::QuerySet,
    buffer: wgpu::Buffer,
    readback: ReadbackBuffer,
}

impl Timer {
    /// `None` where the device has no timestamps.
    pub(crate) fn new(gpu: &Gpu) -> Option<Self> {
        gpu.device.features().contains(Features::TIMESTAMP_QUERY).then(|| Self {
            queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timing/queries"),
                ty: wgpu::QueryType::Timestamp,
                count: QUERIES,
            }),
            buffer: gpu.buffer(
                "timing/resolved",
                BYTES,
                BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC,
            ),
            readback: ReadbackBuffer::new(gpu, "timing/readback", BYTES),
        })
    }

    /// Timestamps of a stage of two passes: at the start of its render pass and at the end of its compute pass.
    pub(crate) fn render_and_compute_pass(
        &self,
        pass: Pass,
    ) -> (wgpu::RenderPassTimestampWrites<'_>, wgpu::ComputePassTimestampWrites<'_>) {
        (
            wgpu::RenderPassTimestampWrites { end_of_pass_write_index: None, ..self.render_pass(pass) },
            wgpu::ComputePassTimestampWrites {
                beginning_of_pass_write_index: None,
                ..self.compute_pass(pass)
            },
        )
    }

    /// Timestamps at start and end of a stage that is a render pass.
    pub(crate) const fn render_pass(&self, pass: Pass) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Timestamps at start and end of a stage that is a compute pass.
    pub(crate) const fn compute_pass(&self, pass: Pass) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Records the copy of the times of `passes` to where the host can read them. They must be those that were recorded: a device
    /// waits for ever for the timestamps of one that was not.
    pub(crate) fn copy(&self, encoder: &mut wgpu::CommandEncoder, passes: &[Pass]) {
        for &pass in passes {
            let queries = 2 * pass as u32..2 * pass as u32 + 2;
            encoder.resolve_query_set(&self.queries, queries, &self.buffer, PASS_BYTES * pass as u64);
        }
        self.readback.copy(encoder, &self.buffer, BYTES);
    }

    /// Asks for the times to be mapped once the device has finished what was submitted.
    pub(crate) fn map(&self) {
        self.readback.map();
    }

    /// The times of the passes that were recorded, after [`Self::map`] and the wait for the frame.
    pub(crate) fn read(&self, gpu: &Gpu, passes: &[Pass]) -> Result<StageTimes> {
        let to_ms = f64::from(gpu.queue.get_timestamp_period()) * 1e-6;
        self.readback.read(|bytes| {
            let tick = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap_or_default());
            let time = |&pass: &Pass| {
                let at = PASS_BYTES as usize * pass as usize;
                (pass.name(), tick(at + 8).saturating_sub(tick(at)) as f64 * to_ms)
            };
            passes.iter().map(time).collect()
        })
    }
}
