//! Times of the passes, taken by the device.

use wgpu::{BufferUsages, Features};

use super::StageTimes;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;

/// The passes that are timed, in their order.
#[derive(Clone, Copy, Debug)]
pub(super) enum Pass {
    Shadow,
    Visibility,
    Scene,
    Resolve,
}

impl Pass {
    const ALL: [(Self, &str); 4] = [
        (Self::Shadow, "shadow"),
        (Self::Visibility, "visibility"),
        (Self::Scene, "scene_pass"),
        (Self::Resolve, "resolve"),
    ];
}

const QUERIES: u32 = 2 * Pass::ALL.len() as u32;
const BYTES: u64 = 8 * QUERIES as u64;

/// Timestamps at the start and end of every pass.
#[derive(Debug)]
pub(super) struct Timer {
    queries: wgpu::QuerySet,
    buffer: wgpu::Buffer,
    readback: Readback,
}

impl Timer {
    /// `None` where the device has no timestamps.
    pub(super) fn new(gpu: &Gpu) -> Option<Self> {
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
            readback: Readback::new(gpu, "timing/readback", BYTES),
        })
    }

    /// Of a stage that is two passes, the start of one and the end of the other.
    pub(super) fn both_passes(
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

    pub(super) const fn render_pass(&self, pass: Pass) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    pub(super) const fn compute_pass(&self, pass: Pass) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Records the copy of the times to where the program can read them. `first` is the first pass that was recorded: a device
    /// waits for ever for one that was not.
    pub(super) fn copy(&self, encoder: &mut wgpu::CommandEncoder, first: Pass) {
        encoder.resolve_query_set(&self.queries, 2 * first as u32..QUERIES, &self.buffer, 0);
        self.readback.copy(encoder, &self.buffer, BYTES);
    }

    /// Waits for the times, from that of the pass which was recorded first.
    pub(super) fn read(
        &self,
        gpu: &Gpu,
        submission: &wgpu::SubmissionIndex,
        first: Pass,
    ) -> Result<StageTimes> {
        let to_ms = f64::from(gpu.queue.get_timestamp_period()) * 1e-6;
        self.readback.read(gpu, submission, |bytes| {
            let ticks: Vec<u64> = bytes
                .chunks_exact(8)
                .map(|tick| u64::from_le_bytes(tick.try_into().unwrap_or_default()))
                .collect();
            Pass::ALL[first as usize..]
                .iter()
                .zip(ticks.chunks_exact(2))
                .map(|(&(_, name), pair)| (name, pair[1].saturating_sub(pair[0]) as f64 * to_ms))
                .collect()
        })
    }
}
