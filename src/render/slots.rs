//! Slots: the buffers that belong to one frame in flight.
//! Must not know: a scene.

use crate::gpu::Gpu;
use crate::render::device::timing::Timer;
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
