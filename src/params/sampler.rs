//! From presets, files and `--set` to the values of one frame.
//!
//! A [`Config`] holds what each knob is drawn from; later settings win over earlier ones, and a setting that is
//! refused changes nothing. [`Config::draw`] gives the values of a seed: every knob from a stream of its own.
//! Must not know: what a knob does.
//! To add a preset: a file in `assets/presets` and its row in [`presets`].

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;

use super::distribution::{Distribution, Value};
use super::{KNOBS, Kind, Knob, KnobInfo, Params, Scope, Stage};
use crate::error::{Error, Result, nearest};
use crate::random::Streams;

/// Element number of the stream that a knob's random ends are drawn from; no scene has as many elements.
const ENDS: u64 = u64::MAX;

macro_rules! preset_files {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!("../../assets/presets/", $name, ".toml")))),*]
    };
}

/// Name and TOML text of every preset that ships; the text starts with a comment that says what it is.
#[must_use]
pub const fn presets() -> [(&'static str, &'static str); 16] {
    preset_files![
        "reference",
        "train_dr",
        "train_nodr",
        "train_full",
        "test_photoreal",
        "surface_train_dr",
        "surface_train_nodr",
        "surface_train_full",
        "surface_test_photoreal",
        "sun_equatorial",
        "sun_mid_latitude",
        "sun_polar",
        "camera_hasselblad",
        "camera_navcam",
        "camera_pcam",
        "camera_colour"
    ]
}

/// What a preset is, in a line: the comment that its text starts with.
#[must_use]
pub fn preset_description(name: &str) -> Option<&'static str> {
    let (_, text) = presets().into_iter().find(|(preset, _)| *preset == name)?;
    text.lines().next()?.strip_prefix("# ")
}

/// What each knob is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// What was set; the rest is the stage's.
    settings: Vec<Option<Distribution>>,
    rules: Vec<RuleSetting>,
}

/// A setting of the section `[rules]`, which says what frames a dataset takes: kept for the dataset to read.
#[derive(Clone, Debug, PartialEq)]
pub struct RuleSetting {
    /// Its name without `rules.`.
    pub name: String,
    /// As it was given.
    pub value: toml::Value,
    /// Where it was given.
    pub origin: String,
}

/// The name within `[rules]` of a setting; the demands on classes may also stand alone.
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

    /// What a knob is drawn from on a stage.
    #[must_use]
    pub fn distribution_on(&self, stage: Stage, knob: Knob) -> &Distribution {
        self.settings[knob as usize].as_ref().unwrap_or_else(|| knob.info().default_on(stage))
    }

    /// What a knob is drawn from; where there are several stages, on the first of them.
    #[must_use]
    pub fn distribution(&self, knob: Knob) -> &Distribution {
        self.distribution_on(self.stages()[0], knob)
    }

    /// The stages that frames may show.
    #[must_use]
    pub fn stages(&self) -> Vec<Stage> {
        let names = self.distribution_on(Stage::Nominal, Knob::StageName).bounds();
        let names: Vec<Value> = names.into_iter().collect();
        let is_named = |name: &str| names.iter().any(|known| *known == Value::Text(name.to_owned().into()));
        Stage::ALL.into_iter().filter(|(_, name)| is_named(name)).map(|(stage, _)| stage).collect()
    }

    /// The knobs that the stages have, with what they are drawn from on the first stage that has each.
    fn rows(&self) -> impl Iterator<Item = (&'static KnobInfo, &Distribution)> {
        let stages = self.stages();
        Knob::ALL.into_iter().filter_map(move |knob| {
            let stage = stages.iter().find(|stage| knob.info().is_of(**stage))?;
            Some((knob.info(), self.distribution_on(*stage, knob)))
        })
    }

    /// What was set of the rules for a dataset's frames, in the order in which it was.
    #[must_use]
    pub fn rules(&self) -> &[RuleSetting] {
        &self.rules
    }

    /// Starts from the defaults of a stage.
    ///
    /// # Errors
    /// [`Error::KnobOutOfRange`] for a stage that there is not.
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

    /// Takes over a preset.
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

    /// Takes over a TOML file, or what comes from standard input where its name is `-`.
    ///
    /// # Errors
    /// [`Error::Read`], or those of [`Self::apply_toml`].
    pub fn apply_file(&mut self, path: &Path) -> Result<()> {
        let text = match path.to_str() {
            Some("-") => std::io::read_to_string(std::io::stdin()),
            _ => std::fs::read_to_string(path),
        };
        let text = text.map_err(|cause| Error::Read { path: path.to_owned(), cause })?;
        self.apply_toml(&text, &path.display().to_string())
    }

    /// Takes over knobs from TOML: `[sun]` and `elevation_deg = 3` in it, or `sun.elevation_deg = 3`.
    ///
    /// # Errors
    /// [`Error::Toml`], [`Error::UnknownKnob`], [`Error::KnobType`], [`Error::KnobOutOfRange`]: the first in the
    /// text; nothing is taken over then.
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
        let places = toml::de::DeTable::parse(text).map_err(syntax)?;
        let mut entries = Vec::new();
        collect_entries("", &table, places.get_ref(), &mut entries);
        entries.sort_by_key(|(place, ..)| *place);
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

    /// Takes over knobs as [`Self::distributions_json`] or [`Params::to_json`] gives them.
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

    /// Takes over one `key=value`.
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
            // A word needs no quotes here.
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
        let place = KNOBS.iter().position(|row| row.name == info.name);
        self.settings[place.expect("a row of the table")] = Some(distribution);
        Ok(())
    }

    /// Checks what a single knob's range cannot: that the values can hold together, whatever is drawn.
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
            if let Some(place) = numbers(knob).into_iter().find(|place| place.abs() >= half_m) {
                return Err(Error::Contradiction(format!(
                    "{} = {place} puts the camera off the ground, which ends {half_m} m from the origin \
                     (terrain.size_m = {}); the camera must stand on it",
                    knob.name(),
                    2.0 * half_m
                )));
            }
        }
        Ok(())
    }

    /// The values of a seed.
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

    /// Every knob with what is known of it, as TOML that [`Self::apply_toml`] reads.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        let mut section = "";
        for (info, distribution) in self.rows() {
            let (own_section, key) = info.name.split_once('.').unwrap_or(("", info.name));
            if own_section != section {
                section = own_section;
                let _ = writeln!(text, "{}[{section}]", if text.is_empty() { "" } else { "\n" });
            }
            let each = match info.scope {
                Scope::Frame => String::new(),
                Scope::Element(element) => format!(" One draw a {element}."),
            };
            let _ =
                writeln!(text, "# {}{each} Allowed: {}.\n{key} = {distribution}", info.doc, info.allowed());
        }
        text
    }

    /// What every knob of the stages is drawn from, by its dotted name. What frames of several stages draw from different
    /// defaults is left to them.
    #[must_use]
    pub fn distributions_json(&self) -> serde_json::Map<String, serde_json::Value> {
        let several = self.stages().len() > 1;
        let is_set = |info: &KnobInfo| {
            KNOBS.iter().zip(&self.settings).any(|(row, setting)| row.name == info.name && setting.is_some())
        };
        self.rows()
            .filter(|(info, _)| !several || info.surface_default.is_none() || is_set(info))
            .map(|(info, from)| (info.name.to_owned(), from.to_json(info.kind == Kind::Integer)))
            .collect()
    }

    /// Every knob with what is known of it.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        let stage = self.stages()[0];
        let rows = self.rows().map(|(info, distribution)| {
            let mut row = json!({
                "name": info.name,
                "value": distribution.to_json(info.kind == Kind::Integer),
                "default": info.default_on(stage).to_json(info.kind == Kind::Integer),
                "unit": info.unit,
                "drawn_per": match info.scope { Scope::Frame => "frame", Scope::Element(element) => element },
                "doc": info.doc,
            });
            row[if matches!(info.kind, Kind::Text(_)) { "choices" } else { "range" }] = match info.kind {
                Kind::Text(words) => json!(words),
                _ => json!(info.range),
            };
            row
        });
        rows.collect()
    }
}

