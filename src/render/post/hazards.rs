//! Hazard maps for a rover's planner: slope, craters, five-class mask, incidence and phase angle.
//!
//! Computed for each pixel on the host, after the readback: depth and camera give the position of the pixel's surface, and the
//! scene's own height function and list of craters answer for it.
//! Must not know: wgpu.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::class::ClassId;
use crate::frame::{Annotation, Annotations, Frame};
use crate::lens::Lens;
use crate::scene::Scene;
use crate::scene::craters::{Pit, Region};

/// Side of the square tiles of pixels that look up their craters together.
const TILE_PX: usize = 16;
/// Baseline of the slope of the ground, metres: about a rover's wheelbase.
pub const SLOPE_BASELINE_M: f32 = 0.5;
/// Where the rim ends, in radii from the centre.
pub const RIM_RADII: f32 = 1.3;
/// Ground that is further from the eye than this is a mountain in the five-class mask, metres.
pub const MOUNTAIN_FROM_M: f32 = 400.0;
/// Value of [`Frame::craters`] inside of a crater; 0 is outside of all.
pub const CRATER_INTERIOR: u8 = 1;
/// Value of [`Frame::craters`] on a rim: from 1 to [`RIM_RADII`] radii from the centre.
pub const CRATER_RIM: u8 = 2;

/// Whether any annotation of this module is requested.
#[must_use]
pub fn any_requested(requested: Annotations) -> bool {
    let own = [Annotation::Slope, Annotation::Craters, Annotation::Angles, Annotation::FiveClasses];
    own.into_iter().any(|annotation| requested.contains(annotation))
}

/// The annotations that must be rendered for those requested: the maps of this module are computed from depth and normals.
#[must_use]
pub fn with_inputs(requested: Annotations) -> Annotations {
    let mut rendered = if any_requested(requested) { requested.with(Annotation::Depth) } else { requested };
    if requested.contains(Annotation::Angles) {
        rendered = rendered.with(Annotation::Normals);
    }
    rendered
}

/// Fills in the maps that are requested, and removes the planes of a frame that were rendered for them alone.
pub fn add(frame: &mut Frame, scene: &Scene, requested: Annotations) {
    if !any_requested(requested) {
        return;
    }
    let rays = PixelRays::new(scene, frame);
    let positions: Vec<Option<Vec3>> = (0..frame.class.len())
        .into_par_iter()
        .map(|pixel| {
            let depth_m = frame.depth_m[pixel];
            depth_m.is_finite().then(|| scene.camera.eye + depth_m * rays.at(pixel))
        })
        .collect();
    let ground: Vec<Option<Vec3>> = positions
        .iter()
        .zip(&frame.class)
        .map(|(position, class)| position.filter(|_| *class == ClassId::REGOLITH.0))
        .collect();
    if requested.contains(Annotation::Slope) {
        let slope = |position: &Option<Vec3>| {
            position.map_or(f32::NAN, |position| slope_deg(scene, position.truncate()))
        };
        frame.slope_deg = ground.par_iter().map(slope).collect();
    }
    if requested.contains(Annotation::Craters) || requested.contains(Annotation::FiveClasses) {
        frame.craters = craters(scene, frame.width as usize, &ground);
    }
    if requested.contains(Annotation::FiveClasses) {
        frame.five_classes = five_classes(frame, scene, &ground);
        if !requested.contains(Annotation::Craters) {
            frame.craters = Vec::new();
        }
    }
    if requested.contains(Annotation::Angles) {
        (frame.incidence_deg, frame.phase_deg) = angles_deg(frame, scene, &rays, &positions);
    }
    if !requested.contains(Annotation::Depth) {
        frame.depth_m = Vec::new();
    }
    if !requested.contains(Annotation::Normals) {
        frame.normals = Vec::new();
    }
}

/// Ids of the five-class mask beyond those that it shares with [`ClassId`].
#[derive(Debug)]
pub struct FiveClasses;

impl FiveClasses {
    /// Inside of a crater.
    pub const CRATER: u8 = 3;
    /// Distant ground.
    pub const MOUNTAIN: u8 = 4;
}

/// The five-class mask, from the class of each pixel and the crater map of the frame. A crater wins over a mountain.
fn five_classes(frame: &Frame, scene: &Scene, ground: &[Option<Vec3>]) -> Vec<u8> {
    (0..ground.len())
        .map(|pixel| match (frame.class[pixel], frame.craters[pixel], ground[pixel]) {
            (_, CRATER_INTERIOR, Some(_)) => FiveClasses::CRATER,
            (_, _, Some(position)) if position.distance(scene.camera.eye) > MOUNTAIN_FROM_M => {
                FiveClasses::MOUNTAIN
            }
            (class, ..) => class,
        })
        .collect()
}

/// Incidence angle (between the normal and the sun) and phase angle (between the eye and the sun) of each pixel, degrees; NaN where
/// nothing is hit.
fn angles_deg(
    frame: &Frame,
    scene: &Scene,
    rays: &PixelRays,
    positions: &[Option<Vec3>],
) -> (Vec<f32>, Vec<f32>) {
    let sun = scene.sun.direction;
    let angles: Vec<[f32; 2]> = (0..positions.len())
        .into_par_iter()
        .map(|pixel| {
            if positions[pixel].is_none() {
                return [f32::NAN; 2];
            }
            let normal = Vec3::from_slice(&frame.normals[3 * pixel..3 * pixel + 3]);
            let to_eye = -rays.at(pixel).normalize();
            [normal, to_eye].map(|unit| libm::acosf(unit.dot(sun).clamp(-1.0, 1.0)).to_degrees())
        })
        .collect();
    angles.into_iter().map(|[incidence, phase]| (incidence, phase)).unzip()
}

