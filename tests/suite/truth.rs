//! Frames against an independent ray caster over the same triangles.
//!
//! The caster is a maintained BVH library; it knows nothing of shaders, levels of detail or shadow maps. It shoots a
//! ray through every pixel's centre, and 64 rays at the sun's disc from what it hits.

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
use regolith::render::RenderSettings;
use regolith::render::selection::Selection;
use regolith::scene::Scene;
use regolith::scene::mesh::Vertex;

use crate::support::{renderer, scene};

const SIDE: u32 = 256;
/// Rays at the sun's disc from each place that is checked.
const SUN_RAYS: usize = 64;
/// One pixel in so many has its shadow checked.
const SHADOW_STRIDE: usize = 7;

const CASES: [(u64, &[&str]); 12] = [
    (1, &[]),
    (2, &["sun.elevation_deg=5"]),
    (3, &["sun.azimuth_deg=0"]),
    (4, &["camera.height_m=1.5"]),
    (5, &["camera.fov_deg=85"]),
    (6, &["terrain.amplitude_m=7"]),
    (7, &["sun.elevation_deg=5", "sun.azimuth_deg=0", "camera.height_m=1.5"]),
    (8, &["sun.elevation_deg=40", "sun.azimuth_deg=250"]),
    (9, &["camera.height_m=12", "camera.pitch_deg=-20", "craters.count=20"]),
    (10, &["sun.elevation_deg=9", "sun.azimuth_deg=60", "camera.yaw_deg=20", "camera.roll_deg=5"]),
    (11, &["terrain.amplitude_m=7", "sun.elevation_deg=5", "sun.azimuth_deg=200", "camera.fov_deg=85"]),
    (
        42,
        &[
            "rocks.hero_scale_m=4.2",
            "rocks.hero_y_m=-76.7",
            "rocks.displacement=0.25",
            "camera.pitch_deg=-1.9",
        ],
    ),
];

