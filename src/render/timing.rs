//! Times of the passes, taken by the device.

use wgpu::{BufferUsages, Features};

use super::StageTimes;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::readback::Readback;

/// The passes that are timed, in the order of their indices.
const PASSES: [&str; 4] = ["shadow", "visibility", "scene_pass", "resolve"];
const QUERIES: u32 = 2 * PASSES.len() as u32;
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

    pub(super) const fn render_pass(&self, pass: u32) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        }
    }

    pub(super) const fn compute_pass(&self, pass: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        }
    }

    pub(super) fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..QUERIES, &self.buffer, 0);
        self.readback.copy(encoder, &self.buffer, BYTES);
    }

    pub(super) fn read(&self, gpu: &Gpu, submission: &wgpu::SubmissionIndex) -> Result<StageTimes> {
        let to_ms = f64::from(gpu.queue.get_timestamp_period()) * 1e-6;
        self.readback.read(gpu, submission, |bytes| {
            let ticks: Vec<u64> = bytes
                .chunks_exact(8)
                .map(|tick| u64::from_le_bytes(tick.try_into().unwrap_or_default()))
                .collect();
            PASSES
                .iter()
                .zip(ticks.chunks_exact(2))
                .map(|(&name, pair)| (name, pair[1].saturating_sub(pair[0]) as f64 * to_ms))
                .collect()
        })
    }
}
