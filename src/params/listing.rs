//! A configuration as TOML and JSON: for `params`, for the manifest of a dataset, and to be read back.
//!
//! Must not know: what a knob does.

use std::fmt::Write as _;

use serde_json::json;

use super::config::Config;
use super::distribution::Distribution;
use super::groups::{GROUPS, group_of};
use super::knob_info::{Kind, KnobInfo, Scope, Stage};
use super::knobs::Knob;
use super::variant::Variant;

impl Config {
    /// Whether a knob has the default of its stage, which differs between the stages that frames may have.
    fn depends_on_stage(&self, info: &KnobInfo) -> bool {
        self.stages().len() > 1 && info.surface_default.is_some() && self.setting(info.knob()).is_none()
    }

    /// Whether a knob has no value for all frames: each stage has its own default for it, or it is the azimuth that follows from the other.
    fn is_unset(&self, info: &KnobInfo) -> bool {
        self.depends_on_stage(info) || Some(info.knob()) == self.computed_azimuth()
    }

    /// The knobs of the stages with their distributions, on the first stage that has each.
    fn rows(&self) -> impl Iterator<Item = (&'static KnobInfo, &Distribution)> {
        let stages = self.stages();
        Knob::ALL.into_iter().filter_map(move |knob| {
            let stage = stages.iter().find(|stage| knob.info().is_of(**stage))?;
            Some((knob.info(), self.distribution_on(*stage, knob)))
        })
    }

    /// Every knob with its description, by groups, as TOML that [`Self::apply_toml`] reads. What frames of several stages draw from
    /// different defaults is a comment, as a value would hold for all of them.
    #[must_use]
    pub fn to_toml(&self) -> String {
        self.to_toml_where(|_| true) + &self.variants_toml()
    }

    /// The same for some knobs; a comment names those of them that variants draw from something else.
    #[must_use]
    pub fn to_toml_where(&self, is_listed: impl Fn(&KnobInfo) -> bool) -> String {
        let mut rows: Vec<_> = self.rows().filter(|(info, _)| is_listed(info)).collect();
        // Sections stay together, in the order of the table within their group.
        rows.sort_by_key(|(info, _)| group_of(info.section()));
        let mut text = String::new();
        let (mut section, mut group) = ("", usize::MAX);
        for (info, distribution) in rows {
            let key = info.name.split_once('.').map_or(info.name, |(_, key)| key);
            if info.section() != section {
                section = info.section();
                let _ = write!(text, "{}", if text.is_empty() { "" } else { "\n" });
                if group_of(section) != group {
                    group = group_of(section);
                    if let Some((title, what, _)) = GROUPS.get(group) {
                        let _ = writeln!(text, "#\n# {title}: {what}\n#");
                    }
                }
                let _ = writeln!(text, "[{section}]");
            }
            let unset = if self.is_unset(info) { "# " } else { "" };
            let by_stage = if self.depends_on_stage(info) {
                let default = |stage: &Stage| format!("{} {}", stage.name(), info.default_on(*stage));
                let defaults: Vec<String> = self.stages().iter().map(default).collect();
                format!(" Defaults by stage: {}.", defaults.join(", "))
            } else {
                String::new()
            };
            let each = match info.scope {
                Scope::Frame => String::new(),
                Scope::Element(element) => format!(" Drawn per {element}."),
            };
            let _ = writeln!(
                text,
                "# {}{each} Allowed: {}.{by_stage}\n{unset}{key} = {distribution}",
                info.doc,
                info.allowed()
            );
        }
        let of_variants: Vec<&str> = self
            .rows()
            .map(|(info, _)| info)
            .filter(|info| is_listed(info) && !self.in_variants(info.knob()).is_empty())
            .map(|info| info.name)
            .collect();
        if !of_variants.is_empty() {
            let _ = writeln!(
                text,
                "\n# Some frames draw otherwise, by [[variant]], which `params` lists behind all knobs: {}.",
                of_variants.join(", ")
            );
        }
        text
    }

    /// What variants draw a knob from, in their order; none of those that leave it as it is.
    fn in_variants(&self, knob: Knob) -> Vec<(f64, &Distribution)> {
        let set = self.variants.iter().filter_map(|Variant { weight, settings }| {
            settings[knob as usize].as_ref().map(|distribution| (*weight, distribution))
        });
        set.collect()
    }

