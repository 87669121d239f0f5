//! From presets, files and `--set` to the parameters of one frame.
//!
//! A [`Config`] holds the distribution of each knob; later settings override earlier ones, and a setting that is refused
//! changes nothing. [`Config::draw`] draws the parameters of a seed, every knob from a random stream of its own.
//! Must not know: what a knob does.

use std::path::Path;

use super::Params;
use super::distribution::{Distribution, Value};
use super::document::{collect_entries, has_non_finite};
use super::knob_info::{KnobInfo, Scope, Stage};
use super::knobs::{KNOBS, Knob};
use super::presets::presets;
use crate::error::{Error, Result, nearest};
use crate::input::{self, MIB};
use crate::random::Streams;

/// Largest size of a configuration.
const MAX_FILE_BYTES: u64 = 16 * MIB;

/// Element of the stream that a knob's random ends are drawn from; no scene has that many elements.
const ENDS: u64 = u64::MAX;

/// The distribution of each knob.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Distributions that were set; the others are the stage's defaults.
    pub(super) settings: Vec<Option<Distribution>>,
    rules: Vec<RuleSetting>,
}

/// A setting of the section `[rules]`, which says which frames a dataset accepts; stored for the dataset to read.
#[derive(Clone, Debug, PartialEq)]
pub struct RuleSetting {
    /// Its name without `rules.`.
    pub name: String,
    /// Its value, unchecked.
    pub value: toml::Value,
    /// Where it was set, for error messages.
    pub origin: String,
}

/// The name within `[rules]` of a setting; `require` is also allowed at the top level.
fn rule_name(name: &str) -> Option<&str> {
    name.strip_prefix("rules.").or((name == "require").then_some(name))
}

impl Default for Config {
    fn default() -> Self {
        Self::new()
    }
}

impl Config {
    /// The defaults of the nominal stage.
    #[must_use]
    pub fn new() -> Self {
        Self { settings: vec![None; KNOBS.len()], rules: Vec::new() }
    }

    /// The distribution of a knob on a stage.
    #[must_use]
    pub fn distribution_on(&self, stage: Stage, knob: Knob) -> &Distribution {
        self.settings[knob as usize].as_ref().unwrap_or_else(|| knob.info().default_on(stage))
    }

    /// The distribution of a knob, on the first stage if there are several.
    #[must_use]
    pub fn distribution(&self, knob: Knob) -> &Distribution {
        self.distribution_on(self.stages()[0], knob)
    }

    /// The stages that frames may have.
    #[must_use]
    pub fn stages(&self) -> Vec<Stage> {
        let names = self.distribution_on(Stage::Nominal, Knob::StageName).bounds();
        let names: Vec<Value> = names.into_iter().collect();
        let is_named = |name: &str| names.iter().any(|known| *known == Value::Text(name.to_owned().into()));
        Stage::ALL.into_iter().filter(|(_, name)| is_named(name)).map(|(stage, _)| stage).collect()
    }

    /// The settings of `[rules]`, in order.
    #[must_use]
    pub fn rules(&self) -> &[RuleSetting] {
        &self.rules
    }

    /// Starts from the defaults of a stage.
    ///
    /// # Errors
    /// [`Error::KnobOutOfRange`] for an unknown stage.
    pub fn set_stage(&mut self, name: &str) -> Result<()> {
        self.set(Knob::StageName.info(), Distribution::Fixed(Value::Text(name.to_owned().into())), "--stage")
    }

    /// Checks that nothing has changed the stage since [`Self::set_stage`].
    ///
    /// # Errors
    /// [`Error::Contradiction`].
    pub fn check_stage(&self, name: &str) -> Result<()> {
        let drawn = self.distribution(Knob::StageName);
        if *drawn == Distribution::Fixed(Value::Text(name.to_owned().into())) {
            return Ok(());
        }
        Err(Error::Contradiction(format!(
            "--stage {name}, while the preset, the file or --set has stage.name = {drawn}; leave out one of them"
        )))
    }

    /// Applies a preset.
    ///
    /// # Errors
    /// [`Error::UnknownPreset`].
    pub fn apply_preset(&mut self, name: &str) -> Result<()> {
        let known = presets();
        match known.iter().find(|(preset, _)| *preset == name) {
            Some((_, text)) => self.apply_toml(text, &format!("preset {name}")),
            None => Err(Error::UnknownPreset {
                name: name.to_owned(),
                suggestion: nearest(name, known.iter().map(|preset| preset.0)),
                available: known.iter().map(|preset| preset.0.to_owned()).collect(),
            }),
        }
    }

