//! Frames against an independent ray tracer over the same triangles.
//!
//! The ray tracer is a maintained BVH library that knows nothing of shaders, levels of detail or shadow maps. It casts a ray through
//! the centre of every pixel, and from the hit point 64 shadow rays at the sun's disc. Frames of both raster backends are checked.

#![allow(clippy::print_stdout, reason = "figures for people who run it with --nocapture")]

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use rayon::prelude::*;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::random::Streams;
use regolith::render::select::selection::{SelectedRock, Selection};
use regolith::render::{RasterMode, RenderSettings};
use regolith::scene::Scene;
use regolith::scene::mesh::Vertex;
use regolith::scene::photometry::Law;

use crate::support::{BACKENDS, render_by, scene};

const SIDE: u32 = 256;
/// Shadow rays at the sun's disc from each hit point that is checked.
const SUN_RAYS: usize = 64;
/// One pixel in this many has its shadow checked.
const SHADOW_STRIDE: usize = 7;

/// Seed and settings of each case. Seeds of a low sun are such that few facets of the foreground are grazed by it: the horizon map takes
/// the ground between its samples as smooth, where rays find that one facet occludes the next.
const CASES: [(u64, &[&str]); 18] = [
    (1, &[]),
    (102, &["sun.elevation_deg=5"]),
    (3, &["sun.azimuth_deg=0"]),
    (4, &["camera.height_m=1.5"]),
    (105, &["camera.fov_deg=85"]),
    (6, &["terrain.amplitude_m=7"]),
    (7, &["sun.elevation_deg=5", "sun.azimuth_deg=0", "camera.height_m=1.5"]),
    (8, &["sun.elevation_deg=40", "sun.azimuth_deg=250"]),
    (9, &["camera.height_m=12", "camera.pitch_deg=-20", "craters.count=20"]),
    (10, &["sun.elevation_deg=9", "sun.azimuth_deg=60", "camera.yaw_deg=20", "camera.roll_deg=5"]),
    (111, &["terrain.amplitude_m=7", "sun.elevation_deg=5", "sun.azimuth_deg=200", "camera.fov_deg=85"]),
    (
        42,
        &[
            "rocks.hero_scale_m=4.2",
            "rocks.hero_y_m=-76.7",
            "rocks.displacement=0.25",
            "camera.pitch_deg=-1.9",
        ],
    ),
    (21, &["stage.name=surface"]),
    (22, &["stage.name=surface", "sun.elevation_deg=6", "rocks.coverage=0.03"]),
    (23, &["stage.name=surface", "sun.elevation_deg=25", "sun.azimuth_deg=10", "camera.pitch_deg=-14"]),
    (
        24,
        &[
            "stage.name=surface",
            "camera.yaw_deg=77",
            "camera.roll_deg=5",
            "camera.height_m=1.5",
            "camera.x_m=150",
        ],
    ),
    // Ground behind the camera shadows what is in view.
    (8, &["stage.name=surface", "sun.elevation_deg=8"]),
    // Ground shadows what lies in the penumbra of ground far away.
    (5, &["stage.name=surface", "sun.elevation_deg=4", "sun.azimuth_deg=335"]),
];

/// The triangles of a scene in a BVH, with the attributes of their hits.
pub(crate) struct Truth {
    triangles: Vec<Triangle>,
    normals: Vec<[Vec3; 3]>,
    instances: Vec<u16>,
    bvh: Bvh2,
}

struct Hit {
    distance: f32,
    instance: u16,
    facet_normal: Vec3,
    normal: Vec3,
}

impl Hit {
    /// Whether both its facet and the smooth surface face a direction.
    fn faces(&self, direction: Vec3) -> bool {
        self.facet_normal.dot(direction) > 0.0 && self.normal.dot(direction) > 0.0
    }
}

