//! Tests of the rules.

use glam::Vec3;

use super::*;
use crate::params::Params;

fn rules(text: &str) -> Result<Rules> {
    let mut config = Config::new();
    config.apply_toml(text, "a test")?;
    Rules::from_config(&config)
}

#[test]
fn invalid_settings_are_refused_by_name() {
    let read = rules("require = { rock = [0.005, 0.6] }\n[rules]\nclipped_max = 0.1\nattempts_max = 3")
        .expect("read");
    assert_eq!((read.clipped_max, read.attempts_max), (0.1, 3));
    assert_eq!(read.require, [None, Some([0.005, 0.6]), None]);
    assert_eq!(rules("[rules]\nrequire = { rock = [0.005, 0.6] }").expect("read").require, read.require);
    for rules_as_set in [Rules::default(), read] {
        assert_eq!(rules(&rules_as_set.to_toml()).expect("its own listing"), rules_as_set);
        assert_eq!(Rules::from_json(&rules_as_set.to_json()), Some(rules_as_set));
    }
    for (text, said) in [
        ("[rules]\nclipped_maks = 1", "did you mean `rules.clipped_max`"),
        ("[rules]\nclipped_max = 2", "0 to 1"),
        ("[rules]\nsky_max = 256", "0 to 255"),
        ("[rules]\nlit_min = -1", "0 to 1"),
        ("[rules]\nignored_max = 1.5", "0 to 1"),
        ("[rules]\nattempts_max = 0", "1 to 1000"),
        ("require = { rocks = [0, 1] }", "no class `rocks`"),
        ("require = { rock = [0.6, 0.1] }", "smallest <= largest"),
        ("require = 3", "a table of classes"),
    ] {
        let message = rules(text).expect_err(text).to_string();
        assert!(message.contains(said), "{text}: {message}");
    }
}

#[test]
fn each_rule_detects_its_violation() {
    let scene = Scene::build(1, &Params::draw_default(1)).expect("a scene");
    let good = Frame {
        width: 10,
        height: 1,
        rgb: [[[120; 3]; 7].concat(), vec![0; 9]].concat(),
        class: vec![0, 0, 0, 0, 0, 1, 1, 2, 2, 2],
        ..Frame::default()
    };
    let rule = |rules: &Rules, change: &dyn Fn(&mut Frame)| {
        let mut frame = good.clone();
        change(&mut frame);
        rules.violation(&scene, &frame, &MaskIds::default()).map(|violation| violation.rule)
    };
    let defaults = Rules::default();
    assert_eq!(rule(&defaults, &|_| {}), None);
    assert_eq!(rule(&defaults, &|frame| frame.class[9] = 255).as_deref(), Some("unlabelled"));
    assert_eq!(rule(&defaults, &|frame| frame.rgb.fill(1)).as_deref(), Some("black"));
    assert_eq!(rule(&defaults, &|frame| frame.rgb[21..].fill(1)), None, "a black sky is allowed");
    assert_eq!(rule(&defaults, &|frame| frame.rgb[..12].fill(249)).as_deref(), Some("clipped"));
    assert_eq!(rule(&defaults, &|frame| frame.rgb[..6].fill(249)), None, "two of seven");
    assert_eq!(rule(&defaults, &|frame| frame.rgb[..21].fill(20)).as_deref(), Some("lit"));
    assert_eq!(rule(&defaults, &|frame| frame.rgb[6..21].fill(20)), None, "two of seven are lit");
    assert_eq!(rule(&defaults, &|frame| frame.rgb[21..].fill(70)).as_deref(), Some("sky"));
    assert_eq!(rule(&defaults, &|frame| frame.rgb[21..24].fill(70)), None, "a star");
    let saturates = |frame: &mut Frame| (frame.rgb[..6].fill(250), frame.rgb[27..].fill(250)).0;
    assert_eq!(rule(&defaults, &saturates).as_deref(), Some("saturated"));
    assert_eq!(rule(&Rules::accepting_any_image(), &saturates), None);
    let demand = Rules { require: [None, Some([0.3, 1.0]), None], ..defaults.clone() };
    assert_eq!(rule(&demand, &|_| {}).as_deref(), Some("require.rock"));
    assert_eq!(rule(&demand, &|frame| frame.class[0] = 1), None);
    let mut buried = scene.clone();
    buried.camera.eye.z -= 100.0;
    assert_eq!(
        defaults.violation(&buried, &good, &MaskIds::default()).map(|violation| violation.rule).as_deref(),
        Some("eye_above_ground")
    );
    let mut inside = scene.clone();
    let rock = scene.rocks.iter().find(|rock| {
        let top = rock.centre + 0.5 * rock.z_range_m[1] * Vec3::Z;
        top.z > scene.terrain.surface_height_at(top.truncate())
    });
    let rock = rock.expect("a rock whose upper half is above the ground");
    inside.camera.eye = rock.centre + 0.5 * rock.z_range_m[1] * Vec3::Z;
    let violation = Rules::violation_of_scene(&inside);
    assert_eq!(violation.map(|violation| violation.rule).as_deref(), Some("eye_outside_rocks"));
}

