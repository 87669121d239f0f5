//! `params` and `presets`: what can be set, and sets of it.

use crate::dataset::rules::{Rules, SETTINGS};
use crate::error::nearest;
use crate::error::{Error, Result};
use crate::params::config::Config;
use crate::params::groups::GROUPS;
use crate::params::presets::{preset_description, presets};
use crate::params::{KNOBS, KnobInfo};
use clap::Args;
use serde_json::{Value, json};

use super::args::ConfigArgs;
use super::messages::print;

/// The section of a configuration that has no knobs.
const RULES: &str = "rules";

#[derive(Args, Debug)]
pub(super) struct ParamsArgs {
    /// A knob (sun.elevation_deg) or a section of knobs (sun); all if left out
    #[arg(value_name = "KNOB")]
    knob: Option<String>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Print JSON: a list of knobs; with KNOB `rules`, the rules
    #[arg(long)]
    json: bool,
}

#[derive(Args, Debug)]
pub(super) struct PresetsArgs {
    /// A preset, whose file is printed; all with a line each if left out
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Lists the knobs, those of a section, or one.
pub(super) fn list_params(args: &ParamsArgs) -> Result<()> {
    let (config, _) = args.config.build()?;
    let rules = Rules::from_config(&config)?;
    let Some(name) = &args.knob else {
        if args.json {
            return print(&format!("{:#}\n", config.to_json()));
        }
        return print(&format!("{}\n{}", config.to_toml(), rules.to_toml()));
    };
    if name == RULES {
        return print(&if args.json { format!("{:#}\n", rules.to_json()) } else { rules.to_toml() });
    }
    if let Some(text) = name.strip_prefix("rules.").and_then(|rule| rules_listing(&rules, rule, args.json)) {
        return print(&text);
    }
    let is_listed = |info: &KnobInfo| info.name == name || info.section() == name;
    let text = config.to_toml_where(is_listed);
    if text.is_empty() {
        return Err(no_such_knob(name, &config, args.config.is_named()));
    }
    if !args.json {
        return print(&text);
    }
    let rows = config.to_json();
    let is_row = |row: &&Value| {
        let known = row["name"].as_str().unwrap_or_default();
        KNOBS.iter().any(|info| info.name == known && is_listed(info))
    };
    let rows: Vec<&Value> = rows.as_array().into_iter().flatten().filter(is_row).collect();
    print(&format!("{:#}\n", json!(rows)))
}

/// A rule by the name of its key; `None` if there is none.
fn rules_listing(rules: &Rules, key: &str, as_json: bool) -> Option<String> {
    if as_json {
        return rules.to_json().get(key).map(|value| format!("{value:#}\n"));
    }
    let text = rules.to_toml();
    let lines: Vec<&str> = text.lines().collect();
    let line = lines.iter().position(|line| line.split_once(" = ").is_some_and(|(name, _)| name == key))?;
    Some(format!("[{RULES}]\n{}\n{}\n", lines[line - 1], lines[line]))
}

/// Why nothing is listed for a name: no knob has it, or none of the stage, which a preset or a file may have chosen.
fn no_such_knob(name: &str, config: &Config, stage_is_chosen: bool) -> Error {
    let elsewhere = KNOBS.iter().find(|info| info.name == name || info.section() == name);
    if let Some(stage) = elsewhere.and_then(|info| info.stage) {
        let own: Vec<&str> = config.stages().iter().map(|stage| stage.name()).collect();
        let remedy = if stage_is_chosen { "choose another preset or file, or none and" } else { "add" };
        return Error::Usage(format!(
            "`{name}` is of the stage {0}, and not of {1}; {remedy} --stage {0}",
            stage.name(),
            own.join(", ")
        ));
    }
    let sections = GROUPS.iter().flat_map(|(.., sections)| sections.iter().copied()).chain([RULES]);
    let names = KNOBS.iter().map(|info| info.name.to_owned()).chain(sections.map(str::to_owned));
    let names: Vec<String> = names.chain(SETTINGS.iter().map(|rule| format!("{RULES}.{rule}"))).collect();
    Error::UnknownKnob {
        name: name.to_owned(),
        origin: "the command line".to_owned(),
        suggestion: nearest(name, names.iter().map(String::as_str)),
    }
}

/// Lists the presets, or prints one.
pub(super) fn list_presets(args: &PresetsArgs) -> Result<()> {
    let description = |name: &str| preset_description(name).unwrap_or_default();
    if let Some(name) = &args.name {
        let mut config = Config::new();
        config.apply_preset(name)?;
        let text = presets().into_iter().find(|(known, _)| known == name).map_or("", |(_, text)| text);
        if args.json {
            let row = json!({
                "name": name,
                "description": description(name),
                "knobs": config.distributions_json(),
                "rules": Rules::from_config(&config)?.to_json(),
            });
            return print(&format!("{row:#}\n"));
        }
        return print(text);
    }
    if args.json {
        let rows: Vec<Value> = presets()
            .iter()
            .map(|(name, _)| json!({ "name": name, "description": description(name) }))
            .collect();
        return print(&format!("{:#}\n", Value::from(rows)));
    }
    print(&presets_help())
}

/// A line for each preset.
pub(super) fn presets_help() -> String {
    let row =
        |(name, _): &(&str, &str)| format!("  {name:<22} {}\n", preset_description(name).unwrap_or_default());
    presets().iter().map(row).collect()
}

/// A line for each group of knobs.
pub(super) fn groups_help() -> String {
    let row = |(title, what, sections): &(&str, &str, &[&str])| {
        let known = |section: &&&str| KNOBS.iter().any(|info| info.section() == **section);
        let sections: Vec<&str> = sections.iter().filter(known).copied().collect();
        if sections.is_empty() {
            String::new()
        } else {
            format!("  {title:<14} {what}: {}\n", sections.join(", "))
        }
    };
    GROUPS.iter().map(row).collect()
}
