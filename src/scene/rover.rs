//! The rover that carries the camera: a silhouette of boxes and cylinders around the camera's mast.
//!
//! Its parts are bodies like rocks, with a mesh each, so that they cast shadows by the same maps. The default dimensions are about
//! those of Yutu: 1.5 m long, 1.0 m wide, six wheels of 0.30 m, cameras on a mast at the front.
//! Must not know: how it is drawn.

use glam::{Vec2, Vec3};

use super::azimuth;
use super::mesh::{Icosphere, Vertex};
use super::rocks::lunar::{PRESSED_M, Placement};
use super::rocks::{Body, Material, Rock};
use super::terrain::Terrain;
use crate::params::{Knob, Params};

/// Icosphere level of the parts.
const LEVEL: usize = 4;
/// Vertices of a part that are nearer to an edge than this, in half extents, lie on the edge: no triangle of [`LEVEL`] then cuts it.
const SNAP: f32 = 0.85;
/// Distance of the front of the camera head, and of the axis of the mast, behind the eye, metres: neither is ever in view of a camera
/// that does not look at itself.
const HEAD_BEHIND_M: f32 = 0.02;
const MAST_BEHIND_M: f32 = 0.12;
/// Half extents of the camera head across, along and upwards, metres.
const HEAD_M: [f32; 3] = [0.22, 0.08, 0.07];
/// Radius of the mast, metres.
const MAST_RADIUS_M: f32 = 0.035;
/// Distance of the mast from the front of the body, metres.
const MAST_FROM_FRONT_M: f32 = 0.15;
/// Height of the eye above the deck below which the camera is mounted on the front of the body, without a mast, metres.
const MIN_MAST_M: f32 = 0.25;
/// Distance of the body's front behind such an eye, metres.
const BODY_BEHIND_M: f32 = 0.05;
/// Height of the body, and half thickness of a solar panel and of the rockers that carry the wheels, metres.
const BODY_OF_DECK: f32 = 0.5;
const PANEL_HALF_M: f32 = 0.012;
const ROCKER_HALF_M: f32 = 0.025;
/// Width of a wheel, in diameters (Yutu: 0.15 of 0.30 m).
pub const WHEEL_WIDTH: f32 = 0.5;
/// Positions of the three axles from the middle of the body, in lengths of the body.
const AXLES: [f32; 3] = [-0.42, 0.0, 0.42];
/// Depth that the wheels sink in, metres: 1 to 2 cm in lunar soil.
const SINKAGE_M: f32 = 0.015;
/// Least distance of a wheel below a solar panel, metres.
const CLEARANCE_M: f32 = 0.02;
/// Overlap of a solar panel with the deck, metres.
const OVERLAP_M: f32 = 0.02;
/// Diffuse reflectance of painted hardware, of solar cells and of wheels.
const PAINT: Vec3 = Vec3::new(0.24, 0.235, 0.225);
const CELLS: Vec3 = Vec3::new(0.03, 0.035, 0.055);
const METAL: Vec3 = Vec3::new(0.12, 0.12, 0.12);

/// Dimensions and pose of a rover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rover {
    /// Unit vector along which it heads, horizontal.
    pub heading: Vec2,
    /// Length and width of the body, metres.
    pub size_m: [f32; 2],
    /// Height of the deck above the ground between the wheels, metres.
    pub deck_m: f32,
    /// Width of each of the two solar panels, metres; 0 for none.
    pub panel_m: f32,
    /// Diameter of a wheel, metres.
    pub wheel_m: f32,
    /// Whether the camera sees it.
    pub is_visible: bool,
}

/// The surface of a part before it is scaled: a cube or a cylinder along x, both of half extent 1.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Box,
    Cylinder,
}

impl Shape {
    /// Point and normal of the surface in a direction from its centre; near an edge, on the edge.
    fn at(self, direction: Vec3) -> (Vec3, Vec3) {
        match self {
            Self::Box => {
                let size = direction.abs();
                let point = direction / size.max_element();
                let on_edge = point.to_array().map(|x| if x.abs() > SNAP { x.signum() } else { x });
                let faces = on_edge.map(|x| if x.abs() >= 1.0 { x.signum() } else { 0.0 });
                let normal = Vec3::from(faces);
                (on_edge.into(), normal / normal.length())
            }
            Self::Cylinder => {
                let radius = libm::hypotf(direction.y, direction.z);
                let (along, around) = (direction.x.abs(), Vec3::new(0.0, direction.y, direction.z));
                let point = direction / along.max(radius);
                let (of_cap, of_side) = (point.x.abs(), libm::hypotf(point.y, point.z));
                let round = if radius > 0.0 { around / radius } else { Vec3::ZERO };
                let cap = Vec3::X * direction.x.signum();
                if of_cap.min(of_side) > SNAP {
                    let normal = cap + round;
                    (normal, normal / normal.length())
                } else if along > radius {
                    (point, cap)
                } else {
                    (point, round)
                }
            }
        }
    }
}

