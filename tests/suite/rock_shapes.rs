//! Shapes and surfaces of the rocks of the surface stage, compared with published values.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use glam::{DMat2, DVec2};
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::RenderSettings;
use regolith::scene::Scene;
use regolith::scene::mesh::Icosphere;
use regolith::scene::rocks::Rock;

use crate::support::{renderer, scene};

const SURFACE: &str = "stage.name=surface";

/// Values at fractions of the sorted list.
fn quantiles<const N: usize>(mut values: Vec<f64>, at: [f64; N]) -> [f64; N] {
    values.sort_by(f64::total_cmp);
    at.map(|share| values[(share * (values.len() - 1) as f64) as usize])
}

/// Scenes seen from close above, where most rocks have fine meshes.
fn scenes() -> impl Iterator<Item = Scene> {
    (0..2).map(|seed| scene(seed, &[SURFACE, "rocks.coverage=0.03", "camera.pitch_deg=-30"]))
}

/// No shapes of melted wax in the ground either: the nearest vertex is not far below the furthest, few edges are steep, and hardly any
/// triangle faces the rock's centre. Forms are star-shaped (a test beside them); in the ground, heights are mapped monotonically
/// around a lower centre, which moves no surface through another.
#[test]
fn rocks_in_the_ground_have_bounded_slopes() {
    let (mut shares, mut inward, mut steep, mut all) = (Vec::new(), 0, 0, 0);
    for scene in scenes() {
        for rock in &scene.rocks {
            let lengths: Vec<f32> = rock.vertices.iter().map(|v| v.position.length()).collect();
            let [low, high] = [
                lengths.iter().copied().fold(f32::MAX, f32::min),
                lengths.iter().copied().fold(0.0, f32::max),
            ];
            shares.push(f64::from(low / high));
            for t in rock.triangles(rock.level) {
                let [a, b, c] = t.map(|v| rock.vertices[v as usize].position);
                let normal = (b - a).cross(c - a);
                inward += u32::from(normal.dot(a) <= 0.0);
                for (p, q) in [(a, b), (b, c), (c, a)] {
                    let slope = (p.length() / q.length()).ln().abs() / p.angle_between(q).max(1e-3);
                    steep += u32::from(slope > 2.5);
                    all += 1;
                }
            }
        }
    }
    let [low, middle] = quantiles(shares, [0.01, 0.5]);
    println!("nearest over furthest vertex: 1 % below {low:.3}, median {middle:.3}");
    println!("{steep} of {all} edges are steep, {inward} triangles face inwards");
    assert!(low > 0.08 && middle > 0.30, "1 % below {low}, median {middle}");
    assert!(f64::from(steep) < 0.015 * f64::from(all), "{steep} of {all} edges are steep");
    assert!(f64::from(inward) < 0.003 * f64::from(all), "{inward} of {} triangles face inwards", all / 3);
}