    /// Applies a TOML file, or standard input if the path is `-`. A pipe is read too, a device is not.
    ///
    /// # Errors
    /// [`Error::Config`], or those of [`Self::apply_toml`].
    pub fn apply_file(&mut self, path: &Path) -> Result<()> {
        let text = input::read_named_text(path, MAX_FILE_BYTES)
            .map_err(|cause| Error::Config { path: path.to_owned(), cause })?;
        self.apply_toml(&text, &path.display().to_string())
    }

    /// Applies knobs from TOML: `elevation_deg = 3` below `[sun]`, or `sun.elevation_deg = 3`.
    ///
    /// # Errors
    /// [`Error::Toml`], [`Error::UnknownKnob`], [`Error::KnobType`], [`Error::KnobOutOfRange`]: the first in the
    /// text; nothing is applied then.
    pub fn apply_toml(&mut self, text: &str, origin: &str) -> Result<()> {
        let syntax = |error: toml::de::Error| {
            let before = &text[..error.span().map_or(0, |span| span.start.min(text.len()))];
            Error::Toml {
                origin: origin.to_owned(),
                line: before.matches('\n').count() + 1,
                column: before.chars().rev().take_while(|c| *c != '\n').count() + 1,
                message: error.message().to_owned(),
            }
        };
        let table: toml::Table = toml::from_str(text).map_err(syntax)?;
        let spans = toml::de::DeTable::parse(text).map_err(syntax)?;
        let mut entries = Vec::new();
        collect_entries("", &table, spans.get_ref(), &mut entries);
        entries.sort_by_key(|(offset, ..)| *offset);
        let mut changed = self.clone();
        for (_, name, value) in entries {
            if let Some(rule) = rule_name(&name) {
                let (name, origin) = (rule.to_owned(), origin.to_owned());
                changed.rules.push(RuleSetting { name, value: value.clone(), origin });
                continue;
            }
            let info = KNOBS.iter().find(|info| info.name == name).ok_or_else(|| unknown(&name, origin))?;
            changed.set_toml(info, value, origin)?;
        }
        *self = changed;
        Ok(())
    }

    /// Applies knobs in the form of [`Self::distributions_json`] or [`Params::to_json`].
    ///
    /// # Errors
    /// As [`Self::apply_toml`].
    pub fn apply_json(
        &mut self,
        knobs: &serde_json::Map<String, serde_json::Value>,
        origin: &str,
    ) -> Result<()> {
        for (name, value) in knobs {
            let info = KNOBS.iter().find(|info| info.name == name).ok_or_else(|| unknown(name, origin))?;
            let value = toml::Value::try_from(value).map_err(|_| Error::KnobType {
                name: name.clone(),
                value: value.to_string(),
                origin: origin.to_owned(),
                expected: info.allowed(),
            })?;
            self.set_toml(info, &value, origin)?;
        }
        Ok(())
    }

    /// Applies one `key=value`.
    ///
    /// # Errors
    /// [`Error::Usage`] without a `=`, else as [`Self::apply_toml`].
    pub fn apply_set(&mut self, assignment: &str) -> Result<()> {
        let Some((name, text)) = assignment.split_once('=') else {
            return Err(Error::Usage(format!(
                "--set {assignment}: the form is KEY=VALUE, as in sun.elevation_deg=12"
            )));
        };
        let (name, text, origin) = (name.trim(), text.trim(), "--set");
        let parsed = toml::from_str::<toml::Table>(&format!("value = {text}"));
        let value =
            parsed.ok().and_then(|mut table| if table.len() == 1 { table.remove("value") } else { None });
        if let Some(rule) = rule_name(name) {
            let value = value.unwrap_or_else(|| toml::Value::String(text.to_owned()));
            self.rules.push(RuleSetting { name: rule.to_owned(), value, origin: origin.to_owned() });
            return Ok(());
        }
        let info = KNOBS.iter().find(|info| info.name == name).ok_or_else(|| unknown(name, origin))?;
        match value {
            Some(value) => self.set_toml(info, &value, origin),
            // Text needs no quotes here.
            None => self.set(info, Distribution::Fixed(Value::Text(text.to_owned().into())), origin),
        }
    }

    fn set_toml(&mut self, info: &KnobInfo, value: &toml::Value, origin: &str) -> Result<()> {
        if has_non_finite(value) {
            return Err(Error::KnobOutOfRange {
                name: info.name.to_owned(),
                value: value.to_string(),
                origin: origin.to_owned(),
                allowed: format!("{}, finite", info.allowed()),
            });
        }
        let distribution =
            Distribution::from_toml(value, info.range).map_err(|expected| Error::KnobType {
                name: info.name.to_owned(),
                value: value.to_string(),
                origin: origin.to_owned(),
                expected: format!("{expected} (allowed: {})", info.allowed()),
            })?;
        self.set(info, distribution, origin)
    }

