//! The far field of the surface stage: hills on the horizon.

use glam::Vec2;
use regolith::class::ClassId;
use regolith::frame::Frame;
use regolith::scene::Scene;

use crate::support::{render, scene};

fn with_hills(seed: u64, height_m: u32) -> Scene {
    scene(seed, &["stage.name=surface", "camera.pitch_deg=0", &format!("relief.far_hills_m={height_m}")])
}

/// Angle of the skyline above the horizontal in each column, degrees.
fn skyline_deg(scene: &Scene, frame: &Frame) -> Vec<f64> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let focal_px = scene.camera.focal_px(frame.width);
    let top = |x: usize| (0..height).find(|y| frame.class[y * width + x] != ClassId::SKY.0).unwrap_or(height);
    (0..width).map(|x| ((0.5 * height as f64 - top(x) as f64) / focal_px).atan().to_degrees()).collect()
}

#[test]
fn far_hills_rise_on_the_horizon_and_leave_the_ground_near_the_camera() {
    const HEIGHT_M: u32 = 120;
    let (mut highest, mut lowest) = (0.0_f64, f64::MAX);
    for seed in [3, 4, 5] {
        let (level, hilly) = (with_hills(seed, 0), with_hills(seed, HEIGHT_M));
        let centre = level.camera.eye.truncate();
        let (mut near, mut top_m) = (0, 0.0_f32);
        for (a, b) in level.terrain.vertices.iter().zip(&hilly.terrain.vertices) {
            let from_m = a.position.truncate().distance(centre);
            if from_m < 0.32 * level.terrain.half_extent_m {
                assert_eq!(a.position, b.position, "seed {seed}, {from_m} m away");
                near += 1;
            }
            top_m = top_m.max(b.position.z - a.position.z);
        }
        assert!(near > 1000, "seed {seed}");
        assert!(top_m > 0.4 * HEIGHT_M as f32 && top_m < 1.7 * HEIGHT_M as f32, "seed {seed}: {top_m} m");
        assert_eq!(level.camera.eye, hilly.camera.eye);
        assert_eq!(
            level.terrain.height_at(centre + Vec2::new(50.0, 80.0)),
            hilly.terrain.height_at(centre + Vec2::new(50.0, 80.0))
        );
        let [flat, skyline] = [&level, &hilly].map(|scene| skyline_deg(scene, &render(scene, 160, 1)));
        for (flat, hills) in flat.iter().zip(&skyline) {
            highest = highest.max(hills - flat);
            lowest = lowest.min(hills - flat);
        }
    }
    // Hills of 120 m some 900 m away span up to 7 degrees or a little more, and leave gaps.
    assert!(highest > 2.5 && highest < 13.0, "{highest} degrees above the level horizon");
    assert!(lowest < 1.0, "{lowest} degrees");
}
