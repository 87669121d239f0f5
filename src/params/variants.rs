//! Presets within presets, and variants: the keys `preset`, `[[variant]]` and `[fallback]` of a configuration.
//!
//! Must not know: what a knob does.

use serde_json::{Map, Value, json};

use super::config::{Config, find};
use super::distribution::Distribution;
use super::knob_info::{Kind, KnobInfo};
use super::knobs::{KNOBS, Knob};
use super::variant::Variant;
use crate::error::{Error, Result};

impl Config {
    /// Applies the key `preset` or `variant`.
    pub(super) fn apply_key(&mut self, key: &str, value: &toml::Value, origin: &str) -> Result<()> {
        if key == "preset" {
            return self.apply_presets(value, origin);
        }
        let tables =
            value.as_array().filter(|list| !list.is_empty()).ok_or_else(|| refused(value, origin))?;
        let read = |table: &toml::Value| match table {
            toml::Value::Table(table) => self.variant(table, origin),
            other => Err(refused(other, origin)),
        };
        self.variants = tables.iter().map(read).collect::<Result<_>>()?;
        if has_finite_sum(&self.variants) { Ok(()) } else { Err(refused(value, origin)) }
    }

    /// Applies presets by name, separated by commas.
    fn apply_presets(&mut self, names: &toml::Value, origin: &str) -> Result<()> {
        let names = names.as_str().ok_or_else(|| {
            Error::Usage(format!("preset = {names} in {origin}: it should be the name of a preset, as text"))
        })?;
        names.split(',').try_for_each(|name| self.apply_preset(name.trim()))
    }

    /// What presets propose for a knob where nothing sets it.
    pub(super) fn set_fallback(&mut self, info: &KnobInfo, value: &toml::Value, origin: &str) -> Result<()> {
        self.fallbacks[info.knob() as usize] = Some(Self::parsed(info, value, origin)?);
        Ok(())
    }

    /// A variant of this configuration: presets, then knobs, of which those count that differ. Rules of its presets do not: rules
    /// hold for all frames.
    fn variant(&self, table: &toml::Table, origin: &str) -> Result<Variant> {
        let weight = match table.get("weight") {
            None => 1.0,
            Some(weight) => {
                let number = weight.as_float().or(weight.as_integer().map(|whole| whole as f64));
                number.filter(|n| n.is_finite() && *n >= 0.0).ok_or_else(|| refused_weight(weight, origin))?
            }
        };
        let mut own = Self::new();
        if let Some(names) = table.get("preset") {
            own.apply_presets(names, origin)?;
        }
        if !own.variants.is_empty() {
            return Err(Error::Usage(format!(
                "a variant in {origin} names a preset that has variants itself; name one without"
            )));
        }
        let knobs: toml::Table = table
            .iter()
            .filter(|(key, _)| !matches!(key.as_str(), "weight" | "preset"))
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        if knobs.contains_key("rules") || knobs.contains_key("require") || knobs.contains_key("variant") {
            return Err(Error::Usage(format!(
                "a variant in {origin} has rules or variants; it has a weight, a preset and knobs, and rules hold for all frames"
            )));
        }
        own.apply_toml(&knobs.to_string(), origin)?;
        let of_knob = |knob: Knob| {
            let set = own.settings[knob as usize].as_ref().filter(|set| self.setting(knob) != Some(set));
            let proposed = || own.fallbacks[knob as usize].as_ref().filter(|_| self.setting(knob).is_none());
            set.or_else(proposed).cloned()
        };
        let settings: Vec<_> = Knob::ALL.into_iter().map(of_knob).collect();
        let stage = settings[Knob::StageName as usize].as_ref();
        if let Some(stage) = stage {
            return Err(Error::Contradiction(format!(
                "a variant in {origin} has stage.name = {stage}, and the configuration {}; all variants have the stage of the \
                 configuration: set it before them",
                self.distribution(Knob::StageName)
            )));
        }
        Ok(Variant { weight, settings })
    }

    /// The configuration of a frame of a variant.
    pub(super) fn of_variant(&self, variant: &Variant) -> Self {
        let mut config = self.clone();
        config.variants.clear();
        for (knob, setting) in Knob::ALL.into_iter().zip(&variant.settings) {
            if let Some(distribution) = setting {
                config.replace(knob, distribution.clone());
            }
        }
        config
    }

    /// Replaces the variants by those of [`Self::variants_json`].
    pub(super) fn set_variants_json(&mut self, variants: &Value, origin: &str) -> Result<()> {
        let refused =
            || Error::Usage(format!("{origin}: variant = {variants}: not a list of weights and knobs"));
        let read = |row: &Value| -> Result<Variant> {
            let (weight, knobs) = row["weight"].as_f64().zip(row["knobs"].as_object()).ok_or_else(refused)?;
            let mut settings: Vec<Option<Distribution>> = vec![None; KNOBS.len()];
            for (name, value) in knobs {
                let info = find(name, origin)?;
                let value = toml::Value::try_from(value).map_err(|_| refused())?;
                settings[info.knob() as usize] = Some(Self::parsed(info, &value, origin)?);
            }
            Ok(Variant { weight, settings })
        };
        let read: Vec<_> =
            variants.as_array().ok_or_else(refused)?.iter().map(read).collect::<Result<_>>()?;
        if !read.is_empty() && !has_finite_sum(&read) {
            return Err(refused());
        }
        self.variants = read;
        Ok(())
    }

    /// The variants: weight and knobs of each.
    pub(super) fn variants_json(&self) -> Value {
        let row = |variant: &Variant| {
            let knobs: Map<String, Value> = KNOBS
                .iter()
                .zip(&variant.settings)
                .filter_map(|(info, setting)| {
                    Some((info.name.to_owned(), setting.as_ref()?.to_json(info.kind == Kind::Integer)))
                })
                .collect();
            json!({ "weight": variant.weight, "knobs": knobs })
        };
        self.variants.iter().map(row).collect()
    }

    /// The variants as TOML.
    pub(super) fn variants_toml(&self) -> String {
        let mut text = String::new();
        for variant in &self.variants {
            text += &format!("\n[[variant]]\nweight = {}\n", variant.weight);
            for (info, setting) in KNOBS.iter().zip(&variant.settings) {
                if let Some(distribution) = setting {
                    text += &format!("{} = {distribution}\n", info.name);
                }
            }
        }
        text
    }
}

/// Whether the weights have a finite sum above 0. One that overflows would leave every frame the last variant.
fn has_finite_sum(variants: &[Variant]) -> bool {
    let sum: f64 = variants.iter().map(|variant| variant.weight).sum();
    (f64::MIN_POSITIVE..=f64::MAX).contains(&sum)
}

fn refused_weight(weight: &toml::Value, origin: &str) -> Error {
    Error::Usage(format!(
        "weight = {weight} in {origin}: the weight of a [[variant]] is a number of 0 or more"
    ))
}

fn refused(value: &toml::Value, origin: &str) -> Error {
    Error::Usage(format!(
        "variant = {value} in {origin}: each [[variant]] has a weight of 0 or more, with a finite sum above 0, a preset or none, and knobs"
    ))
}