/// No two rocks have the same shape, even scaled along any axes, turned, mirrored, and stretched in height. The horizontal coordinates
/// of the vertices of two rocks of one shape would be four linear functions of the three coordinates of that shape, so that some
/// sum of those of the one would be some sum of those of the other: their first canonical correlation would be 1.
#[test]
fn no_two_rocks_of_a_frame_share_a_shape() {
    const LEVEL: usize = 2;
    let scene = scene(11, &[SURFACE, "rocks.coverage=0.06", "camera.pitch_deg=-20"]);
    assert!(scene.rocks.len() > 1000, "{} rocks", scene.rocks.len());
    // Coordinates of zero mean and unit covariance.
    let whitened = |rock: &Rock| {
        let points: Vec<DVec2> = rock.vertices[..Icosphere::vertex_count(LEVEL)]
            .iter()
            .map(|v| v.position.truncate().as_dvec2())
            .collect();
        let mean = points.iter().sum::<DVec2>() / points.len() as f64;
        let centred = points.iter().map(|p| *p - mean);
        let (xx, xy, yy) = centred
            .clone()
            .fold((0.0, 0.0, 0.0), |(xx, xy, yy), p| (xx + p.x * p.x, xy + p.x * p.y, yy + p.y * p.y));
        let rest = (yy - xy * xy / xx).sqrt();
        let whiten = |p: DVec2| DVec2::new(p.x / xx.sqrt(), (p.y - p.x * xy / xx) / rest);
        centred.map(whiten).collect::<Vec<DVec2>>()
    };
    let rocks: Vec<Vec<DVec2>> =
        scene.rocks.iter().filter(|rock| rock.level >= LEVEL).map(whitened).take(700).collect();
    let (mut least, mut alike) = (f64::MAX, 0);
    for (i, a) in rocks.iter().enumerate() {
        for b in &rocks[..i] {
            let c =
                a.iter().zip(b).fold(DMat2::ZERO, |sum, (a, b)| sum + DMat2::from_cols(b.x * *a, b.y * *a));
            // The square of the larger singular value.
            let (sum, det) = (c.x_axis.length_squared() + c.y_axis.length_squared(), c.determinant());
            let correlation = 0.5 * (sum + (sum * sum - 4.0 * det * det).max(0.0).sqrt());
            let left = (1.0 - correlation).max(0.0).sqrt();
            least = least.min(left);
            alike += u32::from(left < 0.01);
        }
    }
    println!("{} rocks: the two that are most alike differ by {least:.4} of their size", rocks.len());
    assert!(rocks.len() > 300, "{} rocks of level {LEVEL} or finer", rocks.len());
    assert_eq!(alike, 0, "pairs of rocks with one shape");
}

/// Linear luminance (green) of the pixels.
fn luminance(frame: &Frame) -> Vec<f64> {
    frame.radiance.chunks_exact(3).map(|rgb| f64::from(rgb[1].to_f32())).collect()
}

/// A square image blurred by a Gaussian of this deviation, pixels.
fn blurred(image: &[f64], side: usize, sigma: f64) -> Vec<f64> {
    let reach = (3.0 * sigma).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let mut values = image.to_vec();
    for step in [1, side] {
        let before = values.clone();
        for (i, value) in values.iter_mut().enumerate() {
            let along = if step == 1 { i % side } else { i / side } as i64;
            *value = weights.iter().zip(-reach..=reach).fold(0.0, |sum, (weight, k)| {
                let k = (along + k).clamp(0, side as i64 - 1) - along;
                sum + weight / total * before[(i as i64 + k * step as i64) as usize]
            });
        }
    }
    values
}

/// Pixels of rocks that have nothing else within `margin` pixels.
fn inside_rocks(frame: &Frame, side: usize, margin: usize) -> Vec<usize> {
    let within = margin..side - margin;
    let is_rock = |x: usize, y: usize| frame.class[y * side + x] == ClassId::ROCK.0;
    let is_inside = |i: &usize| {
        let (x, y) = (i % side, i / side);
        within.contains(&x)
            && within.contains(&y)
            && (y - margin..=y + margin).all(|y| (x - margin..=x + margin).all(|x| is_rock(x, y)))
    };
    (0..side * side).filter(is_inside).collect()
}

/// Standard deviation, over the inside of rocks, of what a blur over one radius keeps and one over twice that removes, relative to
/// the mean; at 1 and at 2 to 4 pixels. The definition of the measured values: differences of Gaussians, linear luminance.
fn texture_bands(frame: &Frame, side: usize) -> Option<[f64; 2]> {
    let linear = luminance(frame);
    let [one, two, four] = [1.0, 2.0, 4.0].map(|sigma| blurred(&linear, side, sigma));
    let inside = inside_rocks(frame, side, 2);
    if inside.len() < 150 {
        return None;
    }
    let mean = |of: &dyn Fn(usize) -> f64| inside.iter().map(|i| of(*i)).sum::<f64>() / inside.len() as f64;
    let level = mean(&|i| linear[i]);
    let contrast = |fine: &[f64], coarse: &[f64]| {
        let middle = mean(&|i| fine[i] - coarse[i]);
        mean(&|i| (fine[i] - coarse[i] - middle).powi(2)).sqrt() / level
    };
    Some([contrast(&linear, &one), contrast(&two, &four)])
}

