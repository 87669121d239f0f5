//! Which frames a dataset accepts. A frame that breaks a rule is rendered again under its next attempt number.
//!
//! Must not know: threads, files.
//! To add a rule: a field (or a line in [`Rules::violation`] if it has no setting), its arm in [`Rules::from_config`].

use serde_json::{Value, json};

use crate::class::ClassId;
use crate::error::{Error, Result, nearest};
use crate::frame::Frame;
use crate::output::edges::{EdgePolicy, MaskIds};
use crate::params::config::{Config, RuleSetting};
use crate::scene::Scene;

/// The largest value that the tone curve produces: a channel with this value is clipped.
const WHITE: u8 = 249;
/// A pixel is black if no channel exceeds this value.
const BLACK: u8 = 2;
/// A pixel is lit if a channel has at least this value: above shadows, which light from sunlit ground fills.
const LIT: u8 = 32;
/// What leaves more of a mask to its classes.
const SMALLER_BAND: &str = "a smaller N or a larger --size ignores less";
/// Names of the settings.
pub const SETTINGS: [&str; 8] = [
    "black_max",
    "clipped_max",
    "saturated_max",
    "lit_min",
    "sky_max",
    "ignored_max",
    "attempts_max",
    "require",
];

/// The rules and their settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// Largest fraction of the ground and rock pixels that may be black.
    pub black_max: f64,
    /// Largest fraction of the ground and rock pixels that may be clipped.
    pub clipped_max: f64,
    /// Largest fraction of the whole image that may be clipped.
    pub saturated_max: f64,
    /// Smallest fraction of the ground and rock pixels that must be lit.
    pub lit_min: f64,
    /// Largest value, of 255, that half of the sky's pixels may exceed.
    pub sky_max: f64,
    /// Largest fraction of the pixels of the mask as it is written that may carry the ignore index.
    pub ignored_max: f64,
    /// Attempts at a frame before the run gives up.
    pub attempts_max: u32,
    /// Smallest and largest fraction of the mask as it is written, for each class in the order of [`ClassId::ALL`].
    pub require: [Option<[f64; 2]>; ClassId::ALL.len()],
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            black_max: 0.95,
            clipped_max: 0.5,
            saturated_max: 0.2,
            lit_min: 0.02,
            sky_max: 64.0,
            ignored_max: 0.9,
            attempts_max: 20,
            require: [None; ClassId::ALL.len()],
        }
    }
}

/// A broken rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Name of the rule.
    pub rule: String,
    /// The value found and the limit.
    pub found: String,
}

impl Rules {
    /// The rules that a configuration sets.
    ///
    /// # Errors
    /// [`Error::UnknownKnob`], [`Error::KnobType`], [`Error::KnobOutOfRange`].
    pub fn from_config(config: &Config) -> Result<Self> {
        Self::from_settings(config.rules())
    }

    /// Rules that every frame with labels keeps whose camera stands on the ground.
    #[must_use]
    pub fn accepting_any_image() -> Self {
        let [saturated_max, clipped_max, black_max, ignored_max] = [1.0; 4];
        let [lit_min, sky_max] = [0.0, 255.0];
        Self { black_max, clipped_max, saturated_max, lit_min, sky_max, ignored_max, ..Self::default() }
    }

    fn from_settings(settings: &[RuleSetting]) -> Result<Self> {
        let mut rules = Self::default();
        for setting in settings {
            match setting.name.as_str() {
                "black_max" => rules.black_max = fraction(setting)?,
                "clipped_max" => rules.clipped_max = fraction(setting)?,
                "saturated_max" => rules.saturated_max = fraction(setting)?,
                "lit_min" => rules.lit_min = fraction(setting)?,
                "ignored_max" => rules.ignored_max = fraction(setting)?,
                "sky_max" => {
                    let value = number(&setting.value).filter(|value| (0.0..=255.0).contains(value));
                    rules.sky_max = value.ok_or_else(|| refused(setting, "a number, 0 to 255"))?;
                }
                "attempts_max" => {
                    let attempts = setting.value.as_integer().filter(|n| (1..=1000).contains(n));
                    rules.attempts_max =
                        attempts.ok_or_else(|| refused(setting, "a whole number, 1 to 1000"))? as u32;
                }
                "require" => rules.set_require(setting)?,
                _ => {
                    return Err(Error::UnknownKnob {
                        name: format!("rules.{}", setting.name),
                        origin: setting.origin.clone(),
                        suggestion: nearest(&setting.name, SETTINGS).map(|name| format!("rules.{name}")),
                    });
                }
            }
        }
        Ok(rules)
    }