#[test]
fn rules_of_the_mask_are_held_against_what_is_written() {
    let scene = Scene::build(1, &Params::draw_default(1)).expect("a scene");
    let (rgb, class) =
        ([[120; 48].as_slice(), &[0; 12]].concat(), [[0; 8].as_slice(), &[1; 8], &[2; 4]].concat());
    let frame = Frame { width: 20, height: 1, rgb, class, ..Frame::default() };
    let found = |rules: &Rules, edges: EdgePolicy| {
        rules
            .violation(&scene, &frame, &MaskIds::new(edges))
            .map(|violation| (violation.rule, violation.found))
    };
    let defaults = Rules::default();
    let demand = Rules { require: [None, Some([0.2, 0.5]), None], ..Rules::default() };
    assert!(defaults.has("ignored") && !defaults.has("require.rock") && demand.has("require.rock"));
    // The band takes N pixels on both sides of the two boundaries.
    for (edges, of_defaults, of_demand) in [
        (EdgePolicy::Hard, None, None),
        (EdgePolicy::Ignore(2), None, None),
        (EdgePolicy::Ignore(3), None, Some("require.rock")),
        (EdgePolicy::Ignore(7), Some("ignored"), Some("require.rock")),
    ] {
        for (rules, expected) in [(&defaults, of_defaults), (&demand, of_demand)] {
            assert_eq!(found(rules, edges).map(|(rule, _)| rule).as_deref(), expected, "{edges}");
        }
    }
    let value =
        |rules: &Rules, edges| rules.violation(&scene, &frame, &MaskIds::new(edges)).and_then(|of| of.value);
    assert_eq!(value(&defaults, EdgePolicy::Ignore(7)).as_deref(), Some("0.950"));
    assert_eq!(value(&demand, EdgePolicy::Ignore(3)).as_deref(), Some("0.1000"));
    let (_, message) = found(&defaults, EdgePolicy::Ignore(7)).expect("refused");
    let expected = "0.950 of the mask is ignored; the limit is rules.ignored_max = 0.9; --edges is ignore:7: a smaller N";
    assert!(message.starts_with(expected), "{message}");
    let (_, message) = found(&demand, EdgePolicy::Ignore(3)).expect("refused");
    let expected =
        "rock covers 0.1000 of the mask; allowed is 0.2 to 0.5 (before --edges ignore:3 it covered 0.4000;";
    assert!(message.starts_with(expected), "{message}");
    assert_eq!(found(&Rules::accepting_any_image(), EdgePolicy::Ignore(64)), None);
}

#[test]
fn every_rule_of_a_setting_names_it() {
    let demand = Rules { require: [None, Some([0.2, 0.5]), None], ..Rules::default() };
    let rules = ["black", "clipped", "saturated", "lit", "sky", "ignored", "require.rock"];
    for (rule, setting) in rules.iter().zip(SETTINGS.iter().filter(|name| **name != "attempts_max")) {
        assert!(demand.has(rule), "{rule}");
        assert_eq!(Rules::setting_of(rule), Some(format!("rules.{setting}")));
    }
    for rule in ["scene", "unlabelled", "eye_above_ground", "eye_outside_rocks"] {
        assert!(demand.has(rule) && Rules::setting_of(rule).is_none(), "{rule}");
    }
}