/// A part: its shape, half extents along its own axes, and these axes and its centre in the world, metres.
struct Part {
    shape: Shape,
    half_m: Vec3,
    axes: [Vec3; 3],
    centre: Vec3,
    albedo: Vec3,
}

impl Part {
    fn body(&self, index: u32, is_visible: bool) -> Rock {
        let to_world = |v: Vec3| v.x * self.axes[0] + v.y * self.axes[1] + v.z * self.axes[2];
        let directions = &Icosphere::shared().directions[..Icosphere::vertex_count(LEVEL)];
        let vertices: Vec<Vertex> = directions
            .iter()
            .map(|direction| {
                let (point, normal) = self.shape.at(*direction);
                let normal = to_world(normal / self.half_m);
                Vertex { position: to_world(point * self.half_m), normal: normal / normal.length() }
            })
            .collect();
        let material = Material { albedo: self.albedo, roughness: 0.3 };
        let mut part = Rock::of_vertices(index, (&vertices[..]).into(), LEVEL, material);
        part.centre = self.centre;
        part.body = Body::Hardware { is_visible };
        part
    }
}

/// Leaves out the rocks that are in the way of the rover of these parameters, which stands around `centre` (metres, world), if there is
/// one: all but those that its wheels press into the soil.
pub fn remove_overlapping_rocks(params: &Params, centre: Vec2, placements: &mut Vec<Placement>) {
    let Some(rover) = Rover::build(params) else { return };
    let middle = centre + rover.middle_below(params);
    placements.retain(|rock| rock.diameter_m < PRESSED_M || !rover.overlaps(rock.position - middle, rock));
}

/// Distance of the middles of the wheels on both sides, metres, for a body and wheels of this width and diameter, metres.
#[must_use]
pub fn gauge_m(width_m: f32, wheel_m: f32) -> f32 {
    width_m + 4.0 * ROCKER_HALF_M + WHEEL_WIDTH * wheel_m
}

impl Rover {
    /// The rover of these parameters; `None` if there is none.
    #[must_use]
    pub fn build(params: &Params) -> Option<Self> {
        if params.text(Knob::RoverKind) != "rover" {
            return None;
        }
        let number = |knob| params.number(knob) as f32;
        let azimuth = (params.number(Knob::CameraYawDeg) + params.number(Knob::RoverHeadingDeg)).to_radians();
        Some(Self {
            heading: azimuth::direction(azimuth),
            size_m: [number(Knob::RoverLengthM), number(Knob::RoverWidthM)],
            deck_m: number(Knob::RoverDeckM),
            panel_m: number(Knob::RoverPanelM),
            wheel_m: number(Knob::RoverWheelM),
            is_visible: params.text(Knob::RoverVisible) == "yes",
        })
    }

    /// The middle of its body, metres, seen from above, relative to a camera that looks along the azimuth of `view` this far above the
    /// deck, metres.
    #[must_use]
    pub fn middle(&self, view: Vec2, above_deck_m: f32) -> Vec2 {
        let has_mast = above_deck_m >= MIN_MAST_M;
        let mast = if has_mast { -MAST_BEHIND_M * view } else { Vec2::ZERO };
        let from_front_m = if has_mast { -MAST_FROM_FRONT_M } else { BODY_BEHIND_M };
        mast - (0.5 * self.size_m[0] + from_front_m) * self.heading
    }

    /// The same for the camera of these parameters on level ground.
    #[must_use]
    pub fn middle_below(&self, params: &Params) -> Vec2 {
        let view = azimuth::direction(params.number(Knob::CameraYawDeg).to_radians());
        self.middle(view, params.number(Knob::CameraHeightM) as f32 - self.deck_m)
    }

    /// Whether a rock at an offset from the middle seen from above, metres, is below or between the wheels of a side, or reaches the body
    /// or a solar panel.
    fn overlaps(&self, offset: Vec2, rock: &Placement) -> bool {
        let (along_m, across_m) = (offset.dot(self.heading).abs(), offset.perp_dot(self.heading).abs());
        let [length_m, width_m] = self.size_m;
        let radius_m = 0.5 * rock.diameter_m as f32;
        let is_below = |half_width_m: f32, clearance_m: f32| {
            rock.max_height_m() > clearance_m
                && along_m <= 0.5 * length_m + radius_m
                && across_m <= half_width_m + radius_m
        };
        let from_wheels_m = (across_m - 0.5 * gauge_m(width_m, self.wheel_m)).abs();
        let is_at_wheels = along_m <= self.front_axle_m() + 0.5 * self.wheel_m + radius_m
            && from_wheels_m <= 0.5 * WHEEL_WIDTH * self.wheel_m + radius_m;
        is_at_wheels
            || is_below(0.5 * width_m, self.deck_m - self.body_m())
            || is_below(0.5 * width_m + self.panel_m, self.deck_m)
    }