/// An image of a quarter of the width shows the same texture as the mean of the larger one's pixels: a rock that comes nearer gains finer
/// detail and keeps what was seen of it. While the texture had only the three octaves next to the size of a sample, much of what a large
/// rock showed at some distance was gone close by (correlations of 0.67 to 0.82).
#[test]
fn texture_of_rocks_is_the_same_at_four_times_the_resolution() {
    const SIDES: [usize; 2] = [192, 768];
    let mut frames = 0;
    for seed in 1900..1908 {
        let view = ["rocks.coverage=0.08", "camera.fov_deg=14", "camera.pitch_deg=-14"];
        let sun = ["sun.elevation_deg=30", "sun.azimuth_deg=160"];
        let scene = scene(seed, &[SURFACE, view[0], view[1], view[2], sun[0], sun[1]]);
        let [small, large] = [(SIDES[0], 16), (SIDES[1], 4)].map(|(side, samples)| {
            let mut settings = RenderSettings::new([side as u32; 2], samples).expect("settings");
            settings.annotations = [Annotation::Hdr].into_iter().collect();
            renderer().render(&scene, &settings).unwrap_or_else(|error| panic!("{error}")).0
        });
        let fine = luminance(&large);
        let reduced: Vec<f64> = (0..SIDES[0] * SIDES[0])
            .map(|i| {
                let corner = 4 * (i / SIDES[0] * SIDES[1] + i % SIDES[0]);
                (0..16).map(|k| fine[corner + k / 4 * SIDES[1] + k % 4]).sum::<f64>() / 16.0
            })
            .collect();
        let inside = inside_rocks(&small, SIDES[0], 4);
        if inside.len() < 500 {
            continue;
        }
        frames += 1;
        let detail = |image: &[f64]| {
            let smooth = blurred(image, SIDES[0], 2.0);
            let values: Vec<f64> = inside.iter().map(|i| image[*i] - smooth[*i]).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.into_iter().map(|value| value - mean).collect::<Vec<_>>()
        };
        let (a, b) = (detail(&luminance(&small)), detail(&reduced));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let correlation = product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt();
        let contrast = (product(&b, &b) / product(&a, &a)).sqrt();
        println!("seed {seed}: correlation {correlation:.3}, contrast {contrast:.3} times as large");
        assert!(correlation > 0.9, "seed {seed}: correlation {correlation}");
        assert!((0.85..1.15).contains(&contrast), "seed {seed}: contrast {contrast} times as large");
    }
    assert!(frames >= 3, "{frames} frames with large rocks");
}

/// Texture within rocks with the sun behind the camera: more contrast at 1 pixel than at 2 to 4, as in frames of Chang'e-3 (0.18 and
/// 0.09 of the mean).
#[test]
fn texture_of_rocks_is_fine() {
    let (mut fine, mut coarse) = (Vec::new(), Vec::new());
    for seed in 0..10 {
        let set =
            ["rocks.coverage=0.06", "camera.fov_deg=22", "camera.pitch_deg=-10", "sun.elevation_deg=30"];
        let azimuth = format!("sun.azimuth_deg={}", 140 + 8 * seed);
        let scene = scene(seed, &[SURFACE, set[0], set[1], set[2], set[3], &azimuth]);
        let mut settings = RenderSettings::new([256, 256], 4).expect("settings");
        settings.annotations = [Annotation::Hdr].into_iter().collect();
        let frame = renderer().render(&scene, &settings).unwrap_or_else(|error| panic!("{error}")).0;
        if let Some([at_1, at_2_to_4]) = texture_bands(&frame, 256) {
            fine.push(at_1);
            coarse.push(at_2_to_4);
        }
    }
    let frames = fine.len();
    let ([fine], [coarse]) = (quantiles(fine, [0.5]), quantiles(coarse, [0.5]));
    println!("{frames} frames: texture of rocks {fine:.3} at 1 px, {coarse:.3} at 2 to 4 px");
    assert!(frames >= 5, "{frames} frames with rocks");
    assert!(fine > 1.15 * coarse, "{fine} at 1 px, {coarse} at 2 to 4 px");
    assert!((0.11..=0.26).contains(&fine), "{fine} at 1 px");
}