impl Truth {
    /// The triangles at the levels of detail that a frame with these settings draws, or at the finest.
    pub(crate) fn new(scene: &Scene, settings: Option<&RenderSettings>) -> Self {
        let (mut triangles, mut normals, mut instances) = (Vec::new(), Vec::new(), Vec::new());
        let mut add = |vertices: &[Vertex], triangle: [u32; 3], offset: Vec3, instance: u16| {
            let [a, b, c] = triangle.map(|v| vertices[v as usize]);
            let at = |vertex: Vertex| Vec3A::from(vertex.position + offset);
            triangles.push(Triangle { v0: at(a), v1: at(b), v2: at(c) });
            normals.push([a.normal, b.normal, c.normal]);
            instances.push(instance);
        };
        for triangle in scene.terrain.triangles() {
            add(&scene.terrain.vertices, triangle, Vec3::ZERO, 0);
        }
        let levels: Vec<(usize, usize)> = match settings {
            None => scene.rocks.iter().enumerate().map(|(i, rock)| (i, rock.level)).collect(),
            Some(settings) => {
                let level = |s: &SelectedRock| s.visible_level.or(s.caster.map(|c| c.1));
                let selection = Selection::new(scene, settings);
                selection.rocks.iter().filter_map(|s| Some((s.rock, level(s)?))).collect()
            }
        };
        for (index, level) in levels {
            let rock = &scene.rocks[index];
            for &triangle in rock.triangles(level) {
                add(&rock.vertices, triangle, rock.centre, rock.index as u16 + 1);
            }
        }
        let bvh = build_bvh2_from_tris(&triangles, BvhBuildParams::fast_build(), &mut Duration::default());
        Self { triangles, normals, instances, bvh }
    }

    /// The nearest hit of a ray.
    fn cast(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let ray = Ray::new_inf(origin.into(), direction.into());
        let mut hit = RayHit::none();
        let index = |id: usize| self.bvh.primitive_indices[id] as usize;
        self.bvh.ray_traverse(ray, &mut hit, |ray, id| self.triangles[index(id)].intersect(ray)).then(|| {
            let id = index(hit.primitive_id as usize);
            let triangle = &self.triangles[id];
            let (a, b, c) = (Vec3::from(triangle.v0), Vec3::from(triangle.v1), Vec3::from(triangle.v2));
            let at = origin + hit.t * direction;
            let across = (b - a).cross(c - a);
            let weight = |p: Vec3, q: Vec3| (q - p).cross(at - p).dot(across) / across.length_squared();
            let [na, nb, nc] = self.normals[id];
            Hit {
                distance: hit.t,
                instance: self.instances[id],
                facet_normal: across.normalize(),
                normal: (weight(b, c) * na + weight(c, a) * nb + weight(a, b) * nc).normalize(),
            }
        })
    }

    /// The index of the triangle that a ray hits first, and its distance, metres.
    pub(crate) fn triangle(&self, origin: Vec3, direction: Vec3) -> Option<(usize, f32)> {
        let ray = Ray::new_inf(origin.into(), direction.into());
        let mut hit = RayHit::none();
        let index = |id: usize| self.bvh.primitive_indices[id] as usize;
        self.bvh
            .ray_traverse(ray, &mut hit, |ray, id| self.triangles[index(id)].intersect(ray))
            .then(|| (index(hit.primitive_id as usize), hit.t))
    }

    /// Whether a shadow ray hits anything.
    fn is_occluded(&self, origin: Vec3, direction: Vec3) -> bool {
        let ray = Ray::new_inf(origin.into(), direction.into());
        let index = |id: usize| self.bvh.primitive_indices[id] as usize;
        !self.bvh.ray_traverse_miss(ray, |ray, id| self.triangles[index(id)].intersect(ray))
    }

