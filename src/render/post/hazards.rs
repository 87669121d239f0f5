//! What a rover's planner asks of a picture besides classes: slopes, craters, the angles of the light.
//!
//! Reckoned for each pixel from what was drawn there: its depth puts it back into the scene, and the scene's own height
//! function and list of craters answer.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::class::ClassId;
use crate::frame::{Annotation, Annotations, Frame};
use crate::lens::Lens;
use crate::scene::Scene;
use crate::scene::craters::Pit;

/// Side of the squares of pixels that ask for their craters together.
const TILE_PX: usize = 16;
/// Length over which the slope of the ground is taken, metres: about a rover's wheelbase.
pub const SLOPE_BASELINE_M: f32 = 0.5;
/// Where the rim ends, in radii from the centre.
pub const RIM_RADII: f32 = 1.3;
/// Ground that is further off than this is a mountain in the five-class mask, metres.
pub const MOUNTAIN_FROM_M: f32 = 400.0;
/// Values of [`Frame::craters`].
pub const CRATER_INTERIOR: u8 = 1;
/// See [`CRATER_INTERIOR`].
pub const CRATER_RIM: u8 = 2;

/// Whether any annotation of this file is asked for.
#[must_use]
pub fn any(asked: Annotations) -> bool {
    let own = [Annotation::Slope, Annotation::Craters, Annotation::Angles, Annotation::FiveClasses];
    own.into_iter().any(|annotation| asked.contains(annotation))
}

/// What the device must draw for these annotations: those of this file come from depth and normals.
#[must_use]
pub fn drawn_for(asked: Annotations) -> Annotations {
    let mut drawn = if any(asked) { asked.with(Annotation::Depth) } else { asked };
    if asked.contains(Annotation::Angles) {
        drawn = drawn.with(Annotation::Normals);
    }
    drawn
}

/// Fills in the planes that are asked for, and takes away what was drawn for them alone.
pub fn add(frame: &mut Frame, scene: &Scene, asked: Annotations) {
    if !any(asked) {
        return;
    }
    let rays = Rays::new(scene, frame);
    let places: Vec<Option<Vec3>> = (0..frame.class.len())
        .into_par_iter()
        .map(|pixel| {
            let depth_m = frame.depth_m[pixel];
            depth_m.is_finite().then(|| scene.camera.eye + depth_m * rays.at(pixel))
        })
        .collect();
    let on_ground = |pixel: usize| places[pixel].filter(|_| frame.class[pixel] == ClassId::REGOLITH.0);
    if asked.contains(Annotation::Slope) {
        frame.slope_deg = (0..places.len())
            .into_par_iter()
            .map(|pixel| on_ground(pixel).map_or(f32::NAN, |place| slope_deg(scene, place.truncate())))
            .collect();
    }
    if asked.contains(Annotation::Craters) || asked.contains(Annotation::FiveClasses) {
        let ground: Vec<Option<Vec2>> =
            (0..places.len()).map(|pixel| on_ground(pixel).map(Vec3::truncate)).collect();
        frame.craters = craters(scene, frame.width as usize, &ground);
    }
    if asked.contains(Annotation::FiveClasses) {
        frame.five_classes = (0..places.len())
            .map(|pixel| match (frame.class[pixel], frame.craters[pixel], on_ground(pixel)) {
                (id, CRATER_INTERIOR, Some(_)) if id == ClassId::REGOLITH.0 => FiveClasses::CRATER,
                (id, _, Some(place))
                    if id == ClassId::REGOLITH.0 && place.distance(scene.camera.eye) > MOUNTAIN_FROM_M =>
                {
                    FiveClasses::MOUNTAIN
                }
                (id, ..) => id,
            })
            .collect();
        if !asked.contains(Annotation::Craters) {
            frame.craters = Vec::new();
        }
    }
    if asked.contains(Annotation::Angles) {
        let sun = scene.sun.direction;
        let angles: Vec<[f32; 2]> = (0..places.len())
            .into_par_iter()
            .map(|pixel| {
                if places[pixel].is_none() {
                    return [f32::NAN; 2];
                }
                let normal = Vec3::from_slice(&frame.normals[3 * pixel..3 * pixel + 3]);
                let to_eye = -rays.at(pixel).normalize();
                [normal, to_eye].map(|unit| libm::acosf(unit.dot(sun).clamp(-1.0, 1.0)).to_degrees())
            })
            .collect();
        frame.incidence_deg = angles.iter().map(|pair| pair[0]).collect();
        frame.phase_deg = angles.iter().map(|pair| pair[1]).collect();
    }
    if !asked.contains(Annotation::Depth) {
        frame.depth_m = Vec::new();
    }
    if !asked.contains(Annotation::Normals) {
        frame.normals = Vec::new();
    }
}