    /// What every knob of the stages is drawn from, by its dotted name. What frames of several stages draw from different
    /// defaults is left to them.
    #[must_use]
    pub fn distributions_json(&self) -> serde_json::Map<String, serde_json::Value> {
        let variants = (!self.variants.is_empty()).then(|| ("variant".to_owned(), self.variants_json()));
        self.rows()
            .filter(|(info, _)| !self.is_unset(info))
            .map(|(info, from)| (info.name.to_owned(), from.to_json(info.kind == Kind::Integer)))
            .chain(variants)
            .collect()
    }

    /// Every knob with its type, unit, default and description. The value is null of what each stage has its own default for, listed as
    /// `value_by_stage`, and of the azimuth that follows from the other; `variants` are what variants draw from instead, with their weights.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        let stage = self.stages()[0];
        let rows = self.rows().map(|(info, distribution)| {
            let json_of = |from: &Distribution| from.to_json(info.kind == Kind::Integer);
            let mut row = json!({
                "name": info.name,
                "group": GROUPS.get(group_of(info.section())).map(|(title, ..)| title),
                "value": if self.is_unset(info) { serde_json::Value::Null } else { json_of(distribution) },
                "default": json_of(info.default_on(stage)),
                "unit": info.unit,
                "drawn_per": match info.scope { Scope::Frame => "frame", Scope::Element(element) => element },
                "doc": info.doc,
            });
            row[if matches!(info.kind, Kind::Text(_)) { "choices" } else { "range" }] = match info.kind {
                Kind::Text(words) => json!(words),
                _ => json!(info.range),
            };
            if self.depends_on_stage(info) {
                let default = |stage: Stage| (stage.name().to_owned(), json_of(info.default_on(stage)));
                row["value_by_stage"] = self.stages().into_iter().map(default).collect();
            }
            let of_variants = self.in_variants(info.knob());
            if !of_variants.is_empty() {
                let variant = |(weight, from): &(f64, &Distribution)| json!({ "weight": weight, "value": json_of(from) });
                row["variants"] = of_variants.iter().map(variant).collect();
            }
            row
        });
        rows.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::KNOBS;
    use crate::params::presets::{preset_description, presets};

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

    /// JSON has no value where TOML has a comment, and what variants draw from.
    #[test]
    fn json_says_what_each_stage_and_variant_draws_from() {
        let row = |config: &Config, name: &str| -> serde_json::Value {
            let rows = config.to_json();
            rows.as_array().into_iter().flatten().find(|row| row["name"] == name).expect("a row").clone()
        };
        let mut config = Config::new();
        config.apply_set("camera.yaw_deg=90").expect("set");
        assert_eq!(row(&config, "sun.relative_azimuth_deg")["value"], serde_json::Value::Null);
        assert_eq!(row(&config, "sun.azimuth_deg")["value"], json!(120.0));
        config.apply_set(r#"stage.name={choice=["nominal","surface"]}"#).expect("set");
        let intensity = row(&config, "sun.intensity");
        assert_eq!(intensity["value"], serde_json::Value::Null);
        assert_eq!(intensity["value_by_stage"], json!({ "nominal": 14000.0, "surface": 3500.0 }));
        let mut rover = Config::new();
        rover.apply_preset("surface_rover").expect("a preset");
        assert!(row(&rover, "camera.height_m")["variants"].as_array().is_some_and(|list| list.len() > 1));
        assert!(
            rover.to_toml_where(|info| info.section() == "camera").contains("# Some frames draw otherwise")
        );
        assert!(!rover.to_toml_where(|info| info.section() == "sky").contains("Some frames draw otherwise"));
    }

    #[test]
    fn a_listing_of_several_stages_leaves_each_its_defaults() {
        let mut both = Config::new();
        both.apply_set(r#"stage.name={choice=["nominal","surface"]}"#).expect("set");
        both.apply_set("regolith.albedo=0.15").expect("set");
        let listing = both.to_toml();
        let mut read = Config::new();
        read.apply_toml(&listing, "listing").expect("read");
        for knob in Knob::ALL {
            for stage in both.stages().into_iter().filter(|stage| knob.info().is_of(*stage)) {
                assert_eq!(
                    read.distribution_on(stage, knob),
                    both.distribution_on(stage, knob),
                    "{}",
                    knob.name()
                );
            }
        }
        assert!(
            listing.contains(" Defaults by stage: nominal 14000, surface 3500.\n# intensity = 14000\n"),
            "{listing}"
        );
        assert!(listing.contains("\nalbedo = 0.15\n"), "what was set holds for both");
    }
}
