//! The two azimuths of the sun: from +Y, and from the camera's heading. One is set, the other follows.
//!
//! Must not know: where they were set.

use super::distribution::{Distribution, Value};
use super::knobs::Knob;

/// The azimuth that counts from the camera's heading.
pub(super) const RELATIVE: Knob = Knob::SunRelativeAzimuthDeg;

/// The other azimuth; `None` for all other knobs.
pub(super) fn other(knob: Knob) -> Option<Knob> {
    match knob {
        Knob::SunAzimuthDeg => Some(RELATIVE),
        RELATIVE => Some(Knob::SunAzimuthDeg),
        _ => None,
    }
}

/// Computes one azimuth from the other and the camera's yaw, in the values that were drawn for a frame.
pub(super) fn complete(drawn: &mut [Distribution], computed: Knob) {
    let number = |knob: Knob| match &drawn[knob as usize] {
        Distribution::Fixed(Value::Number(value)) => *value,
        _ => 0.0,
    };
    let yaw_deg = number(Knob::CameraYawDeg);
    let value = if computed == RELATIVE {
        let turned = (number(Knob::SunAzimuthDeg) - yaw_deg).rem_euclid(360.0);
        if turned > 180.0 { turned - 360.0 } else { turned }
    } else {
        (yaw_deg + number(RELATIVE)).rem_euclid(360.0)
    };
    drawn[computed as usize] = Distribution::number(value);
}