/// Ids of the five-class mask beyond those of [`ClassId`], which it shares.
#[derive(Debug)]
pub struct FiveClasses;

impl FiveClasses {
    /// Inside of a crater.
    pub const CRATER: u8 = 3;
    /// Far ground.
    pub const MOUNTAIN: u8 = 4;
}

/// Directions of the pixels' centres, a metre along the axis.
struct Rays {
    forward: Vec3,
    right: Vec3,
    down: Vec3,
    focal_px: f32,
    lens: Lens,
    width: usize,
    centre_px: Vec2,
}

impl Rays {
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

    fn at(&self, pixel: usize) -> Vec3 {
        let place = Vec2::new((pixel % self.width) as f32, (pixel / self.width) as f32) + 0.5;
        let across = (place - self.centre_px) / self.focal_px;
        let [x, y] = if self.lens.is_pinhole() {
            across.to_array()
        } else {
            self.lens.undistort(across.as_dvec2().to_array()).map(|value| value as f32)
        };
        self.forward + x * self.right + y * self.down
    }
}

/// Slope of the ground over [`SLOPE_BASELINE_M`] around a place, degrees.
fn slope_deg(scene: &Scene, place: Vec2) -> f32 {
    let half = 0.5 * SLOPE_BASELINE_M;
    let height = |offset: Vec2| scene.terrain.surface_height_at(place + offset);
    let rise = |axis: Vec2| (height(half * axis) - height(-half * axis)) / SLOPE_BASELINE_M;
    libm::atanf(Vec2::new(rise(Vec2::X), rise(Vec2::Y)).length()).to_degrees()
}

/// Which pixels of the ground lie in a crater or on its rim. What one crater says of the rim another's inside overrules.
fn craters(scene: &Scene, width: usize, pixels: &[Option<Vec2>]) -> Vec<u8> {
    let height = pixels.len() / width;
    let mut marks = vec![0; pixels.len()];
    marks.par_chunks_mut(TILE_PX * width).enumerate().for_each(|(band, marks)| {
        let rows = (band * TILE_PX)..((band + 1) * TILE_PX).min(height);
        for first in (0..width).step_by(TILE_PX) {
            let columns = first..(first + TILE_PX).min(width);
            let tile =
                || rows.clone().flat_map(|row| columns.clone().map(move |column| row * width + column));
            let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
            for place in tile().filter_map(|pixel| pixels[pixel]) {
                (low, high) = (low.min(place), high.max(place));
            }
            if low.x > high.x {
                continue;
            }
            let near = near_craters(scene, 0.5 * (low + high), 0.5 * low.distance(high));
            for pixel in tile() {
                let Some(place) = pixels[pixel] else { continue };
                let nearest = near
                    .iter()
                    .map(|(centre, radius_m)| place.distance(*centre) / radius_m)
                    .fold(f32::INFINITY, f32::min);
                marks[pixel - rows.start * width] = match nearest {
                    r if r < 1.0 => CRATER_INTERIOR,
                    r if r < RIM_RADII => CRATER_RIM,
                    _ => 0,
                };
            }
        }
    });
    marks
}

/// Centres and radii, metres, of the craters that reach into a circle.
fn near_craters(scene: &Scene, middle: Vec2, radius_m: f32) -> Vec<(Vec2, f32)> {
    let rule = &scene.label_rule;
    let is_marked = |diameter_m: f32, depth: f32| {
        diameter_m >= rule.crater_min_diameter_m && depth >= rule.crater_min_depth
    };
    let classic = scene.terrain.craters.iter().filter(|crater| {
        let diameter_m = 2.0 * crater.radius_m;
        is_marked(diameter_m, (crater.depth_m + crater.rim_m) / diameter_m)
    });
    let mut near: Vec<(Vec2, f32)> = classic.map(|crater| (crater.centre, crater.radius_m)).collect();
    if let Some(relief) = &scene.relief {
        let centre = scene.terrain.centre;
        relief.craters.around(middle - centre, radius_m, rule.crater_min_diameter_m, |pit: Pit| {
            if is_marked(pit.diameter_m, pit.depth) {
                near.push((centre + pit.offset, 0.5 * pit.diameter_m));
            }
        });
    }
    near
}
