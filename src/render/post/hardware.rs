//! The label of the rover's parts.
//! Must not know: how they were drawn.

use crate::class::ClassId;
use crate::frame::Frame;

/// Labels what shows the rover as ignored, and counts it as such.
pub(crate) fn ignore(frame: &mut Frame) {
    for class in frame.class.iter_mut().filter(|class| **class == ClassId::HARDWARE.0) {
        *class = ClassId::UNLABELLED.0;
        frame.label_pixels.ignored += 1;
    }
}