    /// Distance of the front wheels from the middle, metres.
    #[must_use]
    pub fn front_axle_m(&self) -> f32 {
        AXLES[2] * self.size_m[0]
    }

    /// Its parts, with indices from `first` on, for a camera at `eye` that looks along the azimuth of `view`.
    #[must_use]
    pub fn parts(&self, terrain: &Terrain, eye: Vec3, view: Vec2, first: u32) -> Vec<Rock> {
        let has_mast = self.above_deck_m(terrain, eye) >= MIN_MAST_M;
        let pose = self.pose(terrain, eye, view);
        let axes @ [right, _, up] = pose.axes;
        let view = view.extend(0.0);
        let [length_m, width_m] = self.size_m;
        let mut parts = Vec::new();
        let mut add_box = |half_m: [f32; 3], axes, centre, albedo| {
            parts.push(Part { shape: Shape::Box, half_m: half_m.into(), axes, centre, albedo });
        };
        let (deck, body_m) = (pose.deck, self.body_m());
        add_box([0.5 * width_m, 0.5 * length_m, 0.5 * body_m], axes, deck - 0.5 * body_m * up, PAINT);
        if has_mast {
            let head = [view.cross(Vec3::Z), view, Vec3::Z];
            add_box(HEAD_M, head, eye - (HEAD_BEHIND_M + HEAD_M[1]) * view, PAINT);
        }
        for side in [-1.0, 1.0] {
            let beside_m = side * (0.5 * width_m + ROCKER_HALF_M);
            let rocker = deck + beside_m * right - (self.deck_m - self.wheel_m) * up;
            add_box([ROCKER_HALF_M, -AXLES[0] * length_m, ROCKER_HALF_M], axes, rocker, METAL);
            if self.panel_m > 0.0 {
                let from_middle_m = 0.5 * (width_m + self.panel_m) - OVERLAP_M;
                let panel = deck + side * from_middle_m * right;
                add_box([0.5 * self.panel_m, 0.5 * length_m, PANEL_HALF_M], axes, panel, CELLS);
            }
        }
        if has_mast {
            let axis = (eye - MAST_BEHIND_M * view).truncate();
            let (low, high) = (pose.deck_height_at(axis), eye.z - HEAD_M[2]);
            parts.push(Part {
                shape: Shape::Cylinder,
                half_m: Vec3::new(0.5 * (high - low), MAST_RADIUS_M, MAST_RADIUS_M),
                axes: [Vec3::Z, Vec3::X, Vec3::Y],
                centre: axis.extend(0.5 * (low + high)),
                albedo: PAINT,
            });
        }
        let (radius_m, half_width_m) = (0.5 * self.wheel_m, 0.5 * WHEEL_WIDTH * self.wheel_m);
        for below in pose.wheels {
            parts.push(Part {
                shape: Shape::Cylinder,
                half_m: Vec3::new(half_width_m, radius_m, radius_m),
                axes,
                centre: below + (radius_m - SINKAGE_M) * up,
                albedo: METAL,
            });
        }
        (first..).zip(parts).map(|(index, part)| part.body(index, self.is_visible)).collect()
    }

    /// Height of the body, metres.
    fn body_m(&self) -> f32 {
        BODY_OF_DECK * self.deck_m
    }

    /// Height of an eye above the deck of a rover that stands on level ground below it, metres.
    fn above_deck_m(&self, terrain: &Terrain, eye: Vec3) -> f32 {
        eye.z - terrain.height_at(eye.truncate()) - self.deck_m
    }

