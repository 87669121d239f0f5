//! The shipped presets: the ranges that their knobs are drawn from.

use regolith::params::KNOBS;
use regolith::params::config::Config;

/// Seeds that are drawn.
const DRAWS: u64 = 300;

/// The values of a preset: each knob, the least and the greatest value.
type Ranges = &'static [(&'static str, f64, f64)];

/// The presets of the nominal stage, and those of the surface stage under the laws that were measured.
const PRESETS: [(&str, Ranges); 6] = [
    (
        "train_dr",
        &[
            ("sun.elevation_deg", 5.0, 40.0),
            ("sun.azimuth_deg", 100.0, 260.0),
            ("sun.intensity", 9000.0, 20_000.0),
            ("regolith.albedo", 0.10, 0.28),
            ("regolith.roughness", 0.85, 0.99),
            ("terrain.amplitude_m", 2.0, 4.8),
            ("craters.count", 5.0, 12.0),
            ("rocks.count", 70.0, 119.0),
            ("rocks.embedding", 0.22, 0.42),
            ("camera.height_m", 1.5, 2.7),
            ("camera.pitch_deg", -5.0, 1.5),
            ("camera.fov_deg", 52.0, 72.0),
            ("sky.star_count", 160.0, 300.0),
        ],
    ),
    (
        "train_nodr",
        &[
            ("sun.elevation_deg", 22.0, 22.0),
            ("sun.azimuth_deg", 120.0, 120.0),
            ("sun.intensity", 14_000.0, 14_000.0),
            ("regolith.albedo", 0.18, 0.18),
            ("regolith.roughness", 0.94, 0.94),
            ("terrain.amplitude_m", 3.2, 3.2),
            ("craters.count", 5.0, 12.0),
            ("rocks.count", 70.0, 119.0),
            ("rocks.embedding", 0.30, 0.30),
            ("camera.height_m", 2.0, 2.0),
            ("camera.pitch_deg", -0.9, -0.9),
            ("camera.fov_deg", 62.0, 62.0),
            ("sky.star_count", 220.0, 220.0),
        ],
    ),
    (
        "test_photoreal",
        &[
            ("sun.elevation_deg", 42.0, 70.0),
            ("sun.azimuth_deg", 100.0, 260.0),
            ("sun.intensity", 20_000.0, 32_000.0),
            ("regolith.albedo", 0.28, 0.42),
            ("regolith.roughness", 0.70, 0.85),
            ("terrain.amplitude_m", 4.8, 7.0),
            ("craters.count", 10.0, 19.0),
            ("rocks.count", 40.0, 89.0),
            ("rocks.embedding", 0.30, 0.55),
            ("camera.height_m", 2.5, 3.6),
            ("camera.pitch_deg", -9.0, -3.0),
            ("camera.fov_deg", 70.0, 85.0),
            ("sky.star_count", 120.0, 260.0),
        ],
    ),
    (
        "surface_train_dr",
        &[
            ("sun.elevation_deg", 9.0, 26.0),
            ("sun.azimuth_deg", 100.0, 240.0),
            ("sun.intensity", 2600.0, 4400.0),
            ("regolith.albedo", 0.09, 0.17),
            ("relief.hills_m", 6.0, 12.0),
            ("relief.undulation_m", 1.6, 3.2),
            ("relief.slope_deg", 7.0, 13.0),
            ("relief.hurst", 0.6, 0.85),
            ("craters.density", 0.5, 1.2),
            ("craters.fresh_share", 0.01, 0.05),
            ("rocks.coverage", 0.002, 0.03),
            ("rocks.albedo_ratio", 1.0, 1.6),
            ("hapke.w", 0.17, 0.40),
            ("hapke.c", -0.1, 0.45),
            ("camera.height_m", 1.6, 2.8),
            ("camera.pitch_deg", -12.0, -3.0),
            ("camera.fov_deg", 54.0, 70.0),
            ("camera.yaw_deg", -12.0, 12.0),
            ("sky.star_count", 120.0, 200.0),
        ],
    ),
    (
        "surface_train_nodr",
        &[
            ("sun.elevation_deg", 15.0, 15.0),
            ("sun.azimuth_deg", 135.0, 135.0),
            ("sun.intensity", 3500.0, 3500.0),
            ("regolith.albedo", 0.12, 0.12),
            ("relief.hills_m", 9.0, 9.0),
            ("relief.undulation_m", 2.4, 2.4),
            ("relief.slope_deg", 10.0, 10.0),
            ("relief.hurst", 0.75, 0.75),
            ("craters.density", 1.0, 1.0),
            ("craters.fresh_share", 0.03, 0.03),
            ("rocks.coverage", 0.008, 0.008),
            ("rocks.albedo_ratio", 1.35, 1.35),
            ("camera.height_m", 2.1, 2.1),
            ("camera.pitch_deg", -7.0, -7.0),
            ("camera.fov_deg", 60.0, 60.0),
            ("camera.yaw_deg", 0.0, 0.0),
            ("sky.star_count", 150.0, 150.0),
        ],
    ),
    (
        "surface_test_photoreal",
        &[
            ("sun.elevation_deg", 28.0, 46.0),
            ("sun.azimuth_deg", 100.0, 240.0),
            ("sun.intensity", 1800.0, 2800.0),
            ("regolith.albedo", 0.17, 0.26),
            ("relief.hills_m", 11.0, 16.0),
            ("relief.undulation_m", 3.0, 4.5),
            ("relief.slope_deg", 8.0, 14.0),
            ("relief.hurst", 0.6, 0.85),
            ("craters.density", 0.8, 1.5),
            ("craters.fresh_share", 0.03, 0.10),
            ("rocks.coverage", 0.01, 0.1),
            ("rocks.albedo_ratio", 1.1, 1.8),
            ("hapke.w", 0.25, 0.45),
            ("hapke.c", 0.0, 0.45),
            ("camera.height_m", 2.6, 3.6),
            ("camera.pitch_deg", -16.0, -8.0),
            ("camera.fov_deg", 70.0, 84.0),
            ("camera.yaw_deg", -15.0, 15.0),
            ("sky.star_count", 100.0, 180.0),
        ],
    ),
];

#[test]
fn presets_draw_their_knobs_from_the_stated_ranges() {
    for (preset, ranges) in PRESETS {
        let mut config = Config::new();
        config.apply_preset(preset).expect("a preset");
        let draws: Vec<_> = (0..DRAWS).map(|seed| config.draw(seed).expect("drawn").to_json()).collect();
        for (name, least, greatest) in ranges {
            assert!(KNOBS.iter().any(|info| info.name == *name), "no knob {name}");
            let values = draws.iter().map(|draw| draw[*name].as_f64().expect("a number"));
            let [low, high] =
                values.fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(value), high.max(value)]);
            // Of 300 uniform numbers the extremes are nearer than a twentieth of the range to its ends but for one case in a million.
            let margin = 0.05 * (greatest - least);
            let is_near = |found: f64, end: f64| (found - end).abs() <= margin + 1e-9;
            let is_within = low >= least - 1e-9 && high <= greatest + 1e-9;
            assert!(
                is_within && is_near(low, *least) && is_near(high, *greatest),
                "{preset}: {name} is {low} to {high}, not {least} to {greatest}"
            );
        }
    }
}
