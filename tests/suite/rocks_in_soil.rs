//! How rocks lie in the soil, and how many of them there are.

#![allow(clippy::print_stdout, reason = "measurements for runs with --nocapture")]

use regolith::scene::Scene;
use regolith::scene::rocks::lunar::rocks_larger_than;

use crate::support::scene;

const SURFACE: &str = "stage.name=surface";

/// Rocks of more than a diameter on the ground ahead of the camera between two distances, and the area of that ground.
fn rocks_ahead(scene: &Scene, [near_m, far_m]: [f32; 2], min_m: f32) -> (usize, f64) {
    // A sector of 40 degrees, which lies within the field of view.
    let half = 20.0_f32.to_radians();
    let eye = scene.camera.eye.truncate();
    let count = scene.rocks.iter().filter(|rock| {
        let offset = rock.centre.truncate() - eye;
        let is_ahead = offset.y > 0.0 && (offset.x / offset.y).abs() < half.tan();
        is_ahead && (near_m..far_m).contains(&offset.length()) && 2.0 * rock.base_scale_m > min_m
    });
    (count.count(), f64::from(half * (far_m * far_m - near_m * near_m)))
}

/// Li and Wu 2018, at three distances: no rock that spans 2 mrad, less than a pixel of an image 512 wide, is left out.
#[test]
fn small_rocks_follow_the_lunar_law_at_every_distance() {
    for coverage in [0.005, 0.03, 0.08] {
        let set = format!("rocks.coverage={coverage}");
        let scenes: Vec<Scene> =
            (0..4).map(|seed| scene(seed, &[SURFACE, &set, "craters.fresh_share=0"])).collect();
        for ring_m in [[6.0, 12.0], [12.0, 24.0], [24.0, 48.0]] {
            let min_m = 2.1e-3 * ring_m[1];
            let (mut count, mut area_m2) = (0, 0.0);
            for scene in &scenes {
                let (rocks, m2) = rocks_ahead(scene, ring_m, min_m);
                (count, area_m2) = (count + rocks, area_m2 + m2);
            }
            let expected = area_m2 * rocks_larger_than(f64::from(min_m.max(0.032)), coverage);
            println!("coverage {coverage}, {ring_m:?} m: {count} rocks of {min_m:.3} m, {expected:.0} expected");
            assert!(
                (count as f64 - expected).abs() < 3.3 * expected.sqrt(),
                "coverage {coverage}, {ring_m:?} m: {count} rocks for {expected:.0}"
            );
        }
    }
}
