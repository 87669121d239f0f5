//! Tests of configurations.

use super::*;

fn set(assignment: &str) -> Result<Config> {
    let mut config = Config::new();
    config.apply_set(assignment)?;
    config.check()?;
    Ok(config)
}

#[test]
fn each_stage_has_its_defaults_and_its_knobs() {
    let surface = set("stage.name=surface").expect("a stage");
    let params = surface.draw(3).expect("drawn");
    assert_eq!((params.number(Knob::SunElevationDeg), params.number(Knob::CameraPitchDeg)), (13.0, -7.0));
    assert!(params.to_json().contains_key("relief.hurst") && !params.to_json().contains_key("rocks.count"));
    let message = set("relief.hurst=0.7").expect_err("another stage's").to_string();
    assert!(message.contains("relief.hurst") && message.contains("surface"), "{message}");
    // Both stages: each frame has the defaults of its own, unless they were set.
    let mut both = set("stage.name={choice=[\"nominal\", \"surface\"]}").expect("both");
    both.apply_set("relief.hurst=0.7").expect("one stage has it");
    both.apply_set("camera.fov_deg=50").expect("both have it");
    both.check().expect("nothing contradicts");
    let drawn: Vec<Params> = (0..20).map(|seed| both.draw(seed).expect("drawn")).collect();
    for params in &drawn {
        let is_surface = params.stage() == Stage::Surface;
        assert_eq!(params.number(Knob::SunElevationDeg), if is_surface { 13.0 } else { 17.0 });
        assert_eq!(params.number(Knob::CameraFovDeg), 50.0);
    }
    assert!((4..=16).contains(&drawn.iter().filter(|p| p.stage() == Stage::Surface).count()));
    let mut read = Config::new();
    read.apply_json(&both.distributions_json(), "JSON").expect("read");
    assert_eq!(read.distributions_json(), both.distributions_json());
}

#[test]
fn sections_and_dotted_keys_are_the_same() {
    let mut sections = Config::new();
    sections
        .apply_toml("[sun]\nelevation_deg = { uniform = [5, 40] }\n[rocks]\ncount = 80\n", "a")
        .expect("read");
    let mut dotted = Config::new();
    dotted.apply_toml("sun.elevation_deg = { uniform = [5, 40] }\nrocks.count = 80\n", "b").expect("read");
    assert_eq!(sections, dotted);
    assert_eq!(sections.distribution(Knob::RocksCount), &Distribution::number(80.0));
}

#[test]
fn later_settings_win_and_refused_ones_change_nothing() {
    let mut config = Config::new();
    config.apply_preset("train_nodr").expect("a preset");
    config.apply_set("sun.elevation_deg=12").expect("a setting");
    assert_eq!(config.distribution(Knob::SunElevationDeg), &Distribution::number(12.0));
    let before = config.clone();
    assert!(config.apply_toml("sun.elevation_deg = 30\nsun.azimuth_deg = 400\n", "f").is_err());
    assert_eq!(config, before);
}

#[test]
fn errors_name_the_knob_the_value_and_what_is_allowed() {
    for (assignment, expected) in [
        (
            "sun.elevaton_deg=3",
            "unknown knob `sun.elevaton_deg` in --set (did you mean `sun.elevation_deg`?)",
        ),
        ("sun.elevation_deg=95", "sun.elevation_deg = 95 in --set is out of range; allowed: 0.5 to 90 deg"),
        (
            "sun.elevation_deg=nan",
            "sun.elevation_deg = nan in --set is out of range; allowed: 0.5 to 90 deg, finite",
        ),
        ("sun.elevation_deg={uniform=[5, inf]}", "out of range; allowed: 0.5 to 90 deg, finite"),
        ("sun.elevation_deg={uniform=[5, 95]}", "out of range; allowed: 0.5 to 90 deg"),
        ("sun.elevation_deg=high", "expected a number"),
        ("rocks.count=7.5", "expected a whole number"),
        ("rocks.count={uniform=[1,9]}", "expected a whole number"),
        ("sun.color=3", "expected a colour"),
        ("stage.name=mars", "allowed: nominal"),
        ("sun.elevation_deg", "the form is KEY=VALUE"),
        ("camera.x_m=1000", "puts the camera off the ground"),
        ("sun.elevation_deg=3\nrocks.count=1", "expected a number"),
    ] {
        let error = set(assignment).expect_err(assignment);
        assert!(error.to_string().contains(expected), "{assignment}: {error}");
        assert_eq!(error.exit_status(), 2);
    }
}

/// The ground of the surface stage lies around the camera, that of the nominal stage around the origin.
#[test]
fn a_camera_stands_anywhere_on_the_surface() {
    let check = |assignments: &[&str]| {
        let mut config = Config::new();
        assignments.iter().for_each(|assignment| config.apply_set(assignment).expect(assignment));
        config.check().map_err(|error| error.to_string())
    };
    for at in ["camera.x_m=1500", "terrain.size_m=150"] {
        check(&["stage.name=surface", at]).expect(at);
        let either = "stage.name={choice=[\"nominal\",\"surface\"]}";
        for stage in ["stage.name=nominal", either] {
            let error = check(&[stage, at]).expect_err(stage);
            assert!(error.contains("puts the camera off the ground"), "{error}");
        }
    }
}

