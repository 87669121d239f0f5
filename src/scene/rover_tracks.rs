//! Which tracks there are on the surface stage: those of the rover that carries the camera, and others that cross its view.
//!
//! Must not know: the mesh of the ground.

use glam::Vec2;

use super::azimuth;
use super::rover::{self, Rover};
use super::track::Track;
use crate::params::{Knob, Params};
use crate::random::Streams;

/// Length of a track on both sides of its point, metres; of the rover's own, behind it.
const LENGTH_M: f32 = 40.0;
/// The largest angle of an arc, radians.
const MAX_ARC: f32 = 2.4;
/// Element of the random streams of the rover's own track.
const OWN: u64 = u64::MAX;

/// The tracks of these parameters; offsets are from the camera's position on the ground.
#[must_use]
pub fn tracks(streams: &Streams, params: &Params) -> Vec<Track> {
    let own = (params.text(Knob::TracksOwn) == "yes")
        .then(|| Rover::build(params))
        .flatten()
        .map(|rover| own(streams, params, &rover));
    own.into_iter()
        .chain((0..params.count(Knob::TracksCount)).map(|k| crossing(streams, params, k.into())))
        .collect()
}

/// The track that the rover of the camera left as it came.
fn own(streams: &Streams, params: &Params, rover: &Rover) -> Track {
    let track = passing(streams, params, (rover.middle_below(params), rover.heading), OWN);
    // It ends below the front wheels.
    Track { span_m: [track.span_m[0], rover.front_axle_m()], ..track }
}

/// A track that crosses the view.
fn crossing(streams: &Streams, params: &Params, k: u64) -> Track {
    let draw = |knob: Knob| params.sample(knob, &mut streams.stream(knob.name(), k));
    let yaw_deg = params.number(Knob::CameraYawDeg);
    // Somewhere in the middle half of the view.
    let aside = streams.stream("tracks.aside", k).uniform(-0.25, 0.25) * params.number(Knob::CameraFovDeg);
    let offset = draw(Knob::TracksDistanceM) as f32 * azimuth::direction((yaw_deg + aside).to_radians());
    passing(
        streams,
        params,
        (offset, azimuth::direction((yaw_deg + draw(Knob::TracksDirectionDeg)).to_radians())),
        k,
    )
}

/// A track through a point along a unit vector.
fn passing(streams: &Streams, params: &Params, (offset, ahead): (Vec2, Vec2), k: u64) -> Track {
    let draw = |knob: Knob| params.sample(knob, &mut streams.stream(knob.name(), k)) as f32;
    let number = |knob| params.number(knob) as f32;
    let curvature_per_m = draw(Knob::TracksCurvaturePerM);
    let length_m = LENGTH_M.min(MAX_ARC / curvature_per_m.abs().max(1e-6));
    let wheel_m = number(Knob::RoverWheelM);
    Track {
        offset,
        ahead,
        curvature_per_m,
        span_m: [-length_m, length_m],
        gauge_m: rover::gauge_m(number(Knob::RoverWidthM), wheel_m),
        width_m: rover::WHEEL_WIDTH * wheel_m,
        depth_m: draw(Knob::TracksDepthM),
        grouser_m: number(Knob::TracksGrouserM),
        wheel_m,
        seed: streams.stream("tracks.seed", k).bits(),
    }
}
