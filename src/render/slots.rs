//! Slots: the buffers that belong to one frame in flight.
//! Must not know: a scene.

use std::time::Instant;

use crate::error::Result;
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::render::device::timing::{Pass, StageTimes, Timer, milliseconds};
use crate::render::resolve::pass::PackedFrame;
use crate::render::settings::RenderSettings;

/// Slots that are kept for frames of other sizes.
const MAX_OTHER_SLOTS: usize = 3;

/// Buffers that belong to one frame in flight.
#[derive(Debug)]
pub(crate) struct Slot {
    pub(crate) packed: PackedFrame,
    pub(crate) timer: Option<Timer>,
}

impl Slot {
    /// Asks for the frame's results to be mapped once the device has written them: the wait for the frame maps them.
    pub(crate) fn map(&self) {
        self.packed.map();
        if let Some(timer) = &self.timer {
            timer.map();
        }
    }

    /// Waits for a tile that was submitted and reads it back, with the times of this and of the device's passes.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`]; [`Error::Unlabelled`] if a draw of it was lost.
    ///
    /// [`Error::Unlabelled`]: crate::Error::Unlabelled
    /// [`Error::DeviceLost`]: crate::Error::DeviceLost
    /// [`Error::Device`]: crate::Error::Device
    pub(crate) fn read(&self, gpu: &Gpu, tile: &TileSubmission) -> Result<(Frame, StageTimes)> {
        gpu.wait(&tile.index)?;
        let done = Instant::now();
        let planes = self.packed.read()?;
        let read = Instant::now();
        let mut times = match &self.timer {
            Some(timer) => timer.read(gpu, &tile.passes)?,
            None => StageTimes::new(),
        };
        let gpu_ms = milliseconds(done - tile.submitted);
        times.extend([("gpu", gpu_ms), ("readback", milliseconds(read - done))]);
        Ok((planes, times))
    }
}

/// The submission of a frame.
#[derive(Debug)]
pub(crate) enum Submission {
    /// The device draws it.
    Whole(Slot, TileSubmission),
    /// It was drawn in tiles, which are read back already.
    InTiles(Frame),
}

/// The submission of a tile, or of a whole frame, that the device draws.
#[derive(Debug)]
pub(crate) struct TileSubmission {
    pub(crate) index: wgpu::SubmissionIndex,
    pub(crate) submitted: Instant,
    pub(crate) record_ms: f64,
    /// Passes that the device times.
    pub(crate) passes: Vec<Pass>,
}

/// Slots of frames that are not in flight any more. Where frames of several sizes are drawn in turn, each finds its own again.
#[derive(Debug, Default)]
pub(crate) struct SlotPool {
    /// The oldest first.
    spare: Vec<Slot>,
}

impl SlotPool {
    /// A slot for an image with these settings: a kept one, or a new one in place of the oldest.
    pub(crate) fn take(&mut self, gpu: &Gpu, image: &RenderSettings) -> Slot {
        let &RenderSettings { size, annotations, .. } = image;
        if let Some(index) = self.spare.iter().rposition(|slot| slot.packed.serves(size, annotations)) {
            return self.spare.remove(index);
        }
        if self.spare.len() > MAX_OTHER_SLOTS {
            self.spare.remove(0);
        }
        Slot { packed: PackedFrame::new(gpu, size, annotations), timer: Timer::new(gpu) }
    }

    /// Keeps a slot for later frames.
    pub(crate) fn keep(&mut self, slot: Slot) {
        self.spare.push(slot);
    }

    /// Number of slots that are kept.
    #[cfg(test)]
    pub(crate) const fn len(&self) -> usize {
        self.spare.len()
    }
}