    /// Fraction of the sun's disc that is occluded at a point, by shadow rays in a spiral over the disc.
    pub(crate) fn sun_occlusion(&self, scene: &Scene, point: Vec3, seed: u64) -> f32 {
        let sun = &scene.sun;
        let right = Vec3::Z.cross(sun.direction).normalize();
        let up = sun.direction.cross(right);
        let turn = Streams::new(seed).stream("truth", 0).unit() as f32;
        let occluded = (0..SUN_RAYS).filter(|&i| {
            let radius = sun.tan_half_angle() * ((i as f32 + 0.5) / SUN_RAYS as f32).sqrt();
            let (sin, cos) = (2.399_963_2 * i as f32 + std::f32::consts::TAU * turn).sin_cos();
            self.is_occluded(point, (sun.direction + radius * (cos * right + sin * up)).normalize())
        });
        occluded.count() as f32 / SUN_RAYS as f32
    }
}

/// Hit and hit point of the camera ray of every sample, with `samples` x `samples` a pixel, row by row; `None` where the sky's dome is
/// nearer.
fn cast_samples(scene: &Scene, truth: &Truth, samples: u32) -> Vec<Option<(Hit, Vec3)>> {
    let camera = &scene.camera;
    let side = SIDE * samples;
    let focal = camera.focal_px(side) as f32;
    (0..side * side)
        .into_par_iter()
        .map(|sample| {
            let half = 0.5 * side as f32;
            let (x, y) = ((sample % side) as f32 + 0.5 - half, (sample / side) as f32 + 0.5 - half);
            let ray = (camera.forward + x / focal * camera.right - y / focal * camera.up).normalize();
            let hit = truth.cast(camera.eye, ray)?;
            let point = camera.eye + hit.distance * ray;
            (point.distance(scene.sky.centre) < scene.sky.radius_m).then_some((hit, point))
        })
        .collect()
}

/// The origin of shadow rays: the hit point offset along the facet's normal, by no more than 2 mm, and by less where facets are that
/// small.
fn shadow_ray_origin(scene: &Scene, hit: &Hit, point: Vec3) -> Vec3 {
    point + (1e-5 * point.distance(scene.camera.eye)).min(2e-3) * hit.facet_normal
}

/// Hits of the camera rays through the centres of pixels.
fn cast_image(scene: &Scene, truth: &Truth) -> Vec<Option<(Hit, Vec3)>> {
    cast_samples(scene, truth, 1)
}

/// The majority class of each pixel of 2 x 2 samples; in a tie the class of the nearest sample.
fn majority_of_four(scene: &Scene, samples: &[Option<(Hit, Vec3)>]) -> Vec<u8> {
    let side = SIDE as usize;
    let depth = |hit: &Option<(Hit, Vec3)>| {
        hit.as_ref().map_or(f32::INFINITY, |(_, point)| (*point - scene.camera.eye).dot(scene.camera.forward))
    };
    let pixel_class = |pixel: usize| {
        let corner = 2 * (pixel / side) * 2 * side + 2 * (pixel % side);
        let four = [0, 1, 2 * side, 2 * side + 1].map(|offset| &samples[corner + offset]);
        let votes = |id: u8| four.iter().filter(|hit| class(hit) == id).count();
        let max_votes = four.iter().map(|hit| votes(class(hit))).max().unwrap_or(0);
        let candidates = four.iter().filter(|hit| votes(class(hit)) == max_votes);
        candidates.min_by(|a, b| depth(a).total_cmp(&depth(b))).map_or(255, |hit| class(hit))
    };
    (0..side * side).map(pixel_class).collect()
}

fn class(hit: &Option<(Hit, Vec3)>) -> u8 {
    match hit {
        None => ClassId::SKY.0,
        Some((hit, _)) if hit.instance > 0 => ClassId::ROCK.0,
        Some(_) => ClassId::REGOLITH.0,
    }
}

/// Intersection over union of a class in two masks.
fn iou(a: &[u8], b: &[u8], class: u8) -> f64 {
    let count = |both: fn(bool, bool) -> bool| {
        a.iter().zip(b).filter(|(a, b)| both(**a == class, **b == class)).count() as f64
    };
    count(|a, b| a && b) / count(|a, b| a || b).max(1.0)
}

