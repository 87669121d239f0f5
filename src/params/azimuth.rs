//! The two azimuths of the sun: from +Y, and from the camera's heading. One is set, the other follows.
//!
//! Must not know: where they were set.

use super::distribution::{Distribution, Value};
use super::knobs::Knob;

/// The other azimuth; `None` for all other knobs.
pub(super) fn other(knob: Knob) -> Option<Knob> {
    match knob {
        Knob::SunAzimuthDeg => Some(Knob::SunRelativeAzimuthDeg),
        Knob::SunRelativeAzimuthDeg => Some(Knob::SunAzimuthDeg),
        _ => None,
    }
}

/// Computes one azimuth from the other and the camera's yaw, in the values that were drawn for a frame.
pub(super) fn complete(drawn: &mut [Distribution], is_relative: bool) {
    let number = |knob: Knob| match &drawn[knob as usize] {
        Distribution::Fixed(Value::Number(value)) => *value,
        _ => 0.0,
    };
    let yaw_deg = number(Knob::CameraYawDeg);
    let (knob, value) = if is_relative {
        (Knob::SunAzimuthDeg, (yaw_deg + number(Knob::SunRelativeAzimuthDeg)).rem_euclid(360.0))
    } else {
        let turned = (number(Knob::SunAzimuthDeg) - yaw_deg).rem_euclid(360.0);
        (Knob::SunRelativeAzimuthDeg, if turned > 180.0 { turned - 360.0 } else { turned })
    };
    drawn[knob as usize] = Distribution::number(value);
}