    fn set_require(&mut self, setting: &RuleSetting) -> Result<()> {
        let form = "a table of classes and their fraction of the image, as in { rock = [0.005, 0.6] }";
        let table = setting.value.as_table().ok_or_else(|| refused(setting, form))?;
        for (name, range) in table {
            let index = ClassId::ALL.iter().position(|class| class.name == name).ok_or_else(|| {
                let names: Vec<&str> = ClassId::ALL.iter().map(|class| class.name).collect();
                refused(
                    setting,
                    &format!("{form}; there is no class `{name}`, there are {}", names.join(", ")),
                )
            })?;
            let bounds = match range.as_array().map(Vec::as_slice) {
                Some([low, high]) => number(low).zip(number(high)),
                _ => None,
            };
            let [low, high] = bounds
                .filter(|(low, high)| 0.0 <= *low && low <= high && *high <= 1.0)
                .map(|(low, high)| [low, high])
                .ok_or_else(|| refused(setting, &format!("{form}; 0 <= smallest <= largest <= 1")))?;
            self.require[index] = Some([low, high]);
        }
        Ok(())
    }

    /// The `rules` of a manifest.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let require: serde_json::Map<String, Value> = ClassId::ALL
            .iter()
            .zip(self.require)
            .filter_map(|(class, range)| Some((class.name.to_owned(), json!(range?))))
            .collect();
        json!({
            "black_max": self.black_max,
            "clipped_max": self.clipped_max,
            "saturated_max": self.saturated_max,
            "lit_min": self.lit_min,
            "sky_max": self.sky_max,
            "ignored_max": self.ignored_max,
            "attempts_max": self.attempts_max,
            "require": require,
        })
    }

    /// The rules in the form of [`Self::to_json`]; `None` for any other value.
    #[must_use]
    pub fn from_json(json: &Value) -> Option<Self> {
        let settings = json.as_object()?.iter().map(|(name, value)| {
            Some(RuleSetting {
                name: name.clone(),
                value: toml::Value::try_from(value).ok()?,
                origin: "manifest.json".to_owned(),
            })
        });
        Self::from_settings(&settings.collect::<Option<Vec<_>>>()?).ok()
    }

    /// Whether a frame can break a rule of this name, as [`Self::violation`] and a failing scene name them.
    #[must_use]
    pub fn has(&self, rule: &str) -> bool {
        let require = ClassId::ALL.iter().zip(self.require).filter(|(_, range)| range.is_some());
        matches!(
            rule,
            "scene"
                | "unlabelled"
                | "eye_above_ground"
                | "eye_outside_rocks"
                | "black"
                | "clipped"
                | "saturated"
                | "lit"
                | "sky"
                | "ignored"
        ) || require.into_iter().any(|(class, _)| rule == format!("require.{}", class.name))
    }

    /// The rules as TOML, in the form that a configuration reads.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let require: Vec<String> = ClassId::ALL
            .iter()
            .zip(self.require)
            .filter_map(|(class, range)| {
                range.map(|[low, high]| format!(" {} = [{low}, {high}]", class.name))
            })
            .collect();
        format!(
            "# Which frames a dataset accepts; a frame that breaks a rule is rendered again.\n[rules]\n\
             # Largest fraction of the ground and rock pixels that may be black. Allowed: 0 to 1.\nblack_max = {}\n\
             # Largest fraction of the ground and rock pixels that may be clipped (as bright as the tone curve goes). Allowed: 0 to 1.\n\
             clipped_max = {}\n# Largest fraction of the whole image that may be clipped. Allowed: 0 to 1.\nsaturated_max = {}\n\
             # Smallest fraction of the ground and rock pixels that must be lit (32 of 255 or more). Allowed: 0 to 1.\nlit_min = {}\n\
             # Largest value that the median of the sky may have. Allowed: 0 to 255.\nsky_max = {}\n\
             # Largest fraction of the mask that may be ignored (255), the band of --edges included. Allowed: 0 to 1.\nignored_max = {}\n\
             # Attempts at a frame before the run gives up. Allowed: whole numbers, 1 to 1000.\n\
             attempts_max = {}\n# Smallest and largest fraction of the mask by class, as in {{ rock = [0.005, 0.6] }}.\n\
             require = {{{} }}\n",
            self.black_max,
            self.clipped_max,
            self.saturated_max,
            self.lit_min,
            self.sky_max,
            self.ignored_max,
            self.attempts_max,
            require.join(",")
        )
    }

    /// The first rule that a frame breaks whose mask is written like this.
    #[must_use]
    pub fn violation(&self, scene: &Scene, frame: &Frame, mask: &MaskIds) -> Option<Violation> {
        let violation = |rule: &str, found: String| Some(Violation { rule: rule.to_owned(), found });
        let unlabelled = frame.unlabelled_px();
        if unlabelled > 0 {
            return violation("unlabelled", format!("{unlabelled} pixels carry no label"));
        }
        if let Some(violation) = Self::violation_of_scene(scene) {
            return Some(violation);
        }
        if let Some(violation) = self.violation_of_brightness(&Brightness::of(frame)) {
            return Some(violation);
        }
        self.violation_of_mask(frame, mask)
    }

    /// The first rule that the mask breaks as it is written.
    fn violation_of_mask(&self, frame: &Frame, mask: &MaskIds) -> Option<Violation> {
        let (edges, mask) = (mask.edges(), mask.coverage(frame));
        for ((class, range), share) in ClassId::ALL.iter().zip(self.require).zip(mask.classes) {
            let Some([low, high]) = range.filter(|[low, high]| !(low..=high).contains(&&share)) else {
                continue;
            };
            let mut found =
                format!("{} covers {share:.4} of the mask; allowed is {low} to {high}", class.name);
            let before = frame.coverage(class.id);
            if share < low && share < before {
                found += &format!(" (before --edges {edges} it covered {before:.4}; {SMALLER_BAND})");
            }
            return Some(Violation { rule: format!("require.{}", class.name), found });
        }
        if mask.ignored <= self.ignored_max {
            return None;
        }
        let remedy = match edges {
            EdgePolicy::Hard => "rover.* and label.* say what is ignored".to_owned(),
            EdgePolicy::Ignore(_) => format!("--edges is {edges}: {SMALLER_BAND}"),
        };
        let (share, limit) = (mask.ignored, self.ignored_max);
        let found =
            format!("{share:.3} of the mask is ignored; the limit is rules.ignored_max = {limit}; {remedy}");
        Some(Violation { rule: "ignored".to_owned(), found })
    }

    /// The first rule that a scene breaks, whatever its frame shows.
    #[must_use]
    pub fn violation_of_scene(scene: &Scene) -> Option<Violation> {
        let violation = |rule: &str, found: String| Some(Violation { rule: rule.to_owned(), found });
        let eye = scene.camera.eye;
        let height_m = eye.z - scene.terrain.surface_height_at(eye.truncate());
        if height_m <= 0.0 {
            return violation("eye_above_ground", format!("the eye is {height_m:.2} m above the ground"));
        }
        let near_eye = scene.rocks.build_where(|rock| rock.may_lie_within(0.0, eye));
        if let Some((_, rock)) =
            near_eye.into_iter().find(|(_, rock)| rock.body.is_rock() && rock.distance_to(eye, 1.0) <= 0.0)
        {
            return violation("eye_outside_rocks", format!("the eye is inside rock {}", rock.index));
        }
        None
    }

    fn violation_of_brightness(&self, found: &Brightness) -> Option<Violation> {
        let of_ground = |count: u64| count as f64 / found.foreground.max(1) as f64;
        let (black, clipped, lit) = (of_ground(found.black), of_ground(found.clipped), of_ground(found.lit));
        let saturated = found.saturated as f64 / found.pixels.max(1) as f64;
        let (ground, image) = ("of the ground and rock pixels are", "of the image is");
        let checks = [
            ("black", black > self.black_max, black, ground, "black_max", self.black_max),
            ("clipped", clipped > self.clipped_max, clipped, ground, "clipped_max", self.clipped_max),
            (
                "saturated",
                saturated > self.saturated_max,
                saturated,
                image,
                "saturated_max",
                self.saturated_max,
            ),
            ("lit", found.foreground > 0 && lit < self.lit_min, lit, ground, "lit_min", self.lit_min),
        ];
        let broken = checks.into_iter().find(|check| check.1);
        if let Some((rule, _, share, of, name, limit)) = broken {
            let found = format!("{share:.3} {of} {rule}; the limit is rules.{name} = {limit}");
            return Some(Violation { rule: rule.to_owned(), found });
        }
        let median = found.sky_median.filter(|median| f64::from(*median) > self.sky_max)?;
        let found = format!(
            "half of the sky has a value of {median} or more; the limit is rules.sky_max = {}",
            self.sky_max
        );
        Some(Violation { rule: "sky".to_owned(), found })
    }
}