/// The rays through the centres of pixels, with the lens undistorted.
struct PixelRays {
    forward: Vec3,
    right: Vec3,
    down: Vec3,
    focal_px: f32,
    lens: Lens,
    width: usize,
    /// Principal point, pixels.
    centre_px: Vec2,
}

impl PixelRays {
    fn new(scene: &Scene, frame: &Frame) -> Self {
        let camera = &scene.camera;
        Self {
            forward: camera.forward,
            right: camera.right,
            down: -camera.up,
            focal_px: frame.focal_px as f32,
            lens: frame.lens,
            width: frame.width as usize,
            centre_px: 0.5 * Vec2::new(frame.width as f32, frame.height as f32),
        }
    }

    /// The point on a pixel's ray at a depth of a metre, relative to the eye.
    fn at(&self, pixel: usize) -> Vec3 {
        let centre = Vec2::new((pixel % self.width) as f32, (pixel / self.width) as f32) + 0.5;
        let across = (centre - self.centre_px) / self.focal_px;
        let [x, y] = if self.lens.is_pinhole() {
            across.to_array()
        } else {
            self.lens.undistort(across.as_dvec2().to_array()).map(|value| value as f32)
        };
        self.forward + x * self.right + y * self.down
    }
}

/// Slope of the ground around a point, from central differences over [`SLOPE_BASELINE_M`], degrees.
fn slope_deg(scene: &Scene, point: Vec2) -> f32 {
    let half = 0.5 * SLOPE_BASELINE_M;
    let height = |offset: Vec2| scene.terrain.surface_height_at(point + offset);
    let rise = |axis: Vec2| (height(half * axis) - height(-half * axis)) / SLOPE_BASELINE_M;
    libm::atanf(Vec2::new(rise(Vec2::X), rise(Vec2::Y)).length()).to_degrees()
}

/// The crater map: whether the ground at each pixel lies inside of a crater, on a rim, or outside. An interior wins over the rim of
/// another crater.
fn craters(scene: &Scene, width: usize, ground: &[Option<Vec3>]) -> Vec<u8> {
    let height = ground.len() / width;
    let mut map = vec![0; ground.len()];
    map.par_chunks_mut(TILE_PX * width).enumerate().for_each(|(tile_row, map)| {
        let first = tile_row * TILE_PX;
        let rows = first..(first + TILE_PX).min(height);
        let ground = &ground[rows.start * width..rows.end * width];
        for first in (0..width).step_by(TILE_PX) {
            let columns = first..(first + TILE_PX).min(width);
            let pixels: Vec<usize> = (0..rows.len())
                .flat_map(|row| columns.clone().map(move |column| row * width + column))
                .collect();
            mark_craters(scene, &pixels, ground, map);
        }
    });
    map
}

/// Marks the pixels of a tile in the crater map, with one look-up of the craters around all of them.
fn mark_craters(scene: &Scene, pixels: &[usize], ground: &[Option<Vec3>], map: &mut [u8]) {
    let point = |pixel: usize| ground[pixel].map(Vec3::truncate);
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for point in pixels.iter().filter_map(|&pixel| point(pixel)) {
        (low, high) = (low.min(point), high.max(point));
    }
    if low.x > high.x {
        return;
    }
    let near = near_craters(scene, 0.5 * (low + high), 0.5 * low.distance(high));
    for &pixel in pixels {
        let Some(point) = point(pixel) else { continue };
        let nearest_radii = near
            .iter()
            .map(|(centre, radius_m)| point.distance(*centre) / radius_m)
            .fold(f32::INFINITY, f32::min);
        map[pixel] = match nearest_radii {
            r if r < 1.0 => CRATER_INTERIOR,
            r if r < RIM_RADII => CRATER_RIM,
            _ => 0,
        };
    }
}

/// Centres and radii, metres, of the labelled craters that reach into a circle.
fn near_craters(scene: &Scene, middle: Vec2, radius_m: f32) -> Vec<(Vec2, f32)> {
    let rule = &scene.label_rule;
    let is_labelled = |diameter_m: f32, depth: f32| {
        diameter_m >= rule.crater_min_diameter_m && depth >= rule.crater_min_depth
    };
    let classic = scene.terrain.craters.iter().filter(|crater| {
        let diameter_m = 2.0 * crater.radius_m;
        is_labelled(diameter_m, (crater.depth_m + crater.rim_m) / diameter_m)
    });
    let mut near: Vec<(Vec2, f32)> = classic.map(|crater| (crater.centre, crater.radius_m)).collect();
    if let Some(relief) = &scene.relief {
        let centre = scene.terrain.centre;
        relief.craters.around(
            &Region::circle(middle - centre, radius_m),
            // Those of the least diameter too.
            rule.crater_min_diameter_m.next_down(),
            |pit: Pit| {
                if is_labelled(pit.diameter_m, pit.depth) {
                    near.push((centre + pit.offset, 0.5 * pit.diameter_m));
                }
            },
        );
    }
    near
}
