//! Stored depth, unprojected through the recorded camera, against the scene's surface.
//!
//! Must not know: other files.

use glam::{DMat3, DVec3, Vec3};
use serde_json::Value;

use super::context::Context;
use super::report::{Report, Subject, name};
use super::store::StoredFile;
use crate::class::ClassId;
use crate::error::Result;
use crate::frame::{Annotation, Frame};
use crate::lens::Lens;
use crate::output::layout::FrameLine;
use crate::render::{RenderSettings, Renderer};
use crate::scene::Scene;
use crate::scene::label_rule::{LabelPolicy, LabelRule};

// How far an unprojected point may be from the surface: the sum of three parts.
/// Metres.
const TOLERANCE_M: f64 = 0.02;
/// Fraction of the depth.
const TOLERANCE_OF_DEPTH: f64 = 1e-3;
/// Pixels: the outline of a rock's drawn level of detail is within a quarter of a pixel of the authored one.
const TOLERANCE_PX: f64 = 0.25;

/// A pixel is tested only if its mean depth is within this fraction of the depth at its centre: elsewhere the mean mixes
/// the surfaces on both sides of an edge.
const MAX_EDGE_DIFFERENCE: f64 = 0.005;
/// Fraction of the points that must be within the tolerance.
const MIN_GOOD_FRACTION: f64 = 0.99;
/// Distance between tested pixels, in pixels of row-major order.
const STRIDE: usize = 31;

/// A frame rendered twice. The pixels to test are chosen by these, not by the stored depth, which is what is tested.
struct Reference {
    /// With the dataset's samples.
    frame: Frame,
    /// With one sample at each pixel's centre, and every rock with its instance id, also those that the dataset labels regolith.
    centres: Frame,
}

impl Reference {
    fn render(scene: &Scene, settings: &RenderSettings, renderer: &mut Renderer) -> Result<Self> {
        let annotations = [Annotation::Instances, Annotation::Depth].into_iter().collect();
        let settings = RenderSettings { annotations, ..*settings };
        let (frame, _) = renderer.render(scene, &settings)?;
        let rule = LabelRule { too_small: LabelPolicy::Rock, unseen: LabelPolicy::Rock, ..scene.label_rule };
        let scene = Scene { label_rule: rule, ..scene.clone() };
        let (centres, _) = renderer.render(&scene, &RenderSettings { samples_per_side: 1, ..settings })?;
        Ok(Self { frame, centres })
    }

    /// Whether the pixel and its neighbours show one object, and the pixel one surface of it.
    fn is_testable(&self, pixel: usize) -> bool {
        self.is_inside_object(pixel) && self.is_one_surface(pixel)
    }

    fn is_inside_object(&self, pixel: usize) -> bool {
        let (width, height) = (self.frame.width as usize, self.frame.height as usize);
        let object = |pixel: usize| {
            [&self.frame, &self.centres].map(|frame| (frame.class[pixel], frame.instances[pixel]))
        };
        let (x, y) = (pixel % width, pixel / width);
        let neighbours = |at: usize, side: usize| at.saturating_sub(1)..=(at + 1).min(side - 1);
        neighbours(y, height).all(|y| neighbours(x, width).all(|x| object(y * width + x) == object(pixel)))
    }

    fn is_one_surface(&self, pixel: usize) -> bool {
        let [mean_m, centre_m] = [&self.frame, &self.centres].map(|frame| f64::from(frame.depth_m[pixel]));
        mean_m == centre_m || (mean_m - centre_m).abs() <= MAX_EDGE_DIFFERENCE * centre_m
    }

    fn is_sky(&self, pixel: usize) -> bool {
        self.frame.class[pixel] == ClassId::SKY.0
    }

    fn shows_rover(&self, pixel: usize) -> bool {
        self.centres.class[pixel] == ClassId::UNLABELLED.0
    }

    /// Distance from a point to the surface that a pixel shows, metres.
    fn distance_to_surface(&self, scene: &Scene, pixel: usize, point: Vec3) -> f64 {
        let rock = self.centres.instances[pixel].checked_sub(1).and_then(|i| scene.rocks.get(usize::from(i)));
        f64::from(match rock {
            Some(rock) => rock.distance_to_surface(point),
            None if self.shows_rover(pixel) => {
                let parts = scene.rocks.iter().skip(scene.rocks.count());
                parts.map(|part| part.distance_to_surface(point)).fold(f32::INFINITY, f32::min)
            }
            None => (point.z - scene.terrain.surface_height_at(point.truncate())).abs(),
        })
    }
}