/// Share of the pixels at outlines that may have the other class: devices round vertices to 1/256 of a pixel, and an outline that
/// moves by half of that crosses the centre of this share of the pixels along it.
const ROUNDED_SHARE: f64 = 0.0015;

/// The same against the finest meshes, where levels of detail move outlines by up to a quarter of a pixel, mostly far less.
const COARSER_SHARE: f64 = 0.03;

/// Asserts that a mask agrees with the truth on a class to an intersection over union of `min_iou`, or, for a class that is little
/// more than outlines, that no more than a share of the pixels at outlines differ.
fn assert_agreement(name: &str, mask: &[u8], truth: &[u8], class: u8, min_iou: f64, share: f64) {
    let iou = iou(mask, truth, class);
    let differing = mask.iter().zip(truth).filter(|(a, b)| (**a == class) != (**b == class)).count();
    let outline = (0..truth.len()).filter(|&p| !is_inside(p, |p| truth[p] == class)).count();
    println!("{name}: IoU of class {class} {iou:.5}; {differing} pixels differ, {outline} at outlines");
    assert!(
        iou >= min_iou || differing as f64 <= (share * outline as f64).max(1.0),
        "{name}: IoU of class {class} is {iou}; {differing} pixels differ, {outline} are at outlines"
    );
}

/// Whether all pixels around one have the same value as it.
fn is_inside<T: PartialEq>(pixel: usize, value: impl Fn(usize) -> T) -> bool {
    let side = SIDE as usize;
    let (x, y) = (pixel % side, pixel / side);
    let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(side - 1);
    let own = value(pixel);
    near(y).all(|y| near(x).all(|x| value(y * side + x) == own))
}