    /// How it stands on the ground: the body over the plane that fits the ground below its wheels, raised where a wheel would reach the
    /// panels, and wholly behind a camera without a mast.
    fn pose(&self, terrain: &Terrain, eye: Vec3, view: Vec2) -> Pose {
        let above_deck_m = self.above_deck_m(terrain, eye);
        let middle = eye.truncate() + self.middle(view, above_deck_m);
        let mut pose = self.pose_at(terrain, middle);
        let mut room_m = f32::INFINITY;
        if above_deck_m >= MIN_MAST_M {
            room_m = (eye.z - pose.deck_height_at(eye.truncate()) - MIN_MAST_M).max(0.0);
        } else {
            let [_, ahead, up] = pose.axes;
            let top = pose.deck + 0.5 * self.size_m[0] * ahead;
            let [top_m, bottom_m] = [top, top - self.body_m() * up]
                .map(|edge| (edge.truncate() - eye.truncate()).dot(self.heading) + BODY_BEHIND_M);
            pose = self.pose_at(terrain, middle - top_m.max(bottom_m) * self.heading);
        }
        pose.deck += self.lift_m(&pose).min(room_m) * pose.axes[2];
        pose
    }

    /// How it stands with its middle over a point of the ground.
    fn pose_at(&self, terrain: &Terrain, middle: Vec2) -> Pose {
        let right = -self.heading.perp();
        let beside_m = 0.5 * gauge_m(self.size_m[1], self.wheel_m);
        let (mut wheels, mut sum) = ([Vec3::ZERO; 6], [0.0; 3]);
        let (mut ahead_square, mut right_square) = (0.0, 0.0);
        for (wheel, below) in wheels.iter_mut().enumerate() {
            let ahead_m = AXLES[wheel % 3] * self.size_m[0];
            let right_m = if wheel < 3 { -beside_m } else { beside_m };
            let at = middle + ahead_m * self.heading + right_m * right;
            *below = at.extend(terrain.height_at(at));
            for (sum, weight) in sum.iter_mut().zip([1.0, ahead_m, right_m]) {
                *sum += weight * below.z;
            }
            ahead_square += ahead_m * ahead_m;
            right_square += right_m * right_m;
        }
        // Least squares, simple because the wheels lie symmetrically about the middle.
        let [mean_m, rise_ahead, rise_right] = [sum[0] / 6.0, sum[1] / ahead_square, sum[2] / right_square];
        let unit = |v: Vec3| v / v.length();
        let up = unit((-rise_ahead * self.heading - rise_right * right).extend(1.0));
        let ahead = unit(self.heading.extend(rise_ahead));
        Pose { axes: [ahead.cross(up), ahead, up], deck: middle.extend(mean_m) + self.deck_m * up, wheels }
    }

    /// By how much the body must be raised for its panels to stay clear of the wheels, metres.
    fn lift_m(&self, pose: &Pose) -> f32 {
        let up = pose.axes[2];
        let tops = pose.wheels.map(|below| (below - pose.deck).dot(up) + self.wheel_m - SINKAGE_M);
        tops.into_iter().fold(0.0, |lift, top| lift.max(top + PANEL_HALF_M + CLEARANCE_M))
    }
}

/// How a rover stands on the ground.
struct Pose {
    /// Unit vectors of its body: to the right, ahead and up.
    axes: [Vec3; 3],
    /// The middle of its deck, metres.
    deck: Vec3,
    /// The ground below its wheels, metres.
    wheels: [Vec3; 6],
}