/// The entries of a document under their dotted names, each with its place in the text: the table itself is
/// sorted by name, and the first error that is reported should be the first that is read.
fn collect_entries<'a>(
    prefix: &str,
    table: &'a toml::Table,
    places: &toml::de::DeTable<'_>,
    entries: &mut Vec<(usize, String, &'a toml::Value)>,
) {
    for (key, place) in places {
        let name =
            if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        match (&table[key.get_ref().as_ref()], place.get_ref()) {
            (toml::Value::Table(inner), toml::de::DeValue::Table(places)) if is_section(&name) => {
                collect_entries(&name, inner, places, entries);
            }
            (value, _) => entries.push((key.span().start, name, value)),
        }
    }
}

/// Whether NaN or an infinity stands anywhere in it.
fn has_non_finite(value: &toml::Value) -> bool {
    match value {
        toml::Value::Float(number) => !number.is_finite(),
        toml::Value::Array(list) => list.iter().any(has_non_finite),
        toml::Value::Table(table) => table.iter().any(|(_, inner)| has_non_finite(inner)),
        _ => false,
    }
}

fn is_section(name: &str) -> bool {
    name == "rules" || KNOBS.iter().any(|info| info.name.split('.').next() == Some(name))
}

fn unknown(name: &str, origin: &str) -> Error {
    // What is said on the command line alone.
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
    fn the_listing_reads_back() {
        for (name, text) in presets() {
            let mut preset = Config::new();
            preset.apply_preset(name).unwrap_or_else(|error| panic!("{name}: {error}"));
            preset.check().unwrap_or_else(|error| panic!("{name}: {error}"));
            let mut read = Config::new();
            read.apply_toml(&preset.to_toml(), "listing").unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(read.distributions_json(), preset.distributions_json());
            assert!(text.starts_with("# ") && preset != Config::new(), "{name}");
            assert!(preset_description(name).is_some_and(|line| line.len() > 20), "{name}");
        }
        let mut from_json = Config::new();
        let mut full = Config::new();
        full.apply_preset("train_full").expect("a preset");
        from_json.apply_json(&full.distributions_json(), "JSON").expect("read");
        assert_eq!(from_json.distributions_json(), full.distributions_json());
        assert_eq!(preset_description("train"), None);
        let nominal = KNOBS.iter().filter(|info| info.is_of(Stage::Nominal)).count();
        assert_eq!(Config::new().to_json().as_array().map(Vec::len), Some(nominal));
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
                "sun.elevation_deg = 95 in --set is out of range: allowed is 0.5 to 90 deg",
            ),
            (
                "sun.elevation_deg=nan",
                "sun.elevation_deg = nan in --set is out of range: allowed is 0.5 to 90 deg, finite",
            ),
            ("sun.elevation_deg={uniform=[5, inf]}", "out of range: allowed is 0.5 to 90 deg, finite"),
            ("sun.elevation_deg={uniform=[5, 95]}", "out of range: allowed is 0.5 to 90 deg"),
            ("sun.elevation_deg=high", "expected a number"),
            ("rocks.count=7.5", "expected a whole number"),
            ("rocks.count={uniform=[1,9]}", "expected a whole number"),
            ("sun.color=3", "expected a colour"),
            ("stage.name=mars", "allowed is nominal"),
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
