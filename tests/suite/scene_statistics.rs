//! The scenes of 200 seeds compared with the specification of the nominal stage.

use std::sync::LazyLock;

use glam::Vec2;
use regolith::class::ClassId;
use regolith::frame::{Annotation, Frame};
use regolith::lens::Lens;
use regolith::render::RenderSettings;
use regolith::scene::Scene;
use regolith::scene::mesh::Icosphere;

use crate::support::{params, render, renderer, scene};

const SEEDS: u64 = 200;
const NEAR: usize = 12;

static SCENES: LazyLock<Vec<Scene>> = LazyLock::new(|| (0..SEEDS).map(|seed| scene(seed, &[])).collect());

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0));
    sum / n
}

/// Kolmogorov-Smirnov statistic of the values against the uniform distribution over a range, times the square root of their
/// number: it exceeds 1.95 with a probability of 0.001.
fn ks_uniform(values: impl Iterator<Item = f64>, low: f64, high: f64) -> f64 {
    let mut sorted: Vec<f64> = values.map(|value| (value - low) / (high - low)).collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let worst = (0..).zip(&sorted).fold(0.0_f64, |worst, (i, value)| {
        let (below, above) = (f64::from(i) / n, f64::from(i + 1) / n);
        worst.max((value - below).abs()).max((above - value).abs())
    });
    worst * n.sqrt()
}

#[test]
fn counts_are_uniform_over_their_ranges() {
    let mut rocks = [0_u32; 40];
    let mut craters = [0_u32; 5];
    for scene in SCENES.iter() {
        rocks[scene.rocks.len() - 75] += 1;
        craters[scene.terrain.craters.len() - 6] += 1;
        assert_eq!(scene.sky.stars.len(), 220);
    }
    assert!(rocks.iter().filter(|count| **count > 0).count() > 35, "{rocks:?}");
    assert!(craters.iter().all(|count| (20..=65).contains(count)), "{craters:?}");
    let middle = mean(SCENES.iter().map(|scene| scene.rocks.len() as f64));
    assert!((middle - 94.5).abs() < 3.0, "{middle}");
}

#[test]
fn craters_have_the_stated_sizes() {
    let craters: Vec<_> = SCENES.iter().flat_map(|scene| &scene.terrain.craters).collect();
    for crater in &craters {
        assert!(crater.centre.abs().max_element() <= 383.0);
        assert!((10.0..38.0).contains(&crater.radius_m) && (1.5..5.5).contains(&crater.depth_m));
        assert!((0.18..0.35).contains(&(crater.rim_m / crater.depth_m)));
    }
    let all = |value: fn(&regolith::scene::nominal_craters::Crater) -> f32| {
        craters.iter().map(move |c| f64::from(value(c)))
    };
    assert!(ks_uniform(all(|c| c.radius_m), 10.0, 38.0) < 1.95);
    assert!(ks_uniform(all(|c| c.depth_m), 1.5, 5.5) < 1.95);
    assert!(ks_uniform(all(|c| c.centre.x), -383.0, 383.0) < 1.95);
    assert!(ks_uniform(all(|c| c.centre.y), -383.0, 383.0) < 1.95);
}

