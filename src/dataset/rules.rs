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
    /// The value found, if it is one number.
    pub value: Option<String>,
    /// The value found and the limit.
    pub found: String,
}

impl Violation {
    fn new(rule: &str, value: String, found: String) -> Self {
        Self { rule: rule.to_owned(), value: Some(value), found }
    }
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

    /// The name of the setting of a rule, as in `rules.sky_max` for `sky`; `None` for a rule that has none.
    #[must_use]
    pub fn setting_of(rule: &str) -> Option<String> {
        let name = rule.split('.').next();
        let is_of_rule =
            |setting: &str| name == Some(setting.trim_end_matches("_max").trim_end_matches("_min"));
        SETTINGS.into_iter().find(|setting| is_of_rule(setting)).map(|setting| format!("rules.{setting}"))
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
        let unlabelled = frame.unlabelled_px();
        if unlabelled > 0 {
            let found = format!("{unlabelled} pixels carry no label");
            return Some(Violation::new("unlabelled", unlabelled.to_string(), found));
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
            return Some(Violation::new(&format!("require.{}", class.name), format!("{share:.4}"), found));
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
        Some(Violation::new("ignored", format!("{share:.3}"), found))
    }

    /// The first rule that a scene breaks, whatever its frame shows.
    #[must_use]
    pub fn violation_of_scene(scene: &Scene) -> Option<Violation> {
        let eye = scene.camera.eye;
        let height_m = eye.z - scene.terrain.surface_height_at(eye.truncate());
        if height_m <= 0.0 {
            let height = format!("{height_m:.2}");
            let found = format!("the eye is {height} m above the ground");
            return Some(Violation::new("eye_above_ground", height, found));
        }
        let near_eye = scene.rocks.build_where(|rock| rock.may_lie_within(0.0, eye));
        if let Some((_, rock)) =
            near_eye.into_iter().find(|(_, rock)| rock.body.is_rock() && rock.distance_to(eye, 1.0) <= 0.0)
        {
            let found = format!("the eye is inside rock {}", rock.index);
            return Some(Violation { rule: "eye_outside_rocks".to_owned(), value: None, found });
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
            return Some(Violation::new(rule, format!("{share:.3}"), found));
        }
        let median = found.sky_median.filter(|median| f64::from(*median) > self.sky_max)?;
        let found = format!(
            "half of the sky has a value of {median} or more; the limit is rules.sky_max = {}",
            self.sky_max
        );
        Some(Violation::new("sky", median.to_string(), found))
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
mod tests;