impl Pose {
    /// Height of the plane of the deck over a point, metres.
    fn deck_height_at(&self, point: Vec2) -> f32 {
        let up = self.axes[2];
        self.deck.z - (point - self.deck.truncate()).dot(up.truncate()) / up.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::config::Config;
    use crate::scene::Scene;

    /// On slopes, crater walls among them: wheels stand on the ground and below the panels, and the body lies along the ground.
    #[test]
    fn a_rover_stands_on_its_wheels() {
        let mut steepest = 0.0_f32;
        for seed in 0..12 {
            let height = if seed % 2 == 0 { "camera.height_m=1.5" } else { "camera.height_m=0.4" };
            let mut config = Config::new();
            for set in ["stage.name=surface", "rover.kind=rover", "rocks.coverage=0", height] {
                config.apply_set(set).expect(set);
            }
            let params = config.draw(seed).expect("parameters");
            let scene = Scene::build(seed, &params).expect("scene");
            let rover = Rover::build(&params).expect("rover");
            let (eye, view) = (scene.camera.eye, scene.camera.forward.truncate().normalize());
            let pose = rover.pose(&scene.terrain, eye, view);
            let [right, ahead, up] = pose.axes;
            assert!((right.cross(ahead) - up).length() < 1e-5, "{seed}: {:?}", pose.axes);
            steepest = steepest.max(libm::acosf(up.z).to_degrees());
            for below in pose.wheels {
                assert!((below.z - scene.terrain.height_at(below.truncate())).abs() < 1e-4);
                let below_deck_m = (pose.deck - below).dot(up);
                let top_m = rover.wheel_m - SINKAGE_M + PANEL_HALF_M;
                assert!(below_deck_m > top_m, "{seed}: {below_deck_m} m below the deck, top at {top_m}");
            }
            if rover.above_deck_m(&scene.terrain, eye) >= MIN_MAST_M {
                assert!(pose.deck_height_at(eye.truncate()) < eye.z - 0.9 * MIN_MAST_M, "{seed}");
            } else {
                let front = pose.deck + 0.5 * rover.size_m[0] * ahead;
                for edge in [front, front - rover.body_m() * up] {
                    let ahead_m = (edge - eye).truncate().dot(rover.heading);
                    assert!(ahead_m < 0.0, "{seed}: {ahead_m} m ahead of the eye");
                }
            }
        }
        assert!(steepest > 8.0, "no slope was tried: {steepest} degrees at most");
    }

    #[test]
    fn parts_are_closed_and_fill_their_boxes() {
        for (shape, volume) in [(Shape::Box, 8.0), (Shape::Cylinder, 2.0 * std::f32::consts::PI)] {
            let half_m = Vec3::new(0.5, 0.2, 0.2);
            let part =
                Part { shape, half_m, axes: [Vec3::X, Vec3::Y, Vec3::Z], centre: Vec3::ZERO, albedo: PAINT };
            let body = part.body(0, true);
            let at = |vertex: u32| body.vertices[vertex as usize].position;
            let mut found = 0.0;
            for triangle in body.triangles(LEVEL) {
                let [a, b, c] = triangle.map(at);
                let sixfold = a.dot(b.cross(c));
                // Slivers between three points of a rim lie in the plane of the cap, either way round.
                assert!(sixfold >= -1e-4, "{shape:?}: a triangle faces inwards: {sixfold}");
                found += sixfold / 6.0;
            }
            let expected = volume * half_m.x * half_m.y * half_m.z;
            assert!((found / expected - 1.0).abs() < 0.02, "{shape:?}: {found} of {expected}");
            assert!(body.vertices.iter().all(|vertex| (vertex.normal.length() - 1.0).abs() < 1e-5));
        }
    }

    /// Bounds of a part along the axes of its rover, metres.
    fn bounds(part: &Rock, axes: &[Vec3; 3]) -> [[f32; 2]; 3] {
        axes.map(|axis| {
            let along_m = part.vertices.iter().map(|vertex| (part.centre + vertex.position).dot(axis));
            along_m.fold([f32::MAX, f32::MIN], |[low, high], at| [low.min(at), high.max(at)])
        })
    }

    /// With a track of its own, which ends at its front wheels, and without.
    #[test]
    fn no_rock_lies_in_the_rover_or_is_moved_from_the_camera() {
        let (mut near, mut moved) = (0, Vec::new());
        for seed in 0..10 {
            let mut config = Config::new();
            let own = if seed % 2 == 0 { "tracks.own=yes" } else { "tracks.own=no" };
            let height = if seed % 3 == 0 { "camera.height_m=0.5" } else { "camera.height_m=1.5" };
            for set in ["stage.name=surface", "rover.kind=rover", "rocks.coverage=0.08", own, height] {
                config.apply_set(set).expect(set);
            }
            let params = config.draw(seed).expect("parameters");
            let scene = Scene::build(seed, &params).expect("scene");
            moved.extend(scene.moved_rocks());
            let view = scene.camera.forward.truncate().normalize();
            let rover = Rover::build(&params).expect("a rover");
            let axes = rover.pose(&scene.terrain, scene.camera.eye, view).axes;
            let bodies = || scene.rocks.built();
            let parts = bodies().filter(|rock| matches!(rock.body, Body::Hardware { .. }));
            let parts: Vec<[[f32; 2]; 3]> = parts.map(|part| bounds(part, &axes)).collect();
            let contains = |part: &[[f32; 2]; 3], point: Vec3| {
                part.iter().zip(axes).all(|([low, high], axis)| (*low..*high).contains(&point.dot(axis)))
            };
            assert!(parts.len() > 8, "{} parts", parts.len());
            let rocks = bodies().filter(|rock| matches!(rock.body, Body::Rock) && rock.diameter_m() > 0.1);
            for rock in rocks.filter(|rock| rock.centre.distance(scene.camera.eye) < rock.radius_m + 4.0) {
                near += 1;
                let is_inside = rock.vertices.iter().any(|vertex| {
                    let point = rock.centre + vertex.position;
                    parts.iter().any(|part| contains(part, point))
                });
                assert!(!is_inside, "seed {seed}: rock {} of {} m", rock.index, rock.diameter_m());
            }
        }
        assert!(near > 20, "{near} rocks near the rover");
        assert!(moved.is_empty(), "{moved:?}");
    }
}