#[test]
fn rocks_have_the_stated_sizes_positions_and_detail() {
    let mut large = 0.0;
    let mut far_count = 0.0;
    for rock in SCENES.iter().flat_map(|scene| &scene.rocks) {
        let near = (rock.index as usize) < NEAR;
        let base = rock.base_scale_m;
        let at = rock.centre;
        if rock.moved {
            continue;
        }
        if near {
            assert!((1.2..3.0).contains(&base) && at.x.abs() <= 55.0 && (-78.0..-48.0).contains(&at.y));
        } else {
            assert!((0.3..1.3 * 3.3).contains(&base) && at.x.abs() <= 95.0 && (-78.0..230.0).contains(&at.y));
            far_count += 1.0;
            large += f64::from(u8::from(base >= 1.3));
        }
        let vertices = [(1.8, 10_242), (0.9, 2_562), (0.45, 642), (0.0, 162)];
        let expected = vertices.iter().find(|(from, _)| base >= *from).map(|(_, count)| *count);
        assert_eq!(Some(rock.vertices.len()), expected);
        assert_eq!(Icosphere::vertex_count(rock.level), rock.vertices.len());
        let grey = rock.material.albedo.element_sum() / 3.0;
        assert!((0.05..0.14).contains(&grey), "{grey}");
        assert!((0.85..0.97).contains(&rock.material.roughness));
    }
    // 15 % are made 2.0 to 3.3 times larger; LARGE_BEYOND of those exceed 1.3 m (by integration).
    let share = large / far_count;
    assert!((share - 0.15 * LARGE_BEYOND).abs() < 0.01, "{share}");
    let near = |value: fn(&regolith::scene::rocks::Rock) -> f32| {
        let rocks = SCENES.iter().flat_map(|scene| scene.rocks.iter().take(NEAR)).filter(|rock| !rock.moved);
        rocks.map(move |rock| f64::from(value(rock)))
    };
    assert!(ks_uniform(near(|rock| rock.base_scale_m), 1.2, 3.0) < 1.95);
    assert!(ks_uniform(near(|rock| rock.centre.y), -78.0, -48.0) < 1.95);
}
/// Probability that uniform(0.3, 1.3) x uniform(2.0, 3.3) is at least 1.3: 1 - (1.3 ln(3.3 / 2) / 1.3 - 0.3).
const LARGE_BEYOND: f64 = 1.3 - 0.500_775;

#[test]
fn an_authored_scene_has_about_0_7_million_triangles() {
    let triangles = mean(SCENES.iter().map(|scene| {
        let rocks: usize = scene.rocks.iter().map(|rock| rock.triangles(rock.level).len()).sum();
        2.0 * f64::from(scene.terrain.columns).powi(2) + rocks as f64
    }));
    assert!((0.45e6..0.8e6).contains(&triangles), "{triangles}");
}

#[test]
fn relief_has_the_stated_deviation() {
    let deviation = mean((0..20).map(|seed| {
        let scene = scene(seed, &["craters.count=0"]);
        let heights: Vec<f64> = scene.terrain.vertices.iter().map(|v| f64::from(v.position.z)).collect();
        let middle = mean(heights.iter().copied());
        mean(heights.iter().map(|height| (height - middle).powi(2))).sqrt()
    }));
    assert!((0.6..1.0).contains(&deviation), "{deviation} m");
}

#[test]
fn at_least_three_near_rocks_are_in_the_field_of_view() {
    let mut min = usize::MAX;
    for scene in SCENES.iter() {
        let eye = scene.camera.eye.truncate();
        let in_view = scene.rocks.iter().take(NEAR).filter(|rock| {
            let offset: Vec2 = rock.centre.truncate() - eye;
            offset.y > 0.0 && offset.x.abs() <= offset.y * scene.camera.tan_half_fov
        });
        min = min.min(in_view.count());
    }
    assert!(min >= 3, "{min}");
}

#[test]
fn no_rock_floats_and_none_is_close_to_the_camera() {
    for scene in SCENES.iter() {
        for rock in &scene.rocks {
            let lowest =
                rock.vertices.iter().map(|v| v.position + rock.centre).min_by(|a, b| a.z.total_cmp(&b.z));
            let lowest = lowest.expect("a rock has vertices");
            let ground = scene.terrain.surface_height_at(lowest.truncate());
            assert!(lowest.z < ground, "rock {} floats {} m", rock.index, lowest.z - ground);
            let nearest = rock
                .vertices
                .iter()
                .map(|v| (v.position + rock.centre).distance(scene.camera.eye))
                .fold(f32::INFINITY, f32::min);
            assert!(nearest >= 0.5, "rock {} is {nearest} m from the camera", rock.index);
        }
        let below = scene.camera.eye.z - scene.terrain.height_at(scene.camera.eye.truncate());
        assert!((below - 2.0).abs() < 1e-4);
    }
}

#[test]
fn no_rock_lies_beyond_the_border_of_the_ground() {
    for (seed, set) in [
        (3, &["terrain.size_m=200"][..]),
        (9, &["terrain.size_m=200", "terrain.amplitude_m=10"]),
        (5, &["terrain.size_m=100", "camera.y_m=-45", "rocks.count=200"]),
        (7, &["stage.name=surface", "craters.fresh_share=1", "camera.height_m=100"]),
        (40, &["stage.name=surface", "camera.height_m=100"]),
        (9, &["stage.name=surface", "terrain.size_m=200", "camera.height_m=20"]),
        (9, &["stage.name=surface", "terrain.size_m=200", "rocks.law=bands"]),
    ] {
        let scene = scene(seed, set);
        assert!(scene.rocks.len() > 20, "{set:?}");
        for rock in &scene.rocks {
            let points = rock.vertices.iter().map(|v| (v.position + rock.centre).truncate());
            let beyond = points.filter(|point| !scene.terrain.contains(*point)).count();
            assert_eq!(beyond, 0, "seed {seed}, {set:?}: rock {} at {}", rock.index, rock.centre);
        }
    }
}