/// The camera of a frame's line, for unprojection.
struct RecordedCamera {
    k: DMat3,
    k_inverse: DMat3,
    /// Axes of the camera in world space.
    axes: DMat3,
    eye: DVec3,
    lens: Lens,
    width: usize,
}

impl RecordedCamera {
    fn new(camera: &Value, width: usize) -> Self {
        let number =
            |rows: &str, row: usize, column: usize| camera[rows][row][column].as_f64().unwrap_or(f64::NAN);
        let matrix = |rows: &str| {
            DMat3::from_cols_array_2d(&std::array::from_fn(|c| std::array::from_fn(|r| number(rows, r, c))))
        };
        let term = |name: &str| camera["distortion"][name].as_f64().unwrap_or(0.0);
        let k = matrix("K");
        Self {
            k,
            k_inverse: k.inverse(),
            axes: matrix("world_from_camera"),
            eye: DVec3::from_array(std::array::from_fn(|r| number("world_from_camera", r, 3))),
            lens: Lens { k1: term("k1"), k2: term("k2"), k3: term("k3"), p1: term("p1"), p2: term("p2") },
            width,
        }
    }

    /// The world position at a pixel's centre and this depth.
    fn unproject(&self, pixel: usize, depth_m: f64) -> Vec3 {
        let centre = DVec3::new((pixel % self.width) as f64 + 0.5, (pixel / self.width) as f64 + 0.5, 1.0);
        let distorted = self.k_inverse * centre;
        let [x, y] = self.lens.undistort([distorted.x, distorted.y]);
        (self.eye + self.axes * (depth_m * DVec3::new(x, y, 1.0))).as_vec3()
    }

    /// Largest allowed distance from the surface at this depth, metres.
    fn tolerance_m(&self, depth_m: f64) -> f64 {
        let pixel_m = depth_m / self.k.x_axis.x;
        TOLERANCE_M + TOLERANCE_OF_DEPTH * depth_m + TOLERANCE_PX * pixel_m
    }
}

/// Result of testing points.
#[derive(Default)]
struct PointCounts {
    tested: u64,
    off: u64,
    /// Largest distance of a point beyond the tolerance, metres.
    worst_m: f64,
}

/// Checks a depth file of a frame.
pub(super) fn check_depth(
    context: &Context<'_>,
    line: &FrameLine,
    stored: &StoredFile,
    scene: &Scene,
    renderer: &mut Renderer,
    report: &mut Report,
) -> Result<()> {
    let [width, height] = context.plan.settings.size.map(|side| side as usize);
    let path = &stored.path;
    let depths_m = read_depths(&stored.bytes, width * height);
    let reference = Reference::render(scene, &context.plan.settings, renderer)?;
    let camera = RecordedCamera::new(&line.camera, width);
    let counts = count_points(&depths_m, &camera, &reference, scene);
    let is_good = counts.off as f64 <= (1.0 - MIN_GOOD_FRACTION) * counts.tested as f64;
    report.expect(name::DEPTH, Subject::File(line.index), is_good, || {
        format!(
            "{path}: {} of {} points are off the surface, {:.3} m at worst",
            counts.off, counts.tested, counts.worst_m
        )
    });
    Ok(())
}

/// The float32 values at the end of an `.npy` file.
fn read_depths(npy: &[u8], count: usize) -> Vec<f64> {
    npy[npy.len().saturating_sub(4 * count)..]
        .chunks_exact(4)
        .map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
        .collect()
}

fn count_points(
    depths_m: &[f64],
    camera: &RecordedCamera,
    reference: &Reference,
    scene: &Scene,
) -> PointCounts {
    let mut counts = PointCounts::default();
    for pixel in (0..depths_m.len()).step_by(STRIDE).filter(|pixel| reference.is_testable(*pixel)) {
        let (depth_m, is_sky) = (depths_m[pixel], reference.is_sky(pixel));
        if depth_m.is_infinite() != is_sky {
            counts.tested += 1;
            counts.off += 1;
        } else if !is_sky {
            let point = camera.unproject(pixel, depth_m);
            let distance_m = reference.distance_to_surface(scene, pixel, point);
            counts.tested += 1;
            if distance_m.is_nan() || distance_m > camera.tolerance_m(depth_m) {
                counts.off += 1;
                counts.worst_m = counts.worst_m.max(distance_m);
            }
        }
    }
    counts
}
