//! Soil below the size of the mesh's cells: parallax, occlusion and shadows as those of geometry; rocks as the camera moves; light from
//! rocks.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use std::collections::BTreeMap;

use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::render::RenderSettings;
use regolith::scene::Scene;

use crate::support::{renderer, scene};

const SURFACE: &str = "stage.name=surface";

fn frame(scene: &Scene, side: u32, annotations: &[Annotation]) -> Frame {
    let mut settings = RenderSettings::new([side, side], 4).expect("settings");
    settings.annotations = annotations.iter().copied().collect();
    renderer().render(scene, &settings).unwrap_or_else(|error| panic!("{error}")).0
}

fn green(frame: &Frame, pixel: usize) -> f64 {
    f64::from(frame.radiance[3 * pixel + 1].to_f32())
}

/// Mean radiance of soil that no mesh shadows in either frame, and its differences between neighbours along rows over those along
/// columns: strokes along rows make that small.
fn soil(frames: [&Frame; 2], side: usize) -> [[f64; 2]; 2] {
    let is_soil = |pixel: usize| {
        frames
            .iter()
            .all(|frame| frame.class[pixel] == ClassId::REGOLITH.0 && frame.sun_occlusion[pixel] < 128)
    };
    frames.map(|frame| {
        let (mut sum, mut n, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
        for (y, x) in (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| (y, x))) {
            let pixel = y * side + x;
            if [pixel, pixel + 1, pixel + side].into_iter().all(is_soil) {
                let value = green(frame, pixel);
                sum += value;
                n += 1.0;
                along += (green(frame, pixel + 1) - value).abs();
                across += (green(frame, pixel + side) - value).abs();
            }
        }
        assert!(n > 1000.0, "{n} pixels of sunlit soil");
        [sum / n, along / across]
    })
}

/// Soil without grains under a sun at an elevation and an azimuth, degrees: most of its relief in the shading, and most in the mesh.
fn shaded_and_meshed(seed: u64, [elevation_deg, azimuth_deg]: [u32; 2], side: u32) -> [Frame; 2] {
    let sun = [format!("sun.elevation_deg={elevation_deg}"), format!("sun.azimuth_deg={azimuth_deg}")];
    ["terrain.cell_mrad=12", "terrain.cell_mrad=4"].map(|cells| {
        let set = [
            SURFACE,
            &sun[0],
            &sun[1],
            "camera.pitch_deg=-13",
            "camera.fov_deg=20",
            "camera.height_m=1.6",
            "rocks.coverage=0",
            "grains.density=0",
            "regolith.mottling=0",
            cells,
        ];
        frame(&scene(seed, &set), side, &[Annotation::Hdr, Annotation::Shadow])
    })
}