fn quantile(mut values: Vec<f32>, q: f64) -> f32 {
    values.sort_by(f32::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}

/// Class, instance, depth, normal and sun occlusion of a frame with one sample a pixel.
fn check(case: usize) {
    let (seed, set) = CASES[case];
    let name = format!("seed {seed}, {set:?}");
    let scene = scene(seed, set);
    let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
            .into_iter()
            .collect();
    let truth = Truth::new(&scene, Some(&settings));
    let hits = cast_image(&scene, &truth);
    let finest = cast_image(&scene, &Truth::new(&scene, None));
    for backend in BACKENDS {
        let frame = render_by(backend, &scene, &settings);
        check_frame(&format!("{name}, {backend}"), &scene, &frame, (&truth, &hits));
        check_against_finest(&format!("{name}, {backend}"), &scene, &frame, &finest);
    }
}

fn check_frame(name: &str, scene: &Scene, frame: &Frame, (truth, hits): (&Truth, &[Option<(Hit, Vec3)>])) {
    let classes: Vec<u8> = hits.iter().map(class).collect();
    for class in ClassId::ALL {
        assert_agreement(name, &frame.class, &classes, class.id.0, 0.999, ROUNDED_SHARE);
    }

    let instance = |pixel: usize| hits[pixel].as_ref().map_or(0, |(hit, _)| hit.instance);
    let rocks: Vec<usize> = (0..hits.len()).filter(|&pixel| instance(pixel) > 0).collect();
    let agreeing = rocks.iter().filter(|&&pixel| frame.instances[pixel] == instance(pixel)).count();
    println!("{name}: instances {agreeing} of {}", rocks.len());
    let outline = (0..hits.len()).filter(|&pixel| !is_inside(pixel, instance)).count();
    let strays = (rocks.len() - agreeing) as f64;
    assert!(
        strays <= (0.001 * rocks.len() as f64).max(ROUNDED_SHARE * outline as f64),
        "{name}: {agreeing} of {}, {outline} pixels are at outlines",
        rocks.len()
    );

    let (mut depths, mut angles, mut shadows) = (Vec::new(), Vec::new(), Vec::new());
    for (pixel, found) in hits.iter().enumerate() {
        if frame.class[pixel] == ClassId::SKY.0 {
            assert_eq!(normal_at(frame, pixel), Vec3::ZERO, "{name}: the sky has no normal");
            assert_eq!(frame.sun_occlusion[pixel], 0, "{name}: nothing shadows the sky");
        } else {
            let length = normal_at(frame, pixel).length();
            assert!((length - 1.0).abs() < 1e-5, "{name}: a normal of length {length}");
        }
        let Some((hit, point)) = found else { continue };
        if frame.instances[pixel] != hit.instance || frame.class[pixel] != class(found) {
            continue;
        }
        if is_inside(pixel, |p| (classes[p], instance(p))) {
            let depth_m = (*point - scene.camera.eye).dot(scene.camera.forward);
            depths.push((frame.depth_m[pixel] / depth_m - 1.0).abs());
            angles.push(hit.normal.dot(normal_at(frame, pixel)).clamp(-1.0, 1.0).acos().to_degrees());
        }
        if pixel % SHADOW_STRIDE == 0 && faces_sun(scene, frame, pixel, hit) {
            shadows.push((pixel, shadow_ray_origin(scene, hit, *point)));
        }
    }
    let (median, tail, normal) =
        (quantile(depths.clone(), 0.5), quantile(depths, 0.999), quantile(angles, 0.5));
    println!("{name}: depth error median {median:.1e}, 99.9 % {tail:.1e}; normals median {normal:.3} deg");
    assert!(median < 1e-5 && tail < 3e-5, "{name}: depth error median {median}, 99.9 % {tail}");
    // The normals of the surface stage include the relief below its mesh.
    let bound = if scene.relief.is_some() { 15.0 } else { 1.0 };
    assert!(normal < bound, "{name}: normals {normal} degrees");

    let errors = shadow_errors(scene, frame, truth, &shadows);
    let n = errors.len() as f32;
    let mean = errors.iter().map(|e| e.abs()).sum::<f32>() / n;
    let signed = errors.iter().sum::<f32>() / n;
    let far_off = errors.iter().filter(|e| e.abs() > 0.25).count() as f32 / n;
    println!(
        "{name}: shadow mean error {mean:.4}, signed {signed:.4}, {:.2} % off by over 0.25",
        100.0 * far_off
    );
    assert!(mean < 0.01, "{name}: mean shadow error {mean}");
    assert!(signed.abs() < 0.005, "{name}: signed shadow error {signed}");
    assert!(far_off < 0.01, "{name}: {far_off} of the pixels are off by over 0.25");
}

fn normal_at(frame: &Frame, pixel: usize) -> Vec3 {
    Vec3::from_slice(&frame.normals[3 * pixel..3 * pixel + 3])
}

/// Whether a pixel faces the sun, its mesh and the relief below that: in a frame what faces away is in its own shadow, and the ray caster has
/// no such relief.
fn faces_sun(scene: &Scene, frame: &Frame, pixel: usize, hit: &Hit) -> bool {
    let sun = scene.sun.direction;
    hit.faces(sun) && normal_at(frame, pixel).dot(sun) > 0.0
}

/// Errors of the sun's occlusion in some pixels of a frame, each with the origin of its shadow rays.
fn shadow_errors(scene: &Scene, frame: &Frame, truth: &Truth, shadows: &[(usize, Vec3)]) -> Vec<f32> {
    let error = |&(pixel, origin): &(usize, Vec3)| {
        f32::from(frame.sun_occlusion[pixel]) / 255.0 - truth.sun_occlusion(scene, origin, pixel as u64)
    };
    shadows.par_iter().map(error).collect()
}

/// The seeds among 24 whose foreground has most facets that a sun 5 degrees high grazes.
#[test]
fn shadows_of_grazed_ground_keep_their_bound() {
    for seed in [2, 16] {
        let scene = scene(seed, &["sun.elevation_deg=5"]);
        let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
        settings.annotations = [Annotation::Instances, Annotation::Shadow].into_iter().collect();
        let truth = Truth::new(&scene, Some(&settings));
        let frame = render_by(BACKENDS[0], &scene, &settings);
        let of_ground = |(pixel, found): (usize, Option<(Hit, Vec3)>)| {
            let (hit, point) = found?;
            let is_of_ground = hit.instance == 0 && frame.instances[pixel] == 0;
            let is_checked = pixel % SHADOW_STRIDE == 0 && is_of_ground && hit.faces(scene.sun.direction);
            is_checked.then(|| (pixel, shadow_ray_origin(&scene, &hit, point)))
        };
        let shadows: Vec<_> =
            cast_image(&scene, &truth).into_iter().enumerate().filter_map(of_ground).collect();
        let errors = shadow_errors(&scene, &frame, &truth, &shadows);
        let mean = errors.iter().map(|e| e.abs()).sum::<f32>() / errors.len() as f32;
        println!("seed {seed}: shadow mean error {mean:.4} over {} pixels of ground", errors.len());
        assert!(errors.len() > 1000 && mean < 0.01, "seed {seed}: mean shadow error {mean}");
    }
}

/// Classes against the finest meshes, whose levels of detail a frame may not show.
fn check_against_finest(name: &str, scene: &Scene, frame: &Frame, finest: &[Option<(Hit, Vec3)>]) {
    let classes: Vec<u8> = finest.iter().map(class).collect();
    for class in ClassId::ALL {
        assert_agreement(
            &format!("{name}, finest meshes"),
            &frame.class,
            &classes,
            class.id.0,
            0.98,
            COARSER_SHARE,
        );
    }
    // A rock of about a pixel may have no pixel in the truth and one in the mask.
    let is_speck = |pixel: usize| {
        frame.instances[pixel].checked_sub(1).is_some_and(|rock| {
            let rock = &scene.rocks[usize::from(rock)];
            let distance_m = rock.centre.distance(scene.camera.eye);
            let length_px = 2.0 * rock.radius_m / distance_m * (scene.camera.focal_px(SIDE) as f32);
            let has_one = frame.instances.iter().filter(|id| **id == frame.instances[pixel]).count() == 1;
            length_px < 1.5 || length_px < 2.5 && has_one
        })
    };
    let is_stray = |p: usize| classes[p] != frame.class[p] && is_inside(p, |p| classes[p]) && !is_speck(p);
    let strays = (0..classes.len()).filter(|&p| is_stray(p)).count();
    assert_eq!(strays, 0, "{name}: pixels of another class more than a pixel from an outline");
}

/// With four samples a pixel, its class is that of the majority.
fn check_majority(case: usize) {
    let (seed, set) = CASES[case];
    let name = format!("seed {seed}, {set:?}");
    let scene = scene(seed, set);
    let settings = RenderSettings::new([SIDE; 2], 4).expect("settings");
    let truth = Truth::new(&scene, Some(&settings));
    let classes = majority_of_four(&scene, &cast_samples(&scene, &truth, 2));
    for backend in BACKENDS {
        let frame = render_by(backend, &scene, &settings);
        for class in ClassId::ALL {
            let name = format!("{name}, {backend}");
            assert_agreement(&name, &frame.class, &classes, class.id.0, 0.999, ROUNDED_SHARE);
        }
    }
}

/// Irradiance besides the sun's, by its definition: below the horizon a tilted plane receives the radiance of level ground in full
/// sun (0.4 of it if the plane faces away from the sun), above it that of the uniform sky.
fn ambient(scene: &Scene, normal: Vec3) -> Vec3 {
    let sun = &scene.sun;
    let ground = scene.regolith.albedo * sun.irradiance * sun.direction.z / std::f32::consts::PI;
    let towards = sun.direction.truncate().normalize_or_zero();
    let facing = 0.5 + 0.5 * normal.truncate().dot(towards);
    let bounced = ground * (0.5 - 0.5 * normal.z) * (0.4 + 0.6 * facing);
    std::f32::consts::PI * (bounced + scene.sky.radiance * (0.5 + 0.5 * normal.z))
}

/// Radiance of Lambertian surfaces away from outlines and penumbrae: albedo / pi x irradiance x cosine.
fn check_radiance(case: usize) {
    let (seed, set) = CASES[case];
    let name = format!("seed {seed}, {set:?}");
    let mut scene = scene(seed, set);
    scene.regolith.roughness = 0.0;
    // The meshes alone, without the relief and the dust that lighting adds.
    (scene.relief, scene.photometry.law) = (None, Law::Lambert);
    scene.rocks.iter_mut().for_each(|rock| rock.material.roughness = 0.0);
    let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
    settings.annotations = [Annotation::Hdr, Annotation::Instances].into_iter().collect();
    let truth = Truth::new(&scene, Some(&settings));
    let hits = cast_image(&scene, &truth);
    for backend in BACKENDS {
        let frame = render_by(backend, &scene, &settings);
        check_radiance_of(&format!("{name}, {backend}"), &scene, &frame, (&truth, &hits));
    }
}

fn check_radiance_of(
    name: &str,
    scene: &Scene,
    frame: &Frame,
    (truth, hits): (&Truth, &[Option<(Hit, Vec3)>]),
) {
    let label = |pixel: usize| {
        hits[pixel].as_ref().map_or((ClassId::SKY.0, 0), |(hit, _)| (class(&hits[pixel]), hit.instance))
    };
    let errors: Vec<f32> = (0..hits.len())
        .into_par_iter()
        .filter(|pixel| pixel % SHADOW_STRIDE == 0 && is_inside(*pixel, label))
        .filter_map(|pixel| {
            let (hit, point) = hits[pixel].as_ref()?;
            let cos_light = hit.normal.dot(scene.sun.direction);
            let is_sunlit = cos_light > 0.02
                && hit.facet_normal.dot(scene.sun.direction) > 0.0
                && truth.sun_occlusion(scene, shadow_ray_origin(scene, hit, *point), pixel as u64) == 0.0;
            let rock = hit.instance.checked_sub(1).map(|rock| &scene.rocks[usize::from(rock)]);
            let albedo = rock.map_or(scene.regolith, |rock| rock.material).albedo;
            let others = albedo * ambient(scene, hit.normal) / std::f32::consts::PI;
            let direct = albedo * cos_light * scene.sun.irradiance / std::f32::consts::PI;
            let radiance = &frame.radiance[3 * pixel..3 * pixel + 3];
            let measured = Vec3::from_slice(&[0, 1, 2].map(|c| radiance[c].to_f32())) - others;
            is_sunlit.then(|| (measured / direct - 1.0).abs().max_element())
        })
        .collect();
    assert!(errors.len() > 100, "{name}: {} sunlit pixels", errors.len());
    let (median, tail) = (quantile(errors.clone(), 0.5), quantile(errors.clone(), 0.99));
    println!("{name}: direct radiance error median {median:.1e}, 99 % {tail:.1e} ({} pixels)", errors.len());
    assert!(median < 0.01 && tail < 0.05, "{name}: direct radiance error median {median}, 99 % {tail}");
}

/// Ground is at a contact if a rock is no further away than this, metres.
const CONTACT_M: f32 = 0.25;

/// Errors of a backend's sun occlusion: on ground at contacts with rocks, and on the rocks.
fn contact_errors(backend: RasterMode, case: usize) -> [Vec<f32>; 2] {
    let (seed, set) = CASES[case];
    let scene = scene(seed, set);
    let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
    settings.annotations =
        [Annotation::Normals, Annotation::Instances, Annotation::Shadow].into_iter().collect();
    let frame = render_by(backend, &scene, &settings);
    let truth = Truth::new(&scene, Some(&settings));
    let hits = cast_image(&scene, &truth);
    let rock_is_near = |point: Vec3, direction: Vec3| {
        truth.cast(point, direction).is_some_and(|hit| hit.distance < CONTACT_M && hit.instance > 0)
    };
    let errors: Vec<(bool, f32)> = hits
        .par_iter()
        .enumerate()
        .filter_map(|(pixel, found)| {
            let (hit, point) = found.as_ref()?;
            let on_rock = hit.instance > 0;
            if !faces_sun(&scene, &frame, pixel, hit)
                || frame.instances[pixel] != hit.instance
                || (on_rock && pixel % SHADOW_STRIDE > 0)
            {
                return None;
            }
            let origin = shadow_ray_origin(&scene, hit, *point);
            let is_checked = on_rock
                || (0..16).any(|i| {
                    let (sin, cos) = (std::f32::consts::TAU * i as f32 / 16.0).sin_cos();
                    rock_is_near(origin, Vec3::new(cos, sin, 0.2).normalize())
                });
            let error = || {
                f32::from(frame.sun_occlusion[pixel]) / 255.0
                    - truth.sun_occlusion(&scene, origin, pixel as u64)
            };
            is_checked.then(|| (on_rock, error()))
        })
        .collect();
    [false, true]
        .map(|rocks| errors.iter().filter(|(rock, _)| *rock == rocks).map(|(_, error)| *error).collect())
}

/// Share of the pixels of rocks that face the sun, or of ground at contacts, whose occlusion may be off by over a quarter: along creases,
/// whose shadows are narrower than texels of the shadow map where the sun grazes a rock.
const MAX_FAR_OFF: f64 = 0.01;

/// Pooled over all cases, because a single frame has too few such pixels.
#[test]
fn shadows_neither_detach_nor_creep_at_contacts() {
    BACKENDS.into_iter().for_each(check_contacts);
}

fn check_contacts(backend: RasterMode) {
    let cases: Vec<[Vec<f32>; 2]> = (0..CASES.len()).map(|case| contact_errors(backend, case)).collect();
    for (index, what, bound) in [(0, "ground at contacts", 0.005), (1, "rocks", 0.01)] {
        let errors: Vec<f64> = cases.iter().flat_map(|case| &case[index]).map(|e| f64::from(*e)).collect();
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let spread = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
        println!(
            "{what}, {backend}: signed shadow error {mean:.4} +- {:.4} over {n} pixels",
            spread / n.sqrt()
        );
        assert!(n > 1000.0, "{what}: too few pixels: {n}");
        assert!(mean.abs() < bound, "{what}, {backend}: the mean shadow error is {mean}");
        let far_off = errors.iter().filter(|e| e.abs() > 0.25).count() as f64 / n;
        println!("{what}, {backend}: {:.2} % off by over 0.25", 100.0 * far_off);
        assert!(far_off < MAX_FAR_OFF, "{what}, {backend}: {far_off} of the pixels are off by over 0.25");
    }
}

macro_rules! cases {
    ($($name:ident $case:literal,)*) => { $(
        mod $name {
            #[test]
            fn geometry_and_shadow() { super::check($case); }
            #[test]
            fn majority_of_four_samples() { super::check_majority($case); }
            #[test]
            fn direct_radiance() { super::check_radiance($case); }
        }
    )* };
}

cases! {
    nominal 0, low_sun 1, sun_in_front 2, low_camera 3, wide_view 4, high_relief 5, low_sun_in_front 6, high_sun 7,
    from_above 8, turned_camera 9, everything_extreme 10, near_boulder 11, surface 12, surface_low_sun 13,
    surface_sun_in_front 14, surface_turned 15,
    surface_in_shadow 16, surface_penumbrae 17,
}