#[test]
fn no_two_scenes_have_a_rock_at_the_same_position() {
    let mut positions: Vec<[u32; 2]> = SCENES
        .iter()
        .flat_map(|scene| scene.rocks.iter().map(|rock| [rock.centre.x.to_bits(), rock.centre.y.to_bits()]))
        .collect();
    let count = positions.len();
    positions.sort_unstable();
    positions.dedup();
    assert_eq!(positions.len(), count);
}

/// Instance ids have 16 bits: where more rocks would be in view, the smallest are left out.
#[test]
fn a_scene_has_at_most_as_many_rocks_as_there_are_ids() {
    let set = ["stage.name=surface", "craters.fresh_share=1", "craters.density=1.6", "rocks.coverage=0.008"];
    let view = ["camera.fov_deg=130", "camera.height_m=6", "camera.pitch_deg=-50"];
    let scene = scene(5, &[&set[..], &view[..]].concat());
    let count = scene.rocks.count();
    assert!((40_000..=60_000).contains(&count), "{count} rocks");
}

/// Mean coverage of the classes over 200 frames; a training frame typically has 1 to 10 % of rock.
#[test]
fn coverage_suits_training() {
    let mut typical = 0;
    let (mut rock_sum, mut sky_sum) = (0.0, 0.0);
    for scene in SCENES.iter() {
        let frame = render(scene, 64, 1);
        let rock = frame.coverage(ClassId::ROCK);
        assert!(rock > 0.0, "three near rocks are in view");
        typical += u32::from((0.01..=0.10).contains(&rock));
        rock_sum += rock;
        sky_sum += frame.coverage(ClassId::SKY);
    }
    let (rock, sky) = (rock_sum / SEEDS as f64, sky_sum / SEEDS as f64);
    assert!(typical >= 150, "only {typical} of {SEEDS} frames have 1 to 10 % of rock");
    assert!((0.02..0.09).contains(&rock) && (0.42..0.50).contains(&sky), "rock {rock}, sky {sky}");
}

