//! From presets, files and `--set` to the parameters of one frame.
//!
//! A [`Config`] holds the distribution of each knob; later settings override earlier ones, and a setting that is refused
//! changes nothing. Its variants, which a frame draws one of, are in `variants`. [`Config::draw`] draws the parameters of a seed, every knob from a random stream of its own.
//! Must not know: what a knob does.

use std::path::Path;

use super::Params;
use super::azimuth::{self, RELATIVE};
use super::distribution::{Distribution, Value};
use super::document::{collect_entries, has_non_finite};
use super::knob_info::{Kind, KnobInfo, Scope, Stage};
use super::knobs::{KNOBS, Knob};
use super::presets::presets;
use super::variant::Variant;
use crate::error::{Error, Result, nearest};
use crate::input::{self, MIB};
use crate::random::Streams;

/// Largest size of a configuration.
pub(super) const MAX_FILE_BYTES: u64 = 16 * MIB;

/// Element of the stream that a knob's random ends are drawn from; no scene has that many elements.
const ENDS: u64 = u64::MAX;

/// The distribution of each knob.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Distributions that were set; the others are fallbacks, or the stage's defaults.
    pub(super) settings: Vec<Option<Distribution>>,
    /// Distributions that presets propose where nothing is set.
    pub(super) fallbacks: Vec<Option<Distribution>>,
    /// Sets of knobs of which each frame draws one; none if all frames draw from the same distributions.
    pub(super) variants: Vec<Variant>,
    /// Where the sun's azimuth was set, absolute or relative.
    azimuth_origin: String,
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
        Self {
            settings: vec![None; KNOBS.len()],
            fallbacks: vec![None; KNOBS.len()],
            variants: Vec::new(),
            azimuth_origin: String::new(),
            rules: Vec::new(),
        }
    }

    /// The distribution of a knob on a stage, without the variants.
    #[must_use]
    pub fn distribution_on(&self, stage: Stage, knob: Knob) -> &Distribution {
        self.setting(knob).unwrap_or_else(|| knob.info().default_on(stage))
    }

    /// The azimuth that follows from the other; none if a record has both.
    pub(super) fn computed_azimuth(&self) -> Option<Knob> {
        match [RELATIVE, Knob::SunAzimuthDeg].map(|knob| self.setting(knob).is_some()) {
            [true, true] => None,
            [true, false] => Some(Knob::SunAzimuthDeg),
            [false, _] => Some(RELATIVE),
        }
    }

    /// What a knob was set to, or what a preset proposes; `None` if it has its stage's default.
    pub(super) fn setting(&self, knob: Knob) -> Option<&Distribution> {
        self.settings[knob as usize].as_ref().or(self.fallbacks[knob as usize].as_ref())
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

    /// A configuration, checked as a whole: a stage, then presets, then what `apply` sets.
    ///
    /// # Errors
    /// Those of the parts; [`Error::Contradiction`].
    pub fn layered<'a>(
        stage: Option<&str>,
        presets: impl IntoIterator<Item = &'a str>,
        apply: impl FnOnce(&mut Self) -> Result<()>,
    ) -> Result<Self> {
        let mut config = Self::new();
        stage.map_or(Ok(()), |stage| config.set_stage(stage))?;
        presets.into_iter().try_for_each(|preset| config.apply_preset(preset))?;
        apply(&mut config)?;
        stage.map_or(Ok(()), |stage| config.check_stage(stage))?;
        config.check()?;
        Ok(config)
    }

    /// Checks that nothing has changed the stage since [`Self::set_stage`].
    ///
    /// # Errors
    /// [`Error::Contradiction`].
    pub fn check_stage(&self, name: &str) -> Result<()> {
        if self.has_stage(name) {
            return Ok(());
        }
        let drawn = self.distribution(Knob::StageName);
        Err(Error::Contradiction(format!(
            "--stage {name}, while the preset, the file or --set has stage.name = {drawn}; leave out one of them"
        )))
    }

    /// Whether every frame has this stage.
    pub(super) fn has_stage(&self, name: &str) -> bool {
        *self.distribution(Knob::StageName) == Distribution::Fixed(Value::Text(name.to_owned().into()))
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

    /// The text of a file for [`Self::apply_toml`], or of standard input if the path is `-`. A pipe is read too, a device is not.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub fn read_file(path: &Path) -> Result<String> {
        input::read_named_text(path, MAX_FILE_BYTES)
            .map_err(|cause| Error::Config { path: path.to_owned(), cause })
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
        // The preset that a text starts from comes first, variants of the whole text last.
        let rank = |name: &str| match name {
            "preset" => 0,
            "variant" => 2,
            _ => 1,
        };
        entries.sort_by_key(|(offset, name, _)| (rank(name), *offset));
        let mut changed = self.clone();
        for (_, name, value) in entries {
            if matches!(name.as_str(), "preset" | "variant") {
                changed.apply_key(&name, value, origin)?;
                continue;
            }
            if let Some(knob) = name.strip_prefix("fallback.") {
                let info = find(knob, origin)?;
                changed.set_fallback(info, value, origin)?;
                continue;
            }
            if let Some(rule) = rule_name(&name) {
                let (name, origin) = (rule.to_owned(), origin.to_owned());
                changed.rules.push(RuleSetting { name, value: value.clone(), origin });
                continue;
            }
            changed.set_toml(find(&name, origin)?, value, origin)?;
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
            if name == "variant"
                || (name == RELATIVE.name() && knobs.contains_key(Knob::SunAzimuthDeg.name()))
            {
                continue;
            }
            let info = find(name, origin)?;
            let value = toml::Value::try_from(value).map_err(|_| Error::KnobType {
                name: name.clone(),
                value: value.to_string(),
                origin: origin.to_owned(),
                expected: info.allowed(),
            })?;
            self.set_toml(info, &value, origin)?;
        }
        // The record of a frame has both azimuths. One follows from the other, but for the last bit.
        if let (Some(relative), Some(_)) = (knobs.get(RELATIVE.name()), knobs.get(Knob::SunAzimuthDeg.name()))
        {
            self.settings[RELATIVE as usize] = relative.as_f64().map(Distribution::number);
        }
        knobs.get("variant").map_or(Ok(()), |variants| self.set_variants_json(variants, origin))
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
        let info = find(name, origin)?;
        // Numbers that TOML has no form for, as `.5` and `05`, or that are beyond its range.
        let number = || text.parse().ok().filter(|_| !matches!(info.kind, Kind::Text(_)));
        let value = value.or_else(|| number().map(toml::Value::Float));
        match value {
            Some(value) => self.set_toml(info, &value, origin),
            // Text needs no quotes here.
            None => self.set(info, Distribution::Fixed(Value::Text(text.to_owned().into())), origin),
        }
    }

    fn set_toml(&mut self, info: &KnobInfo, value: &toml::Value, origin: &str) -> Result<()> {
        self.set(info, Self::parsed(info, value, origin)?, origin)
    }

    /// The distribution of a knob that a TOML value stands for.
    pub(super) fn parsed(info: &KnobInfo, value: &toml::Value, origin: &str) -> Result<Distribution> {
        if has_non_finite(value) {
            return Err(Error::KnobOutOfRange {
                name: info.name.to_owned(),
                value: value.to_string(),
                origin: origin.to_owned(),
                allowed: format!("{}, finite", info.allowed()),
                suggestion: None,
            });
        }
        let distribution =
            Distribution::from_toml(value, info.range).map_err(|expected| Error::KnobType {
                name: info.name.to_owned(),
                value: value.to_string(),
                origin: origin.to_owned(),
                expected: format!("{expected} (allowed: {})", info.allowed()),
            })?;
        info.check(&distribution, origin)?;
        Ok(distribution)
    }

    /// Sets a knob for all frames, of every variant.
    fn set(&mut self, info: &KnobInfo, distribution: Distribution, origin: &str) -> Result<()> {
        info.check(&distribution, origin)?;
        let knob = info.knob();
        if let Some(other) = azimuth::other(knob) {
            if self.settings[other as usize].is_some() && self.azimuth_origin == origin {
                return Err(Error::Contradiction(format!(
                    "{origin} sets sun.azimuth_deg, which counts from +Y, and sun.relative_azimuth_deg, which counts from the \
                     camera's heading; leave out one of them"
                )));
            }
            origin.clone_into(&mut self.azimuth_origin);
        }
        for variant in &mut self.variants {
            variant.clear(knob);
        }
        self.replace(knob, distribution);
        Ok(())
    }

    /// Sets a knob of this configuration alone. The sun has one azimuth: the absolute and the relative one replace each other.
    pub(super) fn replace(&mut self, knob: Knob, distribution: Distribution) {
        if let Some(other) = azimuth::other(knob) {
            (self.settings[other as usize], self.fallbacks[other as usize]) = (None, None);
        }
        if knob == Knob::CameraYawDeg && self.setting(Knob::SunAzimuthDeg).is_some() {
            self.settings[RELATIVE as usize] = None;
        }
        self.settings[knob as usize] = Some(distribution);
    }

    /// Checks constraints across knobs, for every value that can be drawn.
    ///
    /// # Errors
    /// [`Error::Contradiction`].
    pub fn check(&self) -> Result<()> {
        if !self.variants.is_empty() {
            return self.variants.iter().try_for_each(|variant| self.of_variant(variant).check());
        }
        let stages = self.stages();
        for info in Knob::ALL.into_iter().filter(|knob| self.setting(*knob).is_some()).map(Knob::info) {
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
        // The ground of the surface stage lies around the camera.
        if stage == Stage::Surface {
            return Ok(());
        }
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
        let streams = Streams::new(seed);
        if let Some(variant) = Variant::choose(&self.variants, &streams) {
            return self.of_variant(variant).draw(seed);
        }
        self.check()?;
        let drawn_once = |knob: Knob, distribution: &Distribution| {
            Distribution::Fixed(distribution.sample(&mut streams.stream(knob.name(), 0)))
        };
        let named = drawn_once(Knob::StageName, self.distribution(Knob::StageName));
        let stages = self.stages();
        let stage =
            stages.iter().find(|stage| named == Distribution::Fixed(Value::Text(stage.name().into())));
        let stage = *stage.unwrap_or(&stages[0]);
        let mut settings: Vec<Distribution> = Knob::ALL
            .into_iter()
            .map(|knob| {
                let distribution = self.distribution_on(stage, knob);
                match knob.info().scope {
                    Scope::Frame => drawn_once(knob, distribution),
                    Scope::Element(_) => distribution.with_ends(&mut streams.stream(knob.name(), ENDS)),
                }
            })
            .collect();
        if let Some(computed) = self.computed_azimuth() {
            azimuth::complete(&mut settings, computed);
        }
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

/// The row of a knob.
pub(super) fn find(name: &str, origin: &str) -> Result<&'static KnobInfo> {
    KNOBS.iter().find(|info| info.name == name).ok_or_else(|| unknown(name, origin))
}

fn unknown(name: &str, origin: &str) -> Error {
    // Options that exist on the command line only.
    const OPTIONS: [&str; 18] = [
        "seed",
        "size",
        "samples",
        "outputs",
        "out",
        "count",
        "start",
        "split",
        "format",
        "adapter",
        "edges",
        "preset",
        "stage",
        "config",
        "raster",
        "label-ids",
        "shard",
        "threads",
    ];
    if OPTIONS.contains(&name) {
        return Error::Usage(format!("`{name}` in {origin} is no knob; it is the option --{name}"));
    }
    let is_group = |info: &KnobInfo| info.name.split_once('.').is_some_and(|(group, _)| group == name);
    if name == "rules" || KNOBS.iter().any(is_group) {
        return Error::Usage(format!(
            "`{name}` in {origin} is a group and no knob; `regolith-render params {name}` lists what is in it"
        ));
    }
    if let Some(knob) = name.strip_prefix("fallback.") {
        return Error::Usage(format!(
            "`{name}` in {origin}: only presets and files propose values; set `{knob}` itself"
        ));
    }
    let groups = KNOBS.iter().filter_map(|info| info.name.split_once('.')).map(|(group, _)| group);
    let suggestion = nearest(name, KNOBS.iter().map(|info| info.name).chain(groups).chain(["rules"]));
    Error::UnknownKnob { name: name.to_owned(), origin: origin.to_owned(), suggestion }
}

#[cfg(test)]
mod tests;
