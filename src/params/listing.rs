//! A configuration as TOML and JSON: for `params`, for the manifest of a dataset, and to be read back.
//!
//! Must not know: what a knob does.

use std::fmt::Write as _;

use serde_json::json;

use super::config::Config;
use super::distribution::Distribution;
use super::groups::{GROUPS, group_of};
use super::knob_info::{Kind, KnobInfo, Scope};
use super::knobs::Knob;

impl Config {
    /// The knobs of the stages with their distributions, on the first stage that has each.
    fn rows(&self) -> impl Iterator<Item = (&'static KnobInfo, &Distribution)> {
        let stages = self.stages();
        Knob::ALL.into_iter().filter_map(move |knob| {
            let stage = stages.iter().find(|stage| knob.info().is_of(**stage))?;
            Some((knob.info(), self.distribution_on(*stage, knob)))
        })
    }

    /// Every knob with its description, by groups, as TOML that [`Self::apply_toml`] reads.
    #[must_use]
    pub fn to_toml(&self) -> String {
        self.to_toml_where(|_| true) + &self.variants_toml()
    }

    /// The same for some knobs, without variants.
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
            // Of the two azimuths the one that was set.
            let unset = if Some(info.knob()) == self.computed_azimuth() { "# " } else { "" };
            let each = match info.scope {
                Scope::Frame => String::new(),
                Scope::Element(element) => format!(" Drawn per {element}."),
            };
            let _ = writeln!(
                text,
                "# {}{each} Allowed: {}.\n{unset}{key} = {distribution}",
                info.doc,
                info.allowed()
            );
        }
        text
    }

    /// What every knob of the stages is drawn from, by its dotted name. What frames of several stages draw from different
    /// defaults is left to them.
    #[must_use]
    pub fn distributions_json(&self) -> serde_json::Map<String, serde_json::Value> {
        let several = self.stages().len() > 1;
        let is_set = |info: &KnobInfo| self.setting(info.knob()).is_some();
        let variants = (!self.variants.is_empty()).then(|| ("variant".to_owned(), self.variants_json()));
        self.rows()
            .filter(|(info, _)| Some(info.knob()) != self.computed_azimuth())
            .filter(|(info, _)| !several || info.surface_default.is_none() || is_set(info))
            .map(|(info, from)| (info.name.to_owned(), from.to_json(info.kind == Kind::Integer)))
            .chain(variants)
            .collect()
    }

    /// Every knob with its type, unit, default and description.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        let stage = self.stages()[0];
        let rows = self.rows().map(|(info, distribution)| {
            let mut row = json!({
                "name": info.name,
                "group": GROUPS.get(group_of(info.section())).map(|(title, ..)| title),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::presets::{preset_description, presets};
    use crate::params::{KNOBS, Stage};

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
}