#[test]
fn the_first_error_of_a_file_is_the_first_that_is_read() {
    for (text, expected) in [
        ("[sun]\nelevation_deg = 95\n[camera]\nfov_deg = 500\n", "sun.elevation_deg = 95"),
        ("[sun]\nintensity = -1\nazimuth_deg = 999\n", "sun.intensity = -1"),
        ("sun.intensity = -1\ncamera.zoom = 3\n", "sun.intensity = -1"),
        ("[zoom]\nx = 1\n[camera]\nfov_deg = 500\n", "unknown knob `zoom`"),
    ] {
        let error = Config::new().apply_toml(text, "f").expect_err(text).to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn a_file_s_errors_have_line_and_column() {
    let mut config = Config::new();
    let error = config.apply_toml("[sun]\nelevation_deg = = 3\n", "my.toml").expect_err("no TOML");
    assert!(matches!(error, Error::Toml { line: 2, column: 17, .. }), "{error:?}");
    assert!(error.to_string().starts_with("my.toml, line 2, column 17:"), "{error}");
    let error = config.apply_toml("[sums]\nelevation_deg = 3\n", "my.toml").expect_err("no section");
    assert!(error.to_string().contains("unknown knob `sums` in my.toml"), "{error}");
    let error = config.apply_preset("train").expect_err("no preset").to_string();
    assert!(error.contains("unknown preset `train`") && error.contains("test_photoreal"), "{error}");
}

#[test]
fn a_knob_s_draw_moves_no_other() {
    let mut config = Config::new();
    config.apply_preset("train_dr").expect("a preset");
    let before = config.draw(7).expect("drawn").to_json();
    config.apply_set("sun.elevation_deg={normal=[20,3]}").expect("a setting");
    let after = config.draw(7).expect("drawn").to_json();
    for (name, value) in &before {
        assert_eq!(*value == after[name], name != "sun.elevation_deg", "{name}");
    }
    assert_ne!(before, config.draw(8).expect("drawn").to_json());
}

fn drawn(config: &Config, seed: u64, knob: Knob) -> f64 {
    config.draw(seed).expect("drawn").number(knob)
}

#[test]
fn the_sun_has_one_azimuth_from_north_or_from_the_camera() {
    let relative = set("sun.relative_azimuth_deg=-60").expect("a setting");
    let mut turned = relative.clone();
    turned.apply_set("camera.yaw_deg=30").expect("a setting");
    let azimuths = |config: &Config| {
        [Knob::SunAzimuthDeg, Knob::SunRelativeAzimuthDeg].map(|knob| drawn(config, 1, knob))
    };
    assert_eq!((azimuths(&relative), azimuths(&turned)), ([300.0, -60.0], [330.0, -60.0]));
    turned.apply_set("sun.azimuth_deg=10").expect_err("two of one source");
    turned.apply_toml("sun.azimuth_deg = 10", "a file").expect("a later source");
    assert_eq!(azimuths(&turned), [10.0, -20.0]);
    let both = Config::new().apply_toml("[sun]\nazimuth_deg = 1\nrelative_azimuth_deg = 2\n", "f.toml");
    let message = both.expect_err("both").to_string();
    assert!(message.contains("f.toml") && message.contains("sun.relative_azimuth_deg"), "{message}");
    // A preset gives way, and the record of a frame, which has both, repeats it.
    let mut preset = Config::new();
    preset.apply_preset("surface_train_full").expect("a preset");
    preset.apply_set("sun.relative_azimuth_deg=90").expect("wins over the preset");
    let mut read = Config::new();
    read.apply_json(&preset.draw(5).expect("drawn").to_json(), "frame").expect("read");
    assert_eq!(read.draw(5).expect("drawn"), preset.draw(5).expect("drawn"));
    let spread = (0..9).map(|seed| drawn(&preset, seed, Knob::SunAzimuthDeg)).fold(0.0, f64::max);
    assert!(spread > 100.0, "the yaw turns the sun");
}

/// Whichever comes first, a training preset keeps the ranges of its sensor, and a camera preset the camera that it is named for.
#[test]
fn camera_presets_leave_a_sensor_s_ranges_alone() {
    let of = |names: &[&str]| {
        let mut config = Config::new();
        names.iter().for_each(|name| config.apply_preset(name).expect("a preset"));
        config
    };
    let full = of(&["surface_train_full"]);
    let alone = of(&["camera_pcam"]);
    let ranges = [Knob::SensorFullWellE, Knob::SensorReadNoiseE, Knob::SensorGlare, Knob::SensorGroundLevel];
    for names in [["surface_train_full", "camera_pcam"], ["camera_pcam", "surface_train_full"]] {
        let both = of(&names);
        for knob in ranges {
            assert_eq!(both.distribution(knob), full.distribution(knob), "{names:?}: {}", knob.name());
            assert_ne!(alone.distribution(knob), full.distribution(knob), "{}", knob.name());
        }
    }
    let after = of(&["surface_train_full", "camera_pcam"]);
    assert_eq!(after.distribution(Knob::CameraFovDeg), alone.distribution(Knob::CameraFovDeg));
    for camera in ["camera_pcam", "camera_navcam", "camera_colour", "camera_hasselblad"] {
        let config = of(&[camera]);
        for knob in [Knob::CameraHeightM, Knob::CameraPitchDeg, Knob::SensorFullWellE, Knob::SensorReadNoiseE]
        {
            let distribution = config.distribution(knob);
            assert!(
                !matches!(distribution, Distribution::Fixed(_)),
                "{camera}: {} = {distribution}",
                knob.name()
            );
        }
    }
}

#[test]
fn variants_draw_their_knobs_together() {
    let mut config = Config::new();
    let text = "[[variant]]\nweight = 3\ncamera.fov_deg = 20\ncamera.pitch_deg = -30\n\
                [[variant]]\nweight = 1\ncamera = { fov_deg = 90, pitch_deg = -60 }\n[sun]\nelevation_deg = 30\n";
    config.apply_toml(text, "f").expect("variants");
    let kinds = |config: &Config| {
        let kind = |seed| [Knob::CameraFovDeg, Knob::CameraPitchDeg].map(|knob| drawn(config, seed, knob));
        (0..400).map(kind).collect::<Vec<_>>()
    };
    let of_config = kinds(&config);
    let narrow = of_config.iter().filter(|kind| **kind == [20.0, -30.0]).count();
    assert!(of_config.iter().all(|kind| *kind == [20.0, -30.0] || *kind == [90.0, -60.0]));
    assert!((270..330).contains(&narrow), "{narrow} of 400 with a weight of 3 in 4");
    assert_eq!(drawn(&config, 1, Knob::SunElevationDeg), 30.0);
    // What they are written as, they are read as.
    let mut from_json = Config::new();
    from_json.apply_json(&config.distributions_json(), "JSON").expect("read");
    let mut from_toml = Config::new();
    from_toml.apply_toml(&config.to_toml(), "TOML").expect("read");
    assert_eq!((kinds(&from_json), kinds(&from_toml)), (of_config.clone(), of_config));
    // A later setting is for all of them.
    config.apply_set("camera.fov_deg=50").expect("a setting");
    assert!(kinds(&config).iter().all(|kind| kind[0] == 50.0));
    for (text, said) in [
        ("[[variant]]\nweight = -1\n", "weight"),
        ("[[variant]]\nweight = 0\n", "weight"),
        ("[[variant]]\nweight = 1e308\n[[variant]]\nweight = 1e308\n", "finite sum"),
        ("variant = 3\n", "weight"),
        ("[[variant]]\nrules = { clipped_max = 0.1 }\n", "rules hold for all frames"),
        ("[[variant]]\npreset = \"surface_rover\"\n", "variants itself"),
        ("[[variant]]\npreset = \"surface_train_dr\"\n", "stage.name"),
        ("[[variant]]\ncamera.fow_deg = 3\n", "did you mean `camera.fov_deg`"),
        ("preset = \"pcan\"\n", "did you mean `pcam`"),
        ("[snu]\nelevation_deg = 3\n", "did you mean `sun`"),
        ("[cameras]\nfov_deg = 3\n", "did you mean `camera`"),
        ("rule = 3\n", "did you mean `rules`"),
        ("elevation_deg = 3\n", "did you mean `sun.elevation_deg`"),
    ] {
        let message = Config::new().apply_toml(text, "f").expect_err(text).to_string();
        assert!(message.contains(said), "{text}: {message}");
    }
}

/// `surface_rover` mixes three cameras under suns that seldom stand in front of them, and some frames have no rock.
#[test]
fn the_rover_preset_mixes_cameras() {
    let mut config = Config::new();
    config.apply_preset("surface_rover").expect("a preset");
    let (mut kinds, mut bare, mut in_front) = ([0; 3], 0, 0);
    for seed in 0..400 {
        let params = config.draw(seed).expect("drawn");
        let number = |knob| params.number(knob);
        let (fov, pitch) = (number(Knob::CameraFovDeg), number(Knob::CameraPitchDeg));
        let kind = if fov < 25.0 { 0 } else { 1 + usize::from(fov > 75.0) };
        kinds[kind] += 1;
        assert!([-40.0..-5.0, -28.0..-12.0, -62.0..-56.0][kind].contains(&pitch), "{fov} {pitch}");
        assert_eq!(params.text(Knob::SensorKind), ["bayer", "mono", "mono"][kind]);
        assert!((15.0..=50.0).contains(&number(Knob::SunElevationDeg)));
        assert!(kind > 0 || params.text(Knob::RoverVisible) == "no", "a deck fills the narrow view");
        bare += i32::from(number(Knob::RocksCoverage) == 0.0);
        in_front += i32::from((number(Knob::SunRelativeAzimuthDeg) - 180.0).abs() > 140.0);
    }
    assert!(kinds.iter().all(|count| *count > 80), "{kinds:?}");
    assert!(
        (10..60).contains(&bare) && (4..40).contains(&in_front),
        "{bare} without rocks, {in_front} into the sun"
    );
}
