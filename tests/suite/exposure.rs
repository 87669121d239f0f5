//! Metered exposure of the presets: black skies, few clipped pixels. `REGOLITH_EXPOSURE_FRAMES` is the number of frames of each.

use regolith::class::ClassId;
use regolith::dataset::plan::frame_seed;
use regolith::dataset::rules::Rules;
use regolith::output::edges::MaskIds;
use regolith::params::config::Config;
use regolith::scene::Scene;

use crate::support::render;

/// Combinations of presets with a sensor, joined by commas.
const PRESETS: [&str; 8] = [
    "surface_train_full",
    "navcam",
    "pcam",
    "hazcam",
    "surface_train_dr,camera_navcam,sun_polar",
    "surface_train_dr,camera_pcam,sun_equatorial",
    "surface_train_dr,camera_hasselblad,sun_mid_latitude",
    "surface_train_nodr,camera_colour",
];
/// Columns and rows of a frame.
const SIDE: usize = 72;
/// Largest mean of the sky's brightest channel, of 255, without glare.
const MAX_SKY: f64 = 3.0;

/// The frame of a seed: the mean of its sky's brightest channel if it shows any, the clipped part of the image, and the rule that it breaks.
fn measured(config: &Config, seed: u64) -> Option<(Option<f64>, f64, Option<String>)> {
    // A scene that cannot be built is redrawn, as in a dataset.
    let scene = Scene::build(seed, &config.draw(seed).expect("parameters")).ok()?;
    let frame = render(&scene, SIDE as u32, 1);
    let (mut sum, mut sky, mut clipped) = (0.0, 0.0, 0.0);
    // The point spread of the horizon is no light of the sky.
    let is_far_from_ground = |pixel: usize| {
        let (x, y) = (pixel % SIDE, pixel / SIDE);
        let rows = y.saturating_sub(2)..(y + 3).min(SIDE);
        let columns = x.saturating_sub(2)..(x + 3).min(SIDE);
        rows.flat_map(|y| columns.clone().map(move |x| y * SIDE + x))
            .all(|at| frame.class[at] == ClassId::SKY.0)
    };
    for (pixel, rgb) in frame.rgb.chunks_exact(3).enumerate() {
        let value = rgb.iter().copied().max().unwrap_or(0);
        clipped += f64::from(u8::from(value >= 249));
        if is_far_from_ground(pixel) {
            sum += f64::from(value);
            sky += 1.0;
        }
    }
    let rules = Rules::from_config(config).expect("rules");
    let broken = rules.violation(&scene, &frame, &MaskIds::default()).map(|violation| violation.rule);
    Some(((sky > 0.0).then(|| sum / sky), clipped / frame.class.len() as f64, broken))
}

#[test]
fn skies_are_black_and_few_frames_are_clipped() {
    let frames =
        std::env::var("REGOLITH_EXPOSURE_FRAMES").ok().and_then(|count| count.parse().ok()).unwrap_or(4);
    let mut presets_with_sky = 0;
    for presets in PRESETS {
        let mut config = Config::new();
        for preset in presets.split(',') {
            config.apply_preset(preset).unwrap_or_else(|error| panic!("{error}"));
        }
        for set in ["sensor.glare=0", "sensor.flare=0"] {
            config.apply_set(set).expect("a setting");
        }
        let (mut shown, mut with_sky, mut overexposed, mut refused) = (0, 0, 0, 0);
        for index in 0..frames {
            let seed = frame_seed(42, index, 0);
            let Some((sky, clipped, broken)) = measured(&config, seed) else { continue };
            shown += 1;
            with_sky += u64::from(sky.is_some());
            let sky = sky.unwrap_or(0.0);
            assert!(sky <= MAX_SKY, "{presets}, seed {seed}: the sky has {sky:.2} of 255");
            overexposed += u64::from(clipped > 0.2);
            refused +=
                u64::from(broken.is_some_and(|rule| ["sky", "saturated", "clipped"].contains(&&*rule)));
        }
        assert!(2 * shown >= frames, "{presets}: {shown} of {frames} scenes could be built");
        presets_with_sky += u32::from(with_sky > 0);
        assert!(overexposed <= frames / 200, "{presets}: {overexposed} of {frames} frames are clipped");
        assert!(refused <= frames / 20, "{presets}: {refused} of {frames} frames are refused");
    }
    // Some cameras look at the ground alone.
    assert!(presets_with_sky >= 5, "only frames of {presets_with_sky} show the sky");
}

/// A frame that was all white, sky included, when the exposure followed what little was lit.
#[test]
fn a_sun_on_the_horizon_does_not_overexpose() {
    let mut config = Config::new();
    for preset in ["surface_train_dr", "camera_navcam", "sun_polar"] {
        config.apply_preset(preset).expect("a preset");
    }
    let (sky, clipped, _) = measured(&config, 880_033).expect("a scene");
    let sky = sky.expect("a sky");
    assert!(sky < 20.0 && clipped < 0.05, "the sky has {sky:.1} of 255, {clipped:.3} are clipped");
}