/// Green radiance in squares of 16 pixels of a square image.
fn squares(frame: &Frame, side: usize) -> impl Iterator<Item = Vec<f64>> {
    const SQUARE: usize = 16;
    let corners =
        (0..side / SQUARE).flat_map(move |y| (0..side / SQUARE).map(move |x| (x * SQUARE, y * SQUARE)));
    corners.map(move |(x, y)| {
        let pixels = (0..SQUARE * SQUARE).map(|k| (y + k / SQUARE) * side + x + k % SQUARE);
        pixels.map(|pixel| green(frame, pixel)).collect()
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation of the radiance of soil over its mean in squares of 16 pixels, averaged over these.
fn contrast(frame: &Frame, side: usize) -> f64 {
    let contrasts = squares(frame, side).map(|values| {
        let middle = mean(&values);
        let deviations: Vec<f64> = values.iter().map(|value| (value - middle).powi(2)).collect();
        mean(&deviations).sqrt() / middle
    });
    mean(&contrasts.collect::<Vec<f64>>())
}

/// With the sun behind the camera most shadows lie hidden behind the bumps that cast them.
#[test]
fn relief_hides_its_own_shadows_from_an_eye_before_the_sun() {
    const SIDE: usize = 320;
    let ratios = [(32, 200), (33, 170)].map(|(seed, azimuth_deg)| {
        let [shaded, meshed] =
            shaded_and_meshed(seed, [15, azimuth_deg], SIDE as u32).map(|frame| contrast(&frame, SIDE));
        println!("sun at {azimuth_deg}: contrast {shaded:.4}, {meshed:.4}");
        shaded / meshed
    });
    assert!(ratios.iter().all(|ratio| (0.8..1.25).contains(ratio)), "{ratios:.3?}");
}

/// Correlation of the radiance of two frames, less its means in squares of 16 pixels.
fn correlation(frames: [&Frame; 2], side: usize) -> f64 {
    let [mut product, mut first, mut second] = [0.0; 3];
    for (a, b) in squares(frames[0], side).zip(squares(frames[1], side)) {
        let (mean_a, mean_b) = (mean(&a), mean(&b));
        for (a, b) in a.iter().map(|a| a - mean_a).zip(b.iter().map(|b| b - mean_b)) {
            product += a * b;
            first += a * a;
            second += b * b;
        }
    }
    product / (first * second).sqrt()
}

/// A mesh with cells a third as large has most of the relief that shading adds otherwise. Both must agree where the sun is low and in
/// front, pixel by pixel: relief is seen where the eye's rays meet it, hides what is behind it, and shadows it.
#[test]
fn relief_below_the_mesh_looks_as_geometry_does() {
    const SIDE: usize = 320;
    let mut ratios = Vec::new();
    for (seed, azimuth_deg) in [(1007, 330), (21, 20), (22, 60)] {
        let [shaded, meshed] = shaded_and_meshed(seed, [9, azimuth_deg], SIDE as u32);
        let [[level, strokes], [true_level, true_strokes]] = soil([&shaded, &meshed], SIDE);
        let same = correlation([&shaded, &meshed], SIDE);
        println!(
            "sun at {azimuth_deg}: mean {level:.4}, {true_level:.4}; strokes {strokes:.3}, {true_strokes:.3}; correlation {same:.3}"
        );
        ratios.push([level / true_level, strokes / true_strokes, same]);
    }
    // By slopes alone the soil is a third brighter, and its strokes are 0.91 of what they should be.
    for (k, bounds) in [(0, 0.92..=1.08), (1, 0.95..=1.05), (2, 0.8..=1.0)] {
        let mean = ratios.iter().map(|ratio| ratio[k]).sum::<f64>() / ratios.len() as f64;
        assert!(bounds.contains(&mean), "{k}: {ratios:.3?}");
    }
}

/// Under a high sun only what is steep is dark. The crests of pits below the mesh, which finer relief lifts as it lifts the ground beside
/// them, must not draw thin dark arcs there: with them the ground has 1.27 times the dark pixels of a mesh that has the pits.
#[test]
fn crests_below_the_mesh_draw_no_dark_arcs() {
    const SIDE: usize = 512;
    let dark_pixels = |seed: u64, cells: &str| {
        let set = [
            SURFACE,
            "sun.elevation_deg=40",
            "sun.azimuth_deg=60",
            "camera.pitch_deg=-35",
            "camera.height_m=2",
            "rocks.coverage=0",
            "grains.density=0",
            "regolith.mottling=0",
            cells,
        ];
        let frame = frame(&scene(seed, &set), SIDE as u32, &[Annotation::Hdr]);
        let of_square = |values: Vec<f64>| {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            values.iter().filter(|value| **value < 0.4 * sorted[sorted.len() / 2]).count()
        };
        squares(&frame, SIDE).map(of_square).sum::<usize>()
    };
    let ratios = [41, 42].map(|seed| {
        let counts = ["terrain.cell_mrad=12", "terrain.cell_mrad=4"].map(|cells| dark_pixels(seed, cells));
        println!("{counts:?} dark pixels");
        assert!(counts[1] > 500, "{counts:?} dark pixels");
        counts[0] as f64 / counts[1] as f64
    });
    assert!(mean(&ratios) < 1.22, "{ratios:.3?} times the dark pixels of a finer mesh");
}

/// A camera that drives on by two centimetres sees the rocks that it saw, as large as they were.
#[test]
fn rocks_do_not_pop_as_the_camera_drives() {
    const SIDE: u32 = 256;
    let rocks = |y_m: f64| {
        let y = format!("camera.y_m={y_m}");
        let scene = scene(6, &[SURFACE, "rocks.coverage=0.03", "camera.pitch_deg=-10", &y]);
        let frame = frame(&scene, SIDE, &[Annotation::Instances]);
        let of = |rock: &regolith::frame::RockLabel| {
            let centre = scene.rocks[usize::from(rock.instance) - 1].centre;
            let is_inside = rock.box_px.iter().all(|edge| (3..SIDE as i64 - 3).contains(&i64::from(*edge)));
            (centre.truncate().to_array().map(f32::to_bits), (rock.visible_px, is_inside))
        };
        frame.rocks.iter().map(of).collect::<BTreeMap<_, _>>()
    };
    let (mut compared, mut lost, mut other) = (0, 0, 0);
    let mut before = rocks(-90.0);
    for k in 1..5 {
        let now = rocks(-90.0 + 0.02 * f64::from(k));
        for (position, (visible_px, is_inside)) in &before {
            if *visible_px < 9 || !is_inside {
                continue;
            }
            compared += 1;
            let seen_px = now.get(position).map_or(0, |(visible_px, _)| *visible_px);
            let ratio = f64::from(seen_px) / f64::from(*visible_px);
            lost += u32::from(seen_px == 0);
            other += u32::from(!(0.6..1.7).contains(&ratio));
        }
        before = now;
    }
    println!("{compared} rocks: {lost} vanish, {other} change their size");
    assert!(compared > 100, "{compared} rocks");
    assert!(
        lost == 0 && 100 * other < compared,
        "{lost} of {compared} rocks vanish, {other} change their size"
    );
}

/// Soil in the shadow of rocks receives light from sunlit rocks beside it: more from brighter ones. All else there comes from soil.
#[test]
fn sunlit_rocks_light_the_shadows_beside_them() {
    const SIDE: usize = 192;
    let in_shadow = |ratio: &str| {
        let set = [
            SURFACE,
            "rocks.coverage=0.06",
            "sun.elevation_deg=25",
            "sun.azimuth_deg=90",
            "camera.pitch_deg=-22",
            "camera.fov_deg=40",
            "grains.density=0",
            ratio,
        ];
        let frame = frame(&scene(12, &set), SIDE as u32, &[Annotation::Hdr, Annotation::Shadow]);
        let dark = (0..SIDE * SIDE)
            .filter(|pixel| frame.class[*pixel] == ClassId::REGOLITH.0 && frame.sun_occlusion[*pixel] == 255);
        let values: Vec<f64> = dark.map(|pixel| green(&frame, pixel)).collect();
        (values.iter().sum::<f64>() / values.len() as f64, values.len())
    };
    let ((dim, pixels), (bright, _)) =
        (in_shadow("rocks.albedo_ratio=0.5"), in_shadow("rocks.albedo_ratio=2"));
    println!("{pixels} pixels in shadow: {dim:.6} beside dark rocks, {bright:.6} beside bright ones");
    assert!(pixels > 300, "{pixels} pixels in shadow");
    assert!(bright > 1.1 * dim, "{dim} beside dark rocks, {bright} beside bright ones");
}