#[test]
fn every_knob_changes_the_frame() {
    use regolith::params::{KNOBS, Kind, Knob, Stage};
    let mut checked = 0;
    for (stage, name) in Stage::ALL {
        let stage_name = format!("stage.name={name}");
        for info in KNOBS.iter().filter(|info| info.is_of(stage) && info.name != "stage.name") {
            // A value far from the default, and the setting without which the knob has no effect.
            let other = match info.name {
                "sun.color" => "[0.5, 1.0, 0.5]",
                "sun.angular_diameter_deg" => "5",
                "rocks.near_count" => "3",
                "rocks.large_share" => "1",
                "rocks.large_factor" => "5",
                "rocks.hero_x_m" | "rocks.hero_y_m" => "-70",
                "rocks.coverage" => "0.03",
                "camera.y_m" => "-100",
                "terrain.size_m" => "700",
                "rocks.near_y_m" => "-60",
                "craters.radius_m" | "terrain.amplitude_m" | "craters.depth_m" => "12",
                "photometry.law" => "lommel_seeliger",
                "sensor.kind" => "mono",
                "rover.kind" => "rover",
                "rover.visible" | "tracks.own" => "yes",
                "sky.earthshine" | "tracks.depth_m" | "sensor.stretch" => "0.05",
                "tracks.count" => "2",
                "tracks.distance_m" => "4",
                "tracks.grouser_m" => "0.02",
                "craters.law" => "classes",
                "rocks.law" => "bands",
                "sensor.read_noise_e" | "sensor.dark_e" | "sensor.dsnu_e" => "900",
                "sensor.bits" => "5",
                "sensor.vignetting" => "1",
                "sensor.flare" => "0.1",
                "sky.star_gain" if stage == Stage::Nominal => "0.02",
                "sky.star_gain" => "1",
                "label.too_small" | "label.unseen" => "ignore",
                "label.unseen_contrast" => "100",
                "sensor.grain" | "sensor.halation" | "sensor.glare" | "sensor.prnu"
                | "sensor.black_level" => "0.2",
                "label.min_pixels" => "9999",
                "regolith.mottling" => "0.3",
                "wall.height_m" | "wall.slope_deg" => "30",
                "wall.distance_m" | "wall.radius_m" => "400",
                "label.min_diameter_m" => "10",
                "label.crater_min_diameter_m" => "100",
                "relief.slope_deg" => "20",
                "relief.clods" => "0",
                "camera.k1" | "camera.k2" | "camera.k3" => "0.2",
                "camera.p1" | "camera.p2" => "0.05",
                _ if info.kind == Kind::Integer => "17",
                _ if info.range[1] >= 5000.0 => "800",
                _ if info.range[1] >= 30.0 => "30",
                _ => "0.5",
            };
            let section = info.name.split_once('.').map_or("", |(section, _)| section);
            let needed = match section {
                "hapke" => "photometry.law=hapke",
                "craters" if stage == Stage::Surface && info.name.ends_with("_count") => {
                    "craters.law=classes"
                }
                "rocks" if stage == Stage::Surface && info.name.ends_with("_count") => "rocks.law=bands",
                "tracks" if info.name == "tracks.own" => {
                    "rover.kind=rover rover.heading_deg=180 camera.pitch_deg=-50"
                }
                "tracks" if info.name != "tracks.count" => "tracks.count=2",
                // Of the sun.
                "rover" if info.name == "rover.visible" => {
                    "rover.kind=rover rover.heading_deg=180 camera.pitch_deg=-50"
                }
                "rover" if info.name != "rover.kind" => "rover.kind=rover",
                "sensor" if info.name == "sensor.flare" => "sensor.kind=bayer sun.azimuth_deg=0",
                // Of metering.
                "sensor" if info.name == "sensor.gain_max_ev" => {
                    "sensor.kind=bayer sensor.ground_level=0.9 camera.exposure_ev=-3"
                }
                "sensor" if info.name != "sensor.kind" => "sensor.kind=bayer",
                "rocks" if info.name.starts_with("rocks.hero_") && info.name != "rocks.hero_scale_m" => {
                    "rocks.hero_scale_m=2"
                }
                "wall" if info.name != "wall.height_m" => "wall.height_m=60",
                "regolith" if info.name == "regolith.rays" => "craters.fresh_share=0.5",
                // Grains are seen from nearby.
                "grains" => "camera.height_m=0.3",
                // Hapke's law has its own roughness.
                "regolith" | "rocks" if info.name.ends_with("roughness") => "photometry.law=oren_nayar",
                "label" if info.name == "label.too_small" => "label.min_pixels=100",
                "label" if info.name.starts_with("label.unseen_") => "label.unseen=ignore",
                "label" if info.name == "label.unseen" => "label.unseen_contrast=100",
                "label" if stage == Stage::Nominal && info.name.contains("crater") => "craters.count=200",
                "sky" if stage == Stage::Surface => "sky.star_count=5000",
                _ => "camera.roll_deg=0",
            };
            let set = format!("{}={other}", info.name);
            let needed: Vec<&str> = [&*stage_name].into_iter().chain(needed.split(' ')).collect();
            let before = scene(32, &needed);
            let after = scene(32, &[&needed[..], &[&set]].concat());
            let frame = |scene: &Scene| {
                let mut settings = RenderSettings::new([96, 96], 1).expect("settings");
                if info.name.starts_with("label.crater") {
                    settings.annotations = settings.annotations.with(Annotation::Craters);
                }
                let frame = renderer().render(scene, &settings).expect("a frame").0;
                // What the planes show, not what is noted of the camera.
                Frame { focal_px: 0.0, lens: Lens::default(), ..frame }
            };
            let has_changed =
                after.geometry_hash() != before.geometry_hash() || frame(&after) != frame(&before);
            assert!(has_changed, "{name}: {set} changes nothing");
            checked += 1;
        }
        let names = KNOBS.iter().filter(|info| info.is_of(stage)).count();
        assert_eq!(params(31, &[&stage_name]).to_json().len(), names);
    }
    assert!(checked > Knob::ALL.len());
}