    fn set(&mut self, info: &KnobInfo, distribution: Distribution, origin: &str) -> Result<()> {
        info.check(&distribution, origin)?;
        let index = KNOBS.iter().position(|row| row.name == info.name);
        self.settings[index.expect("a row of the table")] = Some(distribution);
        Ok(())
    }

    /// Checks constraints across knobs, for every value that can be drawn.
    ///
    /// # Errors
    /// [`Error::Contradiction`].
    pub fn check(&self) -> Result<()> {
        let stages = self.stages();
        for (info, _) in KNOBS.iter().zip(&self.settings).filter(|(_, setting)| setting.is_some()) {
            if !stages.iter().any(|stage| info.is_of(*stage)) {
                return Err(Error::Contradiction(format!(
                    "{} is set, and only the stage {} has it, while stage.name is {}; leave it out, or choose that \
                     stage",
                    info.name,
                    info.stage.map_or("", Stage::name),
                    self.distribution(Knob::StageName),
                )));
            }
        }
        stages.into_iter().try_for_each(|stage| self.check_on(stage))
    }

    fn check_on(&self, stage: Stage) -> Result<()> {
        let numbers = |knob: Knob| {
            self.distribution_on(stage, knob)
                .bounds()
                .into_iter()
                .filter_map(|bound| if let Value::Number(value) = bound { Some(value) } else { None })
                .collect::<Vec<f64>>()
        };
        let half_m = 0.5 * numbers(Knob::TerrainSizeM).into_iter().fold(f64::INFINITY, f64::min);
        for knob in [Knob::CameraXM, Knob::CameraYM] {
            if let Some(position_m) = numbers(knob).into_iter().find(|position_m| position_m.abs() >= half_m)
            {
                return Err(Error::Contradiction(format!(
                    "{} = {position_m} puts the camera off the ground, which ends {half_m} m from the origin \
                     (terrain.size_m = {}); the camera must stand on it",
                    knob.name(),
                    2.0 * half_m
                )));
            }
        }
        Ok(())
    }

    /// Draws the parameters of a seed.
    ///
    /// # Errors
    /// [`Error::Contradiction`].
    pub fn draw(&self, seed: u64) -> Result<Params> {
        self.check()?;
        let streams = Streams::new(seed);
        let drawn_once = |knob: Knob, distribution: &Distribution| {
            Distribution::Fixed(distribution.sample(&mut streams.stream(knob.name(), 0)))
        };
        let named = drawn_once(Knob::StageName, self.distribution(Knob::StageName));
        let stages = self.stages();
        let stage =
            stages.iter().find(|stage| named == Distribution::Fixed(Value::Text(stage.name().into())));
        let stage = *stage.unwrap_or(&stages[0]);
        let settings = Knob::ALL
            .into_iter()
            .map(|knob| {
                let distribution = self.distribution_on(stage, knob);
                match knob.info().scope {
                    Scope::Frame => drawn_once(knob, distribution),
                    Scope::Element(_) => distribution.with_ends(&mut streams.stream(knob.name(), ENDS)),
                }
            })
            .collect();
        Ok(Params { settings })
    }
}

impl Params {
    /// The defaults, drawn for a seed.
    ///
    /// # Panics
    /// Never: a test holds the table's defaults against their rules.
    #[must_use]
    pub fn draw_default(seed: u64) -> Self {
        Config::new().draw(seed).expect("the defaults keep their own rules")
    }
}

fn unknown(name: &str, origin: &str) -> Error {
    // Options that exist on the command line only.
    const OPTIONS: [&str; 12] = [
        "seed", "size", "samples", "outputs", "out", "count", "start", "split", "format", "adapter",
        "preset", "edges",
    ];
    if OPTIONS.contains(&name) {
        return Error::Usage(format!("`{name}` in {origin} is no knob; it is the option --{name}"));
    }
    if KNOBS.iter().any(|info| info.name.split_once('.').is_some_and(|(group, _)| group == name)) {
        return Error::Usage(format!(
            "`{name}` in {origin} is a group of knobs and no knob; `regolith-render params` lists those in [{name}]"
        ));
    }
    let suggestion = nearest(name, KNOBS.iter().map(|info| info.name));
    Error::UnknownKnob { name: name.to_owned(), origin: origin.to_owned(), suggestion }
}

#[cfg(test)]
mod tests {
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
        assert!(
            params.to_json().contains_key("relief.hurst") && !params.to_json().contains_key("rocks.count")
        );
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
        dotted
            .apply_toml("sun.elevation_deg = { uniform = [5, 40] }\nrocks.count = 80\n", "b")
            .expect("read");
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
            (
                "sun.elevation_deg=95",
                "sun.elevation_deg = 95 in --set is out of range; allowed: 0.5 to 90 deg",
            ),
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
}