/// How many pixels of a frame are how bright.
struct Brightness {
    pixels: u64,
    foreground: u64,
    black: u64,
    lit: u64,
    clipped: u64,
    saturated: u64,
    /// Median over the sky of the brightest channel, if there is sky.
    sky_median: Option<u8>,
}

impl Brightness {
    fn of(frame: &Frame) -> Self {
        // Pixels by their brightest channel: of ground and rocks, of the sky.
        let mut counts = [[0_u64; 256]; 2];
        for (pixel, class) in frame.rgb.as_chunks::<3>().0.iter().zip(&frame.class) {
            let [r, g, b] = *pixel;
            counts[usize::from(*class == ClassId::SKY.0)][usize::from(r.max(g).max(b))] += 1;
        }
        let [ground, sky] = &counts;
        let sum = |counts: &[u64]| counts.iter().sum::<u64>();
        let of_sky = sum(sky);
        let mut below = 0;
        let median = sky.iter().position(|count| {
            below += count;
            2 * below >= of_sky
        });
        let clipped = sum(&ground[usize::from(WHITE)..]);
        Self {
            pixels: frame.class.len() as u64,
            foreground: sum(ground),
            black: sum(&ground[..=usize::from(BLACK)]),
            lit: sum(&ground[usize::from(LIT)..]),
            clipped,
            saturated: clipped + sum(&sky[usize::from(WHITE)..]),
            sky_median: median.filter(|_| of_sky > 0).map(|value| value as u8),
        }
    }
}