/// Triangles with what the caster must tell of them.
struct Truth {
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

impl Truth {
    /// Of a scene as it is drawn with these settings, or as it is authored.
    fn new(scene: &Scene, drawn: Option<&RenderSettings>) -> Self {
        let (mut triangles, mut normals, mut instances) = (Vec::new(), Vec::new(), Vec::new());
        let mut add = |vertices: &[Vertex], triangle: [u32; 3], offset: Vec3, instance: u16| {
            let [a, b, c] = triangle.map(|v| vertices[v as usize]);
            let at = |vertex: Vertex| Vec3A::from(vertex.position + offset);
            triangles.push(Triangle { v0: at(a), v1: at(b), v2: at(c) });
            normals.push([a.normal, b.normal, c.normal]);
            instances.push(instance);
        };
        let cells = 0..scene.terrain.cells;
        for triangle in scene.terrain.block_triangles(cells.clone(), cells) {
            add(&scene.terrain.vertices, triangle, Vec3::ZERO, 0);
        }
        let levels: Vec<(usize, usize)> = match drawn {
            None => scene.rocks.iter().enumerate().map(|(i, rock)| (i, rock.level)).collect(),
            Some(settings) => {
                let level =
                    |s: &regolith::render::selection::SelectedRock| s.seen_level.or(s.caster.map(|c| c.1));
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

    fn blocked(&self, origin: Vec3, direction: Vec3) -> bool {
        let ray = Ray::new_inf(origin.into(), direction.into());
        let index = |id: usize| self.bvh.primitive_indices[id] as usize;
        !self.bvh.ray_traverse_miss(ray, |ray, id| self.triangles[index(id)].intersect(ray))
    }

    /// Fraction of the sun's disc that is hidden from a place.
    fn hidden(&self, scene: &Scene, place: Vec3, seed: u64) -> f32 {
        let sun = &scene.sun;
        let right = Vec3::Z.cross(sun.direction).normalize();
        let up = sun.direction.cross(right);
        let turn = Streams::new(seed).stream("truth", 0).unit() as f32;
        let blocked = (0..SUN_RAYS).filter(|&i| {
            let radius = sun.tan_half_angle() * ((i as f32 + 0.5) / SUN_RAYS as f32).sqrt();
            let (sin, cos) = (2.399_963_2 * i as f32 + std::f32::consts::TAU * turn).sin_cos();
            self.blocked(place, (sun.direction + radius * (cos * right + sin * up)).normalize())
        });
        blocked.count() as f32 / SUN_RAYS as f32
    }
}

/// What the caster sees at every pixel's centre: nothing where the dome is nearer.
fn cast_picture(scene: &Scene, truth: &Truth) -> Vec<Option<(Hit, Vec3)>> {
    let camera = &scene.camera;
    let focal = camera.focal_px(SIDE) as f32;
    (0..SIDE * SIDE)
        .into_par_iter()
        .map(|pixel| {
            let half = 0.5 * SIDE as f32;
            let (x, y) = ((pixel % SIDE) as f32 + 0.5 - half, (pixel / SIDE) as f32 + 0.5 - half);
            let ray = (camera.forward + x / focal * camera.right - y / focal * camera.up).normalize();
            let hit = truth.cast(camera.eye, ray)?;
            let place = camera.eye + hit.distance * ray;
            (place.distance(scene.sky.centre) < scene.sky.radius_m).then_some((hit, place))
        })
        .collect()
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

/// Whether all pixels around one are alike.
fn is_inside<T: PartialEq>(pixel: usize, of: impl Fn(usize) -> T) -> bool {
    let side = SIDE as usize;
    let (x, y) = (pixel % side, pixel / side);
    let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(side - 1);
    let own = of(pixel);
    near(y).all(|y| near(x).all(|x| of(y * side + x) == own))
}

fn quantile(mut values: Vec<f32>, q: f64) -> f32 {
    values.sort_by(f32::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}

fn check(case: usize) {
    let (seed, set) = CASES[case];
    let name = format!("seed {seed}, {set:?}");
    let scene = scene(seed, set);
    let mut settings = RenderSettings::new([SIDE; 2], 1).expect("settings");
    settings.annotations =
        [Annotation::Depth, Annotation::Normals, Annotation::Instances, Annotation::Shadow]
            .into_iter()
            .collect();
    let frame: Frame = renderer().render(&scene, &settings).expect("a frame").0;

    let drawn = Truth::new(&scene, Some(&settings));
    let seen = cast_picture(&scene, &drawn);
    let classes: Vec<u8> = seen.iter().map(class).collect();
    for class in ClassId::ALL {
        let iou = iou(&frame.class, &classes, class.id.0);
        println!("{name}: {} IoU with drawn {iou:.5}", class.name);
        assert!(iou >= 0.999, "{name}: IoU of {} with the drawn triangles is {iou}", class.name);
    }

    let instance = |pixel: usize| seen[pixel].as_ref().map_or(0, |(hit, _)| hit.instance);
    let rocks: Vec<usize> = (0..seen.len()).filter(|&pixel| instance(pixel) > 0).collect();
    let agreeing = rocks.iter().filter(|&&pixel| frame.instances[pixel] == instance(pixel)).count();
    println!("{name}: instances {agreeing} of {}", rocks.len());
    assert!(agreeing as f64 >= 0.999 * rocks.len() as f64, "{name}: {agreeing} of {}", rocks.len());

    let (mut depths, mut angles, mut shadows) = (Vec::new(), Vec::new(), Vec::new());
    for (pixel, found) in seen.iter().enumerate() {
        let Some((hit, place)) = found else { continue };
        if frame.instances[pixel] != hit.instance || frame.class[pixel] != class(found) {
            continue;
        }
        if is_inside(pixel, |p| (classes[p], instance(p))) {
            let depth_m = (*place - scene.camera.eye).dot(scene.camera.forward);
            depths.push((frame.depth_m[pixel] / depth_m - 1.0).abs());
            let n = &frame.normals[3 * pixel..3 * pixel + 3];
            angles.push(hit.normal.dot(Vec3::new(n[0], n[1], n[2])).clamp(-1.0, 1.0).acos().to_degrees());
        }
        let lit_side =
            hit.facet_normal.dot(scene.sun.direction) > 0.0 && hit.normal.dot(scene.sun.direction) > 0.0;
        if pixel % SHADOW_STRIDE == 0 && lit_side {
            shadows.push((pixel, *place + 2e-3 * hit.facet_normal));
        }
    }
    let (median, most, normal) =
        (quantile(depths.clone(), 0.5), quantile(depths, 0.999), quantile(angles, 0.5));
    println!("{name}: depth median {median:.1e}, 99.9 % {most:.1e}; normals median {normal:.3} deg");
    assert!(median < 1e-4 && most < 0.01, "{name}: depth median {median}, 99.9 % {most}");
    assert!(normal < 1.0, "{name}: normals {normal} degrees");

    let errors: Vec<f32> = shadows
        .par_iter()
        .map(|&(pixel, place)| {
            f32::from(frame.hidden[pixel]) / 255.0 - drawn.hidden(&scene, place, pixel as u64)
        })
        .collect();
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
    assert!(far_off < 0.01, "{name}: {far_off} of the shadow is far off");

    let authored = cast_picture(&scene, &Truth::new(&scene, None));
    let classes: Vec<u8> = authored.iter().map(class).collect();
    for class in ClassId::ALL {
        let iou = iou(&frame.class, &classes, class.id.0);
        println!("{name}: {} IoU with authored {iou:.5}", class.name);
        assert!(iou >= 0.98, "{name}: IoU of {} with the authored triangles is {iou}", class.name);
    }
    let strays =
        (0..classes.len()).filter(|&p| classes[p] != frame.class[p] && is_inside(p, |p| classes[p])).count();
    assert_eq!(strays, 0, "{name}: pixels of another class more than a pixel from an outline");
}

macro_rules! cases {
    ($($name:ident $case:literal,)*) => { $(#[test] fn $name() { check($case); })* };
}

cases! {
    nominal 0, low_sun 1, sun_in_front 2, low_camera 3, wide_view 4, high_relief 5, low_sun_in_front 6, high_sun 7,
    from_above 8, turned_camera 9, everything_extreme 10, near_boulder 11,
}
