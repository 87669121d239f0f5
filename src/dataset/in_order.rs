//! Frames in the order in which they are wanted, from a pipeline that finishes them in any order.
//!
//! Must not know: what a frame is.

use std::collections::BTreeMap;

/// Frames that wait for an earlier one: never more than are in flight. The same index may be wanted more than once; any of its frames
/// serves.
pub(super) struct InOrder<Indices, Frame> {
    wanted: Indices,
    next: Option<u64>,
    waiting: BTreeMap<u64, Vec<Frame>>,
}

impl<Indices: Iterator<Item = u64>, Frame> InOrder<Indices, Frame> {
    /// Frames are wanted at these indices, in this order.
    pub(super) fn new(mut wanted: Indices) -> Self {
        let next = wanted.next();
        Self { wanted, next, waiting: BTreeMap::new() }
    }

    /// A frame is finished.
    pub(super) fn add(&mut self, index: u64, frame: Frame) {
        self.waiting.entry(index).or_default().push(frame);
    }

    /// The next frame, if it is finished.
    pub(super) fn take(&mut self) -> Option<Frame> {
        let index = self.next?;
        let frames = self.waiting.get_mut(&index)?;
        let frame = frames.pop();
        if frames.is_empty() {
            self.waiting.remove(&index);
        }
        self.next = self.wanted.next();
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_in_the_wanted_order_and_as_often_as_wanted() {
        let mut frames = InOrder::new([3, 1, 1, 2].into_iter());
        let mut taken = Vec::new();
        for finished in [1, 2, 3, 1] {
            frames.add(finished, finished);
            taken.extend(std::iter::from_fn(|| frames.take()));
        }
        assert_eq!(taken, [3, 1, 1, 2]);
        assert_eq!(frames.take(), None);
    }
}