fn refused(setting: &RuleSetting, expected: &str) -> Error {
    Error::KnobType {
        name: format!("rules.{}", setting.name),
        value: setting.value.to_string(),
        origin: setting.origin.clone(),
        expected: expected.to_owned(),
    }
}

fn number(value: &toml::Value) -> Option<f64> {
    value.as_float().or(value.as_integer().map(|n| n as f64))
}

fn fraction(setting: &RuleSetting) -> Result<f64> {
    number(&setting.value)
        .filter(|value| (0.0..=1.0).contains(value))
        .ok_or_else(|| refused(setting, "a fraction, 0 to 1"))
}

#[cfg(test)]
mod tests {
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
            defaults
                .violation(&buried, &good, &MaskIds::default())
                .map(|violation| violation.rule)
                .as_deref(),
            Some("eye_above_ground")
        );
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
        let (_, message) = found(&defaults, EdgePolicy::Ignore(7)).expect("refused");
        let expected = "0.950 of the mask is ignored; the limit is rules.ignored_max = 0.9; --edges is ignore:7: a smaller N";
        assert!(message.starts_with(expected), "{message}");
        let (_, message) = found(&demand, EdgePolicy::Ignore(3)).expect("refused");
        let expected = "rock covers 0.1000 of the mask; allowed is 0.2 to 0.5 (before --edges ignore:3 it covered 0.4000;";
        assert!(message.starts_with(expected), "{message}");
        assert_eq!(found(&Rules::accepting_any_image(), EdgePolicy::Ignore(64)), None);
    }
}