/// Brightness of rocks over the soil within 4 pixels of them, with the sun behind the camera: real rocks of Chang'e-3 have a median of
/// 1.45, and a tenth is below 1.08. Their albedo makes them so: with that of the soil they would be as bright as it.
#[test]
fn rocks_are_brighter_than_the_soil_beside_them() {
    let ratios = rocks_over_soil(12, "rocks.albedo_ratio=1.35");
    let rocks = ratios.len();
    let [low, middle, high] = quantiles(ratios, [0.1, 0.5, 0.9]);
    let [equal] = quantiles(rocks_over_soil(6, "rocks.albedo_ratio=1"), [0.5]);
    println!(
        "{rocks} rocks over the soil beside them: {low:.2}, {middle:.2}, {high:.2}; {equal:.2} if as bright"
    );
    assert!(rocks > 80, "{rocks} rocks");
    assert!((1.15..=1.75).contains(&middle), "median {middle}");
    assert!(low > 0.6 && high < 3.0, "from {low} to {high}");
    assert!(
        (0.85..1.15).contains(&equal) && middle > 1.15 * equal,
        "{middle}, but {equal} with the albedo of soil"
    );
}

/// Brightness of each larger rock over that of the soil within 4 pixels: pixels of the encoded image, taken to the power 2.2, medians over the
/// rock and its ring.
fn rocks_over_soil(seeds: u64, albedo: &str) -> Vec<f64> {
    const SIDE: usize = 256;
    let mut ratios = Vec::new();
    for seed in 0..seeds {
        let set =
            ["rocks.coverage=0.05", "camera.fov_deg=24", "camera.pitch_deg=-14", "sun.elevation_deg=28"];
        let azimuth = format!("sun.azimuth_deg={}", 140 + 7 * seed);
        let scene = scene(seed, &[SURFACE, set[0], set[1], set[2], set[3], &azimuth, albedo]);
        let mut settings = RenderSettings::new([SIDE as u32; 2], 4).expect("settings");
        settings.annotations = [Annotation::Instances].into_iter().collect();
        let frame = renderer().render(&scene, &settings).unwrap_or_else(|error| panic!("{error}")).0;
        let grey = |i: usize| {
            let rgb = &frame.rgb[3 * i..3 * i + 3];
            let weighted = 0.299 * f64::from(rgb[0]) + 0.587 * f64::from(rgb[1]) + 0.114 * f64::from(rgb[2]);
            (weighted / 255.0).powf(2.2)
        };
        for rock in frame.rocks.iter().filter(|rock| rock.visible_px >= 40) {
            let [left, top, right, bottom] = rock.box_px.map(|edge| edge as usize);
            let pixels = (top.saturating_sub(4)..=(bottom + 4).min(SIDE - 1))
                .flat_map(|y| (left.saturating_sub(4)..=(right + 4).min(SIDE - 1)).map(move |x| (x, y)));
            let (mut inside, mut ring) = (Vec::new(), Vec::new());
            for (x, y) in pixels {
                let i = y * SIDE + x;
                let near = |v: usize| v.saturating_sub(4)..=(v + 4).min(SIDE - 1);
                let is_rock = |i: usize| frame.instances[i] == rock.instance;
                if is_rock(i) {
                    inside.push(grey(i));
                } else if frame.class[i] == ClassId::REGOLITH.0
                    && near(y).any(|y| near(x).any(|x| is_rock(y * SIDE + x)))
                {
                    ring.push(grey(i));
                }
            }
            if ring.len() >= 20 {
                let ([rock], [soil]) = (quantiles(inside, [0.5]), quantiles(ring, [0.5]));
                ratios.push(rock / soil.max(1e-3));
            }
        }
    }
    ratios
}
